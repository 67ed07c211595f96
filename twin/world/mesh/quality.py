"""Quality of a mesh, and the gates that every mesh passes before it is used."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.parts.body import Body
from twin.world.mesh.quadratic_mesh import (
    TET_EDGES,
    TET_FACES,
    Mesh,
    boundary_triangles,
    signed_volumes,
)

LEAST_DIHEDRAL_DEG = 5.0
LEAST_SCALED_JACOBIAN = 0.05
LEAST_JACOBIAN_RATIO = 0.2
LARGEST_OFFSET_MM = 1e-9
"""Limits of the worst element. A few bad ones don't show: meshes of a wedge of 25 degrees with a
smallest angle of 2.9 to 6 degrees were 0.4 to 0.9 % off, those of 10 to 16 degrees 0.4 to 1.3 %;
13 of a pad with fillets 0.07 to 0.15 %, whatever the Jacobian ratio (-0.00 to 0.61)."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Figures of a mesh, each the worst over it.

    Attributes
    ----------
    least_volume_mm3
        Smallest straight tetrahedron.
    least_dihedral_deg
        Angle between faces of straight tetrahedra.
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
        return Quality(
            least_volume_mm3=float(np.min(signed_volumes(mesh.points, corner_tets))),
            least_dihedral_deg=float(np.min(Quality.dihedral_angles(mesh.points, corner_tets))),
            least_scaled_jacobian=float(np.min(_scaled_jacobians(mesh.points, corner_tets))),
            least_jacobian_ratio=float(np.min(mesh.jacobian_ratios())),
            largest_offset_mm=max(0.0, float(np.max(_offsets(mesh, body)))),
            open_edges=open_edges(mesh.faces),
            unclassified=_unclassified(mesh, body),
            volume_error=mesh.enclosed_volume() / body.volume_mm3 - 1,
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

    @staticmethod
    def dihedral_angles(points: Points, tets: Ints) -> Floats:
        """Return (m, 6) angles between the faces of straight tetrahedra, deg."""
        corner = points[tets[:, :4]]
        normals = np.cross(
            corner[:, TET_FACES[:, 1]] - corner[:, TET_FACES[:, 0]],
            corner[:, TET_FACES[:, 2]] - corner[:, TET_FACES[:, 0]],
        )
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
        cosines = [
            -np.einsum("ij,ij->i", normals[:, a], normals[:, b])
            for a, b in combinations(range(4), 2)
        ]
        return np.asarray(np.degrees(np.arccos(np.clip(np.stack(cosines, axis=1), -1, 1))))


def _scaled_jacobians(points: Points, tets: Ints) -> Floats:
    """Return (m,) least corner Jacobians over the product of the edges there, scaled to 1 for a
    regular tetrahedron."""
    corner = points[tets[:, :4]]
    length = np.linalg.norm(corner[:, TET_EDGES[:, 1]] - corner[:, TET_EDGES[:, 0]], axis=2)
    at_corner = [np.prod(length[:, np.any(k == TET_EDGES, axis=1)], axis=1) for k in range(4)]
    return np.asarray(np.sqrt(2) * 6 * signed_volumes(points, tets) / np.max(at_corner, axis=0))


def _offsets(mesh: Mesh, body: Body) -> Floats:
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
