"""Damaged and hostile files, given to every reader: ``python -m benchmarks fuzz [--rounds N] [--reader NAME]``.

A reader is a command that takes a file of a kind. Each gets a whole file (which must be taken), the same file damaged
in ways that suit any file (`benchmarks.fuzz_files`), and files that are hostile for its kind: lying headers, bombs,
NaN, pickles, paths out of the folder, links. Every attempt is a child process of its own in an empty folder, with
bounded memory and time. What must hold:

* exit code 0 to 4, no traceback, no internal error, no signal;
* at most 10 s of CPU to refuse (60 s to accept: a body may be meshed) and 1 GB more memory than the program itself;
* nothing written, changed or removed outside the child's folder, and nothing executed.

The table is stored in benchmarks/results/fuzz.json; exit code 1 if anything failed.
"""

import faulthandler
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.fuzz_files import READERS, Reader, damaged, make_whole_files
from benchmarks.record import RESULTS, Natural, machine, table

STORED = RESULTS / "fuzz.json"
REFUSE_CPU_S, ACCEPT_CPU_S, WALL_S = 10, 60, 120
MEMORY_BYTES = 1_000_000_000
MISSING = 4
"""The exit code of a command whose extra package is not installed: not the reader's fault."""
WARM = (
    "numpy", "scipy.optimize", "scipy.sparse.linalg", "scipy.ndimage", "pyarrow.parquet", "PIL.Image", "yaml",
    "twin.cli", "twin.sense.reconstruct", "twin.sense.track", "twin.study.check", "twin.study.recorded",
    "twin.study.dataset.audit", "twin.study.dataset.export", "twin.study.dataset.create", "twin.study.dataset.reader",
    "twin.study.sweep.sweep_run",
    "twin.study.calibrate", "twin.world.elasticity.compliance", "twin.world.contact.pressing",
    "twin.study.reproduce.reproduction_run",
)  # fmt: skip
"""Loaded once, before children are forked, so that none of them counts it."""


@dataclass
class Attempt:
    """What became of one child."""

    code: int
    cpu_s: float
    memory_mb: float
    told: str
    wrong: str = ""


@dataclass
class Found:
    """What became of all attempts of a reader."""

    attempts: int = 0
    codes: dict[str, int] = field(default_factory=dict)
    slowest_s: float = 0.0
    largest_mb: float = 0.0
    failed: list[str] = field(default_factory=list)

    def add(self, name: str, one: Attempt) -> None:
        """Count an attempt."""
        self.attempts += 1
        self.codes[str(one.code)] = self.codes.get(str(one.code), 0) + 1
        self.slowest_s, self.largest_mb = max(self.slowest_s, one.cpu_s), max(self.largest_mb, one.memory_mb)
        if one.wrong:
            self.failed.append(f"{name}: {one.wrong}: {one.told[-300:]}")


def warm() -> None:
    """Load what children use, so that none counts it."""
    import importlib

    for name in WARM:
        importlib.import_module(name)


def attempt(reader: Reader, box: Path) -> Attempt:
    """Run a reader in a child whose folder is ``box/inside``; ``box/outside`` must stay as it is."""
    before = _listing(box / "outside")
    told, started = box / "told", time.monotonic()
    child = os.fork()
    if child == 0:
        _as_child(reader, box / "inside", told)
    code, usage, hung = _wait(child, started)
    one = Attempt(code=code, cpu_s=usage.ru_utime + usage.ru_stime, memory_mb=usage.ru_maxrss / 1024,
                  told=told.read_text(errors="replace") if told.is_file() else "")  # fmt: skip
    strange = sorted(path.name for path in box.iterdir() if path.name not in ("inside", "outside", "told"))
    if hung or one.cpu_s > (REFUSE_CPU_S if code else ACCEPT_CPU_S):
        one.wrong = f"took {one.cpu_s:.1f} s of CPU"
    elif code < 0 or code > 4:
        one.wrong = f"ended with code {code}"
    elif "internal error" in one.told or "Traceback" in one.told:
        one.wrong = "an internal error"
    elif code and not one.told.strip():
        one.wrong = f"code {code} and no word"
    elif _listing(box / "outside") != before or strange:
        one.wrong = f"something outside was written, changed or removed {strange}"
    return one


def _wait(child: int, started: float) -> tuple[int, resource.struct_rusage, bool]:
    hung = False
    while True:
        done, status, usage = os.wait4(child, 0 if hung else os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage, hung
        if time.monotonic() - started > WALL_S:
            hung = True
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)


def _as_child(reader: Reader, inside: Path, told: Path) -> None:
    """Run the reader's command with bounded memory and time; never returns."""
    from twin.cli import main

    code = 99
    faulthandler.disable()  # what ends a child is told by its parent
    try:
        os.chdir(inside)
        sys.stderr.flush()
        sys.stdout.flush()
        with open(told, "wb") as words:
            os.dup2(words.fileno(), 2)
        nothing = os.open(reader.stdin if reader.stdin else os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        # whatever the parent has put in their place
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CPU, (2 * ACCEPT_CPU_S, 2 * ACCEPT_CPU_S + 1))
        main(list(reader.command))
    except SystemExit as done:
        code = int(done.code or 0)
    except BaseException as problem:
        os.write(2, f"Traceback: {type(problem).__name__}: {problem}".encode())
    finally:
        sys.stderr.flush()
        os._exit(code)


def _listing(folder: Path) -> dict[str, tuple[int, int, int]]:
    found = {}
    for path in sorted(folder.rglob("*")):
        facts = path.lstat()
        found[str(path.relative_to(folder))] = (facts.st_size, facts.st_mtime_ns, facts.st_mode)
    return found


def cases(reader: Reader, whole: Path, rounds: int) -> Iterator[tuple[str, Any]]:
    """Yield the names of a reader's attempts, each with a function that spoils a fresh copy of the whole files."""
    yield "whole", lambda inside: None
    for name, spoil in reader.hostile.items():
        yield name, spoil
    for target in reader.targets:
        data = (whole / reader.name / target).read_bytes()
        for name, spoilt in damaged(data, rounds, seed=len(reader.name)):
            yield f"{target} {name}", lambda inside, t=target, d=spoilt: (inside / t).write_bytes(d)


def survey(readers: dict[str, Reader], rounds: int, tell: Any = None) -> dict[str, Found]:
    """Attack every reader; return what became of it."""
    found: dict[str, Found] = {}
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        make_whole_files(whole, READERS)
        warm()
        for reader in readers.values():
            here = found[reader.name] = Found()
            for number, (name, spoil) in enumerate(cases(reader, whole, rounds)):
                here.add(name, _boxed(reader, whole, Path(folder) / f"{reader.name}-{number}", spoil, name))
            if tell:
                tell(reader.name, here)
    return found


def _boxed(reader: Reader, whole: Path, box: Path, spoil: Any, name: str) -> Attempt:
    import shutil

    shutil.copytree(whole / reader.name, box / "inside", symlinks=True)
    (box / "outside").mkdir()
    (box / "outside" / "precious").write_text("precious")
    (box / "outside" / ".precious.1.part").write_text("precious")
    try:
        spoil(box / "inside")
        one = attempt(reader, box)
        if name == "whole" and one.code not in (0, MISSING):
            one.wrong = f"the whole file is refused with code {one.code}"
        return one
    finally:
        shutil.rmtree(box)


def rows_of(found: dict[str, Found]) -> list[dict[str, Any]]:
    """Return one row a reader."""
    return [
        {
            "reader": name, "attempts": one.attempts,
            "exit codes": ", ".join(f"{code}: {n}" for code, n in sorted(one.codes.items())),
            "slowest, CPU s": one.slowest_s, "largest, MB": one.largest_mb, "failed": len(one.failed),
        }
        for name, one in found.items()
    ]  # fmt: skip


def measure(*, rounds: Natural = 40, reader: str = "", out: Path = STORED) -> int:
    """Attack the readers, print and store what became of them; exit code 1 if anything failed.

    Parameters
    ----------
    rounds
        Random damages of every file.
    reader
        One reader only; nothing is stored.
    out
        File that the table is stored in.
    """
    if reader and reader not in READERS:
        raise SystemExit(f"--reader {reader}: choose from {', '.join(sorted(READERS))}")
    if not out.parent.is_dir() or out.is_dir():
        raise SystemExit(f"--out {out}: name a file in a folder that is there")
    chosen = {k: v for k, v in READERS.items() if reader in ("", k)}

    def tell(name: str, one: Found) -> None:
        print(f"{name}: {one.attempts} attempts, {len(one.failed)} failed", file=sys.stderr)
        for line in one.failed:
            print("   ", line.replace("\n", " "), file=sys.stderr)

    found = survey(chosen, rounds, tell)
    print(table(rows_of(found)))
    bad = any(one.failed for one in found.values())
    if not reader and not bad:
        out.write_text(json.dumps({"machine": machine(), "rows": rows_of(found)}, indent=1) + "\n")
    return int(bad)
