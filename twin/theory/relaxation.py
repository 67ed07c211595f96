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

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Floats, frozen


def fading(x: Floats) -> tuple[Floats, Floats]:
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
        """Return the strain, over the final stress / G0, a time after a stress has grown linearly
        for some ``seconds``."""
        share, late_s = self.retardation
        mean = fading(seconds / late_s)[1]
        return float(1.0 + share @ (1.0 - mean * np.exp(-since_s / late_s)))

    def dynamic_modulus(self, frequency: Floats | float) -> np.ndarray:
        """Return the complex modulus (G' + i G'')/G0 at angular frequencies (...), 1/s."""
        turned = 1j * np.asarray(frequency)[..., None] * self.time_s
        return np.asarray(1.0 - (1.0 / (1.0 + turned)) @ self.share)

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


class Hereditary:
    """Turns elastic forces q, which follow each other in time, into those of rubber that relaxes.

    Elastic forces are those under which rubber of the instantaneous modulus that doesn't relax
    would have the same shape. The rubber was never loaded before the first of them.

    Parameters
    ----------
    relaxation
        The Prony series.

    Notes
    -----
    f(t) = int G(t - s)/G0 dq(s) = q - sum g_i (q - H_i), H_i = int exp(-(t - s)/tau_i) dq(s)
    (J. D. Ferry, 1980, chapter 3). Exact where q changes linearly in between.

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
        self._elastic: Floats | None = None
        self._kept: Floats = np.zeros((len(relaxation.share), 0))

    def after(self, seconds: float, elastic: Floats) -> Floats:
        """Return the (m,) forces at the end of an interval from the (m,) elastic ones there."""
        share, time_s = self._relaxation.share, self._relaxation.time_s
        before = self._elastic
        if before is None:
            before = np.zeros_like(elastic)
            self._kept = np.zeros((len(share), len(elastic)))
        kept, mean = fading(seconds / time_s)
        self._kept = kept[:, None] * self._kept + mean[:, None] * (elastic - before)
        self._elastic = elastic.copy()
        return np.asarray((1.0 - share.sum()) * elastic + share @ self._kept)
