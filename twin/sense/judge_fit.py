"""Accept fits that look like the marker they are taken for, and say what is wrong with the others.

Compiled: this runs for every marker of every picture, and as array expressions it took a fifth of a frame's time.
"""

from __future__ import annotations

import numpy as np

from twin.compiled import njit
from twin.sense.fit import CENTRE_X, CENTRE_Y, EDGE, LEVEL, MISFIT, PIXELS, SCALE, SQUARES, STEP, VAR_X, VAR_Y

STATES = ("seen", "missing", "dim", "merged", "occluded")
"""What a marker can be: measured; without a spot, or out of the picture; too dark; one spot with another; partly hidden
or unlike itself."""

SEEN, MISSING, DIM, MERGED, OCCLUDED = range(len(STATES))

AREA_RATIO = (0.6, 1.7)
"""Allowed change of a marker's area against rest: less is partly hidden, more has merged."""

LEVEL_RATIO = (0.3, 3.0)
"""Allowed change of a marker's brightness against rest."""

LEAST_EDGE = 0.5
"""Share of its edge by which a marker is measured; with less in sight it counts as hidden."""

UNLIKE = 0.12
"""Root mean square of what a fit leaves beyond what usual fits leave, as a share of the marker's brightness, above
which it is no picture of that marker. Noise that hangs together over pixels (a capture unit's colour) is usual."""

UNSETTLED_PX = 0.3
"""A fit whose last step was larger has found nothing."""

SAME_PLACE = 0.5
"""Two markers of a layer nearer than this share of their width are one spot."""

WHOLE_EDGE, COVERED_SD_PX = 0.9, 0.03
"""A marker with less of its edge in sight may be shadowed too: its standard deviation has this added."""

UNUSUAL, DOUBT = 1.5, 4.0
"""A marker whose residuals exceed the usual ones by this factor is doubted: its variance grows by so much of the
excess. Residuals beyond the noise hang together over several pixels, hence more than in proportion."""

SD_FLOOR_PX = 0.001
"""No centre is taken to be better than this: what a lens and a finite pixel leave even without noise."""


@njit(cache=True)
def centre_sd(fit, usual_misfit):  # type: ignore[no-untyped-def]
    """Return the standard deviation of a fitted centre, per axis, px: the noise's, more where the fit is bad."""
    bad = max(fit[MISFIT] / usual_misfit - UNUSUAL, 0.0)
    return np.sqrt(0.5 * (fit[VAR_X] + fit[VAR_Y]) * (1.0 + DOUBT * bad) + SD_FLOOR_PX**2)


@njit(cache=True)
def centre_sds(fitted, usual_misfit):  # type: ignore[no-untyped-def]
    """Return (n,) `centre_sd` of every row of `fit.fit_centres`, px; NaN where there was no fit."""
    out = np.full(len(fitted), np.nan)
    for k in range(len(fitted)):
        if np.isfinite(fitted[k, LEVEL]):
            out[k] = centre_sd(fitted[k], usual_misfit)
    return out


@njit(cache=True)
def judge_fits(fitted, rest, level, usual_misfit, rest_sd, diameter, contrast, size, shift, sd, state):  # type: ignore[no-untyped-def]
    """Fill ``shift`` (n, 2) and ``sd`` (n,), NaN where a fit is refused, and ``state`` (n,) where there was a fit.

    Parameters
    ----------
    fitted
        (n, `fit.COLUMNS`) what `fit.fit_centres` found.
    rest, level, rest_sd
        (n, 2) centres at rest, px; (n,) brightness there; (n,) standard deviation of the centre, px.
    usual_misfit
        Squared residuals of a good fit over their expected size.
    diameter, contrast, size
        Usual width of a marker, px; least brightness; (height, width) of the picture, px.
    """
    count, radius = len(fitted), 0.5 * diameter
    place_x, place_y = np.empty(count), np.empty(count)
    good = np.empty(count, np.int64)
    kept = 0
    for k in range(count):
        shift[k, 0], shift[k, 1], sd[k] = np.nan, np.nan, np.nan
        fit = fitted[k]
        if not np.isfinite(fit[LEVEL]):
            continue
        x, y, bright, mean_square = fit[CENTRE_X], fit[CENTRE_Y], fit[LEVEL], fit[SQUARES] / fit[PIXELS]
        area, against_rest = fit[SCALE] ** 2, bright / level[k]
        usual = max(usual_misfit, 1.0) / max(fit[MISFIT], 1e-9)
        unlike = np.sqrt(max(mean_square * (1.0 - usual), 0.0)) / bright
        if not (radius - 0.5 < x < size[1] - 0.5 - radius and radius - 0.5 < y < size[0] - 0.5 - radius):
            state[k] = MISSING
        elif fit[EDGE] < LEAST_EDGE:
            state[k] = OCCLUDED
        elif against_rest < LEVEL_RATIO[0] or bright < contrast:
            state[k] = DIM
        elif area > AREA_RATIO[1] or against_rest > LEVEL_RATIO[1]:
            state[k] = MERGED
        elif area < AREA_RATIO[0] or unlike > UNLIKE or fit[STEP] > UNSETTLED_PX:
            state[k] = OCCLUDED
        else:
            state[k] = SEEN
            place_x[kept], place_y[kept], good[kept] = x, y, k
            kept += 1
    near = (SAME_PLACE * diameter) ** 2
    for i in range(kept):
        alone = 0
        for j in range(kept):
            alone += (place_x[i] - place_x[j]) ** 2 + (place_y[i] - place_y[j]) ** 2 <= near
        k = good[i]
        if alone > 1:
            state[k] = MERGED
            continue
        covered = COVERED_SD_PX if fitted[k, EDGE] < WHOLE_EDGE else 0.0
        shift[k, 0], shift[k, 1] = place_x[i] - rest[k, 0], place_y[i] - rest[k, 1]
        sd[k] = np.sqrt(centre_sd(fitted[k], usual_misfit) ** 2 + covered**2 + rest_sd[k] ** 2)
