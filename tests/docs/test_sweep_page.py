"""The page on sweeps: its tables are the stored results."""

from __future__ import annotations

import re

from benchmarks.sweep_page import MARKS, PAGE, page_tables


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.sweep_page"
