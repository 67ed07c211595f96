"""Comparing programs by error and time: fronts, interpolation between runs, powers of growth, and what nodes add."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import scaling
from benchmarks.pages import front, seconds_to
from benchmarks.scaling import exponent

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


def test_exponent_is_the_power():
    sizes = np.array([1e4, 3e4, 2e5])
    rows = [{"size": n, "seconds": 3e-7 * n**1.7} for n in sizes]
    assert exponent(rows, "seconds") == pytest.approx(1.7, abs=1e-12)


def test_starts_and_samples_are_told_apart_and_workers_have_powers(monkeypatch: pytest.MonkeyPatch) -> None:
    def spent(nodes: int, samples: int) -> tuple[float, list[float]]:
        return 0.2 + 0.0005 * samples, [1.5 + 0.004 * samples / nodes] * nodes

    monkeypatch.setattr(scaling, "on_nodes", spent)
    rows = scaling.cluster()
    paper = next(row for row in rows if row["axis"] == "on paper" and "start_s" in row)
    assert paper["start_s"] == pytest.approx(1.5)
    assert paper["node_ms_a_sample"] == pytest.approx(4.0)
    assert paper["head_ms_a_sample"] == pytest.approx(0.5)
    assert paper["nodes_kept_busy"] == pytest.approx(8.0)
    powers = {"all workers, a sample": 0.0, "a worker, a sample of all": -1.0, "head, a sample": 0.0}
    for stage, power in powers.items():
        mine = [row for row in rows if row.get("stage") == stage]
        assert [row["axis"] for row in mine] == ["workers"] * len(scaling.NODES)
        assert exponent(mine, "cpu_ms") == pytest.approx(power, abs=1e-9)
    assert [row["size"] for row in rows if row["axis"] == "nodes"] == [n for n in scaling.NODES for _ in "12"]
