"""Quality of a mesh, the gates that every mesh passes before it is used, and whether an elastic
system on it can be solved.

A sparse solver does not notice an unsolvable system: a body that is held nowhere has been "solved"
to 1e14 mm with a small relative residual, and an element turned inside out gives a plausible field.
So both are looked for first, which costs a few milliseconds. Parts joined at a single node or along
one edge count as one part, although they can turn about it: the solver finds those by their
imbalance.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, coordinates
from twin.errors import InputError, MeshError, SolveError
from twin.parts.body import Body
from twin.world.mesh.elements import (
    TET_EDGES,
    TET_FACES,
    boundary_triangles,
    quadrature,
    shapes,
    signed_volumes,
)
from twin.world.mesh.quadratic_mesh import Mesh

LEAST_DIHEDRAL_DEG = 5.0
LEAST_SCALED_JACOBIAN = 0.05
LEAST_JACOBIAN_RATIO = 0.2
LARGEST_OFFSET_MM = 1e-9
"""Limits of the worst element. A few bad ones don't show: of 13 meshes of a wedge of 25 degrees
with 2,300 to 3,200 unknowns those with a smallest angle of 2.9 to 6 degrees were 0.4 to 0.9 % off,
those of 10 to 16 degrees 0.4 to 1.3 %; 13 of a pad with fillets were 0.07 to 0.15 % off, whatever
the ratio of the quadratic map's determinants (-0.00 to 0.61)."""

STRAIGHT = 1e-6
"""Held nodes of a part count as lying on one line when they leave it by less than this share of
their extent."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Figures of a mesh, each the worst over it.

    Attributes
    ----------
    least_volume_mm3
        Smallest straight tetrahedron.
    least_dihedral_deg, largest_dihedral_deg
        Angles between faces of straight tetrahedra.
    least_scaled_jacobian
        Least sqrt(2) 6 V / (product of the three edges at a corner); 1 for a regular tetrahedron.
    least_jacobian_ratio
        Least over largest determinant of the quadratic map within an element; 1 for straight ones.
    largest_offset_mm
        Largest distance of a boundary node (corner or mid-side) from the pieces its faces belong
        to, or outside others.
    open_edges
        Edges of the boundary that don't belong to exactly two faces running along them in opposite
        directions.
    unclassified
        Faces on none of the body's pieces, and boundary triangles of tetrahedra that are missing
        from the faces.
    volume_error
        Volume inside the quadratic boundary over the exact one, minus 1.
    unknowns
        Three displacements at every node and one pressure at every corner.
    """

    least_volume_mm3: float
    least_dihedral_deg: float
    largest_dihedral_deg: float
    least_scaled_jacobian: float
    least_jacobian_ratio: float
    largest_offset_mm: float
    open_edges: int
    unclassified: int
    volume_error: float
    unknowns: int

    @staticmethod
    def of(mesh: Mesh, body: Body) -> Quality:
        """Measure a mesh of a body."""
        corner_tets = mesh.tets[:, :4]
        angles = dihedral_angles(mesh.points, corner_tets)
        return Quality(
            least_volume_mm3=float(np.min(signed_volumes(mesh.points, corner_tets))),
            least_dihedral_deg=float(np.min(angles)),
            largest_dihedral_deg=float(np.max(angles)),
            least_scaled_jacobian=float(np.min(_scaled_jacobians(mesh.points, corner_tets))),
            least_jacobian_ratio=float(np.min(jacobian_ratios(mesh.points, mesh.tets))),
            largest_offset_mm=max(0.0, float(np.max(offsets(mesh, body)))),
            open_edges=open_edges(mesh.faces),
            unclassified=_unclassified(mesh, body),
            volume_error=enclosed_volume(mesh.points, mesh.faces) / body.volume_mm3 - 1,
            unknowns=mesh.unknowns,
        )

    def failures(self, *, stricter: float = 1.0) -> list[str]:
        """Return one line for every gate that is not passed: figure and allowed range; the limits
        of shape are ``stricter`` times as high."""
        angle, jacobian = stricter * LEAST_DIHEDRAL_DEG, stricter * LEAST_SCALED_JACOBIAN
        ratio = stricter * LEAST_JACOBIAN_RATIO
        gates = [
            ("smallest volume, mm3", self.least_volume_mm3, ">", 0.0),
            ("smallest dihedral angle, deg", self.least_dihedral_deg, ">=", angle),
            ("least scaled Jacobian", self.least_scaled_jacobian, ">=", jacobian),
            ("quadratic Jacobian ratio", self.least_jacobian_ratio, ">=", ratio),
            ("offset of a boundary node, mm", self.largest_offset_mm, "<=", LARGEST_OFFSET_MM),
            ("open boundary edges", self.open_edges, "<=", 0),
            ("boundary faces of no piece", self.unclassified, "<=", 0),
        ]
        passes = {">": operator.gt, ">=": operator.ge, "<=": operator.le}
        return [
            f"{name}: {figure:.3g} (allowed: {sign} {limit:g})"
            for name, figure, sign, limit in gates
            if not passes[sign](figure, limit)
        ]


def worst_place(mesh: Mesh, *, crowded: bool = False) -> Points:
    """Return (3,) the middle of the element with the smallest dihedral angle, or of the smallest
    one, mm."""
    tets = mesh.tets[:, :4]
    figure = (
        signed_volumes(mesh.points, tets)
        if crowded
        else dihedral_angles(mesh.points, tets).min(axis=1)
    )
    return np.asarray(mesh.points[tets[np.argmin(figure)]].mean(axis=0))


def dihedral_angles(points: Points, tets: Ints) -> Floats:
    """Return (m, 6) angles between the faces of straight tetrahedra, deg."""
    corner = points[tets[:, :4]]
    normals = np.cross(
        corner[:, TET_FACES[:, 1]] - corner[:, TET_FACES[:, 0]],
        corner[:, TET_FACES[:, 2]] - corner[:, TET_FACES[:, 0]],
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    cosines = [
        -np.einsum("ij,ij->i", normals[:, a], normals[:, b]) for a, b in combinations(range(4), 2)
    ]
    return np.asarray(np.degrees(np.arccos(np.clip(np.stack(cosines, axis=1), -1, 1))))


def _scaled_jacobians(points: Points, tets: Ints) -> Floats:
    """Return (m,) least corner Jacobians over the product of the edges there, scaled to 1 for a
    regular tetrahedron."""
    corner = points[tets[:, :4]]
    length = np.linalg.norm(corner[:, TET_EDGES[:, 1]] - corner[:, TET_EDGES[:, 0]], axis=2)
    at_corner = [np.prod(length[:, np.any(k == TET_EDGES, axis=1)], axis=1) for k in range(4)]
    return np.asarray(np.sqrt(2) * 6 * signed_volumes(points, tets) / np.max(at_corner, axis=0))


def jacobian_ratios(points: Points, tets: Ints) -> Floats:
    """Return (m,) ratios of the least to the largest determinant of the quadratic map, over a cubic
    lattice.

    The determinant is a cubic in the local coordinates and the lattice of 20 points determines it.
    """
    lattice = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3]) / 3.0
    values = list(_determinants(points, tets, lattice))
    least, largest = np.min(values, axis=0), np.max(values, axis=0)
    flat = np.full(len(tets), -np.inf)  # or inside out
    return np.asarray(np.divide(least, largest, out=flat, where=largest > 0))


def offsets(mesh: Mesh, body: Body) -> Floats:
    """Return (f,) how far the six nodes of every boundary face are off its sheet, or outside any
    other, mm at most."""
    distance = body.sheet_distances(mesh.points[mesh.faces.ravel()]).reshape(len(mesh.faces), 6, -1)
    known = (mesh.piece >= 0) & (mesh.piece < len(body.pieces))
    sheet = body.sheets_of(mesh.points[mesh.faces], np.where(known, mesh.piece, 0))
    off_sheet = np.abs(distance[np.arange(len(mesh.faces)), :, sheet]).max(axis=1)
    return np.where(known, np.maximum(off_sheet, -distance.min(axis=(1, 2))), np.inf)


def open_edges(faces: Ints) -> int:
    """Return how many directed edges of the boundary (f, 3 or more) lack their opposite or occur
    twice."""
    ways = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ways, count = np.unique(ways, axis=0, return_counts=True)
    there = {(int(a), int(b)) for a, b in ways}
    return sum((int(b), int(a)) not in there for a, b in ways) + int(np.sum(count - 1))


def _unclassified(mesh: Mesh, body: Body) -> int:
    stray = int(np.sum((mesh.piece < 0) | (mesh.piece >= len(body.pieces))))
    expected = {tuple(sorted(face)) for face in boundary_triangles(mesh.tets[:, :4]).tolist()}
    return stray + len(expected ^ {tuple(sorted(face)) for face in mesh.faces[:, :3].tolist()})


def enclosed_volume(points: Points, faces: Ints) -> float:
    """Return the volume inside quadratic faces (f, 6), mm3: a third of the flux of x through them.

    The integrand x . (dx/dr x dx/ds) is a quartic, which the quadrature integrates exactly.
    """
    places, weights = quadrature(2)
    values, slopes = shapes(places)
    nodes = points[faces]
    total = 0.0
    for weight, value, slope in zip(weights, values, slopes, strict=True):
        normal = np.cross(*np.einsum("na,fnk->afk", slope, nodes))
        total += weight * float(np.einsum("n,fnk,fk->", value, nodes, normal))
    return total / 3


def require_solvable(mesh: Mesh, held: Bools) -> None:
    """Raise unless the mesh is a body, every part of which is held at nodes ``held`` (N,).

    Raises
    ------
    MeshError
        A node is not finite or belongs to no element, or an element is flat or turned inside out.
    SolveError
        The body, or a part of it, is held nowhere, or so that it can still turn.
    """
    _require_nodes(mesh)
    _require_volumes(mesh)
    _require_held(mesh, held)


def require_finite(mesh: Mesh, values: Floats, what: str, unit: str) -> None:
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
    least = np.min(list(_determinants(mesh.points, mesh.tets, quadrature(3)[0])), axis=0)
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


def _determinants(points: Points, tets: Ints, places: Floats) -> Iterator[Floats]:
    """Yield the (m,) determinants of the elements' maps at each of the reference places (q, 3),
    mm3."""
    nodes = points[tets]
    for slope in shapes(places)[1]:
        a, b, c = np.einsum("mai,aj->jmi", nodes, slope, optimize=True)
        yield np.einsum("mi,mi->m", a, np.cross(b, c))


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
