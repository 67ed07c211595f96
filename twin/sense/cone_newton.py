"""Coulomb's cone on sites that may carry force: the projection onto it, and Newton's method on what that gives.

A semismooth Newton method on F = P(F - D (A F - b)), P the projection onto the cones (Facchinei and Pang,
Finite-Dimensional Variational Inequalities, sec. 9.1; the cone's derivative as in Fukushima, Luo and Tseng, SIAM J.
Optim. 12 (2001) 436), whose steps are symmetric systems along the derivative's axes, without those that slipping sites
can't move along. Which sites may carry force is found in `twin.sense.cone`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv, sposv

from twin.arrays import Floats, Ints
from twin.compiled import njit

SINGLE = 1e-4
"""Above this residual Newton's steps are solved in single precision: what they point at is not the end yet."""

LEAST_SHARE = 1e-12
"""Eigenvalue of the projection's derivative below which it is none: at the cone's tip."""

MOST_NEWTON, HALVINGS = 60, 6


def project_onto_cone(force: Floats, mu: float) -> Floats:
    """Return the (k, 3) nearest forces with |F_t| <= mu F_n; local axes, the normal last."""
    return onto_cone(np.asarray(force, float), mu)[0]


def onto_cone(force: Floats, mu: float) -> tuple[Floats, Ints]:
    """Return the (k, 3) projection of forces, as `project_onto_cone`, and (k,) kinds: 0 no force, 1 slips, 2 sticks."""
    tangent, normal = force[:, :2], force[:, 2]
    length = np.sqrt((tangent**2).sum(axis=1))
    kind = np.where(length <= mu * normal, 2, np.where(mu * length <= -normal, 0, 1))
    carried = (normal + mu * length) / (1 + mu**2)
    safe = np.where(length > 0, length, 1.0)
    slipping = np.column_stack([(mu * carried / safe)[:, None] * tangent, carried])
    out = np.where((kind == 2)[:, None], force, np.where((kind == 1)[:, None], slipping, 0.0))
    return out, kind


def _project_axes(force: Floats, kind: Ints, mu: float) -> tuple[Floats, Floats]:
    """Return (k, 3, 3) orthonormal axes, the columns, and (k, 3) eigenvalues of the derivative of the projection.

    Where a force sticks all are 1; where it slips they are 1 along the cone, a share across it, and 0 off it.
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


def newton(
    matrix: Floats, where: Ints, start: Floats, gradient: Floats, mu: float, rate: Floats, goal: float, single: float
) -> tuple[Floats, Floats]:
    """Semismooth Newton with a line search on the residual; sites that carry nothing drop out of the system.

    Parameters
    ----------
    matrix
        (3k, 3k) A, px^2/N^2.
    where
        (n,) sites that may carry force; all others carry none.
    start
        (n, 3) first guess of their forces in local axes, N.
    gradient
        (k, 3) A F - b at the first guess, px^2/N.
    mu
        Coulomb's coefficient, > 0.
    rate
        (n,) D by site, N^2/px^2.
    goal, single
        Residuals, px^2/N: at which to end, and above which steps are solved in single precision.

    Returns
    -------
    force, gradient
        (n, 3) and (k, 3), the same at the best forces found, which lie in the cone.
    """

    def residual(force: Floats, slope: Floats) -> tuple[Floats, Floats, Ints, float]:
        trial = force - rate[:, None] * slope
        onto, kind = onto_cone(trial, mu)
        miss = force - onto
        return miss, trial, kind, float(np.abs(miss / rate[:, None]).max())

    force = start
    miss, trial, kind, size = residual(force, gradient[where])
    best, best_gradient, least = force, gradient, size
    for _ in range(MOST_NEWTON):
        if size <= goal:
            break
        step = _newton_step(matrix, where, rate, mu, miss, trial, kind, np.float32 if size > single else np.float64)
        change = pull(matrix, where, step)
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
    inside = project_onto_cone(best, mu)
    return inside, best_gradient + pull(matrix, where, inside - best)


@njit(cache=True, fastmath=True)
def pull(matrix, where, force):  # type: ignore[no-untyped-def]
    """Return (k, 3) A F of forces at the sites ``where`` alone, without copying their rows."""
    out = np.zeros(len(matrix))
    for i in range(len(where)):
        x, y, z = force[i, 0], force[i, 1], force[i, 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        first, second, third = matrix[3 * where[i]], matrix[3 * where[i] + 1], matrix[3 * where[i] + 2]
        for column in range(len(out)):
            out[column] += x * first[column] + y * second[column] + z * third[column]
    return out.reshape(-1, 3)


@njit(cache=True, fastmath=True)
def _turned(matrix, active, axes, sought, diagonal, system):  # type: ignore[no-untyped-def]
    """Fill the lower triangle of ``system`` with v.(A w) of the sought axes v, w of the active sites.

    ``diagonal`` is added to the diagonal. In one pass: as array expressions it took most of a solve.
    """
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
                            half[a, 0] * axes[j, 0, e] + half[a, 1] * axes[j, 1, e] + half[a, 2] * axes[j, 2, e]
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
    precision: type[np.floating],
) -> Floats:
    """Return the (k, 3) step that makes the linearised residual vanish, solved in a precision.

    With the projection's derivative P = sum a v v^T the step s solves (1 - a) v.s + a rate v.(A s) = -v.miss for every
    v: at once where a is 0, and divided by a rate a symmetric positive definite system for the others.
    """
    step, active = -miss, np.flatnonzero(kind > 0)
    if not len(active):
        return step
    axes, share = _project_axes(trial[active], kind[active], mu)
    along = np.einsum("nij,ni->nj", axes, miss[active])
    sought = (share > LEAST_SHARE).ravel()
    known = np.where(share > LEAST_SHARE, 0.0, -along)
    step[active] = np.einsum("nij,nj->ni", axes, known)
    pulled = np.einsum("nij,ni->nj", axes, pull(matrix, where, step)[where[active]])
    gain = (share * rate[active][:, None]).ravel()[sought]
    size = int(sought.sum())
    system = np.zeros((size, size), precision)
    _turned(matrix, where[active], axes, sought.reshape(-1, 3), (1.0 - share.ravel()[sought]) / gain, system)
    right = -along.ravel()[sought] / gain - pulled.ravel()[sought]
    solve = sposv if precision is np.float32 else dposv
    _, part, failed = solve(
        system.T, right.astype(precision), lower=0, overwrite_a=1
    )  # its transpose as LAPACK has it: no copy
    if failed:
        return -miss if solve is dposv else _newton_step(matrix, where, rate, mu, miss, trial, kind, np.float64)
    known.ravel()[sought] = part
    step[active] = np.einsum("nij,nj->ni", axes, known)
    return step
