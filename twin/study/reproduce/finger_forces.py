"""The finger as a force sensor and as a field sensor: Sato's Figs. 8 and 9."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.parts.methods import Method
from twin.parts.press import Cylinder, Press, Step
from twin.sense.calibration import Calibration
from twin.sense.rest import Method as Tracker
from twin.show.panels import Curve, CurvePanel
from twin.streams import Purpose, stream
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import calibration, full_width, solved
from twin.study.reproduce.finger_picture import GRAM_FORCE_N, PITCH_MM, above, sphere_press
from twin.study.reproduce.record import Outcome, Record, causes, over
from twin.study.sensor import Motion

PRELOAD_GF = 200.0
REPEATS = 5
AXES = ("x", "y", "z")
READ_GF = 30.0
FIRST_EXPOSURE = 2000

TOLD_APART = 1.96 * 2**0.5
"""Differences of two readings above this many standard deviations of one are real at 95 %."""


def _path(axis: int, steps: int) -> Press:
    """Return the 10 mm cylinder's path: 200 gf down and then sideways, or down in steps; it sticks."""
    levels = [PRELOAD_GF * (k + 1) / steps * GRAM_FORCE_N for k in range(steps)]
    down = PRELOAD_GF * GRAM_FORCE_N
    if axis == 2:
        path = tuple(Step(force_n=(None, None, level)) for level in levels)
    else:
        sideways = [tuple(level if k == axis else None for k in range(2)) for level in levels]
        path = (Step(force_n=(None, None, down)), *(Step(force_n=(*pair, down)) for pair in sideways))
    return Press(probe=Cylinder(diameter_mm=10), friction=np.inf, steps=path)


@dataclass(frozen=True, kw_only=True)
class Line:
    """Readings against applied forces, gf, and the straight line through them."""

    applied_gf: Floats
    measured_gf: Floats

    @property
    def slope(self) -> float:
        """Slope of the least-squares line."""
        return float(np.polyfit(self.applied_gf, self.measured_gf, 1)[0])

    @property
    def residual_gf(self) -> Floats:
        """What the line leaves, gf measured."""
        return np.asarray(
            self.measured_gf - np.polyval(np.polyfit(self.applied_gf, self.measured_gf, 1), self.applied_gf)
        )

    @property
    def determination(self) -> float:
        """R squared."""
        return float(1.0 - (self.residual_gf**2).sum() / ((self.measured_gf - self.measured_gf.mean()) ** 2).sum())

    @property
    def resolution_gf(self) -> float:
        """Smallest difference of applied force that two single readings tell apart at 95 %."""
        deviation = np.sqrt((self.residual_gf**2).sum() / (len(self.applied_gf) - 2))
        return float(TOLD_APART * deviation / abs(self.slope))


def line(
    rig: Rig,
    told: Calibration,
    axis: int,
    steps: int,
    repeats: int,
    how: Method,
    tracker: Tracker | None = None,
    first: int = FIRST_EXPOSURE,
) -> Line:
    """Take every level of a path through pictures and the inverse, ``repeats`` times with noise of their own."""
    states = rig.press(_path(axis, steps)).path[-steps:]
    applied, measured = [], []
    for repeat in range(repeats):
        for number, state in enumerate(states):
            exposure = first + 1000 * axis + 100 * repeat + number
            picture = rig.picture(rig.motion(state), exposure)
            field = solved(rig.track(picture, tracker), told, how)
            cell = (
                rig.scene.calibration.load_cell_n
                * stream(rig.scene.seed, Purpose.LOAD_CELL, exposure).standard_normal()
            )
            applied.append((state.force_n[axis] + cell) / GRAM_FORCE_N)
            measured.append(field.total_force_n[axis] / GRAM_FORCE_N)
    return Line(applied_gf=np.array(applied), measured_gf=np.array(measured))


FIGURES: dict[str, tuple[str, Callable[[Line], float], float | None]] = {
    "slope of measured over applied force": ("", lambda line: line.slope, None),
    "R squared": ("", lambda line: line.determination, None),
    "resolution: smallest difference two readings tell apart at 95 %": ("gf", lambda line: line.resolution_gf, READ_GF),
}


def _figure_8(bench: Bench) -> Outcome:
    steps, repeats = (3, 2) if bench.quick else (10, REPEATS)
    rig = bench.rig("sato")
    told = rig.calibration
    quiet = bench.rig("sato", overrides={"ccd.noise": False})
    records: list[Record] = []
    panels = []
    for axis, name in enumerate(AXES):
        if bench.quick and name != "z":
            continue
        bench.progress(f"cylinder along {name}", axis / 3)
        readings = line(rig, told, axis, steps, repeats, "pinv")
        off = {
            "noise of the picture off": line(quiet, told, axis, steps, 1, "pinv"),
            "tracker: this project's instead of the paper's": line(
                rig, told, axis, steps, repeats, "pinv", OUR_TRACKER
            ),
            "inverse: smooth instead of the pseudo-inverse": line(rig, told, axis, steps, repeats, "smooth"),
        }
        for figure, (unit, value, paper) in FIGURES.items():
            records.append(
                Record(
                    quantity=f"{name}: {figure}", unit=unit, paper=paper, twin=value(readings), n=1,
                    explained_by=causes({cause: value(other) for cause, other in off.items()}),
                )
            )  # fmt: skip
        reach = np.array([0.0, PRELOAD_GF])
        fit = np.polyfit(readings.applied_gf, readings.measured_gf, 1)
        panels.append(
            CurvePanel(
                title=f"Along {name}", across="applied (gf)", up="measured (gf)",
                curves=(
                    Curve(label="readings", x=readings.applied_gf, y=readings.measured_gf, style="."),
                    Curve(label="line", x=reach, y=np.polyval(fit, reach)),
                    Curve(label="as applied", x=reach, y=reach, style=":"),
                ),
            )
        )  # fmt: skip
    note = (
        f"{repeats} repeats are of one probe path, each level with a picture and a load-cell reading of its own; "
        "placing the probe anew, creep and hysteresis are not in it, so scatter of that kind in the paper's 30 gf "
        "is not explained here."
    )
    return Outcome(records=records, panels=panels, notes=(note,))


STEP_MM = 0.5
FORCE_GF = 200.0
PLACES = {"centre": (0.0, 0.0), "edge": (5.0, 0.0)}
"""First of the two adjacent calibrated points; the second lies one pitch further in, along x, or along y."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Magnitudes at the sites of a row, by distance from the press; every press has its own row."""

    distance_mm: Floats
    magnitude: Floats

    @property
    def normalised(self) -> Floats:
        """Magnitudes over the largest."""
        return np.asarray(self.magnitude / self.magnitude.max())

    def curve(self) -> tuple[Floats, Floats]:
        """Return sorted distances, equal ones averaged, and normalised magnitudes."""
        at, which = np.unique(self.distance_mm.round(3), return_inverse=True)
        return at, np.bincount(which, self.normalised) / np.bincount(which)

    @property
    def width_mm(self) -> float:
        """Full width at half maximum."""
        return full_width(*self.curve())

    @property
    def jump(self) -> float:
        """Largest change between neighbouring distances within a pitch of the middle, of the normalised magnitude."""
        at, size = self.curve()
        near = np.abs(at) <= PITCH_MM / 2 + 1e-9
        return float(np.abs(np.diff(size[near])).max())


def _presses(rig: Rig, place: str, along: int, step_mm: float) -> list[tuple[float, tuple[float, float]]]:
    """Return arc length along the row and (x, y) of every press between the two points."""
    s, t = PLACES[place]
    inward = -1.0 if place == "edge" and along == 0 else 1.0
    offsets = np.arange(0.0, PITCH_MM + 1e-9, step_mm)
    charts = [(s + inward * o, t) if along == 0 else (s, t + o) for o in offsets]
    return [(chart[along], above(rig, chart)) for chart in charts]


def _spread(rig: Rig, told: Calibration, place: str, along: int, step_mm: float, how: Method, exposure: int) -> Spread:
    """Press between two calibrated points and read the sites of their row, each press taken as the origin."""
    chart = rig.scene.reconstruction.sites.chart()  # type: ignore[union-attr]
    row = np.flatnonzero(np.abs(chart[:, 1 - along] - PLACES[place][1 - along]) < 1e-6)
    distance, size = [], []
    for number, (at, where) in enumerate(_presses(rig, place, along, step_mm)):
        state = rig.press(sphere_press(where, FORCE_GF))
        field = solved(rig.seen(state, exposure + number), told, how)
        distance.append(chart[row, along] - at)
        size.append(np.linalg.norm(field.force_n[row], axis=1))
    return Spread(distance_mm=np.concatenate(distance), magnitude=np.concatenate(size))


def _dip(rig: Rig, told: Calibration, apart_mm: float, along: int, how: Method) -> float:
    """Return how far the magnitude drops between two presses at once, over the lower peak; their tractions add."""
    half = apart_mm / 2
    charts = [(half, 0.0), (-half, 0.0)] if along == 0 else [(0.0, half), (0.0, -half)]
    motions = [rig.motion(rig.press(sphere_press(above(rig, c), FORCE_GF / 2))) for c in charts]
    both = Motion(
        displacement_mm=motions[0].displacement_mm + motions[1].displacement_mm,
        gradient=motions[0].gradient + motions[1].gradient, error=max(m.error for m in motions),
    )  # fmt: skip
    field = solved(rig.track(rig.picture(both, 3900)), told, how)
    chart = rig.scene.reconstruction.sites.chart()  # type: ignore[union-attr]
    row = np.flatnonzero(np.abs(chart[:, 1 - along]) < 1e-6)
    order = row[np.argsort(chart[row, along])]
    size = np.linalg.norm(field.force_n[order], axis=1)
    middle = len(size) // 2
    left, right = float(size[:middle].max()), float(size[middle + 1 :].max())
    return 1.0 - float(size[middle]) / min(left, right)


def _figure_9(bench: Bench) -> Outcome:
    step = 1.25 if bench.quick else STEP_MM
    places = ("centre",) if bench.quick else tuple(PLACES)
    rig = bench.rig("sato")
    told, nominal = rig.calibration, calibration(bench, rig, "compliance")
    quiet = bench.rig("sato", overrides={"ccd.noise": False})
    records: list[Record] = []
    panels = []
    exposures = (3000,) if bench.quick else (3000, 3200, 3400)
    for number, place in enumerate(places):
        curves = []
        for along in (0,) if bench.quick else (0, 1):
            bench.progress(f"{place}, along {AXES[along]}", (2 * number + along) / 4)
            runs = [_spread(rig, told, place, along, step, "pinv", e) for e in exposures]
            off = {
                "noise of the picture off": _spread(quiet, told, place, along, step, "pinv", 3000),
                "inverse: smooth instead of the pseudo-inverse": _spread(rig, told, place, along, step, "smooth", 3000),
                "calibration: the drawing's compliance instead of the presses": _spread(
                    rig, nominal, place, along, step, "pinv", 3000
                ),
                "calibration and inverse": _spread(rig, nominal, place, along, step, "smooth", 3000),
            }
            records += [
                Record(
                    quantity=f"{place}, along {AXES[along]}: full width at half maximum (n exposures)",
                    unit="mm", paper=5.0,
                    **over(run.width_mm for run in runs), explained_by=causes({n: o.width_mm for n, o in off.items()}),
                ),
                Record(
                    quantity=f"{place}, along {AXES[along]}: largest jump near the middle, of the largest magnitude "
                    "(n exposures)", unit="", **over(run.jump for run in runs),
                    explained_by=causes({n: o.jump for n, o in off.items()}),
                ),
            ]  # fmt: skip
            curves.append(Curve(label=f"along {AXES[along]}", x=runs[0].curve()[0], y=runs[0].curve()[1], style="o-"))
            smooth = off["inverse: smooth instead of the pseudo-inverse"].curve()
            curves.append(Curve(label=f"along {AXES[along]}, smooth inverse", x=smooth[0], y=smooth[1], style=":"))
        panels.append(
            CurvePanel(
                title=f"{place.capitalize()}: magnitude against distance from the press", curves=curves,
                across="distance (mm)", up="magnitude over its largest", levels={"half": 0.5},
            )
        )  # fmt: skip
    if not bench.quick:
        bench.progress("two presses at once", 0.95)
        records += [
            Record(
                quantity=f"two spheres of 100 gf {apart:g} mm apart along x: dip between them", unit="",
                twin=_dip(rig, told, apart, 0, "pinv"),
                explained_by=causes({
                    "noise of the picture off": _dip(quiet, told, apart, 0, "pinv"),
                    "inverse: smooth instead of the pseudo-inverse": _dip(rig, told, apart, 0, "smooth"),
                }),
            )
            for apart in (5.0,)
        ]  # fmt: skip
    note = (
        "The paper blames the discontinuity near the centre on the pseudo-inverse. What becomes of the largest jump "
        "without noise, with another inverse and with another calibration stands beside it."
    )
    return Outcome(records=records, panels=panels, notes=(note,))


FIGURE_8 = Entry(
    name="sato/fig-8",
    title="Measured against applied force, and the resolution of the magnitude",
    source="Sato, section III B, equation 6, Fig. 8",
    protocol="A flat 10 mm cylinder on the apex: 200 gf down and then 20 to 200 gf along x, or along y; 20 to 200 "
    "gf along z. The cylinder sticks (the paper's 200 gf sideways under 200 gf down need it). The measured force is "
    "the sum over the 25 sites; the resolution is 1.96 sqrt 2 times the standard deviation about the line, over its "
    "slope.",
    run=_figure_8,
)
FIGURE_9 = Entry(
    name="sato/fig-9",
    title="Spatial resolution by dense sampling",
    source="Sato, section III C, equation 7, Fig. 9",
    protocol="The 3 mm sphere presses with 200 gf along z in steps of 0.5 mm between two calibrated points, at the "
    "centre and at the edge, along x and along y; the magnitudes at the sites of the row are drawn against their "
    "distance from the press, over the largest.",
    run=_figure_9,
)
