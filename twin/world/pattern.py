"""Which patches touch, which of those slip, and the few unknowns that each is left with.

A slipping patch has two unknowns, not three: along its drag d the force is mu f_n, so that only f_n and the force
across d, which turns d, are left. A sticking one has three. Unknowns of n patches in contact, of which s stick, are
ordered (normal forces, n; forces aside, n; forces ahead, s), and so are the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Ints


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

    def forces(self, unknowns: Floats) -> Floats:
        """Return (3, n, ...) forces in the patches' frames that (size, ...) unknowns stand for."""
        n, many = len(self.touching), (slice(None),) + (None,) * (unknowns.ndim - 1)
        normal, aside = unknowns[:n], unknowns[self.aside]
        ahead = self.mu[many].astype(unknowns.dtype) * normal
        ahead[self.stuck] += unknowns[2 * n :]
        cosine, sine = self.ahead.T.astype(unknowns.dtype)
        cosine, sine = cosine[many], sine[many]
        return np.stack([cosine * ahead - sine * aside, sine * ahead + cosine * aside, normal])

    def seen(self, vectors: Floats) -> Floats:
        """Return (size, ...) parts of (3, n, ...) vectors: normal, across the drag, and along it where it sticks."""
        x, y, normal = vectors
        cosine, sine = self.ahead.T.astype(vectors.dtype)
        many = (slice(None),) + (None,) * (x.ndim - 1)
        cosine, sine = cosine[many], sine[many]
        return np.concatenate([normal, cosine * y - sine * x, (cosine * x + sine * y)[self.stuck]])

    def pulled(self, vectors: Floats) -> Floats:
        """Return (size, ...) the adjoint of `forces`: a slipping patch's normal force brings its friction along."""
        x, y, normal = vectors
        along, across = self.turned(x, y)
        many = (slice(None),) + (None,) * (x.ndim - 1)
        return np.concatenate([normal + self.mu[many] * along, across, along[self.stuck]])
