"""Analyse the rest picture: who is who, how wide and how bright; done once for a sequence of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Picture, Pixels, frozen
from twin.errors import InputError, require
from twin.sense.cells import cell_centroids
from twin.sense.detect import Blobs, find_blobs
from twin.sense.fit import EDGE, LEVEL
from twin.sense.judge_fit import COVERED_SD_PX, LEAST_EDGE, WHOLE_EDGE, centre_sds
from twin.sense.match import Neighbourhood, follow, mutual_nearest, neighbourhood, nominal_to_rest, spacing
from twin.sense.split import Signal, Weights, as_picture, estimate_channels, noise_dn, project
from twin.sense.template import Templates, colour_of, make_templates, projections, used_centres

Method = Literal["disc-fit", "soft-window", "two-pass"]
METHODS: tuple[Method, ...] = ("disc-fit", "soft-window", "two-pass")

PAPERS_CHANNELS: tuple[Weights, Weights] = ((1.0, 0.0, -1.0), (-1.0, 0.0, 1.0))
"""The flat paper's difference of red and blue, for either layer (section 4.1)."""

LEAST_CONTRAST_DN = 5.0

CROWDED = 0.08
"""From this share of foreign colour around its edge on, a marker's outline may be cut by another."""

CROWDED_SD_PX = 0.1


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
    usual_sd_px
        (n,) standard deviation of the shift to a picture that looks the same, px.
    picture_px
        (height, width) of the picture.
    spot_px
        (n, 2) centres of the spots that were matched, px: found, not fitted, as they are in every picture to start a
        fit from.
    templates
        What method ``disc-fit`` fits.
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
    usual_sd_px: Floats
    picture_px: tuple[int, int]
    spot_px: Pixels
    templates: Templates | None = None


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
    usual_sd_px
        (N,) standard deviation of the shift to a picture that looks the same, px; NaN where not found.
    size_px
        (height, width) of the picture.
    method
        How centres are measured.
    """

    layer: NDArray[np.str_]
    rest_px: Pixels
    channels: dict[str, Weights]
    groups: tuple[Group, ...]
    usual_sd_px: Floats
    size_px: tuple[int, int]
    method: Method


def analyse_rest(
    rest_image: Picture,
    layout: Mapping[str, Pixels],
    *,
    diameter_px: float | None = None,
    polarity: str | None = None,
    channels: Mapping[str, Weights] | None = None,
    method: Method = "disc-fit",
) -> Rest:
    """Find the markers of ``layout`` in the rest picture; parameters as for `twin.track`."""
    picture = as_picture(rest_image, "the rest picture")
    drawn = _checked_layout(layout)
    _check_options(drawn, diameter_px, polarity, channels, method)
    size = min(spacing(p) for p in drawn.values())
    if channels is None:
        weights = estimate_channels(picture, drawn, size, polarity, PAPERS_CHANNELS if method == "two-pass" else None)
    else:
        red_green_blue = {name: channels[name] for name in drawn}
        weights = {name: (float(w[0]), float(w[1]), float(w[2])) for name, w in red_green_blue.items()}
    layer = np.concatenate([np.full(len(p), name) for name, p in drawn.items()]).astype(np.str_)
    projections = list(dict.fromkeys(weights.values()))
    rows = [np.flatnonzero([weights[str(name)] == w for name in layer]) for w in projections]
    nominal = np.concatenate(list(drawn.values()))
    prepared = [_first_look(picture, w, nominal[r], diameter_px) for w, r in zip(projections, rows, strict=True)]
    if method == "two-pass":
        measured = [
            cell_centroids(picture, look.weights, look.ground_dn, nominal[r], size, look.contrast_dn)
            for look, r in zip(prepared, rows, strict=True)
        ]
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
    if method == "disc-fit":
        groups = _with_templates(picture, groups, given=channels is not None)
    rest_px, usual = np.full((len(layer), 2), np.nan), np.full(len(layer), np.nan)
    for group in groups:
        rest_px[group.rows] = group.around.rest_px
        usual[group.rows] = group.usual_sd_px
    height, width = picture.shape[:2]
    return Rest(
        layer=layer, rest_px=frozen(rest_px), channels=weights, groups=tuple(groups), usual_sd_px=frozen(usual),
        size_px=(height, width), method=method,
    )  # fmt: skip


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
    blobs = find_blobs(signal, width, contrast, crowd_level(floor))
    if diameter_px is None:
        for _ in range(2):
            whole = blobs.diameter_px[blobs.whole]
            if not len(whole):
                break
            before, width = width, float(np.clip(np.median(whole), 3.0, 0.9 * max(spacing(nominal), 4.0)))
            if 0.8 < width / before < 1.25:
                break
            blobs = find_blobs(signal, width, contrast, crowd_level(floor))
    usual = float(np.median(blobs.area_px)) if len(blobs) else 0.0
    keep = blobs.whole & (blobs.area_px > 0.3 * usual) & (blobs.area_px < 2.5 * usual)
    return _Look(
        weights=weights, signal=signal, ground_dn=ground, floor_dn=floor, contrast_dn=contrast, diameter_px=width,
        blobs=_only(blobs, keep),
    )  # fmt: skip


def _only(blobs: Blobs, keep: Bools) -> Blobs:
    return Blobs(**{name: getattr(blobs, name)[keep] for name in Blobs.__dataclass_fields__})


def crowd_level(floor_dn: float) -> float:
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
        level_dn=level, area_px=area, sd_px=sd, usual_sd_px=np.sqrt(2.0) * sd, picture_px=look.signal.shape,
        spot_px=rest_px,
    )  # fmt: skip


def _with_templates(picture: Picture, groups: list[Group], given: bool) -> list[Group]:
    """Fit the markers' templates and take the fits' centres for the rest positions."""
    centres, widths = [group.around.rest_px for group in groups], [group.diameter_px for group in groups]
    own = [np.asarray(group.weights) for group in groups]
    colours = [colour_of(picture, c, w) for c, w in zip(centres, widths, strict=True)]
    if not given and len(groups) > 1 and all(np.abs(colour).max() >= LEAST_CONTRAST_DN for colour in colours):
        own = projections(colours)
    fitted_groups = []
    for group, (templates, fitted) in zip(groups, make_templates(picture, own, centres, widths), strict=True):
        good = (fitted[:, EDGE] > LEAST_EDGE) & (fitted[:, LEVEL] >= group.contrast_dn)
        rest_px = np.where(good[:, None], used_centres(fitted), np.nan)
        around = neighbourhood(rest_px, group.around.spacing_px)
        sd = np.where(good, centre_sds(fitted, templates.usual_misfit), np.nan)
        usual = np.hypot(np.sqrt(2.0) * sd, np.where(fitted[:, EDGE] < WHOLE_EDGE, COVERED_SD_PX, 0.0))
        fitted_groups.append(replace(group, around=around, sd_px=sd, usual_sd_px=usual, templates=templates))
    return fitted_groups


def _checked_layout(layout: Mapping[str, Pixels]) -> dict[str, Pixels]:
    require(layout, Mapping, "the layout", "give {layer name: (n, 2) nominal positions in px}")
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
    if diameter_px is not None:
        require(diameter_px, Real, "diameter_px", "one width in px for all layers, or None to measure it")
    if diameter_px is not None and not 2.0 <= diameter_px <= 500.0:
        raise InputError(f"diameter_px = {diameter_px} px: allowed are 2 to 500 px, or None to measure it")
    if polarity not in (None, "bright", "dark"):
        raise InputError(f"polarity = {polarity!r}: allowed are 'bright', 'dark', or None to tell from the picture")
    if method not in METHODS:
        raise InputError(f"method = {method!r}: allowed are {', '.join(METHODS)}")
    if channels is not None:
        require(channels, Mapping, "channels", "give {layer name: (r, g, b)}, or None to estimate them")
        for name in drawn:
            numbers = np.asarray(channels.get(name, ()), float)
            if numbers.shape != (3,) or not np.isfinite(numbers).all() or not numbers.any():
                raise InputError(f"channels[{name!r}] must be 3 finite numbers (r, g, b), not all 0; got {numbers}")
