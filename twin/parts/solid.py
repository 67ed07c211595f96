"""A body of the user's own, given by the closed triangles of an STL file, and which part of it is held and pressed.

Why regions and not names: an STL file is a heap of triangles, it can't say which of them are bonded to the base. So the
recipe picks them by a plane, a box, or the direction they face; what is neither held nor sensing is free.

The file is read, and its digest kept, when the recipe is: a run never mixes two versions of it, and a digest given in
the recipe (`sha256`, which written-out scenes carry) must match.

Validity: the surface is the file's triangles, not the curved surface they may stand for: export curved parts finely
(`twin.geometry.pieces` says what is lost). The chart is plain x and y, so the pitch of markers and sites is measured in
the x, y plane, not along a slope. Sharp edges inside the sensing region are rounded by the mesh.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Bools, Chart, Floats, Ints, Points, frozen
from twin.geometry.closed import SIZE_MM
from twin.parts.part import Part
from twin.parts.shape import Body
from twin.parts.stl_file import StlFile

if TYPE_CHECKING:
    from twin.geometry.closed import Surface
    from twin.geometry.pieces import Pieces

Vector = tuple[float, float, float]

CREASE_DEG = 30.0
"""Neighbouring triangles that meet at a sharper angle belong to different pieces."""

MOST_PIECES = 40
"""Smooth pieces at most: every one is measured for every point."""

WINDOW_MM = 1e-2
"""How far the corners of held triangles may be from the base plane that a camera looks through."""

_ORIGIN_MM = 1e-3


class PlaneRegion(Part):
    """Triangles whose corners all lie within ``within_mm`` of a plane and that face along its ``normal``.

    Attributes
    ----------
    point_mm
        A point of the plane.
    normal
        Out of the body; any length.
    within_mm
        Distance allowed.
    """

    point_mm: Vector
    normal: Vector
    within_mm: float = Field(default=0.01, gt=0, le=10)


class BoxRegion(Part):
    """Triangles whose corners all lie in a box."""

    low_mm: Vector
    high_mm: Vector


class Region(Part):
    """Triangles of a surface, picked by everything that is given here at once.

    Attributes
    ----------
    plane, box
        See `PlaneRegion` and `BoxRegion`.
    normal, within_deg
        Triangles whose outward normal is at most ``within_deg`` from ``normal``.
    """

    plane: PlaneRegion | None = None
    box: BoxRegion | None = None
    normal: Vector | None = None
    within_deg: float = Field(default=45, gt=0, le=180)

    @model_validator(mode="after")
    def _picks_something(self) -> Region:
        if self.plane is None and self.box is None and self.normal is None:
            raise ValueError("give at least one of plane, box and normal")
        for normal in (self.normal, self.plane.normal if self.plane else None):
            if normal is not None and not any(normal):
                raise ValueError("normal must not be (0, 0, 0): give the outward direction")
        return self

    def picks(self, corners: Floats) -> Bools:
        """Return (m,) which of the triangles (m, 3, 3) are in the region."""
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        chosen = np.ones(len(corners), bool)
        if self.plane is not None:
            outward = np.array(self.plane.normal) / np.linalg.norm(self.plane.normal)
            near = np.abs((corners - self.plane.point_mm) @ outward).max(axis=1) <= self.plane.within_mm
            chosen &= near & (normal @ outward > 0.5)
        if self.box is not None:
            chosen &= ((corners >= self.box.low_mm) & (corners <= self.box.high_mm)).all(axis=(1, 2))
        if self.normal is not None:
            outward = np.array(self.normal) / np.linalg.norm(self.normal)
            chosen &= normal @ outward >= np.cos(np.radians(self.within_deg)) - 1e-12
        return chosen


class Solid(StlFile, Body):
    """The inside of a closed STL surface.

    Attributes
    ----------
    file
        STL file in mm, relative to the recipe.
    sha256
        Digest of the file; filled in when it is read, checked when it is given.
    origin_mm
        The file's place that becomes the origin; there the sensing surface must be met from -z.
    held
        What is bonded to a rigid base.
    sensing
        What may be pressed.
    """

    largest_mm = SIZE_MM

    shape: Literal["solid"] = "solid"
    origin_mm: Vector = (0.0, 0.0, 0.0)
    held: Region
    sensing: Region

    @model_validator(mode="after")
    def _regions_fit(self) -> Solid:
        corners = self._surface.vertices[self._surface.triangles]
        held, sensing = self.held.picks(corners), self.sensing.picks(corners)
        low, high = _told(corners.min(axis=(0, 1))), _told(corners.max(axis=(0, 1)))
        for name, chosen in (("held", held), ("sensing", sensing)):
            if not chosen.any():
                raise ValueError(
                    f"{name}: no triangle of the {len(corners)} is in it; the body lies between {low} and {high} mm: "
                    "move or widen it"
                )
        both = int((held & sensing).sum())
        if both:
            raise ValueError(f"held and sensing: {both} triangles are in both; narrow one of them")
        count = self._pieces.count
        if count > MOST_PIECES:
            raise ValueError(
                f"file: sharp edges cut the surface into {count} pieces (allowed: {MOST_PIECES}); smooth it"
            )
        z = self.surface_from_above(np.zeros((1, 2)))[0, 2]
        if not abs(z) <= _ORIGIN_MM:
            seen = "not met there" if np.isnan(z) else f"met at z = {z:.6g} mm"
            raise ValueError(
                f"origin_mm = {_told(self.origin_mm)} mm: the sensing surface must be met there from -z, at z = 0, but "
                f"is {seen}; give a place of the file's sensing surface"
            )
        return self

    @cached_property
    def _surface(self) -> Surface:
        from twin.geometry.closed import Surface, read_surface

        read = read_surface(self.file)
        moved = frozen(read.vertices - self.origin_mm)
        return Surface(vertices=moved, triangles=read.triangles, volume_mm3=read.volume_mm3)

    @cached_property
    def _pieces(self) -> Pieces:
        """Triangles by piece: sensing, the smooth parts of the free sides, then those of what is held."""
        from twin.geometry.pieces import Pieces, smooth_parts

        corners = self._surface.vertices[self._surface.triangles]
        held, sensing = self.held.picks(corners), self.sensing.picks(corners)
        free = smooth_parts(self._surface, ~held & ~sensing, CREASE_DEG)
        fixed = smooth_parts(self._surface, held, CREASE_DEG)
        number = np.where(held, int(free.max()) + 2 + fixed, 1 + free)
        return Pieces(self._surface, np.where(sensing, 0, number))

    @cached_property
    def _first_held(self) -> int:
        held = self.held.picks(self._surface.vertices[self._surface.triangles])
        return int(self._pieces.piece[held].min())

    @property
    def pieces(self) -> tuple[str, ...]:
        sides = [f"side_{k}" for k in range(1, self._first_held)]
        held = [f"held_{k}" for k in range(1, self._pieces.count - self._first_held)]
        return ("sensing", *sides, *held, "held")

    @property
    def held_pieces(self) -> tuple[int, ...]:
        return tuple(range(self._first_held, self._pieces.count))

    @property
    def has_window(self) -> bool:
        corners = self._surface.vertices[self._surface.triangles]
        in_base = np.abs(corners[:, :, 2] - self.base_z_mm).max(axis=1) <= WINDOW_MM
        return bool((in_base & self.held.picks(corners)).any())

    @property
    def is_flat(self) -> bool:
        return 0 in self._pieces.planes

    @property
    def is_convex(self) -> bool:
        return self._pieces.is_convex

    def stands_out(self, points: Points, normals: Floats) -> Floats:
        if self.is_convex:
            return np.zeros(len(points))
        height = self._pieces.hull_vertices @ normals.T - np.einsum("ni,ni->n", points, normals)
        return np.asarray(np.maximum(-height.min(axis=0), 0.0))

    @property
    def own_surface(self) -> tuple[Points, Ints] | None:
        return self._surface.vertices, self._surface.triangles

    @property
    def own_rim(self) -> Floats | None:
        rim = self._pieces.edges(np.arange(self._pieces.count) >= self._first_held)
        return np.concatenate([rim, self._pieces.dents(CREASE_DEG)])

    def geometry(self) -> dict[str, Any]:
        regions = {name: getattr(self, name).model_dump(exclude_defaults=True) for name in ("held", "sensing")}
        return {"shape": self.shape, "sha256": self.sha256, "origin_mm": self.origin_mm, **regions}

    def piece_distances(self, points: Points) -> Floats:
        return self._pieces.distances_and_normals(points)[0]

    def piece_normals(self, points: Points) -> Floats:
        return self._pieces.distances_and_normals(points)[1]

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        chart = np.asarray(chart, float)
        depth = np.broadcast_to(np.asarray(depth_mm, float), len(chart))
        points = self.surface_from_above(chart)
        missing = np.isnan(points[:, 2])
        points[missing, 2] = self.bounds_mm[0][2] - 1.0  # outside the body, so that whoever asked is told so
        for _ in range(60):
            distance, normal = self._pieces.distances_and_normals(points)
            step = (depth - distance[:, 0]) / np.maximum(normal[:, 0, 2], 0.05)
            step[missing] = 0.0
            points[:, 2] += step
            if np.max(np.abs(step), initial=0.0) < 1e-12:
                break
        return points

    def chart_of(self, points: Points) -> Chart:
        return np.array(points, float)[:, :2]

    def surface_from_above(self, xy: Floats) -> Points:
        piece, points = self._pieces.from_below(np.asarray(xy, float))
        points[piece != 0, 2] = np.nan
        return points

    @property
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        low, high = self._surface.vertices.min(axis=0), self._surface.vertices.max(axis=0)
        return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))

    @property
    def volume_mm3(self) -> float:
        return self._surface.volume_mm3


def _told(place: Any) -> str:
    return "(" + ", ".join(f"{c:.6g}" for c in place) + ")"
