"""The page on hard beads: its tables are the stored results, and the resolved beads agree with the closed forms."""

from __future__ import annotations

import re

import pytest

from benchmarks.inclusions import MARKS, PAGE, page_tables, run


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.inclusions"


@pytest.mark.slow
def test_resolved_beads_agree_with_closed_forms() -> None:
    pytest.importorskip("ngsolve", reason="an independent program, of the extra 'peers'")
    resolved = run(quick=True)[0]
    assert resolved["largest difference, %"] < 0.08 * resolved["closed form, %"]
