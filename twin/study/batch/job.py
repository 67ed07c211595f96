"""A job: files that every worker is given, tasks that are numbers, and what became of each.

A worker unpacks the files once, into a folder of its own, and shares nothing else with anyone.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Work = Callable[[Path, int], Any]
"""Does task number n of the job whose files are in a folder."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


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


def work_of(place: str) -> Work:
    """Return the function at ``module:name``."""
    module, name = place.split(":")
    function: Work = getattr(importlib.import_module(module), name)
    return function


_KEPT: dict[str, tuple[ExitStack, Path]] = {}
"""Unpacked jobs of this worker process; the one used last stays."""


def tasks_on_worker(name: str, work: str, numbers: Sequence[int]) -> tuple[list[Done], float]:
    """Do tasks on a dask worker, whose plugin has unpacked the job; return them and the CPU seconds they took."""
    if name not in _KEPT:
        raise RuntimeError("this worker was not given the job's files")
    function, folder, started = work_of(work), _KEPT[name][1], time.process_time()
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
