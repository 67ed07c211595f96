"""Calibrations of twenty made fingers against each other: the nominal design, and it fitted to presses.

Noise: .05 px in every component of a shift, .02 px at rest, 5 mN in every component of the load cell. Errors: of the
transfer matrix of a square site, |H^ - H| / |H|; of the total of a distributed load, from the field on the scene's
sites.

The truth: presses on twenty made fingers, as shifts of their markers. They differ in stiffness, depths, print, camera
and lens, none of which changes the contact but for the scale of the forces: at equal indentation displacements stay and
forces grow with Young's modulus. So every press is solved once, for all of them, and its field is read at all their
markers. They share Poisson's ratio, 0.499. With a cover (1.5 times the body's modulus) the tractions of the same press
without one are put on the covered body.
"""

import json
import sys
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np

from benchmarks.inverse import NOISE_PX, as_found
from twin.arrays import Floats
from twin.parts.load import Load, Rectangles, Traction
from twin.parts.scene import Scene, Sites
from twin.sense.calibration import Calibration, fill_between, from_presses
from twin.sense.fit_design import Fit, Presses
from twin.sense.reconstruct import reconstruct
from twin.study.calibrate import FOOTPRINT, calibration_press
from twin.study.fitted_design import FittedDesign
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.contact import hertz
from twin.theory.optics import project, project_with_jacobian
from twin.world.elasticity.coated import CoveredCompliance
from twin.world.elasticity.fem import TaylorHood

SENSORS = 20
NU = 0.499
COVER = 1.5
HALF_MM = 0.5
LAWN = [(a, b) for a in (-5.0, -2.5, 0.0, 2.5, 5.0) for b in (-5.0, -2.5, 0.0, 2.5, 5.0)]
"""Sato's 25 places (surface coordinates, mm)."""

BETWEEN = [(1.25, 1.25), (-1.25, 1.25), (1.25, -3.75)]
"""Places at half a pitch."""

EDGE = [(5.0, 1.25), (-5.0, -1.25), (1.25, 5.0)]
"""Places on the edge, between Sato's."""


def design() -> Scene:
    """Return the nominal finger: the shipped scene's, with room for lens distortion."""
    return load_scene("sato_press", overrides={"tolerance.distortion": 0.01, "calibration.method": "compliance"})


def sensors(scene: Scene, count: int = SENSORS) -> list[Sensor]:
    """Return made sensors."""
    return [Sensor(scene.model_copy(update={"seed": 100 + number})) for number in range(count)]


@dataclass(frozen=True)
class Measured:
    """One load: (s, 3) total forces on all sensors, and (s, n, 2) motion of their markers, px, without noise."""

    force_n: Floats
    shift_px: Floats


class Truth:
    """Loads on all sensors, each solved once."""

    def __init__(self, scene: Scene, made: list[Sensor], covered: bool) -> None:
        self.scene, self.made, self.covered = scene, made, covered
        material = scene.material.model_copy(update={"poisson_ratio": NU})
        tolerance = scene.tolerance.model_copy(update={"preset": "none"})
        self.sensor = Sensor(scene.model_copy(update={"material": material, "tolerance": tolerance}))
        self.points = np.concatenate([one.actual.markers.points for one in made])
        self.rest_px = np.stack([one.project(one.actual.markers.points) for one in made])
        modulus = scene.material.youngs_modulus_mpa
        self.stiffer = [one.actual.scene.material.youngs_modulus_mpa / modulus for one in made]
        self.press = cache(self._press)
        self.square = cache(self._square)
        self.bumps = cache(self._bumps)
        self._body = lru_cache(1)(self._body_at)

    def _press(self, chart: tuple[float, float]) -> list[Measured]:
        """Return a calibration press's steps: along z, then with shear along x, then along y."""
        square = Rectangles.on_surface(self.scene.body, np.array([chart]), HALF_MM, "press")
        path = self.sensor.press(calibration_press(self.sensor.nominal, square, 0)).path
        print(f"pressed {chart}", file=sys.stderr, flush=True)
        return [self._measured(self._body(chart), self.sensor.rectangles(state.load)) for state in path]

    def _square(self, chart: tuple[float, float], half_mm: float) -> Floats:
        """Return (s, 2n, 3) px/N of a uniform square, exact and linear."""
        square = Rectangles.on_surface(self.scene.body, np.array([chart]), half_mm, "square")
        compliance = self._body(chart).to_points(self.points, square)
        found = []
        parts = compliance.reshape(len(self.made), -1, 3, 3)
        for one, part, stiffer in zip(self.made, parts, self.stiffer, strict=True):
            scene, points = one.actual.scene, one.actual.markers.points
            slope = project_with_jacobian(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)[
                1
            ]
            found.append((slope @ part).reshape(2 * len(slope), -1) / stiffer)
        return np.stack(found)

    def _bumps(self, seed: int) -> Measured:
        """Return a load of several bumps, drawn anew for every seed."""
        return self._measured(self.sensor.compliance, self.sensor.rectangles(drawn_bumps(seed)))

    def _body_at(self, chart: tuple[float, float]) -> Any:
        """Return the body's compliance; a covered one has a mesh for every place, of which the last is kept."""
        if not self.covered:
            return self.sensor.compliance
        scene, layer = self.sensor.nominal, TaylorHood.Layer(modulus_ratio=COVER, poisson_ratio=NU)
        return CoveredCompliance(scene.body, scene.material, 0.2, layer, level="coarse")

    def _measured(self, body: Any, load: Rectangles) -> Measured:
        there = (self.points + body.displacement(self.points, load)).reshape(len(self.made), -1, 3)
        seen = [one.project(points) for one, points in zip(self.made, there, strict=True)]
        return Measured(np.outer(self.stiffer, load.force_n.sum(axis=0)), np.stack(seen) - self.rest_px)


@cache
def truth_of(covered: bool) -> Truth:
    """Return the truth of all made sensors."""
    scene = design()
    return Truth(scene, sensors(scene), covered)


def drawn_bumps(seed: int) -> Load:
    """Return three bumps of 1.5 to 3 mm radius, a newton each, with some shear."""
    random = np.random.default_rng(seed)
    load = Load()
    for _ in range(3):
        centre, shear = random.uniform(-3, 3, 2).tolist(), random.normal(0, 0.15, 2).tolist()
        load = load + Traction.bump(centre, float(random.uniform(1.5, 3)), (*shear, 1.0))
    return load


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


BUMPS = 6

SINGLE = "fitted, one press at each of {} places"
"""Press n is along z, with shear along x, or with shear along y, by turns."""

FEW = 7
"""Sensors without a cover: what doesn't need twenty."""

FEWEST = 3
"""Sensors that tell how many presses are needed."""


def measure(quick: bool) -> list[dict[str, Any]]:
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
    truth, out = truth_of(covered), []
    scene = truth.scene
    for count in counts:
        chart = PLACES[count]
        places = Rectangles.on_surface(scene.body, np.array(chart or [(0.0, 0.0)]), 0.5, "places")
        radius = [contact_radius(scene, float(n)) for n in places.frames[:, 2, 2]]
        twin = FittedDesign(scene, places, np.array(radius))
        for number in numbers:
            presses = measured(truth, number, chart, single)
            found = Fit.of(twin, presses) if chart else drawn(twin)
            case = {"places": count, "covered": covered, "sensor": number}
            if single:
                case["way"] = SINGLE.format(count)
            out.append(case | errors(truth, number, twin, found, presses))
            print(json.dumps(out[-1]), file=sys.stderr, flush=True)
    return out


def measured(truth: Truth, number: int, chart: list[tuple[float, float]], single: bool = False) -> Presses:
    """Return what is measured on one sensor at the given places; ``single``: one press a place, its kinds by turns."""
    random = np.random.default_rng([number, 1])
    steps = [step for place in chart for step in truth.press(place)]
    rest = truth.rest_px[number]
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
    zero, given = np.zeros(len(twin.names)), np.eye(len(twin.names))
    return Fit(names=twin.names, scaled=zero, covariance=given, residual_px=0.0, model_px=0.0, left_out=zero)


def errors(truth: Truth, number: int, twin: FittedDesign, found: Fit, presses: Presses) -> dict[str, float]:
    """Return one sensor's errors by a fit."""
    scene = truth.scene
    rest = presses.rest_px if found.residual_px else np.full_like(presses.rest_px, np.nan)
    markers, _ = twin.markers_of(found.scaled, rest)
    transfer = twin.transfer(found.scaled, markers, twin.compliance(found.scaled, markers, squares(scene)))
    out = {"residual_px": found.residual_px, **transfer_errors(truth, number, transfer)}
    if not truth.covered:
        out |= totals(truth, number, calibration(scene, twin, found, markers, scene.reconstruction.sites))
    return out


def contact_radius(scene: Scene, share: float = 1.0) -> float:
    """Return the nominal contact radius of the calibration sphere under a share of its force, mm."""
    rubber = scene.material
    return hertz(
        radius_mm=scene.calibration.press_probe_mm / 2,
        youngs_modulus_mpa=rubber.youngs_modulus_mpa,
        poisson_ratio=rubber.poisson_ratio,
        force_n=share * scene.calibration.press_force_n,
    ).contact_radius_mm


def free_matrices(numbers: Any) -> list[dict[str, Any]]:
    """Return every sensor's errors by a free matrix, measured at Sato's 25 places by 75 presses."""
    truth, out = truth_of(covered=False), []
    scene = truth.scene
    radius = contact_radius(scene)
    places = Rectangles.on_surface(scene.body, np.array(LAWN), FOOTPRINT * radius, "places")
    twin = FittedDesign(scene, places, np.full(len(places), radius))
    for number in numbers:
        presses = measured(truth, number, LAWN)
        found = drawn(twin)
        markers, _ = twin.markers_of(found.scaled, np.full_like(presses.rest_px, np.nan))
        forces = presses.force_n.reshape(-1, 3, 3).transpose(0, 2, 1)
        own = from_presses(forces, presses.shift_px.reshape(len(LAWN), 3, -1))
        there, between = (
            twin.transfer(found.scaled, markers, twin.compliance(found.scaled, markers, at))
            for at in (places, squares(scene))
        )
        coarse = calibration(scene, twin, found, markers, scene.reconstruction.sites)
        # no camera to follow: a free matrix knows none
        free = replace(coarse, compliance=np.zeros((0, 0), np.float32), marker_mm=np.zeros((0, 3)), camera="{}")
        sites = scene.reconstruction.sites.chart()
        for name, helped in MEASURED.items():
            at_squares, at_sites = (
                fill_between(own, helped * there, helped * nominal, (GRID, GRID), chart)
                for nominal, chart in ((between, np.array(BETWEEN + EDGE)), (coarse.transfer, sites))
            )
            case: dict[str, Any] = {"places": 25, "covered": False, "sensor": number, "way": name, "residual_px": 0.0}
            case |= transfer_errors(truth, number, at_squares)
            case |= totals(truth, number, replace(free, transfer=at_sites))
            out.append(case)
            print(json.dumps(case), file=sys.stderr, flush=True)
    return out


def squares(scene: Scene) -> Rectangles:
    """Return the squares whose transfer is compared."""
    return Rectangles.on_surface(scene.body, np.array(BETWEEN + EDGE), 0.625, "squares")


def transfer_errors(truth: Truth, number: int, transfer: Floats) -> dict[str, float]:
    """Return the errors of a (2n, 3q) transfer at the squares."""
    out = {}
    for index, place in enumerate(BETWEEN + EDGE):
        exact = truth.square(place, 0.625)[number]
        part = transfer.reshape(len(transfer), -1, 3)[:, index]
        out[f"transfer {place}"] = float(np.linalg.norm(part - exact) / np.linalg.norm(exact))
    return out


def totals(truth: Truth, number: int, own: Calibration) -> dict[str, float]:
    """Return the total's error under distributed loads, root mean square."""
    wrong = []
    for seed in range(BUMPS):
        step = truth.bumps(seed)
        random = np.random.default_rng([number, 3, seed])
        shift = step.shift_px[number] + random.normal(0, NOISE_PX, own.layout_px.shape)
        force = step.force_n[number]
        total = reconstruct(as_found(own, shift), own).total_force_n
        wrong.append(np.linalg.norm(total - force) / np.linalg.norm(force))
    return {"total": float(np.sqrt(np.mean(np.square(wrong))))}


def calibration(scene: Scene, twin: FittedDesign, found: Fit, markers: Floats, grid: Sites) -> Calibration:
    """Return a calibration at any sites."""
    sites = Rectangles.on_surface(scene.body, grid.chart(), grid.pitch_mm / 2, "sites")
    compliance, optics = twin.compliance(found.scaled, markers, sites), twin.optics_of(found.scaled)
    return Calibration(
        layer=np.repeat(list(scene.markers), [v.columns * v.rows for v in scene.markers.values()]),
        layout_px=project(markers, *optics), site_mm=sites.centre_mm, site_frames=sites.frames,
        site_area_mm2=np.full(len(sites), grid.pitch_mm**2), grid=(grid.columns, grid.rows),
        transfer=twin.transfer(found.scaled, markers, compliance), noise_px=NOISE_PX,
        compliance=compliance.astype(np.float32), marker_mm=markers,
        camera=Calibration.camera_text(*optics),
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
        for name, places in (("", BETWEEN), (", edge", EDGE)):
            values = 100 * np.array([[c[f"transfer {place}"] for place in places] for c in mine])
            row[f"transfer %{name}"] = float(np.sqrt(np.mean(values**2)))
            row[f"transfer %{name}, worst"] = float(values.max())
        if not covered:
            row["total %"] = 100 * float(np.sqrt(np.mean([c["total"] ** 2 for c in mine])))
        rows.append(row)
    return rows
