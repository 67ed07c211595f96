"""How the nominal camera sees the nominal markers: places, sizes, which lie in the picture and which overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Pixels
from twin.errors import RecipeError
from twin.parts.markers import MarkerSet, place
from twin.parts.scene import Scene
from twin.theory.optics import project_with_jacobian


@dataclass(frozen=True, kw_only=True)
class View:
    """The nominal design, seen.

    Attributes
    ----------
    markers
        All nominal markers.
    pixels
        (n, 2) their places, px.
    jacobian
        (n, 2, 3) px/mm.
    diameter_px
        (n,) their widths.
    inside
        (n,) whether the whole marker lies in the picture.
    hidden
        (n,) whether it overlaps a marker that is nearer to the camera, or another of its layer.
    """

    markers: MarkerSet
    pixels: Pixels
    jacobian: Floats
    diameter_px: Floats
    inside: Bools
    hidden: Bools

    @property
    def usable(self) -> Bools:
        """(n,) markers that a tracker can measure."""
        return np.asarray(self.inside & ~self.hidden)


def view_of(scene: Scene) -> View:
    """Return how a scene's nominal camera sees its markers.

    Raises
    ------
    RecipeError
        There is no camera, or a marker lies outside the body.
    """
    from scipy.spatial import cKDTree

    if scene.camera is None:
        raise RecipeError("this scene has no [camera] table: designs are seen by a camera")
    camera = scene.camera
    markers = place(scene.body, scene.markers)
    pixels, jacobian = project_with_jacobian(
        markers.points, camera, scene.material.refractive_index, scene.body.base_z_mm
    )
    across = np.sqrt(np.abs(np.linalg.det(jacobian[:, :, :2])))
    width = np.array([scene.markers[str(name)].diameter_mm for name in markers.layer]) * across
    half = width[:, None] / 2
    with np.errstate(invalid="ignore"):
        inside = ((pixels - half > -0.5) & (pixels + half < (camera.width_px - 0.5, camera.height_px - 0.5))).all(
            axis=1
        )
    inside &= np.isfinite(jacobian).all(axis=(1, 2))
    hidden = np.zeros(len(markers), bool)
    known = np.flatnonzero(inside)
    if len(known) > 1:
        pairs = cKDTree(pixels[known]).query_pairs(float(width[known].max()), output_type="ndarray")
        a, b = known[pairs[:, 0]], known[pairs[:, 1]]
        near = np.linalg.norm(pixels[a] - pixels[b], axis=1) < (width[a] + width[b]) / 2
        a, b = a[near], b[near]
        behind = np.where(markers.points[a, 2] < markers.points[b, 2], a, b)
        hidden[behind] = True
    return View(markers=markers, pixels=pixels, jacobian=jacobian, diameter_px=width, inside=inside, hidden=hidden)
