"""Error against time: which runs no other run beats, and how long a program takes to an error by its own best runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Run = tuple[float, float]
"""Seconds and error."""


def front(runs: Sequence[Run]) -> list[Run]:
    """Return the runs that no other run beats in both time and error, fastest first."""
    best: list[Run] = []
    for seconds, error in sorted(runs):
        if not best or error < best[-1][1]:
            best.append((seconds, error))
    return best


def seconds_to(runs: Sequence[Run], error: float) -> float | None:
    """Return the seconds that a program takes to an error, from its front by straight lines in log-log axes.

    A program whose fastest run is better already takes the time of that run, an upper bound. None: never so good.
    """
    best = front(runs)
    if not best or best[-1][1] > error:
        return None
    if best[0][1] <= error:
        return best[0][0]
    seconds, errors = np.log(np.array(best)).T
    return float(np.exp(np.interp(-np.log(error), -errors, seconds)))
