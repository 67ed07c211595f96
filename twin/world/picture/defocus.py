"""A wide pupil: the mean of pictures through points of it, each shifted so that they agree where the lens is focused.

Every point of the pupil sees the body through its own refracted rays, so that blur grows with the distance from the
focus, and occlusion and shadows stay right, without a formula for either. The blur of a point is a disc of diameter
aperture times (px per mm there) times |depth - focus depth| over the focus depth, depths as they appear in air.

Validity: the points stay single up to blur discs of some 5 px (markers' edges are wider than the steps between points);
the shift that agrees at the focus is taken on the axis, which is exact for a pinhole lens that looks along z.
"""

from __future__ import annotations

import numpy as np

from twin.errors import RecipeError
from twin.parts.camera import Camera
from twin.parts.scene import Scene
from twin.theory.optics import project

PUPIL_WEIGHTS = np.concatenate([[0.25], np.full(6, 0.125)])
"""Weights of the pupil's points: a rule exact for polynomials of degree 5 on a disc (Stroud S2 5-1)."""


def through_the_pupil(scene: Scene) -> list[Camera]:
    """Return cameras of no aperture at points of the scene's pupil, in the order of `PUPIL_WEIGHTS`; none if it is one.

    Notes
    -----
    The seven points are the middle and a hexagon at sqrt(2/3) of the radius.

    Raises
    ------
    RecipeError
        The lens is focused on what it can't see.
    """
    camera = scene.camera
    if camera is None or camera.aperture_mm == 0:
        return []
    around = np.arange(6) * np.pi / 3
    ring = np.sqrt(2 / 3) * np.column_stack([np.cos(around), np.sin(around)])
    points = camera.aperture_mm / 2 * np.concatenate([np.zeros((1, 2)), ring])
    focus = np.array([[camera.pupil_mm[0], camera.pupil_mm[1], camera.focus_z_mm]])
    optics = (scene.material.refractive_index, scene.body.base_z_mm)
    sharp = camera.model_copy(update={"aperture_mm": 0.0})
    if not camera.focus_z_mm < camera.pupil_mm[2]:
        raise RecipeError(
            f"camera.focus_z_mm = {camera.focus_z_mm:g} mm: what the lens shows sharply must lie in front of it (below "
            f"camera.pupil_mm's z = {camera.pupil_mm[2]:g} mm); move it, or set aperture_mm = 0"
        )
    here = project(focus, sharp, *optics)[0]
    if not np.isfinite(here).all():
        raise RecipeError(
            "camera.tilt_deg: the lens doesn't see the place below its pupil where it is focused "
            f"(z = {camera.focus_z_mm:g} mm); turn it there, or set aperture_mm = 0"
        )
    found = []
    for x, y in points.tolist():
        pupil = (camera.pupil_mm[0] + x, camera.pupil_mm[1] + y, camera.pupil_mm[2])
        moved = sharp.model_copy(update={"pupil_mm": pupil})
        column, row = np.asarray(camera.centre_px) + here - project(focus, moved, *optics)[0]
        found.append(moved.model_copy(update={"principal_px": (float(column), float(row))}))
    return found
