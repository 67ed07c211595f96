"""The deformed cover as background: how much brighter or darker its bulge makes it.

A press tilts the black cover and moves it towards the camera, so that it takes other light. Both are smooth, so they
are computed on a coarse grid of rays and laid over the picture of the cover at rest. LEDs all around the lens, as in
the shipped scenes, make up for each other: there a bulge changes even a grey cover by a count or less.

Validity: first order in the displacement; detail finer than the grid, at the rim of a contact, is smoothed; the cover
takes no shadows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points, Singles
from twin.parts.scene import Scene
from twin.theory.optics import rays
from twin.world.picture.lighting import cover_brightness, cover_places
from twin.world.picture.view import stretch

STEP_PX = 16
"""Between the rays of the grid."""


@dataclass(frozen=True, kw_only=True)
class CoverMotion:
    """How the places of a `Background` move.

    Attributes
    ----------
    displacement_mm
        (m, 3) displacements, mm.
    gradient
        (m, 3, 3) displacement gradients du_i/dx_j.
    """

    displacement_mm: Points
    gradient: Floats


class Background:
    """The places of the cover that a coarse grid of rays meets.

    Parameters
    ----------
    scene
        With camera, light and cover.
    top
        The irradiance that counts as 1.
    """

    def __init__(self, scene: Scene, top: float) -> None:
        assert scene.camera is not None
        camera, self._scene, self._top = scene.camera, scene, top
        self._size = (camera.height_px, camera.width_px)
        self._columns, self._rows = (
            np.linspace(0, size - 1, max(size // STEP_PX, 1) + 1) if size > 1 else np.zeros(1)
            for size in (camera.width_px, camera.height_px)
        )
        nodes = np.stack(np.meshgrid(self._columns, self._rows), axis=-1).reshape(-1, 2)
        origins, directions = rays(nodes, camera, scene.material.refractive_index, scene.body.base_z_mm)
        points, normals = cover_places(origins, directions, scene)
        self._met = np.isfinite(points[:, 0])
        self._along, self._normals = directions[self._met], normals[self._met]
        self.points: Points = points[self._met]
        """(m, 3) places on the cover's inner side at rest, mm."""

    def change(self, motion: CoverMotion) -> Singles:
        """Return (height, width) factors on the light of the cover at rest.

        Notes
        -----
        A ray meets the moved surface where it has come (u . n) / (d . n) farther along its direction d. The normal of
        a deformed surface is F^-T n, F = I + du/dx.
        """
        ahead = np.einsum("ni,ni->n", motion.displacement_mm, self._normals)
        ahead = ahead / np.einsum("ni,ni->n", self._along, self._normals)
        moved = self.points + self._along * ahead[:, None]
        deformed = np.swapaxes(np.eye(3) + motion.gradient, 1, 2)
        turned = np.asarray(np.linalg.solve(deformed, self._normals[:, :, None])[:, :, 0], np.float64)
        normals = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        before = cover_brightness(self.points, self._normals, self._scene, self._top)
        after = cover_brightness(moved, normals, self._scene, self._top)
        factor = np.ones(len(self._met))
        factor[self._met] = after / np.maximum(before, 1e-12)
        grid = factor.reshape(len(self._rows), len(self._columns))
        smooth = stretch(self._rows, self._size[0]) @ grid @ stretch(self._columns, self._size[1]).T
        return smooth.astype(np.float32)
