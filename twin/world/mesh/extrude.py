"""Layers glued on a body: prisms grown from the faces of one piece, each cut into three quadratic tetrahedra.

Why not mark elements by their middles: a cover of 0.2 mm is thinner than the elements, and a third of it would be
marked wrong. So the layer is made of elements of its own. A cover lies inside the body's outline, at depths 0 to t;
the body's mesh is squeezed below depth t first, along the depth normals, and the layer grows back to depth 0. A base
plate grows outward from the held face. Thicknesses are exact, layers share their nodes with the body, and curved
faces keep their curvature: the middle of a slanted edge lies half-way between the two curved faces.

Validity: the sensing surface and its depth normals must be smooth, and a cover much thinner than the body, or squeezed
elements turn inside out, which is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from twin.arrays import Bools, Ints, Points, frozen
from twin.errors import MeshError
from twin.parts.body import Body
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.quality import jacobian_ratios
from twin.world.mesh.snap import EDGE_CORNERS, onto_pieces, pieces_at, signed_volumes

LEAST_RATIO = 0.2
"""Least over largest determinant of the quadratic map that an element of a layered mesh may have."""

PRISM = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])
"""Three tetrahedra of a prism, corners 0 to 2 below 3 to 5, numbered along the nodes' own order: neighbours agree."""

Grown = Callable[[Points, Bools], Points]
"""Takes nodes (n, 3) on a piece, and which pieces meet at each (n, pieces), to where the layer's far side has them."""


def with_cover(mesh: Mesh, body: Body, thickness_mm: float, *, sheets: int = 1) -> Mesh:
    """Return the mesh of the same body whose outermost ``thickness_mm`` is a layer of its own, region 1.

    Parameters
    ----------
    mesh
        The body's mesh.
    body
        The body, cover included.
    thickness_mm
        Thickness of the cover, mm.
    sheets
        Number of sheets of elements across it.

    Raises
    ------
    MeshError
        The cover is too thick for the body, or squeezed elements turn inside out.
    """
    made = squeezed(mesh, body, thickness_mm)
    for sheet in range(1, sheets + 1):
        to_depth = partial(onto_pieces, body, depth_mm=thickness_mm * (1.0 - sheet / sheets))
        made = extruded(made, 0, to_depth, region=1)
    return _checked(made, f"a cover of {thickness_mm:g} mm")


def with_base(mesh: Mesh, body: Body, thickness_mm: float, *, sheets: int = 1, region: int | None = None) -> Mesh:
    """Return the mesh with a plate glued below the base, as wide as it; its underside and sides are two new pieces.

    Parameters
    ----------
    mesh, body
        The body, with a cover or without.
    thickness_mm
        Thickness of the plate, mm.
    sheets
        Number of sheets of elements across it.
    region
        Region of the plate; the next free one if not given.
    """
    base, pieces = len(body.pieces) - 1, len(body.pieces)
    region = int(mesh.region.max()) + 1 if region is None else region
    made = mesh
    for sheet in range(sheets):
        made = extruded(
            made,
            base if sheet == 0 else pieces,
            lambda points, on: points - thickness_mm / sheets * body.piece_normals(points)[:, base],
            region=region,
            far_piece=pieces,
            side_piece=pieces + 1,
        )
    return _checked(made, f"a base of {thickness_mm:g} mm")


def squeezed(mesh: Mesh, body: Body, depth_mm: float) -> Mesh:
    """Return the mesh with its sensing surface moved to ``depth_mm`` below the body's; the deepest nodes stay.

    Raises
    ------
    MeshError
        ``depth_mm`` is more than a quarter of the body's depth.
    """
    depth = body.depth(mesh.points)
    deepest = float(depth.max())
    if not 0.0 < depth_mm <= deepest / 4.0:
        raise MeshError(
            f"a cover of {depth_mm:g} mm does not fit into a body {deepest:.3g} mm deep (allowed: above 0, up to "
            f"{deepest / 4.0:.3g} mm)"
        )
    inward = depth_mm * (1.0 - depth / deepest)
    points = mesh.points + inward[:, None] * body.piece_normals(mesh.points)[:, 0]
    on = pieces_at(mesh.faces, mesh.piece, len(points), len(body.pieces))
    corners = onto_pieces(body, points[: mesh.corners], on[: mesh.corners], depth_mm=depth_mm)
    points[: mesh.corners] = corners
    edges = mesh.tets[:, :4][:, EDGE_CORNERS]
    points[mesh.tets[:, 4:]] = corners[edges].mean(axis=2)
    points[mesh.corners :] = onto_pieces(body, points[mesh.corners :], on[mesh.corners :], depth_mm=depth_mm)
    return replace(mesh, points=frozen(points))


def extruded(
    mesh: Mesh,
    piece: int,
    grown: Grown,
    *,
    region: int,
    far_piece: int | None = None,
    side_piece: int | None = None,
) -> Mesh:
    """Return the mesh with one sheet of elements grown from the faces of ``piece``.

    Parameters
    ----------
    mesh
        The mesh.
    piece
        The piece whose faces are grown; they are inside afterwards.
    grown
        Where a node of these faces gets its far copy.
    region
        Region of the new elements.
    far_piece, side_piece
        Pieces of the sheet's far side and of its rim; if not given the far side takes over ``piece``, and each side of
        the rim the piece of the face next to it.
    """
    chosen = mesh.piece == piece
    faces, corners = mesh.faces[chosen], mesh.corners
    nodes = np.unique(faces)
    near = nodes[nodes < corners]
    on = pieces_at(mesh.faces, mesh.piece, len(mesh.points), int(mesh.piece.max()) + 1)
    far_points = grown(mesh.points[nodes], on[nodes])
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, first = np.unique(ends, axis=0, return_index=True)
    middle = faces[:, 3:].reshape(-1)[first]
    # nodes: all corners first, the old ones and their far copies, then old middles, far middles, uprights, slants
    old_middles = len(mesh.points) - corners
    renumbered = np.arange(len(mesh.points))
    renumbered[corners:] += len(near)
    far = np.full(len(mesh.points), -1)
    far[near] = corners + np.arange(len(near))
    far[middle] = corners + len(near) + old_middles + np.arange(len(edges))
    upright = np.full(corners, -1)
    upright[near] = corners + len(near) + old_middles + len(edges) + np.arange(len(near))
    slant = upright[near[-1]] + 1 + np.arange(len(edges))
    place = np.empty((len(mesh.points), 3))
    place[nodes] = far_points
    points = np.concatenate(
        [
            mesh.points[:corners],
            place[near],
            mesh.points[corners:],
            place[middle],
            (mesh.points[near] + place[near]) / 2.0,
            (mesh.points[middle] + place[middle]) / 2.0,
        ]
    )
    sheet = _Sheet(edges, renumbered[middle], far[middle], far, upright, slant)
    tets = sheet.tets(np.sort(faces[:, :3], axis=1), points)
    rim, rim_piece = sheet.rim(mesh, chosen, ends)
    pieces = [mesh.piece[~chosen], np.full(len(faces), piece if far_piece is None else far_piece)]
    return Mesh(
        points=frozen(points),
        tets=frozen(np.concatenate([renumbered[mesh.tets], tets])),
        corners=corners + len(near),
        faces=frozen(np.concatenate([renumbered[mesh.faces[~chosen]], far[faces], rim])),
        piece=frozen(np.concatenate([*pieces, rim_piece if side_piece is None else np.full(len(rim), side_piece)])),
        region=frozen(np.concatenate([mesh.region, np.full(len(tets), region)])),
    )


class _Sheet:
    """Numbers of a sheet's nodes, and the elements and rim faces made of them."""

    def __init__(self, edges: Ints, near_middle: Ints, far_middle: Ints, far: Ints, upright: Ints, slant: Ints) -> None:
        self._far = far
        self._middle: dict[tuple[int, int], int] = {}
        for (a, b), near, beyond, across in zip(edges.tolist(), near_middle, far_middle, slant, strict=True):
            self._middle[a, b] = int(near)
            self._middle[int(far[a]), int(far[b])] = int(beyond)
            self._middle[a, int(far[b])] = int(across)
        for a in np.flatnonzero(upright >= 0).tolist():
            self._middle[a, int(far[a])] = int(upright[a])

    def _between(self, pairs: Ints) -> Ints:
        """Return the middle nodes of edges (..., 2)."""
        flat = np.sort(pairs.reshape(-1, 2), axis=1).tolist()
        return np.array([self._middle[a, b] for a, b in flat], np.int64).reshape(pairs.shape[:-1])

    def tets(self, triangles: Ints, points: Points) -> Ints:
        """Return (3 f, 10) elements over triangles (f, 3) of sorted corners."""
        prisms = np.hstack([triangles, self._far[triangles]])
        tets = prisms[:, PRISM].reshape(-1, 4)
        flipped = signed_volumes(points, tets) < 0
        tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
        return np.hstack([tets, self._between(tets[:, EDGE_CORNERS])])

    def rim(self, mesh: Mesh, chosen: Bools, ends: Ints) -> tuple[Ints, Ints]:
        """Return the faces (2 r, 6) on the rim, outward, and the pieces of the faces beside it."""
        edges, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
        outer = edges[count == 1]
        sides = mesh.faces[chosen][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)[first[count == 1]]
        others = mesh.faces[~chosen]
        beside = {
            (min(a, b), max(a, b)): k
            for triangle, k in zip(others[:, :3].tolist(), mesh.piece[~chosen].tolist(), strict=True)
            for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True)
        }
        piece = np.array([beside[a, b] for a, b in outer.tolist()], np.int64)
        # the quad below a side a -> b of an outward triangle is passed b -> a from outside; its diagonal is low to high
        low, high = outer.T
        a, b = sides.T
        upper = self._far
        forward = a < b
        one = np.where(
            forward[:, None], np.column_stack([low, high, upper[high]]), np.column_stack([low, upper[high], high])
        )
        two = np.where(
            forward[:, None],
            np.column_stack([low, upper[high], upper[low]]),
            np.column_stack([low, upper[low], upper[high]]),
        )
        triangles = np.concatenate([one, two])
        middles = self._between(triangles[:, [[0, 1], [1, 2], [2, 0]]])
        return np.hstack([triangles, middles]), np.concatenate([piece, piece])


def _checked(mesh: Mesh, what: str) -> Mesh:
    """Return the mesh if no element is inside out."""
    worst = float(np.min(jacobian_ratios(mesh.points, mesh.tets)))
    if not (worst >= LEAST_RATIO and np.min(signed_volumes(mesh.points, mesh.tets)) > 0):
        raise MeshError(
            f"with {what} an element's Jacobian ratio is {worst:.3g} (allowed: >= {LEAST_RATIO:g}): make the layer "
            "thinner, or the mesh finer"
        )
    return mesh
