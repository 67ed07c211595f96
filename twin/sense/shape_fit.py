"""The fits of a marker's whole picture, of the part of it that is in sight, and of rough outlines.

`fit_shapes` fits every marker at rest, which gives its template, and later those that no longer
look as at rest: outline, brightness and blur. `Expected.fit_visible` fits markers of which a part
is hidden, or cut off by the picture's frame. `OwnPictures` fits markers with rough outlines by
their pictures at rest.

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
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter, laplace, spline_filter, spline_filter1d

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, Singles, medians
from twin.compiled import njit
from twin.sense.match import Neighbourhood
from twin.sense.template import (
    CENTRE,
    COLUMNS,
    DIFFERENCE,
    DIMS_PX,
    DOUBTED,
    EDGE,
    FITS,
    FITTING,
    GROUND,
    IMPERFECT,
    LANES,
    LEVEL,
    LINEAR,
    MISFIT,
    ONE_SIDED,
    OUTLIER_SD,
    OWN_PICTURE,
    PIXELS,
    RESHAPED,
    SCALE,
    SHAPE,
    SHORTFALL,
    SQUARES,
    STEP,
    THIRD,
    TILTED,
    VAR_TILTED,
    VARIANCE,
    Templates,
    disc,
    disc_offsets,
    gather,
)

TURNS = 12
"""Most steps of a shape's fit."""

WEAK = 1e-4
"""Pull of every parameter towards its start, relative to its own information."""

PARAMETERS = 11
"""Centre x, y; ground; level, its slope x, y and bulge; growth, stretch along the axes and the
diagonals; blur."""


def fit_shapes(
    picture: Picture,
    own: Singles,
    others: Singles,
    sites: Singles,
    ground_slopes: Floats,
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
    picture, own, others, sites, noise
        See `twin.sense.template.Templates`.
    ground_slopes
        (n, 2) slopes of the ground's brightness around them, counts per px.
    start_px, radius_px
        (n, 2) centres and (n,) radii to start from, px; NaN rows are left out.
    blur_px, bulge
        Half width of the blur, px, and relative bulge: where the fit starts if they are free.

    Returns
    -------
    (n, `SHAPE` + 3): the shape, then centre x, y, px, and ground; NaN where a fit failed.
    """
    out = np.full((len(start_px), SHAPE + 3), np.nan)
    rows = np.flatnonzero(np.isfinite(start_px.sum(axis=1) + radius_px))
    start, radius = start_px[rows], radius_px[rows]
    offset, runs, _ = disc(int(reach_px**2))
    p = np.zeros((len(rows), PARAMETERS))
    p[:, :2], p[:, 10] = start, blur_px
    fine = np.zeros(len(rows), np.bool_)
    _fit_shapes(
        picture,
        own,
        others[rows],
        sites,
        offset,
        runs,
        int(runs[:, 2].sum()) // 2,
        radius,
        ground_slopes[rows],
        noise[rows, 1],
        bulge,
        blur_px,
        (float(free_bulge), float(free_blur)),
        np.empty((2, offset.shape[1] + LANES), np.float32),
        np.empty((PARAMETERS + 1, offset.shape[1])),
        np.empty((PARAMETERS + 1, PARAMETERS + 1)),
        p,
        fine,
    )
    centre, level = p[:, :2], p[:, 3:4]
    fine &= (np.abs(centre - start) <= radius[:, None]).all(axis=1)
    axes = radius[:, None] * [1.0, 0.0, 1.0] + p[:, 7:10] @ STRETCHES
    round_part = p[:, 6:7] / level if free_bulge else np.full_like(level, bulge)
    fits = [axes, p[:, 4:6] / level, round_part, p[:, 10:11], level, centre, p[:, 2:3]]
    out[rows[fine]] = np.concatenate(fits, axis=1)[fine]
    return out


@njit(cache=True, fastmath=True)
def _solve(sums):
    """Solve n equations by Cholesky's factor: the matrix is in the lower triangle of ``sums``
    (n + 1, n + 1), its last row the right side, which becomes the solution. Return whether the
    matrix is positive definite."""
    count, definite = len(sums) - 1, True
    for a in range(count + 1):
        for b in range(min(a + 1, count)):
            total = sums[a, b]
            for c in range(b):
                total -= sums[a, c] * sums[b, c]
            if a == b:
                definite = definite and total > 0.0
                sums[a, a] = math.sqrt(max(total, 1e-9))
            else:
                sums[a, b] = total / sums[b, b]
    solution = sums[count]
    for a in range(count - 1, -1, -1):
        for b in range(a + 1, count):
            solution[a] -= sums[b, a] * solution[b]
        solution[a] /= sums[a, a]
    return definite


@njit(cache=True, fastmath=True)
def _fit_shapes(
    image,
    own,
    others,
    sites,
    offset,
    runs,
    middle,
    radius,
    ground_slopes,
    noise,
    bulge,
    blur,
    free,
    room,
    work,
    sums,
    parameters,
    fine,
):
    """Fit all `PARAMETERS` of every marker, from ``parameters`` on, and set ``fine`` where that
    went well.

    ``offset`` (2, m) are the pixels, number ``middle`` in the middle. ``radius`` (k,) is the
    marker's at the start, ``noise`` (k,) a pixel's variance.
    ``free`` are 1 or 0 for bulge and blur, which else keep their values ``bulge`` and ``blur``.
    ``room`` (2, m + `LANES`) is for the pixels and their weights, see `gather`, and ``runs`` too;
    ``work`` (`PARAMETERS` + 1, m) for every pixel's weighted derivatives and residual, ``sums`` for
    their products: a matrix with the right side as its last row.
    """
    free_bulge, free_blur = free
    fixed = (1.0 - free_bulge) * bulge
    colour = (own[0], own[1], own[2], own[3])
    pixels, counts = room[0, : offset.shape[1]], room[1, : offset.shape[1]]
    for k in range(len(parameters)):
        p = parameters[k]
        column, row = int(np.rint(p[0])), int(np.rint(p[1]))
        gather(image, colour, others[k], sites, column, row, offset, runs, room[0], room[1])
        p[3] = pixels[middle]
        r = radius[k]
        moved = 1.0
        good = True
        for turn in range(TURNS):
            if free_bulge == 0.0:
                p[6] = bulge * p[3]
            limit = OUTLIER_SD**2 * (noise[k] + (IMPERFECT * p[3]) ** 2)
            limit += (0.5 * p[3] * min(moved, 2.0)) ** 2
            # the inverse square of the semi-axes' matrix: the outline is where its form is 1
            axis_x = r + p[7] + p[8]
            axis_y = r + p[7] - p[8]
            skew = p[9]
            xx = axis_y * axis_y + skew * skew
            xy = -skew * (axis_x + axis_y)
            yy = axis_x * axis_x + skew * skew
            determinant = max(xx * yy - xy * xy, 1e-6)
            xx /= determinant
            xy /= determinant
            yy /= determinant
            root = 1e-3 * math.sqrt(xx)
            per_blur = 1.0 / p[10]
            apart_x = column - p[0]
            apart_y = row - p[1]
            ground = p[2]
            ground_x = ground_slopes[k, 0]
            ground_y = ground_slopes[k, 1]
            level = p[3]
            slope_x = p[4]
            slope_y = p[5]
            round_part = p[6]
            for i in range(len(pixels)):
                # the distance to the outline in half widths of the blur, and the covered share
                x = offset[0, i] + apart_x
                y = offset[1, i] + apart_y
                ax = xx * x + xy * y
                ay = xy * x + yy * y
                squared = ax * x + ay * y
                steep = math.sqrt(ax * ax + ay * ay) + 1e-9
                away = math.sqrt(squared)
                inside = (1.0 - away) * (away + 1e-3) / (steep + root) * per_blur
                inside = min(max(inside, -1.0), 1.0)
                square = inside * inside
                cover = 0.5 + inside * (15 / 16 - square * (10 / 16 - square * 3 / 16))
                # what the model lacks, and the derivatives of its brightness
                curved = min(squared, 1.0)
                light = level + slope_x * x + slope_y * y + round_part * curved
                behind = ground + (1.0 - cover) * (ground_x * x + ground_y * y)
                residual = pixels[i] - behind - light * cover
                trust = counts[i] / (1.0 + residual * residual / limit)
                edge = trust * light * 15 / 16 * (1.0 - square) * (1.0 - square) * per_blur
                nx = ax / steep
                ny = ay / steep
                cover *= trust
                work[0, i] = edge * nx
                work[1, i] = edge * ny
                work[2, i] = trust
                work[3, i] = cover * (1.0 + fixed * curved)
                work[4, i] = cover * x
                work[5, i] = cover * y
                work[6, i] = free_bulge * cover * curved
                work[7, i] = edge
                work[8, i] = edge * (nx * nx - ny * ny)
                work[9, i] = edge * 2.0 * nx * ny
                work[10, i] = -free_blur * edge * inside
                work[11, i] = trust * residual
            for a in range(PARAMETERS + 1):
                for b in range(a + 1):
                    total = 0.0
                    for i in range(len(pixels)):
                        total += work[a, i] * work[b, i]
                    sums[a, b] = total
            # a weak pull towards no slope, no bulge, round and the usual blur: small markers leave
            # these open
            for a in range(PARAMETERS):
                sums[a, a] += WEAK * sums[a, a] + 1e-9
            size = max(level, 1.0)
            for a in range(4, 6):
                sums[a, a] += 4.0 * (r / size) ** 2
                sums[11, a] -= 4.0 * (r / size) ** 2 * p[a]
            sums[6, 6] += 4.0 / size**2
            sums[11, 6] -= 4.0 / size**2 * p[6]
            sums[8, 8] += 4.0 / r**2
            sums[9, 9] += 4.0 / r**2
            sums[10, 10] += 1.0
            sums[11, 10] -= p[10] - blur
            good = _solve(sums) and good
            step = sums[PARAMETERS]
            shifted = step[0] ** 2 + step[1] ** 2
            for a in range(PARAMETERS):
                if not 2 <= a < 7:
                    most = 0.5 * r if a < 2 else 0.2 * r if a < 10 else 0.4
                    step[a] = min(max(step[a], -most), most)
                p[a] += step[a]
            p[10] = min(max(p[10], 0.7), 1.2 * r)
            moved = math.sqrt(shifted + step[7] ** 2)
            stretched = r + p[7] + abs(p[8])
            squeezed = r + p[7] - abs(p[8])
            good = good and p[3] > 0.0 and squeezed > 0.4 * r
            good = good and stretched < 1.6 * r and abs(p[9]) < 0.5 * r
            if not good or (turn > 1 and moved < 3e-3):
                break
        fine[k] = good


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

SETTLED_PX = 2e-3

ASIDE, ASIDE_STEP, MAY_LACK = 0.6, 0.1, 0.15
"""`Expected.likeliest` looks so far for a better start, in steps of so much, both over the radius;
there missing light counts less above so much of the brightness."""

LARGEST_STEPS = np.array([0.4, 0.4, 1e9, 1e9, 0.1, 0.1, 0.1])
"""Of `FREE`, over the radius; finite, as fast arithmetic knows no infinity."""


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

    def only(self, rows: Bools) -> Expected:
        """Return this for some of the markers."""
        return replace(self, **{name: values[rows] for name, values in vars(self).items()})

    def likeliest(
        self, picture: Picture, templates: Templates, rows: Ints, start_px: Pixels
    ) -> Pixels:
        """Return (k, 2) the places about ``start_px`` where discs of this size fit markers ``rows``
        best: light may be missing, but there is not too much.

        A fit to what is left of a marker starts at its middle. From there the edge in sight is too
        far for steps along the slope of the brightness where more than .4 of the area is hidden.
        """
        radius, blur = np.sqrt(self.axes[:, 0] * self.axes[:, 2]), self.blur[:, None]
        reach = float(np.max((1.0 + ASIDE) * radius + self.blur)) + 1.0
        offset, aside = disc_offsets(reach), disc_offsets(ASIDE / ASIDE_STEP) * ASIDE_STEP
        middle = np.rint(start_px).astype(np.int64)
        signal, use, _ = _signal(picture, templates, middle[:, None] + offset)
        share = signal - _medians(signal, use & (np.hypot(*offset.T) > reach - 1.5))[:, None]
        share /= self.level[:, None]
        place = np.empty((len(rows), 2))
        for k, start in enumerate(start_px):
            centre = start + aside * radius[k]
            x, y = (offset[:, axis] + (middle[k] - centre)[:, axis, None] for axis in range(2))
            v = np.clip((radius[k] - np.sqrt(x * x + y * y)) / blur[k], -1.0, 1.0)
            square = v * v
            left = share[k] - 0.5 - v * (15 / 16 - square * (10 / 16 - square * 3 / 16))
            lacks = np.fmin(left, 0.0) / MAY_LACK
            place[k] = centre[np.argmin((left * left / (1.0 + lacks * lacks)) @ use[k])]
        return place

    def fit_visible(
        self, picture: Picture, templates: Templates, rows: Ints, start_px: Pixels
    ) -> Floats:
        """Fit the parts in sight of the markers ``rows``, from (k, 2) ``start_px`` on.

        Returns
        -------
        (k, `COLUMNS`): as `Templates.fit`, but `EDGE` is the share of the edge's information that
        no other layer covers, `FITTING` the share that is used, and `SHORTFALL` that of the marker
        that is hidden; NaN what is not measured.
        """
        known = templates.shape[rows]
        noise = templates.noise[rows] * templates.usual_misfit
        reach = float(np.max(self.axes[:, [0, 2]].max(axis=1) + self.blur)) + 2.0
        offset = disc_offsets(reach)
        middle = np.rint(start_px).astype(np.int64)
        signal, use, inside = _signal(picture, templates, middle[:, None] + offset)
        far = np.hypot(*offset.T) > reach - 1.5
        blurred = float(np.max(self.blur))
        within = max(BESIDE_PX, BESIDE * blurred), max(AROUND_PX, AROUND * blurred)
        radius = np.sqrt(np.maximum(self.axes[:, 0] * self.axes[:, 2], 0.25))
        fit = np.zeros((len(rows), FREE))
        fit[:, CENTRE] = start_px
        fit[:, 2] = _medians(signal[:, far], use[:, far])
        fit[:, 3] = self.level
        held = np.full((len(rows), FREE), 1e-9)
        held[:, 3] += self.level_sd**-2.0
        held[:, 4:] += self.axes_sd[:, None] ** -2.0
        hidden, step = np.zeros(signal.shape, np.bool_), np.empty(len(rows))
        pixels, matrix = np.empty((len(rows), 4, len(offset))), np.empty((len(rows), FREE, FREE))
        _fit_visible(
            signal,
            use,
            offset,
            tuple(_near(int(reach**2), math.ceil(distance**2)) for distance in within),
            middle,
            (self.axes, np.column_stack([known[:, 3:6], self.blur, templates.ground[rows, 1:3]])),
            (templates.slopes, templates.ground_slopes, picture.shape[:2]),
            noise,
            templates.coherent,
            self.bare,
            (held, radius[:, None] * LARGEST_STEPS),
            fit,
            hidden,
            pixels,
            matrix,
            step,
        )
        used = use & ~hidden
        count = used.sum(axis=1)
        cover, residual, information, expected_square = pixels.transpose(1, 0, 2)
        squares = (residual**2 * used / expected_square).sum(axis=1)
        covariance = np.linalg.inv(matrix)
        every = np.maximum(information.sum(axis=1) * templates.measured, 1e-9)
        fitted = np.full((len(rows), COLUMNS), np.nan)
        fitted[:, CENTRE], fitted[:, LEVEL], fitted[:, GROUND] = (
            fit[:, CENTRE],
            fit[:, 3],
            fit[:, 2],
        )
        variance = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]) + templates.ground[rows, 3]
        fitted[:, VARIANCE] = variance[:, None]
        fitted[:, PIXELS] = count
        fitted[:, MISFIT] = templates.usual_misfit * squares / np.maximum(count, 1)
        fitted[:, SQUARES] = fitted[:, MISFIT] * count * templates.noise[rows, 0]
        fitted[:, STEP] = step
        fitted[:, EDGE] = 1.0 - (information * (inside & ~use)).sum(axis=1) / every
        fitted[:, FITTING] = (information * used).sum(axis=1) / every
        fitted[:, SHORTFALL] = (cover * (hidden & use)).sum(axis=1) / np.maximum(
            cover.sum(axis=1), 1e-9
        )
        return fitted


@lru_cache(maxsize=16)
def _near(disc_square: int, square: int) -> Ints:
    """Return (m, q) for every pixel of a disc those nearer than the root of ``square``, -1 for none
    that is in the disc; ``disc_square`` is the disc's squared radius."""
    offset, beside = (disc_offsets(math.sqrt(most)) for most in (disc_square + 0.5, square - 0.5))
    margin = int(np.abs(beside).max()) - offset.min(axis=0)
    number = np.full(offset.max(axis=0) + 2 * margin + 1, -1)
    number[tuple((offset + margin).T)] = np.arange(len(offset))
    place = offset[:, None] + beside + margin
    return np.asarray(number[place[:, :, 0], place[:, :, 1]])


def _medians(values: Floats, use: Bools) -> Floats:
    """Return (k,) medians of those of ``values`` (k, m) that are to be used; 0 where none is."""
    return np.asarray(np.nan_to_num(medians(np.where(use, values, np.nan), 1)))


@njit(cache=True, fastmath=True)
def _fit_visible(
    signal,
    use,
    offset,
    near,
    middle,
    shape,
    light,
    noise,
    coherent,
    bare,
    hold,
    fit,
    hidden,
    pixels,
    matrix,
    step,
):
    """Take Gauss-Newton steps of the numbers ``fit`` (k, `FREE`) until all markers have settled.

    Pixels' brightness ``signal`` and which of them count, ``use`` (k, m), are at ``offset`` (m, 2)
    from whole pixels ``middle`` (k, 2). ``near`` are tables of `_near`: pixels beside, and those
    around a hidden one. ``shape`` are (k, 3) expected semi-axes and (k, 6) slope x, y, bulge, blur
    and the ground's own slope x, y; ``light`` the slopes of marker and ground, and the picture's
    size; ``hold`` (k, `FREE`) the information on every number before, and the largest steps.

    Filled are which pixels are ``hidden`` (k, m); ``pixels`` (k, 4, m): the covered share, what the
    model lacks, the information, and the noise's variance; the information's ``matrix`` (k, `FREE`,
    `FREE`); and the length of the last ``step`` (k,), px.
    """
    count, (beside, around), (axes, looks) = len(offset), near, shape
    slopes, ground_slopes, size = light
    held, most = hold
    start, ratio = fit.copy(), 0.5
    work = np.empty((FREE + 2, count))
    odd, sums = np.empty(count), np.empty((FREE + 1, FREE + 1))
    for turn in range(LAST):
        strict, largest = turn >= FIRST, 0.0
        for k in range(len(signal)):
            p, found = fit[k], pixels[k]
            xx, xy, yy = axes[k, 0] + p[4] + p[5], axes[k, 1] + p[6], axes[k, 2] + p[4] - p[5]
            xx, xy, yy = xx * xx + xy * xy, xy * (xx + yy), yy * yy + xy * xy
            determinant = max(xx * yy - xy * xy, 1e-6)
            xx, xy, yy = yy / determinant, -xy / determinant, xx / determinant
            u, v = p[0] / size[1] - 0.5, p[1] / size[0] - 0.5
            slope_x, slope_y, ground_x, ground_y = (
                looks[k, 0],
                looks[k, 1],
                looks[k, 4],
                looks[k, 5],
            )
            for term, value in enumerate((1.0, u, v, u * u, u * v, v * v)):
                slope_x += slopes[0, term] * value
                slope_y += slopes[1, term] * value
                ground_x += ground_slopes[0, term] * value
                ground_y += ground_slopes[1, term] * value
            bulge, per_blur = looks[k, 2], 1.0 / looks[k, 3]
            ground, level = p[2], p[3]
            steeper, imperfect = noise[k, 1] - noise[k, 0], (IMPERFECT * level) ** 2
            # missing light counts less than too much of it; later it is left out
            lenient = 0.0
            if not strict:
                lenient = 1.0 / max(ratio * level, 4.0 * math.sqrt(noise[k, 1])) ** 2
            for i in range(count):
                x = offset[i, 0] + (middle[k, 0] - p[0])
                y = offset[i, 1] + (middle[k, 1] - p[1])
                ax, ay = xx * x + xy * y, xy * x + yy * y
                squared = ax * x + ay * y + 1e-6
                per_steep = 1.0 / math.sqrt(ax * ax + ay * ay + 1e-8)
                v = min(max((math.sqrt(squared) - squared) * per_steep * per_blur, -1.0), 1.0)
                v2 = v * v
                cover = 0.5 + v * (15 / 16 - v2 * (10 / 16 - v2 * 3 / 16))
                bright = 1.0 + slope_x * x + slope_y * y + bulge * min(squared, 1.0)
                tilt = level * bright * 15 / 16 * (1.0 - v2) * (1.0 - v2) * per_blur
                behind = ground + (1.0 - cover) * (ground_x * x + ground_y * y)
                residual = signal[k, i] - behind - level * cover * bright
                expected = noise[k, 0] + steeper * min(max(cover * bright, 0.0), 1.0)
                variance = expected + imperfect * 4.0 * min(max(cover * (1.0 - cover), 0.0), 0.25)
                square = residual * residual
                unlikely = square / (OUTLIER_SD**2 * variance) if strict else 0.0
                unlikely += lenient * square * (residual < 0.0)
                found[0, i], found[1, i] = cover, residual
                found[2, i], found[3, i] = tilt * tilt, expected
                odd[i] = use[k, i] * residual / math.sqrt(variance)
                nx, ny = ax * per_steep, ay * per_steep
                work[0, i] = tilt * nx
                work[1, i] = tilt * ny
                work[2, i] = 1.0
                work[3, i] = cover * bright
                work[4, i] = tilt
                work[5, i] = tilt * (nx * nx - ny * ny)
                work[6, i] = tilt * 2.0 * nx * ny
                work[7, i] = residual
                work[8, i] = use[k, i] / (variance * (1.0 + unlikely) * (1.0 + unlikely))
            if turn in (FIRST, LATER):
                hidden[k] = False
                for i in range(count if not bare[k] else 0):
                    number, score = 0, 0.0
                    for j in beside[i]:
                        if j >= 0:
                            number, score = number + use[k, j], score + odd[j]
                    limit = -LACKS * max(number, 1) ** (1.0 if coherent else 0.5)
                    if score < limit and use[k, i] and found[0, i] > 0.03:
                        for j in around[i]:
                            hidden[k, max(j, 0)] |= j >= 0
            if strict:
                for i in range(count):
                    work[8, i] = 0.0 if hidden[k, i] else work[8, i]
            for a in range(FREE + 1):
                for b in range(min(a + 1, FREE)):
                    total = 0.0
                    for i in range(count):
                        total += work[8, i] * work[a, i] * work[b, i]
                    sums[a, b] = total
            for a in range(FREE):
                sums[a, a] += held[k, a]
                sums[FREE, a] -= held[k, a] * (p[a] - start[k, a]) if a > 2 else 0.0
                for b in range(a + 1):
                    matrix[k, a, b] = matrix[k, b, a] = sums[a, b]
            _solve(sums)
            change = sums[FREE]
            for a in range(FREE):
                change[a] = min(max(change[a], -most[k, a]), most[k, a])
                p[a] += change[a]
            p[3] = max(p[3], 0.3 * start[k, 3])
            step[k] = math.sqrt(change[0] ** 2 + change[1] ** 2)
            largest = max(largest, step[k])
        ratio *= NARROWER
        if turn > LATER and largest < SETTLED_PX:
            break


def _signal(picture: Picture, templates: Templates, place: Ints) -> tuple[Floats, Bools, Bools]:
    """Return the projected pixels at ``place`` (k, m, 2), which of them count, and which are in the
    picture, and of the sites."""
    height, width = picture.shape[:2]
    inside = ((place >= 0) & (place < [width, height])).all(axis=2)
    inside &= templates.sites[place[:, :, 1] % 2, place[:, :, 0] % 2] > 0.0
    within = np.clip(place, 0, [width - 1, height - 1])
    first = within.min(axis=1) - DIMS_PX
    wide, high = (within.max(axis=1) + DIMS_PX + 1 - first).max(axis=0, initial=1)
    window = np.stack(np.meshgrid(np.arange(wide), np.arange(high)), -1)
    signal, shown = templates.project(picture, first[:, None, None] + window)
    column, row = (within - first[:, None]).transpose(2, 0, 1)
    number = np.arange(len(place))[:, None]
    signal, shown = signal[number, row, column], shown[number, row, column]
    return signal.astype(float), inside & shown, np.asarray(inside)


COARSE, TURNS_OF_WARP = (0.2, 0.07, 0.0), (12, 8, 12, 8)
"""Blur, over the radius, by which pictures are compared first: edges that strain has moved by less
are found. Most steps with each, and then with slopes of light that neighbours show."""

LEAST_WARP_PX, LARGEST_WARP, LARGEST_STEP = (0.02, 0.02, 1e-3, 1e-3), 1.6, (0.15, 0.3)
"""A marker's last step with each of these; by which factor it may be longer or shorter; a step's
most stretch, and most motion over the radius."""

NORMAL_MEDIAN = 0.455
"""Median of the square of a normal number, over its variance."""


LEAST_BETWEEN = 0.08
"""Share of a marker's brightness from which on, and off the whole of it, a pixel is on its edge; of
slopes, each pixel, twice that."""

STRAINED_PX = 0.06
"""What blur leaves of a centre's error, over the stretch: a marker's picture at rest is stretched
with its blur, which in truth stays. Measured: .03 to .09 px (outlines by hand, 10 and 13 px)."""

STRETCH = [1, 2, 4, 5]
"""Those of an own picture's numbers that are its stretch."""

UNLIKE_STRETCH, KNOWN_STRETCH, HIDDEN_PX = 3.0, 0.005, 0.1
"""Standard deviations from the neighbours' beyond which a stretch is not theirs: of whole markers
up to 1.2 (squares, triangles), of one in a hundred outlines by hand 4, where 5 % of the area is
hidden 1.6 to 8, with 14 % from 11 on. Least of these deviations. What is hidden of a radius, at
most."""

DARKEST = 0.05
"""Least light on a marker that its neighbours' slope follows from, over that at rest."""


@dataclass(frozen=True, kw_only=True)
class OwnPictures:
    """The rest pictures of markers whose outline is no ellipse.

    Such a marker looks as at rest, but moved and stretched (six numbers), in other light (ground, a
    factor and its slopes), and blurred more or less: 11 numbers for any outline. Steps follow from
    the slopes at rest (Baker and Matthews' inverse compositional fit).

    Attributes
    ----------
    rows
        (k,) which markers.
    place
        (k, m, 2) whole pixels around their centres at rest, px, and ``use`` (k, m) which count.
    terms
        For every blur (k, m, 11) what the projected pixels change by: motion and stretch along x,
        then y; ground; factor, so these are the pixels themselves, and its slopes; blur.
    """

    rows: Ints
    place: Ints
    use: Bools
    terms: list[Singles]

    @classmethod
    def of(cls, picture: Picture, templates: Templates, rows: Ints) -> OwnPictures:
        """Return those of markers ``rows`` of the ``picture`` at rest."""
        centre = templates.rest[rows, None, CENTRE]
        place = np.rint(centre).astype(np.int64) + disc_offsets(templates.reach_px)
        views, shown = _views(picture, templates)
        use, column, row = _pixels(shown, place)
        x, y = (place - centre).transpose(2, 0, 1)
        terms = []
        for view in views:
            knots = [spline_filter1d(view, axis=axis) for axis in (1, 0)]
            slopes = [
                (0.5 * (np.roll(knot, -1, axis) - np.roll(knot, 1, axis)))[row, column]
                for knot, axis in zip(knots, (1, 0), strict=True)
            ]
            level = view[row, column]
            columns = [slope * by for slope in slopes for by in (1.0, x, y)]
            columns += [np.ones(x.shape), level, level * x, level * y, laplace(view)[row, column]]
            terms.append(np.stack(columns, axis=2, dtype=np.float32))
        return cls(rows=rows, place=place, use=use, terms=terms)

    def edge_px(self, templates: Templates) -> float:
        """Return how wide edges at rest are, px: the median over the markers.

        Of light f between ground (0) and marker (1), the sum of 4 f (1 - f) over that of the
        slopes, which is the edge's length: 2.26 standard deviations of a blur.
        """
        rest, terms = templates.rest[self.rows], self.terms[-1]
        level = rest[:, LEVEL, None]
        light = (terms[:, :, 7] - templates.own[3] - rest[:, GROUND, None]) / level
        steep = np.hypot(terms[:, :, 0], terms[:, :, 3]) / np.abs(level)
        between = self.use & (np.abs(light - 0.5) < 0.5 - LEAST_BETWEEN)
        across = (4.0 * light * (1.0 - light) * between).sum(axis=1)
        length = (steep * (self.use & (steep > 2.0 * LEAST_BETWEEN))).sum(axis=1)
        return float(medians(across / np.fmax(length, 1e-9)))

    @staticmethod
    def fourth_harmonics(picture: Picture, templates: Templates, rows: Ints) -> Floats:
        """Return (k,) by how far outlines of the ``rows`` lie outside their ellipses in the fourth
        harmonic, px: squares and crosses have no third.

        With z the place in the marker's own ellipse, as a complex number, an outline 1 + e cos 4a
        has 3 e for the sum of light times z^4, over that of light times |z|^4.
        """
        centre = templates.rest[rows, None, CENTRE]
        place = np.rint(centre).astype(np.int64) + disc_offsets(templates.reach_px)
        signal, use, _ = _signal(picture, templates, place)
        light = use * (signal - templates.rest[rows, None, GROUND])
        xx, xy, yy = templates.shape[rows, :3].T[:, :, None]
        dx, dy = (place - centre).transpose(2, 0, 1)
        z = (yy * dx - xy * dy + 1j * (xx * dy - xy * dx)) / (xx * yy - xy * xy)
        lies = np.abs((light * z**4).sum(axis=1) / (light * np.abs(z) ** 4).sum(axis=1)) / 3.0
        return np.asarray(templates.radius_px[rows] * lies)

    def fit(
        self, picture: Picture, templates: Templates, fitted: Floats, around: Neighbourhood
    ) -> None:
        """Fit the markers, in place, from the centres and sizes that are ``fitted`` on.

        `FITTING` is the share of the edge that fits over most markers', so that what blur and
        compression do to all hides none. Hidden parts would be taken for strain: such a fit is one
        that `FITS` refuses, or whose stretch differs from the neighbours'. A strip that is hidden
        moves the centre by what it takes off the radius, so that is stated, and refused from
        `HIDDEN_PX` on.
        """
        rows, rest, known = self.rows, templates.rest[self.rows], fitted[self.rows]
        found = np.isfinite(known[:, LEVEL])
        known[~found] = rest[~found]
        centre, level = known[:, CENTRE].copy(), templates.level[rows, None]
        warp = (known[:, SCALE] / rest[:, SCALE])[:, None, None] * np.eye(2)
        light = np.tile([0.0, 1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        radius = templates.radius_px[rows]
        noise = templates.noise[rows].sum(axis=1)[:, None]  # of both pictures
        unlit: Floats | float = 0.0
        most_stretch, most_moved = LARGEST_STEP
        step, inverse = radius.copy(), np.zeros((len(rows), 11, 11))
        aside, scale = self.place - rest[:, None, CENTRE], np.ones(len(rows))
        sums = np.empty((len(rows), 12, 11))
        use, (left, trust) = np.zeros_like(self.use), np.zeros((2, *self.use.shape))
        views, shown = _views(picture, templates)
        finest = (views[-1], self.terms[-1])
        for stage, (view, terms) in enumerate([*zip(views, self.terms, strict=True), finest]):
            if held := stage == len(views):
                free, loose = centre.copy(), inverse[:, 0, 0] + inverse[:, 3, 3]
                if len(rows) < LINEAR:
                    break
                # the slope of light on a marker follows from its neighbours' brightness
                place, factor = fitted[:, CENTRE].copy(), np.full(len(fitted), np.nan)
                place[rows], factor[rows] = free, np.log(np.fmax(light[:, 1], DARKEST))
                slope, off, _ = around.slopes(factor, place)
                by_slope = inverse[:, [0, 3], 8:10] @ np.linalg.inv(inverse[:, 8:10, 8:10])
                light[:, 2:4] = light[:, 1:2] * slope[rows]
                unsure = light[:, 1] * off[rows] / around.spacing_px
                unlit = (by_slope**2).sum(axis=2) * unsure[:, None] ** 2
            if not held:
                knots = spline_filter(view)
            go = np.arange(len(rows))  # those that have not settled
            for _ in range(TURNS_OF_WARP[stage]):
                astray = (0.5 * level[:, 0] * np.fmin(step, 2.0)) ** 2
                compare_pictures(
                    knots,
                    shown,
                    go,
                    (aside, self.use, terms),
                    (warp, centre, light),
                    (noise[:, 0], level[:, 0], astray),
                    (use, left, trust),
                    scale,
                    sums,
                )
                matrix, right = sums[go, :11], sums[go, 11, :, None]
                if held:
                    matrix[:, [8, 9]] = matrix[:, :, [8, 9]] = right[:, [8, 9]] = 0.0
                    matrix[:, [8, 9], [8, 9]] = 1.0
                size = np.sqrt(matrix.diagonal(axis1=1, axis2=2))[:, :, None] + 1e-9
                size = size * size.swapaxes(1, 2)
                inverse[go] = np.linalg.inv(matrix / size + 1e-9 * np.eye(11)) / size
                change = (inverse[go] @ right)[:, :, 0]
                grown = np.clip(change[:, [[1, 2], [4, 5]]], -most_stretch, most_stretch)
                limit = most_moved * radius[go, None]
                moved = np.clip(change[:, [0, 3]], -limit, limit)
                warp[go] = warp[go] @ np.linalg.inv(np.eye(2) + grown)
                centre[go] -= (warp[go] @ moved[:, :, None])[:, :, 0]
                light[go] += change[:, 6:]
                step[go] = np.hypot(*moved.T) + radius[go] * np.abs(grown).max(axis=(1, 2))
                go = go[step[go] >= LEAST_WARP_PX[stage]]
                if not len(go):
                    break
        slope_x, slope_y = terms[:, :, 0], terms[:, :, 3]
        edge = slope_x**2 + slope_y**2
        seen, every = ((one * edge).sum(axis=1) for one in (use, self.use))
        fits = (trust * edge).sum(axis=1) / np.fmax(seen, 1e-9)
        misfit = (trust * left**2).sum(axis=1) / np.fmax(trust.sum(axis=1), 1.0) / noise[:, 0]
        stretch = np.linalg.svd(warp, compute_uv=False)
        good = (stretch[:, 0] < LARGEST_WARP) & (stretch[:, 1] > 1.0 / LARGEST_WARP)
        good &= np.hypot(*(centre - known[:, CENTRE]).T) < radius
        # the edge's third harmonic, by the angle of its slope
        third = use * left * np.sqrt(edge) * np.exp(3j * np.arctan2(-slope_y, -slope_x))
        third = 2.0 * third.sum(axis=1) / np.fmax(seen, 1e-9)
        variance = 0.5 * noise * np.fmax(misfit, 1.0)[:, None] * inverse[:, [0, 3], [0, 3]]
        growth = np.fmax(stretch[:, 0], 1.0 / np.fmax(stretch[:, 1], 1e-9)) - 1.0
        stretched = np.full((len(fitted), 4), np.nan)
        stretched[rows] = (warp - np.eye(2)).reshape(-1, 4)
        fine = np.zeros(len(fitted), np.bool_)
        fine[rows] = found & good & (fits > FITS * np.median(fits))
        usual, spread = around.usual(stretched, fine, rows)
        spread = np.fmax(spread, medians(spread))  # few neighbours may lie close by chance
        by_noise = noise * np.fmax(misfit, 1.0)[:, None] * inverse[:, STRETCH, STRETCH]
        chance = UNLIKE_STRETCH**2 * (by_noise + spread**2 + KNOWN_STRETCH**2)
        beyond = np.fmax((stretched[rows] - usual) ** 2 - chance, 0.0)
        hidden = radius * np.sqrt(np.nan_to_num(beyond).max(axis=1))
        good &= hidden < HIDDEN_PX
        variance += hidden[:, None] ** 2
        variance += unlit + (STRAINED_PX * np.fmin(growth, 1.0)[:, None]) ** 2
        new = rest.copy()
        new[:, CENTRE], new[:, LEVEL] = centre, rest[:, LEVEL] * light[:, 1]
        new[:, SCALE] = rest[:, SCALE] * np.sqrt(np.abs(np.linalg.det(warp)))
        # as fits of the ellipse state it: what a slope of the marker's own would change
        new[:, TILTED] += free - centre
        new[:, VAR_TILTED] += 0.5 * noise[:, 0] * (loose - inverse[:, 0, 0] - inverse[:, 3, 3])
        new[:, VARIANCE], new[:, PIXELS], new[:, STEP] = variance, use.sum(axis=1), step
        new[:, MISFIT] = templates.usual_misfit * misfit / scale
        new[:, SQUARES] = new[:, MISFIT] * new[:, PIXELS] * templates.noise[rows, 0]
        new[:, EDGE] = seen / np.fmax(every, 1e-9)
        new[:, FITTING] = np.where(good, rest[:, FITTING] * fits / np.median(fits), 0.0)
        new[:, THIRD] += np.column_stack([third.real, third.imag])
        new[:, ONE_SIDED:RESHAPED], new[:, RESHAPED] = np.nan, OWN_PICTURE
        new[:, SHORTFALL], new[:, DOUBTED], new[:, DIFFERENCE] = 1.0, 0.0, 0.0
        fitted[rows[found]] = new[found]


@njit(cache=True, fastmath=True)
def compare_pictures(knots, shown, go, known, fit, errors, pixels, scale, sums):
    """Compare the own pictures of markers ``go`` with the picture whose cubic spline has the
    ``knots`` (h, w), as moved, stretched and lit by the ``fit`` (`OwnPictures.fit`).

    ``known`` are (k, m, 2) offsets, which pixels count, and `OwnPictures.terms`; ``errors`` (k,)
    variance of the noise, brightness, and the square of what a wrong place misses at an edge.
    Filled are, of the ``pixels`` (k, m), which of them are ``shown`` (h, w), what the model lacks
    and the trust in them; ``scale`` (k,) by how much squares exceed the noise's; and ``sums`` (k,
    12, 11): the products of all terms, then with what is lacking.
    """
    height, width = knots.shape
    aside, use, terms = known
    warp, centre, light = fit
    noise, level, astray = errors
    used, left, trust = pixels
    count = aside.shape[1]
    squares, work = np.empty(count), np.empty((12, count))
    places, shares = np.empty((2, 4), np.int64), np.empty((2, 4))
    for k in go:
        number = 0
        for i in range(count):
            dx, dy = aside[k, i, 0], aside[k, i, 1]
            x = centre[k, 0] + warp[k, 0, 0] * dx + warp[k, 0, 1] * dy
            y = centre[k, 1] + warp[k, 1, 0] * dx + warp[k, 1, 1] * dy
            column, row = int(np.rint(x)), int(np.rint(y))
            inside = 0 <= column < width and 0 <= row < height
            used[k, i] = use[k, i] and inside and shown[row, column]
            for axis, at, last in ((0, x, width - 1), (1, y, height - 1)):
                at = min(max(at, -3.0), last + 3.0)
                first = int(np.floor(at))
                t = at - first
                u = 1.0 - t
                shares[axis, 0], shares[axis, 3] = u * u * u / 6.0, t * t * t / 6.0
                shares[axis, 1] = 2.0 / 3.0 - 0.5 * t * t * (1.0 + u)
                shares[axis, 2] = 2.0 / 3.0 - 0.5 * u * u * (1.0 + t)
                for j in range(4):  # the border goes on
                    places[axis, j] = min(max(first - 1 + j, 0), last)
            lacking = 0.0
            for j in range(4):
                line = 0.0
                for n in range(4):
                    line += shares[0, n] * knots[places[1, j], places[0, n]]
                lacking += shares[1, j] * line
            for j in range(5):
                lacking -= terms[k, i, 6 + j] * light[k, j]
            left[k, i] = lacking
            for j in range(11):
                work[j, i] = terms[k, i, j]
            if used[k, i]:
                squares[number] = lacking * lacking / noise[k]
                number += 1
        # what noise explains, by most pixels; in the first steps that the place is wrong
        usual = np.median(squares[:number]) if number > 0 else 0.0
        scale[k] = max(usual / NORMAL_MEDIAN, 1.0)
        limit = OUTLIER_SD**2 * (scale[k] * noise[k] + (IMPERFECT * level[k]) ** 2) + astray[k]
        for i in range(count):
            trust[k, i] = used[k, i] / (1.0 + left[k, i] * left[k, i] / limit) ** 2
            work[11, i] = left[k, i]
        for a in range(12):
            for b in range(min(a + 1, 11)):
                total = 0.0
                for i in range(count):
                    total += trust[k, i] * work[a, i] * work[b, i]
                sums[k, a, b] = total
                if a < 11:
                    sums[k, b, a] = total


def _views(picture: Picture, templates: Templates) -> tuple[list[Singles], Bools]:
    """Return the projected picture (h, w), blurred by each of `COARSE`; and where no other layer
    shows."""
    (signal,), (shown,) = templates.project(picture)
    signal += templates.own[3]
    blurs = [share * templates.usual_radius_px for share in COARSE]
    return [gaussian_filter(signal, blur) for blur in blurs], shown


def _pixels(shown: Bools, place: Ints) -> tuple[Bools, Ints, Ints]:
    """Return which of the pixels at ``place`` (k, m, 2) are ``shown`` and in the picture; and
    column and row of the nearest in it."""
    within = np.clip(place, 0, np.array(shown.shape[::-1]) - 1)
    column, row = within.transpose(2, 0, 1)
    return (within == place).all(axis=2) & shown[row, column], column, row
