"""Many processes: the same bytes from any number of workers, from a cluster of strangers, and when one is killed."""

import http.client
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from distributed.security import Security
from small_dataset import contents, make

import twin
from twin.errors import InputError, MissingCapability
from twin.study.batch import pool
from twin.study.batch.pool import Job, Pool
from twin.study.dataset.sample import ShardBytes

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parent.parent)}


def test_a_scheduler_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "PATIENCE_S", 0.5)
    with pytest.raises(InputError, match="no dask scheduler replies there"):
        make(tmp_path / "d", 2, scheduler=Pool.Scheduler(address="tcp://127.0.0.1:1"))
    assert not (tmp_path / "d").exists(), "nothing is left of what was never begun"


def test_tls_files_are_given_together_and_exist(tmp_path, says):
    there = tmp_path / "there.pem"
    there.write_text("")
    for options, words in (
        (["--scheduler", "tls://here:1"], "needs --tls-ca, --tls-cert, --tls-key"),
        (["--scheduler", "tls://here:1", "--tls-ca", str(there)], "needs --tls-cert, --tls-key"),
        (["--scheduler", "tcp://here:1", "--tls-ca", str(there)], "must start with tls://"),
        (["--scheduler", "tls://here:1", "--tls-key", "none.pem"], "--tls-key none.pem: there is no such file"),
        (["--tls-ca", str(there)], "belong to --scheduler"),
    ):
        assert words in says(2, "dataset", "dataset_kamiyama", "--samples", "2", "--out", str(tmp_path / "d"), *options)


STRANGER = """
import os, sys
from distributed import Client
from distributed.security import Security

if os.getuid() == 0:  # another account of this machine
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
host = sys.argv[1].split("://")[1]
for address, security in ((f"tcp://{host}", None), (f"tls://{host}", Security.temporary())):
    try:
        with Client(address, timeout=1.5, security=security) as client:
            print("ran as", client.submit(os.getuid).result(5))
    except (OSError, TimeoutError):
        print("refused")
"""


@pytest.mark.slow
def test_no_other_account_runs_code_by_the_workers_of_this_machine() -> None:
    """A stranger without this cluster's key is refused, every port is this machine's own, and none serves a page."""
    import psutil
    from distributed import Client

    with Pool.workers_here(1) as cluster:
        told = subprocess.run(
            [sys.executable, "-c", STRANGER, cluster.scheduler_address], capture_output=True, text=True, timeout=60
        )
        assert told.stdout.split() == ["refused", "refused"], told.stdout + told.stderr
        ours = psutil.Process()
        listening = {
            place.laddr
            for process in (ours, *ours.children(recursive=True))
            for place in process.net_connections("inet")
            if place.status == psutil.CONN_LISTEN
        }
        assert {place.ip for place in listening} == {"127.0.0.1"}
        with Client(cluster, timeout=20) as client:
            assert client.submit(os.getuid).result(30) == os.getuid()
        for place in listening:
            with pytest.raises((OSError, http.client.HTTPException)):
                urllib.request.urlopen(f"http://127.0.0.1:{place.port}/info/main/workers.html", timeout=2)


def test_several_workers_need_a_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "LOOPBACK", "192.0.2.1")  # an address for documentation: no machine's own
    with pytest.raises(MissingCapability, match="--workers 1"), Pool.workers_here(2):
        pass


@pytest.mark.parametrize(
    ("problem", "said"),
    [(RuntimeError("Nanny failed to start."), "Nanny failed"), (OSError(11, "no processes left"), "no processes left")],
)
def test_workers_that_can_not_be_started_are_told_with_the_cause(problem, said, monkeypatch):
    import distributed

    def failing(**options: object) -> None:
        raise RuntimeError("Nanny failed to start.") from problem

    monkeypatch.setattr(distributed, "LocalCluster", failing)
    with pytest.raises(MissingCapability, match=f"2 worker processes .*{said}.*--workers 1"), Pool.workers_here(2):
        pass


def test_workers_start_only_where_the_job_takes_longer_than_their_start(tmp_path, monkeypatch):
    started: list[int] = []

    def refused(count: int) -> None:
        started.append(count)
        raise MissingCapability("started")

    monkeypatch.setattr(Pool, "workers_here", staticmethod(refused))
    monkeypatch.setattr(pool, "FORKS", False)
    assert make(tmp_path / "small", 4, workers=2).made == 4
    monkeypatch.setattr(pool, "START_S", 0.0)
    with pytest.raises(MissingCapability, match="started"):
        make(tmp_path / "large", 4, workers=2)
    assert started == [2]


@pytest.mark.parametrize("forks", [pytest.param(False, marks=pytest.mark.slow), True])
def test_two_local_workers_make_the_same_bytes_as_one(forks, tmp_path, monkeypatch):
    """Copies of this process, which work here alone, and dask's."""
    processes: set[int] = set()
    monkeypatch.setattr(pool, "FORKS", forks)
    monkeypatch.setattr(pool, "START_S", 0.0)
    monkeypatch.setattr(pool, "COPY_S", 0.0)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)  # loaded by other tests, and not needed here
    make(tmp_path / "one", 8)
    make(tmp_path / "two", 8, workers=2)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    if forks:
        with Pool(2) as copies:
            for _ in range(2):
                processes |= {
                    done.result for done in copies.run(Job(files={}, work=f"{__name__}:own_number"), range(8))
                }
        assert len(processes - {os.getpid()}) == 2


def own_number(folder: Path, number: int) -> int:
    time.sleep(0.02)
    return os.getpid()


def only_some_return(folder: Path, number: int) -> int:
    if number == 3 and multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 5:
        raise ValueError("five")
    return 10 * number


def ran(job: Job, numbers: Iterable[int]) -> Iterator[Job.Done]:
    with Pool(2) as both:
        yield from both.run(job, numbers)


def test_what_a_killed_copy_leaves_is_done_by_others(monkeypatch: pytest.MonkeyPatch) -> None:
    left: list[int] = []

    def others(job: Job, numbers: Iterable[int], cluster: object) -> Iterator[Job.Done]:
        left.extend(numbers)
        yield from [Job.Done(number, "others") for number in left]

    monkeypatch.setattr(pool, "FORKS", True)
    monkeypatch.setattr(pool, "COPY_S", 0.0)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(Pool, "workers_here", staticmethod(nullcontext))
    monkeypatch.setattr(Pool, "tasks_on_cluster", staticmethod(others))
    job = Job(files={}, work=f"{__name__}:only_some_return")
    done = {one.number: one for one in ran(job, range(20))}
    assert sorted(done) == [*range(20)]
    assert 3 in left
    assert len(left) < 20
    assert all(done[number].result == ("others" if number in left else 10 * number) for number in {*done} - {5})
    left.clear()
    done = {one.number: one for one in ran(job, [4, 5, 6])}
    assert done[5].problem == "ValueError: five"
    assert (done[4].result, done[6].result) == (40, 60)


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


def test_a_shard_travels_whole_by_every_protocol_of_pickle() -> None:
    shard = ShardBytes(samples=b"samples", sensors=None, failed=1, reason="why")
    apart: list[pickle.PickleBuffer] = []
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        assert pickle.loads(pickle.dumps(shard, protocol)) == shard
    held = pickle.dumps(shard, 5, buffer_callback=apart.append)
    assert b"samples" not in held.replace(b"ShardBytes", b"")
    there = pickle.loads(held, buffers=[memoryview(each) for each in apart])
    assert pickle.loads(pickle.dumps(there, 4)) == shard
    assert bytes(there.samples) == b"samples"
