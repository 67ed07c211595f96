"""Which markers' outlines come near each pixel: one list a pixel, in numba, a loop over some hundred small boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints, Pixels

_LARGER = 1.05
"""How much larger an outline may be than its first-order ellipse."""


@dataclass(frozen=True, kw_only=True)
class Nearby:
    """The pixels near outlines, and which.

    Attributes
    ----------
    pixels
        (m,) flat numbers, row * width + column, ascending.
    tops
        (m,) largest of the heights of the markers near each.
    first
        (m + 1,) where each pixel's markers begin in ``members``.
    members
        Numbers of the markers, pixel by pixel, ascending.
    """

    pixels: Ints
    tops: Floats
    first: NDArray[np.int32]
    members: NDArray[np.int32]


def near_pixels(centres: Pixels, conjugate: Floats, room: float, tops: Floats, wanted: Bools) -> Nearby:
    """Return which ellipses come near, pixel by pixel.

    Parameters
    ----------
    centres, conjugate
        (n, 2) px, and (n, 2, 2) matrices C, px^2, of the ellipses x^T C^-1 x = 1 about them.
    room
        How near, px, to an ellipse that is 5 % larger.
    tops
        (n,) heights; -inf leaves a marker out.
    wanted
        (height, width) the pixels that may be covered.
    """
    size = np.array(wanted.shape[::-1])
    half = _LARGER * np.sqrt(np.diagonal(conjugate, axis1=1, axis2=2)) + room
    middle = np.clip(centres, -1e6, 1e6)
    first = np.clip(np.ceil(middle - half), 0, size).astype(np.int64)
    last = np.clip(np.floor(middle + half) + 1, 0, size).astype(np.int64)
    last[~np.isfinite(tops)] = 0
    # A point so near a stretched ellipse is within this in the ellipse's own metric.
    reach = (_LARGER + room / np.sqrt(np.linalg.eigvalsh(conjugate)[:, 0])) ** 2
    spread = np.linalg.inv(conjugate) / reach[:, None, None]
    count, highest = _count(first, last, middle, spread, tops, wanted)
    pixels = np.flatnonzero(count)
    starts = np.zeros(len(pixels) + 1, np.int32)
    np.cumsum(count.ravel()[pixels], out=starts[1:])
    members = _fill(first, last, middle, spread, wanted, pixels, starts)
    return Nearby(pixels=pixels, tops=highest.ravel()[pixels], first=starts, members=members)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _inside(spread: Floats, middle: Floats, i: int, column: int, row: int) -> bool:
    x, y = column - middle[i, 0], row - middle[i, 1]
    return bool(spread[i, 0, 0] * x * x + 2 * spread[i, 0, 1] * x * y + spread[i, 1, 1] * y * y <= 1)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _count(
    first: Ints, last: Ints, middle: Floats, spread: Floats, tops: Floats, wanted: Bools
) -> tuple[NDArray[np.int32], Floats]:
    count = np.zeros(wanted.shape, np.int32)
    highest = np.full(wanted.shape, -np.inf)
    for i in range(len(first)):
        for row in range(first[i, 1], last[i, 1]):
            for column in range(first[i, 0], last[i, 0]):
                if wanted[row, column] and _inside(spread, middle, i, column, row):
                    count[row, column] += 1
                    highest[row, column] = max(highest[row, column], tops[i])
    return count, highest


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fill(
    first: Ints, last: Ints, middle: Floats, spread: Floats, wanted: Bools, pixels: Ints, starts: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the markers' numbers pixel by pixel."""
    width = wanted.shape[1]
    place = np.zeros(wanted.size, np.int32)
    for j in range(len(pixels)):
        place[pixels[j]] = starts[j]
    members = np.empty(starts[-1], np.int32)
    for i in range(len(first)):
        for row in range(first[i, 1], last[i, 1]):
            for column in range(first[i, 0], last[i, 0]):
                if wanted[row, column] and _inside(spread, middle, i, column, row):
                    at = row * width + column
                    members[place[at]] = i
                    place[at] += 1
    return members
