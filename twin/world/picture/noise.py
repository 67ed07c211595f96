"""Normal numbers, each from its own number: no state, so whatever draws whichever of them draws the same.

A counter and a key are hashed to 32 bits (Widynski, "Squares: a fast counter-based RNG", arXiv:2004.06278, four of
whose rounds pass TestU01's BigCrush), of which one is the sign and 31 the share of larger deviates; the deviate is read
from the normal distribution's quantiles, kept as pieces (`twin.world.picture.segments`).

Validity: deviates are off by less than 2e-5 and end at 6.3 standard deviations, which one in 4e9 exceeds.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from twin.arrays import Singles
from twin.compiled import njit
from twin.world.picture.segments import Segments, at_segments, segments

_OCTAVES = 32


@cache
def normal_deviates() -> Segments:
    """Return the deviate that a share x / 2 of all exceeds, x from 2^-32 to 1."""
    return segments(lambda x: -ndtri(x / 2), _OCTAVES)


def noise_key(rng: np.random.Generator) -> NDArray[np.uint64]:
    """Return where to begin counting, and the key: two random numbers, the second odd."""
    key: NDArray[np.uint64] = rng.integers(2**64, size=2, dtype=np.uint64)
    key[1] |= np.uint64(1)
    return key


@njit(cache=True, nogil=True)
def normal_numbers(key: NDArray[np.uint64], first: np.uint64, deviates: Segments, out: Singles) -> None:
    """Write the normal numbers ``first``, ``first`` + 1, ..."""
    start, factor, half = key[0] + first, key[1], np.uint64(32)
    scale = np.float32(2.0**-31)
    for i in range(len(out)):
        y = (start + np.uint64(i)) * factor
        z = y + factor
        x = y * y + y
        x = (x >> half) | (x << half)
        x = x * x + z
        x = (x >> half) | (x << half)
        x = x * x + y
        x = (x >> half) | (x << half)
        word = (x * x + z) >> half
        share = (np.float32(np.int32(word >> np.uint64(1))) + np.float32(0.5)) * scale
        out[i] = share if word & np.uint64(1) else -share
    at_segments(deviates, out)
