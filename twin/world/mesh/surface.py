"""A body's outer surface as closed triangles, for the mesher.

Why a convex hull: every body given by formulas is convex, and the hull of enough exact surface points, its edges and
corners among them, is closed and consistently wound by construction. The mesh that comes of it is snapped to the level
sets afterwards, so the triangles only have to be near. A body that brings its own triangles may have dents; they are
taken as they are.

*Validity*: bodies given by formulas must be convex; any other is refused, because the hull's volume does not match the
body's.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from twin.arrays import Ints, Points
from twin.errors import MeshError
from twin.parts.body import Body
from twin.world.mesh.snap import onto_pieces


def surface_samples(body: Body, spacing_mm: float) -> Points:
    """Return (n, 3) points on the body's surface, mm, about ``spacing_mm`` apart, by casting rays from its middle."""
    low, high = np.array(body.bounds_mm)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    count = int(4 * np.pi * (reach / 2 / spacing_mm) ** 2) + 200
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    direction = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    inside, outside = np.zeros(count), np.full(count, reach)
    for _ in range(60):
        trial = (inside + outside) / 2
        within = body.contains(middle + trial[:, None] * direction)
        inside, outside = np.where(within, trial, inside), np.where(within, outside, trial)
    return np.asarray(middle + inside[:, None] * direction)


def outer_surface(body: Body, spacing_mm: float) -> tuple[Points, Ints]:
    """Triangulate the body's surface.

    Parameters
    ----------
    body
        A body; convex, if it is given by formulas.
    spacing_mm
        Distance between the points on curved pieces, mm.

    Returns
    -------
    vertices
        (n, 3), mm.
    triangles
        (m, 3) indices, right-hand normals pointing out of the body.

    Raises
    ------
    MeshError
        If the triangles are not closed, or their volume differs by more than 1 % from the body's.
    """
    if body.own_surface is not None:
        return body.own_surface
    import trimesh

    samples = surface_samples(body, spacing_mm)
    near = np.abs(body.piece_distances(samples)) < 2 * spacing_mm
    points = [samples]
    for size in (2, 3):
        for pieces in combinations(range(len(body.pieces)), size):
            candidates = samples[np.all(near[:, pieces], axis=1)]
            on = np.zeros((len(candidates), len(body.pieces)), dtype=bool)
            on[:, pieces] = True
            meeting = onto_pieces(body, candidates, on)
            points.append(meeting[body.contains(meeting, -1e-9)])
    rounded = np.unique(np.round(np.concatenate(points), 9), axis=0)
    hull = trimesh.convex.convex_hull(rounded)
    if not (hull.is_watertight and hull.is_winding_consistent):
        raise MeshError(f"the {body_name(body)}'s surface triangles are not closed; this needs a convex body")
    if abs(hull.volume / body.volume_mm3 - 1) > 0.01:
        raise MeshError(
            f"the convex hull of the {body_name(body)}'s surface holds {hull.volume:.6g} mm3, the body "
            f"{body.volume_mm3:.6g} mm3 (allowed: 1 % apart); only convex bodies can be meshed"
        )
    return np.asarray(hull.vertices, np.float64), np.asarray(hull.faces, np.int64)


def body_name(body: Body) -> str:
    """Return the body's kind in words, for messages."""
    return type(body).__name__.lower()
