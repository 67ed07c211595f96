"""Linear elasticity by Taylor-Hood elements: quadratic displacement, linear pressure, curved tetrahedra.

The unknowns are the displacement u at all nodes and the mean tension p = kappa div u (kappa the bulk modulus) at the
corners; for all virtual v and q

    integral 2 G dev e(u) : e(v) + p div v = integral t . v over the surface,    integral q div u - p q / kappa = 0.

Why this pair: 1/kappa = 3 (1 - 2 nu) / E is zero at nu = 1/2, so incompressible rubber is solved as such, without
locking (P. Hood and C. Taylor 1974); splitting off the bulk modulus instead of Lame's lambda keeps the same form for
every nu in [-1/2, 1/2]. Everything is computed for a body of E = 1 MPa; displacements go with 1/E.

Layers (a cover, a base) have moduli of their own. Tension jumps where moduli do, so pressures are doubled there: one
for each side of the interface. A continuous pressure would smear the jump over an element on either side.

Validity: small strain, isotropic materials, each homogeneous within its region of the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.errors import InputError
from twin.world.elasticity.interfaces import regions_behind
from twin.world.elasticity.solve import GOAL, Factor, Solver
from twin.world.mesh.elements import tet_quadrature, tet_shapes
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.soundness import require_finite, require_solvable


@dataclass(frozen=True, kw_only=True)
class Layer:
    """What a further region of a mesh is made of.

    Attributes
    ----------
    modulus_ratio
        Young's modulus over the body's.
    poisson_ratio
        nu in [-0.5, 0.5].
    """

    modulus_ratio: float
    poisson_ratio: float

    @property
    def shear_ratio(self) -> float:
        """Shear modulus G, MPa, where the body's E is 1 MPa."""
        return 0.5 * self.modulus_ratio / (1.0 + self.poisson_ratio)

    @property
    def softness(self) -> float:
        """1 / kappa, 1/MPa, where the body's E is 1 MPa."""
        return 3.0 * (1.0 - 2.0 * self.poisson_ratio) / self.modulus_ratio


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """The parts of the matrix, as sparse matrices in (node, axis) order; P pressures.

    Attributes
    ----------
    deviatoric
        (3 N, 3 N) integral of 2 G dev e(u) : e(v).
    divergence
        (P, 3 N) integral of q div u.
    mass
        (P, P) integral of p q / kappa.
    """

    deviatoric: Any
    divergence: Any
    mass: Any


class TaylorHood:
    """The elastic system of a mesh, held on its last piece; factored once, at the first solve.

    Parameters
    ----------
    mesh
        Quadratic tetrahedra; ``mesh.piece`` says which faces are held.
    poisson_ratio
        nu in [-0.5, 0.5].
    solver
        See `twin.world.elasticity.solve.Factor`.
    held
        (N,) which nodes are held; those of the mesh's last piece if not given.
    layers
        What the mesh's regions 1, 2, ... are made of; region 0 is the body, of modulus 1.
    """

    def __init__(
        self,
        mesh: Mesh,
        poisson_ratio: float,
        solver: Solver = "auto",
        *,
        held: Bools | None = None,
        layers: Sequence[Layer] = (),
    ) -> None:
        self.mesh = mesh
        self.poisson_ratio = poisson_ratio
        self.made_of = (Layer(modulus_ratio=1.0, poisson_ratio=poisson_ratio), *layers)
        _check(self.made_of, mesh)
        self._solver: Solver = solver
        if held is None:
            held = np.zeros(len(mesh.points), bool)
            held[mesh.faces[mesh.piece == mesh.piece.max()]] = True
        self.held = np.asarray(held, bool)

    @cached_property
    def _matrix(self) -> Any:
        from scipy.sparse import bmat

        blocks = assemble(self.mesh, self._shear, self._softness, self.pressure)
        return bmat(
            [[blocks.deviatoric, blocks.divergence.T], [blocks.divergence, -blocks.mass]],
            format="csr",
        )

    @cached_property
    def _shear(self) -> Floats:
        """(m,) shear modulus G of every element, MPa."""
        return np.array([of.shear_ratio for of in self.made_of])[self.mesh.region]

    @cached_property
    def _softness(self) -> Floats:
        """(m,) 1 / kappa of every element, 1/MPa."""
        return np.array([of.softness for of in self.made_of])[self.mesh.region]

    @cached_property
    def pressure(self) -> Ints:
        """(m, 4) pressure unknowns of every element: one at every corner for each of the materials that meet there."""
        of_region = np.array([self.made_of.index(of) for of in self.made_of])
        place = of_region[self.mesh.region][:, None] * self.mesh.corners + self.mesh.tets[:, :4]
        return np.unique(place, return_inverse=True)[1].reshape(-1, 4)

    @cached_property
    def under_load(self) -> Layer:
        """What the sensing surface is made of."""
        return self.made_of[int(np.max(regions_behind(self.mesh, self.mesh.faces[self.mesh.piece == 0]), initial=0))]

    @property
    def pressures(self) -> int:
        """Number of pressure unknowns."""
        return int(self.pressure.max()) + 1

    @cached_property
    def _free(self) -> Ints:
        held = np.concatenate([np.repeat(self.held, 3), np.zeros(self.pressures, bool)])
        return np.flatnonzero(~held)

    @cached_property
    def factor(self) -> Factor:
        """The factored system of the free unknowns."""
        require_solvable(self.mesh, self.held)
        tenths = np.repeat(_volumes(self.mesh) / 10.0 * 0.5 / self._shear, 4)
        schur = np.bincount(self.pressure.ravel(), tenths)
        scale = np.concatenate([np.zeros(3 * len(self.mesh.points)), schur])
        corner = np.empty(self.pressures, np.int64)
        corner[self.pressure] = self.mesh.tets[:, :4]
        node = np.concatenate([np.repeat(np.arange(len(self.mesh.points)), 3), corner])
        free = self._free
        return Factor(self._matrix[free][:, free], scale[free], self._solver, node=node[free])

    def solve(
        self, force: Floats, held_to: Floats | None = None, goal: float = GOAL, dilation: Floats | None = None
    ) -> Floats:
        """Return the displacement (N, 3, m), mm, for E = 1 MPa.

        Parameters
        ----------
        force
            (N, 3, m) nodal forces, N.
        held_to
            (N, 3, m) displacement to which held nodes are moved (others are ignored); zero if not given.
        goal
            Relative residual at which refinement stops.
        dilation
            (P, m) integrals of q (div u - p / kappa) for every pressure unknown's q, mm3; zero if not given.

        Raises
        ------
        MeshError, SolveError
            See `twin.world.mesh.soundness.require_solvable` and `twin.world.elasticity.solve.Factor.solve`.
        InputError
            A force or a given displacement is not finite.
        """
        return self._solve(force, held_to, goal, dilation)[: 3 * len(self.mesh.points)].reshape(force.shape)

    def _solve(
        self, force: Floats, held_to: Floats | None = None, goal: float = GOAL, dilation: Floats | None = None
    ) -> Floats:
        right, solution = self._right(force, held_to, dilation)
        solution[self._free] = self.factor.solve(right, goal)
        return solution

    def _right(self, force: Floats, held_to: Floats | None, dilation: Floats | None) -> tuple[Floats, Floats]:
        """Return the right-hand side of the free unknowns, and the (n, m) unknowns with the held ones in place."""
        nodes, columns = len(self.mesh.points), force.shape[2]
        require_finite(self.mesh, force, "force", "N")
        right = np.zeros((3 * nodes + self.pressures, columns))
        right[: 3 * nodes] = force.reshape(3 * nodes, columns)
        if dilation is not None:
            right[3 * nodes :] = dilation
        solution = np.zeros_like(right)
        if held_to is not None:
            require_finite(self.mesh, held_to, "given displacement", "mm")
            solution[: 3 * nodes] = np.where(self.held[:, None, None], held_to, 0.0).reshape(3 * nodes, columns)
            right -= self._matrix @ solution
        return right[self._free], solution

    def influence(self, reading: Any, goal: float = GOAL) -> Floats:
        """Return (n, 3 r): what a unit right-hand side in every free unknown adds to r readings of the displacement.

        One solve a reading and axis; the matrix is symmetric, so these adjoint solves use the same factor.

        Parameters
        ----------
        reading
            (r, N) sparse matrix from a nodal field to the readings.
        goal
            Relative residual at which refinement stops.
        """
        from scipy.sparse import hstack, kron

        wide = hstack([kron(reading, np.eye(3)), np.zeros((3 * reading.shape[0], self.pressures))]).tocsr()
        return self.factor.solve(wide[:, self._free].T.toarray(), goal)

    def read(
        self, influence: Floats, reading: Any, force: Floats, held_to: Floats | None, dilation: Floats | None = None
    ) -> Floats:
        """Return the (r, 3, m) readings of the solution by products alone; arguments as in `solve` and `influence`."""
        right, solution = self._right(force, held_to, dilation)
        held = solution[: 3 * len(self.mesh.points)].reshape(len(self.mesh.points), -1)
        columns = force.shape[2]
        return np.asarray(influence.T @ right + (reading @ held).reshape(-1, columns)).reshape(-1, 3, columns)

    def reaction(self, force: Floats) -> Floats:
        """Return the holder's (3, m) total force on the body under nodal forces (N, 3, m): minus the load."""
        nodes = len(self.mesh.points)
        out = (self._matrix @ self._solve(force))[: 3 * nodes].reshape(force.shape) - force
        return np.asarray(out[self.held].sum(axis=0))


def _check(made_of: Sequence[Layer], mesh: Mesh) -> None:
    for region, of in enumerate(made_of):
        where = "" if region == 0 else f" of region {region}"
        if not -0.5 <= of.poisson_ratio <= 0.5:
            raise InputError(f"poisson_ratio = {of.poisson_ratio}{where}: allowed is -0.5 to 0.5")
        if not 0.0 < of.modulus_ratio < np.inf:
            raise InputError(f"modulus_ratio = {of.modulus_ratio}{where}: must be finite and above 0")
    if mesh.region.max() >= len(made_of):
        raise InputError(
            f"the mesh has regions 0 to {mesh.region.max()}, but materials are given for {len(made_of)} only: say what "
            "every layer is made of"
        )


def assemble(mesh: Mesh, shear: Floats, softness: Floats, pressure: Ints) -> Blocks:
    """Integrate the matrix's parts over the curved elements (degree 5 in the reference element).

    Parameters
    ----------
    mesh
        The mesh.
    shear, softness
        (m,) G in MPa and 1/kappa in 1/MPa of every element.
    pressure
        (m, 4) numbers of every element's pressure unknowns.
    """
    from scipy.sparse import bsr_matrix

    nodes, tets, pressures = len(mesh.points), mesh.tets, int(pressure.max()) + 1
    uu = _pattern(tets, tets, (nodes, nodes))
    pu = _pattern(pressure, tets, (pressures, nodes))
    pp = _pattern(pressure, pressure, (pressures, pressures))
    places, weights = tet_quadrature()
    slopes = tet_shapes(places)[1]
    shares = np.column_stack([1.0 - places.sum(axis=1), places])
    k, b, m = np.zeros((len(uu[1]), 3, 3)), np.zeros((len(pu[1]), 1, 3)), np.zeros((len(pp[1]), 1, 1))
    _integrate(mesh.points, tets, pressure, shear, softness, slopes, shares, weights, *uu, k, *pu, b, *pp, m)
    return Blocks(
        deviatoric=bsr_matrix((k, uu[1], uu[0]), shape=(3 * nodes, 3 * nodes)).tocsr(),
        divergence=bsr_matrix((b, pu[1], pu[0]), shape=(pressures, 3 * nodes)).tocsr(),
        mass=bsr_matrix((m, pp[1], pp[0]), shape=(pressures, pressures)).tocsr(),
    )


def _volumes(mesh: Mesh) -> Floats:
    """Return (m,) volumes of the elements, taken as flat, mm3; a tenth of it is a pressure mass's diagonal."""
    a, b, c, d = (mesh.points[mesh.tets[:, i]] for i in range(4))
    return np.asarray(np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))) / 6.0)


def _pattern(rows: Ints, columns: Ints, shape: tuple[int, int]) -> tuple[Ints, Ints]:
    """Return indptr and sorted indices of the sparse pattern in which every row node meets every column node."""
    from scipy.sparse import coo_matrix

    i = np.repeat(rows, columns.shape[1], axis=1).ravel()
    j = np.tile(columns, (1, rows.shape[1])).ravel()
    pattern = coo_matrix((np.ones(len(i), np.int8), (i, j)), shape=shape).tocsr()
    pattern.sort_indices()
    return pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)


@njit(cache=True)
def _find(indptr: Ints, indices: Ints, row: int, column: int) -> int:
    low, high = indptr[row], indptr[row + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if indices[middle] <= column:
            low = middle
        else:
            high = middle
    return int(low)


@njit(cache=True)
def _integrate(
    points: Floats,
    tets: Ints,
    pressure: Ints,
    shear: Floats,
    softness: Floats,
    slopes: Floats,
    shares: Floats,
    weights: Floats,
    uu_ptr: Ints,
    uu_ind: Ints,
    k: Floats,
    pu_ptr: Ints,
    pu_ind: Ints,
    b: Floats,
    pp_ptr: Ints,
    pp_ind: Ints,
    m: Floats,
) -> None:
    """Add every element's k (., 3, 3), b (., 1, 3) and m (., 1, 1) into the blocks of the three patterns."""
    jac, inv, g = np.empty((3, 3)), np.empty((3, 3)), np.empty((10, 3))
    ke, be, me = np.empty((10, 10, 3, 3)), np.empty((4, 10, 3)), np.empty((4, 4))
    for t in range(len(tets)):
        ke[:] = 0.0
        be[:] = 0.0
        me[:] = 0.0
        for q in range(len(weights)):
            jac[:] = 0.0
            for a in range(10):
                for i in range(3):
                    for j in range(3):
                        jac[i, j] += points[tets[t, a], i] * slopes[q, a, j]
            volume = _invert(jac, inv) * weights[q]
            stiff = volume * shear[t]
            for a in range(10):
                for i in range(3):
                    g[a, i] = slopes[q, a, 0] * inv[0, i] + slopes[q, a, 1] * inv[1, i] + slopes[q, a, 2] * inv[2, i]
            for a in range(10):
                for c in range(10):
                    dot = g[a, 0] * g[c, 0] + g[a, 1] * g[c, 1] + g[a, 2] * g[c, 2]
                    for i in range(3):
                        ke[a, c, i, i] += stiff * dot
                        for j in range(3):
                            ke[a, c, i, j] += stiff * (g[a, j] * g[c, i] - 2.0 / 3.0 * g[a, i] * g[c, j])
            for p in range(4):
                for a in range(10):
                    for i in range(3):
                        be[p, a, i] += volume * shares[q, p] * g[a, i]
                for s in range(4):
                    me[p, s] += volume * softness[t] * shares[q, p] * shares[q, s]
        for a in range(10):
            for c in range(10):
                k[_find(uu_ptr, uu_ind, tets[t, a], tets[t, c])] += ke[a, c]
        for p in range(4):
            for a in range(10):
                b[_find(pu_ptr, pu_ind, pressure[t, p], tets[t, a]), 0] += be[p, a]
            for s in range(4):
                m[_find(pp_ptr, pp_ind, pressure[t, p], pressure[t, s]), 0, 0] += me[p, s]


@njit(cache=True)
def _invert(jac: Floats, inv: Floats) -> float:
    """Set ``inv`` to the inverse of the 3 x 3 matrix ``jac`` and return the determinant."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            d, e = (c + 1) % 3, (c + 2) % 3
            inv[c, i] = jac[j, d] * jac[k, e] - jac[j, e] * jac[k, d]
    determinant = jac[0, 0] * inv[0, 0] + jac[0, 1] * inv[1, 0] + jac[0, 2] * inv[2, 0]
    inv /= determinant
    return float(determinant)
