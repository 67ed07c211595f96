"""Forces that a probe can exert: pushes only, or pushes with friction, by active sets on the regularised problem.

With A = H^T H + (w/2) Q and b = H^T M in the sites' own frames, both minimise 1/2 F^T A F - b^T F, under F_n >= 0
(flat paper, eq. 13) or under Coulomb's cone |F_t| <= mu F_n.

Why active sets: a probe touches few of the sites, so the systems to solve hold few unknowns, and the active set of one
frame is nearly that of the next. Fz >= 0 has its tangential part eliminated beforehand (a Schur complement) and is
solved by block principal pivoting (Portugal, Judice and Vicente, Math. Comp. 63 (1994) 625); the cone by a semismooth
Newton method on F = P(F - D (A F - b)), P the projection onto the cones (Facchinei and Pang, Finite-Dimensional
Variational Inequalities, sec. 9.1; the cone's derivative as in Fukushima, Luo and Tseng, SIAM J. Optim. 12 (2001) 436).

Validity: weights below `LEAST` times the largest curvature of H^T H have to be raised to it by the caller: H^T H holds
no more in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dposv

from twin.arrays import Bools, Floats, Ints

LEAST = 1e-12
"""Smallest weight over the largest curvature."""

GOAL = 1e-11
"""KKT residual that ends the iterations."""

LOOSE = 1e-6
"""The same while the sites that carry force are still being found."""

SINGLE = 1e-4
"""Above this residual Newton's steps are solved in single precision: what they point at is not the end yet."""

PATIENCE = 4
"""Block exchanges without progress before single ones, which cannot cycle."""

MOST_NEWTON, HALVINGS = 60, 6

MOST_GROWTH, GROWTH, LEAST_GROWTH = 100, 0.6, 8
"""How often sites may be added to those that carry force, and how many at once: a share, and at least."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadratic:
    """1/2 F^T A F - b^T F in local axes (tangent s, tangent t, inward normal), for one weight.

    Attributes
    ----------
    curvature
        (3k, 3k) A, px^2/N^2.
    """

    curvature: Floats

    @property
    def count(self) -> int:
        """Number of sites."""
        return len(self.curvature) // 3

    @cached_property
    def _split(self) -> tuple[Floats, Floats, Floats]:
        """Schur complement on the normals, the tangential factor, and tangential response to normal forces."""
        normal = np.arange(2, len(self.curvature), 3)
        tangent = np.delete(np.arange(len(self.curvature)), normal)
        factor = scipy.linalg.cholesky(self.curvature[np.ix_(tangent, tangent)], lower=True)
        across = self.curvature[np.ix_(tangent, normal)]
        half = scipy.linalg.solve_triangular(factor, across, lower=True)
        schur = self.curvature[np.ix_(normal, normal)] - half.T @ half
        response = scipy.linalg.solve_triangular(factor.T, half, lower=False)
        return np.asarray((schur + schur.T) / 2), factor, response

    def pushes(self, linear: Floats, start: Bools | None = None) -> tuple[Floats, Bools, float]:
        """Solve under F_n >= 0.

        Parameters
        ----------
        linear
            (3k,) b, px^2/N.
        start
            (k,) sites expected to carry force, such as the last frame's.

        Returns
        -------
        force
            (k, 3) local forces, N.
        free
            (k,) sites whose normal force is not held at zero.
        kkt
            Largest violation of the optimality conditions over the largest gradient at F = 0.
        """
        schur, factor, response = self._split
        linear = linear.reshape(-1, 3)
        beside = scipy.linalg.cho_solve((factor, True), linear[:, :2].ravel(), check_finite=False)
        reduced = linear[:, 2] - response.T @ linear[:, :2].ravel()
        normal, free, kkt = _block_pivoting(schur, reduced, start)
        tangent = (beside - response @ normal).reshape(-1, 2)
        return np.column_stack([tangent, normal]), free, kkt

    def cone(self, linear: Floats, mu: float, start: Floats | None = None) -> tuple[Floats, float]:
        """Solve under |F_t| <= mu F_n; return the (k, 3) local forces and the KKT residual, relative as in `pushes`.

        Parameters
        ----------
        linear
            (3k,) b, px^2/N.
        mu
            Coulomb's coefficient, > 0.
        start
            (k, 3) first guess, such as the last frame's forces; that under F_n >= 0 if not given.
        """
        if start is None:
            start, free, _ = self.pushes(linear)
            start = np.where(free[:, None], start, 0.0)
        return _working_set(self.curvature, linear, mu, project_onto_cone(start, mu))


def _block_pivoting(matrix: Floats, linear: Floats, start: Bools | None) -> tuple[Floats, Bools, float]:
    """Solve x >= 0, y = S x - q >= 0, x y = 0 by exchanging all wrong signs at once, or the last one when stuck."""
    count = len(linear)
    scale = float(np.abs(linear).max(initial=0.0))
    if scale == 0.0:
        return np.zeros(count), np.zeros(count, bool), 0.0
    free = np.asarray(linear > 0 if start is None else start.copy(), np.bool_)
    best, patience, value = count + 1, PATIENCE, np.zeros(count)
    for _ in range(100 + 10 * count):
        value[:] = 0.0
        where = np.flatnonzero(free)
        if len(where):
            block = matrix[np.ix_(where, where)]
            _, part, failed = dposv(block, linear[where], lower=1)
            value[where] = part if failed == 0 else np.linalg.lstsq(block, linear[where], rcond=None)[0]
        slack = matrix[:, where] @ value[where] - linear
        slack[where] = 0.0
        size = float(np.abs(value).max(initial=0.0))
        wrong = (free & (value < -1e-14 * size)) | (~free & (slack < -1e-12 * scale))
        bad = int(wrong.sum())
        if bad == 0:
            break
        if bad < best:
            best, patience = bad, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free = free ^ wrong
    value = np.maximum(value, 0.0)
    gradient = matrix @ value - linear
    kkt = max(float(np.abs(gradient[free]).max(initial=0.0)), float(-gradient.min(initial=0.0))) / scale
    return value, free, kkt


def project_onto_cone(force: Floats, mu: float) -> Floats:
    """Return the (k, 3) nearest forces with |F_t| <= mu F_n; local axes, the normal last."""
    return _project(np.asarray(force, float), mu)[0]


def _project(force: Floats, mu: float) -> tuple[Floats, Ints]:
    """Return the projection and its kind by site: 0 no force, 1 slips, 2 sticks."""
    tangent, normal = force[:, :2], force[:, 2]
    length = np.sqrt((tangent**2).sum(axis=1))
    kind = np.where(length <= mu * normal, 2, np.where(mu * length <= -normal, 0, 1))
    carried = (normal + mu * length) / (1 + mu**2)
    safe = np.where(length > 0, length, 1.0)
    slipping = np.column_stack([(mu * carried / safe)[:, None] * tangent, carried])
    out = np.where((kind == 2)[:, None], force, np.where((kind == 1)[:, None], slipping, 0.0))
    return out, kind


def _project_derivative(force: Floats, kind: Ints, mu: float) -> Floats:
    """Return (k, 3, 3) derivatives of the projection."""
    out = np.zeros((len(force), 3, 3))
    out[kind == 2] = np.eye(3)
    slips = kind == 1
    if slips.any():
        tangent, normal = force[slips, :2], force[slips, 2]
        length = np.sqrt((tangent**2).sum(axis=1))
        unit = tangent / length[:, None]
        share = 1 / (1 + mu**2)
        carried = (normal + mu * length) * share
        block = np.zeros((len(unit), 3, 3))
        outer = unit[:, :, None] * unit[:, None, :]
        around = (mu * carried / length)[:, None, None]
        block[:, :2, :2] = mu**2 * share * outer + around * (np.eye(2) - outer)
        block[:, :2, 2] = block[:, 2, :2] = mu * share * unit
        block[:, 2, 2] = share
        out[slips] = block
    return out


def _working_set(matrix: Floats, linear: Floats, mu: float, start: Floats) -> tuple[Floats, float]:
    """Solve on the sites that carry force and those that the optimality conditions add, until none is added."""
    scale = float(np.abs(linear).max(initial=0.0))
    if scale == 0.0:
        return np.zeros_like(start), 0.0
    rate = 1.0 / np.diag(matrix).reshape(-1, 3).mean(axis=1)
    force, inside, goal = start.copy(), np.asarray(start.any(axis=1), np.bool_), LOOSE
    for _ in range(MOST_GROWTH):
        where = np.flatnonzero(inside)
        rows = (3 * where[:, None] + np.arange(3)).ravel()
        block = matrix[rows]
        if len(where):
            some = block[:, rows]
            force[where] = _newton(some, linear[rows], mu, force[where], rate[where], goal * scale, SINGLE * scale)
        gradient = (force[where].ravel() @ block - linear).reshape(-1, 3)
        onto, _ = _project(force - rate[:, None] * gradient, mu)
        wrong = np.abs((force - onto) / rate[:, None]).max(axis=1) / scale
        missing = np.flatnonzero(~inside & (wrong > goal))
        if len(missing):
            most = max(LEAST_GROWTH, int(GROWTH * len(where)))
            inside = np.asarray(force.any(axis=1), np.bool_)
            inside[missing[np.argsort(-wrong[missing])[:most]]] = True
        elif goal > GOAL:
            goal = GOAL
        else:
            break
    return force, float(wrong.max())


def _newton(
    matrix: Floats, linear: Floats, mu: float, start: Floats, rate: Floats, goal: float, single: float
) -> Floats:
    """Semismooth Newton with a line search on the residual; sites that carry nothing drop out of the system."""

    def residual(force: Floats, gradient: Floats) -> tuple[Floats, Floats, Ints, float]:
        trial = force - rate[:, None] * gradient
        onto, kind = _project(trial, mu)
        miss = force - onto
        return miss, trial, kind, float(np.abs(miss / rate[:, None]).max())

    force, gradient = start, (matrix @ start.ravel() - linear).reshape(-1, 3)
    miss, trial, kind, size = residual(force, gradient)
    best, least = force, size
    for _ in range(MOST_NEWTON):
        if size <= goal:
            break
        step = _newton_step(matrix, rate, mu, miss, trial, kind, np.float32 if size > single else np.float64)
        change = (matrix @ step.ravel()).reshape(-1, 3)
        length = 1.0
        for _ in range(HALVINGS):
            after = residual(force + length * step, gradient + length * change)
            if after[3] < size:
                break
            length *= 0.5
        force, gradient = force + length * step, gradient + length * change
        miss, trial, kind, size = after
        if size < least:
            best, least = force, size
    return project_onto_cone(best, mu)


def _newton_step(
    matrix: Floats, rate: Floats, mu: float, miss: Floats, trial: Floats, kind: Ints, precision: type[np.floating]
) -> Floats:
    """Return the (k, 3) step that makes the linearised residual vanish, solved in a precision."""
    step = -miss
    active = np.flatnonzero(kind > 0)
    if not len(active):
        return step
    slope = _project_derivative(trial[active], kind[active], mu)
    gain = slope * rate[active][:, None, None]
    rows = (3 * active[:, None] + np.arange(3)).ravel()
    block = matrix[rows]
    system = np.matmul(gain, block[:, rows].reshape(len(active), 3, -1)).reshape(len(rows), len(rows))
    each = np.arange(len(active))
    system.reshape(len(active), 3, len(active), 3)[each, :, each, :] += np.eye(3) - slope
    right = -miss[active]
    idle = np.flatnonzero((kind == 0) & miss.any(axis=1))
    if len(idle):
        columns = (3 * idle[:, None] + np.arange(3)).ravel()
        pull = (block[:, columns] @ step[idle].ravel()).reshape(-1, 3)
        right = right - np.einsum("nij,nj->ni", gain, pull)
    step[active] = np.linalg.solve(system.astype(precision), right.ravel().astype(precision)).reshape(-1, 3)
    return step
