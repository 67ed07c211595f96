"""Many processes: the same bytes from any number of workers, from a cluster of strangers, and when one is killed."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import psutil
import pytest
from distributed.security import Security
from small_dataset import contents, make

import twin
from twin.errors import InputError, MissingCapability
from twin.study.batch import pool
from twin.study.batch.pool import Job, Pool

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parent.parent)}


def test_a_scheduler_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "PATIENCE_S", 0.5)
    with pytest.raises(InputError, match="no dask scheduler replies there"):
        make(tmp_path / "d", 2, scheduler=Pool.Scheduler(address="tcp://127.0.0.1:1"))
    assert not (tmp_path / "d").exists(), "nothing is left of what was never begun"


def test_processes_that_can_not_be_started_are_told_with_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(process: object) -> None:
        raise OSError(11, "no processes left")

    monkeypatch.setattr(pool, "START_S", 0.0)
    monkeypatch.setattr(pool, "FORKS", False)
    monkeypatch.setattr(multiprocessing.get_context("spawn").Process, "start", failing)
    with pytest.raises(MissingCapability, match=r"worker processes .*no processes left.*--workers 1"):
        list(ran(Job(files={}, work=f"{__name__}:own_number"), range(4)))


def test_workers_start_only_where_the_job_takes_longer_than_their_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "FORKS", False)
    job = Job(files={}, work=f"{__name__}:own_number")
    assert {done.result for done in ran(job, range(4))} == {os.getpid()}


@pytest.mark.parametrize("forks", [pytest.param(False, marks=pytest.mark.slow), True])
def test_two_local_workers_make_the_same_bytes_as_one(forks, tmp_path, monkeypatch):
    """Copies of this process, and new ones; none opens a port."""
    monkeypatch.setattr(pool, "FORKS", forks)
    monkeypatch.setattr(pool, "START_S", 0.0)
    monkeypatch.setattr(pool, "COPY_S", 0.0)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)  # loaded by other tests, and not needed here
    make(tmp_path / "one", 8)
    make(tmp_path / "two", 8, workers=2)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    processes: set[int] = set()
    with Pool(2) as two:
        for _ in range(2):
            processes |= {done.result for done in two.run(Job(files={}, work=f"{__name__}:own_number"), range(8))}
        mine = listening(os.getpid())  # of other tests: copies inherit them
        assert all(listening(number) <= mine for number in processes)
    assert len(processes - {os.getpid()}) == 2


def listening(process: int) -> set[int]:
    ports = psutil.Process(process).net_connections("inet")
    return {port.laddr.port for port in ports if port.status == psutil.CONN_LISTEN}


def own_number(folder: Path, number: int) -> int:
    time.sleep(0.02)
    return os.getpid()


def only_some_return(folder: Path, number: int) -> int:
    once = folder / "killed"
    if multiprocessing.parent_process() is not None and (number == 3 or (number == 4 and not once.exists())):
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 5:
        raise ValueError("five")
    return 10 * number


def ran(job: Job, numbers: Iterable[int]) -> Iterator[Job.Done]:
    with Pool(2) as both:
        yield from both.run(job, numbers)


@pytest.mark.parametrize("forks", [pytest.param(False, marks=pytest.mark.slow), True])
def test_what_a_killed_process_leaves_is_done_by_others(forks: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of task 3 every process dies, of task 4 the first; another job is not given replies to one that was left."""
    monkeypatch.setattr(pool, "FORKS", forks)
    monkeypatch.setattr(pool, "START_S", 0.0)
    monkeypatch.setattr(pool, "COPY_S", 0.0)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    job = Job(files={}, work=f"{__name__}:only_some_return")
    done = {one.number: one for one in ran(job, [0, 3, 4, 5, *range(6, 12)])}
    assert sorted(done) == [0, *range(3, 12)]
    assert done[3].problem == "task 3: its worker died 3 times (out of memory?); run again to repeat it"
    assert done[5].problem == "ValueError: five"
    assert all(done[number].result == 10 * number for number in {*done} - {3, 5})
    with Pool(2) as both:
        left = both.run(job, range(6, 12))
        _ = next(left), next(left)  # the first is computed here
        left.close()
        assert sorted(one.number for one in both.run(job, range(20, 24))) == [*range(20, 24)]


@pytest.mark.slow
def test_a_cluster_without_common_files_survives_a_killed_worker(tmp_path: Path) -> None:
    """Two workers with caches of their own, of which one is killed after the first shard; all talk over TLS."""
    make(tmp_path / "one", 16)
    address = tmp_path / "scheduler.json"
    secret = Security.temporary()
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    cert.write_text(secret.tls_client_cert)
    key.write_text(secret.tls_client_key)
    tls = ["--tls-ca-file", str(cert), "--tls-cert", str(cert), "--tls-key", str(key)]
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "tls://127.0.0.1", "--port", "0", *tls]
    running = [subprocess.Popen([*dask, "--no-dashboard", "--scheduler-file", str(address)], env=ENVIRONMENT)]
    try:
        for _ in range(600):
            if address.is_file():
                break
            time.sleep(0.1)
        for name in ("a", "b"):
            worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address), *tls]
            own = {**ENVIRONMENT, "TWIN_CACHE": str(tmp_path / f"cache_{name}")}
            options = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path / name)]
            running.append(subprocess.Popen([*worker, *options], env=own))
        killed = []

        def kill(what: str, share: float) -> None:
            if not killed and share >= 2 / 16 and "samples," in what:
                killed.append(running[1].pid)
                running[1].send_signal(signal.SIGKILL)

        import json

        wanted = json.loads(address.read_text())["address"]
        scheduler = Pool.Scheduler(address=wanted, ca=cert, cert=cert, key=key)
        done = make(tmp_path / "many", 16, scheduler=scheduler, progress=kill)
    finally:
        for process in running[::-1]:
            process.kill()
            process.wait()
    assert killed
    assert not done.missing
    assert contents(tmp_path / "many") == contents(tmp_path / "one")
