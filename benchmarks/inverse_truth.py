"""Truth for the study of calibrations: presses on twenty made fingers, as shifts of their markers.

Twenty sensors differ in stiffness, depths, print, camera and lens, none of which changes the contact but for the scale
of the forces: at equal indentation displacements stay and forces grow with Young's modulus. So every press is solved
once, for all of them, and its field is read at all their markers. They share Poisson's ratio, 0.499.

With a cover (1.5 times the body's modulus) the tractions of the same press without one are put on the covered body.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.parts.load import Load, Rectangles, Traction
from twin.parts.scene import Scene
from twin.places import cache_folder
from twin.study.actual import Actual, make
from twin.study.calibration_presses import calibration_press
from twin.study.recipe import load_scene
from twin.study.reproduce.runner import source_hash
from twin.study.sensor import Sensor
from twin.theory.optics import project, projection_jacobian
from twin.world.elasticity.covered import Covered
from twin.world.elasticity.fem import Layer

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


def sensors(scene: Scene, count: int = SENSORS) -> list[Actual]:
    """Return made sensors."""
    return [make(scene.model_copy(update={"seed": 100 + number})) for number in range(count)]


@dataclass(frozen=True)
class Measured:
    """One load on all sensors.

    Attributes
    ----------
    force_n
        (s, 3) total force on each.
    shift_px
        (s, n, 2) motion of its markers in its own picture, without noise.
    """

    force_n: Floats
    shift_px: Floats


class Truth:
    """Loads on all sensors, each solved once and kept on disk, until the program's sources change.

    Parameters
    ----------
    covered
        With a cover of another modulus.
    """

    def __init__(self, scene: Scene, made: list[Actual], covered: bool) -> None:
        self.scene, self.made, self.covered = scene, made, covered
        material = scene.material.model_copy(update={"poisson_ratio": NU})
        plain = scene.model_copy(
            update={"material": material, "tolerance": scene.tolerance.model_copy(update={"preset": "none"})}
        )
        self.sensor = Sensor(plain)
        self._last: tuple[tuple[float, float], Covered] | None = None
        self.points = np.concatenate([one.markers.points for one in made])
        self.folder = cache_folder() / f"inverse-{source_hash()[:16]}"
        self.folder.mkdir(parents=True, exist_ok=True)

    def rest_px(self) -> Floats:
        """Return (s, n, 2) markers at rest."""
        return np.stack([self._project(one, one.markers.points) for one in self.made])

    def press(self, chart: tuple[float, float], steps: int) -> list[Measured]:
        """Return a calibration press's steps: along z, then with shear along x, then along y."""
        return [self._measured(*self._press_step(chart, step)) for step in range(steps)]

    def square(self, chart: tuple[float, float], half_mm: float) -> Floats:
        """Return (s, 2n, 3) px/N of a uniform square, exact and linear."""
        place = self._square(chart, half_mm)
        compliance = self._kept("square", (*chart, half_mm), lambda: self._body(chart).to_points(self.points, place))
        columns = compliance.reshape(len(self.points), 3, 3)
        return np.stack([self._through(one, part) for one, part in zip(self.made, self._split(columns), strict=True)])

    def sites(self) -> Floats:
        """Return (s, 2n, 3k) px/N at the scene's sites, exact and linear."""
        moved = self._kept("sites", (), lambda: self.sensor.compliance.to_points(self.points, self.sensor.sites))
        columns = moved.reshape(len(self.points), 3, -1)
        return np.stack([self._through(one, part) for one, part in zip(self.made, self._split(columns), strict=True)])

    def _split(self, columns: Floats) -> Floats:
        return columns.reshape(len(self.made), -1, *columns.shape[1:])

    def _through(self, one: Actual, compliance: Floats) -> Floats:
        """Return (2n, q) px/N of a sensor's (n, 3, q) mm/N at the nominal modulus."""
        scene = one.scene
        assert scene.camera is not None
        slope = projection_jacobian(
            one.markers.points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm
        )
        return np.asarray((slope @ compliance).reshape(2 * len(slope), -1) / self._stiffer(one))

    def bumps(self, seed: int) -> tuple[list[Measured], Load]:
        """Return a load of several bumps, drawn anew for every seed, and the load itself."""
        load = drawn_bumps(seed)
        rectangles = self.sensor.rectangles(load)
        moved = self._kept("bumps", (seed,), lambda: self.sensor.compliance.displacement(self.points, rectangles))
        return [self._measured(rectangles.force_n.sum(axis=0), moved)], load

    def _press_step(self, chart: tuple[float, float], step: int) -> tuple[Floats, Floats]:
        path = self.folder / f"press-{chart[0]:g}-{chart[1]:g}-{step}.npz"
        if not path.is_file():
            self._solve(chart)
        with np.load(path) as stored:
            load = Rectangles(**{f: stored[f] for f in ("centre_mm", "frames", "half_mm", "force_n")})
        moved = self._kept("moved", (*chart, step), lambda: self._body(chart).displacement(self.points, load))
        return load.force_n.sum(axis=0), moved

    def _solve(self, chart: tuple[float, float]) -> None:
        places = self._square(chart, HALF_MM)
        path = self.sensor.press(calibration_press(self.sensor.nominal, places, 0)).path
        for step, state in enumerate(path):
            load = self.sensor.rectangles(state.load)
            parts: dict[str, Any] = {f: getattr(load, f) for f in ("centre_mm", "frames", "half_mm", "force_n")}
            np.savez(self.folder / f"press-{chart[0]:g}-{chart[1]:g}-{step}.npz", **parts)
        print(f"pressed {chart}", file=sys.stderr, flush=True)

    def _square(self, chart: tuple[float, float], half_mm: float) -> Rectangles:
        points = self.scene.body.chart_points(np.array([chart]))
        half = np.full((1, 2), half_mm)
        return Rectangles(
            centre_mm=points, frames=self.scene.body.frames(points), half_mm=half, force_n=np.zeros((1, 3))
        )  # fmt: skip

    def _body(self, chart: tuple[float, float]) -> Any:
        """Return the body's compliance; a covered one has a mesh for every place, of which the last is kept."""
        if not self.covered:
            return self.sensor.compliance
        if self._last is None or self._last[0] != chart:
            scene, layer = self.sensor.nominal, Layer(modulus_ratio=COVER, poisson_ratio=NU)
            self._last = chart, Covered(scene.body, scene.material, 0.2, layer, level="coarse")
        return self._last[1]

    def _kept(self, what: str, key: tuple[float, ...], make_it: Any) -> Floats:
        kind = "covered" if self.covered else "bare"
        name = "-".join(f"{v:g}" for v in key)
        path: Path = self.folder / f"{what}-{kind}-{len(self.made)}-{name}.npy"
        if not path.is_file():
            np.save(path, make_it())
            print(f"{what} {kind} {key}", file=sys.stderr, flush=True)
        return np.asarray(np.load(path))

    def _stiffer(self, one: Actual) -> float:
        return one.scene.material.youngs_modulus_mpa / self.scene.material.youngs_modulus_mpa

    def _measured(self, force: Floats, moved: Floats) -> Measured:
        forces = np.stack([force * self._stiffer(one) for one in self.made])
        parts = moved.reshape(len(self.made), -1, 3)
        shifts = [
            self._project(one, one.markers.points + part) - self._project(one, one.markers.points)
            for one, part in zip(self.made, parts, strict=True)
        ]
        return Measured(forces, np.stack(shifts))

    def _project(self, one: Actual, points: Floats) -> Floats:
        scene = one.scene
        return project(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)  # type: ignore[arg-type]


def drawn_bumps(seed: int) -> Load:
    """Return three bumps of 1.5 to 3 mm radius, a newton each, with some shear."""
    random = np.random.default_rng(seed)
    load = Load()
    for _ in range(3):
        x, y = random.uniform(-3, 3, 2)
        shear = random.normal(0, 0.15, 2)
        load = load + Traction.bump(
            (float(x), float(y)), float(random.uniform(1.5, 3)), (float(shear[0]), float(shear[1]), 1.0)
        )
    return load
