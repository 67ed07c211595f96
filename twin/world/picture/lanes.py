"""The pixels that show one marker at most, many at once: loops that the compiler turns into vector instructions.

Nine pixels in ten near markers are such: nothing is searched, sorted or hidden there. A marker's pixels go in
batches through plain loops without branches, each lane a pixel; a pixel inside the outline takes one ray, one on the
edge k x k.

Why one array of rows of a fixed length: the compiler then knows that rows don't overlap, and needs no checks.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats, Ints, Singles
from twin.compiled import njit
from twin.world.picture.closed_form import (
    QUICK,
    Four,
    approach,
    blocked,
    candidate,
    coverage,
    footprint,
    matrix_of,
    place_met,
)
from twin.world.picture.crowded import between, pixel_rays, tally_whole
from twin.world.picture.frame import WEIGHT
from twin.world.picture.nearby import Whole

BATCH = 128
"""Pixels at once."""

_STEP = 8
"""Lanes are filled up to a multiple of this."""

# Rows of the work array: a pixel's middle ray (x, y on the base, slopes), how it changes along column and row, and the
# pixel's place from the marker's.
_RAY, _ACROSS, _DOWN, _COLUMN, _ROW = 0, 4 * BATCH, 8 * BATCH, 12 * BATCH, 13 * BATCH
_PIXEL_ROWS = 14
# Then what a sub-pixel's ray meets: a place, the unit normal, the slopes, coverage; its light;
# sums over sub-pixels.
_X, _Y, _Z, _NX, _NY, _NZ = (row * BATCH for row in range(14, 20))
_DX, _DY, _COVERS, _BRIGHT, _CLEAR, _LIGHT, _SUM = (row * BATCH for row in range(20, 27))
# And the first rows once more, for all pixels of the batch: inside the outline, on its edge or aside.
_ALL = 27 * BATCH
_ROWS = 27 + _PIXEL_ROWS


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def shade_alone(
    begin: int, end: int, pixels: Ints, alone: Ints, corners: Floats, base: float, centres: Floats, metric: Floats,
    colour: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole, nearest: Ints, edge_grid: int,
    inner_grid: int, ambient: float, bright: bool, light: Singles, free: Singles, tallies: Floats,
) -> None:  # fmt: skip
    """Write light, free share and tallies of the own pixels of markers ``begin`` to ``end``.

    Without ``bright`` only tallies count.
    """
    w = np.zeros(_ROWS * BATCH)
    inner, edge = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    for i in range(begin, end):
        for start in range(alone[i], alone[i + 1], BATCH):
            count = min(BATCH, alone[i + 1] - start)
            _look(pixels, start, count, corners, nearest[i], w)
            inners, edges = _part(i, count, base, centres, metric, edge_grid, w, inner, edge)
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
                _sample(i, n, k, full, base, centres, metric, lamps, dark_first, dark_members, ambient, bright, w,
                        tallies[i])  # fmt: skip
                for j in range(n):
                    at, share = start + which[j], w[_LIGHT + j] / (k * k)
                    light[at, 0] = colour[i, 0] * share
                    light[at, 1] = colour[i, 1] * share
                    light[at, 2] = colour[i, 2] * share
                    free[at] = 1 - w[_SUM + j] / (k * k)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def _look(pixels: Ints, start: int, count: int, corners: Floats, nearest: Ints, w: Floats) -> None:
    """Write the rays of a marker's pixels."""
    width = corners.shape[1] - 1
    row, column, last = 0, 0, np.int64(-2)
    for j in range(count):
        pixel = pixels[start + j]
        if pixel == last + 1 and column + 1 < width:
            column += 1
        else:
            row, column = pixel // width, pixel % width
        last = pixel
        middle, across, down = pixel_rays(row, column, corners)
        for c in range(4):
            w[_ALL + _RAY + c * BATCH + j] = middle[c]
            w[_ALL + _ACROSS + c * BATCH + j], w[_ALL + _DOWN + c * BATCH + j] = across[c], down[c]
        w[_ALL + _COLUMN + j], w[_ALL + _ROW + j] = column - nearest[0], row - nearest[1]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def _four(w: Floats, row: int, j: int) -> Four:
    return w[row + j], w[row + BATCH + j], w[row + 2 * BATCH + j], w[row + 3 * BATCH + j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def _whole(count: int) -> int:
    """Return how many lanes hold so many pixels."""
    return (count + _STEP - 1) // _STEP * _STEP


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def _part(
    i: int, count: int, base: float, centres: Floats, metric: Floats, k: int, w: Floats, inner: Ints, edge: Ints,
) -> tuple[int, int]:  # fmt: skip
    """Sort pixels into those inside the outline and those on its edge; return how many of each."""
    centre, m = (centres[i, 0], centres[i, 1], centres[i, 2]), matrix_of(metric, i)
    for j in range(_whole(count)):
        step = footprint(_four(w, _ALL + _ACROSS, j), _four(w, _ALL + _DOWN, j), base - centre[2])
        near, full = candidate(approach(_four(w, _ALL + _RAY, j), base, centre, m, step), m, step, k)
        w[_COVERS + j] = (1.0 if near else 0.0) + (1.0 if full else 0.0)
    inners, edges = 0, 0
    for j in range(count):
        if w[_COVERS + j] > 1.5:
            inner[inners] = j
            inners += 1
        elif w[_COVERS + j] > 0.5:
            edge[edges] = j
            edges += 1
    return inners, edges


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def _take(count: int, which: Ints, w: Floats) -> None:
    """Put some of the batch's pixels into the first rows; lanes without a pixel repeat the first."""
    lanes = _whole(count)
    which[count:lanes] = which[0]
    for c in range(_PIXEL_ROWS):
        for j in range(lanes):
            w[c * BATCH + j] = w[_ALL + c * BATCH + which[j]]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def _sample(
    i: int, count: int, k: int, full: bool, base: float, centres: Floats, metric: Floats, lamps: Floats,
    dark_first: Whole, dark_members: Whole, ambient: float, bright: bool, w: Floats, tally: Floats,
) -> None:  # fmt: skip
    """Sum light and coverage over the sub-pixels of ``count`` pixels, and tally what edges cover."""
    lanes = _whole(count)
    centre, m = (centres[i, 0], centres[i, 1], centres[i, 2]), matrix_of(metric, i)
    for j in range(lanes):
        w[_LIGHT + j] = w[_SUM + j] = 0.0
    for sample in range(k * k):
        right, low = (sample % k + 0.5) / k - 0.5, (sample // k + 0.5) / k - 0.5
        for j in range(lanes):
            across, down = _four(w, _ACROSS, j), _four(w, _DOWN, j)
            ray = between(_four(w, _RAY, j), across, down, right, low)
            met = approach(ray, base, centre, m, footprint(across, down, base - centre[2]))
            covers = 1.0 if full else coverage(met, k)
            x, y, z, nx, ny, nz = place_met(met, ray, m, covers, k)
            w[_X + j], w[_Y + j], w[_Z + j] = centre[0] + x, centre[1] + y, centre[2] + z
            w[_NX + j], w[_NY + j], w[_NZ + j] = nx, ny, nz
            w[_DX + j], w[_DY + j] = ray[2], ray[3]
            w[_COVERS + j], w[_BRIGHT + j] = covers, 0.0
        if bright:
            _light(i, lanes, k, base, centres, metric, lamps, dark_first, dark_members, w)
        whole, columns, rows = 0.0, 0.0, 0.0
        for j in range(lanes):
            covers = w[_COVERS + j]
            w[_LIGHT + j] += ((1 - ambient) * w[_BRIGHT + j] + ambient) * covers
            w[_SUM + j] += covers
            weight = np.floor(covers * WEIGHT + 0.5) if j < count else 0.0
            whole += weight
            columns += weight * (w[_COLUMN + j] * k + sample % k)
            rows += weight * (w[_ROW + j] * k + sample // k)
        if not full:
            tally[0] += whole
            tally[1] += whole
            tally[2] += columns
            tally[3] += rows


@njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK)  # type: ignore[untyped-decorator]
def _light(
    i: int, lanes: int, k: int, base: float, centres: Floats, metric: Floats, lamps: Floats,
    dark_first: Whole, dark_members: Whole, w: Floats,
) -> None:  # fmt: skip
    """Add the light of all LEDs, shadows included."""
    count = lamps.shape[1]
    for led in range(count):
        lx, ly, lz, power = lamps[i, led, 0], lamps[i, led, 1], lamps[i, led, 2], lamps[i, led, 3]
        if power <= 0:
            continue
        for j in range(lanes):
            tx, ty, tz = lx - w[_X + j], ly - w[_Y + j], lz - w[_Z + j]
            square = max(tx * tx + ty * ty + tz * tz, 1e-30)
            cosine = w[_NX + j] * tx + w[_NY + j] * ty + w[_NZ + j] * tz
            w[_CLEAR + j] = power * max(cosine, 0.0) / (square * np.sqrt(square))
        for dark in range(dark_first[i * count + led], dark_first[i * count + led + 1]):
            other = dark_members[dark]
            centre, m = (centres[other, 0], centres[other, 1], centres[other, 2]), matrix_of(metric, other)
            for j in range(lanes):
                place = (w[_X + j], w[_Y + j], w[_Z + j])
                step = footprint(_four(w, _ACROSS, j), _four(w, _DOWN, j), base - place[2])
                way, normal = (lx - place[0], ly - place[1], lz - place[2]), (w[_NX + j], w[_NY + j], w[_NZ + j])
                w[_CLEAR + j] *= 1 - blocked(centre, m, place, way, normal, w[_DX + j], w[_DY + j], step, k)
        for j in range(lanes):
            w[_BRIGHT + j] += w[_CLEAR + j]
