"""Does it last? ``python -m benchmarks endurance [--minutes 60]``: mixed work in one process, watched for growth.

Presses, pictures, tracking, force fields, broken recipes and damaged files follow each other; after every round memory,
threads, open files and child processes are read. The first `WARM` of the rounds fill caches and compile; from then on
all must stay flat. The result is stored in benchmarks/results/endurance.json; exit code 1 if something grew.
"""

import os
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.fuzz_files import SMALL
from benchmarks.random_scenes import said
from benchmarks.record import Row, store, table

WARM = 0.3
"""Share of the rounds that may still grow."""

GROWTH = {"memory_mb": 60.0, "threads": 0, "files": 0, "children": 0}
"""Largest growth of the median of the last tenth over that of the tenth after the warm rounds."""


def state() -> dict[str, float]:
    """Return this process's resident memory in MB, threads, open files and child processes."""
    memory = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    counts = threading.active_count(), len(os.listdir("/proc/self/fd")), len(children)
    return dict(zip(GROWTH, (memory, *map(float, counts)), strict=True))


def jobs(folder: Path) -> dict[str, Callable[[int], None]]:
    """Return the jobs of a round by name; each takes the round's number and leaves nothing but what it overwrites."""
    import twin

    sensor = twin.Sensor(twin.load_scene("kamiyama_pillar", SMALL))
    scene = folder / "small.toml"
    scene.write_text(sensor.nominal.to_toml())
    calibration, out = folder / "flat.npz", folder / "out"

    def press(number: int) -> None:
        width, x, y = np.random.default_rng(number).uniform((3, -3, -2), (8, 3, 2)).tolist()
        ball = twin.Sphere(diameter_mm=width)
        press = twin.Press(probe=ball, at_mm=(x, y), force_n=(0, 0, 0.4), friction=0.5 * (number % 2))
        assert sensor.picture(sensor.press(press).load, number).shape == (120, 160, 3)

    def chain(number: int) -> None:
        _must(0, ["run", str(scene), "--out", str(out), "-s", f"seed={number + 1}"])

    def calibrate(number: int) -> None:
        if number % 10 == 0:
            _must(0, ["calibrate", "--scene", str(scene), "--out", str(calibration)])

    def reconstruct(_: int) -> None:
        files = [str(out / "rest.png"), str(out / "pressed.png")]
        _must(0, ["reconstruct", *files, "--calibration", str(calibration), "--out", str(folder / "forces.csv")])

    def refuse(number: int) -> None:
        _must(2, ["run", str(scene), "-s", f"no_such_key={number}"])
        (folder / "cut.png").write_bytes((out / "rest.png").read_bytes()[: 100 + number % 500])
        _must(2, ["reconstruct", str(folder / "cut.png"), str(out / "pressed.png"), "--calibration", str(calibration)])

    return {"press": press, "chain": chain, "calibrate": calibrate, "reconstruct": reconstruct, "refuse": refuse}


def _must(code: int, arguments: list[str]) -> None:
    found, told = said(arguments)
    if found != code:
        raise AssertionError(f"{arguments[0]} ended with {found}, not {code}: {told[-300:]}")


def rounds(folder: Path, minutes: float, least: int = 20) -> Iterator[dict[str, float]]:
    """Work for so many minutes, and at least so many rounds; yield the process's state after every round."""
    todo, started, number = jobs(folder), time.monotonic(), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while number < least or time.monotonic() - started < 60 * minutes:
            for job in todo.values():
                job(number)
            number += 1
            yield state()


def grown(states: list[dict[str, float]]) -> dict[str, tuple[float, float]]:
    """Return medians of the first tenth after the warm rounds and of the last tenth, by name."""
    steady = states[int(WARM * len(states)) :]
    some = max(1, len(steady) // 10)
    return {name: tuple(median(s[name] for s in part) for part in (steady[:some], steady[-some:])) for name in GROWTH}


def problems(states: list[dict[str, float]]) -> list[str]:
    """Return what grew by more than it may."""
    sizes = {name: (first, last) for name, (first, last) in grown(states).items() if last - first > GROWTH[name]}
    return [f"{name} grew from {first:g} to {last:g}" for name, (first, last) in sizes.items()]


def measure(*, minutes: float = 60.0) -> int:
    """Work, print what became of the process and store it; exit code 1 if something grew.

    Parameters
    ----------
    minutes
        A run of less than an hour is not stored.
    """
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        states = list(rounds(Path(folder), minutes))
    rows: list[Row] = [
        {"what": name, "after warming up": first, "at the end": last, "largest": max(s[name] for s in states)}
        for name, (first, last) in grown(states).items()
    ]
    took = (time.monotonic() - started) / 60
    print(f"{table(rows)}\n\n{len(states)} rounds in {took:.3g} minutes")
    found = problems(states)
    for line in found:
        print(line, file=sys.stderr)
    if not found and took >= 60:
        store("endurance", rows, minutes=took, rounds=len(states))
    return int(bool(found))
