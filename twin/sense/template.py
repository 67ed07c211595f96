"""A marker's template, and the fit of its centre to a picture.

A marker's signal is ground + level (1 + slope . d + bulge f) E(t / blur) with d the offset from the
centre, f the squared distance in the marker's own ellipse (at most 1), t the distance inside its
edge and E the integral of a biweight, which stands for the point-spread function and the pixel.
Gauss-Newton steps move the centre along the slope of the edge, where all of a disc's information
about its place is (Cramer and Rao).

Where another layer's marker shows, a pixel is left out. Pixels that fit badly, such as those in
another marker's shadow, get Geman and McClure's weights.

Why compiled: these loops run for every marker of every picture.

Validity: markers at least about 4 px wide and blurred by less than their radius; a start within
about half the radius. A covered strip is found from a tenth of the width on if the blur's standard
deviation is about 0.7 px; with 1.6 px a covered marker of 8 px looks like a smaller one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.ndimage import binary_dilation

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, Singles
from twin.compiled import njit

LANES = 16
"""So many pixels of a row are worked on at once."""

HIDDEN, DIMMED, DIMS_PX = np.float32(-1.0), np.float32(2.0), 2
"""Marks of a pixel where another layer shows, and of one so near to it that its blur reaches there;
and how near that is."""


@lru_cache(maxsize=64)
def disc(square: int) -> tuple[Ints, Ints, Singles]:
    """Return the pixels within the root of ``square``, px; not to be written to.

    Returns
    -------
    offset
        (2, m) offsets, row by row, filled up to a multiple of 8 by far ones.
    runs
        (rows, 4) row, first column, number of its pixels, and that of the first of them.
    place
        ``offset`` as float32, at most 1000.
    """
    reach = math.isqrt(square)
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    inside = column**2 + row**2 <= square
    offset = np.stack([column[inside], row[inside]])
    rows, first, count = np.unique(offset[1], return_index=True, return_counts=True)
    runs = np.stack([rows, offset[0, first], count, first], axis=1)
    padding = ((0, 0), (0, -offset.shape[1] % 8))
    offset = np.pad(offset, padding, constant_values=1 << 30)
    return offset, runs, np.clip(offset, -1000, 1000).astype(np.float32)


def disc_offsets(radius: float) -> Ints:
    """Return (m, 2) offsets of the pixels within ``radius``, px, without those that fill up."""
    offset, runs, _ = disc(int(radius**2))
    return np.asarray(offset[:, : int(runs[:, 2].sum())].T)


@njit(cache=True, fastmath=True)
def gather(image, own, others, sites, column, row, offset, runs, signal, use):
    """Project the pixels at ``offset`` (2, m); those outside, not of the ``sites``, or where one of
    ``others`` (q, 6), see `Templates.others_at`, shows don't count.

    Where all are in the picture, every one of the ``runs`` is worked on in whole `LANES`; what is
    too much is written over by the next row. So ``signal`` and ``use`` have room for `LANES` more
    than m. ``runs`` may be empty where there are no others: then the pixels are taken one by one.
    """
    height, width = image.shape[0], image.shape[1]
    red, green, blue, ground = own
    reach, whole = len(runs) // 2, False
    if len(runs):
        longest = (runs[reach, 2] + LANES - 1) // LANES * LANES
        whole = row >= reach and column >= reach and row + reach < height and column + reach < width
        whole = whole and (row + reach) * width + column + longest <= height * width
    if not whole:
        for p in range(offset.shape[1]):
            x, y = column + offset[0, p], row + offset[1, p]
            if x < 0 or y < 0 or x >= width or y >= height:
                signal[p], use[p] = np.float32(0.0), np.float32(0.0)
                continue
            r = np.float32(image[y, x, 0])
            g = np.float32(image[y, x, 1])
            b = np.float32(image[y, x, 2])
            signal[p] = red * r + green * g + blue * b - ground
            seen = np.float32(1.0)
            for k in range(others.shape[0]):
                if others[k, 0] * r + others[k, 1] * g + others[k, 2] * b > others[k, 3]:
                    seen = HIDDEN
            use[p] = seen
        _uncover(image, others, sites, column, row, offset, runs, signal, use)
        return
    flat = image.reshape(-1)
    other_red, other_green, other_blue = np.float32(0), np.float32(0), np.float32(0)
    limit = np.float32(1)
    if len(others):
        other_red, other_green = others[0, 0], others[0, 1]
        other_blue, limit = others[0, 2], others[0, 3]
    done = 0
    for i in range(len(runs)):
        y, first, count = runs[i, 0], runs[i, 1], runs[i, 2]
        for block in range(0, count, LANES):
            start = 3 * ((row + y) * width + column + first + block)
            pixels = flat[start : start + 3 * LANES]
            value = signal[done + block : done + block + LANES]
            seen = use[done + block : done + block + LANES]
            for x in range(LANES):
                r = np.float32(pixels[3 * x])
                g = np.float32(pixels[3 * x + 1])
                b = np.float32(pixels[3 * x + 2])
                value[x] = red * r + green * g + blue * b - ground
                hidden = other_red * r + other_green * g + other_blue * b > limit
                seen[x] = HIDDEN if hidden else np.float32(1.0)
        done += count
    for p in range(done, offset.shape[1]):
        signal[p], use[p] = np.float32(0.0), np.float32(0.0)
    for k in range(1, len(others)):
        for p in range(done):
            x, y = column + offset[0, p], row + offset[1, p]
            r = np.float32(image[y, x, 0])
            g = np.float32(image[y, x, 1])
            b = np.float32(image[y, x, 2])
            if others[k, 0] * r + others[k, 1] * g + others[k, 2] * b > others[k, 3]:
                use[p] = HIDDEN
    _uncover(image, others, sites, column, row, offset, runs, signal, use)


@njit(cache=True, fastmath=True)
def _uncover(image, others, sites, column, row, offset, runs, signal, use):
    """Make `HIDDEN` pixels of ``use``, and those not of the ``sites``, 0, and ``signal`` beside
    hidden ones as bright as without the blurred edge of what lies in front.

    Why: that edge takes light from pixels in which it hardly shows, and the marker behind would
    follow its motion. What it covers of a pixel is its own share of its brightness.
    """
    if len(others) > 0:
        least = np.float32(0.0)
        for p in range(offset.shape[1]):
            least = min(least, use[p])
        for i in range(len(runs) if least < 0.0 else 0):
            for p in range(runs[i, 2]):
                if use[runs[i, 3] + p] >= 0.0:
                    continue
                x = runs[i, 1] + p
                for k in range(max(i - DIMS_PX, 0), min(i + DIMS_PX + 1, len(runs))):
                    first, last = x - DIMS_PX - runs[k, 1], x + DIMS_PX + 1 - runs[k, 1]
                    for q in range(max(first, 0), min(last, runs[k, 2])):
                        near = runs[k, 3] + q
                        if use[near] != 1.0:
                            continue
                        use[near] = DIMMED
                        y, across = row + runs[k, 0], column + runs[k, 1] + q
                        r = np.float32(image[y, across, 0])
                        g = np.float32(image[y, across, 1])
                        b = np.float32(image[y, across, 2])
                        for o in range(len(others)):
                            shows = others[o, 0] * r + others[o, 1] * g + others[o, 2] * b
                            covers = (shows - others[o, 4]) * others[o, 5]
                            signal[near] /= np.float32(1.0) - max(covers, np.float32(0.0))
        for p in range(offset.shape[1] if least < 0.0 else 0):
            use[p] = min(max(use[p], np.float32(0.0)), np.float32(1.0))
    if sites[0, 0] + sites[0, 1] + sites[1, 0] + sites[1, 1] < 4.0:
        for p in range(offset.shape[1]):
            if use[p] > 0.0:
                use[p] = sites[(row + offset[1, p]) % 2, (column + offset[0, p]) % 2]


SHAPE = 8
BULGE, BLUR, BRIGHT = range(5, 8)
"""Numbers of a template: semi-axes xx, xy, yy in px; slope x, y in 1/px; then, by name, bulge, half
width of the blur in px, and level."""

CENTRE_X, CENTRE_Y, LEVEL, GROUND, SCALE, VAR_X, VAR_Y, EDGE, SQUARES = range(9)
PIXELS, STEP, MISFIT, FITTING, THIRD_X, THIRD_Y, SHORTFALL, ONE_SIDED = range(9, 17)
DIRECTIONS = 8
RESHAPED = ONE_SIDED + DIRECTIONS
DOUBTED, DIFFERENCE, TILTED_X, TILTED_Y, VAR_TILTED, LIT = range(RESHAPED + 1, RESHAPED + 7)
COLUMNS = LIT + 1
CENTRE, VARIANCE = slice(CENTRE_X, CENTRE_Y + 1), slice(VAR_X, VAR_Y + 1)
THIRD, TILTED = slice(THIRD_X, THIRD_Y + 1), slice(TILTED_X, TILTED_Y + 1)
"""Columns of what `Templates.fit` gives, a row a marker.

- ``CENTRE``, ``LEVEL``, ``GROUND``, ``SCALE``: what is fitted; the scale is against the template.
- ``VARIANCE``: of the centre, by the noise, px^2. ``STEP``: the fit's last step, px.
- ``SQUARES``, ``PIXELS``: sum of squared residuals over how many pixels. ``MISFIT``: squared
  residuals over their expected size.
- ``EDGE``: share of the edge in sight. ``FITTING``: share of that which fits.
- ``THIRD``: how far the edge lies outside the model's, as the cosine and sine of three times the
  angle, px.
- ``SHORTFALL``: the most light that a pixel on the marker lacks, or one beyond its edge has too
  much, as a share of the marker's; 0 where the edge is not looked at.
- ``ONE_SIDED`` and on, along `DIRECTIONS` from 0 to 180 degrees: how far the centre moves if the
  edge on that side is left out, less how far it moves back if the other side is, px; NaN where the
  edge is not looked at.
- ``RESHAPED``: what was fitted; 0 the shape at rest, `OWN_SHAPE`, `PART_IN_SIGHT`, `OWN_PICTURE`.
- ``DOUBTED``: 1 where the fit, the edge or the size is not as usual, else 0.
- ``DIFFERENCE``: by how much the outline differs from its neighbours', unexplained, px.
- ``TILTED``: how far the centre would move were the marker's slope of brightness fitted too, px.
  ``VAR_TILTED``: the variance of that by the noise.
"""

OWN_SHAPE, PART_IN_SIGHT, OWN_PICTURE = 1.0, 2.0, 3.0
"""A marker fitted with an outline and blur of its own; by the part of it that is in sight; by its
own picture at rest."""

FITS = 0.9
"""A marker of whose edge less fits may be partly hidden."""

UNUSUAL = 1.5
"""A marker whose squared residuals exceed the usual ones by this factor is doubted: its edge is
looked at, and its variance grows."""

DOUBT = 4.0
"""A doubted marker's variance grows by so much of the excess of its residuals."""

SMALLER, LEAST_SPREAD = 4.0, 0.004
"""A marker smaller than the others by so many of their standard deviations, which are taken for no
less than this share, may be partly hidden."""

UNEVEN = 5.0
"""A marker whose edge has a third harmonic, against that at rest, of so many standard deviations
may be partly hidden: neither motion nor size nor strain has one (by chance one in 270,000)."""

SECTORS, LEFT_OUT = 2 * DIRECTIONS, 5
"""Parts that an edge is cut into, and how many of them are left out at a time: 112 degrees, what a
strip of a fifth of the width covers (106)."""

_HALF_SECTORS = np.pi / SECTORS * np.arange(2 * SECTORS + LEFT_OUT)
TURNED = np.column_stack([np.cos(_HALF_SECTORS), np.sin(_HALF_SECTORS)])
"""Directions, each turned by half a sector from the one before."""

ON_MARKER = 0.3
"""Share of a pixel that a marker covers, from which on light is missed there; below it is too
much."""

MARGIN_PX = 1.0
"""Pixels of ground beyond the blurred edge that are looked at."""

SETTLED_PX, SETTLED_GROWTH, SETTLED_LEVEL = 0.02, 0.02, 0.01
"""A marker is done when a step is below the first, of which a twentieth is then left, its size
grows by less than the second, and its brightness and ground change by less than the third: one
that starts at its very place may still have to grow, or be in other light. More is left where
markers are in shadow: up to half of the last step. To settle there helps none: where the model
lacks an outline, or a JPEG's blur, weights and size walk off with many steps, up to .1 px."""

SETTLED_TURNS = 24
"""Steps after which a centre no longer moves, wherever it started: a rest position that has not
settled shifts every picture after it (a marker in another's shadow by up to .15 px after 4)."""

OUTLIER_SD = 6.0
"""A pixel that misses by this many standard deviations counts a quarter."""

OVERSHOT, LEAST_SHARE = 0.2, 0.2
"""A step that goes back by more than this share of the last one went too far, as with blurred
markers that are darker at their edge, whose middle helps to hold them: from then on steps are
shortened to what would have gone right. The first step trusts all pixels, the second does not: in
another's shadow that one goes back, and how far must not depend on how near the fit started."""

IMPERFECT, SHARE = 0.02, 0.25
"""What the model is trusted to: as a share of the brightness, and of the mean squared residual that
it has (a marker that has changed its shape misses at its edge, where its place is to be read)."""

SHOWS, SHOWS_DN = 0.3, 4.0
"""Another layer shows where it has this share of its usual level, at least so many counts."""

UNCOVERED = 15
"""Number of the last of what describes another layer."""

LEADS = 3
"""Earlier markers by whose motion a start may be moved."""

QUADRATIC, LINEAR = 30, 12
"""From how many markers on their shared slope is a quadratic, or linear, function of the place."""

SETTLED_LEAD_PX = 0.3
"""A marker whose last step was larger leads no other."""


@njit(cache=True, fastmath=True)
def _sums(
    signal,
    use,
    place,
    cx,
    cy,
    form,
    slope,
    bulge,
    blur,
    level,
    ground,
    ground_slope,
    narrow,
    noise,
    more,
    total,
):
    """Add up over the pixels at ``place`` (2, m) what one step needs; float32, no branches: for the
    vector unit.

    (cx, cy) is the centre in the same frame, ``form`` the inverse squared axes; ``slope`` and
    ``ground_slope`` are those of the brightness of marker and ground.
    """
    xx, xy, yy = form
    slope_x, slope_y = slope
    ground_x, ground_y = ground_slope
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    three, four = np.float32(3.0), np.float32(4.0)
    edge0, edge1, edge2 = np.float32(15 / 16), np.float32(10 / 16), np.float32(3 / 16)
    per_blur = one / blur
    n, sm, smm, si, sim = zero, zero, zero, zero, zero
    jxx, jxy, jyy, jxr, jyr = zero, zero, zero, zero, zero
    jrr, jr, jxxm, jyym, rr, edge = zero, zero, zero, zero, zero, zero
    cosine, sine = zero, zero
    edge_x, edge_y, tilt_x, tilt_y, sharp, both, slopes = zero, zero, zero, zero, zero, zero, zero
    for p in range(len(signal)):
        dx, dy = place[0, p] - cx, place[1, p] - cy
        ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
        squared = ax * dx + ay * dy + np.float32(1e-6)
        flat = one / math.sqrt(ax * ax + ay * ay + np.float32(1e-8))
        v = min(max((math.sqrt(squared) - squared) * flat * per_blur, -one), one)
        v2 = v * v
        cover = half + v * (edge0 - v2 * (edge1 - v2 * edge2))
        fall = one - v2
        light = one + slope_x * dx + slope_y * dy + bulge * min(squared, one)
        tilt = level * light * fall * fall * edge0 * per_blur
        nx, ny = ax * flat, ay * flat
        jx, jy = tilt * nx, tilt * ny
        model = cover * light
        value = signal[p] - (one - cover) * (ground_x * dx + ground_y * dy)
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
        missed = use[p] * tilt * residual
        cosine += missed * nx * (four * nx * nx - three)
        sine += missed * ny * (three - four * ny * ny)
        precise = use[p] / (noise + more * cover)
        missed, on = precise * tilt, precise * model
        sharp += missed * tilt
        both += on * (dx * jx + dy * jy)
        slopes += on * model * (dx * dx + dy * dy)
        bounded = residual * trust
        missed *= bounded
        on *= bounded
        edge_x += missed * nx
        edge_y += missed * ny
        tilt_x += on * dx
        tilt_y += on * dy
    total[0], total[1], total[2], total[3], total[4] = n, sm, smm, si, sim
    total[5], total[6], total[7], total[8], total[9] = jxx, jxy, jyy, jxr, jyr
    total[10], total[11], total[12], total[13], total[14], total[15] = jrr, jr, jxxm, jyym, rr, edge
    total[16], total[17] = cosine, sine
    total[18], total[19], total[20], total[21] = edge_x, edge_y, tilt_x, tilt_y
    total[22], total[23], total[24] = sharp, both, slopes


@njit(cache=True)
def _inverse_form(xx, xy, yy, scale):
    """Return the inverse square of a symmetric matrix of semi-axes (times ``scale``): xx, xy,
    yy."""
    a = scale * scale * (xx * xx + xy * xy)
    b = scale * scale * xy * (xx + yy)
    c = scale * scale * (yy * yy + xy * xy)
    determinant = max(a * c - b * b, 1e-6)
    return c / determinant, -b / determinant, a / determinant


@njit(cache=True)
def _fit_centres(
    image,
    own,
    others,
    sites,
    start,
    lead,
    shape,
    ground,
    ground_slopes,
    noise,
    gain,
    usual_misfit,
    slopes,
    offset,
    runs,
    place,
    room,
    third,
    coherent,
    turns,
    out,
):
    """Fill ``out`` (n, `COLUMNS`), see `Templates.fit`; what it holds stays where a fit failed.

    ``lead`` is (0, `LEADS`) where starts are taken as they are; rows of ``start`` that are NaN are
    left out. ``place`` (2, m) is ``offset`` as float32, ``room`` (2, m + `LANES`) a work array.
    """
    rows, columns = image.shape[0], image.shape[1]
    signal, use = room[0, : offset.shape[1]], room[1, : offset.shape[1]]
    colour = (own[0], own[1], own[2], own[3])
    total, first = np.empty(25), np.empty(2)
    smallest, largest = np.inf, 0.0
    for k in range(len(start)):
        fit, mark = out[k], shape[k]
        # where a marker starts: moved as those that lead it, by the median
        for axis in range(2):
            first[axis] = start[k, axis]
            count, a, b, c = 0, 0.0, 0.0, 0.0
            for which in range(LEADS if len(lead) > 0 and math.isfinite(start[k].sum()) else 0):
                m = lead[k, which]
                if m >= 0 and out[m, STEP] < SETTLED_LEAD_PX:
                    a, b, c, count = out[m, axis] - start[m, axis], a, b, count + 1
            if 0 < count < 3:
                first[axis] += (a + b) / count
            elif count >= 3:
                first[axis] += max(min(a, b), min(max(a, b), c))
        cx, cy = first[CENTRE_X], first[CENTRE_Y]
        if not (math.isfinite(cx) and math.isfinite(cy) and math.isfinite(mark[0])):
            continue
        xx, xy, yy, blur, level = mark[0], mark[1], mark[2], mark[6], mark[7]
        here = ground[k, 0]
        mean_radius = math.sqrt(max(xx * yy - xy * xy, 0.25))
        ground_noise, more = noise[k, 0], noise[k, 1] - noise[k, 0]
        scale, step, column, row = 1.0, 1e9, 0, 0
        share, last_x, last_y = 1.0, 0.0, 0.0
        for turn in range(turns):
            middle_x, middle_y = int(np.rint(cx)), int(np.rint(cy))
            if middle_x < 0 or middle_y < 0 or middle_x >= columns or middle_y >= rows:
                step = 1e9
                break
            if turn == 0 or abs(cx - column) > 1.0 or abs(cy - row) > 1.0:
                column, row = middle_x, middle_y
                gather(image, colour, others[k], sites, column, row, offset, runs, room[0], room[1])
            u, v = cx / columns - 0.5, cy / rows - 0.5
            slope_x, slope_y, ground_x, ground_y = mark[3], mark[4], ground[k, 1], ground[k, 2]
            for term, value in enumerate((1.0, u, v, u * u, u * v, v * v)):
                slope_x += slopes[0, term] * value
                slope_y += slopes[1, term] * value
                ground_x += ground_slopes[0, term] * value
                ground_y += ground_slopes[1, term] * value
            fxx, fxy, fyy = _inverse_form(xx, xy, yy, scale)
            left = SHARE * total[14] / total[0] if turn > 0 else 0.0
            # a pixel counts a quarter from here on; more may miss while the centre still moves
            doubtful = OUTLIER_SD**2 * (max(noise[k, 1], left) + (IMPERFECT * level) ** 2)
            doubtful += (0.5 * level * min(math.sqrt(step) if turn > 0 else 1.0, 2.0)) ** 2
            narrow = 1.0 / doubtful
            _sums(
                signal,
                use,
                place,
                np.float32(cx - column),
                np.float32(cy - row),
                (np.float32(fxx), np.float32(fxy), np.float32(fyy)),
                (np.float32(slope_x), np.float32(slope_y)),
                np.float32(mark[5]),
                np.float32(blur),
                np.float32(level),
                np.float32(here),
                (np.float32(ground_x), np.float32(ground_y)),
                np.float32(narrow),
                np.float32(ground_noise),
                np.float32(more),
                total,
            )
            n, sm, smm, si, sim = total[0], total[1], total[2], total[3], total[4]
            determinant = n * smm - sm * sm
            jxx, jxy, jyy = total[5], total[6], total[7]
            information = jxx * jyy - jxy * jxy
            step = 1e12
            if n < 9 or determinant < 1e-5 * n * n or information < 1e-3 * jxx * jyy + 1e-9:
                break
            level_before, ground_before = level, here
            level = (n * sim - sm * si) / determinant
            here = (si - level * sm) / n
            brighter = abs(level - level_before) + abs(here - ground_before)
            if level <= 0.05 * mark[7]:
                break
            step_x = (jyy * total[8] - jxy * total[9]) / (gain * information)
            step_y = (jxx * total[9] - jxy * total[8]) / (gain * information)
            swing = -(step_x * last_x + step_y * last_y) / max(
                last_x * last_x + last_y * last_y, 1e-9
            )
            if swing > OVERSHOT and turn > 1:
                share = max(share / (1.0 + swing), LEAST_SHARE)
            last_x, last_y = step_x, step_y
            limit = 0.5 * mean_radius
            step_x = min(max(share * step_x, -limit), limit)
            step_y = min(max(share * step_y, -limit), limit)
            cx, cy = cx + step_x, cy + step_y
            step = step_x * step_x + step_y * step_y
            growth = 1.0
            if turn > 0 or step < 0.25:
                growth = total[11] / max(total[10], 1e-9) / (gain * mean_radius)
                scale = min(max(scale * (1.0 + min(max(growth, -0.1), 0.1)), 0.7), 1.3)
            settled = abs(growth) < SETTLED_GROWTH and brighter < SETTLED_LEVEL * level
            # the first step trusts all pixels, which moves irregular markers: not where others end
            expected = ground_noise * total[0] + more * total[1]
            settled = settled and (turn > 0 or total[14] < UNUSUAL * expected)
            if settled and step < SETTLED_PX * SETTLED_PX:
                break
        if step > 1e8:
            continue
        # all that a residual moves is less by the gain
        jxx, jxy, jyy, n = total[5], total[6], total[7], total[0]
        determinant = gain * max(jxx * jyy - jxy * jxy, 1e-9)
        across = ground_noise * jxx + more * total[12]
        along = ground_noise * jyy + more * total[13]
        # the middle matrix of the sandwich, taken as diagonal: exact on whole discs
        fit[CENTRE_X], fit[CENTRE_Y], fit[LEVEL], fit[GROUND] = cx, cy, level, here
        fit[SCALE] = scale
        square = determinant * determinant
        fit[VAR_X] = (jyy * jyy * across + jxy * jxy * along) / square + ground[k, 3]
        fit[VAR_Y] = (jxx * jxx * along + jxy * jxy * across) / square + ground[k, 3]
        # a whole ellipse's sum of squared slopes: its length times 5/7 over the blur's half width
        mean, gap = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        length = 2.0 * np.pi * scale * math.sqrt(mean * mean + gap * gap)
        whole = length * (level * (1.0 + mark[5])) ** 2 * 5.0 / 7.0 / blur
        if sites[0, 0] + sites[0, 1] + sites[1, 0] + sites[1, 1] < 4.0:
            form = _inverse_form(xx, xy, yy, scale)
            light = (slope_x, slope_y, mark[5])
            at = (cx - column, cy - row)
            whole = _edge_of_sites(sites, column, row, offset, at, form, light, blur, level)
        fit[EDGE] = total[15] / max(whole, 1e-9)
        fit[SQUARES], fit[PIXELS], fit[STEP] = total[14], n, math.sqrt(step)
        fit[MISFIT] = total[14] / max(ground_noise * n + more * total[1], 1e-9)
        fit[FITTING] = total[10] / max(total[15], 1e-9)
        fit[SHORTFALL], fit[RESHAPED], fit[DIFFERENCE] = 0.0, 0.0, 0.0
        sharp = 0.5 * gain * max(total[15], 1e-9)
        fit[THIRD_X], fit[THIRD_Y] = total[16] / sharp, total[17] / sharp
        # both axes alike: exact on whole discs
        firm, both, own_slope = 0.5 * total[22], 0.5 * total[23], 0.5 * total[24]
        free = max(firm * own_slope - both * both, 1e-12)
        fit[TILTED_X] = (own_slope * total[18] - both * total[20]) / (gain * free)
        fit[TILTED_Y] = (own_slope * total[19] - both * total[21]) / (gain * free)
        fit[VAR_TILTED] = own_slope / (gain * gain * free)
        uneven = (fit[THIRD_X] - third[k, 0]) ** 2 + (fit[THIRD_Y] - third[k, 1]) ** 2
        uneven /= 2.0 * (fit[VAR_X] + fit[VAR_Y])
        doubted = fit[FITTING] < FITS or fit[MISFIT] > UNUSUAL * usual_misfit
        doubted = doubted or (uneven > UNEVEN**2 and not coherent)
        smallest, largest = min(smallest, scale), max(largest, scale)
        unlike = smallest < (1.0 - SMALLER * LEAST_SPREAD) * largest
        fit[DOUBTED] = 1.0 if doubted or unlike else 0.0
        if doubted:
            form = _inverse_form(xx, xy, yy, scale)
            light = (slope_x, slope_y, mark[5])
            centre = (cx - column, cy - row)
            around = (here, ground_x, ground_y)
            _edge(signal, use, place, centre, form, light, blur, level, around, narrow, fit)
            for side in range(ONE_SIDED, RESHAPED):  # a slice divided takes 2 s to compile
                fit[side] /= gain
            if fit[SHORTFALL] * level <= OUTLIER_SD * math.sqrt(noise[k, 1]):
                fit[SHORTFALL] = 0.0


@njit(cache=True)
def _edge_of_sites(sites, column, row, offset, centre, form, light, blur, level):
    """Return a whole edge's sum of squared slopes at the ``sites``."""
    xx, xy, yy = form
    slope_x, slope_y, bulge = light
    whole = 0.0
    for p in range(offset.shape[1]):
        if sites[(row + offset[1, p]) % 2, (column + offset[0, p]) % 2] == 0.0:
            continue
        dx, dy = offset[0, p] - centre[0], offset[1, p] - centre[1]
        ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
        squared = ax * dx + ay * dy + 1e-6
        v = (math.sqrt(squared) - squared) / math.sqrt(ax * ax + ay * ay + 1e-8) / blur
        if abs(v) < 1.0:
            bright = level * (1.0 + slope_x * dx + slope_y * dy + bulge * min(squared, 1.0))
            whole += (bright * (1.0 - v * v) ** 2 * 15 / 16 / blur) ** 2
    return whole


@njit(cache=True)
def _edge(signal, use, place, centre, form, light, blur, level, around, narrow, out):
    """Fill the columns of ``out`` that describe how the edge differs from the model's.

    What hides a part of one side pulls the fit off it: the fit without that side's edge moves back
    (a jackknife, with the size free). Strain moves it by as much towards the other side, and
    cancels in the difference of the two.
    """
    xx, xy, yy = form
    slope_x, slope_y, bulge = light
    ground, ground_x, ground_y = around
    missed, per_blur, per_level = 0.0, 1.0 / blur, 1.0 / level
    # beyond this distance, in the marker's own ellipse, there is no edge
    steepest = 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    far = (1.0 + blur * math.sqrt(steepest)) ** 2
    sums = np.zeros((SECTORS, 9))
    for p in range(len(signal)):
        dx, dy = place[0, p] - centre[0], place[1, p] - centre[1]
        ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
        squared = ax * dx + ay * dy + 1e-6
        if squared > far or use[p] == 0.0:
            continue
        flat = 1.0 / math.sqrt(ax * ax + ay * ay + 1e-8)
        v = (math.sqrt(squared) - squared) * flat * per_blur
        if v <= -1.0:
            continue
        v = min(v, 1.0)
        v2 = v * v
        cover = 0.5 + v * (15 / 16 - v2 * (10 / 16 - v2 * 3 / 16))
        bright = level * (1.0 + slope_x * dx + slope_y * dy + bulge * min(squared, 1.0))
        tilt = bright * (1.0 - v2) ** 2 * 15 / 16 * per_blur
        behind = (1.0 - cover) * (ground_x * dx + ground_y * dy)
        residual = signal[p] - ground - behind - bright * cover
        missed = max(missed, (-residual if cover > ON_MARKER else residual) * per_level)
        if v == 1.0:
            continue
        nx, ny = ax * flat, ay * flat
        # weighted sums of the normal equations for x, y and the size, sector by sector
        part = 0
        for k in range(1, SECTORS // 4):
            part += abs(ny) * TURNED[2 * k, 0] > abs(nx) * TURNED[2 * k, 1]
        part = part if nx >= 0.0 else SECTORS // 2 - 1 - part
        sector = sums[part if ny >= 0.0 else SECTORS - 1 - part]
        trust = tilt / (1.0 + narrow * residual * residual) ** 2
        for i, weight in enumerate((trust * tilt, trust * residual)):
            sector[3 * i] += weight
            sector[3 * i + 1] += weight * nx
            sector[3 * i + 2] += weight * ny
        sector[6] += trust * tilt * nx * nx
        sector[7] += trust * tilt * nx * ny
        sector[8] += trust * tilt * ny * ny
    out[SHORTFALL] = missed
    step, kept = np.empty(SECTORS), np.zeros(9)
    for s in range(LEFT_OUT, SECTORS):
        for i in range(9):
            kept[i] += sums[s, i]
    for s in range(SECTORS):
        # towards the middle of what is left out
        ux, uy = TURNED[2 * s + LEFT_OUT, 0], TURNED[2 * s + LEFT_OUT, 1]
        along = ux * ux * kept[6] + 2.0 * ux * uy * kept[7] + uy * uy * kept[8]
        cross = ux * kept[1] + uy * kept[2]
        right = ux * kept[4] + uy * kept[5]
        step[s] = (kept[0] * right - cross * kept[3]) / max(kept[0] * along - cross**2, 1e-9)
        for i in range(9):
            kept[i] += sums[s, i] - sums[(s + LEFT_OUT) % SECTORS, i]
    for s in range(DIRECTIONS):
        out[ONE_SIDED + s] = step[s] - step[s + DIRECTIONS]


def slope_terms(places: Pixels, size: Sequence[int]) -> Floats:
    """Return (n, 6) 1, u, v, u^2, u v, v^2 of picture positions; u, v from -1/2 to 1/2 across the
    (h, w) picture."""
    u, v = places[:, 0] / size[1] - 0.5, places[:, 1] / size[0] - 0.5
    return np.array([np.ones_like(u), u, v, u * u, u * v, v * v]).T


NOBODY = np.zeros((0, LEADS), np.int64)
NO_RUNS = np.zeros((0, 4), np.int64)
"""Runs of `gather` for pixels one by one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Templates:
    """The templates of the markers that share a signal.

    Attributes
    ----------
    own, others
        (4,) projection (r, g, b) and ground; (m, 16) the other signals' projections, then their
        ground's counts and their markers' brightness, each by `slope_terms`, and 1 where pixels
        beside are taken for as bright as without them, else 0 (`UNCOVERED`); float32.
    sites
        (2, 2) 1 where a camera with a colour mosaic has measured the layer's colour, by parity of
        row and column, else 0; all 1 without. float32.
    shape
        (n, `SHAPE`) every marker's template; NaN for markers not found at rest.
    ground
        (n, 4) ground around every marker at rest, counts; in light that has changed since its slope
        along x and y, counts per px, on top of ``ground_slopes``, and the variance of centres by
        what that slope is not known to, px^2.
    ground_slopes
        (2, 6) slope of its brightness along x and y, counts per px, by `slope_terms`.
    noise
        (n, 2) variance of the ground's noise and of a full marker's, counts squared.
    gain
        By how much pictures change with the place more than their model does: a step of the
        model's slopes alone goes so many times too far.
    slopes
        (2, 6) slope of brightness along x and y, 1/px, that the light gives to a marker anywhere in
        the picture, by `slope_terms`. A template's own slope comes on top.
    usual_misfit
        Squared residuals of a good fit at rest over what the noise explains: what the model lacks
        for every marker.
    level
        (n,) brightness at rest, counts.
    reach_px
        Radius of what is looked at around a marker, px.
    coherent
        Whether residuals at rest are those of noise that hangs together over pixels.
    rest
        (n, `COLUMNS`) `fit` of the rest picture.
    """

    own: Singles
    others: Singles
    sites: Singles
    shape: Floats
    ground: Floats
    ground_slopes: Floats
    noise: Floats
    gain: float
    slopes: Floats
    usual_misfit: float
    level: Floats
    reach_px: float
    coherent: bool
    rest: Floats

    @staticmethod
    def smooth(values: Floats, places: Pixels, size: Sequence[int]) -> Floats:
        """Return (q, 6) the smooth functions of the place that ``values`` (n, q) follow, by
        `slope_terms`: least squares with Huber's weights; zeros where there are few."""
        shared, count = np.zeros((values.shape[1], 6)), len(values)
        terms = 6 if count >= QUADRATIC else 3 if count >= LINEAR else 0
        basis = slope_terms(places, size)[:, :terms]
        for axis in range(len(shared)):
            weight = np.ones(count)
            for _ in range(5 if terms else 0):
                shared[axis, :terms] = np.linalg.lstsq(
                    basis * weight[:, None], values[:, axis] * weight, rcond=None
                )[0]
                rest = np.abs(values[:, axis] - basis @ shared[axis, :terms])
                weight = np.sqrt(
                    np.minimum(
                        1.0, 1.5 * max(float(np.median(rest)), 1e-9) / np.maximum(rest, 1e-9)
                    )
                )
        return shared

    @staticmethod
    def others_at(others: Singles, places: Pixels, size: Sequence[int]) -> Singles:
        """Return (n, m, 6) of ``others`` (m, 16) about ``places`` (n, 2): projections (r, g, b),
        the counts above which they show, the ground's, and the share that they cover for every
        count more."""
        at = np.empty((len(places), len(others), 6), np.float32)
        if len(others):
            even = not (others[:, 4:9].any() or others[:, 10:UNCOVERED].any())
            terms = np.eye(1, 6) if even else slope_terms(places, size)
            level = np.fmax(terms @ others[:, 9:UNCOVERED].T, 1.0)
            at[:, :, :3], at[:, :, 4] = others[:, :3], terms @ others[:, 3:9].T
            at[:, :, 5] = others[:, UNCOVERED] / level
            at[:, :, 3] = at[:, :, 4] + np.fmax(SHOWS * level, SHOWS_DN)
        return at

    def project(self, picture: Picture, windows: Ints | None = None) -> tuple[Floats, Bools]:
        """Return pixels (k, h, w) projected as by `gather`, and which of them count: those of
        ``windows`` (k, h, w, 2), at the border again where these go beyond, or all, k = 1."""
        height, width = picture.shape[:2]
        pixels, places = picture[None], windows
        if windows is not None:
            column, row = np.clip(windows, 0, [width - 1, height - 1]).transpose(3, 0, 1, 2)
            pixels = picture[row, column]
        signal = pixels @ self.own[:3] - self.own[3]
        shown = np.ones(signal.shape, np.bool_)
        if not len(self.others):
            return signal, shown
        if places is None:
            places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
        at = self.others_at(self.others, places.reshape(-1, 2).astype(np.float64), picture.shape)
        beside = np.ones((1, 2 * DIMS_PX + 1, 2 * DIMS_PX + 1))
        for k in range(len(self.others)):
            limit, ground, share = at[:, k, 3:].T.reshape(3, *signal.shape)
            here = pixels @ self.others[k, :3]
            hidden = here > limit
            near = binary_dilation(hidden, beside) & ~hidden
            signal[near] /= 1.0 - np.fmax((here - ground) * share, 0.0)[near]
            shown &= ~hidden
        return signal, shown

    @property
    def blur_px(self) -> Floats:
        """(n,) standard deviation of the blur, px: of a biweight, half its width over root 7."""
        return np.asarray(self.shape[:, BLUR] / np.sqrt(7.0))

    @cached_property
    def radius_px(self) -> Floats:
        """(n,) mean radius, px."""
        return np.asarray(np.sqrt(self.shape[:, 0] * self.shape[:, 2]))

    @property
    def usual_radius_px(self) -> float:
        """That of `usual_shape`, px."""
        return float(np.sqrt(self.usual_shape[0] * self.usual_shape[2]))

    @cached_property
    def measured(self) -> float:
        """Share of the pixels that a camera with a colour mosaic has measured; 1 without."""
        return float(self.sites.mean())

    @cached_property
    def third(self) -> Floats:
        """(n, 2) third harmonic of the edge at rest, px."""
        return np.ascontiguousarray(self.rest[:, THIRD])

    @cached_property
    def third_weakened(self) -> Floats:
        """(n,) by how much blur weakens an edge's third harmonic more than its first, which is
        motion."""
        return np.asarray(np.exp(4.0 * (self.blur_px / self.radius_px) ** 2))

    @cached_property
    def smooths_third(self) -> float:
        """By how much noise that hangs together over pixels weakens an edge's third harmonic more
        than its first, taken as white noise that a Gaussian of b px has blurred.

        Neighbouring pixels then correlate by exp(-1 / 4 b^2), and 2 x 2 differences, from which
        `noise` is read, have (1 - that)^2 of the variance: the rest is `usual_misfit`. The n-th
        harmonic at radius r falls by exp(-(n b / r)^2 / 2).
        """
        if not self.coherent or self.usual_misfit <= 1.0:
            return 1.0
        square = -0.25 / math.log(1.0 - self.usual_misfit**-0.5)
        return math.exp(4.0 * square / self.usual_radius_px**2)

    @cached_property
    def usual_noise(self) -> float:
        """Median variance of the ground's noise, counts squared."""
        return float(np.median(self.noise[:, 0]))

    @cached_property
    def usual_shape(self) -> Floats:
        """(`SHAPE`,) median of the markers'."""
        return np.asarray(np.nanmedian(self.shape, axis=0))

    def centre_sds(self, fitted: Floats) -> Floats:
        """Return (n,) standard deviations of ``fitted`` (n, `COLUMNS`) centres, per axis, px: the
        noise's, more where the fit is bad; NaN where there was none, or its optimum is none."""
        bad = np.maximum(fitted[:, MISFIT] / self.usual_misfit - UNUSUAL, 0.0)
        variance = 0.5 * (fitted[:, VAR_X] + fitted[:, VAR_Y])
        return np.asarray(np.sqrt(np.where(variance > 0, variance, np.nan) * (1.0 + DOUBT * bad)))

    def fit(
        self,
        picture: Picture,
        start_px: Pixels,
        lead: Ints | None = None,
        *,
        turns: int = SETTLED_TURNS,
    ) -> Floats:
        """Fit every marker's centre, level, ground and scale.

        Parameters
        ----------
        picture
            (h, w, 3) counts.
        start_px
            (n, 2) px; NaN rows are left out.
        lead
            (n, `LEADS`) earlier rows, -1 for none: a start is moved by the median of how far these
            moved from theirs.
        turns
            Most steps of a marker.

        Returns
        -------
        (n, `COLUMNS`)
        """
        out = np.full((len(start_px), COLUMNS), np.nan)
        offset, runs, place = disc(int(self.reach_px**2))
        room = np.empty((2, offset.shape[1] + LANES), np.float32)
        _fit_centres(
            picture,
            self.own,
            self.others_at(self.others, start_px, picture.shape),
            self.sites,
            np.ascontiguousarray(start_px),
            NOBODY if lead is None else lead,
            self.shape,
            self.ground,
            self.ground_slopes,
            self.noise,
            self.gain,
            self.usual_misfit,
            self.slopes,
            offset,
            runs,
            place,
            room,
            self.third,
            self.coherent,
            turns,
            out,
        )
        return out
