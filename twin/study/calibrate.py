"""Calibrate a sensor: from the nominal design, or from presses on the made one as Sato did.

The sensor's software never sees the truth: the nominal methods use the nominal design on a mesh of its own; method
``sato`` uses pictures of the made sensor and the forces that a noisy load cell read, nothing else.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError, RecipeError
from twin.parts.body import Block
from twin.parts.press import Press, Sphere, Step
from twin.parts.scene import Scene
from twin.places import SCENES, cache_folder
from twin.results import make_folder
from twin.streams import Purpose, stream
from twin.study.sensor import Sensor
from twin.theory.optics import projection_jacobian

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.sense.calibration import Calibration

SHEAR_SHARE = 0.25
"""Sideways motion of a calibration press over the contact radius: well inside what sticks."""

FIRST_EXPOSURE = 1000
"""Calibration pictures are exposures from here on, so that they share no noise with any press."""


def calibration_of(sensor: Sensor) -> Calibration:
    """Return the calibration that the scene asks for; a file made earlier is used only while it matches."""
    scene = sensor.nominal
    if scene.calibration.method != "sato":
        return _nominal(sensor)
    from twin.sense.calibration import read_calibration, write_calibration

    digest = sensor_digest(scene)
    cached = cache_folder() / f"calibration-{digest[:32]}.npz"
    for path in (SCENES / (scene.calibration.file or "-"), cached):
        if path.is_file():
            found = read_calibration(path)
            if json.loads(found.provenance).get("digest") == digest:
                return found
    made = calibrate_by_presses(sensor)
    write_calibration(made, cached)
    return made


def calibrate_to_file(scene: Scene, out: Path, progress: Any = None) -> str:
    """Calibrate the scene's sensor anew, write the file and return a line about it."""
    from twin.sense.calibration import write_calibration

    if scene.reconstruction is None:
        raise RecipeError("calibrating needs a [reconstruction] table with sites")
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a calibration file ends in .npz")
    make_folder(out.parent)
    sensor = Sensor(scene, progress)
    made = calibrate_by_presses(sensor) if scene.calibration.method == "sato" else _nominal(sensor)
    write_calibration(made, out)
    if progress is not None:
        progress("done", 1.0)
    return f"{out}: {scene.calibration.method}, {len(made.site_mm)} sites, {len(made.transfer) // 2} markers"


def sensor_digest(scene: Scene) -> str:
    """Return a hash of everything that a calibration by presses depends on: the sensor, not the press."""
    table = scene.model_dump(mode="json", exclude={"title", "press", "accuracy"})
    table["calibration"].pop("file")
    table["reconstruction"] = table["reconstruction"]["sites"]
    return hashlib.sha256(json.dumps(_without_provenance(table), sort_keys=True).encode()).hexdigest()


def _without_provenance(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_provenance(v) for k, v in value.items() if k not in {"source", "assumed"}}
    return [_without_provenance(v) for v in value] if isinstance(value, list) else value


def _nominal(sensor: Sensor) -> Calibration:
    """Calibrate from the nominal design alone: its compliance, or the papers' half-space, through its camera."""
    from twin.sense.transfer import from_compliance

    scene = sensor.nominal
    markers, sites = sensor.nominal_markers.points, sensor.sites
    assert scene.camera is not None
    if scene.calibration.method == "compliance":
        compliance = sensor.nominal_compliance.to_points(markers, sites)
    else:
        compliance = half_space_compliance(scene, markers, sites)
    jacobian = projection_jacobian(markers, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    return _calibration(sensor, from_compliance(compliance, jacobian), noise_px=0.03)


def half_space_compliance(scene: Scene, markers: Floats, sites: Rectangles) -> Floats:
    """Return (3n, 3k) mm/N by the papers' half-space formula (eqs. 1 and 2 with u_z, corrected), uniform rectangles.

    Raises
    ------
    RecipeError
        The sensing surface is not flat.
    """
    from twin.theory.halfspace import compliance

    if not isinstance(scene.body, Block):
        raise RecipeError(
            "calibration.method = 'halfspace': the formula holds on flat bodies only; use compliance or sato"
        )
    material = scene.material
    return compliance(markers, sites, material.youngs_modulus_mpa, material.poisson_ratio)


def calibrate_by_presses(sensor: Sensor) -> Calibration:
    """Press the made sensor at every site along z, then x, then y, and read pictures and load cell (Sato, II C).

    The probe moves along global axes, held by motion sideways; what enters is the measured 3-D force.
    """
    from twin.sense.track import analyse_rest, track_frame
    from twin.sense.transfer import from_presses

    scene = sensor.nominal
    rest = analyse_rest(sensor.picture(None, exposure=FIRST_EXPOSURE), sensor.layout_px)
    forces, shifts, spread = [], [], []
    count = len(sensor.sites)
    for site in range(count):
        states = sensor.press(calibration_press(scene, sensor.sites, site)).path
        noise = scene.calibration.load_cell_n * stream(scene.seed, Purpose.LOAD_CELL, site).standard_normal((3, 3))
        forces.append(np.stack([state.force_n for state in states], axis=1) + noise)
        frames = []
        for number, state in enumerate(states):
            picture = sensor.picture(sensor.motion(state.load), FIRST_EXPOSURE + 1 + 3 * site + number)
            found = track_frame(rest, picture)
            frames.append(found.shift_px.ravel())
            spread.append(found.sd_px)
        shifts.append(np.stack(frames))
        if sensor.progress is not None:
            sensor.progress(f"calibrating, press {site + 1} of {count}", 0.9 * (site + 1) / count)
    transfer = from_presses(np.stack(forces), np.stack(shifts))
    return _calibration(sensor, transfer, noise_px=float(np.nanmedian(np.concatenate(spread))))


def calibration_press(scene: Scene, sites: Rectangles, site: int) -> Press:
    """Return the path of one calibration press: down to the wanted force, then a small motion along x, then along y.

    The sphere's axis is set off so that it first touches at the site, whatever the slope there.
    """
    wanted, material = scene.calibration, scene.material
    radius = wanted.press_probe_mm / 2
    modulus = material.youngs_modulus_mpa / (1 - material.poisson_ratio**2)
    contact_radius = (0.75 * wanted.press_force_n * radius / modulus) ** (1 / 3)
    x, y = sites.centre_mm[site, :2] - radius * sites.frames[site, 2, :2]
    shear = SHEAR_SHARE * min(contact_radius, radius)
    return Press(
        probe=Sphere(diameter_mm=wanted.press_probe_mm),
        at_mm=(float(x), float(y)),
        friction=np.inf,
        steps=(
            Step(force_n=(None, None, wanted.press_force_n)),
            Step(move_mm=(shear, None, None)),
            Step(move_mm=(-shear, shear, None)),
        ),
    )


def _calibration(sensor: Sensor, transfer: Floats, noise_px: float) -> Calibration:
    from twin.sense.calibration import Calibration

    scene, sites = sensor.nominal, sensor.sites
    assert scene.reconstruction is not None
    grid = scene.reconstruction.sites
    layout = sensor.layout_px
    facts = {
        "digest": sensor_digest(scene),
        "method": scene.calibration.method,
        "scene": scene.title,
        "seed": scene.seed,
        "versions": _versions(),
    }
    return Calibration(
        layer=np.repeat(list(layout), [len(p) for p in layout.values()]),
        layout_px=np.concatenate(list(layout.values())),
        site_mm=sites.centre_mm,
        site_frames=sites.frames,
        site_area_mm2=4 * sites.half_mm.prod(axis=1),
        grid=(grid.columns, grid.rows),
        transfer=transfer,
        noise_px=noise_px,
        method=scene.calibration.method,
        provenance=json.dumps(facts),
    )


@cache
def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {name: version(name) for name in ("tactile-twin", "numpy", "scipy", "mitsuba")}
