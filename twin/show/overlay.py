"""A frame with what the sensor's software made of it drawn in: every marker's motion, and the total force in words."""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Picture, Pixels

SEEN, LOST, TEXT = (120, 255, 120), (255, 210, 0), (255, 255, 255)


def overlay(picture: Picture, rest_px: Pixels, shift_px: Pixels, seen: Bools, text: str) -> Picture:
    """Return an (h, w, 3) picture with a line from every marker's rest position (dot) to where it is, true to scale.

    Parameters
    ----------
    picture
        (h, w, 3) or (h, w) uint8.
    rest_px, shift_px, seen
        (n, 2), (n, 2), (n,): lost markers are circles at their rest positions.
    text
        One line at the top.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture).convert("RGB")
    draw = ImageDraw.Draw(image)
    for (x, y), (dx, dy), fine in zip(rest_px, shift_px, seen, strict=True):
        if not np.isfinite(x + y):
            continue
        if fine:
            draw.line((x, y, x + dx, y + dy), fill=SEEN)
            draw.point((x, y), fill=TEXT)
        else:
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), outline=LOST)
    draw.rectangle((0, 0, image.width, 13), fill=(0, 0, 0))
    draw.text((3, 1), text, fill=TEXT)
    return np.array(image)
