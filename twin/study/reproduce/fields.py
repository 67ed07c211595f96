"""From a tracked picture to a force field on the bench, and what is read off a field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.arrays import Floats, Points
from twin.judge.resolution import full_width as full_width
from twin.judge.score import force_score, into_cells
from twin.parts.load import Load
from twin.parts.methods import Method
from twin.sense.calibration import Calibration
from twin.sense.reconstruct import Field, reconstruct
from twin.sense.track import Found
from twin.show.panels import FieldPanel
from twin.study.calibrate import half_space_compliance
from twin.study.motion import Motion
from twin.study.reproduce.bench import Bench, Rig
from twin.theory.optics import projection_jacobian
from twin.world.contact.contact import ContactState

NO_NOISE = "noise off"
PAPERS_TRACKER = "tracker: the paper's instead of this project's"
OUR_TRACKER_INSTEAD = "tracker: this project's instead of the paper's"
TOO = ", in the calibration too"
NO_NOISE_AT_ALL = "noise of the picture off" + TOO
OURS_AT_ALL = OUR_TRACKER_INSTEAD + TOO
SMOOTH = "inverse: smooth instead of the pseudo-inverse"
NO_LENS = "lens: seen from far away"
NO_BLOCK = "finite block: a half-space is filmed instead"
TOLD_OF_BLOCK = "finite block: the sensor is told of the real block instead of a half-space"
"""Causes, in the words of the page."""

FAR = 50.0
"""Times the distance at which a lens sees almost in parallel."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A press, and what the tracker made of its picture."""

    rig: Rig
    state: ContactState
    found: Found


def calibration(bench: Bench, rig: Rig, method: str | None = None) -> Calibration:
    """Return a sensor's calibration by another method than its scene's; ``no camera`` leaves the motion along z out."""
    if method is None or method == rig.scene.calibration.method:
        return rig.calibration
    if method == "no camera":
        return bench.once(("no camera", id(rig.calibration)), lambda: _without_depth(rig))
    paper = "kamiyama" if rig.scene.calibration.method == "halfspace" else "sato"
    return bench.rig(paper, rig.scene.seed, {"calibration.method": method}).calibration


def _without_depth(rig: Rig) -> Calibration:
    """Return the half-space calibration whose camera doesn't see motion along z (before Kamiyama's section 2.5)."""
    from twin.sense.transfer import from_compliance

    scene, points = rig.scene, rig.sensor.nominal_markers.points
    assert scene.camera is not None
    jacobian = projection_jacobian(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    flat = jacobian * (1.0, 1.0, 0.0)
    compliance = half_space_compliance(scene, points, rig.sensor.sites)
    return replace(rig.calibration, transfer=from_compliance(compliance, flat))


def far_away(rig: Rig) -> dict[str, Any]:
    """Return overrides of a camera that sees almost in parallel, at the same scale; its tilt moves the view as much."""
    camera, body = rig.scene.camera, rig.scene.body
    assert camera is not None
    x, y, z = camera.pupil_mm
    away = FAR * (z - body.base_z_mm)
    return {
        "camera.pupil_mm": [x, y, body.base_z_mm + away],
        "tolerance.tilt_deg": rig.scene.tolerance.tilt_deg / FAR,
        "camera.focal_px": camera.focal_px * (away + body.base_z_mm) / z,
    }


def half_space_motion(rig: Rig, load: Load) -> Motion:
    """Return how a load would move the actual markers, were the block a half-space: the papers' formula as the world.

    The markers are beads, so that their strain isn't needed.
    """
    points, pieces = rig.sensor.actual.markers.points, rig.sensor.rectangles(load)
    moved = half_space_compliance(rig.sensor.actual.scene, points, pieces) @ pieces.force_n.ravel()
    return Motion(displacement_mm=moved.reshape(-1, 3), gradient=np.zeros((len(points), 3, 3)), error=0.0)


def solved(found: Found, how: Calibration, method: Method, options: Mapping[str, Any] | None = None) -> Field:
    """Reconstruct with an automatic weight (the papers give none)."""
    return reconstruct(found, how, method=method, **(options or {}))


def true_field(rig: Rig, state: ContactState, site_mm: Points) -> Floats:
    """Return (k, 3) the press's forces summed into the sites' cells, N."""
    pieces = rig.sensor.rectangles(state.load)
    return into_cells(site_mm, pieces.centre_mm, pieces.force_n)


def scored(rig: Rig, state: ContactState, field: Field) -> dict[str, Any]:
    """Return the judge's score of a field."""
    pieces = rig.sensor.rectangles(state.load)
    return force_score(
        site_mm=field.site_mm, force_n=field.force_n, total_force_n=field.total_force_n,
        total_torque_nmm=field.total_torque_nmm, surface_mm=pieces.centre_mm, surface_force_n=pieces.force_n,
        true_force_n=pieces.force_n.sum(axis=0), true_torque_nmm=np.cross(pieces.centre_mm, pieces.force_n).sum(axis=0),
    )  # fmt: skip


def strongest_mm(field: Field) -> Floats:
    """Return (x, y) of the site with the largest force, mm."""
    return np.asarray(field.site_mm[np.argmax(np.linalg.norm(field.force_n, axis=1)), :2])


def profile(field: Field, half_band_mm: float) -> tuple[Floats, Floats]:
    """Return x, mm, and the force along z by column of sites, N, added over the rows within ``half_band_mm`` of "
    "y = 0."""
    x = np.unique(field.site_mm[:, 0].round(6))
    band = np.abs(field.site_mm[:, 1]) <= half_band_mm
    push = [float(field.force_n[band & (np.abs(field.site_mm[:, 0] - at) < 1e-3), 2].sum()) for at in x]
    return x, np.array(push)


def field_panel(title: str, field: Field, outline_mm: Floats | None, side_mm: float) -> FieldPanel:
    """Return the drawing of a field."""
    return FieldPanel(title=title, site_mm=field.site_mm, force_n=field.force_n, side_mm=side_mm, outline_mm=outline_mm)


def circle_mm(radius_mm: float, at_mm: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return (m, 2) points of a circle, mm."""
    turn = np.linspace(0.0, 2.0 * np.pi, 60)
    return np.column_stack([at_mm[0] + radius_mm * np.cos(turn), at_mm[1] + radius_mm * np.sin(turn)])
