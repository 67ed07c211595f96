"""Where every stage breaks: each axis is walked outwards from the middle until an answer is wrong or refused.

A step holds when nothing that must be true of any answer is off by more than the bounds of its axis: the relative
residual; the imbalance of load and reaction; the asymmetry of the compliance, or under mirrored loads; and the
departure from what must come out (scaled, limiting or summed answers). Where the program estimates its
error, mirrored answers may differ by three times that. ``python -m benchmarks stress`` stores the
rows; ``python -m benchmarks.stress`` writes them into docs/stress.md, ``python -m benchmarks.stress STAGE ...``
measures the rows of some stages anew before that.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table
from benchmarks.arguments import command_line
from benchmarks.stress_axes import Axis, Measured, system_axes, unsolvable
from benchmarks.stress_loads import load_axes
from benchmarks.stress_picture import unfit_libraries
from twin.errors import TwinError
from twin.places import cache_folder

PAGE = ROOT / "docs" / "stress.md"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"
TOLD = 0.01
"""Estimated error above which the accuracy of every shipped scene is missed, so that a run warns."""

ELASTICITY = "elasticity"
STAGES = {
    ELASTICITY: "",
    "contact": "stress_contact.contact_axes",
    "picture": "stress_picture.picture_axes",
    "tracking": "stress_sense.tracking_axes",
    "inverse": "stress_sense.inverse_axes",
    "dataset": "stress_dataset.dataset_axes",
}
"""Stages, with the function that returns their axes; elasticity has two here."""

REFUSALS: dict[str, Callable[[], dict[str, Callable[[], Measured]]]] = {
    ELASTICITY: unsolvable,
    "picture": unfit_libraries,
}
"""What has no answer, or no good one, by stage."""

BREAKING, REFUSED = "Breaking points", "What can't be solved"


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row an axis, then one for every kind of system that can't be solved.

    The quick form walks every fourth step, of elasticity alone, and leaves out axes that have no fourth.
    """
    with tempfile.TemporaryDirectory() as folder:
        _forget(folder)
        return [row for stage in (STAGES if not quick else [ELASTICITY]) for row in _walked(stage, quick)]


def _walked(stage: str, quick: bool = False) -> list[dict[str, Any]]:
    rows = []
    for axis in _axes(stage):
        steps = axis.steps[:: 4 if quick else 1]
        if len(steps) == 1:
            continue
        start = sum(os.times()[:4])
        row = survey(axis, steps)
        rows.append({"what": BREAKING, "stage": stage, **row, "cpu_s": sum(os.times()[:4]) - start})
    attempts = REFUSALS.get(stage, dict)()
    return rows + [{"what": REFUSED, "stage": stage, **refusal(name, attempt)} for name, attempt in attempts.items()]


def _axes(stage: str) -> list[Axis]:
    if stage == ELASTICITY:
        return [*system_axes(), *load_axes()]
    module, name = STAGES[stage].split(".")
    found: list[Axis] = getattr(importlib.import_module(f"benchmarks.{module}"), name)()
    return found


def anew(stages: list[str]) -> None:
    """Measure the rows of some stages and put them in the place of those that are stored."""
    with tempfile.TemporaryDirectory() as folder:
        _forget(folder)
        fresh = {stage: _walked(stage) for stage in stages}
    file = RESULTS / "stress.json"
    stored = json.loads(file.read_text())
    kept = [{"stage": ELASTICITY, **row} for row in stored["rows"]]
    rows = [row for stage in STAGES for row in fresh.get(stage) or [r for r in kept if r["stage"] == stage]]
    file.write_text(json.dumps({**stored, "rows": rows}, indent=1) + "\n")


def _forget(folder: str) -> None:
    """Keep solved fields in an empty folder, so that none of an earlier run is read instead of solving."""
    os.environ["TWIN_CACHE"] = folder
    cache_folder.cache_clear()


def survey(axis: Axis, steps: tuple[float, ...]) -> dict[str, Any]:
    """Walk an axis; return how far it holds, what comes first beyond, and the worst figures of the steps that hold."""
    held: list[float] = []
    worst, first_bad, refused = Measured(), "", ""
    for step in steps:
        try:
            measured = axis.attempt(step)
        except TwinError as problem:
            refused = f"from {step:g} refused: {_short(problem)}"
            break
        wrong = measured.beyond(axis.bounds)
        if wrong:
            told = (
                f"the program estimates {measured.told:.2g}" if measured.told > TOLD else "the program doesn't say so"
            )
            first_bad = first_bad or f"at {step:g} degraded, {told}: {wrong}"
        elif not first_bad:
            held.append(step)
            worst = worst.or_worse(measured)
    return {
        "axis": axis.name,
        "tried": f"{steps[0]:g} to {steps[-1]:g}",
        "holds to": f"{held[-1]:g}" if held else "nowhere",
        "beyond": "; ".join(filter(None, (first_bad, refused))) or "not reached",
        **worst.columns(),
    }


def refusal(name: str, attempt: Callable[[], Measured]) -> dict[str, str]:
    """Return what the program says of a system that can't be solved."""
    try:
        measured = attempt()
    except TwinError as problem:
        return {"system": name, "error": type(problem).__name__, "says": _short(problem, 400)}
    return {"system": name, "error": "none", "says": f"solved, to a residual of {measured.residual:.1e}"}


def _short(problem: TwinError, most: int = 110) -> str:
    text = re.sub(r"\s+", " ", str(problem)).replace("|", "/").replace(f"{ROOT}/", "")
    return text if len(text) <= most else text[: most - 3].rsplit(" ", 1)[0] + " ..."


def page_tables() -> str:
    """Return the Markdown between the page's two result marks."""
    stored = json.loads((RESULTS / "stress.json").read_text())
    parts = [""]
    for what in (BREAKING, REFUSED):
        rows = [_cells(row, what) for row in stored["rows"] if row["what"] == what]
        parts.append(f"**{what}**\n\n{table(rows)}\n")
    return "\n".join([*parts, f"On {stored['machine']['processor']}, {stored['machine']['cores']} cores.\n"])


def _cells(row: dict[str, Any], what: str) -> dict[str, Any]:
    hidden = ("what",) if what == BREAKING else ("what", "stage")
    return {k: v for k, v in row.items() if k not in hidden}


def write_page(page: Path = PAGE) -> None:
    """Put the stored rows between the page's marks."""
    text = page.read_text()
    page.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    if wanted := command_line("stress", __doc__, STAGES).names:
        anew(wanted)
    write_page()
    sys.exit(0)
