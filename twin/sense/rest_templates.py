"""The templates of the markers, made from the rest picture.

`LayerSignal` chooses the projection by which each layer is measured, and fits every marker at rest.
So the noise is known that later fits are judged by: in single pixels, and, by `BareGround`, as far
as it hangs together over the ground around the markers.

**Projection.** A layer's projection removes the other layers' colours and otherwise has the least
noise: for pure dyes it is the one channel that shows the marker. The paper's difference of red and
blue has the noise of two, and only finds spots.

**Slope of brightness.** The light falls off over the picture: that slope is a quadratic of the
place, and another one where a marker has moved to. A marker may also be uneven: that slope moves
with it, and is used where it is large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, Singles, for_kernel, medians
from twin.compiled import njit
from twin.sense.centre import Look
from twin.sense.colour import LUMA, Flaws
from twin.sense.match import Neighbourhood
from twin.sense.shape_fit import fit_shapes
from twin.sense.template import (
    BLUR,
    BRIGHT,
    BULGE,
    CENTRE,
    COLUMNS,
    FITTING,
    GROUND,
    LEVEL,
    LINEAR,
    LIT,
    MARGIN_PX,
    MISFIT,
    NO_RUNS,
    QUADRATIC,
    SHAPE,
    UNCOVERED,
    VAR_X,
    Templates,
    disc,
    disc_offsets,
    gather,
    slope_terms,
)

LEAST_CONTRAST_DN = 5.0
"""Markers that differ less from their ground, counts, are not visible."""

LEAST_LUMA = 0.2
"""Brightness shows a layer that has this share of its contrast in it: red has, blue has not."""

MIXED = 5.0
"""Where compression halves the resolution of colours, a layer that hardly shows in the brightness
has the smallest errors with so many parts of it (blue: 5 to 9)."""

CROSSING, BLIND, DARKER, SAME_LEVEL = 20, 0.03, 0.1, 0.15
"""From how many pixels, where markers of two layers cross, it is seen which lies in front: it is as
bright there as elsewhere, but for the last share. The other one, of whose own brightness no more
than the second share shows in it, then can't hide it."""

FALLS = 0.2
"""Change of a layer's ground over the picture, over its markers' brightness, from which on it is
known by the place."""

ONE_COLOUR = 0.75
"""A layer shows in one colour if its projection has this share in it."""

USUAL_BLUR_PX = 2.0
"""Half width of a sharp lens' blur with the pixel's, px (.75 px standard deviation): where the
search starts."""

SAMPLE = 40
"""About how many markers give the layer's blur and bulge."""

CLEAR_PX = 1.5
"""So far from markers' edges is the ground, for all the blur."""

EVERYWHERE = np.ones((2, 2), np.float32)

ASIDE_PX, GAINS = 0.1, (0.7, 1.6)
"""How far from a marker's centre a step is tried; what gains may be."""

QUANTISED = 1 / 12
"""Variance of rounding to whole counts: no noise is less."""

GROWS = 0.17
"""Growth of a marker up to which ground around it is looked at, as a share of its radius."""

NOISE_VARIES, NOISIER = 0.25, 2.0
"""Logarithms of by how much the noise's variance differs over the picture at least, and at most: by
chance up to .1 over 60 markers."""

OWN_SLOPE = 0.3
"""A marker's own slope, over its radius, counts above this: a neighbour's shadow feigns smaller
ones, and then moves."""

USUAL = 0.25
"""Share of the markers that fit better than what is called usual."""

WHITE = 1.3
"""Noise that leaves residuals up to so many times as large, squared, as it has in single pixels
does not hang together over pixels."""

PLACES, FEW_PLACES = 1200, 100
"""About at how many places of the rest picture the ground is looked at (`BareGround`), and of later
ones."""

BESIDE = 3
"""So many markers move as a place between them does."""

LEAST_FREE = 0.499
"""A place counts where so much of the edge's information is over ground that no marker covers: less
than a half, which is in sight, but for rounding, where one side is covered."""

RING = 1.4
"""The ground's slope is measured out to so many radii of a marker."""

SLOPING = 0.5
"""Standard deviations of a pixel's noise by which the ground differs over that length, at least: by
chance up to .15."""

RELIT = 0.5
"""Motion that a change of light from marker to marker feigns, over its standard deviation by the
noise, above which the light has changed."""

LIGHT = (0.05, 20.0)
"""Of the light at rest that the ground or the markers are seen in."""

UNLIT = 0.6
"""Share of the change, squared, that planes may leave where it is light's: shadows a quarter of a
marker's distance wide leave .3; hidden parts, growth and shadows of single markers .8 and more."""


@dataclass(frozen=True, kw_only=True)
class LayerSignal:
    """How one layer shows in the picture.

    Attributes
    ----------
    own
        (4,) its projection (r, g, b) and the ground's level in it.
    number, hiding, every
        Which layer it is, and which ones may hide it, of (q, 16) all, see `Templates.others`.
    shade
        The largest share of its light that it lacks around those that hide it.
    brightness
        As ``own``, of the brightness, in which compression keeps more than in colours; where the
        layer hardly shows in it, of both; None where the projection was given.
    bright
        Whether the layer shows in the brightness (`LEAST_LUMA`).
    sites
        See `Templates`: of a colour mosaic, where the layer shows in one colour.
    """

    own: Singles
    number: int
    hiding: list[int]
    every: Singles
    shade: float
    brightness: Singles | None
    bright: bool
    sites: Singles

    @property
    def others(self) -> Singles:
        """(m, 16) the layers that may hide it."""
        return self.every[self.hiding]

    @property
    def smeared(self) -> LayerSignal:
        """The same where colours are smeared, so how much of a pixel others cover is not known."""
        every = self.every.copy()
        every[:, UNCOVERED] = 0.0
        return replace(self, every=every)

    @property
    def by_brightness(self) -> LayerSignal | None:
        """The same by the picture's brightness, in which all layers show; None without."""
        if self.brightness is None:
            return None
        rivals = [rival for rival in range(len(self.every)) if rival != self.number]
        return replace(self, own=self.brightness, hiding=rivals).smeared

    @classmethod
    def of_layers(
        cls, picture: Picture, looks: Sequence[Look], spots_px: Sequence[Pixels], given: bool
    ) -> list[LayerSignal]:
        """Return the signal of every layer.

        Parameters
        ----------
        picture
            (h, w, 3) counts at rest.
        looks, spots_px
            First look at every layer, and (n, 2) centres of its spots, px; NaN where there is none.
        given
            Whether the projections of ``looks`` are to be used as they are.
        """
        # Colours of the markers, less the ground's; each projection is blind to the other colours.
        own = [np.asarray(look.weights) for look in looks]
        widest = max(look.diameter_px for look in looks)
        lit = [
            _marker_colours(picture, spots, look.diameter_px, np.concatenate(spots_px), widest)
            for spots, look in zip(spots_px, looks, strict=True)
        ]
        colours = [np.median(apart, axis=0) if len(apart) else np.zeros(3) for _, _, apart in lit]
        visible = all(np.abs(colour).max() >= LEAST_CONTRAST_DN for colour in colours)
        if not given and len(looks) > 1 and visible:
            inverse = np.linalg.pinv(np.array(colours), rcond=0.05).T
            own = [row / max(float(np.abs(row).max()), 1e-12) for row in inverse]
        # The ground's level in each of them, and the level from which on another layer shows.
        # Most of a wide picture may show what surrounds the sensor, unlike the ground.
        drawn = np.concatenate([look.nominal_px for look in looks])
        last = np.array(picture.shape[1::-1]) - 1
        ends = np.clip([drawn.min(axis=0), drawn.max(axis=0)], 0, last)
        (left, top), (right, bottom) = ends.astype(int)
        parts = (picture[::4, ::4], picture[top : bottom + 1 : 4, left : right + 1 : 4])
        samples = [part.reshape(-1, 3).astype(float) for part in parts]

        def ground(weights: Floats, colour: Floats) -> float:
            whole, near = (float(np.median(sample @ weights)) for sample in samples)
            return near if abs(near - whole) > 0.5 * abs(weights @ colour) else whole

        def with_ground(weights: Floats, colour: Floats) -> Singles:
            return np.array([*weights, ground(weights, colour)], np.float32)

        shows = []
        mosaic = Flaws.mosaic_sites(picture)
        for weights, colour, part in zip(own, colours, lit, strict=True):
            known = float(mosaic is None)
            terms = np.zeros((2, 6))
            terms[:, 0] = ground(weights, colour), weights @ colour
            # where light falls off the ground would show, and dim markers would not
            places, behind, apart = part
            smooth = Templates.smooth(
                np.column_stack([behind @ weights, apart @ weights]), places, picture.shape
            )
            here, bright = smooth @ slope_terms(places, picture.shape).T
            if (
                len(places) >= QUADRATIC
                and np.ptp(here) > FALLS * terms[1, 0]
                and min(bright) > 0.0
            ):
                terms = smooth
            shows.append([*weights, *terms.ravel(), known])
        whole, inside = (
            [
                Flaws.covered(picture, spots, max(0.5 * look.diameter_px - less, 0.0))
                for spots, look in zip(spots_px, looks, strict=True)
            ]
            for less in (-MARGIN_PX, MARGIN_PX + USUAL_BLUR_PX)
        )
        around = [
            Flaws.covered(picture, spots, 0.5 * look.diameter_px + USUAL_BLUR_PX + MARGIN_PX)
            for spots, look in zip(spots_px, looks, strict=True)
        ]

        def lies_in_front(number: int, rival: int) -> bool:
            """Return whether the layer is as bright where the rival's markers are as elsewhere, and
            these don't show in it: then they don't hide it."""
            mine, its = inside[number], whole[rival]
            weights, level = own[number], float(own[number] @ colours[number])
            if not abs(weights @ colours[rival]) < BLIND * level:
                return False
            crossing, alone = picture[mine & its] @ weights, picture[mine & ~its] @ weights
            if min(len(crossing), len(alone)) < CROSSING:
                return False
            darker = np.median(alone) - np.quantile(crossing, DARKER)
            return bool(darker < SAME_LEVEL * level)

        def shaded(number: int, rival: int) -> float:
            """Return the share of the layer's light that it lacks around the rival's markers."""
            mine, near = inside[number], around[rival]
            close = picture[mine & near & ~whole[rival]] @ own[number]
            away = picture[mine & ~near] @ own[number]
            if min(len(close), len(away)) < CROSSING:
                return 0.0
            lacks = np.median(away) - np.median(close)
            return max(float(lacks) / max(float(own[number] @ colours[number]), 1.0), 0.0)

        layers = range(len(own))
        in_front = [[lies_in_front(one, other) for other in layers] for one in layers]
        every = np.array(shows, np.float32).reshape(-1, 16)
        signals = []
        for number, (weights, colour) in enumerate(zip(own, colours, strict=True)):
            bright = float(LUMA @ colour)
            in_brightness = abs(bright) > LEAST_LUMA * float(np.abs(colour).max())
            mixed = np.sign(bright) * LUMA
            if not in_brightness:
                mixed = weights + MIXED * mixed
            brightness = None if given else with_ground(mixed / np.abs(mixed).max(), colour)
            hiding = [rival for rival in layers if rival != number and not in_front[number][rival]]
            as_seen = every.copy()  # which lies in front may not be seen
            as_seen[:, UNCOVERED] *= [in_front[rival][number] for rival in layers]
            channel = int(np.abs(weights).argmax())
            one_colour = np.abs(weights[channel]) > ONE_COLOUR * np.abs(weights).sum()
            sites = EVERYWHERE
            if mosaic is not None and one_colour:
                sites = mosaic[channel].astype(np.float32)
            signals.append(
                cls(
                    own=with_ground(weights, colour),
                    number=number,
                    hiding=hiding,
                    every=as_seen,
                    shade=max((shaded(number, rival) for rival in hiding), default=0.0),
                    brightness=brightness,
                    bright=bool(in_brightness),
                    sites=sites,
                )
            )
        return signals

    def make_templates(
        self,
        picture: Picture,
        spots_px: Pixels,
        cut: Bools,
        diameter_px: float,
        marks_px: Pixels,
    ) -> tuple[Templates, Pixels]:
        """Make the templates of the layer's markers.

        Parameters
        ----------
        picture
            (h, w, 3) counts at rest.
        spots_px, cut
            (n, 2) centres of the spots, px; (n,) which the picture's frame cuts: these have the
            others' outline.
        diameter_px
            About how wide they are.
        marks_px
            (q, 2) centres of the spots of all layers, px.

        Returns
        -------
        templates
            `Templates.rest` is not known yet.
        start_px
            (n, 2) where their fits start at rest, px.
        """
        own = self.own
        others = Templates.others_at(self.others, spots_px, picture.shape)
        count, wanted = len(spots_px), np.isfinite(spots_px).all(axis=1)
        radius = np.where(wanted & ~cut, 0.5 * diameter_px, np.nan)
        # The noise in single pixels: a full marker's is never taken for less than the ground's.
        variances = _noise_variances(
            picture, own, self.sites, spots_px, 0.5 * diameter_px, USUAL_BLUR_PX
        )
        noise = _smooth_noise(variances, spots_px, picture.shape)
        ground_slopes = _ground_slopes(
            picture, self, spots_px, 0.5 * diameter_px, marks_px, noise[:, 0]
        )
        # Blur and bulge are the layer's, by a sample of its markers; then every marker is fitted.
        shape = np.full((count, SHAPE + 3), np.nan)
        if wanted.any():
            every = max(1, int(np.isfinite(radius).sum()) // SAMPLE)
            few = np.where(np.cumsum(np.isfinite(radius)) % every == 0, radius, np.nan)
            reach = 0.65 * diameter_px + 2.0 * USUAL_BLUR_PX + MARGIN_PX
            around = slope_terms(spots_px, picture.shape) @ ground_slopes.T
            seen = (picture, own, others, self.sites, around, spots_px)
            first = fit_shapes(
                *seen, few, reach, noise, USUAL_BLUR_PX, free_bulge=True, free_blur=True
            )
            good = np.isfinite(first[:, 0])
            blur = float(np.median(first[good, BLUR])) if good.any() else USUAL_BLUR_PX
            bulge = float(np.median(first[good, BULGE])) if good.any() else 0.0
            reach = 0.65 * diameter_px + 2.0 * blur + MARGIN_PX
            shape = fit_shapes(*seen, radius, reach, noise, blur, bulge)
        # Markers that could not be fitted have the median shape.
        good = np.isfinite(shape[:, 0])
        if good.any():
            shape[wanted & ~good, :SHAPE] = np.median(shape[good, :SHAPE], axis=0)
        places = np.where(good[:, None], shape[:, SHAPE : SHAPE + 2], spots_px)
        slopes = _share_slopes(shape, places, good, picture.shape)
        axes = np.hypot(shape[:, [0, 2]], shape[:, [1]]).max(axis=1)
        margin = np.fmax(MARGIN_PX, GROWS * axes)
        reach = float(np.nanmax(axes + shape[:, BLUR] + margin, initial=3.0 + MARGIN_PX))
        unknown = np.zeros((count, COLUMNS))
        unknown[:, [MISFIT, FITTING]] = 1.0
        ground = shape[:, SHAPE + 2]
        templates = Templates(
            own=own,
            others=self.others,
            sites=self.sites,
            shape=for_kernel(shape[:, :SHAPE]),
            ground=_evenly_lit(np.where(np.abs(ground) > 0.5 * shape[:, BRIGHT], ground, 0.0)),
            ground_slopes=ground_slopes,
            noise=noise,
            gain=1.0,
            slopes=slopes,
            usual_misfit=1.0,
            level=shape[:, BRIGHT].copy(),
            reach_px=reach,
            coherent=False,
            rest=unknown,
        )
        # The rest picture fitted by its own templates gives ground, level and the usual misfit.
        fitted = templates.fit(picture, places)
        templates = replace(templates, gain=_gain(picture, templates, fitted[:, CENTRE]))
        fitted = templates.fit(picture, for_kernel(fitted[:, CENTRE]))
        misfit = fitted[np.isfinite(fitted[:, MISFIT]), MISFIT]
        usual = float(np.quantile(misfit, USUAL)) if len(misfit) else 1.0
        settled = replace(
            templates,
            ground=_evenly_lit(np.nan_to_num(fitted[:, GROUND])),
            usual_misfit=max(usual, 1.0),
            level=fitted[:, LEVEL],
            coherent=usual > WHITE,
        )
        return settled, np.ascontiguousarray(fitted[:, CENTRE])


def _marker_colours(
    picture: Picture, centres: Pixels, diameter: float, marks: Pixels, widest: float
) -> tuple[Pixels, Floats, Floats]:
    """Return (k, 2) places of markers, (k, 3) their ground and how they differ from that, counts.
    Their ground is where none of the ``marks`` (q, 2), up to ``widest`` px, is."""
    middle = np.rint(centres[np.isfinite(centres).all(axis=1)]).astype(int)
    far = int(np.ceil(0.5 * diameter)) + 4
    height, width = picture.shape[:2]
    inside = ((middle >= far) & (middle < [width - far, height - far])).all(axis=1)
    if not inside.any():
        return np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 3))
    column, row = middle[inside].T
    half = int(0.2 * diameter)
    near = range(-half, half + 1)
    spot = np.mean([picture[row + j, column + i] for j in near for i in near], axis=0)
    around = middle[inside] + np.array([(far, 0), (-far, 0), (0, far), (0, -far)])[:, None]
    ring = picture[around[..., 1], around[..., 0]].astype(float)
    away, _ = cKDTree(marks[np.isfinite(marks).all(axis=1)]).query(around)
    free = away > 0.5 * widest + CLEAR_PX
    if not free.any():  # too dense
        behind = np.broadcast_to(np.median(picture[::4, ::4], axis=(0, 1)), spot.shape)
        return middle[inside].astype(float), behind, spot - behind
    ring[~free] = np.nan
    some = free.any(axis=0)
    behind = np.nanmedian(ring[:, some], axis=0)
    return middle[inside][some].astype(float), behind, spot[some] - behind


def _gain(picture: Picture, templates: Templates, centres: Pixels) -> float:
    """Return `Templates.gain`: the length of the first step back from places `ASIDE_PX` beside the
    ``centres`` (n, 2), over the way back; the median over markers and axes."""
    steps = []
    for aside in (ASIDE_PX, -ASIDE_PX):
        first = templates.fit(picture, for_kernel(centres + aside), turns=1)[:, CENTRE]
        steps.append(1.0 - (first - centres) / aside)
    gains = np.concatenate(steps)
    gains = gains[np.isfinite(gains).all(axis=1)]
    return float(np.clip(np.median(gains), *GAINS)) if len(gains) else 1.0


def _share_slopes(shape: Floats, places: Pixels, good: Bools, size: Sequence[int]) -> Floats:
    """Split the fitted slopes: return the shared part (2, 6), and leave in ``shape`` what is
    clearly a marker's own."""
    shared = Templates.smooth(shape[good, 3:5], places[good], size)
    shape[good, 3:5] -= slope_terms(places[good], size) @ shared.T
    own = np.hypot(shape[:, 3], shape[:, 4]) * np.hypot(shape[:, 0], shape[:, 2]) / np.sqrt(2.0)
    shape[~(good & (own > OWN_SLOPE)), 3:5] = 0.0
    return shared


def _evenly_lit(ground: Floats) -> Floats:
    """Return (n, 4) `Templates.ground` in the light at rest."""
    return np.pad(ground[:, None], ((0, 0), (0, 3)))


def in_other_light(
    picture: Picture,
    templates: Templates,
    fitted: Floats,
    around: Neighbourhood,
    at_rest: tuple[bool, Floats, Floats],
) -> tuple[Templates, Floats] | None:
    """Return templates whose brightness slopes as the light does now, and their fits, where that
    has changed from marker to marker since rest; None where it has not.

    Light multiplies what it falls on: the logarithm of the change of the ground, or of the markers
    where these are brighter, is a plane over a marker and its neighbours. Its slope, times the
    ground's and the marker's brightness, is theirs. What lies off the planes is what the slope is
    not known to. ``fitted`` (n, `COLUMNS`) are the fits without; ``at_rest``
    are whether markers are brighter than the ground, the (n,) brightness at rest of what is, and
    the (n, 2) slopes of its logarithm, 1/px.
    """
    near = around.near
    place, level = fitted[:, CENTRE], fitted[:, LEVEL]
    ground = fitted[:, GROUND] + templates.own[3]
    whole = ground + level
    shows, before, slope_before = at_rest
    now = whole if shows else ground
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.log(np.minimum(np.maximum(now / before, LIGHT[0]), LIGHT[1]))
    # A slope of the ground moves a centre by the sum of edge times slope over that of the edge
    # squared; one of the marker, about as the mean of both.
    shape, radius = templates.shape, templates.radius_px
    edge = 5.0 / 7.0 * level * (1.0 + shape[:, BULGE]) / shape[:, BLUR]
    moves = np.abs(ground) * radius / edge + 0.25 * np.abs(whole) / level * radius**2
    sd = np.sqrt(fitted[:, VAR_X])
    step = np.abs(change[near[:, 0]] - change) * moves / (around.spacing_px * sd)
    known = np.isfinite(step)
    if np.count_nonzero(known) < LINEAR or not np.mean(step[known] ** 2) > RELIT**2:
        return None
    fitted[:, LIT] = change
    # less what markers that have moved see of the light at rest
    change -= ((place - templates.rest[:, CENTRE]) * slope_before).sum(axis=1)
    slope, off, left = around.slopes(change, place)
    if left > UNLIT:
        return None
    unsure = off / around.spacing_px * moves
    mark = shape.copy()
    mark[:, 3:5] += slope * (whole / level)[:, None]
    lit = templates.ground.copy()
    lit[:, 1:3] = slope * ground[:, None]
    lit[:, 3] = unsure**2
    lit, mark = np.nan_to_num(lit), np.where(np.isfinite(mark), mark, shape)
    relit = replace(templates, shape=for_kernel(mark), ground=lit)
    return relit, relit.fit(picture, for_kernel(place))


def _noise_variances(
    picture: Picture,
    own: Singles,
    sites: Singles,
    centres: Pixels,
    radius: float,
    blur: float,
) -> Floats:
    """Return (n, 2): variance of the noise around, and inside, every marker, from 2 x 2
    differences; NaN if none.

    Neither a slope nor a marker's round shading changes a 2 x 2 difference.
    """
    reach = int(np.ceil(1.3 * radius + blur + 4.0))
    inner = (1.0 - blur / radius) ** 2 if radius > blur else 0.0
    outer = (1.0 + (blur + 0.5) / radius) ** 2
    side = np.arange(-reach, reach + 2)
    offset = np.stack(np.meshgrid(side, side)).reshape(2, -1)
    known = np.flatnonzero(np.isfinite(centres).all(axis=1))
    signal, use = np.empty((2, len(known), offset.shape[1]), np.float32)
    nothing, middle = np.zeros((0, 6), np.float32), np.rint(centres[known]).astype(np.int64)
    for k, (column, row) in enumerate(middle):
        gather(picture, tuple(own), nothing, sites, column, row, offset, NO_RUNS, signal[k], use[k])
    # of a colour mosaic, differences of pixels that lie two apart: those of the same site
    apart = 1 if sites.all() else 2
    corners = list(product((slice(-apart), slice(apart, None)), repeat=2))
    signal, use = (v.reshape(-1, len(side), len(side)) for v in (signal, use))
    x, y = ((middle - centres[known])[:, :, None] + side).transpose(1, 0, 2)
    away = (y[:, :, None] ** 2 + x[:, None] ** 2) / radius**2
    first, right, below, last = (signal[:, down, along] for down, along in corners)
    square = 0.25 * (first - right - below + last).astype(float) ** 2
    # a difference belongs to the marker, or to the ground, with all four of its pixels
    inside, around = (
        np.logical_and.reduce([part[:, down, along] for down, along in corners])
        for part in (away < inner, away > outer)
    )
    seen = (use[:, :-apart, :-apart] > 0) & (use[:, apart:, apart:] > 0)
    variances = np.full((len(centres), 2), np.nan)
    for which, part in enumerate((around & ~inside & seen, inside & seen)):
        count = part.sum(axis=(1, 2))
        enough = count > 2
        total = (square * part).sum(axis=(1, 2))
        variances[known[enough], which] = total[enough] / count[enough]
    return variances


def _smooth_noise(variances: Floats, places: Pixels, size: Sequence[int]) -> Floats:
    """Return (n, 2) variances of the noise of ground and marker from the measured ones (n, 2).

    Brighter pixels have more noise: these are the medians times the smooth function of the place in
    the picture that the ground's variances follow. A full marker's is never less than its ground's.
    """
    middle = [float(np.nanmedian(v)) if np.isfinite(v).any() else np.nan for v in variances.T]
    ground, marker = np.nan_to_num(middle, nan=1.0)
    usual = np.maximum([ground, max(marker, ground)], QUANTISED)
    ratio = np.log(np.maximum(variances[:, 0], QUANTISED) / usual[0])
    known = np.isfinite(ratio + places[:, 0])
    smooth = Templates.smooth(ratio[known, None], places[known], size)[0]
    factor = slope_terms(places, size) @ smooth
    factor = np.clip(np.nan_to_num(factor), -NOISIER, NOISIER)
    if np.abs(factor).max(initial=0.0) < NOISE_VARIES:
        factor = 0.0 * factor
    return np.asarray(np.maximum(usual * np.exp(factor)[:, None], QUANTISED))


def _widest(templates: Templates) -> float:
    """Return how far a usual marker reaches with its blur, px."""
    return templates.usual_radius_px + float(templates.usual_shape[6])


def _ground_slopes(
    picture: Picture,
    layer: LayerSignal,
    centres: Pixels,
    radius: float,
    marks: Pixels,
    variances: Floats,
) -> Floats:
    """Return (2, 6) `Templates.ground_slopes` by the pixels around markers at ``centres`` (n, 2).

    Planes go through the pixels of rings, where no marker covers them; taken is the smooth function
    of the place in the picture that they follow, if it is more than chance anywhere.
    """
    nothing = np.zeros((2, 6))
    known = np.flatnonzero(np.isfinite(centres).all(axis=1))
    if len(known) < LINEAR:
        return nothing
    size, clear = picture.shape[:2], radius + USUAL_BLUR_PX
    outer = RING * radius + 2.0 * USUAL_BLUR_PX + MARGIN_PX
    ring = disc_offsets(outer)
    ring = ring[np.hypot(*ring.T) > clear + MARGIN_PX]
    covered = Flaws.covered(picture, marks, clear)
    column, row = (np.rint(centres[known]).astype(int)[:, None] + ring).transpose(2, 0, 1)
    use = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    use &= layer.sites[row % 2, column % 2] > 0.0
    column, row = np.where(use, column, 0), np.where(use, row, 0)
    use &= ~covered[row, column]
    # Least squares; a quarter of a ring at least, and not of one side alone.
    signal = picture[row, column] @ layer.own[:3].astype(float)
    terms = np.column_stack([np.ones(len(ring)), ring])
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(ring), -1)
    matrix = (use @ products).reshape(-1, 3, 3)
    least = 0.25 * (ring[:, 0] ** 2).sum() * layer.sites.mean()
    firm = matrix[:, [1, 2], [1, 2]].min(axis=1) > least
    planes = np.linalg.solve(matrix[firm], ((use * signal) @ terms)[firm, :, None])[:, 1:, 0]
    shared = Templates.smooth(planes, centres[known[firm]], size)
    steep = np.hypot(*(slope_terms(centres[known], size) @ shared.T).T) * outer
    return shared if (steep > SLOPING * np.sqrt(variances[known])).any() else nothing


@dataclass(frozen=True, kw_only=True)
class BareGround:
    """Places between the markers, where noise and texture of the ground show alone.

    The ground's texture, and noise of whole rows, move a fitted centre by a sum of pixels times the
    edge's slopes, over that of the slopes squared. So that sum is taken where no marker lies, at
    rest and later: its change is the error, whatever the noise, and whether the texture has moved
    or stayed. A marker hides the ground behind it, but not the camera's noise: that changes both
    where a marker moved from and where it moved to.

    Attributes
    ----------
    places_px, moved_px
        (q, 2) places at rest; (q, 4) how far a marker there would have been moved, px, by the
        ground around it, and by that behind it too.
    terms
        (q, 6) `slope_terms` of these places.
    marks_px
        (m, 2) markers of all layers at rest, px.
    near
        (`BESIDE`, q + m) the nearest markers of the layer: these move as the places and marks do.
    """

    places_px: Pixels
    moved_px: Floats
    terms: Floats
    marks_px: Pixels
    near: Ints

    @staticmethod
    def noise_now(picture: Picture, templates: Templates, places: Pixels) -> Floats:
        """Return (n, 2) the noise's variances in another picture than that at rest: never less, and
        more as the ground around the markers at ``places`` (n, 2), px, has more."""
        radius = float(np.nanmedian(templates.radius_px))
        variances = _noise_variances(
            picture, templates.own, templates.sites, places, radius, 2.0 * USUAL_BLUR_PX
        )
        ratio = variances[:, 0] / templates.noise[:, 0]
        return np.asarray(
            templates.noise
            * max(float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else 1.0, 1.0)
        )

    @classmethod
    def of(
        cls, picture: Picture, templates: Templates, rest_px: Pixels, marks_px: Pixels
    ) -> BareGround | None:
        """Return the places of the rest picture, whose markers are at ``rest_px`` (n, 2); None
        where they show no more than single pixels' noise, or are few."""
        marks = marks_px[np.isfinite(marks_px).all(axis=1)]
        own = np.flatnonzero(np.isfinite(rest_px).all(axis=1))
        if len(own) < BESIDE:
            return None
        height, width = picture.shape[:2]
        reach = math.ceil(templates.reach_px)
        step = max(int(np.sqrt(height * width / PLACES)), 1)
        grid = np.mgrid[reach : width - reach : step, reach : height - reach : step]
        places = grid.reshape(2, -1).T.astype(float)
        covered = Flaws.covered(picture, marks, _widest(templates))
        moved, by_noise = _moved_by_ground(picture, templates, places, covered)
        known = np.isfinite(moved[:, 0])
        if known.sum() < QUADRATIC:
            return None
        places, moved = places[known], moved[known]
        terms = slope_terms(places, picture.shape)
        if _uneven(moved, terms)[1] < WHITE * medians(by_noise[known])[1]:
            return None
        few = slice(None, None, math.ceil(len(places) / FEW_PLACES))
        places, moved, terms = places[few], moved[few], terms[few]
        near = cKDTree(rest_px[own]).query(np.concatenate([places, marks]), k=BESIDE)[1]
        return cls(places_px=places, moved_px=moved, terms=terms, marks_px=marks, near=own[near.T])

    def coherence(
        self,
        picture: Picture,
        templates: Templates,
        shift_px: Pixels,
        sd_px: Floats,
        growth: float,
    ) -> float:
        """Return how many times as large errors of shifts are as the noise of single pixels makes
        them, ``sd_px`` (n,); at least 1. ``growth`` is that of most markers since rest."""
        if np.isnan(sd_px).all():
            return 1.0
        # Where the places, and what covers them, have moved to.
        known = np.isfinite(shift_px[:, 0])
        number = known[self.near].sum(axis=0, dtype=float)
        number[number == 0.0] = np.nan
        moved_on = np.where(known[:, None], shift_px, 0.0)[self.near].sum(axis=0) / number[:, None]
        count = len(self.places_px)
        widest = max(growth, 1.0) * _widest(templates)
        covered = Flaws.covered(picture, self.marks_px + moved_on[count:], widest)

        def changed(places: Pixels, parts: int) -> Floats:
            """Return (parts,) mean squares of what the ground now moves markers at places more than
            at rest: by what is around them; of two ``parts`` by what is behind them too."""
            moved, by_noise = _moved_by_ground(picture, templates, places, covered, parts)
            at_rest = self.moved_px[:, : 2 * parts]
            change = moved - at_rest
            known = np.isfinite(change[:, 0])
            noise = medians(by_noise[known]) if known.any() else np.zeros(parts)
            if known.sum() < QUADRATIC:
                change = np.sqrt(2.0) * at_rest  # as if the texture were another one
            return np.asarray(np.fmax(_uneven(change, self.terms) - 2.0 * noise, 0.0))

        (there,) = changed(self.places_px + moved_on[:count], 1)
        if there == 0.0:
            return 1.0
        here, whole = changed(self.places_px, 2)
        camera = max(whole - here, 0.0) * min(there / max(here, 1e-12), 1.0)
        return float(np.sqrt(1.0 + (there + camera) / medians(sd_px) ** 2))


def _uneven(moved: Floats, smooth: Floats) -> Floats:
    """Return (p,) the mean squares, per axis, of ``moved`` (n, 2 p) but for what varies as
    ``smooth`` (n, 6) functions of the place, which moves markers alike at rest and later."""
    known = np.isfinite(moved[:, 0])
    moved, basis = moved[known], smooth[known]
    moved = moved - basis @ np.linalg.solve(basis.T @ basis, basis.T @ moved)
    return Neighbourhood.bounded_squares(np.concatenate([moved[:, ::2], moved[:, 1::2]]))


def _moved_by_ground(
    picture: Picture, templates: Templates, places: Pixels, covered: Bools, parts: int = 2
) -> tuple[Floats, Floats]:
    """Return how far the ground moves a usual marker's centre at ``places`` (n, 2), px: (n, 2) by
    what is around the marker, and two columns more of two ``parts``, by that behind it too; NaN
    where too much is ``covered`` (h, w). And (n, parts) the variances by single pixels' noise."""
    shape = templates.usual_shape
    radius, blur = templates.usual_radius_px, float(shape[6])
    offset, runs, _ = disc(int((radius + blur) ** 2))
    moved = np.full((len(places), 2 * parts), np.nan)
    variance = np.full((len(places), parts), np.nan)
    # of places inside the picture
    nearest, far = np.rint(places), 0.5 * np.array([picture.shape[1] - 1, picture.shape[0] - 1])
    inside = (np.abs(nearest - far) <= far - len(runs) // 2).all(axis=1)
    seen = (picture, tuple(templates.own.tolist()), templates.sites, covered)
    at = (inside, nearest, places, templates.ground_slopes, offset, runs)
    edge = (radius, blur, float(shape[7]))
    _fit_ground(*seen, *at, edge, LEAST_FREE * templates.measured, moved, variance)
    return moved, templates.usual_noise * variance


@njit(cache=True, fastmath=True)
def _fit_ground(
    image,
    own,
    sites,
    covered,
    inside,
    nearest,
    places,
    slopes,
    offset,
    runs,
    edge,
    least,
    moved,
    variance,
):
    """Fill how far the ground has ``moved`` (q, 2 p) a marker at each place ``inside`` the picture,
    and the ``variance`` (q, p) of that by unit noise, where more than the share ``least`` of its
    edge is not ``covered``: by what is around the marker, and with p = 2 by that behind it too.
    ``slopes`` (2, 6) of the ground are in the model.

    Least squares of the signal s, less its mean, by the slopes of the brightness along x and y, and
    a constant: g. With b the share of a pixel that no marker hides, or 1, the right side sums
    b s g; the matrix what a whole marker there moves by, g g; and the noise adds b b g g.
    """
    (radius, blur, level), (red, green, blue, _) = edge, own
    count, steepest = runs[:, 2].sum(), 15 / 16 * level / blur
    x, y, value, use, across, along, hides = np.empty((7, count))
    flat, hidden, width, whole = image.reshape(-1), covered.reshape(-1), image.shape[1], 0.0
    last_x, last_y = np.inf, np.inf
    for k in range(len(places)):
        if not inside[k]:
            continue
        column, row = int(nearest[k, 0]), int(nearest[k, 1])
        right, down = column - places[k, 0], row - places[k, 1]
        u, v = places[k, 0] / width - 0.5, places[k, 1] / image.shape[0] - 0.5
        slope_x, slope_y = 0.0, 0.0
        for term, factor in enumerate((1.0, u, v, u * u, u * v, v * v)):
            slope_x += slopes[0, term] * factor
            slope_y += slopes[1, term] * factor
        done = 0
        for i in range(len(runs)):
            line, first, number = row + runs[i, 0], column + runs[i, 1], runs[i, 2]
            start = line * width + first
            pixels = flat[3 * start : 3 * (start + number)]
            start = line * covered.shape[1] + first
            behind = hidden[start : start + number]
            site, other = sites[line & 1, first & 1], sites[line & 1, ~first & 1]
            at, counts = value[done : done + number], use[done : done + number]
            for p in range(number):
                at[p] = red * pixels[3 * p] + green * pixels[3 * p + 1] + blue * pixels[3 * p + 2]
            for p in range(number):
                counts[p] = (other if p & 1 else site) * (1.0 - behind[p])
            done += number
        if right != last_x or down != last_y:  # at rest all places lie alike on the pixels
            last_x, last_y, whole = right, down, 0.0
            for p in range(count):
                x[p], y[p] = offset[0, p] + right, offset[1, p] + down
            for p in range(count):
                far = math.sqrt(x[p] * x[p] + y[p] * y[p])
                depth = min(max((radius - far) / blur, -1.0), 1.0)
                square = depth * depth
                hides[p] = 0.5 + depth * (15 / 16 - square * (10 / 16 - square * 3 / 16))
                steep = steepest * (1.0 - square) ** 2 / max(far, 0.5)
                across[p], along[p] = steep * x[p], steep * y[p]
                whole += across[p] * across[p]
        # the information, of what is in sight; of all along x it is the whole
        n, mean, xx, xy, x1, yy, y1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(count):
            counts, gx, gy = use[p], across[p], along[p]
            value[p] -= slope_x * x[p] + slope_y * y[p]
            n += counts
            mean += counts * value[p]
            xx += counts * gx * gx
            xy += counts * gx * gy
            x1 += counts * gx
            yy += counts * gy * gy
            y1 += counts * gy
        mean /= max(n, 1.0)
        if min(xx, yy) <= least * whole:
            continue
        # two rows of the inverse matrix
        rows = np.array(
            [
                [yy * n - y1 * y1, x1 * y1 - xy * n, xy * y1 - x1 * yy],
                [x1 * y1 - xy * n, xx * n - x1 * x1, xy * x1 - xx * y1],
            ]
        )
        rows /= xx * rows[0, 0] + xy * rows[0, 1] + x1 * rows[0, 2]
        for part in range(variance.shape[1]):
            by_x, by_y, sx, sy = 0.0, 0.0, 0.0, 0.0
            for p in range(count):
                bare = use[p] * (1.0 - (1.0 - part) * hides[p])
                move_x = rows[0, 0] * across[p] + rows[0, 1] * along[p] + rows[0, 2]
                move_y = rows[1, 0] * across[p] + rows[1, 1] * along[p] + rows[1, 2]
                signal = bare * (value[p] - mean)
                sx += signal * move_x
                sy += signal * move_y
                by_x += bare * bare * move_x * move_x
                by_y += bare * bare * move_y * move_y
            moved[k, 2 * part], moved[k, 2 * part + 1] = sx, sy
            variance[k, part] = 0.5 * (by_x + by_y)
