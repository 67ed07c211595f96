"""Measure a marker's centre: fit the picture of an evenly blurred ellipse. Compiled kernels only.

A marker's signal is ground + level (1 + slope . d + bulge f) E(t / blur) with d the offset from the centre, f the
squared distance in the marker's own ellipse (at most 1), t the distance inside its edge and E the integral of a
biweight, which stands for the point-spread function and the pixel. Gauss-Newton steps move the centre along the slope
of the edge, where all of a disc's information about its place is (Cramer and Rao).

Why a template: brightness that falls off to one side looks much like motion. Fitted in every picture, that slope would
cost half of the information in an 8 px marker; so it is taken from the rest picture (`twin.sense.template`), with
ellipse, bulge and blur, and every other picture is asked for centre, level, ground and scale alone. What is wrong with
the slope is then the same in both pictures and cancels in the shift.

Where another layer's marker shows, a pixel says nothing about this one and is left out. Pixels that fit badly, such as
those in another marker's shadow, count little (Geman and McClure's weights, which forget an outlier altogether).

Validity: markers at least about 4 px wide and blurred by less than their radius; a start within about half the radius.
"""

from __future__ import annotations

import numpy as np

from twin.compiled import njit
from twin.sense.gather import LANES, disc, gather, gather_inside, runs_of

SHAPE = 8
"""Numbers of a template: semi-axes xx, xy, yy in px; slope x, y in 1/px; bulge; half width of the blur in px; level."""

CENTRE_X, CENTRE_Y, LEVEL, GROUND, SCALE, VAR_X, VAR_Y, EDGE, SQUARES, PIXELS, STEP, MISFIT = range(12)
COLUMNS = 12
"""What `fit_centres` gives for a marker: centre, level, ground, scale against the template; variances of the centre;
share of the edge in sight; sum of squared residuals over how many pixels; last step in px; squared residuals over
their expected size."""

MARGIN_PX = 1.0
"""Pixels of ground beyond the blurred edge that are looked at."""

SETTLED_PX, SETTLED_GROWTH = 0.02, 0.02

OUTLIER_SD = 6.0
"""A pixel that misses by this many standard deviations counts a quarter."""

OVERSHOT, LEAST_SHARE = 0.2, 0.2
"""A step that goes back by more than this share of the last one went too far, as with blurred markers that are darker
at their edge, whose middle helps to hold them: from then on steps are shortened to what would have gone right."""

IMPERFECT, SHARE = 0.02, 0.25
"""What the model is trusted to: as a share of the brightness, and of the mean squared residual that it has (a marker
that has changed its shape misses at its edge, where its place is to be read)."""

LEADS = 3
"""Earlier markers by whose motion a start may be moved."""

SETTLED_LEAD_PX = 0.3
"""A marker whose last step was larger leads no other."""


@njit(cache=True, fastmath=True)
def _sums(signal, use, place, cx, cy, form, slope, bulge, blur, level, ground, narrow, total):  # type: ignore[no-untyped-def]
    """Add up over the pixels at ``place`` (2, m) what one step needs; float32, no branches: for the vector unit.

    (cx, cy) is the centre in the same frame, ``form`` the inverse squared axes, ``slope`` the brightness' slope.
    """
    xx, xy, yy = form
    slope_x, slope_y = slope
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    edge0, edge1, edge2 = np.float32(15 / 16), np.float32(10 / 16), np.float32(3 / 16)
    per_blur = one / blur
    n, sm, smm, si, sim = zero, zero, zero, zero, zero
    jxx, jxy, jyy, jxr, jyr = zero, zero, zero, zero, zero
    jrr, jr, jxxm, jyym, rr, edge = zero, zero, zero, zero, zero, zero
    for p in range(len(signal)):
        dx, dy = place[0, p] - cx, place[1, p] - cy
        ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
        squared = ax * dx + ay * dy + np.float32(1e-6)
        flat = one / np.sqrt(ax * ax + ay * ay + np.float32(1e-8))
        v = min(max((np.sqrt(squared) - squared) * flat * per_blur, -one), one)
        v2 = v * v
        cover = half + v * (edge0 - v2 * (edge1 - v2 * edge2))
        fall = one - v2
        light = one + slope_x * dx + slope_y * dy + bulge * min(squared, one)
        tilt = level * light * fall * fall * edge0 * per_blur
        jx, jy = tilt * ax * flat, tilt * ay * flat
        model = cover * light
        value = signal[p]
        residual = value - ground - level * model
        trust = one / (one + narrow * residual * residual)
        w = use[p] * trust * trust
        wm, wx, wy, wt = w * model, w * jx, w * jy, w * tilt
        n += w
        sm += wm
        smm += wm * model
        si += w * value
        sim += wm * value
        jxx += wx * jx
        jxy += wx * jy
        jyy += wy * jy
        jxr += wx * residual
        jyr += wy * residual
        jrr += wt * tilt
        jr += wt * residual
        jxxm += wx * jx * model
        jyym += wy * jy * model
        rr += w * residual * residual
        edge += use[p] * tilt * tilt
    total[0], total[1], total[2], total[3], total[4] = n, sm, smm, si, sim
    total[5], total[6], total[7], total[8], total[9] = jxx, jxy, jyy, jxr, jyr
    total[10], total[11], total[12], total[13], total[14], total[15] = jrr, jr, jxxm, jyym, rr, edge


@njit(cache=True)
def doubtful(noise, level, step):  # type: ignore[no-untyped-def]
    """Return the squared residual at which a pixel counts a quarter; wide while the centre still moves by ``step``."""
    return OUTLIER_SD**2 * (noise + (IMPERFECT * level) ** 2) + (0.5 * level * min(step, 2.0)) ** 2


@njit(cache=True)
def inverse_form(xx, xy, yy, scale):  # type: ignore[no-untyped-def]
    """Return the inverse square of a symmetric matrix of semi-axes (times ``scale``): xx, xy, yy."""
    a, b, c = scale * scale * (xx * xx + xy * xy), scale * scale * xy * (xx + yy), scale * scale * (yy * yy + xy * xy)
    determinant = max(a * c - b * b, 1e-6)
    return c / determinant, -b / determinant, a / determinant


@njit(cache=True)
def _led(out, start, lead, axis):  # type: ignore[no-untyped-def]
    """Return how far the markers of ``lead`` have moved along an axis from their starts: the median; 0 if none has."""
    count, a, b, c = 0, 0.0, 0.0, 0.0
    for m in lead:
        if m >= 0 and out[m, STEP] < SETTLED_LEAD_PX:
            a, b, c, count = out[m, axis] - start[m, axis], a, b, count + 1
    if count == 0:
        return 0.0
    if count < 3:
        return (a + b) / count
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True)
def fit_centres(image, own, others, start, lead, shape, ground, noise, slopes, reach, turns, out):  # type: ignore[no-untyped-def]
    """Fit every marker's centre, level, ground and scale; rows of ``out`` are `COLUMNS` numbers, NaN where it failed.

    Parameters
    ----------
    image
        (h, w, 3) uint8.
    own, others
        (4,) projection and ground; (m, 4) projections and limits above which another layer shows; float32.
    start
        (n, 2) px; NaN rows are left out.
    lead
        (n, `LEADS`) earlier rows, -1 for none: a start is moved by the median of how far these moved from theirs.
        (0, `LEADS`): starts are taken as they are.
    shape
        (n, `SHAPE`) templates.
    ground
        (n,) ground at the start, counts.
    noise
        (2,) variance of the ground's noise, and of a full marker's, counts squared.
    slopes
        (2, 6) relative slope x and y of brightness at a picture position as `slope_terms` has it; a template's own
        slope comes on top.
    reach
        Radius of what is looked at around a marker, px.
    turns
        Most steps; a marker is done when one is below `SETTLED_PX`, of which a twentieth is then left, and its size
        has settled too: one that starts at its very place may still have to grow.
    """
    rows, columns = image.shape[0], image.shape[1]
    offset = disc(reach)
    place = np.minimum(np.abs(offset), 1000).astype(np.float32) * np.sign(offset).astype(np.float32)
    room, runs = np.empty((2, offset.shape[1] + LANES), np.float32), runs_of(offset)
    signal, use = room[0, : offset.shape[1]], room[1, : offset.shape[1]]
    colour = (own[0], own[1], own[2], own[3])
    total = np.empty(16, np.float64)
    for k in range(len(start)):
        out[k, :] = np.nan
        cx, cy = start[k, 0], start[k, 1]
        if len(lead) and np.isfinite(cx + cy):
            cx, cy = cx + _led(out, start, lead[k], CENTRE_X), cy + _led(out, start, lead[k], CENTRE_Y)
        if not (np.isfinite(cx) and np.isfinite(cy) and np.isfinite(shape[k, 0])):
            continue
        xx, xy, yy, blur, level, here = shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 6], shape[k, 7], ground[k]
        mean_radius = np.sqrt(max(xx * yy - xy * xy, 0.25))
        scale, step, column, row = 1.0, 1e9, 0, 0
        share, last_x, last_y = 1.0, 0.0, 0.0
        for turn in range(turns):
            middle_x, middle_y = int(np.rint(cx)), int(np.rint(cy))
            if middle_x < 0 or middle_y < 0 or middle_x >= columns or middle_y >= rows:
                step = 1e9
                break
            if turn == 0 or abs(cx - column) > 1.0 or abs(cy - row) > 1.0:
                column, row = middle_x, middle_y
                if not gather_inside(image, colour, others, column, row, offset, runs, room[0], room[1]):
                    gather(image, own, others, column, row, offset, signal, use)
            u, v = cx / columns - 0.5, cy / rows - 0.5
            slope_x = shape[k, 3] + slopes[0, 0] + slopes[0, 1] * u + slopes[0, 2] * v
            slope_x += slopes[0, 3] * u * u + slopes[0, 4] * u * v + slopes[0, 5] * v * v
            slope_y = shape[k, 4] + slopes[1, 0] + slopes[1, 1] * u + slopes[1, 2] * v
            slope_y += slopes[1, 3] * u * u + slopes[1, 4] * u * v + slopes[1, 5] * v * v
            fxx, fxy, fyy = inverse_form(xx, xy, yy, scale)
            left = SHARE * total[14] / total[0] if turn > 0 else 0.0
            narrow = 1.0 / doubtful(max(noise[1], left), level, np.sqrt(step) if turn > 0 else 1.0)
            _sums(
                signal, use, place, np.float32(cx - column), np.float32(cy - row),
                (np.float32(fxx), np.float32(fxy), np.float32(fyy)), (np.float32(slope_x), np.float32(slope_y)),
                np.float32(shape[k, 5]), np.float32(blur), np.float32(level), np.float32(here), np.float32(narrow),
                total,
            )  # fmt: skip
            n, sm, smm, si, sim = total[0], total[1], total[2], total[3], total[4]
            determinant = n * smm - sm * sm
            jxx, jxy, jyy = total[5], total[6], total[7]
            information = jxx * jyy - jxy * jxy
            step = 1e12
            if n < 9 or determinant < 1e-5 * n * n or information < 1e-3 * jxx * jyy + 1e-9:
                break
            level = (n * sim - sm * si) / determinant
            here = (si - level * sm) / n
            if level <= 0.05 * shape[k, 7]:
                break
            step_x = (jyy * total[8] - jxy * total[9]) / information
            step_y = (jxx * total[9] - jxy * total[8]) / information
            swing = -(step_x * last_x + step_y * last_y) / max(last_x * last_x + last_y * last_y, 1e-9)
            if swing > OVERSHOT:
                share = max(share / (1.0 + swing), LEAST_SHARE)
            last_x, last_y = step_x, step_y
            limit = 0.5 * mean_radius
            step_x, step_y = min(max(share * step_x, -limit), limit), min(max(share * step_y, -limit), limit)
            cx, cy = cx + step_x, cy + step_y
            step = step_x * step_x + step_y * step_y
            growth = 1.0
            if turn > 0 or step < 0.25:
                growth = total[11] / max(total[10], 1e-9) / mean_radius
                scale = min(max(scale * (1.0 + min(max(growth, -0.1), 0.1)), 0.7), 1.3)
            if step < SETTLED_PX * SETTLED_PX and abs(growth) < SETTLED_GROWTH:
                break
        if step > 1e8:
            continue
        jxx, jxy, jyy, n = total[5], total[6], total[7], total[0]
        determinant = max(jxx * jyy - jxy * jxy, 1e-9)
        more = noise[1] - noise[0]
        across, along = noise[0] * jxx + more * total[12], noise[0] * jyy + more * total[13]
        # the middle matrix of the sandwich, taken as diagonal: exact on whole discs
        out[k, CENTRE_X], out[k, CENTRE_Y], out[k, LEVEL], out[k, GROUND] = cx, cy, level, here
        out[k, SCALE] = scale
        out[k, VAR_X] = (jyy * jyy * across + jxy * jxy * along) / (determinant * determinant)
        out[k, VAR_Y] = (jxx * jxx * along + jxy * jxy * across) / (determinant * determinant)
        out[k, EDGE] = total[15] / max(_whole_edge(xx, yy, xy, scale, blur, level, shape[k, 5]), 1e-9)
        out[k, SQUARES], out[k, PIXELS], out[k, STEP] = total[14], n, np.sqrt(step)
        out[k, MISFIT] = total[14] / max(noise[0] * n + more * total[1], 1e-9)


@njit(cache=True)
def _whole_edge(xx, yy, xy, scale, blur, level, bulge):  # type: ignore[no-untyped-def]
    """Return the sum of squared slopes around a whole ellipse's edge: length times 5/7 over the blur's half width."""
    a = scale * 0.5 * (xx + yy)
    gap = scale * np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    length = 2 * np.pi * np.sqrt(a * a + gap * gap)
    return length * (level * (1.0 + bulge)) ** 2 * 5 / 7 / blur
