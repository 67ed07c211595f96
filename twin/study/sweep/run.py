"""A sweep from its file to its table: the cheap fidelity for all designs, the dear ones for the best.

Only this process writes into the folder, under a lock. Whatever stops a sweep, the same command goes on with the rows
that are missing and ends with the same table (but for the seconds, which are measured).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.progress import Progress
from twin.results import make_folder
from twin.study.batch.engine import reach
from twin.study.batch.lock import only_writer
from twin.study.sweep.closed import closed
from twin.study.sweep.designs import Designs, designs_of
from twin.study.sweep.loads import refuse
from twin.study.sweep.optimise import optimised
from twin.study.sweep.rank import agreement, best_first, scores
from twin.study.sweep.runner import Runner
from twin.study.sweep.sites import advice, limited
from twin.study.sweep.table import write_table
from twin.study.sweep.work import Row


@dataclass
class Swept:
    """A finished sweep.

    Attributes
    ----------
    designs
        All of them.
    columns
        (m,) numbers by ``<fidelity>_<metric>``; NaN where a design was not looked at so closely.
    status, error, fidelity
        (m,) ok, dropped or failed; why; how closely it was looked at.
    score
        (m,) see `twin.study.sweep.rank.scores`, at the best fidelity.
    order
        The designs that are ok, the best first, those looked at most closely before all others.
    keys
        Keys of the rows of the full chain by design.
    notes
        What was reused and how well fidelities agree, in words.
    warnings
        What makes figures other than they seem, and what to do.
    seconds
        Of this run, by fidelity.
    """

    designs: Designs
    columns: dict[str, Floats]
    status: np.ndarray
    error: np.ndarray
    fidelity: np.ndarray
    score: Floats = field(default_factory=lambda: np.zeros(0))
    order: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    keys: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def failed(self) -> int:
        """How many designs failed (those that are dropped have not)."""
        return int((self.status == "failed").sum())


def check(sweep: Sweep, scene: Scene) -> None:
    """Refuse a sweep that can't be run.

    Raises
    ------
    RecipeError
        With all problems at once.
    """
    problems = []
    if scene.camera is None:
        problems.append(f"scene = '{sweep.scene}': it has no [camera] table, and designs are seen by a camera")
    if scene.reconstruction is None and sweep.ladder != ("closed",):
        problems.append(f"scene = '{sweep.scene}': it has no [reconstruction] table, so there are no sites")
    if scene.calibration.method not in ("compliance", "halfspace") and sweep.ladder != ("closed",):
        problems.append(
            f"calibration.method = '{scene.calibration.method}': every design would have to be pressed; set "
            "calibration.method = 'compliance' or 'halfspace' under [set]"
        )
    if not scene.markers:
        problems.append(f"scene = '{sweep.scene}': it has no markers")
    if problems:
        raise RecipeError(problems)
    refuse(scene)


def run_sweep(
    sweep: Sweep, scene: Scene, folder: Path, *, workers: int = 1, scheduler: str | None = None,
    progress: Progress | None = None, optimise: bool = False,
) -> Swept:  # fmt: skip
    """Run a sweep, or what is missing of it, and write its table.

    Raises
    ------
    RecipeError
        The sweep can't be run.
    InputError
        The folder can't be written, another process is writing there, or the scheduler doesn't answer.
    """
    check(sweep, scene)
    designs = designs_of(sweep, scene)
    reach(scheduler)
    make_folder(folder)
    with only_writer(folder / "writer.lock"):
        for stale in folder.rglob(".*.part"):
            stale.unlink(missing_ok=True)
        runner = Runner(sweep, scene, folder, workers=workers, scheduler=scheduler, progress=progress)
        if optimise:
            designs = optimised(designs, runner)
        done = sweep_designs(designs, runner)
        write_table(folder, table_columns(done))
    return done


def sweep_designs(designs: Designs, runner: Runner) -> Swept:
    """Take designs through the sweep's fidelities."""
    sweep, count = designs.sweep, len(designs)
    started = time.perf_counter()
    first = closed(designs)
    done = Swept(
        designs=designs, columns={f"closed_{k}": v for k, v in first.columns.items()},
        status=np.where(first.reason == "", "ok", "dropped").astype(object), error=first.reason.copy(),
        fidelity=np.full(count, "closed", dtype=object),
    )  # fmt: skip
    done.seconds["closed"] = time.perf_counter() - started
    if "closed" not in sweep.ladder:
        done.columns = {k: v for k, v in done.columns.items() if k in ("closed_markers", "closed_cost")}
    for stage in sweep.ladder:
        if stage == "closed":
            continue
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        rank = scores(sweep, done.columns) if stage != sweep.ladder[0] else np.zeros(count)
        if stage == "linear" and "closed" not in sweep.ladder:
            most = None
        chosen = best_first(rank, done.status == "ok", most)
        if stage == "full" and sweep.ladder == ("full",):
            chosen = best_first(rank, done.status == "ok", None)
        began = time.perf_counter()
        values = [designs.values(int(n)) for n in chosen]
        rows = runner.rows(stage, values)
        done.seconds[stage] = time.perf_counter() - began
        _take(done, stage, chosen, rows)
        if stage == "full":
            done.keys = {int(n): runner.key(stage, v) for n, v in zip(chosen, values, strict=True)}
    done.score = scores(sweep, done.columns)
    depth = np.array([("closed", "linear", "full").index(f) for f in done.fidelity])
    order = np.lexsort((done.score, -depth))
    done.order = order[(done.status == "ok")[order]]
    coarse, done.warnings = _coarse(done)
    done.notes = _notes(done, runner, coarse)
    return done


def _take(done: Swept, stage: str, chosen: Ints, rows: Sequence[Row]) -> None:
    """Put a stage's rows into the columns."""
    count = len(done.designs)
    for number, row in zip(chosen, rows, strict=True):
        done.fidelity[number] = stage
        done.status[number], done.error[number] = row["status"], row["error"]
        for name, value in row.items():
            if name not in ("status", "error"):
                column = done.columns.setdefault(f"{stage}_{name}", np.full(count, np.nan))
                column[number] = value


def table_columns(done: Swept) -> dict[str, Any]:
    """Return the table's columns: number, the axes, status, metrics, score."""
    count = len(done.designs)
    return {
        "design": np.arange(count), **done.designs.columns, "fidelity": list(done.fidelity),
        "status": list(done.status), "error": list(done.error), "score": done.score, **done.columns,
    }  # fmt: skip


COMPARED = (
    ("closed", "linear", "two_point_mm"), ("closed", "linear", "fwhm_mm"), ("closed", "linear", "resolution_gf"),
    ("linear", "full", "fwhm_mm"), ("linear", "full", "total_force_error"), ("linear", "full", "dip"),
)  # fmt: skip


def _coarse(done: Swept) -> tuple[Bools, list[str]]:
    """Return which designs' widths are those of their sites, and a warning of them."""
    none = np.full(len(done.designs), np.nan)
    told, sites = (done.columns.get(f"linear_{name}", none) for name in ("two_point_mm", "sites_mm"))
    coarse = limited(told, sites)
    if not coarse.any():
        return coarse, []
    sweep = done.designs.sweep
    wanted = sweep.targets.get("two_point_mm", sweep.loads.pair_mm)
    return coarse, [
        f"{int(coarse.sum())} of {int((~np.isnan(told)).sum())} designs tell two points as near as their sites can, so "
        f"that two_point_mm does not rank them: {advice(float(sites[coarse].max()), wanted)}"
    ]


def _notes(done: Swept, runner: Runner, coarse: Bools) -> list[str]:
    """Return how fidelities agree, and what was reused; designs whose sites hold them back count in no width."""
    notes = []
    for one, other, name in COMPARED:
        a, b = done.columns.get(f"{one}_{name}"), done.columns.get(f"{other}_{name}")
        if a is not None and b is not None:
            if name in ("two_point_mm", "fwhm_mm"):
                a = np.where(coarse, np.nan, a)
            rank, ratio, count = agreement(a, b)
            if count:
                told = (
                    f"rank correlation {rank:.2f}" if np.isfinite(rank) else "too few or equal for a rank correlation"
                )
                notes.append(f"{name}: {one} against {other} over {count} designs: {told}, median ratio {ratio:.3g}")
    if runner.fresh:
        notes.append(
            f"{runner.fresh} rows computed now; a body's compliance was asked for {runner.asked} times and prepared "
            f"{runner.made} times"
        )
    return notes
