"""Marker motion between the rest picture and another: `track`, or `analyse_rest` once and `track_frame` for each.

Why two steps: everything about the rest picture (colours, sizes, who is who, neighbours) is worked out once and serves
a whole sequence. Markers keep their rows; one that can't be seen, has merged with another, or is partly hidden is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Picture, Pixels, frozen
from twin.errors import InputError
from twin.sense.cells import cell_centroids
from twin.sense.detect import Blobs, find_blobs
from twin.sense.match import follow
from twin.sense.rest import CROWDED, CROWDED_SD_PX, Group, Method, Rest, analyse_rest, crowd_level
from twin.sense.split import Weights, as_picture, project

__all__ = ["Found", "analyse_rest", "track", "track_frame"]

AREA_RATIO = (0.6, 1.7)
"""Allowed change of a marker's area against rest: less is partly hidden, more has merged."""

LEVEL_RATIO = (0.3, 3.0)
"""Allowed change of a marker's brightness against rest."""

HIDDEN_AREA = 0.92
"""A crowded marker below this share of its area at rest counts as hidden."""

CELLS_SD_PX = 0.07
"""What the two-pass centroid is good for with a pitch-wide cell, px (no estimate of its own exists)."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """Marker motion in one picture; rows are the markers, layers concatenated in the layout's order.

    Attributes
    ----------
    rest_px
        (N, 2) centres in the rest picture, px; NaN where not found.
    shift_px
        (N, 2) motion since, px (column, row); NaN where lost.
    sd_px
        (N,) standard deviation of the shift, per axis, px; NaN where lost.
    layer
        (N,) layer names.
    channels
        Projection (r, g, b) that was used for every layer.
    method
        How centres were measured.
    """

    rest_px: Pixels
    shift_px: Pixels
    sd_px: Floats
    layer: NDArray[np.str_]
    channels: dict[str, Weights]
    method: str

    @property
    def seen(self) -> Bools:
        """(N,) which markers have a shift."""
        return np.asarray(np.isfinite(self.shift_px).all(axis=1))


def track(
    rest_image: Picture,
    image: Picture,
    layout: Mapping[str, Pixels],
    *,
    diameter_px: float | None = None,
    polarity: str | None = None,
    channels: Mapping[str, Weights] | None = None,
    method: Method = "soft-window",
) -> Found:
    """Measure every marker's motion between two pictures.

    Parameters
    ----------
    rest_image, image
        (h, w, 3) uint8 pictures at rest and pressed.
    layout
        Nominal rest positions (n, 2) by layer, px; may be off by several px, as a whole by up to half the pitch.
    diameter_px
        Typical marker width, px; measured in the rest picture if not given.
    polarity
        ``bright`` or ``dark`` markers on their ground; told from the rest picture if not given.
    channels
        (r, g, b) by layer such that r R + g G + b B is large on its markers; estimated if not given.
    method
        ``soft-window``, or the flat paper's ``two-pass`` cell centroid.

    Raises
    ------
    InputError
        Pictures, layout or options that can't be used.
    """
    rest = analyse_rest(
        rest_image, layout, diameter_px=diameter_px, polarity=polarity, channels=channels, method=method
    )
    return track_frame(rest, image)


def track_frame(rest: Rest, image: Picture, start_px: Pixels | None = None) -> Found:
    """Measure the motion of every marker between the analysed rest picture and ``image``.

    Parameters
    ----------
    start_px
        (N, 2) shifts of the previous picture of a sequence, px; None starts cold.
    """
    picture = as_picture(image, "the picture")
    if picture.shape[:2] != rest.size_px:
        raise InputError(
            f"the picture is {picture.shape[1]}x{picture.shape[0]} px, the rest picture "
            f"{rest.size_px[1]}x{rest.size_px[0]} px: both must come from the same camera mode"
        )
    shift = np.full(rest.rest_px.shape, np.nan)
    sd = np.full(len(rest.rest_px), np.nan)
    for group in rest.groups:
        signal = project(picture, group.weights, group.ground_dn + group.floor_dn) - np.float32(group.ground_dn)
        known = group.around.rest_px
        if rest.method == "two-pass":
            shift[group.rows] = cell_centroids(signal, known, group.around.spacing_px, group.contrast_dn) - known
            sd[group.rows] = CELLS_SD_PX
            continue
        blobs = find_blobs(signal, group.diameter_px, group.contrast_dn, crowd_level(group.floor_dn))
        start = None if start_px is None else start_px[group.rows]
        spot = follow(group.around, blobs.centre_px, _alike(group, blobs), start)
        kept = np.flatnonzero(spot >= 0)
        spot = spot[kept]
        crowded = blobs.crowding[spot] > CROWDED
        hidden = crowded & (blobs.area_px[spot] < HIDDEN_AREA * group.area_px[kept])
        good = ~hidden
        rows = group.rows[kept[good]]
        shift[rows] = blobs.centre_px[spot[good]] - known[kept[good]]
        noise = np.hypot(blobs.sd_px[spot], np.where(crowded, CROWDED_SD_PX, 0.0))
        sd[rows] = np.hypot(noise[good], group.sd_px[kept[good]])
    sd[~np.isfinite(shift).all(axis=1)] = np.nan
    frozen(shift)
    frozen(sd)
    return Found(
        rest_px=rest.rest_px, shift_px=shift, sd_px=sd, layer=rest.layer, channels=rest.channels, method=rest.method
    )


def _alike(group: Group, blobs: Blobs) -> Bools:
    """(n, b) whether a spot's area and brightness allow it to be the marker."""
    with np.errstate(invalid="ignore", divide="ignore"):
        area = blobs.area_px[None] / group.area_px[:, None]
        level = blobs.level_dn[None] / group.level_dn[:, None]
    good = (area > AREA_RATIO[0]) & (area < AREA_RATIO[1]) & (level > LEVEL_RATIO[0]) & (level < LEVEL_RATIO[1])
    return np.asarray(good & blobs.whole[None])
