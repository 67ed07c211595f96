"""The pixels that show one marker at most, many at once: loops that the compiler turns into vector instructions.

Nine pixels in ten near markers are such: nothing is searched, sorted or hidden there. A marker's pixels go in
batches through plain loops without branches, each lane a pixel; a pixel inside the outline takes one ray, one on the
edge k x k.

Why singles: twice as many lanes, and roots and quotients that take half as long. Everything is told from the marker's
centre, where they leave a ray's distance good to a millionth of the radius. Why one array of rows of a fixed length:
the compiler then knows that rows don't overlap, and needs no checks.

Validity: sums over a pixel are whole numbers below 2^24, exact in singles, up to 20 x 20 rays.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats, Ints, Singles
from twin.compiled import njit
from twin.world.picture.closed_form import (
    HALF,
    ONE,
    QUICK,
    ZERO,
    Four,
    Number,
    Six,
    Three,
    approach,
    blocked,
    candidate,
    coverage,
    footprint,
    matrix_of,
    place_met,
)
from twin.world.picture.crowded import between, tally_whole
from twin.world.picture.frame import WEIGHT
from twin.world.picture.nearby import Whole

BATCH = 256
"""Pixels at once."""

_STEP = 8
"""Lanes are filled up to a multiple of this."""

_WEIGHT = np.float32(WEIGHT)
_FAINT = np.float32(1e-30)

# Rows of the work array: a pixel's middle ray at the height of the marker's centre, how it changes along column and
# row, and the pixel's place from the marker's; first for all pixels of the batch, inside the outline, on its edge or
# aside.
_ALL_RAY, _ALL_ACROSS, _ALL_DOWN, _ALL_COLUMN, _ALL_ROW = 0, 4 * BATCH, 8 * BATCH, 12 * BATCH, 13 * BATCH
_PIXEL_ROWS = 14
# Then for those that are shaded together.
_RAY, _ACROSS, _DOWN, _COLUMN, _ROW = (row * BATCH for row in (14, 18, 22, 26, 27))
# What a sub-pixel's ray meets: a place from the centre, the unit normal, the slopes, coverage; its light.
_X, _Y, _Z, _NX, _NY, _NZ = (row * BATCH for row in range(28, 34))
_DX, _DY, _COVERS, _BRIGHT, _CLEAR = (row * BATCH for row in range(34, 39))
# Sums over sub-pixels: light, coverage, and coverage as whole weights, alone and times column and row of the sub-pixel.
_LIGHT, _SUM, _WHOLE, _ASIDE, _BELOW = (row * BATCH for row in range(39, 44))
_NEAR, _FULL = _X, _Y
_ROWS = 44


@njit(cache=True, nogil=True, fastmath=QUICK)
def shade_alone(
    begin: int, end: int, pixels: Ints, alone: Ints, corners: Floats, base: float, centres: Floats, metric: Floats,
    colour: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole, nearest: Ints, edge_grid: int,
    inner_grid: int, ambient: float, bright: bool, light: Singles, free: Singles, tallies: Floats,
) -> None:  # fmt: skip
    """Write light, free share and tallies of the own pixels of markers ``begin`` to ``end``.

    Without ``bright`` only tallies count.
    """
    w = np.zeros(_ROWS * BATCH, np.float32)
    inner, edge = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    for i in range(begin, end):
        m = _single(matrix_of(metric, i))
        for start in range(alone[i], alone[i + 1], BATCH):
            count = min(BATCH, alone[i + 1] - start)
            _look(pixels, start, count, corners, base, (centres[i, 0], centres[i, 1], centres[i, 2]), nearest[i], w)
            inners, edges = _part(count, m, np.float32(edge_grid), w, inner, edge)
            for j in range(start, start + count):
                light[j, 0], light[j, 1], light[j, 2], free[j] = 0, 0, 0, 1
            for full in (True, False):
                n, k, which = (inners, inner_grid, inner) if full else (edges, edge_grid, edge)
                if n == 0:
                    continue
                _take(n, which, w)
                if full:
                    tally_whole(n, edge_grid, w[_COLUMN:][:n].sum(), w[_ROW:][:n].sum(), tallies[i])
                    if not bright:
                        continue
                _sample(i, n, k, full, m, centres, metric, lamps, dark_first, dark_members, ambient, bright, w)
                if not full:
                    _tally(n, k, w, tallies[i])
                for j in range(n):
                    at, share = start + which[j], w[_LIGHT + j] / (k * k)
                    light[at, 0] = colour[i, 0] * share
                    light[at, 1] = colour[i, 1] * share
                    light[at, 2] = colour[i, 2] * share
                    free[at] = 1 - w[_SUM + j] / (k * k)


@njit(cache=True, nogil=True, fastmath=QUICK)
def _single(m: Six) -> Six:
    return (np.float32(m[0]), np.float32(m[1]), np.float32(m[2]), np.float32(m[3]), np.float32(m[4]), np.float32(m[5]))


@njit(cache=True, nogil=True, fastmath=QUICK)
def _look(
    pixels: Ints, start: int, count: int, corners: Floats, base: float, centre: Three, nearest: Ints, w: Singles
) -> None:
    """Write the rays of a marker's pixels, row by row of the picture."""
    width = corners.shape[2] - 1
    drop, quarter = base - centre[2], 0.25
    j = 0
    while j < count:
        pixel = pixels[start + j]
        row, column = pixel // width, pixel % width
        run = 1
        while j + run < count and pixels[start + j + run] == pixel + run and column + run < width:
            run += 1
        for i in range(run):
            at, over = j + i, column + i
            for c in range(2):
                p, q = corners[c, row, over], corners[c, row, over + 1]
                r, s = corners[c, row + 1, over], corners[c, row + 1, over + 1]
                t, u = corners[c + 2, row, over], corners[c + 2, row, over + 1]
                x, y = corners[c + 2, row + 1, over], corners[c + 2, row + 1, over + 1]
                slope, along, below = (t + u + x + y) * quarter, (u - t + y - x) * 0.5, (x - t + y - u) * 0.5
                w[_ALL_RAY + c * BATCH + at] = (p + q + r + s) * quarter + slope * drop - centre[c]
                w[_ALL_RAY + (c + 2) * BATCH + at] = slope
                w[_ALL_ACROSS + c * BATCH + at] = (q - p + s - r) * 0.5 + along * drop
                w[_ALL_ACROSS + (c + 2) * BATCH + at] = along
                w[_ALL_DOWN + c * BATCH + at] = (r - p + s - q) * 0.5 + below * drop
                w[_ALL_DOWN + (c + 2) * BATCH + at] = below
            w[_ALL_COLUMN + at], w[_ALL_ROW + at] = over - nearest[0], row - nearest[1]
        j += run


@njit(cache=True, nogil=True, fastmath=QUICK)
def _four(w: Singles, row: int, j: int) -> Four:
    return w[row + j], w[row + BATCH + j], w[row + 2 * BATCH + j], w[row + 3 * BATCH + j]


@njit(cache=True, nogil=True, fastmath=QUICK)
def _whole(count: int) -> int:
    """Return how many lanes hold so many pixels."""
    return (count + _STEP - 1) // _STEP * _STEP


@njit(cache=True, nogil=True, fastmath=QUICK)
def _part(count: int, m: Six, k: Number, w: Singles, inner: Ints, edge: Ints) -> tuple[int, int]:
    """Sort pixels into those inside the outline and those on its edge; return how many of each."""
    for j in range(_whole(count)):
        step = footprint(_four(w, _ALL_ACROSS, j), _four(w, _ALL_DOWN, j), ZERO)
        w[_NEAR + j], w[_FULL + j] = candidate(approach(_four(w, _ALL_RAY, j), m, step), m, step, k)
    inners, edges = 0, 0
    for j in range(count):  # without branches, which no processor could foresee
        full = w[_FULL + j] > ZERO
        inner[inners], edge[edges] = j, j
        inners += full
        edges += (w[_NEAR + j] > ZERO) & ~full
    return inners, edges


@njit(cache=True, nogil=True, fastmath=QUICK)
def _take(count: int, which: Ints, w: Singles) -> None:
    """Put some of the batch's pixels into the first rows; lanes without a pixel repeat the first."""
    lanes = _whole(count)
    which[count:lanes] = which[0]
    for c in range(_PIXEL_ROWS):
        for j in range(lanes):
            w[_RAY + c * BATCH + j] = w[c * BATCH + which[j]]


@njit(cache=True, nogil=True, fastmath=QUICK)
def _sample(
    i: int, count: int, grid: int, full: bool, m: Six, centres: Floats, metric: Floats, lamps: Floats,
    dark_first: Whole, dark_members: Whole, ambient: float, bright: bool, w: Singles,
) -> None:  # fmt: skip
    """Sum light and coverage over the sub-pixels of ``count`` pixels."""
    lanes, k = _whole(count), np.float32(grid)
    even, rest = np.float32(ambient), np.float32(1 - ambient)
    for j in range(lanes):
        w[_LIGHT + j] = w[_SUM + j] = w[_WHOLE + j] = w[_ASIDE + j] = w[_BELOW + j] = ZERO
    for sample in range(grid * grid):
        column, row = np.float32(sample % grid), np.float32(sample // grid)
        right, low = (column + HALF) / k - HALF, (row + HALF) / k - HALF
        for j in range(lanes):
            across, down = _four(w, _ACROSS, j), _four(w, _DOWN, j)
            ray = between(_four(w, _RAY, j), across, down, right, low)
            met = approach(ray, m, footprint(across, down, ZERO))
            covers = ONE if full else coverage(met, k)
            x, y, z, nx, ny, nz = place_met(met, ray, m, covers, k)
            w[_X + j], w[_Y + j], w[_Z + j] = x, y, z
            w[_NX + j], w[_NY + j], w[_NZ + j] = nx, ny, nz
            w[_DX + j], w[_DY + j] = ray[2], ray[3]
            w[_COVERS + j], w[_BRIGHT + j] = covers, ZERO
        if bright:
            _light(i, lanes, k, centres, metric, lamps, dark_first, dark_members, w)
        for j in range(lanes):
            covers = w[_COVERS + j]
            w[_LIGHT + j] += (rest * w[_BRIGHT + j] + even) * covers
            w[_SUM + j] += covers
            weight = np.floor(covers * _WEIGHT + HALF)
            w[_WHOLE + j] += weight
            w[_ASIDE + j] += weight * column
            w[_BELOW + j] += weight * row


@njit(cache=True, nogil=True, fastmath=QUICK)
def _tally(count: int, k: int, w: Singles, tally: Floats) -> None:
    """Add what ``count`` pixels show of their marker."""
    whole, columns, rows = 0.0, 0.0, 0.0
    for j in range(count):
        weight = float(w[_WHOLE + j])
        whole += weight
        columns += weight * k * w[_COLUMN + j] + w[_ASIDE + j]
        rows += weight * k * w[_ROW + j] + w[_BELOW + j]
    tally[0] += whole
    tally[1] += whole
    tally[2] += columns
    tally[3] += rows


@njit(cache=True, nogil=True, fastmath=QUICK)
def _light(
    i: int, lanes: int, k: Number, centres: Floats, metric: Floats, lamps: Floats, dark_first: Whole,
    dark_members: Whole, w: Singles,
) -> None:  # fmt: skip
    """Add the light of all LEDs, shadows included."""
    count = lamps.shape[1]
    for led in range(count):
        lx, ly, lz, power = _from(centres[i], lamps[i, led])
        if power <= 0:
            continue
        for j in range(lanes):
            tx, ty, tz = lx - w[_X + j], ly - w[_Y + j], lz - w[_Z + j]
            square = max(tx * tx + ty * ty + tz * tz, _FAINT)
            cosine = w[_NX + j] * tx + w[_NY + j] * ty + w[_NZ + j] * tz
            w[_CLEAR + j] = power * max(cosine, ZERO) / (square * np.sqrt(square))
        for dark in range(dark_first[i * count + led], dark_first[i * count + led + 1]):
            other = dark_members[dark]
            m = _single(matrix_of(metric, other))
            centre = _from(centres[i], centres[other])[:3]
            for j in range(lanes):
                place = (w[_X + j], w[_Y + j], w[_Z + j])
                step = footprint(_four(w, _ACROSS, j), _four(w, _DOWN, j), -place[2])
                way, normal = (lx - place[0], ly - place[1], lz - place[2]), (w[_NX + j], w[_NY + j], w[_NZ + j])
                w[_CLEAR + j] *= ONE - blocked(centre, m, place, way, normal, w[_DX + j], w[_DY + j], step, k)
        for j in range(lanes):
            w[_BRIGHT + j] += w[_CLEAR + j]


@njit(cache=True, nogil=True, fastmath=QUICK)
def _from(centre: Floats, there: Floats) -> Four:
    """Return a place as seen from a centre, and the number that comes with it."""
    return (np.float32(there[0] - centre[0]), np.float32(there[1] - centre[1]), np.float32(there[2] - centre[2]),
            np.float32(there[-1]))  # fmt: skip
