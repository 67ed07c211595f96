"""What the camera's pixels look at: rays inside the body, and which pixels are near markers.

Why rays at pixel corners only: they are smooth, so straight interpolation inside a pixel is off by less than 1e-3 px
even for a fisheye, and the cost doesn't grow with the number of sub-pixel rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints, Pixels, Singles
from twin.compiled import njit
from twin.parts.scene import Scene
from twin.theory.optics import axis_cosine, project_with_jacobian, rays, transmission
from twin.world.picture.glare import glare
from twin.world.picture.lighting import cover_light
from twin.world.picture.markers import Ellipsoids
from twin.world.picture.nearby import least_eigenvalue, near_pixels

_COARSE = 4
_AT_ONCE = 400_000
"""Rays computed in one go: memory for a picture of any size stays that of its results."""

_EDGE_SEARCH = 1.2
"""Sub-pixels: a ray reaches half a diagonal, 0.71, and an ellipsoid grows by less than its axes between them."""

_ROOM_PX = 1.2
"""Half a pixel's diagonal, and as much again for what a first-order outline leaves out."""


@dataclass(frozen=True, kw_only=True)
class View:
    """The rays of a camera in a body, computed once.

    Attributes
    ----------
    corners
        (height + 1, width + 1, 4) rays through the pixel corners (column - 1/2, row - 1/2): x and y on the base plane,
        mm, and dx/d(-z), dy/d(-z).
    sees
        (height, width) whether all four corners of a pixel have rays that enter the body through its base.
    vignette
        (height, width) light on the sensor that a surface of brightness 1 makes: the gain times the share that passes
        the interfaces and the lens, which is 1 on the axis.
    cover
        (height, width, 3) light from the cover behind the markers, vignette included.
    veil
        (height, width) light of mirrored LEDs before all, or None.
    """

    corners: Floats
    sees: Bools
    vignette: Singles
    cover: Singles
    veil: Singles | None


def look(scene: Scene, top: float, gain: float) -> View:
    """Return the view of the scene's camera; ``top`` is the irradiance that counts as 1, ``gain`` what becomes of 1."""
    camera = scene.camera
    assert camera is not None
    index, base = scene.material.refractive_index, scene.body.base_z_mm
    width, height = camera.width_px, camera.height_px
    corners = np.empty((height + 1, width + 1, 4))
    sees = np.empty((height, width), bool)
    vignette = np.empty((height, width), np.float32)
    rows_at_once = max(_AT_ONCE // (width + 1), 1)
    for top_row in range(0, height, rows_at_once):
        last = min(top_row + rows_at_once, height)
        columns, rows = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(top_row, last + 1) - 0.5)
        grid = np.column_stack([columns.ravel(), rows.ravel()])
        rays_here, inside, passed = _corner_rays(grid, scene)
        shape = (last - top_row + 1, width + 1)
        corners[top_row : last + 1] = rays_here.reshape(*shape, 4)
        sees[top_row:last] = _pixelwise(inside.reshape(shape), np.logical_and)
        vignette[top_row:last] = gain / 4 * _pixelwise(passed.reshape(shape), np.add)

    columns, rows = _coarse(width), _coarse(height)
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    light = cover_light(*rays(nodes, camera, index, base), scene, top).reshape(len(rows), len(columns), 3)
    cover = np.empty((height, width, 3), np.float32)
    for c in range(3):
        cover[:, :, c] = stretch(rows, height) @ light[:, :, c] @ stretch(columns, width).T
    rim = np.argwhere(_between_unlike(np.any(light > 0, axis=2), rows, columns, sees))
    for begin in range(0, len(rim), _AT_ONCE):
        some = rim[begin : begin + _AT_ONCE]
        cover[some[:, 0], some[:, 1]] = cover_light(*rays(some[:, ::-1].astype(float), camera, index, base), scene, top)
    cover *= (vignette * sees)[:, :, None]
    veil = glare(scene, top)
    if veil is not None:
        veil *= np.float32(gain)
    return View(corners=corners, sees=sees, vignette=vignette, cover=cover, veil=veil)


def _corner_rays(grid: Pixels, scene: Scene) -> tuple[Floats, Bools, Floats]:
    """Return rays of `View.corners`, whether they enter the body through its base, and the share that passes."""
    camera = scene.camera
    assert camera is not None
    index, base = scene.material.refractive_index, scene.body.base_z_mm
    origins, directions = rays(grid, camera, index, base)
    tangents = directions[:, :2] / -directions[:, 2:]
    inside = np.isfinite(tangents[:, 0]) & scene.body.contains(np.nan_to_num(origins), -1e-6)
    sine = np.linalg.norm(directions[:, :2], axis=1) * index
    passed = transmission(sine / np.sqrt(np.maximum(1 - sine**2, 1e-12)), index, camera.layers)
    if camera.vignetting > 0:
        passed = passed * np.clip(axis_cosine(grid, camera), 0, 1) ** camera.vignetting
    return np.nan_to_num(np.column_stack([origins[:, :2], tangents])), inside, np.nan_to_num(passed)


@njit(cache=True, nogil=True)
def compose(picture: Singles, pixels: Ints, light: Singles, free: Singles, vignette: Singles) -> None:
    """Put (m, 3) light from markers over what (m,) free shares of pixels leave of a picture of the cover, in place."""
    there, passed = picture.reshape(-1, 3), vignette.reshape(-1)
    for j in range(len(pixels)):
        at = pixels[j]
        for c in range(3):
            there[at, c] = there[at, c] * free[j] + light[j, c] * passed[at]


@dataclass(frozen=True, kw_only=True)
class Near:
    """Where markers may be seen.

    Attributes
    ----------
    pixels, alone, first, members
        The pixels near any marker, and which, as in `twin.world.picture.nearby.Nearby`.
    top_mm
        (n,) height z just behind each marker: rays start there, close to what they meet; -inf where it isn't seen.
    centres_px
        (n, 2) projected centres; 0 where the camera doesn't see the place.
    conjugate
        (n, 2, 2) matrix C of each outline to first order, x^T C^-1 x = 1 about the projected centre, px^2; the unit
        matrix where the camera doesn't see the place.
    pad_mm
        (n,) how much larger than a marker a search for its edge has to be.
    seen
        (n,) whether the camera's lens and layers let it see the place.
    cut
        (n,) whether the outline may cross the picture's edge.
    """

    pixels: Ints
    alone: Ints
    first: NDArray[np.int32]
    members: NDArray[np.int32]
    top_mm: Floats
    centres_px: Floats
    conjugate: Floats
    pad_mm: Floats
    seen: Bools
    cut: Bools


def near_markers(markers: Ellipsoids, scene: Scene, view: View, subpixels: int) -> Near:
    """Return the pixels in which markers can be seen, ``subpixels`` squared rays going through each.

    The outline's half extents come from the projection's Jacobian, with room for its curvature.
    """
    camera = scene.camera
    assert camera is not None
    optics = (camera, scene.material.refractive_index, scene.body.base_z_mm)
    centres, jacobian = project_with_jacobian(markers.centres, *optics)
    seen = markers.present & np.isfinite(centres).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    centres = np.where(seen[:, None], centres, 0.0)
    conjugate, pad, tops, cut = _outlines(
        centres, jacobian, markers.centres[:, 2], markers.axes, seen, subpixels, scene.body.base_z_mm,
        camera.width_px, camera.height_px,
    )  # fmt: skip
    nearby = near_pixels(centres, conjugate, _ROOM_PX, seen, view.sees)
    return Near(
        pixels=nearby.pixels,
        alone=nearby.alone,
        first=nearby.first,
        members=nearby.members,
        top_mm=tops,
        centres_px=centres,
        conjugate=conjugate,
        pad_mm=pad,
        seen=seen,
        cut=cut,
    )


@njit(cache=True, nogil=True)
def _outlines(
    centres: Pixels, jacobian: Floats, z: Floats, axes: Floats, seen: Bools, subpixels: int, base: float, width: int,
    height: int,
) -> tuple[Floats, Floats, Floats, Bools]:  # fmt: skip
    """Return ``conjugate``, ``pad_mm``, ``top_mm`` and ``cut`` of `Near`."""
    n = len(centres)
    conjugate, pad, tops, cut = np.zeros((n, 2, 2)), np.zeros(n), np.full(n, -np.inf), np.zeros(n, np.bool_)
    for i in range(n):
        if not seen[i]:
            conjugate[i, 0, 0] = conjugate[i, 1, 1] = 1.0
            continue
        a = b = c = 0.0  # of J J^T
        thick = 0.0
        for j in range(3):
            a += jacobian[i, 0, j] ** 2
            b += jacobian[i, 0, j] * jacobian[i, 1, j]
            c += jacobian[i, 1, j] ** 2
            thick += axes[i, 2, j] ** 2
            across = down = 0.0
            for k in range(3):
                across += jacobian[i, 0, k] * axes[i, k, j]
                down += jacobian[i, 1, k] * axes[i, k, j]
            conjugate[i, 0, 0] += across * across
            conjugate[i, 0, 1] += across * down
            conjugate[i, 1, 1] += down * down
        conjugate[i, 1, 0] = conjugate[i, 0, 1]
        pad[i] = _EDGE_SEARCH / subpixels / np.sqrt(least_eigenvalue(a, b, c))
        tops[i] = min(z[i] + 1.02 * (np.sqrt(thick) + pad[i]), base)
        right, below = 1.05 * np.sqrt(conjugate[i, 0, 0]) + _ROOM_PX, 1.05 * np.sqrt(conjugate[i, 1, 1]) + _ROOM_PX
        column, row = centres[i]
        cut[i] = column < right or row < below or column + right > width - 1 or row + below > height - 1
    return conjugate, pad, tops, cut


def _pixelwise(corners: Any, join: np.ufunc) -> Any:
    """Join the values at each pixel's four corners."""
    rows = join(corners[:-1], corners[1:])
    return join(rows[:, :-1], rows[:, 1:])


def _between_unlike(met: Bools, rows: Floats, columns: Floats, sees: Bools) -> Bools:
    """Return which pixels that see into the body lie between nodes of which some have met the cover and some not."""
    corners = np.pad(met, (0, 1), mode="edge")
    unlike = _pixelwise(corners, np.logical_or) & ~_pixelwise(corners, np.logical_and)
    row, column = (np.searchsorted(nodes, np.arange(size), side="right") - 1
                   for nodes, size in zip((rows, columns), sees.shape, strict=True))  # fmt: skip
    between: Bools = unlike[np.ix_(row, column)] & sees
    return between


def _coarse(size: int) -> Floats:
    """Return every fourth pixel, or fewer of a large picture, and the last."""
    return np.unique(np.append(np.arange(0, size, max(_COARSE, size // 200)), size - 1)).astype(float)


def stretch(nodes: Floats, size: int) -> Floats:
    """Return the (size, nodes) matrix of straight interpolation from nodes to pixels."""
    return np.stack([np.interp(np.arange(size), nodes, column) for column in np.eye(len(nodes))], axis=1)
