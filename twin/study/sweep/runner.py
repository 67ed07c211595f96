"""The rows of a sweep's designs: those that are kept are read, the others are made by tasks and kept."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.progress import Progress
from twin.study.batch.draw import plain_table
from twin.study.batch.engine import run_tasks
from twin.study.batch.job import Job
from twin.study.recipe import dump_scene
from twin.study.sweep.loads import thickness_range
from twin.study.sweep.table import Store, row_key
from twin.study.sweep.work import WORK, Row, region_of

FORMAT = 3
CHUNK = {"linear": 16, "full": 1}
"""Designs of one task: what a kill loses at most, a worker each."""


class Runner:
    """Runs designs of one sweep, and keeps their rows.

    Parameters
    ----------
    sweep, scene
        What is swept.
    folder
        Where rows are kept.
    workers, scheduler
        See `twin.study.batch.engine.run_tasks`.
    progress
        Told what is done.
    """

    def __init__(
        self, sweep: Sweep, scene: Scene, folder: Path, *, workers: int = 1, scheduler: str | None = None,
        progress: Progress | None = None,
    ) -> None:  # fmt: skip
        self.sweep, self.scene = sweep, scene
        self.store = Store(folder)
        self._workers, self._scheduler, self._progress = workers, scheduler, progress
        self._identity = identity(sweep, scene)
        self.asked, self.made, self.fresh = 0, 0, 0

    def rows(self, stage: str, values: Sequence[dict[str, Any]]) -> list[Row]:
        """Return the rows of designs, computing those that are not there."""
        keys = [self.key(stage, each) for each in values]
        missing = {key: each for key, each in zip(keys, values, strict=True) if not self._is_whole(stage, key)}
        names, waiting = list(missing), list(missing.values())
        chunk = max(1, min(CHUNK[stage], -(-len(waiting) // self._workers)))
        told = {"sweep": self.sweep.model_dump(mode="json"), "stage": stage, "chunk": chunk, "designs": waiting}
        files = {"sweep.json": json.dumps(told).encode(), "scene.toml": dump_scene(self.scene).encode()}
        tasks = range(-(-len(waiting) // chunk))
        started = time.perf_counter()
        workers = min(self._workers, max(1, len(tasks)))
        for done in (
            run_tasks(Job(files=files, work=WORK), tasks, workers=workers, scheduler=self._scheduler)
            if len(tasks)
            else ()
        ):
            mine = names[done.number * chunk : (done.number + 1) * chunk]
            if done.problem is not None:
                lost: Row = {"status": "failed", "error": done.problem, "seconds": float("nan")}
                for key in mine:  # not kept: the next run tries again
                    self.store._rows[key] = lost
                continue
            shown = {key: data for key, data in zip(mine, done.result.shown, strict=True) if data is not None}
            self.store.add(dict(zip(mine, done.result.rows, strict=True)), shown)
            self.asked += done.result.asked
            self.made += done.result.made
            self.fresh += len(mine)
            self._tell(stage, sum(key in self.store for key in names), len(names), started)
        return [self.store[key] for key in keys]

    def _is_whole(self, stage: str, key: str) -> bool:
        """Return whether a design's row is there, and of the full chain also what the page shows of it."""
        if key not in self.store:
            return False
        return stage != "full" or self.store[key]["status"] != "ok" or self.store.pictures(key) is not None

    def key(self, stage: str, values: dict[str, Any]) -> str:
        """Return the key of a design's row."""
        return row_key(self._identity, stage, values)

    def _tell(self, stage: str, done: int, of: int, started: float) -> None:
        if self._progress is not None:
            rate = done / max(time.perf_counter() - started, 1e-9)
            self._progress(f"{stage}: {done}/{of} designs, {rate:.3g}/s", min(0.98, done / max(of, 1)))


def identity(sweep: Sweep, scene: Scene) -> str:
    """Return a hash of everything but the design that rows depend on."""
    from twin.study.dataset.prepare import versions

    kept = sweep.model_dump(mode="json", include={"seed", "keep_extent", "loads", "limits", "noise_px", "sensors"})
    base = plain_table(scene) | {"title": ""}
    told = [FORMAT, kept, region_of(sweep, scene), list(sweep.axes), list(sweep.derived), base, versions()]
    if (thickness := thickness_range(sweep)) is not None:
        told.append(list(thickness))
    return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()
