"""Numbered tasks computed here, on all cores, or on a cluster: numbers in, results out, in any
order.

One worker runs in this process and imports no dask. Several are copies of this process where it can
be copied (Linux): they start at once, with all that this one has loaded. Elsewhere, after a copy
has died, and on clusters, workers are dask.distributed's, the only one of the engines tried that
finished when a worker was killed. A worker unpacks the job's files once, into a folder of its
own; no common file system is needed. A task that loses its worker is repeated by another; a task
whose workers die again and again is reported and left out. Results travel to this process, which
alone writes.

Why copies and not ``concurrent.futures``: its processes can't be killed at once before Python 3.14,
and Ctrl-C would wait for their tasks.

Peers unpickle what they receive, so the workers of this machine communicate over TLS with a key
that this process makes and keeps in memory (docs/dataset.md).
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import importlib.metadata
import logging
import math
import multiprocessing
import os
import platform
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from twin.blas_threads import one_thread
from twin.errors import InputError, MissingCapability
from twin.files import make_folder, temporary_folder

Work = Callable[[Path, int], Any]
"""Computes task number n of the job whose files are in a folder."""

AHEAD = 2
"""Batches of tasks per worker: the next is there when one is done, and memory stays flat."""

BATCH_S = 1.0
"""CPU seconds of tasks that are handed out together: handing out costs some 7 ms."""

START_S = 9.0
"""Seconds that two processes take to start and to load what this one has, on two cores: 6 where
they are idle, 9 and more with other work, which also makes tasks look longer."""

RETRIES = 3
"""Workers that a task may lose before it is given up."""

PATIENCE_S = 20
"""How long to wait for a scheduler."""

COPY_S = 1.0
"""CPU seconds of work from which on copies of this process pay: a second core gains as much, and
what they would load is loaded by then."""

FORKS = sys.platform == "linux"
"""Whether workers may be copies of this process: other systems' libraries don't bear it."""

_DIES_WITH_PARENT = 1
"""Linux's PR_SET_PDEATHSIG."""

LOOPBACK = "127.0.0.1"

_LOCAL_SETTINGS = {
    "distributed.scheduler.allowed-failures": RETRIES,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.tick.interval": "1s",
    "distributed.scheduler.active-memory-manager.start": False,
}
"""dask's settings for workers of this machine: no pages over HTTP, and no monitoring, which takes
half of dask's CPU time."""


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

    @contextmanager
    def unpacked(self) -> Iterator[Path]:
        """Write the files into a temporary folder."""
        with temporary_folder("twin-job") as folder:
            for path, data in self.files.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_bytes(data)
            yield folder


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
        self._cluster: Any = scheduler
        self._copies: list[Any] = []
        self._folders: dict[str, Path] = {}
        self._started = ExitStack()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *raised: object) -> None:
        self._started.close()

    def run(self, job: Job, numbers: Iterable[int]) -> Iterator[Job.Done]:
        """Compute tasks in the order of their numbers, and yield them as they finish; `InputError`
        where the scheduler can't be reached."""
        waiting = deque(numbers)
        if self._cluster is None and waiting:
            if job.name not in self._folders:
                self._folders[job.name] = self._started.enter_context(job.unpacked())
            yield from self._run_on_this_machine(job, waiting)
        if waiting:
            if self._cluster is None:
                workers = min(self._workers, len(waiting))
                self._cluster = self._started.enter_context(self.workers_here(workers))
            yield from self.tasks_on_cluster(job, waiting, self._cluster)

    @staticmethod
    def end_if_too_long() -> None:
        """Give up a first task here that takes long; tasks call it between their parts."""
        if time.process_time() > _limit_s[0]:
            raise _TooLong

    def _run_on_this_machine(self, job: Job, waiting: deque[int]) -> Iterator[Job.Done]:
        """Take tasks off the list and compute them in this process and its copies; the rest is for
        others."""
        if not self._copies:
            if _can_be_copied():
                yield from self._run_here(job, waiting, COPY_S)
            if waiting and _can_be_copied():
                count = min(self._workers, len(waiting))
                self._copies = self._started.enter_context(_copies(count))
            elif waiting:
                yield from self._run_here(job, waiting, START_S)
        yield from self._run_in_copies(job, waiting)

    def _run_in_copies(self, job: Job, waiting: deque[int]) -> Iterator[Job.Done]:
        """Take tasks off the list and compute them in copies; the rest, if one died, is for other
        workers."""
        idle, given = self._copies, dict[Any, int]()
        self._copies = []
        try:
            while given or (waiting and idle):
                while waiting and idle:
                    pipe = idle.pop()
                    given[pipe] = waiting.popleft()
                    pipe.send((job.work, self._folders[job.name], given[pipe]))
                ready: list[Any] = wait(given)
                for pipe in ready:
                    done: Job.Done = pipe.recv()
                    del given[pipe]
                    idle.append(pipe)
                    yield done
        except (EOFError, OSError):
            waiting.extendleft(sorted(given.values(), reverse=True))
        else:
            self._copies = idle

    def _run_here(self, job: Job, waiting: deque[int], start_s: float) -> Iterator[Job.Done]:
        """Take tasks off the list and compute them here until processes pay that take ``start_s``
        to start."""
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
    @contextmanager
    def workers_here(count: int) -> Iterator[Any]:
        """Start worker processes, which only peers with the key of this cluster reach, and stop
        them in the end; `MissingCapability` where 127.0.0.1 or room for them is missing."""
        import dask
        from distributed import LocalCluster
        from distributed.security import Security

        _check_loopback()
        _silence()
        with dask.config.set(_LOCAL_SETTINGS):
            try:
                started = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    security=Security.temporary(),
                    dashboard_address=f"{LOOPBACK}:0",
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                )
            except (OSError, RuntimeError, TimeoutError) as problem:
                raise MissingCapability(
                    f"{count} worker processes could not be started here ({_cause(problem)}): see "
                    "that there are enough processes, memory, open files and room for temporary "
                    "files, or take --workers 1"
                ) from None
            with started as cluster:
                yield cluster

    @staticmethod
    def tasks_on_cluster(job: Job, numbers: Iterable[int], cluster: Any) -> Iterator[Job.Done]:
        """Compute tasks on `workers_here`, or a scheduler's workers; yield them as they finish."""
        from distributed import as_completed
        from distributed.diagnostics.plugin import WorkerPlugin

        class JobFiles(WorkerPlugin):  # type: ignore[misc]
            """Sends every worker, also a later one, the job's files before its first task."""

            name = f"twin-{job.name}"
            idempotent = True

            def setup(self, worker: Any) -> None:
                _unpack_on_worker(job)

        with _connected(cluster) as client:
            client.register_plugin(JobFiles())
            waiting = deque(numbers)
            alone = deque[int]()
            given: dict[str, list[int]] = {}
            ahead = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))

            def hand_out(many: int) -> Any:
                batch = [alone.popleft()] if alone else [waiting.popleft() for _ in range(many)]
                key = f"{job.work}-{batch[0]}-{len(batch)}"
                given[key] = batch
                return client.submit(
                    _tasks_on_worker, job.name, job.work, batch, pure=False, key=key
                )

            pool = as_completed([hand_out(1) for _ in range(min(ahead, len(waiting)))])
            many = 1
            for future in pool:
                batch = given.pop(future.key)
                found, seconds = _outcome(batch, future)
                future.release()
                if seconds is None and len(batch) > 1:  # find out which task kills workers
                    alone.extend(batch)
                    found = []
                elif seconds is not None:
                    many = max(1, int(BATCH_S * len(batch) / max(seconds, 1e-6)))
                if alone or waiting:
                    pool.add(hand_out(min(many, -(-len(waiting) // ahead))))
                yield from found


def _can_be_copied() -> bool:
    """Return whether this process can be copied: a copy would wait for Dr.Jit's threads for
    ever."""
    return FORKS and "drjit" not in sys.modules


@contextmanager
def _copies(count: int) -> Iterator[list[Any]]:
    """Give pipes to ``count`` copies of this process, fewer where there is no room; stop them in
    the end."""
    context = multiprocessing.get_context("fork")
    processes = []
    pipes: list[Any] = []
    with one_thread(), suppress(OSError):
        while len(pipes) < count:
            ours, theirs = context.Pipe()
            pipes.append(ours)
            process = context.Process(target=_serve, args=(theirs, tuple(pipes)), daemon=True)
            process.start()
            processes.append(process)
            theirs.close()
    try:
        yield pipes[: len(processes)]
    finally:
        for process in processes:
            process.kill()
            process.join()
        for pipe in pipes:
            pipe.close()


def _serve(pipe: Any, others: Sequence[Any]) -> None:
    """Compute tasks in a copy, which ends with its process at once: it holds a copy of the folder's
    lock."""
    ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for other in others:
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


def _tasks_on_worker(name: str, work: str, numbers: Sequence[int]) -> tuple[list[Job.Done], float]:
    """Compute tasks of an unpacked job on a dask worker; return them and their CPU seconds."""
    if name not in _unpacked:
        raise RuntimeError("this worker has not received the job's files")
    function = _work_of(work)
    folder = _unpacked[name][1]
    started = time.process_time()
    return [_tried(function, folder, number) for number in numbers], time.process_time() - started


def _tried(function: Work, folder: Path, number: int) -> Job.Done:
    try:
        return Job.Done(number, function(folder, number))
    except Exception as problem:  # whatever it is, the other tasks go on
        return Job.Done(number, problem=f"{type(problem).__name__}: {problem}")


def _unpack_on_worker(job: Job) -> None:
    """Unpack a job in a worker process, which uses one numeric thread from here on."""
    if job.name in _unpacked:
        return
    for stack, _ in _unpacked.values():
        stack.close()
    _unpacked.clear()
    stack = ExitStack()
    stack.enter_context(one_thread())
    _unpacked[job.name] = (stack, stack.enter_context(job.unpacked()))


def _cause(problem: BaseException) -> str:
    """Return the operating system's message under an error, else the error's own."""
    under: BaseException | None = problem
    while under is not None and not isinstance(under, OSError):
        under = under.__cause__ or under.__context__
    return " ".join(str(under or problem).split()) or type(problem).__name__


def _check_loopback() -> None:
    """Refuse a machine whose loopback is down: dask would wait for its workers for minutes."""
    try:
        with (
            socket.create_server((LOOPBACK, 0)) as server,
            socket.create_connection(server.getsockname(), timeout=5),
        ):
            pass
    except OSError as problem:
        raise MissingCapability(
            f"several workers communicate over {LOOPBACK}, which can't be reached here "
            f"({problem.strerror or problem}): ip link set lo up, or --workers 1"
        ) from None


def _silence() -> None:
    logging.getLogger("distributed").setLevel(logging.CRITICAL)


def _connected(cluster: Any) -> Any:
    """Return a client of `Pool.workers_here` or of a scheduler; `InputError` where that fails."""
    from distributed import Client
    from distributed.security import Security

    _silence()
    if not isinstance(cluster, Pool.Scheduler):
        return Client(cluster, timeout=PATIENCE_S, direct_to_workers=True)
    try:
        security = None
        if cluster.key is not None:
            security = Security(
                require_encryption=True,
                tls_ca_file=str(cluster.ca),
                tls_client_cert=str(cluster.cert),
                tls_client_key=str(cluster.key),
            )
        # the workers may not be reachable from here, so results travel through the scheduler
        return Client(
            cluster.address, timeout=PATIENCE_S, direct_to_workers=False, security=security
        )
    except (OSError, TimeoutError, ValueError) as problem:
        raise InputError(
            f"--scheduler {cluster.address}: no dask scheduler replies there "
            f"({type(problem).__name__}); start one with dask scheduler, or leave the option out "
            "to work on this machine"
        ) from None


def _outcome(numbers: list[int], future: Any) -> tuple[list[Job.Done], float | None]:
    """Return the outcome of tasks, and their CPU seconds; None if they were lost."""
    problem = future.exception()
    if problem is None:
        found, seconds = future.result()
        return found, seconds
    if type(problem).__name__ == "KilledWorker":
        died = f"its worker died {RETRIES} times (out of memory?); run again to repeat it"
        return [Job.Done(number, problem=f"task {number}: {died}") for number in numbers], None
    text = f"{type(problem).__name__}: {problem}"
    return [Job.Done(number, problem=text) for number in numbers], None


@contextmanager
def only_writer(folder: Path, lock: Path) -> Iterator[None]:
    """Make a folder and be its only writer, by the operating system's lock on the empty file
    ``lock``, which ends with its owner; remove what a killed writer left. `InputError` where
    another process is writing or the folder can't be written."""
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


def _locked(path: Path) -> int:
    """Return the locked file; one that its holder has just removed is made again."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except OSError as problem:
            raise InputError(
                f"{path}: can't be written ({problem.strerror}); give another --out"
            ) from None
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
