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
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, InputError, RecipeError, SomeFailed
from twin.parts.scene import Scene
from twin.results import Estimate, RunResult, Truth, make_folder, refuse_others_files, remove_results, write_whole
from twin.study.actual import shared_by_truth_and_estimate
from twin.study.recipe import dump_scene
from twin.study.sensor import Motion, Progress, Sensor
from twin.study.touch import touches

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.sense.calibration import Calibration
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
    return _only_wanted(_run(scene, asked, by_name=want is not None, progress=progress), asked)


def _run(
    scene: Scene, asked: frozenset[str], *, by_name: bool, progress: Progress | None, keep_last: bool = False
) -> RunResult:
    """Return everything that had to be computed for what was asked."""
    if unknown := sorted(asked - WANTED):
        raise RecipeError(f"want: unknown {', '.join(unknown)}; allowed are {', '.join(sorted(WANTED))}")
    return _Chain(Sensor(scene, progress), _needed(scene, asked, by_name=by_name), progress, keep_last).go()


def run_to_folder(scene: Scene, folder: Path, want: Collection[str], progress: Progress | None = None) -> str:
    """Run a scene, write its files into ``folder`` and return a summary of a few lines.

    Where a step of the press after the first is refused or does not converge, the files are those of the state before
    it, `SomeFailed` says so, and so do their facts.
    """
    make_folder(folder)
    refuse_others_files(folder)
    asked = frozenset(want)
    result = _run(scene, asked, by_name=asked != WANTED, keep_last=True, progress=progress)
    page = ""
    if "report" in want:
        from twin.show.report import report

        started = time.perf_counter()
        page = report(result)
        result = replace(result, timings={**result.timings, "report": time.perf_counter() - started})
    remove_results(folder)
    _only_wanted(result, asked).write(folder)
    if page:
        write_whole(folder / "report.html", lambda f: f.write(page.encode()))
    if progress is not None:
        progress("done", 1.0)
    if (reason := result.facts.get("contact", {}).get("incomplete")) is not None:
        raise SomeFailed(f"press: {reason}; what belongs to that state is in {folder}")
    return _summary(result, folder)


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
            score = self._score(truth, motion, estimate, state, frames)
        return RunResult(
            scene_toml=dump_scene(scene),
            truth=truth,
            estimate=estimate,
            rest=rest,
            pressed=pressed,
            score=score,
            touches=touches(scene, scene.press, state) if scene.press is not None and state is not None else (),
            facts=self._facts(state, calibration, forces),
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

    def _score(
        self,
        truth: Truth,
        motion: Motion,
        estimate: Estimate | None,
        state: ContactState | None,
        frames: Floats | None,
    ) -> dict[str, Any]:
        from twin.judge.score import force_score, score, tracking_score

        moved = np.linalg.norm(truth.marker_displacement_mm, axis=1)
        elastic = {
            "displacement_error": motion.error,
            "largest_displacement_mm": float(moved.max()) if len(moved) else None,
            "contact_residual": state.residual if state is not None else None,
            **_linearity(motion, state),
        }
        tracking = force = None
        if estimate is not None:
            true_shift = truth.marker_outline_pressed_px - truth.marker_outline_rest_px
            bound = self._bound_px()
            tracking = tracking_score(estimate.marker_shift_px, true_shift, truth.marker_visible, bound_px=bound)
        if estimate is not None and len(estimate.site_mm):
            force = force_score(
                site_mm=estimate.site_mm,
                force_n=estimate.force_n,
                total_force_n=estimate.total_force_n,
                total_torque_nmm=estimate.total_torque_nmm,
                surface_mm=truth.surface_mm,
                surface_force_n=truth.surface_force_n,
                true_force_n=truth.total_force_n,
                true_torque_nmm=truth.total_torque_nmm,
                frames=frames,
            )
        result = score(elastic=elastic, tracking=tracking, force=force)
        result["reasons"] |= self.failures
        return result

    def _bound_px(self) -> Floats | None:
        """Return (n,) what the pictures' noise allows at best, px; None where no closed form knows the camera."""
        from twin.study.sweep.noise import can_tell, shift_bound
        from twin.study.sweep.view import view_of

        scene = self.sensor.nominal
        if scene.camera is None or not can_tell(scene) or not scene.ccd.spelt_out().noise:
            return None
        view = view_of(scene)
        bound = np.full(len(view.markers), np.nan)
        for name in scene.markers:
            rows = view.markers.layer == name
            bound[rows] = shift_bound(scene, name, np.nan_to_num(view.diameter_px[rows]))
        return np.where(np.isfinite(view.diameter_px), bound, np.nan)

    def _facts(
        self, state: ContactState | None, calibration: Calibration | None, forces: Field | None
    ) -> dict[str, Any]:
        scene = self.sensor.nominal
        facts: dict[str, Any] = {"seed": scene.seed, "shared": shared_by_truth_and_estimate(scene)}
        if state is not None:
            facts["contact"] = {
                "force_n": state.force_n,
                "torque_nmm": state.torque_nmm,
                "indentation_mm": state.indentation_mm,
                "contact_radius_mm": state.contact_radius_mm,
                "area_mm2": state.area_mm2,
                "peak_pressure_mpa": state.peak_pressure_mpa,
                "elastic_nmm": state.elastic_nmm,
                "dissipated_nmm": state.dissipated_nmm,
            }
            if state.error is not None:
                facts["contact"]["patch_error"] = asdict(state.error)
            if not state.complete:
                facts["contact"]["incomplete"] = state.reason
            if state.also:
                facts["further_probes"] = [
                    {"force_n": other.force_n, "torque_nmm": other.torque_nmm, "indentation_mm": other.indentation_mm}
                    for other in state.also
                ]
            facts["validity"] = _validity(state)
        if calibration is not None and forces is not None:
            facts["calibration"] = {"method": scene.calibration.method, "sites": len(calibration.site_mm)}
            facts["weight"] = forces.weight
        if "picture" in self.needed:
            variant = self.sensor.renderer.variant
            facts["renderer"] = f"{variant.name}: {variant.reason}"
        return facts


def _validity(state: ContactState) -> dict[str, Any]:
    """Return the first probe's validity with every probe's warnings."""
    warned = [warning for one in (state, *state.also) for warning in one.validity.warnings]
    incomplete = [f"the press is not complete: {state.reason}"] if not state.complete else []
    return asdict(state.validity) | {"warnings": (*incomplete, *dict.fromkeys(warned))}


def _linearity(motion: Motion, state: ContactState | None) -> dict[str, Any]:
    """Return how far the load strains linear theory, and what that is expected to cost."""
    from twin.theory.linearity import largest_strain_and_turn

    strain, turn = largest_strain_and_turn(motion.gradient)
    figures: dict[str, Any] = {"largest_strain": strain, "largest_turn_deg": turn}
    if state is None:
        unknown = ("contact_over_probe_radius", "linearisation_error")
        return figures | dict.fromkeys(unknown) | {"reasons": dict.fromkeys(unknown, "nothing is pressed")}
    ratio = state.validity.contact_over_probe_radius
    figures |= {"contact_over_probe_radius": ratio, "linearisation_error": state.validity.linearisation_error}
    return figures | {"reasons": {"contact_over_probe_radius": "the probe is flat"} if ratio is None else {}}


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


def _only_wanted(result: RunResult, asked: frozenset[str]) -> RunResult:
    """Drop what was only needed on the way."""
    return replace(
        result,
        truth=result.truth if "displacement" in asked else None,
        rest=result.rest if "picture" in asked else None,
        pressed=result.pressed if "picture" in asked else None,
        estimate=result.estimate if asked & {"tracking", "forces"} else None,
        score=result.score if "score" in asked else None,
    )


def _summary(result: RunResult, folder: Path) -> str:
    lines = []
    score = result.score or {}
    contact = result.facts.get("contact")
    if contact is not None:
        lines.append(
            f"contact     {contact['force_n'][2]:.4g} N along z, indentation {contact['indentation_mm']:.3g} mm"
        )
    lines += [f"warning     {doubt}" for doubt in result.facts.get("validity", {}).get("warnings", ())]
    if "renderer" in result.facts:
        lines.append(f"renderer    {result.facts['renderer']}")
    tracking, force = score.get("tracking"), score.get("force")
    for stage in ("tracking", "force"):
        if score.get(stage) is None and "tracking" in result.timings and stage in score.get("reasons", {}):
            lines.append(f"{stage:11s} failed: {score['reasons'][stage]}")
    if tracking and tracking.get("sd_px") is not None:
        lines.append(f"tracking    SD {tracking['sd_px']:.3f} px, {100 * tracking['matched']:.1f} % matched")
    if force and force.get("total_force_error") is not None:
        lines.append(f"total force {100 * force['total_force_error']:.1f} % off")
    lines.append(f"time        {sum(result.timings.values()):.1f} s")
    lines.append(f"written to  {folder}")
    return "\n".join(lines)
