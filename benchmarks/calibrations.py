"""Calibrations of twenty made fingers against each other: the nominal design, and it fitted to presses.

Noise: .05 px in every component of a shift, .02 px at rest, 5 mN in every component of the load cell. Errors: of the
transfer matrix of a square site, |H^ - H| / |H|; of the force and the place of a 3 mm sphere's press (1 N), at a known
place and where the place is sought; of the total of a distributed load, from the field on the scene's sites.

``python -m benchmarks.calibrations`` writes the stored results into docs/calibrations.md.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.__main__ import RESULTS, table
from benchmarks.inverse import NOISE_PX, as_found
from benchmarks.inverse_truth import BETWEEN, EDGE, LAWN, SENSORS, Truth, design, sensors
from twin.arrays import Floats
from twin.parts.load import Rectangles
from twin.parts.pipeline import Sites
from twin.parts.scene import Scene
from twin.sense.calibration import Calibration
from twin.sense.fit_design import Fit, Presses, fit
from twin.sense.reconstruct import reconstruct
from twin.sense.single import single_contact
from twin.sense.transfer import fill_between, from_presses
from twin.study.calibration_presses import FOOTPRINT, hertz_radius
from twin.study.fitted import FittedDesign
from twin.study.sites import on_grid, on_surface

PAGE = Path(__file__).parent.parent / "docs" / "calibrations.md"
REST_PX, CELL_N = 0.02, 0.005
PLACES: dict[int, list[tuple[float, float]]] = {
    0: [],
    1: [(0.0, 0.0)],
    2: [(2.5, 2.5), (-2.5, -2.5)],
    5: [(0.0, 0.0), (2.5, 2.5), (2.5, -2.5), (-2.5, 2.5), (-2.5, -2.5)],
}
PLACES[9] = [*PLACES[5], (5.0, 5.0), (5.0, -5.0), (-5.0, 5.0), (-5.0, -5.0)]
PLACES[25] = LAWN
GRID = np.arange(-5.0, 5.1, 2.5)
"""Of Sato's places, along either direction, mm."""

MEASURED = {"Sato's H, interpolated": False, "Sato's H, the design in between": True}
"""Ways of using a free matrix between the pressed places: whether the nominal design carries the shape."""

FINE = Sites(columns=17, rows=17, pitch_mm=0.7)
"""Sites that a single contact is sought between."""

BUMPS = 6

SINGLE = "fitted, one press at each of {} places"
"""Press n is along z, with shear along x, or with shear along y, by turns."""

FEW = 7
"""Sensors without a cover: what doesn't need twenty."""

FEWEST = 3
"""Sensors that tell how many presses are needed."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a way and truth; the quick form has two sensors, without a cover."""
    if quick:
        return summary(study(range(2), covered=False, counts=(0, 5)))
    cases = study(range(SENSORS), covered=True, counts=(5,)) + study(range(FEW), covered=False, counts=(5, 0))
    cases += study(range(SENSORS), covered=True, counts=(5,), single=True)
    cases += study(range(FEWEST), covered=False, counts=(1, 2, 9, 25))
    cases += free_matrices(range(FEW))
    return summary(cases)


def study(numbers: Any, covered: bool, counts: tuple[int, ...], single: bool = False) -> list[dict[str, Any]]:
    """Return the errors of every sensor and way; see `measured` for ``single``."""
    scene = design()
    truth, out = Truth(scene, sensors(scene), covered), []
    for count in counts:
        chart = PLACES[count]
        places = on_surface(scene.body, np.array(chart or [(0.0, 0.0)]), 0.5, "places")
        radius = [hertz_radius(scene, scene.calibration.press_force_n * float(n)) for n in places.frames[:, 2, 2]]
        twin = FittedDesign(scene, places, np.array(radius))
        for number in numbers:
            presses = measured(truth, number, chart, single)
            found = fit(twin, presses) if chart else drawn(twin)
            case = {"places": count, "covered": covered, "sensor": number}
            if single:
                case["way"] = SINGLE.format(count)
            out.append(case | errors(truth, number, twin, found, presses))
            print(json.dumps(out[-1]), file=sys.stderr, flush=True)
    return out


def measured(truth: Truth, number: int, chart: list[tuple[float, float]], single: bool = False) -> Presses:
    """Return what is measured on one sensor at the given places; ``single``: one press a place, its kinds by turns."""
    random = np.random.default_rng([number, 1])
    steps = [step for place in chart for step in truth.press(place, 3)]
    rest = truth.rest_px()[number]
    forces = np.array([step.force_n[number] for step in steps]).reshape(-1, 3)
    shifts = np.array([step.shift_px[number] for step in steps]).reshape(-1, *rest.shape)
    kept = [3 * place + place % 3 for place in range(len(chart))] if single else slice(None)
    return Presses(
        place=np.repeat(np.arange(len(chart)), 3)[kept],
        force_n=(forces + random.normal(0, CELL_N, forces.shape))[kept],
        shift_px=(shifts + random.normal(0, NOISE_PX, shifts.shape))[kept],
        rest_px=rest + random.normal(0, REST_PX, rest.shape), load_cell_n=CELL_N, noise_px=NOISE_PX,
    )  # fmt: skip


def drawn(twin: FittedDesign) -> Fit:
    """Return the design as drawn."""
    zero = np.zeros(len(twin.names))
    return Fit(
        names=twin.names, scaled=zero, covariance=np.eye(len(zero)), residual_px=0.0, model_px=0.0, left_out=zero
    )  # fmt: skip


def errors(truth: Truth, number: int, twin: FittedDesign, found: Fit, presses: Presses) -> dict[str, float]:
    """Return one sensor's errors by a fit."""
    scene = truth.scene
    rest = presses.rest_px if found.residual_px else np.full_like(presses.rest_px, np.nan)
    markers, _ = twin.markers_of(found.scaled, rest)
    transfer = twin.transfer(found.scaled, markers, twin.compliance(found.scaled, markers, squares(scene)))
    fine = calibration(scene, twin, found, markers, FINE)
    out = {"residual_px": found.residual_px}
    out |= known_errors(truth, number, transfer, fine, twin.footprint_mm(found.scaled, 0))
    if not truth.covered:
        out |= totals(truth, number, calibration(scene, twin, found, markers, scene.reconstruction.sites))
    return out


def free_matrices(numbers: Any) -> list[dict[str, Any]]:
    """Return every sensor's errors by a free matrix, measured at Sato's 25 places by 75 presses."""
    scene = design()
    truth, out = Truth(scene, sensors(scene), False), []
    radius = hertz_radius(scene, scene.calibration.press_force_n)
    places = on_surface(scene.body, np.array(LAWN), FOOTPRINT * radius, "places")
    twin = FittedDesign(scene, places, np.full(len(places), radius))
    for number in numbers:
        presses = measured(truth, number, LAWN)
        found = drawn(twin)
        markers, _ = twin.markers_of(found.scaled, np.full_like(presses.rest_px, np.nan))
        own = from_presses(
            presses.force_n.reshape(-1, 3, 3).transpose(0, 2, 1), presses.shift_px.reshape(len(LAWN), 3, -1)
        )

        def nominal(at: Rectangles, found: Fit = found, markers: Floats = markers) -> Floats:
            return twin.transfer(found.scaled, markers, twin.compliance(found.scaled, markers, at))

        fine = calibration(scene, twin, found, markers, FINE)
        coarse = calibration(scene, twin, found, markers, scene.reconstruction.sites)
        wanted = {"squares": nominal(squares(scene)), "fine": fine.transfer, "coarse": coarse.transfer}
        charts = {
            "squares": np.array(BETWEEN + EDGE), "fine": FINE.chart(), "coarse": scene.reconstruction.sites.chart(),
        }  # fmt: skip
        there = nominal(places)
        for name, helped in MEASURED.items():
            filled = {
                key: fill_between(own, helped * there, helped * value, (GRID, GRID), charts[key])
                for key, value in wanted.items()
            }
            case: dict[str, Any] = {"places": 25, "covered": False, "sensor": number, "way": name, "residual_px": 0.0}
            case |= known_errors(truth, number, filled["squares"], linear(fine, filled["fine"]), radius)
            case |= totals(truth, number, linear(coarse, filled["coarse"]))
            out.append(case)
            print(json.dumps(case), file=sys.stderr, flush=True)
    return out


def squares(scene: Scene) -> Rectangles:
    """Return the squares whose transfer is compared."""
    return on_surface(scene.body, np.array(BETWEEN + EDGE), 0.625, "squares")


def linear(one: Calibration, transfer: Floats) -> Calibration:
    """Return a calibration with another transfer matrix and no camera to follow."""
    return replace(
        one, transfer=transfer, compliance=np.zeros((0, 0), np.float32), marker_mm=np.zeros((0, 3)), camera="{}"
    )  # fmt: skip


def known_errors(truth: Truth, number: int, transfer: Floats, fine: Calibration, radius: float) -> dict[str, float]:
    """Return the errors of a (2n, 3q) transfer at the squares, and of presses there by a calibration on `FINE`."""
    out = {}
    for index, place in enumerate(BETWEEN + EDGE):
        exact = truth.square(place, 0.625)[number]
        part = transfer.reshape(len(transfer), -1, 3)[:, index]
        out[f"transfer {place}"] = float(np.linalg.norm(part - exact) / np.linalg.norm(exact))
        step = truth.press(place, 1)[0]
        random = np.random.default_rng([number, 2, index])
        told = as_found(fine, step.shift_px[number] + random.normal(0, NOISE_PX, fine.layout_px.shape))
        force = step.force_n[number]
        known = (place[0] / FINE.pitch_mm + 8, place[1] / FINE.pitch_mm + 8)
        at_place = single_contact(told, fine, place=known, radius_mm=radius)
        sought = single_contact(told, fine, radius_mm=radius)
        centre = truth.scene.body.chart_points(np.array([place]))[0]
        out[f"known {place}"] = float(np.linalg.norm(at_place.force_n - force) / np.linalg.norm(force))
        out[f"sought {place}"] = float(np.linalg.norm(sought.force_n - force) / np.linalg.norm(force))
        out[f"place_mm {place}"] = float(np.linalg.norm(sought.place_mm - centre))
    return out


def totals(truth: Truth, number: int, own: Calibration) -> dict[str, float]:
    """Return the total's error under distributed loads, by this calibration and by the exact transfer matrix."""
    exact = linear(own, truth.sites()[number])
    wrong: dict[str, list[float]] = {"total": [], "total, exact H": []}
    for seed in range(BUMPS):
        (step,), _ = truth.bumps(seed)
        random = np.random.default_rng([number, 3, seed])
        shift = step.shift_px[number] + random.normal(0, NOISE_PX, own.layout_px.shape)
        for name, one in (("total", own), ("total, exact H", exact)):
            field = reconstruct(as_found(one, shift), one)
            force = step.force_n[number]
            wrong[name].append(float(np.linalg.norm(field.total_force_n - force) / np.linalg.norm(force)))
    return {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in wrong.items()}


def calibration(scene: Scene, twin: FittedDesign, found: Fit, markers: Floats, grid: Sites) -> Calibration:
    """Return a calibration at any sites."""
    sites = on_grid(scene.body, grid, grid.pitch_mm / 2, "sites")
    compliance = twin.compliance(found.scaled, markers, sites)
    return Calibration(
        layer=np.repeat(list(scene.markers), [v.columns * v.rows for v in scene.markers.values()]),
        layout_px=twin.seen(found.scaled, markers), site_mm=sites.centre_mm, site_frames=sites.frames,
        site_area_mm2=np.full(len(sites), grid.pitch_mm**2), grid=(grid.columns, grid.rows),
        transfer=twin.transfer(found.scaled, markers, compliance), noise_px=NOISE_PX,
        compliance=compliance.astype(np.float32), marker_mm=markers, camera=twin.optics(found.scaled),
    )  # fmt: skip


def summary(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row a way and truth: root mean square and worst over sensors and places, percent and mm."""
    rows = []
    for covered, count, way in sorted({(c["covered"], c["places"], c.get("way", "")) for c in cases}):
        mine = [c for c in cases if (c["covered"], c["places"], c.get("way", "")) == (covered, count, way)]
        row: dict[str, Any] = {
            "truth": "covered" if covered else "bare",
            "calibration": way or (f"fitted, {count} place{'s' * (count > 1)}" if count else "as drawn"),
            "presses": count if way == SINGLE.format(count) else 3 * count,
            "sensors": len(mine),
        }
        for what, scale, unit in (
            ("transfer", 100, " %"),
            ("known", 100, " %"),
            ("sought", 100, " %"),
            ("place_mm", 1, ""),
        ):
            for name, places in (("", BETWEEN), (", edge", EDGE)):
                values = scale * np.array([[c[f"{what} {place}"] for place in places] for c in mine])
                row[f"{what}{unit}{name}"] = float(np.sqrt(np.mean(values**2)))
                row[f"{what}{unit}{name}, worst"] = float(values.max())
        if not covered:
            for name in ("total", "total, exact H"):
                row[f"{name} %"] = 100 * float(np.sqrt(np.mean([c[name] ** 2 for c in mine])))
        rows.append(row)
    return rows


def main() -> None:
    """Write docs/calibrations.md from the stored results."""
    stored = json.loads((RESULTS / "calibrations.json").read_text())
    told = [
        {
            "truth": row["truth"], "calibration": row["calibration"], "presses": row["presses"],
            "sensors": row["sensors"],
            "transfer, between %": row["transfer %"], "transfer, edge %": row["transfer %, edge"],
            "transfer, worst %": max(row["transfer %, worst"], row["transfer %, edge, worst"]),
            "force at a known place %": row["known %"], "edge %": row["known %, edge"],
            "force, place sought %": row["sought %"],
            "place mm": row["place_mm"], "place, edge mm": row["place_mm, edge"],
        }
        for row in stored["rows"]
    ]  # fmt: skip
    PAGE.write_text(
        f"# How many presses a calibration needs\n\n{(__doc__ or '').split('``python')[0].strip()}\n\n"
        "A place is three presses: along z, then with shear along x, then along y. `fitted, n places` is the nominal "
        "design with its stiffness, depths, print, camera and footprint fitted to n places and the rest picture.\n\n"
        f"{table(told)}\n\n"
        "**One place is enough** on a bare finger: what the fit leaves hardly depends on how many places were pressed, "
        "and is a fraction of what the drawing alone is wrong by. The likely reason is that the rest picture tells "
        "depths, print and camera, and any place the stiffness. With a cover that the fit knows nothing of, about "
        "twice as much is left.\n\n"
        f"{against_sato(stored['rows'])}\n\n"
        "Rows with few sensors say little about the worst case. Shifts here are projected, with noise drawn. Through "
        "rendered pictures, tracked, `tests/study/test_fitted_pictures.py` leaves .37 % of the transfer matrix on the "
        "sites of a flat sensor (as drawn: .57 %) and .88 % of a finger's (1.12 %) after five places, and .48 % of "
        "another flat one's after two, from a folder of pictures with a table of forces. The truth is "
        "solved on another mesh, by contact, with lens distortion and another Poisson's ratio.\n\n"
        "Run again with `python -m benchmarks calibrations`, then `python -m benchmarks.calibrations`.\n"
    )


def against_sato(rows: list[dict[str, Any]]) -> str:
    """Say what 75 presses as a free matrix leave, against fits to fewer."""
    by_name = {row["calibration"]: row for row in rows if row["truth"] == "bare"}
    plain, helped = (by_name[name] for name in MEASURED)
    few = by_name["fitted, 5 places"]
    return (
        f"**Sato's way**, the {plain['presses']} presses of the finger paper's 25 places as a free matrix, leaves "
        f"{plain['transfer %']:.1f} % of the transfer matrix between the places where it is interpolated linearly, and "
        f"{helped['transfer %']:.1f} % where the design as drawn carries the shape and only its error is interpolated; "
        f"{few['presses']} presses with the fit leave {few['transfer %']:.2f} %, "
        f"{plain['transfer %'] / few['transfer %']:.0f} and {helped['transfer %'] / few['transfer %']:.1f} times less. "
        "The press's footprint is part of a measured matrix: it is that of a 3 mm sphere, not of the square it is "
        "compared with."
    )


if __name__ == "__main__":
    main()
