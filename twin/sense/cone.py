"""Forces that a probe can exert: pushes only, or pushes with friction, by active sets on the regularised problem.

With A = H^T H + (w/2) Q and b = H^T M in the sites' own frames, both minimise 1/2 F^T A F - b^T F, under F_n >= 0
(flat paper, eq. 13) or under Coulomb's cone |F_t| <= mu F_n.

Why active sets: a probe touches few of the sites, so the systems to solve hold few unknowns, and the active set of one
frame is nearly that of the next. Fz >= 0 has its tangential part eliminated beforehand (a Schur complement) and is
solved by block principal pivoting (Portugal, Judice and Vicente, Math. Comp. 63 (1994) 625); the cone on the sites that
carry force by Newton's method (`twin.sense.cone_newton`).

Validity: weights below `LEAST` times the largest curvature of H^T H have to be raised to it by the caller: H^T H holds
no more in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dposv

from twin.arrays import Bools, Floats
from twin.sense.cone_newton import SINGLE, newton, onto_cone, project_onto_cone, pull

LEAST = 1e-12
"""Smallest weight over the largest curvature."""

GOAL = 1e-11
"""KKT residual that ends the iterations."""

LOOSE = 1e-6
"""The same while the sites that carry force are still being found."""

CLEAR = 0.1
"""Share of the largest push above which a site of the solution without bounds is taken to carry force at first."""

PATIENCE = 4
"""Block exchanges without progress before single ones, which cannot cycle."""

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

    @cached_property
    def _freely(self) -> Floats:
        """Normal forces without bounds, from their reduced linear term."""
        return np.asarray(np.linalg.inv(self._split[0]))

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
        if start is None:
            freely = self._freely @ reduced
            start = freely > CLEAR * freely.max(initial=0.0)
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


def _block_pivoting(matrix: Floats, linear: Floats, start: Bools) -> tuple[Floats, Bools, float]:
    """Solve x >= 0, y = S x - q >= 0, x y = 0 by exchanging all wrong signs at once, or the last one when stuck."""
    count = len(linear)
    scale = float(np.abs(linear).max(initial=0.0))
    if scale == 0.0:
        return np.zeros(count), np.zeros(count, bool), 0.0
    free = start
    best, patience, value = count + 1, PATIENCE, np.zeros(count)
    for _ in range(100 + 10 * count):
        value[:] = 0.0
        where = np.flatnonzero(free)
        if len(where):
            block = matrix[where][:, where]
            _, part, failed = dposv(block, linear[where], lower=1)
            value[where] = part if failed == 0 else np.linalg.lstsq(block, linear[where], rcond=None)[0]
        slack = matrix @ value - linear
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


def _working_set(matrix: Floats, linear: Floats, mu: float, start: Floats) -> tuple[Floats, float]:
    """Solve on the sites that carry force and those that the optimality conditions add, until none is added."""
    scale = float(np.abs(linear).max(initial=0.0))
    if scale == 0.0:
        return np.zeros_like(start), 0.0
    rate = 1.0 / np.diag(matrix).reshape(-1, 3).mean(axis=1)
    force, inside, goal = start.copy(), np.asarray(start.any(axis=1), np.bool_), LOOSE
    for _ in range(MOST_GROWTH):
        where = np.flatnonzero(inside)
        gradient = pull(matrix, where, force[where]) - linear.reshape(-1, 3)
        if len(where):
            force[where], gradient = newton(
                matrix, where, force[where], gradient, mu, rate[where], goal * scale, SINGLE * scale
            )
        onto, _ = onto_cone(force - rate[:, None] * gradient, mu)
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
