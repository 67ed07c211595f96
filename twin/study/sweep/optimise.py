"""Looking for the best design instead of sampling: differential evolution over the cheapest fidelity that tells enough.

Every generation is a batch of designs whose rows are kept like a sweep's, so a killed search goes on where it was: the
same seed asks for the same designs. It minimises the same score that ranks a sweep (`twin.study.sweep.rank`); noise
is in the linear information as a covariance and tolerances as drawn sensors (``sensors``), so what is found stands
them.

Why differential evolution (R. Storn and K. Price 1997): axes may be lists, designs may be impossible, and a generation
is a batch for all cores; scipy has it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.parts.sweep import Sweep
from twin.study.sweep.closed import closed
from twin.study.sweep.designs import Designs, designs_at
from twin.study.sweep.rank import scores

if TYPE_CHECKING:
    from twin.study.sweep.run import Runner

POPULATION = 8
"""Designs of a generation, times the axes."""

WORST = 1e3
"""Score of an impossible design: worse than any other, and finite."""


def optimised(designs: Designs, runner: Runner) -> Designs:
    """Return the designs that a search looked at, ``count`` of them at most, the sweep's axes being its bounds."""
    from scipy.optimize import differential_evolution

    sweep, scene = designs.sweep, designs.scene
    stage = "linear" if "linear" in sweep.ladder else "closed"
    size = max(5, POPULATION * len(sweep.axes))
    generations = max(1, sweep.count // size - 1)
    looked: list[Floats] = []

    def judged(u: Floats) -> Floats:
        points = np.clip(np.atleast_2d(np.asarray(u).T), 0.0, 1.0).reshape(-1, len(sweep.axes))
        looked.append(points)
        return scored(sweep, designs_at(sweep, scene, points), stage, runner)

    differential_evolution(
        judged, [(0.0, 1.0)] * len(sweep.axes), maxiter=generations, popsize=POPULATION, init="sobol", polish=False,
        vectorized=True, updating="deferred", rng=np.random.default_rng(sweep.seed), tol=1e-4,
    )  # fmt: skip
    return designs_at(sweep, scene, np.concatenate(looked))


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
