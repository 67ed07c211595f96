"""Which markers' outlines come near each pixel: one list a pixel, in numba, a loop over some hundred small ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints, Pixels
from twin.compiled import njit

_LARGER = 1.05
"""How much larger an outline may be than its first-order ellipse."""

Whole = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class Nearby:
    """The pixels near outlines, and which.

    Attributes
    ----------
    pixels
        (m,) flat numbers, row * width + column: first those near one outline only, marker by marker and ascending, then
        those near several, ascending.
    alone
        (n + 1,) where each marker's own pixels begin in ``pixels``; those near several begin at the last.
    first
        (m + 1,) where each pixel's markers begin in ``members``.
    members
        Numbers of the markers, pixel by pixel, ascending.
    """

    pixels: Ints
    alone: Ints
    first: Whole
    members: Whole


def near_pixels(centres: Pixels, conjugate: Floats, room: float, there: Bools, wanted: Bools) -> Nearby:
    """Return which ellipses come near, pixel by pixel.

    Parameters
    ----------
    centres, conjugate
        (n, 2) px, and (n, 2, 2) matrices C, px^2, of the ellipses x^T C^-1 x = 1 about them.
    room
        How near, px, to an ellipse that is 5 % larger.
    there
        (n,) False leaves a marker out.
    wanted
        (height, width) the pixels that may be covered.
    """
    pixels, alone, first, members = _lists(*_runs(centres, conjugate, room, there, *wanted.shape), wanted)
    return Nearby(pixels=pixels, alone=alone, first=first, members=members)


@njit(cache=True, nogil=True)
def least_eigenvalue(a: float, b: float, c: float) -> float:
    """Return the smaller eigenvalue of the symmetric matrix [[a, b], [b, c]]."""
    larger = (a + c) / 2 + np.sqrt(((a - c) / 2) ** 2 + b * b)
    least: float = (a * c - b * b) / larger
    return least


@njit(cache=True, nogil=True)
def _runs(centres: Pixels, conjugate: Floats, room: float, there: Bools, height: int, width: int) -> tuple[Ints, Ints]:
    """Return (n + 1,) where each ellipse's runs of pixels begin, and (runs, 3) row, first column, column after."""
    n = len(centres)
    begin = np.zeros(n + 1, np.int64)
    runs = np.empty((max(32 * n, 64), 3), np.int64)
    used = 0
    for i in range(n):
        if there[i]:
            a, b, c = conjugate[i, 0, 0], conjugate[i, 0, 1], conjugate[i, 1, 1]
            # A point so near a stretched ellipse is within this in the ellipse's own metric.
            reach = _LARGER + room / np.sqrt(least_eigenvalue(a, b, c))
            low, high = _between(centres[i, 1], _LARGER * np.sqrt(c) + room, height)
            left, right = _between(centres[i, 0], _LARGER * np.sqrt(a) + room, width)
            while used + high - low > len(runs):
                runs = np.concatenate((runs, np.empty_like(runs)))
            # x^T C^-1 x = reach^2 in a row: x = shear y +- narrow sqrt(c reach^2 - y^2).
            shear, narrow = b / c, np.sqrt(a * c - b * b) / c
            for row in range(low, high):
                y = row - centres[i, 1]
                square = c * reach * reach - y * y
                if square >= 0:
                    middle, half = centres[i, 0] + shear * y, narrow * np.sqrt(square)
                    first, last = max(np.ceil(middle - half), left), min(np.floor(middle + half) + 1, right)
                    if first < last:
                        runs[used] = row, int(first), int(last)
                        used += 1
        begin[i + 1] = used
    return begin, runs[:used]


@njit(cache=True, nogil=True)
def _between(middle: float, half: float, size: int) -> tuple[int, int]:
    """Return the first pixel that is within ``half`` of ``middle`` and the one after the last, in a picture."""
    return int(min(max(np.ceil(middle - half), 0.0), size)), int(min(max(np.floor(middle + half) + 1, 0.0), size))


@njit(cache=True, nogil=True)
def _lists(begin: Ints, runs: Ints, wanted: Bools) -> tuple[Ints, Ints, Whole, Whole]:
    """Return the arrays of `Nearby`."""
    n, width = len(begin) - 1, wanted.shape[1]
    count = np.zeros(wanted.shape, np.uint8)  # none, one or several
    total = 0
    for j in range(len(runs)):
        strip, good = count[runs[j, 0]], wanted[runs[j, 0]]
        for column in range(runs[j, 1], runs[j, 2]):
            strip[column] += np.uint8(good[column] & (strip[column] < 2))
        total += runs[j, 2] - runs[j, 1]
    pixels, alone = np.empty(total, np.int64), np.zeros(n + 1, np.int64)
    shared_pixel, shared_marker = np.empty(total, np.int64), np.empty(total, np.int32)
    used, shared = 0, 0
    for i in range(n):
        for j in range(begin[i], begin[i + 1]):
            strip, row = count[runs[j, 0]], runs[j, 0] * width
            for column in range(runs[j, 1], runs[j, 2]):
                if strip[column] == 1:
                    pixels[used] = row + column
                    used += 1
                elif strip[column] > 1:
                    shared_pixel[shared], shared_marker[shared] = row + column, i
                    shared += 1
        alone[i + 1] = used
    order = np.argsort(shared_pixel[:shared], kind="mergesort")
    first, members = np.empty(used + shared + 1, np.int32), np.empty(used + shared, np.int32)
    for i in range(n):
        for j in range(alone[i], alone[i + 1]):
            first[j], members[j] = j, i
    at, last = used, np.int64(-1)
    for j in range(shared):
        pixel = shared_pixel[order[j]]
        if pixel != last:
            first[at], pixels[at], last = used + j, pixel, pixel
            at += 1
        members[used + j] = shared_marker[order[j]]
    first[at] = used + shared
    return pixels[:at], alone, first[: at + 1], members
