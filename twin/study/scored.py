"""What is said of a run: the error of every stage, and the facts that belong beside the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.results import Estimate, Truth
from twin.study.actual import shared_by_truth_and_estimate
from twin.study.motion import Motion
from twin.study.sensor import Sensor

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration
    from twin.sense.reconstruct import Field
    from twin.world.contact.contact import ContactState


def score_of(
    sensor: Sensor,
    truth: Truth,
    motion: Motion,
    estimate: Estimate | None,
    state: ContactState | None,
    frames: Floats | None,
    failures: Mapping[str, str],
) -> dict[str, Any]:
    """Return ``score.json``'s errors by stage.

    Parameters
    ----------
    sensor, truth, motion, estimate, state
        What was run, what happened, and what was made of it; None where a stage was not.
    frames
        (k, 3, 3) the sites' axes, where forces were recovered.
    failures
        Why a stage has no result, by its name.
    """
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
        bound = _bound_px(sensor)
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
    result["reasons"] |= failures
    return result


def facts_of(
    sensor: Sensor, state: ContactState | None, calibration: Calibration | None, forces: Field | None, pictured: bool
) -> dict[str, Any]:
    """Return what the report tells beside the numbers; ``pictured``: whether the scene was filmed."""
    scene = sensor.nominal
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
    if pictured:
        variant = sensor.renderer.variant
        facts["renderer"] = f"{variant.name}: {variant.reason}"
    return facts


def _bound_px(sensor: Sensor) -> Floats | None:
    """Return (n,) what the pictures' noise allows at best, px; None where no closed form knows the camera."""
    from twin.study.sweep.noise import can_tell, shift_bound
    from twin.study.sweep.view import view_of

    scene = sensor.nominal
    if scene.camera is None or not can_tell(scene) or not scene.ccd.spelt_out().noise:
        return None
    view = view_of(scene)
    bound = np.full(len(view.markers), np.nan)
    for name in scene.markers:
        rows = view.markers.layer == name
        bound[rows] = shift_bound(scene, name, np.nan_to_num(view.diameter_px[rows]))
    return np.where(np.isfinite(view.diameter_px), bound, np.nan)


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
