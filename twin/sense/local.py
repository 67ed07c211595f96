"""Forces are expected where some were found: a prior of each picture's own, for loads on a part of the surface.

The priors of `twin.sense.problem` are the same at every site. Where a probe touches a tenth of them, the weight that
keeps the others quiet smooths the press more than its markers' noise asks for, and the totals hold the noise of all.
Here the forces of a first solution say where forces are expected: with a_k their size around site k over the largest,
and A = diag(a_k), the penalty is F^T A^-1 Q A^-1 F, and a site with a_k below `LEAST` carries none. What comes out says
it again. Without the average over neighbours this is FOCUSS (I. F. Gorodnitsky and B. D. Rao, IEEE Trans. Signal
Process. 45 (1997) 600), which draws a load together into single sites; that average, and few turns, keep it from that.

Why here the most likely weight is right: the prior's shape is now that of the load (see `weigh.automatic_weight`).

Validity: the forces are no longer linear in the shifts. Standard deviations are those given the prior; of a site that
carries no force they say nothing, and `reconstruct` states those of the smooth solution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from twin.arrays import Bools, Floats
from twin.sense.linear import Linear, solved
from twin.sense.problem import Base, Problem
from twin.sense.weigh import Factors, factorise

TURNS = 2
"""Solutions after the first; from one that is known beforehand, such as the last frame's, one is enough."""

AROUND = 1.0
"""Standard deviation of the average over neighbours, sites."""

LEAST = 0.03
"""Expected size of a force, over the largest, below which a site carries none: the smooth solution's noise is about
half of it. A press this much weaker than the strongest goes unseen, so it is not raised for the sake of time."""


def expected(force_n: Floats, grid: tuple[int, int]) -> Floats:
    """Return (k,) the size of the forces that (k, 3) forces lead to expect, over the largest; 0 below `LEAST`."""
    squared = gaussian_filter(
        ((force_n / np.abs(force_n).max()) ** 2).sum(axis=1).reshape(grid), AROUND, mode="constant"
    ).ravel()
    size = np.sqrt(squared / squared.max())
    return np.where(size > LEAST, size, 0.0)


def localised(problem: Problem, force_n: Floats) -> Problem:
    """Return the problem with forces expected where ``force_n`` (k, 3) has some; it must not be zero everywhere."""
    size = expected(force_n, problem.calibration.grid)
    carries = np.repeat(size > 0, 3)
    scale = np.repeat(size, 3)[carries]
    whole = problem.base
    penalty = whole.penalty[np.ix_(carries, carries)] / np.outer(scale, scale)
    if "reduced" not in whole.gram:
        whole.gram["reduced"] = whole.factors.left.T @ whole.transfer
    factors = factorise(whole.gram["reduced"][:, carries], penalty)
    everywhere = np.eye(len(carries))
    everywhere[np.ix_(carries, carries)] = penalty
    base = Base(
        transfer=np.where(carries, whole.transfer, 0.0), penalty=everywhere, gram={}, quadratics={},
        factors=Factors(
            left=whole.factors.left @ factors.left, singular=factors.singular,
            back=_put(carries, factors.back), null=_put(carries, factors.null),
        ),
    )  # fmt: skip
    return replace(problem, base=base, factors=replace(base.factors, singular=factors.singular / problem.size_px))


def solved_locally(
    problem: Problem, whole: Floats, weight: float | str, *, robust: bool, camera: bool
) -> tuple[Linear, Floats]:
    """Solve with forces expected where the smooth solution, then the local one, has some; and (k, 3) deviations, N."""
    found = smooth = solved(problem, whole, "auto", robust=robust, camera=camera)
    rule = "likelihood" if weight == "auto" else weight
    for _ in range(TURNS):
        if not found.force_n.any():
            return smooth, smooth.sd_force_n
        found = solved(localised(problem, found.force_n), whole, rule, robust=robust, camera=camera)
    carries = found.problem.factors.back.any(axis=1).reshape(-1, 3)
    return found, np.where(carries, found.sd_force_n, smooth.sd_force_n)


def _put(where: Bools, rows: Floats) -> Floats:
    out = np.zeros((len(where), rows.shape[1]))
    out[where] = rows
    return out
