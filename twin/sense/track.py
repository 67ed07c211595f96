"""Marker motion between the rest picture and another: `track`, or `analyse_rest` once and `track_frame` for each.

Why two steps: everything about the rest picture (colours, sizes, who is who, neighbours) is worked out once and serves
a whole sequence. Markers keep their rows; one that can't be seen, has merged with another, or is partly hidden is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Picture, Pixels, frozen
from twin.errors import InputError
from twin.sense.cells import cell_centroids
from twin.sense.detect import Blobs, find_blobs
from twin.sense.match import Neighbourhood, follow, mutual_nearest, neighbourhood, nominal_to_rest, spacing
from twin.sense.split import Signal, Weights, as_picture, estimate_channels, noise_dn, project

Method = Literal["soft-window", "two-pass"]

LEAST_CONTRAST_DN = 5.0
AREA_RATIO = (0.6, 1.7)
"""Allowed change of a marker's area against rest: less is partly hidden, more has merged."""

LEVEL_RATIO = (0.3, 3.0)
"""Allowed change of a marker's brightness against rest."""

CROWDED = 0.08
"""From this share of foreign colour around its edge on, a marker's outline may be cut by another."""

HIDDEN_AREA = 0.92
CROWDED_SD_PX = 0.1
CELLS_SD_PX = 0.07
"""What the two-pass centroid is good for with a pitch-wide cell, px (no estimate of its own exists)."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Layers that share a signal (one layer each, unless colours can't be told apart), with their rest state.

    Attributes
    ----------
    rows
        Which of the sensor's markers belong to it.
    weights, floor_dn, ground_dn
        Projection of the picture, the counts below which it is cut off, and the ground taken off.
    around
        Rest positions and neighbours, px.
    diameter_px, contrast_dn
        Typical marker width, and the least contrast of a spot.
    level_dn, area_px, sd_px
        Brightness, area and centre's standard deviation of every marker at rest.
    """

    rows: NDArray[np.int64]
    weights: Weights
    floor_dn: float
    ground_dn: float
    around: Neighbourhood
    diameter_px: float
    contrast_dn: float
    level_dn: Floats
    area_px: Floats
    sd_px: Floats


@dataclass(frozen=True, kw_only=True)
class Rest:
    """The analysed rest picture.

    Attributes
    ----------
    layer
        (N,) layer of every marker, in the layout's order.
    rest_px
        (N, 2) centres, px; NaN where not found.
    channels
        Projection (r, g, b) of every layer.
    groups
        What tracking needs, signal by signal.
    size_px
        (height, width) of the picture.
    method
        How centres are measured.
    """

    layer: NDArray[np.str_]
    rest_px: Pixels
    channels: dict[str, Weights]
    groups: tuple[Group, ...]
    size_px: tuple[int, int]
    method: Method


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


def analyse_rest(
    rest_image: Picture,
    layout: Mapping[str, Pixels],
    *,
    diameter_px: float | None = None,
    polarity: str | None = None,
    channels: Mapping[str, Weights] | None = None,
    method: Method = "soft-window",
) -> Rest:
    """Find the markers of ``layout`` in the rest picture; parameters as for `track`."""
    picture = as_picture(rest_image, "the rest picture")
    drawn = _checked_layout(layout)
    _check_options(drawn, diameter_px, polarity, channels, method)
    size = min(spacing(p) for p in drawn.values())
    if channels is None:
        weights = estimate_channels(picture, drawn, size, polarity)
    else:
        red_green_blue = {name: channels[name] for name in drawn}
        weights = {name: (float(w[0]), float(w[1]), float(w[2])) for name, w in red_green_blue.items()}
    layer = np.concatenate([np.full(len(p), name) for name, p in drawn.items()]).astype(np.str_)
    projections = list(dict.fromkeys(weights.values()))
    rows = [np.flatnonzero([weights[str(name)] == w for name in layer]) for w in projections]
    nominal = np.concatenate(list(drawn.values()))
    prepared = [_first_look(picture, w, nominal[r], diameter_px) for w, r in zip(projections, rows, strict=True)]
    if method == "two-pass":
        measured = [cell_centroids(look.signal, nominal[r], size) for look, r in zip(prepared, rows, strict=True)]
        pairs = [np.where(np.isfinite(m[:, 0]), np.arange(len(m)), -1) for m in measured]
        groups = [
            _group(look, r, m, p, size, None) for look, r, m, p in zip(prepared, rows, measured, pairs, strict=True)
        ]
    else:
        spots = [look.blobs.centre_px for look in prepared]
        expected = nominal_to_rest([nominal[r] for r in rows], spots, size)
        pairs = [_settle(e, s, spacing(e)) for e, s in zip(expected, spots, strict=True)]
        groups = [
            _group(look, r, s, p, spacing(nominal[r]), look.blobs)
            for look, r, s, p in zip(prepared, rows, spots, pairs, strict=True)
        ]
    rest_px = np.full((len(layer), 2), np.nan)
    for group in groups:
        rest_px[group.rows] = group.around.rest_px
    frozen(rest_px)
    height, width = picture.shape[:2]
    return Rest(
        layer=layer, rest_px=rest_px, channels=weights, groups=tuple(groups), size_px=(height, width), method=method
    )


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
            shift[group.rows] = cell_centroids(signal, known, group.around.spacing_px) - known
            sd[group.rows] = CELLS_SD_PX
            continue
        blobs = find_blobs(signal, group.diameter_px, group.contrast_dn, _crowd_level(group.floor_dn))
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


@dataclass(frozen=True, kw_only=True)
class _Look:
    """A first look at one signal of the rest picture."""

    weights: Weights
    signal: Signal
    ground_dn: float
    floor_dn: float
    contrast_dn: float
    diameter_px: float
    blobs: Blobs


def _first_look(picture: Picture, weights: Weights, nominal: Pixels, diameter_px: float | None) -> _Look:
    """Project, take the ground off, and find the spots, measuring their width where it isn't known."""
    raw = project(picture, weights)
    ground = float(np.median(raw[::4, ::4]))
    noise = noise_dn(raw)
    opposed = min(weights) < -0.2 * max(weights) and max(weights) > 0
    floor = -max(8.0, 5.0 * noise) if opposed else -np.inf
    signal = np.maximum(raw - np.float32(ground), np.float32(floor))
    contrast = max(LEAST_CONTRAST_DN, 4.0 * noise)
    width = diameter_px or 0.33 * spacing(nominal)
    blobs = find_blobs(signal, width, contrast, _crowd_level(floor))
    if diameter_px is None:
        for _ in range(2):
            whole = blobs.diameter_px[blobs.whole]
            if not len(whole):
                break
            before, width = width, float(np.clip(np.median(whole), 3.0, 0.9 * max(spacing(nominal), 4.0)))
            if 0.8 < width / before < 1.25:
                break
            blobs = find_blobs(signal, width, contrast, _crowd_level(floor))
    usual = float(np.median(blobs.area_px)) if len(blobs) else 0.0
    keep = blobs.whole & (blobs.area_px > 0.3 * usual) & (blobs.area_px < 2.5 * usual)
    return _Look(
        weights=weights, signal=signal, ground_dn=ground, floor_dn=floor, contrast_dn=contrast, diameter_px=width,
        blobs=_only(blobs, keep),
    )  # fmt: skip


def _only(blobs: Blobs, keep: Bools) -> Blobs:
    return Blobs(**{name: getattr(blobs, name)[keep] for name in Blobs.__dataclass_fields__})


def _crowd_level(floor_dn: float) -> float:
    return 0.8 * floor_dn if np.isfinite(floor_dn) else -np.inf


def _settle(expected: Pixels, spots: Pixels, size: float) -> NDArray[np.int64]:
    """Match the drawing, already mapped onto the picture, to its spots; then once more with the local misfit off."""
    allowed = np.ones((len(expected), len(spots)), bool)
    pair = mutual_nearest(expected, spots, 0.4 * size, allowed)
    if (pair >= 0).sum() >= 4:
        around = neighbourhood(expected, size)
        alike = np.zeros_like(allowed)
        close = np.linalg.norm(expected[:, None] - spots[None], axis=2) < 0.6 * size
        alike[close] = True
        start = np.where((pair >= 0)[:, None], spots[pair] - expected, np.nan)
        pair = follow(around, spots, alike, start)
    return pair


def _group(
    look: _Look, rows: NDArray[np.int64], spots: Pixels, pair: NDArray[np.int64], size: float, blobs: Blobs | None
) -> Group:
    found = pair >= 0
    rest_px = np.full((len(rows), 2), np.nan)
    rest_px[found] = spots[pair[found]]
    nothing = np.full(len(rows), np.nan)
    level, area, sd = nothing, nothing, nothing
    if blobs is not None and len(blobs):
        level, area = (np.where(found, values[pair], np.nan) for values in (blobs.level_dn, blobs.area_px))
        usual = float(np.nanmedian(area)) if found.any() else 0.0
        hidden = (blobs.crowding[pair] > CROWDED) & (area < 0.8 * usual)
        sd = np.where(found, np.hypot(blobs.sd_px[pair], np.where(hidden, CROWDED_SD_PX, 0.0)), np.nan)
    return Group(
        rows=rows, weights=look.weights, floor_dn=look.floor_dn, ground_dn=look.ground_dn,
        around=neighbourhood(rest_px, size), diameter_px=look.diameter_px, contrast_dn=look.contrast_dn,
        level_dn=level, area_px=area, sd_px=sd,
    )  # fmt: skip


def _alike(group: Group, blobs: Blobs) -> Bools:
    """(n, b) whether a spot's area and brightness allow it to be the marker."""
    with np.errstate(invalid="ignore", divide="ignore"):
        area = blobs.area_px[None] / group.area_px[:, None]
        level = blobs.level_dn[None] / group.level_dn[:, None]
    good = (area > AREA_RATIO[0]) & (area < AREA_RATIO[1]) & (level > LEVEL_RATIO[0]) & (level < LEVEL_RATIO[1])
    return np.asarray(good & blobs.whole[None])


def _checked_layout(layout: Mapping[str, Pixels]) -> dict[str, Pixels]:
    drawn = {str(name): np.atleast_2d(np.asarray(points, float)) for name, points in layout.items()}
    if not drawn:
        raise InputError("the layout has no layers: give {layer name: (n, 2) nominal positions in px}")
    for name, points in drawn.items():
        if points.ndim != 2 or points.shape[1] != 2 or not len(points) or not np.isfinite(points).all():
            raise InputError(
                f"layout[{name!r}] must be (n, 2) finite px (column, row) with n >= 1, got shape {points.shape}"
            )
    return drawn


def _check_options(
    drawn: Mapping[str, Pixels],
    diameter_px: float | None,
    polarity: str | None,
    channels: Mapping[str, Weights] | None,
    method: str,
) -> None:
    if diameter_px is not None and not 2.0 <= diameter_px <= 500.0:
        raise InputError(f"diameter_px = {diameter_px} px: allowed are 2 to 500 px, or None to measure it")
    if polarity not in (None, "bright", "dark"):
        raise InputError(f"polarity = {polarity!r}: allowed are 'bright', 'dark', or None to tell from the picture")
    if method not in ("soft-window", "two-pass"):
        raise InputError(f"method = {method!r}: allowed are 'soft-window' and 'two-pass'")
    if channels is not None:
        for name in drawn:
            numbers = np.asarray(channels.get(name, ()), float)
            if numbers.shape != (3,) or not np.isfinite(numbers).all() or not numbers.any():
                raise InputError(f"channels[{name!r}] must be 3 finite numbers (r, g, b), not all 0; got {numbers}")
