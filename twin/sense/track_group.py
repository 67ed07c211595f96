"""What a picture shows of one group of markers, those that are read from one signal: where each is, or why it is lost.

Places come from fits of the markers' own shapes, spots from a search of the whole picture, or cells around the rest
places (method ``two-pass``). After a first picture the fits start where the last ones ended; only where too many of
them fail is the whole picture searched again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels
from twin.sense.cells import cell_centroids
from twin.sense.detect import Blobs, find_blobs
from twin.sense.judge_fit import (
    AREA_RATIO,
    DIM,
    LEVEL_RATIO,
    MERGED,
    MISSING,
    OCCLUDED,
    SAME_PLACE,
    SEEN,
    judge_fits,
)
from twin.sense.match import GATE, TRUST, follow, predict
from twin.sense.rest import CROWDED, CROWDED_SD_PX, Group, Method, crowd_level
from twin.sense.split import project
from twin.sense.template import SETTLED_TURNS

HIDDEN_AREA = 0.92
"""A crowded marker below this share of its area at rest counts as hidden."""

CELLS_SD_PX = 0.07
"""What the two-pass centroid is good for with a pitch-wide cell, px (no estimate of its own exists)."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What one group's signal shows: rows are the group's markers, fields as in `twin.sense.track.Found`."""

    shift_px: Pixels
    sd_px: Floats
    state: NDArray[np.uint8]
    spurious_px: Pixels | None


def in_group(method: Method, group: Group, picture: Picture, start_px: Pixels | None) -> Seen:
    """Measure the motion of a group's markers between rest and ``picture``.

    Parameters
    ----------
    picture
        (h, w, 3), of the rest picture's size.
    start_px
        (n, 2) shifts of the group's markers in the picture before, px, NaN where unknown; None searches the whole.
    """
    if group.templates is not None and start_px is not None and (warm := _from_last(group, picture, start_px)):
        return warm
    known = group.around.rest_px
    if method == "two-pass":
        cell_px, least_dn = group.around.spacing_px, group.contrast_dn
        shift = cell_centroids(picture, group.weights, group.ground_dn, known, cell_px, least_dn) - known
        state = np.full(len(known), MISSING, np.uint8)
        return Seen(shift_px=shift, sd_px=np.full(len(known), CELLS_SD_PX), state=state, spurious_px=None)
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
    return Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=spurious)


def _from_last(group: Group, picture: Picture, last_px: Pixels) -> Seen | None:
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
        seen = Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=None)
    return seen if np.isfinite(seen.shift_px[:, 0]).sum() >= (1.0 - TRUST) * count else None


def _judged(group: Group, fitted: Floats, state: NDArray[np.uint8]) -> Seen:
    """Return what the fits that are accepted say, and what is wrong with the others."""
    templates = group.templates
    assert templates is not None
    shift, sd, state = np.empty((len(fitted), 2)), np.empty(len(fitted)), state.copy()
    judge_fits(
        fitted, group.around.rest_px, templates.level, templates.usual_misfit, group.sd_px, group.diameter_px,
        group.contrast_dn, group.picture_px, shift, sd, state,
    )  # fmt: skip
    return Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=None)


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
