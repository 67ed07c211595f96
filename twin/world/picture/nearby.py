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
    size = np.array(wanted.shape[::-1])
    half = _LARGER * np.sqrt(np.diagonal(conjugate, axis1=1, axis2=2)) + room
    middle = np.clip(centres, -1e6, 1e6)
    begin = np.clip(np.ceil(middle - half), 0, size).astype(np.int64)
    end = np.clip(np.floor(middle + half) + 1, 0, size).astype(np.int64)
    end[~there] = 0
    # A point so near a stretched ellipse is within this in the ellipse's own metric.
    reach = (_LARGER + room / np.sqrt(least_eigenvalues(conjugate))) ** 2
    spread = _inverses(conjugate) / reach[:, None, None]
    pixels, alone, first, members = _lists(begin, end, middle, spread, wanted)
    return Nearby(pixels=pixels, alone=alone, first=first, members=members)


def least_eigenvalues(matrices: Floats) -> Floats:
    """Return the smaller eigenvalue of each of (n, 2, 2) symmetric matrices, for a tenth of LAPACK's price."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    larger = (a + c) / 2 + np.sqrt(((a - c) / 2) ** 2 + b**2)
    smaller: Floats = (a * c - b**2) / larger
    return smaller


def _inverses(matrices: Floats) -> Floats:
    """Return the inverses of (n, 2, 2) symmetric matrices."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    inverses: Floats = np.array([[c, -b], [-b, a]]).transpose(2, 0, 1) / (a * c - b**2)[:, None, None]
    return inverses


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _columns(spread: Floats, middle: Floats, begin: Ints, end: Ints, i: int, row: int) -> tuple[int, int]:
    """Return from and to where ellipse ``i`` covers a row."""
    y = row - middle[i, 1]
    a, b = spread[i, 0, 0], spread[i, 0, 1] * y
    square = b * b - a * (spread[i, 1, 1] * y * y - 1)
    if square < 0:
        return 0, 0
    root = np.sqrt(square)
    left, right = middle[i, 0] + (-b - root) / a, middle[i, 0] + (-b + root) / a
    return max(begin[i, 0], int(np.ceil(left))), min(end[i, 0], int(np.floor(right)) + 1)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _lists(begin: Ints, end: Ints, middle: Floats, spread: Floats, wanted: Bools) -> tuple[Ints, Ints, Whole, Whole]:
    """Return the arrays of `Nearby`."""
    n, width = len(begin), wanted.shape[1]
    count = np.zeros(wanted.shape, np.uint8)  # none, one or several
    total = 0
    for i in range(n):
        for row in range(begin[i, 1], end[i, 1]):
            left, right = _columns(spread, middle, begin, end, i, row)
            for column in range(left, right):
                if wanted[row, column]:
                    count[row, column] = min(count[row, column] + 1, 2)
                    total += 1
    pixels, alone = np.empty(total, np.int64), np.zeros(n + 1, np.int64)
    shared_pixel, shared_marker = np.empty(total, np.int64), np.empty(total, np.int32)
    used, shared = 0, 0
    for i in range(n):
        for row in range(begin[i, 1], end[i, 1]):
            left, right = _columns(spread, middle, begin, end, i, row)
            for column in range(left, right):
                if count[row, column] == 1:
                    pixels[used] = row * width + column
                    used += 1
                elif count[row, column] > 1:
                    shared_pixel[shared], shared_marker[shared] = row * width + column, i
                    shared += 1
        alone[i + 1] = used
    order = np.argsort(shared_pixel[:shared], kind="mergesort")
    first, members = np.empty(total + 1, np.int32), np.empty(total, np.int32)
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
    first[at] = total
    return pixels[:at].copy(), alone, first[: at + 1].copy(), members
