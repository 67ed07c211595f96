"""What distant rectangles do at a face: point forces in their middles, many at once.

Why apart from `twin.world.elasticity.residual`: nearly all pairs of a place and a rectangle are distant, and a loop
without branches and in any order is done four to eight pairs at a time.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit

FAR = 6.0
"""Half diagonals beyond which one point force stands for a rectangle."""


def distant_rows(centre: Floats, frames: Floats, half: Floats, force: Floats) -> Floats:
    """Return (13, k) what `distant` needs of rectangles under forces (k, 3), contiguous in each quantity."""
    normal = frames[:, 2]
    along = np.sum(normal * force, axis=1)
    limit = FAR**2 * np.sum(half**2, axis=1)
    flat = force - along[:, None] * normal
    return np.ascontiguousarray(np.vstack([centre.T, limit, force.T, normal.T, flat.T]))


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def distant(
    px: float, py: float, pz: float, ax: float, ay: float, az: float, rows: Floats, k: float
) -> tuple[float, float, float]:
    """Return minus the traction times area of all distant rectangles at the place p, on the area vector a.

    A point force's stress is radial, -3 (f . x) x x / (2 pi r^5), plus k = 1 - 2 nu times a plane part that has no
    component along the normal n (Boussinesq, Cerruti; H is the potential of `twin.theory.halfspace_kernels`): the
    traction 1 / (2 pi) [A_i (x . f) / r^3 - H_imj A_m f_j], i and m in the plane. With s = 1 / (r + z) its derivatives
    there are H_imj = p (d_im x_j + d_ij x_m + d_mj x_i) - w x_i x_m x_j and H_imz = d_im s / r - v x_i x_m.
    """
    tx, ty, tz = 0.0, 0.0, 0.0
    radial, plane = 1.5 / math.pi, 0.5 * k / math.pi
    for t in range(rows.shape[1]):
        x, y, z = px - rows[0, t], py - rows[1, t], pz - rows[2, t]
        r2 = x * x + y * y + z * z
        far = r2 > rows[3, t]
        r2 = r2 if far else 1.0
        over_r = (1.0 if far else 0.0) / math.sqrt(r2)
        r3 = over_r * over_r * over_r
        c = radial * (x * ax + y * ay + z * az) * r3 * over_r * over_r
        c *= x * rows[4, t] + y * rows[5, t] + z * rows[6, t]
        tx += c * x
        ty += c * y
        tz += c * z
    if k == 0.0:
        return tx, ty, tz
    for t in range(rows.shape[1]):
        x, y, z = px - rows[0, t], py - rows[1, t], pz - rows[2, t]
        r2 = x * x + y * y + z * z
        far = r2 > rows[3, t]
        r2 = r2 if far else 1.0
        weight = plane if far else 0.0
        nx, ny, nz, fx, fy, fz = rows[7, t], rows[8, t], rows[9, t], rows[10, t], rows[11, t], rows[12, t]
        deep, a_n = x * nx + y * ny + z * nz, ax * nx + ay * ny + az * nz
        f_n = (rows[4, t] - fx) * nx + (rows[5, t] - fy) * ny + (rows[6, t] - fz) * nz
        flat_f, flat_a = x * fx + y * fy + z * fz, x * ax + y * ay + z * az - deep * a_n
        both = ax * fx + ay * fy + az * fz
        below = max(deep, 0.0)
        over_r = 1.0 / math.sqrt(r2 - deep * deep + below * below)
        s = 1.0 / (1.0 / over_r + below)
        p = over_r * s * s
        w, v = p * over_r * (over_r + 2.0 * s), over_r * s * over_r * (over_r + s)
        on_a = (flat_f + below * f_n) * over_r * over_r * over_r - p * flat_f - f_n * s * over_r
        on_f = -p * flat_a
        on_x = flat_a * (w * flat_f + v * f_n) - p * both
        on_n = on_a * a_n + on_x * deep
        tx -= weight * (on_a * ax + on_f * fx + on_x * x - on_n * nx)
        ty -= weight * (on_a * ay + on_f * fy + on_x * y - on_n * ny)
        tz -= weight * (on_a * az + on_f * fz + on_x * z - on_n * nz)
    return tx, ty, tz
