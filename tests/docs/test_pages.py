"""The measured pages: tables between marks are the output of the stored results, which keep what is promised."""

import json
import re
from pathlib import Path

import pytest

from benchmarks import pages
from benchmarks.inclusions import measure as resolved_beads
from benchmarks.pages import PAGES, RESULTS, extrapolated, order, series, stored
from benchmarks.presses import BODIES, SITES, compliance_of, drawn, outcome
from benchmarks.random_scenes import COUNT
from twin.study.dataset.columns import ALWAYS, SAMPLE, SENSOR
from twin.study.reproduce.reproduction_run import ENTRIES


@pytest.mark.parametrize("name", PAGES)
def test_page_is_the_writers_output(name: str) -> None:
    page = PAGES[name]
    assert page.file.read_text() == page.text(), f"run: python -m benchmarks pages {name}"
    marks = [mark for mark in page.parts() if f"<!-- {mark} -->\n" not in page.file.read_text()]
    assert not marks, "their tables stand nowhere"


def test_every_stored_result_is_shown() -> None:
    source = Path(pages.__file__).read_text()
    names = {file.stem for file in RESULTS.glob("*.json") if not file.stem.startswith("presses_")}
    assert not [name for name in names if name not in source]


def test_columns_that_the_page_on_datasets_names_are_there() -> None:
    known = {column.name for column in (*ALWAYS, *SAMPLE, *SENSOR)}
    named = set(re.findall(r"(?<![.\w])(?:marker|site|surface|force)_[a-z_]+\b", PAGES["dataset"].file.read_text()))
    assert named - known <= {"force_n"}


# elasticity, pictures, budget


def test_no_scene_errs_more_than_its_parts_together() -> None:
    scenes = pages.by_scene(stored("budget"))
    assert len(scenes) >= 6
    for mine in scenes.values():
        assert list(mine) == list(pages.STAGES)
        whole = mine["contact"]["total_force_error"]
        chain = ("regularisation", "inverse model", "tracking", "CCD noise")
        assert whole <= 1.001 * sum(pages.part_of_error(mine[stage]) for stage in chain)


# contact

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


def test_stored_errors_are_what_is_asked() -> None:
    rows = stored("contact")
    for one in series(rows):
        last = one[-1]
        if asked := ASKED.get((last["case"], last["quantity"])):
            assert abs(last["error"]) <= asked, last
        if last["case"].startswith(("flat", "stuck")):
            assert abs(extrapolated(one)) <= 0.01, last
            assert order(one) > 1.0
        assert max(row["residual"] for row in one) <= 1e-8


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
    assert drawn("block", 1)[0] != drawn("block", 2)[0]


# hard beads, linearity


@pytest.mark.slow
def test_resolved_beads_agree_with_closed_forms() -> None:
    pytest.importorskip("ngsolve", reason="an independent program, of the extra 'peers'")
    resolved = resolved_beads(quick=True)[0]
    assert resolved["largest difference, %"] < 0.08 * resolved["closed form, %"]


# long runs, papers


def test_nothing_that_is_stored_failed() -> None:
    names = ("random_scenes", "fuzz", "kills")
    found = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in names}
    assert not any("failed" in kind["outcomes"] for kind in found["random_scenes"].values())
    assert found["random_scenes"]["invalid"]["drawn"] >= COUNT
    for name, key in (("fuzz", "failed"), ("kills", "lost or torn")):
        assert not any(row[key] for row in found[name]["rows"]), name


def test_every_entry_was_run_for_the_page_on_the_papers() -> None:
    rows = stored("reproduction")
    assert {row["entry"] for row in rows if "entry" in row} == set(ENTRIES)
    assert {row["record"]["name"] for row in rows if "record" in row} == set(ENTRIES)
