"""The fits of a marker's whole picture, and of the part of it that is in sight.

`fit_shapes` fits every marker at rest, which gives its template, and later those that no longer
look as at rest: outline, brightness and blur. `fit_visible` fits markers of which a part is hidden,
or cut off by the picture's frame.

A marker that lacks light on one side is either partly hidden or smaller than it was. Its own
picture does not say which, so its neighbours' do: the outline, blur and brightness are expected to
have changed as theirs have (`Expected`), and may differ by as much as theirs scatter. What hides a
marker in its ground's colour takes light away and adds none. So a first fit lets light be missing
but not be too much; then the pixels that lack light are left out, with those around them that the
blur reaches, and the others are fitted. The stated deviation follows from the pixels left in, and
from how well outline and brightness are known: with an edge on one side alone an error of the size
is an error of the place.

Validity of `fit_visible`: something of the ground's colour in front of the marker; a fifth of the
edge's information left. What is brighter than the ground, as a glint, is not recognised: such fits
are refused by their residuals.

Why not compiled: after the rest picture few markers of few pictures need it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, Singles
from twin.sense.template import (
    IMPERFECT,
    NO_RUNS,
    OUTLIER_SD,
    SHAPE,
    Templates,
    disc,
    gather,
    slope_terms,
)

TURNS = 12
"""Most steps of a shape's fit."""

WEAK = 1e-4
"""Pull of every parameter towards its start, relative to its own information."""

TOGETHER = 64
"""Markers that are fitted at once."""


def fit_shapes(
    picture: Picture,
    own: Singles,
    others: Singles,
    start_px: Pixels,
    radius_px: Floats,
    reach_px: float,
    noise: Floats,
    blur_px: float,
    bulge: float = 0.0,
    *,
    free_bulge: bool = False,
    free_blur: bool = False,
) -> Floats:
    """Fit markers by all their pixels out to ``reach_px``.

    Parameters
    ----------
    picture, own, others, noise
        See `twin.sense.template.Templates`.
    start_px, radius_px
        (n, 2) centres and (n,) radii to start from, px; NaN rows are left out.
    blur_px, bulge
        Half width of the blur, px, and relative bulge: where the fit starts if they are free.

    Returns
    -------
    (n, `SHAPE` + 3): the shape, then centre x, y, px, and ground; NaN where a fit failed.
    """
    out = np.full((len(start_px), SHAPE + 3), np.nan)
    known = np.flatnonzero(np.isfinite(start_px.sum(axis=1) + radius_px))
    offset, _ = disc(reach_px)
    colour = tuple(own)
    for rows in np.split(known, range(TOGETHER, len(known), TOGETHER)):
        start, radius = start_px[rows], radius_px[rows]
        middle = np.rint(start).astype(np.int64)
        signal, use = np.empty((2, len(rows), offset.shape[1]), np.float32)
        for k, (column, row) in enumerate(middle):
            gather(picture, colour, others, column, row, offset, NO_RUNS, signal[k], use[k])
        # centre x, y; ground; level, its slope x, y and bulge; growth, stretch along the axes and
        # the diagonals; blur
        p = np.zeros((len(rows), 11))
        p[:, :2], p[:, 3], p[:, 10] = start, signal[:, offset.shape[1] // 2], blur_px
        moved, live, fine = np.ones(len(rows)), np.arange(len(rows)), np.ones(len(rows), np.bool_)
        for turn in range(TURNS):
            now, r, size = p[live], radius[live], np.maximum(p[live, 3], 1.0)
            if not free_bulge:
                now[:, 6] = bulge * now[:, 3]
            limit = OUTLIER_SD**2 * (noise[1] + (IMPERFECT * now[:, 3]) ** 2)
            limit += (0.5 * now[:, 3] * np.minimum(moved[live], 2.0)) ** 2
            place = offset - (now[:, :2] - middle[live])[:, :, None]
            slopes, residual = _whole_marker(signal[live], place, now, r, bulge, free_bulge)
            if not free_blur:
                slopes[:, 10] = 0.0
            weight = use[live] / (1.0 + residual**2 / limit[:, None]) ** 2
            weighted = slopes * weight[:, None]
            matrix = weighted @ np.swapaxes(slopes, 1, 2)
            right = (weighted @ residual[:, :, None])[:, :, 0]
            # a weak pull towards no slope, no bulge, round and the usual blur: small markers leave
            # these open
            pull = np.zeros_like(now)
            pull[:, 4:6], pull[:, 6] = 4.0 * ((r / size) ** 2)[:, None], 4.0 / size**2
            pull[:, 8:10], pull[:, 10] = 4.0 / r[:, None] ** 2, 1.0
            away = now - np.array([0.0] * 10 + [blur_px])
            away[:, 7:10] = 0.0
            right -= pull * away * np.array([1.0] * 6 + [free_bulge] + [1.0] * 4)
            diagonal = matrix[:, range(11), range(11)]
            diagonal[:, [6, 10]] += [not free_bulge, not free_blur]
            matrix[:, range(11), range(11)] = diagonal + pull + WEAK * diagonal + 1e-9
            step = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
            most = np.stack(
                [0.5 * r] * 2 + [np.full(len(r), np.inf)] * 5 + [0.2 * r] * 3 + [0 * r + 0.4], 1
            )
            now += np.clip(step, -most, most)
            now[:, 10] = np.clip(now[:, 10], 0.7, 1.2 * r)
            p[live] = now
            moved[live] = np.sqrt(
                step[:, 0] ** 2 + step[:, 1] ** 2 + np.clip(step[:, 7], -0.2 * r, 0.2 * r) ** 2
            )
            axes = _axes(now, r)
            good = (now[:, 3] > 0.0) & (axes[:, [0, 2]].min(axis=1) > 0.4 * r)
            good &= (axes[:, [0, 2]].max(axis=1) < 1.6 * r) & (np.abs(axes[:, 1]) < 0.5 * r)
            fine[live[~good]] = False
            live = live[good & ~((turn > 1) & (moved[live] < 3e-3))]
            if not len(live):
                break
        fine &= (np.abs(p[:, :2] - start) <= radius[:, None]).all(axis=1)
        level = p[:, 3:4]
        round_part = p[:, 6:7] / level if free_bulge else np.full_like(level, bulge)
        shape = [_axes(p, radius), p[:, 4:6] / level, round_part, p[:, 10:11], level]
        out[rows[fine]] = np.concatenate([*shape, p[:, :2], p[:, 2:3]], axis=1)[fine]
    return out


def _axes(p: Floats, radius: Floats) -> Floats:
    """Return (k, 3) semi-axes xx, xy, yy of discs grown and stretched, px."""
    return np.asarray(radius[:, None] * [1.0, 0.0, 1.0] + p[:, 7:10] @ STRETCHES)


def _whole_marker(
    signal: Singles, place: Floats, p: Floats, radius: Floats, bulge: float, free_bulge: bool
) -> tuple[Floats, Floats]:
    """Return (k, 11, m) derivatives of the model by the parameters of `fit_shapes`, and (k, m) what
    it leaves; ``place`` (k, 2, m) are offsets from the centres."""
    xx, xy, yy = _inverse_form(_axes(p, radius))
    x, y = place[:, 0], place[:, 1]
    ax, ay = xx * x + xy * y, xy * x + yy * y
    squared = ax * x + ay * y
    steep = np.sqrt(ax * ax + ay * ay) + 1e-9
    away, blur = np.sqrt(squared), p[:, 10:]
    inside = (1.0 - away) * (away + 1e-3) / (steep + 1e-3 * np.sqrt(xx))
    cover, fall, v = _profile(inside / blur)
    curved = np.minimum(squared, 1.0)
    ground, level, slope_x, slope_y, round_part = (p[:, i : i + 1] for i in range(2, 7))
    light = level + slope_x * x + slope_y * y + round_part * curved
    tilt = light * fall / blur
    nx, ny = ax / steep, ay / steep
    slopes = np.empty((*signal.shape[:1], 11, *signal.shape[1:]))
    slopes[:, 0], slopes[:, 1], slopes[:, 2] = tilt * nx, tilt * ny, 1.0
    slopes[:, 3] = cover if free_bulge else cover * (1.0 + bulge * curved)
    slopes[:, 4], slopes[:, 5] = cover * x, cover * y
    slopes[:, 6] = cover * curved if free_bulge else 0.0
    slopes[:, 7], slopes[:, 8] = tilt, tilt * (nx * nx - ny * ny)
    slopes[:, 9], slopes[:, 10] = tilt * 2.0 * nx * ny, -tilt * v
    return slopes, signal - ground - light * cover


def _inverse_form(axes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the (k, 1) xx, xy, yy of the inverse squares of symmetric matrices (k, 3)."""
    xx, xy, yy = axes.T[:, :, None]
    a, b, c = xx * xx + xy * xy, xy * (xx + yy), yy * yy + xy * xy
    determinant = np.maximum(a * c - b * b, 1e-6)
    return c / determinant, -b / determinant, a / determinant


def _profile(distance: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the covered share at a distance inside the edge, in half widths of the blur, its
    derivative, and the distance, cut off at 1."""
    v = np.clip(distance, -1.0, 1.0)
    v2 = v * v
    cover = 0.5 + v * (15 / 16 - v2 * (10 / 16 - v2 * 3 / 16))
    return cover, 15 / 16 * (1.0 - v2) ** 2, v


STRETCHES = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Growth, stretch along the axes and the diagonals, as changes of the semi-axes xx, xy, yy."""

FREE = 7
"""Centre x, y, ground, level; growth, stretch along the axes and the diagonals."""

NARROWER = 0.6
"""Missing light counts less above a limit, which falls by this factor with every step from half
the brightness on: first it may be that the start is wrong, later that a part is hidden."""

FIRST, LATER, LAST = 8, 11, 20
"""Steps after which pixels are left out, and looked at again; and the most steps."""

LACKS = 3.0
"""A pixel, with its neighbours, that lacks light by so many standard deviations is hidden. Those of
a mean are less by the root of the number, but not where noise hangs together over pixels."""

BESIDE_PX, BESIDE, AROUND_PX, AROUND = 1.5, 0.45, 2.1, 0.6
"""How far neighbours are, and around a hidden pixel those that are not used as the blur reaches
them: px, and shares of the blur's half width where that is more."""

SETTLED_PX, LARGEST_STEP = 2e-3, 0.4


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What markers should look like, were they whole.

    Attributes
    ----------
    axes, axes_sd
        (k, 3) semi-axes xx, xy, yy, px; (k,) how well growth and stretches are known, px.
    level, level_sd
        (k,) brightness, counts.
    blur
        (k,) half width of the blur, px.
    bare
        (k,) whether nothing hides them, but the picture's frame may cut them.
    """

    axes: Floats
    axes_sd: Floats
    level: Floats
    level_sd: Floats
    blur: Floats
    bare: Bools


@dataclass(frozen=True, kw_only=True)
class _VisiblePart:
    """Fits of the parts in sight.

    Attributes
    ----------
    centre_px, sd_px
        (k, 2) centres; (k,) their standard deviations per axis, px.
    misfit, pixels
        (k,) squared residuals over their expected size, and over how many pixels.
    edge, covered, hidden
        (k,) share of the edge's information that is used, and that another layer covers; share of
        the marker that is hidden.
    level, ground
        (k,) brightness, counts.
    step_px
        (k,) last step.
    """

    centre_px: Pixels
    sd_px: Floats
    misfit: Floats
    pixels: Ints
    edge: Floats
    covered: Floats
    hidden: Floats
    level: Floats
    ground: Floats
    step_px: Floats


def fit_visible(
    picture: Picture, templates: Templates, rows: Ints, start_px: Pixels, expected: Expected
) -> _VisiblePart:
    """Fit the parts in sight of the markers ``rows``, from (k, 2) ``start_px`` on."""
    known = templates.shape[rows]
    noise = templates.noise * templates.usual_misfit
    reach = float(np.max(expected.axes[:, [0, 2]].max(axis=1) + expected.blur)) + 2.0
    offset = _offsets(reach)
    middle = np.rint(start_px).astype(np.int64)
    place = middle[:, None] + offset
    signal, use, inside = _signal(picture, templates, place)
    far = np.hypot(*offset.T) > reach - 1.5
    ground = np.array([_median(s[u & far]) for s, u in zip(signal, use, strict=True)])
    blurred, length = float(np.max(expected.blur)), (offset**2).sum(axis=1).astype(np.float32)
    apart = length[:, None] + length - 2.0 * (offset @ offset.T.astype(np.float32))  # squared
    beside = (apart < max(BESIDE_PX, BESIDE * blurred) ** 2).astype(np.float32)
    around = (apart <= max(AROUND_PX, AROUND * blurred) ** 2).astype(np.float32)
    number = np.maximum(use @ beside, 1.0) ** (1.0 if templates.coherent else 0.5)
    spread = np.stack([expected.level_sd, *3 * [expected.axes_sd]], axis=1)
    held = np.concatenate([np.zeros((len(rows), 3)), spread**-2.0], axis=1)

    centre, level, ratio = np.array(start_px, float), expected.level.copy(), 0.5
    change, hidden = np.zeros((len(rows), 3)), np.zeros(signal.shape, np.bool_)
    radius = np.sqrt(np.maximum(expected.axes[:, 0] * expected.axes[:, 2], 0.25))
    most = LARGEST_STEP * radius[:, None]
    for turn in range(LAST):
        # the model and its slopes along the parameters
        terms = slope_terms(centre, picture.shape)
        slope = known[:, 3:5] + terms @ templates.slopes.T
        axes = expected.axes + change @ STRETCHES
        cover, light, tilt, normal = _model(place - centre[:, None], axes, slope, known, expected)
        model, tilt = cover * light, level[:, None] * tilt
        residual = signal - ground[:, None] - level[:, None] * model
        share = np.clip(model, 0.0, 1.0)
        expected_square = noise[0] + (noise[1] - noise[0]) * share
        edge = 4.0 * np.clip(cover * (1.0 - cover), 0.0, 0.25)
        variance = expected_square + (IMPERFECT * level[:, None]) ** 2 * edge
        # missing light counts less than too much of it; later it is left out
        if turn < FIRST:
            limit = np.maximum(ratio * level, 4.0 * np.sqrt(noise[1]))[:, None]
            trust = np.where(residual > 0.0, 1.0, 1.0 / (1.0 + (residual / limit) ** 2) ** 2)
            weight = use * trust / variance
            ratio *= NARROWER
        else:
            if turn in (FIRST, LATER):
                score = (use * residual / np.sqrt(variance)) @ beside / number
                lacks = (score < -LACKS) & use & (cover > 0.03) & ~expected.bare[:, None]
                hidden = lacks @ around > 0.0
            odd = residual**2 / (OUTLIER_SD**2 * variance)
            weight = (use & ~hidden) / variance / (1.0 + odd) ** 2
        # a Gauss-Newton step, with what is known of level and outline
        x, y = normal
        rows_ = [tilt * x, tilt * y, np.ones_like(tilt), model]
        rows_ += [tilt, tilt * (x * x - y * y), tilt * 2.0 * x * y]
        slopes = np.stack(rows_, axis=1)
        weighted = slopes * weight[:, None]
        matrix = weighted @ np.swapaxes(slopes, 1, 2)
        right = (weighted @ residual[:, :, None])[:, :, 0]
        matrix[:, range(FREE), range(FREE)] += held + 1e-9
        away = np.concatenate([(level - expected.level)[:, None], change], axis=1)
        right[:, 3:] -= held[:, 3:] * away
        step = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
        centre += np.clip(step[:, :2], -most, most)
        ground = ground + step[:, 2]
        level = np.maximum(level + step[:, 3], 0.3 * expected.level)
        change += np.clip(step[:, 4:], -0.25 * most, 0.25 * most)
        if turn > LATER and np.hypot(step[:, 0], step[:, 1]).max() < SETTLED_PX:
            break
    used = use & ~hidden
    count = used.sum(axis=1)
    squares = (residual**2 * used / expected_square).sum(axis=1)
    covariance = np.linalg.inv(matrix)
    return _VisiblePart(
        centre_px=centre,
        sd_px=np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])),
        misfit=templates.usual_misfit * squares / np.maximum(count, 1),
        pixels=count,
        edge=(tilt**2 * used).sum(axis=1) / np.maximum((tilt**2).sum(axis=1), 1e-9),
        covered=(tilt**2 * (inside & ~use)).sum(axis=1) / np.maximum((tilt**2).sum(axis=1), 1e-9),
        hidden=(cover * (hidden & use)).sum(axis=1) / cover.sum(axis=1),
        level=level,
        ground=ground,
        step_px=np.hypot(step[:, 0], step[:, 1]),
    )


def _offsets(reach: float) -> Ints:
    """Return (m, 2) offsets of the pixels within ``reach``."""
    offset, runs = disc(reach)
    return np.asarray(offset[:, : int(runs[:, 2].sum())].T)


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _signal(picture: Picture, templates: Templates, place: Ints) -> tuple[Floats, Bools, Bools]:
    """Return the projected pixels at ``place`` (k, m, 2), which of them count, and which are in the
    picture."""
    height, width = picture.shape[:2]
    inside = ((place >= 0) & (place < [width, height])).all(axis=2)
    use = inside.copy()
    column, row = np.clip(place, 0, [width - 1, height - 1]).transpose(2, 0, 1)
    pixels = picture[row, column].astype(float)
    own = templates.own.astype(float)
    for other in templates.others.astype(float):
        use &= pixels @ other[:3] <= other[3]
    return pixels @ own[:3] - own[3], np.asarray(use), np.asarray(inside)


def _model(
    off: Floats, axes: Floats, slope: Floats, known: Floats, expected: Expected
) -> tuple[Floats, Floats, Floats, tuple[Floats, Floats]]:
    """Return, at offsets (k, m, 2) from the centres, the covered share, the light on it, the slope
    of the edge and its normal; as `twin.sense.template` has it, for a level of 1."""
    dx, dy = off[:, :, 0], off[:, :, 1]
    xx, xy, yy = _inverse_form(axes)
    ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
    squared = ax * dx + ay * dy + 1e-6
    steep = np.sqrt(ax * ax + ay * ay + 1e-8)
    blur = expected.blur[:, None]
    cover, fall, _ = _profile((np.sqrt(squared) - squared) / steep / blur)
    light = 1.0 + slope[:, :1] * dx + slope[:, 1:] * dy + known[:, 5:6] * np.minimum(squared, 1.0)
    return cover, light, light * fall / blur, (ax / steep, ay / steep)
