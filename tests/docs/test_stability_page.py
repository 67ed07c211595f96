"""The page on stability: its tables are the stored results, and nothing in them failed."""

from __future__ import annotations

import json
import re
from pathlib import Path

from benchmarks.__main__ import RESULTS
from benchmarks.stability_page import MARKS, PAGE, PARTS, page_tables


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.stability_page"


def test_nothing_that_is_stored_failed() -> None:
    stored = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in PARTS if _is_stored(name)}
    assert not any("failed" in kind["outcomes"] for kind in stored["random_scenes"].values())
    for name, key in (("fuzz", "failed"), ("kills", "lost or torn")):
        assert not any(row[key] for row in stored.get(name, {"rows": []})["rows"]), name


def _is_stored(name: str) -> bool:
    return (RESULTS / f"{name}.json").is_file()


def test_every_run_is_shown_and_a_missing_one_is_said(tmp_path: Path) -> None:
    kind = {
        "drawn": 3,
        "cpu_s": 1.0,
        "slowest_s": 0.5,
        "worst": {"balance": 1e-16},
        "outcomes": {"computed": 2, "failed": 1},
    }
    rows = {
        "random_scenes": {"valid": kind, "invalid": {**kind, "worst": {}}},
        "fuzz": {"rows": [{"reader": "a", "attempts": 5, "failed": 0}, {"reader": "b", "attempts": 6, "failed": 2}]},
        "kills": {
            "rows": [{"command": "run", "killed": 4, "lost or torn": 0}, {"command": "sweep", "lost or torn": 1}]
        },
    }
    for name, content in rows.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    shown = page_tables(tmp_path)
    for words in (
        "3 drawn, 1 failed",
        "11 attempts on 2 readers, 2 failed",
        "4 random moments: 1 files",
        "is not stored yet",
    ):
        assert words in shown
