"""Bodies: their shape as level sets, so that surface, cover, marker layers and meshes all read one formula.

Why level sets: depth below the outer sensing surface is an exact distance for both sensors, so the marker layers, the
cover and the snapping of mesh nodes need no triangles, and a new body is one class with three formulas.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from twin.arrays import Bools, Chart, Floats, Points
from twin.parts.part import Part


class Body(Part):
    """A solid, held on some pieces of its boundary, pressed on another.

    Attributes
    ----------
    pieces
        Names of the smooth pieces of the boundary, in the order of `piece_distances`; ``sensing`` comes first,
        ``held``, the base, last.
    """

    pieces: ClassVar[tuple[str, ...]]

    @abstractmethod
    def piece_distances(self, points: Points) -> Floats:
        """Return (n, pieces) distances in mm to every boundary piece, positive on the inner side."""

    @abstractmethod
    def piece_normals(self, points: Points) -> Floats:
        """Return (n, pieces, 3) unit inward normals: the gradients of `piece_distances`."""

    @abstractmethod
    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        """Return the (n, 3) points at arc lengths (s, t) on the outer surface, ``depth_mm`` below it."""

    @abstractmethod
    def chart_of(self, points: Points) -> Chart:
        """Return the (n, 2) arc lengths (s, t) of the surface points above ``points``: inverse of `chart_points`."""

    @abstractmethod
    def surface_from_above(self, xy: Floats) -> Points:
        """Return the (n, 3) points of the sensing surface met from -z at (x, y); NaN where there is none."""

    @property
    @abstractmethod
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Lowest and highest corner of the box around the body, mm."""

    @property
    @abstractmethod
    def volume_mm3(self) -> float:
        """Exact volume."""

    @property
    def held_pieces(self) -> tuple[int, ...]:
        """Indices into `pieces` of the pieces that are bonded to something rigid; all others are free."""
        return (len(self.pieces) - 1,)

    @property
    def base_z_mm(self) -> float:
        """Height of the held base plane, mm; the camera looks through it."""
        return self.bounds_mm[1][2]

    def depth(self, points: Points) -> Floats:
        """Return (n,) depths below the outer sensing surface, mm, positive inside."""
        return self.piece_distances(points)[:, 0]

    def contains(self, points: Points, margin_mm: float = 0.0) -> Bools:
        """Return (n,) whether each point is at least ``margin_mm`` inside (a negative margin forgives round-off)."""
        return np.asarray(np.all(self.piece_distances(points) >= margin_mm, axis=1))

    def frames(self, points: Points) -> Floats:
        """Return (n, 3, 3) right-handed frames at surface points: rows are tangent s, tangent t, inward normal."""
        normal = self.piece_normals(points)[:, 0]
        along_s = np.array([1.0, 0.0, 0.0]) - normal[:, :1] * normal
        length = np.linalg.norm(along_s, axis=1, keepdims=True)
        along_s = np.where(length > 1e-9, along_s / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
        return np.stack([along_s, np.cross(normal, along_s), normal], axis=1)


class Block(Body):
    """A rectangular block, its sensing face z = 0 centred on the origin, bonded at z = thickness.

    Attributes
    ----------
    width_mm, length_mm, thickness_mm
        Extents along x, y and z.
    """

    pieces: ClassVar[tuple[str, ...]] = ("sensing", "x_min", "x_max", "y_min", "y_max", "held")
    shape: Literal["block"] = "block"
    width_mm: float = Field(ge=5, le=500)
    length_mm: float = Field(ge=5, le=500)
    thickness_mm: float = Field(ge=1, le=500)

    def piece_distances(self, points: Points) -> Floats:
        x, y, z = np.asarray(points, float).T
        a, b = self.width_mm / 2, self.length_mm / 2
        return np.stack([z, x + a, a - x, y + b, b - y, self.thickness_mm - z], axis=1)

    def piece_normals(self, points: Points) -> Floats:
        inward = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], float)
        return np.broadcast_to(inward, (len(points), 6, 3))

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        chart = np.asarray(chart, float)
        return np.column_stack([chart, np.broadcast_to(np.asarray(depth_mm, float), len(chart))])

    def chart_of(self, points: Points) -> Chart:
        return np.array(points, float)[:, :2]

    def surface_from_above(self, xy: Floats) -> Points:
        points = self.chart_points(xy)
        points[~self.contains(points, -1e-9)] = np.nan
        return points

    @property
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        a, b = self.width_mm / 2, self.length_mm / 2
        return (-a, -b, 0.0), (a, b, self.thickness_mm)

    @property
    def volume_mm3(self) -> float:
        return self.width_mm * self.length_mm * self.thickness_mm


class Finger(Body):
    """Half cylinder along x, quarter sphere at the tip (+x), straight skirt below: all points within ``radius_mm`` of
    the core C = {x <= 0, y = 0, z >= radius}, cut at x = -barrel and at z = radius + skirt, which is bonded.

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

    pieces: ClassVar[tuple[str, ...]] = ("sensing", "back", "held")
    shape: Literal["finger"] = "finger"
    radius_mm: float = Field(ge=2, le=100)
    barrel_mm: float = Field(ge=1, le=200)
    skirt_mm: float = Field(ge=0.5, le=100)
    back: Literal["free", "held"] = "free"

    @property
    def held_pieces(self) -> tuple[int, ...]:
        return (2,) if self.back == "free" else (1, 2)

    def _from_core(self, points: Points) -> tuple[Floats, Floats]:
        points = np.asarray(points, float)
        core = np.zeros_like(points)
        core[:, 0] = np.minimum(points[:, 0], 0.0)
        core[:, 2] = np.maximum(points[:, 2], self.radius_mm)
        away = points - core
        return away, np.linalg.norm(away, axis=1)

    def piece_distances(self, points: Points) -> Floats:
        points = np.asarray(points, float)
        _, distance = self._from_core(points)
        return np.stack(
            [self.radius_mm - distance, points[:, 0] + self.barrel_mm, self.base_z_mm - points[:, 2]], axis=1
        )

    def piece_normals(self, points: Points) -> Floats:
        away, distance = self._from_core(points)
        normals = np.zeros((len(away), 3, 3))
        normals[:, 0] = -away / np.maximum(distance, 1e-300)[:, None]
        normals[:, 1] = [1.0, 0.0, 0.0]
        normals[:, 2] = [0.0, 0.0, -1.0]
        return normals

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        s, t = np.asarray(chart, float).T
        radius = self.radius_mm
        r = radius - np.broadcast_to(np.asarray(depth_mm, float), s.shape)
        rho = np.where(s > 0, np.hypot(s, t), np.abs(t))
        safe = np.where(rho > 0, rho, 1.0)
        along = r * np.sin(rho / radius) / safe
        x = np.where(s > 0, along * s, s)
        return np.column_stack([x, along * t, radius - r * np.cos(rho / radius)])

    def chart_of(self, points: Points) -> Chart:
        away, _distance = self._from_core(points)
        sideways = np.where(away[:, :1] > 0, away[:, :2], away[:, :2] * [0.0, 1.0])
        length = np.linalg.norm(sideways, axis=1)
        rho = self.radius_mm * np.arctan2(length, -away[:, 2])
        chart = sideways * (rho / np.where(length > 0, length, 1.0))[:, None]
        chart[:, 0] += np.minimum(np.asarray(points, float)[:, 0], 0.0)
        return np.asarray(chart)

    def surface_from_above(self, xy: Floats) -> Points:
        x, y = np.asarray(xy, float).T
        squared = self.radius_mm**2 - y**2 - np.maximum(x, 0.0) ** 2
        z = self.radius_mm - np.sqrt(np.where(squared >= 0, squared, np.nan))
        return np.column_stack([x, y, np.where(x >= -self.barrel_mm, z, np.nan)])

    @property
    def base_z_mm(self) -> float:
        return self.radius_mm + self.skirt_mm

    @property
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        r = self.radius_mm
        return (-self.barrel_mm, -r, 0.0), (r, r, self.base_z_mm)

    @property
    def volume_mm3(self) -> float:
        r = self.radius_mm
        footprint = 2 * r * self.barrel_mm + math.pi * r**2 / 2
        return math.pi * r**2 / 2 * self.barrel_mm + math.pi * r**3 / 3 + footprint * self.skirt_mm


AnyBody = Annotated[Block | Finger, Field(discriminator="shape")]
