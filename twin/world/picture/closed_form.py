"""One ray and one ellipsoid, in closed form: the formulas that all loops of the splat share.

Everything is measured in the ellipsoid's own metric, where its radius is 1: a ray's distance to the centre there is
below 1 where it meets. Rays go down, and are told from the ellipsoid's centre: (fx + dx t, fy + dy t, -t). Coverage of
a sub-pixel follows from that distance and how fast it changes from pixel to pixel, and so is smooth.

Formulas keep the precision of what they are given, so constants are singles: next to a plain number numba would take
every single for a double, and halve what vector instructions do at once. Told from the centre, singles are enough.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit
from twin.world.picture.frame import INTO

QUICK = {"contract", "arcp", "reassoc", "nsz"}
"""What the compiler may do with sums: nothing that breaks infinities."""

ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)

_INTO = np.float32(INTO)

_TINY = np.float32(1e-9)

_GRAZING = np.float32(0.1)
"""Least cosine between a surface and a camera ray for which a shadow's edge is thought to run over it."""

_INNER = np.float32(1.5)
"""How many pixels, by half their steepest step, inside the outline a pixel begins to take one ray; 0.71 is the edge."""

_FAR = np.float32(3)
"""A ray that passes a marker at so many radii is not near its shadow's edge."""

Number = float | np.float32
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]
Met = tuple[Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number]


@njit(cache=True, nogil=True, fastmath=QUICK)
def matrix_of(metric: Floats, marker: int) -> Six:
    """Return a marker's metric as m00, m11, m22, m01, m02, m12."""
    return (metric[marker, 0, 0], metric[marker, 1, 1], metric[marker, 2, 2],
            metric[marker, 0, 1], metric[marker, 0, 2], metric[marker, 1, 2])  # fmt: skip


@njit(cache=True, nogil=True, fastmath=QUICK)
def relative(ray: Four, drop: Number, centre: Three) -> Four:
    """Return a ray that begins at the base, ``drop`` above a centre, as it passes the height of that centre."""
    return ray[0] + ray[2] * drop - centre[0], ray[1] + ray[3] * drop - centre[1], ray[2], ray[3]


@njit(cache=True, nogil=True, fastmath=QUICK)
def footprint(across: Four, down: Four, drop: Number) -> Four:
    """Return how far aside the rays one column and one row on go, ``drop`` below where rays are told."""
    return (across[0] + across[2] * drop, across[1] + across[3] * drop,
            down[0] + down[2] * drop, down[1] + down[3] * drop)  # fmt: skip


@njit(cache=True, nogil=True, fastmath=QUICK)
def approach(ray: Four, m: Six, step: Four) -> Met:
    """Return how a ray passes an ellipsoid.

    Returns
    -------
    The ray's distance to the centre in the ellipsoid's metric, its changes along column and row (``step`` is the
    `footprint` there), the nearest point from the centre (3), the metric times the ray's direction (3), and that
    direction's square.
    """
    m00, m11, m22, m01, m02, m12 = m
    fx, fy, dx, dy = ray
    ax, ay, az = m00 * dx + m01 * dy - m02, m01 * dx + m11 * dy - m12, m02 * dx + m12 * dy - m22
    square = dx * ax + dy * ay - az
    t = (fx * ax + fy * ay) / square
    x, y, z = fx - dx * t, fy - dy * t, t
    gx, gy, gz = m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z
    miss = np.sqrt(max(x * gx + y * gy + z * gz, ZERO))
    # Only what is across the ray counts of a step aside: at the nearest point the gradient has no other part.
    inverse = ONE / max(miss, _TINY)
    one, two = (gx * step[0] + gy * step[1]) * inverse, (gx * step[2] + gy * step[3]) * inverse
    return miss, one, two, x, y, z, ax, ay, az, square, np.sqrt(one * one + two * two)


@njit(cache=True, nogil=True, fastmath=QUICK)
def candidate(met: Met, m: Six, step: Four, k: Number) -> tuple[Number, Number]:
    """Return two numbers, positive if any of a pixel's k x k sub-pixels may show the ellipsoid, and if all of them do.

    Notes
    -----
    The distance is the norm of a map that is nearly straight over a pixel. A norm is convex: it falls nowhere below
    its tangent, and rises at most by the map's norm times half a diagonal. Pixels count as full from another one
    inwards: next to the outline shading still bends, and one ray at their middle misses its mean.
    """
    miss, one, two = met[0], met[1], met[2]
    ax, ay, square, steep = met[6], met[7], met[9], met[10]
    reach = (np.abs(one) + np.abs(two)) * HALF
    m00, m11, m01 = m[0], m[1], m[3]
    px, py, qx, qy = step
    pa, qa = px * ax + py * ay, qx * ax + qy * ay
    pp = m00 * px * px + TWO * m01 * px * py + m11 * py * py - pa * pa / square
    qq = m00 * qx * qx + TWO * m01 * qx * qy + m11 * qy * qy - qa * qa / square
    pq = m00 * px * qx + m01 * (px * qy + py * qx) + m11 * py * qy - pa * qa / square
    half, apart = (pp + qq) * HALF, (pp - qq) * HALF
    most = np.sqrt(half + np.sqrt(apart * apart + pq * pq))
    return ONE + (reach * (k - ONE) + HALF * steep) / k - miss, ONE - _INNER * most - miss


@njit(cache=True, nogil=True, fastmath=QUICK)
def coverage(met: Met, k: Number) -> Number:
    """Return the share of a sub-pixel, 1/k px wide, around a ray that the ellipsoid covers."""
    share = min(max(HALF + k * (ONE - met[0]) / max(met[10], _TINY), ZERO), ONE)
    return ONE if met[0] < HALF else share


@njit(cache=True, nogil=True, fastmath=QUICK)
def place_met(met: Met, ray: Four, m: Six, covers: Number, k: Number) -> Six:
    """Return where a sub-pixel is lit: the way from the centre to the surface, and the unit normal there."""
    m00, m11, m22, m01, m02, m12 = m
    miss = met[0]
    rim = _INTO * covers * met[10] / k if covers < ONE else ONE - miss
    rim = min(max(rim, ZERO), ONE)
    depth = np.sqrt(rim * (TWO - rim) / met[9])
    shrink = (ONE - rim) / max(miss, _TINY)
    x, y, z = met[3] * shrink - ray[2] * depth, met[4] * shrink - ray[3] * depth, met[5] * shrink + depth
    nx, ny, nz = m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z
    norm = ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
    return x, y, z, nx * norm, ny * norm, nz * norm


@njit(cache=True, nogil=True, fastmath=QUICK)
def blocked(centre: Three, m: Six, place: Three, way: Three, normal: Three, dx: Number, dy: Number, step: Four,
            k: Number) -> Number:  # fmt: skip
    """Return the share of a sub-pixel around a ``place`` in which another ellipsoid blocks its ``way`` to a lamp.

    ``dx`` and ``dy`` are the camera ray's slopes, ``step`` its `footprint` there.
    """
    m00, m11, m22, m01, m02, m12 = m
    tx, ty, tz = way
    fx, fy, fz = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
    ax, ay, az = m00 * tx + m01 * ty + m02 * tz, m01 * tx + m11 * ty + m12 * tz, m02 * tx + m12 * ty + m22 * tz
    part = -(fx * ax + fy * ay + fz * az) / (tx * ax + ty * ay + tz * az)
    fx, fy, fz = fx + tx * part, fy + ty * part, fz + tz * part
    gx, gy, gz = m00 * fx + m01 * fy + m02 * fz, m01 * fx + m11 * fy + m12 * fz, m02 * fx + m12 * fy + m22 * fz
    miss = np.sqrt(max(fx * gx + fy * gy + fz * gz, ZERO))
    # How fast the place runs over its marker, and with it the way past the other one, per pixel.
    facing = min(normal[0] * dx + normal[1] * dy - normal[2], -_GRAZING * np.sqrt(ONE + dx * dx + dy * dy))
    along = (gx * dx + gy * dy - gz) / facing
    one = gx * step[0] + gy * step[1] - along * (normal[0] * step[0] + normal[1] * step[1])
    two = gx * step[2] + gy * step[3] - along * (normal[0] * step[2] + normal[1] * step[3])
    steep = np.sqrt(one * one + two * two) / max(miss, _TINY) * (ONE - part)
    share = min(max(HALF + k * (ONE - miss) / max(steep, _TINY), ZERO), ONE)
    return share if part > ZERO and part < ONE and miss < _FAR else ZERO
