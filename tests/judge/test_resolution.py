import numpy as np
import pytest

from benchmarks.inverse import widths
from twin.judge.resolution import dip, full_width, two_point_distance


def test_width_of_a_known_bell():
    x = np.linspace(-5, 5, 401)
    assert full_width(x, np.exp(-(x**2) / 2)) == pytest.approx(2 * np.sqrt(2 * np.log(2)), rel=1e-3)
    assert full_width(x, np.maximum(1 - np.abs(x - 0.6) / 2, 0)) == pytest.approx(2.0, rel=1e-6)
    coarse = np.array([0, 0.2, 0.8, 1, 0.8, 0.2, 0])
    assert full_width(np.arange(7.0), coarse) == pytest.approx(3.0), "the crossing nearest to the peak"
    assert np.isnan(full_width(x, x + 10))
    assert widths(np.ones(12), (4, 3), 1.0) == (np.inf, np.inf)
    s, t = np.meshgrid(0.1 * np.arange(60), 0.1 * np.arange(40), indexing="ij")
    bell = np.exp(-((s - 3) ** 2) / 2 / 0.5**2 - (t - 2) ** 2 / 2 / 0.3**2)
    assert widths(bell.ravel(), (60, 40), 0.1) == pytest.approx((0.5 * 2.3548, 0.3 * 2.3548), rel=0.01)


def test_the_dip_of_two_gaussians() -> None:
    x = np.linspace(-10, 10, 401)

    def two(apart: float) -> np.ndarray:
        return sum(np.exp(-((x - s * apart / 2) ** 2) / 2) for s in (-1, 1))

    assert dip(x, two(1.0), 1.0) == 0.0, "closer than their width, two pushes are one"
    between, peak = 2 * np.exp(-2.0), two(4.0).max()
    assert dip(x, two(4.0), 4.0) == pytest.approx(1 - between / peak, rel=1e-6)
    beside = np.where(np.abs(x) > 3.3, 9.0, two(4.0))
    assert dip(x, beside, 4.0) == dip(x, two(4.0), 4.0), "peaks are within a quarter of the distance"
    assert dip(np.array([-1.0, 1.0]), np.ones(2), 2.0) == 0.0, "nothing was sampled between them"
    for side in (-1, 1):
        assert dip(np.linspace(-1, 0.4, 15) * side, np.arange(15.0), 2.0) == 0.0, "one place was not sampled"


def test_the_least_distance_is_interpolated_and_never_optimistic() -> None:
    apart = np.array([1.0, 2.0, 3.0, 4.0])
    assert two_point_distance(apart, np.array([0.0, 0.1, 0.3, 0.5])) == pytest.approx(2.5)
    assert two_point_distance(apart, np.array([0.3, 0.1, 0.3, 0.5])) == pytest.approx(2.5), "a stray dip does not count"
    assert two_point_distance(apart, np.array([0.3, 0.4, 0.5, 0.6])) == 1.0
    assert two_point_distance(apart, np.zeros(4)) == np.inf


def test_a_width_that_is_wanted_at_least_is_never_missing():
    x = np.linspace(-4.0, 4.0, 9)
    assert full_width(x, np.maximum(0.0, 1.0 - np.abs(x) / 3.0), at_least=True) == pytest.approx(3.0)
    assert full_width(x, np.ones(9), at_least=True) == pytest.approx(8.0), "as wide as its samples"
    assert np.isnan(full_width(x, np.ones(9)))
