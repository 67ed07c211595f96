"""Beyond the papers: what limits each sensor, and what the half-space costs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.parts.load import Traction
from twin.show.panels import BarPanel, Curve, CurvePanel
from twin.study.calibrate import half_space_compliance
from twin.study.reproduce.bench import Bench
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import far_away
from twin.study.reproduce.reach import DISTANCES_MM, DRAWN, FINER, FORCE_N
from twin.study.reproduce.record import Outcome, Record
from twin.study.reproduce.two_forces import (
    Chain,
    limit_of,
    limit_records,
    point_width_mm,
    shift_noise_px,
    two_points_mm,
)


def _half_space(bench: Bench) -> Outcome:
    """Compare the marker motion of the papers' formula with the real block's, for equal material and load."""
    rig = bench.rig("kamiyama", overrides={"tolerance.preset": "none"})
    scene, sensor = rig.scene, rig.sensor
    points = sensor.nominal_markers.points
    records, curves = [], []
    for axis, name in enumerate("xyz"):
        force = [0.0, 0.0, 0.0]
        force[axis] = 1.0
        load = Traction.rectangle((0.0, 0.0), (4.0, 4.0), (force[0], force[1], force[2]))
        real = sensor.displacement(points, load)
        pieces = sensor.rectangles(load)
        formula = (half_space_compliance(scene, points, pieces) @ pieces.force_n.ravel()).reshape(-1, 3)
        row = np.flatnonzero(np.abs(points[:, 1]) < 0.8)
        for layer in ("red", "blue"):
            mine = sensor.nominal_markers.layer == layer
            largest = np.linalg.norm(real[mine], axis=1).max()
            gap = float(np.linalg.norm(formula[mine] - real[mine], axis=1).max() / largest)
            records.append(
                Record(
                    quantity=f"force along {name}, {layer} layer: half-space off by, over the largest motion",
                    unit="",
                    twin=gap,
                )
            )
            row = np.flatnonzero(mine & (np.abs(points[:, 1]) < 0.8))
            order = row[np.argsort(points[row, 0])]
            if axis != 1 and layer == "blue":
                across = points[order, 0]
                curves += [
                    Curve(label=f"f{name}: block", x=across, y=1e3 * real[order, axis]),
                    Curve(label=f"f{name}: half-space", x=across, y=1e3 * formula[order, axis], style=":"),
                ]
    panel = CurvePanel(
        title="Blue layer along the x axis, 1 N on 4 x 4 mm: motion along the force", curves=curves, across="x (mm)",
        up="motion (µm)",
    )  # fmt: skip
    note = "No picture here: this is the model itself, the papers' formula against the converged block of equal rubber."
    return Outcome(records=records, panels=(panel,), notes=(note,))


FLAT_CHANGES: dict[str, Mapping[str, Any]] = {
    "as published": {},
    "noise off": {"ccd.noise": False},
    "markers 3 and 1.5 mm deep": {"markers.red.depth_mm": 3.0, "markers.blue.depth_mm": 1.5},
    "markers 1 mm apart": {
        "markers.red.pitch_mm": 1.0, "markers.blue.pitch_mm": 1.0, "markers.red.diameter_mm": 0.35,
        "markers.blue.diameter_mm": 0.35,
    },
    "told of the real block": {"calibration.method": "compliance"},
    "made exactly as drawn": {"tolerance.preset": "none"},
}  # fmt: skip
FINGER_CHANGES: dict[str, Mapping[str, Any]] = {
    "as published, told of its drawing": DRAWN,
    "noise off": DRAWN | {"ccd.noise": False},
    "markers 1 mm apart": FINER,
    "markers 1.0 and 2.0 mm deep": DRAWN | {"markers.red.depth_mm": 1.0},
    "made exactly as drawn": DRAWN | {"tolerance.preset": "none"},
}


def _limits(bench: Bench) -> Outcome:
    """Change one thing at a time, with the paper's tracker and inverse."""
    records: list[Record] = []
    panels = []
    far = {"lens: seen from far away": far_away(bench.rig("kamiyama"))}
    for number, (paper, changes, method) in enumerate(
        (("kamiyama", {**FLAT_CHANGES, **far}, "norm"), ("sato", FINGER_CHANGES, "pinv"))
    ):
        width: dict[str, float] = {}
        apart: dict[str, float] = {}
        least_width: dict[str, float] = {}
        least_apart: dict[str, float] = {}
        kept = list(changes.items())[:2] if bench.quick else list(changes.items())
        for step, (name, overrides) in enumerate(kept):
            bench.progress(f"{paper}, {name}", (number + step / len(kept)) / 2)
            chain = Chain(paper=paper, overrides=overrides, method=method)  # type: ignore[arg-type]
            noise = max(shift_noise_px(bench, chain), 1e-3)
            limit = limit_of(chain.rig(bench), noise, FORCE_N, 1.0)
            width[name] = point_width_mm(bench, chain, FORCE_N)
            apart[name] = two_points_mm(bench, chain, FORCE_N, DISTANCES_MM)
            least_width[name] = float(limit.fwhm_normal_mm[0])
            least_apart[name] = float(limit.two_point_mm[0])
            records += [
                Record(
                    quantity=f"{paper}, {name}: full width at half maximum of a narrow force",
                    unit="mm", twin=width[name],
                ),
                Record(
                    quantity=f"{paper}, {name}: least distance of two narrow forces", unit="mm", twin=apart[name]
                ),
                Record(quantity=f"{paper}, {name}: noise of a shift", unit="px", twin=noise),
                *limit_records(f"{paper}, {name}", limit),
            ]  # fmt: skip
        label = {"kamiyama": "Flat sensor", "sato": "Finger"}[paper]
        panels += [
            BarPanel(
                title=f"{label}: width of a narrow force", values=width, across="full width at half maximum (mm)",
                marks=least_width, marked="closed-form limit of the design",
            ),
            BarPanel(
                title=f"{label}: two forces told apart", values=apart, across="least distance (mm)",
                marks=least_apart, marked="closed-form limit of the design",
            ),
        ]  # fmt: skip
    note = (
        "The limits are of a half-space seen straight on, by two layers with noise but no print errors. The width of "
        "one force can come out below: the finger's pseudo-inverse sharpens it at the price of what stands beside it, "
        "so read it with the distance at which two are told apart."
    )
    return Outcome(records=records, panels=panels, notes=(note,))


HALF_SPACE = Entry(
    name="beyond/half-space",
    title="The papers' half-space against the real block",
    source="Kamiyama, section 3: the elastic body must be large enough to satisfy the half-space assumption",
    protocol="A force of 1 N on 4 x 4 mm along each axis; the motion of the markers by the papers' formula and by "
    "the block of 100 x 90 x 40 mm bonded to its plate.",
    run=_half_space,
)
LIMITS = Entry(
    name="beyond/limits",
    title="What limits each sensor",
    source="beyond the papers",
    protocol="The papers' tracker and inverse on the papers' sensors, with one thing changed at a time: noise, "
    "depth, pitch, lens, model. A narrow force of 1 N, and two of them ever further apart; beside them the design's "
    "closed-form limit.",
    run=_limits,
    long=True,
)
