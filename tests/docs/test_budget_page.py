"""The page on error budgets shows what is stored, and its parts add up."""

from __future__ import annotations

import re

import pytest

from benchmarks.budget_page import MARKS, PAGE, STAGES, by_scene, part, tables
from benchmarks.elasticity_page import stored


@pytest.mark.parametrize("mark", ["budget", "auto", "scaling", "nodes"])
def test_page_is_the_scripts_output(mark: str) -> None:
    found = re.search(MARKS.format(mark), PAGE.read_text(), flags=re.DOTALL)
    assert found is not None
    assert found[0] == found[1] + tables()[mark] + found[2], "run: python -m benchmarks.budget_page"


def test_no_scene_errs_more_than_its_parts_together() -> None:
    scenes = by_scene(stored("budget"))
    assert len(scenes) >= 6
    for mine in scenes.values():
        assert list(mine) == list(STAGES)
        whole = mine["contact"]["total_force_error"]
        chain = ("regularisation", "inverse model", "tracking", "CCD noise")
        assert whole <= 1.001 * sum(part(mine[stage]) for stage in chain)
