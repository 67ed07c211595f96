"""The flat sensor: its pictures (Kamiyama's Figs. 6, 9, 17) and force fields (Figs. 10 to 16)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from twin.arrays import Floats
from twin.judge.score import full_width
from twin.parts.load import Load, Traction
from twin.parts.press import Cylinder, Pillar, Press, Step
from twin.sense.reconstruct import Field
from twin.sense.track import Found
from twin.show.reproduction_page import Panel
from twin.study.reproduce.bench import (
    NO_NOISE,
    OUR_TRACKER,
    OUR_TRACKER_INSTEAD,
    PILLAR_N,
    PILLAR_PRESS,
    QUIET,
    Bench,
    Chain,
    Entry,
    Measure,
    Rig,
    Shot,
    Trial,
)
from twin.study.reproduce.record import Numbers, Quantity, Record, Unprinted

PITCH_MM, BAND_MM, SHAPE_BAND_MM = 1.5, 0.8, 4.0
WIDTHS_MM = (2.0, 4.0, 6.0, 8.0, 10.0)
LENGTH_MM = 16.0
PRESSURE_MPA = 0.15
APART_MM = (4.0, 8.0, 12.0, 16.0, 20.0, 24.0)
DEPTHS_MM = (1.5, 3.0, 4.5, 6.0, 8.0, 10.0)
IMPULSE_N = 1.0
SPOT_MM = 1.5
"""Depths of Fig. 17; an impulse, and the radius of the disc that stands for it, smaller than the
pitch."""

AXIS_MM = 1.2
"""Markers nearer to the x axis than this count as on it."""

AXIS = "along the x axis"
COMPARED = (
    ("red layer, along the x axis", "red", False),
    ("blue layer, along the x axis", "blue", False),
    (AXIS, "", False),
    ("all markers, both directions", "", True),
)
"""What Fig. 16 compares: its name, its layer, and whether the whole plane counts."""

IMPULSES = {0: "fx", 2: "fz"}
NORM = Chain(paper="kamiyama", method="norm")
DIFFERENCE = replace(NORM, method="smooth")
PUSHES = replace(DIFFERENCE, options={"push_only": True})
BLIND = replace(NORM, calibrated_by="no camera")
FREE = replace(NORM, method="pinv")
TRACKED = Chain(paper="kamiyama", tracker=OUR_TRACKER)
OURS_DIFFERENCE = replace(DIFFERENCE, tracker=OUR_TRACKER, calibrated_by="compliance")
LOAD = Unprinted(
    "force on the pillar over Young's modulus",
    "N/MPa",
    (3.0, 10.0, 17.0, 20.0, 23.0, 26.0, 30.0),
    "a hand or a weight pushes with 1 to 30 N, and clear silicones of the maker's kind have 0.2 to "
    "1 MPa; at 30 N/MPa linear theory sinks the pillar 4.3 mm into a block of 40 mm",
)
ROUNDED_N, RIM_MM = 12.0, 1.0
"""The largest load, with a rim rounded by so much, at which finite strain is solved here."""

ROW = Unprinted(
    "half the row of red markers that is compared",
    "mm",
    (4.5, 6.0, 9.0, 12.0, 16.0),
    "from three markers on each side to the width of the view; the figure's range isn't printed",
)
OURS = "inverse, tracker and block: this project's"
PAPERS_TRACKER = "tracker: the paper's instead of this project's"
NO_LENS = "lens: seen from far away"
NO_BLOCK = "finite block: a half-space is filmed instead"
KNOWN_BLOCK = "finite block: the sensor knows the real block instead of a half-space"
"""Causes, in the words of the page."""


def _impulse(axis: int, at_mm: tuple[float, float] = (0.0, 0.0), sign: float = 1.0) -> Load:
    """Return a narrow traction along one axis, standing for an impulse."""
    x, y, z = (sign * IMPULSE_N * np.eye(3)[axis]).tolist()
    return Traction.disk(at_mm, SPOT_MM, (x, y, z))


def _pillar_press(force_n: float, edge_mm: float = 0.0) -> Press:
    """Return the press of the 5 mm pillar with another force, its rim rounded by ``edge_mm``."""
    return Press(probe=Cylinder(diameter_mm=5, edge_mm=edge_mm), force_n=(0.0, 0.0, force_n))


def _causes(bench: Bench, chain: Chain, block: str) -> dict[str, Chain]:
    """Return a chain with one cause off, by name; ``block`` is that of the block."""
    tracker = {OUR_TRACKER_INSTEAD: replace(chain, tracker=OUR_TRACKER)}
    if chain.tracker == OUR_TRACKER:
        tracker = {PAPERS_TRACKER: replace(chain, tracker="two-pass")}
    blocks = {
        KNOWN_BLOCK: replace(chain, calibrated_by="compliance"),
        NO_BLOCK: replace(chain, half_space=True),
    }
    return {
        NO_NOISE: replace(chain, overrides=QUIET),
        **tracker,
        NO_LENS: replace(chain, overrides=bench.rig("kamiyama").far_away()),
        block: blocks[block],
    }


def _figure_6(bench: Bench) -> Entry.Outcome:
    def numbers(rig: Rig) -> Numbers:
        rest = rig.rest(OUR_TRACKER)
        layers = rig.scene.markers
        steps = [_pitch_px(rig, name, rest.rest_px[rest.layer == name]) for name in sorted(layers)]
        size = Quantity("size of a pixel in the marker layers", "mm", paper=0.05)
        return {size: PITCH_MM / float(np.mean(steps)), **rig.rest_numbers()}

    rigs = [NORM.rig(bench, trial) for trial in bench.trials("kamiyama")]
    picture = rigs[0].picture(None, 0)
    signal = picture[..., 0].astype(int) - picture[..., 2]
    red = np.maximum(signal, 0)
    blue = np.maximum(-signal, 0)
    brighter = 255 / max(int(np.abs(signal).max()), 1)
    split = (brighter * np.stack([red, 0 * red, blue], axis=2)).astype(np.uint8)
    split_title = "Red minus blue, brightened; blue where negative"
    panels = (
        Panel.picture(title="The picture at rest", picture=picture),
        Panel.picture(title=split_title, picture=split),
    )
    return Entry.Outcome(records=Record.of_runs([numbers(rig) for rig in rigs]), panels=panels)


def _pitch_px(rig: Rig, name: str, at: Floats) -> float:
    """Return the mean distance of neighbours in a layer's grid, px."""
    layer = rig.scene.markers[name]
    grid = at.reshape(layer.columns, layer.rows, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).ravel() for axis in (0, 1)]
    return float(np.nanmean(np.concatenate(steps)))


def _radial_share(found: Found) -> float:
    """Return the share of the red layer's squared shifts along the way from the picture's
    middle."""
    mine = (found.layer == "red") & found.seen
    away = found.rest_px[mine] - found.rest_px[found.seen].mean(axis=0)
    shift = found.shift_px[mine]
    outward = (shift * away).sum(axis=1) / np.linalg.norm(away, axis=1)
    return float((outward**2).sum() / (shift**2).sum())


def _figure_9(bench: Bench) -> Entry.Outcome:
    largest = Quantity(
        f"largest movement under the pillar with {PILLAR_N:g} N (the paper's force isn't known)",
        "px",
        paper=10.0,
    )
    radial = Quantity(
        "share of the red field's energy along the radius (the paper: radial)", paper=1.0, near=0.1
    )

    def numbers(found: Found) -> Numbers:
        size = np.linalg.norm(found.shift_px, axis=1)
        return {radial: _radial_share(found), largest: float(np.nanmax(size))}

    def loaded(ratio: float) -> Measure[Found]:
        def measure(chain: Chain, trial: Trial) -> Found:
            # linear theory knows the force over Young's modulus alone
            modulus = chain.rig(bench, trial).scene.material.youngs_modulus_mpa
            return chain.shot(bench, _pillar_press(ratio * modulus), trial).found

        return measure

    records, runs, _ = bench.compare(
        lambda chain, trial: chain.shot(bench, PILLAR_PRESS, trial).found,
        numbers,
        NORM,
        _causes(bench, NORM, NO_BLOCK),
        ranges={} if bench.quick else {LOAD: loaded},
    )
    harder = Quantity(
        f"largest movement under {ROUNDED_N:g} N, rim rounded by {RIM_MM:g} mm: finite strain over "
        "linear theory"
    )
    press = _pillar_press(ROUNDED_N, edge_mm=RIM_MM)
    moved = [
        numbers(replace(TRACKED, overrides={"material.law": law}).shot(bench, press).found)[largest]
        for law in ("neo_hookean", "linear")
    ]
    panel = Panel.shifts("Red layer, 5 mm pillar along z", runs[0], "red")
    return Entry.Outcome(
        records=[*records, *Record.of_runs([{harder: moved[0] / moved[1]}])],
        panels=(panel,),
    )


def _strongest_mm(found: Field) -> float:
    """Return the distance of the site with the largest force from the middle, mm."""
    place = found.site_mm[np.argmax(np.linalg.norm(found.force_n, axis=1)), :2]
    return float(np.linalg.norm(place))


def _profile(found: Field, half_band_mm: float) -> tuple[Floats, Floats]:
    """Return x, mm, and the force along z, N, by column of sites within ``half_band_mm`` of y =
    0."""
    x = np.unique(found.site_mm[:, 0].round(6))
    band = np.abs(found.site_mm[:, 1]) <= half_band_mm
    near = [band & (np.abs(found.site_mm[:, 0] - at) < 1e-3) for at in x]
    return x, np.array([float(found.force_n[mine, 2].sum()) for mine in near])


def _push_share(shot: Shot) -> float:
    return float(shot.field.total_force_n[2] / shot.state.force_n[2])


def _pillar_numbers(shot: Shot) -> Numbers:
    width = full_width(*_profile(shot.field, BAND_MM))
    return {
        Quantity("field error"): shot.score("field_error"),
        Quantity("total push over the applied one"): _push_share(shot),
        Quantity("distance of the strongest force from the pillar's axis", "mm"): _strongest_mm(
            shot.field
        ),
        Quantity("full width at half maximum of the push along x", "mm"): width,
    }


def _pillar_field(label: str, chain: Chain, bench: Bench) -> Entry.Outcome:
    """Solve the pillar's press by one constraint, and again with causes off."""
    ours = replace(OURS_DIFFERENCE, options=PUSHES.options)
    causes = _causes(bench, chain, KNOWN_BLOCK) | {OURS: ours}
    press = bench.pressing(PILLAR_PRESS)
    records, runs, _ = bench.compare(press, _pillar_numbers, chain, causes, label=label)
    panels = [
        Panel.field(label, runs[0].field, 2.5),
        Panel.field("Truth, summed into the sites' cells", runs[0].truth, 2.5),
    ]
    return Entry.Outcome(records=records, panels=panels)


def _free_numbers(shot: Shot) -> Numbers:
    largest = np.abs(shot.field.force_n).max() / np.abs(shot.truth.force_n).max()
    return {
        Quantity("largest force over the true largest (the paper: diverged greatly)"): float(
            largest
        ),
        Quantity(
            "distance of the strongest force from the pillar's axis (the paper: clearly another)",
            "mm",
        ): _strongest_mm(shot.field),
    }


def _figure_10(bench: Bench) -> Entry.Outcome:
    """Add the solution without any constraint."""
    constrained = _pillar_field("least norm of differences", DIFFERENCE, bench)
    quiet = {NO_NOISE: replace(FREE, overrides=QUIET)}
    press = bench.pressing(PILLAR_PRESS)
    records, free, _ = bench.compare(press, _free_numbers, FREE, quiet, label="no constraint")
    panel = Panel.field("No constraint", free[0].field, 2.5)
    return Entry.Outcome(
        records=[*constrained.records, *records], panels=[*constrained.panels, panel]
    )


def _figure_13(bench: Bench) -> Entry.Outcome:
    """Show the field before camera calibration and the one after it."""
    before = _pillar_field("least norm, before camera calibration", BLIND, bench)
    after = NORM.shot(bench, PILLAR_PRESS).field
    panel = Panel.field("After camera calibration (Fig. 11)", after, 2.5)
    return replace(before, panels=[*before.panels, panel])


def _ways(bench: Bench, **options: bool) -> dict[str, Chain]:
    """Return the paper's way with one cause off, by name, and this project's software at last."""
    return {
        **_causes(bench, DIFFERENCE, KNOWN_BLOCK),
        "inverse: the least norm instead of the least norm of differences": NORM,
        OURS: replace(OURS_DIFFERENCE, options=options),
    }


def _figure_14(bench: Bench) -> Entry.Outcome:
    widths = WIDTHS_MM[::2] if bench.quick else WIDTHS_MM

    def profiles(chain: Chain, trial: Trial) -> dict[float, tuple[Floats, Floats]]:
        """Return the profile of the push along x by width of the pillar."""
        found = {}
        for width in widths:
            probe = Pillar(width_mm=width, length_mm=LENGTH_MM)
            press = Press(probe=probe, force_n=(0, 0, PRESSURE_MPA * width * LENGTH_MM))
            found[width] = _profile(chain.shot(bench, press, trial).field, SHAPE_BAND_MM)
        return found

    def numbers(run: dict[float, tuple[Floats, Floats]]) -> Numbers:
        return {
            Quantity(f"width recovered of a pillar {width:g} mm wide", "mm"): full_width(*profile)
            for width, profile in run.items()
        }

    # Compare with the paper, and draw the profiles and the recovered widths.
    records, runs, off = bench.compare(profiles, numbers, DIFFERENCE, _ways(bench, push_only=True))
    applied = np.array(widths)
    published = np.array([record.twin for record in records])
    recovered = np.array([*numbers(off[OURS]).values()])
    panels = (
        Panel.curves(
            "Push along x, each over its largest",
            "x (mm)",
            "push",
            {f"{width:g} mm wide": (x, push / push.max()) for width, (x, push) in runs[0].items()},
        ),
        Panel.curves(
            "Width recovered",
            "applied (mm)",
            "full width at half maximum (mm)",
            {
                "as applied": (applied, applied, ":"),
                "the paper's way": (applied, published, "o-"),
                OURS: (applied, recovered, "s-"),
            },
        ),
    )
    return Entry.Outcome(records=records, panels=panels)


def _twist_press(diameter_mm: float) -> Press:
    push = float(10.0 / (np.pi * 8.0**2) * np.pi * diameter_mm**2 / 4)
    steps = (
        Step(force_n=(None, None, push)),
        Step(force_n=(None, None, push), torque_nmm=30.0 * (diameter_mm / 16.0) ** 3),
    )
    return Press(probe=Cylinder(diameter_mm=diameter_mm), friction=np.inf, steps=steps)


def _figure_15(bench: Bench) -> Entry.Outcome:
    records: list[Record] = []
    panels: list[Panel] = []
    presses = {40.0: "as published, wider than the view", 16.0: "one that fits"}
    for number, (diameter, what) in enumerate(presses.items()):
        bench.progress(what, number / 2)
        press = _twist_press(diameter)
        radius = diameter / 2
        label = f"{diameter:g} mm pillar, {what}"

        numbers = partial(_twist_numbers, radius)
        found, runs, _ = bench.compare(
            bench.pressing(press), numbers, DIFFERENCE, _ways(bench), label=label
        )
        records += found
        panels.append(Panel.field(label, runs[0].field, radius))
    return Entry.Outcome(records=records, panels=panels)


def _twist_numbers(radius_mm: float, shot: Shot) -> Numbers:
    torque = shot.field.total_torque_nmm[2] / shot.state.torque_nmm
    return {
        Quantity("torque recovered over the applied one"): torque,
        Quantity("push recovered over the applied one"): _push_share(shot),
        Quantity("share of the tangential field's energy that turns about z"): _turning_share(
            shot.field, radius_mm
        ),
    }


def _turning_share(found: Field, radius_mm: float) -> float:
    """Return the share of the squared tangential forces along circles about z."""
    distance = np.hypot(found.site_mm[:, 0], found.site_mm[:, 1])
    under = (distance < radius_mm) & (distance > 0)
    x, y = (found.site_mm[under, :2] / distance[under, None]).T
    force = found.force_n[under]
    turning = force[:, 1] * x - force[:, 0] * y
    return float((turning**2).sum() / (force[:, :2] ** 2).sum())


def _cosine(one: Floats, other: Floats) -> float:
    """Return the cosine of the angle between two fields."""
    return float(one @ other / np.sqrt((one @ one) * (other @ other)))


def _figure_16(bench: Bench) -> Entry.Outcome:
    """Compare two opposite impulses along x, both outwards, with one along z."""
    apart = APART_MM[1::2] if bench.quick else APART_MM

    def filmed(chain: Chain, trial: Trial) -> tuple[Rig, Found, list[Found]]:
        """Track the push, and the two impulses at every distance."""
        rig = chain.rig(bench, trial)

        def work() -> tuple[Rig, Found, list[Found]]:
            pairs = [
                _impulse(0, (distance / 2, 0.0)) + _impulse(0, (-distance / 2, 0.0), -1.0)
                for distance in apart
            ]
            moved = [chain.film(rig, pair, 2 + number) for number, pair in enumerate(pairs)]
            return rig, chain.film(rig, _impulse(2), 1), moved

        return bench.once(("impulses", id(rig), chain.tracker, chain.half_space), work)

    def cosines(
        chain: Chain,
        trial: Trial,
        compare: Sequence[tuple[str, str, bool]] = COMPARED,
        reach: float = np.inf,
    ) -> dict[str, list[float]]:
        """Return cosines by what is compared, a distance each, of markers within ``reach`` along
        x."""
        rig, push, pairs = filmed(chain, trial)
        points = rig.sensor.nominal_markers.points
        on_axis = np.abs(points[:, 1]) < AXIS_MM
        near = np.abs(points[:, 0]) <= reach
        found: dict[str, list[float]] = {what: [] for what, _, _ in compare}
        for moved in pairs:
            seen = push.seen & moved.seen & near
            for what, layer, across in compare:
                rows = seen & (on_axis | across) & ((push.layer == layer) | (layer == ""))
                kept = slice(0, 2 if across else 1)
                one, other = (f.shift_px[rows, kept].ravel() for f in (push, moved))
                found[what].append(_cosine(one, other))
        return found

    def numbers(run: dict[str, list[float]]) -> Numbers:
        largest = "largest cosine between two x-impulses and a z-force"
        return {
            Quantity(f"{what}: {largest} (the paper: quite the same)", paper=1.0, near=0.1)
            if what == AXIS
            else Quantity(f"{what}: {largest}", near=0.1): max(values)
            for what, values in run.items()
        }

    def on_row(reach: float) -> Measure[dict[str, list[float]]]:
        return partial(cosines, compare=((AXIS, "red", False),), reach=reach)

    # Compare with the paper: it calls the two movements the same.
    records, runs, _ = bench.compare(
        cosines,
        numbers,
        TRACKED,
        _causes(bench, TRACKED, NO_BLOCK),
        ranges={} if bench.quick else {ROW: on_row},
    )
    best = Quantity("distance of the two impulses at the largest cosine along the x axis", "mm")
    records += Record.of_runs([{best: apart[int(np.argmax(runs[0][AXIS]))]}])
    panel = Panel.curves(
        "Two x-impulses against one z-force",
        "distance of the impulses (mm)",
        "cosine",
        {what: (apart, values, "o-") for what, values in runs[0].items()},
    )
    return Entry.Outcome(records=records, panels=(panel,))


_Fields = dict[tuple[int, float], Floats]


def _size(moved: Floats) -> float:
    return float(np.linalg.norm(moved.reshape(-1, 2), axis=1).max())


def _figure_17(bench: Bench) -> Entry.Outcome:
    depths = DEPTHS_MM[1::2] if bench.quick else DEPTHS_MM

    def fields(chain: Chain, depths_mm: tuple[float, ...]) -> _Fields:
        """Return (2n,) tracked movements of the red layer, mm, by axis of the impulse and depth."""
        found: _Fields = {}
        for depth in depths_mm:
            fewer = {"markers.red.depth_mm": depth, "markers.red.columns": 13}
            fewer["markers.red.rows"] = 10
            rig = bench.rig("kamiyama", overrides={**fewer, **chain.overrides})
            for axis in IMPULSES:
                moved = chain.film(rig, _impulse(axis), 1)
                red = moved.layer == "red"
                scale = np.linalg.norm(rig.image_scale[red][:, :, 0], axis=1)
                found[axis, depth] = np.nan_to_num(moved.shift_px[red] / scale[:, None]).ravel()
        return found

    def numbers(run: _Fields) -> Numbers:
        ratios: dict[str, Callable[[Floats, Floats], float]] = {
            "cosine between the fields at 3 mm and at 6 mm (the paper: not orthogonal)": _cosine,
            "largest movement at 6 mm over that at 3 mm": lambda at_3, at_6: (
                _size(at_6) / _size(at_3)
            ),
        }
        return {
            Quantity(f"{name}: {what}"): ratio(run[axis, 3.0], run[axis, 6.0])
            for what, ratio in ratios.items()
            for axis, name in IMPULSES.items()
        }

    bench.progress("markers at other depths", 0.1)
    found = fields(TRACKED, depths)
    bench.progress("with causes off", 0.5)
    ways = _causes(bench, TRACKED, NO_BLOCK)
    off = {name: numbers(fields(way, (3.0, 6.0))) for name, way in ways.items()}
    panel = Panel.curves(
        "Largest movement against the markers' depth",
        "depth (mm)",
        "movement (µm)",
        {
            f"{name} = {IMPULSE_N:g} N": (
                depths,
                [1e3 * _size(found[axis, depth]) for depth in depths],
                "o-",
            )
            for axis, name in IMPULSES.items()
        },
    )
    return Entry.Outcome(records=Record.of_runs([numbers(found)], off), panels=(panel,))


FLAT_FIGURES: dict[str, Callable[[Bench], Entry.Outcome]] = {
    "kamiyama/fig-6": _figure_6,
    "kamiyama/fig-9": _figure_9,
    "kamiyama/fig-10": _figure_10,
    "kamiyama/fig-11": partial(_pillar_field, "least norm", NORM),
    "kamiyama/fig-12": partial(_pillar_field, "Fz >= 0, least norm of differences", PUSHES),
    "kamiyama/fig-13": _figure_13,
    "kamiyama/fig-14": _figure_14,
    "kamiyama/fig-15": _figure_15,
    "kamiyama/fig-16": _figure_16,
    "kamiyama/fig-17": _figure_17,
}
