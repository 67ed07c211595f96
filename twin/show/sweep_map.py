"""Maps of a sweep: a metric over two axes, binned, with the borders of where its target is met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from twin.arrays import Floats
from twin.show import plots
from twin.show.words import digits

BINS = 14
"""Bins of a map along an axis at most."""


@dataclass(frozen=True, kw_only=True)
class Map:
    """A metric over two axes.

    Attributes
    ----------
    across, up, metric
        Names, with units.
    x, y, value
        (m,) axis values, and the metric.
    limit
        (m,) the same metric by the design limit.
    target
        Of the metric; NaN if none.
    """

    across: str
    up: str
    metric: str
    x: Floats
    y: Floats
    value: Floats
    limit: Floats
    target: float


def map_figure(told: Map) -> str:
    """Return a map (HTML): the metric's median in every bin, and the border of what the design limit allows."""
    edges = [_edges(v) for v in (told.x, told.y)]
    if min(len(e) for e in edges) < 2:
        return ""
    place = [
        np.clip(np.searchsorted(e, v, side="right") - 1, 0, len(e) - 2)
        for e, v in zip(edges, (told.x, told.y), strict=True)
    ]
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    value, limit = (_binned(place, v, shape) for v in (told.value, told.limit))
    known = np.isfinite(value)
    if not known.any():
        return ""
    low, high = float(value[known].min()), float(value[known].max())
    axes = plots.Axes(
        left=float(edges[0][0]), right=float(edges[0][-1]), bottom=float(edges[1][0]), top=float(edges[1][-1]),
        height=300,
    )  # fmt: skip
    parts = []
    for i, j in np.argwhere(known):
        corners = axes.place(np.array([[edges[0][i], edges[1][j + 1]], [edges[0][i + 1], edges[1][j]]]))
        (x0, y0), (x1, y1) = corners.tolist()
        share = 1.0 - (value[i, j] - low) / (high - low) if high > low else 1.0
        parts.append(
            f'<rect class="push" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" '
            f'fill-opacity="{0.05 + 0.9 * share:.2f}"><title>{value[i, j]:.3g}</title></rect>'
        )
    if np.isfinite(told.target):
        parts.append(_border(axes, edges, limit <= told.target, "contact"))
        parts.append(_border(axes, edges, value <= told.target, "force"))
    svg = plots.drawing(axes, "".join(parts), told.across, told.up, f"{told.metric} over {told.across} and {told.up}")
    border = (
        f" Inside the dashed border the design limit is at most {digits(told.target)}, inside the solid one it is."
        if np.isfinite(told.target)
        else ""
    )
    return (
        f"<figure>{svg}<figcaption>{escape(told.metric)}: {digits(low)} (darkest) to {digits(high)}.{border}"
        "</figcaption></figure>"
    )


def _edges(values: Floats) -> Floats:
    """Return bin edges: halfway between values if they are few, else even."""
    known = np.unique(values[np.isfinite(values)])
    if len(known) < 2:
        return np.zeros(0)
    if len(known) <= BINS:
        middle = (known[1:] + known[:-1]) / 2
        return np.concatenate([[2 * known[0] - middle[0]], middle, [2 * known[-1] - middle[-1]]])
    return np.linspace(known[0], known[-1], BINS + 1)


def _binned(place: Sequence[np.ndarray], values: Floats, shape: tuple[int, int]) -> Floats:
    """Return the median of finite values in every bin; NaN where there is none."""
    out = np.full(shape, np.nan)
    flat = place[0] * shape[1] + place[1]
    finite = np.isfinite(values)
    for number in np.unique(flat[finite]):
        out.flat[number] = np.median(values[finite & (flat == number)])
    return out


def _border(axes: plots.Axes, edges: Sequence[Floats], inside: np.ndarray, style: str) -> str:
    """Return the border between bins that are inside and those that are not."""
    steps = []
    for i in range(inside.shape[0]):
        for j in range(inside.shape[1]):
            if not inside[i, j]:
                continue
            for di, dj, line in (
                (1, 0, [[edges[0][i + 1], edges[1][j]], [edges[0][i + 1], edges[1][j + 1]]]),
                (-1, 0, [[edges[0][i], edges[1][j]], [edges[0][i], edges[1][j + 1]]]),
                (0, 1, [[edges[0][i], edges[1][j + 1]], [edges[0][i + 1], edges[1][j + 1]]]),
                (0, -1, [[edges[0][i], edges[1][j]], [edges[0][i + 1], edges[1][j]]]),
            ):
                a, b = i + di, j + dj
                outside = not (0 <= a < inside.shape[0] and 0 <= b < inside.shape[1]) or not inside[a, b]
                if outside:
                    (x0, y0), (x1, y1) = axes.place(np.array(line)).tolist()
                    steps.append(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")
    return f'<path class="{style}" d="{"".join(steps)}"/>' if steps else ""
