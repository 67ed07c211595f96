"""The finger: its picture and fields (Sato's Figs. 6 and 7), the 75 calibration presses, and the
resolution of magnitude (Fig. 8) and place (Fig. 9)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints
from twin.judge.score import full_width
from twin.sense.calibration import Calibration
from twin.show.reproduction_page import Panel
from twin.study.reproduce.bench import (
    FIRST_EXPOSURE,
    MADE,
    OUR_TRACKER,
    OUR_TRACKER_INSTEAD,
    PRELOAD_GF,
    QUIET,
    READ_GF,
    Bench,
    Chain,
    Entry,
    ForceLine,
    Measure,
    Reading,
    Rig,
    Shot,
    Trial,
    sphere_press,
)
from twin.study.reproduce.record import Numbers, Quantity, Record, Unprinted
from twin.study.sensor import Motion

PITCH_MM, STEP_MM = 2.5, 0.5
EXPOSURES, REPEATS = 5, 5
FORCE_GF = 200.0
AXES = ("x", "y", "z")
PLACES = {"centre": (0.0, 0.0), "edge": (5.0, 0.0)}
"""First of the two adjacent calibrated points; the second lies one pitch further in, along x, or
along y."""

OUR_WAY: dict[str, Any] = {"tracking.method": OUR_TRACKER}
FEW: dict[str, Any] = {
    f"{table}.{key}": 1
    for table in ("calibration.presses", "reconstruction.sites")
    for key in ("columns", "rows")
}
"""The quick form presses one point."""

COMPRESSED = {"ccd.jpeg_quality": 99}
"""What all numbers of Table I want (`twin.study.reproduce.shifted.QUALITY`)."""

CELL = Unprinted(
    "standard deviation of the six-axis force sensor, compressed as Table I wants it",
    "N",
    (0.005, 0.05, 0.1, 0.15),
    "from a sensor made for 1 N to 1 % of one made for 15 N; its type isn't printed. With 0.3 N "
    "the presses of 1 N no longer determine the matrix",
)
ASIDE = Unprinted(
    "how far from the apex the probe is placed in four of the five repeats",
    "mm",
    (0.0, 1.0),
    "a stage moved by hand repeats to 0.01 to 0.1 mm, an eye to 1 mm",
)
SMOOTH = "inverse: smooth instead of the pseudo-inverse"
WIDEST = "largest difference of measured and applied force"
READ = "reading: the largest difference of measured and applied force instead of the scatter"

PAPER = Chain(paper="sato", method="pinv")
"""The paper's tracker, calibration and inverse."""


def _ways(bench: Bench) -> dict[str, Chain]:
    """Return the paper's chain with one cause off, by name; the quick form keeps the
    calibration."""
    too = "" if bench.quick else ", in the calibration too"
    return {
        f"noise of the picture off{too}": replace(PAPER, overrides=QUIET, calibrated_by=QUIET),
        f"{OUR_TRACKER_INSTEAD}{too}": replace(PAPER, tracker=OUR_TRACKER, calibrated_by=OUR_WAY),
        SMOOTH: replace(PAPER, method="smooth"),
    }


def _weighed(deviation_n: float) -> Chain:
    """Return the paper's chain with another force sensor, compressed as Table I wants it."""
    cell = {"calibration.load_cell_n": deviation_n, **COMPRESSED}
    return replace(PAPER, overrides=cell, calibrated_by=cell)


def _site_errors(made: Calibration, wanted: Calibration) -> Floats:
    """Return (k,) the relative difference of two transfer matrices by site."""
    sites = len(made.site_mm)
    known = np.isfinite(made.transfer).all(axis=1) & np.isfinite(wanted.transfer).all(axis=1)
    one, other = (
        c.transfer[known].reshape(-1, sites, 3).transpose(1, 0, 2) for c in (made, wanted)
    )
    return np.asarray(np.linalg.norm(one - other, axis=(1, 2)) / np.linalg.norm(other, axis=(1, 2)))


def _calibration(bench: Bench) -> Entry.Outcome:
    """Calibrate, and calibrate again with one source of error off; every press is solved once."""
    few = FEW if bench.quick else {}
    made = bench.by_presses(few)
    bench.progress("once more without errors", 0.8)
    no_cell = {"calibration.load_cell_n": 0.0}
    exact = bench.by_presses(few | {"ccd.preset": "ideal"} | no_cell | OUR_WAY)
    off = {
        "noise of the picture off": QUIET,
        "noise of the load cell off": no_cell,
        OUR_TRACKER_INSTEAD: OUR_WAY,
    }
    variants: dict[str, Floats] = {}
    for name, overrides in off.items():
        bench.progress(name, 0.85 + 0.05 * len(variants))
        variants[name] = _site_errors(bench.by_presses(few | overrides), exact)
    drawing = bench.rig("sato", overrides=few | {"calibration.method": "compliance"}).calibration
    name = "drawing instead of presses: the nominal finger's compliance"
    variants[name] = _site_errors(drawing, exact)
    # Error of the transfer matrix by site: the sites of the edge apart from the inner ones.
    errors = _site_errors(made, exact)
    at = np.arange(len(errors)).reshape(made.grid)
    edge = np.unique(np.concatenate([at[0], at[-1], at[:, 0], at[:, -1]]))
    inner = np.setdiff1d(at.ravel(), edge)
    parts = {f"the {len(edge)} points of the edge": edge, f"the {len(inner)} inner points": inner}
    if bench.quick:
        parts = {"the point": at.ravel()}
    records: list[Record] = []
    for name, rows in parts.items():
        # runs are sites; with a cause off it is their mean
        error = Quantity(f"error of H at {name}, against the same presses without noise")
        means = {cause: {error: float(e[rows].mean())} for cause, e in variants.items()}
        records += Record.of_runs([{error: each} for each in errors[rows].tolist()], means)
    # Numbers that the paper prints, and the picture of the errors.
    columns = made.transfer[np.isfinite(made.transfer).all(axis=1)]
    records += Record.of_runs(
        [
            {
                Quantity("presses", paper=None if bench.quick else 75.0): 3.0 * len(made.site_mm),
                Quantity("condition number of H"): float(np.linalg.cond(columns)),
                Quantity("noise of a shift, as the tracker has it", "px"): made.noise_px,
            }
        ]
    )
    drawn = {"as published": errors, **variants}
    panel = Panel.strips("Error of H, a dot for each point", "error over its size", drawn)
    return Entry.Outcome(records=records, panels=(panel,))


def _figure_6(bench: Bench) -> Entry.Outcome:
    trials = bench.trials("sato", pressed=False)
    rigs = [PAPER.rig(bench, trial) for trial in trials]
    sensor = bench.rig("sato").sensor
    points = sensor.sites.centre_mm
    width, found = Record.of_runs([rig.rest_numbers(15.0, 5.0) for rig in rigs])
    pressed = Quantity("points where force is applied", paper=25.0)
    picture = rigs[0].picture(None, 0)
    marks = sensor.project(points, "nominal")
    panels = (
        Panel.picture(title="The picture at rest", picture=picture),
        Panel.picture(
            title="The 25 points where force is applied", picture=picture, marks_px=marks
        ),
    )
    records = (width, *Record.of_runs([{pressed: float(len(points))}]), found)
    return Entry.Outcome(records=records, panels=panels)


def _shot_numbers(shot: Shot) -> Numbers:
    return {
        Quantity(name, unit, runs="exposures"): shot.score(key)
        for name, unit, key in (
            ("field error", "", "field_error"),
            ("error of the total force", "", "total_force_error"),
            ("error of the centre of pressure", "mm", "centre_error_mm"),
        )
    }


def _figure_7(bench: Bench) -> Entry.Outcome:
    places = {"on a calibrated point": (0.0, 0.0)}
    if not bench.quick:
        places["between four"] = bench.rig("sato").above((1.25, 1.25))
    trials = [Trial(exposures=k) for k in range(EXPOSURES)]
    records: list[Record] = []
    panels: list[Panel] = []
    for where, at in places.items():
        bench.progress(where, 0.6)
        press = bench.pressing(sphere_press(at, 100), 30)
        label = f"3 mm sphere, 100 gf, {where}"
        found, (first, *_), _ = bench.compare(
            press, _shot_numbers, PAPER, _ways(bench), trials, label=label
        )
        records += found
        if not panels:
            panels.append(Panel.shifts("Markers under the sphere", first.found))
        radius = first.state.contact_radius_mm
        panels.append(Panel.field(f"Force field, sphere {where}", first.field, radius, at))
    return Entry.Outcome(records=records, panels=panels)


def _line_numbers(repeats: int, run: ForceLine) -> Numbers:
    scatter = ((run.measured_gf - run.measured_gf.mean()) ** 2).sum()
    runs = _resolution(repeats).runs
    return {
        Quantity("slope of measured over applied force", runs=runs): run.fit[0],
        Quantity("R squared", runs=runs): 1.0 - run.squares / scatter,
        _resolution(repeats): run.resolution_gf,
        Quantity(WIDEST, "gf", runs=runs): run.widest_gf,
    }


def _resolution(repeats: int) -> Quantity:
    what = "resolution: smallest difference two readings resolve at 95 %"
    return Quantity(what, "gf", paper=READ_GF, runs=f"runs of {repeats} repeats")


def _figure_8(bench: Bench) -> Entry.Outcome:
    steps, repeats = (3, 2) if bench.quick else (10, REPEATS)
    read = Reading[ForceLine](lambda run: {_resolution(repeats): run.widest_gf})
    records: list[Record] = []
    panels = []
    for axis, name in enumerate(AXES):
        if bench.quick and name != "z":
            continue
        bench.progress(f"cylinder along {name}", axis / 3)

        # The readings of one chain along an axis, and the numbers that are drawn from them.
        def line(way: Chain, trial: Trial, axis: int = axis, aside_mm: float = 0.0) -> ForceLine:
            times = 1 if way.calibrated_by == QUIET else repeats
            first = FIRST_EXPOSURE + trial.exposures
            return ForceLine.of(bench, way, axis, steps, times, first, aside_mm)

        def placed(aside: float, line: Any = line) -> Measure[ForceLine]:
            return partial(line, aside_mm=aside)

        # Compare with the paper, and with each cause off.
        found, (first, *_), _ = bench.compare(
            line,
            partial(_line_numbers, repeats),
            PAPER,
            {**_ways(bench), READ: read},
            bench.trials("sato"),
            {} if bench.quick else {CELL: _weighed, ASIDE: placed},
            name,
        )
        records += found
        reach = np.array([0.0, PRELOAD_GF])
        curves = {
            "readings": (first.applied_gf, first.measured_gf, "."),
            "line": (reach, np.polyval(first.fit, reach)),
            "as applied": (reach, reach, ":"),
        }
        panels.append(Panel.curves(f"Along {name}", "applied (gf)", "measured (gf)", curves))
    note = (
        f"{repeats} repeats are of one probe path, each level with a picture and a load-cell "
        "reading of its own. Force is read at the moment of the picture, so rubber that relaxes "
        "changes both."
    )
    return Entry.Outcome(records=records, panels=panels, notes=(note,))


def _curve(distance_mm: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Return sorted distances, equal ones averaged, and normalised magnitudes."""
    at, which = np.unique(distance_mm.round(3), return_inverse=True)
    return at, np.bincount(which, size) / np.bincount(which)


def _jump(distance_mm: Floats, size: Floats) -> float:
    """Return how far normalised magnitudes near the middle stand off a quartic within a pitch of
    it: half of a peak 3 mm wide falls by a sixth every 0.5 mm, so neighbours differ anyhow."""
    near = np.abs(distance_mm) <= PITCH_MM + 1e-9
    at, size = distance_mm[near], size[near]
    middle = np.abs(at) <= PITCH_MM / 2 + 1e-9
    return float(np.abs(size - np.polyval(np.polyfit(at, size, 4), at))[middle].max())


def _row(rig: Rig, along: int, across_mm: float) -> tuple[Ints, Floats]:
    """Return the numbers of a row's sites, and their places along it, mm."""
    chart = rig.scene.inverse.sites.chart()
    row = np.flatnonzero(np.abs(chart[:, 1 - along] - across_mm) < 1e-6)
    return row, chart[row, along]


def _spread(
    bench: Bench, place: str, along: int, step_mm: float, chain: Chain, trial: Trial
) -> tuple[Floats, Floats]:
    """Press between two calibrated points; return distances of a row's sites, mm, and
    magnitudes."""
    rig = chain.rig(bench, trial)
    start = PLACES[place]
    inward = -1.0 if place == "edge" and along == 0 else 1.0
    row, sites = _row(rig, along, start[1 - along])
    distances, sizes = [], []
    for number, offset in enumerate(np.arange(0.0, PITCH_MM + 1e-9, step_mm)):
        s, t = start
        at = (s + inward * offset, t) if along == 0 else (s, t + offset)
        press = sphere_press(rig.above(at), FORCE_GF)
        field = chain.shot(bench, press, trial, 3000 + number).field
        distances.append(sites - at[along])
        sizes.append(np.linalg.norm(field.force_n[row], axis=1))
    size = np.concatenate(sizes)
    return np.concatenate(distances), size / size.max()


def _dip(bench: Bench, chain: Chain, apart_mm: float) -> float:
    """Return how far the magnitude drops between two presses at once along x, over the lower
    peak."""
    rig = chain.rig(bench)
    presses = [
        sphere_press(rig.above((x, 0.0)), FORCE_GF / 2) for x in (apart_mm / 2, -apart_mm / 2)
    ]
    one, other = (rig.motion(rig.press(press).load) for press in presses)
    both = Motion(
        displacement_mm=one.displacement_mm + other.displacement_mm,
        gradient=one.gradient + other.gradient,
        error=max(one.error, other.error),
    )
    field = chain.solved(bench, rig, rig.track(rig.picture(both, 3900)))
    row, sites = _row(rig, 0, 0.0)
    size = np.linalg.norm(field.force_n[row[np.argsort(sites)]], axis=1)
    middle = len(size) // 2
    peak = min(float(size[:middle].max()), float(size[middle + 1 :].max()))
    return 1.0 - float(size[middle]) / peak


def _spread_numbers(run: tuple[Floats, Floats]) -> Numbers:
    width = Quantity("full width at half maximum", "mm", paper=5.0, runs="exposures")
    jump = Quantity(
        "largest jump off a smooth curve near the middle, of the largest magnitude",
        runs="exposures",
    )
    return {width: full_width(*_curve(*run)), jump: _jump(*run)}


def _figure_9(bench: Bench) -> Entry.Outcome:
    # The chain of the paper, and what is changed in it to find the causes.
    step = 1.25 if bench.quick else STEP_MM
    nominal = replace(PAPER, calibrated_by="compliance")
    ways = _ways(bench) | {
        "calibration: the drawing's compliance instead of the presses": nominal,
        "calibration and inverse": replace(nominal, method="smooth"),
    }
    records: list[Record] = []
    panels = []
    trials = [Trial(exposures=200 * k) for k in range(1 if bench.quick else MADE)]
    for number, place in enumerate(("centre",) if bench.quick else PLACES):
        curves: dict[str, tuple[Any, ...]] = {}
        # A press at each place, read along both axes.
        for along in (0,) if bench.quick else (0, 1):
            label = f"along {AXES[along]}"
            where = f"{place}, {label}"
            bench.progress(where, (2 * number + along) / 4)
            measure = partial(_spread, bench, place, along, step)
            ranges = {} if bench.quick else {CELL: _weighed}
            found, runs, off = bench.compare(
                measure, _spread_numbers, PAPER, ways, trials, ranges, where
            )
            records += found
            curves[label] = (*_curve(*runs[0]), "o-")
            curves[f"{label}, smooth inverse"] = (*_curve(*off[SMOOTH]), ":")
        title = f"{place.capitalize()}: magnitude against distance from the press"
        up = "magnitude over its largest"
        panels.append(Panel.curves(title, "distance (mm)", up, curves, levels={"half": 0.5}))
    notes = [] if bench.quick else [_on_the_jump(records)]
    # Two presses at once: the dip of the field between them.
    if not bench.quick:
        bench.progress("two presses at once", 0.95)
        dip = Quantity("two spheres of 100 gf 5 mm apart along x: dip between them")
        off_dip = {
            name: {dip: _dip(bench, way, 5.0)}
            for name, way in _ways(bench).items()
            if way.tracker is None
        }
        records += Record.of_runs([{dip: _dip(bench, PAPER, 5.0)}], off_dip)
    return Entry.Outcome(records=records, panels=panels, notes=notes)


def _on_the_jump(records: Sequence[Record]) -> str:
    """Return whether the jump goes with the pseudo-inverse; means over places and directions."""
    jumps = [record for record in records if "jump" in record.quantity.name]
    had = float(np.mean([record.twin for record in jumps]))
    left = {
        cause: float(np.mean([record.explained_by[cause] for record in jumps]))
        for cause in jumps[0].explained_by
    }
    gone = "is refuted in the twin: another inverse leaves more than half of it"
    if left[SMOOTH] < had / 2:
        gone = "is confirmed: another inverse more than halves it"
    others = "; ".join(f"{cause}: {value:.2g}" for cause, value in left.items())
    return (
        f"The paper blames the discontinuity near the centre on the pseudo-inverse. That {gone}. "
        f"Magnitudes near the middle stand up to {had:.2g} of the largest off a smooth curve, as "
        f"published; {others}."
    )


FINGER_FIGURES: dict[str, Callable[[Bench], Entry.Outcome]] = {
    "sato/fig-6": _figure_6,
    "sato/calibration": _calibration,
    "sato/fig-7": _figure_7,
    "sato/fig-8": _figure_8,
    "sato/fig-9": _figure_9,
}
