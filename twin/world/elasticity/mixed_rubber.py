"""What rubber at finite strain has in common on every mesh: displacements of nodes and pressures of
corners as unknowns, sums over elements, a solution, and Newton's steps.

`twin.world.contact.round_slab` and `twin.world.contact.whole_body` are the two meshes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from twin.arrays import Floats, Ints
from twin.parts.material import Material, shear_modulus
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.strain_law import strain_law

State = TypeVar("State")


class MixedRubber:
    """Rubber of E = 1 MPa, held at some nodes.

    Its unknowns are the displacements of every node, mm, then the pressures of the corners, MPa. A
    mesh gives ``_axes`` (displacements of a node), ``_residual`` (relative, of `solve`), ``_moves``
    (the number of displacements), ``_free``, ``_scale`` and ``_node`` (the unknowns that are not
    held, and `Factor`'s arguments for all), and `tangent`.
    """

    _axes: int
    _residual: float
    _moves: int
    _free: Ints
    _scale: Floats
    _node: Ints
    size: int

    def __init__(self, material: Material) -> None:
        nu = material.poisson_ratio
        self._law = strain_law(material)
        self._shear = shear_modulus(1.0, nu)
        self._softness = (1.0 - 2.0 * nu) / (2.0 * self._shear * nu)

    def displacement(self, unknowns: Floats) -> Floats:
        """Return the displacement (N, axes) of the nodes, mm."""
        return unknowns[: self._moves].reshape(-1, self._axes)

    def tangent(self, unknowns: Floats) -> Any:
        """Return the sparse symmetric slope of the rubber's resistance."""
        raise NotImplementedError

    @cached_property
    def at_rest(self) -> Any:
        """The tangent of linear theory."""
        return self.tangent(np.zeros(self.size))

    def solve(self, matrix: Any, right: Floats) -> Floats:
        """Return the solution (n, m) of a tangent for ``right`` (n, m); 0 where it is held."""
        out = np.zeros_like(right)
        free = self._free
        factor = Factor(matrix[free][:, free], self._scale[free], node=self._node[free])
        out[free] = factor.solve(right[free], self._residual)
        return out


def gathered(rows: Ints, parts: Floats, size: int) -> Floats:
    """Return the (size,) sum of parts at ``rows``, of as many numbers."""
    return np.bincount(rows.ravel(), parts.ravel(), size).astype(float)


def summed(blocks: Floats, rows: Ints, size: int) -> Any:
    """Return the sparse (size, size) sum of blocks (m, r, r) at rows (m, r)."""
    from scipy.sparse import csr_matrix

    wide = rows.shape[1]
    i = np.repeat(rows, wide, axis=1).ravel()
    j = np.tile(rows, (1, wide)).ravel()
    return csr_matrix((blocks.ravel(), (i, j)), shape=(size, size))


def largest(vectors: Floats) -> float:
    """Return the length of the longest of vectors (n, axes)."""
    return float(np.linalg.norm(vectors, axis=1).max())


def newton(
    after: Callable[[State], State],
    displacement: Callable[[State], Floats],
    state: State,
    steps: int,
    tolerance: float,
) -> tuple[State, bool]:
    """Take Newton's steps until one moves nothing.

    Returns
    -------
    The last state, and whether its step moved no node by more than ``tolerance`` of the largest
    displacement.
    """
    step = math.inf
    for _ in range(steps):
        before = displacement(state)
        state = after(state)
        moved = displacement(state)
        step = largest(moved - before) / largest(moved)
        if step < tolerance or not math.isfinite(step):
            break
    return state, step < tolerance
