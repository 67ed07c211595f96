"""Marker motion drawn into pictures: of one frame, or of samples of a dataset on one sheet."""

from __future__ import annotations

import base64
import html
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Picture, Pixels
from twin.show.html_page import figure

LOST, TEXT = (255, 210, 0), (255, 255, 255)
BY_STATE = {
    "seen": (120, 255, 120),
    "strained": (90, 220, 255),
    "partly hidden": (255, 130, 40),
    "ambiguous": (255, 90, 255),
}
"""Colours of markers by their state; others are lost."""


class _Motion(Protocol):
    """What a tracker found: (n, 2) rest places and shifts, px, (n,) whether it was seen, and
    states."""

    @property
    def rest_px(self) -> Pixels: ...
    @property
    def shift_px(self) -> Pixels: ...
    @property
    def seen(self) -> Bools: ...
    @property
    def states(self) -> NDArray[np.str_]: ...


def overlay(picture: Picture, found: _Motion | None, text: str) -> Picture:
    """Return an (h, w, 3) or (h, w) picture in colour, with a line of text and, if markers were
    found, a line from every one's rest place (dot) to where it is, true to scale; those without a
    shift are circles. Colours tell the states."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture).convert("RGB")
    draw = ImageDraw.Draw(image)
    rows = (found.rest_px, found.shift_px, found.seen, found.states) if found else ()
    for (x, y), (dx, dy), fine, state in zip(*rows, strict=True):
        if not np.isfinite(x + y):
            continue
        colour = BY_STATE.get(str(state), LOST)
        if fine:
            draw.line((x, y, x + dx, y + dy), fill=colour)
            draw.point((x, y), fill=TEXT)
        else:
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), outline=colour)
    draw.rectangle((0, 0, image.width, 13), fill=(0, 0, 0))
    draw.text((3, 1), text, fill=TEXT)
    return np.array(image)


GAIN = 4.0
"""Times by which the markers' shifts of `sample_figure` are drawn longer."""


def sample_figure(
    title: str, png: bytes | None, size_px: tuple[int, int], shifts_px: Floats, contact_px: Pixels
) -> str:
    """Return a sample of a dataset as a figure (HTML).

    Parameters
    ----------
    title
        Number, probe and force, in words.
    png, size_px
        The picture, None where there is none, and its width and height.
    shifts_px
        (n, 4) rest and pressed places of the markers.
    contact_px
        (k, 2) places in contact, seen by the camera.
    """
    width, height = size_px
    parts = []
    if png is not None:
        data = base64.b64encode(png).decode()
        parts.append(
            f'<image href="data:image/png;base64,{data}" width="{width}" height="{height}"/>'
        )
    parts += [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="#fd0" opacity=".55"/>'
        for x, y in _finite(contact_px)
    ]
    steps = "".join(
        f"M{a:.1f} {b:.1f}L{a + GAIN * (c - a):.1f} {b + GAIN * (d - b):.1f}"
        for a, b, c, d in _finite(shifts_px)
    )
    parts.append(f'<path d="{steps}" stroke="#4f8" stroke-width="1.6"/>')
    box = f'style="background:#111" viewBox="-0.5 -0.5 {width} {height}"'
    return figure(f"<svg {box}>{''.join(parts)}</svg>", html.escape(title))


def _finite(rows: Floats) -> Any:
    return rows[np.isfinite(rows).all(axis=1)] if len(rows) else rows
