"""A sensor that is pressed again and again: a load in, what the sensor feels out, with the truth beside it.

What control, learning and the live page stand on. A step costs the contact, one product, a picture, tracking and one
product; what belongs to the sensor (body, calibration, rest picture) is made once.

Why every step starts from the rest state: the body is elastic and a `Press` holds its own path, so that a step's
answer depends on its load and the number of its exposure alone, whatever came before. A path with friction is one
press of several steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Picture, Pixels, Points
from twin.errors import ContactError, InputError, RecipeError
from twin.parts.load import Load
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.study.motion import Motion
from twin.study.sensor import Sensor

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration
    from twin.sense.reconstruct import Field
    from twin.sense.track import Found, Tracker
    from twin.world.contact.contact_state import ContactState


@dataclass(frozen=True, kw_only=True)
class Happened:
    """What really happened in a step: n markers, k sites.

    Attributes
    ----------
    marker_displacement_mm
        (n, 3) displacements, mm.
    marker_shift_px
        (n, 2) motion of the projected centres, px.
    displacement_error
        Estimated largest error of the displacements over the largest displacement.
    force_n
        (k, 3) forces summed into the cells of the sites, N.
    total_force_n, total_torque_nmm
        (3,) resultants, N and N mm about the origin.
    state
        The contact, after a press; None after a load.
    """

    marker_displacement_mm: Points
    marker_shift_px: Pixels
    displacement_error: float
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    state: ContactState | None


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What the sensor feels after a step, and the truth beside it: n markers in their one order, k sites.

    Attributes
    ----------
    picture
        (height, width, 3) uint8 CCD picture.
    marker_shift_px
        (n, 2) tracked motion since rest, px; NaN where lost.
    site_mm, force_n
        (k, 3) sites and the force recovered at each, mm and N.
    total_force_n, total_torque_nmm
        (3,) recovered resultants, N and N mm about the origin.
    truth
        What really happened.
    error
        ``field_error``, ``total_force_error``, ``torque_error``, ``centre_error_mm``: recovered against true, as in
        score.json; None where one is not defined.
    exposure
        Number of the picture's noise.
    """

    picture: Picture
    marker_shift_px: Pixels
    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    truth: Happened
    error: dict[str, float | None]
    exposure: int


class Environment:
    """A sensor under one load after another, in the manner of Gymnasium.

    Parameters
    ----------
    scene
        A scene with ``[camera]`` and ``[reconstruction]``; its own press is not taken.
    progress
        Told about work that takes longer.

    Raises
    ------
    RecipeError
        The scene lacks one of them.

    Examples
    --------
    >>> environment = twin.Environment(twin.load_scene("kamiyama_pillar"))
    >>> observation = environment.step(twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1)))
    >>> observation.total_force_n, observation.truth.total_force_n

    Notes
    -----
    Steps are independent: each starts from the rest state. Validity: quasi-static, as everywhere.
    """

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        self.sensor = Sensor(scene, progress)
        for table, there in (("camera", scene.camera), ("reconstruction", scene.reconstruction)):
            if there is None:
                raise RecipeError(f"this scene has no [{table}] table, so its sensor feels nothing")
        self._exposure = 0
        self._made: tuple[Calibration, Tracker] | None = None

    def reset(self) -> Observation:
        """Begin again: exposures count from 1. Returns what the sensor feels under no load."""
        self._exposure = 0
        if self._made is not None:
            self._made[1].forget()
        return self.step(None)

    def step(self, load: Load | Press | None) -> Observation:
        """Return what the sensor feels under a load, a press, or nothing.

        Raises
        ------
        InputError
            The load misses the sensing surface, or the picture shows too few markers.
        ContactError
            The press has no equilibrium, or did not come to its end.
        """
        state = None
        if isinstance(load, Press):
            state = self.sensor.press(load)
            if not state.complete:
                raise ContactError(f"press: {state.reason}")
            load = state.load
        return self._feel(load if load is not None else Load(), state)

    def _feel(self, load: Load, state: ContactState | None) -> Observation:
        from twin.judge.score import force_score, into_cells
        from twin.sense.reconstruct import reconstruct

        sensor, options = self.sensor, self.sensor.nominal.reconstruction
        assert options is not None
        calibration, tracker = self._software()
        patches = sensor.rectangles(load)
        motion = self._motion(load)
        self._exposure += 1
        picture = sensor.picture(motion, self._exposure)
        found = tracker.track(picture)
        if not found.seen.any():
            raise InputError("no marker was found in the picture: is the press far beyond what the sensor can follow?")
        field = reconstruct(found, calibration, **options.model_dump(exclude=_NOT_OPTIONS))
        rest = sensor.actual.markers.points
        total, torque = patches.force_n.sum(axis=0), np.cross(patches.centre_mm, patches.force_n).sum(axis=0)
        truth = Happened(
            marker_displacement_mm=motion.displacement_mm,
            marker_shift_px=sensor.project(rest + motion.displacement_mm) - sensor.project(rest),
            displacement_error=motion.error,
            force_n=into_cells(field.site_mm, patches.centre_mm, patches.force_n),
            total_force_n=total,
            total_torque_nmm=torque,
            state=state,
        )
        error = force_score(
            site_mm=field.site_mm, force_n=field.force_n, total_force_n=field.total_force_n,
            total_torque_nmm=field.total_torque_nmm, surface_mm=patches.centre_mm, surface_force_n=patches.force_n,
            true_force_n=total, true_torque_nmm=torque,
        )  # fmt: skip
        error.pop("reasons")
        return _observation(picture, found, field, truth, error, self._exposure)

    def _motion(self, load: Load) -> Motion:
        """Return how the markers move; with gradients only where a picture shows them."""
        cover = self.sensor.nominal.cover
        if cover is not None and cover.deforms:
            return self.sensor.motion(load)
        return self.sensor.motion_of_patches(self.sensor.rectangles(load), strained=self.sensor.markers_strain)

    def _software(self) -> tuple[Calibration, Tracker]:
        """Return the sensor's software, made at the first step."""
        if self._made is None:
            from twin.sense.track import Tracker
            from twin.study.calibrate import calibration_of
            from twin.world.elasticity.compliance import Compliance

            sensor, scene = self.sensor, self.sensor.nominal
            calibration = calibration_of(sensor)
            if isinstance(sensor.compliance, Compliance):
                sensor.compliance.keep(sensor.actual.markers.points)
            self._made = calibration, Tracker(sensor.picture(None), sensor.layout_px, method=scene.tracking.method)
        return self._made


_NOT_OPTIONS = {"sites", "source", "assumed"}


def _observation(
    picture: Picture, found: Found, field: Field, truth: Happened, error: dict[str, Any], exposure: int
) -> Observation:
    return Observation(
        picture=picture, marker_shift_px=found.shift_px, site_mm=field.site_mm, force_n=field.force_n,
        total_force_n=field.total_force_n, total_torque_nmm=field.total_torque_nmm, truth=truth, error=error,
        exposure=exposure,
    )  # fmt: skip
