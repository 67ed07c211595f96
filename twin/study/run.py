"""One press through the whole twin: `run` returns its results, `run_to_folder` also writes files.

Only the stages are computed that are wanted, and those that they need:

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

import math
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Picture, Pixels, Progress
from twin.blas_threads import one_blas_thread
from twin.compiled import COMPILING
from twin.errors import ContactError, InputError, RecipeError, SomeFailed, did_you_mean
from twin.files import make_folder, write_whole
from twin.parts.load import Rectangles
from twin.parts.methods import WANTED
from twin.parts.press import Cylinder, Press, Sphere
from twin.parts.scene import Scene
from twin.results import MARK, RESULT_FILES, Estimate, RunResult, Truth
from twin.study.doubts import View, doubts
from twin.study.recipe import load_scene
from twin.study.sensor import Motion, Sensor
from twin.theory.contact import hertz, largest_strain_and_turn, punch_pressure

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration
    from twin.sense.reconstruct import Field
    from twin.sense.track import Found
    from twin.world.contact.pressing import ContactState

UNOCCLUDED = 0.98
"""Share of an unoccluded marker's outline that is visible, at rest and pressed."""

FEW = 0.5
"""Share of found markers below which a run warns, as for a recorded frame."""

_STAGES = {
    "design": "displacement",
    "contact": "displacement",
    "displacement": "displacement",
    "rest picture": "picture",
    "pressed picture": "picture",
    "outlines": "picture",
    "tracking": "tracking",
    "calibration": "forces",
    "reconstruction": "forces",
    "contact error": "displacement",
    "linearity": "score",
    "score": "displacement",
}
"""The stages in their order, each with what needs it."""

_CURVE_POINTS = 80

_SAME = 1e-6
"""A part of a press ends with a frame within this share of the time between two."""


def run(
    scene: Scene | str | Path,
    want: Collection[str] | None = None,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> RunResult:
    """Compute the scene's press through the twin.

    Parameters
    ----------
    scene
        A scene, the name of a shipped one, or the path of a file.
    want
        Any of displacement, picture, tracking, forces, score, report; all if not given.
    progress
        Called at every stage.
    overrides
        Values by dotted key, as for `load_scene`; only with a name or a path.

    Returns
    -------
    RunResult
        What was wanted; the rest is None.

    Raises
    ------
    RecipeError
        The scene lacks what ``want`` names.
    InputError
        There is no such scene, ``want`` names what is no result, or overrides are given with a
        scene that is loaded.

    Examples
    --------
    >>> import twin
    >>> result = twin.run("first_press", {"displacement"})
    >>> result
    RunResult(true force (0, 0, 2) N)
    >>> sorted(result.truth.columns())
    ['layer', 'ux_mm', 'uy_mm', 'uz_mm', 'x_mm', 'y_mm', 'z_mm']
    """
    if isinstance(want, str):
        want = {want}
    if not isinstance(scene, Scene):
        scene = load_scene(scene, overrides)
    elif overrides:
        raise InputError("overrides belong to a scene's name or path: give them to load_scene")
    wanted = frozenset(WANTED if want is None else want)
    return _only(_computed(*_checked(scene, wanted, want is not None, progress)), wanted)


def run_to_folder(
    scene: Scene, folder: Path, want: Collection[str], progress: Progress | None = None
) -> str:
    """Run a scene, write its files into ``folder`` and return a summary of a few lines.

    Raises
    ------
    SomeFailed
        A step of the press after the first has no equilibrium or does not converge: the files,
        and the facts in score.json, are those of the state before it. Or the sensor's software
        found no markers or no forces in the pictures: the other files are complete.
    """
    wanted = frozenset(want)
    sensor, needed = _checked(scene, wanted, wanted != frozenset(WANTED), progress)
    make_folder(folder, (MARK, *RESULT_FILES))
    with COMPILING.compiled_ahead("twin.sense.compile_ahead" if "tracking" in needed else ""):
        result = _computed(sensor, needed, keep_last=True)
    page = ""
    if "report" in wanted:
        from twin.show.report import report

        started = time.perf_counter()
        page = report(result)
        result.timings["report"] = time.perf_counter() - started
    _only(result, wanted).write(folder)
    if page:
        write_whole(folder / "report.html", page.encode())
    if progress is not None:
        progress("done", 1.0)
    # A path that stopped early has results, and an exit code of its own.
    if (reason := result.facts.get("contact", {}).get("incomplete")) is not None:
        raise SomeFailed(f"press: {reason}; what belongs to that state is in {folder}")
    summary = f"{result.summary()}\nwritten to  {folder}"
    if failed := result.facts.get("failed"):
        stage, reason = next(iter(failed.items()))
        raise SomeFailed(f"{stage} failed: {reason}\n{summary}")
    return summary


@one_blas_thread()
def _checked(
    scene: Scene, wanted: frozenset[str], by_name: bool, progress: Progress | None
) -> tuple[Sensor, frozenset[str]]:
    """Return the sensor and what is needed; ``by_name``: the scene must have all that is wanted."""
    for name in sorted(wanted.difference(WANTED)):
        hint = did_you_mean(name, WANTED, f"allowed are {', '.join(WANTED)}")
        raise InputError(f"want = '{name}': unknown; {hint}")
    sensor = Sensor(scene, progress)
    needed = _needed(scene, wanted, by_name)
    sensor.actual  # noqa: B018  refuses a marker outside the body
    return sensor, needed


def _needed(scene: Scene, wanted: frozenset[str], by_name: bool) -> frozenset[str]:
    """Add to ``wanted`` what each part needs, within what the scene has."""
    has = {"displacement", "score", "report"}
    if scene.camera is not None:
        has |= {"picture", "tracking"}
    if scene.reconstruction is not None:
        has |= {"forces"}
    if by_name and (lacking := sorted(wanted - has)):
        tables = "[reconstruction]" if lacking == ["forces"] and scene.camera else "[camera]"
        raise RecipeError(f"want {', '.join(lacking)}: this scene has no {tables} table")
    if wanted & {"score", "report"}:
        return frozenset(has)
    needs = {"displacement"}
    if wanted & {"picture", "tracking", "forces"}:
        needs |= {"picture"}
    if wanted & {"tracking", "forces"}:
        needs |= {"tracking"}
    return frozenset(needs | wanted)


def _only(result: RunResult, wanted: frozenset[str]) -> RunResult:
    """Drop intermediate results that are not wanted."""
    return replace(
        result,
        truth=result.truth if "displacement" in wanted else None,
        rest=result.rest if "picture" in wanted else None,
        pressed=result.pressed if "picture" in wanted else None,
        estimate=result.estimate if wanted & {"tracking", "forces"} else None,
        score=result.score if "score" in wanted else None,
    )


@one_blas_thread()
def _computed(sensor: Sensor, needed: frozenset[str], keep_last: bool = False) -> RunResult:
    """Compute what is needed; with ``keep_last`` a step without equilibrium leaves the state before
    it."""
    stages = _Stages(sensor, needed)
    stages.press(keep_last)
    if "picture" in needed:
        stages.pictures()
    if "tracking" in needed:
        stages.track()
    if "forces" in needed:
        stages.reconstruct()
    stages.judge_truth()
    return stages.result(stages.score())


class _Stages:
    """The stages of one run, in the order in which they are called, and what each found.

    Attributes
    ----------
    state, ends_s
        The press, None of given tractions, and the times at which its parts end, s, None without
        frames.
    rest, pressed, found, calibration, field
        Pictures, shifts, calibration and forces: None where they aren't needed or failed.
    bound_px
        `View.noise_bound` of the markers; None without pictures.
    failures
        Why the sensor's software found nothing, by the name of the missing result.
    """

    def __init__(self, sensor: Sensor, needed: frozenset[str]) -> None:
        self.sensor = sensor
        self.scene = sensor.nominal
        self.needed = needed
        self.timings: dict[str, float] = {}
        self.cpu_s: dict[str, float] = {}
        self.failures: dict[str, str] = {}
        self.state: ContactState | None = None
        self.ends_s: Floats | None = None
        self.rest: Picture | None = None
        self.pressed: Picture | None = None
        self.found: Found | None = None
        self.calibration: Calibration | None = None
        self.field: Field | None = None
        self.bound_px: Floats | None = None
        self._names = [name for name, needs in _STAGES.items() if needs in needed]

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        """Say that a stage begins, and keep how long it takes."""
        if self.sensor.progress is not None:
            self.sensor.progress(name, self._names.index(name) / len(self._names))
        started, cpu = time.perf_counter(), time.process_time()
        yield
        self.timings[name] = time.perf_counter() - started
        self.cpu_s[name] = time.process_time() - cpu

    def press(self, keep_last: bool) -> None:
        """Compute the truth: the load of the press, or given tractions, and the markers' motion."""
        sensor, scene = self.sensor, self.scene
        # Refuse what can't be rendered on this machine before anything is solved.
        with self._stage("design"):
            if "picture" in self.needed:
                from twin.world.picture.backend import Variant

                Variant.check_machine(scene)
        with self._stage("contact"):
            if scene.press is not None and not scene.tractions:
                press, self.ends_s = _at_rate(scene, scene.press)
                self.state = _pressed(sensor, press, keep_last)
            load = scene.load if self.state is None else self.state.load
        with self._stage("displacement"):
            self.motion = sensor.motion(load)
        self.patches = sensor.rectangles(load)
        self.truth = _truth(sensor, self.motion, self.patches)

    def pictures(self) -> None:
        """Draw the rest and the pressed picture, and add the true outlines in them to the truth."""
        with self._stage("rest picture"):
            self.rest = self.sensor.picture(None)
        with self._stage("pressed picture"):
            self.pressed = self.sensor.picture(self.motion)
        with self._stage("outlines"):
            self.truth = _with_outlines(self.sensor, self.truth, self.motion)
        self.bound_px = View.noise_bound(self.scene)

    def track(self) -> None:
        """Find the markers' shifts in the pictures; where that fails, truth and pictures stay."""
        from twin.sense.track import track

        assert self.rest is not None
        assert self.pressed is not None
        method = self.scene.tracking.method
        with self._stage("tracking"):
            COMPILING.wait_for_second()
            try:
                self.found = track(self.rest, self.pressed, self.sensor.layout_px, method=method)
            except InputError as problem:
                self.failures |= {"tracking": str(problem), "force": "nothing was tracked"}

    def reconstruct(self) -> None:
        """Compute the forces from the shifts, if there are any."""
        if self.found is None or self.scene.reconstruction is None:
            return
        from twin.sense.reconstruct import reconstruct
        from twin.study.calibrate import calibration_of

        with self._stage("calibration"):
            self.calibration = calibration_of(self.sensor)
        with self._stage("reconstruction"):
            try:
                options = self.scene.reconstruction.options()
                if self.state is not None and self.ends_s is not None and self.rest is not None:
                    options |= _history(
                        self.sensor, self.rest, self.state, self.ends_s, self.calibration
                    )
                self.field = reconstruct(self.found, self.calibration, **options)
            except InputError as problem:
                self.failures["force"] = str(problem)

    @cached_property
    def estimate(self) -> Estimate | None:
        """What the sensor's software found; None where it tracked nothing."""
        return _estimate(self.found, self.field)

    def judge_truth(self) -> None:
        """Estimate how far the truth itself is off, and how far linear theory carries."""
        if self.state is None:
            return
        with self._stage("contact error"):
            self.state.error  # noqa: B018  computed at first use
        if "score" in self.needed:
            with self._stage("linearity"):
                self.state = replace(self.state, validity=self.sensor.validity(self.state))

    def score(self) -> dict[str, Any]:
        """Return the errors by stage."""
        from twin.judge.score import force_score, score, tracking_score

        with self._stage("score"):
            tracking = force = None
            truth = self.truth
            if (estimate := self.estimate) is not None:
                shift_px = truth.marker_outline_pressed_px - truth.marker_outline_rest_px
                tracking = tracking_score(
                    estimate.marker_shift_px, shift_px, truth.marker_visible, bound_px=self.bound_px
                )
                if len(estimate.site_mm):
                    frames = None if self.calibration is None else self.calibration.site_frames
                    force = force_score(estimate, self.patches, frames)
            in_time = self.ends_s is not None
            errors = score(
                elastic=_elastic_errors(truth, self.motion, self.state, in_time=in_time),
                tracking=tracking,
                force=force,
            )
            errors["reasons"] |= self.failures
        return errors

    def result(self, errors: dict[str, Any]) -> RunResult:
        """Return all that was found, with ``errors`` of `score`."""
        return RunResult(
            scene_toml=self.scene.to_toml(),
            truth=self.truth,
            estimate=self.estimate,
            rest=self.rest,
            pressed=self.pressed,
            score=errors,
            touches=_touches(self.scene, self.state),
            facts=self._facts(errors),
            timings=self.timings,
            cpu_s=self.cpu_s,
        )

    def _facts(self, errors: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the report and the summary show beside the errors."""
        scene = self.scene
        facts: dict[str, Any] = {
            "seed": scene.seed,
            "shared": _shared_by_truth_and_estimate(scene),
        }
        if warned := self._warnings(errors["tracking"]):
            facts["warnings"] = warned
        if self.failures:
            facts["failed"] = self.failures
        if self.state is not None:
            facts |= _press_facts(self.state) | _course(scene, self.state, self.ends_s)
            if self.field is not None and "creep_error" in errors["elastic"]:
                facts["validity"]["notes"] += (
                    "one picture doesn't show how far the rubber has relaxed: forces are taken "
                    "half-way between not at all and for ever; found as if it didn't they are "
                    f"{100 * errors['elastic']['creep_error']:.2g} % off by that alone. "
                    "reconstruction.frames_per_second follows the press in frames",
                )
        if self.calibration is not None and self.field is not None:
            sites = len(self.calibration.site_mm)
            facts["calibration"] = {"method": scene.calibration.method, "sites": sites}
            facts["weight"] = self.field.weight
            if cause := self.field.one_layer(self.calibration.layer):
                facts["one_layer"] = cause
        if "picture" in self.needed:
            facts["renderer"] = self.sensor.renderer.drawn_by
            if self.sensor.saturation is not None:
                facts["picture_warnings"] = [self.sensor.saturation]
        return facts

    def _warnings(self, tracking: Mapping[str, Any] | None) -> list[str]:
        """Return what is doubtful in the scene, its pictures and its tracking."""
        scene = self.scene
        warned = doubts(scene)
        if "picture" in self.needed:
            if self.state is not None or scene.tractions:
                shift_px = self.truth.marker_pressed_px - self.truth.marker_rest_px
                noise_px = (tracking or {}).get("sd_px")
                if self.bound_px is not None and np.isfinite(self.bound_px).any():
                    noise_px = float(np.nanmedian(self.bound_px))
                warned += _unseen(scene, shift_px, noise_px)
            if scene.light is not None and self.ends_s is None:
                warned += scene.light.turns()
        return [*warned, *_tracking_doubt(tracking, self.found)]


def _unseen(scene: Scene, shift_px: Pixels, noise_px: float | None) -> list[str]:
    """Return a warning where (n, 2) true shifts are all below the noise of one, None if not
    known."""
    moved = np.linalg.norm(shift_px, axis=1)
    if noise_px is None or not np.isfinite(moved).any() or np.nanmax(moved) >= noise_px:
        return []
    keys = "tractions in N"
    if scene.press is not None:
        keys = "press.force_n in N, or indentation_mm in mm"
    return [
        f"no marker moves by more than {np.nanmax(moved):.2g} px in the picture, less than the "
        f"noise of a measured shift ({noise_px:.2g} px): nothing can be measured; press harder "
        f"({keys}), or take softer rubber (material.youngs_modulus_mpa = "
        f"{scene.material.youngs_modulus_mpa:g} MPa)"
    ]


def _at_rate(scene: Scene, press: Press) -> tuple[Press, Floats | None]:
    """Return the press in parts that end with frames, and their times, s; without frames None."""
    rate = None if scene.reconstruction is None else scene.reconstruction.frames_per_second
    if rate is None:
        return press, None
    from twin.study.film import at_frames

    return at_frames(press, rate)


def _history(
    sensor: Sensor,
    rest: Picture,
    state: ContactState,
    ends_s: Floats,
    calibration: Calibration,
) -> dict[str, Any]:
    """Return what the last frame's reconstruction takes of all frames before it, of rubber that
    relaxes."""
    from twin.sense.reconstruct import reconstruct
    from twin.sense.track import Tracker
    from twin.theory.relaxation import Hereditary

    scene = sensor.nominal
    assert calibration.relaxation is not None
    rate = scene.inverse.frames_per_second
    rests = [rest, *(sensor.rest_picture(n) for n in range(1, len(sensor.renderers)))]
    tracker = Tracker(rests, sensor.layout_px, method=scene.tracking.method)
    history = Hereditary(calibration.relaxation)
    before_s = 0.0
    last_s = float(ends_s[len(state.path) - 1])
    for number, (one, end_s) in enumerate(zip(state.path[:-1], ends_s, strict=False)):
        if abs(end_s * rate - round(end_s * rate)) > _SAME:
            continue  # a step that ends between two frames
        frame = round((end_s - last_s) * rate)  # the last one, whose picture is there, is 0
        if sensor.progress is not None:
            sensor.progress(f"frame at {end_s:.3g} s", 0.8)
        picture = sensor.picture(sensor.quick_motion(one.load), 2 + number, frame)
        memory = {"history": history, "after_s": end_s - before_s}
        try:
            found = tracker.track(picture, frame)
            reconstruct(found, calibration, **memory, **scene.inverse.options())
        except InputError:  # bridged, as in a recording
            tracker.forget()
            continue
        before_s = end_s
    return {"history": history, "after_s": last_s - before_s}


def _pressed(sensor: Sensor, press: Press, keep_last: bool) -> ContactState:
    from twin.world.contact.contact_state import ContactState

    try:
        return sensor.press(press)
    except ContactError as problem:
        if keep_last and isinstance(problem.last_state, ContactState):
            return problem.last_state
        raise


def _truth(sensor: Sensor, motion: Motion, patches: Rectangles) -> Truth:
    markers = sensor.actual.markers
    return Truth(
        marker_rest_mm=markers.points,
        marker_displacement_mm=motion.displacement_mm,
        marker_layer=markers.layer,
        marker_rest_px=sensor.project(markers.points),
        marker_pressed_px=sensor.project(markers.points + motion.displacement_mm),
        marker_outline_rest_px=np.zeros((0, 2)),
        marker_outline_pressed_px=np.zeros((0, 2)),
        marker_visible=np.zeros(0, bool),
        surface_mm=patches.centre_mm,
        surface_force_n=patches.force_n,
        total_force_n=patches.total_force_n,
        total_torque_nmm=patches.total_torque_nmm,
    )


def _with_outlines(sensor: Sensor, truth: Truth, motion: Motion) -> Truth:
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
    by_site = ("site_mm", "force_n", "sd_force_n")
    totals = ("total_force_n", "total_torque_nmm", "sd_total_n", "sd_torque_nmm")
    return Estimate(
        marker_rest_px=found.rest_px,
        marker_shift_px=found.shift_px,
        marker_sd_px=found.sd_px,
        marker_state=found.states,
        **{name: getattr(forces, name, np.zeros((0, 3))) for name in by_site},
        **{name: getattr(forces, name, np.zeros(0)) for name in totals},
    )


def _tracking_doubt(tracking: Mapping[str, Any] | None, found: Found | None) -> list[str]:
    """Return a warning where few of the unoccluded markers were found, and what became of the
    others."""
    if found is None or not tracking or not tracking["markers"] or tracking["matched"] >= FEW:
        return []
    seen = round(tracking["matched"] * tracking["markers"])
    others = zip(*np.unique(found.states[~found.seen], return_counts=True), strict=True)
    lost = ", ".join(f"{count} {state}" for state, count in others)
    return [
        f"only {seen} of the {tracking['markers']} markers in full sight were found in the "
        f"pressed picture (of all, {lost}): the forces rest on these alone. Press less, or look at "
        "exposure and contrast in rest.png and pressed.png"
    ]


def _press_facts(state: ContactState) -> dict[str, Any]:
    """Return the contact, with the warnings and notes of every probe."""
    loads = ("force_n", "torque_nmm", "indentation_mm")
    shapes = ("contact_radius_mm", "area_mm2", "peak_pressure_mpa", "elastic_nmm", "dissipated_nmm")
    contact: dict[str, Any] = {name: getattr(state, name) for name in (*loads, *shapes)}
    if state.error is not None:
        contact["error"] = asdict(state.error)
    every = [one.validity for one in (state, *state.also)]
    warned = dict.fromkeys(warning for one in every for warning in one.warnings)
    notes = dict.fromkeys(note for one in every for note in one.notes)
    incomplete = []
    if not state.complete:
        contact["incomplete"] = state.reason
        incomplete = [f"the press is not complete: {state.reason}"]
    facts: dict[str, Any] = {"contact": contact}
    if state.also:
        facts["further_probes"] = [
            {name: getattr(other, name) for name in loads} for other in state.also
        ]
    texts = {"warnings": (*incomplete, *warned), "notes": tuple(notes)}
    return facts | {"validity": asdict(state.validity) | texts}


def _course(scene: Scene, state: ContactState, ends_s: Floats | None) -> dict[str, Any]:
    """Return force and indentation at the end of every step, or part of one, in time."""
    if scene.press is None or not any(step.seconds for step in scene.press.path):
        return {}
    times = accumulate(step.seconds for step in scene.press.path) if ends_s is None else ends_s
    rows = [(0.0, 0.0, 0.0, 0.0, 0.0)]
    rows += [
        (time_s, *one.force_n.tolist(), one.indentation_mm)
        for time_s, one in zip(times, state.path, strict=False)
    ]
    time_s, x, y, z, depth = zip(*rows, strict=True)
    course = {"time_s": time_s, "x_n": x, "y_n": y, "z_n": z, "indentation_mm": depth}
    return {"course": course}


def _elastic_errors(
    truth: Truth, motion: Motion, state: ContactState | None, *, in_time: bool
) -> dict[str, Any]:
    """Return the errors of the truth itself, and the reasons of those that are unknown."""
    moved = np.linalg.norm(truth.marker_displacement_mm, axis=1)
    strain, turn = largest_strain_and_turn(motion.gradient)
    figures: dict[str, Any] = {
        "largest_displacement_mm": float(moved.max()) if len(moved) else None,
        "contact_residual": None if state is None else state.residual,
        "largest_strain": strain,
        "largest_turn_deg": turn,
    }
    crept = None if state is None or state.load.strained is not None else state.load.crept
    if not in_time and state is not None and crept is not None and state.load.terms:
        # A total force that takes the motion of rubber that relaxes for elastic.
        true, elastic = (
            sum(term.force_n.sum(axis=0) for term in load.terms if isinstance(term, Rectangles))
            for load in (state.load, crept)
        )
        figures["creep_error"] = float(np.linalg.norm(elastic - true) / np.linalg.norm(true))
    reasons = {}
    error = None if state is None else state.error
    names = ("force", "indentation", "traction", "markers")
    stated = {name: getattr(error, name, None) for name in names}
    stated["displacement"] = motion.error_of(state)
    for name, value in stated.items():
        if value is None or not math.isfinite(value):
            value = None
            reasons[f"{name}_error"] = (
                "nothing is pressed"
                if error is None
                else "the press doesn't settle on other patches"
            )
        figures[f"{name}_error"] = value
    for name in ("contact_over_probe_radius", "linearisation_error"):
        figures[name] = None if state is None else getattr(state.validity, name)
        if figures[name] is None:
            reasons[name] = "nothing is pressed" if state is None else "the probe is flat"
    return figures | {"reasons": reasons}


def _touches(scene: Scene, state: ContactState | None) -> tuple[RunResult.Touch, ...]:
    """Return the contact under each probe that touches the body."""
    if state is None or scene.press is None:
        return ()
    terms = iter(state.load.terms)
    found = []
    for press, own in zip(scene.presses, (state, *state.also), strict=True):
        if not len(own.pressure_mpa):
            continue
        patches = next(terms)
        assert isinstance(patches, Rectangles)
        # A plane through the middle of the contact, with the local normal; its own frame for the
        # drawing.
        middle = np.average(patches.centre_mm, axis=0, weights=own.pressure_mpa)
        inward = patches.frames[np.argmin(np.linalg.norm(patches.centre_mm - middle, axis=1)), 2]
        axes = Press.frame_of(tuple(inward))
        push_n = float(patches.total_force_n @ inward)
        expected, name = _closed_form(scene, press, own, push_n)
        found.append(
            RunResult.Touch(
                probe=press.probe.kind,
                place_mm=(patches.centre_mm - middle) @ axes[:2].T,
                half_mm=np.array(patches.half_mm),
                pressure_mpa=np.array(own.pressure_mpa),
                shear_mpa=np.array(own.traction_mpa @ axes[:2].T),
                slip=np.array(own.slip),
                friction=own.friction,
                expected=expected,
                expected_name=name,
            )
        )
    return tuple(found)


def _closed_form(
    scene: Scene, press: Press, state: ContactState, push_n: float
) -> tuple[Floats, str]:
    """Return (n, 2) distances, mm, and pressures, MPa, of a half-space, and the form's name."""
    probe = press.probe
    if scene.body.is_flat and state.pressure_mpa.any():
        if isinstance(probe, Sphere):
            theory = hertz(
                radius_mm=probe.diameter_mm / 2,
                youngs_modulus_mpa=scene.material.youngs_modulus_mpa,
                poisson_ratio=scene.material.poisson_ratio,
                force_n=push_n,
            )
            distance = np.linspace(0.0, 1.2 * theory.contact_radius_mm, _CURVE_POINTS)
            return np.column_stack([distance, theory.pressure(distance)]), "Hertz"
        if isinstance(probe, Cylinder) and probe.edge_mm == 0.0 and not any(press.tilt_deg):
            distance = np.linspace(0.0, 0.995 * probe.diameter_mm / 2, _CURVE_POINTS)
            pressure = punch_pressure(distance, probe.diameter_mm / 2, push_n)
            return np.column_stack([distance, pressure]), "flat punch on a half-space"
    return np.zeros((0, 2)), ""


def _shared_by_truth_and_estimate(scene: Scene) -> list[str]:
    """Return what the sensor's software knows exactly, as truth and nominal design share it."""
    relaxes = bool(scene.material.relaxation)
    in_time = scene.reconstruction is not None and scene.reconstruction.frames_per_second
    shared = [
        "shape of the body, and that it is homogeneous"
        + (", linear" if scene.material.law == "linear" else "")
        + ((", and how it relaxes" if in_time else " (but not that it relaxes)") if relaxes else "")
        + " and bonded at its base",
        "number, order, pitch and diameter of the markers",
        "refractive indices and thicknesses of the layers in front of the camera",
        "closed-form half-space part of the elastic field (its finite-element correction lives "
        "on another mesh)",
    ]
    if not scene.tolerance.distortion:
        shared.append("lens model without distortion error")
    if not any(layer.stiff for layer in scene.markers.values()):
        shared.append(
            "that markers are points which the rubber carries (beads in a block can be stiff)"
        )
    if scene.tolerance.preset == "none":
        shared.append("every nominal number: tolerance.preset is none")
    return shared
