"""The rows of a sweep: what is computed of a design, stored in the sweep's folder and used again.

A row's key is a hash of all that it depends on (design, scene, loads, fidelity, versions), so an
interrupted or changed sweep uses the rows that are there. ``rows.jsonl`` grows by whole lines, and
a kill cuts off one line at most; only this process writes. A worker knows the sweep by the job's
files only; each body that it keeps serves one set of patches, so a row depends on nothing but its
design.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Progress
from twin.blas_threads import one_thread
from twin.files import read_arrays, write_whole
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.batch.draw import SceneTable
from twin.study.batch.pool import Job, Pool, counted, versions
from twin.study.sweep.loads import Bodies, Pushes

Row = dict[str, Any]
"""A design's ``status`` (ok, dropped or failed), ``error``, ``seconds``, and metrics."""

FORMAT = 5
"""Version of the rows: a change of what they hold makes a sweep compute them again."""

Shown = dict[str, np.ndarray]
"""What the page shows of a design: (k, 3) ``site_mm``, the forces estimated there under the push in
the middle, ``middle_n``, and under the pair, ``pair_n``, and the middle push's ``picture``."""

_WORK = "twin.study.sweep.fidelities:_make_rows"

CHUNK = {"linear": 16, "full": 1}
"""Designs of one task: what a kill loses at most, a worker each."""

SHOWN = ("picture", "site_mm", "middle_n", "pair_n")
"""What is kept of a design's full chain for the page."""


class Rows:
    """The rows of designs of one sweep, computed where the folder lacks them.

    Attributes
    ----------
    asked, made
        How often a body's compliance was needed, and prepared.
    fresh
        How many rows were computed.
    """

    def __init__(
        self,
        sweep: Sweep,
        scene: Scene,
        folder: Path,
        *,
        workers: int = 1,
        scheduler: Pool.Scheduler | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.asked = 0
        self.made = 0
        self.fresh = 0
        self._sweep = sweep
        self._scene = scene
        self._folder = folder
        self._workers = workers
        self._scheduler = scheduler
        self._progress = progress
        self._stored = _Stored(folder)
        self._identity = _identity(sweep, scene)

    def of(self, stage: str, values: Sequence[dict[str, Any]]) -> list[Row]:
        """Return the rows of designs at a fidelity, computing those that are not there."""
        keys = [self.key(stage, each) for each in values]
        missing = {k: v for k, v in zip(keys, values, strict=True) if not self._is_whole(stage, k)}
        if missing:
            self._compute(stage, missing)
        return [self._stored[key] for key in keys]

    def key(self, stage: str, values: dict[str, Any]) -> str:
        """Return the key of a row."""
        facts = json.dumps([self._identity, stage, values], sort_keys=True)
        return hashlib.sha256(facts.encode()).hexdigest()[:32]

    @staticmethod
    def shown(folder: Path, key: str) -> Shown | None:
        """Return a design's picture and fields; None where they are missing or damaged."""
        try:
            kept = read_arrays(_shown_file(folder, key), SHOWN)
        except (OSError, ValueError):
            return None
        return kept if len(kept) == len(SHOWN) else None

    @staticmethod
    def cost(
        sweep: Sweep, scene: Scene, stage: str, tried: list[dict[str, Any]]
    ) -> tuple[float, float, list[Row], str]:
        """Return CPU seconds of a design and of the start, the rows of the designs tried and how,
        from the cache if it has them."""
        # Pictures take as long for every made sensor of a design: one sensor stands for all.
        times = sweep.sensors if stage == "full" else 1
        few = sweep.model_copy(update={"sensors": sweep.sensors // times})
        # The first of several comes twice, as it begins. One alone is slow: its time holds both.
        again = tried[:1] if len(tried) > 1 else []
        job = _job_of(few, scene, stage, [*again, *tried], 1)

        def measured() -> dict[str, Any]:
            with one_thread(), job.unpacked() as folder:
                began = time.process_time()
                for number, _ in enumerate(again):
                    job.task(folder, number)
                started = time.process_time()
                rows = [job.task(folder, len(again) + k).rows[0] for k in range(len(tried))]
                spent = (time.process_time() - started) / len(rows)
            begin = max(started - began - spent, 0.0)
            failed = any(row["status"] != "ok" for row in rows)
            return {"each_s": times * spent, "begin_s": begin, "rows": rows, "failed": failed}

        found, earlier = Job.remembered("sweep", job.name, measured)
        how = f"an estimate from {counted(len(tried), 'design')}{earlier}"
        return found["each_s"], found["begin_s"], found["rows"], how

    def _compute(self, stage: str, missing: Mapping[str, dict[str, Any]]) -> None:
        """Compute and store the rows of designs, by key, in tasks."""
        keys = list(missing)
        chunk = max(1, min(CHUNK[stage], -(-len(keys) // self._workers)))
        tasks = range(-(-len(keys) // chunk))
        job = _job_of(self._sweep, self._scene, stage, list(missing.values()), chunk)
        started = time.perf_counter()
        with Pool(min(self._workers, len(tasks)), self._scheduler) as pool:
            for done in pool.run(job, tasks):
                self._keep(done, keys[done.number * chunk : (done.number + 1) * chunk])
                if self._progress is not None:
                    ready = sum(key in self._stored for key in keys)
                    rate = ready / max(time.perf_counter() - started, 1e-9)
                    words = f"{stage}: {ready}/{len(keys)} designs, {rate:.3g}/s"
                    self._progress(words, min(0.98, ready / len(keys)))

    def _keep(self, done: Job.Done, keys: Sequence[str]) -> None:
        """Keep the rows of a finished task; those of a lost one fail, for this run only."""
        if done.problem is not None:
            row: Row = {"status": "failed", "error": done.problem, "seconds": float("nan")}
            self._stored |= dict.fromkeys(keys, row)
            return
        found = done.result
        shown = {k: data for k, data in zip(keys, found.shown, strict=True) if data is not None}
        self._stored.add(dict(zip(keys, found.rows, strict=True)), shown)
        self.asked += found.asked
        self.made += found.made
        self.fresh += len(keys)

    def _is_whole(self, stage: str, key: str) -> bool:
        """Return whether a row is there, and of the full chain also what the page shows."""
        if key not in self._stored:
            return False
        no_picture = stage != "full" or self._stored[key]["status"] != "ok"
        return no_picture or self.shown(self._folder, key) is not None


class _Stored(dict[str, Row]):
    """Finished rows of a sweep's folder by key."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._path = folder / "rows.jsonl"
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
            path = _shown_file(self._folder, key)
            path.parent.mkdir(exist_ok=True)
            write_whole(path, data)
        with open(self._path, "ab") as file:
            for key, row in rows.items():
                file.write(json.dumps({"key": key, "row": row}).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self |= rows


def _shown_file(folder: Path, key: str) -> Path:
    return folder / "shown" / f"{key}.npz"


def _identity(sweep: Sweep, scene: Scene) -> str:
    """Return a hash of everything but the design that rows depend on."""
    kept = {"seed", "keep_extent", "loads", "limits", "noise_px", "sensors"}
    facts = [
        FORMAT,
        sweep.model_dump(mode="json", include=kept),
        Pushes.region_of(sweep, scene),
        list(sweep.axes),
        list(sweep.derived),
        SceneTable.of(scene) | {"title": ""},
        versions(),
        Bodies.of(sweep).thickness_mm,
    ]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


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
    return Job(files=files, work=_WORK)
