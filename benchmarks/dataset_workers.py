"""What handing shards to dask workers costs, by CPU seconds of all processes: client, scheduler and workers.

Workers are warmed up first. Every shard says how many CPU seconds its samples took; whatever else all processes spend
until the last shard is there (messages, the way of the bytes, heartbeats) is the overhead. Heartbeats go by the clock,
tasks or none: where other programs take most of the cores, they come more often per sample. So what idle processes
spend is measured, too, and from that what the overhead is where workers have the cores for themselves.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twin.study.batch.engine import run_tasks
from twin.study.batch.job import Done, Job, one_thread
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import job_of, prepare
from twin.study.dataset.work import ShardBytes, make_shard
from twin.study.recipe import load_scene

WARM = 3
"""Shards of every worker before the clock is started."""

IDLE_S = 5.0
"""How long idle processes are watched."""


def timed(folder: Path, shard: int) -> tuple[ShardBytes, float]:
    """Make a shard; return it with the CPU seconds that it took."""
    started = time.process_time()
    made = make_shard(folder, shard)
    return made, time.process_time() - started


def rows(name: str, scene: str, overrides: dict[str, Any], samples: int) -> list[dict[str, Any]]:
    """Return a row for one process without dask, and for one and two workers of it."""
    loaded = load_scene(scene, overrides)
    each = loaded.dataset.samples_per_shard
    shards = samples // each
    found = []
    for workers in (0, 1, 2):
        with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder, one_thread():
            places = Places(Path(folder))
            places.meta.mkdir()
            prepare(Plan(loaded, (WARM * 2 + shards) * each), places, None)
            job = Job(files=job_of(places).files, work=f"{__name__}:timed")
            with _runner(workers) as run:
                warm = WARM * max(1, workers)
                for _ in run(job, range(warm)):
                    pass
                clock, before = time.perf_counter(), _cpu()
                spent = sum(done.result[1] for done in run(job, range(warm, warm + shards)))
                wall, cpu = time.perf_counter() - clock, _cpu() - before
                idle = _idle() if workers else 0.0
        count = shards * each
        how = f"dask, {workers} worker{'s' if workers > 1 else ''}" if workers else "one process"
        own_cores = (cpu - idle * wall) / spent - 1 + idle / max(1, workers)
        found.append({"what": f"{name}, {how}", "samples": count, "total": 1000 * cpu / count,
                      "overhead_percent": 100 * (cpu / spent - 1), "on_own_cores_percent": 100 * own_cores,
                      "idle_ms_per_s": 1000 * idle, "per_s_wall": count / wall})  # fmt: skip
    return found


@contextmanager
def _runner(workers: int) -> Iterator[Callable[[Job, Iterable[int]], Iterator[Done]]]:
    """Give what does tasks: so many of dask's workers, also a single one; this process without any."""
    if not workers:
        yield run_tasks
        return
    from twin.study.batch.cluster import tasks_on_cluster, workers_here

    with workers_here(workers) as cluster:
        yield lambda job, numbers: tasks_on_cluster(job, numbers, cluster)


def _idle() -> float:
    """Return the CPU seconds that idle processes spend in a second."""
    clock, before = time.perf_counter(), _cpu()
    time.sleep(IDLE_S)
    return (_cpu() - before) / (time.perf_counter() - clock)


def _cpu() -> float:
    """Return the CPU seconds of this process and of all that it started and that still run."""
    import psutil

    this = psutil.Process()
    return float(sum(sum(p.cpu_times()[:2]) for p in (this, *this.children(recursive=True))))
