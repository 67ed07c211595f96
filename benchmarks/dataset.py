"""Datasets: where a sample's time goes, stage by stage.

CPU milliseconds a sample of one process, after a shard that warms everything up.
"""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from twin.blas_threads import one_thread
from twin.study import sensor
from twin.study.dataset import sample
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import prepare
from twin.study.recipe import load_scene

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


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a case; the quick form tries four samples of two cases."""
    if quick:
        return [_case(*case, FEW) for case in CASES[1:3]]
    return [_case(*case, MANY if "no pictures" in case[0] else COUNT) for case in CASES]


def _case(name: str, scene: str, overrides: dict[str, Any], count: int) -> dict[str, Any]:
    loaded = load_scene(scene, {"dataset.samples_per_shard": count, **overrides})
    with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder, one_thread():
        places = Places(Path(folder))
        places.meta.mkdir()
        prepare(Plan(loaded, 2 * count), places, None)
        with places.job.unpacked() as job:
            sample.make_shard(job, 0)
            with _stages() as spent:
                started = time.process_time()
                shard = sample.make_shard(job, 1)
                total = time.process_time() - started
    each = {stage: 1000 * seconds / count for stage, seconds in spent.items()}
    each["picture"] = each["picture"] - each["ccd"]  # exposing is a part of taking the picture
    spare = 1000 * total / count - sum(each.values())
    return {"what": name, "samples": count, **each, "other": spare, "total": 1000 * total / count,
            "kb": len(shard.samples) / count / 1000, "failed": shard.failed}  # fmt: skip


@contextmanager
def _stages() -> Iterator[dict[str, float]]:
    """Count the CPU seconds that are spent in each stage while the block runs."""
    from twin.world.picture import ccd as exposure

    where: dict[str, tuple[Any, str]] = {
        "contact": (sensor.Sensor, "press"),
        "displacement": (sensor.Sensor, "quick_motion"),
        "sites": (sample, "in_cells"),
        "picture": (sensor.Sensor, "seen"),
        "ccd": (exposure, "expose"),
        "png": (sample, "png_bytes"),
        "parquet": (sample, "_parquet"),
    }
    spent = dict.fromkeys(where, 0.0)

    def counted(stage: str, before: Any) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            started = time.process_time()
            try:
                return before(*arguments, **named)
            finally:
                spent[stage] += time.process_time() - started

        return call

    with ExitStack() as patched:
        for stage, (owner, name) in where.items():
            patched.enter_context(patch.object(owner, name, counted(stage, getattr(owner, name))))
        yield spent
