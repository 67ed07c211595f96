"""The elastic half-space under point forces and uniform rectangles: displacement, gradient, stress.

Each rectangle (`twin.parts.load.Rectangles`) lies on the surface of its own half-space: the plane
through its centre, normal to the third row of its frame. Rectangles of no size are point forces.

Everything derives from three harmonic functions of the distance r from the load, z into the body
(A. E. H. Love 1929, Phil. Trans. A 228; K. L. Johnson, Contact Mechanics, ch. 3): with
H = z ln(r + z) - r the displacement of a force f on the surface is

    u_i = c [delta_ij / r + x_i x_j / r^3 + (1 - 2 nu) V_ij] f_j,     c = (1 + nu) / (2 pi E),
    V_xx = -H_xx, V_xy = -H_xy, V_yy = -H_yy,
    V_xz = -V_zx = -H_xz, V_yz = -V_zy = -H_yz, V_zz = H_zz = 1/r.

A uniform rectangle is the same, integrated twice: sums over the corners (x -+ a, y -+ b) with
alternating sign of a coordinate times a logarithm or an arctangent. Those with the same factor are
brought together in pairs first: fewer are left to compute, and nothing cancels that needn't. For
nu < 1/2 the three arctangents of a corner are two, since

    atan[xy / (zr)] = atan[xy (r - z) / (x^2 r + y^2 z)] + atan[xy (r - z) / (y^2 r + x^2 z)].

The kernels work in the frame of the load and return everything divided by c, per unit force. k is
1 - 2 nu; -nu/pi n . f with n_j = x_j / r^3 is lambda div u, which stays finite at nu = 1/2.

Validity: small strain, linear isotropic rubber, sides of 1e-30 to 1e30 mm, points on or below every
rectangle's plane, or over it next to the rectangle and just over itself (a hollow face), where the
same formulas go on. Infinite values on a rectangle's edges at the surface are finite. On the 40 mm
block these formulas alone are 9 to 17 % wrong: `twin.world.elasticity.compliance` adds the rest.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats, Points, for_kernel
from twin.compiled import njit
from twin.parts.load import Rectangles

GAUSS_2 = (-0.5773502691896257, 0.5773502691896257)
"""Gauss points of order 2 on (-1, 1)."""

_FAR_3, _FAR_2 = 8.0, 40.0
"""Beyond these distances, in half diagonals, 3 x 3 and 2 x 2 Gauss points replace the corners
(error below 1e-7)."""

_TINY = 1e-300
_CHUNK = 4_000_000
"""Entries of a compliance matrix that are held at once."""


def displacement(
    points: Points, load: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float
) -> Points:
    """Return the displacement under all rectangles together.

    Parameters
    ----------
    points
        (n, 3) points, mm, not above a rectangle but where its face is hollow.
    load
        k rectangles and their forces, N, along the axes of the body; z leads into it.
    youngs_modulus_mpa, poisson_ratio
        Of the half-space; up to 1/2, inclusive.

    Returns
    -------
    (n, 3) displacement, mm. Equations, sources and validity stand at the head of the module.
    """
    if len(load) > 1 and not load.half_mm.any() and (load.frames == load.frames[0]).all():
        turn = load.frames[0]
        parts = (
            np.ascontiguousarray((each @ turn.T).T)
            for each in (points, load.centre_mm, load.force_n)
        )
        moved = np.zeros((3, len(points)))
        _of_point_forces(*parts, 1.0 - 2.0 * poisson_ratio, moved)
        return np.asarray(moved.T @ turn) * _scale(youngs_modulus_mpa, poisson_ratio)
    out = np.empty((len(points), 3))
    step = max(1, _CHUNK // (9 * max(len(load), 1)))
    for start in range(0, len(points), step):
        some = slice(start, start + step)
        moved = compliance(points[some], load, youngs_modulus_mpa, poisson_ratio)
        out[some] = (moved @ load.force_n.ravel()).reshape(-1, 3)
    return out


def compliance(
    points: Points, rectangles: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float
) -> Floats:
    """Return the displacement under unit forces on each rectangle: the columns whose sum, times the
    forces, is `displacement`.

    Parameters
    ----------
    points
        (n, 3) points, mm, not above a rectangle but where its face is hollow.
    rectangles
        k rectangles; their forces don't count.
    youngs_modulus_mpa, poisson_ratio
        Of the half-space.

    Returns
    -------
    (3 n, 3 k) displacement, mm/N: rows by point, then axis; columns by rectangle, then axis.
    """
    out = np.empty((3 * len(points), 3 * len(rectangles)))
    _compliance(*_pairs(points, rectangles), 1.0 - 2.0 * poisson_ratio, out)
    out *= _scale(youngs_modulus_mpa, poisson_ratio)
    return out


def normal_compliance(
    rectangles: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float
) -> Floats:
    """Return the (k, k) normal displacement in mm/N of the centres of rectangles in one plane,
    frames along the axes, per unit normal force on each: the mean of 1 / r (Boussinesq; Love
    1929)."""
    out = np.empty((len(rectangles), len(rectangles)))
    _normal(for_kernel(rectangles.centre_mm), for_kernel(rectangles.half_mm), out)
    out *= (1.0 - poisson_ratio**2) / (math.pi * youngs_modulus_mpa)
    return out


def gradient(
    points: Points, load: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float
) -> Floats:
    """Return how the displacement changes from place to place; for the parameters see
    `displacement`.

    Returns
    -------
    (n, 3, 3) du_i/dx_j, without a unit; on a rectangle's edges, where it is infinite, finite.
    """
    slope, _ = _slopes(points, load, poisson_ratio)
    return slope * _scale(youngs_modulus_mpa, poisson_ratio)


def stress(points: Points, load: Rectangles, poisson_ratio: float) -> Floats:
    """Return the stress under all rectangles together; for the parameters see `displacement`.

    Returns
    -------
    (n, 3, 3) stress, MPa, tension positive: sigma = G (grad u + grad u^T) + lambda div u, which
    stays finite at nu = 1/2 and is independent of E.
    """
    slope, pull = _slopes(points, load, poisson_ratio)
    out = 0.25 / math.pi * (slope + slope.transpose(0, 2, 1))
    out[:, range(3), range(3)] -= poisson_ratio / math.pi * pull[:, None]
    return np.asarray(out)


def _scale(youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return c = (1 + nu) / (2 pi E), mm2/N."""
    return (1.0 + poisson_ratio) / (2.0 * math.pi * youngs_modulus_mpa)


def _slopes(points: Points, load: Rectangles, poisson_ratio: float) -> tuple[Floats, Floats]:
    """Return du_i/dx_j over c (n, 3, 3), and the sums of n . f (n,)."""
    slope = np.zeros((len(points), 3, 3))
    pull = np.zeros(len(points))
    _gradient(
        *_pairs(points, load), for_kernel(load.force_n), 1.0 - 2.0 * poisson_ratio, slope, pull
    )
    return slope, pull


def _pairs(points: Points, load: Rectangles) -> tuple[Floats, Floats, Floats, Floats]:
    return (
        for_kernel(points),
        for_kernel(load.centre_mm),
        for_kernel(load.frames),
        for_kernel(load.half_mm),
    )


@njit(cache=True)
def _local(point: Floats, centre: Floats, frame: Floats) -> tuple[float, float, float]:
    """Return the point in the rectangle's frame."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    x = frame[0, 0] * dx + frame[0, 1] * dy + frame[0, 2] * dz
    y = frame[1, 0] * dx + frame[1, 1] * dy + frame[1, 2] * dz
    z = frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz
    return x, y, z


@njit(cache=True, fastmath={"reassoc", "contract"})
def _of_point_forces(points: Floats, centre: Floats, force: Floats, k: float, out: Floats) -> None:
    """Add to ``out`` (3, n) at ``points`` (3, n) the sums over forces (3, t) at ``centre`` (3, t),
    all in one frame. Points run innermost, for the vector unit."""
    for t in range(centre.shape[1]):
        x, y, z = centre[0, t], centre[1, t], centre[2, t]
        fx, fy, fz = force[0, t], force[1, t], force[2, t]
        for q in range(points.shape[1]):
            dx = points[0, q] - x
            dy = points[1, q] - y
            dz = points[2, q] - z
            # 1/r and 1/(r + z) from one division.
            r2 = dx * dx + dy * dy + dz * dz
            r = math.sqrt(r2)
            over_both = 1.0 / (r2 + r * dz)
            over_r = (r + dz) * over_both
            s = r * over_both
            # Kelvin's part, and that of a compressible half-space, with k = 1 - 2 nu.
            aside = dx * fx + dy * fy
            pull = (aside + dz * fz) * over_r * over_r * over_r
            slope = k * over_r * s
            sideways = pull - slope * (aside * s + fz)
            out[0, q] += fx * (over_r + k * s) + dx * sideways
            out[1, q] += fy * (over_r + k * s) + dy * sideways
            out[2, q] += fz * over_r * (1.0 + k) + dz * pull + slope * aside
    for q in range(points.shape[1]):
        if not math.isfinite(out[2, q]):
            for t in range(centre.shape[1]):
                same = points[0, q] == centre[0, t] and points[1, q] == centre[1, t]
                if same and points[2, q] <= centre[2, t]:
                    raise ZeroDivisionError("a point force moves its own place infinitely far")


@njit(cache=True)
def _compliance(
    points: Floats, centre: Floats, frames: Floats, half: Floats, k: float, out: Floats
) -> None:
    u = np.empty((3, 3))
    n = np.empty(3)
    v = np.empty((3, 3))
    for q in range(len(points)):
        for t in range(len(centre)):
            frame = frames[t]
            x, y, z = _local(points[q], centre[t], frame)
            rectangle_terms(x, y, z, half[t, 0], half[t, 1], k, u, n)
            if frame[0, 0] == 1.0 and frame[1, 1] == 1.0 and frame[2, 2] == 1.0:
                for i in range(3):
                    for j in range(3):
                        out[3 * q + i, 3 * t + j] = u[i, j]
                continue
            for i in range(3):
                for j in range(3):
                    v[i, j] = u[i, 0] * frame[0, j] + u[i, 1] * frame[1, j] + u[i, 2] * frame[2, j]
            for i in range(3):
                for j in range(3):
                    out[3 * q + i, 3 * t + j] = (
                        frame[0, i] * v[0, j] + frame[1, i] * v[1, j] + frame[2, i] * v[2, j]
                    )


@njit(cache=True, fastmath={"reassoc", "contract"})
def _normal(centre: Floats, half: Floats, out: Floats) -> None:
    """Set ``out`` (k, k) to the means of 1 / r over each rectangle, from each centre."""
    for t in range(len(centre)):
        a, b = half[t]
        size = a * a + b * b
        for q in range(len(centre)):
            x, y = centre[q, 0] - centre[t, 0], centre[q, 1] - centre[t, 1]
            squared = x * x + y * y
            # Far away a few Gauss points are as exact as the closed form.
            if squared > _FAR_3 * _FAR_3 * size:
                nodes = _FOUR if squared > _FAR_2 * _FAR_2 * size else _NINE
                mean = 0.0
                for i in range(len(nodes)):
                    px, py = x - a * nodes[i, 0], y - b * nodes[i, 1]
                    mean += nodes[i, 2] / math.sqrt(px * px + py * py)
                out[q, t] = mean
                continue
            # Love's closed form from the four corners.
            x1 = x + a
            x2 = x - a
            y1 = y + b
            y2 = y - b
            xx1 = x1 * x1
            xx2 = x2 * x2
            yy1 = y1 * y1
            yy2 = y2 * y2
            r11, r12 = math.sqrt(xx1 + yy1), math.sqrt(xx1 + yy2)
            r21, r22 = math.sqrt(xx2 + yy1), math.sqrt(xx2 + yy2)
            x_log_y = x1 * _log_ratio(y1, r11, y2, r12, xx1)
            x_log_y -= x2 * _log_ratio(y1, r21, y2, r22, xx2)
            y_log_x = y1 * _log_ratio(x1, r11, x2, r21, yy1)
            y_log_x -= y2 * _log_ratio(x1, r12, x2, r22, yy2)
            out[q, t] = (x_log_y + y_log_x) * 0.25 / (a * b)


@njit(cache=True)
def _gradient(
    points: Floats,
    centre: Floats,
    frames: Floats,
    half: Floats,
    force: Floats,
    k: float,
    out: Floats,
    pull: Floats,
) -> None:
    """Add du_i/dx_m over c to ``out`` (n, 3, 3) and n . f to ``pull`` (n,), of all rectangles."""
    d = np.empty((3, 3, 3))
    n = np.empty(3)
    g = np.empty((3, 3))
    for q in range(len(points)):
        for t in range(len(centre)):
            frame = frames[t]
            x, y, z = _local(points[q], centre[t], frame)
            rectangle_slopes(x, y, z, half[t, 0], half[t, 1], k, d, n)
            for i in range(3):
                for m in range(3):
                    g[i, m] = 0.0
            for j in range(3):
                f = (
                    frame[j, 0] * force[t, 0]
                    + frame[j, 1] * force[t, 1]
                    + frame[j, 2] * force[t, 2]
                )
                pull[q] += n[j] * f
                for i in range(3):
                    for m in range(3):
                        g[i, m] += d[i, j, m] * f
            # back to global axes
            for i in range(3):
                for m in range(3):
                    total = 0.0
                    for p in range(3):
                        for s in range(3):
                            total += frame[p, i] * g[p, s] * frame[s, m]
                    out[q, i, m] += total


@njit(cache=True)
def rectangle_terms(
    x: float, y: float, z: float, a: float, b: float, k: float, u: Floats, n: Floats
) -> None:
    """Set u (3, 3) and n (3,) to the mean over -a..a by -b..b; a = b = 0 is a point force."""
    distance = x * x + y * y + z * z
    size = a * a + b * b
    if size == 0.0:
        if x == y == 0.0 and z <= 0.0:
            raise ZeroDivisionError("a point force moves its own place infinitely far")
        _point_terms(x, y, z, a, b, k, _ONE, u, n)
    elif distance > _FAR_2 * _FAR_2 * size:
        _point_terms(x, y, z, a, b, k, _FOUR, u, n)
    elif distance > _FAR_3 * _FAR_3 * size:
        _point_terms(x, y, z, a, b, k, _NINE, u, n)
    else:
        _closed_terms(x, y, z, a, b, k, u, n)


@njit(cache=True)
def rectangle_slopes(
    x: float, y: float, z: float, a: float, b: float, k: float, d: Floats, n: Floats
) -> None:
    """Set d (3, 3, 3), du_i/dx_m per unit force j, and n (3,) to the mean over -a..a by -b..b."""
    for i in range(3):
        n[i] = 0.0
        for j in range(3):
            for m in range(3):
                d[i, j, m] = 0.0
    distance = x * x + y * y + z * z
    size = a * a + b * b
    if size > 0.0 and distance <= _FAR_3 * _FAR_3 * size:
        _closed_slopes(x, y, z, a, b, k, d, n)
        return
    nodes = _ONE if size == 0.0 else (_FOUR if distance > _FAR_2 * _FAR_2 * size else _NINE)
    for q in range(len(nodes)):
        _point_slopes(x - a * nodes[q, 0], y - b * nodes[q, 1], z, k, nodes[q, 2], d, n)


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
    """Set u (3, 3), indexed [displacement, force], and n_j = x_j / r^3 (3,) to the weighted sums
    over point forces at ``nodes``, (q, 3) shares of a and b, and weights."""
    one = 0.0
    xx = 0.0
    yy = 0.0
    zz = 0.0
    xy = 0.0
    xz = 0.0
    yz = 0.0
    nx, ny, nz = 0.0, 0.0, 0.0
    # Kelvin's part, which every half-space has: 1/r and x_i x_j / r^3.
    for q in range(len(nodes)):
        px = x - a * nodes[q, 0]
        py = y - b * nodes[q, 1]
        weight = nodes[q, 2]
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
    v00 = 0.0
    v11 = 0.0
    v01 = 0.0
    v02 = 0.0
    v12 = 0.0
    # The part of a compressible half-space, with k = 1 - 2 nu: terms in 1 / (r + z).
    if k != 0.0:
        for q in range(len(nodes)):
            px = x - a * nodes[q, 0]
            py = y - b * nodes[q, 1]
            weight = nodes[q, 2]
            r = math.sqrt(px * px + py * py + z * z)
            ws = weight / (r + z)
            wrs = ws / r
            wrss = wrs / (r + z)
            v00 += ws - px * px * wrss
            v11 += ws - py * py * wrss
            v01 -= px * py * wrss
            v02 -= px * wrs
            v12 -= py * wrs
    # Put the sums together: displacement by direction of the force.
    u[0, 0], u[1, 1], u[2, 2] = one + xx + k * v00, one + yy + k * v11, one * (1.0 + k) + zz
    u[0, 1] = u[1, 0] = xy + k * v01
    u[0, 2], u[2, 0] = xz + k * v02, xz - k * v02
    u[1, 2], u[2, 1] = yz + k * v12, yz - k * v12
    n[0], n[1], n[2] = nx, ny, nz


@njit(cache=True)
def _point_slopes(
    x: float, y: float, z: float, k: float, weight: float, d: Floats, n: Floats
) -> None:
    """Add ``weight`` times d[i, j, m] = du_i/dx_m per unit force j, and n_j = x_j / r^3."""
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
    # Third derivatives of H, from which the slopes of V are made; zero at nu = 1/2.
    s = 1.0 / (1.0 / over_r + z)
    t = over_r * s * s
    q = k * weight * t * over_r * (over_r + 2.0 * s)
    t *= k * weight
    v = k * weight * over_r * s * over_r * (over_r + s)
    hxxx = x * (3.0 * t - x * x * q)
    hxxy = y * (t - x * x * q)
    hxyy = x * (t - y * y * q)
    hyyy = y * (3.0 * t - y * y * q)
    hz = k * weight * over_r * s
    hxxz = hz - x * x * v
    hyyz = hz - y * y * v
    hxyz = -x * y * v
    w3 *= k
    _add_slopes(d, hxxx, hxxy, hxyy, hyyy, hxxz, hyyz, hxyz, -x * w3, -y * w3, -z * w3)


@njit(cache=True, forceinline=True)
def _log(over: float, under: float) -> float:
    """Return ln(over / under), neither negative; one that is 0 counts as 1."""
    return math.log((over if over > 0.0 else 1.0) / (under if under > 0.0 else 1.0))


@njit(cache=True, forceinline=True)
def _log_ratio(y1: float, r1: float, y2: float, r2: float, rest: float) -> float:
    """Return ln[(y1 + r1) / (y2 + r2)], y1 > y2, r^2 = y^2 + rest, without cancellation; 0 if
    infinite."""
    if y2 >= 0.0:
        over, under = y1 + r1, y2 + r2
    elif y1 < 0.0:
        over, under = r2 - y2, r1 - y1
    else:
        over = (y1 + r1) * (r2 - y2)
        under = rest
    return math.log(over / under) if under > _TINY * over else 0.0


@njit(cache=True, forceinline=True)
def _turn(s1: float, c1: float, s2: float, c2: float) -> float:
    """Return the angle of c1 + i s1 less that of c2 + i s2, each between -pi and pi."""
    turn = math.atan2(s1 * c2 - c1 * s2, c1 * c2 + s1 * s2)
    if s1 * s2 < 0.0 and s1 * turn < 0.0:
        turn += math.copysign(2.0 * math.pi, s1)
    return turn


@njit(cache=True, forceinline=True)
def _over(y: float, r: float, rest: float) -> float:
    """Return 1 / [r (r + y)] without cancellation; 0 on the line where it is singular."""
    if r == 0.0 or rest == 0.0:
        return 0.0 if y <= 0.0 or r == 0.0 else 0.5 / (r * r)
    return 1.0 / (r * (r + y)) if y >= 0.0 else (r - y) / (r * rest)


@njit(cache=True)
def _solid_angle(
    x1: float,
    x2: float,
    y1: float,
    y2: float,
    z: float,
    r11: float,
    r12: float,
    r21: float,
    r22: float,
) -> float:
    """Return the sum of atan(x y / (z r)) over the corners, signs alternating: the solid angle of
    the rectangle.

    It is the argument of a product of four complex numbers, up to a turn: more than pi is seen from
    above the rectangle only. Past the edges it has the sign of z; through the rectangle it goes on
    growing.
    """
    if z != 0.0:
        a = x1 * z * (y1 * r12 - y2 * r11)
        b = z * z * r11 * r12 + x1 * x1 * y1 * y2
        c = x2 * z * (y2 * r21 - y1 * r22)
        d = z * z * r21 * r22 + x2 * x2 * y1 * y2
        angle = math.atan2(a * d + b * c, b * d - a * c)
        if x1 > 0.0 > x2 and y1 > 0.0 > y2:
            angle += 2.0 * math.pi * ((angle < 0.0) + (z < 0.0))
        return angle
    # the limit z -> 0 of atan(x y / (z r)) is a quarter turn of the sign of x y
    one, two = math.atan2(x1 * y1, 0.0), math.atan2(x1 * y2, 0.0)
    return one - two - math.atan2(x2 * y1, 0.0) + math.atan2(x2 * y2, 0.0)


@njit(cache=True)
def _closed_terms(
    x: float, y: float, z: float, a: float, b: float, k: float, u: Floats, n: Floats
) -> None:
    """Set u (3, 3) and n (3,), to the means over -a..a by -b..b."""
    # Distances from the four corners of the rectangle.
    x1 = x + a
    x2 = x - a
    y1 = y + b
    y2 = y - b
    xx1 = x1 * x1
    xx2 = x2 * x2
    yy1 = y1 * y1
    yy2 = y2 * y2
    zz = z * z
    r11, r12 = math.sqrt(xx1 + yy1 + zz), math.sqrt(xx1 + yy2 + zz)
    r21, r22 = math.sqrt(xx2 + yy1 + zz), math.sqrt(xx2 + yy2 + zz)
    # Integrals of 1/r along the sides are logarithms; over the area, the solid angle joins them.
    log_y1, log_y2 = _log_ratio(y1, r11, y2, r12, xx1 + zz), _log_ratio(y1, r21, y2, r22, xx2 + zz)
    log_x1, log_x2 = _log_ratio(x1, r11, x2, r21, yy1 + zz), _log_ratio(x1, r12, x2, r22, yy2 + zz)
    x_log_y, y_log_x = x1 * log_y1 - x2 * log_y2, y1 * log_x1 - y2 * log_x2
    log_y = log_y1 - log_y2
    log_x = log_x1 - log_x2
    r = r11 - r12 - r21 + r22
    xy = -r
    xz = -z * log_y
    yz = -z * log_x
    w = 0.25 / (a * b)
    v00 = 0.0
    v11 = 0.0
    s1 = 0.0
    s2 = 0.0
    # With k = 1 - 2 nu = 0 the terms of 1 / (r + z) vanish, and only their sum, the solid angle,
    # is left.
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
        log_1, log_2, across = (
            _log(r11 + z, r12 + z),
            _log(r21 + z, r22 + z),
            _log(r12 + z, r22 + z),
        )
        s1 = k * (
            y1 * (log_1 - log_2 + across) - y2 * across + z * log_y + x1 * turn_y1 - x2 * turn_y2
        )
        s2 = k * (x1 * log_1 - x2 * log_2 + z * log_x + y1 * turn_x1 - y2 * turn_x2)
        v00, v11 = k * (x_log_y - z * (turn_y1 - turn_y2)), k * (y_log_x - z * (turn_x1 - turn_x2))
        xy -= k * (z * (log_1 - log_2) - r)
    # The integral of 1/r over the rectangle; every component is made of it and of its derivatives.
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
def _closed_slopes(
    x: float, y: float, z: float, a: float, b: float, k: float, d: Floats, n: Floats
) -> None:
    """Add the means of `_point_slopes` over the rectangle -a..a by -b..b."""
    # Distances from the four corners of the rectangle.
    x1 = x + a
    x2 = x - a
    y1 = y + b
    y2 = y - b
    xx1 = x1 * x1
    xx2 = x2 * x2
    yy1 = y1 * y1
    yy2 = y2 * y2
    zz = z * z
    r11, r12 = math.sqrt(xx1 + yy1 + zz), math.sqrt(xx1 + yy2 + zz)
    r21, r22 = math.sqrt(xx2 + yy1 + zz), math.sqrt(xx2 + yy2 + zz)
    w = 0.25 / (a * b)
    # First derivatives of the integral of 1/r.
    log_y = w * (_log_ratio(y1, r11, y2, r12, xx1 + zz) - _log_ratio(y1, r21, y2, r22, xx2 + zz))
    log_x = w * (_log_ratio(x1, r11, x2, r21, yy1 + zz) - _log_ratio(x1, r12, x2, r22, yy2 + zz))
    angle = w * _solid_angle(x1, x2, y1, y2, z, r11, r12, r21, r22)
    # Second derivatives: sums over the corners, with the sign of each.
    a_sum = 0.0
    xa = 0.0
    xxa = 0.0
    b_sum = 0.0
    yb = 0.0
    yyb = 0.0
    over = 0.0
    xr = 0.0
    yr = 0.0
    xs = 0.0
    ys = 0.0
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
    # Kelvin's part of the slopes, component by component.
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
    # The part of a compressible half-space.
    if k == 0.0:
        return
    log_z = w * (_log(r11 + z, r12 + z) - _log(r21 + z, r22 + z))
    turn = _turn(x1 * y1 * (r11 - z), xx1 * r11 + yy1 * z, x1 * y2 * (r12 - z), xx1 * r12 + yy2 * z)
    turn -= _turn(
        x2 * y1 * (r21 - z), xx2 * r21 + yy1 * z, x2 * y2 * (r22 - z), xx2 * r22 + yy2 * z
    )
    turn *= w
    _add_slopes(
        d,
        k * (ys - log_y),
        -k * xs,
        -k * ys,
        k * (xs - log_x),
        k * turn,
        k * (angle - turn),
        k * log_z,
        k * log_y,
        k * log_x,
        -k * angle,
    )


@njit(cache=True)
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
    # by the numbers of x and of y among the indices i, j, m; V_zx and V_zy have H's sign
    third = (hzzz, hyzz, hyyz, hyyy, hxzz, hxyz, hxyy, hxxz, hxxy, hxxx)
    first = (0, 4, 7, 9)
    for i in range(3):
        for j in range(3):
            for m in range(3):
                slope = third[
                    first[(i == 0) + (j == 0) + (m == 0)] + (i == 1) + (j == 1) + (m == 1)
                ]
                d[i, j, m] += slope if i == 2 else -slope
