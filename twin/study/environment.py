"""A sensor that is pressed again and again: a load in, what the sensor feels out, with the truth.

Control, learning (`twin.study.gym`) and the live page (`twin.study.live`) use it. Body, calibration
and rest picture are made once for the sensor. A step then costs the contact, two products, a
picture and its tracking.

A load or a press starts from the rest state, at once, unless it is given ``seconds``: it then
follows those before, and rubber that relaxes remembers these, in the truth and in the recovered
forces. A `twin.Step` always follows: it moves the probe of the press before on, and patches
remember where they slipped. The result of anything else depends only on its load and on the number
of its exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real
from types import NoneType
from typing import TYPE_CHECKING

from twin.arrays import Floats, Picture, Pixels, Points, Progress
from twin.blas_threads import one_blas_thread
from twin.errors import ContactError, InputError, RecipeError, TwinError, require
from twin.parts.load import Load
from twin.parts.press import Press, Step
from twin.parts.scene import Scene
from twin.study.sensor import Motion, Sensor
from twin.theory.relaxation import Hereditary
from twin.world.contact.pressing import PathMemory

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration
    from twin.sense.track import Tracker
    from twin.world.contact.contact_state import ContactState


@dataclass(frozen=True, kw_only=True)
class _Happened:
    """What really happened in a step: see `Observation`."""

    marker_displacement_mm: Points
    marker_shift_px: Pixels
    motion: Motion
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    state: ContactState | None

    @property
    def displacement_error(self) -> float:
        return self.motion.error_of(self.state)


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What the sensor feels after a step, and the truth: n markers in their order, k sites.

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
    sd_force_n, sd_total_n, sd_torque_nmm
        Stated standard deviations of these three, of their shapes and units.
    truth
        What really happened: ``marker_displacement_mm`` (n, 3), mm, with its estimated
        ``displacement_error`` (the largest over the largest displacement); ``marker_shift_px`` (n,
        2) of the projected centres, px; ``force_n`` (k, 3) summed into the cells of the sites, N;
        ``total_force_n`` and ``total_torque_nmm`` (3,), N and N mm about the origin; and after a
        press ``state``, its contact.
    error
        ``field_error``, ``total_force_error``, ``torque_error``, ``centre_error_mm`` and the other
        keys of `twin.judge.score.force_score`: recovered against true; None where one is not
        defined.
    exposure
        Number of the picture's noise.

    Examples
    --------
    >>> import twin
    >>> quick = {"accuracy.contact_patches": 8, "accuracy.centroid_px": 0.05}
    >>> rest = twin.Environment(twin.load_scene("kamiyama_pillar", quick)).reset()
    >>> rest.picture.ndim, rest.truth.total_force_n.tolist()
    (3, [0.0, 0.0, 0.0])
    >>> bool(abs(rest.total_force_n[2]) < 5 * rest.sd_total_n[2])  # N: nothing presses
    True
    """

    picture: Picture
    marker_shift_px: Pixels
    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    sd_force_n: Floats
    sd_total_n: Floats
    sd_torque_nmm: Floats
    truth: _Happened
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
    >>> import twin
    >>> quick = {"accuracy.contact_patches": 8, "accuracy.centroid_px": 0.05}
    >>> environment = twin.Environment(twin.load_scene("kamiyama_pillar", quick))
    >>> load = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
    >>> observation = environment.step(load)
    >>> bool(0.9 < observation.total_force_n[2] < 1.1)  # N
    True
    >>> observation.error["total_force_error"] < 0.1
    True

    A probe is pressed on, then moved on sideways from where it is:

    >>> push = twin.Step(move_mm={"z": 0.2})
    >>> press = twin.Press(probe=twin.Sphere(diameter_mm=6), friction=0.5, steps=[push])
    >>> _ = environment.step(press)
    >>> moved = environment.step(twin.Step(move_mm={"x": 0.05}))
    >>> bool(moved.truth.total_force_n[0] > 0.01)  # N
    True
    """

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        self.sensor = Sensor(scene, progress)
        for table, there in (("camera", scene.camera), ("reconstruction", scene.reconstruction)):
            if there is None:
                raise RecipeError(f"this scene has no [{table}] table, so its sensor feels nothing")
        self._exposure = 0
        self._loads: list[tuple[Load, float]] = []
        self._press: Press | None = None  # in time, with all its steps since rest
        self._last: Press | None = None  # at once or in time, which a step follows
        self._made: tuple[Calibration, Tracker] | None = None
        self._history: Hereditary | None = None
        self._memory = PathMemory()

    def reset(self) -> Observation:
        """Begin again at rest: exposures count from 1. Returns what the sensor feels under no
        load."""
        self._exposure = 0
        if self._made is not None:
            self._made[1].forget()
        return self.step(None)

    @one_blas_thread()
    def step(self, load: Load | Press | Step | None, seconds: float | None = None) -> Observation:
        """Return what the sensor feels under a load, a press, or nothing.

        Parameters
        ----------
        load
            The load that is reached, or a press, or a step that follows those of the press before.
            With seconds, a press's steps do so, too. What is followed is solved again only where
            the contact outgrows its grid of patches, as under a probe that slides further and
            further, or at finite strain with friction its mesh.
        seconds
            Time in which the load changes linearly from the one before, or which the steps of the
            press share evenly; what came since the last without seconds, or `reset`, counts. None
            starts from rest, at once; a step then takes its own seconds.

        Raises
        ------
        InputError
            The load misses the sensing surface, the picture shows too few markers, or what should
            follow a press follows none of its kind. Then, as after a `ContactError`, the sensor is
            where it was before.
        ContactError
            The press has no equilibrium, or did not come to its end.
        """
        before = self._loads, self._press, self._last, self._history
        try:
            return self._stepped(load, seconds)
        except TwinError:
            self._loads, self._press, self._last, self._history = before
            raise

    def _stepped(self, load: Load | Press | Step | None, seconds: float | None) -> Observation:
        require(load, (Load, Press, Step, NoneType), "load", "a twin.Press, Traction, Step or None")
        if isinstance(load, Step) and seconds is None:
            seconds = load.seconds
        if seconds is not None and not (isinstance(seconds, Real) and 0.0 <= seconds < math.inf):
            raise InputError(f"seconds = {seconds!r:.60}: give a number, 0 or more")
        if isinstance(load, Step):
            load = self._moved_on(load)
        else:
            self._last = None
        if seconds is None:
            self._loads = []
            self._press = None
            self._history = None
        elif isinstance(load, Press):
            load = self._followed(load, seconds)
        else:
            load = self._crept(load or Load(), seconds)
        state = None
        if isinstance(load, Press):
            state = self.sensor.press(load, self._memory)
            if not state.complete:
                raise ContactError(f"press: {state.reason}")
            self._last = load
            self._press = load if seconds is not None else None
            load = state.load
        return self._feel(load if load is not None else Load(), state, seconds)

    def _moved_on(self, step: Step) -> Press:
        """Return the press before with this step alone, which then follows it."""
        if self._last is None:
            raise InputError("step: a twin.Step follows a press; give one with its probe first")
        by_steps = {"steps": self._last.path, "force_n": None, "indentation_mm": None}
        self._press = self._last.model_copy(update=by_steps)
        self._loads = []
        return self._press.model_copy(update={"steps": (step,)})

    def _followed(self, press: Press, seconds: float) -> Press:
        """Return the press before with the steps of one that follows in some seconds."""
        if press.also or not press.steps:
            raise InputError(
                "step: only a press of one probe, given by its steps, follows another; one of "
                "several probes, or by force_n or indentation_mm, starts from rest, without seconds"
            )
        before = press if self._press is None else self._press
        if self._loads or press.model_copy(update={"steps": before.steps}) != before:
            raise InputError(
                "step: with seconds a press follows one of the same probe, place and friction; "
                "call reset() first"
            )
        each = {"seconds": seconds / len(press.steps)}
        steps = tuple(step.model_copy(update=each) for step in press.steps)
        if self._press is not None:
            steps = (*self._press.steps, *steps)
        return press.model_copy(update={"steps": steps})

    def _crept(self, load: Load, seconds: float) -> Load:
        """Return a load that is reached in some seconds with what moves rubber that relaxes."""
        if self._press is not None:
            raise InputError(
                "step: with seconds no load of given tractions follows a press; call reset() first"
            )
        self._loads = [*self._loads, (load, seconds)]
        relaxation = self.sensor.relaxation
        if relaxation is None:
            return load
        # By linearity every change of load creeps for itself.
        terms = []
        since = 0.0
        weight = 0.0
        for each, took in reversed(self._loads):
            creep = relaxation.ramp_creep(since, took)
            pushed = self.sensor.rectangles(each)
            terms.append(replace(pushed, force_n=(creep - weight) * pushed.force_n))
            since += took
            weight = creep
        return replace(load, crept=Load(tuple(terms)))

    def _feel(self, load: Load, state: ContactState | None, seconds: float | None) -> Observation:
        from twin.judge.score import force_score, into_cells
        from twin.sense.reconstruct import reconstruct

        sensor = self.sensor
        options = sensor.nominal.inverse.options()
        calibration, tracker = self._software()
        # What happens: displacement and picture.
        patches = sensor.rectangles(load)
        motion = sensor.quick_motion(load)
        frame = self._exposure
        self._exposure += 1
        picture = sensor.picture(motion, self._exposure, frame)
        # What the sensor's software makes of the picture.
        found = tracker.track(picture, frame)
        if not found.seen.any():
            raise InputError(
                "no marker was found in the picture: is the press far beyond what the sensor can "
                "follow?"
            )
        if seconds is not None and calibration.relaxation is not None:
            if self._history is None:
                self._history = Hereditary(calibration.relaxation)
            options |= {"history": self._history, "after_s": seconds}
        field = reconstruct(found, calibration, **options)
        # The truth, and the error against it.
        rest = sensor.actual.markers.points
        truth = _Happened(
            marker_displacement_mm=motion.displacement_mm,
            marker_shift_px=sensor.project(rest + motion.displacement_mm) - sensor.project(rest),
            motion=motion,
            force_n=into_cells(field.site_mm, patches.centre_mm, patches.force_n),
            total_force_n=patches.total_force_n,
            total_torque_nmm=patches.total_torque_nmm,
            state=state,
        )
        error = force_score(field, patches)
        error.pop("reasons")
        return Observation(
            picture=picture,
            marker_shift_px=found.shift_px,
            site_mm=field.site_mm,
            force_n=field.force_n,
            total_force_n=field.total_force_n,
            total_torque_nmm=field.total_torque_nmm,
            sd_force_n=field.sd_force_n,
            sd_total_n=field.sd_total_n,
            sd_torque_nmm=field.sd_torque_nmm,
            truth=truth,
            error=error,
            exposure=self._exposure,
        )

    def _software(self) -> tuple[Calibration, Tracker]:
        """Return the sensor's software, made at the first step."""
        if self._made is None:
            from twin.sense.track import Tracker
            from twin.study.calibrate import calibration_of

            sensor = self.sensor
            scene = self.sensor.nominal
            calibration = calibration_of(sensor)
            sensor.keep_markers()
            rests = sensor.rest_pictures
            tracker = Tracker(rests, sensor.layout_px, method=scene.tracking.method)
            self._made = calibration, tracker
        return self._made
