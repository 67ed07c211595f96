"""Which patches touch, which of those slip, and the few unknowns that each is left with.

A slipping patch has two unknowns, not three: along its drag d the force is mu f_n, so that only f_n and the force
across d, which turns d, are left. A sticking one has three. Unknowns of n patches in contact, of which s stick, are
ordered (normal forces, n; forces aside, n; forces ahead, s), and so are the equations.

Why numba: turning a few hundred short vectors is a dozen calls in NumPy, which take as long as a product with the
compliance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Patches in contact, each with axes along and across its drag.

    Attributes
    ----------
    touching
        (n,) indices of the patches in contact.
    slips
        (n,) which of them slip.
    ahead
        (n, 2) the drag's direction; of a sticking patch, its own first axis.
    mu
        (n,) coefficient of friction, 0 where it sticks.
    share
        (n,) c = mu f_n / drag: across its drag a slipping patch turns by (1 - c) f / r + c w = 0. 1 where it sticks.
    """

    touching: Ints
    slips: Bools
    ahead: Floats
    mu: Floats
    share: Floats

    @cached_property
    def stuck(self) -> Ints:
        """(s,) which of the n patches stick."""
        return np.flatnonzero(~self.slips)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 2 * len(self.touching) + len(self.stuck)

    @property
    def aside(self) -> slice:
        """The unknowns and equations across the drag."""
        return slice(len(self.touching), 2 * len(self.touching))

    def turned(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the parts along and across the drag of (n, ...) parts along the patches' own axes."""
        shape = (-1,) + (1,) * (x.ndim - 1)
        cosine, sine = self.ahead[:, 0].reshape(shape), self.ahead[:, 1].reshape(shape)
        return cosine * x + sine * y, cosine * y - sine * x

    @cached_property
    def _third(self) -> Ints:
        """(n,) where each patch's force ahead is among the unknowns; 0 where it slips."""
        third = np.zeros(len(self.touching), int)
        third[self.stuck] = np.arange(2 * len(self.touching), self.size)
        return third

    def forces(self, unknowns: Floats) -> Floats:
        """Return (3, n, ...) forces in the patches' frames that (size, ...) unknowns stand for."""
        columns = unknowns.reshape(self.size, math.prod(unknowns.shape[1:]))
        out = np.empty((3, len(self.touching), columns.shape[1]), unknowns.dtype)
        _forces(columns, self.ahead, self.mu, self._third, out)
        return out.reshape(3, len(self.touching), *unknowns.shape[1:])

    def seen(self, vectors: Floats) -> Floats:
        """Return (size, ...) parts of (3, n, ...) vectors: normal, across the drag, and along it where it sticks."""
        columns = vectors.reshape(3, len(self.touching), math.prod(vectors.shape[2:]))
        out = np.empty((self.size, columns.shape[2]), vectors.dtype)
        _seen(columns, self.ahead, self._third, out)
        return out.reshape(self.size, *vectors.shape[2:])

    def unseen(self, parts: Floats) -> Floats:
        """Return the (3, n, ...) vectors whose `seen` is (size, ...), without a part along a slipping patch's drag."""
        columns = parts.reshape(self.size, math.prod(parts.shape[1:]))
        out = np.empty((3, len(self.touching), columns.shape[1]), parts.dtype)
        _forces(columns, self.ahead, np.zeros_like(self.mu), self._third, out)
        return out.reshape(3, len(self.touching), *parts.shape[1:])

    def pulled(self, vectors: Floats) -> Floats:
        """Return (size, ...) the adjoint of `forces`: a slipping patch's normal force brings its friction along."""
        x, y, normal = vectors
        along, across = self.turned(x, y)
        many = (slice(None),) + (None,) * (x.ndim - 1)
        return np.concatenate([normal + self.mu[many] * along, across, along[self.stuck]])


@njit(cache=True)
def _forces(unknowns: Floats, drag: Floats, mu: Floats, third: Ints, out: Floats) -> None:
    n = len(mu)
    for i in range(n):
        cosine, sine = drag[i, 0], drag[i, 1]
        for c in range(unknowns.shape[1]):
            normal, aside = unknowns[i, c], unknowns[n + i, c]
            ahead = mu[i] * normal
            if third[i] > 0:
                ahead += unknowns[third[i], c]
            out[0, i, c] = cosine * ahead - sine * aside
            out[1, i, c] = sine * ahead + cosine * aside
            out[2, i, c] = normal


@njit(cache=True)
def _seen(vectors: Floats, drag: Floats, third: Ints, out: Floats) -> None:
    n = len(third)
    for i in range(n):
        cosine, sine = drag[i, 0], drag[i, 1]
        for c in range(vectors.shape[2]):
            x, y = vectors[0, i, c], vectors[1, i, c]
            out[i, c] = vectors[2, i, c]
            out[n + i, c] = cosine * y - sine * x
            if third[i] > 0:
                out[third[i], c] = cosine * x + sine * y
