"""Forces that a probe can exert: pushes only, or pushes with friction, by active sets on the
regularised problem.

With A = H^T H + (w/2) Q and b = H^T M in the sites' own frames, both minimise 1/2 F^T A F - b^T F,
under F_n >= 0 (flat paper, eq. 13) or under Coulomb's cone |F_t| <= mu F_n.

A probe touches few of the sites, so the systems are small, and the active set of one frame is
nearly that of the next. F_n >= 0 has its tangential part eliminated (a Schur complement) and is
solved by block principal pivoting (Portugal, Judice and Vicente, Math. Comp. 63 (1994) 625). The
cone is solved by a semismooth Newton method on F = P(F - D (A F - b)), P the projection onto the
cones (Facchinei and Pang, Finite-Dimensional Variational Inequalities, sec. 9.1; the cone's
derivative as in Fukushima, Luo and Tseng, SIAM J. Optim. 12 (2001) 436). Its steps are symmetric
systems along the derivative's axes. ADMM takes four times as long at 180 sites.

Validity: weights below `LEAST` times the largest curvature of H^T H have to be raised to it by the
caller: H^T H holds no more in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dposv

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit

LEAST_SHARE = 1e-12
"""Eigenvalue of the projection's derivative below which it is none: at the cone's tip."""

MOST_NEWTON, HALVINGS = 60, 6


def _onto_cone(force: Floats, mu: float) -> tuple[Floats, Ints]:
    """Return the (k, 3) nearest forces with |F_t| <= mu F_n, in local axes, the normal last; and
    (k,) kinds: 0 no force, 1 slips, 2 sticks."""
    tangent, normal = force[:, :2], force[:, 2]
    length = np.sqrt((tangent**2).sum(axis=1))
    kind = np.where(length <= mu * normal, 2, np.where(mu * length <= -normal, 0, 1))
    carried = (normal + mu * length) / (1 + mu**2)
    safe = np.where(length > 0, length, 1.0)
    slipping = np.column_stack([(mu * carried / safe)[:, None] * tangent, carried])
    out = np.where((kind == 2)[:, None], force, np.where((kind == 1)[:, None], slipping, 0.0))
    return out, kind


def _project_axes(force: Floats, kind: Ints, mu: float) -> tuple[Floats, Floats]:
    """Return (k, 3, 3) orthonormal axes, the columns, and (k, 3) eigenvalues of the derivative of
    the projection.

    Where a force sticks all are 1; where it slips they are 1 along the cone, a share across it, and
    0 off it.
    """
    axes, share = np.tile(np.eye(3), (len(force), 1, 1)), np.ones((len(force), 3))
    slips = kind == 1
    if slips.any():
        tangent, normal = force[slips, :2], force[slips, 2]
        length = np.sqrt((tangent**2).sum(axis=1))
        unit = tangent / length[:, None]
        size = np.sqrt(1 + mu**2)
        turned = np.zeros((len(unit), 3, 3))
        turned[:, :2, 0], turned[:, 2, 0] = mu * unit / size, 1 / size
        turned[:, 0, 1], turned[:, 1, 1] = -unit[:, 1], unit[:, 0]
        turned[:, :2, 2], turned[:, 2, 2] = unit / size, -mu / size
        axes[slips] = turned
        share[slips, 1] = mu * (normal + mu * length) / (1 + mu**2) / length
        share[slips, 2] = 0.0
    return axes, share


def _newton(
    matrix: Floats,
    where: Ints,
    start: Floats,
    gradient: Floats,
    mu: float,
    rate: Floats,
    goal: float,
) -> tuple[Floats, Floats]:
    """Semismooth Newton with a line search on the residual; sites that carry nothing drop out of
    the system.

    Only the sites ``where`` (n,) may carry force. ``start`` (n, 3) is a first guess, ``gradient``
    (k, 3) A F - b there; ``rate`` (n,) is D by site, N^2/px^2. Ends at the residual ``goal``,
    px^2/N. Returns forces and gradient of the same shapes at the best forces found, which lie in
    the cone.
    """

    def residual(force: Floats, slope: Floats) -> tuple[Floats, Floats, Ints, float]:
        trial = force - rate[:, None] * slope
        onto, kind = _onto_cone(trial, mu)
        miss = force - onto
        return miss, trial, kind, float(np.abs(miss / rate[:, None]).max())

    force = start
    miss, trial, kind, size = residual(force, gradient[where])
    best, best_gradient, least = force, gradient, size
    for _ in range(MOST_NEWTON):
        if size <= goal:
            break
        step = _newton_step(matrix, where, rate, mu, miss, trial, kind)
        change = _pull(matrix, where, step)
        length = 1.0
        for _ in range(HALVINGS):
            after = residual(force + length * step, gradient[where] + length * change[where])
            if after[3] < size:
                break
            length *= 0.5
        force, gradient = force + length * step, gradient + length * change
        miss, trial, kind, size = after
        if size < least:
            best, best_gradient, least = force, gradient, size
    inside, _ = _onto_cone(best, mu)
    return inside, best_gradient + _pull(matrix, where, inside - best)


@njit(cache=True, fastmath=True)
def _pull(matrix, where, force):
    """Return (k, 3) A F of forces at the sites ``where`` alone, without copying their rows."""
    out = np.zeros(len(matrix))
    for i in range(len(where)):
        x, y, z = force[i, 0], force[i, 1], force[i, 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        first, second, third = (
            matrix[3 * where[i]],
            matrix[3 * where[i] + 1],
            matrix[3 * where[i] + 2],
        )
        for column in range(len(out)):
            out[column] += x * first[column] + y * second[column] + z * third[column]
    return out.reshape(-1, 3)


@njit(cache=True, fastmath=True)
def _turned(matrix, active, axes, sought, diagonal, system):
    """Fill the lower triangle of ``system`` with v.(A w) of the sought axes v, w of the active
    sites, and add ``diagonal`` to its diagonal. One pass: array expressions took most of a
    solve."""
    half = np.empty((3, 3))
    row = 0
    for i in range(len(active)):
        start, column = row, 0
        for j in range(i + 1):
            for a in range(3):
                for d in range(3):
                    half[a, d] = (
                        axes[i, 0, a] * matrix[3 * active[i], 3 * active[j] + d]
                        + axes[i, 1, a] * matrix[3 * active[i] + 1, 3 * active[j] + d]
                        + axes[i, 2, a] * matrix[3 * active[i] + 2, 3 * active[j] + d]
                    )
            for e in range(3):
                if not sought[j, e]:
                    continue
                row = start
                for a in range(3):
                    if sought[i, a]:
                        system[row, column] = (
                            half[a, 0] * axes[j, 0, e]
                            + half[a, 1] * axes[j, 1, e]
                            + half[a, 2] * axes[j, 2, e]
                        )
                        row += 1
                column += 1
        row = start
        for a in range(3):
            if sought[i, a]:
                system[row, row] += diagonal[row]
                row += 1


def _newton_step(
    matrix: Floats,
    where: Ints,
    rate: Floats,
    mu: float,
    miss: Floats,
    trial: Floats,
    kind: Ints,
) -> Floats:
    """Return the (k, 3) step that makes the linearised residual vanish.

    With the projection's derivative P = sum a v v^T the step s solves (1 - a) v.s + a rate v.(A s)
    = -v.miss for every v: at once where a is 0, else divided by a rate, a symmetric positive
    definite system.
    """
    step, active = -miss, np.flatnonzero(kind > 0)
    if not len(active):
        return step
    axes, share = _project_axes(trial[active], kind[active], mu)
    along = np.einsum("nij,ni->nj", axes, miss[active])
    sought = (share > LEAST_SHARE).ravel()
    known = np.where(share > LEAST_SHARE, 0.0, -along)
    step[active] = np.einsum("nij,nj->ni", axes, known)
    pulled = np.einsum("nij,ni->nj", axes, _pull(matrix, where, step)[where[active]])
    gain = (share * rate[active][:, None]).ravel()[sought]
    size = int(sought.sum())
    system = np.zeros((size, size))
    diagonal = (1.0 - share.ravel()[sought]) / gain
    _turned(matrix, where[active], axes, sought.reshape(-1, 3), diagonal, system)
    right = -along.ravel()[sought] / gain - pulled.ravel()[sought]
    # its transpose is as LAPACK has it: no copy
    _, part, failed = dposv(system.T, right, lower=0, overwrite_a=1)
    if failed:
        return -miss
    known.ravel()[sought] = part
    step[active] = np.einsum("nij,nj->ni", axes, known)
    return step


LEAST = 1e-12
"""Smallest weight over the largest curvature."""

GOAL = 1e-11
"""KKT residual that ends the iterations."""

LOOSE = 1e-6
"""The same while the sites that carry force are still being found."""

CLEAR = 0.1
"""Share of the largest push above which a site of the solution without bounds is taken to carry
force at first."""

PATIENCE = 4
"""Block exchanges without progress before single ones, which cannot cycle."""

MOST_GROWTH, GROWTH, LEAST_GROWTH = 100, 0.6, 8
"""How often sites may be added to those that carry force, and how many at once: a share, and at
least."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadratic:
    """1/2 F^T A F - b^T F in local axes (tangent s, tangent t, inward normal), for one weight.

    Attributes
    ----------
    curvature
        (3k, 3k) A, px^2/N^2.
    """

    curvature: Floats

    @cached_property
    def _split(self) -> tuple[Floats, Floats, Floats]:
        """Schur complement on the normals, the tangential factor, and tangential response to normal
        forces."""
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
        """Inverse of the Schur complement."""
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
        sideways = scipy.linalg.cho_solve((factor, True), linear[:, :2].ravel(), check_finite=False)
        reduced = linear[:, 2] - response.T @ linear[:, :2].ravel()
        if start is None:
            freely = self._freely @ reduced
            start = freely > CLEAR * freely.max(initial=0.0)
        normal, free, kkt = _block_pivoting(schur, reduced, start)
        tangent = (sideways - response @ normal).reshape(-1, 2)
        return np.column_stack([tangent, normal]), free, kkt

    def cone(self, linear: Floats, mu: float, start: Floats | None = None) -> tuple[Floats, float]:
        """Solve under |F_t| <= mu F_n; return the (k, 3) local forces and the KKT residual,
        relative as in `pushes`.

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
        return _working_set(self.curvature, linear, mu, _onto_cone(start, mu)[0])


def _block_pivoting(matrix: Floats, linear: Floats, start: Bools) -> tuple[Floats, Bools, float]:
    """Solve x >= 0, y = S x - q >= 0, x y = 0 by exchanging all wrong signs at once, or the last
    one when stuck."""
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
            if failed:
                part = np.linalg.lstsq(block, linear[where], rcond=None)[0]
            value[where] = part
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
    uneven = float(np.abs(gradient[free]).max(initial=0.0))
    return value, free, max(uneven, float(-gradient.min(initial=0.0))) / scale


def _working_set(matrix: Floats, linear: Floats, mu: float, start: Floats) -> tuple[Floats, float]:
    """Solve on the sites that carry force and those that the optimality conditions add."""
    scale = float(np.abs(linear).max(initial=0.0))
    if scale == 0.0:
        return np.zeros_like(start), 0.0
    rate = 1.0 / np.diag(matrix).reshape(-1, 3).mean(axis=1)
    force, inside, goal = start.copy(), np.asarray(start.any(axis=1), np.bool_), LOOSE
    for _ in range(MOST_GROWTH):
        where = np.flatnonzero(inside)
        gradient = _pull(matrix, where, force[where]) - linear.reshape(-1, 3)
        if len(where):
            force[where], gradient = _newton(
                matrix, where, force[where], gradient, mu, rate[where], goal * scale
            )
        onto, _ = _onto_cone(force - rate[:, None] * gradient, mu)
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
