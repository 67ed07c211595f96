"""Looking for the best design instead of sampling: differential evolution, then descent along the gradient.

Both look at the cheapest fidelity that tells enough, the linear information where the sweep has it. Every generation
is a batch of designs whose rows are kept like a sweep's, so a killed search goes on where it was: the same seed asks
for the same designs. What is minimised is the score that ranks a sweep (`twin.study.sweep.rank`); noise is in the
linear information as a covariance and tolerances as drawn sensors (``sensors``), so what is found stands them.

Why differential evolution (R. Storn and K. Price 1997): axes may be lists, designs may be impossible, and a generation
is a batch for all cores; scipy has it. Why the gradient after it (L-BFGS-B, R. Byrd et al. 1995): a population finds
the valley, and takes long to find its floor. The gradient is of differences, a batch of one design more than there are
axes, as counts of markers are no smooth function of anything; where steps of lists and whole numbers are in the way it
finds nothing better and costs `SHARE` of the designs. Not Optuna: its samplers propose a few designs at a time from the
ones before, where batches for all cores and a kill at any time want generations.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.parts.sweep import Sweep
from twin.study.sweep.closed import closed
from twin.study.sweep.designs import Designs, designs_at
from twin.study.sweep.rank import scores
from twin.study.sweep.runner import Runner

POPULATION = 8
"""Designs of a generation, times the axes."""

SHARE = 0.2
"""Part of the designs that is for the gradient."""

STEP = 0.01
"""Differences of the gradient, over an axis's range."""

WORST = 1e3
"""Score of an impossible design: worse than any other, and finite."""


def optimised(designs: Designs, runner: Runner) -> Designs:
    """Return the designs that a search looked at, ``count`` of them at most, the sweep's axes being its bounds."""
    from scipy.optimize import differential_evolution

    sweep, scene = designs.sweep, designs.scene
    stage = "linear" if "linear" in sweep.ladder else "closed"
    size = max(5, POPULATION * len(sweep.axes))
    generations = max(1, round((1 - SHARE) * sweep.count) // size - 1)
    looked: list[Floats] = []

    def judged(u: Floats) -> Floats:
        points = np.clip(np.atleast_2d(np.asarray(u).T), 0.0, 1.0).reshape(-1, len(sweep.axes))
        looked.append(points)
        return scored(sweep, designs_at(sweep, scene, points), stage, runner)

    found = differential_evolution(
        judged, [(0.0, 1.0)] * len(sweep.axes), maxiter=generations, popsize=POPULATION, init="sobol", polish=False,
        vectorized=True, updating="deferred", rng=np.random.default_rng(sweep.seed), tol=1e-4,
    )  # fmt: skip
    descend(judged, np.clip(found.x, 0.0, 1.0), looked, sweep.count)
    return designs_at(sweep, scene, np.concatenate(looked))


def descend(judged: Callable[[Floats], Floats], start: Floats, looked: list[Floats], most: int) -> None:
    """Go down the gradient from a design until nothing is gained or ``most`` designs have been looked at."""
    from scipy.optimize import minimize

    width = len(start)

    def batch(u: Floats) -> tuple[float, Floats]:
        if sum(map(len, looked)) + width + 1 > most:
            raise StopIteration
        step = np.where(u + STEP <= 1.0, STEP, -STEP)
        score = judged(np.concatenate([u[None], u + np.diag(step)]).T)
        slope = (score[1:] - score[0]) / step
        return float(score[0]), np.where(np.abs(score[1:]) < WORST, slope, 0.0)

    with suppress(StopIteration):
        minimize(batch, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * width)


def scored(sweep: Sweep, designs: Designs, stage: str, runner: Runner) -> Floats:
    """Return (m,) finite scores of designs, impossible ones being worst."""
    first = closed(designs)
    columns = {f"closed_{k}": v for k, v in first.columns.items()}
    ok = first.reason == ""
    if stage == "linear":
        numbers = np.flatnonzero(ok)
        rows = runner.rows("linear", [designs.values(int(n)) for n in numbers])
        for number, row in zip(numbers, rows, strict=True):
            ok[number] = row["status"] == "ok"
            for name, value in _numbers(row).items():
                columns.setdefault(f"linear_{name}", np.full(len(designs), np.nan))[number] = value
    score = scores(sweep, columns)
    return np.where(ok & np.isfinite(score), np.minimum(score, WORST / 2), WORST)


def _numbers(row: dict[str, Any]) -> dict[str, float]:
    return {k: v for k, v in row.items() if k not in ("status", "error")}
