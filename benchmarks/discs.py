"""A renderer for tests and benchmarks, apart from the tracker's model and from the twin's: discs by area.

Every pixel is cut into 10 x 10 pieces, of which those on an edge count by their share inside; the fine picture is
blurred by a Gaussian (scipy) and binned. Nothing of an edge's profile is assumed. Blur and binning act along rows and
columns alike, so both are one matrix, and only the pieces that a disc can cover are drawn.
"""

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

FINE = 10
GROUND_DN = 30.0
READ_NOISE_DN = 1.5
ELECTRONS_PER_DN = 20000 / 255


def cover(size, centres, diameter, psf, shade=None, stretch=None):
    """Share of light (h, w) that discs send; ``shade(dx, dy, x, y)`` is the brightness about a centre, 1 if None;
    ``stretch`` (n, 2, 2) maps each disc to an ellipse."""
    width, height = size
    whole = np.zeros((height, width))
    longest = 1.0 if stretch is None else np.linalg.norm(stretch, 2, axis=(1, 2)).max()
    radius = longest * diameter / 2
    half = int(np.ceil(radius + 5 * psf + 2))
    steps, blur = _steps(half), _blur(half, psf)
    for number, (x, y) in enumerate(centres):
        if not np.isfinite(x + y):
            continue
        column, row = round(x), round(y)
        across, along = steps - (x - column), steps - (y - row)
        near_x, near_y = (np.abs(off) < radius + 1 / FINE for off in (across, along))
        dx, dy = across[None, near_x], along[near_y, None]
        inside = np.clip(0.5 + FINE * _depth(dx, dy, diameter / 2, None if stretch is None else stretch[number]), 0, 1)
        if shade is not None:
            inside *= shade(dx, dy, x, y)
        part = blur[:, near_y] @ inside @ blur[:, near_x].T
        left, top = column - half, row - half
        columns = slice(max(left, 0), min(left + 2 * half + 1, width))
        rows = slice(max(top, 0), min(top + 2 * half + 1, height))
        whole[rows, columns] += part[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return whole


def _depth(dx, dy, radius, stretch):
    """Distance inside the outline, px; near an ellipse's by its gradient."""
    if stretch is None:
        return radius - np.sqrt(dx**2 + dy**2)
    back = np.linalg.inv(stretch)
    ux, uy = back[0, 0] * dx + back[0, 1] * dy, back[1, 0] * dx + back[1, 1] * dy
    away = np.hypot(ux, uy) + 1e-9
    steep = np.hypot(back[0, 0] * ux + back[1, 0] * uy, back[0, 1] * ux + back[1, 1] * uy) / away
    return (radius - away) / np.maximum(steep, 1e-9)


@cache
def _steps(half):
    """Middles of the pieces about a pixel's centre, px."""
    return (np.arange((2 * half + 1) * FINE) + 0.5) / FINE - 0.5 - half


@cache
def _blur(half, psf):
    """Matrix (pixels, pieces) that blurs the pieces of a line and bins them to pixels."""
    pieces = np.eye((2 * half + 1) * FINE)
    fine = gaussian_filter1d(pieces, psf * FINE, axis=0) if psf > 0 else pieces
    return fine.reshape(2 * half + 1, FINE, -1).mean(axis=1)


def scene(size, layers, diameter, psf=0.7, contrast=130.0, shade=None):
    """Noise-free (h, w, 3): each of ``layers`` [(centres, channel)] adds ``contrast`` counts in its channel."""
    picture = np.full((size[1], size[0], 3), GROUND_DN)
    for centres, channel in layers:
        picture[..., channel] += contrast * cover(size, centres, diameter, psf, shade)
    return picture


def expose(picture, seed):
    """8-bit counts with shot and read noise."""
    random = np.random.default_rng(seed)
    counts = random.poisson(np.maximum(picture, 0) * ELECTRONS_PER_DN) / ELECTRONS_PER_DN
    return np.clip(np.rint(counts + random.normal(0, READ_NOISE_DN, picture.shape)), 0, 255).astype(np.uint8)


def bound_px(diameter, contrast=130.0):
    """Cramer-Rao bound of one centre coordinate, px, all else known, all three channels used; mean over the phases."""
    size, step = (int(diameter) + 22,) * 2, 0.1
    found = []
    for phase in (0.0, 0.25, 0.5):
        middle = np.array([[size[0] // 2 + phase, size[1] // 2 + 0.3]])
        ends = (middle + np.array([[d, 0.0]]) for d in (step / 2, -step / 2))
        right, left = (contrast * cover(size, end, diameter, 0.7) for end in ends)
        slope, mean = (right - left) / step, GROUND_DN + (right + left) / 2
        found.append((slope**2 / (mean / ELECTRONS_PER_DN + READ_NOISE_DN**2 + 1 / 12)).sum())
    return 1 / np.sqrt(np.mean(found))
