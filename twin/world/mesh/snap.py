"""From raw linear tetrahedra to quadratic ones whose boundary lies on the body's true surface.

Why snap: the mesher keeps the surface only within an envelope (sharp edges come out rounded, flat faces may tilt),
while the level sets are exact. Boundary nodes move onto the piece their faces belong to, nodes of faces of two or three
pieces onto the edge or corner where those meet, and the mid-side nodes of boundary faces follow, which turns a chord
error of h^2 / (8 R) into one of fourth order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen
from twin.parts.body import Body

FACE_CORNERS = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
"""Corners of a positive tetrahedron's faces, right-hand normals pointing out of it."""

EDGE_CORNERS = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])
"""Corners of a tetrahedron's edges, in the order of VTK's quadratic tetrahedron."""


@dataclass(frozen=True, kw_only=True)
class Quadratic:
    """Quadratic tetrahedra with a classified boundary; see `twin.world.mesh.mesh.Mesh` for the arrays."""

    points: Points
    tets: Ints
    corners: int
    faces: Ints
    piece: Ints


def signed_volumes(points: Points, tets: Ints) -> Floats:
    """Return the (m,) signed volumes, mm3, of straight tetrahedra (m, 4 or more; the first four nodes count)."""
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6)


def onto_pieces(body: Body, points: Points, on: Bools, *, depth_mm: float = 0.0) -> Points:
    """Project points onto the pieces asked for, by Newton steps of least length.

    Parameters
    ----------
    body
        The body.
    points
        (n, 3), mm.
    on
        (n, pieces): the pieces that each point shall lie on; none leaves the point where it is.
    depth_mm
        Depth of the level set that takes the sensing piece's place.

    Returns
    -------
    ndarray
        (n, 3), mm: nearest points on the surfaces, edges (two pieces) or corners (three).
    """
    points = np.array(points, dtype=np.float64)
    if len(points) == 0:
        return points
    for _ in range(30):
        away = body.piece_distances(points) - depth_mm * (np.arange(on.shape[1]) == 0)
        distance = np.where(on, away, 0.0)
        if np.max(np.abs(distance)) < 1e-14:
            break
        normals = np.where(on[:, :, None], body.piece_normals(points), 0.0)
        step = np.linalg.pinv(normals, rcond=1e-6) @ distance[:, :, None]
        points -= step[:, :, 0]
    return points


def boundary_triangles(tets: Ints) -> Ints:
    """Return the (f, 3) faces that belong to one tetrahedron only, right-hand normals pointing out."""
    faces = tets[:, FACE_CORNERS].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(faces[np.sort(first[count == 1])])


def classify(body: Body, points: Points, triangles: Ints) -> Ints:
    """Return (f,) indices into ``body.pieces``: the piece each boundary triangle lies on.

    Distance alone can't tell the pieces of a small triangle on a rounded edge, so the normal has a say: a piece costs
    its largest distance at the corners in units of the triangle's longest edge, plus 1 - cosine of the normals' angle.
    """
    corner = points[triangles]
    distance = np.abs(body.piece_distances(corner.reshape(-1, 3))).reshape(len(triangles), 3, -1).max(axis=1)
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    turned = 1 + np.einsum("fpk,fk->fp", body.piece_normals(corner.mean(axis=1)), outward)
    return np.asarray(np.argmin(distance / longest[:, None] + turned, axis=1), np.int64)


def pieces_at(nodes: Ints, piece: Ints, count: int, pieces: int) -> Bools:
    """Return (count, pieces): which pieces meet at each node, from faces (f, k) of nodes and their piece (f,)."""
    on = np.zeros((count, pieces), dtype=bool)
    on[nodes.ravel(), np.repeat(piece, nodes.shape[1])] = True
    return on


def snapped(body: Body, points: Points, tets: Ints) -> tuple[Points, Ints, Ints]:
    """Move the boundary nodes of linear tetrahedra (m, 4) onto the body's surface.

    Returns
    -------
    points
        (n, 3), mm.
    triangles
        (f, 3) boundary faces, normals out.
    piece
        (f,) indices into ``body.pieces``.
    """
    triangles = boundary_triangles(tets)
    piece = classify(body, points, triangles)
    on = pieces_at(triangles, piece, len(points), len(body.pieces))
    return onto_pieces(body, points, on), triangles, piece


def quadratic(body: Body, points: Points, tets: Ints, triangles: Ints, piece: Ints) -> Quadratic:
    """Add mid-side nodes; those of boundary faces lie on the true surface.

    Parameters
    ----------
    body
        The body.
    points
        (n, 3) snapped corner nodes, mm.
    tets
        (m, 4) positive tetrahedra.
    triangles, piece
        Boundary faces (f, 3) and the piece of each (f,).
    """
    corners = len(points)
    pairs = np.sort(tets[:, EDGE_CORNERS].reshape(-1, 2), axis=1)
    edges, of_pair = np.unique(pairs, axis=0, return_inverse=True)
    number = {(int(a), int(b)): k for k, (a, b) in enumerate(edges)}
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    face_mid = np.array([[number[(int(a), int(b))] for a, b in face] for face in sides], dtype=np.int64)
    middle = points[edges].mean(axis=1)
    on = pieces_at(face_mid, piece, len(edges), len(body.pieces))
    middle = onto_pieces(body, middle, on)
    return Quadratic(
        points=frozen(np.concatenate([points, middle])),
        tets=frozen(np.hstack([tets, corners + of_pair.reshape(-1, 6)])),
        corners=corners,
        faces=frozen(np.hstack([triangles, corners + face_mid])),
        piece=frozen(piece),
    )
