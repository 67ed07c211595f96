"""The elastic half-space under point forces and uniform rectangles: displacement, gradient, stress.

Each rectangle (`twin.parts.load.Rectangles`) lies on the surface of its own half-space: the plane through its centre,
normal to the third row of its frame. Rectangles of no size are point forces. The closed forms, their sources and
their sign are in `twin.theory.halfspace_kernels`.

Validity: small strain, linear isotropic rubber, points on or below every rectangle's plane. A real body is not a
half-space: on the 40 mm block these formulas alone are 9 to 17 % wrong, so they are the first half of the answer
(`twin.world.elasticity.compliance` adds the rest), or the model that a sensor believes in.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats, Points
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.theory.halfspace_kernels import rectangle_slopes, rectangle_terms


def displacement(points: Points, load: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float) -> Points:
    """Return the (n, 3) displacement in mm of ``points`` (n, 3) under all rectangles together."""
    if len(load) > 1 and not load.half_mm.any() and (load.frames == load.frames[0]).all():
        turn = load.frames[0]
        parts = (np.ascontiguousarray((each @ turn.T).T) for each in (points, load.centre_mm, load.force_n))
        moved = np.zeros((3, len(points)))
        _of_point_forces(*parts, 1.0 - 2.0 * poisson_ratio, moved)
        out = np.asarray(moved.T @ turn)
    else:
        out = np.zeros((len(points), 3))
        _displacement(*_pairs(points, load), _c(load.force_n), 1.0 - 2.0 * poisson_ratio, out)
    return out * scale(youngs_modulus_mpa, poisson_ratio)


def compliance(points: Points, rectangles: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float) -> Floats:
    """Return the (3 n, 3 k) displacement in mm/N of ``points`` under a unit force in x, y, z on each rectangle."""
    out = np.empty((3 * len(points), 3 * len(rectangles)))
    _compliance(*_pairs(points, rectangles), 1.0 - 2.0 * poisson_ratio, out)
    out *= scale(youngs_modulus_mpa, poisson_ratio)
    return out


def gradient(points: Points, load: Rectangles, youngs_modulus_mpa: float, poisson_ratio: float) -> Floats:
    """Return (n, 3, 3) du_i/dx_j (no unit) at ``points``; infinite edge values at the surface are given as finite."""
    out = np.zeros((len(points), 3, 3))
    _gradient(*_pairs(points, load), _c(load.force_n), 1.0 - 2.0 * poisson_ratio, out)
    return out * scale(youngs_modulus_mpa, poisson_ratio)


def stress(points: Points, load: Rectangles, poisson_ratio: float) -> Floats:
    """Return the (n, 3, 3) stress in MPa at ``points``; E does not enter, and nu = 1/2 is no exception.

    Notes
    -----
    sigma = G (grad u + grad u^T) + lambda div u, where lambda div u = -(nu / pi) integral of f . x / r^3 stays finite.
    """
    out = np.empty((len(points), 3, 3))
    _stress(*_pairs(points, load), _c(load.force_n), poisson_ratio, out)
    return out


def scale(youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return c = (1 + nu) / (2 pi E), mm2/N: what the kernels leave out."""
    return (1.0 + poisson_ratio) / (2.0 * math.pi * youngs_modulus_mpa)


def _c(array: Floats) -> Floats:
    return np.ascontiguousarray(array, float)


def _pairs(points: Points, load: Rectangles) -> tuple[Floats, Floats, Floats, Floats]:
    return _c(points), _c(load.centre_mm), _c(load.frames), _c(load.half_mm)


@njit(cache=True)
def _local(point: Floats, centre: Floats, frame: Floats) -> tuple[float, float, float]:
    """Return the point in the rectangle's frame; round-off and hair's breadths above its plane count as on it."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    x = frame[0, 0] * dx + frame[0, 1] * dy + frame[0, 2] * dz
    y = frame[1, 0] * dx + frame[1, 1] * dy + frame[1, 2] * dz
    z = frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz
    return x, y, max(z, 0.0)


@njit(cache=True)
def _displacement(
    points: Floats, centre: Floats, frames: Floats, half: Floats, force: Floats, k: float, out: Floats
) -> None:
    u, n = np.empty((3, 3)), np.empty(3)
    local = np.empty_like(force)
    for t in range(len(centre)):
        local[t] = frames[t] @ force[t]
    for q in range(len(points)):
        for t in range(len(centre)):
            frame = frames[t]
            x, y, z = _local(points[q], centre[t], frame)
            rectangle_terms(x, y, z, half[t, 0], half[t, 1], k, u, n)
            fx, fy, fz = local[t]
            ux = u[0, 0] * fx + u[0, 1] * fy + u[0, 2] * fz
            uy = u[1, 0] * fx + u[1, 1] * fy + u[1, 2] * fz
            uz = u[2, 0] * fx + u[2, 1] * fy + u[2, 2] * fz
            for i in range(3):
                out[q, i] += frame[0, i] * ux + frame[1, i] * uy + frame[2, i] * uz


@njit(cache=True, fastmath={"reassoc", "contract"})
def _of_point_forces(points: Floats, centre: Floats, force: Floats, k: float, out: Floats) -> None:
    """Add to ``out`` (3, n) at ``points`` (3, n) the sums over forces (3, t) at ``centre`` (3, t), all in one frame.

    `_displacement` of points only. Points run innermost, so that several are done at once without a sum among them: a
    pair takes a thirtieth of the time.
    """
    for t in range(centre.shape[1]):
        x, y, z = centre[0, t], centre[1, t], centre[2, t]
        fx, fy, fz = force[0, t], force[1, t], force[2, t]
        for q in range(points.shape[1]):
            dx, dy, dz = points[0, q] - x, points[1, q] - y, max(points[2, q] - z, 0.0)
            r2 = dx * dx + dy * dy + dz * dz
            r = math.sqrt(r2)
            over_both = 1.0 / (r2 + r * dz)
            over_r, s = (r + dz) * over_both, r * over_both
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
def _compliance(points: Floats, centre: Floats, frames: Floats, half: Floats, k: float, out: Floats) -> None:
    u, n, v = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
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
                    )  # fmt: skip


@njit(cache=True)
def _local_gradient(
    x: float, y: float, z: float, half: Floats, frame: Floats, force: Floats, k: float, d: Floats, n: Floats, g: Floats
) -> None:
    """Set g (3, 3) to du_i/dx_m of one rectangle in its own frame, over c, and n to the mean of x_j / r^3."""
    rectangle_slopes(x, y, z, half[0], half[1], k, d, n)
    g[:] = 0.0
    for j in range(3):
        f = frame[j, 0] * force[0] + frame[j, 1] * force[1] + frame[j, 2] * force[2]
        for i in range(3):
            for m in range(3):
                g[i, m] += d[i, j, m] * f


@njit(cache=True)
def _add_turned(g: Floats, frame: Floats, out: Floats) -> None:
    """Add a tensor given in the rectangle's frame to ``out`` in global axes."""
    for i in range(3):
        for m in range(3):
            total = 0.0
            for p in range(3):
                for s in range(3):
                    total += frame[p, i] * g[p, s] * frame[s, m]
            out[i, m] += total


@njit(cache=True)
def _gradient(
    points: Floats, centre: Floats, frames: Floats, half: Floats, force: Floats, k: float, out: Floats
) -> None:
    d, n, g = np.empty((3, 3, 3)), np.empty(3), np.empty((3, 3))
    for q in range(len(points)):
        for t in range(len(centre)):
            x, y, z = _local(points[q], centre[t], frames[t])
            _local_gradient(x, y, z, half[t], frames[t], force[t], k, d, n, g)
            _add_turned(g, frames[t], out[q])


@njit(cache=True)
def _stress(
    points: Floats, centre: Floats, frames: Floats, half: Floats, force: Floats, nu: float, out: Floats
) -> None:
    k = 1.0 - 2.0 * nu
    d, n, g, s = np.empty((3, 3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(points)):
        out[q] = 0.0
        for t in range(len(centre)):
            frame = frames[t]
            x, y, z = _local(points[q], centre[t], frame)
            _local_gradient(x, y, z, half[t], frame, force[t], k, d, n, g)
            mean = 0.0
            for j in range(3):
                f = frame[j, 0] * force[t, 0] + frame[j, 1] * force[t, 1] + frame[j, 2] * force[t, 2]
                mean -= nu / math.pi * n[j] * f
            for i in range(3):
                for m in range(3):
                    s[i, m] = 0.25 / math.pi * (g[i, m] + g[m, i])
                s[i, i] += mean
            _add_turned(s, frame, out[q])
