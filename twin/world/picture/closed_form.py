"""One ray and one ellipsoid, in closed form: the formulas that all loops of the splat share.

Everything is measured in the ellipsoid's own metric, where its radius is 1: a ray's distance to the centre there is
below 1 where it meets. Rays go down, (x0 + dx t, y0 + dy t, base - t). Coverage of a sub-pixel follows from that
distance and how fast it changes from pixel to pixel, and so is smooth.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit
from twin.world.picture.frame import INTO

QUICK = {"contract", "arcp", "reassoc", "nsz"}
"""What the compiler may do with sums: nothing that breaks infinities."""

_GRAZING = 0.1
"""Least cosine between a surface and a camera ray for which a shadow's edge is thought to run over it."""

_INNER = 1.5
"""How many pixels, by half their steepest step, inside the outline a pixel begins to take one ray; 0.71 is the edge."""

_FAR = 3.0
"""A ray that passes a marker at so many radii is not near its shadow's edge."""

Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]
Met = tuple[float, float, float, float, float, float, float, float, float, float, float]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def matrix_of(metric: Floats, marker: int) -> Six:
    """Return a marker's metric as m00, m11, m22, m01, m02, m12."""
    return (metric[marker, 0, 0], metric[marker, 1, 1], metric[marker, 2, 2],
            metric[marker, 0, 1], metric[marker, 0, 2], metric[marker, 1, 2])  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def footprint(across: Four, down: Four, drop: float) -> Four:
    """Return how far aside the rays one column and one row on go, ``drop`` below the base."""
    return (across[0] + across[2] * drop, across[1] + across[3] * drop,
            down[0] + down[2] * drop, down[1] + down[3] * drop)  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def approach(ray: Four, base: float, centre: Three, m: Six, step: Four) -> Met:
    """Return how a ray passes an ellipsoid.

    Returns
    -------
    The ray's distance to the centre in the ellipsoid's metric, its changes along column and row (``step`` is the
    `footprint` there), the nearest point from the centre (3), the metric times the ray's direction (3), and that
    direction's square.
    """
    m00, m11, m22, m01, m02, m12 = m
    drop = base - centre[2]
    dx, dy = ray[2], ray[3]
    fx, fy = ray[0] + dx * drop - centre[0], ray[1] + dy * drop - centre[1]
    ax, ay, az = m00 * dx + m01 * dy - m02, m01 * dx + m11 * dy - m12, m02 * dx + m12 * dy - m22
    square = dx * ax + dy * ay - az
    t = (fx * ax + fy * ay) / square
    x, y, z = fx - dx * t, fy - dy * t, t
    gx, gy, gz = m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z
    miss = np.sqrt(max(x * gx + y * gy + z * gz, 0.0))
    # Only what is across the ray counts of a step aside: at the nearest point the gradient has no other part.
    inverse = 1 / max(miss, 1e-9)
    one, two = (gx * step[0] + gy * step[1]) * inverse, (gx * step[2] + gy * step[3]) * inverse
    return miss, one, two, x, y, z, ax, ay, az, square, np.sqrt(one * one + two * two)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def candidate(met: Met, m: Six, step: Four, k: int) -> tuple[bool, bool]:
    """Return whether any of a pixel's k x k sub-pixels may show the ellipsoid, and whether all of them do.

    Notes
    -----
    The distance is the norm of a map that is nearly straight over a pixel. A norm is convex: it falls nowhere below
    its tangent, and rises at most by the map's norm times half a diagonal. Pixels count as full from another one
    inwards: next to the outline shading still bends, and one ray at their middle misses its mean.
    """
    miss, one, two = met[0], met[1], met[2]
    ax, ay, square, steep = met[6], met[7], met[9], met[10]
    reach = (abs(one) + abs(two)) / 2
    m00, m11, m01 = m[0], m[1], m[3]
    px, py, qx, qy = step
    pa, qa = px * ax + py * ay, qx * ax + qy * ay
    pp = m00 * px * px + 2 * m01 * px * py + m11 * py * py - pa * pa / square
    qq = m00 * qx * qx + 2 * m01 * qx * qy + m11 * qy * qy - qa * qa / square
    pq = m00 * px * qx + m01 * (px * qy + py * qx) + m11 * py * qy - pa * qa / square
    most = np.sqrt((pp + qq) / 2 + np.sqrt((pp - qq) * (pp - qq) / 4 + pq * pq))
    return miss < 1 + (reach * (k - 1) + 0.5 * steep) / k, miss < 1 - _INNER * most


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def coverage(met: Met, k: int) -> float:
    """Return the share of a sub-pixel, 1/k px wide, around a ray that the ellipsoid covers."""
    share = min(max(0.5 + k * (1 - met[0]) / max(met[10], 1e-6), 0.0), 1.0)
    return 1.0 if met[0] < 0.5 else share


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def place_met(met: Met, ray: Four, m: Six, covers: float, k: int) -> Six:
    """Return where a sub-pixel is lit: the way from the centre to the surface, and the unit normal there."""
    m00, m11, m22, m01, m02, m12 = m
    miss = met[0]
    within = min(1 - INTO * covers * met[10] / k, 1.0) if covers < 1 else miss
    within = max(within, 0.0)
    depth = np.sqrt(max(1 - within * within, 0.0) / met[9])
    shrink = within / max(miss, 1e-9)
    x, y, z = met[3] * shrink - ray[2] * depth, met[4] * shrink - ray[3] * depth, met[5] * shrink + depth
    nx, ny, nz = m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z
    norm = 1 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return x, y, z, nx * norm, ny * norm, nz * norm


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def blocked(centre: Three, m: Six, place: Three, way: Three, normal: Three, dx: float, dy: float, step: Four,
            k: int) -> float:  # fmt: skip
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
    miss = np.sqrt(max(fx * gx + fy * gy + fz * gz, 0.0))
    # How fast the place runs over its marker, and with it the way past the other one, per pixel.
    facing = min(normal[0] * dx + normal[1] * dy - normal[2], -_GRAZING * np.sqrt(1 + dx * dx + dy * dy))
    along = (gx * dx + gy * dy - gz) / facing
    one = gx * step[0] + gy * step[1] - along * (normal[0] * step[0] + normal[1] * step[1])
    two = gx * step[2] + gy * step[3] - along * (normal[0] * step[2] + normal[1] * step[3])
    steep = np.sqrt(one * one + two * two) / max(miss, 1e-9) * (1 - part)
    share = min(max(0.5 + k * (1 - miss) / max(steep, 1e-9), 0.0), 1.0)
    return share if part > 0 and part < 1 and miss < _FAR else 0.0
