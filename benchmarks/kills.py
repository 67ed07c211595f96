"""Killed at any moment: ``python -m benchmarks kills [--count 50]``.

Run, dataset, sweep and reproduce are started as processes of their own, killed after a random time (all of their group,
every third time by Ctrl-C's SIGINT, else by SIGKILL), and looked at: every file that is there must be whole. Then the
same command is given again until it ends, and what it leaves must be what an undisturbed command left: the same bytes
for samples, designs, pictures and arrays. Done in rounds, a dozen kills each, that are stored in
benchmarks/results/kills.json and taken up from there; exit code 1 if anything was lost or torn.
"""

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.fuzz_files import SMALL, SWEEP, VARY
from benchmarks.record import Count, machine, read, table, write

WALL_S, ROUND = 600, 12


@dataclass(frozen=True)
class Job:
    """A command, and which of the files it leaves (patterns) must be the same bytes however it was stopped."""

    command: tuple[str, ...]
    same: tuple[str, ...]


JOBS = {
    "run": Job(("run", "small.toml", "--out", "OUT"), ("*.png", "*.npz", "scene.toml")),
    "dataset": Job(
        ("dataset", "data.toml", "--samples", "4", "--out", "OUT", "--workers", "2"),
        ("data/*.parquet", "sensors/*.parquet"),
    ),
    "sweep": Job(("sweep", "sweep.toml", "--out", "OUT", "--workers", "1"), ("best/*.toml",)),
    "reproduce": Job(("reproduce", "kamiyama/fig-6", "--quick", "--out", "OUT"), ("results.json",)),
}


def prepare(folder: Path) -> None:
    """Write the recipes of the jobs."""
    import twin

    (folder / "small.toml").write_text(twin.load_scene("kamiyama_pillar", SMALL).to_toml())
    (folder / "data.toml").write_text(twin.load_scene("kamiyama_pillar", {**SMALL, **VARY}).to_toml())
    (folder / "sweep.toml").write_text(SWEEP.replace('"closed"]', '"closed", "linear"]'))


def start(folder: Path, job: Job, out: str) -> subprocess.Popen[bytes]:
    """Start a job's command in a session of its own."""
    command = [sys.executable, "-m", "twin", *(part.replace("OUT", out) for part in job.command)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with open(folder / f"{out}.told", "wb") as told:
        return subprocess.Popen(command, cwd=folder, env=environment, stdout=told, stderr=told, start_new_session=True)


def finished(folder: Path, job: Job, out: str) -> None:
    """Give a job's command and wait for its end."""
    code = start(folder, job, out).wait(timeout=WALL_S)
    if code:
        raise AssertionError(f"{job.command[0]} ended with {code}: {(folder / f'{out}.told').read_text()[-400:]}")


def kept(folder: Path, job: Job) -> dict[str, str]:
    """Return the digests of what must be the same."""
    found = [path for pattern in job.same for path in sorted(folder.glob(pattern))]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def torn(folder: Path) -> list[str]:
    """Return the files under their own names that can't be read whole."""
    import pyarrow.parquet as pq

    from twin.errors import TwinError
    from twin.files import read_arrays
    from twin.study.frames import read_picture

    readers: dict[str, Callable[[Path], object]] = {
        ".png": read_picture,
        ".npz": read_arrays,
        ".parquet": pq.read_table,
        ".json": lambda path: json.loads(path.read_text()),
        ".html": lambda path: path.read_text().rstrip().rindex("</html>", -7),
    }
    bad = []
    for path in sorted(p for p in folder.rglob("*") if p.suffix in readers and not p.name.startswith(".")):
        try:
            readers[path.suffix](path)
        except (OSError, ValueError, TwinError) as problem:
            bad.append(f"{path.name}: {problem}")
    return bad


def killed(names: list[str], count: int, seed: int = 1) -> list[dict[str, Any]]:
    """Kill each job in turn, ``count`` times in all; return a row a job. AssertionError: something was torn or lost."""
    chance = random.Random(seed)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        prepare(folder)
        for index, name in enumerate(names):
            job = JOBS[name]
            finished(folder, job, "warm")  # compiled code and caches
            started = time.monotonic()
            finished(folder, job, "whole")
            seconds = time.monotonic() - started
            wanted = kept(folder / "whole", job)
            if not wanted:
                raise AssertionError(f"{name} left nothing to compare")
            outcomes: Counter[str] = Counter()
            out = "killed"
            for number in range(index, count, len(names)):
                running = start(folder, job, out)
                time.sleep(chance.uniform(0.1, 1.0) * seconds)
                how = signal.SIGINT if number // len(names) % 3 == 2 else signal.SIGKILL
                os.killpg(running.pid, how) if running.poll() is None else None
                outcomes["ended before" if running.wait() == 0 else "killed"] += 1
                if bad := torn(folder / out):
                    raise AssertionError(f"{name}, killed: torn are {bad}")
                if chance.random() < 0.5:  # else it is killed again, on what the last one left
                    _compare(folder, job, out, wanted, name)
            _compare(folder, job, out, wanted, name)
            rows.append({"command": name, "seconds undisturbed": seconds, **outcomes, "lost or torn": 0})
            for each in ("warm", "whole"):
                shutil.rmtree(folder / each)
    return rows


def _compare(folder: Path, job: Job, out: str, wanted: dict[str, str], name: str) -> None:
    finished(folder, job, out)
    found = kept(folder / out, job)
    if found != wanted:
        differ = sorted(k for k in {*found, *wanted} if found.get(k) != wanted.get(k))
        raise AssertionError(f"{name}, killed and finished: other bytes in {differ}")
    if stale := [p.name for p in (folder / out).rglob(".*.part")]:
        raise AssertionError(f"{name}, finished: left {stale}")
    shutil.rmtree(folder / out)


def measure(*, count: Count = 50) -> int:
    """Kill so many jobs in all, print the rows and store them; exit code 1 if anything was lost or torn."""
    found: dict[str, Any] = {"rounds": 0, "rows": [], **read("kills")}
    while sum(row.get("killed", 0) for row in found["rows"]) < count:
        earlier = {row["command"]: row for row in found["rows"]}
        try:
            rows = killed(list(JOBS), ROUND, seed=found["rounds"] + 1)
        except AssertionError as problem:
            print(problem, file=sys.stderr)
            return 1
        for row in rows:  # counts in all, the seconds of the last round
            for key in ("killed", "ended before", "lost or torn"):
                row[key] = row.get(key, 0) + earlier.get(row["command"], {}).get(key, 0)
        found = {"rounds": found["rounds"] + 1, "machine": machine(), "rows": rows}
        write("kills", found)
    print(table(found["rows"]))
    return 0
