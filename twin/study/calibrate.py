"""Calibrate a sensor: from the nominal design, or from presses on the made one.

The sensor's software never sees the truth: the nominal methods use the nominal design on a mesh of its own; ``sato``
and ``fitted`` use pictures of the made sensor and the forces that a noisy load cell read, the first as they are, place
by place, the second to fit the nominal design's parameters (`twin.study.fitted`), for which five places do.
"""

from __future__ import annotations

import hashlib
import json
import sys
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError, RecipeError
from twin.parts.body import Block
from twin.parts.part import without_later
from twin.parts.scene import Scene
from twin.places import cache_folder
from twin.results import make_folder
from twin.study.calibration_presses import FOOTPRINT, hertz_radius, press_everywhere
from twin.study.sensor import Sensor
from twin.study.sites import on_surface
from twin.theory.optics import projection_jacobian

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.parts.pipeline import Sites
    from twin.sense.calibration import Calibration
    from twin.sense.fit_design import Presses

BY_PRESSES = ("sato", "fitted")

FIVE = ((0.0, 0.0), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5))
"""Where method ``fitted`` presses if nothing else is said, over the half extents of the sites."""


def calibration_of(sensor: Sensor) -> Calibration:
    """Return the calibration that the scene asks for; a file made earlier is used only while it matches."""
    scene = sensor.nominal
    if scene.calibration.method not in BY_PRESSES:
        return calibrate_by_design(sensor)
    from twin.sense.calibration import read_calibration, write_calibration

    digest = sensor_digest(scene)
    cached = cache_folder() / f"calibration-{digest[:32]}.npz"
    given = [Path(scene.calibration.file)] if scene.calibration.file else []
    for path in [*given, cached]:
        if path.is_file():
            found = read_calibration(path)
            if json.loads(found.provenance).get("digest") == digest:
                return found
    if given and sensor.progress is None:
        print(f"twin: {given[0].name} was made for another sensor than this scene's; calibrating anew, which takes "
              "minutes", file=sys.stderr)  # fmt: skip
    made = calibrate_by_presses(sensor)
    with suppress(InputError):  # a full disk costs the time to calibrate again
        write_calibration(made, cached)
    return made


def calibrate_to_file(scene: Scene, out: Path, progress: Any = None) -> str:
    """Calibrate the scene's sensor anew, write the file and return a line about it."""
    from twin.sense.calibration import write_calibration

    if scene.reconstruction is None:
        raise RecipeError("this scene has no [reconstruction] table, whose sites are calibrated: add one")
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a calibration file ends in .npz")
    make_folder(out.parent)
    sensor = Sensor(scene, progress)
    made = calibrate_by_presses(sensor) if scene.calibration.method in BY_PRESSES else calibrate_by_design(sensor)
    write_calibration(made, out)
    if progress is not None:
        progress("done", 1.0)
    return f"{out}: {scene.calibration.method}, {len(made.site_mm)} sites, {len(made.transfer) // 2} markers"


def sensor_digest(scene: Scene) -> str:
    """Return a hash of everything that a calibration by presses depends on: the sensor, not the press."""
    table = scene.model_dump(mode="json", exclude={"title", "press", "tractions", "accuracy", "dataset", "vary"})
    table["calibration"].pop("file")
    table["reconstruction"] = table["reconstruction"]["sites"]
    return hashlib.sha256(json.dumps(_without_provenance(table), sort_keys=True).encode()).hexdigest()


def _without_provenance(value: Any) -> Any:
    if isinstance(value, dict):
        told = without_later(value)
        return {k: _without_provenance(v) for k, v in told.items() if k not in {"source", "assumed"}}
    return [_without_provenance(v) for v in value] if isinstance(value, list) else value


def calibrate_by_design(sensor: Sensor) -> Calibration:
    """Calibrate from the nominal design alone: its compliance, or the papers' half-space, through its camera."""
    return nominal_calibration(sensor, _nominal_compliance(sensor, sensor.sites))


def nominal_calibration(sensor: Sensor, compliance: Floats) -> Calibration:
    """Return the calibration by a known (3n, 3k) nominal compliance, mm/N, through the nominal camera."""
    return _calibration(sensor, _through_camera(sensor, compliance), noise_px=0.03, compliance=compliance)


def _nominal_compliance(sensor: Sensor, sites: Rectangles) -> Floats:
    """Return (3n, 3k) mm/N of the nominal design's markers."""
    scene, markers = sensor.nominal, sensor.nominal_markers.points
    if scene.calibration.method == "halfspace":
        return half_space_compliance(scene, markers, sites)
    return sensor.nominal_compliance.to_points(markers, sites)


def _through_camera(sensor: Sensor, compliance: Floats) -> Floats:
    """Return (2n, 3k) px/N of a compliance seen by the nominal camera."""
    from twin.sense.transfer import from_compliance

    scene, markers = sensor.nominal, sensor.nominal_markers.points
    assert scene.camera is not None
    jacobian = projection_jacobian(markers, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    return from_compliance(compliance, jacobian)


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
    """Press the made sensor at every place along z, then x, then y, and read pictures and load cell (Sato, II C).

    The probe moves along global axes, held by motion sideways; what enters is the measured 3-D force. Where forces are
    reconstructed at more sites than were pressed, the nominal design fills in between.
    """
    scene = sensor.nominal
    assert scene.reconstruction is not None
    grid = scene.calibration.presses
    if grid is None and scene.calibration.method == "sato":
        grid = scene.reconstruction.sites
    half_mm = FOOTPRINT * hertz_radius(scene, scene.calibration.press_force_n)
    chart = grid.chart() if grid is not None else np.array(FIVE) * np.array(scene.reconstruction.sites.half_mm)
    places = on_surface(scene.body, chart, half_mm, "calibration.presses")
    presses = press_everywhere(sensor, places)
    if scene.calibration.method == "fitted":
        return fitted_calibration(sensor, places, presses)
    assert grid is not None
    return measured_calibration(sensor, places, grid, presses)


def measured_calibration(sensor: Sensor, places: Rectangles, grid: Sites, presses: Presses) -> Calibration:
    """Return Sato's calibration: what was measured, place by place, and the nominal design in between.

    Parameters
    ----------
    sensor
        Of which the nominal side is used only.
    places, grid
        Squares where presses were made, on this grid.
    presses
        Three at every place, place by place.
    """
    from twin.sense.transfer import fill_between, from_presses, left_out

    scene, count = sensor.nominal, len(places)
    assert scene.reconstruction is not None
    forces = presses.force_n.reshape(count, 3, 3).transpose(0, 2, 1)
    transfer = from_presses(forces, presses.shift_px.reshape(count, 3, -1))
    there = _through_camera(sensor, _nominal_compliance(sensor, places))
    errors = left_out(transfer, there, grid.chart())
    if grid.chart().tolist() != scene.reconstruction.sites.chart().tolist():
        here = _through_camera(sensor, _nominal_compliance(sensor, sensor.sites))
        transfer = fill_between(transfer, there, here, grid.axes(), scene.reconstruction.sites.chart())
    return _calibration(sensor, transfer, presses.noise_px, left_out=errors)


def fitted_calibration(sensor: Sensor, places: Rectangles, presses: Presses) -> Calibration:
    """Return the calibration by the nominal design with its parameters fitted to presses and the rest picture.

    Parameters
    ----------
    sensor
        Of which the nominal side is used only.
    places
        Squares where presses were made.
    presses
        Any number at any of the places.
    """
    from twin.sense.fit_design import fit
    from twin.study.fitted import FittedDesign

    scene = sensor.nominal
    force = scene.calibration.press_force_n * places.frames[:, 2, 2]
    radius = [min(hertz_radius(scene, float(f)), scene.calibration.press_probe_mm / 2) for f in force]
    design = FittedDesign(scene, places, np.array(radius), progress=sensor.progress)
    found = fit(design, presses)
    markers, _ = design.markers_of(found.scaled, presses.rest_px)
    compliance = design.compliance(found.scaled, markers, sensor.sites)
    transfer = design.transfer(found.scaled, markers, compliance)
    made = _calibration(sensor, transfer, float(np.hypot(presses.noise_px, found.model_px)), left_out=found.left_out)
    facts = json.loads(made.provenance) | {"fitted": design.told(found), "model_px": found.model_px}
    seen = np.isfinite(presses.rest_px)
    return replace(
        made, compliance=compliance.astype(np.float32), marker_mm=markers, camera=design.optics(found.scaled),
        layout_px=np.where(seen, presses.rest_px, made.layout_px), provenance=json.dumps(facts),
    )  # fmt: skip


def _calibration(
    sensor: Sensor, transfer: Floats, noise_px: float, compliance: Floats | None = None, left_out: Floats | None = None
) -> Calibration:
    from twin.sense.calibration import Calibration

    optics: dict[str, Any] = {}
    if compliance is not None:
        optics = {
            "compliance": compliance,
            "marker_mm": sensor.nominal_markers.points,
            "camera": _optics(sensor.nominal),
        }
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
        condition=_condition(transfer),
        left_out=np.zeros(0) if left_out is None else left_out,
        **optics,
    )


def _optics(scene: Scene) -> str:
    """Return the camera as a calibration file holds it."""
    assert scene.camera is not None
    camera = scene.camera.model_dump(mode="json")
    told = {"camera": camera, "body_index": scene.material.refractive_index, "base_z_mm": scene.body.base_z_mm}
    return json.dumps(told)


def _condition(transfer: Floats) -> float:
    """Return the largest over the smallest singular value of the rows that were calibrated."""
    singular = np.linalg.svd(transfer[np.isfinite(transfer).all(axis=1)], compute_uv=False)
    return float(singular[0] / max(singular[-1], singular[0] * np.finfo(float).eps))


@cache
def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {name: version(name) for name in ("tactile-twin", "numpy", "scipy", "mitsuba")}
