"""Maps of marker arrows: layers and their colours, the window, and how much longer than life arrows are drawn."""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats
from twin.show import plots
from twin.show.words import digits

STYLES = {"red": "red", "blue": "blue"}
"""Layers that are named after their colour; others take the remaining styles in turn."""


def layers(names: np.ndarray) -> list[tuple[str, str, Bools]]:
    """Return name, style and mask of every layer, in their order of appearance."""
    spare = ["blue", "red", "other"]
    ordered = list(dict.fromkeys(names.tolist()))
    taken = {STYLES[n] for n in ordered if n in STYLES}
    rest = iter([s for s in spare if s not in taken] + ["other"] * len(ordered))
    return [(str(n), STYLES.get(n) or next(rest), names == n) for n in ordered]


def figure(drawing: str, caption: str) -> str:
    """Return a drawing with its caption (HTML)."""
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def scale_note(scale: float, size: float, unit: str, directions: str) -> str:
    """Say how arrows are drawn: ``scale`` times their length, the longest being ``size`` in ``unit``."""
    if size == 0:
        return f"No marker moves. {directions}"
    drawn = f"Arrows are drawn {digits(scale)} times as long as they are" if scale != 1 else "Arrows are true to scale"
    return f"{drawn}; the longest is {digits(size)} {unit}. {directions}"


def longest(vectors: Floats) -> float:
    """Return the length of the longest of (n, 2) vectors, NaN apart; 0 if there is none."""
    sizes = np.hypot(vectors[:, 0], vectors[:, 1])
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.max()) if len(sizes) else 0.0


def magnification(axes: plots.Axes, names: np.ndarray, places: Floats, size: float) -> float:
    """Return the round factor at which an arrow of ``size`` is about as long as markers of a layer are apart."""
    pitches = [spacing(places[mask]) for _, _, mask in layers(names)] if len(places) else []
    pitch = min((p for p in pitches if p > 0), default=40 / axes.per_unit)
    return plots.nice(1.5 * max(pitch, 20 / axes.per_unit) / size) if size > 0 else 1.0


def spacing(points: Floats) -> float:
    """Return the median distance to the nearest neighbour of (n, 2) points; 0 for fewer than two."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return 0.0
    nearest = []
    for block in np.array_split(points, -(-len(points) // 500)):
        apart = np.hypot(*(block[:, None] - points[None]).transpose(2, 0, 1))
        nearest.append(np.partition(apart, 1, axis=1)[:, 1])
    return float(np.median(np.concatenate(nearest)))


def around(points: Floats) -> tuple[float, float, float, float]:
    """Return left, right, low and high of a window with a margin around (n, 2) points."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return -1.0, 1.0, -1.0, 1.0
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * max(right - left, high - low) or 1.0
    return float(left - margin), float(right + margin), float(low - margin), float(high + margin)
