"""The page on elasticity is what the stored benchmarks say."""

from __future__ import annotations

import re

from benchmarks.elasticity_page import MARKS, PAGE, page_tables


def test_page_is_the_scripts_output() -> None:
    found = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert found is not None
    assert found.group(0) == found.group(1) + page_tables() + found.group(2), (
        "run: python -m benchmarks.elasticity_page"
    )
