"""The picture without Mitsuba: every pixel meets the few ellipsoids whose outlines come near it, in closed form.

The sums are those of `twin.world.picture.wavefront`, three things cheaper. A pixel knows its candidates, so nothing is
searched, and those of one marker go through vector instructions (`twin.world.picture.lanes`). A pixel inside one
marker's outline takes one ray where edges take k x k: shading is smooth. And the edge of a shadow is smoothed as the
edge of a marker is, by the ray's distance to the silhouette of what blocks it, so that it needs no finer grid. All in
numba, and rays are told from the marker that they meet: thin or far markers lose nothing.

Outlines come from the same hits, in one pass with the picture or alone, and are the truth beside traced pictures too.

Threads work on separate pixels, and tallies are whole numbers: the number of threads changes no bit.

Validity: as in `twin.world.picture.render`; several shadows on one place multiply, as if what blocks were unrelated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, Singles
from twin.world.picture.crowded import shade_crowded
from twin.world.picture.frame import Frame
from twin.world.picture.lanes import shade_alone
from twin.world.picture.threads import in_parts
from twin.world.picture.view import View

_INTERIOR = 3
"""The grid of an edge is so many times finer than inside an outline."""


@dataclass(frozen=True, kw_only=True)
class Shaded:
    """What a frame's pixels show.

    Attributes
    ----------
    light
        (m, 3) light from markers.
    free
        (m,) share of each pixel that they leave free.
    whole, seen
        (n,) coverage of every marker, all of it and what nothing hides, in sub-pixels times ``WEIGHT``.
    moments
        (n, 2) columns and rows of what is seen, from the sub-pixels' corners of the pixel nearest the marker.
    """

    light: Singles
    free: Singles
    whole: Ints
    seen: Ints
    moments: Ints


class Splat:
    """Camera and shadow rays of all pixels, on all cores."""

    def __init__(self, view: View, unit_mm: float, ambient: float) -> None:
        self.corners = np.ascontiguousarray(np.moveaxis(view.corners / [unit_mm, unit_mm, 1, 1], 2, 0))
        """(4, height + 1, width + 1) rays through pixels' corners, of `View`, x and y in units of ``unit_mm``."""
        self._ambient = ambient

    def shade(self, frame: Frame) -> tuple[Singles, Singles]:
        """Return (m, 3) light from markers in the frame's pixels, and (m,) the share of each that they leave free."""
        shaded = self.look(frame)
        return shaded.light, shaded.free

    def look(self, frame: Frame, *, bright: bool = True) -> Shaded:
        """Return light and outlines; without ``bright`` the light is none."""
        near, lists, k = frame.near, frame.occluders, frame.subpixels
        light, free = np.empty((len(near.pixels), 3), np.float32), np.empty(len(near.pixels), np.float32)
        nearest = np.rint(near.centres_px).astype(np.int64)
        own = int(near.alone[-1])
        lit = (self.corners, frame.base, frame.centres, frame.metric, frame.colour, frame.lamps, lists.first,
               lists.members, nearest, k, max(k // _INTERIOR, 1), self._ambient, bright)  # fmt: skip

        def alone(_: int, begin: int, end: int) -> Any:
            tallies = np.zeros((len(frame), 4))
            shade_alone(begin, end, near.pixels, near.alone, *lit, light, free, tallies)
            return tallies

        def crowded(_: int, begin: int, end: int) -> Any:
            tallies = np.zeros((len(frame), 4))
            shade_crowded(own + begin, own + end, near.pixels, near.first, near.members, *lit, light, free, tallies)
            return tallies

        parts = in_parts(len(frame), alone) + in_parts(len(near.pixels) - own, crowded)
        tallies: Floats = np.sum(parts, axis=0)
        whole, seen, columns, rows = tallies.astype(np.int64).T
        return Shaded(light=light, free=free, whole=whole, seen=seen, moments=np.column_stack([columns, rows]))
