"""The error budget of the chain: how much of a scene's force error each stage makes, and how much of its time.

From a perfect sensor to the real one, a stage at a time, so that the parts add up to the whole:

* regularisation: exact shifts, the made sensor's own transfer matrix; what is wrong is what few markers and sites,
  a linear map and the weight leave open
* inverse model: what the software is told instead (nominal design, other mesh, or a calibration by presses)
* tracking: shifts of pictures without noise instead of exact ones
* CCD noise: pictures with noise; here the mean over exposures is bias and their spread is ``sd``

and from the scene's numerics to the finest: what contact patches, the mesh and rays per pixel change in the estimate's
error. ``share`` is the length of a part's vector over the force; ``error_without`` is what is left of the total error
where that part alone is perfect. CPU seconds are a first press's, body and calibration read from their files.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.clock import Clock
from twin.arrays import Floats, Pixels, Singles
from twin.blas_threads import one_thread
from twin.errors import AccuracyWarning
from twin.parts.load import Rectangles
from twin.parts.part import Purpose
from twin.parts.scene import Scene
from twin.sense.calibration import Calibration, from_compliance
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found, track
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Motion, Sensor
from twin.theory.optics import project_with_jacobian
from twin.world.picture.ccd import expose
from twin.world.picture.render import Renderer

SCENES = (
    "kamiyama_pillar", "kamiyama_shear", "kamiyama_twist", "kamiyama_wide", "kamiyama_two_points", "sato_press",
    "sato_shear", "sato_two_points", "dome_press",
)  # fmt: skip
EXPOSURES = 6
PATCHES, SUBPIXELS, FINEST = 40, 6, 1e-5
"""The finest contact, rays per pixel and displacement that stages are switched to."""

NOISE_PX = 1e-3
"""Noise that exact shifts are said to have: far below the CCD's, far above round-off."""


@dataclass(frozen=True, kw_only=True)
class Press:
    """A press of a scene: (3,) true total force, N, motion of the markers, and light at rest and pressed."""

    sensor: Sensor
    force: Floats
    motion: Motion
    light: tuple[Singles, Singles]


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return a row for every stage of every scene."""
    names = ("kamiyama_pillar",) if quick else SCENES
    rows = []
    for name in names:
        _chain(load_scene(name))  # makes tables and calibrations and compiles: no part of a press's time
        rows += budget(name, 2 if quick else EXPOSURES)
    return [*rows, *(skipped(name, 2 if quick else EXPOSURES) for name in names)]


def budget(name: str, exposures: int) -> list[dict[str, Any]]:
    """Return the rows of a scene."""
    scene = load_scene(name)
    press, calibration, found, seconds = _chain(scene)
    sensor = press.sensor
    exact = _exact(press, found)
    own = replace(calibration, transfer=own_transfer(sensor, sensor.sites))
    perfect = _error(scene, exact, own, press.force)
    told = _error(scene, exact, calibration, press.force)
    seen = _error(scene, _tracked(press, scene), calibration, press.force)
    noisy = np.array([
        _error(scene, _tracked(press, scene, 2 * k), calibration, press.force) for k in range(exposures)
    ])  # fmt: skip
    whole, spread = noisy.mean(axis=0), float(np.sqrt(noisy.var(axis=0, ddof=1).sum()))
    parts = {"regularisation": perfect, "inverse model": told - perfect, "tracking": seen - told,
             "CCD noise": whole - seen}  # fmt: skip
    for stage, finer in _finer(scene, press).items():
        parts[stage] = seen - _error(scene, _tracked(finer, scene), calibration, finer.force)
    return [
        {
            "scene": name, "stage": stage, "share": _length(part), "sd": spread if stage == "CCD noise" else 0.0,
            "total_force_error": float(np.hypot(_length(whole), spread)),
            "error_without": float(np.hypot(_length(whole - part), 0.0 if stage == "CCD noise" else spread)),
            "cpu_s": seconds[stage],
        }
        for stage, part in parts.items()
    ]  # fmt: skip


def _chain(scene: Scene) -> tuple[Press, Calibration, Found, dict[str, float]]:
    """Go through the whole chain once; return what comes of it, and the CPU seconds of each stage."""
    clock, seconds = Clock(), dict[str, float]()

    def lap(stage: str) -> None:
        seconds[stage] = seconds.get(stage, 0.0) + clock.lap().cpu

    sensor = Sensor(scene)
    press = _press(sensor, lap)
    calibration = calibration_of(sensor)
    lap("inverse model")
    pictures = [_picture(sensor, press.light[number], number, noise=True) for number in (0, 1)]
    lap("CCD noise")
    found = track(*pictures, sensor.layout_px, method=scene.tracking.method)
    lap("tracking")
    _error(scene, found, calibration, press.force)
    lap("regularisation")
    return press, calibration, found, seconds


AUTO: dict[str, Any] = {"accuracy.displacement": "auto", "accuracy.contact_patches": "auto"}
FIXED: dict[str, Any] = {"accuracy.displacement": 2e-3, "accuracy.contact_patches": 16}
"""What ``auto`` is compared with: the same numbers for every scene, good enough for the most exacting one."""


def skipped(name: str, exposures: int) -> dict[str, Any]:
    """Return what ``auto`` saves in a scene, and what it does to the error of the total force."""
    told: dict[str, Any] = {"scene": name}
    calibration = calibration_of(Sensor(load_scene(name)))  # the same for both: some take minutes
    for what, settings in (("fixed", FIXED), ("auto", AUTO)):
        scene = load_scene(name, settings)
        seconds: dict[str, float] = {}
        _press(Sensor(scene))  # meshes and tables read, and what is kept of them
        clock = Clock()

        def lap(stage: str, clock: Clock = clock, seconds: dict[str, float] = seconds) -> None:
            seconds[stage] = clock.lap().cpu

        sensor = Sensor(scene)
        press = _press(sensor, lap)
        errors = [_error(scene, _tracked(press, scene, 2 * k), calibration, press.force) for k in range(exposures)]
        told |= {f"{what}: patches": scene.contact_patches, f"{what}: displacement": scene.displacement_error,
                 f"{what}: cpu_s": seconds["contact"] + seconds["elasticity"],
                 f"{what}: error": float(np.sqrt(np.mean(np.square(errors).sum(axis=1))))}  # fmt: skip
    return told


def _press(sensor: Sensor, lap: Callable[[str], None] = lambda stage: None) -> Press:
    sensor.actual  # noqa: B018  made before the clock is looked at
    state = sensor.press()
    lap("contact")
    motion = sensor.motion(state.load)
    lap("elasticity")
    light = tuple(sensor.renderer.radiance(sensor.ellipsoids(each)) for each in (None, motion))
    lap("optics")
    force = sensor.rectangles(state.load).force_n.sum(axis=0)
    return Press(sensor=sensor, force=force, motion=motion, light=(light[0], light[1]))


def _finer(scene: Scene, press: Press) -> dict[str, Press]:
    """Return the press with each of its numerics at the finest, the others as they are."""

    def changed(**update: Any) -> Sensor:
        return Sensor(scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update=update)}))

    state = press.sensor.press()
    mesh = changed(displacement=FINEST)
    with warnings.catch_warnings():  # the finest there is need not be as fine as was asked
        warnings.simplefilter("ignore", AccuracyWarning)
        motion = mesh.motion(state.load)
    elastic = replace(press, motion=motion, light=(press.light[0], _light(press.sensor.renderer, press.sensor, motion)))
    seen = press.sensor.renderer
    fine = Renderer(seen.scene, press.sensor.ellipsoids(None), seen.variant, SUBPIXELS, True)
    optics = replace(press, light=(_light(fine, press.sensor, None), _light(fine, press.sensor, press.motion)))
    return {"contact": _press(changed(contact_patches=PATCHES)), "elasticity": elastic, "optics": optics}


def _light(renderer: Renderer, sensor: Sensor, motion: Motion | None) -> Singles:
    return renderer.radiance(sensor.ellipsoids(motion))


def _picture(sensor: Sensor, light: Singles, number: int, *, noise: bool) -> Any:
    scene = sensor.nominal
    ccd = scene.ccd if noise else scene.ccd.model_copy(update={"noise": False})
    return expose(light, ccd, Purpose.EXPOSURE.stream(scene.seed, number), sensor.pattern)


def _tracked(press: Press, scene: Scene, exposure: int | None = None) -> Found:
    """Return what the tracker makes of both pictures; without noise if no exposure is given."""
    rest, pressed = (
        _picture(press.sensor, light, (exposure or 0) + number, noise=exposure is not None)
        for number, light in enumerate(press.light)
    )
    return track(rest, pressed, press.sensor.layout_px, method=scene.tracking.method)


def _exact(press: Press, found: Found) -> Found:
    """Return the true shifts of the projected centres, for the markers that were found."""
    points = press.sensor.actual.markers.points
    shift: Pixels = press.sensor.project(points + press.motion.displacement_mm) - press.sensor.project(points)
    seen = np.isfinite(found.shift_px).all(axis=1, keepdims=True)
    return replace(found, shift_px=np.where(seen, shift, np.nan), sd_px=np.full(len(shift), NOISE_PX))


def own_transfer(sensor: Sensor, sites: Rectangles) -> Floats:
    """Return (2n, 3k) the transfer matrix at some sites by the made sensor's own body, markers and camera, px/N."""
    scene, points = sensor.actual.scene, sensor.actual.markers.points
    slope = project_with_jacobian(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)[1]
    return from_compliance(sensor.compliance.to_points(points, sites), slope)


def _error(scene: Scene, found: Found, calibration: Calibration, force: Floats) -> Floats:
    """Return (3,) the error of the total force over the force."""
    options = scene.reconstruction.options()
    total = reconstruct(found, calibration, **options).total_force_n
    return np.asarray((total - force) / np.linalg.norm(force))


def _length(vector: Floats) -> float:
    return float(np.linalg.norm(vector))
