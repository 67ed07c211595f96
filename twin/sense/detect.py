"""Find the marker-like spots of a layer's signal; `twin.sense.centre` measures them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Pixels
from twin.compiled import njit
from twin.sense.centre import COLUMNS, measure
from twin.sense.split import Signal

SD_FLOOR_PX = 0.002
"""No centre is taken to be better than this: what a lens and a finite pixel leave even without noise."""


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Marker-like spots of one signal.

    Attributes
    ----------
    centre_px
        (b, 2) centres, px.
    sd_px
        (b,) standard deviation of each centre, per axis, from the measured noise.
    level_dn
        (b,) brightness of the middle above the ground.
    area_px
        (b,) pixels above threshold.
    crowding
        (b,) share of the ring outside the edge that shows the other layer's colour, 0 to 1.
    whole
        (b,) whether the spot lies fully inside the picture and its window.
    """

    centre_px: Pixels
    sd_px: Floats
    level_dn: Floats
    area_px: Floats
    crowding: Floats
    whole: np.ndarray

    def __len__(self) -> int:
        return len(self.area_px)

    @property
    def diameter_px(self) -> Floats:
        """(b,) diameters of circles of the same area, px."""
        return np.asarray(2.0 * np.sqrt(self.area_px / np.pi))


@njit(cache=True)
def _box(signal, half):  # type: ignore[no-untyped-def]
    """Running mean over (2 half + 1)^2 pixels, edges repeated."""
    height, width = signal.shape
    across = np.empty((height, width), np.float32)
    share = np.float32(1.0 / (2 * half + 1))
    for row in range(height):
        total = np.float64(0.0)
        for offset in range(-half, half + 1):
            total += signal[row, min(max(offset, 0), width - 1)]
        for column in range(width):
            across[row, column] = total * share
            total += signal[row, min(column + half + 1, width - 1)] - signal[row, max(column - half, 0)]
    down = np.empty((height, width), np.float32)
    totals = np.zeros(width, np.float64)
    for offset in range(-half, half + 1):
        row = min(max(offset, 0), height - 1)
        for column in range(width):
            totals[column] += across[row, column]
    for row in range(height):
        enter, leave = min(row + half + 1, height - 1), max(row - half, 0)
        for column in range(width):
            down[row, column] = totals[column] * share
            totals[column] += across[enter, column] - across[leave, column]
    return down


@njit(cache=True)
def _peaks(smooth, broad, radius, contrast, most):  # type: ignore[no-untyped-def]
    """Local maxima of smooth - broad within a square of ``radius``, above ``contrast``: (column, row) each."""
    height, width = smooth.shape
    found = np.empty((most, 2), np.int64)
    count = 0
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            here = smooth[row, column]
            if here - broad[row, column] < contrast:
                continue
            if here < smooth[row, column - 1] or here <= smooth[row, column + 1]:
                continue
            if here < smooth[row - 1, column] or here <= smooth[row + 1, column]:
                continue
            highest = True
            for other in range(max(row - radius, 0), min(row + radius, height - 1) + 1):
                for beside in range(max(column - radius, 0), min(column + radius, width - 1) + 1):
                    value = smooth[other, beside]
                    later = other > row or (other == row and beside > column)
                    if value > here or (value == here and later):
                        highest = False
                        break
                if not highest:
                    break
            if highest and count < most:
                found[count, 0] = column
                found[count, 1] = row
                count += 1
    return found[:count]


def find_blobs(signal: Signal, diameter_px: float, contrast_dn: float, crowd_dn: float = -np.inf) -> Blobs:
    """Find and measure the marker-like spots of a signal.

    Parameters
    ----------
    signal
        (h, w) counts.
    diameter_px
        About how wide the markers are, px; a factor of two either way does no harm.
    contrast_dn
        Least contrast of a spot above its surroundings.
    crowd_dn
        A pixel at or below this count shows another layer's colour.
    """
    diameter_px = min(diameter_px, float(max(signal.shape)))  # windows are as large: none is larger than the picture
    half = max(1, round(0.3 * diameter_px))
    smooth = _box(signal, half)
    broad = _box(signal, max(2 * half + 2, round(1.5 * diameter_px)))
    peaks = _peaks(smooth, broad, max(2, round(0.5 * diameter_px)), np.float32(contrast_dn), 20_000)
    out = np.zeros((len(peaks), COLUMNS))
    measure(signal, smooth, peaks, float(diameter_px), float(crowd_dn), out)
    out = out[(out[:, 5] >= 4) & (out[:, 4] >= contrast_dn)]
    out = out[_distinct(out)]
    return Blobs(
        centre_px=np.ascontiguousarray(out[:, :2]),
        sd_px=np.sqrt(np.mean(out[:, 2:4], axis=1) + SD_FLOOR_PX**2),
        level_dn=out[:, 4].copy(),
        area_px=out[:, 5].copy(),
        crowding=out[:, 6].copy(),
        whole=out[:, 7] > 0,
    )


def _distinct(out: Floats) -> np.ndarray:
    """Return which rows to keep: of peaks that flooded into one spot (equal centres) only the first."""
    _, first = np.unique(np.rint(out[:, :2] * 4).astype(np.int64), axis=0, return_index=True)
    return np.asarray(np.sort(first))
