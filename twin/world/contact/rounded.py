"""Where lines meet rounded convex probes: a sharp one with a ball rolled around it.

The distance to the sharp one is known in closed form, and along a line it is convex, so that Newton's steps from
outside can't pass the first place where the line enters.

Why numba: a hundred points take three steps each, of a dozen NumPy calls on so few numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points
from twin.compiled import njit

GRAZING = 1e-3
"""A line that meets a probe at a smaller sine than this doesn't meet it."""

CONE, ROUND, SQUARE = range(3)
_NEWTON = 60

_TINY_MM = 1e-150
"""What lies nearer to the sharp body lies on it: the squares of smaller lengths are 0, and nothing divides by them."""


@dataclass(frozen=True)
class Rounded:
    """All places nearer than ``radius_mm`` to a sharp convex body.

    Attributes
    ----------
    sharp, sizes
        An endless `CONE` that opens towards -z, with sine and cosine of its half angle and its apex's height; or a
        `ROUND` or `SQUARE` shaft, with its half widths along x and y and the height at which it ends flat. mm.
    radius_mm
        Of the ball.
    """

    sharp: int
    sizes: tuple[float, float, float]
    radius_mm: float

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `twin.world.contact.probe_shape.Shape`."""
        points, along = np.ascontiguousarray(points), np.ascontiguousarray(along)
        distance, normal = _enter(points, along, self.sharp, self.sizes, self.radius_mm)
        return distance, normal


@njit(cache=True)
def _enter(
    points: Floats, along: Floats, sharp: int, sizes: tuple[float, float, float], radius: float
) -> tuple[Floats, Floats]:
    distance, normal, largest = np.empty(len(points)), along.copy(), 0.0
    for i in range(len(points)):
        largest = max(largest, abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2]))
    far = 10.0 * (1.0 + radius + largest)
    for i in range(len(points)):
        e0, e1, e2 = along[i]
        way, left, met = -far, 0.0, False
        for _ in range(_NEWTON):
            x, y, z = points[i, 0] - way * e0, points[i, 1] - way * e1, points[i, 2] - way * e2
            left, n0, n1, n2 = _distance(x, y, z, sharp, sizes)
            left -= radius
            steep = n0 * e0 + n1 * e1 + n2 * e2
            met = steep > GRAZING
            if not met:
                break
            way += left / steep
            if abs(left / steep) < 1e-13 * far:
                break
        if met and abs(left) <= 1e-9 * far:
            distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = way, n0, n1, n2
        else:
            distance[i] = math.inf
    return distance, normal


@njit(cache=True)
def _distance(
    x: float, y: float, z: float, sharp: int, sizes: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Return the distance to the sharp body, negative inside, and its gradient."""
    rho = math.hypot(x, y)
    out_x, out_y = (x / rho, y / rho) if rho > 0.0 else (0.0, 0.0)
    if sharp == CONE:
        sine, cosine, up = sizes[0], sizes[1], z - sizes[2]
        if rho * sine > up * cosine:
            return rho * cosine + up * sine, cosine * out_x, cosine * out_y, sine
        away = max(math.hypot(rho, up), 1e-300)  # the apex is nearest
        return away, x / away, y / away, up / away
    below = z - sizes[2]
    if sharp == ROUND:
        beside, b, a_x, a_y, b_y = rho - sizes[0], -math.inf, out_x, out_y, 0.0
    else:
        beside, b, a_x, a_y, b_y = abs(x) - sizes[0], abs(y) - sizes[1], np.sign(x), 0.0, np.sign(y)
    if max(beside, b, below) <= _TINY_MM:
        if beside >= b and beside >= below:
            return beside, a_x, a_y, 0.0
        return (b, 0.0, b_y, 0.0) if b >= below else (below, 0.0, 0.0, 1.0)
    p, q, r = max(beside, 0.0), max(b, 0.0), max(below, 0.0)
    away = math.sqrt(p * p + q * q + r * r)
    return away, p * a_x / away, (p * a_y + q * b_y) / away, r / away
