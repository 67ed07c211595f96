"""Making a large matrix symmetric, and telling how far it was from that, in one walk through memory.

Why numba: in NumPy the difference to the transpose, its largest entry and the mean are five walks with strides, which
took two thirds of the time of a press on the block.
"""

from __future__ import annotations

from twin.arrays import Floats
from twin.compiled import njit

TILE = 64
"""Rows and columns at a time: two tiles stay in the fast memory."""


@njit(cache=True)
def make_symmetric(matrix: Floats) -> float:
    """Replace a (n, n) matrix by the mean of it and its transpose.

    Returns
    -------
    Its largest asymmetry before, over its largest entry; 0 of a matrix of zeros.
    """
    n = len(matrix)
    largest, differ = 0.0, 0.0
    for first in range(0, n, TILE):
        for second in range(first, n, TILE):
            for i in range(first, min(first + TILE, n)):
                for j in range(max(second, i), min(second + TILE, n)):
                    one, other = matrix[i, j], matrix[j, i]
                    largest = max(largest, abs(one), abs(other))
                    differ = max(differ, abs(one - other))
                    matrix[i, j] = matrix[j, i] = 0.5 * (one + other)
    return differ / largest if largest > 0.0 else 0.0
