"""Comparing programs by error and time: fronts, and interpolation between runs."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.pages import front, seconds_to

SIZES = st.floats(1e-6, 1e3)
RUNS = st.lists(st.tuples(SIZES, SIZES), max_size=12)


@settings(deadline=None)
@given(RUNS)
def test_no_run_beats_the_front_and_every_other_run_is_beaten(runs):
    best = front(runs)
    for seconds, error in best:
        assert not any(s <= seconds and e <= error and (s, e) != (seconds, error) for s, e in runs)
    for seconds, error in runs:
        assert any(s <= seconds and e <= error for s, e in best)


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_interpolation_is_exact_for_a_power_law(power):
    """Half the error for twice the power of time, in whatever order the runs come, with worse runs in between."""
    runs = [(0.1 * error**-power, error) for error in (0.05, 0.002, 0.0004, 0.01)]
    assert seconds_to([*runs, (1e4, 0.5)], 0.003) == pytest.approx(0.1 * 0.003**-power, rel=1e-12)


def test_a_goal_beyond_the_best_run_is_not_reached_and_one_below_the_first_costs_the_first():
    runs = [(1.0, 0.01), (10.0, 0.001)]
    assert seconds_to(runs, 0.0009) is None
    assert seconds_to(runs, 0.5) == 1.0
    assert seconds_to([], 0.5) is None
