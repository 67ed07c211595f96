"""A round dome: a spherical cap on a flat base, the shape of many fingertips and of soft pads.

The cap is part of one sphere, so depth is the exact distance to it, and any plane through the axis is a mirror plane.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Chart, Floats, Points
from twin.parts.shape import Body

FLATTEST = 0.3
"""Least height over radius: a flatter cap ends in so sharp a wedge at its rim that its elements fail the gates."""


class Dome(Body):
    """The part z <= height of a ball of ``radius_mm`` whose apex is the origin, bonded at its flat base z = height.

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
        low, high = FLATTEST * self.radius_mm, self.radius_mm
        if not low * (1 - 1e-12) <= self.height_mm <= high:
            raise ValueError(
                f"height_mm = {self.height_mm:g} mm must be {FLATTEST:g} to 1 radius ({low:g} to {high:g} mm); change "
                "height_mm or radius_mm"
            )
        return self

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("sensing", "held")

    @property
    def base_radius_mm(self) -> float:
        """Radius of the held base, mm."""
        return math.sqrt(self.height_mm * (2 * self.radius_mm - self.height_mm))

    def _from_centre(self, points: Points) -> tuple[Points, Floats]:
        away = np.asarray(points, float) - [0.0, 0.0, self.radius_mm]
        return away, np.linalg.norm(away, axis=1)

    def piece_distances(self, points: Points) -> Floats:
        away, distance = self._from_centre(points)
        return np.stack([self.radius_mm - distance, self.height_mm - self.radius_mm - away[:, 2]], axis=1)

    def piece_normals(self, points: Points) -> Floats:
        away, distance = self._from_centre(points)
        normals = np.zeros((len(away), 2, 3))
        normals[:, 0] = -away / np.maximum(distance, 1e-300)[:, None]
        normals[:, 1] = [0.0, 0.0, -1.0]
        return normals

    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        chart = np.asarray(chart, float)
        rho = np.linalg.norm(chart, axis=1)
        r = self.radius_mm - np.broadcast_to(np.asarray(depth_mm, float), rho.shape)
        sideways = r * np.sinc(rho / self.radius_mm / math.pi) / self.radius_mm
        return np.column_stack([sideways[:, None] * chart, self.radius_mm - r * np.cos(rho / self.radius_mm)])

    def chart_of(self, points: Points) -> Chart:
        away, _ = self._from_centre(points)
        length = np.linalg.norm(away[:, :2], axis=1)
        rho = self.radius_mm * np.arctan2(length, -away[:, 2])
        return np.asarray(away[:, :2] * (rho / np.where(length > 0, length, 1.0))[:, None])

    def surface_from_above(self, xy: Floats) -> Points:
        x, y = np.asarray(xy, float).T
        squared = self.radius_mm**2 - x**2 - y**2
        z = self.radius_mm - np.sqrt(np.where(squared >= 0, squared, np.nan))
        return np.column_stack([x, y, np.where(z <= self.height_mm, z, np.nan)])

    @property
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        a = self.base_radius_mm
        return (-a, -a, 0.0), (a, a, self.height_mm)

    @property
    def volume_mm3(self) -> float:
        return math.pi * self.height_mm**2 * (3 * self.radius_mm - self.height_mm) / 3
