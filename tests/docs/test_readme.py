"""The README's Python blocks run, and its tables are the benchmarks' output."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.readme import results_section

README = (Path(__file__).parents[2] / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_python_block_runs(number: int) -> None:
    exec(compile(BLOCKS[number], f"README.md, block {number + 1}", "exec"), {})


def test_there_is_a_block_to_run() -> None:
    assert BLOCKS


def test_tables_are_the_scripts_output() -> None:
    section = re.search(r"<!-- results -->\n(.*?)<!-- end of results -->", README, re.DOTALL)
    assert section is not None
    assert section.group(1) == results_section(), "run: python -m benchmarks.readme"
