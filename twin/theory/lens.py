"""The lens in closed form: directions in the camera's axes to pixels and back, with derivatives.

A lens maps the angle of a direction to a radius in the picture: its tangent for a pinhole, itself
for an equidistant fisheye (`RADIAL`). Two families bend that map, in OpenCV's terms and order of
coefficients:

- pinhole, Brown-Conrady: r (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), plus
  the decentring 2 p1 x y + p2 (r^2 + 2 x^2) in x and p1 (r^2 + 2 y^2) + 2 p2 x y in y, x to the
  right and y *down* (Brown, Photogrammetric Eng. 32, 1966);
- equidistant, Kannala-Brandt: a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8) (IEEE Trans. PAMI 28,
  2006).

Validity: up to the first fold of the radial map, where it stops growing: nothing is shown twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Pixels, Points
from twin.parts.camera import Camera


@dataclass(frozen=True)
class Radial:
    """What a lens makes of the angle of a direction to its axis, before any distortion.

    Attributes
    ----------
    radius, slopes
        From how far directions go across and ahead, (n,) each, to the radius in the picture over
        the focal length; the derivatives with respect to both.
    angle
        From the radius to the angle, radians; NaN where there is none.
    """

    radius: Callable[[Floats, Floats], Floats]
    slopes: Callable[[Floats, Floats], tuple[Floats, Floats]]
    angle: Callable[[Floats], Floats]


def _ahead(ahead: Floats) -> Floats:
    """Return how far directions go ahead; NaN for those that don't."""
    return np.where(ahead > 1e-12, ahead, np.nan)


RADIAL: dict[str, Radial] = {
    "pinhole": Radial(
        radius=lambda across, ahead: across / _ahead(ahead),
        slopes=lambda across, ahead: (1 / _ahead(ahead), -across / _ahead(ahead) ** 2),
        angle=np.arctan,
    ),
    "equidistant": Radial(
        radius=np.arctan2,
        slopes=lambda across, ahead: (
            ahead / (across**2 + ahead**2),
            -across / (across**2 + ahead**2),
        ),
        angle=lambda radius: np.where(radius < np.pi, radius, np.nan),
    ),
}
"""By the name of the lens."""

_ITERATIONS = 60
_NEWTON = 20
_NONE = 1e-30
"""A coefficient this small bends nothing, and quotients of such overflow."""


def lens(towards: Points, camera: Camera) -> Pixels:
    """Return where the lens shows directions.

    Parameters
    ----------
    towards
        (n, 3) directions of any length in the camera's axes: right, up, backward.
    camera
        Kind, focal length, centre, aspect and distortion of the lens.

    Returns
    -------
    (n, 2) column and row, px; NaN where the lens shows nothing.
    """
    radius, across, ahead = _radius(towards, camera)
    undistorted = _around(radius, across, ahead)[:, None] * towards[:, :2]
    if not any(camera.distortion):
        return _to_pixels(undistorted, camera)
    image, growth = _radial(radius, camera)
    flat = _around(image, across, ahead)[:, None] * towards[:, :2]
    more, slope = _decentring(undistorted, camera)
    one_to_one = growth > 0
    if slope is not None:
        one_to_one &= np.linalg.det(_distortion_jacobian(undistorted, radius, camera)) > 0
    return np.where(one_to_one[:, None], _to_pixels(flat + more, camera), np.nan)


def lens_jacobian(towards: Points, camera: Camera) -> Floats:
    """Return (n, 2, 3) derivatives of `lens` with respect to the directions, px for a direction's
    unit; for the parameters see there."""
    radius, across, ahead = _radius(towards, camera)
    by_across, by_ahead = RADIAL[camera.lens].slopes(across, ahead)
    unit = towards[:, :2] / np.where(across > 1e-12, across, 1.0)[:, None]
    # First to the undistorted place in the picture, then through the distortion.
    first = np.empty((len(towards), 2, 3))
    first[:, :, :2] = stretches(unit, by_across, _around(radius, across, ahead))
    first[:, :, 2] = -unit * by_ahead[:, None]
    if any(camera.distortion):
        first = _distortion_jacobian(radius[:, None] * unit, radius, camera) @ first
    return first * (camera.focal_px * np.array([1.0, -camera.aspect]))[:, None]


def _distortion_jacobian(place: Floats, radius: Floats, camera: Camera) -> Floats:
    """Return (n, 2, 2) derivatives of distorted places, undistorted ones being ``radius`` off the
    axis."""
    image, growth = _radial(radius, camera)
    stretch = np.where(radius > 1e-12, image / np.maximum(radius, 1e-300), 1.0)
    _, slope = _decentring(place, camera)
    radial = stretches(place / np.where(radius > 1e-12, radius, 1.0)[:, None], growth, stretch)
    return radial if slope is None else radial + slope


def lens_inverse(pixels: Pixels, camera: Camera) -> Points:
    """Return the directions that the lens shows at places in the picture.

    Parameters
    ----------
    pixels
        (n, 2) column and row, px.
    camera
        As for `lens`.

    Returns
    -------
    (n, 3) unit directions in the camera's axes; NaN where none reaches the place.
    """
    column, row = camera.centre_px
    flat = (np.asarray(pixels, float) - [column, row]) / [
        camera.focal_px,
        -camera.focal_px * camera.aspect,
    ]
    flat = _without_decentring(flat, camera)
    image = np.linalg.norm(flat, axis=1)
    radius = _undistort(image, camera)
    angle = RADIAL[camera.lens].angle(radius)
    unit = flat / np.where(image > 0, image, 1.0)[:, None]
    return np.column_stack([unit * np.sin(angle)[:, None], -np.cos(angle)])


def _fold(camera: Camera) -> float:
    """Return the radius (tan of the angle, or angle) where the radial map stops growing; inf if
    nowhere."""
    up, down = _polynomials(camera)
    # g = r U(s) / D(s) with s = r^2: g' D^2 = U D + 2 s (U' D - U D').
    s = np.polynomial.Polynomial([0.0, 1.0])
    slope = up * down + 2 * s * (up.deriv() * down - up * down.deriv())
    places = np.concatenate([slope.trim().roots(), down.trim().roots()])
    real = [
        float(root.real)
        for root in places
        if abs(root.imag) < 1e-9 * max(abs(root), 1) and root.real > 0
    ]
    return float(np.sqrt(min(real))) if real else np.inf


def _radius(towards: Points, camera: Camera) -> tuple[Floats, Floats, Floats]:
    """Return the undistorted radius, and how far directions go across and ahead."""
    ahead = -towards[:, 2]
    across = np.linalg.norm(towards[:, :2], axis=1)
    return RADIAL[camera.lens].radius(across, ahead), across, ahead


def _around(radius: Floats, across: Floats, ahead: Floats) -> Floats:
    """Return radii over how far directions go across; their limit on the axis, NaN behind the
    camera."""
    on_axis = across <= 1e-12
    return np.where(on_axis, 1 / _ahead(ahead), radius / np.where(on_axis, 1.0, across))


def _to_pixels(flat: Floats, camera: Camera) -> Pixels:
    column, row = camera.centre_px
    scale = camera.focal_px
    pixels = np.empty((len(flat), 2))
    pixels[:, 0] = column + scale * flat[:, 0]
    pixels[:, 1] = row - scale * camera.aspect * flat[:, 1]
    return pixels


def _polynomials(camera: Camera) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Return numerator and denominator of the radial stretch in the squared radius."""
    coefficients = [k if abs(k) > _NONE else 0.0 for k in [*camera.distortion, *[0.0] * 8][:8]]
    if camera.lens == "equidistant":
        return np.polynomial.Polynomial([1.0, *coefficients[:4]]), np.polynomial.Polynomial([1.0])
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    return np.polynomial.Polynomial([1.0, k1, k2, k3]), np.polynomial.Polynomial([1.0, k4, k5, k6])


def _radial(radius: Floats, camera: Camera) -> tuple[Floats, Floats]:
    """Return the distorted radius and its derivative; NaN past the fold."""
    if not any(camera.distortion):
        return radius, np.ones_like(radius)
    up, down = _polynomials(camera)
    square = np.where(radius <= _fold(camera), radius**2, np.nan)
    top, bottom = up(square), down(square)
    growth = (
        top * bottom + 2 * square * (up.deriv()(square) * bottom - top * down.deriv()(square))
    ) / bottom**2
    return radius * top / bottom, growth


def _undistort(distorted: Floats, camera: Camera) -> Floats:
    """Return the radius of a distorted one, by Newton in a shrinking bracket; NaN past the fold."""
    if not any(camera.distortion):
        return distorted
    top = min(_fold(camera), 1e3)
    low = np.zeros_like(distorted)
    high = np.full_like(distorted, top)
    radius = np.minimum(distorted, top)
    excess = np.full_like(distorted, np.nan)
    for _ in range(_ITERATIONS):
        image, slope = _radial(radius, camera)
        excess = image - distorted
        if not np.any(np.abs(excess) > 1e-14 * (1 + distorted)):
            break
        low = np.where(excess < 0, radius, low)
        high = np.where(excess > 0, radius, high)
        step = radius - excess / np.where(slope > 1e-12, slope, np.inf)
        radius = np.where((step > low) & (step < high) & (slope > 1e-12), step, (low + high) / 2)
    return np.where(np.abs(excess) <= 1e-9 * (1 + distorted), radius, np.nan)


def stretches(unit: Floats, along: Floats, across: Floats) -> Floats:
    """Return (n, 2, 2) stretches by factors (n,) along (n, 2) unit vectors and across them."""
    matrices: Floats = (along - across)[:, None, None] * (unit[:, :, None] * unit[:, None, :])
    matrices[:, 0, 0] += across
    matrices[:, 1, 1] += across
    return matrices


def _decentring(place: Floats, camera: Camera) -> tuple[Floats, Floats | None]:
    """Return (n, 2) decentring of places (x right, y up) and its (n, 2, 2) derivatives; None for
    none."""
    p1, p2 = (
        camera.distortion[2:4]
        if len(camera.distortion) > 2 and camera.lens == "pinhole"
        else (0.0, 0.0)
    )
    if p1 == 0 and p2 == 0:
        return np.zeros_like(place), None
    x, y = place[:, 0], place[:, 1]
    # OpenCV's y points down: p1 changes its sign here.
    more = np.column_stack(
        [-2 * p1 * x * y + p2 * (3 * x**2 + y**2), 2 * p2 * x * y - p1 * (x**2 + 3 * y**2)]
    )
    slope = np.empty((len(place), 2, 2))
    slope[:, 0, 0], slope[:, 0, 1] = -2 * p1 * y + 6 * p2 * x, -2 * p1 * x + 2 * p2 * y
    slope[:, 1, 0], slope[:, 1, 1] = 2 * p2 * y - 2 * p1 * x, 2 * p2 * x - 6 * p1 * y
    return more, slope


def _without_decentring(flat: Floats, camera: Camera) -> Floats:
    """Return (n, 2) places without decentring: Newton from the undecentred guess."""
    if _decentring(np.zeros((1, 2)), camera)[1] is None:
        return flat
    image = np.linalg.norm(flat, axis=1)
    start: Floats = np.nan_to_num(_undistort(image, camera), nan=0.0)
    place = flat * (start / np.where(image > 0, image, 1.0))[:, None]
    for _ in range(_NEWTON):
        radius = np.linalg.norm(place, axis=1)
        image, _ = _radial(radius, camera)
        around = np.where(radius > 1e-12, image / np.maximum(radius, 1e-300), 1.0)
        more, _ = _decentring(place, camera)
        excess = around[:, None] * place + more - flat
        if not np.any(np.abs(excess) > 1e-15 * (1 + np.abs(flat))):
            break
        both = _distortion_jacobian(place, radius, camera)
        determinant = np.linalg.det(both)
        both[~(determinant > 1e-9)] = np.nan
        place = place - np.einsum("nij,nj->ni", np.linalg.inv(both), excess)
    good = np.abs(excess).max(axis=1) <= 1e-12 * (1 + np.abs(flat).max(axis=1))
    return np.where(good[:, None], around[:, None] * place, np.nan)
