"""The renderer without Mitsuba: each pixel meets its few candidate ellipsoids in closed form.

An ellipsoid's own metric M makes it a unit ball. A ray's least distance to the centre in that
metric is below 1 where it meets the ellipsoid; how much of a sub-pixel is covered follows from that
distance and how fast it changes from pixel to pixel. So edges are smooth and centroids need few
rays; inside an outline shading is smooth, and fewer still do. The edge of a shadow is smoothed in
the same way, by the distance of the way to the lamp.

Pixels near one outline only, nine in ten, go many at once through loops that the compiler turns
into vector instructions (`_shade_isolated`); pixels near several meet their candidates one by one,
front to back (`_shade_overlapping`). The first takes a quarter of the second's time (12 ms against
49 ms a picture of 636 markers) and is the only reason for two. A test holds them together.

Rays go down and are relative to the ellipsoid's centre: (fx + dx t, fy + dy t, -t). Formulas keep
the precision of their arguments, so their constants are singles: next to a Python float numba would
take every single for a double and halve the lanes of vector instructions.

Threads work on separate pixels, and tallies are whole numbers below 2^24: the number of threads
changes no bit.

Validity: markers at least a sub-pixel in radius, up to 20 x 20 rays a pixel; several shadows on one
place multiply, as if what blocks were unrelated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, Pixels, Singles, frozen
from twin.compiled import in_parts, njit
from twin.world.picture.camera_rays import View
from twin.world.picture.picture_job import INTO, OPAQUE, WEIGHT, Indices, PictureJob

_HIDDEN = 0.01
"""A smaller share of an outline that is seen counts as none: edges just behind edges leave such
specks."""

_INTERIOR = 3
"""The grid of an edge is so many times finer than inside an outline."""

_REORDER = {"contract", "arcp", "reassoc", "nsz"}
"""What the compiler may do with sums: nothing that breaks infinities."""

_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_ONE = np.float32(1)
_TWO = np.float32(2)
_DEPTH_INTO = np.float32(INTO)
_FULL_WEIGHT = np.float32(WEIGHT)
_TINY = np.float32(1e-9)
_FAINT = np.float32(1e-30)

_GRAZING = np.float32(0.1)
"""Least cosine between a surface and a camera ray at which a shadow's edge is taken to run over
the surface."""

_INNER = np.float32(1.5)
"""Pixels, by half their steepest step, inside the outline where one ray begins to do; 0.71 is the
edge."""

_FAR = np.float32(3)
"""Radii from a marker's centre beyond which a ray is not near its shadow's edge."""

_BATCH = 256
"""Isolated pixels at once."""

_LANES = 8
"""Batches are filled up to a multiple of this."""

# Rows of the work array of `_shade_isolated`, _BATCH singles each, in one array of fixed rows so
# that the compiler knows that they don't overlap. First all pixels of a batch: the middle ray at
# the height of the marker's centre, its change along column and row, and the pixel's place.
_ALL_RAY, _ALL_ACROSS, _ALL_DOWN, _ALL_COLUMN, _ALL_ROW = (r * _BATCH for r in (0, 4, 8, 12, 13))
_PIXEL_ROWS = 14
# The same for the pixels that are shaded together.
_RAY, _ACROSS, _DOWN, _COLUMN, _ROW = (r * _BATCH for r in (14, 18, 22, 26, 27))
# What a sub-pixel's ray meets: a place from the centre, the unit normal, slopes, coverage; light.
_X, _Y, _Z, _NX, _NY, _NZ = (r * _BATCH for r in range(28, 34))
_DX, _DY, _COVERS, _CLEAR, _BRIGHT = (r * _BATCH for r in range(34, 39))
# Sums over sub-pixels: coverage, and weights, alone and times column and row; light. The last rows
# of both, of `_BRIGHT` and `_LIGHT`, are three: one for each channel of coloured light.
_SUM, _WHOLE, _ASIDE, _BELOW, _LIGHT = (r * _BATCH for r in range(41, 46))
_NEAR, _FULL = _X, _Y
_ROWS = 48

Number = float | np.float32
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]
Approach = tuple[Number, ...]


@dataclass(frozen=True, kw_only=True)
class Outlines:
    """Visible outlines of the markers, in their one order.

    Attributes
    ----------
    centroid_px
        (n, 2) coverage centroid of what is seen of each marker; NaN where nothing is.
    visible
        (n,) share of the whole outline that is seen: 1 free, 0 hidden, lost or outside the picture.
    area_px
        (n,) area that is seen, px^2.
    """

    centroid_px: Pixels
    visible: Floats
    area_px: Floats


class Splat:
    """Renders jobs of one view, on all cores."""

    def __init__(self, view: View, unit_mm: float, ambient: float) -> None:
        self._corners = np.ascontiguousarray(
            np.moveaxis(view.corners / [unit_mm, unit_mm, 1, 1], 2, 0)
        )
        self._ambient = ambient

    def shade(self, job: PictureJob) -> tuple[Singles, Singles]:
        """See `twin.world.picture.render.RENDERERS`."""
        return self.look(job)[:2]

    def look(self, job: PictureJob, *, bright: bool = True) -> tuple[Singles, Singles, Outlines]:
        """Return light and free shares as `shade` does, and the outlines; without ``bright`` the
        outlines alone count."""
        k = job.subpixels
        light = np.empty((len(job.pixels), 3), np.float32)
        free = np.empty(len(job.pixels), np.float32)
        # What both kernels need: markers, their light, and the pixels nearest to them.
        metric = np.ascontiguousarray(job.metric[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        nearest = np.rint(job.centres_px).astype(np.int64)
        lamps = (job.lamps, job.tints.astype(np.float32), job.even)
        shadows = (job.occluder_first, job.occluder_members)
        grids = (k, max(k // _INTERIOR, 1))
        lit_by = (job.colour, *lamps, *shadows, nearest, grids, self._ambient, bright)
        placed = (self._corners, job.base, job.centres)
        singles = metric.astype(np.float32)
        own = int(job.isolated[-1])
        longest = int(np.diff(job.first).max(initial=1))

        def isolated(_: int, begin: int, end: int) -> Any:
            tallies = np.zeros((len(job), 4))
            work = (np.zeros(_ROWS * _BATCH, np.float32), np.empty((2, _BATCH), np.int64))
            lists = (job.pixels, job.isolated)
            _shade_isolated(
                begin, end, lists, placed, singles, lit_by, work, (light, free, tallies)
            )
            return tallies

        def overlapping(_: int, begin: int, end: int) -> Any:
            tallies = np.zeros((len(job), 4))
            work = (np.empty((2, longest), np.int64), np.empty((longest, 7)))
            lists = (job.pixels, job.first, job.members)
            where = (own + begin, own + end)
            _shade_overlapping(*where, lists, placed, metric, lit_by, work, (light, free, tallies))
            return tallies

        parts = in_parts(len(job), isolated) + in_parts(len(job.pixels) - own, overlapping)
        return light, free, _outlines(job, np.sum(parts, axis=0).astype(np.int64))


def _outlines(job: PictureJob, tallies: Ints) -> Outlines:
    """Return outlines from (n, 4) tallies: coverage of each marker, all of it and what nothing
    hides, in sub-pixels times `WEIGHT`; columns and rows of the latter, from the sub-pixels'
    corners of the pixel nearest the marker."""
    k = job.subpixels
    whole, seen = tallies[:, 0], tallies[:, 1]
    area = seen / (k * k * WEIGHT)
    expected = whole / (k * k * WEIGHT)
    first_order = np.pi * np.sqrt(np.linalg.det(job.conjugate))
    expected = np.where(job.cut, np.maximum(expected, first_order), expected)
    seen = np.where(area >= _HIDDEN * expected, seen, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        centroid = np.rint(job.centres_px) + (tallies[:, 2:] / seen[:, None] + 0.5) / k - 0.5
        centroid = np.where(seen[:, None] > 0, centroid, np.nan)
        visible = np.where(seen > 0, np.minimum(area / expected, 1.0), 0.0)
    area = np.where(seen > 0, area, 0.0)
    return Outlines(centroid_px=frozen(centroid), visible=frozen(visible), area_px=frozen(area))


@njit(cache=True, fastmath=_REORDER)
def _six(row: Any) -> Six:
    return row[0], row[1], row[2], row[3], row[4], row[5]


@njit(cache=True, fastmath=_REORDER)
def _approach(ray: Four, m: Six, step: Four) -> Approach:
    """Return how a ray (fx, fy, dx, dy) passes an ellipsoid of metric ``m``: its distance to the
    centre in the metric, that distance's change along column and row (``step``: how far aside the
    next rays go, at the centre's height), the nearest point (3), the metric times the ray's
    direction (3), that direction's square, and the steepest change."""
    m00, m11, m22, m01, m02, m12 = m
    fx, fy, dx, dy = ray
    ax, ay, az = m00 * dx + m01 * dy - m02, m01 * dx + m11 * dy - m12, m02 * dx + m12 * dy - m22
    square = dx * ax + dy * ay - az
    t = (fx * ax + fy * ay) / square
    x = fx - dx * t
    y = fy - dy * t
    z = t
    gx = m00 * x + m01 * y + m02 * z
    gy = m01 * x + m11 * y + m12 * z
    gz = m02 * x + m12 * y + m22 * z
    miss = np.sqrt(max(x * gx + y * gy + z * gz, _ZERO))
    # At the nearest point the gradient has no part along the ray, so a step aside is enough.
    inverse = _ONE / max(miss, _TINY)
    one, two = (gx * step[0] + gy * step[1]) * inverse, (gx * step[2] + gy * step[3]) * inverse
    return miss, one, two, x, y, z, ax, ay, az, square, np.sqrt(one * one + two * two)


@njit(cache=True, fastmath=_REORDER)
def _candidate(met: Approach, m: Six, step: Four, k: Number) -> tuple[Number, Number]:
    """Return two numbers, positive if any of a pixel's k x k sub-pixels may show the ellipsoid, and
    if all of them do.

    The distance is the norm of a nearly linear map. A norm is convex: it falls nowhere below its
    tangent, and rises at most by the map's norm times half a diagonal. Pixels count as full from
    another one inwards, as next to the outline one ray misses the mean of shading.
    """
    miss, one, two = met[0], met[1], met[2]
    ax = met[6]
    ay = met[7]
    square = met[9]
    steep = met[10]
    reach = (np.abs(one) + np.abs(two)) * _HALF
    m00, m11, m01 = m[0], m[1], m[3]
    px, py, qx, qy = step
    pa, qa = px * ax + py * ay, qx * ax + qy * ay
    pp = m00 * px * px + _TWO * m01 * px * py + m11 * py * py - pa * pa / square
    qq = m00 * qx * qx + _TWO * m01 * qx * qy + m11 * qy * qy - qa * qa / square
    pq = m00 * px * qx + m01 * (px * qy + py * qx) + m11 * py * qy - pa * qa / square
    half = (pp + qq) * _HALF
    apart = (pp - qq) * _HALF
    most = np.sqrt(half + np.sqrt(apart * apart + pq * pq))
    return _ONE + (reach * (k - _ONE) + _HALF * steep) / k - miss, _ONE - _INNER * most - miss


@njit(cache=True, fastmath=_REORDER)
def _coverage(met: Approach, k: Number) -> Number:
    """Return the share of a sub-pixel, 1/k px wide, around a ray that the ellipsoid covers."""
    share = min(max(_HALF + k * (_ONE - met[0]) / max(met[10], _TINY), _ZERO), _ONE)
    return _ONE if met[0] < _HALF else share


@njit(cache=True, fastmath=_REORDER)
def _lit_place(met: Approach, ray: Four, m: Six, covers: Number, k: Number) -> Six:
    """Return where a sub-pixel is lit, from the centre, and the unit normal there."""
    m00, m11, m22, m01, m02, m12 = m
    miss = met[0]
    rim = _DEPTH_INTO * covers * met[10] / k if covers < _ONE else _ONE - miss
    rim = min(max(rim, _ZERO), _ONE)
    depth = np.sqrt(rim * (_TWO - rim) / met[9])
    shrink = (_ONE - rim) / max(miss, _TINY)
    x = met[3] * shrink - ray[2] * depth
    y = met[4] * shrink - ray[3] * depth
    z = met[5] * shrink + depth
    nx = m00 * x + m01 * y + m02 * z
    ny = m01 * x + m11 * y + m12 * z
    nz = m02 * x + m12 * y + m22 * z
    norm = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
    return x, y, z, nx * norm, ny * norm, nz * norm


@njit(cache=True, fastmath=_REORDER)
def _blocked(
    centre: Three,
    m: Six,
    place: Three,
    way: Three,
    normal: Three,
    slope: tuple[Number, Number],
    step: Four,
    k: Number,
) -> Number:
    """Return the share of a sub-pixel around a ``place`` in which another ellipsoid blocks its
    ``way`` to a lamp; ``slope`` is the camera ray's, ``step`` how far aside its neighbours go."""
    m00, m11, m22, m01, m02, m12 = m
    dx, dy = slope
    tx, ty, tz = way
    fx, fy, fz = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
    ax = m00 * tx + m01 * ty + m02 * tz
    ay = m01 * tx + m11 * ty + m12 * tz
    az = m02 * tx + m12 * ty + m22 * tz
    part = -(fx * ax + fy * ay + fz * az) / (tx * ax + ty * ay + tz * az)
    fx, fy, fz = fx + tx * part, fy + ty * part, fz + tz * part
    gx = m00 * fx + m01 * fy + m02 * fz
    gy = m01 * fx + m11 * fy + m12 * fz
    gz = m02 * fx + m12 * fy + m22 * fz
    miss = np.sqrt(max(fx * gx + fy * gy + fz * gz, _ZERO))
    # How fast the place runs over its marker, and with it the way past the other one, per pixel.
    facing = min(
        normal[0] * dx + normal[1] * dy - normal[2], -_GRAZING * np.sqrt(_ONE + dx * dx + dy * dy)
    )
    along = (gx * dx + gy * dy - gz) / facing
    one = gx * step[0] + gy * step[1] - along * (normal[0] * step[0] + normal[1] * step[1])
    two = gx * step[2] + gy * step[3] - along * (normal[0] * step[2] + normal[1] * step[3])
    steep = np.sqrt(one * one + two * two) / max(miss, _TINY) * (_ONE - part)
    share = min(max(_HALF + k * (_ONE - miss) / max(steep, _TINY), _ZERO), _ONE)
    return share if part > _ZERO and part < _ONE and miss < _FAR else _ZERO


@njit(cache=True, fastmath=_REORDER)
def _four(w: Singles, at: int) -> Four:
    return w[at], w[at + _BATCH], w[at + 2 * _BATCH], w[at + 3 * _BATCH]


@njit(cache=True, fastmath=_REORDER)
def _shade_isolated(
    begin: int,
    end: int,
    lists: tuple[Ints, Ints],
    placed: tuple[Floats, float, Floats],
    metric: Singles,
    lit_by: Any,
    work: tuple[Singles, Ints],
    out: tuple[Singles, Singles, Floats],
) -> None:
    """Write ``out``, light, free share and tallies, of the own pixels of markers ``begin`` to
    ``end``.

    ``lists`` are pixels and where each marker's begin, ``placed`` corners, base and centres,
    ``lit_by`` what `Splat.look` names so; ``work`` are work arrays.
    """
    pixels, isolated = lists
    corners, base, centres = placed
    colour, lamps, tints, even, dark_first, dark_members, nearest, grids, ambient, bright = lit_by
    edge_grid, inner_grid = grids
    w, chosen = work
    light, free, tallies = out
    width = corners.shape[2] - 1
    leds = lamps.shape[1]
    quarter = 0.25
    channels = len(even)
    rest = np.float32(1 - ambient)
    inner, edge = chosen[0], chosen[1]
    for i in range(begin, end):
        m = _six(metric[i])
        cx, cy, cz = centres[i, 0], centres[i, 1], centres[i, 2]
        drop = base - cz
        for start in range(isolated[i], isolated[i + 1], _BATCH):
            count = min(_BATCH, isolated[i + 1] - start)

            # 1. Rays of the pixels.
            for j in range(count):
                row, column = divmod(pixels[start + j], width)
                for c in range(2):
                    p = corners[c, row, column]
                    q = corners[c, row, column + 1]
                    r = corners[c, row + 1, column]
                    s = corners[c, row + 1, column + 1]
                    t = corners[c + 2, row, column]
                    u = corners[c + 2, row, column + 1]
                    x = corners[c + 2, row + 1, column]
                    y = corners[c + 2, row + 1, column + 1]
                    slope = (t + u + x + y) * quarter
                    along = (u - t + y - x) * 0.5
                    below = (x - t + y - u) * 0.5
                    middle = (p + q + r + s) * quarter + slope * drop - centres[i, c]
                    w[_ALL_RAY + c * _BATCH + j] = middle
                    w[_ALL_RAY + (c + 2) * _BATCH + j] = slope
                    w[_ALL_ACROSS + c * _BATCH + j] = (q - p + s - r) * 0.5 + along * drop
                    w[_ALL_ACROSS + (c + 2) * _BATCH + j] = along
                    w[_ALL_DOWN + c * _BATCH + j] = (r - p + s - q) * 0.5 + below * drop
                    w[_ALL_DOWN + (c + 2) * _BATCH + j] = below
                w[_ALL_COLUMN + j] = column - nearest[i, 0]
                w[_ALL_ROW + j] = row - nearest[i, 1]

            # 2. Which pixels are inside the outline and which on its edge.
            for j in range((count + _LANES - 1) // _LANES * _LANES):
                step = (
                    w[_ALL_ACROSS + j],
                    w[_ALL_ACROSS + _BATCH + j],
                    w[_ALL_DOWN + j],
                    w[_ALL_DOWN + _BATCH + j],
                )
                met = _approach(_four(w, _ALL_RAY + j), m, step)
                w[_NEAR + j], w[_FULL + j] = _candidate(met, m, step, np.float32(edge_grid))
            inners, edges = 0, 0
            for j in range(count):  # without branches, which no processor could foresee
                full = w[_FULL + j] > _ZERO
                inner[inners], edge[edges] = j, j
                inners += full
                edges += (w[_NEAR + j] > _ZERO) & ~full
            for j in range(start, start + count):
                light[j, 0], light[j, 1], light[j, 2], free[j] = 0, 0, 0, 1

            for group in range(2):
                full = group == 0
                n, grid, which = (
                    (inners, inner_grid, inner) if group == 0 else (edges, edge_grid, edge)
                )
                if n == 0:
                    continue
                k = np.float32(grid)

                # 3. Put the chosen pixels side by side; lanes without a pixel repeat the first.
                lanes = (n + _LANES - 1) // _LANES * _LANES
                for j in range(n, lanes):
                    which[j] = which[0]
                for c in range(_PIXEL_ROWS):
                    for j in range(lanes):
                        w[_RAY + c * _BATCH + j] = w[c * _BATCH + which[j]]
                if full:  # tallies as k x k covered sub-pixels would give
                    columns, rows = 0.0, 0.0
                    for j in range(n):
                        columns += w[_COLUMN + j]
                        rows += w[_ROW + j]
                    e = edge_grid
                    half = e * e * (e - 1) / 2 * n
                    tallies[i, 0] += WEIGHT * e * e * n
                    tallies[i, 1] += WEIGHT * e * e * n
                    tallies[i, 2] += WEIGHT * (e * e * e * columns + half)
                    tallies[i, 3] += WEIGHT * (e * e * e * rows + half)
                    if not bright:
                        continue

                # 4. Sum light and coverage over sub-pixels.
                for j in range(lanes):
                    w[_SUM + j] = w[_WHOLE + j] = w[_ASIDE + j] = w[_BELOW + j] = _ZERO
                for c in range(channels):
                    for j in range(lanes):
                        w[_LIGHT + c * _BATCH + j] = _ZERO
                for sample in range(grid * grid):
                    column_in = np.float32(sample % grid)
                    row_in = np.float32(sample // grid)
                    right, low = (column_in + _HALF) / k - _HALF, (row_in + _HALF) / k - _HALF
                    for j in range(lanes):
                        first, across = _four(w, _RAY + j), _four(w, _ACROSS + j)
                        down = _four(w, _DOWN + j)
                        ray = (
                            first[0] + across[0] * right + down[0] * low,
                            first[1] + across[1] * right + down[1] * low,
                            first[2] + across[2] * right + down[2] * low,
                            first[3] + across[3] * right + down[3] * low,
                        )
                        met = _approach(ray, m, (across[0], across[1], down[0], down[1]))
                        covers = _ONE if full else _coverage(met, k)
                        x, y, z, nx, ny, nz = _lit_place(met, ray, m, covers, k)
                        w[_X + j], w[_Y + j], w[_Z + j] = x, y, z
                        w[_NX + j], w[_NY + j], w[_NZ + j] = nx, ny, nz
                        w[_DX + j], w[_DY + j] = ray[2], ray[3]
                        w[_COVERS + j] = covers
                    for c in range(channels):
                        for j in range(lanes):
                            w[_BRIGHT + c * _BATCH + j] = _ZERO
                    # Light of each lamp: inverse square and cosine, then the shadows of other
                    # markers.
                    for led in range(leds if bright else 0):
                        power = np.float32(lamps[i, led, 3])
                        if power <= 0:
                            continue
                        lx = np.float32(lamps[i, led, 0] - cx)
                        ly = np.float32(lamps[i, led, 1] - cy)
                        lz = np.float32(lamps[i, led, 2] - cz)
                        gx = np.float32(lamps[i, led, 4])
                        gy = np.float32(lamps[i, led, 5])
                        gz = np.float32(lamps[i, led, 6])
                        for j in range(lanes):
                            tx, ty, tz = lx - w[_X + j], ly - w[_Y + j], lz - w[_Z + j]
                            square = max(tx * tx + ty * ty + tz * tz, _FAINT)
                            cosine = w[_NX + j] * tx + w[_NY + j] * ty + w[_NZ + j] * tz
                            sends = power + gx * w[_X + j] + gy * w[_Y + j] + gz * w[_Z + j]
                            lit = max(sends, _ZERO) * max(cosine, _ZERO)
                            w[_CLEAR + j] = lit / (square * np.sqrt(square))
                        pair = i * leds + led
                        for dark in range(dark_first[pair], dark_first[pair + 1]):
                            other = dark_members[dark]
                            blocking = _six(metric[other])
                            centre = (
                                np.float32(centres[other, 0] - cx),
                                np.float32(centres[other, 1] - cy),
                                np.float32(centres[other, 2] - cz),
                            )
                            for j in range(lanes):
                                place = (w[_X + j], w[_Y + j], w[_Z + j])
                                across, down = _four(w, _ACROSS + j), _four(w, _DOWN + j)
                                step = (
                                    across[0] - across[2] * place[2],
                                    across[1] - across[3] * place[2],
                                    down[0] - down[2] * place[2],
                                    down[1] - down[3] * place[2],
                                )
                                w[_CLEAR + j] *= _ONE - _blocked(
                                    centre,
                                    blocking,
                                    place,
                                    (lx - place[0], ly - place[1], lz - place[2]),
                                    (w[_NX + j], w[_NY + j], w[_NZ + j]),
                                    (w[_DX + j], w[_DY + j]),
                                    step,
                                    k,
                                )
                        for c in range(channels):
                            tint = tints[c, led]
                            for j in range(lanes):
                                w[_BRIGHT + c * _BATCH + j] += tint * w[_CLEAR + j]
                    for c in range(channels):
                        around = np.float32(ambient * even[c])
                        for j in range(lanes):
                            direct = rest * w[_BRIGHT + c * _BATCH + j]
                            w[_LIGHT + c * _BATCH + j] += (direct + around) * w[_COVERS + j]
                    for j in range(lanes):
                        covers = w[_COVERS + j]
                        w[_SUM + j] += covers
                        weight = np.floor(covers * _FULL_WEIGHT + _HALF)
                        w[_WHOLE + j] += weight
                        w[_ASIDE + j] += weight * column_in
                        w[_BELOW + j] += weight * row_in

                # 5. Tallies of edges, and light.
                if not full:
                    for j in range(n):
                        share = float(w[_WHOLE + j])
                        tallies[i, 0] += share
                        tallies[i, 1] += share
                        tallies[i, 2] += share * grid * w[_COLUMN + j] + w[_ASIDE + j]
                        tallies[i, 3] += share * grid * w[_ROW + j] + w[_BELOW + j]
                for j in range(n):
                    at = start + which[j]
                    for c in range(3):
                        lit = w[_LIGHT + min(c, channels - 1) * _BATCH + j] / (grid * grid)
                        light[at, c] = colour[i, c] * lit
                    free[at] = 1 - w[_SUM + j] / (grid * grid)


@njit(cache=True, fastmath=_REORDER)
def _relative(
    ray: Floats, across: Floats, down: Floats, base: float, place: Floats
) -> tuple[Four, Four]:
    """Return a ray (4,) from the base relative to a place (3,), and how far aside the rays one
    column and one row on go there."""
    drop = base - place[2]
    there = (
        ray[0] + ray[2] * drop - place[0],
        ray[1] + ray[3] * drop - place[1],
        ray[2],
        ray[3],
    )
    step = (
        across[0] + across[2] * drop,
        across[1] + across[3] * drop,
        down[0] + down[2] * drop,
        down[1] + down[3] * drop,
    )
    return there, step


@njit(cache=True, fastmath=_REORDER)
def _shade_overlapping(
    begin: int,
    end: int,
    lists: tuple[Ints, Indices, Indices],
    placed: tuple[Floats, float, Floats],
    metric: Floats,
    lit_by: Any,
    work: tuple[Ints, Floats],
    out: tuple[Singles, Singles, Floats],
) -> None:
    """Write ``out`` as `_shade_isolated` does, of pixels ``begin`` to ``end``.

    ``lists`` are pixels, where each one's markers begin, and these.
    """
    pixels, first, members = lists
    corners, base, centres = placed
    colour, lamps, tints, even, dark_first, dark_members, nearest, grids, ambient, bright = lit_by
    edge_grid, inner_grid = grids
    near, order = work[0][0], work[0][1]
    hit = work[1]
    light, free, tallies = out
    width = corners.shape[2] - 1
    leds = lamps.shape[1]
    channels = len(even)
    total = np.zeros(channels)
    ray = np.empty(4)
    middle, across, down = np.empty(4), np.empty(4), np.empty(4)
    for j in range(begin, end):
        light[j, 0], light[j, 1], light[j, 2], free[j] = 0, 0, 0, 1
        row = pixels[j] // width
        column = pixels[j] % width
        for c in range(4):
            p = corners[c, row, column]
            q = corners[c, row, column + 1]
            r = corners[c, row + 1, column]
            s = corners[c, row + 1, column + 1]
            middle[c] = (p + q + r + s) / 4
            across[c] = (q - p + s - r) / 2
            down[c] = (r - p + s - q) / 2

        # 1. Which markers the pixel may show, and whether just one does and fills the pixel.
        found, simple = 0, False
        for at in range(first[j], first[j + 1]):
            marker = members[at]
            m = _six(metric[marker])
            there, step = _relative(middle, across, down, base, centres[marker])
            may, fills = _candidate(_approach(there, m, step), m, step, edge_grid)
            if may > 0:
                simple = fills > 0
                near[found] = marker
                found += 1
        if found == 0:
            continue
        simple = simple and found == 1
        k = edge_grid
        if simple:
            marker = near[0]
            half = k * k * (k - 1) / 2
            tallies[marker, 0] += WEIGHT * k * k
            tallies[marker, 1] += WEIGHT * k * k
            tallies[marker, 2] += WEIGHT * (k * k * k * (column - nearest[marker, 0]) + half)
            tallies[marker, 3] += WEIGHT * (k * k * k * (row - nearest[marker, 1]) + half)
            k = inner_grid

        red = 0.0
        green = 0.0
        blue = 0.0
        clear_sum = 0.0
        for sample in range(k * k):
            # 2. The markers that a sub-pixel's ray meets, front to back: rays go down, so the
            # higher place is the nearer one.
            right = (sample % k + 0.5) / k - 0.5
            low = (sample // k + 0.5) / k - 0.5
            for c in range(4):
                ray[c] = middle[c] + across[c] * right + down[c] * low
            hits = 0
            for i in range(found):
                marker = near[i]
                m = _six(metric[marker])
                there, step = _relative(ray, across, down, base, centres[marker])
                met = _approach(there, m, step)
                covers = _coverage(met, k)
                if covers > 0:
                    x, y, z, nx, ny, nz = _lit_place(met, there, m, covers, k)
                    hit[i, 0] = covers
                    hit[i, 1] = centres[marker, 0] + x
                    hit[i, 2] = centres[marker, 1] + y
                    hit[i, 3] = centres[marker, 2] + z
                    hit[i, 4], hit[i, 5], hit[i, 6] = nx, ny, nz
                    at = hits
                    while at > 0 and hit[order[at - 1], 3] < hit[i, 3]:
                        order[at] = order[at - 1]
                        at -= 1
                    order[at] = i
                    hits += 1

            clear = 1.0
            for number in range(hits):
                at = order[number]
                marker = near[at]
                covers = 1.0 if simple else hit[at, 0]
                # 3. Tallies.
                if not simple:
                    seen = np.rint(covers * clear * WEIGHT)
                    whole = np.rint(covers * WEIGHT)
                    tallies[marker, 0] += whole
                    tallies[marker, 1] += seen
                    tallies[marker, 2] += seen * ((column - nearest[marker, 0]) * k + sample % k)
                    tallies[marker, 3] += seen * ((row - nearest[marker, 1]) * k + sample // k)
                # 4. Light of all LEDs, shadows included.
                if bright and clear >= OPAQUE:
                    x, y, z = hit[at, 1], hit[at, 2], hit[at, 3]
                    nx, ny, nz = hit[at, 4], hit[at, 5], hit[at, 6]
                    _, step = _relative(ray, across, down, base, hit[at, 1:4])
                    for c in range(channels):
                        total[c] = 0.0
                    for led in range(leds):
                        power = lamps[marker, led, 3]
                        tx = lamps[marker, led, 0] - x
                        ty = lamps[marker, led, 1] - y
                        tz = lamps[marker, led, 2] - z
                        square = tx * tx + ty * ty + tz * tz
                        cosine = nx * tx + ny * ty + nz * tz
                        if cosine <= 0 or power <= 0:
                            continue
                        open_share = 1.0
                        pair = marker * leds + led
                        for dark in range(dark_first[pair], dark_first[pair + 1]):
                            other = dark_members[dark]
                            open_share *= 1 - _blocked(
                                (centres[other, 0], centres[other, 1], centres[other, 2]),
                                _six(metric[other]),
                                (x, y, z),
                                (tx, ty, tz),
                                (nx, ny, nz),
                                (ray[2], ray[3]),
                                step,
                                k,
                            )
                        for axis in range(3):
                            away = hit[at, 1 + axis] - centres[marker, axis]
                            power += lamps[marker, led, 4 + axis] * away
                        lit = max(power, 0.0) * cosine * open_share / (square * np.sqrt(square))
                        for c in range(channels):
                            total[c] += tints[c, led] * lit
                    for c in range(channels):
                        total[c] = ((1 - ambient) * total[c] + ambient * even[c]) * covers * clear
                    red += colour[marker, 0] * total[0]
                    green += colour[marker, 1] * total[(channels - 1) // 2]
                    blue += colour[marker, 2] * total[channels - 1]
                clear *= 1 - covers
            clear_sum += clear
        light[j, 0], light[j, 1], light[j, 2] = red / (k * k), green / (k * k), blue / (k * k)
        free[j] = clear_sum / (k * k)
