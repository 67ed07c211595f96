"""Numbered tasks computed here, on all cores, or on a cluster: numbers in, results out, in any
order.

One worker runs in this process. Several are processes of this machine: copies of this one where it
can be copied (Linux), which start at once with all that this one has loaded, else new ones. On a
cluster they are dask.distributed's, where each unpacks the job's files once, into a folder of its
own; no common file system is needed. A task that loses its worker is repeated by another; a task
whose workers die again and again is reported and left out. Results travel to this process, which
alone writes.

Why not ``concurrent.futures``: its processes can't be killed at once before Python 3.14, and Ctrl-C
would wait for their tasks. Why not dask on one machine, too: it takes seconds to load, and its
workers listen on ports.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import importlib.metadata
import json
import logging
import math
import multiprocessing
import os
import platform
import signal
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from twin.blas_threads import one_thread
from twin.errors import InputError, MissingCapability, TwinError
from twin.files import cache_folder, kept_if_possible, make_folder, temporary_folder, write_json

Work = Callable[[Path, int], Any]
"""Computes task number n of the job whose files are in a folder."""

AHEAD = 2
"""Tasks per worker: the next is there when one is done, and memory stays flat. Handing one out
costs some 7 ms, a task takes half a second and more."""

START_S = 9.0
"""Seconds that two processes take to start and to load what this one has, on two cores: 6 where
they are idle, 9 and more with other work, which also makes tasks look longer."""

RETRIES = 3
"""Workers that a task may lose before it is given up."""

DIED = f"its worker died {RETRIES} times (out of memory?); run again to repeat it"

PATIENCE_S = 20
"""How long to wait for a scheduler."""

COPY_S = 1.0
"""CPU seconds of work from which on copies of this process pay: a second core gains as much, and
what they would load is loaded by then."""

FORKS = sys.platform == "linux"
"""Whether workers may be copies of this process: other systems' libraries don't bear it."""

_DIES_WITH_PARENT = 1
"""Linux's PR_SET_PDEATHSIG."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """What every worker needs: files' contents by relative path, and the function,
    ``module:name``."""

    @dataclass(frozen=True)
    class Done:
        """A finished task: its number, and what it returned or what went wrong."""

        number: int
        result: Any = None
        problem: str | None = None

    files: Mapping[str, bytes]
    work: str

    @property
    def name(self) -> str:
        """Hash of the files: jobs on the same files share one unpacked folder per process."""
        sha = hashlib.sha256()
        for path in sorted(self.files):
            sha.update(path.encode())
            sha.update(hashlib.sha256(self.files[path]).digest())
        return sha.hexdigest()[:32]

    def task(self, folder: Path, number: int) -> Any:
        """Compute a task here, from the files unpacked in ``folder``."""
        return _work_of(self.work)(folder, number)

    @contextmanager
    def unpacked(self) -> Iterator[Path]:
        """Write the files into a temporary folder."""
        with temporary_folder("twin-job") as folder:
            for path, data in self.files.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_bytes(data)
            yield folder

    @staticmethod
    def remembered(
        kind: str, of: Any, measure: Callable[[], dict[str, Any]]
    ) -> tuple[dict[str, Any], str]:
        """Return what was measured for an estimate, and ``", made before"`` where the cache has it,
        of the same by these versions on this machine; not kept where something ``failed``."""
        made_by = hashlib.sha256(json.dumps([of, versions(), platform.node()]).encode())
        kept = cache_folder() / f"{kind}-cost-{made_by.hexdigest()[:32]}.json"
        with suppress(OSError, ValueError):
            found: dict[str, Any] = json.loads(kept.read_text())
            return found, ", made before"
        found = measure()
        if not found["failed"]:
            with kept_if_possible():
                write_json(kept, found)
        return found, ""


class Pool:
    """This process, processes here that start when they pay (``workers`` at most), or a
    ``scheduler``'s.

    A context manager, which stops the processes in the end. This process begins with the first task
    and computes all of them if that takes less time than others take to start.
    """

    @dataclass(frozen=True, kw_only=True)
    class Scheduler:
        """A dask scheduler on a cluster, ``tcp://host:8786``, or ``tls://`` with PEM files: the
        authority of all certificates, and this process's certificate and key.

        Whoever can connect to it can run code as the user of its workers and of this process:
        without TLS it belongs on a private network only.
        """

        address: str
        ca: Path | None = None
        cert: Path | None = None
        key: Path | None = None

        def __post_init__(self) -> None:
            """Raise `InputError` unless the files are given together, exist, and go with tls://."""
            files = {"--tls-ca": self.ca, "--tls-cert": self.cert, "--tls-key": self.key}
            for name, file in files.items():
                if file is not None and not file.is_file():
                    raise InputError(f"{name} {file}: there is no such file")
            encrypted = self.address.startswith("tls://")
            missing = [name for name, file in files.items() if file is None]
            if encrypted and missing:
                raise InputError(f"--scheduler {self.address}: needs {', '.join(missing)}, too")
            if not encrypted and len(missing) < len(files):
                raise InputError(
                    f"--scheduler {self.address}: must start with tls:// where --tls files are "
                    "given"
                )

        def reach(self) -> None:
            """Connect to it, before anything is written for it; `InputError` where that fails."""
            _connected(self).close()

    def __init__(self, workers: int = 1, scheduler: Scheduler | None = None) -> None:
        self._workers = workers
        self._scheduler = scheduler
        self._processes: dict[Any, Any] = {}  # by the pipe to each
        self._folders: dict[str, Path] = {}
        self._unpacked = ExitStack()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *raised: object) -> None:
        for pipe in list(self._processes):
            self._end(pipe)
        self._unpacked.close()

    def run(self, job: Job, numbers: Iterable[int]) -> Iterator[Job.Done]:
        """Compute tasks in the order of their numbers, and yield them as they finish; `InputError`
        where the scheduler can't be reached, `MissingCapability` where no process can be
        started."""
        waiting = deque(numbers)
        if not waiting:
            return
        if self._scheduler is not None:
            yield from self.tasks_on_cluster(job, waiting, self._scheduler)
            return
        if job.name not in self._folders:
            self._folders[job.name] = self._unpacked.enter_context(job.unpacked())
        if not self._processes:
            if _can_be_copied():
                yield from self._run_here(job, waiting, COPY_S)
            if waiting and not _can_be_copied():
                yield from self._run_here(job, waiting, START_S)
        yield from self._run_in_processes(job, waiting)

    @staticmethod
    def end_if_too_long() -> None:
        """Give up a first task here that takes long; tasks call it between their parts."""
        if time.process_time() > _limit_s[0]:
            raise _TooLong

    def _run_in_processes(self, job: Job, waiting: deque[int]) -> Iterator[Job.Done]:
        """Compute tasks in processes; where one dies, another is started and its task is waiting
        again."""
        given: dict[Any, int] = {}
        lost = Counter[int]()
        try:
            while waiting or given:
                self._start(min(self._workers, len(waiting) + len(given)))
                for pipe in self._processes.keys() - given.keys():
                    if waiting:
                        given[pipe] = waiting.popleft()
                        with suppress(OSError):  # it has died, as the next `recv` finds
                            pipe.send((job.work, self._folders[job.name], given[pipe]))
                ready: list[Any] = wait(given)
                for pipe in ready:
                    number = given.pop(pipe)
                    try:
                        done: Job.Done = pipe.recv()
                    except (EOFError, OSError):
                        self._end(pipe)
                        lost[number] += 1
                        if lost[number] < RETRIES:
                            waiting.appendleft(number)
                            continue
                        done = Job.Done(number, problem=f"task {number}: {DIED}")
                    yield done
        finally:
            for pipe in given:  # a reply that nobody reads must not be taken for a later task's
                self._end(pipe)

    def _start(self, count: int) -> None:
        """Start processes until there are ``count`` of them, fewer where there is no room."""
        if len(self._processes) >= count:
            return
        copied = _can_be_copied()
        context: Any = multiprocessing.get_context("fork" if copied else "spawn")
        try:
            with one_thread():
                while len(self._processes) < count:
                    ours, theirs = context.Pipe()
                    inherited = (*self._processes, ours) if copied else ()
                    process = context.Process(target=_serve, args=(theirs, inherited), daemon=True)
                    process.start()
                    theirs.close()
                    self._processes[ours] = process
        except OSError as problem:
            if not self._processes:
                raise MissingCapability(
                    f"worker processes could not be started here ({problem.strerror or problem}): "
                    "see that there are enough processes, memory, open files and room for "
                    "temporary files, or take --workers 1"
                ) from None

    def _end(self, pipe: Any) -> None:
        """Stop the process at the other end of a pipe."""
        process = self._processes.pop(pipe)
        process.kill()
        process.join()
        pipe.close()

    def _run_here(self, job: Job, waiting: deque[int], start_s: float) -> Iterator[Job.Done]:
        """Compute tasks here until processes pay that take ``start_s`` to start."""
        gain = 1.0 - 1.0 / min(self._workers, len(waiting))
        folder = self._folders[job.name]
        with one_thread(), suppress(_TooLong):
            work = _work_of(job.work)
            started = time.process_time()
            done = 0
            while waiting:
                with _limited(started + start_s if gain and not done else math.inf):
                    result = work(folder, waiting[0])
                done += 1
                yield Job.Done(waiting.popleft(), result)
                left_s = len(waiting) * (time.process_time() - started) / done
                if left_s * gain > start_s:
                    return

    @staticmethod
    def tasks_on_cluster(
        job: Job, numbers: Iterable[int], scheduler: Scheduler
    ) -> Iterator[Job.Done]:
        """Compute tasks on a scheduler's workers; yield them as they finish."""
        from distributed import as_completed
        from distributed.diagnostics.plugin import WorkerPlugin

        class JobFiles(WorkerPlugin):  # type: ignore[misc]
            """Sends every worker, also a later one, the job's files before its first task."""

            name = f"twin-{job.name}"
            idempotent = True

            def setup(self, worker: Any) -> None:
                _unpack_on_worker(job)

        with _connected(scheduler) as client:
            client.register_plugin(JobFiles())
            waiting = deque(numbers)
            given: dict[str, int] = {}
            ahead = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))

            def hand_out() -> Any:
                number = waiting.popleft()
                future = client.submit(_task_on_worker, job.name, job.work, number, pure=False)
                given[future.key] = number
                return future

            pool = as_completed([hand_out() for _ in range(min(ahead, len(waiting)))])
            for future in pool:
                done = _outcome(given.pop(future.key), future)
                future.release()
                if waiting:
                    pool.add(hand_out())
                yield done


def _can_be_copied() -> bool:
    """Return whether this process can be copied: a copy would wait for Dr.Jit's threads for
    ever."""
    return FORKS and "drjit" not in sys.modules


def _serve(pipe: Any, inherited: Sequence[Any]) -> None:
    """Compute tasks in a process that ends with its parent: a copy has ``inherited`` its pipes and
    holds its lock of the folder."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for other in inherited:
        other.close()
    with suppress(EOFError, OSError):
        while True:
            work, folder, number = pipe.recv()
            pipe.send(_tried(_work_of(work), folder, number))


class _TooLong(Exception):
    """A first task takes so long that workers are to compute it."""


_limit_s = [math.inf]
"""CPU time at which the task that runs in this process is given up."""


@contextmanager
def _limited(end_s: float) -> Iterator[None]:
    _limit_s[0] = end_s
    try:
        yield
    finally:
        _limit_s[0] = math.inf


def _work_of(place: str) -> Work:
    module, name = place.split(":")
    function: Work = getattr(importlib.import_module(module), name)
    return function


_unpacked: dict[str, tuple[ExitStack, Path]] = {}
"""The job that this worker process has unpacked last, by its name."""


def _task_on_worker(name: str, work: str, number: int) -> Job.Done:
    """Compute a task of an unpacked job on a dask worker."""
    if name not in _unpacked:
        raise RuntimeError("this worker has not received the job's files")
    return _tried(_work_of(work), _unpacked[name][1], number)


def _tried(function: Work, folder: Path, number: int) -> Job.Done:
    try:
        return Job.Done(number, function(folder, number))
    except Exception as problem:  # whatever it is, the other tasks go on
        return Job.Done(number, problem=f"{type(problem).__name__}: {problem}")


def _unpack_on_worker(job: Job) -> None:
    """Unpack a job in a worker process, which uses one numeric thread from then on."""
    if job.name in _unpacked:
        return
    for stack, _ in _unpacked.values():
        stack.close()
    _unpacked.clear()
    stack = ExitStack()
    stack.enter_context(one_thread())
    _unpacked[job.name] = (stack, stack.enter_context(job.unpacked()))


def _connected(scheduler: Pool.Scheduler) -> Any:
    """Return a client of a scheduler; `InputError` where that fails."""
    from distributed import Client
    from distributed.security import Security

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        security = None
        if scheduler.key is not None:
            security = Security(
                require_encryption=True,
                tls_ca_file=str(scheduler.ca),
                tls_client_cert=str(scheduler.cert),
                tls_client_key=str(scheduler.key),
            )
        # the workers may not be reachable from here, so results travel through the scheduler
        return Client(
            scheduler.address, timeout=PATIENCE_S, direct_to_workers=False, security=security
        )
    except (OSError, TimeoutError, ValueError, MemoryError) as problem:  # memory: another protocol
        raise InputError(
            f"--scheduler {scheduler.address}: no dask scheduler replies there "
            f"({type(problem).__name__}); start one with dask scheduler, or leave the option out "
            "to work on this machine"
        ) from None


def _outcome(number: int, future: Any) -> Job.Done:
    """Return the outcome of a task, also of one that was lost."""
    problem = future.exception()
    if problem is None:
        done: Job.Done = future.result()
        return done
    text = f"{type(problem).__name__}: {problem}"
    if type(problem).__name__ == "KilledWorker":
        text = f"task {number}: {DIED}"
    return Job.Done(number, problem=text)


@contextmanager
def only_writer(folder: Path, lock: Path) -> Iterator[None]:
    """Make a folder and be its only writer, by the operating system's lock on the empty file
    ``lock``, which ends with its owner; remove what a killed writer left, and the folders made
    here if they stay empty. `InputError` where another process is writing or the folder can't be
    written."""
    made = [each for each in (lock.parent, folder) if not each.exists()]
    make_folder(folder)
    make_folder(lock.parent)
    handle = _locked(lock)
    try:
        for stale in folder.rglob(".*.part"):
            stale.unlink(missing_ok=True)
        yield
    finally:
        with suppress(OSError):  # Windows removes no open file
            lock.unlink()
        os.close(handle)
        with suppress(OSError):  # not empty
            for each in made:
                each.rmdir()


def _locked(path: Path) -> int:
    """Return the locked file; one that its holder has just removed is made again."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except OSError as problem:
            raise TwinError.unwritable(path, problem) from None
        try:
            _lock(handle)
        except OSError:
            os.close(handle)
            raise InputError(
                f"{path.parent}: another process is writing here; wait for it, stop it, or give "
                "another --out"
            ) from None
        with suppress(OSError):
            if os.path.samestat(os.fstat(handle), os.lstat(path)):
                return handle
        os.close(handle)


def _lock(handle: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def counted(number: int, thing: str) -> str:
    """Return a number of things in words."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


PACKAGES = ("numpy", "scipy", "numba", "mitsuba", "drjit", "pyarrow", "deflate")

PACKAGE = Path(__file__).resolve().parents[2]

COUNTED = ("arrays.py", "files.py", "geometry", "parts", "theory", "world", "study")
"""Sources on which the numbers depend."""


def versions() -> dict[str, str]:
    """Return what the bytes depend on: packages, Python, and a hash of this program's sources."""
    found = {name: importlib.metadata.version(name) for name in PACKAGES}
    sha = hashlib.sha256()
    for name in COUNTED:
        path = PACKAGE / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            sha.update(file.relative_to(PACKAGE).as_posix().encode())
            sha.update(file.read_bytes())
    python = ".".join(platform.python_version_tuple()[:2])
    return {**found, "python": python, "twin": sha.hexdigest()[:16], "machine": platform.machine()}
