"""A function of one variable as straight pieces, 64 between each two powers of 2: the float's own bits are the index.

Why: its relative error is the same from 1e-19 to 1, so that powers and the tails of distributions, which no even table
holds, cost two look-ups. Straight pieces between the ends of [x, x (1 + 1/64)] are off by x^2 f'' / 32768: 8e-6 of a
square root.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Singles
from twin.compiled import njit

_SHIFT = 17
"""Bits of a float32's 23 that lie within a piece."""

Segments = NDArray[np.float32]
"""(n, 2) value at 0 and slope of each piece; row 0 begins at ``2 ** -octaves`` times the largest argument."""


def segments(function: Callable[[Floats], Floats], octaves: int) -> Segments:
    """Return a function of x in [2^-octaves, 1] as pieces; beyond, the first and the last are carried on."""
    ends = np.arange(64 * octaves + 2)
    octave, step = np.divmod(ends, 64)
    x = 2.0 ** (octave - octaves) * (1 + step / 64)
    y = function(np.minimum(x, 1.0))
    slope = np.diff(y) / np.diff(x)
    return np.column_stack([y[:-1] - slope * x[:-1], slope]).astype(np.float32)


@njit(cache=True, nogil=True)
def at_segments(pieces: Segments, line: Singles) -> None:
    """Put the function's values in the place of (n,) arguments, of the sign of each; those above 1 count as 1."""
    octaves = (len(pieces) - 1) // 64
    least = np.float32(2.0**-octaves)
    first = (127 - octaves) << (23 - _SHIFT)
    size = np.empty_like(line)
    bits = size.view(np.int32)
    for i in range(len(line)):
        size[i] = min(max(abs(line[i]), least), np.float32(1))
    for i in range(len(line)):
        at = (bits[i] >> _SHIFT) - first
        line[i] = np.copysign(pieces[at, 0] + pieces[at, 1] * size[i], line[i])
