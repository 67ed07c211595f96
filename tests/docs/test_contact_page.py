"""The page on contact: its tables are the stored results, which keep what is asked."""

from __future__ import annotations

import json
import re

import pytest

from benchmarks.__main__ import RESULTS
from benchmarks.contact import CLOSED, HELD, extrapolated, order
from benchmarks.contact_page import MARKS, PAGE, of, page_tables, series, stored_rows
from benchmarks.contact_peer import PEER
from benchmarks.presses import BODIES, SITES, compliance_of, drawn, outcome

ASKED = {
    ("Hertz", "contact radius"): 0.005,
    ("Hertz", "peak pressure"): 0.005,
    ("Hertz", "indentation"): 0.005,
    ("Hertz", "total force"): 1e-8,
    ("Cattaneo-Mindlin", "stick radius"): 0.02,
    ("Cattaneo-Mindlin", "first tangential stiffness"): 0.02,
    ("Cattaneo-Mindlin", "sideways motion"): 0.02,
    ("Lubkin, a twisted sphere", "first torsional stiffness"): 0.03,
    ("Lubkin, a twisted sphere", "turn"): 0.03,
}
"""Largest error on the finest grid."""


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.contact_page"


def test_stored_errors_are_what_is_asked() -> None:
    rows = stored_rows()
    for one in series(rows):
        last = one[-1]
        if asked := ASKED.get((last["case"], last["quantity"])):
            assert abs(last["error"]) <= asked, last
        if last["case"].startswith(("flat", "stuck")):
            assert abs(extrapolated(one)) <= 0.01, last
            assert order(one) > 1.0
        assert max(row["residual"] for row in one) <= 1e-8
    for row in of(rows, HELD):
        assert max(row[key] for key in ("imbalance", "complementarity", "pull")) <= 1e-8
        assert row.get("out of the cone", 0.0) <= 1e-8
        assert row.get("tangential over normal", 0.0) <= 1e-9
    assert CLOSED in {row["what"] for row in rows}
    finest = {row["case"]: row["indentation error"] for row in of(rows, PEER) if row["program"] == "twin"}
    assert len(finest) >= 3
    assert max(finest.values()) <= 0.01


@pytest.mark.parametrize("body", BODIES)
def test_stored_presses_did_not_fail(body: str) -> None:
    found = json.loads((RESULTS / f"presses_{body}.json").read_text())
    assert not found["failed"]
    assert sum(group["presses"] for group in found["groups"].values()) == found["done"]
    assert max(group["largest_residual"] for group in found["groups"].values()) <= 1e-8


def test_order_and_limit_of_a_made_up_series() -> None:
    rows = [{"across": n, "error": 0.02 + 3.0 * n**-2.0} for n in (10, 20, 40)]
    assert extrapolated(rows) == pytest.approx(0.02)
    assert order([{"across": n, "error": n**-1.5} for n in (10, 14, 28)]) == pytest.approx(1.5)


@pytest.mark.slow
def test_random_presses_on_the_block() -> None:
    compliance = compliance_of("block")
    said = [outcome("block", compliance, number) for number in range(10_000, 10_200)]
    assert not [one for one in said if "failed" in one]
    assert sum("residual" in one for one in said) > 150
    assert max(one.get("residual", 0.0) for one in said) <= 1e-8


def test_a_press_is_known_by_its_number() -> None:
    assert drawn("finger", 3 * SITES) == drawn("finger", 3 * SITES)
    assert drawn("block", 1).press != drawn("block", 2).press
