"""Linear elasticity by Taylor-Hood elements: quadratic displacement, linear pressure, curved
tetrahedra.

The unknowns are the displacement u at all nodes and the mean tension p = kappa div u (kappa the
bulk modulus) at the corners; for all virtual v and q

    integral 2 G dev e(u) : e(v) + p div v = integral t . v over the surface,
    integral q div u - p q / kappa = 0.

1/kappa = 3 (1 - 2 nu) / E is zero at nu = 1/2, so incompressible rubber is solved as such, without
locking (P. Hood and C. Taylor 1974), and the form is the same for every nu in [-1/2, 1/2].
Everything is computed for a body of E = 1 MPa; displacements go with 1/E. Layers (a cover, a base)
have moduli of their own. Tension jumps where moduli do, so pressures are doubled there.

A sparse solver does not notice an unsolvable system: a body that is held nowhere has been "solved"
to 1e14 mm with a small residual, and an element turned inside out gives a plausible field. So both
are looked for first. Parts joined at a single node or edge count as one part: where they can turn
about it, the solver finds their imbalance.

Validity: small strain, isotropic materials, each homogeneous within its region of the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, coordinates
from twin.errors import InputError, MeshError, SolveError
from twin.parts.material import Cover, Material, shear_modulus
from twin.world.elasticity.factor import GOAL, Factor
from twin.world.mesh.quadratic_mesh import Mesh, inverses, quadrature, shapes, signed_volumes

STRAIGHT = 1e-6
"""Held nodes of a part count as lying on one line when they leave it by less than this share of
their extent."""

_CHUNK = 1000
"""Elements that are integrated at once."""


class TaylorHood:
    """The elastic system of a mesh, held on its last piece; factored once, at the first solve.

    Parameters
    ----------
    mesh
        Quadratic tetrahedra; ``mesh.piece`` defines which faces are held.
    poisson_ratio
        nu in [-0.5, 0.5].
    held
        (N,) which nodes are held; those of the mesh's last piece if not given.
    layers
        What the mesh's regions 1, 2, ... are made of; region 0 is the body, of modulus 1.
    """

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

        @classmethod
        def of_cover(cls, material: Material, cover: Cover | None) -> TaylorHood.Layer | None:
            """Return what a cover is made of, None where it is made of the body's ``material``."""
            if cover is None:
                return None
            modulus, nu = material.youngs_modulus_mpa, material.poisson_ratio
            own = modulus if cover.youngs_modulus_mpa is None else cover.youngs_modulus_mpa
            own_nu = nu if cover.poisson_ratio is None else cover.poisson_ratio
            same = own == modulus and own_nu == nu
            return None if same else cls(modulus_ratio=own / modulus, poisson_ratio=own_nu)

        @property
        def shear_ratio(self) -> float:
            """Shear modulus G, MPa, where the body's E is 1 MPa."""
            return shear_modulus(self.modulus_ratio, self.poisson_ratio)

        @property
        def softness(self) -> float:
            """1 / bulk modulus, 1/MPa, where the body's E is 1 MPa."""
            return 3.0 * (1.0 - 2.0 * self.poisson_ratio) / self.modulus_ratio

    def __init__(
        self,
        mesh: Mesh,
        poisson_ratio: float,
        *,
        held: Bools | None = None,
        layers: Sequence[TaylorHood.Layer] = (),
    ) -> None:
        self.mesh = mesh
        self.poisson_ratio = poisson_ratio
        self.made_of = (TaylorHood.Layer(modulus_ratio=1.0, poisson_ratio=poisson_ratio), *layers)
        _check(self.made_of, mesh)
        if held is None:
            held = np.zeros(len(mesh.points), bool)
            held[mesh.faces[mesh.piece == mesh.piece.max()]] = True
        self.held = np.asarray(held, bool)

    @cached_property
    def _matrix(self) -> Any:
        """The sparse matrix [[A, D^T], [D, -M]]: A (3 N, 3 N) integrates 2 G dev e(u) : e(v), D (P,
        3 N) q div u, and M (P, P) p q / kappa, over the curved elements (degree 5 in the reference
        element)."""
        from scipy.sparse import bmat

        mesh, pressure = self.mesh, self.pressure
        parts = [
            _element_matrices(mesh.points[mesh.tets[some]], self._shear[some], self._softness[some])
            for some in (slice(s, s + _CHUNK) for s in range(0, len(mesh.tets), _CHUNK))
        ]
        stiffness, divergence, mass = (np.concatenate(each) for each in zip(*parts, strict=True))
        nodes, pressures = len(mesh.points), self.pressures
        deviatoric = _summed(stiffness, mesh.tets, mesh.tets, (nodes, nodes))
        expansion = _summed(divergence, pressure, mesh.tets, (pressures, nodes))
        softness = _summed(mass, pressure, pressure, (pressures, pressures))
        return bmat([[deviatoric, expansion.T], [expansion, -softness]], format="csr")

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
        """(m, 4) pressure unknowns of every element: one at every corner for each of the materials
        that meet there."""
        of_region = np.array([self.made_of.index(of) for of in self.made_of])
        place = of_region[self.mesh.region][:, None] * self.mesh.corners + self.mesh.tets[:, :4]
        return np.unique(place, return_inverse=True)[1].reshape(-1, 4)

    @cached_property
    def under_load(self) -> Layer:
        """What the sensing surface is made of."""
        pressed = self.mesh.faces[self.mesh.piece == 0]
        return self.made_of[int(np.max(self.mesh.regions_behind(pressed), initial=0))]

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
        _require_solvable(self.mesh, self.held)
        tenths = np.repeat(
            np.abs(signed_volumes(self.mesh.points, self.mesh.tets)) / 10.0 * 0.5 / self._shear, 4
        )
        schur = np.bincount(self.pressure.ravel(), tenths)
        scale = np.concatenate([np.zeros(3 * len(self.mesh.points)), schur])
        corner = np.empty(self.pressures, np.int64)
        corner[self.pressure] = self.mesh.tets[:, :4]
        node = np.concatenate([np.repeat(np.arange(len(self.mesh.points)), 3), corner])
        free = self._free
        return Factor(self._matrix[free][:, free], scale[free], node=node[free])

    def solve(
        self,
        force: Floats,
        held_to: Floats | None = None,
        goal: float = GOAL,
        dilation: Floats | None = None,
    ) -> Floats:
        """Return the displacement (N, 3, m), mm, for E = 1 MPa.

        Parameters
        ----------
        force
            (N, 3, m) nodal forces, N.
        held_to
            (N, 3, m) displacement to which held nodes are moved (others are ignored); zero if not
            given.
        goal
            Relative residual at which refinement stops.
        dilation
            (P, m) integrals of q (div u - p / kappa) for every pressure unknown's q, mm3; zero if
            not given.

        Raises
        ------
        MeshError, SolveError
            See `twin.world.elasticity.factor.Factor.solve`.
        InputError
            A force or a given displacement is not finite.
        """
        right, solution = self._right(force, held_to, dilation)
        solution[self._free] = self.factor.solve(right, goal)
        return solution[: 3 * len(self.mesh.points)].reshape(force.shape)

    def _right(
        self, force: Floats, held_to: Floats | None, dilation: Floats | None
    ) -> tuple[Floats, Floats]:
        """Return the right-hand side of the free unknowns, and the (n, m) unknowns with the held
        ones in place."""
        nodes, columns = len(self.mesh.points), force.shape[2]
        _require_finite(self.mesh, force, "force", "N")
        right = np.zeros((3 * nodes + self.pressures, columns))
        right[: 3 * nodes] = force.reshape(3 * nodes, columns)
        if dilation is not None:
            right[3 * nodes :] = dilation
        solution = np.zeros_like(right)
        if held_to is not None:
            _require_finite(self.mesh, held_to, "given displacement", "mm")
            solution[: 3 * nodes] = np.where(self.held[:, None, None], held_to, 0.0).reshape(
                3 * nodes, columns
            )
            right -= self._matrix @ solution
        return right[self._free], solution

    def influence(self, reading: Any, goal: float = GOAL) -> Floats:
        """Return (n, 3 r): what a unit right-hand side in every free unknown adds to r readings of
        the displacement; ``reading`` is the (r, N) sparse matrix from a nodal field to them.

        One solve a reading and axis; the matrix is symmetric, so these adjoint solves use the same
        factor.
        """
        from scipy.sparse import hstack, kron

        wide = hstack(
            [kron(reading, np.eye(3)), np.zeros((3 * reading.shape[0], self.pressures))]
        ).tocsr()
        return self.factor.solve(wide[:, self._free].T.toarray(), goal)

    def read(
        self,
        influence: Floats,
        reading: Any,
        force: Floats,
        held_to: Floats | None,
        dilation: Floats | None = None,
    ) -> Floats:
        """Return the (r, 3, m) readings of the solution by products alone; arguments as in `solve`
        and `influence`."""
        right, solution = self._right(force, held_to, dilation)
        held = solution[: 3 * len(self.mesh.points)].reshape(len(self.mesh.points), -1)
        columns = force.shape[2]
        return np.asarray(influence.T @ right + (reading @ held).reshape(-1, columns)).reshape(
            -1, 3, columns
        )


def _require_solvable(mesh: Mesh, held: Bools) -> None:
    """Raise a `MeshError` where a node is not finite or belongs to no element, or an element is
    flat or turned inside out; a `SolveError` where the body, or a part of it, is held nowhere by
    its nodes ``held`` (N,), or so that it can still turn."""
    _require_nodes(mesh)
    _require_volumes(mesh)
    _require_held(mesh, held)


def _require_finite(mesh: Mesh, values: Floats, what: str, unit: str) -> None:
    """Raise an `InputError` that names the first node where nodal ``values`` (N, 3, m) are not
    finite."""
    if np.isfinite(values).all():
        return
    wrong = ~np.isfinite(values).all(axis=(1, 2))
    first = int(np.argmax(wrong))
    column = int(np.argmin(np.isfinite(values[first]).all(axis=0)))
    raise InputError(
        f"the {what} at node {first}, at ({coordinates(mesh.points[first])}) mm, is "
        f"{values[first, :, column]} {unit} in load case {column} ({wrong.sum()} nodes have one "
        "that is not finite): check the load"
    )


def _require_nodes(mesh: Mesh) -> None:
    wrong = ~np.isfinite(mesh.points).all(axis=1)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise MeshError(
            f"node {first} of the mesh is at {mesh.points[first]} mm ({wrong.sum()} nodes are not "
            "finite): make the mesh again"
        )
    used = np.zeros(len(mesh.points), bool)
    used[mesh.tets] = True
    if not used.all():
        first = int(np.argmin(used))
        raise MeshError(
            f"node {first} of the mesh, at ({coordinates(mesh.points[first])}) mm, belongs to no "
            f"element ({(~used).sum()} of {len(used)} nodes are like that): leave such nodes out"
        )


def _require_volumes(mesh: Mesh) -> None:
    least = np.min(list(mesh.determinants(quadrature(3)[0])), axis=0)
    wrong = ~(least > 0.0)
    if wrong.any():
        worst = int(np.argmin(least))
        middle = mesh.points[mesh.tets[worst, :4]].mean(axis=0)
        raise MeshError(
            f"element {worst} of the mesh, near ({coordinates(middle)}) mm, is flat or turned "
            f"inside out: the determinant of its map goes down to {least[worst]:.3g} mm3, allowed "
            f"is above 0 ({wrong.sum()} of {len(least)} elements are): mend the mesh or make it "
            "again"
        )


def _require_held(mesh: Mesh, held: Bools) -> None:
    part = _parts(mesh)
    parts = int(part.max()) + 1
    for number in range(parts):
        own = part == number
        points = mesh.points[own & held]
        if _pins(points):
            continue
        where = coordinates(mesh.points[own].mean(axis=0))
        what = "the body" if parts == 1 else f"part {number} of the mesh, near ({where}) mm,"
        line = f"is held by {len(points)} nodes on one line only, and can turn"
        how = "is held nowhere" if len(points) == 0 else line
        raise SolveError(
            f"{what} {how}, so no load on it has an equilibrium: hold at least one face of every "
            f"part, or join the {'parts' if parts > 1 else 'body to something'}"
        )


def _parts(mesh: Mesh) -> Ints:
    """Return (N,) which connected part of the mesh every node belongs to."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    size = mesh.tets.shape[1]
    first, other = np.repeat(mesh.tets[:, 0], size - 1), mesh.tets[:, 1:].ravel()
    graph = csr_matrix(
        (np.ones(len(first), np.int8), (first, other)), shape=(len(mesh.points),) * 2
    )
    return np.asarray(connected_components(graph, directed=False)[1])


def _pins(points: Floats) -> bool:
    """Tell whether holding these points (n, 3) stops every motion: three of them are not on one
    line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > STRAIGHT * spread[0])


def _check(made_of: Sequence[TaylorHood.Layer], mesh: Mesh) -> None:
    for region, of in enumerate(made_of):
        where = "" if region == 0 else f" of region {region}"
        if not -0.5 <= of.poisson_ratio <= 0.5:
            raise InputError(f"poisson_ratio = {of.poisson_ratio}{where}: allowed is -0.5 to 0.5")
        if not 0.0 < of.modulus_ratio < np.inf:
            raise InputError(
                f"modulus_ratio = {of.modulus_ratio}{where}: must be finite and above 0"
            )
    if mesh.region.max() >= len(made_of):
        raise InputError(
            f"the mesh has regions 0 to {mesh.region.max()}, but materials are given for "
            f"{len(made_of)} only: say what every layer is made of"
        )


def _element_matrices(
    nodes: Floats, shear: Floats, softness: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the parts of the matrix of elements with ``nodes`` (m, 10, 3): (m, 10, 10, 3, 3), (m,
    4, 10, 1, 3) and (m, 4, 4, 1, 1)."""
    places, weights = quadrature(3)
    slopes = shapes(places)[1]
    shares = np.column_stack([1.0 - places.sum(axis=1), places])
    jacobian = np.einsum("mai,qaj->mqij", nodes, slopes, optimize=True)
    inverse, determinant = inverses(jacobian)
    volume = determinant * weights
    gradient = (slopes @ inverse).reshape(*volume.shape, 30)
    weighted = volume[:, :, None] * gradient
    # products of two gradients: (m, node a, axis i, node c, axis j)
    pairs = (gradient.swapaxes(1, 2) @ weighted).reshape(-1, 10, 3, 10, 3)
    pairs *= shear[:, None, None, None, None]
    stiffness = pairs.transpose(0, 1, 3, 4, 2) - 2.0 / 3.0 * pairs.transpose(0, 1, 3, 2, 4)
    trace = np.einsum("maici->mac", pairs)
    for axis in range(3):
        stiffness[..., axis, axis] += trace
    divergence = (shares.T @ weighted).reshape(-1, 4, 10, 1, 3)
    mass = np.einsum("mq,qp,qs->mps", volume * softness[:, None], shares, shares, optimize=True)
    return stiffness, divergence, mass[..., None, None]


def _summed(blocks: Floats, rows: Ints, columns: Ints, shape: tuple[int, int]) -> Any:
    """Return the sparse sum of element blocks (m, r, c, i, j) at rows (m, r) and columns (m, c)."""
    from scipy.sparse import bsr_matrix

    key = (rows[:, :, None] * shape[1] + columns[:, None, :]).ravel()
    places, entry = np.unique(key, return_inverse=True)
    size = blocks.shape[3:]
    flat = blocks.reshape(len(key), -1)
    data = np.stack([np.bincount(entry.ravel(), each) for each in flat.T], axis=1)
    row, column = np.divmod(places, shape[1])
    ends = np.searchsorted(row, np.arange(shape[0] + 1))
    whole = (shape[0] * size[0], shape[1] * size[1])
    return bsr_matrix((data.reshape(-1, *size), column, ends), shape=whole).tocsr()
