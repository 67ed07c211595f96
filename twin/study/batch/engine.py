"""Tasks run here, on all cores, or on a cluster: numbers in, bytes out, in any order.

One worker runs in this process and imports no dask; several, and clusters, are dask.distributed's, the only one of
the engines tried that finished when a worker was killed. A worker is given the job's files once, unpacks them into a
folder of its own, and shares nothing else with anyone: no common file system is needed.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import InputError, TwinError

Work = Callable[[Path, int], Any]
"""Does task number n of the job whose files are in a folder."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
AHEAD = 2
"""Hand-outs per worker: the next is there when one is done, and memory stays flat."""

TOGETHER_S = 1.0
"""Quick tasks are handed out several at a time, as many as take so long, in CPU seconds: a hand-out costs some 7 ms."""

RETRIES = 3
"""Times a task may see its worker die before it is given up."""


@dataclass(frozen=True)
class Done:
    """A finished task.

    Attributes
    ----------
    number
        Of the task.
    result
        What it returned; None if it failed.
    problem
        What went wrong, if it did.
    """

    number: int
    result: Any = None
    problem: str | None = None


@dataclass(frozen=True, kw_only=True)
class Job:
    """What every worker needs.

    Attributes
    ----------
    files
        Contents by relative path.
    work
        The function that does a task, as ``module:name``.
    """

    files: Mapping[str, bytes]
    work: str

    @property
    def name(self) -> str:
        """Hash of the files: equal ones are unpacked once per process, whatever is done with them."""
        sha = hashlib.sha256()
        for path in sorted(self.files):
            sha.update(path.encode())
            sha.update(hashlib.sha256(self.files[path]).digest())
        return sha.hexdigest()[:32]


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
                work = _function(job.work)
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


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold every numeric library to one thread: sums in another order would change last digits."""
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def unpacked(job: Job) -> Iterator[Path]:
    """Write a job's files into a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="twin-job-") as name:
        folder = Path(name)
        for path, data in job.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        yield folder


def _function(work: str) -> Work:
    module, name = work.split(":")
    function: Work = getattr(importlib.import_module(module), name)
    return function


_KEPT: dict[str, tuple[ExitStack, Path]] = {}
"""Unpacked jobs of this worker process; the one used last stays."""


def tasks_on_worker(name: str, work: str, numbers: Sequence[int]) -> tuple[list[Done], float]:
    """Do tasks on a dask worker, whose plugin has unpacked the job; return them and the CPU seconds they took."""
    if name not in _KEPT:
        raise RuntimeError("this worker was not given the job's files")
    function, folder, started = _function(work), _KEPT[name][1], time.process_time()
    return [_tried(function, folder, number) for number in numbers], time.process_time() - started


def _tried(function: Work, folder: Path, number: int) -> Done:
    try:
        return Done(number, function(folder, number))
    except Exception as problem:  # whatever it is, the other tasks go on
        return Done(number, problem=f"{type(problem).__name__}: {problem}")


def unpack_on_worker(job: Job) -> None:
    """Unpack a job in a worker process, one numeric thread from here on."""
    if job.name in _KEPT:
        return
    for stack, _ in _KEPT.values():
        stack.close()
    _KEPT.clear()
    stack = ExitStack()
    stack.enter_context(one_thread())
    _KEPT[job.name] = (stack, stack.enter_context(unpacked(job)))


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


def unreachable(scheduler: str, problem: Exception) -> InputError:
    """Return the error of a scheduler that doesn't answer."""
    return InputError(
        f"--scheduler {scheduler}: no dask scheduler answers there ({type(problem).__name__}); start one with "
        "dask scheduler, or leave the option out to work on this machine"
    )


def died(number: int) -> TwinError:
    """Return the error of a task whose workers died again and again."""
    return TwinError(f"task {number}: its worker died {RETRIES} times (out of memory?); run again to try it anew")
