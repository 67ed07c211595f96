"""What the flat sensor's camera sees: Kamiyama's Figs. 6, 9 and 17."""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.parts.load import Load, Traction
from twin.parts.press import Cylinder, Press
from twin.sense.track import Found
from twin.show.panels import ArrowPanel, Curve, CurvePanel, PicturePanel
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import far_away
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
        "tracker: this project's instead of the paper's": rig.seen(state, method=OUR_TRACKER),
        "noise off": _seen(bench, {"ccd.noise": False}),
        "lens: seen from far away": _seen(bench, far_away(rig)),
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


def _figure_17(bench: Bench) -> Outcome:
    depths = DEPTHS_MM[1::2] if bench.quick else DEPTHS_MM
    size: dict[int, list[float]] = {0: [], 2: []}
    fields: dict[int, list[Floats]] = {0: [], 2: []}
    for number, depth in enumerate(depths):
        bench.progress(f"markers {depth:g} mm deep", number / len(depths))
        fewer = {"markers.red.depth_mm": depth, "markers.red.columns": 13, "markers.red.rows": 10}
        rig = bench.rig("kamiyama", overrides=fewer)
        for axis in (0, 2):
            motion = rig.sensor.motion(impulse(axis))
            found = rig.track(rig.picture(motion, 1), OUR_TRACKER)
            red = found.layer == "red"
            scale = np.linalg.norm(rig.image_scale[red][:, :, 0], axis=1)
            moved = found.shift_px[red] / scale[:, None]
            size[axis].append(float(np.nanmax(np.linalg.norm(moved, axis=1))))
            fields[axis].append(np.nan_to_num(moved).ravel())
    names = {0: "fx", 2: "fz"}
    curves = [
        Curve(label=f"{names[axis]} = {IMPULSE_N:g} N", x=np.array(depths), y=1e3 * np.array(size[axis]), style="o-")
        for axis in (0, 2)
    ]
    three, six = depths.index(3.0), depths.index(6.0)
    records = [
        Record(
            quantity=f"cosine between the fields at 3 mm and at 6 mm, {names[axis]} (the paper: not orthogonal)",
            unit="", twin=cosine(fields[axis][three], fields[axis][six]),
        )
        for axis in (0, 2)
    ] + [
        Record(
            quantity=f"largest movement at 6 mm over that at 3 mm, {names[axis]}", unit="",
            twin=size[axis][six] / size[axis][three],
        )
        for axis in (0, 2)
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
