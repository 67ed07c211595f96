"""The page on the papers shows what was measured, of every entry."""

from __future__ import annotations

import re

from benchmarks.elasticity_page import stored
from benchmarks.reproduction_page import MARKS, PAGE, page_tables
from twin.study.reproduce.catalogue import ENTRIES


def test_page_is_the_scripts_output() -> None:
    found = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert found is not None
    assert found[0] == found[1] + page_tables(stored("reproduction")) + found[2], (
        "run: python -m benchmarks.reproduction_page"
    )


def test_every_entry_was_run_for_it() -> None:
    rows = stored("reproduction")
    assert {row["entry"] for row in rows if "entry" in row} == set(ENTRIES)
    assert {row["record"]["name"] for row in rows if "record" in row} == set(ENTRIES)
