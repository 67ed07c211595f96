"""The bodies of recipes: block, dome, finger, and a solid given by an STL file.

An STL file has no names for its faces, so a solid's recipe picks what is held and what is pressed
by a plane, a box or a direction (`Solid.Region`).

Validity: a solid's surface is the file's triangles, not the curved surface that they may stand for
(`twin.geometry.pieces`). Its surface coordinates are x and y, so that the pitch of markers and
sites is measured in the x, y plane. The mesh rounds sharp edges inside the sensing region.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Bools, Chart, Floats, Ints, Points, frozen
from twin.geometry.closed import FLAT, SIZE_MM
from twin.parts.part import Part
from twin.parts.shape import Body, Bounds, StlFile

if TYPE_CHECKING:
    from twin.geometry.closed import Surface
    from twin.geometry.pieces import Pieces


__all__ = ["AnyBody", "Block", "Body", "Dome", "Finger", "Solid"]

Vector = tuple[float, float, float]

_AXES = np.eye(3)
_INWARD = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], float)


class Block(Body):
    """A rectangular block, its sensing face z = 0 centred on the origin, bonded at z = thickness.

    Attributes
    ----------
    width_mm, length_mm, thickness_mm
        Extents along x, y and z.
    """

    shape: Literal["block"] = "block"
    width_mm: float = Field(ge=5, le=500)
    length_mm: float = Field(ge=5, le=500)
    thickness_mm: float = Field(ge=1, le=500)

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("sensing", "x_min", "x_max", "y_min", "y_max", "held")

    @property
    def layer_mm(self) -> float | None:
        return self.thickness_mm

    @property
    def is_flat(self) -> bool:
        return True

    def is_level_around(self, x_mm: float, y_mm: float, reach_mm: float) -> bool:
        return (
            abs(x_mm) + reach_mm < self.width_mm / 2 and abs(y_mm) + reach_mm < self.length_mm / 2
        )

    def piece_distances(self, points: Points) -> Floats:
        x, y, z = np.asarray(points, float).T
        a, b = self.width_mm / 2, self.length_mm / 2
        out = np.empty((6, len(x)))  # piece by piece: far quicker to fill, and to take the least of
        out[0], out[1], out[2], out[3], out[4] = z, x + a, a - x, y + b, b - y
        np.subtract(self.thickness_mm, z, out=out[5])
        return out.T

    def piece_normals(self, points: Points) -> Floats:
        return np.broadcast_to(_INWARD, (len(points), 6, 3))

    def frames(self, points: Points) -> Floats:
        out = np.empty((len(points), 3, 3))
        out[:] = _AXES
        return out

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        chart = np.asarray(chart, float)
        return np.column_stack([chart, np.broadcast_to(np.asarray(depth_mm, float), len(chart))])

    def chart_of(self, points: Points) -> Chart:
        return np.array(points, float)[:, :2]

    def surface_from_above(self, xy: Floats) -> Points:
        points = np.zeros((len(xy), 3))
        points[:, :2] = xy
        inside = self.contains(points, -1e-9)
        if not inside.all():
            points[~inside] = np.nan
        return points

    @property
    def bounds_mm(self) -> Bounds:
        a, b = self.width_mm / 2, self.length_mm / 2
        return (-a, -b, 0.0), (a, b, self.thickness_mm)

    @property
    def volume_mm3(self) -> float:
        return self.width_mm * self.length_mm * self.thickness_mm


class _Round(Body):
    """A body whose sensing surface lies ``radius_mm`` from a core; its other pieces are flat."""

    if TYPE_CHECKING:
        radius_mm: float

    @abstractmethod
    def _core(self, points: Points) -> Points:
        """Return the (n, 3) places of the core nearest to points."""

    @property
    @abstractmethod
    def _planes(self) -> tuple[tuple[Vector, float], ...]:
        """Inward normal of each flat piece, and its distance, mm, from the origin."""

    def _from_core(self, points: Points) -> tuple[Points, Floats]:
        away = np.asarray(points, float) - self._core(points)
        return away, np.linalg.norm(away, axis=1)

    def piece_distances(self, points: Points) -> Floats:
        _, distance = self._from_core(points)
        flat = [np.asarray(points, float) @ normal + offset for normal, offset in self._planes]
        return np.stack([self.radius_mm - distance, *flat], axis=1)

    def piece_normals(self, points: Points) -> Floats:
        away, distance = self._from_core(points)
        normals = np.zeros((len(away), len(self.pieces), 3))
        normals[:, 0] = -away / np.maximum(distance, 1e-300)[:, None]
        normals[:, 1:] = [normal for normal, _ in self._planes]
        return normals

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        start = np.column_stack([np.asarray(chart, float), np.zeros(len(chart))])
        core = self._core(start)[:, :2]
        bent = start[:, :2] - core
        rho = np.linalg.norm(bent, axis=1)
        r = self.radius_mm - np.broadcast_to(np.asarray(depth_mm, float), rho.shape)
        sideways = r * np.sin(rho / self.radius_mm) / np.where(rho > 0, rho, 1.0)
        height = self.radius_mm - r * np.cos(rho / self.radius_mm)
        return np.column_stack([core + sideways[:, None] * bent, height])

    def chart_of(self, points: Points) -> Chart:
        away, _ = self._from_core(points)
        length = np.linalg.norm(away[:, :2], axis=1)
        rho = self.radius_mm * np.arctan2(length, -away[:, 2])
        bent = away[:, :2] * (rho / np.where(length > 0, length, 1.0))[:, None]
        return np.asarray(self._core(points)[:, :2] + bent)

    def surface_from_above(self, xy: Floats) -> Points:
        points = np.column_stack([np.asarray(xy, float), np.zeros(len(xy))])
        away = points[:, :2] - self._core(points)[:, :2]
        squared = self.radius_mm**2 - (away**2).sum(axis=1)
        points[:, 2] = self.radius_mm - np.sqrt(np.where(squared >= 0, squared, np.nan))
        beyond = [points @ normal + offset < 0 for normal, offset in self._planes]
        points[np.any(beyond, axis=0), 2] = np.nan
        return points


FLATTEST = 0.3
"""Least height over radius: a flatter cap ends in so sharp a wedge at its rim that its elements
fail the gates."""


class Dome(_Round):
    """The part z <= height of a ball of ``radius_mm`` whose apex is the origin, bonded at its flat
    base z = height.

    Attributes
    ----------
    radius_mm
        Radius of curvature.
    height_mm
        From base to apex, 0.3 to 1 radius; a half ball at 1.
    """

    shape: Literal["dome"] = "dome"
    radius_mm: float = Field(ge=4, le=250)
    height_mm: float = Field(ge=1, le=250)

    @model_validator(mode="after")
    def _is_a_cap(self) -> Dome:
        low = FLATTEST * self.radius_mm
        high = self.radius_mm
        if not low * (1 - 1e-12) <= self.height_mm <= high:
            raise ValueError(
                f"height_mm = {self.height_mm:g} mm must be {FLATTEST:g} to 1 radius ({low:g} to "
                f"{high:g} mm); change height_mm or radius_mm"
            )
        return self

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("sensing", "held")

    @property
    def base_radius_mm(self) -> float:
        """Radius of the held base, mm."""
        return math.sqrt(self.height_mm * (2 * self.radius_mm - self.height_mm))

    def _core(self, points: Points) -> Points:
        return np.broadcast_to([0.0, 0.0, self.radius_mm], (len(points), 3))

    @property
    def _planes(self) -> tuple[tuple[Vector, float], ...]:
        return (((0.0, 0.0, -1.0), self.height_mm),)

    @property
    def bounds_mm(self) -> Bounds:
        a = self.base_radius_mm
        return (-a, -a, 0.0), (a, a, self.height_mm)

    @property
    def volume_mm3(self) -> float:
        return math.pi * self.height_mm**2 * (3 * self.radius_mm - self.height_mm) / 3


class Finger(_Round):
    """Half cylinder along x, quarter sphere at the tip (+x), straight skirt below: all points
    within ``radius_mm`` of the core C = {x <= 0, y = 0, z >= radius}, cut at x = -barrel and at z =
    radius + skirt, which is bonded.

    Attributes
    ----------
    radius_mm
        Radius of cylinder and sphere; the apex is the origin.
    barrel_mm
        Length of the cylindrical part, which ends flat at x = -barrel.
    skirt_mm
        Height of the straight part between the half cylinder and the base.
    back
        Whether the flat end is ``free`` or ``held``, bonded to something rigid.
    """

    shape: Literal["finger"] = "finger"
    radius_mm: float = Field(ge=2, le=100)
    barrel_mm: float = Field(ge=1, le=200)
    skirt_mm: float = Field(ge=0.5, le=100)
    back: Literal["free", "held"] = "free"

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("sensing", "back", "held")

    @property
    def held_pieces(self) -> tuple[int, ...]:
        return (2,) if self.back == "free" else (1, 2)

    def _core(self, points: Points) -> Points:
        x, _, z = np.asarray(points, float).T
        return np.column_stack([np.minimum(x, 0.0), 0.0 * x, np.maximum(z, self.radius_mm)])

    @property
    def _planes(self) -> tuple[tuple[Vector, float], ...]:
        return ((1.0, 0.0, 0.0), self.barrel_mm), ((0.0, 0.0, -1.0), self.base_z_mm)

    @property
    def base_z_mm(self) -> float:
        return self.radius_mm + self.skirt_mm

    @property
    def bounds_mm(self) -> Bounds:
        r = self.radius_mm
        return (-self.barrel_mm, -r, 0.0), (r, r, self.base_z_mm)

    @property
    def volume_mm3(self) -> float:
        r = self.radius_mm
        footprint = 2 * r * self.barrel_mm + math.pi * r**2 / 2
        return math.pi * r**2 / 2 * self.barrel_mm + math.pi * r**3 / 3 + footprint * self.skirt_mm


CREASE_DEG = 30.0
"""Neighbouring triangles that meet at a sharper angle belong to different pieces."""

MOST_PIECES = 40
"""Smooth pieces at most: every one is measured for every point."""

WINDOW_MM = 1e-2
"""How far the corners of held triangles may be from the base plane that a camera looks through."""

_ORIGIN_MM = 1e-3
_ROUNDED_MM = 1e-3  # to which corners in a file are rounded
_UPRIGHT = (
    "z points from the pressed surface, at z = 0, into the body: turn it in CAD if it does not"
)

_FACING = 0.1
"""Least share of a triangle's area seen along z for it to count as facing -z."""


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

    class Region(Part):
        """Triangles of a surface, picked by everything that is given here at once.

        Attributes
        ----------
        plane, box
            Triangles whose corners all lie near a plane, or in a box.
        normal, within_deg
            Triangles whose outward normal is at most ``within_deg`` from ``normal``.
        """

        class Plane(Part):
            """Triangles whose corners all lie within ``within_mm`` of a plane and that face along
            its ``normal``.

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

        class Box(Part):
            """Triangles whose corners all lie in a box between its lowest and highest corner."""

            low_mm: Vector
            high_mm: Vector

            @model_validator(mode="after")
            def _ordered(self) -> Self:
                for axis, low, high in zip("xyz", self.low_mm, self.high_mm, strict=True):
                    if low > high:
                        raise ValueError(
                            f"low_mm.{axis} = {low:g} mm must not be above high_mm.{axis} = "
                            f"{high:g} mm"
                        )
                return self

        plane: Plane | None = None
        box: Box | None = None
        normal: Vector | None = None
        within_deg: float = Field(default=45, gt=0, le=180)

        @model_validator(mode="after")
        def _picks_something(self) -> Self:
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
                away = np.abs((corners - self.plane.point_mm) @ outward).max(axis=1)
                chosen &= (away <= self.plane.within_mm) & (normal @ outward > 0.5)
            if self.box is not None:
                inside = (corners >= self.box.low_mm) & (corners <= self.box.high_mm)
                chosen &= inside.all(axis=(1, 2))
            if self.normal is not None:
                outward = np.array(self.normal) / np.linalg.norm(self.normal)
                chosen &= normal @ outward >= np.cos(np.radians(self.within_deg)) - 1e-12
            return chosen

    largest_mm = SIZE_MM

    shape: Literal["solid"] = "solid"
    origin_mm: Vector = (0.0, 0.0, 0.0)
    held: Region
    sensing: Region

    @model_validator(mode="after")
    def _regions_fit(self) -> Solid:
        corners, held, sensing = self._corners, self._held, self._pressed
        low, high = _as_text(corners.min(axis=(0, 1))), _as_text(corners.max(axis=(0, 1)))
        for name, chosen in (("held", held), ("sensing", sensing)):
            if not chosen.any():
                raise ValueError(
                    f"{name}: no triangle of the {len(corners)} is in it; the body lies between "
                    f"{low} and {high} mm: move or widen it, or set origin_mm; {_UPRIGHT}"
                )
        both = int((held & sensing).sum())
        if both:
            raise ValueError(f"held and sensing: {both} triangles are in both; narrow one of them")
        count = max(self._pieces.count, self._sheets.count)
        if count > MOST_PIECES:
            raise ValueError(
                f"file: sharp edges cut the surface into {count} pieces (allowed: {MOST_PIECES}); "
                "smooth it"
            )
        z = self.surface_from_above(np.zeros((1, 2)))[0, 2]
        if not abs(z) <= _ORIGIN_MM + 2.0 * self.chord_mm:
            seen = "not met there" if np.isnan(z) else f"met at z = {z:.6g} mm"
            raise ValueError(
                f"origin_mm = {_as_text(self.origin_mm)} mm: the sensing surface must be met there "
                f"from -z, at z = 0, but is {seen}; give a place of the file's sensing surface; "
                f"{_UPRIGHT}"
            )
        return self

    @cached_property
    def _surface(self) -> Surface:
        from twin.geometry.closed import Surface

        read = Surface.read(self.file)
        moved = frozen(read.vertices - self.origin_mm)
        return Surface(vertices=moved, triangles=read.triangles, volume_mm3=read.volume_mm3)

    @cached_property
    def _corners(self) -> Floats:
        """(m, 3, 3) corners of the surface's triangles."""
        return self._surface.vertices[self._surface.triangles]

    @cached_property
    def _held(self) -> Bools:
        """(m,) which triangles are held."""
        return self.held.picks(self._corners)

    @cached_property
    def _pressed(self) -> Bools:
        """(m,) which triangles may be pressed: the chosen ones that nothing hides."""
        return self.sensing.picks(self._corners) & ~self._hidden

    @cached_property
    def _hidden(self) -> Bools:
        """(m,) which of the chosen triangles face -z behind others, such as the walls of a hole;
        none of them if all do."""
        from twin.geometry.pieces import TriangleTree

        chosen, corners = self.sensing.picks(self._corners), self._corners
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = outward[:, 2] <= -_FACING * np.linalg.norm(outward, axis=1)
        asked = np.flatnonzero(chosen & facing)
        middle = corners[asked].mean(axis=1)
        along = np.broadcast_to([0.0, 0.0, 1.0], middle.shape)
        first = TriangleTree(corners).first_along(middle * [1, 1, 0], along)[1]
        hidden = np.zeros(len(corners), np.bool_)
        hidden[asked[first < middle[:, 2] - _ORIGIN_MM]] = True
        return hidden if hidden.sum() < chosen.sum() else np.zeros_like(hidden)

    @cached_property
    def _pieces(self) -> Pieces:
        """Triangles by piece: sensing, the smooth parts of the free sides, then those of what is
        held."""
        from twin.geometry.pieces import Pieces

        held, sensing = self._held, self._pressed
        free = Pieces.smooth_parts(self._surface, ~held & ~sensing, CREASE_DEG)
        fixed = Pieces.smooth_parts(self._surface, held, CREASE_DEG)
        number = np.where(held, int(free.max()) + 2 + fixed, 1 + free)
        return Pieces(self._surface, np.where(sensing, 0, number), self._rises)

    @cached_property
    def _sheets(self) -> Pieces:
        """Triangles by smooth sheet: sharp edges alone divide them."""
        from twin.geometry.pieces import Pieces

        everything = np.ones(len(self._surface.triangles), bool)
        parts = Pieces.smooth_parts(self._surface, everything, CREASE_DEG)
        return Pieces(self._surface, parts, self._rises)

    @cached_property
    def _rises(self) -> Floats | None:
        """(m, 3) how far triangles of curved faces are bent over their edges; None for none."""
        from twin.geometry.pieces import Pieces

        return Pieces.rises(self._surface, CREASE_DEG)

    @cached_property
    def _pieces_of_sheets(self) -> Bools:
        """(sheets, pieces) which pieces each sheet holds triangles of."""
        shared = np.zeros((self._sheets.count, self._pieces.count), bool)
        shared[self._sheets.piece, self._pieces.piece] = True
        return shared

    @cached_property
    def _first_held(self) -> int:
        return int(self._pieces.piece[self._held].min())

    @property
    def pieces(self) -> tuple[str, ...]:
        sides = [f"side_{k}" for k in range(1, self._first_held)]
        held = [f"held_{k}" for k in range(1, self._pieces.count - self._first_held)]
        return ("sensing", *sides, *held, "held")

    @property
    def sensing_sheets(self) -> Bools:
        return self._pieces_of_sheets[:, 0]

    @property
    def has_smooth_border(self) -> bool:
        return bool((self.sensing_sheets & self._pieces_of_sheets[:, 1:].any(axis=1)).any())

    def sheet_distances(self, points: Points) -> Floats:
        return self._sheets.distances_and_normals(points)[0]

    def sheet_normals(self, points: Points) -> Floats:
        return self._sheets.distances_and_normals(points)[1]

    def from_sheets(self, points: Points, sheet: Ints) -> tuple[Floats, Floats]:
        return self._sheets.from_pieces(points, sheet)

    def pieces_on(self, points: Points, sheet: Ints) -> Ints:
        return self._pieces.piece[self._sheets.nearest_triangles(points, sheet)]

    def sheets_of(self, corners: Floats, piece: Ints) -> Ints:
        faces, nodes = corners.shape[:2]
        away = np.abs(self.sheet_distances(corners.reshape(-1, 3))).reshape(faces, nodes, -1)
        shared = self._pieces_of_sheets.T[piece]
        return np.asarray(np.argmin(np.where(shared, away.max(axis=1), np.inf), axis=1))

    @property
    def held_pieces(self) -> tuple[int, ...]:
        return tuple(range(self._first_held, self._pieces.count))

    @property
    def has_window(self) -> bool:
        in_base = np.abs(self._corners[:, :, 2] - self.base_z_mm).max(axis=1) <= WINDOW_MM
        return bool((in_base & self._held).any())

    @property
    def is_flat(self) -> bool:
        return 0 in self._pieces.planes

    @property
    def layer_mm(self) -> float | None:
        if not self.is_flat:
            return None
        corners, held, pressed = self._corners, self._held, self._pressed
        room = FLAT * float(np.linalg.norm(np.ptp(corners, axis=(0, 1))))
        in_base = np.abs(corners[:, :, 2] - self.base_z_mm).max(axis=1) <= room
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(sides, axis=1) / 2.0
        fits = (
            np.abs(corners[pressed, :, 2]).max() <= room
            and corners[:, :, 2].min() >= -room
            and np.array_equal(in_base, held)
            and area[held].sum() >= (1.0 - FLAT) * area[pressed].sum()
        )
        return self.base_z_mm if fits else None

    @property
    def is_convex(self) -> bool:
        return self._pieces.is_convex

    def stands_out(self, points: Points, normals: Floats) -> Floats:
        if self.is_convex:
            return np.zeros(len(points))
        far = self._pieces.hull_vertices
        over = np.einsum("ni,ni->n", points, normals) - far @ normals.T
        squared = (far**2).sum(axis=1)[:, None] - 2.0 * far @ points.T + (points**2).sum(axis=1)
        rise = np.where(over > _ROUNDED_MM, over**2, 0.0) / np.maximum(squared, _ROUNDED_MM**2)
        return np.asarray(np.sqrt(rise.max(axis=0)))

    @property
    def own_surface(self) -> tuple[Points, Ints] | None:
        return self._surface.vertices, self._surface.triangles

    @property
    def own_rim(self) -> Floats | None:
        rim = self._pieces.edges(np.arange(self._pieces.count) >= self._first_held)
        return np.concatenate([rim, self._pieces.dents(CREASE_DEG)])

    def geometry(self) -> dict[str, Any]:
        kept = self.model_dump(include={"shape", "sha256", "origin_mm"})
        regions = self.model_dump(include={"held", "sensing"}, exclude_defaults=True)
        hidden = int(self._hidden.sum())
        bent = {} if self._rises is None else {"bent": True}
        return kept | regions | ({"hidden": hidden} if hidden else {}) | bent

    def piece_distances(self, points: Points) -> Floats:
        return self._pieces.distances_and_normals(points)[0]

    def piece_normals(self, points: Points) -> Floats:
        return self._pieces.distances_and_normals(points)[1]

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        chart = np.asarray(chart, float)
        depth = np.broadcast_to(np.asarray(depth_mm, float), len(chart))
        points = self.surface_from_above(chart)
        missing = np.isnan(points[:, 2])
        # Outside the body, which the caller then reports.
        points[missing, 2] = self.bounds_mm[0][2] - 1.0
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
    def bounds_mm(self) -> Bounds:
        low, high = self._surface.vertices.min(axis=0), self._surface.vertices.max(axis=0)
        return tuple(low.tolist()), tuple(high.tolist())

    @cached_property
    def volume_mm3(self) -> float:
        volume = self._surface.volume_mm3
        if self._rises is not None:  # the mean of a product of two coordinates is a twelfth
            a, b, c = self._corners.transpose(1, 0, 2)
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
            volume += float(areas @ self._rises.sum(axis=1) / 12.0)
        return volume

    @cached_property
    def chord_mm(self) -> float:
        return 0.0 if self._rises is None else float(np.abs(self._rises).max() / 4.0)


def _as_text(place: Any) -> str:
    return "(" + ", ".join(f"{c:.6g}" for c in place) + ")"


AnyBody = Annotated[Block | Dome | Finger | Solid, Field(discriminator="shape")]
