"""Sweeps: designs a second by fidelity, and how far each fidelity is from the next.

CPU seconds are of one thread; ``designs_per_s`` is what two cores make of them. ``python -m benchmarks sweep`` makes
the stored comparisons of fidelities anew and leaves the stored rates, which want an idle machine.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import twin
from benchmarks.clock import Clock, Cost
from twin.arrays import Floats
from twin.blas_threads import one_thread
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import closed
from twin.study.sweep.sweep_report import write_report
from twin.study.sweep.sweep_run import Swept, run_sweep

CORES = 2
FLAT: dict[str, Any] = {
    "scene": "kamiyama_pillar",
    "set": {"reconstruction.sites.pitch_mm": 1.0},
    "axes": {
        "markers.blue.depth_mm": {"low": 1.0, "high": 3.0},
        "markers.red.depth_mm": {"low": 3.5, "high": 6.0},
        "markers.*.pitch_mm": {"low": 1.2, "high": 1.8},
        "markers.*.diameter_mm": {"low": 0.3, "high": 0.5},
        "material.youngs_modulus_mpa": {"low": 0.3, "high": 2.0, "log": True},
    },
    "loads": {"force_n": 0.5, "size_mm": 1.5, "pair_mm": 4.0, "region_mm": [4.0, 3.0]},
    "sampling": "latin",
    "limits": {"overlap": 0.25},
}
FINGER: dict[str, Any] = {
    "scene": "sato_press",
    "set": {"calibration.method": "compliance", "reconstruction.sites.pitch_mm": 1.0},
    "axes": {
        "markers.blue.depth_mm": {"low": 1.2, "high": 2.5},
        "markers.*.pitch_mm": {"low": 1.2, "high": 2.5},
        "markers.*.diameter_mm": {"low": 0.25, "high": 0.5},
        "material.youngs_modulus_mpa": {"low": 0.3, "high": 1.5, "log": True},
    },
    "loads": {"force_n": 0.3, "size_mm": 1.5, "pair_mm": 4.0, "region_mm": [2.0, 2.0]},
    "sampling": "latin",
    "limits": {"overlap": 0.25},
}
SENSORS = {"flat": FLAT, "finger": FINGER}
PRESSES, MADE, EXPOSURES = 3, 6, 8
"""Presses of the comparison with the full chain, made sensors of each design and exposures of each press: a design's
error is a mean over all of them.

Why many sensors: of one, a tracker's systematic errors (shadows) add to the error of its tolerances or cancel it. Why
many exposures: the linear information means noise over all its draws; of one draw, the full chain's error of a total
force lies a tenth and more off its mean."""

WITHIN = 0.2
NOISE_SE = {"fwhm_mm": "fwhm_noise_se_mm", "total_force_error": "total_force_error_noise_se"}
"""Which metric tells the standard error that noise leaves of another."""


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return the rows of the stage; the quick form has few designs, made sensors and no processes of its own."""
    rows = [
        _closed(2_000 if quick else 200_000),
        _one_by_one("linear information, 636 markers of the scene and more", "linear", 8 if quick else 100),
        _one_by_one("full chain, 5 presses", "full", 2 if quick else 8),
    ]
    if quick:
        return rows + agreement("flat", 2, made=2, exposures=2, workers=1)
    return [*rows, _whole(1000), *comparisons()]


def comparisons() -> list[dict[str, Any]]:
    """Return the rows that compare fidelities: they are the same whatever else the machine does."""
    rows: list[dict[str, Any]] = []
    for name in SENSORS:
        rows += ranked(name, 60, CORES).values()
        rows += agreement(name, 25)
    return rows


def _sweep(table: dict[str, Any], **changes: Any) -> tuple[Sweep, Scene]:
    sweep = Sweep.model_validate({**table, **changes})
    return sweep, twin.load_scene(sweep.scene, sweep.set)


def _rate(what: str, designs: int, cost: Cost) -> dict[str, Any]:
    row = {"what": what, "designs": designs, "cpu_ms": 1e3 * cost.cpu / designs, "wall_s": cost.wall}
    return row | {"designs_per_s": CORES * designs / cost.cpu}


def _closed(count: int) -> dict[str, Any]:
    designs = Designs.of(*_sweep(FLAT, count=count))
    closed(Designs.of(*_sweep(FLAT, count=100)))
    with one_thread():
        clock = Clock()
        closed(designs)
        return _rate("closed form", count, clock.lap())


PRESSED: dict[str, Any] = {**FLAT, "set": {}, "loads": {**FLAT["loads"], "presses": 5, "size_mm": 2.0}}
"""The flat sensor as it is shipped, under five presses."""


def _one_by_one(what: str, stage: str, count: int) -> dict[str, Any]:
    """Time rows in this process, the first apart: it reads tables and compiles."""
    with tempfile.TemporaryDirectory() as name:
        run_sweep(*_sweep(PRESSED, count=1, seed=2, fidelity=[stage], confirm={"full": 1}), Path(name))
        clock = Clock()
        done = run_sweep(*_sweep(PRESSED, count=count, fidelity=[stage], confirm={"full": count}), Path(name))
        return _rate(what, max(int((done.status == "ok").sum()), 1), clock.lap())


def _whole(count: int) -> dict[str, Any]:
    """A thousand designs from the file to the page, on two processes that begin with nothing."""
    with tempfile.TemporaryDirectory() as name:
        clock = Clock()
        done = run_sweep(*_sweep(PRESSED, count=count, fidelity=["closed", "linear"]), Path(name), workers=CORES)
        write_report(done, Path(name))
        return _rate("closed form, linear information and page, two processes", count, clock.lap())


def ranked(name: str, count: int, workers: int = 1) -> dict[str, dict[str, Any]]:
    """Return by metric how the closed form ranks designs, at sites that are fine enough not to limit any."""
    sites = {"columns": 17, "rows": 13} if name == "flat" else {"columns": 11, "rows": 11}
    fine = {f"reconstruction.sites.{key}": value for key, value in {**sites, "pitch_mm": 0.75}.items()}
    table = {**SENSORS[name], "set": {**SENSORS[name]["set"], **fine}}
    table["loads"] = {**table["loads"], "size_mm": 1.0, "pair_mm": 2.0, "region_mm": [2.0, 2.0], "presses": PRESSES}
    with tempfile.TemporaryDirectory() as place:
        done = run_sweep(*_sweep(table, count=count), Path(place), workers=workers)
    metrics = ("fwhm_mm", "two_point_mm", "resolution_gf")
    return {metric: compared(done, "closed", "linear", metric, name) for metric in metrics}


def agreement(
    name: str, count: int, made: int = MADE, exposures: int = EXPOSURES, workers: int = CORES
) -> list[dict[str, Any]]:
    """Return how far the linear information is from the full chain, by metric."""
    loads = {**SENSORS[name]["loads"], "presses": PRESSES, "exposures": exposures}
    table = {**SENSORS[name], "loads": loads, "sensors": made}
    with tempfile.TemporaryDirectory() as place:
        settings = {"count": count, "fidelity": ["closed", "linear", "full"], "confirm": {"full": count}}
        done = run_sweep(*_sweep(table, **settings), Path(place), workers=workers)
    rows = (compared(done, "linear", "full", metric, name) for metric in ("fwhm_mm", "total_force_error", "dip"))
    return [row for row in rows if row]


def compared(done: Swept, one: str, other: str, metric: str, name: str) -> dict[str, Any]:
    """Return the row that compares a metric at two fidelities; empty where no design has both.

    ``standard error`` is the median over the designs of what noise leaves uncertain of the other, over its value.
    """
    from scipy.stats import spearmanr

    a, b = (done.columns.get(f"{f}_{metric}", np.full(len(done.designs), np.nan)) for f in (one, other))
    both = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
    if not both.any():
        return {}
    ratio: Floats = a[both] / b[both]
    rank = float(spearmanr(a[both], b[both]).statistic) if both.sum() > 2 else float("nan")
    row = {
        "what": f"{name}: {metric}, {one} over {other}", "designs": int(both.sum()), "median": float(np.median(ratio)),
        "tenth": float(np.quantile(ratio, 0.1)), "nine tenths": float(np.quantile(ratio, 0.9)),
        f"within {100 * WITHIN:.0f} %": float(np.mean(np.abs(ratio - 1) <= WITHIN)), "rank correlation": rank,
    }  # fmt: skip
    left = done.columns.get(f"{other}_{NOISE_SE.get(metric, '')}")
    if left is not None:
        row["standard error"] = float(np.median(left[both] / b[both]))
    return row
