"""The half-space's influence functions, pair by pair, in the frame of the load: x, y in the plane, z into the body.

Everything derives from three harmonic functions of r = |(x, y, z)| (A. E. H. Love 1929, Phil. Trans. A 228, and
K. L. Johnson, Contact Mechanics, ch. 3): with H = z ln(r + z) - r the displacement of a force f on the surface is

    u_i = c [delta_ij / r + x_i x_j / r^3 + (1 - 2 nu) V_ij] f_j,     c = (1 + nu) / (2 pi E),
    V_xx = -H_xx, V_xy = -H_xy, V_yy = -H_yy, V_xz = -V_zx = -H_xz, V_yz = -V_zy = -H_yz, V_zz = H_zz = 1/r.

A uniform rectangle is the same, integrated twice: four corner terms that hold three logarithms and three
arctangents. The kernels return everything divided by c, per unit force.

Why numba: a call is a few hundred flops with branches at every pair; numpy would need 30 temporaries of that size.
"""

from __future__ import annotations

import math

from numba import njit

from twin.arrays import Floats

GAUSS_2 = (-0.5773502691896257, 0.5773502691896257)
GAUSS_3 = (-0.7745966692414834, 0.0, 0.7745966692414834)
FAR_3, FAR_2 = 8.0, 40.0
"""Beyond these distances, in half diagonals, 3 x 3 and 2 x 2 Gauss points replace the corners (error below 1e-7)."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def point_terms(x: float, y: float, z: float, k: float, weight: float, u: Floats, n: Floats) -> None:
    """Add ``weight`` times the point force's u (3, 3), indexed [displacement, force], and n_j = x_j / r^3 to (3,).

    ``k`` is 1 - 2 nu. -nu/pi n . f is lambda div u, which stays finite at nu = 1/2.
    """
    over_r = 1.0 / math.sqrt(x * x + y * y + z * z)
    over_r3 = over_r * over_r * over_r
    wr, w3 = weight * over_r, weight * over_r3
    u[0, 0] += wr + x * x * w3
    u[1, 1] += wr + y * y * w3
    u[2, 2] += wr * (1.0 + k) + z * z * w3
    xy, xz, yz = x * y * w3, x * z * w3, y * z * w3
    if k != 0.0:
        s = 1.0 / (1.0 / over_r + z)
        ks, krs, krss = k * weight * s, k * wr * s, k * wr * s * s
        u[0, 0] += ks - x * x * krss
        u[1, 1] += ks - y * y * krss
        xy -= x * y * krss
        u[0, 2] -= x * krs
        u[2, 0] += x * krs
        u[1, 2] -= y * krs
        u[2, 1] += y * krs
    u[0, 1] += xy
    u[1, 0] += xy
    u[0, 2] += xz
    u[2, 0] += xz
    u[1, 2] += yz
    u[2, 1] += yz
    n[0] += x * w3
    n[1] += y * w3
    n[2] += z * w3


@njit(cache=True)  # type: ignore[untyped-decorator]
def point_slopes(x: float, y: float, z: float, k: float, weight: float, d: Floats) -> None:
    """Add ``weight`` times d[i, j, m] = du_i/dx_m per unit force j, (3, 3, 3)."""
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
    _add_slopes(d, hxxx, hxxy, hxyy, hyyy, hxxz, hyyz, hxyz, -x * w3, -y * w3, -z * w3)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _add_slopes(
    d: Floats,
    hxxx: float,
    hxxy: float,
    hxyy: float,
    hyyy: float,
    hxxz: float,
    hyyz: float,
    hxyz: float,
    hxzz: float,
    hyzz: float,
    hzzz: float,
) -> None:
    """Add the slopes of V from the third derivatives of H (or of its twofold integral)."""
    d[0, 0, 0] -= hxxx
    d[0, 0, 1] -= hxxy
    d[0, 0, 2] -= hxxz
    d[1, 1, 0] -= hxyy
    d[1, 1, 1] -= hyyy
    d[1, 1, 2] -= hyyz
    d[0, 1, 0] -= hxxy
    d[0, 1, 1] -= hxyy
    d[0, 1, 2] -= hxyz
    d[1, 0, 0] -= hxxy
    d[1, 0, 1] -= hxyy
    d[1, 0, 2] -= hxyz
    d[0, 2, 0] -= hxxz
    d[0, 2, 1] -= hxyz
    d[0, 2, 2] -= hxzz
    d[2, 0, 0] += hxxz
    d[2, 0, 1] += hxyz
    d[2, 0, 2] += hxzz
    d[1, 2, 0] -= hxyz
    d[1, 2, 1] -= hyyz
    d[1, 2, 2] -= hyzz
    d[2, 1, 0] += hxyz
    d[2, 1, 1] += hyyz
    d[2, 1, 2] += hyzz
    d[2, 2, 0] += hxzz
    d[2, 2, 1] += hyzz
    d[2, 2, 2] += hzzz


@njit(cache=True)  # type: ignore[untyped-decorator]
def _log_sum(y: float, r: float, rest: float) -> float:
    """Return ln(y + r) with r^2 = y^2 + rest and no cancellation; 0 where it only meets a zero factor."""
    if y >= 0.0:
        return math.log(y + r) if y + r > 0.0 else 0.0
    return math.log(rest / (r - y)) if rest > 0.0 else 0.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _over(y: float, r: float, rest: float) -> float:
    """Return 1 / [r (r + y)] without cancellation; 0 on the line where it is singular."""
    if r == 0.0 or rest == 0.0:
        return 0.0 if y <= 0.0 or r == 0.0 else 0.5 / (r * r)
    return 1.0 / (r * (r + y)) if y >= 0.0 else (r - y) / (r * rest)


@njit(cache=True)  # type: ignore[untyped-decorator]
def corner_terms(x: float, y: float, z: float, k: float, weight: float, u: Floats, n: Floats) -> None:
    """Add ``weight`` times the twofold integrals of `point_terms` at one corner."""
    r = math.sqrt(x * x + y * y + z * z)
    log_y, log_x = _log_sum(y, r, x * x + z * z), _log_sum(x, r, y * y + z * z)
    angle = math.atan2(x * y, z * r) if z > 0.0 else _quadrant(x, y)
    potential = x * log_y + y * log_x - z * angle
    u[0, 0] += weight * (2.0 * potential - x * log_y)
    u[1, 1] += weight * (2.0 * potential - y * log_x)
    u[2, 2] += weight * ((1.0 + k) * potential + z * angle)
    xy, xz, yz = -r, -z * log_y, -z * log_x
    if k != 0.0:
        log_z = math.log(r + z) if r + z > 0.0 else 0.0
        turn_y = math.atan2(x * y * (r - z), x * x * r + y * y * z) if x != 0.0 else 0.0
        turn_x = math.atan2(x * y * (r - z), y * y * r + x * x * z) if y != 0.0 else 0.0
        s1, s2 = y * log_z + z * log_y + x * turn_y, x * log_z + z * log_x + y * turn_x
        u[0, 0] += weight * k * (x * log_y - z * turn_y)
        u[1, 1] += weight * k * (y * log_x - z * turn_x)
        xy -= k * (z * log_z - r)
        u[0, 2] -= weight * k * s1
        u[2, 0] += weight * k * s1
        u[1, 2] -= weight * k * s2
        u[2, 1] += weight * k * s2
    u[0, 1] += weight * xy
    u[1, 0] += weight * xy
    u[0, 2] += weight * xz
    u[2, 0] += weight * xz
    u[1, 2] += weight * yz
    u[2, 1] += weight * yz
    n[0] -= weight * log_y
    n[1] -= weight * log_x
    n[2] += weight * angle


@njit(cache=True)  # type: ignore[untyped-decorator]
def _quadrant(x: float, y: float) -> float:
    """Return the limit z -> 0 of atan(x y / (z r))."""
    product = x * y
    if product > 0.0:
        return 0.5 * math.pi
    return -0.5 * math.pi if product < 0.0 else 0.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def corner_slopes(x: float, y: float, z: float, k: float, weight: float, d: Floats) -> None:
    """Add ``weight`` times the twofold integrals of `point_slopes` at one corner; 0 where an edge is singular."""
    w = weight
    r = math.sqrt(x * x + y * y + z * z)
    over_r = 1.0 / r if r > 0.0 else 0.0
    log_y, log_x = _log_sum(y, r, x * x + z * z), _log_sum(x, r, y * y + z * z)
    angle = math.atan2(x * y, z * r) if z > 0.0 else _quadrant(x, y)
    a, b = _over(y, r, x * x + z * z), _over(x, r, y * y + z * z)
    for i in range(2):
        d[i, i, 0] += w * 2.0 * log_y
        d[i, i, 1] += w * 2.0 * log_x
        d[i, i, 2] -= w * 2.0 * angle
    d[2, 2, 0] += w * (log_y - z * z * a)
    d[2, 2, 1] += w * (log_x - z * z * b)
    d[2, 2, 2] += w * z * (x * a + y * b)
    d[0, 0, 0] -= w * (log_y + x * x * a)
    d[0, 0, 1] -= w * x * over_r
    d[0, 0, 2] -= w * x * z * a
    d[1, 1, 0] -= w * y * over_r
    d[1, 1, 1] -= w * (log_x + y * y * b)
    d[1, 1, 2] -= w * y * z * b
    for i, j in ((0, 1), (1, 0)):
        d[i, j, 0] -= w * x * over_r
        d[i, j, 1] -= w * y * over_r
        d[i, j, 2] -= w * z * over_r
    for i, j in ((0, 2), (2, 0)):
        d[i, j, 0] -= w * z * x * a
        d[i, j, 1] -= w * z * over_r
        d[i, j, 2] -= w * (log_y + z * z * a)
    for i, j in ((1, 2), (2, 1)):
        d[i, j, 0] -= w * z * over_r
        d[i, j, 1] -= w * z * y * b
        d[i, j, 2] -= w * (log_x + z * z * b)
    if k == 0.0:
        return
    kw = k * w
    s = 1.0 / (r + z) if r + z > 0.0 else 0.0
    log_z = math.log(r + z) if r + z > 0.0 else 0.0
    turn_y = math.atan2(x * y * (r - z), x * x * r + y * y * z) if x != 0.0 else 0.0
    turn_x = math.atan2(x * y * (r - z), y * y * r + x * x * z) if y != 0.0 else 0.0
    _add_slopes(
        d,
        kw * (y * s - log_y), -kw * x * s, -kw * y * s, kw * (x * s - log_x),
        kw * turn_y, kw * turn_x, kw * log_z, kw * log_y, kw * log_x, -kw * angle,
    )  # fmt: skip


@njit(cache=True)  # type: ignore[untyped-decorator]
def rectangle_terms(x: float, y: float, z: float, a: float, b: float, k: float, u: Floats, n: Floats) -> None:
    """Set u (3, 3) and n (3,) to the mean over the rectangle |x| <= a, |y| <= b; a = b = 0 is a point force."""
    u[:] = 0.0
    n[:] = 0.0
    distance, size = x * x + y * y + z * z, a * a + b * b
    if size == 0.0:
        point_terms(x, y, z, k, 1.0, u, n)
    elif distance > FAR_2 * FAR_2 * size:
        for s in GAUSS_2:
            for t in GAUSS_2:
                point_terms(x - a * s, y - b * t, z, k, 0.25, u, n)
    elif distance > FAR_3 * FAR_3 * size:
        for i in range(3):
            for j in range(3):
                weight = (8.0 if i == 1 else 5.0) * (8.0 if j == 1 else 5.0) / 324.0
                point_terms(x - a * GAUSS_3[i], y - b * GAUSS_3[j], z, k, weight, u, n)
    else:
        weight = 0.25 / (a * b)
        corner_terms(x + a, y + b, z, k, weight, u, n)
        corner_terms(x - a, y - b, z, k, weight, u, n)
        corner_terms(x - a, y + b, z, k, -weight, u, n)
        corner_terms(x + a, y - b, z, k, -weight, u, n)


@njit(cache=True)  # type: ignore[untyped-decorator]
def rectangle_slopes(x: float, y: float, z: float, a: float, b: float, k: float, d: Floats) -> None:
    """Set d (3, 3, 3), du_i/dx_m per unit force j, to the mean over the rectangle |x| <= a, |y| <= b."""
    d[:] = 0.0
    distance, size = x * x + y * y + z * z, a * a + b * b
    if size == 0.0:
        point_slopes(x, y, z, k, 1.0, d)
    elif distance > FAR_2 * FAR_2 * size:
        for s in GAUSS_2:
            for t in GAUSS_2:
                point_slopes(x - a * s, y - b * t, z, k, 0.25, d)
    elif distance > FAR_3 * FAR_3 * size:
        for i in range(3):
            for j in range(3):
                weight = (8.0 if i == 1 else 5.0) * (8.0 if j == 1 else 5.0) / 324.0
                point_slopes(x - a * GAUSS_3[i], y - b * GAUSS_3[j], z, k, weight, d)
    else:
        weight = 0.25 / (a * b)
        corner_slopes(x + a, y + b, z, k, weight, d)
        corner_slopes(x - a, y - b, z, k, weight, d)
        corner_slopes(x - a, y + b, z, k, -weight, d)
        corner_slopes(x + a, y - b, z, k, -weight, d)
