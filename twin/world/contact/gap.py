"""Where a rigid probe is, and how far each surface point is from it.

The probe's place is q = (x, y, z, about x, about y, turn): millimetres from first touch and radians, along and about
its own axes, whose z is its direction of approach. The turns are one rotation vector about the place of its lowest
point. The gap of a surface point is measured along the point's normal to the exact shape of the probe (not its
parabola). Why along the normal: it is the direction in which the pressure acts and in which the linear theory moves the
point; on a flat body it is the vertical distance, so that pushing along z changes it exactly by z.

Validity: the gap is exact for any turn, but forces act along the normals of the undeformed surface and arms count from
where the probe first touched, so turns about x and y should stay small (a few degrees).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Floats, Points
from twin.compiled import njit
from twin.parts.press import Probe
from twin.parts.probe import Cylinder, Pillar
from twin.world.contact.probe_shape import Shape, half_extent, is_flat, rotation_of, shape_of, turning_of

X, Y, Z, ABOUT_X, ABOUT_Y, TURN = range(6)
MOTIONS = 6

_NO_TURN = np.eye(3)


@dataclass(frozen=True, kw_only=True)
class Approach:
    """A probe that just touches a body.

    Attributes
    ----------
    probe, tilt_deg
        The rigid probe, and its turn about its own axes before it comes.
    axes
        (3, 3) its own axes as rows; the last one is the direction of approach.
    axis_mm
        (3,) the place of its lowest point (before it was tilted) at first touch; torques count about it.
    touch_mm
        (3,) surface point that is touched first (the middle of them if there are many).
    level
        Whether it is known that the surface is as high everywhere under the probe.
    """

    probe: Probe
    axis_mm: Floats
    touch_mm: Floats
    axes: Floats
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    level: bool = False

    @cached_property
    def shape(self) -> Shape:
        """The probe's surface."""
        return shape_of(self.probe, self.tilt_deg)

    @cached_property
    def is_flat(self) -> bool:
        """Whether the probe touches with a flat face, so that its footprint bounds the contact."""
        return is_flat(self.probe, self.tilt_deg)

    def gap(self, points: Points, normals: Floats, place: Floats) -> tuple[Floats, Floats]:
        """Return gaps along the outward normals and their derivatives with respect to the probe's place.

        Parameters
        ----------
        points, normals
            (k, 3) points of the undeformed surface, mm, and their unit inward normals.
        place
            (6,) q.

        Returns
        -------
        gap
            (k,) mm; negative where the probe would overlap the undeformed body, inf where it can't be met.
        slope
            (k, 6) d gap / d place.
        """
        own, along = _seen_from(points, normals, self.axis_mm, self.axes, place)
        turn = place[ABOUT_X:]
        if not turn.any():
            gap, normal = self.shape.met(own, along)
            return gap, _slopes(own, along, gap, normal, _NO_TURN, _NO_TURN)
        turned = rotation_of(turn)
        gap, normal = self.shape.met(_turned(own, turned), _turned(along, turned))
        return gap, _slopes(own, along, gap, normal, turned, turning_of(turn))


@njit(cache=True)
def _turned(vectors: Floats, axes: Floats) -> Floats:
    """Return the product of (k, 3) vectors with (3, 3) axes; for so few numbers faster than NumPy's."""
    out = np.empty((len(vectors), 3))
    for i in range(len(vectors)):
        for j in range(3):
            out[i, j] = vectors[i, 0] * axes[0, j] + vectors[i, 1] * axes[1, j] + vectors[i, 2] * axes[2, j]
    return out


@njit(cache=True)
def _seen_from(points: Floats, normals: Floats, axis_mm: Floats, axes: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Return points and normals (k, 3) from where a probe is at a place, along the axes that it had at first touch."""
    own, along = np.empty((len(points), 3)), np.empty((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0] - axis_mm[0], points[i, 1] - axis_mm[1], points[i, 2] - axis_mm[2]
        for j in range(3):
            a, b, c = axes[j]
            own[i, j] = x * a + y * b + z * c - place[j]
            along[i, j] = normals[i, 0] * a + normals[i, 1] * b + normals[i, 2] * c
    return own, along


@njit(cache=True)
def _slopes(own: Floats, along: Floats, gap: Floats, normal: Floats, turned: Floats, turning: Floats) -> Floats:
    """Return (k, 6) the gap's derivatives where a line meets the probe.

    A motion dc of the probe at the place that is met changes the gap by -(e . dc) / (e . n), e its normal there.
    """
    slope = np.zeros((len(gap), 6))
    for i in range(len(gap)):
        if not math.isfinite(gap[i]):
            continue
        a, b, c = own[i, 0] - gap[i] * along[i, 0], own[i, 1] - gap[i] * along[i, 1], own[i, 2] - gap[i] * along[i, 2]
        u, v, w = normal[i, 0], normal[i, 1], normal[i, 2]
        x = turned[0, 0] * u + turned[0, 1] * v + turned[0, 2] * w
        y = turned[1, 0] * u + turned[1, 1] * v + turned[1, 2] * w
        z = turned[2, 0] * u + turned[2, 1] * v + turned[2, 2] * w
        steep = x * along[i, 0] + y * along[i, 1] + z * along[i, 2]
        about = b * z - c * y, c * x - a * z, a * y - b * x
        slope[i, 0], slope[i, 1], slope[i, 2] = -x / steep, -y / steep, -z / steep
        for j in range(3):
            slope[i, 3 + j] = -(about[0] * turning[0, j] + about[1] * turning[1, j] + about[2] * turning[2, j]) / steep
    return slope


def outline(probe: Probe) -> Floats:
    """Return (16, 2) offsets from the axis around the probe's flat face; none for any other probe."""
    if not isinstance(probe, Cylinder | Pillar):
        return np.zeros((0, 2))
    angle = np.arange(16) * math.pi / 8
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    if isinstance(probe, Pillar):
        around /= np.abs(around).max(axis=1, keepdims=True)
    return np.asarray(around * half_extent(probe))
