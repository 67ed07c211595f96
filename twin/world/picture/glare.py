"""Glare: the LEDs' discs as base, layers and air mirror them straight into the camera.

Light that is mirrored once, at any of the flat interfaces, lies like a veil over markers and cover. It depends on
nothing that moves, so it is computed once. A disc looks as bright as its light over its area tells; an interface of
plastic or rubber and air sends back 4 % of it, which is more than a lit marker gives off.

Validity: one reflection; discs whose images are wider than a pixel (points, ``light.radius_mm = 0``, have none: their
glare would be a spot without size); LEDs in air.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from twin.arrays import Floats, Pixels, Singles
from twin.parts.scene import Scene
from twin.theory.lens import lens_inverse
from twin.theory.optics import air_gap, reflection, tilt_matrix

_AT_ONCE = 400_000
"""Rays computed in one go."""

_GRAZING = 1e-3
"""Cosine below which an LED is taken to look no brighter."""


def glare(scene: Scene, top: float) -> Singles | None:
    """Return (height, width) mirrored light, or None where no LED's disc is seen.

    Parameters
    ----------
    scene
        With camera and light.
    top
        The irradiance that counts as 1.

    Returns
    -------
    Light in the units of a marker's brightness, 1 for white in the brightest marker's place, before the camera's
    vignetting and the gain.
    """
    camera, light = scene.camera, scene.light
    assert camera is not None
    assert light is not None
    if light.radius_mm == 0:
        return None
    width, height = camera.width_px, camera.height_px
    veil = np.zeros((height, width), np.float32)
    rows_at_once = max(_AT_ONCE // (width + 1), 1)
    for first in range(0, height, rows_at_once):
        last = min(first + rows_at_once, height)
        columns, rows = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(first, last + 1) - 0.5)
        shape = (last - first + 1, width + 1)
        corners = np.column_stack([columns.ravel(), rows.ravel()])
        veil[first:last] = _mirrored(corners, shape, scene)
    if not veil.any():
        return None
    # Lit surfaces count relative to light that has passed the interfaces twice, straight, and spreads as it leaves.
    indices = [scene.material.refractive_index, *(layer.index for layer in camera.layers), 1.0]
    through = np.prod([1 - ((one - two) / (one + two)) ** 2 for one, two in pairwise(indices)])
    return veil * np.float32((1 - light.ambient) * (indices[0] / through / light.radius_mm) ** 2 / top)


def _mirrored(corners: Pixels, shape: tuple[int, int], scene: Scene) -> Floats:
    """Return the LEDs' light in pixels between corners: the share mirrored, times intensity over cosine.

    Notes
    -----
    A ray of tangent p in air goes down to an interface and up again to the height of an LED; a layer moves it aside
    twice.
    """
    camera, light = scene.camera, scene.light
    assert camera is not None
    assert light is not None
    body_index, layers = scene.material.refractive_index, camera.layers
    into = lens_inverse(corners, camera) @ tilt_matrix(camera).T
    tangent = into[:, :2] / np.where(into[:, 2] < -1e-12, -into[:, 2], np.nan)[:, None]
    p = np.linalg.norm(tangent, axis=1)
    cosine = np.maximum((1 + p**2) ** -0.5, _GRAZING)
    passed, total = light.emission(cosine) / cosine, np.zeros((shape[0] - 1, shape[1] - 1))
    gap = air_gap(camera, scene.body.base_z_mm)
    back = camera.pupil_mm[2] - gap
    indices = [1.0, *(layer.index for layer in layers[::-1]), body_index]
    for n, (one, two) in enumerate(pairwise(indices)):
        behind = [(la.thickness_mm, la.index) for la in layers[len(layers) - n :]]
        aside = sum((t / np.sqrt(m**2 + (m**2 - 1) * p**2) for t, m in behind), np.zeros(len(p)))
        sent_back = reflection(p, one, two)
        for led in np.array(light.positions_mm):
            if led[2] < back:
                continue
            way = gap + led[2] - back + 2 * aside
            away = np.linalg.norm(np.array(camera.pupil_mm[:2]) + way[:, None] * tangent - led[:2], axis=1)
            covers = _disc(away.reshape(shape), light.radius_mm)
            total += np.nan_to_num(covers * _mean((passed * sent_back).reshape(shape)))
        passed = passed * (1 - sent_back) ** 2
    return total


def _disc(away: Floats, radius: float) -> Floats:
    """Return how much of each pixel a disc covers, from the distances of the pixels' corners to its centre."""
    across, down = away[:, 1:] - away[:, :-1], away[1:] - away[:-1]
    steep = np.hypot((across[1:] + across[:-1]) / 2, (down[:, 1:] + down[:, :-1]) / 2)
    covers: Floats = np.clip(0.5 + (radius - _mean(away)) / np.maximum(steep, 1e-12), 0, 1)
    # At the horizon a pixel looks at more than the whole disc: there its share is next to nothing.
    within: Floats = np.where(steep < 2 * radius, covers, 0.0)
    return within


def _mean(corners: Floats) -> Floats:
    """Return the mean of each pixel's four corners."""
    mean: Floats = (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:] + corners[:-1, :-1]) / 4
    return mean
