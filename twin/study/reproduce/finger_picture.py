"""What the finger sees and feels: Sato's Figs. 6 and 7."""

from __future__ import annotations

import numpy as np

from twin.parts.press import Press, Sphere
from twin.show.panels import ArrowPanel, Panel, PicturePanel
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import NO_NOISE_AT_ALL, OURS_AT_ALL, SMOOTH, circle_mm, field_panel, scored, solved
from twin.study.reproduce.finger_calibration import OUR_WAY, QUIET, calibrated_without, said
from twin.study.reproduce.record import Outcome, Record, causes, over
from twin.world.contact.contact import ContactState

GRAM_FORCE_N = 9.80665e-3
PITCH_MM = 2.5
EXPOSURES = 5


def sphere_press(place_mm: tuple[float, float], gram_force: float) -> Press:
    """Return a press of the 3 mm sphere along z at a place of the surface chart (arc lengths s and t), sticking."""
    return Press(
        probe=Sphere(diameter_mm=3), at_mm=place_mm, force_n=(None, None, gram_force * GRAM_FORCE_N), friction=np.inf
    )


def above(rig: Rig, chart_mm: tuple[float, float]) -> tuple[float, float]:
    """Return (x, y) of the surface point with these arc lengths, mm."""
    x, y, _ = rig.scene.body.chart_points(np.array([chart_mm]))[0]
    return float(x), float(y)


def _figure_6(bench: Bench) -> Outcome:
    rig = bench.rig("sato")
    rests = [bench.rig("sato", seed).rest(OUR_TRACKER) for seed in bench.seeds("sato", pressed=False)]
    points = rig.sensor.sites.centre_mm
    marks = rig.sensor.project(points, "nominal")
    records = (
        Record(
            quantity="width of a marker in the picture", unit="px", paper=15.0, near=5.0,
            **over(float(np.mean([group.diameter_px for group in rest.groups])) for rest in rests),
        ),
        Record(quantity="points where force is applied", unit="", paper=25.0, twin=float(len(points))),
        Record(
            quantity="share of markers found", unit="",
            **over(float(np.isfinite(rest.rest_px).all(axis=1).mean()) for rest in rests),
        ),
    )  # fmt: skip
    picture = rig.picture(None, 0)
    return Outcome(
        records=records,
        panels=(
            PicturePanel(title="The picture at rest", picture=picture),
            PicturePanel(title="The 25 points where force is applied", picture=picture, marks_px=marks),
        ),
        notes=("The paper tells 15 px in section II D and 10 to 20 px in section IV.",),
    )


def _figure_7(bench: Bench) -> Outcome:
    rig = bench.rig("sato")
    bench.progress("press", 0.2)
    states: dict[str, ContactState] = {"on a calibrated point": rig.press(sphere_press((0.0, 0.0), 100))}
    if not bench.quick:
        states["between four"] = rig.press(sphere_press(above(rig, (1.25, 1.25)), 100))
    records: list[Record] = []
    panels: list[Panel] = []
    for where, state in states.items():
        bench.progress(where, 0.6)
        told = rig.calibration
        fields = [solved(rig.seen(state, 30 + k), told, "pinv") for k in range(EXPOSURES)]
        quiet = bench.rig("sato", overrides=QUIET)
        off = {
            said(bench, NO_NOISE_AT_ALL): solved(quiet.seen(state, 30), calibrated_without(bench, QUIET), "pinv"),
            said(bench, OURS_AT_ALL): solved(
                rig.seen(state, 30, OUR_TRACKER), calibrated_without(bench, OUR_WAY), "pinv"
            ),
            SMOOTH: solved(rig.seen(state, 30), told, "smooth"),
        }
        for name, unit, key in (
            ("field error", "", "field_error"), ("error of the total force", "", "total_force_error"),
            ("error of the centre of pressure", "mm", "centre_error_mm"),
        ):  # fmt: skip
            records.append(
                Record(
                    quantity=f"3 mm sphere, 100 gf, {where}: {name} (n exposures)", unit=unit,
                    **over(_known(scored(rig, state, f)[key]) for f in fields),
                    explained_by=causes({n: _known(scored(rig, state, f)[key]) for n, f in off.items()}),
                )
            )  # fmt: skip
        found = rig.seen(state, 30)
        if not panels:
            colours = ["#c22f26" if name == "red" else "#2161c2" for name in found.layer]
            panels.append(
                ArrowPanel(
                    title="Markers under the sphere", tails_px=found.rest_px, shifts_px=found.shift_px, colours=colours,
                    magnified=3.0,
                )
            )  # fmt: skip
        radius = state.contact_radius_mm
        at = above(rig, (1.25, 1.25)) if where == "between four" else (0.0, 0.0)
        panels.append(field_panel(f"Force field, sphere {where}", fields[0], circle_mm(radius, at), PITCH_MM))
    return Outcome(records=records, panels=panels)


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


FIGURE_6 = Entry(
    name="sato/fig-6",
    title="The picture, and the 25 points where force is applied",
    source="Sato, section II D, Fig. 6",
    protocol="A picture at rest, and the calibrated points seen through the nominal camera.",
    run=_figure_6,
)
FIGURE_7 = Entry(
    name="sato/fig-7",
    title="The force field of a contact",
    source="Sato, section II D, Fig. 7",
    protocol="The 3 mm sphere presses with 100 gf along z, on a calibrated point and between four; the paper's "
    "tracker, its calibration by presses and the pseudo-inverse of equation 2.",
    run=_figure_7,
)
