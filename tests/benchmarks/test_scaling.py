"""What is read off datasets that nodes made: a start, a sample's time, and the powers over workers."""

from __future__ import annotations

import pytest

from benchmarks import scaling
from benchmarks.growth_law import exponent


def test_starts_and_samples_are_told_apart_and_workers_have_powers(monkeypatch: pytest.MonkeyPatch) -> None:
    def spent(nodes: int, samples: int) -> tuple[float, list[float]]:
        return 0.2 + 0.0005 * samples, [1.5 + 0.004 * samples / nodes] * nodes

    monkeypatch.setattr(scaling, "_on_nodes", spent)
    rows = scaling.cluster()
    paper = next(row for row in rows if row["axis"] == "on paper" and "start_s" in row)
    assert paper["start_s"] == pytest.approx(1.5)
    assert paper["node_ms_a_sample"] == pytest.approx(4.0)
    assert paper["head_ms_a_sample"] == pytest.approx(0.5)
    assert paper["nodes_kept_busy"] == pytest.approx(8.0)
    powers = {"all workers, a sample": 0.0, "a worker, a sample of all": -1.0, "head, a sample": 0.0}
    for stage, power in powers.items():
        mine = [{**row, "unknowns": row["size"]} for row in rows if row.get("stage") == stage]
        assert [row["axis"] for row in mine] == ["workers"] * len(scaling.NODES)
        assert exponent(mine, "cpu_ms") == pytest.approx(power, abs=1e-9)
    assert [row["size"] for row in rows if row["axis"] == "nodes"] == [n for n in scaling.NODES for _ in "12"]
