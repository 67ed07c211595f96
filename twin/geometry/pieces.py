"""Level sets of a triangulated surface: signed distances to its pieces, and their gradients.

Why pieces: meshes are snapped to one smooth piece at a time, and to the edges where two meet. Beyond its own border a
piece goes on in the plane of its last triangle, as the plane or sphere of a parametric body does; without that, points
near a sharp edge would be drawn along the edge's rounding instead of onto both pieces. In a body with dents such a
plane may cut through the body's other parts, so inside it the plain distance is taken.

The side of the surface comes from normals averaged by angle over the nearest corner or edge (J. A. Baerentzen, H.
Aanaes, 2005), which is right for every closed surface.

Validity: distances are those to the triangles, exactly. A curved surface cut into triangles of edge h lies up to
h^2 / (8 R) beside the one that was drawn (R its radius of curvature), and its normals are off by up to h / (2 R).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen
from twin.geometry.closed import Surface
from twin.geometry.nearest import FACE, BoxTree, box_tree, first_from_below, nearest

FLAT = 1e-6
"""A piece is a plane if its corners are nearer to one than this share of the box's diagonal."""

DENT = 1e-5
"""A body is convex if its hull holds at most this share more than itself: corners in a file are rounded."""

_TOUCHING_MM = 1e-9


class Pieces:
    """A closed surface whose triangles belong to pieces.

    Parameters
    ----------
    surface
        The closed surface.
    piece
        (m,) piece of every triangle, 0 to the number of pieces - 1.
    """

    def __init__(self, surface: Surface, piece: Ints) -> None:
        self.surface = surface
        self.piece = frozen(np.asarray(piece, np.int64))
        self.count = int(self.piece.max()) + 1
        self._corners = frozen(surface.vertices[surface.triangles])
        self._outward, self._border = feature_normals(surface.triangles, self._corners, self.piece)
        self._asked: tuple[Points, Floats, Floats] | None = None

    @cached_property
    def is_convex(self) -> bool:
        """Whether the surface has no dents."""
        from scipy.spatial import ConvexHull

        hull = ConvexHull(self.surface.vertices)
        return bool(hull.volume <= self.surface.volume_mm3 * (1.0 + DENT))

    @cached_property
    def hull_vertices(self) -> Points:
        """(h, 3) corners of the convex hull, mm."""
        from scipy.spatial import ConvexHull

        return frozen(self.surface.vertices[ConvexHull(self.surface.vertices).vertices])

    @cached_property
    def planes(self) -> dict[int, tuple[Points, Floats]]:
        """A point and the inward normal of every piece that is a plane."""
        found = {}
        room = FLAT * float(np.linalg.norm(np.ptp(self.surface.vertices, axis=0)))
        for k in range(self.count):
            corners = self._corners[self.piece == k]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
            length = float(np.linalg.norm(normal))
            if length == 0.0:
                continue
            normal, middle = -normal / length, corners.mean(axis=(0, 1))
            if np.max(np.abs((corners - middle) @ normal)) < room:
                found[k] = (middle, normal)
        return found

    @cached_property
    def _trees(self) -> list[tuple[Ints, BoxTree]]:
        of_piece = [np.flatnonzero(self.piece == k) for k in range(self.count)]
        return [(own, box_tree(self._corners[own])) for own in of_piece]

    @cached_property
    def _tree(self) -> BoxTree:
        return box_tree(self._corners)

    def distances_and_normals(self, points: Points) -> tuple[Floats, Floats]:
        """Return (n, pieces) distances in mm, positive inside, and their (n, pieces, 3) gradients.

        The latest answer is kept, because distances and normals are mostly asked for in turn.
        """
        points = np.ascontiguousarray(points, np.float64)
        if self._asked is not None and np.array_equal(self._asked[0], points):
            return self._asked[1:]
        distance, normal = self._measured(points)
        self._asked = (frozen(points.copy()), frozen(distance), frozen(normal))
        return distance, normal

    def _measured(self, points: Points) -> tuple[Floats, Floats]:
        shape = (len(points), self.count)
        distance, normal = np.empty(shape), np.empty((*shape, 3))
        plain, towards = np.empty(shape), np.empty((*shape, 3))
        within = np.empty(shape, bool)
        for k in range(self.count):
            if self.is_convex and k in self.planes:
                origin, inward = self.planes[k]
                distance[:, k], normal[:, k] = (points - origin) @ inward, inward
                continue
            own, tree = self._trees[k]
            triangle, foot, feature = nearest(tree, points)
            triangle = own[triangle]
            away = points - foot
            plain[:, k] = np.linalg.norm(away, axis=1)
            outward = self._outward[triangle, feature]
            within[:, k] = np.einsum("ni,ni->n", away, outward) <= 0.0
            side = np.where(within[:, k], 1.0, -1.0)
            beyond = self._border[triangle, feature]
            inward = -np.where(beyond[:, None], self._outward[triangle, FACE], outward)
            on_plane = np.einsum("ni,ni->n", away, inward)
            distance[:, k] = np.where(beyond, on_plane, side * plain[:, k])
            clear = plain[:, k] > _TOUCHING_MM
            towards[:, k] = away / np.where(clear, plain[:, k], 1.0)[:, None]
            plain_way = clear & ~beyond
            normal[:, k] = np.where(plain_way[:, None], side[:, None] * towards[:, k], inward)
        if not self.is_convex:
            row, first = np.arange(len(points)), np.argmin(plain, axis=1)
            depth = np.where(within[row, first], 1.0, -1.0) * plain[row, first]
            far_away = (depth[:, None] > _TOUCHING_MM) | (distance < depth[:, None] - _TOUCHING_MM)
            distance = np.where(far_away, plain, distance)
            normal = np.where(far_away[:, :, None] & (plain > _TOUCHING_MM)[:, :, None], towards, normal)
        return distance, normal

    def from_below(self, xy: Floats, preferred: int = 0) -> tuple[Ints, Points]:
        """Return the piece (n,) met first by rays along +z at (n, 2) places, -1 for none, and the places (n, 3)."""
        xy = np.asarray(xy, np.float64)
        triangle, z = first_from_below(self._tree, xy, self.piece == preferred)
        return np.where(triangle >= 0, self.piece[triangle], -1), np.column_stack([xy, z])

    def edges(self, chosen: Bools) -> Points:
        """Return the (e, 2, 3) ends of the edges between the ``chosen`` (pieces,) pieces and the others."""
        own = chosen[self.piece]
        others = {(int(b), int(a)) for a, b in _sides(self.surface.triangles[~own])}
        shared = [(int(a), int(b)) for a, b in _sides(self.surface.triangles[own]) if (int(a), int(b)) in others]
        return np.asarray(self.surface.vertices[np.array(shared, np.int64).reshape(-1, 2)])

    def dents(self, crease_deg: float) -> Points:
        """Return the (e, 2, 3) ends of the edges at which the surface is folded inwards by more than ``crease_deg``."""
        face, across = self._outward[:, FACE], neighbours(self.surface.triangles)
        own, side = np.meshgrid(np.arange(len(face)), np.arange(3), indexing="ij")
        other = across[own, side]
        ends = np.stack([self._corners[own, side], self._corners[own, (side + 1) % 3]], axis=2)
        outer = self._corners[other].mean(axis=2) - ends[:, :, 0]
        inwards = np.einsum("msi,mi->ms", outer, face) > 0.0
        folded = np.einsum("mi,msi->ms", face, face[other]) < np.cos(np.radians(crease_deg))
        return np.asarray(ends[inwards & folded & (own < other)])


def _sides(triangles: Ints) -> Ints:
    """Return (3 m, 2) directed edges in the order of the triangles, 01, 12, 20."""
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def face_normals(corners: Floats) -> Floats:
    """Return (m, 3) unit outward normals of triangles (m, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def neighbours(triangles: Ints) -> Ints:
    """Return (m, 3) the triangle across each edge 01, 12, 20 of a closed surface."""
    sides = _sides(triangles)
    number = {(int(a), int(b)): k // 3 for k, (a, b) in enumerate(sides)}
    return np.array([number[(int(b), int(a))] for a, b in sides], np.int64).reshape(-1, 3)


def feature_normals(triangles: Ints, corners: Floats, piece: Ints) -> tuple[Floats, Bools]:
    """Return (m, 7, 3) unit outward normals of every feature of every triangle, and (m, 7) which are on a border.

    Features are numbered as in `twin.geometry.nearest`: face, three corners, three edges. A corner's normal is the
    mean of its triangles' weighted by their angle there, an edge's the mean of its two.
    """
    face, across = face_normals(corners), neighbours(triangles)
    sides = np.roll(corners, -1, axis=1) - corners
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    angle = np.arccos(np.clip(-np.einsum("mki,mki->mk", sides, np.roll(sides, 1, axis=1)), -1.0, 1.0))
    count = int(triangles.max()) + 1
    at_corner = np.zeros((count, 3))
    np.add.at(at_corner, triangles, angle[:, :, None] * face[:, None])
    at_edge = face[:, None] + face[across]
    outward = np.concatenate([face[:, None], at_corner[triangles], at_edge], axis=1)
    length = np.linalg.norm(outward, axis=2, keepdims=True)
    outward = np.where(length > 1e-12, outward / np.maximum(length, 1e-300), face[:, None])
    lowest, highest = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(lowest, triangles, piece[:, None])
    np.maximum.at(highest, triangles, piece[:, None])
    border = np.zeros((len(triangles), 7), bool)
    border[:, 1:4] = (lowest != highest)[triangles]
    border[:, 4:] = piece[across] != piece[:, None]
    return frozen(outward), frozen(border)


def smooth_parts(surface: Surface, chosen: Bools, crease_deg: float) -> Ints:
    """Return (m,) numbers of the parts into which the ``chosen`` triangles fall at sharp edges, -1 for the others."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = surface.vertices[surface.triangles]
    face, across = face_normals(corners), neighbours(surface.triangles)
    own = np.repeat(np.arange(len(face)), 3)
    other = across.ravel()
    joined = chosen[own] & chosen[other]
    joined &= np.einsum("ei,ei->e", face[own], face[other]) > np.cos(np.radians(crease_deg))
    graph = coo_matrix((np.ones(int(joined.sum())), (own[joined], other[joined])), shape=(len(face), len(face)))
    _, part = connected_components(graph, directed=False)
    part = np.where(chosen, part, -1)
    _, number = np.unique(part, return_inverse=True)
    return np.asarray(number - int((~chosen).any()), np.int64)
