"""Resolution: the width of a point force's image, and the least distance of two that are resolved.

All are functions of plain arrays. So estimates from recorded data can be judged as well, and
designs by their transfer matrix alone.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.theory.limit import DIP


def full_width(x: Floats, y: Floats, *, at_least: bool = False) -> float:
    """Return the full width at half maximum of a sampled peak, crossings interpolated linearly; NaN
    if open, or with ``at_least`` the length of the row."""
    top = int(np.argmax(y))
    half = 0.5 * float(y[top])
    open_width = float(x[-1] - x[0]) if at_least else float("nan")
    if half <= 0:
        return open_width
    left = next((k for k in range(top, 0, -1) if y[k - 1] < half), None)
    right = next((k for k in range(top, len(y) - 1) if y[k + 1] < half), None)
    if left is None or right is None:
        return open_width
    low = x[left] - (x[left] - x[left - 1]) * (y[left] - half) / (y[left] - y[left - 1])
    high = x[right] + (x[right + 1] - x[right]) * (y[right] - half) / (y[right] - y[right + 1])
    return float(high - low)


def dip(x: Floats, y: Floats, apart: float) -> float:
    """Return how far a profile, (n,) places rising and pushes, falls between two equal pushes at
    -apart/2 and apart/2, over the lower of the peaks.

    Peaks are looked for within a quarter of the distance around their places; 0 where a place has
    none, or where nothing was sampled between them.
    """
    near = [np.abs(x - side * apart / 2) <= apart / 4 + 1e-9 for side in (-1, 1)]
    between = np.abs(x) < apart / 4 - 1e-9
    if not (near[0].any() and near[1].any() and between.any()):
        return 0.0
    peak = min(float(y[near[0]].max()), float(y[near[1]].max()))
    return max(0.0, 1.0 - float(y[between].min()) / peak) if peak > 0 else 0.0


def two_point_distance(apart: Floats, dips: Floats) -> float:
    """Return the least of (n,) rising distances, at least the first, from which on all dip by
    `DIP`, interpolated; infinite if none does."""
    enough = dips >= DIP
    if not enough[-1]:
        return float("inf")
    first = len(enough) - int(np.argmin(enough[::-1])) if not enough.all() else 0
    if first == 0:
        return float(apart[0])
    share = (DIP - dips[first - 1]) / (dips[first] - dips[first - 1])
    return float(apart[first - 1] + share * (apart[first] - apart[first - 1]))
