"""The inner product of two rows, for compiled loops: added up in any order, which lanes do several terms of at once."""

from __future__ import annotations

from twin.arrays import Floats
from twin.compiled import njit


@njit(cache=True, fastmath={"reassoc", "contract"})
def inner(one: Floats, other: Floats) -> float:
    """Return the sum of products, in the precision of the rows; 0 of empty ones."""
    total = one.dtype.type(0.0)
    for i in range(len(one)):
        total += one[i] * other[i]
    return total
