"""What the flat sensor's camera sees: Kamiyama's Figs. 6, 9 and 17."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.parts.load import Load, Traction
from twin.parts.press import Cylinder, Press
from twin.sense.rest import Method as Tracker
from twin.sense.track import Found
from twin.show.panels import ArrowPanel, Curve, CurvePanel, PicturePanel
from twin.study.motion import Motion
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import (
    NO_BLOCK,
    NO_LENS,
    NO_NOISE,
    OUR_TRACKER_INSTEAD,
    PAPERS_TRACKER,
    far_away,
    half_space_motion,
)
from twin.study.reproduce.record import Outcome, Record, causes, over

PILLAR_N = 3.0
"""Force on the 5 mm pillar, in no paper: the same in every entry."""

PITCH_MM = 1.5


def pillar_press(force_n: float = PILLAR_N) -> Press:
    """Return the press of Figs. 9 to 13: the 5 mm pillar, along z, at the middle."""
    return Press(probe=Cylinder(diameter_mm=5), force_n=(0, 0, force_n))


def _figure_6(bench: Bench) -> Outcome:
    scale, width, seen = [], [], []
    for seed in bench.seeds("kamiyama"):
        rig = bench.rig("kamiyama", seed)
        rest = rig.rest(OUR_TRACKER)
        places = {str(name): rest.rest_px[rest.layer == name] for name in np.unique(rest.layer)}
        steps = [_pitch_px(rig, name, at) for name, at in places.items()]
        scale.append(PITCH_MM / float(np.mean(steps)))
        width.append(float(np.mean([group.diameter_px for group in rest.groups])))
        seen.append(float(np.isfinite(rest.rest_px).all(axis=1).mean()))
    rig = bench.rig("kamiyama")
    picture = rig.picture(None, 0)
    records = (
        Record(quantity="size of a pixel in the marker layers", unit="mm", paper=0.05, **over(scale)),
        Record(quantity="width of a marker in the picture", unit="px", **over(width)),
        Record(quantity="share of markers found", unit="", **over(seen)),
    )
    signal = np.clip(picture[..., 0].astype(int) - picture[..., 2], -255, 255)
    red, blue = np.clip(signal, 0, 255), np.clip(-signal, 0, 255)
    split = np.stack([red, np.zeros_like(red), blue], axis=2).astype(np.uint8)
    return Outcome(
        records=records,
        panels=(
            PicturePanel(title="The picture at rest", picture=picture),
            PicturePanel(title="Red minus blue: positive part red, negative part blue", picture=split),
        ),
    )


def _pitch_px(rig: Rig, name: str, at: Floats) -> float:
    """Return the mean distance of neighbours in a layer's grid, px, from the tracked rest places."""
    layer = rig.scene.markers[name]
    grid = at.reshape(layer.columns, layer.rows, 2)
    along = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    return float(np.nanmean(np.concatenate([along.ravel(), across.ravel()])))


def radial_share(found: Found, layer: str) -> float:
    """Return the share of a layer's squared shifts that points away from, or towards, the middle of the picture."""
    mine = (found.layer == layer) & found.seen
    away = found.rest_px[mine] - found.rest_px[found.seen].mean(axis=0)
    shift = found.shift_px[mine]
    outward = (shift * away).sum(axis=1) / np.linalg.norm(away, axis=1)
    return float((outward**2).sum() / (shift**2).sum())


def largest(found: Found) -> float:
    """Return the largest shift, px."""
    return float(np.nanmax(np.linalg.norm(found.shift_px, axis=1)))


def _figure_9(bench: Bench) -> Outcome:
    runs = [bench.rig("kamiyama", seed) for seed in bench.seeds("kamiyama")]
    found = [rig.seen(rig.press(pillar_press())) for rig in runs]
    bench.progress("with causes off", 0.6)
    rig = runs[0]
    state = rig.press(pillar_press())
    off = {
        OUR_TRACKER_INSTEAD: rig.seen(state, method=OUR_TRACKER),
        NO_NOISE: _seen(bench, {"ccd.noise": False}),
        NO_LENS: _seen(bench, far_away(rig)),
        NO_BLOCK: rig.track(rig.picture(half_space_motion(rig, state.load), 1)),
    }
    heavy = PILLAR_N * 10.0 / largest(found[0])
    records = (
        Record(
            quantity="share of the red field's energy along the radius (the paper: radial)", unit="",
            paper=1.0, near=0.1, **over(radial_share(f, "red") for f in found),
            explained_by=causes({name: radial_share(f, "red") for name, f in off.items()}),
        ),
        Record(
            quantity=f"largest movement under the pillar with {PILLAR_N:g} N (the paper's force isn't known)",
            unit="px", paper=10.0, **over(largest(f) for f in found),
            explained_by=causes({name: largest(f) for name, f in off.items()}),
        ),
        Record(
            quantity="force that linear theory wants for the paper's largest movement of 10 px, at E = 1 MPa", unit="N",
            twin=heavy,
        ),
    )  # fmt: skip
    red = found[0].layer == "red"
    panel = ArrowPanel(
        title="Red layer, 5 mm pillar along z", tails_px=found[0].rest_px[red], shifts_px=found[0].shift_px[red],
        colours=["#c22f26"] * int(red.sum()), magnified=20.0,
    )  # fmt: skip
    pressure = heavy / (np.pi * 2.5**2)
    note = (
        f"10 px by the pillar alone would take a pressure of {pressure:.1f} times Young's modulus, far beyond any "
        "linear theory: the paper's largest movement (section 5.1) is of another press, of softer rubber, or not of "
        "this pillar."
    )
    return Outcome(records=records, panels=(panel,), notes=(note,))


def _seen(bench: Bench, overrides: dict[str, object]) -> Found:
    rig = bench.rig("kamiyama", overrides=overrides)
    return rig.seen(rig.press(pillar_press()))


DEPTHS_MM = (1.5, 3.0, 4.5, 6.0, 8.0, 10.0)
SPOT_MM = 1.5
"""Radius of the disc that stands for an impulse: smaller than the pitch."""

IMPULSE_N = 1.0


def impulse(axis: int, at_mm: tuple[float, float] = (0.0, 0.0), sign: float = 1.0) -> Load:
    """Return a narrow traction along one axis, standing for an impulse."""
    force = [0.0, 0.0, 0.0]
    force[axis] = sign * IMPULSE_N
    return Traction.disk(at_mm, SPOT_MM, (force[0], force[1], force[2]))


IMPULSES = {0: "fx", 2: "fz"}

_Fields = dict[tuple[int, float], Floats]


def _at_depths(
    bench: Bench,
    depths_mm: Sequence[float],
    overrides: Mapping[str, Any] | None = None,
    tracker: Tracker = OUR_TRACKER,
    motion: Callable[[Rig, Load], Motion] = lambda rig, load: rig.sensor.motion(load),
) -> _Fields:
    """Return (2n,) tracked movements of the red layer, mm at the markers, by axis of the impulse and depth."""
    fields: _Fields = {}
    for depth in depths_mm:
        fewer = {"markers.red.depth_mm": depth, "markers.red.columns": 13, "markers.red.rows": 10}
        rig = bench.rig("kamiyama", overrides={**fewer, **(overrides or {})})
        for axis in IMPULSES:
            found = rig.track(rig.picture(motion(rig, impulse(axis)), 1), tracker)
            red = found.layer == "red"
            scale = np.linalg.norm(rig.image_scale[red][:, :, 0], axis=1)
            fields[axis, depth] = np.nan_to_num(found.shift_px[red] / scale[:, None]).ravel()
    return fields


def _size(field: Floats) -> float:
    return float(np.linalg.norm(field.reshape(-1, 2), axis=1).max())


DEPTH_FIGURES: dict[str, Callable[[Floats, Floats], float]] = {
    "cosine between the fields at 3 mm and at 6 mm (the paper: not orthogonal)": lambda at_3, at_6: cosine(at_3, at_6),
    "largest movement at 6 mm over that at 3 mm": lambda at_3, at_6: _size(at_6) / _size(at_3),
}


def _figure_17(bench: Bench) -> Outcome:
    depths = DEPTHS_MM[1::2] if bench.quick else DEPTHS_MM
    bench.progress("markers at other depths", 0.1)
    fields = _at_depths(bench, depths)
    bench.progress("with causes off", 0.5)
    two = (3.0, 6.0)
    off = {
        NO_NOISE: _at_depths(bench, two, {"ccd.noise": False}),
        PAPERS_TRACKER: _at_depths(bench, two, tracker="two-pass"),
        NO_LENS: _at_depths(bench, two, far_away(bench.rig("kamiyama"))),
        NO_BLOCK: _at_depths(bench, two, motion=half_space_motion),
    }
    records = [
        Record(
            quantity=f"{name}: {what}", unit="", twin=value(*(fields[axis, depth] for depth in two)),
            explained_by=causes({c: value(*(run[axis, depth] for depth in two)) for c, run in off.items()}),
        )
        for what, value in DEPTH_FIGURES.items()
        for axis, name in IMPULSES.items()
    ]  # fmt: skip
    curves = [
        Curve(
            label=f"{name} = {IMPULSE_N:g} N", x=np.array(depths),
            y=1e3 * np.array([_size(fields[axis, depth]) for depth in depths]), style="o-",
        )
        for axis, name in IMPULSES.items()
    ]  # fmt: skip
    panel = CurvePanel(
        title="Largest movement against the markers' depth", curves=curves, across="depth (mm)", up="movement (µm)"
    )
    return Outcome(records=records, panels=(panel,))


def cosine(one: Floats, other: Floats) -> float:
    """Return the cosine of the angle between two fields."""
    return float(one @ other / np.sqrt((one @ one) * (other @ other)))


FIGURE_6 = Entry(
    name="kamiyama/fig-6",
    title="The picture, and its red and blue parts",
    source="Kamiyama, sections 3 and 4.1, Fig. 6",
    protocol="A picture at rest; the difference of red and blue, its positive part the red layer, its negative part "
    "the blue one. The size of a pixel is the nominal pitch over the tracked one.",
    run=_figure_6,
)
FIGURE_9 = Entry(
    name="kamiyama/fig-9",
    title="Red displacement field under a 5 mm pillar",
    source="Kamiyama, section 4.2, Fig. 9, and section 5.1 for the largest movement",
    protocol="The pillar presses along z at the middle without friction; red markers are tracked from rest. The "
    f"force is assumed ({PILLAR_N:g} N at E = 1 MPa).",
    run=_figure_9,
)
FIGURE_17 = Entry(
    name="kamiyama/fig-17",
    title="Movement against depth",
    source="Kamiyama, section 5.1, Fig. 17",
    protocol=f"A unit force on a disc of {SPOT_MM:g} mm radius, along x and along z, with the red layer at other "
    "depths; tracked in pictures and told in mm at the markers.",
    run=_figure_17,
)
