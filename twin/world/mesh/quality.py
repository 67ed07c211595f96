"""Quality of a mesh, and the gates every mesh passes before it is used."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.errors import MeshError
from twin.parts.body import Body
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import EDGE_CORNERS, FACE_CORNERS, boundary_triangles, signed_volumes

LEAST_DIHEDRAL_DEG = 12.0
LEAST_SCALED_JACOBIAN = 0.12
LEAST_JACOBIAN_RATIO = 0.5
LARGEST_OFFSET_MM = 1e-9


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
        Largest distance of a boundary node (corner or mid-side) from the pieces its faces belong to, or outside others.
    open_edges
        Edges of the boundary that don't belong to exactly two faces running along them in opposite directions.
    unclassified
        Faces on none of the body's pieces, and boundary triangles of tetrahedra that are missing from the faces.
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

    def failures(self) -> list[str]:
        """Return one line for every gate that is not passed: figure and allowed range."""
        gates = [
            (self.least_volume_mm3 > 0, f"smallest volume {self.least_volume_mm3:.3g} mm3 (allowed: > 0)"),
            (
                self.least_dihedral_deg >= LEAST_DIHEDRAL_DEG,
                f"smallest dihedral angle {self.least_dihedral_deg:.3g} deg (allowed: >= {LEAST_DIHEDRAL_DEG:g})",
            ),
            (
                self.least_scaled_jacobian >= LEAST_SCALED_JACOBIAN,
                f"least scaled Jacobian {self.least_scaled_jacobian:.3g} (allowed: >= {LEAST_SCALED_JACOBIAN:g})",
            ),
            (
                self.least_jacobian_ratio >= LEAST_JACOBIAN_RATIO,
                f"quadratic Jacobian ratio {self.least_jacobian_ratio:.3g} (allowed: >= {LEAST_JACOBIAN_RATIO:g})",
            ),
            (
                self.largest_offset_mm <= LARGEST_OFFSET_MM,
                f"a boundary node is {self.largest_offset_mm:.3g} mm off (allowed: <= {LARGEST_OFFSET_MM:g})",
            ),
            (self.open_edges == 0, f"{self.open_edges} open boundary edges (allowed: 0)"),
            (self.unclassified == 0, f"{self.unclassified} boundary faces of no piece (allowed: 0)"),
        ]
        return [line for passed, line in gates if not passed]

    def described(self) -> dict[str, float | int]:
        """Return the plain numbers."""
        return asdict(self)


def quality(mesh: Mesh, body: Body) -> Quality:
    """Measure a mesh of a body."""
    corner_tets = mesh.tets[:, :4]
    angles = dihedral_angles(mesh.points, corner_tets)
    return Quality(
        least_volume_mm3=float(np.min(signed_volumes(mesh.points, corner_tets))),
        least_dihedral_deg=float(np.min(angles)),
        largest_dihedral_deg=float(np.max(angles)),
        least_scaled_jacobian=float(np.min(scaled_jacobians(mesh.points, corner_tets))),
        least_jacobian_ratio=float(np.min(jacobian_ratios(mesh.points, mesh.tets))),
        largest_offset_mm=max(0.0, float(np.max(offsets(mesh, body)))),
        open_edges=open_edges(mesh.faces),
        unclassified=_unclassified(mesh, body),
        volume_error=enclosed_volume(mesh.points, mesh.faces) / body.volume_mm3 - 1,
        unknowns=3 * len(mesh.points) + mesh.corners,
    )


def check(mesh: Mesh, body: Body) -> Quality:
    """Measure a mesh and raise if it fails a gate.

    Raises
    ------
    MeshError
        Naming every gate that failed.
    """
    measured = quality(mesh, body)
    failures = measured.failures()
    if failures:
        raise MeshError("the mesh fails its quality gates: " + "; ".join(failures) + "; build it again")
    return measured


def dihedral_angles(points: Points, tets: Ints) -> Floats:
    """Return (m, 6) angles between the faces of straight tetrahedra, deg."""
    corner = points[tets[:, :4]]
    normals = np.cross(
        corner[:, FACE_CORNERS[:, 1]] - corner[:, FACE_CORNERS[:, 0]],
        corner[:, FACE_CORNERS[:, 2]] - corner[:, FACE_CORNERS[:, 0]],
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    cosines = [-np.einsum("ij,ij->i", normals[:, a], normals[:, b]) for a, b in combinations(range(4), 2)]
    return np.asarray(np.degrees(np.arccos(np.clip(np.stack(cosines, axis=1), -1, 1))))


def scaled_jacobians(points: Points, tets: Ints) -> Floats:
    """Return (m,) least corner Jacobians over the product of the edges there, scaled to 1 for a regular tetrahedron."""
    corner = points[tets[:, :4]]
    length = np.linalg.norm(corner[:, EDGE_CORNERS[:, 1]] - corner[:, EDGE_CORNERS[:, 0]], axis=2)
    at_corner = [np.prod(length[:, np.any(k == EDGE_CORNERS, axis=1)], axis=1) for k in range(4)]
    return np.asarray(np.sqrt(2) * 6 * signed_volumes(points, tets) / np.max(at_corner, axis=0))


def jacobian_ratios(points: Points, tets: Ints) -> Floats:
    """Return (m,) ratios of the least to the largest determinant of the quadratic map, over a cubic lattice.

    The determinant is a cubic in the local coordinates and the lattice of 20 points determines it.
    """
    lattice = [(i / 3, j / 3, k / 3) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
    nodes = points[tets]
    values = []
    for local in lattice:
        jacobian = np.einsum("mna,nb->mab", nodes, shape_gradients(*local))
        values.append(np.linalg.det(jacobian))
    least, largest = np.min(values, axis=0), np.max(values, axis=0)
    flat = np.full(len(tets), -np.inf)  # or inside out
    return np.asarray(np.divide(least, largest, out=flat, where=largest > 0))


def shape_gradients(r: float, s: float, t: float) -> Floats:
    """Return the (10, 3) gradients of the quadratic shape functions at local coordinates (r, s, t), VTK's order."""
    weight = np.array([1 - r - s - t, r, s, t])
    slope = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
    corner = (4 * weight - 1)[:, None] * slope
    a, b = EDGE_CORNERS.T
    middle = 4 * (weight[a, None] * slope[b] + weight[b, None] * slope[a])
    return np.concatenate([corner, middle])


def offsets(mesh: Mesh, body: Body) -> Floats:
    """Return (f,) how far the six nodes of every boundary face are off its piece, or outside any other, mm at most."""
    distance = body.piece_distances(mesh.points[mesh.faces.ravel()]).reshape(len(mesh.faces), 6, -1)
    known = (mesh.piece >= 0) & (mesh.piece < len(body.pieces))
    off_piece = np.abs(distance[np.arange(len(mesh.faces)), :, np.where(known, mesh.piece, 0)]).max(axis=1)
    return np.where(known, np.maximum(off_piece, -distance.min(axis=(1, 2))), np.inf)


def open_edges(faces: Ints) -> int:
    """Return how many directed edges of the boundary (f, 3 or more) lack their opposite or occur twice."""
    ways = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ways, count = np.unique(ways, axis=0, return_counts=True)
    there = {(int(a), int(b)) for a, b in ways}
    return sum((int(b), int(a)) not in there for a, b in ways) + int(np.sum(count - 1))


def _unclassified(mesh: Mesh, body: Body) -> int:
    stray = int(np.sum((mesh.piece < 0) | (mesh.piece >= len(body.pieces))))
    expected = {tuple(sorted(face)) for face in boundary_triangles(mesh.tets[:, :4]).tolist()}
    return stray + len(expected ^ {tuple(sorted(face)) for face in mesh.faces[:, :3].tolist()})


_TRIANGLE_RULE = (
    (0.109951743655322, 0.816847572980459, 0.091576213509771),
    (0.223381589678011, 0.108103018168070, 0.445948490915965),
)
"""Dunavant's rule of degree 4: weight, odd and twin barycentric coordinate of two triples of points."""


def enclosed_volume(points: Points, faces: Ints) -> float:
    """Return the volume inside quadratic faces (f, 6), mm3: a third of the flux of x through them.

    Six-point rule of degree 4 on every face; the integrand x . (dx/dr x dx/ds) is a quartic.
    """
    nodes = points[faces]
    total = 0.0
    for weight, odd, twin in _TRIANGLE_RULE:
        for turn in range(3):
            a, b, c = np.roll([odd, twin, twin], turn)
            shape = np.array([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])
            along_r = np.array([1 - 4 * a, 4 * b - 1, 0, 4 * (a - b), 4 * c, -4 * c])
            along_s = np.array([1 - 4 * a, 0, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
            place, tangent_r, tangent_s = (np.einsum("n,fna->fa", w, nodes) for w in (shape, along_r, along_s))
            total += weight * float(np.einsum("fa,fa->", place, np.cross(tangent_r, tangent_s)))
    return total / 6
