"""Finer elements where they are wanted, by halving longest edges: no mesher, the same result every time.

An edge is cut only when it is the longest of every element around it, so elements always fit together (M.-C. Rivara
1997, Int. J. Numer. Meth. Eng. 40): where a neighbour has a longer edge, that one is cut first. Angles stay bounded
however often it is done. New nodes of the surface are moved onto the true surface afterwards.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.errors import MeshError
from twin.parts.body import Body
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import EDGE_CORNERS, quadratic, signed_volumes, snapped

MOST = 1000
"""Rounds after which a mesh is given up; a hundred or two are usual."""


def refined(mesh: Mesh, body: Body, wanted: Callable[[Points], Floats]) -> Mesh:
    """Return a mesh whose elements have no edge longer than ``wanted`` at their middle.

    Parameters
    ----------
    mesh, body
        A mesh without layers, and its body.
    wanted
        Takes points (n, 3) to longest edges (n,), mm.

    Raises
    ------
    MeshError
        It takes too many rounds, or an element is turned inside out on the curved surface.
    """
    points, tets = mesh.points[: mesh.corners], mesh.tets[:, :4]
    for _ in range(MOST):
        points, tets, cut = _round(points, tets, wanted)
        if not cut:
            break
    else:
        raise MeshError(f"the mesh is not fine enough after {MOST} rounds of halving: ask for longer edges")
    on_surface, triangles, piece = snapped(body, points, tets)
    if np.min(signed_volumes(on_surface, tets)) <= 0:
        raise MeshError("moving new nodes onto the curved surface turns an element inside out: ask for longer edges")
    return Mesh(**vars(quadratic(body, on_surface, tets, triangles, piece)))


def _round(points: Points, tets: Ints, wanted: Callable[[Points], Floats]) -> tuple[Points, Ints, bool]:
    """Cut every edge that may be cut now; return the points, the elements, and whether any was cut."""
    ends = np.sort(tets[:, EDGE_CORNERS], axis=2)
    keys, of = np.unique(ends[..., 0] * len(points) + ends[..., 1], return_inverse=True)
    of = of.reshape(-1, 6)
    edges = np.column_stack(np.divmod(keys, len(points)))
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    rank = np.empty(len(edges), np.int64)
    rank[np.lexsort((np.arange(len(edges)), np.round(length, 9)))] = np.arange(len(edges))
    place = np.argmax(rank[of], axis=1)
    longest = np.take_along_axis(of, place[:, None], axis=1)[:, 0]
    asked = length[longest] > wanted(points[tets].mean(axis=1))
    if not asked.any():
        return points, tets, False
    marked = np.zeros(len(edges), bool)
    marked[longest[asked]] = True
    while True:
        more = longest[marked[of].any(axis=1)]
        if marked[more].all():
            break
        marked[more] = True
    around = np.bincount(of.ravel(), minlength=len(edges))
    cut = marked & (around == np.bincount(longest, minlength=len(edges)))
    middle = np.full(len(edges), -1)
    middle[cut] = len(points) + np.arange(cut.sum())
    points = np.concatenate([points, points[edges[cut]].mean(axis=1)])
    halved = cut[longest]
    pair = EDGE_CORNERS[place[halved]]
    children = [tets[~halved]]
    for side in range(2):
        child = tets[halved].copy()
        np.put_along_axis(child, pair[:, side : side + 1], middle[longest[halved]][:, None], axis=1)
        children.append(child)
    return points, np.concatenate(children), True
