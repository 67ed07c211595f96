"""The page on stability: ``python -m benchmarks.stability_page`` puts the stored long runs into docs/stability.md."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table

PAGE = ROOT / "docs" / "stability.md"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

Stored = dict[str, Any]


def random_part(stored: Stored) -> str:
    """Return what became of random scenes, valid and spoilt."""
    parts = []
    for kind, told in (("valid", "Random valid scenes"), ("invalid", "Random spoilt recipes")):
        found = stored[kind]
        rows = [{"what became of it": what, "scenes": count} for what, count in found["outcomes"].items()]
        parts.append(
            f"**{told}: {found['drawn']} drawn, {found['outcomes'].get('failed', 0)} failed, "
            f"{found['cpu_s']:.0f} CPU s, the slowest {found['slowest_s']:.3g} s.**\n\n{table(rows)}\n"
        )
        if found["worst"]:
            worst: list[dict[str, object]] = [{"what": what, "largest": size} for what, size in found["worst"].items()]
            parts.append(f"{table(worst)}\n")
    return "\n".join(parts)


def fuzz_part(stored: Stored) -> str:
    """Return what became of damaged and hostile files, a row a reader."""
    rows = stored["rows"]
    attempts, failed = (sum(row[key] for row in rows) for key in ("attempts", "failed"))
    told = f"**Damaged and hostile files: {attempts} attempts on {len(rows)} readers, {failed} failed.**"
    return f"{told}\n\n{table(rows)}\n"


def kills_part(stored: Stored) -> str:
    """Return what became of killed commands, a row a command."""
    rows = stored["rows"]
    killed, lost = sum(row.get("killed", 0) for row in rows), sum(row["lost or torn"] for row in rows)
    return f"**Killed at {killed} random moments: {lost} files lost or torn.**\n\n{table(rows)}\n"


def endurance_part(stored: Stored) -> str:
    """Return what an hour of mixed work did to the process."""
    told = f"**{stored['minutes']:.0f} minutes of mixed work in one process, {stored['rounds']} rounds.**"
    return f"{told}\n\n{table(stored['rows'])}\n"


PARTS: dict[str, Callable[[Stored], str]] = {
    "random_scenes": random_part,
    "fuzz": fuzz_part,
    "kills": kills_part,
    "endurance": endurance_part,
}


def page_tables(folder: Path = RESULTS) -> str:
    """Return the Markdown between the page's two result marks; a run that is not stored is said to be missing."""
    found = [""]
    for name, part in PARTS.items():
        file = folder / f"{name}.json"
        found.append(
            part(json.loads(file.read_text())) if file.is_file() else f"`benchmarks.{name}` is not stored yet.\n"
        )
    return "\n".join(found)


def write_page(page: Path = PAGE) -> None:
    """Put the stored rows between the page's marks."""
    text = page.read_text()
    page.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    write_page()
