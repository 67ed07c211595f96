"""The main job: one press through the whole twin, doing only what is wanted and what that needs.

=============  ====================================  =============================
wanted         needs                                 file
=============  ====================================  =============================
displacement   press, markers                        truth.npz
picture        displacement, [camera]                rest.png, pressed.png
tracking       picture                               estimate.npz
forces         tracking, [reconstruction]            estimate.npz
score          what the scene has of the above       score.json
report         the same                              report.html
=============  ====================================  =============================
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from twin.errors import ContactError, InputError, RecipeError
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.results import Estimate, RunResult, Truth
from twin.study.motion import Motion
from twin.study.recipe import dump_scene
from twin.study.scored import facts_of, score_of
from twin.study.sensor import Sensor
from twin.study.touch import touches

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.sense.reconstruct import Field
    from twin.sense.track import Found
    from twin.world.contact.contact import ContactState

UNOCCLUDED = 0.98
"""Share of a marker's outline that must be seen at rest and pressed for it to count as unoccluded."""

WANTED = frozenset({"displacement", "picture", "tracking", "forces", "score", "report"})


def run(scene: Scene, want: Collection[str] | None = None, progress: Progress | None = None) -> RunResult:
    """Take the scene's press through the twin.

    Parameters
    ----------
    scene
        A resolved scene.
    want
        Any of displacement, picture, tracking, forces, score, report; all if not given.
    progress
        Told about every stage.

    Returns
    -------
    RunResult
        What was wanted; the rest is None.

    Raises
    ------
    RecipeError
        The scene lacks what was asked for by name.
    """
    if isinstance(want, str):
        want = {want}
    asked = frozenset(want) if want is not None else WANTED
    return only_wanted(computed(scene, asked, by_name=want is not None, progress=progress), asked)


def computed(
    scene: Scene, asked: frozenset[str], *, by_name: bool, progress: Progress | None, keep_last: bool = False
) -> RunResult:
    """Return everything that had to be computed for what was asked.

    Parameters
    ----------
    asked
        As ``want`` of `run`.
    by_name
        Whether the scene must have all of it.
    keep_last
        Where a step of the press is refused, go on with the state before it, which its facts say.
    """
    if unknown := sorted(asked - WANTED):
        raise RecipeError(f"want: unknown {', '.join(unknown)}; allowed are {', '.join(sorted(WANTED))}")
    return _Chain(Sensor(scene, progress), _needed(scene, asked, by_name=by_name), progress, keep_last).go()


def _needed(scene: Scene, asked: frozenset[str], by_name: bool) -> frozenset[str]:
    """Close ``asked`` under what each part needs, within what the scene has."""
    has = {"displacement", "score", "report"}
    if scene.camera is not None:
        has |= {"picture", "tracking"}
    if scene.reconstruction is not None:
        has |= {"forces"}
    if by_name and (lacking := sorted(asked - has)):
        tables = "[reconstruction]" if lacking == ["forces"] and scene.camera else "[camera]"
        raise RecipeError(f"want {', '.join(lacking)}: this scene has no {tables} table")
    needs = {"displacement"}
    if asked & {"score", "report"}:
        return frozenset(has)
    if asked & {"picture", "tracking", "forces"}:
        needs |= {"picture"}
    if asked & {"tracking", "forces"}:
        needs |= {"tracking"}
    return frozenset(needs | asked)


@dataclass
class _Chain:
    """One run through the stages; holds what later stages need of earlier ones.

    With ``keep_last`` a step of the press that is refused leaves the state before it, else the error.
    """

    sensor: Sensor
    needed: frozenset[str]
    progress: Progress | None
    keep_last: bool = False
    timings: dict[str, float] = field(default_factory=dict)
    stages: int = 8
    failures: dict[str, str] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.progress is not None:
            self.progress(name, min(0.95, len(self.timings) / self.stages))
        started = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - started

    def go(self) -> RunResult:
        sensor, scene = self.sensor, self.sensor.nominal
        with self.stage("design"):
            sensor.actual  # noqa: B018  a marker outside the body is said before anything is computed
            if "picture" in self.needed:
                from twin.world.picture.room import require_room
                from twin.world.picture.variant import forced_variant

                require_room(scene)
                forced_variant()  # a wrong name is said before the press is solved
        with self.stage("contact"):
            state = None
            if scene.press is not None and not scene.tractions:
                state = self._pressed()
            load = state.load if state is not None else scene.load
        with self.stage("displacement"):
            motion = sensor.motion(load)
        truth = self._truth(motion, sensor.rectangles(load))
        rest = pressed = found = calibration = forces = None
        if "picture" in self.needed:
            with self.stage("rest picture"):
                rest = sensor.picture(None)
            with self.stage("pressed picture"):
                pressed = sensor.picture(motion)
            with self.stage("outlines"):
                truth = self._with_outlines(truth, motion)
        if "tracking" in self.needed and rest is not None and pressed is not None:
            from twin.sense.track import track

            with self.stage("tracking"):
                try:
                    found = track(rest, pressed, sensor.layout_px, method=scene.tracking.method)
                except InputError as problem:  # the picture shows too little: truth and pictures are still worth having
                    self.failures |= {"tracking": str(problem), "force": "nothing was tracked"}
        if "forces" in self.needed and found is not None and scene.reconstruction is not None:
            from twin.sense.reconstruct import reconstruct
            from twin.study.calibrate import calibration_of

            with self.stage("calibration"):
                calibration = calibration_of(sensor)
            with self.stage("reconstruction"):
                wanted = scene.reconstruction
                try:
                    forces = reconstruct(
                        found, calibration, **wanted.model_dump(exclude={"sites", "source", "assumed"})
                    )
                except InputError as problem:
                    self.failures["force"] = str(problem)
        estimate = _estimate(found, forces)
        with self.stage("score"):
            frames = calibration.site_frames if calibration is not None else None
            score = score_of(sensor, truth, motion, estimate, state, frames, self.failures)
        return RunResult(
            scene_toml=dump_scene(scene),
            truth=truth,
            estimate=estimate,
            rest=rest,
            pressed=pressed,
            score=score,
            touches=touches(scene, scene.press, state) if scene.press is not None and state is not None else (),
            facts=facts_of(sensor, state, calibration, forces, "picture" in self.needed),
            timings=self.timings,
        )

    def _pressed(self) -> ContactState:
        from twin.world.contact.contact_state import ContactState

        try:
            return self.sensor.press(with_error=bool({"score", "report"} & self.needed))
        except ContactError as refused:
            if self.keep_last and isinstance(refused.last_state, ContactState):
                return refused.last_state
            raise

    def _truth(self, motion: Motion, rectangles: Rectangles) -> Truth:
        sensor = self.sensor
        markers = sensor.actual.markers
        force, place = rectangles.force_n, rectangles.centre_mm
        return Truth(
            marker_rest_mm=markers.points,
            marker_displacement_mm=motion.displacement_mm,
            marker_layer=markers.layer,
            marker_rest_px=sensor.project(markers.points),
            marker_pressed_px=sensor.project(markers.points + motion.displacement_mm),
            marker_outline_rest_px=np.zeros((0, 2)),
            marker_outline_pressed_px=np.zeros((0, 2)),
            marker_visible=np.zeros(0, bool),
            surface_mm=place,
            surface_force_n=force,
            total_force_n=force.sum(axis=0),
            total_torque_nmm=np.cross(place, force).sum(axis=0),
        )

    def _with_outlines(self, truth: Truth, motion: Motion) -> Truth:
        sensor = self.sensor
        rest = sensor.renderer.outlines(sensor.ellipsoids(None))
        pressed = sensor.renderer.outlines(sensor.ellipsoids(motion))
        return replace(
            truth,
            marker_outline_rest_px=rest.centroid_px,
            marker_outline_pressed_px=pressed.centroid_px,
            marker_visible=(rest.visible >= UNOCCLUDED) & (pressed.visible >= UNOCCLUDED),
        )


def _estimate(found: Found | None, forces: Field | None) -> Estimate | None:
    if found is None:
        return None
    nothing = np.zeros((0, 3))
    return Estimate(
        marker_rest_px=found.rest_px,
        marker_shift_px=found.shift_px,
        site_mm=forces.site_mm if forces is not None else nothing,
        force_n=forces.force_n if forces is not None else nothing,
        total_force_n=forces.total_force_n if forces is not None else np.zeros(0),
        total_torque_nmm=forces.total_torque_nmm if forces is not None else np.zeros(0),
    )


def only_wanted(result: RunResult, asked: frozenset[str]) -> RunResult:
    """Drop what was only needed on the way."""
    return replace(
        result,
        truth=result.truth if "displacement" in asked else None,
        rest=result.rest if "picture" in asked else None,
        pressed=result.pressed if "picture" in asked else None,
        estimate=result.estimate if asked & {"tracking", "forces"} else None,
        score=result.score if "score" in asked else None,
    )
