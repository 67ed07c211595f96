"""Test pictures: anti-aliased elliptic discs with known sub-pixel centres, re-rendered for every shift."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

RED = (200.0, 14.0, 10.0)
BLUE = (10.0, 18.0, 200.0)
GROUND_DN = 8.0
READ_NOISE_DN = 1.5
ELECTRONS_PER_DN = 20000 / 255


def clean_picture(size, layers, *, diameter, psf=0.7, shading=0.0, rear_first=True):
    """Noise-free (h, w, 3) picture. ``layers`` is [(centres (n, 2), colour)], later ones in front; NaN is left out.

    The edge of a disc blurred by a Gaussian is the straight edge's error function to second order in psf / radius;
    ``shading`` is the relative brightness change per marker radius, along a direction that differs by marker.
    """
    width, height = size
    picture = np.full((height, width, 3), GROUND_DN)
    radius = diameter / 2
    for centres, colour in layers:
        for number, (x, y) in enumerate(centres):
            if not np.isfinite(x + y):
                continue
            half = int(np.ceil(radius + 5 * psf + 2))
            c0, r0 = round(x) - half, round(y) - half
            columns = np.arange(max(c0, 0), min(c0 + 2 * half + 1, width))
            rows = np.arange(max(r0, 0), min(r0 + 2 * half + 1, height))
            if not len(columns) or not len(rows):
                continue
            sub = (np.arange(5) - 2) / 5
            dx = (columns[:, None] + sub).ravel() - x
            dy = (rows[:, None] + sub).ravel() - y
            distance = np.hypot(dx[None, :], dy[:, None])
            cover = ndtr((radius - distance) / psf)
            angle = 0.7 * number
            bright = 1 + shading / radius * (np.cos(angle) * dx[None, :] + np.sin(angle) * dy[:, None])
            shape = (len(rows), 5, len(columns), 5)
            cover, lit = (v.reshape(shape).mean(axis=(1, 3)) for v in (cover, cover * np.maximum(bright, 0)))
            part = picture[np.ix_(rows, columns)]
            picture[np.ix_(rows, columns)] = part * (1 - cover[..., None]) + lit[..., None] * np.array(colour)
    return picture


def expose(picture, seed):
    """8-bit counts with shot and read noise."""
    random = np.random.default_rng(seed)
    electrons = random.poisson(picture * ELECTRONS_PER_DN)
    counts = electrons / ELECTRONS_PER_DN + random.normal(0, READ_NOISE_DN, picture.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def flat_layout(columns=10, rows=8, pitch=30.0, origin=(40.0, 40.0)):
    """Red grid and blue grid at half a pitch inside it, as in the flat sensor."""
    red = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1).reshape(-1, 2)
    blue = np.stack(np.meshgrid(np.arange(columns - 1), np.arange(rows - 1), indexing="ij"), -1).reshape(-1, 2)
    return {"red": red * pitch + origin, "blue": (blue + 0.5) * pitch + origin}


def render(layout, shift, *, size, diameter, seed=None, **options):
    """Picture of both layers of ``layout`` moved by ``shift`` {layer: (n, 2)} (blue in the rear); uint8 if seeded."""
    layers = [(layout[name] + shift.get(name, 0.0), RED if name == "red" else BLUE) for name in ("blue", "red")]
    picture = clean_picture(size, layers, diameter=diameter, **options)
    return picture if seed is None else expose(picture, seed)


def centre_bound_px(diameter, psf=0.7):
    """Cramer-Rao bound of one centre coordinate, px, all else known, from all three channels."""
    step = 0.02
    size = (int(diameter) + 21,) * 2
    middle = np.array([[size[0] / 2, size[1] / 2]])
    right, left = (
        clean_picture(size, [(middle + np.array([d, 0]), RED)], diameter=diameter, psf=psf)
        for d in (step / 2, -step / 2)
    )
    slope, mean = (right - left) / step, 0.5 * (right + left)
    variance = mean / ELECTRONS_PER_DN + READ_NOISE_DN**2 + 1 / 12
    return 1 / np.sqrt((slope**2 / variance).sum())
