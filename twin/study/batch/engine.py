"""Tasks run here, on all cores, or on a cluster: numbers in, bytes out, in any order.

One worker runs in this process and imports no dask; several, and clusters, are dask.distributed's, the only one of
the engines tried that finished when a worker was killed. No common file system is needed (`twin.study.batch.job`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from twin.study.batch.job import Done, Job, one_thread, unpacked, work_of


class Pool:
    """Who does tasks: this process, processes on this machine that start when they are first needed, or a cluster.

    A context manager, which stops the processes in the end.

    Parameters
    ----------
    workers
        Processes on this machine; 1 works in this one.
    scheduler
        Address of a dask scheduler (``tcp://host:8786``), whose workers are used instead.
    """

    def __init__(self, workers: int = 1, scheduler: str | None = None) -> None:
        self._workers = workers
        self._cluster: Any = scheduler
        self._started = ExitStack()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *raised: object) -> None:
        self._started.close()

    def run(self, job: Job, numbers: Sequence[int]) -> Iterator[Done]:
        """Do tasks and yield them as they finish.

        Parameters
        ----------
        job
            Files and function.
        numbers
            Of the tasks, in the order in which they are wanted.

        Raises
        ------
        InputError
            The scheduler can't be reached.
        """
        if self._cluster is None and min(self._workers, len(numbers)) <= 1:
            with one_thread(), unpacked(job) as folder:
                work = work_of(job.work)
                for number in numbers:
                    yield Done(number, work(folder, number))
            return
        from twin.study.batch.cluster import tasks_on_cluster, workers_here

        if self._cluster is None:
            self._cluster = self._started.enter_context(workers_here(min(self._workers, len(numbers))))
        yield from tasks_on_cluster(job, numbers, self._cluster)


def run_tasks(job: Job, numbers: Iterable[int], *, workers: int = 1, scheduler: str | None = None) -> Iterator[Done]:
    """Do the tasks of one job and yield them as they finish: see `Pool`."""
    with Pool(workers, scheduler) as pool:
        yield from pool.run(job, list(numbers))


def reach(scheduler: str | None) -> None:
    """Ask a scheduler, if one is wanted, whether it is there: before anything is written for it.

    Raises
    ------
    InputError
        It doesn't answer.
    """
    if scheduler is not None:
        from twin.study.batch.cluster import connected

        connected(scheduler).close()
