"""Marker motion between the rest picture and another: `track`; through a sequence of pictures: `Tracker`.

Why two steps: everything about the rest picture (colours, sizes, who is who, neighbours) is worked out once and serves
a whole sequence. Markers keep their rows; one that can't be seen, has merged with another, or is partly hidden is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, frozen
from twin.errors import InputError
from twin.sense.cells import cell_centroids
from twin.sense.detect import Blobs, find_blobs
from twin.sense.gather import stream
from twin.sense.judge_fit import (
    AREA_RATIO,
    DIM,
    LEVEL_RATIO,
    MERGED,
    MISSING,
    OCCLUDED,
    SAME_PLACE,
    SEEN,
    STATES,
    judge_fits,
)
from twin.sense.match import GATE, TRUST, follow, predict
from twin.sense.rest import CROWDED, CROWDED_SD_PX, Group, Method, Rest, analyse_rest, crowd_level
from twin.sense.split import Weights, as_picture, project
from twin.sense.template import SETTLED_TURNS

__all__ = ["STATES", "Found", "Tracker", "analyse_rest", "track", "track_frame"]

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
    state
        (N,) index into `STATES`.
    usual_sd_px
        (N,) standard deviation of the shift where picture and rest picture look alike, px; NaN where not found at rest,
        None where not known.
    spurious_px
        (s, 2) spots that look like markers and are none's, px; None where the whole picture was not searched.
    """

    rest_px: Pixels
    shift_px: Pixels
    sd_px: Floats
    layer: NDArray[np.str_]
    channels: dict[str, Weights]
    method: str
    state: NDArray[np.uint8] | None = None
    spurious_px: Pixels | None = None
    usual_sd_px: Floats | None = None

    def __post_init__(self) -> None:
        if self.state is None:
            object.__setattr__(self, "state", np.where(self.seen, SEEN, MISSING).astype(np.uint8))

    @property
    def states(self) -> NDArray[np.str_]:
        """(N,) seen, missing, dim, merged or occluded."""
        return np.array(STATES)[self.state]

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
    method: Method = "disc-fit",
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
        ``disc-fit``; ``soft-window`` centroid; or the flat paper's ``two-pass`` cell centroid.

    Raises
    ------
    InputError
        Pictures, layout or options that can't be used.
    """
    rest = analyse_rest(
        rest_image, layout, diameter_px=diameter_px, polarity=polarity, channels=channels, method=method
    )
    return track_frame(rest, image)


class Tracker:
    """Follows the markers through a sequence of pictures, each from where they were in the one before.

    Motion from picture to picture may be up to about half the markers' width where only places around the last ones
    are looked at, and up to 0.6 of the pitch where that fails and the whole picture is searched; in total there is no
    limit but the picture. Nothing grows with the number of pictures.

    Parameters
    ----------
    rest_image, layout, options
        As for `track`.
    """

    def __init__(
        self,
        rest_image: Picture,
        layout: Mapping[str, Pixels],
        *,
        diameter_px: float | None = None,
        polarity: str | None = None,
        channels: Mapping[str, Weights] | None = None,
        method: Method = "disc-fit",
    ) -> None:
        self.rest = analyse_rest(
            rest_image, layout, diameter_px=diameter_px, polarity=polarity, channels=channels, method=method
        )
        self._last_px: Pixels | None = None

    def track(self, image: Picture) -> Found:
        """Measure the motion between rest and the next picture of the sequence."""
        found = track_frame(self.rest, image, self._last_px)
        if found.seen.any():
            before = np.nan if self._last_px is None else self._last_px
            self._last_px = np.where(found.seen[:, None], found.shift_px, before)
        return found

    def forget(self) -> None:
        """Search the whole next picture, as after a cut in the sequence."""
        self._last_px = None


def track_frame(rest: Rest, image: Picture, start_px: Pixels | None = None) -> Found:
    """Measure the motion of every marker between the analysed rest picture and ``image``.

    Parameters
    ----------
    start_px
        (N, 2) shifts of the previous picture of a sequence, px, NaN where unknown; None starts cold.

    Raises
    ------
    InputError
        The picture isn't one that the rest picture's camera mode gives.
    """
    picture = as_picture(image, "the picture")
    if picture.shape[:2] != rest.size_px:
        raise InputError(
            f"the picture is {picture.shape[1]}x{picture.shape[0]} px, the rest picture "
            f"{rest.size_px[1]}x{rest.size_px[0]} px: both must come from the same camera mode"
        )
    if start_px is not None and np.shape(start_px) != rest.rest_px.shape:
        raise InputError(f"start_px must be {rest.rest_px.shape} px, one row a marker, got {np.shape(start_px)}")
    shift = np.full(rest.rest_px.shape, np.nan)
    sd = np.full(len(rest.rest_px), np.nan)
    state = np.full(len(rest.rest_px), MISSING, np.uint8)
    spurious: list[Pixels] | None = []
    stream(picture.reshape(-1))
    for group in rest.groups:
        start = None if start_px is None else np.asarray(start_px, float)[group.rows]
        seen = _in_group(rest.method, group, picture, start)
        shift[group.rows], sd[group.rows], state[group.rows] = seen.shift_px, seen.sd_px, seen.state
        spurious = None if spurious is None or seen.spurious_px is None else [*spurious, seen.spurious_px]
    lost = ~np.isfinite(shift).all(axis=1)
    sd[lost] = np.nan
    state[~lost] = SEEN
    for array in (shift, sd, state):
        frozen(array)
    return Found(
        rest_px=rest.rest_px, shift_px=shift, sd_px=sd, layer=rest.layer, channels=rest.channels, method=rest.method,
        state=state, spurious_px=None if spurious is None else frozen(np.concatenate(spurious)),
        usual_sd_px=rest.usual_sd_px,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """What one group's signal shows; as in `Found`."""

    shift_px: Pixels
    sd_px: Floats
    state: NDArray[np.uint8]
    spurious_px: Pixels | None


def _in_group(method: Method, group: Group, picture: Picture, start_px: Pixels | None) -> _Seen:
    if group.templates is not None and start_px is not None and (warm := _from_last(group, picture, start_px)):
        return warm
    known = group.around.rest_px
    if method == "two-pass":
        cell_px, least_dn = group.around.spacing_px, group.contrast_dn
        shift = cell_centroids(picture, group.weights, group.ground_dn, known, cell_px, least_dn) - known
        state = np.full(len(known), MISSING, np.uint8)
        return _Seen(shift_px=shift, sd_px=np.full(len(known), CELLS_SD_PX), state=state, spurious_px=None)
    signal = project(picture, group.weights, group.ground_dn + group.floor_dn) - np.float32(group.ground_dn)
    blobs = find_blobs(signal, group.diameter_px, group.contrast_dn, crowd_level(group.floor_dn))
    alike, odd = _alike(group, blobs)
    spot = follow(group.around, blobs.centre_px, alike, start_px)
    state = _lost_state(group, blobs, spot, odd)
    spurious = _spurious(group, blobs, spot)
    if group.templates is not None:
        moved = (blobs.centre_px[spot] if len(blobs) else np.nan) - group.spot_px
        place = np.where((spot >= 0)[:, None], known + moved, np.nan)
        return replace(_judged(group, group.templates.fit(picture, place, SETTLED_TURNS), state), spurious_px=spurious)
    shift, sd = np.full(known.shape, np.nan), np.full(len(known), np.nan)
    kept = np.flatnonzero(spot >= 0)
    spot = spot[kept]
    crowded = blobs.crowding[spot] > CROWDED
    hidden = crowded & (blobs.area_px[spot] < HIDDEN_AREA * group.area_px[kept])
    state[kept[hidden]] = OCCLUDED
    rows, spot, crowded = kept[~hidden], spot[~hidden], crowded[~hidden]
    shift[rows] = blobs.centre_px[spot] - known[rows]
    sd[rows] = np.hypot(np.hypot(blobs.sd_px[spot], np.where(crowded, CROWDED_SD_PX, 0.0)), group.sd_px[rows])
    return _Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=spurious)


def _from_last(group: Group, picture: Picture, last_px: Pixels) -> _Seen | None:
    """Fit around the last places, then once more where the neighbours' motion says; None where too many are lost."""
    known, templates = group.around.rest_px, group.templates
    assert templates is not None
    start = known + last_px
    count = int(np.isfinite(known[:, 0]).sum())
    if not count or np.isfinite(start[:, 0]).sum() < (1.0 - TRUST) * count:
        return None
    nothing = np.full(len(known), MISSING, np.uint8)
    seen = _judged(group, templates.fit(picture, start, lead=group.around.lead), nothing)
    expected, certain = predict(group.around, seen.shift_px)
    with np.errstate(invalid="ignore"):
        astray = np.hypot(*(seen.shift_px - expected).T) > GATE * group.around.spacing_px
    again = np.flatnonzero(certain & (astray | ~np.isfinite(seen.shift_px[:, 0])))
    if len(again):
        shift, sd, state = seen.shift_px.copy(), seen.sd_px.copy(), seen.state.copy()
        shift[astray & certain] = np.nan
        start = np.full_like(known, np.nan)
        start[again] = known[again] + expected[again]
        second = _judged(group, templates.fit(picture, start), nothing)
        near = np.hypot(*(second.shift_px[again] - expected[again]).T) < GATE * group.around.spacing_px
        rows = again[near]
        taken = cKDTree((known + shift)[np.isfinite(shift[:, 0])]) if np.isfinite(shift[:, 0]).any() else None
        if taken is not None and len(rows):
            apart, _ = taken.query(known[rows] + second.shift_px[rows])
            rows = rows[apart > SAME_PLACE * group.diameter_px]
        shift[rows], sd[rows], state[rows] = second.shift_px[rows], second.sd_px[rows], SEEN
        lost = again[np.isnan(shift[again, 0])]
        state[lost] = np.where(second.state[lost] == SEEN, MISSING, second.state[lost])
        sd[lost] = np.nan
        seen = _Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=None)
    return seen if np.isfinite(seen.shift_px[:, 0]).sum() >= (1.0 - TRUST) * count else None


def _judged(group: Group, fitted: Floats, state: NDArray[np.uint8]) -> _Seen:
    """Return what the fits that are accepted say, and what is wrong with the others."""
    templates = group.templates
    assert templates is not None
    shift, sd, state = np.empty((len(fitted), 2)), np.empty(len(fitted)), state.copy()
    judge_fits(
        fitted, group.around.rest_px, templates.level, templates.usual_misfit, group.sd_px, group.diameter_px,
        group.contrast_dn, group.picture_px, shift, sd, state,
    )  # fmt: skip
    return _Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=None)


def _lost_state(group: Group, blobs: Blobs, spot: Ints, odd: Bools) -> NDArray[np.uint8]:
    """Say why markers without a spot are lost: the spot near the expected place is odd, or there is none."""
    state = np.full(len(spot), MISSING, np.uint8)
    lost = np.flatnonzero((spot < 0) & np.isfinite(group.around.rest_px[:, 0]))
    if not len(lost) or not len(blobs):
        return state
    rest = group.around.rest_px
    motion = np.where((spot >= 0)[:, None], blobs.centre_px[spot] - rest, np.nan)
    expected, _ = predict(group.around, motion)
    distance, near = cKDTree(blobs.centre_px).query(rest[lost] + expected[lost])
    close = (distance < GATE * group.around.spacing_px) & odd[lost, near]
    lost, near = lost[close], near[close]
    with np.errstate(invalid="ignore", divide="ignore"):
        area, level = blobs.area_px[near] / group.area_px[lost], blobs.level_dn[near] / group.level_dn[lost]
    state[lost] = np.where(area > AREA_RATIO[1], MERGED, np.where(level < LEVEL_RATIO[0], DIM, OCCLUDED))
    return state


def _spurious(group: Group, blobs: Blobs, spot: Ints) -> Pixels:
    """Return (s, 2) spots that look like markers and are none's."""
    free = np.ones(len(blobs), np.bool_)
    free[spot[spot >= 0]] = False
    if not len(blobs) or not np.isfinite(group.area_px).any():
        return np.asarray(blobs.centre_px[free])
    area, level = blobs.area_px / np.nanmedian(group.area_px), blobs.level_dn / np.nanmedian(group.level_dn)
    return np.asarray(blobs.centre_px[free & blobs.whole & (area > AREA_RATIO[0]) & (level > LEVEL_RATIO[0])])


def _alike(group: Group, blobs: Blobs) -> tuple[Bools, Bools]:
    """(n, b) whether a spot's area and brightness allow it to be the marker; whether these alone speak against it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        area = blobs.area_px[None] / group.area_px[:, None]
        level = blobs.level_dn[None] / group.level_dn[:, None]
    good = (area > AREA_RATIO[0]) & (area < AREA_RATIO[1]) & (level > LEVEL_RATIO[0]) & (level < LEVEL_RATIO[1])
    return np.asarray(good & blobs.whole[None]), np.asarray(~good & blobs.whole[None])
