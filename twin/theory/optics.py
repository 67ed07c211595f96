"""The camera in closed form: points to pixels and pixels to rays, through flat layers and a lens.

A chief ray leaves a point in the body, crosses the base, the camera's layers and air, and ends in the entrance pupil.
All interfaces are normal to z, so the ray stays in one vertical plane and Snell's invariant n sin(angle) fixes it by
one number. Taking p, the tangent of the angle in air, a layer of index n and thickness t moves the ray sideways by

    t p / sqrt(n^2 + (n^2 - 1) p^2)        (Snell's law, Born & Wolf, Principles of Optics, sec. 1.5)

Why p and not the sine: the sum over the layers is concave and increasing in p, so Newton's iteration from the paraxial
value climbs to the root without ever passing it, at grazing angles too.

The camera's axes are right = +x, up = +y, backward = +z before its small tilts, so column grows with x and row with -y:
a camera that looks along -z sees the body without a mirror.

Validity: geometric optics of a thin pupil; no defocus, no polarisation; the base and the layers stay flat.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from twin.arrays import Floats, Pixels, Points
from twin.errors import RecipeError
from twin.parts.camera import Camera, Layer

_ITERATIONS = 60


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
    (n, 2) column and row, px, also outside the picture; NaN for points behind the base, outside the lens's range or
    without a ray to the pupil.

    Raises
    ------
    RecipeError
        The pupil lies in front of the layers.
    """
    towards, _ = _leave(points, camera, body_index, base_z_mm)
    return _lens(towards @ tilt_matrix(camera), camera)


def projection_jacobian(points: Points, camera: Camera, body_index: float, base_z_mm: float) -> Floats:
    """Return (n, 2, 3) derivatives of `project` with respect to the points, px/mm; NaN where `project` is NaN.

    Notes
    -----
    Analytic: the implicit derivative of Snell's sum, then the chain rule through tilt and lens.
    """
    return project_with_jacobian(points, camera, body_index, base_z_mm)[1]


def project_with_jacobian(points: Points, camera: Camera, body_index: float, base_z_mm: float) -> tuple[Pixels, Floats]:
    """Return `project` and `projection_jacobian` for the price of one."""
    towards, slope = _leave(points, camera, body_index, base_z_mm)
    turn = tilt_matrix(camera)
    seen = towards @ turn
    jacobian: Floats = _lens_jacobian(seen, camera) @ (turn.T @ slope)
    return _lens(seen, camera), jacobian


def rays(pixels: Pixels, camera: Camera, body_index: float, base_z_mm: float) -> tuple[Points, Points]:
    """Return the rays inside the body that end in the given places of the picture: the exact inverse of `project`.

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
        (n, 3) unit vectors from there into the body (z < 0). Both are NaN where no ray reaches the pixel.
    """
    into = _lens_inverse(pixels, camera) @ tilt_matrix(camera).T
    down = np.where(into[:, 2] < -1e-12, -into[:, 2], np.nan)
    tangent = into[:, :2] / down[:, None]
    p = np.linalg.norm(tangent, axis=1)
    air = air_gap(camera, base_z_mm)
    reach, _ = sideways(p, np.zeros(len(p)), body_index, camera.layers, air)
    # reach / p tends to the slope at p = 0; the tiny number only keeps the division quiet there.
    safe = np.maximum(p, 1e-300)
    slope0 = air + sum(layer.thickness_mm / layer.index for layer in camera.layers)
    share = np.where(p > 1e-12, reach / safe, slope0)
    origins = np.column_stack([np.asarray(camera.pupil_mm[:2]) + share[:, None] * tangent, np.full(len(p), base_z_mm)])
    inside = tangent / (body_index * np.sqrt(1 + p**2))[:, None]
    directions = np.column_stack([inside, -np.sqrt(1 - np.sum(inside**2, axis=1))])
    origins[np.isnan(directions[:, 0])] = np.nan
    return origins, directions


def air_gap(camera: Camera, base_z_mm: float) -> float:
    """Return the way from the last layer to the entrance pupil, mm.

    Raises
    ------
    RecipeError
        The pupil lies in front of the last layer.
    """
    back = base_z_mm + sum(layer.thickness_mm for layer in camera.layers)
    gap = camera.pupil_mm[2] - back
    if gap < -1e-9:
        raise RecipeError(
            f"camera.pupil_mm: z = {camera.pupil_mm[2]:.6g} mm must be at least {back:.6g} mm, behind the base and "
            "the layers: move the pupil back or thin the layers"
        )
    return max(gap, 0.0)


def sideways(
    p: Floats, depth_mm: Floats, body_index: float, layers: tuple[Layer, ...], air_mm: float
) -> tuple[Floats, Floats]:
    """Return how far rays move sideways between a depth in the body and the pupil, and the derivative.

    Parameters
    ----------
    p
        (n,) tangents of the rays' angles to z in air.
    depth_mm
        (n,) distances from the base plane into the body, mm.
    body_index, layers, air_mm
        The stack.

    Returns
    -------
    reach
        (n,) sideways distance, mm.
    slope
        (n,) d(reach)/dp, mm.
    """
    reach = air_mm * p
    slope = np.full(np.shape(p), air_mm, float)
    stack: list[tuple[Floats | float, float]] = [(depth_mm, body_index)]
    stack += [(layer.thickness_mm, layer.index) for layer in layers]
    for thickness, index in stack:
        root = np.sqrt(index**2 + (index**2 - 1) * p**2)
        reach = reach + thickness * p / root
        slope = slope + thickness * index**2 / root**3
    return reach, slope


def air_tangents(
    reach_mm: Floats, depth_mm: Floats, body_index: float, layers: tuple[Layer, ...], air_mm: float
) -> Floats:
    """Return (n,) tangents in air of the rays that move ``reach_mm`` sideways: the inverse of `sideways`.

    NaN where there is no such ray: negative depth, or too far aside when the pupil touches the layers.
    """
    reach_mm = np.asarray(reach_mm, float)
    depth_mm = np.where(np.asarray(depth_mm) >= -1e-9, np.maximum(depth_mm, 0.0), np.nan)
    if len(reach_mm) == 0:
        return np.zeros(0)
    _, steepest = sideways(np.zeros(len(reach_mm)), depth_mm, body_index, layers, air_mm)
    tolerance = 1e-13 * (1 + reach_mm)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        p = np.where(steepest > 0, reach_mm / steepest, np.nan)
        for _ in range(_ITERATIONS):
            reach, slope = sideways(p, depth_mm, body_index, layers, air_mm)
            missing = reach_mm - reach
            if not np.any(np.abs(missing) > tolerance):
                break
            p = p + missing / slope
        return np.where(np.abs(missing) <= 1e-9 * (1 + reach_mm), p, np.nan)


def transmission(p: Floats, body_index: float, layers: tuple[Layer, ...]) -> Floats:
    """Return (n,) shares of unpolarised light that pass all interfaces between air and body, 1 = straight through.

    Parameters
    ----------
    p
        (n,) tangents of the rays' angles to z in air.

    Notes
    -----
    Fresnel's formulas (Born & Wolf sec. 1.5.2), the mean of both polarisations at each interface in turn, relative to
    normal incidence, which the exposure takes up. Reflections to and fro between interfaces are left out.
    """
    indices = [body_index, *(layer.index for layer in layers), 1.0]
    sine2 = p**2 / (1 + p**2)
    share = np.ones_like(p)
    for one, two in pairwise(indices):
        # n cos(angle) on both sides; n^2 cos^2 = n^2 - sin^2(angle in air).
        a, b = np.sqrt(one**2 - sine2), np.sqrt(two**2 - sine2)
        across = ((a - b) / (a + b)) ** 2
        along = ((two**2 * a - one**2 * b) / (two**2 * a + one**2 * b)) ** 2
        straight = 1 - ((one - two) / (one + two)) ** 2
        share = share * (1 - (across + along) / 2) / straight
    return share


def tilt_matrix(camera: Camera) -> Floats:
    """Return the (3, 3) rotation from camera to body axes: turns about x, y and z, applied in this order."""
    turn = np.eye(3)
    for axis, angle in enumerate(np.deg2rad(camera.tilt_deg)):
        cosine, sine = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i] = step[j, j] = cosine
        step[i, j], step[j, i] = -sine, sine
        turn = step @ turn
    return turn


def _leave(points: Points, camera: Camera, body_index: float, base_z_mm: float) -> tuple[Points, Floats]:
    """Return (n, 3) air directions (p e, -1) in which the pupil sees the points, and their (n, 3, 3) derivatives."""
    points = np.asarray(points, float)
    air = air_gap(camera, base_z_mm)
    aside = points[:, :2] - np.asarray(camera.pupil_mm[:2])
    reach = np.linalg.norm(aside, axis=1)
    depth = base_z_mm - points[:, 2]
    p = air_tangents(reach, depth, body_index, camera.layers, air)
    _, slope = sideways(p, np.maximum(depth, 0.0), body_index, camera.layers, air)
    near = reach <= 1e-12
    unit = aside / np.where(near, 1.0, reach)[:, None]
    over = np.where(near, 1 / slope, p / np.where(near, 1.0, reach))
    towards = np.column_stack([over[:, None] * aside, np.where(np.isnan(p), np.nan, -1.0)])
    radial = unit[:, :, None] * unit[:, None, :]
    derivative = np.zeros((len(points), 3, 3))
    derivative[:, :2, :2] = over[:, None, None] * (np.eye(2) - radial) + radial / slope[:, None, None]
    body_tangent = p / np.sqrt(body_index**2 + (body_index**2 - 1) * p**2)
    derivative[:, :2, 2] = unit * (body_tangent / slope)[:, None]
    return towards, derivative


def _distort(radius: Floats, camera: Camera) -> tuple[Floats, Floats]:
    """Return r (1 + k1 r^2 + k2 r^4) and its derivative; NaN past the first fold of that curve."""
    k1, k2 = camera.distortion
    square = np.where(radius <= _fold(camera), radius**2, np.nan)
    return radius * (1 + square * (k1 + square * k2)), 1 + square * (3 * k1 + square * 5 * k2)


def _fold(camera: Camera) -> float:
    """Return the radius where the distortion stops growing: 1 + 3 k1 r^2 + 5 k2 r^4 = 0; inf if nowhere."""
    k1, k2 = camera.distortion
    roots = np.roots([5 * k2, 3 * k1, 1.0]) if k2 else np.roots([3 * k1, 1.0]) if k1 else np.zeros(0)
    positive = [float(root.real) for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
    return float(np.sqrt(min(positive))) if positive else np.inf


def _undistort(distorted: Floats, camera: Camera) -> Floats:
    """Return the radius whose distorted value is given: Newton held inside a shrinking bracket; NaN past the fold."""
    if camera.distortion == (0.0, 0.0):
        return distorted
    k1, k2 = camera.distortion
    top = min(_fold(camera), 1e3)
    low, high = np.zeros_like(distorted), np.full_like(distorted, top)
    radius = np.minimum(distorted, top)
    for _ in range(_ITERATIONS):
        square = radius**2
        excess = radius * (1 + square * (k1 + square * k2)) - distorted
        if not np.any(np.abs(excess) > 1e-14 * (1 + distorted)):
            break
        low, high = np.where(excess < 0, radius, low), np.where(excess > 0, radius, high)
        slope = 1 + square * (3 * k1 + square * 5 * k2)
        step = radius - excess / np.where(slope > 1e-12, slope, np.inf)
        radius = np.where((step > low) & (step < high) & (slope > 1e-12), step, (low + high) / 2)
    return np.where(np.abs(excess) <= 1e-9 * (1 + distorted), radius, np.nan)


def _lens(towards: Points, camera: Camera) -> Pixels:
    """Return (n, 2) px of (n, 3) directions in camera axes (right, up, backward)."""
    ahead = -towards[:, 2]
    across = np.linalg.norm(towards[:, :2], axis=1)
    pinhole = camera.lens == "pinhole"
    radius = across / np.where(ahead > 1e-12, ahead, np.nan) if pinhole else np.arctan2(across, ahead)
    image, _ = _distort(radius, camera)
    scale = camera.focal_px * np.where(across > 1e-12, image / np.maximum(across, 1e-300), 1 / ahead)
    column, row = camera.centre_px
    return np.column_stack([column + scale * towards[:, 0], row - scale * towards[:, 1]])


def _lens_jacobian(towards: Points, camera: Camera) -> Floats:
    """Return (n, 2, 3) derivatives of `_lens` with respect to the directions."""
    ahead = -towards[:, 2]
    across = np.linalg.norm(towards[:, :2], axis=1)
    near = across <= 1e-12
    unit = towards[:, :2] / np.where(near, 1.0, across)[:, None]
    if camera.lens == "pinhole":
        ahead = np.where(ahead > 1e-12, ahead, np.nan)
        radius, by_across, by_ahead = across / ahead, 1 / ahead, -across / ahead**2
    else:
        square = across**2 + ahead**2
        radius, by_across, by_ahead = np.arctan2(across, ahead), ahead / square, -across / square
    image, growth = _distort(radius, camera)
    around = np.where(near, 1 / ahead, image / np.where(near, 1.0, across))
    radial = unit[:, :, None] * unit[:, None, :]
    jacobian = np.empty((len(towards), 2, 3))
    jacobian[:, :, :2] = around[:, None, None] * (np.eye(2) - radial) + radial * (growth * by_across)[:, None, None]
    jacobian[:, :, 2] = -unit * (growth * by_ahead)[:, None]
    return jacobian * (camera.focal_px * np.array([1.0, -1.0]))[:, None]


def _lens_inverse(pixels: Pixels, camera: Camera) -> Points:
    """Return (n, 3) unit directions in camera axes that reach (n, 2) px; NaN where none does."""
    column, row = camera.centre_px
    flat = (np.asarray(pixels, float) - [column, row]) * [1.0, -1.0] / camera.focal_px
    image = np.linalg.norm(flat, axis=1)
    radius = _undistort(image, camera)
    angle = np.arctan(radius) if camera.lens == "pinhole" else np.where(radius < np.pi, radius, np.nan)
    unit = flat / np.where(image > 0, image, 1.0)[:, None]
    return np.column_stack([unit * np.sin(angle)[:, None], -np.cos(angle)])
