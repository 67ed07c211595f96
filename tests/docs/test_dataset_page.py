"""The page on datasets shows what was measured, and its commands and columns exist."""

from __future__ import annotations

import re

from benchmarks.dataset import MARKS, PAGE, page_tables
from twin.study.dataset.columns import ALWAYS, SAMPLE, SENSOR


def test_page_is_the_scripts_output() -> None:
    found = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert found is not None
    assert found[0] == found[1] + page_tables() + found[2], "run: python -m benchmarks.dataset"


def test_columns_that_the_page_names_are_there() -> None:
    known = {column.name for column in (*ALWAYS, *SAMPLE, *SENSOR)}
    named = set(re.findall(r"(?<![.\w])(?:marker|site|surface|force)_[a-z_]+\b", PAGE.read_text()))
    assert named - known <= {"force_n"}
