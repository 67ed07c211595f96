"""What matters: how much of the spread of a metric each axis makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.study.sweep.closed import closed
from twin.study.sweep.designs import designs_at
from twin.study.sweep.rank import agreement
from twin.study.sweep.run import Swept

SAMPLES = 512
"""Base samples of the Sobol' indices; each costs as many designs as there are axes and two more."""

EXPLAINED = ("two_point_mm", "fwhm_mm", "resolution_gf")


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """How a metric depends on one axis.

    Attributes
    ----------
    axis, metric
        Their names.
    first, total
        Sobol' indices of log(metric) by the closed form: the share of its variance that the axis makes alone, and with
        the others.
    rank
        Spearman's rank correlation of axis and metric over the sweep's designs, at the best fidelity; NaN for lists of
        texts.
    """

    axis: str
    metric: str
    first: float
    total: float
    rank: float


def sensitivities(done: Swept) -> list[Sensitivity]:
    """Return the sensitivity of every metric to every axis.

    Designs that are dropped take the metric's mean, so that they add nothing to its variance.
    """
    from scipy.stats import sobol_indices, uniform

    sweep, scene = done.designs.sweep, done.designs.scene
    axes = list(sweep.axes)

    def metrics(u: Floats) -> Floats:
        found = closed(designs_at(sweep, scene, np.clip(np.asarray(u).T, 0.0, 1.0))).columns
        values = np.log(np.stack([found[name] for name in EXPLAINED]))
        values[~np.isfinite(values)] = np.nan
        mean = np.nanmean(values, axis=1, keepdims=True) if np.isfinite(values).any(axis=1).all() else 0.0
        return np.where(np.isnan(values), mean, values)

    indices = sobol_indices(func=metrics, n=SAMPLES, dists=[uniform()] * len(axes), rng=np.random.default_rng(0))
    first, total = (
        np.asarray(a).reshape(len(EXPLAINED), len(axes)) for a in (indices.first_order, indices.total_order)
    )
    told = []
    for row, metric in enumerate(EXPLAINED):
        for column, axis in enumerate(axes):
            rank = float("nan")
            values = done.designs.columns[axis]
            if all(isinstance(v, int | float) for v in values):
                deepest = next(
                    (done.columns[f"{s}_{metric}"] for s in ("linear", "closed") if f"{s}_{metric}" in done.columns),
                    np.full(len(values), np.nan),
                )
                rank = agreement(np.asarray(values, float), deepest)[0]
            told.append(
                Sensitivity(
                    axis=axis, metric=metric, first=float(first[row, column]), total=float(total[row, column]),
                    rank=rank,
                )
            )  # fmt: skip
    return told
