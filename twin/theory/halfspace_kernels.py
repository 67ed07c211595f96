"""The half-space's influence functions, pair by pair, in the frame of the load: x, y in the plane, z into the body.

Everything derives from three harmonic functions of r = |(x, y, z)| (A. E. H. Love 1929, Phil. Trans. A 228, and
K. L. Johnson, Contact Mechanics, ch. 3): with H = z ln(r + z) - r the displacement of a force f on the surface is

    u_i = c [delta_ij / r + x_i x_j / r^3 + (1 - 2 nu) V_ij] f_j,     c = (1 + nu) / (2 pi E),
    V_xx = -H_xx, V_xy = -H_xy, V_yy = -H_yy, V_xz = -V_zx = -H_xz, V_yz = -V_zy = -H_yz, V_zz = H_zz = 1/r.

A uniform rectangle is the same, integrated twice (`twin.theory.halfspace_rectangle`). The kernels return everything
divided by c, per unit force.

Why numba: a call is a few hundred flops with branches at every pair; numpy would need 30 temporaries of that size.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit
from twin.theory.halfspace_rectangle import add_slopes, closed_slopes, closed_terms

GAUSS_2 = (-0.5773502691896257, 0.5773502691896257)
GAUSS_3 = (-0.7745966692414834, 0.0, 0.7745966692414834)
FAR_3, FAR_2 = 8.0, 40.0
"""Beyond these distances, in half diagonals, 3 x 3 and 2 x 2 Gauss points replace the corners (error below 1e-7)."""


def _gauss(order: int) -> Floats:
    """Return (order^2, 3) Gauss points of a square, and weights that sum to one."""
    at, weight = np.polynomial.legendre.leggauss(order)
    x, y = np.meshgrid(at, at, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.outer(weight, weight).ravel() / 4.0])


_ONE, _FOUR, _NINE = _gauss(1), _gauss(2), _gauss(3)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _point_terms(
    x: float, y: float, z: float, a: float, b: float, k: float, nodes: Floats, u: Floats, n: Floats
) -> None:
    """Set u (3, 3), indexed [displacement, force], and n_j = x_j / r^3 (3,) to the weighted sums over point forces.

    ``nodes`` are (q, 3) places, as shares of a and b, and weights. ``k`` is 1 - 2 nu. -nu/pi n . f is lambda div u,
    which stays finite at nu = 1/2. The sums may be taken in any order, so that several points are done at once.
    """
    one, xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = 0.0, 0.0, 0.0
    for q in range(len(nodes)):
        px, py, weight = x - a * nodes[q, 0], y - b * nodes[q, 1], nodes[q, 2]
        r2 = px * px + py * py + z * z
        wr = weight / math.sqrt(r2)
        w3 = wr / r2
        tx, ty, tz = px * w3, py * w3, z * w3
        one += wr
        xx += px * tx
        yy += py * ty
        zz += z * tz
        xy += px * ty
        xz += px * tz
        yz += py * tz
        nx += tx
        ny += ty
        nz += tz
    v00, v11, v01, v02, v12 = 0.0, 0.0, 0.0, 0.0, 0.0
    if k != 0.0:
        for q in range(len(nodes)):
            px, py, weight = x - a * nodes[q, 0], y - b * nodes[q, 1], nodes[q, 2]
            r = math.sqrt(px * px + py * py + z * z)
            ws = weight / (r + z)
            wrs = ws / r
            wrss = wrs / (r + z)
            v00 += ws - px * px * wrss
            v11 += ws - py * py * wrss
            v01 -= px * py * wrss
            v02 -= px * wrs
            v12 -= py * wrs
    u[0, 0], u[1, 1], u[2, 2] = one + xx + k * v00, one + yy + k * v11, one * (1.0 + k) + zz
    u[0, 1] = u[1, 0] = xy + k * v01
    u[0, 2], u[2, 0] = xz + k * v02, xz - k * v02
    u[1, 2], u[2, 1] = yz + k * v12, yz - k * v12
    n[0], n[1], n[2] = nx, ny, nz


@njit(cache=True)
def point_slopes(x: float, y: float, z: float, k: float, weight: float, d: Floats, n: Floats) -> None:
    """Add ``weight`` times d[i, j, m] = du_i/dx_m per unit force j, (3, 3, 3), and n_j = x_j / r^3 to (3,)."""
    p = (x, y, z)
    over_r = 1.0 / math.sqrt(x * x + y * y + z * z)
    w3 = weight * over_r * over_r * over_r
    w5 = 3.0 * w3 * over_r * over_r
    for i in range(3):
        for j in range(3):
            for m in range(3):
                d[i, j, m] -= p[i] * p[j] * p[m] * w5
        for m in range(3):
            d[i, i, m] -= p[m] * w3
            d[i, m, i] += p[m] * w3
            d[i, m, m] += p[i] * w3
        n[i] += p[i] * w3
    if k == 0.0:
        return
    s = 1.0 / (1.0 / over_r + z)
    t = over_r * s * s
    q = k * weight * t * over_r * (over_r + 2.0 * s)
    t *= k * weight
    v = k * weight * over_r * s * over_r * (over_r + s)
    hxxx, hxxy = x * (3.0 * t - x * x * q), y * (t - x * x * q)
    hxyy, hyyy = x * (t - y * y * q), y * (3.0 * t - y * y * q)
    hz = k * weight * over_r * s
    hxxz, hyyz, hxyz = hz - x * x * v, hz - y * y * v, -x * y * v
    w3 *= k
    add_slopes(d, hxxx, hxxy, hxyy, hyyy, hxxz, hyyz, hxyz, -x * w3, -y * w3, -z * w3)


@njit(cache=True)
def rectangle_terms(x: float, y: float, z: float, a: float, b: float, k: float, u: Floats, n: Floats) -> None:
    """Set u (3, 3) and n (3,) to the mean over the rectangle |x| <= a, |y| <= b; a = b = 0 is a point force."""
    distance, size = x * x + y * y + z * z, a * a + b * b
    if size == 0.0:
        if distance == 0.0:
            raise ZeroDivisionError("a point force moves its own place infinitely far")
        _point_terms(x, y, z, a, b, k, _ONE, u, n)
    elif distance > FAR_2 * FAR_2 * size:
        _point_terms(x, y, z, a, b, k, _FOUR, u, n)
    elif distance > FAR_3 * FAR_3 * size:
        _point_terms(x, y, z, a, b, k, _NINE, u, n)
    else:
        closed_terms(x, y, z, a, b, k, u, n)


@njit(cache=True)
def rectangle_slopes(x: float, y: float, z: float, a: float, b: float, k: float, d: Floats, n: Floats) -> None:
    """Set d (3, 3, 3), du_i/dx_m per unit force j, and n (3,) to the mean over the rectangle |x| <= a, |y| <= b."""
    d[:] = 0.0
    n[:] = 0.0
    distance, size = x * x + y * y + z * z, a * a + b * b
    if size == 0.0:
        point_slopes(x, y, z, k, 1.0, d, n)
    elif distance > FAR_2 * FAR_2 * size:
        for s in GAUSS_2:
            for t in GAUSS_2:
                point_slopes(x - a * s, y - b * t, z, k, 0.25, d, n)
    elif distance > FAR_3 * FAR_3 * size:
        for i in range(3):
            for j in range(3):
                weight = (8.0 if i == 1 else 5.0) * (8.0 if j == 1 else 5.0) / 324.0
                point_slopes(x - a * GAUSS_3[i], y - b * GAUSS_3[j], z, k, weight, d, n)
    else:
        closed_slopes(x, y, z, a, b, k, d, n)
