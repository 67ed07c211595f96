"""The camera in closed form: points to pixels and pixels to rays, through flat layers and a lens.

The formulas are in docs/theory.md. All interfaces are normal to z, so a chief ray stays in one
vertical plane and p, the tangent of its angle in air, fixes it (Snell's law; Born & Wolf,
Principles of Optics, sec. 1.5). The sum over the layers is concave and increasing in p, so Newton's
iteration from the paraxial value climbs to the root without ever passing it, at grazing angles too.

The camera's axes are right = +x, up = +y, backward = +z before its small tilts, so column grows
with x and row with -y: a camera that looks along -z sees the body without a mirror.

Validity: geometric optics of a thin pupil; no polarisation; the base and the layers stay flat.
Inside the body rays lean to z by less than the critical angle, where total reflection begins.

Rays are traced one at a time by compiled code: whole-array steps cost more than their arithmetic.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from twin.arrays import Floats, Pixels, Points
from twin.compiled import njit
from twin.parts.camera import Camera
from twin.theory.lens import lens, lens_inverse, lens_jacobian, stretches

_ITERATIONS = 60


def _through(p: Any, thickness: Any, index: float) -> tuple[Any, Any]:
    """Return how far rays of tangent ``p`` in air move sideways in one layer, and the
    derivative."""
    square = index * index
    inverse = 1 / np.sqrt(square + (square - 1) * (p * p))
    return thickness * (p * inverse), thickness * (square * (inverse * inverse * inverse))


_through_one = njit()(_through)


@njit(cache=True)
def _tangents(
    reach: Floats, depth: Floats, index: float, stack: Floats, air: Floats, out: Floats
) -> None:
    """Set ``out`` (n,) to `air_tangents`; ``stack`` (k, 2) holds thicknesses and indices."""
    for i in range(len(reach)):
        out[i] = np.nan
        if depth[i] >= -1e-9:
            out[i] = _tangent(reach[i], max(depth[i], 0.0), index, stack, air[i])[0]


@njit(cache=True)
def _tangent(
    reach: float, depth: float, index: float, stack: Floats, air: float
) -> tuple[float, float]:
    """Return the tangent of the ray that moves ``reach`` sideways, NaN for none, and `sideways`'
    slope."""
    p = reach / _sideways(0.0, depth, index, stack, air)[1]
    for _ in range(_ITERATIONS):
        so_far, slope = _sideways(p, depth, index, stack, air)
        missing = reach - so_far
        if abs(missing) <= 1e-13 * (1 + reach):
            break
        p += missing / slope
    return (p if abs(missing) <= 1e-9 * (1 + reach) else np.nan), slope


@njit(cache=True)
def _sideways(
    p: float, depth: float, index: float, stack: Floats, air: float
) -> tuple[float, float]:
    reach, slope = _through_one(p, depth, index)
    for layer in range(len(stack)):
        further, steeper = _through_one(p, stack[layer, 0], stack[layer, 1])
        reach, slope = reach + further, slope + steeper
    return reach + air * p, slope + air


def project(points: Points, camera: Camera, body_index: float, base_z_mm: float) -> Pixels:
    """Return where the camera sees points of the body.

    Parameters
    ----------
    points
        (n, 3) points in the body, mm.
    camera
        The camera, nominal or actual.
    body_index
        Refractive index of the body.
    base_z_mm
        Height of the plane where the body ends and the layers begin, mm.

    Returns
    -------
    (n, 2) column and row, px, also outside the picture; NaN for points behind the base, outside the
    lens's range or without a ray to the pupil.

    Raises
    ------
    RecipeError
        The pupil lies in front of the layers.
    """
    towards, _, _ = _leave(points, camera, body_index, base_z_mm)
    return lens(towards @ camera.tilt_matrix(), camera)


def project_with_jacobian(
    points: Points, camera: Camera, body_index: float, base_z_mm: float
) -> tuple[Pixels, Floats]:
    """Return `project`, and its (n, 2, 3) derivatives with respect to the points, px/mm: the
    implicit derivative of Snell's sum, then the chain rule through tilt and lens."""
    towards, p, aside = _leave(points, camera, body_index, base_z_mm)
    slope = _leaving_slopes(points, p, aside, camera, body_index, base_z_mm)
    turn = camera.tilt_matrix()
    seen = towards @ turn
    turned = (lens_jacobian(seen, camera).reshape(-1, 3) @ turn.T).reshape(-1, 2, 3)
    jacobian: Floats = turned[:, :, :2] @ slope
    return lens(seen, camera), jacobian


def rays(
    pixels: Pixels, camera: Camera, body_index: float, base_z_mm: float
) -> tuple[Points, Points]:
    """Return the rays inside the body that end in the given places of the picture: the exact
    inverse of `project`.

    Parameters
    ----------
    pixels
        (n, 2) column and row, px.
    camera, body_index, base_z_mm
        As for `project`.

    Returns
    -------
    origins
        (n, 3) points on the base plane, mm.
    directions
        (n, 3) unit vectors from there into the body (z < 0). Both are NaN where no ray reaches the
        pixel: outside the lens, or away from the layers.
    """
    into = lens_inverse(pixels, camera) @ camera.tilt_matrix().T
    down = np.where(into[:, 2] < -1e-12, -into[:, 2], np.nan)
    tangent = into[:, :2] / down[:, None]
    p = np.linalg.norm(tangent, axis=1)
    air = camera.air_gap_mm(base_z_mm)
    reach, _ = sideways(p, np.zeros(len(p)), body_index, camera.layers, air)
    # reach / p tends to the slope at p = 0; the tiny number only keeps the division quiet there.
    safe = np.maximum(p, 1e-300)
    slope0 = air + sum(layer.thickness_mm / layer.index for layer in camera.layers)
    share = np.where(p > 1e-12, reach / safe, slope0)
    origins = np.column_stack(
        [np.asarray(camera.pupil_mm[:2]) + share[:, None] * tangent, np.full(len(p), base_z_mm)]
    )
    inside = tangent / (body_index * np.sqrt(1 + p**2))[:, None]
    directions = np.column_stack([inside, -np.sqrt(1 - np.sum(inside**2, axis=1))])
    origins[np.isnan(directions[:, 0])] = np.nan
    return origins, directions


def sideways(
    p: Floats,
    depth_mm: Floats,
    body_index: float,
    layers: tuple[Camera.Layer, ...],
    air_mm: Floats | float,
) -> tuple[Floats, Floats]:
    """Return how far rays move sideways between a depth in the body and the pupil, (n,) mm, and the
    derivative with respect to ``p``, (n,) mm.

    ``p`` are (n,) tangents of the rays' angles to z in air, ``depth_mm`` (n,) distances from the
    base plane into the body; the way in air may be another one for every ray.
    """
    reach = air_mm * p
    slope = np.full(np.shape(p), air_mm, float)
    stack: list[tuple[Floats | float, float]] = [(depth_mm, body_index)]
    stack += [(layer.thickness_mm, layer.index) for layer in layers]
    for thickness, index in stack:
        further, steeper = _through(p, thickness, index)
        reach, slope = reach + further, slope + steeper
    return reach, slope


def air_tangents(
    reach_mm: Floats,
    depth_mm: Floats,
    body_index: float,
    layers: tuple[Camera.Layer, ...],
    air_mm: Floats | float,
) -> Floats:
    """Return (n,) tangents in air of the rays that move ``reach_mm`` sideways: the inverse of
    `sideways`. NaN for negative depth, or too far aside when the pupil touches the layers."""
    reach = np.array(reach_mm, float)
    depth, air = (
        np.array(np.broadcast_to(np.asarray(each, float), reach.shape))
        for each in (depth_mm, air_mm)
    )
    stack = np.array([(layer.thickness_mm, layer.index) for layer in layers], float).reshape(-1, 2)
    out = np.empty(len(reach))
    _tangents(reach, depth, float(body_index), stack, air, out)
    return out


def transmission(p: Floats, body_index: float, layers: tuple[Camera.Layer, ...]) -> Floats:
    """Return (n,) shares of unpolarised light that pass all interfaces between air and body:
    `reflection` at each in turn, relative to normal incidence, which the exposure takes up; without
    reflections to and fro. ``p`` are (n,) tangents of the rays' angles to z in air."""
    indices = [body_index, *(layer.index for layer in layers), 1.0]
    share = np.ones_like(p)
    for one, two in pairwise(indices):
        share = share * (1 - reflection(p, one, two)) / (1 - ((one - two) / (one + two)) ** 2)
    return share


def reflection(p: Any, one: Any, two: Any) -> Any:
    """Return the shares of unpolarised light that an interface of refractive indices ``one`` and
    ``two`` sends back: Fresnel's formulas (Born & Wolf sec. 1.5.2), the mean of both polarisations.

    ``p`` are tangents of the rays' angles to the interface's normal in air, wherever it lies, or in
    any medium to whose index ``one`` and ``two`` are relative; all numbers or arrays.
    """
    sine2 = p**2 / (1 + p**2)
    # n cos(angle) on both sides; n^2 cos^2 = n^2 - sin^2(angle in air).
    a, b = np.sqrt(one**2 - sine2), np.sqrt(two**2 - sine2)
    across = ((a - b) / (a + b)) ** 2
    along = ((two**2 * a - one**2 * b) / (two**2 * a + one**2 * b)) ** 2
    return (across + along) / 2


def _leave(
    points: Points, camera: Camera, body_index: float, base_z_mm: float
) -> tuple[Points, Floats, Floats]:
    """Return (n, 3) air directions (p e, -1) from pupil to points, (n,) p, and (n, 2) how far
    aside."""
    points = np.asarray(points, float)
    aside = points[:, :2] - np.asarray(camera.pupil_mm[:2])
    reach = np.sqrt(aside[:, 0] ** 2 + aside[:, 1] ** 2)
    p = air_tangents(
        reach, base_z_mm - points[:, 2], body_index, camera.layers, camera.air_gap_mm(base_z_mm)
    )
    towards = np.empty((len(points), 3))
    towards[:, :2] = (p / np.maximum(reach, 1e-300))[:, None] * aside
    towards[:, 2] = np.where(np.isnan(p), np.nan, -1.0)
    return towards, p, aside


def _leaving_slopes(
    points: Points, p: Floats, aside: Floats, camera: Camera, body_index: float, base_z_mm: float
) -> Floats:
    """Return (n, 2, 3) derivatives of the p e that `_leave` returns."""
    depth = np.maximum(base_z_mm - np.asarray(points, float)[:, 2], 0.0)
    _, slope = sideways(p, depth, body_index, camera.layers, camera.air_gap_mm(base_z_mm))
    reach = np.sqrt(aside[:, 0] ** 2 + aside[:, 1] ** 2)
    near = reach <= 1e-12
    unit = aside / np.where(near, 1.0, reach)[:, None]
    over = np.where(near, 1 / slope, p / np.where(near, 1.0, reach))
    derivative = np.empty((len(points), 2, 3))
    derivative[:, :, :2] = stretches(unit, 1 / slope, over)
    body_tangent = p / np.sqrt(body_index**2 + (body_index**2 - 1) * p**2)
    derivative[:, :, 2] = unit * (body_tangent / slope)[:, None]
    return derivative


PIXEL_VARIANCE = 1.0 / 12.0
"""Of a square pixel, px^2."""


def centre_bound(diameter_px: Floats, contrast: float, psf_px: float, noise: float) -> Floats:
    """Return the least standard deviation of a disc's centre, per axis, px: the Cramer-Rao bound.

    Parameters
    ----------
    diameter_px, psf_px
        Of the discs; standard deviation of the blur.
    contrast, noise
        Brightness over the ground's, and standard deviation of a pixel at the rim, in one unit.

    Notes
    -----
    A disc of radius R and contrast A, blurred by a Gaussian g of standard deviation s small against
    R, changes only at its rim: df/dx = A cos(angle) g(r - R). With noise of standard deviation n
    there, the Fisher information of x is (H. Cramer 1946)

        I = int (df/dx)^2 / n^2 = A^2 / n^2  pi R  int g^2 dr = A^2 R sqrt(pi) / (2 s n^2).

    A square pixel adds 1/12 to s^2. Validity: R well above s (at R = 2 s it is 3 % off), one
    channel, markers apart, a disc of even brightness; `twin.study.doubts` has what real ones add.
    """
    radius = np.asarray(diameter_px, float) / 2
    blur = np.sqrt(np.asarray(psf_px, float) ** 2 + PIXEL_VARIANCE)
    information = (np.asarray(contrast) / noise) ** 2 * radius * np.sqrt(np.pi) / (2 * blur)
    return np.asarray(information**-0.5)
