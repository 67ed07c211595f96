"""A body's mesh with its cover as a layer of elements of its own.

A cover of 0.2 mm is thinner than the elements. So the body's mesh is squeezed below the cover's
depth, along the depth normals, and prisms grow back to the surface, each cut into three quadratic
tetrahedra: the thickness is exact, and curved faces keep their curvature.

Validity: the sensing surface and its depth normals must be smooth, and the cover much thinner than
the body, or squeezed elements turn inside out, which is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Bools, Ints, Points, frozen
from twin.errors import MeshError
from twin.parts.body import Body
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh, signed_volumes

_LEAST_RATIO = 0.2
"""Least over largest determinant of the quadratic map that an element of a layered mesh may
have."""

_PRISM = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])
"""Three tetrahedra of a prism, corners 0 to 2 below 3 to 5, numbered along the nodes' own order:
neighbours agree."""


def with_cover(mesh: Mesh, body: Body, thickness_mm: float) -> Mesh:
    """Return the mesh of a body, cover included, whose outermost ``thickness_mm`` is a layer of its
    own, region 1.

    Raises
    ------
    MeshError
        The cover is too thick for the body, or squeezed elements turn inside out.
    """
    made = _extruded(_squeezed(mesh, body, thickness_mm), body)
    worst = float(np.min(made.jacobian_ratios()))
    if not (worst >= _LEAST_RATIO and np.min(signed_volumes(made.points, made.tets)) > 0):
        raise MeshError(
            f"with a cover of {thickness_mm:g} mm an element's Jacobian ratio is {worst:.3g} "
            f"(allowed: >= {_LEAST_RATIO:g}): make the layer thinner, or the mesh finer"
        )
    return made


def _squeezed(mesh: Mesh, body: Body, depth_mm: float) -> Mesh:
    """Return the mesh with its sensing surface moved to ``depth_mm`` below the body's; the deepest
    nodes stay. `MeshError` where that is more than a quarter of the body's depth, or the sensing
    surface ends without an edge."""
    if body.has_smooth_border:
        raise MeshError(
            "a cover needs a sensing surface that ends at a sharp edge, but this one goes on "
            "smoothly where it is not pressed any more: widen body.sensing (within_deg) up to the "
            "edge, or leave the cover's own stiffness out"
        )
    depth = body.depth(mesh.points)
    deepest = float(depth.max())
    if not 0.0 < depth_mm <= deepest / 4.0:
        raise MeshError(
            f"a cover of {depth_mm:g} mm does not fit into a body {deepest:.3g} mm deep (allowed: "
            f"above 0, up to {deepest / 4.0:.3g} mm)"
        )
    inward = depth_mm * (1.0 - depth / deepest)
    points = mesh.points + inward[:, None] * body.piece_normals(mesh.points)[:, 0]
    on = mesh.node_sheets(body)
    corners = body.onto_sheets(points[: mesh.corners], on[: mesh.corners], depth_mm=depth_mm)
    points[: mesh.corners] = corners
    edges = mesh.tets[:, :4][:, TET_EDGES]
    points[mesh.tets[:, 4:]] = corners[edges].mean(axis=2)
    points[mesh.corners :] = body.onto_sheets(
        points[mesh.corners :], on[mesh.corners :], depth_mm=depth_mm
    )
    return replace(mesh, points=frozen(points))


def _extruded(mesh: Mesh, body: Body) -> Mesh:
    """Return a squeezed mesh with one sheet of elements, region 1, grown from its sensing faces
    back to the body's surface. The sheet's far side takes their piece; each side of its rim that of
    the face next to it."""
    chosen = mesh.piece == 0
    faces, corners = mesh.faces[chosen], mesh.corners
    nodes = np.unique(faces)
    near = nodes[nodes < corners]
    far_points = body.onto_sheets(mesh.points[nodes], mesh.node_sheets(body)[nodes])
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, first = np.unique(ends, axis=0, return_index=True)
    middle = faces[:, 3:].reshape(-1)[first]
    # nodes: all corners first, the old ones and their far copies, then old middles, far middles,
    # uprights, slants
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
    return Mesh(
        points=frozen(points),
        tets=frozen(np.concatenate([renumbered[mesh.tets], tets])),
        corners=corners + len(near),
        faces=frozen(np.concatenate([renumbered[mesh.faces[~chosen]], far[faces], rim])),
        piece=frozen(
            np.concatenate([mesh.piece[~chosen], np.zeros(len(faces), np.int64), rim_piece])
        ),
        region=frozen(np.concatenate([mesh.region, np.ones(len(tets), np.int64)])),
    )


class _Sheet:
    """Numbers of a sheet's nodes, and the elements and rim faces made of them."""

    def __init__(
        self,
        edges: Ints,
        near_middle: Ints,
        far_middle: Ints,
        far: Ints,
        upright: Ints,
        slant: Ints,
    ) -> None:
        self._far = far
        self._middle: dict[tuple[int, int], int] = {}
        for (a, b), near, beyond, across in zip(
            edges.tolist(), near_middle, far_middle, slant, strict=True
        ):
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
        tets = prisms[:, _PRISM].reshape(-1, 4)
        flipped = signed_volumes(points, tets) < 0
        tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
        return np.hstack([tets, self._between(tets[:, TET_EDGES])])

    def rim(self, mesh: Mesh, chosen: Bools, ends: Ints) -> tuple[Ints, Ints]:
        """Return the faces (2 r, 6) on the rim, outward, and the pieces of the faces next to it."""
        edges, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
        outer = edges[count == 1]
        sides = mesh.faces[chosen][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)[first[count == 1]]
        others = mesh.faces[~chosen]
        next_to = {
            (min(a, b), max(a, b)): k
            for triangle, k in zip(
                others[:, :3].tolist(), mesh.piece[~chosen].tolist(), strict=True
            )
            for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True)
        }
        piece = np.array([next_to[a, b] for a, b in outer.tolist()], np.int64)
        # the quad below a side a -> b of an outward triangle is passed b -> a from outside; its
        # diagonal is low to high
        low, high = outer.T
        a, b = sides.T
        upper = self._far
        forward = a < b
        one = np.where(
            forward[:, None],
            np.column_stack([low, high, upper[high]]),
            np.column_stack([low, upper[high], high]),
        )
        two = np.where(
            forward[:, None],
            np.column_stack([low, upper[high], upper[low]]),
            np.column_stack([low, upper[low], upper[high]]),
        )
        triangles = np.concatenate([one, two])
        middles = self._between(triangles[:, [[0, 1], [1, 2], [2, 0]]])
        return np.hstack([triangles, middles]), np.concatenate([piece, piece])
