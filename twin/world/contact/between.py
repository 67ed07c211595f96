"""Compliance between contact patches: how forces on some move the others.

It comes as a matrix, on any body, or as a convolution and a smooth rest where equal patches lie in a plane
(`twin.world.contact.lattice`). Solvers ask for products and for small parts of it only, and don't know which it is.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from twin.arrays import Floats, Ints
from twin.world.contact.singles import Operator, Singles


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


class Dense:
    """A compliance that is known as a matrix (k, 3, k, 3)."""

    rough = None

    def __init__(self, matrix: Floats) -> None:
        self._matrix = matrix

    def __len__(self) -> int:
        return len(self._matrix)

    @cached_property
    def own(self) -> Floats:
        """See `Between`."""
        return np.array(np.diagonal(self._matrix[:, 2, :, 2]))

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
        return np.asarray(self._matrix.reshape(size, size) @ force.reshape(-1)).reshape(-1, 3)

    def sunk(self, push: Floats) -> Floats:
        """See `Between`."""
        return np.asarray(self._normal @ push)

    def part(self, rows: Ints) -> Floats:
        """See `Between`."""
        return np.asarray(self._matrix[rows][:, :, rows])

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """See `Between`."""
        return np.asarray(self._normal[np.ix_(rows, columns)])


def between(compliance: Floats | Between) -> Between:
    """Return a compliance that may be given as a matrix."""
    return Dense(compliance) if isinstance(compliance, np.ndarray) else compliance
