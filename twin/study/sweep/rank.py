"""How designs are ranked: distance to the targets, Pareto fronts, agreement between fidelities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.parts.sweep import FIDELITIES, Sweep

BEYOND = 0.1
"""What being better than a target counts for, over being worse."""


def metric(columns: Mapping[str, Floats], name: str, upto: str | None = None) -> Floats | None:
    """Return a metric at the best fidelity that each design has it at; None if none has.

    Parameters
    ----------
    columns
        (m,) numbers by ``<fidelity>_<metric>``.
    name
        Of the metric.
    upto
        The last fidelity to look at; all if not given.
    """
    last = FIDELITIES.index(upto) if upto else len(FIDELITIES) - 1
    found: Floats | None = None
    for fidelity in FIDELITIES[: last + 1]:
        column = columns.get(f"{fidelity}_{name}")
        if column is not None:
            found = column if found is None else np.where(np.isnan(column), found, column)
    return found


def scores(sweep: Sweep, columns: Mapping[str, Floats], upto: str | None = None) -> Floats:
    """Return (m,) distances to the targets, the less the better: a weighted sum of log(metric / target).

    What is better than its target counts a tenth only, so that meeting all targets comes first. Infinite where a metric
    is, or is missing.
    """
    total: Floats | None = None
    for name, target in sweep.targets.items():
        values = metric(columns, name, upto)
        if values is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(np.maximum(values, 1e-300) / target)
        part = sweep.weights.get(name, 1.0) * np.where(off > 0, off, BEYOND * off)
        part = np.where(np.isnan(part), np.inf, part)
        total = part if total is None else total + part
    count = len(next(iter(columns.values()))) if columns else 0
    return total if total is not None else np.full(count, np.inf)


def best_first(score: Floats, allowed: Bools, at_most: int | None) -> Ints:
    """Return the numbers of the allowed designs, the best first; equal ones in their order."""
    order = np.argsort(score, kind="stable")
    order = order[allowed[order]]
    return order[:at_most] if at_most is not None else order


def pareto(columns: Sequence[Floats]) -> Bools:
    """Return (m,) whether no other design is at least as good in all columns and better in one; less is better."""
    table = np.column_stack(columns)
    front: Bools = np.array(np.isfinite(table).all(axis=1), np.bool_)
    candidates = np.flatnonzero(front)
    order = candidates[np.lexsort(table[candidates].T[::-1])]
    kept: list[int] = []
    for number in order:
        row = table[number]
        worse = any((table[k] <= row).all() and (table[k] < row).any() for k in kept)
        front[number] = not worse
        if not worse:
            kept.append(int(number))
    return front


def agreement(one: Floats, other: Floats) -> tuple[float, float, int]:
    """Return Spearman's rank correlation of two fidelities, the median ratio of the second to the first, and how many
    designs have both."""
    from scipy.stats import spearmanr

    both = np.isfinite(one) & np.isfinite(other)
    count = int(both.sum())
    if count == 0:
        return float("nan"), float("nan"), 0
    ratio = float(np.median(other[both] / one[both]))
    if count < 3 or np.ptp(one[both]) == 0 or np.ptp(other[both]) == 0:
        return float("nan"), ratio, count
    return float(spearmanr(one[both], other[both]).statistic), ratio, count
