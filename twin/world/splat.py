"""The picture without Mitsuba: every pixel meets the few ellipsoids whose boxes cover it, in closed form, in numba.

The sums are those of `twin.world.wavefront`, three things cheaper. A pixel knows its candidates, so nothing is
searched. A pixel inside one marker's outline takes one ray where edges take k x k: shading is smooth. And the edge of a
shadow is smoothed as the edge of a marker is, by the ray's distance to the silhouette of what blocks it, so that it
needs no finer grid. All in double precision: rays may start anywhere, and thin or far markers lose nothing.

Threads work on separate pixels, and tallies are whole numbers: the number of threads changes no bit.

Validity: as in `twin.world.render`; several shadows on one place multiply, as if what blocks were unrelated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Singles
from twin.world.frame import OPAQUE, WEIGHT, Frame
from twin.world.threads import in_parts
from twin.world.view import View

_INTERIOR = 3
"""The grid of an edge is so many times finer than inside an outline."""

_GRAZING = 0.1
"""Least cosine between a surface and a camera ray for which a shadow's edge is thought to run over it."""

_QUICK = {"contract", "arcp", "reassoc", "nsz"}
"""What the compiler may do with sums: nothing that breaks infinities."""

Whole = NDArray[np.int32]


class Splat:
    """Camera and shadow rays of all pixels, on all cores."""

    def __init__(self, view: View, unit_mm: float, ambient: float) -> None:
        self._corners = np.ascontiguousarray(view.corners / [unit_mm, unit_mm, 1, 1])
        self._ambient = ambient

    def shade(self, frame: Frame) -> tuple[Singles, Singles]:
        """Return (m, 3) light from markers in the frame's pixels, and (m,) the share of each that they leave free."""
        near = frame.near
        light, free = np.empty((len(near.pixels), 3), np.float32), np.empty(len(near.pixels), np.float32)
        lists = frame.occluders

        def some(_: int, begin: int, end: int) -> None:
            _shade(begin, end, near.pixels, near.first, near.members, self._corners, frame.base,
                   frame.centres, frame.metric, frame.colour, frame.lamps, lists.first, lists.members,
                   frame.subpixels, max(frame.subpixels // _INTERIOR, 1), self._ambient, light, free)  # fmt: skip

        in_parts(len(near.pixels), some)
        return light, free

    def count(self, frame: Frame) -> tuple[Ints, Ints, Ints]:
        """Return (n,) seen and (n,) whole coverage of every marker, and (n, 2) moments of what is seen.

        All in sub-pixels times ``WEIGHT``, moments about the pixel nearest the marker.
        """
        near = frame.near
        nearest = np.rint(near.centres_px).astype(np.int64)

        def some(_: int, begin: int, end: int) -> Any:
            return _count(begin, end, near.pixels, near.first, near.members, self._corners, frame.base,
                          frame.centres, frame.metric, nearest, frame.subpixels)  # fmt: skip

        tallies = sum(in_parts(len(near.pixels), some), np.zeros((len(frame), 4), np.int64))
        return tallies[:, 1], tallies[:, 0], tallies[:, 2:]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK)  # type: ignore[untyped-decorator]
def _shade(
    begin: int, end: int, pixels: Ints, first: Whole, members: Whole, corners: Floats, base: float,
    centres: Floats, metric: Floats, colour: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole,
    edge_grid: int, inner_grid: int, ambient: float, light: Singles, free: Singles,
) -> None:  # fmt: skip
    """Write light and free share of the pixels ``begin`` to ``end``."""
    room = 1
    for j in range(begin, end):
        room = max(room, first[j + 1] - first[j])
    near, meet, order = np.empty(room, np.int64), np.empty((room, 11)), np.empty(room, np.int64)
    tangent = np.empty((room, 3))
    middle, ray, across, down = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    total = np.zeros(3)
    for j in range(begin, end):
        pixel_rays(pixels[j], corners, middle, across, down)
        found, simple = pixel_candidates(first[j], first[j + 1], members, base, centres, metric, edge_grid, near, meet,
                                    tangent, middle, across, down)  # fmt: skip
        total[:] = 0
        clear_sum, k = 1.0, 1
        if found > 0:
            k = inner_grid if simple else edge_grid
            clear_sum = 0.0
            for sample in range(k * k):
                hits = hits_of_sample(found, near, base, centres, metric, middle, ray, across, down, sample, k,
                                      simple, meet, tangent, order)  # fmt: skip
                clear = 1.0
                for h in range(hits):
                    at = order[h]
                    marker, covers = near[at], meet[at, 0]
                    bright = _bright(marker, meet, at, ray, across, down, base, centres, metric, lamps,
                                     dark_first, dark_members, k)  # fmt: skip
                    share = ((1 - ambient) * bright + ambient) * covers * clear
                    for c in range(3):
                        total[c] += colour[marker, c] * share
                    clear *= 1 - covers
                    if clear < OPAQUE:
                        break
                clear_sum += clear
        for c in range(3):
            light[j, c] = total[c] / (k * k)
        free[j] = clear_sum / (k * k)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK)  # type: ignore[untyped-decorator]
def _count(
    begin: int, end: int, pixels: Ints, first: Whole, members: Whole, corners: Floats, base: float,
    centres: Floats, metric: Floats, nearest: Ints, k: int,
) -> Ints:  # fmt: skip
    """Return (n, 4) whole and seen coverage and moments of columns and rows of what is seen."""
    room = 1
    for j in range(begin, end):
        room = max(room, first[j + 1] - first[j])
    near, meet, order = np.empty(room, np.int64), np.empty((room, 11)), np.empty(room, np.int64)
    tangent = np.empty((room, 3))
    middle, ray, across, down = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    tallies = np.zeros((len(centres), 4), np.int64)
    width = corners.shape[1] - 1
    for j in range(begin, end):
        pixel_rays(pixels[j], corners, middle, across, down)
        found, simple = pixel_candidates(first[j], first[j + 1], members, base, centres, metric, k, near, meet, tangent,
                                    middle, across, down)  # fmt: skip
        row, column = pixels[j] // width, pixels[j] % width
        if simple:
            marker = near[0]
            tallies[marker, 0] += k * k * WEIGHT
            tallies[marker, 1] += k * k * WEIGHT
            half = k * k * (k - 1) // 2
            tallies[marker, 2] += WEIGHT * (k * k * k * (column - nearest[marker, 0]) + half)
            tallies[marker, 3] += WEIGHT * (k * k * k * (row - nearest[marker, 1]) + half)
        elif found > 0:
            for sample in range(k * k):
                hits = hits_of_sample(found, near, base, centres, metric, middle, ray, across, down, sample, k,
                                      False, meet, tangent, order)  # fmt: skip
                clear = 1.0
                for h in range(hits):
                    marker, covers = near[order[h]], meet[order[h], 0]
                    seen = np.int64(np.rint(covers * clear * WEIGHT))
                    tallies[marker, 0] += np.int64(np.rint(covers * WEIGHT))
                    tallies[marker, 1] += seen
                    tallies[marker, 2] += seen * (column * k + sample % k - k * nearest[marker, 0])
                    tallies[marker, 3] += seen * (row * k + sample // k - k * nearest[marker, 1])
                    clear *= 1 - covers
    return tallies


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def pixel_rays(pixel: int, corners: Floats, middle: Floats, across: Floats, down: Floats) -> None:
    """Write a pixel's middle ray, and how rays change along its column and row."""
    width = corners.shape[1] - 1
    row, column = pixel // width, pixel % width
    for c in range(4):
        upper, upper2 = corners[row, column, c], corners[row, column + 1, c]
        lower, lower2 = corners[row + 1, column, c], corners[row + 1, column + 1, c]
        middle[c] = (upper + upper2 + lower + lower2) / 4
        across[c] = (upper2 - upper + lower2 - lower) / 2
        down[c] = (lower - upper + lower2 - upper2) / 2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def pixel_candidates(
    begin: int, end: int, members: Whole, base: float, centres: Floats, metric: Floats, k: int,
    near: Ints, meet: Floats, tangent: Floats, ray: Floats, across: Floats, down: Floats,
) -> tuple[int, bool]:  # fmt: skip
    """Write which markers the pixel may show, and where its middle ray meets them.

    Returns their number, and whether there is just one that fills the pixel.

    Notes
    -----
    A ray's distance to a centre in a marker's own metric is the norm of a map that is nearly straight over a pixel. A
    norm is convex: it falls nowhere below its tangent, and rises at most by the map's norm times half a diagonal.
    """
    found, full = 0, False
    for i in range(begin, end):
        marker = members[i]
        steep = _meet(marker, base, centres, metric, ray, across, down, meet, found)
        miss = meet[found, 0]
        reach = (abs(meet[found, 8]) + abs(meet[found, 9])) / 2
        if miss < 1 + (reach * (k - 1) + 0.5 * steep) / k:
            full = miss < 1 - 0.71 * meet[found, 10]
            tangent[found, 0] = miss - 1 - 0.5 * steep / k
            tangent[found, 1], tangent[found, 2] = meet[found, 8], meet[found, 9]
            near[found] = marker
            found += 1
    return found, found == 1 and full


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def _meet(
    marker: int, base: float, centres: Floats, metric: Floats, ray: Floats, across: Floats, down: Floats,
    out: Floats, at: int,
) -> float:  # fmt: skip
    """Write where a ray meets or just misses a marker; return how fast its distance changes, per pixel.

    ``out[at]``: 0 the ray's distance to the centre where the marker's radius is 1; 1 to 3 the way from the centre to
    the surface, 4 to 6 the metric times it (the normal), 7 the height z; 8 and 9 the distance's gradient along column
    and row, 10 the most that it can change per pixel.
    """
    cx, cy, cz = centres[marker, 0], centres[marker, 1], centres[marker, 2]
    m00, m11, m22 = metric[marker, 0, 0], metric[marker, 1, 1], metric[marker, 2, 2]
    m01, m02, m12 = metric[marker, 0, 1], metric[marker, 0, 2], metric[marker, 1, 2]
    drop = base - cz
    fx, fy = ray[0] + ray[2] * drop - cx, ray[1] + ray[3] * drop - cy
    dx, dy = ray[2], ray[3]
    ax, ay, az = m00 * dx + m01 * dy - m02, m01 * dx + m11 * dy - m12, m02 * dx + m12 * dy - m22
    square = dx * ax + dy * ay - az
    t = (fx * ax + fy * ay) / square
    x, y, z = fx - dx * t, fy - dy * t, t
    gx, gy, gz = m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z
    miss = np.sqrt(max(x * gx + y * gy + z * gz, 0.0))
    # The ray one pixel on passes the centre's height this much aside, and only what is across the ray counts.
    px, py = across[0] + across[2] * drop, across[1] + across[3] * drop
    qx, qy = down[0] + down[2] * drop, down[1] + down[3] * drop
    one, two = gx * px + gy * py, gx * qx + gy * qy
    inverse = 1 / max(miss, 1e-9)
    steep = np.sqrt(one * one + two * two) * inverse
    pa, qa = px * ax + py * ay, qx * ax + qy * ay
    pp = m00 * px * px + 2 * m01 * px * py + m11 * py * py - pa * pa / square
    qq = m00 * qx * qx + 2 * m01 * qx * qy + m11 * qy * qy - qa * qa / square
    pq = m00 * px * qx + m01 * (px * qy + py * qx) + m11 * py * qy - pa * qa / square
    most = np.sqrt((pp + qq) / 2 + np.sqrt((pp - qq) * (pp - qq) / 4 + pq * pq))
    depth = np.sqrt(max(1 - miss * miss, 0.0) / square)
    shrink = 1 / max(miss, 1.0)
    sx, sy, sz = x * shrink - dx * depth, y * shrink - dy * depth, z * shrink + depth
    out[at, 1], out[at, 2], out[at, 3] = sx, sy, sz
    out[at, 4], out[at, 5] = m00 * sx + m01 * sy + m02 * sz, m01 * sx + m11 * sy + m12 * sz
    out[at, 6] = m02 * sx + m12 * sy + m22 * sz
    out[at, 7] = cz + sz
    out[at, 0], out[at, 8], out[at, 9], out[at, 10] = miss, one * inverse, two * inverse, most
    return float(steep)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def hits_of_sample(
    found: int, near: Ints, base: float, centres: Floats, metric: Floats, middle: Floats, ray: Floats, across: Floats,
    down: Floats, sample: int, k: int, full: bool, meet: Floats, tangent: Floats, order: Ints,
) -> int:  # fmt: skip
    """Write where a sub-pixel's ray meets the candidates, 0 now its coverage; return how many, in order front to back.

    All rays go down, so the higher place is the nearer one.
    """
    right, low = (sample % k + 0.5) / k - 0.5, (sample // k + 0.5) / k - 0.5
    for c in range(4):
        ray[c] = middle[c] + across[c] * right + down[c] * low
    hits = 0
    for i in range(found):
        if tangent[i, 0] + tangent[i, 1] * right + tangent[i, 2] * low > 0:
            continue
        steep = _meet(near[i], base, centres, metric, ray, across, down, meet, i)
        miss, covers = meet[i, 0], 1.0
        if not full and miss >= 0.5:
            covers = min(max(0.5 + k * (1 - miss) / max(steep, 1e-6), 0.0), 1.0)
        if covers > 0:
            meet[i, 0] = covers
            at = hits
            while at > 0 and meet[order[at - 1], 7] < meet[i, 7]:
                order[at] = order[at - 1]
                at -= 1
            order[at] = i
            hits += 1
    return hits


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def _bright(
    marker: int, met: Floats, at: int, ray: Floats, across: Floats, down: Floats, base: float, centres: Floats,
    metric: Floats, lamps: Floats, dark_first: Whole, dark_members: Whole, k: int,
) -> float:  # fmt: skip
    """Return the light of all LEDs on a place of a marker, shadows included."""
    nx, ny, nz = met[at, 4], met[at, 5], met[at, 6]
    norm = 1 / np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx * norm, ny * norm, nz * norm
    x, y, z = centres[marker, 0] + met[at, 1], centres[marker, 1] + met[at, 2], met[at, 7]
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
            clear *= 1 - _blocks(dark_members[i], centres, metric, x, y, z, tx, ty, tz, nx, ny, nz, ray, across, down,
                                 base, k)  # fmt: skip
        total += lamps[marker, led, 3] * cosine * clear / (square * np.sqrt(square))
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_QUICK, forceinline=True)  # type: ignore[untyped-decorator]
def _blocks(
    other: int, centres: Floats, metric: Floats, x: float, y: float, z: float, tx: float, ty: float, tz: float,
    nx: float, ny: float, nz: float, ray: Floats, across: Floats, down: Floats, base: float, k: int,
) -> float:  # fmt: skip
    """Return the share of a sub-pixel around a place in which another marker blocks the way (tx, ty, tz) to a lamp."""
    m00, m11, m22 = metric[other, 0, 0], metric[other, 1, 1], metric[other, 2, 2]
    m01, m02, m12 = metric[other, 0, 1], metric[other, 0, 2], metric[other, 1, 2]
    fx, fy, fz = x - centres[other, 0], y - centres[other, 1], z - centres[other, 2]
    ax, ay, az = m00 * tx + m01 * ty + m02 * tz, m01 * tx + m11 * ty + m12 * tz, m02 * tx + m12 * ty + m22 * tz
    part = -(fx * ax + fy * ay + fz * az) / (tx * ax + ty * ay + tz * az)
    if part <= 0 or part >= 1:
        return 0.0
    fx, fy, fz = fx + tx * part, fy + ty * part, fz + tz * part
    gx, gy, gz = m00 * fx + m01 * fy + m02 * fz, m01 * fx + m11 * fy + m12 * fz, m02 * fx + m12 * fy + m22 * fz
    miss = np.sqrt(max(fx * gx + fy * gy + fz * gz, 0.0))
    if miss >= 3:
        return 0.0
    # How fast the place runs over its marker, and with it the way past the other one, per pixel.
    drop = base - z
    px, py = across[0] + across[2] * drop, across[1] + across[3] * drop
    qx, qy = down[0] + down[2] * drop, down[1] + down[3] * drop
    facing = min(nx * ray[2] + ny * ray[3] - nz, -_GRAZING * np.sqrt(1 + ray[2] * ray[2] + ray[3] * ray[3]))
    along = (gx * ray[2] + gy * ray[3] - gz) / facing
    one = gx * px + gy * py - along * (nx * px + ny * py)
    two = gx * qx + gy * qy - along * (nx * qx + ny * qy)
    steep = np.sqrt(one * one + two * two) / max(miss, 1e-9) * (1 - part)
    return float(min(max(0.5 + k * (1 - miss) / max(steep, 1e-9), 0.0), 1.0))
