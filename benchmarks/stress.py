"""Where every stage breaks: each axis is walked outwards from the middle until an answer is wrong or refused.

A step holds when nothing that must be true of any answer is off by more than the bounds of its axis: the relative
residual; the imbalance of load and reaction; the asymmetry of the compliance, or under mirrored loads; and the
departure from what must come out (scaled, limiting or summed answers). Where the program estimates its
error, mirrored answers may differ by three times that. ``python -m benchmarks stress`` stores the
rows; ``python -m benchmarks.stress`` writes them into docs/stress.md, ``python -m benchmarks.stress STAGE ...``
measures the rows of some stages anew before that.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from benchmarks import ROOT, record
from benchmarks.clock import Clock, empty_cache
from benchmarks.pages import write
from benchmarks.stress_elastic import Axis, Measured, elastic_axes
from benchmarks.stress_press import contact_axes
from benchmarks.stress_software import inverse_axes, picture_axes, tracking_axes
from twin.errors import TwinError

TOLD = 0.01
"""Estimated error above which the accuracy of every shipped scene is missed, so that a run warns."""

STAGES: dict[str, Callable[[], list[Axis]]] = {
    "elasticity": elastic_axes,
    "contact": contact_axes,
    "picture": picture_axes,
    "tracking": tracking_axes,
    "inverse": inverse_axes,
}
"""Stages with the function that returns their axes."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row an axis.

    The quick form walks every fourth step, of elasticity alone, and leaves out axes that have no fourth.
    """
    with empty_cache():
        return [row for stage in (["elasticity"] if quick else STAGES) for row in _walked(stage, quick)]


def _walked(stage: str, quick: bool = False) -> list[dict[str, Any]]:
    rows = []
    for axis in STAGES[stage]():
        steps = axis.steps[:: 4 if quick else 1]
        if len(steps) == 1:
            continue
        clock = Clock()
        row = survey(axis, steps)
        rows.append({"what": "Breaking points", "stage": stage, **row, "cpu_s": clock.lap().cpu})
    return rows


def anew(stages: list[str]) -> None:
    """Measure the rows of some stages and put them in the place of those that are stored."""
    with empty_cache():
        fresh = {stage: _walked(stage) for stage in stages}
    kept = record.stored("stress")
    rows = [row for stage in STAGES for row in fresh.get(stage) or [r for r in kept if r["stage"] == stage]]
    record.write("stress", {**record.read("stress"), "rows": rows})


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
            told = f"estimates {measured.told:.2g}" if measured.told > TOLD else "doesn't say so"
            first_bad = first_bad or f"at {step:g} degraded, the program {told}: {wrong}"
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


def _short(problem: TwinError) -> str:
    text = re.sub(r"\s+", " ", str(problem)).replace("|", "/").replace(f"{ROOT}/", "")
    return text if len(text) <= 110 else text[:107].rsplit(" ", 1)[0] + " ..."


if __name__ == "__main__":
    if wanted := record.names_of(record.parser_of("stress", __doc__), STAGES).names:
        anew(wanted)
    write("stress")
