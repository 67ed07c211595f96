"""Tasks on dask.distributed: this machine's cores, or any cluster whose scheduler has an address.

A task that loses its worker is done again by another; a task whose workers die again and again is reported and left
out. Results travel through the scheduler's workers to this process, which alone writes.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable, Iterator
from typing import Any

from twin.study.batch.engine import AHEAD, RETRIES, Done, Job, died, task_on_worker, unpack_on_worker, unreachable

PATIENCE_S = 20
"""How long a scheduler is waited for."""

QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.tick.interval": "1s",
    "distributed.scheduler.active-memory-manager.start": False,
}
"""What dask watches in workers of this machine, and nobody looks at: half of what it costs beside tasks."""


def tasks_on_cluster(job: Job, numbers: Iterable[int], workers: int, scheduler: str | None) -> Iterator[Done]:
    """Do the tasks and yield them as they finish; see `twin.study.batch.engine.run_tasks`."""
    import dask
    from distributed import Client, LocalCluster, as_completed
    from distributed.diagnostics.plugin import WorkerPlugin

    class JobFiles(WorkerPlugin):  # type: ignore[misc]
        """Gives every worker, also one that comes later, the job's files before its first task."""

        name = f"twin-{job.name}"
        idempotent = True

        def setup(self, worker: Any) -> None:
            unpack_on_worker(job)

    dask.config.set({"distributed.scheduler.allowed-failures": RETRIES, **QUIET})
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    cluster = None
    try:
        if scheduler is None:
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0,
                silence_logs=logging.CRITICAL, host="127.0.0.1",
            )  # fmt: skip
        try:
            client = Client(cluster or scheduler, timeout=PATIENCE_S, direct_to_workers=False)
        except (OSError, TimeoutError, ValueError) as problem:
            raise unreachable(str(scheduler), problem) from None
        with client:
            client.register_plugin(JobFiles())
            waiting = iter(numbers)
            count = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))

            def hand_out(number: int) -> Any:
                return client.submit(task_on_worker, job.name, job.work, number, pure=False, key=f"task-{number}")

            pool = as_completed([hand_out(n) for n in itertools.islice(waiting, AHEAD * count)])
            for future in pool:
                number = int(future.key.split("-")[1])
                done = _done(number, future)
                future.release()
                for more in itertools.islice(waiting, 1):
                    pool.add(hand_out(more))
                yield done
    finally:
        if cluster is not None:
            cluster.close()


def _done(number: int, future: Any) -> Done:
    problem = future.exception()
    if problem is None:
        return Done(number, future.result())
    if type(problem).__name__ == "KilledWorker":
        return Done(number, problem=str(died(number)))
    return Done(number, problem=f"{type(problem).__name__}: {problem}")
