"""The rows of a sweep: stored ones are read, missing ones are computed by tasks and stored.

``rows.jsonl`` grows by whole lines; a kill cuts off one line at most, which is computed again. A
row's key is a hash of all that it depends on (design, scene, loads, fidelity, versions), so a row
is computed once whatever the order, and a changed sweep reuses the designs that it shares with the
one before.

A worker knows the sweep by the job's files only. It keeps the bodies that it has prepared; each
body serves one set of patches, so a row depends on nothing but its design.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import time
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Progress
from twin.errors import InputError, RecipeError, TwinError
from twin.files import write_whole
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.batch.draw import plain_table
from twin.study.batch.pool import Job, Scheduler, run_tasks
from twin.study.doubts import view_of
from twin.study.recipe import dump_scene, load_scene
from twin.study.sweep.designs import scene_of
from twin.study.sweep.fidelities import Shown, cost, full, linear
from twin.study.sweep.loads import REGION, Bodies, Pushes, pushes_of, thickness_range

Row = dict[str, Any]

FORMAT = 4
"""Version of the rows: a change of what they hold makes a sweep compute them again."""

CHUNK = {"linear": 16, "full": 1}
"""Designs of one task: what a kill loses at most, a worker each."""

COST = "cost"
"""Stage of a job that estimates what designs of the full chain cost."""

SHOWN = ("picture", "site_mm", "middle_n", "pair_n")
"""What is kept of a design's full chain for the page."""


@dataclass(frozen=True)
class Rows:
    """Rows of a task.

    Attributes
    ----------
    rows
        One for every design: ``status`` ok, dropped or failed, ``error``, ``seconds``, and metrics.
    shown
        Contents of npz files that hold what the report shows, where something is.
    asked, made
        How often a compliance was needed, and how many were prepared.
    """

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
        self.values: list[dict[str, Any]] = job["designs"]
        self.scene = load_scene(folder / "scene.toml")
        self.base = plain_table(self.scene)
        self.bodies = Bodies(thickness_mm=thickness_range(self.sweep))
        self._pushes: dict[str, Pushes] = {}

    def row(self, values: dict[str, Any]) -> tuple[Row, bytes | None]:
        """Return a design's row; what goes wrong with it is its status."""
        started = time.perf_counter()
        row: Row = {"status": "ok", "error": ""}
        shown = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                figures, shown = self._judge(scene_of(self.sweep, self.base, values))
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
        view = view_of(scene)
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
        if self.stage == COST:
            return cost(scene, self.sweep, self.bodies, self._pushes[key]), None
        figures, shown = full(scene, self.sweep, self.bodies, self._pushes[key])
        file = io.BytesIO()
        np.savez_compressed(file, **shown)  # type: ignore[arg-type]
        return figures, file.getvalue()


_SHOPS: dict[Path, _Workshop] = {}


def make_rows(folder: Path, task: int) -> Rows:
    """Return the rows of a task of the job whose files are in ``folder``."""
    if folder not in _SHOPS:
        _SHOPS.clear()
        _SHOPS[folder] = _Workshop(folder)
    shop = _SHOPS[folder]
    before = shop.bodies.asked, shop.bodies.made
    done = [shop.row(values) for values in shop.values[task * shop.chunk : (task + 1) * shop.chunk]]
    asked, made = shop.bodies.asked - before[0], shop.bodies.made - before[1]
    return Rows([row for row, _ in done], [shown for _, shown in done], asked, made)


def job_of(
    sweep: Sweep, scene: Scene, stage: str, designs: Sequence[dict[str, Any]], chunk: int
) -> Job:
    """Return the job that computes a fidelity of designs, ``chunk`` of them a task."""
    table = {
        "sweep": sweep.model_dump(mode="json"),
        "stage": stage,
        "chunk": chunk,
        "designs": list(designs),
    }
    files = {"sweep.json": json.dumps(table).encode(), "scene.toml": dump_scene(scene).encode()}
    return Job(files=files, work=f"{__name__}:{make_rows.__name__}")


def expected(sweep: Sweep, scene: Scene, values: dict[str, Any]) -> Shown:
    """Return what the page shows of a design by its linear information."""
    design = scene_of(sweep, plain_table(scene), values)
    bodies = Bodies(thickness_mm=thickness_range(sweep))
    return linear(design, view_of(design), sweep, bodies, _pushes(sweep, scene, design))[1]


def _pushes(sweep: Sweep, scene: Scene, design: Scene) -> Pushes:
    return pushes_of(design.body, sweep.loads, _region(sweep, scene), sweep.seed)


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


class Store:
    """Finished rows by key; one process writes.

    Parameters
    ----------
    folder
        Of the sweep.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "rows.jsonl"
        self._shown = folder / "shown"
        self._rows: dict[str, Row] = {}
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
            self._rows[key] = row
            whole += len(line)
        if whole < len(data):
            with open(self._path, "r+b") as file:
                file.truncate(whole)

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

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
        self._rows |= rows

    def lose(self, keys: Sequence[str], problem: str) -> None:
        """Fail rows for this run; they are not written, so the next run tries again."""
        row: Row = {"status": "failed", "error": problem, "seconds": float("nan")}
        self._rows |= dict.fromkeys(keys, row)

    def pictures(self, key: str) -> Shown | None:
        """Return a design's picture and fields; None where they are missing or damaged."""
        try:
            with np.load(self._file(key), allow_pickle=False) as kept:
                return {name: kept[name] for name in SHOWN}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            return None

    def _file(self, key: str) -> Path:
        return self._shown / f"{key}.npz"


class Runner:
    """Runs designs of one sweep, and keeps their rows.

    Parameters
    ----------
    sweep, scene
        What is swept.
    folder
        Where rows are kept.
    workers, scheduler
        See `twin.study.batch.pool.run_tasks`.
    progress
        Called with what is done.
    """

    def __init__(
        self,
        sweep: Sweep,
        scene: Scene,
        folder: Path,
        *,
        workers: int = 1,
        scheduler: Scheduler | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.sweep, self.scene = sweep, scene
        self.store = Store(folder)
        self._workers, self._scheduler, self._progress = workers, scheduler, progress
        self._identity = _identity(sweep, scene)
        self.asked, self.made, self.fresh = 0, 0, 0

    def rows(self, stage: str, values: Sequence[dict[str, Any]]) -> list[Row]:
        """Return the rows of designs, computing those that are not there."""
        keys = [self.key(stage, each) for each in values]
        missing = {k: v for k, v in zip(keys, values, strict=True) if not self._is_whole(stage, k)}
        names = list(missing)
        chunk = max(1, min(CHUNK[stage], -(-len(names) // self._workers)))
        tasks = range(-(-len(names) // chunk))
        job = job_of(self.sweep, self.scene, stage, list(missing.values()), chunk)
        workers = min(self._workers, max(1, len(tasks)))
        started = time.perf_counter()
        finished = run_tasks(job, tasks, workers=workers, scheduler=self._scheduler)
        for done in finished if len(tasks) else ():
            mine = names[done.number * chunk : (done.number + 1) * chunk]
            if done.problem is not None:
                self.store.lose(mine, done.problem)
                continue
            found = done.result
            shown = {k: data for k, data in zip(mine, found.shown, strict=True) if data is not None}
            self.store.add(dict(zip(mine, found.rows, strict=True)), shown)
            self.asked += found.asked
            self.made += found.made
            self.fresh += len(mine)
            if self._progress is not None:
                ready = sum(key in self.store for key in names)
                rate = ready / max(time.perf_counter() - started, 1e-9)
                self._progress(
                    f"{stage}: {ready}/{len(names)} designs, {rate:.3g}/s",
                    min(0.98, ready / max(len(names), 1)),
                )
        return [self.store[key] for key in keys]

    def _is_whole(self, stage: str, key: str) -> bool:
        """Return whether a row is there, and of the full chain also what the page shows."""
        if key not in self.store:
            return False
        no_picture = stage != "full" or self.store[key]["status"] != "ok"
        return no_picture or self.store.pictures(key) is not None

    def key(self, stage: str, values: dict[str, Any]) -> str:
        """Return the key of a design's row."""
        facts = json.dumps([self._identity, stage, values], sort_keys=True)
        return hashlib.sha256(facts.encode()).hexdigest()[:32]


def _identity(sweep: Sweep, scene: Scene) -> str:
    """Return a hash of everything but the design that rows depend on."""
    from twin.study.batch.pool import versions

    kept = {"seed", "keep_extent", "loads", "limits", "noise_px", "sensors"}
    facts = [
        FORMAT,
        sweep.model_dump(mode="json", include=kept),
        _region(sweep, scene),
        list(sweep.axes),
        list(sweep.derived),
        plain_table(scene) | {"title": ""},
        versions(),
        thickness_range(sweep),
    ]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()
