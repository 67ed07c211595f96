"""The half-space under a uniform rectangle, in closed form: A. E. H. Love's potentials at the four corners.

Every term is a sum over the corners (x_i, y_j) = (x -+ a, y -+ b) with alternating sign of a coordinate times a
logarithm or an arctangent. Logarithms and arctangents with the same factor are first brought together, in pairs
(`_log_ratio`, `_turn`): half as many, or fewer, are left to compute, and nothing cancels that needn't. For nu < 1/2 the
three arctangents of a corner are two, since

    atan[xy / (zr)] = atan[xy (r - z) / (x^2 r + y^2 z)] + atan[xy (r - z) / (y^2 r + x^2 z)].

Validity: sides of 1e-30 to 1e30 mm, or products of eight lengths leave the range of numbers.

What stands for an infinite value on the rectangle's edges at the surface is finite, and 0 where its factor is.
"""

from __future__ import annotations

import math

from twin.arrays import Floats
from twin.compiled import njit

_TINY = 1e-300


@njit(cache=True, inline="always")
def _log(over: float, under: float) -> float:
    """Return ln(over / under), neither negative; one that is 0 counts as 1."""
    return math.log((over if over > 0.0 else 1.0) / (under if under > 0.0 else 1.0))


@njit(cache=True, inline="always")
def _log_ratio(y1: float, r1: float, y2: float, r2: float, rest: float) -> float:
    """Return ln[(y1 + r1) / (y2 + r2)] with y1 > y2 and r^2 = y^2 + rest, without cancellation; 0 if infinite."""
    if y2 >= 0.0:
        over, under = y1 + r1, y2 + r2
    elif y1 < 0.0:
        over, under = r2 - y2, r1 - y1
    else:
        over, under = (y1 + r1) * (r2 - y2), rest
    return math.log(over / under) if under > _TINY * over else 0.0


@njit(cache=True, inline="always")
def _turn(s1: float, c1: float, s2: float, c2: float) -> float:
    """Return atan(s1 / c1) - atan(s2 / c2), c1 and c2 not negative."""
    return math.atan2(s1 * c2 - c1 * s2, c1 * c2 + s1 * s2)


@njit(cache=True, inline="always")
def _over(y: float, r: float, rest: float) -> float:
    """Return 1 / [r (r + y)] without cancellation; 0 on the line where it is singular."""
    if r == 0.0 or rest == 0.0:
        return 0.0 if y <= 0.0 or r == 0.0 else 0.5 / (r * r)
    return 1.0 / (r * (r + y)) if y >= 0.0 else (r - y) / (r * rest)


@njit(cache=True)
def _quadrant(x: float, y: float) -> float:
    """Return the limit z -> 0 of atan(x y / (z r))."""
    product = x * y
    if product > 0.0:
        return 0.5 * math.pi
    return -0.5 * math.pi if product < 0.0 else 0.0


@njit(cache=True)
def _solid_angle(
    x1: float, x2: float, y1: float, y2: float, z: float, r11: float, r12: float, r21: float, r22: float
) -> float:
    """Return the sum of atan(x y / (z r)) over the corners, signs alternating: the solid angle of the rectangle.

    It is the argument of a product of four complex numbers, up to a turn: more than pi is seen from above the rectangle
    only, and from beside it never less than 0 but by round-off.
    """
    if z > 0.0:
        a, b = x1 * z * (y1 * r12 - y2 * r11), z * z * r11 * r12 + x1 * x1 * y1 * y2
        c, d = x2 * z * (y2 * r21 - y1 * r22), z * z * r21 * r22 + x2 * x2 * y1 * y2
        angle = math.atan2(a * d + b * c, b * d - a * c)
        return angle + 2.0 * math.pi if angle < 0.0 and x1 > 0.0 > x2 and y1 > 0.0 > y2 else angle
    return float(_quadrant(x1, y1) - _quadrant(x1, y2) - _quadrant(x2, y1) + _quadrant(x2, y2))


@njit(cache=True)
def closed_terms(x: float, y: float, z: float, a: float, b: float, k: float, u: Floats, n: Floats) -> None:
    """Set u (3, 3) and n (3,), as in `twin.theory.halfspace_kernels`, to the means over |x| <= a, |y| <= b."""
    x1, x2, y1, y2 = x + a, x - a, y + b, y - b
    xx1, xx2, yy1, yy2, zz = x1 * x1, x2 * x2, y1 * y1, y2 * y2, z * z
    r11, r12 = math.sqrt(xx1 + yy1 + zz), math.sqrt(xx1 + yy2 + zz)
    r21, r22 = math.sqrt(xx2 + yy1 + zz), math.sqrt(xx2 + yy2 + zz)
    log_y1, log_y2 = _log_ratio(y1, r11, y2, r12, xx1 + zz), _log_ratio(y1, r21, y2, r22, xx2 + zz)
    log_x1, log_x2 = _log_ratio(x1, r11, x2, r21, yy1 + zz), _log_ratio(x1, r12, x2, r22, yy2 + zz)
    x_log_y, y_log_x = x1 * log_y1 - x2 * log_y2, y1 * log_x1 - y2 * log_x2
    log_y, log_x, r = log_y1 - log_y2, log_x1 - log_x2, r11 - r12 - r21 + r22
    xy, xz, yz, w = -r, -z * log_y, -z * log_x, 0.25 / (a * b)
    v00, v11, s1, s2 = 0.0, 0.0, 0.0, 0.0
    if k == 0.0:
        angle = _solid_angle(x1, x2, y1, y2, z, r11, r12, r21, r22)
    else:
        s11, s12 = x1 * y1 * (r11 - z), x1 * y2 * (r12 - z)
        s21, s22 = x2 * y1 * (r21 - z), x2 * y2 * (r22 - z)
        turn_y1 = _turn(s11, xx1 * r11 + yy1 * z, s12, xx1 * r12 + yy2 * z)
        turn_y2 = _turn(s21, xx2 * r21 + yy1 * z, s22, xx2 * r22 + yy2 * z)
        turn_x1 = _turn(s11, yy1 * r11 + xx1 * z, s21, yy1 * r21 + xx2 * z)
        turn_x2 = _turn(s12, yy2 * r12 + xx1 * z, s22, yy2 * r22 + xx2 * z)
        angle = turn_y1 - turn_y2 + turn_x1 - turn_x2
        log_1, log_2, across = _log(r11 + z, r12 + z), _log(r21 + z, r22 + z), _log(r12 + z, r22 + z)
        s1 = k * (y1 * (log_1 - log_2 + across) - y2 * across + z * log_y + x1 * turn_y1 - x2 * turn_y2)
        s2 = k * (x1 * log_1 - x2 * log_2 + z * log_x + y1 * turn_x1 - y2 * turn_x2)
        v00, v11 = k * (x_log_y - z * (turn_y1 - turn_y2)), k * (y_log_x - z * (turn_x1 - turn_x2))
        xy -= k * (z * (log_1 - log_2) - r)
    potential = x_log_y + y_log_x - z * angle
    u[0, 0] = w * (2.0 * potential - x_log_y + v00)
    u[1, 1] = w * (2.0 * potential - y_log_x + v11)
    u[2, 2] = w * ((1.0 + k) * potential + z * angle)
    u[0, 1] = w * xy
    u[1, 0] = w * xy
    u[0, 2] = w * (xz - s1)
    u[2, 0] = w * (xz + s1)
    u[1, 2] = w * (yz - s2)
    u[2, 1] = w * (yz + s2)
    n[0] = -w * log_y
    n[1] = -w * log_x
    n[2] = w * angle


@njit(cache=True)
def closed_slopes(x: float, y: float, z: float, a: float, b: float, k: float, d: Floats, n: Floats) -> None:
    """Add the means over the rectangle |x| <= a, |y| <= b of `twin.theory.halfspace_kernels.point_slopes`."""
    x1, x2, y1, y2 = x + a, x - a, y + b, y - b
    xx1, xx2, yy1, yy2, zz = x1 * x1, x2 * x2, y1 * y1, y2 * y2, z * z
    r11, r12 = math.sqrt(xx1 + yy1 + zz), math.sqrt(xx1 + yy2 + zz)
    r21, r22 = math.sqrt(xx2 + yy1 + zz), math.sqrt(xx2 + yy2 + zz)
    w = 0.25 / (a * b)
    log_y = w * (_log_ratio(y1, r11, y2, r12, xx1 + zz) - _log_ratio(y1, r21, y2, r22, xx2 + zz))
    log_x = w * (_log_ratio(x1, r11, x2, r21, yy1 + zz) - _log_ratio(x1, r12, x2, r22, yy2 + zz))
    angle = w * _solid_angle(x1, x2, y1, y2, z, r11, r12, r21, r22)
    a_sum, xa, xxa, b_sum, yb, yyb = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    over, xr, yr, xs, ys = 0.0, 0.0, 0.0, 0.0, 0.0
    for p, q, r, sign in ((x1, y1, r11, w), (x2, y2, r22, w), (x2, y1, r21, -w), (x1, y2, r12, -w)):
        first, second = sign * _over(q, r, p * p + zz), sign * _over(p, r, q * q + zz)
        a_sum += first
        xa += p * first
        xxa += p * p * first
        b_sum += second
        yb += q * second
        yyb += q * q * second
        over_r = sign / r if r > 0.0 else 0.0
        over += over_r
        xr += p * over_r
        yr += q * over_r
        if k != 0.0:
            s = sign / (r + z) if r + z > 0.0 else 0.0
            xs += p * s
            ys += q * s
    for i in range(2):
        d[i, i, 0] += 2.0 * log_y
        d[i, i, 1] += 2.0 * log_x
        d[i, i, 2] -= 2.0 * angle
    d[2, 2, 0] += log_y - zz * a_sum
    d[2, 2, 1] += log_x - zz * b_sum
    d[2, 2, 2] += z * (xa + yb)
    d[0, 0, 0] -= log_y + xxa
    d[0, 0, 1] -= xr
    d[0, 0, 2] -= z * xa
    d[1, 1, 0] -= yr
    d[1, 1, 1] -= log_x + yyb
    d[1, 1, 2] -= z * yb
    for i, j in ((0, 1), (1, 0)):
        d[i, j, 0] -= xr
        d[i, j, 1] -= yr
        d[i, j, 2] -= z * over
    for i, j in ((0, 2), (2, 0)):
        d[i, j, 0] -= z * xa
        d[i, j, 1] -= z * over
        d[i, j, 2] -= log_y + zz * a_sum
    for i, j in ((1, 2), (2, 1)):
        d[i, j, 0] -= z * over
        d[i, j, 1] -= z * yb
        d[i, j, 2] -= log_x + zz * b_sum
    n[0] -= log_y
    n[1] -= log_x
    n[2] += angle
    if k == 0.0:
        return
    log_z = w * (_log(r11 + z, r12 + z) - _log(r21 + z, r22 + z))
    turn = _turn(x1 * y1 * (r11 - z), xx1 * r11 + yy1 * z, x1 * y2 * (r12 - z), xx1 * r12 + yy2 * z)
    turn -= _turn(x2 * y1 * (r21 - z), xx2 * r21 + yy1 * z, x2 * y2 * (r22 - z), xx2 * r22 + yy2 * z)
    turn *= w
    add_slopes(
        d,
        k * (ys - log_y), -k * xs, -k * ys, k * (xs - log_x),
        k * turn, k * (angle - turn), k * log_z, k * log_y, k * log_x, -k * angle,
    )  # fmt: skip


@njit(cache=True)
def add_slopes(
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
