"""Many processes: the same bytes from any number of workers, from a cluster of strangers, and when one is killed."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_dataset import contents, make

import twin
from twin.errors import InputError, MissingCapability
from twin.study.dataset.work import ShardBytes

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parent.parent)}


def test_a_scheduler_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from twin.study.batch import cluster

    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    with pytest.raises(InputError, match="no dask scheduler answers there"):
        make(tmp_path / "d", 2, scheduler="tcp://127.0.0.1:1")
    assert not (tmp_path / "d").exists(), "nothing is left of what was never begun"


def test_several_workers_need_a_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    from twin.study.batch import cluster

    monkeypatch.setattr(cluster, "HERE", "192.0.2.1")  # an address for documentation: no machine's own
    with pytest.raises(MissingCapability, match="--workers 1"), cluster.workers_here(2):
        pass


@pytest.mark.parametrize(
    ("problem", "said"),
    [(RuntimeError("Nanny failed to start."), "Nanny failed"), (OSError(11, "no processes left"), "no processes left")],
)
def test_workers_that_can_not_be_started_are_told_with_the_cause(
    problem: Exception, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import distributed

    from twin.study.batch import cluster

    def failing(**options: object) -> None:
        raise RuntimeError("Nanny failed to start.") from problem

    monkeypatch.setattr(distributed, "LocalCluster", failing)
    with pytest.raises(MissingCapability, match=f"2 worker processes .*{said}.*--workers 1"), cluster.workers_here(2):
        pass


@pytest.mark.slow
def test_two_local_workers_make_the_same_bytes_as_one(tmp_path: Path) -> None:
    make(tmp_path / "one", 8)
    make(tmp_path / "two", 8, workers=2)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


@pytest.mark.slow
def test_a_cluster_without_common_files_survives_a_killed_worker(tmp_path: Path) -> None:
    """Two workers with caches of their own, of which one is killed after the first shard."""
    make(tmp_path / "one", 16)
    address = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    running = [subprocess.Popen([*dask, "--no-dashboard", "--scheduler-file", str(address)], env=ENVIRONMENT)]
    try:
        for _ in range(600):
            if address.is_file():
                break
            time.sleep(0.1)
        for name in ("a", "b"):
            worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address)]
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
        done = make(tmp_path / "many", 16, scheduler=wanted, progress=kill)
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
