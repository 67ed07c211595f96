"""Widths and dips of profiles whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from twin.judge.resolve import dip, full_width, two_point_distance


def test_the_width_of_a_gaussian_is_its_own() -> None:
    x = np.linspace(-10, 10, 401)
    assert full_width(x, np.exp(-(x**2) / (2 * 1.5**2))) == pytest.approx(2.3548 * 1.5, rel=1e-3)
    assert np.isnan(full_width(x, 1.0 + 0 * x)), "a profile that never falls to half has no width"


def test_the_dip_of_two_gaussians() -> None:
    x = np.linspace(-10, 10, 401)

    def two(apart: float) -> np.ndarray:
        return sum(np.exp(-((x - s * apart / 2) ** 2) / 2) for s in (-1, 1))

    assert dip(x, two(1.0), 1.0) == 0.0, "closer than their width, two pushes are one"
    between, peak = 2 * np.exp(-2.0), two(4.0).max()
    assert dip(x, two(4.0), 4.0) == pytest.approx(1 - between / peak, rel=1e-6)
    assert dip(np.array([-1.0, 1.0]), np.ones(2), 2.0) == 0.0, "nothing was sampled between them"


def test_the_least_distance_is_interpolated_and_never_optimistic() -> None:
    apart = np.array([1.0, 2.0, 3.0, 4.0])
    assert two_point_distance(apart, np.array([0.0, 0.1, 0.3, 0.5])) == pytest.approx(2.5)
    assert two_point_distance(apart, np.array([0.3, 0.1, 0.3, 0.5])) == pytest.approx(2.5), "a stray dip does not count"
    assert two_point_distance(apart, np.array([0.3, 0.4, 0.5, 0.6])) == 1.0
    assert two_point_distance(apart, np.zeros(4)) == np.inf
