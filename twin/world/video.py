"""Between camera and computer: interlaced composite video, and compressed pictures.

Composite video carries luminance Y and two colour signals I and Q of less bandwidth (SMPTE 170M); its pictures are two
fields, each of every other line, each line the sum of two lines of pixels, one field after the other.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from twin.arrays import Floats, Picture, Singles

ACTIVE_US = 52.66
"""Time that the visible part of a line takes."""

_YIQ = np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])


def interlace(second: Singles, first: Singles) -> Singles:
    """Weave two fields: even lines from ``first``, the light of a field before, odd ones from ``second``.

    Parameters
    ----------
    second, first
        (height, width, 3) light while each field was exposed; the same for what stands still.

    Notes
    -----
    A line of a field holds the charges of two lines of pixels, its own and the next, so that neither field leaves light
    unused; the mean of both is returned.
    """
    woven = np.empty_like(second)
    for field, light in ((0, first), (1, second)):
        below = np.concatenate([light[1:], light[-1:]])
        woven[field::2] = (light[field::2] + below[field::2]) / 2
    return woven


def composite(shares: Singles, bandwidth_mhz: tuple[float, float, float]) -> Singles:
    """Return what a composite line keeps of (height, width, 3) gamma-corrected red, green and blue.

    Notes
    -----
    Gaussian filters that let half the power pass at the bandwidth, exp(-2 pi^2 s^2 f^2) = 1/sqrt 2.
    """
    signals = shares @ _YIQ.T.astype(np.float32)
    for i, spread in enumerate(spreads_px(bandwidth_mhz, shares.shape[1])):
        signals[..., i] = gaussian_filter1d(signals[..., i], spread, axis=1, mode="nearest")
    mixed: Singles = signals @ np.linalg.inv(_YIQ).T.astype(np.float32)
    return mixed


def spreads_px(bandwidth_mhz: tuple[float, float, float], width: int) -> Floats:
    """Return the three filters' standard deviations, px."""
    spreads: Floats = np.sqrt(np.log(2)) / (2 * np.pi * np.asarray(bandwidth_mhz)) * width / ACTIVE_US
    return spreads


def compress(counts: Picture, quality: int) -> Picture:
    """Return what is left of a picture after JPEG compression."""
    from PIL import Image

    stream: Any = io.BytesIO()
    Image.fromarray(counts).save(stream, "JPEG", quality=quality)
    stream.seek(0)
    return np.array(Image.open(stream).convert("RGB"))
