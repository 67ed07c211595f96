"""The body of Sato's sensor: half cylinder, quarter sphere, skirt."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from twin.arrays import Chart, Floats, Points
from twin.parts.shape import Body


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
