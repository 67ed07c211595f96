"""One walk that makes a matrix symmetric, against NumPy."""

import math

import numpy as np
import pytest

from twin.world.elasticity.symmetric import TILE, make_symmetric


@pytest.mark.parametrize("n", [0, 1, TILE, 2 * TILE + 3])
def test_is_the_mean_with_the_transpose(n: int) -> None:
    matrix = np.random.default_rng(n).normal(size=(n, n))
    wanted, before = (matrix + matrix.T) / 2, matrix.copy()
    asymmetry = make_symmetric(matrix)
    np.testing.assert_array_equal(matrix, wanted)
    largest = np.abs(before).max(initial=0.0)
    assert asymmetry == (np.abs(before - before.T).max() / largest if largest else 0.0)
    assert make_symmetric(np.zeros((3, 3))) == 0.0


def test_a_nan_is_not_lost() -> None:
    matrix = np.eye(3)
    matrix[0, 2] = math.nan
    make_symmetric(matrix)
    assert math.isnan(matrix[2, 0])
    assert math.isnan(matrix[0, 2])
