"""The papers' own centroid: against the same by plain sums, everywhere in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from twin.sense.cells import cell_centroids

WEIGHTS, GROUND = (1.0, 0.1, -0.9), 20.0


def by_sums(picture: np.ndarray, start: np.ndarray, half: int, passes: int) -> np.ndarray:
    """Return the centroid of the positive signal in the cell around ``start``, pass by pass, in double precision."""
    signal = np.maximum(picture @ np.array(WEIGHTS) - GROUND, 0.0)
    at = start.copy()
    for _ in range(passes):
        column, row = np.rint(at).astype(int)
        rows = np.arange(max(row - half, 0), min(row + half, len(signal) - 1) + 1)
        columns = np.arange(max(column - half, 0), min(column + half, signal.shape[1] - 1) + 1)
        cell = signal[np.ix_(rows, columns)]
        at = np.array([(cell.sum(axis=0) * columns).sum(), (cell.sum(axis=1) * rows).sum()]) / cell.sum()
    return at


@pytest.mark.parametrize("half", [1, 7, 8, 30])
@pytest.mark.parametrize("passes", [1, 2])
def test_centroids_are_those_of_plain_sums_up_to_every_border(half: int, passes: int) -> None:
    rng = np.random.default_rng(half)
    picture = rng.integers(0, 256, (70, 83, 3), dtype=np.uint8)
    starts = np.concatenate([rng.uniform(0, (82, 69), (40, 2)), [[0, 0], [82, 69], [0, 69], [82, 0], [75, 68]]])
    found = cell_centroids(picture, WEIGHTS, GROUND, starts, 2.0 * half, 1.0, passes)
    wanted = [by_sums(picture, start, half, passes) for start in starts]
    np.testing.assert_allclose(found, wanted, atol=1e-3 if half == 1 else 1e-4)


def test_an_empty_cell_and_an_unknown_place_show_nothing() -> None:
    picture = np.full((40, 40, 3), 100, np.uint8)
    picture[5, 5] = 180, 100, 20
    found = cell_centroids(picture, (1.0, 0.0, -1.0), 0.0, np.array([[6.0, 4.0], [30.0, 30.0], [np.nan, 5.0]]), 8, 50.0)
    np.testing.assert_allclose(found[0], [5.0, 5.0])
    assert np.isnan(found[1:]).all()
