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

`summary` makes the lines that ``twin run`` prints at the end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Progress
from twin.blas_threads import one_blas_thread
from twin.compiled import COMPILING, compiled_ahead
from twin.errors import ContactError, InputError, RecipeError, SomeFailed
from twin.files import make_folder, write_whole
from twin.parts.load import Rectangles
from twin.parts.press import Press, Sphere, frame_of
from twin.parts.probe import Cylinder
from twin.parts.scene import Scene
from twin.results import Estimate, RunResult, Touch, Truth
from twin.study.doubts import doubts, noise_bound, unseen
from twin.study.recipe import dump_scene, load_scene
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

WANTED = frozenset({"displacement", "picture", "tracking", "forces", "score", "report"})

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
        There is no such scene, or overrides are given with a scene that is loaded.

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
    wanted = frozenset(want) if want is not None else WANTED
    return _only(_chain(scene, wanted, want is not None, progress).result(), wanted)


def run_to_folder(
    scene: Scene, folder: Path, want: Collection[str], progress: Progress | None = None
) -> str:
    """Run a scene, write its files into ``folder`` and return a summary of a few lines.

    Raises
    ------
    SomeFailed
        A step of the press after the first has no equilibrium or does not converge: the files,
        and the facts in score.json, are those of the state before it.
    """
    # Compute, then write only what is wanted.
    wanted = frozenset(want)
    chain = _chain(scene, wanted, wanted != WANTED, progress)
    make_folder(folder)
    RunResult.refuse_other_files(folder)
    chain.keep_last = True
    with compiled_ahead("twin.sense.compile_ahead" if "tracking" in chain.needed else ""):
        result = chain.result()
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
    return summary(result, folder)


@one_blas_thread()
def _chain(
    scene: Scene, wanted: frozenset[str], by_name: bool, progress: Progress | None
) -> _Chain:
    """Return the stages of ``wanted``, checked; ``by_name``: the scene must have all of it."""
    if unknown := sorted(wanted - WANTED):
        raise RecipeError(
            f"want: unknown {', '.join(unknown)}; allowed are {', '.join(sorted(WANTED))}"
        )
    sensor = Sensor(scene, progress)
    needed = _needed(scene, wanted, by_name)
    sensor.actual  # noqa: B018  refuses a marker outside the body
    return _Chain(sensor, needed, progress)


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


@dataclass
class _Chain:
    """The stages of one run, with the results that later stages need.

    With ``keep_last`` a step without equilibrium leaves the state before it, else the error.
    """

    sensor: Sensor
    needed: frozenset[str]
    progress: Progress | None
    keep_last: bool = False
    state: ContactState | None = None
    calibration: Calibration | None = None
    forces: Field | None = None
    timings: dict[str, float] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.progress is not None:
            stages = [each for each, needs in _STAGES.items() if needs in self.needed]
            self.progress(name, stages.index(name) / len(stages))
        started = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - started

    @one_blas_thread()
    def result(self) -> RunResult:
        sensor = self.sensor
        scene = self.sensor.nominal
        # Refuse what can't be rendered on this machine before anything is solved.
        with self.stage("design"):
            if "picture" in self.needed:
                from twin.world.picture.backend import check_machine

                check_machine(scene)
        # The truth: the load of the press, or given tractions, and the motion of the markers.
        with self.stage("contact"):
            load = scene.load
            if scene.press is not None and not scene.tractions:
                self.state = self._pressed()
                load = self.state.load
        with self.stage("displacement"):
            motion = sensor.motion(load)
        patches = sensor.rectangles(load)
        truth = self._truth(motion, patches)
        # The pictures, and the shifts that the software finds in them.
        rest = pressed = found = None
        if "picture" in self.needed:
            with self.stage("rest picture"):
                rest = sensor.picture(None)
            with self.stage("pressed picture"):
                pressed = sensor.picture(motion)
            with self.stage("outlines"):
                truth = self._with_outlines(truth, motion)
            if "tracking" in self.needed:
                from twin.sense.track import track

                with self.stage("tracking"):
                    COMPILING.wait_for_second()
                    try:
                        found = track(rest, pressed, sensor.layout_px, method=scene.tracking.method)
                    except InputError as problem:  # truth and pictures are still useful
                        self.failures |= {"tracking": str(problem), "force": "nothing was tracked"}
        # The forces that the software computes, which may be none.
        if "forces" in self.needed and found is not None:
            self._reconstruct(found)
        estimate = _estimate(found, self.forces)
        # How far the truth itself is off, and how far linear theory carries.
        if self.state is not None:
            with self.stage("contact error"):
                self.state.error  # noqa: B018  computed at first use
        if self.state is not None and "score" in self.needed:
            with self.stage("linearity"):
                self.state = replace(self.state, validity=sensor.validity(self.state))
        with self.stage("score"):
            score = self._score(truth, motion, patches, estimate)
        return RunResult(
            scene_toml=dump_scene(scene),
            truth=truth,
            estimate=estimate,
            rest=rest,
            pressed=pressed,
            score=score,
            touches=_touches(scene, self.state),
            facts=self._facts(truth, score),
            timings=self.timings,
        )

    def _pressed(self) -> ContactState:
        from twin.world.contact.contact_state import ContactState

        try:
            return self.sensor.press()
        except ContactError as problem:
            if self.keep_last and isinstance(problem.last_state, ContactState):
                return problem.last_state
            raise

    def _truth(self, motion: Motion, patches: Rectangles) -> Truth:
        sensor = self.sensor
        markers = self.sensor.actual.markers
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

    def _reconstruct(self, found: Found) -> None:
        from twin.sense.reconstruct import reconstruct
        from twin.study.calibrate import calibration_of

        wanted = self.sensor.nominal.reconstruction
        assert wanted is not None
        with self.stage("calibration"):
            self.calibration = calibration_of(self.sensor)
        with self.stage("reconstruction"):
            try:
                self.forces = reconstruct(found, self.calibration, **wanted.options())
            except InputError as problem:
                self.failures["force"] = str(problem)

    def _score(
        self, truth: Truth, motion: Motion, patches: Rectangles, estimate: Estimate | None
    ) -> dict[str, Any]:
        """Return ``score.json``'s errors by stage."""
        from twin.judge.score import field_score, score, tracking_score

        # Errors of the truth itself: displacement, contact, linear theory.
        state = self.state
        moved = np.linalg.norm(truth.marker_displacement_mm, axis=1)
        pressed, reasons = _press_error(state)
        strained, unknown = _linearity(motion, state)
        elastic = {
            "displacement_error": motion.error,
            "largest_displacement_mm": float(moved.max()) if len(moved) else None,
            "contact_residual": state.residual if state is not None else None,
            **_creep_error(state),
            **pressed,
            **strained,
            "reasons": reasons | unknown,
        }
        # Errors of what the software made of the pictures.
        tracking = force = None
        if estimate is not None:
            tracking = tracking_score(
                estimate.marker_shift_px,
                truth.marker_outline_pressed_px - truth.marker_outline_rest_px,
                truth.marker_visible,
                bound_px=noise_bound(self.sensor.nominal),
            )
        if estimate is not None and len(estimate.site_mm):
            frames = self.calibration.site_frames if self.calibration is not None else None
            force = field_score(estimate, patches, frames)
        found = score(elastic=elastic, tracking=tracking, force=force)
        found["reasons"] |= self.failures
        return found

    def _facts(self, truth: Truth, score: Mapping[str, Any]) -> dict[str, Any]:
        """Return the facts that the report shows with the score."""
        scene = self.sensor.nominal
        state = self.state
        pictured = "picture" in self.needed
        facts: dict[str, Any] = {"seed": scene.seed, "shared": _shared_by_truth_and_estimate(scene)}
        warned = doubts(scene)
        if pictured and (state is not None or scene.tractions):
            shift = truth.marker_pressed_px - truth.marker_rest_px
            warned += unseen(scene, shift, _noise_px(scene, score))
        if doubt := tracking_doubt(score.get("tracking")):
            warned.append(doubt)
        if warned:
            facts["warnings"] = warned
        if state is not None:
            facts |= _press_facts(state) | _course(scene, state)
        if self.calibration is not None and self.forces is not None:
            sites = len(self.calibration.site_mm)
            facts["calibration"] = {"method": scene.calibration.method, "sites": sites}
            facts["weight"] = self.forces.weight
        if pictured:
            facts["renderer"] = self.sensor.renderer.drawn_by
            if self.sensor.saturation is not None:
                facts["picture_warnings"] = [self.sensor.saturation]
        return facts


def _estimate(found: Found | None, forces: Field | None) -> Estimate | None:
    if found is None:
        return None
    none = np.zeros(0)
    nothing = np.zeros((0, 3))
    return Estimate(
        marker_rest_px=found.rest_px,
        marker_shift_px=found.shift_px,
        site_mm=forces.site_mm if forces is not None else nothing,
        force_n=forces.force_n if forces is not None else nothing,
        total_force_n=forces.total_force_n if forces is not None else none,
        total_torque_nmm=forces.total_torque_nmm if forces is not None else none,
    )


def tracking_doubt(tracking: Mapping[str, Any] | None) -> str:
    """Return a warning where few of the unoccluded markers were found; empty otherwise."""
    if not tracking or not tracking["markers"] or tracking["matched"] >= FEW:
        return ""
    found = round(tracking["matched"] * tracking["markers"])
    return (
        f"only {found} of the {tracking['markers']} markers in full sight were found in the "
        "pressed picture: the forces rest on these alone. Press less, or look at exposure and "
        "contrast in rest.png and pressed.png"
    )


def _noise_px(scene: Scene, score: Mapping[str, Any]) -> float | None:
    """Return the noise of a marker's shift, px: by closed form, else as measured."""
    bound = noise_bound(scene)
    if bound is not None and np.isfinite(bound).any():
        return float(np.median(bound[np.isfinite(bound)]))
    return (score.get("tracking") or {}).get("sd_px")


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


def _course(scene: Scene, state: ContactState) -> dict[str, Any]:
    """Return force and indentation at the end of every step, where steps take time."""
    if scene.press is None or not any(step.seconds for step in scene.press.path):
        return {}
    times = accumulate(step.seconds for step in scene.press.path)
    rows = [(0.0, 0.0, 0.0, 0.0, 0.0)]
    rows += [
        (time_s, *one.force_n.tolist(), one.indentation_mm)
        for time_s, one in zip(times, state.path, strict=False)
    ]
    time_s, x, y, z, depth = zip(*rows, strict=True)
    course = {"time_s": time_s, "x_n": x, "y_n": y, "z_n": z, "indentation_mm": depth}
    return {"course": course}


def _press_error(state: ContactState | None) -> tuple[dict[str, Any], dict[str, str]]:
    """Return a press's errors of all causes, and the reasons of those that are unknown."""
    error = state.error if state is not None else None
    names = ("force", "indentation", "traction", "markers")
    figures = {f"{name}_error": getattr(error, name, None) for name in names}
    why = "nothing is pressed" if error is None else "the press doesn't settle on other patches"
    unknown = {
        name: why for name, value in figures.items() if value is None or not math.isfinite(value)
    }
    return figures | dict.fromkeys(unknown), unknown


def _creep_error(state: ContactState | None) -> dict[str, Any]:
    """Return how far a total force is off that takes the motion of relaxing rubber for elastic."""
    if state is None or state.load.crept is None or not state.load.terms:
        return {}
    true, elastic = (
        sum(term.force_n.sum(axis=0) for term in load.terms if isinstance(term, Rectangles))
        for load in (state.load, state.load.crept)
    )
    return {"creep_error": float(np.linalg.norm(elastic - true) / np.linalg.norm(true))}


def _linearity(motion: Motion, state: ContactState | None) -> tuple[dict[str, Any], dict[str, str]]:
    """Return strain, turn and the error of linear theory, and the reasons of what is unknown."""
    names = ("contact_over_probe_radius", "linearisation_error")
    figures = {name: getattr(state.validity, name) if state else None for name in names}
    why = "the probe is flat" if state else "nothing is pressed"
    reasons = {name: why for name, value in figures.items() if value is None}
    strain, turn = largest_strain_and_turn(motion.gradient)
    return {"largest_strain": strain, "largest_turn_deg": turn, **figures}, reasons


def _touches(scene: Scene, state: ContactState | None) -> tuple[Touch, ...]:
    """Return the contact under each probe that touches the body."""
    if state is None or scene.press is None:
        return ()
    terms = iter(state.load.terms)
    found = []
    for press, own in zip((scene.press, *scene.press.also), (state, *state.also), strict=True):
        if not len(own.pressure_mpa):
            continue
        patches = next(terms)
        assert isinstance(patches, Rectangles)
        # A plane through the middle of the contact, with the local normal; its own frame for the
        # drawing.
        middle = np.average(patches.centre_mm, axis=0, weights=own.pressure_mpa)
        inward = patches.frames[np.argmin(np.linalg.norm(patches.centre_mm - middle, axis=1)), 2]
        axes = frame_of(tuple(inward))
        push_n = float(patches.total_force_n @ inward)
        expected, name = _closed_form(scene, press, own, push_n)
        found.append(
            Touch(
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


def summary(result: RunResult, folder: Path) -> str:
    """Return the text that is printed for a run whose files are in ``folder``."""
    lines = []
    score = result.score or {}
    facts = result.facts
    if (contact := facts.get("contact")) is not None:
        lines.append(
            f"contact     {contact['force_n'][2]:.4g} N along z, indentation "
            f"{contact['indentation_mm']:.3g} mm"
        )
    validity = facts.get("validity", {})
    warned = (*validity.get("warnings", ()), *facts.get("warnings", ()))
    lines += [f"warning     {warning}" for warning in warned]
    lines += [f"note        {note}" for note in validity.get("notes", ())]
    if "renderer" in facts:
        lines.append(f"renderer    {facts['renderer']}")
    tracking, force = score.get("tracking"), score.get("force")
    if "tracking" in result.timings:
        for stage in ("tracking", "force"):
            if score.get(stage) is None and stage in score.get("reasons", {}):
                lines.append(f"{stage:11s} failed: {score['reasons'][stage]}")
    if tracking and tracking.get("matched") is not None:
        sd = tracking.get("sd_px")
        spread = f"SD {sd:.3f} px" if sd is not None else "no SD, too few markers"
        lines.append(f"tracking    {spread}, {100 * tracking['matched']:.1f} % matched")
    if force:
        lines += _force_lines(force, result.estimate)
    long = [f"{stage} {seconds:.1f}" for stage, seconds in result.timings.items() if seconds >= 0.1]
    total = f"time        {sum(result.timings.values()):.1f} s"
    lines += [": ".join(filter(None, (total, ", ".join(long)))), f"written to  {folder}"]
    return "\n".join(lines)


def _force_lines(force: Mapping[str, Any], estimate: Estimate | None) -> list[str]:
    """Return the errors of total force, centre and field that are defined."""
    lines = []
    if force["total_force_error"] is not None:
        lines.append(f"total force {100 * force['total_force_error']:.1f} % off")
        if estimate is not None and len(estimate.force_n):
            sites = estimate.force_n.sum(axis=0)
            total = estimate.total_force_n
            if not np.allclose(sites, total, rtol=1e-6, atol=1e-9):
                lines.append(
                    f"sites' sum  {100 * force['sites_force_error']:.1f} % off: Fz "
                    f"{sites[2]:.4g} N, the total of the unbounded solve {total[2]:.4g} N"
                )
    if force["centre_error_mm"] is not None:
        lines.append(f"centre      {force['centre_error_mm']:.3g} mm off")
    if force["field_error"] is not None:
        lines.append(f"force field {100 * force['field_error']:.0f} % off")
    return lines


def _shared_by_truth_and_estimate(scene: Scene) -> list[str]:
    """Return what the sensor's software knows exactly, as truth and nominal design share it."""
    shared = [
        "shape of the body, and that it is homogeneous"
        + (", linear" if scene.material.law == "linear" else "")
        + (" (but not that it relaxes)" if scene.material.relaxation else "")
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
