"""The page on the papers: ``python -m benchmarks.reproduction_page [DIR]`` writes docs/reproduction.md's tables.

DIR is what ``twin reproduce all`` wrote; its numbers and times are stored first. Without DIR the stored ones are taken.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, machine, table
from benchmarks.elasticity_page import stored
from twin.study.reproduce.bench import FITTED
from twin.study.reproduce.catalogue import ENTRIES
from twin.study.reproduce.same_hardware import CAMERA, DEFAULT, PAPERS

PAGE = ROOT / "docs" / "reproduction.md"
PICTURES = {"beyond_limits.png": "reproduction_limits.png", "beyond_half-space.png": "reproduction_half_space.png"}
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"
HEADINGS = {
    "kamiyama": "The flat sensor (Kamiyama)",
    "sato": "The finger (Sato)",
}

Row = dict[str, Any]


def store(folder: Path) -> None:
    """Keep a reproduction's numbers, and seconds by entry, in benchmarks/results; its pictures in docs."""
    entries = [json.loads(file.read_text()) for file in (folder / "entries").glob("*.json")]
    missing = sorted(set(ENTRIES) - {entry["name"] for entry in entries})
    if missing:
        raise SystemExit(f"{folder} lacks {', '.join(missing)}: run twin reproduce all --out {folder}")
    seconds = {entry["name"]: {"wall": entry["seconds"], "CPU": entry["cpu_seconds"]} for entry in entries}
    records = json.loads((folder / "results.json").read_text())
    rows = [{"record": record} for record in records] + [
        {"entry": name, **seconds[name]} for name in ENTRIES
    ]  # fmt: skip
    (RESULTS / "reproduction.json").write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
    for name, copy in PICTURES.items():
        shutil.copyfile(folder / name, ROOT / "docs" / copy)


def page_tables(rows: list[Row]) -> str:
    """Return the Markdown between the page's marks."""
    records = [row["record"] for row in rows if "record" in row]
    parts = [_counts(records)]
    for paper, heading in HEADINGS.items():
        mine = [r for r in records if r["name"].startswith(paper) and r["paper"] is not None]
        parts += [f"## {heading}", ""]
        if paper in FITTED:
            parts += [f"Fitted: {'; '.join(FITTED[paper])}.", ""]
        parts += [table([_row(record) for record in mine]), ""]
    parts += [
        "## The same hardware with this project's tracker, calibration and inverse", "",
        "The papers' bodies, markers, cameras and capture chains. Beside what the papers print, what the twin gives "
        "with the paper's own software, with this project's tracker and calibration and its default inverse "
        "(`smooth`), with its inverse `local`, and that behind an industrial camera. Field errors are over the sites "
        "of each: 1 mm apart on the flat sensor (the paper's 1.5 mm), 1.25 mm on the finger (2.5 mm).", "",
        table([_beside(r) for r in records if r["name"].startswith("beyond/same-hardware")]), "",
        "## What limits each sensor", "",
        "One thing is changed at a time, with the papers' tracker and inverse; the mark on each bar is the closed-form "
        "limit of that design at its noise, of a half-space seen straight on.", "",
        "![Width of a narrow force and least distance of two, with one thing changed](reproduction_limits.png)", "",
        "## The papers' half-space against the real block", "",
        table([
            {"load and layer": r["quantity"].split(":")[0], "off by, over the largest motion": r["twin"]}
            for r in records if r["name"] == "beyond/half-space"
        ]), "",
        "![Motion of the blue layer by formula and by the block](reproduction_half_space.png)", "",
        "## Seconds", "",
        table([row for row in rows if "entry" in row]), "",
    ]  # fmt: skip
    return "\n".join(["", *parts])


def _counts(records: list[Row]) -> str:
    said = Counter(_short(r["verdict"]) for r in records if r["paper"] is not None and not r["timed"] and not r["ours"])
    counts = "; ".join(f"{count} {what}" for what, count in said.most_common())
    return f"Of {sum(said.values())} numbers that the papers print: {counts}.\n"


def _short(verdict: str) -> str:
    kinds = {"agrees": "agree", "explained by": "explained", "partly explained": "partly explained"}
    return next((kind for start, kind in kinds.items() if verdict.startswith(start)), "not explained")


def _row(record: Row) -> Row:
    spread = f" ± {record['spread']:.2g}" if record["spread"] is not None else ""
    return {
        "entry": record["name"].split("/")[1], "number": record["quantity"], "unit": record["unit"],
        "paper": f"{record['paper']:g}", "twin": "not defined" if record["twin"] is None
        else f"{record['twin']:.3g}{spread}", "n": record["n"], "agreement": record["verdict"],
    }  # fmt: skip


def _beside(record: Row) -> Row:
    others = {cause["cause"]: cause["value"] for cause in record["explained_by"]}
    spread = f" ± {record['spread']:.2g}" if record["spread"] else ""
    return {
        "number": record["quantity"], "unit": record["unit"],
        "paper prints": "" if record["paper"] is None else f"{record['paper']:.3g}",
        "with the paper's software": _value(others.get(PAPERS)),
        "with the default inverse": _value(others.get(DEFAULT)),
        "with this project's": f"{_value(record['twin'])}{spread}",
        "and an industrial camera": _value(others.get(CAMERA)), "n": record["n"],
    }  # fmt: skip


def _value(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def main() -> None:
    """Store what is given, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reproduction_page", description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="what twin reproduce wrote, to be stored first")
    folder = parser.parse_args().folder
    if folder is not None and not (folder / "results.json").is_file():
        parser.error(f"{folder}: holds no results.json; give the folder that twin reproduce wrote")
    if folder is not None:
        store(folder)
    text = page_tables(stored("reproduction"))
    PAGE.write_text(re.sub(MARKS, lambda m: m[1] + text + m[2], PAGE.read_text(), flags=re.DOTALL))


if __name__ == "__main__":
    main()
