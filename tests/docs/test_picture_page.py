"""The page on pictures: its tables are the stored results."""

from __future__ import annotations

import re

import pytest

from benchmarks.picture_page import MARKS, PAGE, page_tables, to_the_goal


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.picture_page"


def test_time_to_a_goal_is_read_between_runs_or_continued_for_random_samples() -> None:
    def run(method: str, cost: float, error: float) -> dict[str, object]:
        return {"scene": "a", "method": method, "shadows": True, "cpu_ms": cost, "centroid_rms_px": error}

    rows = [
        run("twin, splat", 10.0, 0.012),
        run("twin, splat", 40.0, 0.00075),
        run("mi.render direct, 4 samples", 50.0, 0.03),
    ]
    found = {row["method"]: row["CPU ms"] for row in to_the_goal(rows)}
    assert found["twin, splat"] == pytest.approx(20.0)
    assert found["mi.render direct"] == pytest.approx(5000.0)
