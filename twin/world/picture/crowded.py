"""The pixels that may show several markers: each meets its few candidates one by one, front to back."""

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
    relative,
)
from twin.world.picture.frame import OPAQUE, WEIGHT
from twin.world.picture.nearby import Whole


@njit(cache=True, nogil=True, fastmath=QUICK)
def shade_crowded(
    begin: int, end: int, pixels: Ints, first: Whole, members: Whole, corners: Floats, base: float, centres: Floats,
    metric: Floats, colour: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole, nearest: Ints,
    edge_grid: int, inner_grid: int, ambient: float, bright: bool, light: Singles, free: Singles, tallies: Floats,
) -> None:  # fmt: skip
    """Write light and free share of pixels ``begin`` to ``end``, and add to the markers' tallies.

    Without ``bright`` only tallies count.
    """
    room = most_candidates(begin, end, first)
    near, order = np.empty(room, np.int64), np.empty(room, np.int64)
    meet = np.empty((room, 7))
    width = corners.shape[2] - 1
    for j in range(begin, end):
        middle, across, down = pixel_rays(pixels[j] // width, pixels[j] % width, corners)
        found, simple = pixel_candidates(first[j], first[j + 1], members, base, centres, metric, edge_grid, near,
                                         middle, across, down)  # fmt: skip
        light[j, 0], light[j, 1], light[j, 2], free[j] = 0, 0, 0, 1
        if found == 0:
            continue
        column, row = pixels[j] % width - nearest[near[0], 0], pixels[j] // width - nearest[near[0], 1]
        k = edge_grid
        if simple:
            tally_whole(1, edge_grid, column, row, tallies[near[0]])
            k = inner_grid
        red, green, blue, clear_sum = 0.0, 0.0, 0.0, 0.0
        for sample in range(k * k):
            right, low = (sample % k + 0.5) / k - 0.5, (sample // k + 0.5) / k - 0.5
            ray = between(middle, across, down, right, low)
            hits = hits_of_sample(found, near, base, centres, metric, ray, across, down, k, meet, order)  # fmt: skip
            clear = 1.0
            for h in range(hits):
                at = order[h]
                marker, covers = near[at], 1.0 if simple else meet[at, 0]
                if not simple:
                    seen, whole = np.rint(covers * clear * WEIGHT), np.rint(covers * WEIGHT)
                    column, row = pixels[j] % width - nearest[marker, 0], pixels[j] // width - nearest[marker, 1]
                    tallies[marker, 0] += whole
                    tallies[marker, 1] += seen
                    tallies[marker, 2] += seen * (column * k + sample % k)
                    tallies[marker, 3] += seen * (row * k + sample // k)
                if bright and clear >= OPAQUE:
                    lit = _bright(marker, meet, at, ray, across, down, base, centres, metric, lamps, dark_first,
                                  dark_members, k)  # fmt: skip
                    share = ((1 - ambient) * lit + ambient) * covers * clear
                    red += colour[marker, 0] * share
                    green += colour[marker, 1] * share
                    blue += colour[marker, 2] * share
                clear *= 1 - covers
            clear_sum += clear
        light[j, 0], light[j, 1], light[j, 2] = red / (k * k), green / (k * k), blue / (k * k)
        free[j] = clear_sum / (k * k)


@njit(cache=True, nogil=True, fastmath=QUICK)
def most_candidates(begin: int, end: int, first: Whole) -> int:
    """Return the length of the longest list of markers of pixels ``begin`` to ``end``."""
    room = 1
    for j in range(begin, end):
        room = max(room, first[j + 1] - first[j])
    return room


@njit(cache=True, nogil=True, fastmath=QUICK)
def tally_whole(count: int, k: int, columns: float, rows: float, tally: Floats) -> None:
    """Count pixels, the sums of whose places are given, that are covered wholly, as k x k sub-pixels would."""
    half = k * k * (k - 1) / 2 * count
    tally[0] += WEIGHT * k * k * count
    tally[1] += WEIGHT * k * k * count
    tally[2] += WEIGHT * (k * k * k * columns + half)
    tally[3] += WEIGHT * (k * k * k * rows + half)


@njit(cache=True, nogil=True, fastmath=QUICK)
def pixel_rays(row: int, column: int, corners: Floats) -> tuple[Four, Four, Four]:
    """Return a pixel's middle ray, and how rays change along its column and row."""
    a, b = corners[:, row, column], corners[:, row, column + 1]
    c, d = corners[:, row + 1, column], corners[:, row + 1, column + 1]
    return (
        ((a[0] + b[0] + c[0] + d[0]) / 4, (a[1] + b[1] + c[1] + d[1]) / 4,
         (a[2] + b[2] + c[2] + d[2]) / 4, (a[3] + b[3] + c[3] + d[3]) / 4),
        ((b[0] - a[0] + d[0] - c[0]) / 2, (b[1] - a[1] + d[1] - c[1]) / 2,
         (b[2] - a[2] + d[2] - c[2]) / 2, (b[3] - a[3] + d[3] - c[3]) / 2),
        ((c[0] - a[0] + d[0] - b[0]) / 2, (c[1] - a[1] + d[1] - b[1]) / 2,
         (c[2] - a[2] + d[2] - b[2]) / 2, (c[3] - a[3] + d[3] - b[3]) / 2),
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=QUICK)
def between(middle: Four, across: Four, down: Four, right: float, low: float) -> Four:
    """Return the ray through a place of a pixel, in shares of it from its middle."""
    return (middle[0] + across[0] * right + down[0] * low, middle[1] + across[1] * right + down[1] * low,
            middle[2] + across[2] * right + down[2] * low, middle[3] + across[3] * right + down[3] * low)  # fmt: skip


@njit(cache=True, nogil=True, fastmath=QUICK)
def pixel_candidates(
    begin: int, end: int, members: Whole, base: float, centres: Floats, metric: Floats, k: int, near: Ints,
    ray: Four, across: Four, down: Four,
) -> tuple[int, bool]:  # fmt: skip
    """Write which markers the pixel may show; return their number, and whether just one does and fills the pixel."""
    found, full = 0, False
    for i in range(begin, end):
        marker = members[i]
        m, centre = matrix_of(metric, marker), (centres[marker, 0], centres[marker, 1], centres[marker, 2])
        drop = base - centre[2]
        step = footprint(across, down, drop)
        met = approach(relative(ray, drop, centre), m, step)
        may, fills = candidate(met, m, step, k)
        if may > 0:
            full = fills > 0
            near[found] = marker
            found += 1
    return found, found == 1 and full


@njit(cache=True, nogil=True, fastmath=QUICK)
def hits_of_sample(
    found: int, near: Ints, base: float, centres: Floats, metric: Floats, ray: Four, across: Four, down: Four,
    k: int, meet: Floats, order: Ints,
) -> int:  # fmt: skip
    """Write where a sub-pixel's ray meets the candidates; return how many it does, in order front to back.

    ``meet`` holds of each candidate its coverage, the place and the unit normal. All rays go down, so the higher place
    is the nearer one.
    """
    hits = 0
    for i in range(found):
        marker = near[i]
        m, centre = matrix_of(metric, marker), (centres[marker, 0], centres[marker, 1], centres[marker, 2])
        drop = base - centre[2]
        met = approach(relative(ray, drop, centre), m, footprint(across, down, drop))
        covers = coverage(met, k)
        if covers > 0:
            x, y, z, nx, ny, nz = place_met(met, ray, m, covers, k)
            meet[i, 0], meet[i, 1], meet[i, 2], meet[i, 3] = covers, centre[0] + x, centre[1] + y, centre[2] + z
            meet[i, 4], meet[i, 5], meet[i, 6] = nx, ny, nz
            at = hits
            while at > 0 and meet[order[at - 1], 3] < meet[i, 3]:
                order[at] = order[at - 1]
                at -= 1
            order[at] = i
            hits += 1
    return hits


@njit(cache=True, nogil=True, fastmath=QUICK)
def _bright(
    marker: int, meet: Floats, at: int, ray: Four, across: Four, down: Four, base: float, centres: Floats,
    metric: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole, k: int,
) -> float:  # fmt: skip
    """Return the light of all LEDs on a place of a marker, shadows included."""
    x, y, z, nx, ny, nz = meet[at, 1], meet[at, 2], meet[at, 3], meet[at, 4], meet[at, 5], meet[at, 6]
    step = footprint(across, down, base - z)
    total = 0.0
    count = lamps.shape[1]
    for led in range(count):
        tx, ty, tz = lamps[marker, led, 0] - x, lamps[marker, led, 1] - y, lamps[marker, led, 2] - z
        square = tx * tx + ty * ty + tz * tz
        cosine = nx * tx + ny * ty + nz * tz
        if cosine <= 0 or lamps[marker, led, 3] <= 0:
            continue
        clear = 1.0
        pair = marker * count + led
        for i in range(dark_first[pair], dark_first[pair + 1]):
            other = dark_members[i]
            clear *= 1 - blocked((centres[other, 0], centres[other, 1], centres[other, 2]), matrix_of(metric, other),
                                 (x, y, z), (tx, ty, tz), (nx, ny, nz), ray[2], ray[3], step, k)  # fmt: skip
        total += lamps[marker, led, 3] * cosine * clear / (square * np.sqrt(square))
    return total
