"""Tasks on dask.distributed: this machine's cores, or any cluster whose scheduler has an address.

A task that loses its worker is done again by another; a task whose workers die again and again is reported and left
out. Results travel to this process, which alone writes: through a cluster's scheduler, as its workers may not be
reached from here, and straight from workers of this machine.
"""

from __future__ import annotations

import logging
import socket
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from twin.errors import InputError, MissingCapability
from twin.study.batch.job import Done, Job, tasks_on_worker, unpack_on_worker

AHEAD = 2
"""Hand-outs per worker: the next is there when one is done, and memory stays flat."""

TOGETHER_S = 1.0
"""Quick tasks are handed out several at a time, as many as take so long, in CPU seconds: a hand-out costs some 7 ms."""

RETRIES = 3
"""Times a task may see its worker die before it is given up."""

HERE = "127.0.0.1"
"""This machine, for itself."""

PATIENCE_S = 20
"""How long a scheduler is waited for."""

QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.tick.interval": "1s",
    "distributed.scheduler.active-memory-manager.start": False,
}
"""What dask watches in workers of this machine, and nobody looks at: half of what it costs beside tasks."""


@contextmanager
def workers_here(count: int) -> Iterator[Any]:
    """Start so many worker processes on this machine, and stop them in the end.

    Raises
    ------
    MissingCapability
        This machine has no network to itself (127.0.0.1), by which they are talked to, or no room for them.
    """
    import dask
    from distributed import LocalCluster

    _talks_to_itself()
    _configure(dask)
    try:
        started = LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0,
            silence_logs=logging.CRITICAL, host=HERE,
        )  # fmt: skip
    except (OSError, RuntimeError, TimeoutError) as problem:
        raise MissingCapability(
            f"{count} worker processes could not be started here ({_why(problem)}): see that there are enough "
            "processes, memory, open files and room for temporary files, or take --workers 1"
        ) from None
    with started as cluster:
        yield cluster


def _why(problem: BaseException) -> str:
    """Return what the system said, if that lies under an error: dask's own says no more than that none did start."""
    under: BaseException | None = problem
    while under is not None and not isinstance(under, OSError):
        under = under.__cause__ or under.__context__
    return " ".join(str(under or problem).split()) or type(problem).__name__


def _talks_to_itself() -> None:
    """Refuse a machine whose loopback is down: dask would wait for its workers for minutes."""
    try:
        with socket.create_server((HERE, 0)) as server, socket.create_connection(server.getsockname(), timeout=5):
            pass
    except OSError as problem:
        raise MissingCapability(
            f"several workers talk over {HERE}, which can't be reached here ({problem.strerror or problem}): "
            "ip link set lo up, or --workers 1"
        ) from None


def _configure(dask: Any) -> None:
    dask.config.set({"distributed.scheduler.allowed-failures": RETRIES, **QUIET})
    logging.getLogger("distributed").setLevel(logging.CRITICAL)


def connected(cluster: Any) -> Any:
    """Return a client of `workers_here`, or of a scheduler by its address.

    Raises
    ------
    InputError
        The scheduler doesn't answer.
    """
    import dask
    from distributed import Client

    _configure(dask)
    try:
        return Client(cluster, timeout=PATIENCE_S, direct_to_workers=not isinstance(cluster, str))
    except (OSError, TimeoutError, ValueError) as problem:
        raise InputError(
            f"--scheduler {cluster}: no dask scheduler answers there ({type(problem).__name__}); start one with "
            "dask scheduler, or leave the option out to work on this machine"
        ) from None


def tasks_on_cluster(job: Job, numbers: Iterable[int], cluster: Any) -> Iterator[Done]:
    """Do the tasks on `workers_here`, or a scheduler's, and yield them as they finish; see `Pool.run`."""
    from distributed import as_completed
    from distributed.diagnostics.plugin import WorkerPlugin

    class JobFiles(WorkerPlugin):  # type: ignore[misc]
        """Gives every worker, also one that comes later, the job's files before its first task."""

        name = f"twin-{job.name}"
        idempotent = True

        def setup(self, worker: Any) -> None:
            unpack_on_worker(job)

    with connected(cluster) as client:
        client.register_plugin(JobFiles())
        waiting, alone = deque(numbers), deque[int]()
        given: dict[str, list[int]] = {}
        ahead = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))

        def hand_out(many: int) -> Any:
            these = [alone.popleft()] if alone else [waiting.popleft() for _ in range(many)]
            key = f"{job.work}-{these[0]}-{len(these)}"
            given[key] = these
            return client.submit(tasks_on_worker, job.name, job.work, these, pure=False, key=key)

        pool, many = as_completed([hand_out(1) for _ in range(min(ahead, len(waiting)))]), 1
        for future in pool:
            these = given.pop(future.key)
            found, seconds = _done(these, future)
            future.release()
            if seconds is None and len(these) > 1:  # what kills workers shall take no others along
                alone.extend(these)
                found = []
            elif seconds is not None:
                many = max(1, int(TOGETHER_S * len(these) / max(seconds, 1e-6)))
            if alone or waiting:
                pool.add(hand_out(min(many, -(-len(waiting) // ahead))))
            yield from found


def _done(numbers: list[int], future: Any) -> tuple[list[Done], float | None]:
    """Return what became of tasks, and the CPU seconds they took; None if they were lost."""
    problem = future.exception()
    if problem is None:
        found, seconds = future.result()
        return found, seconds
    if type(problem).__name__ == "KilledWorker":
        died = f"its worker died {RETRIES} times (out of memory?); run again to try it anew"
        return [Done(number, problem=f"task {number}: {died}") for number in numbers], None
    return [Done(number, problem=f"{type(problem).__name__}: {problem}") for number in numbers], None
