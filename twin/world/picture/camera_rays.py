"""The rays that end in the camera's pixels: directions in the body, what they lose, and glare.

Rays go through pixel corners only: they are smooth, so linear interpolation inside a pixel is off
by less than 1e-3 px even for a fisheye.

Glare is light of the LEDs' discs that base, layers and air mirror straight into the camera, a veil
over markers and cover that depends on nothing that moves. An interface of plastic or rubber and air
sends back 4 % of a disc's brightness, which is more than a lit marker has.

A wide pupil is the mean of pictures through points of it, each shifted so that they agree where the
lens is focused. Each point has its own refracted rays, so occlusion and shadows stay right. The
blur of a point is a disc of diameter aperture times (px per mm there) times |depth - focus depth|
over the focus depth, depths as they appear in air.

Validity: glare by one reflection, of discs whose images are wider than a pixel, LEDs in air; points
of the pupil stay single up to blur discs of some 5 px; the shift that agrees at the focus is taken
on the axis, which is exact for a pinhole lens that looks along z.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Pixels, Singles
from twin.errors import RecipeError
from twin.parts.camera import DISC_POINTS, Camera, Ccd
from twin.parts.load import Load
from twin.parts.scene import Scene
from twin.theory.lens import lens_inverse
from twin.theory.optics import project, rays, reflection, transmission
from twin.world.picture.cover import SeeThrough, cover_light, stretch
from twin.world.picture.lamps import Lamps

_STEPS = 1000
"""The most parts in which a scratch is looked for."""

_COARSE = 4
"""Pixels between the nodes on which the cover's light is computed."""

_AT_ONCE = 400_000
"""Rays computed in one go: memory for a picture of any size stays that of its results."""

_GRAZING = 1e-3
"""Cosine below which an LED looks no brighter."""

_EXPOSED = 0.99
"""Share of the ground's pixels that are no brighter than the level that sets the exposure."""


@dataclass(frozen=True, kw_only=True)
class View:
    """The rays of a camera in a body, computed once.

    Attributes
    ----------
    corners
        (height + 1, width + 1, 4) rays through the pixel corners (column - 1/2, row - 1/2): x and y
        on the base plane, mm, and dx/d(-z), dy/d(-z).
    sees
        (height, width) whether all four corners of a pixel have rays that enter the body through
        its base.
    vignette
        (height, width) light on the sensor that a surface of brightness 1 makes: the gain times the
        share that passes the interfaces and the lens, which is 1 on the axis.
    cover
        (height, width, 3) light from the cover behind the markers, vignette included.
    veil
        (height, width, k) light of mirrored LEDs in front of all, k of `Light.tints`, or None.
    see_through
        What is seen behind the sensing surface, None where that is black or hidden.
    """

    corners: Floats
    sees: Bools
    vignette: Singles
    cover: Singles
    veil: Singles | None
    see_through: SeeThrough | None = None

    @staticmethod
    def of(scene: Scene, top: float) -> View:
        """Return the view of a scene's camera at a gain of 1.

        Parameters
        ----------
        scene
            With camera and light.
        top
            The irradiance that counts as 1, of `twin.world.picture.lamps.Lamps.brightest`.
        """
        camera, _ = scene.imaging
        width, height = camera.width_px, camera.height_px
        corners = np.empty((height + 1, width + 1, 4))
        sees = np.empty((height, width), bool)
        vignette = np.empty((height, width), np.float32)
        veil = _glare(scene, top)
        for first, last, grid in _bands(camera):
            rays_here, inside, passed = _corner_rays(grid, scene)
            shape = (last - first + 1, width + 1)
            corners[first : last + 1] = rays_here.reshape(*shape, 4)
            sees[first:last] = _pixelwise(inside.reshape(shape), np.logical_and)
            vignette[first:last] = 0.25 * _pixelwise(passed.reshape(shape), np.add)
        for marks in camera.on_window:
            share, light = _marked(marks, corners, scene)
            vignette *= 1 - share
            glare = 0.0 if veil is None else veil * (1 - share)[:, :, None]
            veil = (light * share[:, :, None] * _outside(scene, top) + glare).astype(np.float32)
        cover = _cover_picture(scene, top, sees) * (vignette * sees)[:, :, None]
        see_through = None
        if scene.cover is None or scene.cover.transmittance > 0:
            see_through = SeeThrough(sees, scene, top)
        return View(
            corners=corners,
            sees=sees,
            vignette=vignette,
            cover=cover,
            veil=veil,
            see_through=see_through,
        )

    @staticmethod
    def pupil_cameras(scene: Scene) -> list[Camera]:
        """Return cameras of no aperture at points of the scene's pupil, in the order of
        `twin.parts.camera.DISC_POINTS`; none if the pupil is a point.

        Raises
        ------
        RecipeError
            The lens is focused on what it can't see.
        """
        camera = scene.camera
        if camera is None or camera.aperture_mm == 0:
            return []
        if not camera.focus_z_mm < camera.pupil_mm[2]:
            raise RecipeError(
                f"camera.focus_z_mm = {camera.focus_z_mm:g} mm: what the lens shows sharply must "
                f"lie in front of it (below camera.pupil_mm's z = {camera.pupil_mm[2]:g} mm); move "
                "it, or set aperture_mm = 0"
            )
        focus = np.array([[camera.pupil_mm[0], camera.pupil_mm[1], camera.focus_z_mm]])
        optics = (scene.material.refractive_index, scene.body.base_z_mm)
        sharp = camera.model_copy(update={"aperture_mm": 0.0})
        here = project(focus, sharp, *optics)[0]
        if not np.isfinite(here).all():
            raise RecipeError(
                "camera.tilt_deg: the lens doesn't see the place below its pupil where it is "
                f"focused (z = {camera.focus_z_mm:g} mm); turn it there, or set aperture_mm = 0"
            )
        # One camera for each point, its principal point moved so that all see the place in focus on
        # the same pixel.
        cameras = []
        for x, y in (camera.aperture_mm / 2 * DISC_POINTS).tolist():
            pupil = (camera.pupil_mm[0] + x, camera.pupil_mm[1] + y, camera.pupil_mm[2])
            moved = sharp.model_copy(update={"pupil_mm": pupil})
            column, row = np.asarray(camera.centre_px) + here - project(focus, moved, *optics)[0]
            cameras.append(moved.model_copy(update={"principal_px": (float(column), float(row))}))
        return cameras

    def times(self, gain: float) -> View:
        """Return the view with all of its light times a gain."""
        factor = np.float32(gain)
        veil = None if self.veil is None else factor * self.veil
        return replace(self, vignette=factor * self.vignette, cover=factor * self.cover, veil=veil)

    def behind(self, probes: tuple[Load.Placed, ...]) -> Singles | None:
        """Return the (height, width, 3) light of what is seen behind the sensing surface; None if
        nothing is."""
        if self.see_through is None or not (probes or self.see_through.is_bright):
            return None
        return self.see_through.light(probes) * self.vignette[:, :, None]

    def ground_light(self, ccd: Ccd) -> float:
        """Return the light in a CCD's brightest channel that 99 % of the pixels do not exceed
        without markers.

        One pixel in a hundred may be brighter, so that mirrored LEDs don't set the exposure.
        """
        ground = self.cover if self.veil is None else self.cover + self.veil
        if (behind := self.behind(())) is not None:
            ground = ground + behind
        return float(np.quantile((ground @ ccd.response.T).max(axis=2), _EXPOSED))


def _marked(marks: Camera.Marks, corners: Floats, scene: Scene) -> tuple[Floats, Floats]:
    """Return (height, width) shares that marks cover, and (height, width, k) light that one sends
    to the camera, k of `Light.tints`; times `_outside`."""
    from scipy.spatial import KDTree

    camera, light = scene.imaging
    # Where each pixel's ray crosses the outer face, and how far from the nearest mark's line.
    ahead = corners[:, :, 2:] * scene.material.refractive_index
    ahead /= np.sqrt(1 + (corners[:, :, 2:] ** 2).sum(axis=2) - (ahead**2).sum(axis=2))[:, :, None]
    gap = camera.air_gap_mm(scene.body.base_z_mm)
    places = camera.pupil_mm[:2] + gap * ahead
    lines = marks.lines(*scene.body.bounds_mm)
    steps = min(int(np.ceil(4 * marks.length_mm / marks.size_mm)), _STEPS) + 1
    along = np.linspace(0, 1, steps)[:, None]
    parts = lines[:, None, 0] + along * (lines[:, 1] - lines[:, 0])[:, None]
    # Only what comes near a mark is looked for: three pixels and a scratch's part beyond its edge.
    near = marks.size_mm + 3 * max(float(np.abs(np.diff(places, axis=n)).max()) for n in (0, 1))
    tree = KDTree(parts.reshape(-1, 2))
    away, nearest = tree.query(places, distance_upper_bound=near)
    away = np.minimum(away, near)
    if steps > 1:
        first, last = np.moveaxis(lines[np.minimum(nearest // steps, marks.count - 1)], 2, 0)
        way = last - first
        part = np.sum((places - first) * way, axis=2) / marks.length_mm**2
        away = np.linalg.norm(places - first - np.clip(part, 0, 1)[:, :, None] * way, axis=2)
    share = _disc(away, marks.size_mm / 2)
    if marks.hollow > 0:
        share = share - _disc(away, marks.hollow * marks.size_mm / 2)
    # Marks are lit as they lie there, before the window.
    seen = share > 0
    points = np.pad(
        places[:-1, :-1][seen], ((0, 0), (0, 1)), constant_values=camera.pupil_mm[2] - gap
    )
    leds, powers = light.points()
    towards = leds - points[:, None]
    cosine = towards[:, :, 2] / np.linalg.norm(towards, axis=2)
    lamps = Lamps(place=leds[None], power=powers * light.emission(cosine) * (cosine > 0))
    tints, _ = light.tints()
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    bright = np.zeros((*share.shape, len(tints)))
    bright[seen] = np.column_stack([lamps.times(tint).irradiance(points, up) for tint in tints])
    return share, marks.albedo * bright


def _glare(scene: Scene, top: float) -> Singles | None:
    """Return (height, width, k) mirrored light, 1 for white in the brightest marker's place before
    vignetting and gain; None where no LED's disc is seen."""
    camera, light = scene.imaging
    if light.radius_mm == 0:
        return None
    channels = len(light.tints()[1])
    veil = np.zeros((camera.height_px, camera.width_px, channels), np.float32)
    for first, last, grid in _bands(camera):
        veil[first:last] = _mirrored(grid, (last - first + 1, camera.width_px + 1), scene)
    if not veil.any():
        return None
    return veil * (_outside(scene, top) / np.float32(light.radius_mm**2))


def _outside(scene: Scene, top: float) -> np.float32:
    """Return what light that never entered the body counts: a surface's brightness is relative to
    light that has passed the interfaces twice, straight, and spreads as it leaves."""
    camera, light = scene.imaging
    indices = [scene.material.refractive_index, *(layer.index for layer in camera.layers), 1.0]
    through = np.prod([1 - ((one - two) / (one + two)) ** 2 for one, two in pairwise(indices)])
    return np.float32((1 - light.ambient) * (indices[0] / through) ** 2 / top)


def _bands(camera: Camera) -> Iterator[tuple[int, int, Pixels]]:
    """Yield bands of rows, first and one after the last, and their pixels' corners (n, 2)."""
    width, height = camera.width_px, camera.height_px
    rows_at_once = max(_AT_ONCE // (width + 1), 1)
    for first in range(0, height, rows_at_once):
        last = min(first + rows_at_once, height)
        columns, rows = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(first, last + 1) - 0.5)
        yield first, last, np.column_stack([columns.ravel(), rows.ravel()])


def _corner_rays(grid: Pixels, scene: Scene) -> tuple[Floats, Bools, Floats]:
    """Return rays of `View.corners`, whether they enter the body through its base, and the share
    that passes."""
    camera, index, _ = scene.optics
    origins, directions = rays(grid, *scene.optics)
    tangents = directions[:, :2] / -directions[:, 2:]
    inside = np.isfinite(tangents[:, 0]) & scene.body.contains(np.nan_to_num(origins), -1e-6)
    sine = np.linalg.norm(directions[:, :2], axis=1) * index
    passed = transmission(sine / np.sqrt(np.maximum(1 - sine**2, 1e-12)), index, camera.layers)
    if camera.vignetting > 0:
        passed = passed * np.clip(-lens_inverse(grid, camera)[:, 2], 0, 1) ** camera.vignetting
    return np.nan_to_num(np.column_stack([origins[:, :2], tangents])), inside, np.nan_to_num(passed)


def _cover_picture(scene: Scene, top: float, sees: Bools) -> Singles:
    """Return (height, width, 3) light of the cover: interpolated between nodes, but exact where it
    ends between them."""
    height, width = sees.shape
    columns, rows = _nodes(width), _nodes(height)
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    light = cover_light(*rays(nodes, *scene.optics), scene, top).reshape(len(rows), len(columns), 3)
    cover = np.empty((height, width, 3), np.float32)
    for c in range(3):
        cover[:, :, c] = stretch(rows, height) @ light[:, :, c] @ stretch(columns, width).T
    # Pixels between nodes of which some meet the cover and some do not have rays of their own.
    met = np.pad(np.any(light > 0, axis=2), (0, 1), mode="edge")
    unlike = _pixelwise(met, np.logical_or) & ~_pixelwise(met, np.logical_and)
    row, column = (
        np.searchsorted(nodes, np.arange(size), side="right") - 1
        for nodes, size in ((rows, height), (columns, width))
    )
    rim = np.argwhere(unlike[np.ix_(row, column)] & sees)
    for begin in range(0, len(rim), _AT_ONCE):
        some = rim[begin : begin + _AT_ONCE]
        origins, directions = rays(some[:, ::-1].astype(float), *scene.optics)
        cover[some[:, 0], some[:, 1]] = cover_light(origins, directions, scene, top)
    return cover


def _nodes(size: int) -> Floats:
    """Return every fourth pixel, or fewer of a large picture, and the last."""
    step = max(_COARSE, size // 200)
    return np.unique(np.append(np.arange(0, size, step), size - 1)).astype(float)


def _pixelwise(corners: Any, join: np.ufunc) -> Any:
    """Join the values at each pixel's four corners."""
    rows = join(corners[:-1], corners[1:])
    return join(rows[:, :-1], rows[:, 1:])


def _mirrored(corners: Pixels, shape: tuple[int, int], scene: Scene) -> Floats:
    """Return the LEDs' light in pixels between corners: the share mirrored, times intensity over
    cosine, by channel.

    A ray of tangent p in air goes down to an interface and up again to the height of an LED; a
    layer moves it aside twice.
    """
    camera, light = scene.imaging
    body_index = scene.material.refractive_index
    layers = camera.layers
    # The rays of the pixels' corners, and the light of an LED along each.
    into = lens_inverse(corners, camera) @ camera.tilt_matrix().T
    tangent = into[:, :2] / np.where(into[:, 2] < -1e-12, -into[:, 2], np.nan)[:, None]
    p = np.linalg.norm(tangent, axis=1)
    cosine = np.maximum((1 + p**2) ** -0.5, _GRAZING)
    passed = light.emission(cosine) / cosine
    # One LED's light by channel: that of its disc's points.
    tints, _ = light.tints()
    powers = (
        (tints * light.points()[1]).reshape(len(tints), len(light.positions_mm), -1).sum(axis=2)
    )
    total = np.zeros((shape[0] - 1, shape[1] - 1, len(powers)))
    gap = camera.air_gap_mm(scene.body.base_z_mm)
    back = camera.pupil_mm[2] - gap
    indices = [1.0, *(layer.index for layer in layers[::-1]), body_index]
    # Each interface mirrors a part; the light passes all interfaces before it twice.
    for n, (one, two) in enumerate(pairwise(indices)):
        behind = [(la.thickness_mm, la.index) for la in layers[len(layers) - n :]]
        aside = sum((t / np.sqrt(m**2 + (m**2 - 1) * p**2) for t, m in behind), np.zeros(len(p)))
        mirrored = reflection(p, one, two)
        for led, power in zip(np.array(light.positions_mm), powers.T, strict=True):
            if led[2] < back:
                continue
            # Unfolded at the interface, the mirrored ray goes straight on; it meets the LED's disc
            # or misses it.
            way = gap + led[2] - back + 2 * aside
            there = np.array(camera.pupil_mm[:2]) + way[:, None] * tangent
            covers = _disc(np.linalg.norm(there - led[:2], axis=1).reshape(shape), light.radius_mm)
            seen = np.nan_to_num(
                covers * _pixelwise((passed * mirrored).reshape(shape), np.add) / 4
            )
            total += seen[:, :, None] * power
        passed = passed * (1 - mirrored) ** 2
    return total


def _disc(away: Floats, radius: float) -> Floats:
    """Return the share of each pixel that a disc covers, from the distances of the pixels' corners
    to its centre."""
    across = away[:, 1:] - away[:, :-1]
    down = away[1:] - away[:-1]
    steep = np.hypot((across[1:] + across[:-1]) / 2, (down[:, 1:] + down[:, :-1]) / 2)
    covers: Floats = np.clip(
        0.5 + (radius - _pixelwise(away, np.add) / 4) / np.maximum(steep, 1e-12), 0, 1
    )
    # At the horizon a pixel looks at more than the whole disc: its share there is next to nothing.
    within: Floats = np.where(steep < 2 * radius, covers, 0.0)
    return within
