"""The page on breaking points: its tables are the stored results, and what it promises is in them."""

from __future__ import annotations

import json
import re

import pytest

from benchmarks.__main__ import RESULTS
from benchmarks.stress import BREAKING, MARKS, PAGE, REFUSED, page_tables, refusal, survey
from benchmarks.stress_axes import Axis, Measured
from twin.errors import SolveError

ROWS = json.loads((RESULTS / "stress.json").read_text())["rows"]
PROMISED = {
    "Poisson's ratio, down": "-0.5",
    "Poisson's ratio, up": "0.5",
    "cover, times stiffer": "1e+07",
    "cover, times as stiff": "1e-12",
    "E up, MPa": "1e+06",
    "threads": "4",
    "field of view, pinhole, deg": "170",
    "field of view, equidistant, deg": "200",
    "markers": "20000",
    "strain of a print": "10",
    "pictures of a process without a home (departure: MiB grown)": "10000",
}


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.stress"


@pytest.mark.parametrize("axis", list(PROMISED))
def test_axis_holds_as_far_as_promised(axis: str) -> None:
    (row,) = [row for row in ROWS if row.get("axis") == axis]
    assert row["holds to"] == PROMISED[axis]


def test_every_impossible_system_is_refused() -> None:
    refused = [row for row in ROWS if row["what"] == REFUSED]
    assert len(refused) >= 12
    assert all(row["error"] in ("SolveError", "MeshError", "InputError", "MissingCapability") for row in refused)


def test_survey_stops_at_the_first_wrong_step_and_goes_on_to_the_error() -> None:
    """An axis that is wrong from 3 on and refused from 5: it holds to 2, whatever is right again later."""

    def attempt(step: float) -> Measured:
        if step > 4:
            raise SolveError("too far")
        return Measured(residual=1e-3 if step == 3 else 1e-12 * step, asymmetry=1.4, told=0.5)

    axis = Axis(name="any", steps=(1, 2, 3, 4, 5), attempt=attempt, bounds=Measured(residual=1e-9))
    row = survey(axis, axis.steps)
    assert row["holds to"] == "2"
    assert row["beyond"] == "at 3 degraded, the program estimates 0.5: residual 1.0e-03; from 5 refused: too far"
    assert row["worst residual"] == 2e-12
    assert refusal("any", lambda: attempt(5.0)) == {"system": "any", "error": "SolveError", "says": "too far"}
    assert {row["what"] for row in ROWS} == {BREAKING, REFUSED}
