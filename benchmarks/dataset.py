"""Datasets: where a sample's time goes, stage by stage, and what many workers add.

CPU milliseconds a sample of one process, after a shard that warms everything up. A machine with n idle cores makes n
times 1000 / total samples a second; the last rows say what one process and dask with 1 and 2 workers take of the CPU
of all processes, and which share is not the samples' own (`benchmarks.dataset_workers`). ``python -m
benchmarks.dataset`` puts the stored rows into docs/dataset.md.
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table
from benchmarks.dataset_workers import rows as workers_rows
from twin.study import sensor
from twin.study.batch.job import one_thread, unpacked
from twin.study.dataset import cells, work
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import job_of, prepare
from twin.study.recipe import load_scene

PAGE = ROOT / "docs" / "dataset.md"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

TRUTH = ["force_n", "surface_force_n", "site_force_n", "site_contact", "marker_displacement_mm", "marker_pressed_px"]
FRICTIONLESS = {
    "press.friction": 0.0,
    "vary": {
        "press.at_mm": {"low": [-9.0, -6.0], "high": [9.0, 6.0]},
        "press.force_n": {"normal_n": {"low": 0.1, "high": 1.5, "log": True}},
        "press.probe": {"choice": [{"kind": "sphere", "diameter_mm": {"low": 4.0, "high": 16.0}},
                                   {"kind": "cylinder", "diameter_mm": {"low": 3.0, "high": 7.0}}]},
    },
}  # fmt: skip
RECTANGLE = {
    "tractions": [{"kind": "rectangle", "size_mm": [4.0, 4.0], "force_n": [0.0, 0.0, 1.0]}],
    "vary": {
        "tractions.0.centre_mm": {"low": [-9.0, -6.0], "high": [9.0, 6.0]},
        "tractions.0.size_mm": {"low": [1.0, 1.0], "high": [6.0, 6.0]},
        "tractions.0.force_n": {"normal_n": {"low": 0.1, "high": 1.5, "log": True}, "ratio": {"low": 0.0, "high": 1.0}},
    },
}
CASES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("flat, all, traced", "dataset_kamiyama", {"accuracy.centroid_px": "auto"}),
    ("flat, all, fast path", "dataset_kamiyama", {}),
    ("flat, no pictures, friction", "dataset_kamiyama", {"dataset.columns": TRUTH}),
    ("flat, no pictures, frictionless", "dataset_kamiyama", {"dataset.columns": TRUTH, **FRICTIONLESS}),
    ("flat, all, two round footprints given", "dataset_tractions", {}),
    ("flat, no pictures, two round footprints", "dataset_tractions", {"dataset.columns": TRUTH}),
    ("flat, no pictures, a rectangle given", "dataset_tractions", {"dataset.columns": TRUTH, **RECTANGLE}),
    ("finger, all, fast path", "dataset_sato", {}),
)

COUNT = 24
"""Samples that are timed, after as many that warm up."""

FEW = 4
"""Of the quick form."""

MANY = 96
"""Without pictures, where samples are quick and alike only on average; by then all sizes of bumps were met."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a case and one a number of workers; the quick form tries four samples of two cases."""
    rows = [_case(*case, FEW if quick else _count(case[0])) for case in (CASES[1:3] if quick else CASES)]
    return rows if quick else [*rows, *_workers()]


def _count(name: str) -> int:
    return MANY if "no pictures" in name else COUNT


def _case(name: str, scene: str, overrides: dict[str, Any], count: int) -> dict[str, Any]:
    loaded = load_scene(scene, {"dataset.samples_per_shard": count, **overrides})
    with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder, one_thread():
        places = Places(Path(folder))
        places.meta.mkdir()
        prepare(Plan(loaded, 2 * count), places, None)
        with unpacked(job_of(places)) as job:
            work.make_shard(job, 0)
            with _stages() as spent:
                started = time.process_time()
                shard = work.make_shard(job, 1)
                total = time.process_time() - started
    each = {stage: 1000 * seconds / count for stage, seconds in spent.items()}
    each["picture"] = each["picture"] - each["ccd"]  # exposing is a part of taking the picture
    spare = 1000 * total / count - sum(each.values())
    return {"what": name, "samples": count, **each, "other": spare, "total": 1000 * total / count,
            "kb": len(shard.samples) / count / 1000, "failed": shard.failed}  # fmt: skip


@contextmanager
def _stages() -> Iterator[dict[str, float]]:
    """Count the CPU seconds that are spent in each stage while the block runs."""
    from twin import png
    from twin.world.picture import exposure

    where: dict[str, tuple[Any, str]] = {
        "contact": (sensor.Sensor, "press"),
        "displacement": (sensor.Sensor, "motion_of_patches"),
        "sites": (cells, "in_cells"),
        "picture": (sensor.Sensor, "seen"),
        "ccd": (exposure, "expose"),
        "png": (png, "png_bytes"),
        "parquet": (work, "parquet"),
    }
    spent = dict.fromkeys(where, 0.0)
    before = {stage: getattr(owner, name) for stage, (owner, name) in where.items()}

    def counted(stage: str) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            started = time.process_time()
            try:
                return before[stage](*arguments, **named)
            finally:
                spent[stage] += time.process_time() - started

        return call

    for stage, (owner, name) in where.items():
        setattr(owner, name, counted(stage))
    try:
        yield spent
    finally:
        for stage, (owner, name) in where.items():
            setattr(owner, name, before[stage])


def _workers() -> list[dict[str, Any]]:
    """Return what dask adds to samples of a usual price, and to the quickest ones, in the scenes' own shards."""
    usual, quick = {"dataset.columns": TRUTH}, {"dataset.columns": TRUTH, **RECTANGLE}
    return [
        *workers_rows("flat, no pictures, friction", "dataset_kamiyama", usual, 200),
        *workers_rows("flat, no pictures, a rectangle given", "dataset_tractions", quick, 3000),
    ]


def page_tables() -> str:
    """Return the stored rows as the page shows them."""
    path = RESULTS / "dataset.json"
    if not path.is_file():
        return "(not measured yet)\n"
    told = json.loads(path.read_text())
    cores = told["machine"]["cores"]
    rows = [_with_rate(row, cores) for row in told["rows"]]
    return f"On {told['machine']['processor']}, {cores} cores.\n\n{table(rows)}\n"


def _with_rate(row: dict[str, Any], cores: int) -> dict[str, Any]:
    """Return a row with the samples a second that all cores make, after what one takes; of rows by stage only."""
    if "contact" not in row:
        return row
    before = list(row)[: list(row).index("total") + 1]
    return {key: row[key] for key in before} | {"per_s": 1000.0 * cores / row["total"]} | row


def write_page(page: Path = PAGE) -> None:
    """Put the stored rows into the page."""
    text = page.read_text()
    page.write_text(re.sub(MARKS, lambda m: m[1] + page_tables() + m[2], text, flags=re.DOTALL))


if __name__ == "__main__":
    write_page()
