"""The force field under the 5 mm pillar, by the paper's constraints: Kamiyama's Figs. 10 to 13."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.parts.methods import Method
from twin.sense.reconstruct import Field
from twin.study.reproduce.bench import OUR_TRACKER, Bench
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import (
    NO_LENS,
    NO_NOISE,
    OUR_TRACKER_INSTEAD,
    TOLD_OF_BLOCK,
    Seen,
    calibration,
    circle_mm,
    far_away,
    field_panel,
    full_width,
    profile,
    scored,
    solved,
    strongest_mm,
    true_field,
)
from twin.study.reproduce.flat_picture import PILLAR_N, pillar_press
from twin.study.reproduce.record import Cause, Outcome, Record, over

SIDE_MM = 1.5
BAND_MM = 0.8


@dataclass(frozen=True, kw_only=True)
class Inverse:
    """How a figure was solved: constraint, calibration, and what it is called."""

    label: str
    method: Method
    options: Mapping[str, Any] = field(default_factory=dict)
    calibration: str | None = None


DIFFERENCE = Inverse(label="least norm of differences", method="smooth")
NORM = Inverse(label="least norm", method="norm")
PUSHES = Inverse(label="Fz >= 0, least norm of differences", method="smooth", options={"push_only": True})
BLIND = Inverse(label="least norm, before camera calibration", method="norm", calibration="no camera")
FREE = Inverse(label="no constraint", method="pinv")


def _press(bench: Bench, seed: int, cause: str = "", overrides: Mapping[str, Any] | None = None) -> Seen:
    """Return the pillar's press and its picture, tracked; kept for all figures."""

    def work() -> Seen:
        rig = bench.rig("kamiyama", seed, overrides)
        state = rig.press(pillar_press())
        return Seen(rig=rig, state=state, found=rig.seen(state, method=OUR_TRACKER if cause == "tracker" else None))

    seen = bench.once(("pillar", seed, cause), work)
    seen.rig.motion(seen.rig.press(pillar_press()))  # kept; what they say of their own doubts goes for this figure too
    return seen


FIGURES: dict[str, tuple[str, Callable[[Seen, Field], float]]] = {
    "field error": ("", lambda seen, found: float(scored(seen.rig, seen.state, found)["field_error"])),
    "total push over the applied one": (
        "", lambda seen, found: float(found.total_force_n[2] / seen.state.force_n[2]),
    ),
    "distance of the strongest force from the pillar's axis": (
        "mm", lambda _, found: float(np.linalg.norm(strongest_mm(found))),
    ),
    "full width at half maximum of the push along x": (
        "mm", lambda _, found: full_width(*profile(found, BAND_MM)),
    ),
}  # fmt: skip


def _solve(bench: Bench, seen: Seen, how: Inverse) -> Field:
    return solved(seen.found, calibration(bench, seen.rig, how.calibration), how.method, how.options)


def _causes(bench: Bench, how: Inverse) -> dict[str, tuple[Seen, Field]]:
    """Return the runs with one cause switched off, by name; of the first sensor."""
    base = _press(bench, bench.seed)
    cases = {
        NO_NOISE: _press(bench, bench.seed, "noise", {"ccd.noise": False}),
        OUR_TRACKER_INSTEAD: _press(bench, bench.seed, "tracker"),
        NO_LENS: _press(bench, bench.seed, "lens", far_away(base.rig)),
    }
    runs = {name: (seen, _solve(bench, seen, how)) for name, seen in cases.items()}
    finite = Inverse(label="", method=how.method, options=how.options, calibration="compliance")
    runs[TOLD_OF_BLOCK] = (base, _solve(bench, base, finite))
    told = calibration(bench, base.rig, "compliance")
    ours = cases[OUR_TRACKER_INSTEAD]
    runs["inverse, tracker and block: this project's"] = (ours, solved(ours.found, told, "smooth", PUSHES.options))
    return runs


def _field_entry(bench: Bench, how: Inverse) -> Outcome:
    runs: list[tuple[Seen, Field]] = []
    for seed in bench.seeds("kamiyama"):
        bench.progress(f"sensor {seed}", 0.1 + 0.1 * len(runs))
        seen = _press(bench, seed)
        runs.append((seen, _solve(bench, seen, how)))
    bench.progress("with causes off", 0.5)
    off = _causes(bench, how)
    records = [
        Record(
            quantity=f"{how.label}: {name}", unit=unit, **over(figure(*run) for run in runs),
            explained_by=tuple(Cause(cause=cause, value=figure(*run)) for cause, run in off.items()),
        )
        for name, (unit, figure) in FIGURES.items()
    ]  # fmt: skip
    seen, found = runs[0]
    truth = _as_field(found, true_field(seen.rig, seen.state, found.site_mm))
    outline = circle_mm(2.5)
    panels = [
        field_panel(how.label, found, outline, SIDE_MM),
        field_panel("Truth, summed into the sites' cells", truth, outline, SIDE_MM),
    ]
    return Outcome(records=records, panels=panels)


def _as_field(like: Field, force_n: Any) -> Field:
    from dataclasses import replace

    return replace(like, force_n=force_n)


def _figure_10(bench: Bench) -> Outcome:
    """Add the solution without any constraint, which the paper says diverged."""
    constrained = _field_entry(bench, DIFFERENCE)
    grown, away, drawn = [], [], None
    for seed in bench.seeds("kamiyama"):
        seen = _press(bench, seed)
        free = _solve(bench, seen, FREE)
        truth = true_field(seen.rig, seen.state, free.site_mm)
        grown.append(float(np.abs(free.force_n).max() / np.abs(truth).max()))
        away.append(float(np.linalg.norm(strongest_mm(free))))
        drawn = drawn or free
    assert drawn is not None
    quiet = _press(bench, bench.seed, "noise", {"ccd.noise": False})
    still = _solve(bench, quiet, FREE)
    truth = true_field(quiet.rig, quiet.state, still.site_mm)
    size, place = float(np.abs(still.force_n).max() / np.abs(truth).max()), float(np.linalg.norm(strongest_mm(still)))
    records = (
        Record(
            quantity="no constraint: largest force over the true largest (the paper: diverged greatly)", unit="",
            **over(grown), explained_by=(Cause(cause=NO_NOISE, value=size),),
        ),
        Record(
            quantity="no constraint: distance of the strongest force from the pillar's axis (the paper: clearly "
            "another)",
            unit="mm", **over(away), explained_by=(Cause(cause=NO_NOISE, value=place),),
        ),
    )  # fmt: skip
    panel = field_panel("No constraint", drawn, circle_mm(2.5), SIDE_MM)
    return Outcome(records=[*constrained.records, *records], panels=[*constrained.panels, panel])


def _figure_13(bench: Bench) -> Outcome:
    """Set the field before camera calibration beside the one after it."""
    before = _field_entry(bench, BLIND)
    after = _press(bench, bench.seed)
    return Outcome(
        records=before.records,
        panels=[
            *before.panels,
            field_panel("After camera calibration (Fig. 11)", _solve(bench, after, NORM), circle_mm(2.5), SIDE_MM),
        ],
    )


_PROTOCOL = (
    f"A 5 mm pillar presses along z at the middle ({PILLAR_N:g} N, assumed); the paper's tracker, the paper's "
    "half-space with the projection of all three axes, the paper's constraint, its weight chosen by this project as "
    "the paper gives none."
)
FIGURE_10 = Entry(
    name="kamiyama/fig-10",
    title="Force field by the least norm of differences, and without any constraint",
    source="Kamiyama, section 4.3.1, Fig. 10, equations 11 and 12",
    protocol=_PROTOCOL + " Differences are taken in two dimensions and per component: equation 11's chain wraps at the "
    "ends of rows.",
    run=_figure_10,
)
FIGURE_11 = Entry(
    name="kamiyama/fig-11",
    title="Force field by the least norm",
    source="Kamiyama, section 4.3.1, Fig. 11, equations 14 and 15",
    protocol=_PROTOCOL,
    run=lambda bench: _field_entry(bench, NORM),
)
FIGURE_12 = Entry(
    name="kamiyama/fig-12",
    title="Force field with pushes only",
    source="Kamiyama, section 4.3.1, Fig. 12, equation 13 with the differences of equation 11",
    protocol=_PROTOCOL,
    run=lambda bench: _field_entry(bench, PUSHES),
)
FIGURE_13 = Entry(
    name="kamiyama/fig-13",
    title="Force field before camera calibration",
    source="Kamiyama, sections 2.5 and 4.3.1, Fig. 13",
    protocol=_PROTOCOL + " Before camera calibration the transfer leaves the motion along z out.",
    run=_figure_13,
)
