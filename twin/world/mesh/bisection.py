"""Tetrahedra halved at their longest edges: meshes refined in places, and the mesh of a block.

An edge is cut only when it is the longest of every element around it, so elements always fit
together; where a neighbour has a longer edge, that one is cut first (M.-C. Rivara 1997, Int. J.
Numer. Meth. Eng. 40): angles stay bounded. A block's first cells are six tetrahedra each, which are
halved to the wanted edges; the smallest angle is 20 degrees and more on all proportions.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.errors import MeshError
from twin.parts.body import Block, Body
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh, kuhn_grid, signed_volumes
from twin.world.mesh.sizing import Sizing, WantedEdge
from twin.world.mesh.snap import snapped_mesh

_MOST_ROUNDS = 1000
"""Rounds after which a mesh is given up; a hundred or two are usual."""

_LONGEST = 2.0
"""Length of a block's first cells over the block's shortest side, at most."""

_LARGEST, _STEP = 8.0, 0.94
"""A block's mesh is halved to the wanted edges times the first of these, then to ever shorter ones,
by the other, until it has as many unknowns as wanted, or more: up to two thirds on small ones."""


def block_mesh(block: Block, sizing: Sizing) -> Mesh:
    """Return the mesh of a block with the proportions of a sizing and at least as many unknowns."""
    low, high = np.array(block.bounds_mm)
    size = high - low
    cell = min(2.0 * sizing.coarse_mm, _LONGEST * float(size.min()))
    counts = np.maximum(np.rint(size / cell).astype(int), 1)
    points, tets = kuhn_grid(
        *(np.linspace(*ends) for ends in zip(low, high, counts + 1, strict=True))
    )
    edge = WantedEdge(block, sizing)
    scale = _LARGEST

    def wanted(places: Points) -> Floats:
        return scale * edge(places)

    while _unknowns(points, tets) < sizing.unknowns:
        scale *= _STEP
        points, tets = _halved(points, tets, wanted)
    return snapped_mesh(block, points, tets)


def _unknowns(points: Points, tets: Ints) -> int:
    """Return how many unknowns the quadratic mesh of linear tetrahedra has: see `Sizing`."""
    ends = np.sort(tets[:, TET_EDGES].reshape(-1, 2), axis=1)
    edges = len(np.unique(ends[:, 0] * len(points) + ends[:, 1]))
    return 3 * (len(points) + edges) + len(points)


def refined(
    mesh: Mesh, body: Body, wanted: Callable[[Points], Floats], *, local: bool = False
) -> Mesh:
    """Return a mesh whose elements have no edge longer than ``wanted`` at their middle.

    ``mesh`` has no layers; ``wanted`` takes points (n, 3) to longest edges (n,), mm. With ``local``
    an edge is cut where it is longer than wanted at its own middle, and no other: a third fewer
    nodes, but nothing bounds the angles.

    Raises
    ------
    MeshError
        It takes too many rounds, or an element is turned inside out on the curved surface.
    """
    points, tets = _halved(mesh.points[: mesh.corners], mesh.tets[:, :4], wanted, local)
    made = snapped_mesh(body, points, tets)
    if np.min(signed_volumes(made.points, tets)) <= 0:
        raise MeshError(
            "moving new nodes onto the curved surface turns an element inside out: ask for "
            "longer edges"
        )
    return made


def _halved(
    points: Points, tets: Ints, wanted: Callable[[Points], Floats], local: bool = False
) -> tuple[Points, Ints]:
    """Return linear tetrahedra, none of which has an edge longer than ``wanted``: see `refined`."""
    for _ in range(_MOST_ROUNDS):
        points, tets, cut = _round(points, tets, wanted, local)
        if not cut:
            return points, tets
    raise MeshError(
        f"the mesh is not fine enough after {_MOST_ROUNDS} rounds of halving: ask for longer edges"
    )


def _round(
    points: Points, tets: Ints, wanted: Callable[[Points], Floats], local: bool
) -> tuple[Points, Ints, bool]:
    """Cut every edge that may be cut now; return the points, the elements, and whether any was
    cut."""
    ends = np.sort(tets[:, TET_EDGES], axis=2)
    keys, of = np.unique(ends[..., 0] * len(points) + ends[..., 1], return_inverse=True)
    of = of.reshape(-1, 6)
    edges = np.column_stack(np.divmod(keys, len(points)))
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    rank = np.empty(len(edges), np.int64)
    rank[np.lexsort((np.arange(len(edges)), np.round(length, 9)))] = np.arange(len(edges))
    if local:
        marked = length > wanted(points[edges].mean(axis=1))
    else:
        longest = of[np.arange(len(of)), np.argmax(rank[of], axis=1)]
        marked = np.zeros(len(edges), bool)
        marked[longest[length[longest] > wanted(points[tets].mean(axis=1))]] = True
        while True:
            more = longest[marked[of].any(axis=1)]
            if marked[more].all():
                break
            marked[more] = True
    if not marked.any():
        return points, tets, False

    # An edge is cut when it is the longest marked one of every element around it.
    rank[~marked] = -1
    place = np.argmax(rank[of], axis=1)
    longest = of[np.arange(len(of)), place]
    around = np.bincount(of.ravel(), minlength=len(edges))
    cut = marked & (around == np.bincount(longest, minlength=len(edges)))
    middle = np.full(len(edges), -1)
    middle[cut] = len(points) + np.arange(cut.sum())
    points = np.concatenate([points, points[edges[cut]].mean(axis=1)])
    halved = cut[longest]
    pair = TET_EDGES[place[halved]]
    children = [tets[~halved]]
    for side in range(2):
        child = tets[halved].copy()
        np.put_along_axis(child, pair[:, side : side + 1], middle[longest[halved]][:, None], axis=1)
        children.append(child)
    return points, np.concatenate(children), True
