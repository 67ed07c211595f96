"""Compliance between contact patches: how forces on some move the others.

It comes as a matrix, on any body, or as a convolution and a smooth rest where equal patches lie in a plane
(`twin.world.contact.lattice`). Solvers ask for products and for small parts of it only, and don't know which it is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.world.contact.iterated import MANY, Iterated, NearLattice
from twin.world.contact.linear import LinearSolver
from twin.world.contact.released import Released
from twin.world.contact.singles import SinglesArray, full_inverse, symmetric_product

_NEW, _SLACK = 0.1, 1.3
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

    def solver(self, carried: Floats) -> LinearSolver:
        """Return what solves Newton's systems under probes that carry the patches so, (k, 3, m) per unit motion."""
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
    """A `Rough` of a matrix (k, k): the inverse, in single precision, of its part on patches that were in contact.

    What pushes on patches that left since are taken back, and those on patches that came are added, by blocks (Schur's
    complements): so an inverse serves the sets in contact that follow, one of which differs little from the next, as
    well as one made for each. Why not factors: those of other sets are others.
    """

    def __init__(self, normal: Floats) -> None:
        self._normal = normal
        self._place: Ints = np.full(len(normal), -1)
        self._inverse: SinglesArray | None = None
        self._kept = self._rows = np.zeros(0, int)

    def pushes(self, rows: Ints, depth: Floats) -> Floats:
        """See `Rough`; NaN where the matrix is not definite."""
        if not np.array_equal(rows, self._rows):
            self._take_over(rows)
        if self._inverse is None:
            return np.full(len(rows), np.nan)
        right: SinglesArray = np.zeros(len(self._kept), np.float32)
        right[self._at] = depth[self._old]
        found = self._on_old(right)
        pushes = np.empty(len(rows))
        if len(self._new):
            added = self._schur @ (depth[self._new] - self._coupling @ found)
            found -= self._answer @ added
            pushes[self._new] = added
        pushes[self._old] = found[self._at]
        return pushes

    def _on_old(self, right: SinglesArray) -> SinglesArray:
        """Return the pushes (kept, ...) under depths (kept, ...) on patches kept, none on those that left."""
        assert self._inverse is not None
        found = symmetric_product(self._inverse.T, right)
        return found - self._of_gone.T @ (self._back @ found[self._gone]) if len(self._gone) else found

    def _take_over(self, rows: Ints) -> None:
        """Make ready for a set in contact."""
        new = self._place[rows] < 0
        if new.sum() > _NEW * len(rows) or len(self._kept) > _SLACK * len(rows):
            self._inverse = full_inverse(self._normal[np.ix_(rows, rows)].astype(np.float32))
            self._place[:], self._kept = -1, rows.copy()
            self._place[rows] = np.arange(len(rows))
            new[:] = False
        self._rows, self._new, self._old = rows.copy(), np.flatnonzero(new), np.flatnonzero(~new)
        self._at = self._place[rows[self._old]]
        if self._inverse is None:
            return
        self._gone = np.setdiff1d(np.arange(len(self._kept)), self._at, assume_unique=True)
        if len(self._gone):
            self._of_gone = self._inverse[self._gone]
            self._back = np.linalg.inv(self._of_gone[:, self._gone])
        if len(self._new):
            came = rows[self._new]
            coupling = self._normal[np.ix_(came, self._kept)].astype(np.float32)
            coupling[:, self._gone] = 0.0
            self._coupling, self._answer = coupling, self._on_old(np.asfortranarray(coupling.T))
            self._schur = np.linalg.inv(self._normal[np.ix_(came, came)] - coupling @ self._answer).astype(np.float32)


class Dense:
    """A compliance that is known as a symmetric matrix.

    Parameters
    ----------
    matrix
        (k, 3, k, 3) mm/N.
    near
        Returns a rough inverse of it, which costs little, where there is one.
    """

    def __init__(self, matrix: Floats, near: Callable[[], NearLattice | None] = lambda: None) -> None:
        self._matrix, self._near = matrix, near

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

    def solver(self, carried: Floats) -> LinearSolver:
        """See `Between`."""
        near = self._near() if len(self) > MANY else None
        return Released(self._matrix, carried) if near is None else Iterated(self._matrix, carried, near)

    @cached_property
    def _normal(self) -> Floats:
        return np.ascontiguousarray(self._matrix[:, 2, :, 2])

    def moved(self, force: Floats) -> Floats:
        """See `Between`."""
        size = 3 * len(self)
        matrix, flat = self._matrix.reshape(size, size), force.reshape(-1)
        pushed = np.flatnonzero(flat)
        if 2 * len(pushed) > size:  # a symmetric product reads one half
            return np.asarray(symmetric_product(matrix.T, flat)).reshape(-1, 3)
        moved = np.zeros(size)
        _add_rows(matrix, pushed, flat, moved)
        return moved.reshape(-1, 3)

    def sunk(self, push: Floats) -> Floats:
        """See `Between`."""
        return np.asarray(symmetric_product(self._normal.T, push))

    def part(self, rows: Ints) -> Floats:
        """See `Between`."""
        size = 3 * len(self)
        flat = (3 * rows[:, None] + np.arange(3)).reshape(-1)
        part = self._matrix.reshape(size, size)[np.ix_(flat, flat)]
        return np.asarray(part.reshape(len(rows), 3, len(rows), 3))

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """See `Between`."""
        return np.asarray(self._normal[np.ix_(rows, columns)])


@njit(cache=True, fastmath=True)
def _add_rows(matrix: Floats, rows: Ints, weights: Floats, out: Floats) -> None:
    """Add some rows of a matrix to ``out``, each times its weight; others are not read."""
    for row in rows:
        for i in range(len(out)):
            out[i] += weights[row] * matrix[row, i]


def between(compliance: Floats | Between) -> Between:
    """Return a compliance that may be given as a matrix."""
    return Dense(compliance) if isinstance(compliance, np.ndarray) else compliance
