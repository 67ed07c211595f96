"""Making a dataset: what must be there before the first sample, the samples, and what is said about them at the end.

Only this process writes into the folder, under an operating system's lock. ``meta/`` with scene, meshes and info is
written before the first sample; every file appears whole under its name. So whatever stops a run, the same command
goes on with the shards that are missing, and ends with the same bytes.
"""

from __future__ import annotations

import json
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import InputError
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.results import make_folder, write_whole
from twin.study.batch.engine import Pool, reach
from twin.study.batch.job import Done, Job
from twin.study.batch.lock import only_writer
from twin.study.dataset.finish import drop_changed, finish
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import job_of, prepare, resumed


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes
    ----------
    folder
        Where the dataset is.
    samples, failed
        How many it has, and how many of them failed.
    missing
        Shards that could not be made.
    reason
        The first failure.
    seconds
        Of this run.
    made
        Samples made by this run.
    """

    folder: Path
    samples: int
    failed: int
    missing: tuple[int, ...]
    reason: str
    seconds: float
    made: int


def create_dataset(
    scene: Scene,
    folder: Path,
    samples: int,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Make a dataset, or what is missing of it.

    Parameters
    ----------
    scene
        With ``[vary]``, and ``[dataset]`` if its defaults don't fit.
    folder
        Where to; it may hold the beginning of the same dataset.
    samples
        How many; a dataset can grow, but not shrink.
    workers, scheduler
        See `twin.study.batch.engine.Pool`.
    progress
        Told what is being done and the share that is done.

    Raises
    ------
    RecipeError
        The scene can't be sampled.
    InputError
        The folder holds something else, another process is writing there, or the scheduler doesn't answer.

    Warns
    -----
    UserWarning
        Nothing of the press varies, so that all samples are the same one.
    """
    plan = Plan(scene, samples)
    plan.check()
    if "picture" in plan.needs and scheduler is None:
        from twin.world.picture.room import require_room

        require_room(scene, at_once=min(workers, plan.shards))
    if plan.alike:
        warnings.warn(plan.alike, stacklevel=2)
    reach(scheduler)
    places = Places(folder)
    make_folder(folder)
    make_folder(places.meta)
    with only_writer(places.meta / "writer.lock"):
        for stale in folder.rglob(".*.part"):
            stale.unlink(missing_ok=True)
        if places.info.is_file():
            plan = resumed(plan, places)
            drop_changed(places)
        else:
            prepare(plan, places, progress)
        for wanted in (places.data, places.sensors):
            make_folder(wanted)
        job = job_of(places)
        content = json.loads(places.info.read_text())["content"]
        with Pool(workers, scheduler) as pool:
            return _work(plan, places, job, content, pool, progress)


def _work(plan: Plan, places: Places, job: Job, content: str, pool: Pool, progress: Progress | None) -> Outcome:
    started = time.perf_counter()
    waiting = [number for number in range(plan.shards) if not is_whole(plan, places, number, content)]
    if waiting:
        places.sums.unlink(missing_ok=True)
    total = sum(len(plan.of_shard(n)) for n in waiting)
    made, failed, reason = 0, 0, ""
    missing: list[int] = []
    _tell(progress, plan, plan.samples - total, 0, 0, started)
    for done in pool.run(job, waiting):
        if done.problem is not None:
            missing.append(done.number)
            reason = reason or f"shard {done.number}: {done.problem}"
            continue
        _write(places, done)
        made += len(plan.of_shard(done.number))
        failed += done.result.failed
        reason = reason or done.result.reason
        _tell(progress, plan, plan.samples - total + made, made, failed, started)
    seconds = time.perf_counter() - started
    if not missing:
        told = finish(plan, places, job, pool, progress)
        failed, reason = len(told.numbers), reason or told.reason
    if progress is not None:
        progress("done", 1.0)
    return Outcome(
        folder=places.folder, samples=plan.samples, failed=failed, missing=tuple(missing), reason=reason,
        seconds=seconds, made=made,
    )  # fmt: skip


def _write(places: Places, done: Done) -> None:
    shard: Any = done.result
    if shard.sensors is not None:
        write_whole(places.sensor_shard(done.number), lambda file: file.write(shard.sensors))
    write_whole(places.shard(done.number), lambda file: file.write(shard.samples))


def _tell(progress: Progress | None, plan: Plan, there: int, made: int, failed: int, started: float) -> None:
    if progress is None:
        return
    rate = made / max(time.perf_counter() - started, 1e-9)
    failures = f", {failed} failed" if failed else ""
    progress(f"{there}/{plan.samples} samples, {rate:.3g}/s{failures}", min(0.999, there / plan.samples))


def is_whole(plan: Plan, places: Places, number: int, content: str) -> bool:
    """Return whether a shard is there, with all of its samples and sensors and of this dataset.

    Raises
    ------
    InputError
        A file in its place belongs to another dataset.
    """
    paths = [places.shard(number)] + [places.sensor_shard(number)] * bool(plan.sensors_of(number))
    numbers = plan.of_shard(number)
    return all(_holds(path, content, f"{numbers.start}-{numbers.stop}") for path in paths)


def _holds(path: Path, content: str, samples: str) -> bool:
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        return False
    try:
        words = pq.read_schema(path).metadata or {}
    except (pa.ArrowException, OSError):
        return False
    if words.get(b"twin.content", b"") != content.encode():
        raise InputError(f"{path}: belongs to another dataset; give another --out, or remove it")
    return bool(words.get(b"twin.samples", b"") == samples.encode())
