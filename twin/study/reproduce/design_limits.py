"""What each sensor can reach: the papers' own predictions, the causes that limit each design, the
papers' hardware with this project's software, and seconds (Sato's Table II).

Times are CPU times of one thread for one frame that has arrived; capture is not part of them.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Floats, Picture
from twin.judge.score import full_width
from twin.parts.load import Traction
from twin.parts.press import Press
from twin.parts.sweep import GF
from twin.sense.reconstruct import Field, reconstruct
from twin.sense.track import Tracker
from twin.show.reproduction_page import Panel
from twin.study.calibrate import half_space_compliance
from twin.study.reproduce.bench import (
    FIRST_EXPOSURE,
    KAMIYAMA,
    ONCE,
    OUR_TRACKER,
    PILLAR_PRESS,
    READ_GF,
    RESOLVED,
    SATO,
    SCENES,
    Bench,
    Chain,
    Entry,
    ForceLine,
    Protocol,
    Rig,
    Trial,
    sphere_press,
)
from twin.study.reproduce.record import Numbers, Quantity, Record
from twin.theory.limit import DIP, Limit

FORCE_N, HUMAN_MM = 1.0, 2.0
DISTANCES_MM = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
DRAWN: dict[str, Any] = {"calibration.method": "compliance"}
FINE_SITES: dict[str, Any] = {**DRAWN, "reconstruction.sites.pitch_mm": 1.0}
INDUSTRIAL: dict[str, Any] = {"ccd.preset": "industrial", "ccd.read_noise_e": 12.0}


def _layers(red: Mapping[str, float], blue: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return overrides of both layers of markers, equal ones if one is given."""
    both = {"red": red, "blue": red if blue is None else blue}
    return {f"markers.{name}.{k}": v for name, layer in both.items() for k, v in layer.items()}


CLOSER = _layers({"pitch_mm": 1.0, "diameter_mm": 0.35})
SHALLOWER = _layers({"depth_mm": 2.0}, {"depth_mm": 1.0})
SMALL = {"pitch_mm": 1.0, "diameter_mm": 0.2}
FINER: dict[str, Any] = {
    **_layers({**SMALL, "columns": 11, "rows": 11}, {**SMALL, "columns": 12, "rows": 12}),
    **FINE_SITES,
    "reconstruction.sites.columns": 11,
    "reconstruction.sites.rows": 11,
}
_BETTER = Chain(paper="kamiyama", overrides=FINE_SITES, tracker=OUR_TRACKER, method="smooth")
_QUIET = FINE_SITES | INDUSTRIAL
FLAT = {
    "as published": Chain(paper="kamiyama"),
    "better software: tracker, block, smoothness": _BETTER,
    "and a quiet camera": replace(_BETTER, overrides=_QUIET),
    "and markers 1 mm apart": replace(_BETTER, overrides=_QUIET | CLOSER),
    "and markers 1 and 2 mm deep": replace(_BETTER, overrides=_QUIET | CLOSER | SHALLOWER),
}
"""Steps from the published sensor to one that resolves 2 mm, each with those before it."""

FLAT_CHANGES: dict[str, dict[str, Any]] = {
    "as published": {},
    "noise off": {"ccd.noise": False},
    "markers 3 and 1.5 mm deep": _layers({"depth_mm": 3.0}, {"depth_mm": 1.5}),
    "markers 1 mm apart": CLOSER,
    "by the real block": DRAWN,
    "made exactly as drawn": {"tolerance.preset": "none"},
}
FINGER_CHANGES: dict[str, dict[str, Any]] = {
    "as published, by its drawing": DRAWN,
    "noise off": DRAWN | {"ccd.noise": False},
    "markers 1 mm apart": FINER,
    "markers 1.0 and 2.0 mm deep": DRAWN | {"markers.red.depth_mm": 1.0},
    "made exactly as drawn": DRAWN | {"tolerance.preset": "none"},
}


FRAME_S, CALCULATED_US = 0.08, 545.0
"""What the papers print for one sensor: a frame with its capture (Kamiyama), its calculation alone
(Sato)."""

WIDTH = "full width at half maximum of a narrow force"
LEAST = "least distance of two narrow forces"
LEAST_GF = "smallest difference of force"
NOISE = "noise of a shift"
"""Names of what is measured of every design."""

BEFORE = 0.9
"""Share of the markers' motion that the frame before had shown: a tracker that follows them starts
from there."""

TRIALS = 100
WARM = 3
READINGS = 10
RATED = 20
CAMERA = "capture chain: an industrial camera"
PAPERS = "tracker, calibration and inverse: the paper's"
DEFAULT = "inverse: smooth, as scenes have it"


def _along_x(found: Field, *, magnitude: bool = False) -> tuple[Floats, Floats]:
    """Return x, mm, and the push or the magnitude, N, on the two rows of sites nearest to y = 0."""
    y = np.abs(found.site_mm[:, 1])
    row = y < y.min() + 1e-6
    x = np.unique(found.site_mm[row, 0].round(6))
    size = np.linalg.norm(found.force_n, axis=1) if magnitude else found.force_n[:, 2]
    near = [row & (np.abs(found.site_mm[:, 0] - at) < 1e-3) for at in x]
    return x, np.array([float(size[mine].mean()) for mine in near])


def _point_width_mm(bench: Bench, chain: Chain, trial: Trial = ONCE) -> float:
    """Return the full width at half maximum of the magnitude of a narrow force's estimate, mm: the
    push's alone would flatter an inverse that swings from site to site."""
    found = chain.narrow(bench, (0.0,), FORCE_N, 60, trial)
    return full_width(*_along_x(found, magnitude=True), at_least=True)


def _two_points_mm(bench: Bench, chain: Chain, trial: Trial = ONCE) -> float:
    """Return the least distance, mm, of two narrow forces with a dip of a fifth; else the
    largest."""
    for number, apart in enumerate(DISTANCES_MM):
        ends = (-apart / 2, apart / 2)
        x, push = _along_x(chain.narrow(bench, ends, FORCE_N, 70 + number, trial))
        peak = float(np.interp(ends, x, push).min())
        if peak > 0 and 1.0 - float(np.interp(0.0, x, push)) / peak >= DIP:
            return apart
    return DISTANCES_MM[-1]


def _shift_noise_px(bench: Bench, chain: Chain) -> float:
    """Return the standard deviation of a shift per axis between two pictures at rest, px."""
    rig = chain.rig(bench)
    return rig.track(rig.picture(None, 55), chain.tracker).scatter_px


def _limit_of(rig: Rig, noise_px: float) -> Limit:
    """Return the closed-form limit of a nominal design at a tracker's noise."""
    material, layers = rig.scene.material, rig.scene.markers
    scale = np.linalg.norm(rig.image_scale[:, 0, :2], axis=1)
    markers = rig.sensor.actual.markers
    return _limits(
        np.array([[layer.depth_mm for layer in layers.values()]]),
        np.array([[layer.pitch_mm for layer in layers.values()]]),
        np.array([[noise_px / float(scale[markers.of(name)].mean()) for name in layers]]),
        material.youngs_modulus_mpa,
        material.poisson_ratio,
    )


def _limits(
    depth_mm: Floats, pitch_mm: Floats, noise_mm: Floats, modulus_mpa: float, ratio: float
) -> Limit:
    """Return the closed-form limit of (m, layers) designs under `FORCE_N` on discs of 1 mm
    radius."""
    return Limit.of(
        depth_mm=depth_mm,
        pitch_mm=pitch_mm,
        noise_mm=noise_mm,
        youngs_modulus_mpa=np.array(modulus_mpa),
        poisson_ratio=np.array(ratio),
        force_n=np.array(FORCE_N),
        radius_mm=np.array(1.0),
    )


def _limit_numbers(limit: Limit) -> Numbers:
    """Return a design's closed-form limits as numbers of their own."""
    return {
        Quantity("closed-form limit of the least distance of two forces", "mm"): float(
            limit.two_point_mm[0]
        ),
        Quantity("closed-form limit of the width of a narrow force", "mm"): float(
            limit.fwhm_normal_mm[0]
        ),
    }


def _conclusion(bench: Bench) -> Entry.Outcome:
    records: list[Record] = []
    for number, (name, chain) in enumerate(FLAT.items()):
        if bench.quick and number in (1, 2, 3):
            continue
        bench.progress(name, number / len(FLAT))
        noise = _shift_noise_px(bench, chain)
        least = "least distance of two narrow forces with a dip of a fifth (2 mm is wanted)"
        numbers = {
            Quantity(least, "mm"): _two_points_mm(bench, chain),
            Quantity(WIDTH, "mm"): _point_width_mm(bench, chain),
            Quantity(NOISE, "px"): noise,
            **_limit_numbers(_limit_of(chain.rig(bench), noise)),
        }
        records += Record.of_runs([numbers], label=name)
    return Entry.Outcome(records=records, panels=(_limit_curves(),))


def _limit_curves() -> Panel:
    """Draw the closed-form limit against noise for the designs on the way."""
    noise_px = np.geomspace(0.003, 0.3, 25)
    noise_mm = np.repeat(0.05 * noise_px[:, None], 2, axis=1)
    curves = {}
    for name, red, blue, pitch in (
        ("6 and 3 mm deep, 1.5 mm apart (published)", 6.0, 3.0, 1.5),
        ("6 and 3 mm deep, 1 mm apart", 6.0, 3.0, 1.0),
        ("3 and 1.5 mm deep, 1 mm apart", 3.0, 1.5, 1.0),
        ("2 and 1 mm deep, 1 mm apart", 2.0, 1.0, 1.0),
        ("2 and 1 mm deep, 1.5 mm apart", 2.0, 1.0, 1.5),
    ):
        depth = np.tile([red, blue], (len(noise_px), 1))
        limit = _limits(depth, np.full(depth.shape, pitch), noise_mm, 1.0, 0.5)
        curves[name] = (np.log10(noise_px), limit.two_point_mm)
    return Panel.curves(
        "Two-point limit of a design, whatever the software",
        "log10 of a shift's noise (px)",
        "least distance (mm)",
        curves,
        levels={"2 mm": HUMAN_MM},
    )


def _predicted(bench: Bench, name: str, chain: Chain, printed_mm: float | None) -> list[Record]:
    """Return the widths and the least distance of a finger, with causes off, and its limits."""
    quiet = {**chain.overrides, **INDUSTRIAL}
    ours = replace(chain, tracker=OUR_TRACKER, method="smooth")
    ways = {"tracker and inverse: this project's": ours}
    if not bench.quick:
        ways = {
            CAMERA: replace(chain, overrides=quiet),
            **ways,
            "camera, tracker and inverse": replace(ours, overrides=quiet),
        }
    width = "full width at half maximum"
    least = "least distance of two narrow forces with a dip of a fifth"

    def run(way: Chain, trial: Trial) -> Numbers:
        found = {}
        for force in (200.0,) if bench.quick else (200.0, 20.0):
            under = f"{width} under the 3 mm sphere at {force:g} gf"
            paper = printed_mm if force == 200 else None
            press = sphere_press((0.0, 0.0), force)
            field = way.shot(bench, press, trial, 80).field
            found[Quantity(under, "mm", paper=paper, runs="exposures")] = full_width(
                *_along_x(field, magnitude=True), at_least=True
            )
        narrow = Quantity(
            f"{width} of a narrow force of 1 N", "mm", paper=printed_mm, runs="exposures"
        )
        return found | {
            narrow: _point_width_mm(bench, way, trial),
            Quantity(least, "mm", runs="exposures"): _two_points_mm(bench, way, trial),
        }

    noise = _shift_noise_px(bench, chain)
    records = bench.compare(run, dict, chain, ways, label=name)[0]
    limits = _limit_numbers(_limit_of(chain.rig(bench), noise))
    return records + Record.of_runs([{Quantity(NOISE, "px"): noise, **limits}], label=name)


def _prediction(bench: Bench) -> Entry.Outcome:
    made = Chain(paper="sato", overrides=DRAWN, method="pinv")
    chains = {
        "pitch 2.5 mm, diameter 0.5 mm, as made": made,
        "pitch 1.0 mm, diameter 0.2 mm, as predicted": replace(made, overrides=FINER),
    }
    records: list[Record] = []
    for number, ((name, chain), printed) in enumerate(
        zip(chains.items(), (None, 2.0), strict=True)
    ):
        bench.progress(name, number / 2)
        records += _predicted(bench, name, chain, printed)
    return Entry.Outcome(records=records, panels=[_narrow_forces(bench, chains)])


def _narrow_forces(bench: Bench, chains: Mapping[str, Chain]) -> Panel:
    curves = {}
    for name, chain in chains.items():
        smooth = replace(chain, method="smooth", tracker=OUR_TRACKER)
        for way, used in (("pseudo-inverse", chain), ("smooth", smooth)):
            x, size = _along_x(used.narrow(bench, (0.0,), FORCE_N, 60), magnitude=True)
            curves[f"{name.split(',')[0]}, {way}"] = (x, size / np.abs(size).max(), "o-")
    return Panel.curves("A narrow force of 1 N", "x (mm)", "magnitude over its largest", curves)


def _half_space(bench: Bench) -> Entry.Outcome:
    """Compare the papers' formula with the real block, for equal material and load."""
    rig = bench.rig("kamiyama", overrides={"tolerance.preset": "none"})
    markers = rig.sensor.nominal_markers
    points = markers.points
    numbers: dict[Quantity, float] = {}
    curves = {}
    for axis, name in enumerate("xyz"):
        x, y, z = np.eye(3)[axis].tolist()
        load = Traction.rectangle((0.0, 0.0), (4.0, 4.0), (x, y, z))
        real = rig.sensor.displacement(points, load)
        pieces = rig.sensor.rectangles(load)
        compliance = half_space_compliance(rig.scene, points, pieces)
        formula: Floats = (compliance @ pieces.force_n.ravel()).reshape(-1, 3)
        for layer in ("red", "blue"):
            mine = markers.layer == layer
            gap = np.linalg.norm(formula[mine] - real[mine], axis=1).max()
            what = f"force along {name}, {layer} layer: half-space off by, over the largest motion"
            numbers[Quantity(what)] = float(gap / np.linalg.norm(real[mine], axis=1).max())
        if axis == 1:
            continue
        row = np.flatnonzero((markers.layer == "blue") & (np.abs(points[:, 1]) < 0.8))
        row = row[np.argsort(points[row, 0])]
        for world, moved, style in (("block", real, "-"), ("half-space", formula, ":")):
            curves[f"f{name}: {world}"] = (points[row, 0], 1e3 * moved[row, axis], style)
    panel = Panel.curves(
        "Blue layer along the x axis, 1 N on 4 x 4 mm: motion along the force",
        "x (mm)",
        "motion (µm)",
        curves,
    )
    return Entry.Outcome(records=Record.of_runs([numbers]), panels=(panel,))


def _limiting_causes(bench: Bench) -> Entry.Outcome:
    """Change one thing at a time, with the paper's tracker and inverse."""
    records: list[Record] = []
    panels: list[Panel] = []
    far = {"lens: seen from far away": bench.rig("kamiyama").far_away()}
    for number, (label, own, changes) in enumerate(
        (
            ("Flat sensor", Chain(paper="kamiyama", method="norm"), {**FLAT_CHANGES, **far}),
            ("Finger", Chain(paper="sato", method="pinv"), FINGER_CHANGES),
        )
    ):
        width: dict[str, float] = {}
        apart: dict[str, float] = {}
        limits: list[Limit] = []
        kept = list(changes.items())[: 2 if bench.quick else None]
        for step, (name, overrides) in enumerate(kept):
            what = f"{own.paper}, {name}"
            bench.progress(what, (number + step / len(kept)) / 2)
            chain = replace(own, overrides=overrides)
            noise = max(_shift_noise_px(bench, chain), 1e-3)
            limits.append(_limit_of(chain.rig(bench), noise))
            width[name] = _point_width_mm(bench, chain)
            apart[name] = _two_points_mm(bench, chain)
            numbers = {
                Quantity(WIDTH, "mm"): width[name],
                Quantity(LEAST, "mm"): apart[name],
                Quantity(NOISE, "px"): noise,
                **_limit_numbers(limits[-1]),
            }
            records += Record.of_runs([numbers], label=what)
        of_width = [float(limit.fwhm_normal_mm[0]) for limit in limits]
        of_two = [float(limit.two_point_mm[0]) for limit in limits]
        at_half = "full width at half maximum (mm)"
        panels += [
            _bars(f"{label}: width of a narrow force", at_half, width, of_width),
            _bars(f"{label}: two forces resolved", "least distance (mm)", apart, of_two),
        ]
    return Entry.Outcome(records=records, panels=panels)


def _bars(title: str, across: str, values: Mapping[str, float], limits: list[float]) -> Panel:
    """Return the drawing of a length by design, with the limit of each."""

    def draw(axes: Any) -> None:
        axes.barh(list(values), list(values.values()), color="#7d8894")
        kept = np.where(np.isfinite(limits), limits, np.nan)
        axes.plot(kept, list(values), "|", ms=14, mew=2.5, label="closed-form limit of the design")
        axes.set_ylim(len(values) - 0.4, -1.4)  # room for the legend
        axes.set_xlabel(across)

    return Panel(title=title, draw=draw)


def _frame_seconds(
    rig: Rig, pictures: list[Picture], count: int, chain: Chain, before_px: Floats
) -> Floats:
    """Return (count,) CPU seconds from frames to force fields, tracked from the frame before."""
    rest = rig.rest(chain.tracker)
    how = rig.calibration
    seconds = np.zeros(WARM + count)
    for number in range(len(seconds)):
        started = time.process_time()
        for picture in pictures:
            found = Tracker.motion(rest, picture, before_px)
            reconstruct(found, how, method=chain.method, **chain.options)
        seconds[number] = time.process_time() - started
    return seconds[WARM:]


def _timed(
    name: str, unit: str, paper: float | None, times: Floats, value: float | None = None
) -> Record:
    """Return the record of the mean of times with its spread, or of another number of them."""
    quantity = Quantity(name, unit, paper=paper, timed=True)
    if value is not None:
        return Record(quantity=quantity, twin=value, n=len(times))
    spread = float(times.std(ddof=1))
    return Record(quantity=quantity, twin=float(times.mean()), spread=spread, n=len(times))


def _rate_of(seconds: Floats) -> float:
    return float(1.0 / np.median(seconds))


def _sorted_times(
    curves: Mapping[str, Floats], across: str, unit: str, levels: Mapping[str, float]
) -> Panel:
    """Draw the sorted times of every way by name."""
    count = len(next(iter(curves.values())))
    return Panel.curves(
        f"{count} {across}s, sorted",
        across,
        f"time ({unit})",
        {name: (np.arange(count), np.sort(times)) for name, times in curves.items()},
        logarithmic=True,
        levels=levels,
    )


def _flat_times(bench: Bench) -> Entry.Outcome:
    rig = bench.rig("kamiyama")
    count = 20 if bench.quick else TRIALS
    picture = rig.picture(rig.motion(rig.press(PILLAR_PRESS).load), 1)
    fixed = reconstruct(rig.track(picture), rig.calibration, method="smooth").weight
    theirs = Chain(paper="kamiyama", tracker="two-pass", method="smooth", options={"weight": fixed})
    pushes = replace(theirs, options={"push_only": True, "weight": fixed})
    ways = {
        "paper's tracker and linear constraint": (theirs, FRAME_S),
        "paper's tracker, pushes only (quadratic programme)": (pushes, 0.9),
        "this project's tracker and linear constraint": (
            replace(theirs, tracker=OUR_TRACKER),
            FRAME_S,
        ),
    }
    records = []
    curves: dict[str, Floats] = {}
    for number, (name, (chain, paper)) in enumerate(ways.items()):
        bench.progress(name, number / len(ways))
        before = BEFORE * rig.track(picture, chain.tracker).shift_px
        seconds = _frame_seconds(rig, [picture], count, chain, before)
        records += [
            _timed(f"{name}: from the frame to the force field", "s", paper, seconds),
            _timed(f"{name}: frames a second (goal 70)", "Hz", None, seconds, _rate_of(seconds)),
        ]
        curves[name] = 1e3 * seconds
    panel = _sorted_times(curves, "frame", "ms", {"70 Hz": 1e3 / 70})
    return Entry.Outcome(records=records, panels=(panel,))


def _finger_times(bench: Bench) -> Entry.Outcome:
    rig = bench.rig("sato")
    count = 20 if bench.quick else TRIALS
    pictures = [rig.picture(None, 20 + k) for k in range(4)]
    chain = Chain(paper="sato", method="pinv")
    before = np.zeros_like(rig.rest().rest_px)
    printed = {1: (CALCULATED_US, 56.0), 4: (2159.0, 43.0)}
    records = []
    curves: dict[str, Floats] = {}
    for sensors, (average, deviation) in printed.items():
        bench.progress(f"{sensors} sensors", sensors / 5)
        micros = 1e6 * _frame_seconds(rig, pictures[:sensors], count, chain, before)
        what = "one sensor" if sensors == 1 else f"{sensors} sensors"
        name = f"{what}: standard deviation of the time"
        records += [
            _timed(f"{what}: average time from frame to force field", "µs", average, micros),
            _timed(name, "µs", deviation, micros, float(micros.std(ddof=1))),
        ]
        curves[what] = micros
    panel = _sorted_times(curves, "trial", "µs", {"60 frames a second": 1e6 / 60})
    return Entry.Outcome(records=records, panels=(panel,))


@dataclass(frozen=True, kw_only=True)
class _Hardware:
    """A paper's sensor with its own software and with this project's; the test of Table 1 or I;
    contacts by name; width at half maximum and frames a second, as printed."""

    own: Chain
    ours: Chain
    shift: Protocol
    presses: Mapping[str, Callable[[Rig], Press]]
    width_mm: float | None
    rate_hz: float

    @property
    def industrial(self) -> Chain:
        """This project's software behind an industrial camera."""
        return replace(self.ours, overrides={**self.ours.overrides, **INDUSTRIAL})

    def press(self, rig: Rig) -> Press:
        """Return the first of the contacts."""
        return next(iter(self.presses.values()))(rig)

    def tracking(self, bench: Bench, chain: Chain, trial: Trial) -> Numbers:
        """Measure the deviation of a shift, mean over layers and axes, whatever the sites and the
        inverse."""
        camera = INDUSTRIAL if chain == self.industrial else {}
        chain = replace(chain, overrides=camera)
        found = self.shift.tracked(bench, "re-rendered", chain, trial)
        spreads = [Protocol.samples(found, layer).std(axis=0, ddof=1) for layer in ("red", "blue")]
        printed = float(np.mean([sd for _, sd in self.shift.paper.values()]))
        name = "standard deviation of a shift, re-rendered"
        return {Quantity(name, "px", paper=printed, ours=True): float(np.mean(spreads))}

    def fields(self, bench: Bench, chain: Chain, trial: Trial) -> Numbers:
        """Measure the errors of the fields of all contacts."""
        rig = chain.rig(bench, trial)
        shots = {
            where: chain.shot(bench, press(rig), trial, 90) for where, press in self.presses.items()
        }
        return {
            Quantity(f"field error {where}, on each one's sites", ours=True): shot.score(
                "field_error"
            )
            for where, shot in shots.items()
        }

    def widths(self, bench: Bench, chain: Chain, trial: Trial) -> Numbers:
        """Measure the width of a narrow force, and the least distance of two."""
        width = Quantity(WIDTH, "mm", paper=self.width_mm, ours=True)
        return {
            width: _point_width_mm(bench, chain, trial),
            Quantity(LEAST, "mm", ours=True): _two_points_mm(bench, chain, trial),
        }

    def reading(self, bench: Bench, chain: Chain, trial: Trial) -> Numbers:
        """Measure the smallest difference of force between two readings of one press."""
        name = f"{LEAST_GF} two readings of one press resolve at 95 %"
        resolution = _resolution_gf(bench, self.press(chain.rig(bench, trial)), chain, trial)
        return {Quantity(name, "gf", ours=True): resolution}

    def line(self, axis: int, bench: Bench, chain: Chain, trial: Trial) -> Numbers:
        """Measure Fig. 8's resolution along an axis, of two repeats."""
        first = FIRST_EXPOSURE + 5000 + trial.exposures
        found = ForceLine.of(bench, chain, axis, 10, 2, first)
        name = f"{LEAST_GF} two readings resolve at 95 %"
        return {Quantity(name, "gf", paper=READ_GF, ours=True): found.resolution_gf}

    def rate(self, bench: Bench, chain: Chain, _: Trial) -> Numbers:
        """Measure the median frames a second, on one thread."""
        rig = chain.rig(bench)
        picture = rig.picture(rig.motion(rig.press(self.press(rig)).load), 90)
        found = rig.track(picture, chain.tracker)
        weight = reconstruct(found, rig.calibration, method=chain.method).weight
        given = replace(chain, options={**chain.options, "weight": weight})
        seconds = _frame_seconds(rig, [picture], RATED, given, BEFORE * found.shift_px)
        name = "frames a second, from the frame to the force field"
        return {Quantity(name, "Hz", paper=self.rate_hz, timed=True): _rate_of(seconds)}


HARDWARE = (
    _Hardware(
        own=Chain(paper="kamiyama", method="norm"),
        ours=Chain(paper="kamiyama", overrides=FINE_SITES, tracker=OUR_TRACKER, method="local"),
        shift=KAMIYAMA,
        presses={"under the 5 mm pillar": lambda _: PILLAR_PRESS},
        width_mm=None,
        rate_hz=1 / FRAME_S,
    ),
    _Hardware(
        own=Chain(paper="sato", method="pinv"),
        ours=Chain(
            paper="sato",
            overrides={
                **DRAWN,
                "reconstruction.sites.columns": 9,
                "reconstruction.sites.rows": 9,
                "reconstruction.sites.pitch_mm": 1.25,
            },
            tracker=OUR_TRACKER,
            method="local",
        ),
        shift=SATO,
        presses={
            "under the 3 mm sphere at 100 gf, on a calibrated point": lambda _: sphere_press(
                (0.0, 0.0), 100.0
            ),
            "between four": lambda rig: sphere_press(rig.above((1.25, 1.25)), 100.0),
        },
        width_mm=5.0,
        rate_hz=1e6 / CALCULATED_US,
    ),
)


def _resolution_gf(bench: Bench, press: Press, chain: Chain, trial: Trial) -> float:
    """Return the smallest difference of pushes that two readings of a press resolve at 95 %, gf."""
    shots = [chain.shot(bench, press, trial, 100 + number) for number in range(READINGS)]
    pushes = np.array([shot.field.total_force_n[2] for shot in shots])
    slope = float(pushes.mean() / shots[0].state.force_n[2])
    return float(RESOLVED * pushes.std(ddof=1) / abs(slope) / GF)


def _same_hardware(bench: Bench, hardware: _Hardware) -> Entry.Outcome:
    """Compare `local` with the paper's software, the default inverse, and an industrial camera."""
    ours = hardware.ours
    paper = ours.paper
    own = {PAPERS: hardware.own}
    default = {DEFAULT: replace(ours, method="smooth")}
    industrial = {CAMERA: hardware.industrial}
    trials = bench.trials(paper)
    records: list[Record] = []

    def compare(
        measure: Callable[[Bench, Chain, Trial], Numbers],
        causes: Mapping[str, Chain],
        trials: Sequence[Trial] = trials,
        label: str = paper,
    ) -> None:
        found, _, _ = bench.compare(
            partial(measure, bench), dict, ours, causes, trials, label=label
        )
        records.extend(found)

    bench.progress(f"{paper}, tracking", 0.05)
    unpressed = bench.trials(paper, pressed=False)
    compare(hardware.tracking, own | industrial, unpressed)
    bench.progress(f"{paper}, fields", 0.2)
    pushes = {"pushes only": replace(ours, options={"push_only": True})}
    compare(hardware.fields, own | default | industrial | pushes)
    compare(hardware.widths, own | default | industrial)
    limit = _limit_of(ours.rig(bench), _shift_noise_px(bench, ours))
    records += Record.of_runs([_limit_numbers(limit)], label=paper)

    bench.progress(f"{paper}, magnitude", 0.6)
    if paper == "kamiyama":
        compare(hardware.reading, own | default | industrial, label="kamiyama, z")
    elif not bench.quick:
        for axis in range(3):
            line = partial(hardware.line, axis)
            compare(line, own | default, label=f"sato, {'xyz'[axis]}")
    compare(hardware.rate, own | default, (ONCE,))
    records[-1] = replace(records[-1], n=RATED)
    return Entry.Outcome(records=records)


DESIGN_LIMITS: dict[str, Callable[[Bench], Entry.Outcome]] = {
    "kamiyama/conclusion": _conclusion,
    "sato/2mm-prediction": _prediction,
    "beyond/half-space": _half_space,
    "beyond/limits": _limiting_causes,
    "kamiyama/times": _flat_times,
    "sato/table-2": _finger_times,
    **{
        f"beyond/same-hardware-{each.ours.paper}": partial(_same_hardware, hardware=each)
        for each in HARDWARE
    },
}


def in_short(records: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return sentences by heading about both sensors, with the numbers of these records; nothing
    where an entry is missing."""

    def value(part: str, cause: str = "") -> str:
        found = [r for r in records if r["quantity"].startswith(part)]
        if not found:
            raise KeyError(part)
        row = found[0]
        others = {c["cause"]: c["value"] for c in row["explained_by"]}
        return f"{others[cause] if cause else row['twin']:.2g}"

    def of(paper: str, what: str) -> tuple[str, str, str]:
        """Return a number with the paper's software, this project's, and behind an industrial
        camera."""
        part = f"{paper}: {what}"
        return value(part, PAPERS), value(part), value(part, CAMERA)

    last = list(FLAT)[-1]
    try:
        flat, finger = (
            {
                name: of(paper, what)
                for name, what in {
                    "shift": "standard deviation of a shift",
                    "width": WIDTH,
                    "apart": LEAST,
                    "field": "field error",
                }.items()
            }
            for paper in SCENES
        )
        between = of("sato", "field error between four")
        gram = [
            (value(f"sato, {axis}: smallest", PAPERS), value(f"sato, {axis}: smallest"))
            for axis in "xyz"
        ]
        best = value(f"{last}: least distance")
        pushed = (value("least norm: distance of the strongest"), value("least norm: total push"))
    except KeyError:
        return {}
    numbers = {
        "flat": flat,
        "finger": finger,
        "between": between,
        "gram": gram,
        "best": best,
        "pushed": pushed,
    }
    said = tomllib.loads(Path(__file__).with_name("in_short.toml").read_text(encoding="utf-8"))
    return {
        heading: [" ".join(each.split()).format(**numbers) for each in part["sentences"]]
        for heading, part in said.items()
    }
