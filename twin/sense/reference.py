"""The rest picture of a sequence, analysed once: which marker is which, and how each one looks.

`analyse_rest` splits the colours, finds the markers of every layer, and measures them by one of
`METHODS`. The result, `Rest`, holds an estimator for every layer, with which `twin.sense.track`
measures all other pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import permutations
from numbers import Real

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, frozen
from twin.errors import InputError, require
from twin.parts.methods import CentreMethod
from twin.sense.centre import CentreEstimator, Look
from twin.sense.colour import (
    EVEN,
    STEEP,
    Flaws,
    Signal,
    Weights,
    as_picture,
    estimate_channels,
    project,
)
from twin.sense.detect import Blobs
from twin.sense.disc_fit import DiscFit
from twin.sense.match import LEAST_ODD, LEFT_ODD, Neighbourhood, spacing
from twin.sense.paper_centroid import PaperCentroid
from twin.sense.rest_templates import LEAST_CONTRAST_DN
from twin.sense.soft_window import SoftWindow

METHODS: dict[CentreMethod, type[CentreEstimator]] = {
    "disc-fit": DiscFit,
    "soft-window": SoftWindow,
    "two-pass": PaperCentroid,
}

CLEAR_PX = 3.0
"""So far beyond an edge the ground is bare, for blur and motion."""

NARROWEST_PX = 3.0
"""No marker is looked for as if it were narrower."""

MOST, HOLES = 0.8, (0.15, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Where fewer than this share of the markers are spots, or their middles are dark, they may be
rings: holes up to so wide are filled, over their distance."""

PAPERS_CHANNELS: tuple[Weights, Weights] = ((1.0, 0.0, -1.0), (-1.0, 0.0, 1.0))
"""The flat paper's difference of red and blue, for either layer (section 4.1)."""


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
        (N,) standard deviation of the shift to a picture that looks the same, px; NaN where not
        found.
    size_px
        (height, width) of the picture.
    method
        How centres are measured.
    flaws
        Of the picture.
    film
        Whether a film's codec has been found since (`twin.sense.colour.Flaws.repeats_blocks`).
    """

    layer: NDArray[np.str_]
    rest_px: Pixels
    channels: dict[str, Weights]
    groups: tuple[CentreEstimator, ...]
    usual_sd_px: Floats
    size_px: tuple[int, int]
    method: CentreMethod
    flaws: Flaws
    film: bool = False

    @property
    def share_found(self) -> float:
        """Share of the markers that are found."""
        return float(np.isfinite(self.rest_px[:, 0]).mean())

    @cached_property
    def gain_error(self) -> float:
        """The largest of the groups' (`CentreEstimator.gain_error`)."""
        return max(group.gain_error for group in self.groups)

    @cached_property
    def drift_px(self) -> Floats:
        """(N, 2) motion that the rest picture shows against itself, px."""
        drift = np.zeros(self.rest_px.shape)
        for group in self.groups:
            drift[group.look.rows] = group.drift_px
        return frozen(drift)

    @property
    def ground_px(self) -> tuple[float, float]:
        """How far from markers' centres the ground begins, and how far it is looked at, px."""
        widest = max(group.look.diameter_px for group in self.groups)
        return 0.5 * widest + CLEAR_PX, 0.5 * max(group.around.spacing_px for group in self.groups)


def analyse_rest(
    rest_image: Picture,
    layout: Mapping[str, Pixels],
    *,
    diameter_px: float | None = None,
    polarity: str | None = None,
    channels: Mapping[str, Weights] | None = None,
    method: CentreMethod = "disc-fit",
) -> Rest:
    """Find the markers of ``layout`` in the rest picture; parameters as for `twin.track`."""
    picture = as_picture(rest_image, "the rest picture")
    flaws = Flaws.of(picture)
    picture = flaws.mended(picture)
    drawn = _checked_layout(layout, picture)
    _check_options(drawn, diameter_px, polarity, channels, method)

    def analysed(even: float) -> Rest:
        options = drawn, diameter_px, polarity, channels, method, even
        rest = _analysed(picture, flaws, *options)
        # bands may hide markers, which are about where they are drawn
        marks = np.where(np.isnan(rest.rest_px), np.concatenate(list(drawn.values())), rest.rest_px)
        banded, level = flaws.seen_without_bands(picture, marks, *rest.ground_px)
        return rest if banded.ground is None else _analysed(level, banded, *options)

    rest = analysed(EVEN)
    if channels is None and rest.share_found < MOST:
        # light may fall off steeply; tried first, what bands leave would pass for markers
        rest = max(rest, analysed(STEEP), key=lambda one: one.share_found)
    return rest


def _analysed(
    picture: Picture,
    flaws: Flaws,
    drawn: dict[str, Pixels],
    diameter_px: float | None,
    polarity: str | None,
    channels: Mapping[str, Weights] | None,
    method: CentreMethod,
    even: float,
) -> Rest:
    """Find the markers of the layout ``drawn`` in a picture less its ``flaws``, whose ground is
    evenly lit over so many spacings."""
    size = min(spacing(p) for p in drawn.values())
    if channels is None:
        pair = PAPERS_CHANNELS if method == "two-pass" else None
        weights = estimate_channels(picture, drawn, size, polarity, pair, even)
    else:
        weights = {}
        for name in drawn:
            red, green, blue = (float(w) for w in channels[name])
            weights[name] = (red, green, blue)
    looks = _looks(picture, drawn, weights, diameter_px)
    if channels is None:
        weights, looks = _fewest_odd(picture, drawn, weights, diameter_px, looks, size)
    layer = np.concatenate([np.full(len(p), name) for name, p in drawn.items()]).astype(np.str_)
    groups = METHODS[method].at_rest(picture, looks, size, channels is not None)
    rest_px, usual = np.full((len(layer), 2), np.nan), np.full(len(layer), np.nan)
    for group in groups:
        rest_px[group.look.rows] = group.around.rest_px
        usual[group.look.rows] = group.usual_sd_px
    height, width = picture.shape[:2]
    return Rest(
        layer=layer,
        rest_px=frozen(rest_px),
        channels=weights,
        groups=tuple(groups),
        usual_sd_px=frozen(usual),
        size_px=(height, width),
        method=method,
        flaws=flaws,
    )


def _looks(
    picture: Picture,
    drawn: dict[str, Pixels],
    weights: dict[str, Weights],
    diameter_px: float | None,
) -> list[Look]:
    """Return the first look at the markers of every colour."""
    nominal = np.concatenate(list(drawn.values()))
    of_marker = np.repeat(np.arange(len(drawn)), [len(places) for places in drawn.values()])
    looks = []
    for w in dict.fromkeys(weights.values()):
        layers = [number for number, name in enumerate(drawn) if weights[name] == w]
        rows = np.flatnonzero(np.isin(of_marker, layers))
        looks.append(_first_look(picture, w, rows, nominal[rows], diameter_px))
    return looks


def _fewest_odd(
    picture: Picture,
    drawn: dict[str, Pixels],
    weights: dict[str, Weights],
    diameter_px: float | None,
    looks: list[Look],
    spacing_px: float,
) -> tuple[dict[str, Weights], list[Look]]:
    """Return the colours of the layers, and ``looks`` by them, exchanged where that leaves far
    fewer markers without a spot and spots without a marker.

    Why: colours are given to layers where the drawing may be off by less than half a step. Off by
    more, layers that lie between each other are taken for one another, up to their borders.
    """
    best = weights, looks
    if not len(looks) == len(drawn) > 1:
        return best  # one layer, or layers of one colour: nothing to exchange
    least = _odd_spots(looks, spacing_px)
    if least < LEAST_ODD:
        return best  # nearly always
    for order in permutations(weights.values()):
        tried = dict(zip(drawn, order, strict=True))
        seen = _looks(picture, drawn, tried, diameter_px)
        odd = _odd_spots(seen, spacing_px)
        if odd < LEFT_ODD * least:
            best, least = (tried, seen), odd
    return best


def _odd_spots(looks: list[Look], spacing_px: float) -> int:
    """Return how many markers have no spot, or are spots without a marker."""
    spots = [look.blobs.centre_px[look.blobs.whole] for look in looks]
    drawn = [look.nominal_px for look in looks]
    return Neighbourhood.odd_spots(drawn, spots, spacing_px, looks[0].picture_px)


def _first_look(
    picture: Picture,
    weights: Weights,
    rows: NDArray[np.int64],
    nominal: Pixels,
    diameter_px: float | None,
) -> Look:
    """Project, take the ground off, and find the spots, measuring their width where it isn't
    known."""
    raw = project(picture, weights)
    ground = float(np.median(raw[::4, ::4]))
    # the noise, from differences of neighbouring pixels
    steps = np.abs(np.diff(raw[::3, ::2], axis=1)) if raw.shape[1] > 2 else np.zeros(1)
    noise = float(max(1.4826 * np.median(steps) / np.sqrt(2.0), 0.2))
    opposed = min(weights) < -0.2 * max(weights) and max(weights) > 0
    floor = -max(8.0, 5.0 * noise) if opposed else -np.inf
    signal = np.maximum(raw - np.float32(ground), np.float32(floor))
    contrast = max(LEAST_CONTRAST_DN, 4.0 * noise)
    seek = (signal, nominal, diameter_px, contrast, floor)
    (width, blobs), hole_px = _sought(*seek), 0
    found = _nearest(nominal, blobs.centre_px, blobs.whole)
    if len(found) < MOST * len(nominal) or blobs.hollow(signal, found):  # rings, maybe
        holes = np.ceil(np.multiply(HOLES, spacing(nominal))).astype(int).tolist()
        tried = [_sought(*seek, hole) for hole in holes]
        rings = []
        for _, filled in tried:
            near = _nearest(nominal, filled.centre_px, filled.whole)
            rings.append(len(near) * filled.hollow(signal, near))
        if max(rings) >= MOST * len(nominal):
            best = np.flatnonzero(np.array(rings) == max(rings))
            middle = best[(len(best) - 1) // 2]  # holes neither just filled, nor nearly the gaps
            hole_px, (width, blobs) = holes[middle], tried[middle]
    keep = blobs.whole | blobs.cut
    if keep.any():
        usual = float(np.median(blobs.area_px[_nearest(nominal, blobs.centre_px, keep)]))
        keep &= (blobs.area_px > 0.3 * usual) & (blobs.area_px < 2.5 * usual)
    height, width_px = signal.shape
    return Look(
        rows=rows,
        nominal_px=nominal,
        weights=weights,
        ground_dn=ground,
        floor_dn=floor,
        contrast_dn=contrast,
        diameter_px=width,
        hole_px=hole_px,
        picture_px=(height, width_px),
        blobs=Blobs(**{f.name: getattr(blobs, f.name)[keep] for f in fields(Blobs)}),
    )


def _sought(
    signal: Signal,
    nominal: Pixels,
    diameter_px: float | None,
    contrast: float,
    floor: float,
    hole_px: int = 0,
) -> tuple[float, Blobs]:
    """Return how wide markers are, px, and the spots; holes up to ``hole_px`` wide are filled."""
    width = diameter_px or 0.33 * spacing(nominal)
    blobs = Blobs.found_in(signal, width, contrast, floor, hole_px)
    looks_left = 2 if diameter_px is None else 0
    while looks_left:
        markers = _nearest(nominal, blobs.centre_px, blobs.whole)
        before = width
        if len(markers):
            usual = float(np.median(blobs.diameter_px[markers]))
            width = float(np.clip(usual, NARROWEST_PX, 0.9 * max(spacing(nominal), 4.0)))
            looks_left -= 1
        elif width > 2.0 * NARROWEST_PX:  # much narrower than they are apart, they are blurred away
            width /= 2.0
        else:
            break
        blobs = Blobs.found_in(signal, width, contrast, floor, hole_px)
        if len(markers) and 0.8 < width / before < 1.25:
            break
    return width, blobs


def _nearest(nominal: Pixels, spots: Pixels, fit: Bools) -> Ints:
    """Return which of ``spots`` (b, 2) that ``fit`` are the nearest to some nominal place: the
    border of a gel that lies in the picture mostly isn't."""
    rows = np.flatnonzero(fit)
    if not len(rows):
        return rows
    return np.unique(rows[cKDTree(spots[rows]).query(nominal)[1]])


def _checked_layout(layout: Mapping[str, Pixels], picture: Picture) -> dict[str, Pixels]:
    wanted = "give {layer name: (n, 2) nominal positions in px}"
    require(layout, Mapping, "the layout", wanted)
    drawn = {str(name): np.atleast_2d(np.asarray(points, float)) for name, points in layout.items()}
    if not drawn:
        raise InputError(f"the layout has no layers: {wanted}")
    for name, points in drawn.items():
        if (
            points.ndim != 2
            or points.shape[1] != 2
            or not len(points)
            or not np.isfinite(points).all()
        ):
            raise InputError(
                f"layout[{name!r}] must be (n, 2) finite px (column, row) with n >= 1, got shape "
                f"{points.shape}"
            )
    height, width = picture.shape[:2]
    places = np.concatenate(list(drawn.values()))
    if not ((places > -0.5) & (places < np.array([width, height]) - 0.5)).all(axis=1).any():
        raise InputError(
            f"the layout lies outside the picture of {width}x{height} px, its first marker at "
            f"column {places[0, 0]:.5g}, row {places[0, 1]:.5g}"
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
        wanted = "one width in px for all layers, or None to measure it"
        require(diameter_px, Real, "diameter_px", wanted)
        if not 2.0 <= diameter_px <= 500.0:
            raise InputError(
                f"diameter_px = {diameter_px} px: allowed are 2 to 500 px, or None to measure it"
            )
    if polarity not in (None, "bright", "dark"):
        raise InputError(
            f"polarity = {polarity!r}: allowed are 'bright', 'dark', or None to find it in the "
            f"picture"
        )
    if method not in METHODS:
        raise InputError(f"method = {method!r}: allowed are {', '.join(METHODS)}")
    if channels is not None:
        require(
            channels, Mapping, "channels", "give {layer name: (r, g, b)}, or None to estimate them"
        )
        for name in drawn:
            numbers = np.asarray(channels.get(name, ()), float)
            if numbers.shape != (3,) or not np.isfinite(numbers).all() or not numbers.any():
                raise InputError(
                    f"channels[{name!r}] must be 3 finite numbers (r, g, b), not all 0; got "
                    f"{numbers}"
                )
