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
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fuzz_files import READERS, Reader, Spoil, damaged, make_whole_files, written
from benchmarks.record import RESULTS, Natural, Row, machine, table

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


def attempt(reader: Reader, box: Path) -> Attempt:
    """Run a reader in a child whose folder is ``box/inside``; ``box/outside`` must stay as it is."""
    before, told = _listing(box / "outside"), box / "told"
    child = os.fork()
    if child == 0:
        _as_child(reader, box / "inside", told)
    _, status, usage = os.wait4(child, 0)
    text = told.read_text(errors="replace") if told.is_file() else ""
    cpu_s, code = usage.ru_utime + usage.ru_stime, os.waitstatus_to_exitcode(status)
    one = Attempt(code=code, cpu_s=cpu_s, memory_mb=usage.ru_maxrss / 1024, told=text)
    strange = sorted(path.name for path in box.iterdir() if path.name not in ("inside", "outside", "told"))
    if one.cpu_s > (REFUSE_CPU_S if code else ACCEPT_CPU_S):
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


def _as_child(reader: Reader, inside: Path, told: Path) -> None:
    """Run the reader's command with bounded memory and time; never returns."""
    from twin.cli import main

    code = 99
    faulthandler.disable()  # what ends a child is told by its parent
    try:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(WALL_S)  # ends a child that waits for ever
        os.chdir(inside)
        sys.stderr.flush()
        sys.stdout.flush()
        with open(told, "wb") as words:
            os.dup2(words.fileno(), 2)
        os.dup2(os.open(reader.stdin or os.devnull, os.O_RDONLY), 0)
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


def _listing(folder: Path) -> list[tuple[str, int, int, int]]:
    facts = ((str(path.relative_to(folder)), path.lstat()) for path in sorted(folder.rglob("*")))
    return [(name, found.st_size, found.st_mtime_ns, found.st_mode) for name, found in facts]


def cases(reader: Reader, whole: Path, rounds: int) -> Iterator[tuple[str, Spoil]]:
    """Yield the names of a reader's attempts, each with a function that spoils a fresh copy of the whole files."""
    yield "whole", lambda inside: None
    yield from reader.hostile.items()
    for target in reader.targets:
        data = (whole / reader.name / target).read_bytes()
        for name, spoilt in damaged(data, rounds, seed=len(reader.name)):
            yield f"{target} {name}", written(target, spoilt)


def attacked(reader: Reader, whole: Path, folder: Path, rounds: int) -> tuple[Row, list[str]]:
    """Attack a reader in every way; return its row, and a line for each attempt that failed."""
    done: list[Attempt] = []
    failed = []
    for number, (name, spoil) in enumerate(cases(reader, whole, rounds)):
        box = folder / f"{reader.name}-{number}"
        shutil.copytree(whole / reader.name, box / "inside", symlinks=True)
        (box / "outside").mkdir()
        (box / "outside" / "precious").write_text("precious")
        (box / "outside" / ".precious.1.part").write_text("precious")
        try:
            spoil(box / "inside")
            one = attempt(reader, box)
        finally:
            shutil.rmtree(box)
        if name == "whole" and one.code not in (0, MISSING):
            one.wrong = f"the whole file is refused with code {one.code}"
        if one.wrong:
            failed.append(f"{name}: {one.wrong}: {one.told[-300:]}".replace("\n", " "))
        done.append(one)
    codes = Counter(str(one.code) for one in done)
    row = {
        "reader": reader.name, "attempts": len(done),
        "exit codes": ", ".join(f"{code}: {n}" for code, n in sorted(codes.items())),
        "slowest, CPU s": max(one.cpu_s for one in done), "largest, MB": max(one.memory_mb for one in done),
        "failed": len(failed),
    }  # fmt: skip
    return row, failed


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
    rows, bad = [], False
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        make_whole_files(whole, READERS)
        for name in WARM:
            importlib.import_module(name)
        for one in [READERS[reader]] if reader else READERS.values():
            row, failed = attacked(one, whole, Path(folder), rounds)
            print(f"{one.name}: {row['attempts']} attempts, {len(failed)} failed", file=sys.stderr)
            for line in failed:
                print("   ", line, file=sys.stderr)
            rows.append(row)
            bad |= bool(failed)
    print(table(rows))
    if not reader and not bad:
        out.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
    return int(bad)
