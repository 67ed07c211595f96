"""Faces across which a load's half-space field is out of balance: the free outside, and where materials meet.

The half-space has the modulus of the material at the sensing surface. In another region its strains make g times its
stress, g the ratio of the shear moduli (the mean tension is chosen to fit), which is in balance within the region but
not with its neighbour: the traction jumps. So a region costs surface integrals only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.world.mesh.elements import TET_EDGES
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import FACE_CORNERS


@dataclass(frozen=True)
class Skin:
    """Faces and the true surfaces behind them.

    Attributes
    ----------
    body
        The body whose level sets the surfaces are.
    faces
        (f, 6) quadratic triangles.
    piece, depth_mm
        (f,) piece of the body that each lies on, and how far below it.
    weight
        (f,) how many times the half-space's traction is out of balance there.
    inside
        (f,) whether each is an interface.
    """

    body: Body
    faces: Ints
    piece: Ints
    depth_mm: Floats
    weight: Floats
    inside: Bools

    def __getitem__(self, chosen: Bools) -> Skin:
        arrays = {key: value[chosen] for key, value in vars(self).items() if key != "body"}
        return Skin(self.body, **arrays)

    def nearest(self, points: Points, face: Ints) -> tuple[Points, Floats]:
        """Return the nearest points (q, 3) on the surfaces of ``face`` (q,), and the inward normals (q, 3) there."""
        row, piece, depth = np.arange(len(points)), self.piece[face], self.depth_mm[face]
        for _ in range(2):
            normal = self.body.piece_normals(points)[row, piece]
            points = points - (self.body.piece_distances(points)[row, piece] - depth)[:, None] * normal
        return points, normal


def skin(mesh: Mesh, body: Body, shares: Floats) -> Skin:
    """Return the free faces, weighted by their region's share (regions,) of the half-space's stress, and interfaces."""
    outside = ~np.isin(mesh.piece, body.held_pieces) & (mesh.piece < len(body.pieces))
    faces, piece = mesh.faces[outside], mesh.piece[outside]
    if not np.any(mesh.region):
        return Skin(
            body, faces, piece, np.zeros(len(faces)), np.full(len(faces), shares[0]), np.zeros(len(faces), bool)
        )
    inner, sides = interfaces(mesh)
    depth = body.depth(mesh.points[inner[:, :3].ravel()]).reshape(-1, 3)
    level = np.ptp(depth, axis=1) < 1e-9
    return Skin(
        body,
        np.concatenate([faces, inner]),
        np.concatenate([piece, np.where(level, 0, len(body.pieces) - 1)]),
        np.concatenate([np.zeros(len(faces)), np.where(level, depth.mean(axis=1), 0.0)]),
        np.concatenate([shares[regions_behind(mesh, faces)], shares[sides[:, 0]] - shares[sides[:, 1]]]),
        np.arange(len(faces) + len(inner)) >= len(faces),
    )


def add_exactly(
    points: Points,
    areas: Floats,
    values: Floats,
    nodes: Ints,
    centre: Points,
    frames: Floats,
    half: Floats,
    columns: Floats,
    poisson_ratio: float,
    out: Floats,
) -> None:
    """Add every point's traction -sigma n, spread by the shape functions (q, 6), to the nodal forces (N, 3, m).

    In closed form all over: under a load the interface carries all of it, where a free face carries next to nothing.
    """
    for case in range(columns.shape[2]):
        load = Rectangles(centre_mm=centre, frames=frames, half_mm=half, force_n=columns[:, :, case])
        traction = -np.einsum("qij,qj->qi", halfspace.stress(points, load, poisson_ratio), areas)
        np.add.at(out[:, :, case], nodes, values[:, :, None] * traction[:, None])


def interfaces(mesh: Mesh) -> tuple[Ints, Ints]:
    """Return the faces (f, 6) between regions, normals out of the first, and the two regions (f, 2)."""
    corners, owner = _all_faces(mesh)
    key = np.sort(corners, axis=1)
    _, first, inverse, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
    other = np.zeros(len(first), np.int64)
    other[inverse.ravel()] = np.arange(len(key))  # the last one of each pair
    region = mesh.region[owner]
    between = (count == 2) & (region[first] != region[other])
    chosen = first[between]
    return _with_middles(mesh, corners[chosen], owner[chosen]), np.column_stack(
        [region[chosen], region[other[between]]]
    )


def _all_faces(mesh: Mesh) -> tuple[Ints, Ints]:
    """Return the corners (4 m, 3) of all elements' faces, turned outward, and the elements (4 m,)."""
    return mesh.tets[:, FACE_CORNERS].reshape(-1, 3), np.repeat(np.arange(len(mesh.tets)), 4)


def _with_middles(mesh: Mesh, corners: Ints, owner: Ints) -> Ints:
    """Return faces (f, 6) with the middle nodes of their elements' edges."""
    edges = np.array(TET_EDGES)
    ends = np.sort(mesh.tets[owner][:, edges], axis=2)
    sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    which = np.argmax(np.all(sides[:, :, None] == ends[:, None], axis=3), axis=2)
    return np.hstack([corners, np.take_along_axis(mesh.tets[owner, 4:], which, axis=1)])


def regions_behind(mesh: Mesh, faces: Ints) -> Ints:
    """Return the region (f,) behind boundary faces."""
    if not np.any(mesh.region):
        return np.zeros(len(faces), np.int64)
    corners, owner = _all_faces(mesh)
    scale = np.array([mesh.corners**2, mesh.corners, 1])
    keys = np.sort(corners, axis=1) @ scale
    order = np.argsort(keys)
    at = np.searchsorted(keys[order], np.sort(faces[:, :3], axis=1) @ scale)
    return np.asarray(mesh.region[owner[order[at]]])
