"""Compliance between contact patches: how forces on some move the others.

It comes as a matrix, on any body, or as a convolution and a smooth rest where equal patches lie in a plane
(`twin.world.contact.lattice`). Solvers ask for products and for small parts of it only, and don't know which it is.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from twin.arrays import Floats, Ints
from twin.world.contact.singles import Operator, Singles, SinglesArray, inverse, symmetric_product

_NEW, _SLACK = 0.02, 1.3
"""Shares of the patches in contact: what an inverse doesn't know, and all it knows, before one is made anew."""


class Rough(Protocol):
    """Approximate inverse of the normal compliance."""

    def pushes(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) normal forces on the patches ``rows`` (n,) that move them by about ``depth`` (n,)."""
        ...


class Between(Protocol):
    """Compliance between k patches, in their own frames, mm/N."""

    def __len__(self) -> int: ...

    @property
    def own(self) -> Floats:
        """(k,) how far a unit normal force moves a patch along its own normal."""
        ...

    @property
    def rough(self) -> Rough | None:
        """What makes iteration on normal forces worth while; None where elimination is better."""
        ...

    @property
    def operator(self) -> Operator:
        """What `twin.world.contact.krylov` works with."""
        ...

    def moved(self, force: Floats) -> Floats:
        """Return the (k, 3) displacements of the patches under forces (k, 3), mm."""
        ...

    def sunk(self, push: Floats) -> Floats:
        """Return the (k,) normal displacements under normal forces (k,), mm."""
        ...

    def part(self, rows: Ints) -> Floats:
        """Return the (n, 3, n, 3) compliance between some patches."""
        ...

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """Return the (n, m) normal displacements of some patches under unit normal forces on others."""
        ...


class Inverted:
    """A `Rough` of a matrix (k, k): the inverse, in single precision, of its part on the patches in contact.

    It serves while few patches come that it doesn't know; those are moved by themselves. Why not a factor: its two
    triangles take ten times as long as one product, two dozen of which a solution needs.
    """

    def __init__(self, normal: Floats) -> None:
        self._normal = normal
        self._place: Ints = np.full(len(normal), -1)
        self._inverse: SinglesArray | None = None
        self._count = 0

    def pushes(self, rows: Ints, depth: Floats) -> Floats:
        """See `Rough`; NaN where the matrix is not definite."""
        place = self._place[rows]
        known = place >= 0
        if len(rows) - known.sum() > _NEW * len(rows) or self._count > _SLACK * len(rows):
            self._invert(rows)
            place, known = np.arange(len(rows)), np.ones(len(rows), bool)
        if self._inverse is None:
            return np.full(len(rows), np.nan)
        right: SinglesArray = np.zeros(self._count, np.float32)
        right[place[known]] = depth[known]
        found = symmetric_product(self._inverse, right)
        return np.where(known, found[place], depth / self._normal[rows, rows])

    def _invert(self, rows: Ints) -> None:
        self._inverse = inverse(self._normal[np.ix_(rows, rows)].astype(np.float32).T)
        self._place[:], self._count = -1, len(rows)
        self._place[rows] = np.arange(len(rows))


class Dense:
    """A compliance that is known as a symmetric matrix (k, 3, k, 3)."""

    def __init__(self, matrix: Floats) -> None:
        self._matrix = matrix

    def __len__(self) -> int:
        return len(self._matrix)

    @cached_property
    def own(self) -> Floats:
        """See `Between`."""
        return np.array(np.diagonal(self._matrix[:, 2, :, 2]))

    @cached_property
    def rough(self) -> Rough:
        """See `Between`."""
        return Inverted(self._normal)

    @cached_property
    def operator(self) -> Operator:
        """See `Between`."""
        return Singles(self._matrix)

    @cached_property
    def _normal(self) -> Floats:
        return np.ascontiguousarray(self._matrix[:, 2, :, 2])

    def moved(self, force: Floats) -> Floats:
        """See `Between`."""
        size = 3 * len(self)
        return np.asarray(symmetric_product(self._matrix.reshape(size, size).T, force.reshape(-1))).reshape(-1, 3)

    def sunk(self, push: Floats) -> Floats:
        """See `Between`."""
        return np.asarray(symmetric_product(self._normal.T, push))

    def part(self, rows: Ints) -> Floats:
        """See `Between`."""
        return np.asarray(self._matrix[rows][:, :, rows])

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """See `Between`."""
        return np.asarray(self._normal[np.ix_(rows, columns)])


def between(compliance: Floats | Between) -> Between:
    """Return a compliance that may be given as a matrix."""
    return Dense(compliance) if isinstance(compliance, np.ndarray) else compliance
