"""Run the papers' entries into a folder: one file an entry, the list of all records, and the page.

Resuming: an entry's file carries a key, the hash of this package's source, the paper's resolved
scene, the seed, the form (quick or full) and the renderer. An entry whose file has the right key
is skipped, so an interrupted reproduction continues. A change of any source file runs everything
again.

One thread: sums in another order change last digits, and one seed must give one file whatever the
number of cores. On busy cores a second thread also cost several times the work (Fig. 10: 41 s of
CPU with two threads, 5 s with one).
"""

from __future__ import annotations

import hashlib
import json
import os
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import twin
from twin.arrays import Progress
from twin.blas_threads import one_thread
from twin.errors import InputError, TwinError, did_you_mean
from twin.files import make_folder, write_whole
from twin.study.recipe import load_scene
from twin.study.reproduce.bench import FITTED, SCENES, Bench, Entry
from twin.study.reproduce.design_limits import DESIGN_LIMITS, in_short
from twin.study.reproduce.finger_figures import FINGER_FIGURES
from twin.study.reproduce.flat_figures import FLAT_FIGURES
from twin.study.reproduce.record import Record
from twin.study.reproduce.shifted import SHIFTED

Table = dict[str, Any]

_MADE = {**SHIFTED, **FLAT_FIGURES, **FINGER_FIGURES, **DESIGN_LIMITS}
_DECLARED = tomllib.loads(Path(__file__).with_name("entries.toml").read_text(encoding="utf-8"))

ENTRIES = {name: Entry(name=name, run=_MADE[name], **facts) for name, facts in _DECLARED.items()}
"""Tables and figures in the order of the papers."""

assert ENTRIES.keys() == _MADE.keys(), "every entry is declared"

_ALL_GB = 8.0
"""Memory of all entries. By itself an entry also makes what all share: with an empty cache 7 to 42
s more on the flat sensor, and 106 s for the finger's Fig. 8."""


def _listing() -> list[str | tuple[str, Table]]:
    """Return a line and a record of each entry: what it shows, and the time and memory it takes."""
    lines: list[str | tuple[str, Table]] = []
    for name, entry in ENTRIES.items():
        shown = ("name", "title", "cpu_seconds", "memory_gb")
        room = f"{entry.memory_gb:.1f} GB" if entry.memory_gb else ""
        line = f"{name:29s} {entry.cpu_seconds:4d} s  {room:6s}  {entry.title}"
        lines.append((line, {key: getattr(entry, key) for key in shown}))
    seconds = sum(entry.cpu_seconds for entry in ENTRIES.values())
    return [
        *lines,
        f"{'all':29s} {seconds:4d} s  {_ALL_GB:.1f} GB  on one core",
        "Give entries, papers (kamiyama, sato, beyond) or all. One by itself, with an empty cache, "
        "takes 7 to 110 s more.",
    ]


def _chosen(names: Sequence[str], quick: bool = False) -> list[Entry]:
    """Return the entries that names mean, in the papers' order; the quick form leaves long ones to
    their name."""
    wanted: set[str] = set()
    for name in names:
        found = [key for key in ENTRIES if name in ("all", key, key.split("/")[0])]
        if not found:
            hint = did_you_mean(name, (*(key.split("/")[0] for key in ENTRIES), *ENTRIES), "", 0.4)
            raise InputError(
                f"there is no entry '{name}':{hint and f' {hint}'} allowed are all, kamiyama, "
                f"sato, beyond, {', '.join(ENTRIES)}"
            )
        wanted.update(key for key in found if key == name or not (quick and ENTRIES[key].long))
    return [entry for key, entry in ENTRIES.items() if key in wanted]


@dataclass(frozen=True, kw_only=True)
class _Reproduced:
    """Lines for the terminal, those of entries with a record, and reasons of unfinished entries."""

    lines: Sequence[str | tuple[str, Table]]
    failed: dict[str, str]


def reproduce(
    names: Sequence[str] = (),
    out: Path = Path("reproduce"),
    *,
    seed: int = 1,
    quick: bool = False,
    renderer: str = "auto",
    progress: Progress | None = None,
) -> _Reproduced:
    """Run the papers' experiments and write ``index.html``, ``results.json`` and an SVG for each;
    without names, list the entries. `twin.commands.reproduce` explains the arguments.

    Raises
    ------
    InputError
        There is no such entry, or the folder can't be written.
    """
    if not names:
        return _Reproduced(lines=_listing(), failed={})
    wanted = _chosen(names, quick)
    make_folder(out)
    make_folder(out / "entries")
    bench = Bench(seed=seed, quick=quick, renderer=renderer, progress=progress)
    with one_thread():
        failed = _run_all(out, wanted, bench)
    _publish(out, bench, failed)
    if progress is not None:
        progress("done", 1.0)
    lines = [_line(entry, _kept(out, entry, bench), failed) for entry in wanted]
    return _Reproduced(lines=[*lines, f"written to {out / 'index.html'}"], failed=failed)


def _run_all(out: Path, wanted: Sequence[Entry], bench: Bench) -> dict[str, str]:
    """Run what doesn't stand yet; return the reasons of what could not be finished."""
    failed: dict[str, str] = {}
    for number, entry in enumerate(wanted):
        if _kept(out, entry, bench) is not None:
            continue
        bench.begin(entry.name, number / len(wanted), 1.0 / len(wanted))
        try:
            _run(out, entry, bench)
        except TwinError as problem:
            failed[entry.name] = str(problem)
        except Exception as problem:
            # one broken experiment must not cost the others; developers see it at once
            if os.environ.get("TWIN_DEBUG"):
                raise
            failed[entry.name] = (
                f"internal error: {type(problem).__name__}: {problem}; please report it"
            )
        _publish(out, bench, failed)
    return failed


def _run(out: Path, entry: Entry, bench: Bench) -> None:
    from twin.show.reproduction_page import Panel

    started, worked = time.perf_counter(), time.process_time()
    outcome = entry.run(bench)
    about = {"name": entry.name, "source": entry.source}
    sensor = {
        "sensor": entry.name.split("/")[0],
        "sensor_hash": {name: Bench.sensor_hash(name) for name in sorted(bench.used)},
    }
    protocol = entry.protocol
    if bench.quick and entry.quick:
        protocol += f" In the quick form {entry.quick}."
    table = {
        "key": _key(entry, bench),
        "name": entry.name,
        "title": entry.title,
        "source": entry.source,
        "protocol": protocol,
        "renderer": bench.renderer,
        "notes": [*entry.notes, *outcome.notes, *([bench.validity] if bench.validity else [])],
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(time.process_time() - worked, 2),
        "records": [{**about, **record.row(), **sensor} for record in outcome.records],
        "panels": [panel.title for panel in outcome.panels],
    }
    if outcome.panels:
        write_whole(_picture(out, entry.name), Panel.svg(outcome.panels))
    for number, panel in enumerate(outcome.panels):
        write_whole(_picture(out / "entries", f"{entry.name}_{number}"), Panel.svg([panel]))
    write_whole(_records(out, entry), json.dumps(table, indent=1).encode())


def _records(out: Path, entry: Entry) -> Path:
    """Return the file of an entry's records."""
    return out / "entries" / f"{entry.name.replace('/', '_')}.json"


def _picture(out: Path, name: str) -> Path:
    return out / f"{name.replace('/', '_')}.svg"


def _kept(out: Path, entry: Entry, bench: Bench) -> Table | None:
    """Return what an earlier run left of an entry, if it still stands."""
    try:
        table: Table = json.loads(_records(out, entry).read_text())
    except (OSError, ValueError):
        return None
    return table if table.get("key") == _key(entry, bench) else None


def _key(entry: Entry, bench: Bench) -> str:
    form = [bench.seed, bench.quick, bench.renderer]
    facts = [_source_hash(), entry.name, _scenes_hash(), *form]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


@cache
def _source_hash() -> str:
    """Return the hash of all source files of this package, and of what is declared."""
    root = Path(twin.__file__).parent
    digest = hashlib.sha256(json.dumps(_DECLARED).encode())
    for file in sorted(root.rglob("*.py")):
        digest.update(
            file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0"
        )
    return digest.hexdigest()


@cache
def _scenes_hash() -> str:
    scenes = [
        load_scene(name).model_dump_json(exclude={"calibration": {"file"}})
        for name in SCENES.values()
    ]
    return hashlib.sha256("".join(scenes).encode()).hexdigest()


def _publish(out: Path, bench: Bench, failed: dict[str, str]) -> None:
    """Write the list of records and the page from the entries that stand."""
    from twin.show.reproduction_page import reproduction

    tables = [t for entry in ENTRIES.values() if (t := _kept(out, entry, bench)) is not None]
    records, unprinted = Record.settled([record for table in tables for record in table["records"]])
    for table in tables:
        table["records"] = [record for record in records if record["name"] == table["name"]]
    text = json.dumps(records, indent=1) + "\n"
    write_whole(out / "results.json", text.encode())
    pictures = {
        table["name"]: [
            (title, _picture(out / "entries", f"{table['name']}_{number}").read_bytes())
            for number, title in enumerate(table["panels"])
        ]
        for table in tables
    }
    facts = {
        paper: {"scene": scene, "hash": Bench.sensor_hash(paper), "fitted": list(FITTED[paper])}
        for paper, scene in SCENES.items()
    }
    page = reproduction(
        tables,
        pictures,
        facts,
        failed,
        in_short(records),
        unprinted,
        seed=bench.seed,
        quick=bench.quick,
        renderer=bench.renderer,
    )
    write_whole(out / "index.html", page.encode())


def _line(entry: Entry, table: Table | None, failed: dict[str, str]) -> tuple[str, Table]:
    """Return the line about an entry, and its record."""
    if table is None:
        reason = failed.get(entry.name, "not run")
        return f"{entry.name:22s} failed: {reason}", {"name": entry.name, "failed": reason}
    verdicts = [
        r["verdict"]
        for r in table["records"]
        if r["paper"] is not None and not r["timed"] and not r["ours"]
    ]
    record = {
        "name": entry.name,
        "seconds": table["seconds"],
        "numbers": len(table["records"]),
        "compared": len(verdicts),
        "agree": verdicts.count("agrees"),
        "explained": sum("explained by:" in verdict for verdict in verdicts),
    }
    words = "{numbers} numbers; the paper gives none"
    if verdicts:
        words = (
            "{agree} of {compared} numbers agree with the paper's, {explained} more are explained"
        )
    return f"{entry.name:22s} {table['seconds']:6.1f} s  {words.format(**record)}", record
