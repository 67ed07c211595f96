"""Symmetric matrices in single precision, for iteration: products and inverses.

Why single precision: it halves the time, and the outer Newton steps mend what it loses, as they measure what is left
of the equations in double precision. Why products of symmetric matrices: they read one half of a matrix, and reading is
what products of this size cost.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from scipy.linalg import blas, lapack

from twin.compiled import njit

SinglesArray: TypeAlias = Any
"""Arrays in single precision."""


def symmetric_product(matrix: Any, right: Any) -> Any:
    """Return the product of a symmetric matrix (n, n) with (n,) or (n, m); what is above its diagonal is read only.

    The matrix in Fortran's order, or it is copied.
    """
    double = matrix.dtype == np.float64
    if right.ndim == 1 or right.shape[1] == 1:
        by = blas.dsymv if double else blas.ssymv
        return by(1.0, matrix, right.reshape(-1)).reshape(right.shape)
    return (blas.dsymm if double else blas.ssymm)(1.0, matrix, right)


def full_inverse(matrix: SinglesArray) -> SinglesArray | None:
    """Return a symmetric matrix's inverse, (n, n); None where it is not definite."""
    root, wrong = lapack.spotrf(matrix.T, lower=0, clean=0)
    if wrong or not np.isfinite(root[-1, -1]):
        return None
    half: SinglesArray = lapack.spotri(root, lower=0, overwrite_c=1)[0]
    if not np.isfinite(half.diagonal()).all():
        return None
    whole = half.T  # rows of its lower half lie together
    _mirror(whole)
    return whole


_TILE = 64
"""Rows and columns at a time: two tiles stay in the fast memory."""


@njit(cache=True)
def _mirror(matrix: SinglesArray) -> None:
    """Make a matrix (n, n) symmetric by what is below its diagonal."""
    n = len(matrix)
    for first in range(0, n, _TILE):
        for second in range(0, first + 1, _TILE):
            for i in range(first, min(first + _TILE, n)):
                for j in range(second, min(second + _TILE, i)):
                    matrix[j, i] = matrix[i, j]
