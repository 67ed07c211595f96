"""What each pixel shows: the truth beside the picture, by the rays through the pixels' middles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Pixels, Singles
from twin.compiled import njit
from twin.world.picture.crowded import hits_of_sample, most_candidates, pixel_candidates, pixel_rays
from twin.world.picture.frame import Frame
from twin.world.picture.nearby import Whole
from twin.world.picture.threads import in_parts

NONE = -1
"""No marker."""


@dataclass(frozen=True, kw_only=True)
class PictureTruth:
    """The truth beside a picture; arrays over markers are in their one order.

    Attributes
    ----------
    marker
        (height, width) number of the marker that the middle of each pixel shows, -1 for none.
    layer
        (height, width) number of its layer in the scene's order, -1 for none.
    z_mm
        (height, width) height z of the place that is seen, NaN where no marker is.
    centre_px
        (n, 2) projected centres; NaN where the camera doesn't see the place: ``sight`` says why.
    outline_px
        (n, 2) coverage centroids of the visible outlines; NaN where nothing is seen.
    visible
        (n,) share of each outline that is seen.
    area_px
        (n,) area that is seen, px^2.
    flow_px
        (n, 2) motion since rest of the centres in the picture.
    outline_flow_px
        (n, 2) motion since rest of the outlines' centroids: what a tracker can find.
    depth_mm
        (n,) distance of the centres from the base, along z.
    sight
        (n,) numbers of `twin.theory.optics.Sight`.
    centroid_error_px
        Bound on the error of the picture's intensity centroids.
    """

    marker: Whole
    layer: NDArray[np.int8]
    z_mm: Singles
    centre_px: Pixels
    outline_px: Pixels
    visible: Floats
    area_px: Floats
    flow_px: Pixels
    outline_flow_px: Pixels
    depth_mm: Floats
    sight: Ints
    centroid_error_px: float


def marker_map(frame: Frame, corners: Floats, base_z_mm: float) -> tuple[Whole, Singles]:
    """Return (height, width) numbers of the markers that pixels' middles show, and the heights z of those places.

    ``corners`` are the rays of `twin.world.picture.splat.Splat`.
    """
    near, size = frame.near, (corners.shape[1] - 1, corners.shape[2] - 1)
    shown, heights = np.full(len(near.pixels), NONE, np.int32), np.full(len(near.pixels), np.nan, np.float32)
    in_parts(len(near.pixels), lambda _, begin, end: _front(
        begin, end, near.pixels, near.first, near.members, corners, frame.base, frame.centres, frame.metric,
        shown, heights))  # fmt: skip
    marker = np.full(size, NONE, np.int32)
    z_mm = np.full(size, np.nan, np.float32)
    marker.ravel()[near.pixels] = shown
    z_mm.ravel()[near.pixels] = (heights - frame.base) * frame.unit_mm + base_z_mm
    return marker, z_mm


@njit(cache=True, nogil=True)
def _front(
    begin: int, end: int, pixels: Ints, first: Whole, members: Whole, corners: Floats, base: float,
    centres: Floats, metric: Floats, shown: Whole, heights: Singles,
) -> None:  # fmt: skip
    """Write the nearest marker on each pixel's middle ray and the height of the place where it is met."""
    room = most_candidates(begin, end, first)
    near, order = np.empty(room, np.int64), np.empty(room, np.int64)
    meet = np.empty((room, 7))
    width = corners.shape[2] - 1
    for j in range(begin, end):
        middle, across, down = pixel_rays(pixels[j] // width, pixels[j] % width, corners)
        found, _ = pixel_candidates(first[j], first[j + 1], members, base, centres, metric, 1, near, middle, across,
                                    down)  # fmt: skip
        hits = hits_of_sample(found, near, base, centres, metric, middle, across, down, 1, meet, order)  # fmt: skip
        for h in range(hits):
            # Half covered is where the ray just meets the outline.
            if meet[order[h], 0] >= 0.5:
                shown[j] = near[order[h]]
                heights[j] = meet[order[h], 3]
                break
