"""A finer mesh below a load: the program's own mesh, bisected where a study wants shorter edges.

The program's meshes carry the smooth rest that is left when the half-space is subtracted, so they are coarse where a
load presses. A study of plain elements needs them fine there. Bisecting the longest edges (M. C. Rivara 1984) keeps
the mesh conforming, needs no mesher, and gives the same mesh every time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.parts.body import Body
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import EDGE_CORNERS, quadratic, signed_volumes, snapped

MOST_PASSES = 200


def refined(mesh: Mesh, body: Body, wanted: Callable[[Points], Floats]) -> Mesh:
    """Return ``mesh`` with its tetrahedra bisected until no edge is longer than ``wanted``.

    Parameters
    ----------
    mesh, body
        The mesh, and the body whose surface its nodes are put on.
    wanted
        Longest edges in mm allowed in tetrahedra around given points (n, 3), mm.
    """
    points, tets = mesh.points[: mesh.corners].copy(), mesh.tets[:, :4].copy()
    for _ in range(MOST_PASSES):
        split = _terminal_edges(points, tets, wanted)
        if split is None:
            break
        points, tets = _bisected(points, tets, *split)
        points, triangles, piece = snapped(body, points, tets)
    else:
        raise RuntimeError(f"bisection did not end after {MOST_PASSES} passes")
    if np.min(signed_volumes(points, tets)) <= 0:
        raise RuntimeError("bisection turned a tetrahedron inside out: start from a finer mesh")
    points, triangles, piece = snapped(body, points, tets)
    return Mesh(**vars(quadratic(body, points, tets, triangles, piece)))


def _terminal_edges(points: Points, tets: Ints, wanted: Callable[[Points], Floats]) -> tuple[Ints, Ints, Ints] | None:
    """Return edges (e, 2), which of them each tetrahedron is cut at (-1: none), and its place in the tetrahedron.

    Of the edges that have to be cut only those are returned that are the longest of all their tetrahedra: the cut is
    then conforming, and the others follow in later passes.
    """
    pairs = np.sort(tets[:, EDGE_CORNERS], axis=2)
    edges, of = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    of = of.reshape(-1, 6)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    rank = np.empty(len(edges), np.int64)
    rank[np.argsort(length, kind="stable")] = np.arange(len(edges))
    place = np.argmax(rank[of], axis=1)
    longest = of[np.arange(len(tets)), place]
    cut = np.zeros(len(edges), bool)
    cut[longest[length[longest] > wanted(points[tets].mean(axis=1))]] = True
    if not cut.any():
        return None
    while True:
        touched = cut[of].any(axis=1)
        if cut[longest[touched]].all():
            break
        cut[longest[touched]] = True
    terminal = cut.copy()
    terminal[of[np.arange(6) != place[:, None]]] = False
    return edges, np.where(terminal[longest], longest, -1), place


def _bisected(points: Points, tets: Ints, edges: Ints, edge: Ints, place: Ints) -> tuple[Points, Ints]:
    """Cut every tetrahedron that has an ``edge`` at the middle of it."""
    used, middle = np.unique(edge[edge >= 0], return_inverse=True)
    new = len(points) + middle
    whole, halves = tets[edge < 0], tets[edge >= 0]
    first, second = halves.copy(), halves.copy()
    ends = EDGE_CORNERS[place[edge >= 0]]
    row = np.arange(len(halves))
    first[row, ends[:, 0]] = new
    second[row, ends[:, 1]] = new
    return np.concatenate([points, points[edges[used]].mean(axis=1)]), np.concatenate([whole, first, second])
