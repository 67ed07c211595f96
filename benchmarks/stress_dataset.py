"""Axes of a dataset: samples to a file, processes, places that can't be pressed; the answers must not move.

Departure is the share of samples whose columns differ from those of the plainest run (one process, two to a file), or,
on an axis of wrong scenes, the share of samples that neither came out nor are rows with an error.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.fuzz_whole import SMALL
from benchmarks.stress_axes import Axis, Measured
from twin.study.dataset.create import create_dataset
from twin.study.dataset.reader import open_dataset
from twin.study.recipe import load_scene

SAMPLES = 6
KEPT = ("force_n", "marker_displacement_mm", "marker_pressed_px")
SAME = Measured(departure=0.0)


def dataset_axes() -> list[Axis]:
    """Return the axes of a dataset of six samples."""
    return [
        _axis("samples to a file", (2.0, 1.0, 3.0, 100.0), lambda n: _same(shard=int(n))),
        _axis("processes", (1.0, 2.0, 4.0), lambda n: _same(workers=int(n))),
        _axis("places that miss the block, share of the range", (0.0, 0.5, 1.0), _missing),
        _axis("columns of markers", (7.0, 1.0, 0.0), lambda n: _told({"markers.red.columns": int(n)})),
    ]


def _axis(name: str, steps: tuple[float, ...], attempt: Any) -> Axis:
    return Axis(name=name, steps=steps, attempt=attempt, bounds=SAME)


def _made(more: dict[str, Any], shard: int = 2, workers: int = 1) -> list[dict[str, Any]]:
    keys = {
        **SMALL, "dataset.samples_per_shard": shard, "dataset.columns": list(KEPT), "press.friction": 0.0,
        "vary": {"press.at_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]}}, **more,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        create_dataset(load_scene("kamiyama_pillar", keys), Path(folder), SAMPLES, workers=workers)
        return list(open_dataset(Path(folder)))


@cache
def _plainest() -> list[dict[str, Any]]:
    return _made({})


def _same(shard: int = 2, workers: int = 1) -> Measured:
    rows = _made({}, shard, workers)
    differ = [any((a[k] != b[k]).any() for k in KEPT) for a, b in zip(rows, _plainest(), strict=True)]
    return Measured(departure=sum(differ) / SAMPLES)


def _missing(share: float) -> Measured:
    far = 50.0 + 200.0 * share
    return _told({"vary": {"press.at_mm": {"low": [-3.0, -2.0], "high": [-3.0 + share * far, 2.0]}}})


def _told(more: dict[str, Any]) -> Measured:
    rows = _made(more)
    told = [row["status"] == "ok" or (row["status"] == "failed" and row["error"]) for row in rows]
    return Measured(departure=1.0 - sum(map(bool, told)) / SAMPLES)
