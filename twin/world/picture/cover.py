"""The cover behind the markers: its light at rest, and how a press changes it.

A press tilts the black cover and moves it towards the camera, so that it takes other light. Both
are smooth, so they are computed on a coarse grid of rays and multiply the picture of the cover at
rest. Where LEDs stand all around the lens, a bulge changes even a grey cover by a count or less.

Validity: the change is first order in the displacement; detail finer than the grid, at the rim of a
contact, is smoothed; the cover takes no shadows, as it is nearly black.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Ints, Points, Singles
from twin.parts.scene import Scene
from twin.theory.optics import rays
from twin.world.picture.lamps import Lamps

_STEP_PX = 16
"""Distance between the rays of the grid."""


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

    def turned(self, normals: Floats) -> Floats:
        """Return (m, 3) unit normals of the deformed surface, F^-T n with F = I + du/dx."""
        deformed = np.swapaxes(np.eye(3) + self.gradient, 1, 2)
        moved = np.asarray(np.linalg.solve(deformed, normals[:, :, None])[:, :, 0], np.float64)
        unit: Floats = moved / np.linalg.norm(moved, axis=1, keepdims=True)
        return unit


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
        camera, _ = scene.imaging
        self._scene, self._top = scene, top
        self._size = (camera.height_px, camera.width_px)
        self._columns, self._rows = (
            np.linspace(-0.5, size - 0.5, max(size // _STEP_PX, 1) + 1)
            for size in (camera.width_px, camera.height_px)
        )
        nodes = np.stack(np.meshgrid(self._columns, self._rows), axis=-1).reshape(-1, 2)
        origins, directions = rays(nodes, *scene.optics)
        points, normals = _cover_places(origins, directions, scene)
        self._met = np.isfinite(points[:, 0])
        self._along = directions[self._met]
        self.normals: Floats = normals[self._met]
        """(m, 3) inward normals there."""
        self.points: Points = points[self._met]
        """(m, 3) places on the cover's inner side at rest, mm."""

    @property
    def triangles(self) -> Ints:
        """(k, 3) numbers of the places that make up triangles between the grid's rays."""
        number = np.where(self._met, np.cumsum(self._met) - 1, -1)
        grid = number.reshape(len(self._rows), len(self._columns))
        here, right = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel()
        below, both = grid[1:, :-1].ravel(), grid[1:, 1:].ravel()
        halves = [np.column_stack([here, below, right]), np.column_stack([right, below, both])]
        triangles = np.concatenate(halves)
        return triangles[(triangles >= 0).all(axis=1)]

    def change(self, motion: CoverMotion) -> Singles:
        """Return (height, width, k) factors on the light of the cover at rest, k of `Light.tints`.

        Notes
        -----
        A ray meets the moved surface where it has come (u . n) / (d . n) farther along its
        direction d.
        """
        ahead = np.einsum("ni,ni->n", motion.displacement_mm, self.normals)
        ahead = ahead / np.einsum("ni,ni->n", self._along, self.normals)
        moved = self.points + self._along * ahead[:, None]
        normals = motion.turned(self.normals)
        before = _brightness(self.points, self.normals, self._scene, self._top)
        after = _brightness(moved, normals, self._scene, self._top)
        factor = np.ones((after.shape[1], len(self._met)))
        factor[:, self._met] = (after / np.maximum(before, 1e-12)).T
        grid = factor.reshape(-1, len(self._rows), len(self._columns))
        smooth = stretch(self._rows, self._size[0]) @ grid @ stretch(self._columns, self._size[1]).T
        return np.moveaxis(smooth, 0, 2).astype(np.float32)


def cover_light(origins: Points, directions: Floats, scene: Scene, top: float) -> Floats:
    """Return (n, 3) light from the cover along rays inside the body; 0 where a ray leaves the body
    or there is none.

    Parameters
    ----------
    origins, directions
        (n, 3) rays from the base plane, mm; NaN rays see nothing.
    scene
        With camera and light.
    top
        The irradiance that counts as 1, of `twin.world.picture.lamps.Lamps.brightest`.
    """
    light = np.zeros((len(origins), 3))
    if scene.cover is not None:
        points, normals = _cover_places(origins, directions, scene)
        seen = np.isfinite(points[:, 0])
        bright = _brightness(points[seen], normals[seen], scene, top)
        light[seen] = bright * np.asarray(scene.cover.albedo)
    return light


def stretch(nodes: Floats, size: int) -> Floats:
    """Return the (size, nodes) matrix of linear interpolation from nodes to pixels."""
    return np.stack(
        [np.interp(np.arange(size), nodes, column) for column in np.eye(len(nodes))], axis=1
    )


def _cover_places(origins: Points, directions: Floats, scene: Scene) -> tuple[Points, Floats]:
    """Return (n, 3) places where rays inside the body meet the cover at rest, mm, and its inward
    normals; NaN for none.

    The cover's inner side is a level set of the depth, an exact distance: rays march by it.
    """
    assert scene.cover is not None
    points, normals = np.full((len(origins), 3), np.nan), np.full((len(origins), 3), np.nan)
    seen = np.flatnonzero(
        np.isfinite(origins).all(axis=1) & scene.body.contains(np.nan_to_num(origins), -1e-6)
    )
    start, along = origins[seen], directions[seen]
    distance = np.zeros(len(start))
    gap = np.zeros(len(start))
    for _ in range(80):
        gap = scene.body.depth(start + along * distance[:, None]) - scene.cover.thickness_mm
        distance += gap
        if not np.any(np.abs(gap) > 1e-4):
            break
    places = start + along * distance[:, None]
    hits = (scene.body.piece_distances(places)[:, 1:] > -1e-3).all(axis=1) & (np.abs(gap) < 1e-2)
    points[seen[hits]] = places[hits]
    normals[seen[hits]] = scene.body.piece_normals(places[hits])[:, 0]
    return points, normals


def _brightness(points: Points, normals: Floats, scene: Scene, top: float) -> Floats:
    """Return (n, k) light that white places of the cover send back, a share of even light
    included."""
    _, light = scene.imaging
    tints, even = light.tints()
    lamps = Lamps.at(points, scene)
    direct = [lamps.times(tint).irradiance(points, normals) / top for tint in tints]
    bright: Floats = (1 - light.ambient) * np.column_stack(direct) + light.ambient * even
    return bright
