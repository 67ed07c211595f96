"""Where a rigid probe is, and how far each surface point is from it.

The probe's place is q = (x, y, z, turn): millimetres from where its axis was given and from first touch, and radians
about its own axis. The gap of a surface point is measured along the point's normal to the exact shape of the probe
(not its parabola). Why along the normal: it is the direction in which the pressure acts and in which the linear
theory moves the point; on a flat body it is the vertical distance, so that pushing along z changes it exactly by z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.press import Cylinder, Pillar, Probe, Sphere

X, Y, Z, TURN = range(4)
MOTIONS = 4
_LEVELS, _ACROSS = 14, 25


@dataclass(frozen=True, kw_only=True)
class Approach:
    """A probe that just touches a body.

    Attributes
    ----------
    probe
        The rigid probe.
    axis_mm
        (x, y, z) of the probe's lowest point on its axis at first touch.
    touch_mm
        (3,) surface point that is touched first (the middle of them if there are many).
    """

    probe: Probe
    axis_mm: tuple[float, float, float]
    touch_mm: Floats

    def gap(self, points: Points, normals: Floats, place: Floats) -> tuple[Floats, Floats]:
        """Return gaps along the outward normals and their derivatives with respect to the probe's place.

        Parameters
        ----------
        points, normals
            (k, 3) points of the undeformed surface, mm, and their unit inward normals.
        place
            (4,) x, y, z (mm) and turn (radians).

        Returns
        -------
        gap
            (k,) mm; negative where the probe would overlap the undeformed body, inf where it can't be met.
        slope
            (k, 4) d gap / d place.
        """
        lowest = np.asarray(self.axis_mm) + place[:3]
        if isinstance(self.probe, Sphere):
            return _sphere_gap(points, normals, lowest, self.probe.diameter_mm / 2)
        return _face_gap(self.probe, points, normals, lowest, float(place[TURN]))


def _sphere_gap(points: Points, normals: Floats, lowest: Floats, radius: float) -> tuple[Floats, Floats]:
    away = points - (lowest - [0.0, 0.0, radius])
    along = np.einsum("ki,ki->k", away, normals)
    inside = along**2 - np.einsum("ki,ki->k", away, away) + radius**2
    met = inside > 1e-6 * radius**2
    gap = np.where(met, along - np.sqrt(np.where(met, inside, 1.0)), np.inf)
    # The probe's normal e where the ray meets it: a motion dc of the probe changes the gap by -(e . dc) / (e . n).
    probe_normal = np.where(met[:, None], (away - np.where(met, gap, 0.0)[:, None] * normals) / radius, normals)
    slope = np.zeros((len(points), 4))
    slope[:, :3] = -probe_normal / np.einsum("ki,ki->k", probe_normal, normals)[:, None]
    slope[~met] = 0.0
    return gap, slope


def _face_gap(
    probe: Cylinder | Pillar, points: Points, normals: Floats, lowest: Floats, turn: float
) -> tuple[Floats, Floats]:
    upright = np.maximum(normals[:, 2], 1e-9)
    gap = (points[:, 2] - lowest[2]) / upright
    over = points - gap[:, None] * normals - lowest
    met = (normals[:, 2] > 1e-3) & within_footprint(probe, over[:, :2], turn)
    slope = np.zeros((len(points), 4))
    slope[met, Z] = -1.0 / upright[met]
    return np.where(met, gap, np.inf), slope


def within_footprint(probe: Cylinder | Pillar, offset_mm: Floats, turn: float) -> np.ndarray:
    """Return (k,) whether horizontal offsets (k, 2) from the axis lie under the flat face, its border included.

    The border is forgiven half a per cent: a patch whose middle is there belongs to the face by construction.
    """
    if isinstance(probe, Cylinder):
        return np.asarray(np.hypot(offset_mm[:, 0], offset_mm[:, 1]) <= probe.diameter_mm / 2 * 1.005)
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = np.abs(offset_mm @ np.array([[cosine, -sine], [sine, cosine]]))
    return np.asarray(np.all(turned <= np.array(probe.size_mm) / 2 * 1.005, axis=1))


def outline(probe: Probe) -> Floats:
    """Return (16, 2) offsets from the axis around the probe's flat face; none for a sphere."""
    if isinstance(probe, Sphere):
        return np.zeros((0, 2))
    angle = np.arange(16) * math.pi / 8
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    if isinstance(probe, Pillar):
        around /= np.abs(around).max(axis=1, keepdims=True)
    return np.asarray(around * half_extent(probe))


def half_extent(probe: Probe) -> tuple[float, float]:
    """Return the probe's half sizes along its own first and second axis, mm."""
    if isinstance(probe, Pillar):
        return probe.size_mm[0] / 2, probe.size_mm[1] / 2
    return probe.diameter_mm / 2, probe.diameter_mm / 2


def rise(probe: Probe, offset_mm: Floats, turn: float) -> Floats:
    """Return (k,) how far the probe's lower side is above its lowest point at horizontal offsets (k, 2), mm."""
    if isinstance(probe, Sphere):
        radius = probe.diameter_mm / 2
        squared = radius**2 - offset_mm[:, 0] ** 2 - offset_mm[:, 1] ** 2
        return np.where(squared >= 0, radius - np.sqrt(np.maximum(squared, 0.0)), np.inf)
    return np.where(within_footprint(probe, offset_mm, turn), 0.0, np.inf)


def approach(probe: Probe, body: Body, at_mm: tuple[float, float], turn: float = 0.0) -> Approach:
    """Lower a probe along z onto a body until it touches.

    Parameters
    ----------
    probe, body
        The rigid probe and the undeformed body.
    at_mm
        (x, y) of the probe's axis.
    turn
        Turn of the probe about its axis, radians.

    Raises
    ------
    InputError
        The probe misses the sensing surface.

    Notes
    -----
    The smallest height of the surface over the probe is found on grids that shrink around the minimum; ties (a flat
    face on a flat body, or along a barrel) are averaged.
    """
    reach = np.array(half_extent(probe))
    if isinstance(probe, Pillar):
        reach = np.full(2, np.hypot(*reach))
    centre, half = np.asarray(at_mm, float), reach
    height, touch = np.inf, np.full(2, np.nan)
    for _ in range(_LEVELS):
        steps = np.linspace(-1.0, 1.0, _ACROSS)
        xy = centre + np.stack(np.meshgrid(steps * half[0], steps * half[1]), axis=-1).reshape(-1, 2)
        height_here = body.surface_from_above(xy)[:, 2] + rise(probe, xy - at_mm, turn)
        height_here = np.where(np.isfinite(height_here), height_here, np.inf)
        lowest = float(height_here.min())
        if not math.isfinite(lowest):
            break
        middle = xy[height_here <= lowest + 1e-12].mean(axis=0)
        if lowest < height:
            height, touch = lowest, middle
        centre, half = touch, half / 3
    if not math.isfinite(height):
        (x0, y0, _), (x1, y1, _) = body.bounds_mm
        raise InputError(
            f"the {probe.kind} at ({at_mm[0]:g}, {at_mm[1]:g}) mm misses the sensing surface, which lies within "
            f"x {x0:g} to {x1:g} mm and y {y0:g} to {y1:g} mm: move at_mm or the step's motion over the body"
        )
    point = body.surface_from_above(touch[None])[0]
    return Approach(probe=probe, axis_mm=(float(at_mm[0]), float(at_mm[1]), height), touch_mm=point)
