"""Between camera and computer: interlaced composite video, and compressed pictures.

Composite video carries luminance Y and two colour signals I and Q of less bandwidth (SMPTE 170M); its pictures are two
fields, each of every other line, each line the sum of two lines of pixels (so that neither field leaves light unused),
one field after the other.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from twin.arrays import Floats, Picture

ACTIVE_US = 52.66
"""Time that the visible part of a line takes."""

YIQ = np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
"""Luminance and colour signals of red, green and blue."""


def spreads_px(bandwidth_mhz: tuple[float, float, float], width: int) -> Floats:
    """Return the standard deviations of three Gaussian filters that stand for a composite line's bandwidths, px.

    Notes
    -----
    Half the power passes at the bandwidth, exp(-2 pi^2 s^2 f^2) = 1/sqrt 2.
    """
    spreads: Floats = np.sqrt(np.log(2)) / (2 * np.pi * np.asarray(bandwidth_mhz)) * width / ACTIVE_US
    return spreads


def compress(counts: Picture, quality: int) -> Picture:
    """Return what is left of a picture after JPEG compression."""
    from PIL import Image

    stream: Any = io.BytesIO()
    Image.fromarray(counts).save(stream, "JPEG", quality=quality)
    stream.seek(0)
    return np.array(Image.open(stream).convert("RGB"))
