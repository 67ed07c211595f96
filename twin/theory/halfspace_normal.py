"""How rectangles in one plane of a half-space push each other in: the normal part of `twin.theory.halfspace` alone.

Without friction nothing else is asked of a flat surface, and it is a ninth of the whole: w = (1 - nu^2) / (pi E) times
the mean of 1 / r over the rectangle (Boussinesq; A. E. H. Love 1929, Phil. Trans. A 228). Equal rectangles on a lattice
need one mean for every offset, not one for every pair.

Validity: as of `twin.theory.halfspace`, whose numbers these are to round-off.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.theory.halfspace_kernels import FAR_2, FAR_3, GAUSS_2, GAUSS_3
from twin.theory.halfspace_rectangle import _log_ratio

_PLANE, _WHOLE = 1e-9, 1e-6
"""How far rectangles may lie off one plane, and differ in size, over their size; and off the points of a lattice."""


def normal_compliance(rectangles: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float) -> Floats | None:
    """Return the (k, k) normal displacements of rectangles' middles under unit normal forces on each, mm/N.

    Symmetric: the mean of either way round, which differ where sizes do. None where they don't lie in one plane, with
    the same frames.
    """
    out = np.empty((len(rectangles), len(rectangles)))
    unit = (1.0 - poisson_ratio**2) / (math.pi * youngs_modulus_mpa)
    return out if _fill(rectangles.centre_mm, rectangles.frames, rectangles.half_mm, unit, out) else None


@njit(cache=True)
def _mean(x: float, y: float, a: float, b: float) -> float:
    """Return the mean of 1 / r, seen from (x, y), over the rectangle |x| <= a, |y| <= b, by the same rules as there."""
    distance, size, total = x * x + y * y, a * a + b * b, 0.0
    if distance > FAR_2 * FAR_2 * size:
        for s in GAUSS_2:
            for t in GAUSS_2:
                total += 0.25 / math.sqrt((x - a * s) ** 2 + (y - b * t) ** 2)
        return total
    if distance > FAR_3 * FAR_3 * size:
        for i in range(3):
            for j in range(3):
                weight = (8.0 if i == 1 else 5.0) * (8.0 if j == 1 else 5.0) / 324.0
                total += weight / math.sqrt((x - a * GAUSS_3[i]) ** 2 + (y - b * GAUSS_3[j]) ** 2)
        return total
    x1, x2, y1, y2 = x + a, x - a, y + b, y - b
    xx1, xx2, yy1, yy2 = x1 * x1, x2 * x2, y1 * y1, y2 * y2
    r11, r12, r21, r22 = math.sqrt(xx1 + yy1), math.sqrt(xx1 + yy2), math.sqrt(xx2 + yy1), math.sqrt(xx2 + yy2)
    along_x = y1 * _log_ratio(x1, r11, x2, r21, yy1) - y2 * _log_ratio(x1, r12, x2, r22, yy2)
    along_y = x1 * _log_ratio(y1, r11, y2, r12, xx1) - x2 * _log_ratio(y1, r21, y2, r22, xx2)
    return float((along_x + along_y) * 0.25 / (a * b))


@njit(cache=True)
def _fill(centre: Floats, frames: Floats, half: Floats, unit: float, out: Floats) -> bool:
    """Set ``out`` (k, k) to ``unit`` means over each rectangle, seen from each; return whether all lie in one plane."""
    k, frame = len(centre), frames[0]
    place = np.empty((k, 2))
    for i in range(k):
        dx, dy, dz = centre[i, 0] - centre[0, 0], centre[i, 1] - centre[0, 1], centre[i, 2] - centre[0, 2]
        for axis in range(2):
            place[i, axis] = frame[axis, 0] * dx + frame[axis, 1] * dy + frame[axis, 2] * dz
        off = frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz
        if abs(off) > _PLANE * min(half[i, 0], half[i, 1]):
            return False
        for axis in range(9):
            if frames[i, axis // 3, axis % 3] != frame[axis // 3, axis % 3]:
                return False
    cell, shape = _lattice(place, half)
    if shape[0] * shape[1] * 2 > k * k:
        for i in range(k):
            for j in range(i + 1):
                x, y = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
                found = _mean(x, y, half[j, 0], half[j, 1])
                if half[i, 0] != half[j, 0] or half[i, 1] != half[j, 1]:
                    found = (found + _mean(x, y, half[i, 0], half[i, 1])) / 2.0
                out[i, j] = out[j, i] = unit * found
        return True
    kernel, a, b = np.empty((shape[0], shape[1])), half[0, 0], half[0, 1]
    for u in range(shape[0]):
        for v in range(shape[1]):
            if a == b and v < u < shape[1]:  # of squares as far the other way round
                kernel[u, v] = kernel[v, u]
            else:
                kernel[u, v] = unit * _mean(2.0 * a * u, 2.0 * b * v, a, b)
    for i in range(k):
        u, v = cell[i]
        for j in range(k):
            out[i, j] = kernel[abs(u - cell[j, 0]), abs(v - cell[j, 1])]
    return True


@njit(cache=True)
def _lattice(place: Floats, half: Floats) -> tuple[Ints, tuple[int, int]]:
    """Return (k, 2) cells of equal rectangles on a lattice, and how many there are a side; too many if it is none."""
    cell, shape, none = np.zeros(place.shape, np.int64), [0, 0], (len(place) + 1, len(place) + 1)
    for axis in range(2):
        low, size = place[:, axis].min(), half[0, axis]
        for i in range(len(place)):
            steps = (place[i, axis] - low) / (2.0 * size)
            cell[i, axis] = round(steps)
            if abs(half[i, axis] - size) > _PLANE * size or abs(steps - cell[i, axis]) > _WHOLE:
                return cell, none
            shape[axis] = max(shape[axis], cell[i, axis] + 1)
    return cell, (shape[0], shape[1])
