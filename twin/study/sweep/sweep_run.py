"""Run a sweep: from its recipe to a ranked table of designs.

`run_sweep` computes the cheap fidelity for all designs and the expensive ones for the best, which
a score ranks. Instead of a grid of designs it can search for the best design. `estimate` predicts
the time, and `check` tests the recipe first.

Only this process writes into the folder, under a lock. Rows are stored: ``rows.jsonl`` grows by
whole lines, and a kill cuts off one line at most. A row's key is a hash of all that it depends on
(design, scene, loads, fidelity, versions), so an interrupted or changed sweep reuses the rows that
are there. A worker knows the sweep by the job's files only; each body that it keeps serves one set
of patches, so a row depends on nothing but its design.

Why differential evolution (R. Storn and K. Price 1997): axes may be lists, designs may be
impossible, a generation is a batch for all cores, and SciPy has it. Why L-BFGS-B after it
(R. Byrd et al. 1995): a population finds the valley quickly and its lowest point slowly. The
gradient is taken by differences. On axes that are lists or whole numbers the descent finds nothing
better and costs the share `SHARE` of the designs.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import platform
import time
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Progress
from twin.blas_threads import one_thread
from twin.errors import InputError, RecipeError, TwinError
from twin.files import Fact, cache_folder, fact, kept_if_possible, write_json, write_whole
from twin.parts.scene import Scene, Sites
from twin.parts.sweep import FIDELITIES, METRICS, Sweep
from twin.study.batch.draw import SceneTable
from twin.study.batch.pool import (
    Job,
    Pool,
    counted,
    only_writer,
    versions,
)
from twin.study.doubts import View
from twin.study.recipe import load_scene
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import Shown, closed, full, linear, resolved_by_sites
from twin.study.sweep.loads import REGION, Bodies, Pushes

Row = dict[str, Any]

FORMAT = 5
"""Version of the rows: a change of what they hold makes a sweep compute them again."""

CHUNK = {"linear": 16, "full": 1}
"""Designs of one task: what a kill loses at most, a worker each."""

SHOWN = ("picture", "site_mm", "middle_n", "pair_n")
"""What is kept of a design's full chain for the page."""


@dataclass(frozen=True)
class _Rows:
    """A task's rows (status, error, seconds, metrics), npz contents shown, and compliances needed
    and made."""

    rows: list[Row]
    shown: list[bytes | None]
    asked: int
    made: int


class _Workshop:
    """What a process keeps of one sweep."""

    def __init__(self, folder: Path) -> None:
        job = json.loads((folder / "sweep.json").read_text())
        self.sweep = Sweep.model_validate(job["sweep"])
        self.stage: str = job["stage"]
        self.chunk: int = job["chunk"]
        self.scene = load_scene(folder / "scene.toml")
        columns = {key: [each[key] for each in job["designs"]] for key in job["designs"][0]}
        self.designs = Designs(self.sweep, self.scene, columns)
        self.base = SceneTable.of(self.scene)
        self.bodies = Bodies.of(self.sweep)
        self._pushes: dict[str, Pushes] = {}

    def numbers(self, task: int) -> range:
        """Return the numbers of the designs of a task."""
        return range(task * self.chunk, min((task + 1) * self.chunk, len(self.designs)))

    def row(self, number: int) -> tuple[Row, bytes | None]:
        """Return a design's row; what goes wrong with it is its status."""
        started = time.perf_counter()
        row: Row = {"status": "ok", "error": ""}
        shown = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                figures, shown = self._judge(self.designs.scene_of(number, self.base))
            row |= figures
        except RecipeError as problem:
            row |= {"status": "dropped", "error": "; ".join(problem.problems)}
        except TwinError as problem:
            row |= {"status": "failed", "error": str(problem)}
        except OSError:
            # this machine's trouble, such as a full disk, and not the design's: its row is no row
            raise
        except Exception as problem:  # one design must not end a sweep of thousands
            row |= {"status": "failed", "error": f"{type(problem).__name__}: {problem}"}
        row["seconds"] = time.perf_counter() - started
        return row, shown

    def _judge(self, scene: Scene) -> tuple[dict[str, float], bytes | None]:
        view = View.of(scene)
        inside, hidden = view.inside.mean(), view.hidden.mean()
        if inside < self.sweep.limits.seen:
            raise RecipeError(f"only {100 * inside:.0f} % of the markers are inside the picture")
        if hidden > self.sweep.limits.overlap:
            raise RecipeError(
                f"{100 * hidden:.0f} % of the markers overlap another one in the picture"
            )
        key = json.dumps(scene.body.geometry(), sort_keys=True, default=str)
        if key not in self._pushes:  # the same patches for every design of one body
            self._pushes[key] = _pushes(self.sweep, self.scene, scene)
        if self.stage == "linear":
            return linear(scene, view, self.sweep, self.bodies, self._pushes[key])[0], None
        figures, shown = full(scene, self.sweep, self.bodies, self._pushes[key])
        file = io.BytesIO()
        np.savez_compressed(file, **shown)  # type: ignore[arg-type]
        return figures, file.getvalue()


_workshop = lru_cache(maxsize=1)(_Workshop)


def _make_rows(folder: Path, task: int) -> _Rows:
    """Return the rows of a task of the job whose files are in ``folder``."""
    shop = _workshop(folder)
    before = shop.bodies.asked, shop.bodies.made
    done = [shop.row(number) for number in shop.numbers(task)]
    asked, made = shop.bodies.asked - before[0], shop.bodies.made - before[1]
    return _Rows([row for row, _ in done], [shown for _, shown in done], asked, made)


def _job_of(
    sweep: Sweep, scene: Scene, stage: str, designs: Sequence[dict[str, Any]], chunk: int
) -> Job:
    table = {
        "sweep": sweep.model_dump(mode="json"),
        "stage": stage,
        "chunk": chunk,
        "designs": list(designs),
    }
    files = {"sweep.json": json.dumps(table).encode(), "scene.toml": scene.to_toml().encode()}
    return Job(files=files, work=f"{__name__}:{_make_rows.__name__}")


def _pushes(sweep: Sweep, scene: Scene, design: Scene) -> Pushes:
    return Pushes.of(design.body, sweep.loads, _region(sweep, scene), sweep.seed)


def _region(sweep: Sweep, scene: Scene) -> tuple[float, float]:
    """Return the half sides of the presses' region."""
    if sweep.loads.region_mm is not None:
        return sweep.loads.region_mm
    if scene.reconstruction is None:
        raise InputError(
            "loads.region_mm: the scene has no [reconstruction] sites to take it from; give it"
        )
    s, t = scene.reconstruction.sites.half_mm
    return REGION * s, REGION * t


class Store(dict[str, Row]):
    """Finished rows of a sweep's folder by key; one process writes."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._path = folder / "rows.jsonl"
        self._shown = folder / "shown"
        whole = 0
        data = self._path.read_bytes() if self._path.is_file() else b""
        for line in data.splitlines(keepends=True):
            try:
                read = json.loads(line) if line.endswith(b"\n") else {}
                key, row = read["key"], read["row"]
                if not isinstance(key, str) or not {"status", "error"} <= row.keys():
                    break
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                break
            self[key] = row
            whole += len(line)
        if whole < len(data):
            with open(self._path, "r+b") as file:
                file.truncate(whole)

    def add(self, rows: Mapping[str, Row], shown: Mapping[str, bytes]) -> None:
        """Keep finished rows, and what belongs to them."""
        for key, data in shown.items():
            self._shown.mkdir(exist_ok=True)
            write_whole(self._file(key), data)
        with open(self._path, "ab") as file:
            for key, row in rows.items():
                file.write(json.dumps({"key": key, "row": row}).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self |= rows

    def lose(self, keys: Sequence[str], problem: str) -> None:
        """Fail rows for this run; they are not written, so the next run tries again."""
        row: Row = {"status": "failed", "error": problem, "seconds": float("nan")}
        self |= dict.fromkeys(keys, row)

    def pictures(self, key: str) -> Shown | None:
        """Return a design's picture and fields; None where they are missing or damaged."""
        try:
            with np.load(self._file(key), allow_pickle=False) as kept:
                return {name: kept[name] for name in SHOWN}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            return None

    def _file(self, key: str) -> Path:
        return self._shown / f"{key}.npz"


@dataclass
class _Runner:
    """Runs designs of one sweep and keeps their rows; counts compliances needed and made, and fresh
    rows."""

    sweep: Sweep
    scene: Scene
    folder: Path
    workers: int = 1
    scheduler: Pool.Scheduler | None = None
    progress: Progress | None = None
    asked: int = 0
    made: int = 0
    fresh: int = 0

    def __post_init__(self) -> None:
        self.store = Store(self.folder)
        self._identity = _identity(self.sweep, self.scene)

    def rows(self, stage: str, values: Sequence[dict[str, Any]]) -> list[Row]:
        """Return the rows of designs, computing those that are not there."""
        keys = [self.key(stage, each) for each in values]
        missing = {k: v for k, v in zip(keys, values, strict=True) if not self._is_whole(stage, k)}
        if missing:
            names = list(missing)
            chunk = max(1, min(CHUNK[stage], -(-len(names) // self.workers)))
            tasks = range(-(-len(names) // chunk))
            job = _job_of(self.sweep, self.scene, stage, list(missing.values()), chunk)
            started = time.perf_counter()
            with Pool(min(self.workers, len(tasks)), self.scheduler) as pool:
                for done in pool.run(job, tasks):
                    self._keep(done, names[done.number * chunk : (done.number + 1) * chunk])
                    if self.progress is not None:
                        ready = sum(key in self.store for key in names)
                        rate = ready / max(time.perf_counter() - started, 1e-9)
                        words = f"{stage}: {ready}/{len(names)} designs, {rate:.3g}/s"
                        self.progress(words, min(0.98, ready / len(names)))
        return [self.store[key] for key in keys]

    def _keep(self, done: Job.Done, keys: Sequence[str]) -> None:
        """Keep the rows of a finished task."""
        if done.problem is not None:
            self.store.lose(keys, done.problem)
            return
        found = done.result
        shown = {k: data for k, data in zip(keys, found.shown, strict=True) if data is not None}
        self.store.add(dict(zip(keys, found.rows, strict=True)), shown)
        self.asked += found.asked
        self.made += found.made
        self.fresh += len(keys)

    def _is_whole(self, stage: str, key: str) -> bool:
        """Return whether a row is there, and of the full chain also what the page shows."""
        if key not in self.store:
            return False
        no_picture = stage != "full" or self.store[key]["status"] != "ok"
        return no_picture or self.store.pictures(key) is not None

    def key(self, stage: str, values: dict[str, Any]) -> str:
        """Return the key of a row."""
        facts = json.dumps([self._identity, stage, values], sort_keys=True)
        return hashlib.sha256(facts.encode()).hexdigest()[:32]


def _identity(sweep: Sweep, scene: Scene) -> str:
    """Return a hash of everything but the design that rows depend on."""
    kept = {"seed", "keep_extent", "loads", "limits", "noise_px", "sensors"}
    facts = [
        FORMAT,
        sweep.model_dump(mode="json", include=kept),
        _region(sweep, scene),
        list(sweep.axes),
        list(sweep.derived),
        SceneTable.of(scene) | {"title": ""},
        versions(),
        Bodies.of(sweep).thickness_mm,
    ]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


BEYOND = 0.1
"""What being better than a target counts for, over being worse."""

POPULATION, SHARE = 8, 0.2
"""Designs of a generation, times the axes; part of the designs that is for the gradient."""

STEP = 0.01
"""Differences of the gradient, over an axis's range."""

WORST = 1e3
"""Score of an impossible design: worse than any other, and finite."""

COMPARED = (
    ("closed", "linear", "two_point_mm"),
    ("closed", "linear", "fwhm_mm"),
    ("closed", "linear", "resolution_gf"),
    ("linear", "full", "fwhm_mm"),
    ("linear", "full", "total_force_error"),
    ("linear", "full", "dip"),
)

NEAR = 1.1
"""A two-point distance up to this times the grid's own is the grid's."""

FINE = 0.375
"""Pitch of sites over the two-point distance that they shall resolve: two pushes need a site
each and one between."""

TRIED = 4
"""Designs whose linear rows are computed for an estimate of the time."""


@dataclass
class Swept:
    """A finished sweep.

    Attributes
    ----------
    columns
        (m,) numbers by ``<fidelity>_<metric>``; NaN where a design was not taken so far.
    status, error, fidelity, score
        (m,) ok, dropped or failed; why; the last fidelity; the distance to the targets.
    order
        The designs that are ok, the best first, those of the last fidelity before all others.
    keys
        Keys of the rows of the full chain by design.
    notes, warnings
        What was reused and how well fidelities agree; what makes figures other than they seem.
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

    @property
    def failed(self) -> int:
        """How many designs failed (those that are dropped have not)."""
        return int((self.status == "failed").sum())

    def metric(self, name: str, upto: str = "full") -> Floats | None:
        """Return a metric at the best fidelity, ``upto`` at most, of each design; None if none has
        it."""
        return _metric(self.columns, name, upto)

    @staticmethod
    def agreement(one: Floats, other: Floats) -> tuple[float, float, int]:
        """Return two fidelities' rank correlation (Spearman), the median ratio of the second to the
        first (NaN where one of the first is zero), and how many designs have both."""
        from scipy.stats import spearmanr

        both = np.isfinite(one) & np.isfinite(other)
        a, b = one[both], other[both]
        ratio = float(np.median(b / a)) if len(a) and a.all() else float("nan")
        ranked = len(a) > 2 and np.ptp(a) > 0 and np.ptp(b) > 0
        return float(spearmanr(a, b).statistic) if ranked else float("nan"), ratio, len(a)

    @staticmethod
    def front(columns: Sequence[Floats]) -> Bools:
        """Return (m,) whether no other design is at least as good (less) in all columns and better
        in one."""
        table = np.column_stack(columns)
        front: Bools = np.array(np.isfinite(table).all(axis=1), np.bool_)
        candidates = np.flatnonzero(front)
        kept: list[int] = []
        for number in candidates[np.lexsort(table[candidates].T[::-1])]:
            row = table[number]
            front[number] = not any(
                (table[k] <= row).all() and (table[k] < row).any() for k in kept
            )
            if front[number]:
                kept.append(int(number))
        return front

    def expected(self, number: int) -> Shown:
        """Return what the page shows of a design by its linear information."""
        designs = self.designs
        design = designs.scene_of(number)
        pushes = _pushes(designs.sweep, designs.scene, design)
        return linear(design, View.of(design), designs.sweep, Bodies.of(designs.sweep), pushes)[1]


def _check(sweep: Sweep, scene: Scene) -> None:
    """Raise a `RecipeError` with all reasons why a sweep can't be run."""
    problems = []
    solved = sweep.ladder != ("closed",)
    where = f"scene = '{sweep.scene}'"
    method = scene.calibration.method
    if scene.camera is None:
        problems.append(f"{where}: it has no [camera] table, and designs are seen by a camera")
    if scene.reconstruction is None and solved:
        problems.append(f"{where}: it has no [reconstruction] table, so there are no sites")
    if method not in ("compliance", "halfspace") and solved:
        problems.append(
            f"calibration.method = '{method}': every design would have to be pressed; set "
            "calibration.method = 'compliance' or 'halfspace' under [set]"
        )
    if not scene.markers:
        problems.append(f"{where}: it has no markers")
    loads, press = sweep.loads, scene.press
    if loads.probe and sweep.ladder != ("full",):
        problems.append(
            "loads.probe: only the full chain presses a probe, the closed form and linear "
            "information know given tractions; set fidelity = ['full'], or probe = false"
        )
    if loads.probe and press is None:
        problems.append(f"{where}: it has no [press] table, and loads.probe presses its probe")
    slides = press is not None and 0.0 < loads.shear >= press.friction
    if loads.probe and press is not None and slides and "press.friction" not in sweep.axes:
        problems.append(
            f"loads.shear = {loads.shear:g}: the probe would slide, as press.friction = "
            f"{press.friction:g}; set it above that under [set], or loads.shear = 0"
        )
    if not loads.probe and (scene.material.law != "linear" or "material.law" in sweep.axes):
        problems.append(
            "material.law: loads of given tractions are solved by linear theory only; set "
            "loads.probe = true and fidelity = ['full'], so that the scene's probe presses, or "
            "leave the law linear"
        )
    if scene.material.relaxation:
        problems.append("material.relaxation: a sweep's loads take no time; leave it out")
    if problems:
        raise RecipeError(problems)
    Bodies.refuse(scene)


def run_sweep(
    sweep: Sweep,
    scene: Scene,
    folder: Path,
    *,
    workers: int = 1,
    scheduler: Pool.Scheduler | None = None,
    progress: Progress | None = None,
    optimise: bool = False,
) -> Swept:
    """Run a sweep, or what is missing of it, and write its table.

    Raises
    ------
    RecipeError
        The sweep can't be run.
    InputError
        The folder can't be written, another process is writing there, or the scheduler can't be
        reached.
    """
    _check(sweep, scene)
    designs = Designs.of(sweep, scene)
    if scheduler is not None:
        scheduler.reach()
    with only_writer(folder, folder / "writer.lock"):
        runner = _Runner(
            sweep, scene, folder, workers=workers, scheduler=scheduler, progress=progress
        )
        if optimise:
            designs = _optimised(designs, runner)
        done = _sweep_designs(designs, runner)
        table: dict[str, Any] = {
            "design": np.arange(len(designs)),
            **designs.columns,
            "fidelity": list(done.fidelity),
            "status": list(done.status),
            "error": list(done.error),
            "score": done.score,
            **done.columns,
        }
        _write_table(folder, table)
    return done


def _sweep_designs(designs: Designs, runner: _Runner) -> Swept:
    """Take all designs through the fidelities."""
    sweep = designs.sweep
    count = len(designs)
    columns, reason = closed(designs)
    done = Swept(
        designs=designs,
        columns={f"closed_{k}": v for k, v in columns.items()},
        status=np.where(reason == "", "ok", "dropped").astype(object),
        error=reason,
        fidelity=np.full(count, "closed", dtype=object),
    )
    if "closed" not in sweep.ladder:
        kept = ("closed_markers", "closed_cost")
        done.columns = {k: v for k, v in done.columns.items() if k in kept}
    for number, stage in enumerate(sweep.ladder):
        if stage == "closed":
            continue
        # the first stage takes all designs, a later one the best of the stage before
        rank = _scores(sweep, done.columns) if number else np.zeros(count)
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        order = np.argsort(rank, kind="stable")
        chosen = order[(done.status == "ok")[order]][: most if number else None]
        values = [designs.values(int(n)) for n in chosen]
        rows = runner.rows(stage, values)
        done.fidelity[chosen] = stage
        done.status[chosen] = [row["status"] for row in rows]
        done.error[chosen] = [row["error"] for row in rows]
        _put(done.columns, stage, chosen, rows, count)
        if stage == "full":
            done.keys = {int(n): runner.key(stage, v) for n, v in zip(chosen, values, strict=True)}
    done.score = _scores(sweep, done.columns)
    depth = np.array([FIDELITIES.index(f) for f in done.fidelity])
    order = np.lexsort((done.score, -depth))
    done.order = order[(done.status == "ok")[order]]
    coarse, done.warnings, enough = _coarse(done)
    inverse = done.designs.scene.reconstruction
    if inverse is not None and inverse.method == "local" and (done.fidelity == "linear").any():
        remedy = f"set full = {count} under [confirm]"
        if "full" not in sweep.fidelity:
            remedy = f'add "full" to fidelity, and {remedy}'
        error = "differ" if len(done.designs.scene.markers) > 1 else "are far too large"
        done.warnings.append(
            "the linear fidelity takes method smooth for local, which is not linear: its force "
            f"errors {error}; {remedy}"
        )
    if (done.fidelity == "full").any():
        done.warnings += done.designs.scene.imaging[1].turns()
    done.notes = [*enough, *_notes(done, runner, coarse)]
    return done


def _put(
    columns: dict[str, Floats], stage: str, chosen: Ints, rows: Sequence[Row], count: int
) -> None:
    """Put the numbers of rows into the columns of chosen designs."""
    for number, row in zip(chosen, rows, strict=True):
        for name, value in row.items():
            if name not in ("status", "error"):
                columns.setdefault(f"{stage}_{name}", np.full(count, np.nan))[number] = value


def _coarse(done: Swept) -> tuple[Bools, list[str], list[str]]:
    """Return which widths are only those of the sites, a warning where that is too wide, and else a
    note."""
    none = np.full(len(done.designs), np.nan)
    found = done.columns.get("linear_two_point_mm", none)
    sites = done.columns.get("linear_sites_mm", none)
    with np.errstate(invalid="ignore"):
        coarse: Bools = np.asarray(found <= NEAR * sites)
    if not coarse.any():
        return coarse, [], []
    sweep = done.designs.sweep
    wanted = sweep.targets.get("two_point_mm", sweep.loads.pair_mm)
    least = float(sites[coarse].max())
    said = (
        f"{int(coarse.sum())} of {int((~np.isnan(found)).sum())} designs tell two points apart as "
        f"finely as their sites allow, from {least:.3g} mm on, so this distance does not rank them"
    )
    if least <= wanted:
        finer = "finer sites under [set] would rank them"
        return coarse, [], [f"{said}. All of them reach the {wanted:.3g} mm wanted; {finer}"]
    assert done.designs.scene.reconstruction is not None
    return coarse, [f"{said}; {_finer(done.designs.scene.reconstruction.sites, wanted)}"], []


def _finer(sites: Sites, wanted_mm: float) -> str:
    """Return what to set for sites as fine as wanted over the same area."""
    pitch = float(f"{FINE * wanted_mm:.2g}")
    width, length = size = 2 * np.array(sites.half_mm)
    columns, rows = 1 + np.ceil(size / pitch - 1e-9).astype(int)
    return (
        f"set reconstruction.sites.pitch_mm = {pitch:g} or less under [set], with columns = "
        f"{columns} and rows = {rows} (now {sites.columns} and {sites.rows}) to cover the same "
        f"{width:.3g} x {length:.3g} mm"
    )


def _notes(done: Swept, runner: _Runner, coarse: Bools) -> list[str]:
    """Return how fidelities agree, without widths that the sites limit, and what was reused."""
    notes = []
    for one, other, name in COMPARED:
        a, b = done.columns.get(f"{one}_{name}"), done.columns.get(f"{other}_{name}")
        if a is None or b is None:
            continue
        if name in ("two_point_mm", "fwhm_mm"):
            a = np.where(coarse, np.nan, a)
        rank, ratio, count = done.agreement(a, b)
        if count:
            ranks = f"rank correlation {rank:.2f}"
            if not np.isfinite(rank):
                ranks = "too few or equal for a rank correlation"
            words = METRICS.get(name, name).split(",")[0]
            notes.append(
                f"{words}: {one} against {other} over {count} designs: {ranks}"
                + (f", median ratio {ratio:.3g}" if np.isfinite(ratio) else "")
            )
    if runner.fresh:
        notes.append(
            f"{runner.fresh} rows computed now; a body's compliance was needed {runner.asked} "
            f"times and prepared {runner.made} times"
        )
    return notes


def _metric(columns: Mapping[str, Floats], name: str, upto: str = "full") -> Floats | None:
    """See `Swept.metric`."""
    found: Floats | None = None
    for fidelity in FIDELITIES:
        column = columns.get(f"{fidelity}_{name}")
        if column is not None:
            found = column if found is None else np.where(np.isnan(column), found, column)
        if fidelity == upto:
            break
    return found


def _scores(sweep: Sweep, columns: Mapping[str, Floats]) -> Floats:
    """Return (m,) distances to the targets, a weighted sum of log(metric / target); infinite where
    unknown. What is better than its target counts a tenth, so that meeting all targets comes
    first."""
    parts = []
    for name, target in sweep.targets.items():
        values = _metric(columns, name)
        if values is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(np.maximum(values, 1e-300) / target)
        part = sweep.weights.get(name, 1.0) * np.where(off > 0, off, BEYOND * off)
        parts.append(np.where(np.isnan(part), np.inf, part))
    if not parts:
        return np.full(len(next(iter(columns.values()), ())), np.inf)
    return np.asarray(np.sum(parts, axis=0))


def _optimised(designs: Designs, runner: _Runner) -> Designs:
    """Return the designs that a search within the sweep's axes evaluated, ``count`` of them at
    most."""
    from scipy.optimize import differential_evolution

    sweep, scene = designs.sweep, designs.scene
    stage = "linear" if "linear" in sweep.ladder else "closed"
    # A population that begins with Sobol' points is a power of two, SciPy rounds it up.
    size = 2 ** math.ceil(math.log2(max(5, POPULATION * len(sweep.axes))))
    evaluated: list[Floats] = []

    def judged(u: Floats) -> Floats:
        points = np.clip(np.atleast_2d(np.asarray(u).T), 0.0, 1.0).reshape(-1, len(sweep.axes))
        evaluated.append(points)
        return _scored(sweep, Designs.at(sweep, scene, points), stage, runner)

    found = differential_evolution(
        judged,
        [(0.0, 1.0)] * len(sweep.axes),
        maxiter=max(1, round((1 - SHARE) * sweep.count) // size - 1),
        popsize=POPULATION,
        init="sobol",
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=np.random.default_rng(sweep.seed),
        tol=1e-4,
    )
    _descend(judged, np.clip(found.x, 0.0, 1.0), evaluated, sweep.count)
    return Designs.at(sweep, scene, np.concatenate(evaluated))


def _descend(
    judged: Callable[[Floats], Floats], start: Floats, evaluated: list[Floats], most: int
) -> None:
    """Go down the gradient until nothing is gained or ``most`` designs have been evaluated."""
    from scipy.optimize import minimize

    width = len(start)

    def batch(u: Floats) -> tuple[float, Floats]:
        if sum(map(len, evaluated)) + width + 1 > most:
            raise StopIteration
        step = np.where(u + STEP <= 1.0, STEP, -STEP)
        score = judged(np.concatenate([u[None], u + np.diag(step)]).T)
        slope = (score[1:] - score[0]) / step
        return float(score[0]), np.where(np.abs(score[1:]) < WORST, slope, 0.0)

    with suppress(StopIteration):
        minimize(batch, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * width)


def _scored(sweep: Sweep, designs: Designs, stage: str, runner: _Runner) -> Floats:
    """Return (m,) finite scores of designs, impossible ones being worst."""
    found, reason = closed(designs)
    columns = {f"closed_{k}": v for k, v in found.items()}
    ok = reason == ""
    if stage == "linear":
        numbers = np.flatnonzero(ok)
        rows = runner.rows("linear", [designs.values(int(n)) for n in numbers])
        ok[numbers] = [row["status"] == "ok" for row in rows]
        _put(columns, "linear", numbers, rows, len(designs))
    score = _scores(sweep, columns)
    return np.where(ok & np.isfinite(score), np.minimum(score, WORST / 2), WORST)


def estimate(sweep: Sweep, scene: Scene, *, workers: int = 1) -> list[Fact]:
    """Return what a sweep would do and, unless ``workers`` is 0, how long it takes, from the CPU
    seconds of a few designs; `RecipeError` where it can't be run."""
    facts, good, designs = _overview(sweep, scene)
    left = len(good)
    for stage in sweep.ladder if workers else ():
        if stage == "closed" or not left:
            continue
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        left = min(left, most) if most and stage != sweep.ladder[0] else left
        tried = good[:: max(1, len(good) // TRIED)][: 1 if stage == "full" else TRIED]
        each, start, rows, how = _measured(
            sweep, scene, stage, [designs.values(int(n)) for n in tried]
        )
        text = (
            f"{counted(left, 'design')}, about {{seconds:.3g}} s with {counted(workers, 'worker')}"
            f", a free core each: {{design_s:.3g}} s of CPU a design ({how}), {{begin_s:.2g}} s to "
            "begin"
        )
        times = {"seconds": start + left * each / workers, "design_s": each, "begin_s": start}
        facts.append(fact(stage, text, {"designs": left, **times}))
        bad = Counter((row["status"], row["error"]) for row in rows if row["status"] != "ok")
        for (status, why), count in bad.items():
            facts.append(fact(f"{'':12s}{count} of {len(rows)} tried {status}", why, mark=": "))
        # The next stage tries what this one didn't drop: a dropped design costs nothing.
        ok = np.array([row["status"] == "ok" for row in rows])
        good = tried[ok] if ok.any() else good
    return facts


def _measured(
    sweep: Sweep, scene: Scene, stage: str, tried: list[dict[str, Any]]
) -> tuple[float, float, list[Row], str]:
    """Return CPU seconds of a design and of the start, the rows of the designs tried and how, from
    the cache if it has them."""
    # Pictures take as long for every made sensor of a design: one sensor stands for all.
    times = sweep.sensors if stage == "full" else 1
    few = sweep.model_copy(update={"sensors": sweep.sensors // times})
    job = _job_of(few, scene, stage, [tried[0], *tried], 1)  # the first twice: it begins
    how = f"an estimate from {counted(len(tried), 'design')}"
    made_by = json.dumps([job.name, versions(), platform.node()])
    kept = cache_folder() / f"sweep-cost-{hashlib.sha256(made_by.encode()).hexdigest()[:32]}.json"
    with suppress(OSError, ValueError, KeyError):
        found = json.loads(kept.read_text())
        return found["each_s"], found["begin_s"], found["rows"], f"{how}, made before"
    with one_thread(), job.unpacked() as folder:
        began = time.process_time()
        _make_rows(Path(folder), 0)
        started = time.process_time()
        rows = [_make_rows(Path(folder), k).rows[0] for k in range(1, 1 + len(tried))]
        spent = (time.process_time() - started) / len(rows)
        begin = max(started - began - spent, 0.0)
        each = times * spent
    if all(row["status"] == "ok" for row in rows):
        with kept_if_possible():
            write_json(kept, {"each_s": each, "begin_s": begin, "rows": rows})
    return each, begin, rows, how


def _overview(sweep: Sweep, scene: Scene) -> tuple[list[Fact], Ints, Designs]:
    """Return facts about a sweep's designs, the numbers of those that are possible, and all."""
    _check(sweep, scene)
    designs = Designs.of(sweep, scene)
    found = closed(designs)[1]
    good = np.flatnonzero(found == "")
    if len(good):
        designs.scene_of(int(good[0]))
    over = f"{len(designs)} ({sweep.sampling}) over {', '.join(sweep.axes)}"
    dropped = len(designs) - len(good)
    facts = [
        fact("designs", over, {"designs": len(designs)}),
        fact("dropped", "{dropped} before anything is solved", {"dropped": dropped}),
    ]
    for reason in sorted({str(r) for r in found if r}):
        facts.append(fact(f"{'':12s}{int((found == reason).sum())}", reason, mark=": "))
    target = sweep.targets.get("two_point_mm")
    swept = designs.swept("reconstruction.sites.pitch_mm")
    if target is not None and scene.reconstruction and not swept and not sweep.loads.probe:
        least = resolved_by_sites(scene.reconstruction.sites, sweep.loads)
        if least > target:
            text = (
                f"targets.two_point_mm = {target:g} can't be met: the sites resolve two points "
                f"from {least:.3g} mm on; {_finer(scene.reconstruction.sites, target)}"
            )
            facts.append(fact("warning", text))
    return facts, good, designs


def _write_table(folder: Path, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> None:
    """Write ``designs.parquet`` and ``designs.csv``, a row for every design."""
    import pyarrow as pa
    import pyarrow.csv as csv
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(_plain(column)) for name, column in columns.items()})
    write_whole(
        folder / "designs.parquet", lambda file: pq.write_table(table, file, compression="zstd")
    )
    write_whole(folder / "designs.csv", lambda file: csv.write_csv(table, file))


def _plain(column: Sequence[Any] | np.ndarray) -> list[Any]:
    """Return values of one type; lists and mixtures as JSON."""
    values = column.tolist() if isinstance(column, np.ndarray) else list(column)
    types = {type(v) for v in values}
    if len(types) <= 1 and not types & {list, tuple, dict}:
        return values
    if types <= {int, float}:
        return [float(v) for v in values]
    return [v if isinstance(v, str) else json.dumps(v) for v in values]
