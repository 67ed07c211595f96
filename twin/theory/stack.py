"""Rays through a stack of flat layers, one at a time, compiled: `twin.theory.optics` says what they are.

Why one at a time: a few hundred points take Newton's iteration some hundred whole-array steps, each of which costs
more than the arithmetic in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit

_ITERATIONS = 60


def through(p: Any, thickness: Any, index: float) -> tuple[Any, Any]:
    """Return how far a ray of tangent ``p`` in air moves sideways in one layer, and the derivative; or many rays."""
    square = index * index
    inverse = 1 / np.sqrt(square + (square - 1) * (p * p))
    return thickness * (p * inverse), thickness * (square * (inverse * inverse * inverse))


_through = njit()(through)


@njit(cache=True, nogil=True)
def tangents(reach: Floats, depth: Floats, index: float, stack: Floats, air: Floats, out: Floats) -> None:
    """Set ``out`` (n,) to `twin.theory.optics.air_tangents`; ``stack`` (k, 2) holds thicknesses and indices."""
    for i in range(len(reach)):
        out[i] = np.nan
        if depth[i] >= -1e-9:
            out[i] = tangent(reach[i], max(depth[i], 0.0), index, stack, air[i])[0]


@njit(cache=True, nogil=True)
def tangent(reach: float, depth: float, index: float, stack: Floats, air: float) -> tuple[float, float]:
    """Return the tangent of the ray that moves ``reach`` sideways, NaN for none, and the slope of `sideways` there."""
    p = reach / _sideways(0.0, depth, index, stack, air)[1]
    for _ in range(_ITERATIONS):
        so_far, slope = _sideways(p, depth, index, stack, air)
        missing = reach - so_far
        if abs(missing) <= 1e-13 * (1 + reach):
            break
        p += missing / slope
    return (p if abs(missing) <= 1e-9 * (1 + reach) else np.nan), slope


@njit(cache=True, nogil=True)
def _sideways(p: float, depth: float, index: float, stack: Floats, air: float) -> tuple[float, float]:
    reach, slope = _through(p, depth, index)
    for layer in range(len(stack)):
        further, steeper = _through(p, stack[layer, 0], stack[layer, 1])
        reach, slope = reach + further, slope + steeper
    return reach + air * p, slope + air
