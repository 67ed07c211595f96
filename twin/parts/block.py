"""The flat body of Kamiyama's sensor: a rectangular block."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from twin.arrays import Chart, Floats, Points
from twin.parts.shape import Body

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
    def is_flat(self) -> bool:
        return True

    def is_level_around(self, x_mm: float, y_mm: float, reach_mm: float) -> bool:
        return abs(x_mm) + reach_mm < self.width_mm / 2 and abs(y_mm) + reach_mm < self.length_mm / 2

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
    def bounds_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        a, b = self.width_mm / 2, self.length_mm / 2
        return (-a, -b, 0.0), (a, b, self.thickness_mm)

    @property
    def volume_mm3(self) -> float:
        return self.width_mm * self.length_mm * self.thickness_mm
