"""What every marker looks like at rest: made once from the rest picture, then fitted to every other picture.

A layer's own projection of the colours takes the other layers' colours to zero and otherwise has the least noise: for
pure dyes it is the one channel that shows the marker. (The paper's difference of red and blue carries the noise of a
second channel, which says nothing about this marker; spots are found with it, centres are not measured with it.)

The slope of brightness across a marker has two parts: what all markers share, as the lamps give it (a quadratic in the
picture), and a marker's own, if it is large. The first changes as a marker moves, the second goes along with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Picture, Pixels
from twin.sense.fit import (
    CENTRE_X,
    COLUMNS,
    LEADS,
    MARGIN_PX,
    MISFIT,
    SHAPE,
    fit_centres,
)
from twin.sense.fit_rest import fit_shapes, noise_variances

Narrow: TypeAlias = NDArray[np.float32]

USUAL_BLUR_PX = 2.0
"""Half width of a sharp lens' blur with the pixel's, px (.75 px standard deviation): where the search starts."""

SHOWS = 0.3
"""Another layer shows where it has this share of its usual level."""

OWN_SLOPE = 0.3
"""A marker's own slope, over its radius, counts above this: smaller ones cost little where they are real (a tenth of
the precision), and much where a neighbour's shadow feigns them and then moves."""

SAMPLE = 40
"""About how many markers tell the layer's blur and bulge."""

TURNS = 12
"""Most steps of a shape's fit at rest."""

SETTLED_TURNS = 24
"""Steps after which a centre no longer moves, wherever it started: a rest position that has not settled shifts every
picture after it (a marker in another's shadow by up to .15 px after 4)."""

QUADRATIC, LINEAR = 30, 12
"""From how many markers on their shared slope is a quadratic, or linear, function of the place."""

NOBODY = np.zeros((0, LEADS), np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Templates:
    """A group's templates.

    Attributes
    ----------
    own, others
        (4,) projection (r, g, b) and ground; (m, 4) the other groups' and the counts above which they show.
    shape
        (n, `fit.SHAPE`) every marker's template; NaN for markers not found at rest.
    ground
        (n,) ground around every marker at rest, counts.
    noise
        (2,) variance of the ground's noise and of a full marker's, counts squared.
    slopes
        (2, 6) shared slope of brightness, see `fit.fit_centres`.
    usual_misfit
        Squared residuals of a good fit at rest over what the noise explains: what the model lacks for every marker.
    level
        (n,) brightness at rest, counts.
    reach_px
        Radius of what is looked at around a marker, px.
    """

    own: Narrow
    others: Narrow
    shape: Floats
    ground: Floats
    noise: Floats
    slopes: Floats
    usual_misfit: float
    level: Floats
    reach_px: float

    def fit(self, picture: Picture, start_px: Pixels, turns: int = 4, lead: Ints | None = None) -> Floats:
        """Return (n, `fit.COLUMNS`) what `fit.fit_centres` finds from ``start_px``, with ``lead`` if given."""
        out = np.empty((len(start_px), COLUMNS))
        fit_centres(
            picture, self.own, self.others, np.ascontiguousarray(start_px), NOBODY if lead is None else lead,
            self.shape, self.ground, self.noise, self.slopes, self.reach_px, turns, out,
        )  # fmt: skip
        return out


def colour_of(picture: Picture, centres: Pixels, diameter: float) -> Floats:
    """Return (3,) how markers differ from their ground, counts: the median over them; zeros if there are none."""
    middle = np.rint(centres[np.isfinite(centres).all(axis=1)]).astype(int)
    far = int(np.ceil(0.5 * diameter)) + 4
    height, width = picture.shape[:2]
    inside = ((middle >= far) & (middle < [width - far, height - far])).all(axis=1)
    if not inside.any():
        return np.zeros(3)
    column, row = middle[inside].T
    near = range(-max(int(0.2 * diameter), 0), max(int(0.2 * diameter), 0) + 1)
    spot = np.mean([picture[row + j, column + i] for j in near for i in near], axis=0)
    ring = [picture[row + j, column + i] for i, j in ((far, 0), (-far, 0), (0, far), (0, -far))]
    return np.asarray(np.median(spot - np.median(ring, axis=0), axis=0), float)


def projections(colours: Sequence[Floats]) -> list[Floats]:
    """Return for every colour the (3,) projection that takes the others to zero with the least noise, largest 1."""
    matrix = np.array(colours)
    inverse = np.linalg.pinv(matrix, rcond=0.05).T
    return [row / max(float(np.abs(row).max()), 1e-12) for row in inverse]


def make_templates(
    picture: Picture, own: Sequence[Floats], centres: Sequence[Pixels], diameter: Sequence[float]
) -> list[tuple[Templates, Floats]]:
    """Return every group's templates, and its markers' first fit with them.

    Parameters
    ----------
    own
        (3,) projection of each group.
    centres
        (n, 2) about where its markers are, px; NaN for those not found.
    diameter
        Their usual width, px.
    """
    sample = picture[::4, ::4].reshape(-1, 3).astype(float)
    limits = []
    for weights, points, width in zip(own, centres, diameter, strict=True):
        level = float(weights @ colour_of(picture, points, width))
        limits.append([*weights, float(np.median(sample @ weights)) + max(SHOWS * level, 4.0)])
    made = []
    for number, (weights, points, width) in enumerate(zip(own, centres, diameter, strict=True)):
        mine = np.array([*weights, np.median(sample @ weights)], np.float32)
        others = np.array([row for i, row in enumerate(limits) if i != number], np.float32).reshape(-1, 4)
        made.append(_of_group(picture, mine, others, np.ascontiguousarray(points, float), width))
    return made


def _of_group(
    picture: Picture, own: Narrow, others: Narrow, centres: Pixels, diameter: float
) -> tuple[Templates, Floats]:
    count = len(centres)
    radius = np.where(np.isfinite(centres).all(axis=1), 0.5 * diameter, np.nan)
    circles = np.zeros((count, SHAPE))
    circles[:, 0], circles[:, 2], circles[:, 6] = radius, radius, USUAL_BLUR_PX
    variances = np.full((count, 2), np.nan)
    noise_variances(picture, own, centres, circles, variances)
    with np.errstate(all="ignore"):
        ground = float(np.nanmedian(variances[:, 0])) if np.isfinite(variances[:, 0]).any() else 1.0
        marker = float(np.nanmedian(variances[:, 1])) if np.isfinite(variances[:, 1]).any() else ground
    noise = np.maximum([ground, max(marker, ground)], 1 / 12)
    first, shape = np.full((count, SHAPE + 2), np.nan), np.full((count, SHAPE + 2), np.nan)
    if np.isfinite(radius).any():
        few = np.where(
            np.cumsum(np.isfinite(radius)) % max(1, int(np.isfinite(radius).sum()) // SAMPLE) == 0, radius, np.nan
        )
        fit_shapes(picture, own, others, centres, few, USUAL_BLUR_PX, 0.0, True, noise, TURNS, first)
        good = np.isfinite(first[:, 0])
        blur, bulge = (float(np.median(first[good, i])) if good.any() else v for i, v in ((6, USUAL_BLUR_PX), (5, 0.0)))
        fit_shapes(picture, own, others, centres, radius, blur, bulge, False, noise, TURNS, shape)
    good, wanted = np.isfinite(shape[:, 0]), np.isfinite(radius)
    if good.any():
        shape[wanted & ~good, :SHAPE] = np.median(shape[good, :SHAPE], axis=0)
    places = np.where(good[:, None], shape[:, SHAPE:], centres)
    slopes = _share_slopes(shape, places, good, picture.shape)
    axes = np.hypot(shape[:, [0, 2]], shape[:, [1]]).max(axis=1) + shape[:, 6]
    reach = float(np.nanmax(axes, initial=3.0)) + MARGIN_PX
    templates = Templates(
        own=own, others=others, shape=np.ascontiguousarray(shape[:, :SHAPE]), ground=np.zeros(count), noise=noise,
        slopes=slopes, usual_misfit=1.0, level=shape[:, 7].copy(), reach_px=reach,
    )  # fmt: skip
    fitted = templates.fit(picture, places, turns=SETTLED_TURNS)
    misfit = fitted[np.isfinite(fitted[:, MISFIT]), MISFIT]
    usual = float(np.quantile(misfit, 0.25)) if len(misfit) else 1.0
    settled = replace(templates, ground=np.nan_to_num(fitted[:, 3]), usual_misfit=max(usual, 1.0), level=fitted[:, 2])
    return settled, settled.fit(picture, used_centres(fitted), turns=SETTLED_TURNS)


def slope_terms(places: Pixels, size: Sequence[int]) -> Floats:
    """Return (n, 6) 1, u, v, u^2, u v, v^2 of picture positions; u, v from -1/2 to 1/2 across the (h, w) picture."""
    u, v = places[:, 0] / size[1] - 0.5, places[:, 1] / size[0] - 0.5
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _share_slopes(shape: Floats, places: Pixels, good: NDArray[np.bool_], size: Sequence[int]) -> Floats:
    """Split the fitted slopes: return the shared part (2, 6), and leave in ``shape`` what is clearly a marker's own."""
    shared = np.zeros((2, 6))
    count = int(good.sum())
    terms = 6 if count >= QUADRATIC else 3 if count >= LINEAR else 0
    basis = slope_terms(places[good], size)[:, :terms]
    for axis in range(2):
        slope = shape[good, 3 + axis]
        weight = np.ones(count)
        for _ in range(5 if terms else 0):
            shared[axis, :terms] = np.linalg.lstsq(basis * weight[:, None], slope * weight, rcond=None)[0]
            rest = np.abs(slope - basis @ shared[axis, :terms])
            weight = np.sqrt(np.minimum(1.0, 1.5 * max(float(np.median(rest)), 1e-9) / np.maximum(rest, 1e-9)))
        shape[good, 3 + axis] = slope - basis @ shared[axis, :terms]
    own = np.hypot(shape[:, 3], shape[:, 4]) * np.hypot(shape[:, 0], shape[:, 2]) / np.sqrt(2.0)
    shape[~(good & (own > OWN_SLOPE)), 3:5] = 0.0
    return shared


def used_centres(fitted: Floats) -> Pixels:
    """Return the (n, 2) centres of a fit, px."""
    return np.ascontiguousarray(fitted[:, CENTRE_X : CENTRE_X + 2])
