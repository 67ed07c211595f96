"""Level sets of a triangulated surface: signed distances to its pieces, and their gradients.

Meshes are snapped to one smooth piece at a time, and to the edges where two meet. Beyond its own
border a piece continues in the plane of its last triangle; otherwise points near a sharp edge would
be drawn along the edge's rounding. In a body with dents such a plane may cut through other parts,
so inside it the plain distance is taken. The side of the surface follows from normals averaged by
angle over the nearest corner or edge (J. A. Baerentzen, H. Aanaes, 2005).

Triangles of a curved face are chords of it: with edges h long they lie up to h^2 / (8 R) off the
face that was drawn (R its radius of curvature), and their normals are off by up to h / (2 R). So
each triangle is bent (`Pieces.rises`): the height over it is a quadratic function that follows from
the normals at its corners, and the distance is that to the triangle plus the height at the nearest
place.

Validity: a bent triangle leaves the triangles' own error where normals at corners are uncertain: of
edges that are as long as a tenth of the circumference, or next to faces much narrower or wider.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen
from twin.geometry.closed import FLAT, Surface

FACE = 0
"""Feature of a triangle's nearest place that lies on its face."""

_COPLANAR = 1e-3
"""Angle between triangles, rad, up to which they are of one plane: corners in files are rounded."""

_FLATTER = 2.5
"""A face is flat if it is so many times as wide as its neighbours, over their turns: of a circle
cut into chords of two widths a wide one among narrow ones is 1.7 to 2.3, the flat between two
fillets 3 where it is twice as wide as their chords."""

_MOST_RISE = 3.0
"""Rise of an edge at most, over turn and width of a triangle: 0.5 over the chord of a circle, 1.0
of even triangles of a sphere."""

_LONGER, _LARGER = 3.0, 6.0
"""Times that an edge may be as long as a neighbour that turns against it, as a chord of the same
curve, and a plane face as large as others at a corner: elsewhere the curvature jumps, as where a
fillet becomes a corner."""

_BENT_STEPS, _STEEP = 4, 0.05
"""Steps from a triangle to the bent one along z, and the least slope against it."""

_TOUCHING_MM = 1e-9
_PARALLEL = 1e-12


class TriangleTree:
    """Searches among triangles (m, 3, 3) by VTK: the nearest, and the first along lines."""

    def __init__(self, corners: Floats) -> None:
        from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator

        self._corners = np.ascontiguousarray(corners, np.float64)
        points = vtkPoints()
        points.SetDataTypeToDouble()
        points.SetData(numpy_to_vtk(self._corners.reshape(-1, 3)))  # type: ignore[no-untyped-call]
        cells = vtkCellArray()
        order = np.arange(3 * len(corners))
        numbers = numpy_to_vtkIdTypeArray(order, deep=True)  # type: ignore[no-untyped-call]
        cells.SetData(3, numbers)
        mesh = vtkPolyData()
        mesh.SetPoints(points)
        mesh.SetPolys(cells)
        self._middle = (self._corners.min(axis=(0, 1)) + self._corners.max(axis=(0, 1))) / 2.0
        self._radius = 1.0 + float(np.linalg.norm(self._corners - self._middle, axis=2).max())
        self._locator: Any = vtkStaticCellLocator()
        self._locator.SetDataSet(mesh)
        self._locator.BuildLocator()

    def nearest(self, points: Points) -> tuple[Ints, Points, Ints]:
        """Return for (n, 3) points the nearest triangle (n,), place (n, 3), and its feature (n,): 0
        the face, 1 to 3 the corners, 4 to 6 the edges 01, 12, 20."""
        from vtkmodules.vtkCommonCore import reference
        from vtkmodules.vtkCommonDataModel import vtkGenericCell

        triangle = np.zeros(len(points), np.int64)
        found: Any = reference(0)
        part, squared, place, cell = reference(0), reference(0.0), [0.0, 0.0, 0.0], vtkGenericCell()
        for row, point in enumerate(np.asarray(points, float).tolist()):
            self._locator.FindClosestPoint(point, place, cell, found, part, squared)
            triangle[row] = found.get()
        return triangle, *_onto_triangles(points, self._corners[triangle])

    def first_along(self, points: Points, along: Floats) -> tuple[Ints, Floats]:
        """Return the triangle (n,) that whole lines through (n, 3) points meet first, -1 for none,
        and how many times ``along`` (n, 3) from the point (n,), perhaps negative; inf for none."""
        from vtkmodules.vtkCommonCore import reference, vtkIdList, vtkPoints

        points, along = np.asarray(points, float), np.asarray(along, float)
        length = np.linalg.norm(along, axis=1)
        unit = along / length[:, None]
        # The piece of each line within a ball around all triangles.
        ahead = np.einsum("ni,ni->n", self._middle - points, unit)[:, None]
        starts = points + (ahead - self._radius) * unit
        ends = points + (ahead + self._radius) * unit
        away = points + ahead * unit - self._middle
        near = np.flatnonzero(np.einsum("ni,ni->n", away, away) <= self._radius**2)
        found: Any = reference(0)
        share, part = reference(0.0), reference(0)
        place, local = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        triangle = np.full(len(points), -1)
        room = _TOUCHING_MM * self._radius
        between = zip(near.tolist(), starts[near].tolist(), ends[near].tolist(), strict=True)
        for row, start, end in between:
            if self._locator.IntersectWithLine(start, end, room, share, place, local, part, found):
                triangle[row] = found.get()
        times = self._times(triangle, points, along)
        for row in np.flatnonzero((triangle >= 0) & np.isinf(times)).tolist():
            # A triangle that the line lies in is no place to enter: take the first of the others.
            others = vtkIdList()
            self._locator.IntersectWithLine(starts[row], ends[row], room, vtkPoints(), others)
            crossed = [others.GetId(k) for k in range(others.GetNumberOfIds())] + [-1]
            entered = self._times(np.array(crossed), points[row], along[row])
            first = int(np.argmin(entered))
            triangle[row] = crossed[first] if np.isfinite(entered[first]) else -1
            times[row] = entered[first]
        return triangle, times

    def _times(self, triangle: Ints, points: Points, along: Floats) -> Floats:
        """Return how many times ``along`` lines lie from triangles' planes; inf where parallel, or
        of none."""
        a, b, c = (self._corners[triangle, k] for k in range(3))
        normal = np.cross(b - a, c - a)
        slope = np.sum(normal * along, axis=-1)
        steep = np.linalg.norm(normal, axis=-1) * np.linalg.norm(along, axis=-1)
        met = (triangle >= 0) & (np.abs(slope) > _PARALLEL * steep)
        height = np.sum(normal * (a - points), axis=-1)
        return np.where(met, height / np.where(met, slope, 1.0), np.inf)


def _onto_triangles(points: Points, corners: Floats) -> tuple[Points, Ints]:
    """Return the nearest places (n, 3) of triangles (n, 3, 3), and their features (n,)."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, ac = b - a, c - a

    def dots(origin: Points) -> tuple[Floats, Floats]:
        away = points - origin
        return np.einsum("ni,ni->n", ab, away), np.einsum("ni,ni->n", ac, away)

    # Barycentric coordinates, and the Voronoi region of the triangle that the point lies in: a
    # corner, an edge or the face (C. Ericson, Real-Time Collision Detection, section 5.1.5).
    (d1, d2), (d3, d4), (d5, d6) = dots(a), dots(b), dots(c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    conditions = [
        (d1 <= 0.0) & (d2 <= 0.0),
        (d3 >= 0.0) & (d4 <= d3),
        (vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0),
        (d6 >= 0.0) & (d5 <= d6),
        (vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0),
        (va <= 0.0) & (d4 >= d3) & (d5 >= d6),
    ]
    feature = np.select(conditions, [1, 2, 4, 3, 6, 5], FACE)
    # The place in each region: clamped to the corner or to the edge.
    zero, one = np.zeros(len(points)), np.ones(len(points))
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ab, on_ac = d1 / (d1 - d3), d2 / (d2 - d6)
        on_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = np.select(conditions, [zero, one, on_ab, zero, zero, 1.0 - on_bc], vb / (va + vb + vc))
        w = np.select(conditions, [zero, zero, zero, one, on_ac, on_bc], vc / (va + vb + vc))
    return a + v[:, None] * ab + w[:, None] * ac, feature


@dataclass(frozen=True)
class _Nearest:
    """Of points (...): the signed distance from a piece, its gradient (..., 3), the plain distance,
    the direction (..., 3) from its nearest place, whether a point is inside of it, and how far it
    is bent there."""

    distance: Floats
    normal: Floats
    plain: Floats
    towards: Floats
    within: Bools
    bent: Floats

    @classmethod
    def empty(cls, shape: int | tuple[int, int]) -> _Nearest:
        one = np.empty(shape)
        way = np.empty((*one.shape, 3))
        bent = np.zeros_like(one)
        return cls(one, way, np.zeros_like(one), np.zeros_like(way), np.zeros(shape, bool), bent)

    def fill(self, place: Any, found: _Nearest) -> None:
        """Set some of the points."""
        for name, array in vars(found).items():
            getattr(self, name)[place] = array

    def limit(self, depth: Floats, bent: Floats) -> None:
        """Take the plain distance where, in a body with dents, a piece's plane cuts other parts:
        where it is less than ``depth``, the distance to the whole surface, which is ``bent``
        there."""
        room = _TOUCHING_MM + np.maximum(self.bent, bent)
        far_away = (depth > room) | (self.distance < depth - room)
        self.distance[far_away] = self.plain[far_away]
        clear = far_away & (self.plain > _TOUCHING_MM)
        self.normal[clear] = self.towards[clear]


DENT = 1e-5
"""A body is convex if its hull holds at most this share more than itself: corners in a file are
rounded."""


class Pieces:
    """A closed surface whose triangles belong to pieces, (m,) from 0."""

    def __init__(self, surface: Surface, piece: Ints, rises: Floats | None = None) -> None:
        self.surface = surface
        self._rises = rises
        self.piece = frozen(np.asarray(piece, np.int64))
        self.count = int(self.piece.max()) + 1
        self._corners = frozen(surface.vertices[surface.triangles])
        self._outward, self._border = _feature_normals(surface.triangles, self._corners, self.piece)
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
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(
                axis=0
            )
            length = float(np.linalg.norm(normal))
            if length == 0.0:
                continue
            normal = -normal / length
            middle = corners.mean(axis=(0, 1))
            if np.max(np.abs((corners - middle) @ normal)) < room:
                found[k] = (middle, normal)
        return found

    @cached_property
    def _trees(self) -> list[tuple[Ints, TriangleTree]]:
        of_piece = [np.flatnonzero(self.piece == k) for k in range(self.count)]
        return [(own, TriangleTree(self._corners[own])) for own in of_piece]

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self._corners)

    def distances_and_normals(self, points: Points) -> tuple[Floats, Floats]:
        """Return (n, pieces) distances in mm, positive inside, and their (n, pieces, 3) gradients.
        The latest are kept, because both are mostly needed in turn."""
        points = np.ascontiguousarray(points, np.float64)
        if self._asked is not None and np.array_equal(self._asked[0], points):
            return self._asked[1:]
        distance, normal = self._measured(points)
        self._asked = (frozen(points.copy()), frozen(distance), frozen(normal))
        return distance, normal

    def from_pieces(self, points: Points, piece: Ints) -> tuple[Floats, Floats]:
        """Return distances (n,) of points (n, 3) from one piece (n,) each, and their gradients (n,
        3)."""
        found = _Nearest.empty(len(points))
        for k in np.unique(piece).tolist():
            found.fill(piece == k, self._nearest(points[piece == k], k))
        if not self.is_convex:
            triangle, foot, feature = self._tree.nearest(points)
            away = points - foot
            inward = -self._outward[triangle, feature]
            plain = np.linalg.norm(away, axis=1)
            depth = np.where(np.einsum("ni,ni->n", away, inward) >= 0.0, plain, -plain)
            height = np.zeros(len(points))
            if self._rises is not None:
                height, bent = self._bent(triangle, foot, feature, plain, inward)
                depth = (depth + height) / np.linalg.norm(bent, axis=1)
            found.limit(depth, np.abs(height))
        return found.distance, found.normal

    def _measured(self, points: Points) -> tuple[Floats, Floats]:
        found = _Nearest.empty((len(points), self.count))
        for k in range(self.count):
            found.fill((slice(None), k), self._nearest(points, k))
        if not self.is_convex:
            row = np.arange(len(points))
            first = np.argmin(found.plain, axis=1)
            side = np.where(found.within[row, first], 1.0, -1.0)
            found.limit((side * found.plain[row, first])[:, None], found.bent[row, first, None])
        return found.distance, found.normal

    def _nearest(self, points: Points, k: int) -> _Nearest:
        """Return what is nearest to points (n, 3) on the piece ``k``."""
        # A flat piece of a convex solid stands for its whole plane.
        if self.is_convex and k in self.planes:
            found = _Nearest.empty(len(points))
            origin, inward = self.planes[k]
            found.distance[:] = (points - origin) @ inward
            found.normal[:] = inward
            return found
        # The nearest point of the piece; the normal of that face, edge or corner gives the side.
        own, tree = self._trees[k]
        triangle, foot, feature = tree.nearest(points)
        triangle = own[triangle]
        away = points - foot
        plain = np.linalg.norm(away, axis=1)
        outward = self._outward[triangle, feature]
        within = np.einsum("ni,ni->n", away, outward) <= 0.0
        # Beyond the border of the piece, the face is continued as a plane.
        side = np.where(within, 1.0, -1.0)
        beyond = self._border[triangle, feature]
        inward = -np.where(beyond[:, None], self._outward[triangle, FACE], outward)
        distance = np.where(beyond, np.einsum("ni,ni->n", away, inward), side * plain)
        # On the surface itself the way to the nearest point has no direction: take the normal.
        clear = plain > _TOUCHING_MM
        towards = away / np.where(clear, plain, 1.0)[:, None]
        plain_way = clear & ~beyond
        normal = np.where(plain_way[:, None], side[:, None] * towards, inward)
        height = np.zeros(len(points))
        if self._rises is not None:
            near = np.where(beyond, np.inf, plain)
            height, bent = self._bent(triangle, foot, feature, near, normal)
            steep = np.linalg.norm(bent, axis=1)
            distance = (distance + height) / steep
            normal = bent / steep[:, None]
            depth = (side * plain + height) / steep
            plain, within = np.abs(depth), depth >= 0.0
            inwards = np.where(within, 1.0, -1.0)[:, None] * normal
            towards = np.where(beyond[:, None], towards, inwards)
        return _Nearest(distance, normal, plain, towards, within, np.abs(height))

    def _bent(
        self, triangle: Ints, foot: Points, feature: Ints, plain: Floats, inward: Floats
    ) -> tuple[Floats, Floats]:
        """Return heights (n,) of bent triangles over the places ``foot`` (n, 3) of flat ones
        nearest to points ``plain`` (n,) away, and gradients (n, 3) of the distance, not of unit
        length; of the flat ones these are ``inward`` (n, 3)."""
        assert self._rises is not None
        rises = self._rises[triangle]
        height, slope = _heights(self._corners[triangle], rises, foot)
        # Next to an edge, too, the bent triangle has one normal, where the flat ones have two.
        on_face = feature == FACE
        near = on_face | (plain < np.abs(rises).max(axis=1))
        flat = np.where(on_face[:, None], inward, -self._outward[triangle, FACE])
        return height, np.where(near[:, None], flat + slope, inward)

    def nearest_triangles(self, points: Points, piece: Ints) -> Ints:
        """Return (n,) the triangle of the piece (n,) that is nearest to each of (n, 3) points."""
        found = np.zeros(len(points), np.int64)
        for k in np.unique(piece):
            own, tree = self._trees[k]
            found[piece == k] = own[tree.nearest(points[piece == k])[0]]
        return found

    def from_below(self, xy: Floats) -> tuple[Ints, Points]:
        """Return the piece (n,) that rays along +z at (n, 2) meet first, -1 for none, and the
        places (n, 3)."""
        points = np.column_stack([xy, np.zeros(len(xy))])
        up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        triangle, z = self._tree.first_along(points, up)
        met = triangle >= 0
        # Where two pieces are met at one height, at their common edge, the first piece counts.
        ties = np.flatnonzero(met & (self.piece[triangle] != 0))
        if len(ties):
            own, tree = self._trees[0]
            found, height = tree.first_along(points[ties], up[ties])
            same = (found >= 0) & (height <= z[ties] + _TOUCHING_MM)
            triangle[ties[same]] = own[found[same]]
        points[:, 2] = np.where(met, z, np.nan)
        piece = np.where(met, self.piece[triangle], -1)
        for _ in range(_BENT_STEPS if self._rises is not None else 0):
            distance, normal = self.from_pieces(points[met], piece[met])
            points[met, 2] -= distance / np.maximum(normal[:, 2], _STEEP)
        return piece, points

    def edges(self, chosen: Bools) -> Points:
        """Return the (e, 2, 3) ends of edges between the ``chosen`` (pieces,) and the others."""
        own = chosen[self.piece]
        others = {(int(b), int(a)) for a, b in Surface.directed_edges(self.surface.triangles[~own])}
        shared = [
            (int(a), int(b))
            for a, b in Surface.directed_edges(self.surface.triangles[own])
            if (int(a), int(b)) in others
        ]
        return np.asarray(self.surface.vertices[np.array(shared, np.int64).reshape(-1, 2)])

    def dents(self, crease_deg: float) -> Points:
        """Return the (e, 2, 3) ends of edges folded inwards by more than ``crease_deg``."""
        face = self._outward[:, FACE]
        ends, outward, cosine, own, other = _folds(self.surface.triangles, self._corners, face)
        folded = cosine < np.cos(np.radians(crease_deg))
        return np.asarray(ends[(outward > 0.0) & folded & (own < other)])

    @staticmethod
    def rises(surface: Surface, crease_deg: float) -> Floats | None:
        """Return (m, 3) how the bent triangles rise over their edges 01, 12, 20, mm, outwards
        positive; None if all are flat.

        Notes
        -----
        Over the barycentric coordinates b of a triangle its height is c01 b0 b1 + c12 b1 b2 + c20
        b2 b0, of an edge e between corners with normals n0 and n1 c = e . (n1 - n0) / 2: over the
        chord of a circle the sagitta c / 4 = e^2 / (8 R). Normals at corners weigh the faces as N.
        Max does (1999, J. Graphics Tools 4(2), 1), which is exact on a sphere and on strips of a
        cylinder. Edges sharper than ``crease_deg`` divide faces. Faces that are flat, as the top of
        a pad between its fillets, stay so: they are wider than their neighbours, and turn less
        against them.
        """
        corners = surface.vertices[surface.triangles]
        face, across = _face_normals(corners), _neighbours(surface.triangles)
        cosine = np.einsum("mi,msi->ms", face, face[across])
        smooth = cosine > np.cos(np.radians(crease_deg))
        turned = np.where(smooth, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0)
        turned[turned < _COPLANAR] = 0.0
        if not turned.any():
            return None
        sides = np.roll(corners, -1, axis=1) - corners
        length = np.linalg.norm(sides, axis=2)
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2.0
        everything = np.ones(len(face), bool)
        plane = Pieces.smooth_parts(surface, everything, math.degrees(_COPLANAR))
        flat = _flat_faces(plane, across, length, area, turned)[plane]
        several = np.bincount(plane)[plane] > 1
        whole = np.where(several, np.bincount(plane, area)[plane], 0.0)
        sheet = Pieces.smooth_parts(surface, everything, crease_deg)
        normal = _corner_normals(surface.triangles, sheet, sides, face, whole)
        rise = np.einsum("mki,mki->mk", sides, np.roll(normal, -1, axis=1) - normal) / 2.0
        # An edge rises at most by what turns against neighbours of about its own length allow.
        narrower = 2.0 * np.minimum(area[:, None], area[across]) / length
        away = np.cross(sides, face[:, None]) / length[:, :, None]
        over = np.abs(np.einsum("mei,mki->mek", sides, away))
        room = narrower[:, None]
        chord = np.where(over < _LONGER * room, np.minimum(over, room) ** 2 / room, 0.0)
        most = _MOST_RISE * np.einsum("mek,mk->me", chord, turned)
        beyond = np.argmax(across[across] == np.arange(len(face))[:, None, None], axis=2)
        most = np.where(smooth, np.maximum(most, most[across, beyond]), most)
        rise = np.clip(rise, -most, most)
        rise[flat] = 0.0
        return frozen(rise) if rise.any() else None

    @staticmethod
    def smooth_parts(surface: Surface, chosen: Bools, crease_deg: float) -> Ints:
        """Return (m,) parts into which ``chosen`` triangles fall at sharp edges, -1 for the
        others."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        corners = surface.vertices[surface.triangles]
        face = _face_normals(corners)
        across = _neighbours(surface.triangles)
        own = np.repeat(np.arange(len(face)), 3)
        other = across.ravel()
        joined = chosen[own] & chosen[other]
        joined &= np.einsum("ei,ei->e", face[own], face[other]) > np.cos(np.radians(crease_deg))
        graph = coo_matrix(
            (np.ones(int(joined.sum())), (own[joined], other[joined])), shape=(len(face), len(face))
        )
        _, part = connected_components(graph, directed=False)
        part = np.where(chosen, part, -1)
        _, number = np.unique(part, return_inverse=True)
        return np.asarray(number - int((~chosen).any()), np.int64)

    @staticmethod
    def edge_angles(vertices: Points, triangles: Ints) -> tuple[Floats, Floats]:
        """Return the inside angles (m, 3) at the edges of triangles, deg, and their ends (m, 3, 2,
        3)."""
        corners = vertices[triangles]
        ends, outward, cosine, _, _ = _folds(triangles, corners, _face_normals(corners))
        turned = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return np.where(outward <= 0.0, 180.0 - turned, 180.0 + turned), ends


def _heights(corners: Floats, rises: Floats, foot: Points) -> tuple[Floats, Floats]:
    """Return the heights (n,) of bent triangles over places (n, 3) of flat ones (n, 3, 3), and
    their slopes (n, 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(sides[:, 0], sides[:, 1])
    # Corner k faces the side from k + 1 to k + 2, along whose normal its coordinate grows.
    grows = np.cross(normal[:, None], np.roll(sides, -1, axis=1))
    grows /= np.einsum("ni,ni->n", normal, normal)[:, None, None]
    share = np.einsum("nki,nki->nk", grows, foot[:, None] - np.roll(corners, -1, axis=1))
    after = np.roll(share, -1, axis=1)
    slope = share[:, :, None] * np.roll(grows, -1, axis=1) + after[:, :, None] * grows
    height = np.einsum("nk,nk->n", rises, share * after)
    return height, np.einsum("nk,nki->ni", rises, slope)


def _flat_faces(plane: Ints, across: Ints, length: Floats, area: Floats, turned: Floats) -> Bools:
    """Return which of the ``plane`` faces, those of triangles (m,), are no chords of a curve."""
    other = plane[across]
    border = other != plane[:, None]
    count = int(plane.max()) + 1

    def total(each: Floats) -> Floats:
        return np.asarray(np.bincount(np.repeat(plane, 3), each.ravel(), count), float)

    wide = 2.0 * np.bincount(plane, area, count) / total(np.where(border, length, 0.0))
    joined = np.where(turned > 0.0, length, 0.0)
    all_joined = np.maximum(total(joined), 1e-300)
    turns = total(joined * turned) / all_joined
    wide_across = total(joined * wide[other]) / all_joined
    turns_across = total(joined * turns[other]) / all_joined
    several = np.bincount(plane) > 1
    return several & (wide * turns_across > _FLATTER * wide_across * turns)


def _corner_normals(
    triangles: Ints, sheet: Ints, sides: Floats, face: Floats, whole: Floats
) -> Floats:
    """Return (m, 3, 3) normals at the corners of triangles, each of its own smooth ``sheet`` (m,);
    next to plane faces much larger than others, those faces' own. ``whole`` (m,) are areas."""
    vertices = int(triangles.max()) + 1
    _, corner = np.unique(triangles + vertices * sheet[:, None], return_inverse=True)
    corner = corner.reshape(-1, 3)
    squared = np.einsum("mki,mki->mk", sides, sides)
    double = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    weight = double[:, None] / (squared * np.roll(squared, 1, axis=1))
    largest = np.zeros(int(corner.max()) + 1)
    np.maximum.at(largest, corner, whole[:, None])
    weight[_LARGER * np.maximum(whole, double / 2.0)[:, None] < largest[corner]] = 0.0
    normal = np.zeros((len(largest), 3))
    np.add.at(normal, corner, weight[:, :, None] * face[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(normal[corner])


def _face_normals(corners: Floats) -> Floats:
    """Return (m, 3) unit outward normals of triangles (m, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _neighbours(triangles: Ints) -> Ints:
    """Return (m, 3) the triangle across each edge 01, 12, 20 of a closed surface."""
    sides = Surface.directed_edges(triangles)
    count = int(triangles.max()) + 1
    key = sides[:, 0] * count + sides[:, 1]
    order = np.argsort(key)
    opposite = order[np.searchsorted(key, sides[:, 1] * count + sides[:, 0], sorter=order)]
    return np.asarray(opposite.reshape(-1, 3) // 3)


def _folds(
    triangles: Ints, corners: Floats, face: Floats
) -> tuple[Floats, Floats, Floats, Ints, Ints]:
    """Return for the three edges of m triangles: (m, 3, 2, 3) ends, (m, 3) how far the neighbour's
    middle stands out, the cosine between both normals, and (m, 3) both triangles."""
    own, side = np.meshgrid(np.arange(len(face)), np.arange(3), indexing="ij")
    other = _neighbours(triangles)
    ends = np.stack([corners[own, side], corners[own, (side + 1) % 3]], axis=2)
    outward = np.einsum("msi,mi->ms", corners[other].mean(axis=2) - ends[:, :, 0], face)
    return ends, outward, np.einsum("mi,msi->ms", face, face[other]), own, other


def _feature_normals(triangles: Ints, corners: Floats, piece: Ints) -> tuple[Floats, Bools]:
    """Return (m, 7, 3) outward normals of every feature of triangles, and (m, 7) which are on a
    border."""
    face, across = _face_normals(corners), _neighbours(triangles)
    sides = np.roll(corners, -1, axis=1) - corners
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    # Normals of corners: the mean of the faces' normals, weighted with their angles; the sign of
    # the distance is then right at corners too (Baerentzen and Aanaes 2005).
    angle = np.arccos(
        np.clip(-np.einsum("mki,mki->mk", sides, np.roll(sides, 1, axis=1)), -1.0, 1.0)
    )
    count = int(triangles.max()) + 1
    at_corner = np.zeros((count, 3))
    np.add.at(at_corner, triangles, angle[:, :, None] * face[:, None])
    at_edge = face[:, None] + face[across]
    outward = np.concatenate([face[:, None], at_corner[triangles], at_edge], axis=1)
    length = np.linalg.norm(outward, axis=2, keepdims=True)
    outward = np.where(length > 1e-12, outward / np.maximum(length, 1e-300), face[:, None])
    # Corners and edges where two pieces meet.
    lowest = np.full(count, np.iinfo(np.int64).max)
    highest = np.full(count, -1)
    np.minimum.at(lowest, triangles, piece[:, None])
    np.maximum.at(highest, triangles, piece[:, None])
    border = np.zeros((len(triangles), 7), bool)
    border[:, 1:4] = (lowest != highest)[triangles]
    border[:, 4:] = piece[across] != piece[:, None]
    return frozen(outward), frozen(border)
