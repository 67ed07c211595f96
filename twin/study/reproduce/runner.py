"""Run entries into a folder: one file an entry, the list of all records, and the page.

Resuming: an entry's file carries a key, the hash of this package's source, the paper's resolved scene, the seed and the
form (quick or full). An entry whose file has the right key is not run again, so an interrupted reproduction goes on
where it was. A change of any source file runs everything anew: cheaper than a figure that the code no longer gives.

One thread: sums in another order change last digits, and the same seed shall give the same file whatever the number of
cores. On busy cores a second thread also cost several times the work (Fig. 10: 41 s of CPU with two, 5 with one).
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import twin
from twin.errors import TwinError
from twin.progress import Progress
from twin.results import make_folder, write_whole
from twin.study.batch.job import one_thread
from twin.study.recipe import load_scene
from twin.study.reproduce.bench import FITTED, SCENES, Bench, sensor_hash
from twin.study.reproduce.catalogue import ENTRIES, chosen
from twin.study.reproduce.entry import Entry

Table = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Reproduced:
    """What a reproduction left in its folder.

    Attributes
    ----------
    folder
        Where it lies.
    lines
        Summary for the terminal.
    failed
        Entries that could not be finished, with the reason.
    """

    folder: Path
    lines: Sequence[str]
    failed: dict[str, str]


def reproduce(
    names: Sequence[str] = (),
    out: Path = Path("reproduce"),
    *,
    seed: int = 1,
    quick: bool = False,
    progress: Progress | None = None,
) -> Reproduced:
    """Run the papers' experiments and write ``index.html``, ``results.json`` and a PNG for each.

    Parameters
    ----------
    names
        Entries (``kamiyama/table-1``), papers (``sato``) or ``all``, the default.
    out
        Folder; what it holds already and still stands is not run again.
    seed
        Root seed of sensors and noise.
    quick
        One made sensor, fewer steps and no long entries, for a first look.
    progress
        Told about every piece of work.

    Raises
    ------
    InputError
        There is no such entry, or the folder can't be written.
    """
    wanted = chosen(names, quick)
    make_folder(out)
    bench = Bench(seed=seed, quick=quick, progress=progress)
    with one_thread():
        failed = _run_all(out, wanted, bench)
    _publish(out, seed, quick, failed)
    if progress is not None:
        progress("done", 1.0)
    return Reproduced(folder=out, lines=_lines(out, wanted, seed, quick, failed), failed=failed)


def _run_all(out: Path, wanted: Sequence[Entry], bench: Bench) -> dict[str, str]:
    """Run what doesn't stand yet; return the reasons of what could not be finished."""
    seed, quick = bench.seed, bench.quick
    failed: dict[str, str] = {}
    for number, entry in enumerate(wanted):
        if _kept(out, entry, seed, quick) is not None:
            continue
        bench.begin(entry.name, number / len(wanted), 1.0 / len(wanted))
        try:
            _run(out, entry, bench)
        except TwinError as problem:
            failed[entry.name] = str(problem)
        except Exception as problem:  # one broken experiment must not cost the others; developers see it at once
            if os.environ.get("TWIN_DEBUG"):
                raise
            failed[entry.name] = f"internal error: {type(problem).__name__}: {problem}; please report it"
        _publish(out, seed, quick, failed)
    return failed


def _run(out: Path, entry: Entry, bench: Bench) -> None:
    from twin.show.drawn import drawn

    started, worked = time.perf_counter(), time.process_time()
    outcome = entry.run(bench)
    paper = entry.name.split("/")[0]
    sensors = {name: sensor_hash(name) for name in sorted(bench.used)}
    picture = drawn(outcome.panels) if outcome.panels else b""
    table = {
        "key": _key(entry, bench.seed, bench.quick),
        "name": entry.name, "title": entry.title, "source": entry.source, "protocol": entry.protocol,
        "notes": [*outcome.notes, *([bench.validity] if bench.validity else [])],
        "seconds": round(time.perf_counter() - started, 2), "cpu_seconds": round(time.process_time() - worked, 2),
        "records": [
            {"name": entry.name, "source": entry.source, **record.row(), "sensor": paper, "sensor_hash": sensors}
            for record in outcome.records
        ],
    }  # fmt: skip
    if picture:
        write_whole(_file(out, entry.name, ".png"), lambda f: f.write(picture))
    text = json.dumps(table, indent=1)
    write_whole(_file(out, entry.name, ".json"), lambda f: f.write(text.encode()))


def _file(out: Path, name: str, suffix: str) -> Path:
    """Return an entry's file; the records lie in a folder of their own, the pictures beside the page."""
    plain = name.replace("/", "_")
    if suffix == ".json":
        make_folder(out / "entries")
        return out / "entries" / f"{plain}.json"
    return out / f"{plain}{suffix}"


def _kept(out: Path, entry: Entry, seed: int, quick: bool) -> Table | None:
    """Return what an earlier run left of an entry, if it still stands."""
    try:
        table: Table = json.loads(_file(out, entry.name, ".json").read_text())
    except (OSError, ValueError):
        return None
    return table if table.get("key") == _key(entry, seed, quick) else None


def _key(entry: Entry, seed: int, quick: bool) -> str:
    facts = [source_hash(), entry.name, _scenes_hash(), seed, quick]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


@cache
def source_hash() -> str:
    """Return the hash of all source files of this package."""
    root = Path(twin.__file__).parent
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


@cache
def _scenes_hash() -> str:
    scenes = [load_scene(name).model_dump_json(exclude={"calibration": {"file"}}) for name in SCENES.values()]
    return hashlib.sha256("".join(scenes).encode()).hexdigest()


def _publish(out: Path, seed: int, quick: bool, failed: dict[str, str]) -> None:
    """Write the list of records and the page from the entries that stand."""
    from twin.show.reproduction import reproduction

    tables = [t for entry in ENTRIES.values() if (t := _kept(out, entry, seed, quick)) is not None]
    records = [record for table in tables for record in table["records"]]
    text = json.dumps(records, indent=1) + "\n"
    write_whole(out / "results.json", lambda f: f.write(text.encode()))
    pictures = {t["name"]: _picture(out, t["name"]) for t in tables}
    facts = {
        paper: {"scene": scene, "hash": sensor_hash(paper), "fitted": list(FITTED[paper])}
        for paper, scene in SCENES.items()
    }
    page = reproduction(tables, pictures, facts, failed, seed=seed, quick=quick)
    write_whole(out / "index.html", lambda f: f.write(page.encode()))


def _picture(out: Path, name: str) -> bytes:
    try:
        return _file(out, name, ".png").read_bytes()
    except OSError:
        return b""


def _compared(record: Table) -> bool:
    """Return whether a record should come out as the paper's number did."""
    return record["paper"] is not None and not record["timed"] and not record["ours"]


def _lines(out: Path, wanted: Sequence[Entry], seed: int, quick: bool, failed: dict[str, str]) -> list[str]:
    lines = []
    for entry in wanted:
        table = _kept(out, entry, seed, quick)
        if table is None:
            lines.append(f"{entry.name:22s} failed: {failed.get(entry.name, 'not run')}")
            continue
        compared = [r for r in table["records"] if _compared(r)]
        agreeing = sum(r["verdict"] == "agrees" for r in compared)
        explained = sum("explained by:" in r["verdict"] for r in compared)
        told = (
            f"{agreeing} of {len(compared)} numbers agree with the paper's, {explained} more are explained"
            if compared
            else f"{len(table['records'])} numbers; the paper gives none"
        )
        lines.append(f"{entry.name:22s} {table['seconds']:6.1f} s  {told}")
    return [*lines, f"written to {out / 'index.html'}"]
