"""Linear viscoelasticity with one relaxation function: a Prony series, and the creep function that
belongs to it.

Under a strain that is held the stress falls as G(t)/G0 = 1 - sum g_i (1 - exp(-t/tau_i)). Under a
stress that is held the strain grows as the creep function G0 J(t) = 1 + sum c_j (1 -
exp(-t/theta_j)), whose transform is the inverse of that of G (J. D. Ferry, Viscoelastic Properties
of Polymers, 1980, chapter 3).

Validity: small strain; Poisson's ratio doesn't change with time, so that one function serves shear
and volume.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Floats, frozen


def _fading(x: Floats) -> tuple[Floats, Floats]:
    """Return exp(-x) and its mean from 0 to x, for x (n,) from 0."""
    mean = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
    return np.exp(-x), mean


@dataclass(frozen=True)
class Relaxation:
    """A Prony series of n terms.

    Attributes
    ----------
    share
        (n,) g_i, by which share of the instantaneous modulus G0 each term relaxes; together less
        than 1.
    time_s
        (n,) tau_i, s.

    Examples
    --------
    >>> import numpy as np
    >>> from twin.theory.relaxation import Relaxation
    >>> rubber = Relaxation(np.array([0.2]), np.array([1.0]))
    >>> [round(float(value), 3) for value in (rubber.modulus(1e9), rubber.creep(1e9))]
    [0.8, 1.25]
    """

    share: Floats
    time_s: Floats

    def __post_init__(self) -> None:
        frozen(self.share)
        frozen(self.time_s)

    def modulus(self, time_s: Floats | float) -> Floats:
        """Return G/G0 a time after a sudden strain, for times (...) from 0, s."""
        gone = -np.expm1(-np.asarray(time_s)[..., None] / self.time_s)
        return np.asarray(1.0 - gone @ self.share)

    def creep(self, time_s: Floats | float) -> Floats:
        """Return G0 J a time after a sudden stress, for times (...) from 0, s."""
        share, late_s = self.retardation
        return np.asarray(1.0 - np.expm1(-np.asarray(time_s)[..., None] / late_s) @ share)

    def ramp_creep(self, since_s: float, seconds: float) -> float:
        """Return the strain, over final stress / G0, some time after a linear rise in
        ``seconds``."""
        share, late_s = self.retardation
        mean = _fading(seconds / late_s)[1]
        return float(1.0 + share @ (1.0 - mean * np.exp(-since_s / late_s)))

    @cached_property
    def retardation(self) -> tuple[Floats, Floats]:
        """(n,) shares c_j and (n,) times theta_j, s, of the creep function.

        Notes
        -----
        Let H_i be the part of a strain q that term i has not forgotten, H_i' = q' - H_i/tau_i. A
        stress that is held means q' = sum g_i H_i/tau_i. With s_i = (g_i/tau_i)^(1/2) the vector
        s_i H_i follows the symmetric matrix s s^T - diag(1/tau). Its eigenvalues are -1/theta_j,
        and c_j = theta_j (v_j s)^2 for its eigenvectors v_j.
        """
        size = np.sqrt(self.share / self.time_s)
        rate, vectors = np.linalg.eigh(np.outer(size, size) - np.diag(1.0 / self.time_s))
        return (vectors.T @ size) ** 2 / -rate, -1.0 / rate


@dataclass(frozen=True, kw_only=True)
class RubberMemory:
    """What n terms of a Prony series remember of elastic forces q.

    Elastic forces are those under which rubber of the instantaneous modulus that doesn't relax
    would have the same shape.

    Attributes
    ----------
    relaxation
        The series.
    elastic
        (...) q, of forces or torques of any number.
    kept
        (n, ...) H_i, the part of q that each term has not forgotten.

    Notes
    -----
    Forces are the convolution of the changes of q with the relaxation function,

        f(t) = int G(t - s)/G0 dq(s) = q - sum g_i (q - H_i),  H_i = int exp(-(t - s)/tau_i) dq(s)

    (J. D. Ferry, 1980, chapter 3). While q changes linearly during an interval, f = share q + left
    exactly, with a number and an array that are known before it. So an interval's contact is an
    elastic one, for the forces f/share and the gaps of a surface that the memory alone has moved by
    -C left/share, where C is the compliance at the instantaneous modulus.
    """

    relaxation: Relaxation
    elastic: Floats
    kept: Floats

    @classmethod
    def at_rest(cls, relaxation: Relaxation, shape: tuple[int, ...]) -> RubberMemory:
        """Return the memory of rubber that was never loaded."""
        kept = np.zeros((len(relaxation.share), *shape))
        return cls(relaxation=relaxation, elastic=np.zeros(shape), kept=kept)

    def over(self, seconds: float) -> tuple[float, Floats]:
        """Return ``share`` and ``left`` (...): after an interval the forces are share q + left."""
        kept, mean = _fading(seconds / self.relaxation.time_s)
        share = self.relaxation.share
        left = np.tensordot(share * kept, self.kept, 1) - (share @ mean) * self.elastic
        return float(1.0 - share @ (1.0 - mean)), left

    def after(self, seconds: float, forces: Floats) -> RubberMemory:
        """Return the memory after an interval at whose end the forces are (...)."""
        share, left = self.over(seconds)
        return self.after_elastic(seconds, (forces - left) / share)

    def after_elastic(self, seconds: float, elastic: Floats) -> RubberMemory:
        """Return the memory after an interval at whose end the elastic forces are (...)."""
        kept, mean = _fading(seconds / self.relaxation.time_s)
        per_term = (len(kept), *(1,) * elastic.ndim)
        changed = kept.reshape(per_term) * self.kept
        changed += mean.reshape(per_term) * (elastic - self.elastic)
        return replace(self, elastic=elastic, kept=changed)


class Hereditary:
    """Turns elastic forces, which follow each other in time, into those of rubber that relaxes: see
    `RubberMemory`. The rubber was never loaded before the first of them.

    Parameters
    ----------
    relaxation
        The Prony series.

    Attributes
    ----------
    off
        (m,) by how much the last forces may be off, as the shape need not change linearly from one
        to the next: a change at the interval's end is forgotten less than that by 1 - mean of each
        term. What intervals add is independent, and fades with the terms.

    Examples
    --------
    A shape that is held:

    >>> import numpy as np
    >>> from twin.theory.relaxation import Hereditary, Relaxation
    >>> history = Hereditary(Relaxation(np.array([0.2]), np.array([1.0])))
    >>> [round(float(history.after(seconds, np.ones(1))[0]), 3) for seconds in (0.0, 1.0, 1e9)]
    [1.0, 0.874, 0.8]
    """

    def __init__(self, relaxation: Relaxation) -> None:
        self._relaxation = relaxation
        self._memory: RubberMemory | None = None
        self._variance: Floats = np.zeros((1, 1, 1))  # (n, n, m) of the terms' forces
        self.off: Floats = np.zeros(0)

    def after(self, seconds: float, elastic: Floats) -> Floats:
        """Return the (m,) forces at the end of an interval from the (m,) elastic ones there."""
        memory = self._memory or RubberMemory.at_rest(self._relaxation, elastic.shape)
        share, left = memory.over(seconds)
        kept, mean = _fading(seconds / self._relaxation.time_s)
        added = np.multiply.outer(self._relaxation.share * (1.0 - mean), elastic - memory.elastic)
        before = np.multiply.outer(kept, kept)[..., None] * self._variance
        self._variance = before + added[:, None] * added
        self.off = np.sqrt(self._variance.sum(axis=(0, 1)))
        self._memory = memory.after_elastic(seconds, elastic.copy())
        return np.asarray(share * elastic + left)
