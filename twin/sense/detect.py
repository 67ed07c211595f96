"""The marker-like spots of a layer's signal, and their centres by the soft-window centroid.

The soft window cuts each marker out by a threshold at its own level, levels its brightness by a
plane fitted to its inner pixels, takes its ground from a ring around it, and the centroid under a
window that follows the marker's ellipse and fades out a few pixels outside its edge. Why not the
plain centroid of a cell: LEDs near the lens light a marker from one side, which pulls an intensity
centroid up to a pixel away from the centre of the outline, and pixels far from the marker only add
noise. Measured (8 bit, 1.5 counts of read noise, 20 000 electron well), standard deviation of the
two-frame shift per axis: .027 / .014 / .010 px at 6 / 10 / 15 px diameter; the Cramer-Rao bound is
.010 / .0075 / .006. Valid for markers at least about 4 px wide, sharp to about 2 px, and 2 px or
more from others of their layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import grey_closing, uniform_filter

from twin.arrays import Bools, Floats, Ints, Pixels
from twin.compiled import njit
from twin.sense.colour import Signal

CROWD = 0.8
"""Share of the counts at which a signal is cut off, below which a pixel shows another colour."""

SD_FLOOR_PX = 0.002
"""No centre is taken to be better than this: what a lens and a finite pixel leave even without
noise."""

THRESHOLD = 0.4
"""Share of a marker's middle brightness above which a pixel belongs to it."""

CEILING = 0.8
"""Levelled brightness above which a pixel counts in full, so that shadows and sheen inside a marker
weigh little."""

CORE_PX = 0.35
"""The plane is fitted inside the edge by this much, px."""

EDGE_START, EDGE_END = 1.2, 3.0
"""Distances outside the edge between which the window fades out, px."""

CUT = 0.92
"""A spot at the picture's border is whole if its centroid is farther from it than this share of its
mean radius: of a disc with a twelfth of its width beyond the border that is .9."""

INNER, HOLLOW = 0.4, 0.6
"""Share of a spot's radius that is its middle, and of the brightness around below which it is a
ring's."""

TURNS = 5
"""Times the window is moved to the centroid at most; the plane is fitted again every second
time."""


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Marker-like spots of one signal.

    Attributes
    ----------
    centre_px
        (b, 2) centres, px.
    sd_px
        (b,) standard deviation of each centre, per axis, from the measured noise.
    level_dn
        (b,) brightness of the middle above the ground.
    area_px
        (b,) pixels above threshold.
    crowding
        (b,) share of the ring outside the edge that shows the other layer's colour, 0 to 1.
    whole, cut
        (b,) whether the spot lies fully inside the picture and its window; inside its window, but
        cut by the picture's frame.
    """

    centre_px: Pixels
    sd_px: Floats
    level_dn: Floats
    area_px: Floats
    crowding: Floats
    whole: Bools
    cut: Bools

    def __len__(self) -> int:
        return len(self.area_px)

    @property
    def diameter_px(self) -> Floats:
        """(b,) diameters of circles of the same area, px."""
        return np.asarray(2.0 * np.sqrt(self.area_px / np.pi))

    def hollow(self, signal: Signal, rows: Ints) -> bool:
        """Return whether the spots ``rows`` are rings: their middles are much darker than what is
        around these."""
        share = []
        for (x, y), radius in zip(self.centre_px[rows], 0.5 * self.diameter_px[rows], strict=True):
            low = np.fmax(np.rint([y - radius, x - radius]), 0).astype(int)
            part = signal[low[0] : int(y + radius) + 2, low[1] : int(x + radius) + 2]
            down, across = np.indices(part.shape) + low[:, None, None]
            away = np.hypot(across - x, down - y) / radius
            inner, rim = part[away < INNER], part[(away > INNER) & (away < 1.0)]
            if len(inner) and len(rim):
                share.append(np.median(inner) / max(float(np.quantile(rim, 0.75)), 1e-9))
        return len(share) > 0 and float(np.median(share)) < HOLLOW

    @staticmethod
    def found_in(
        signal: Signal,
        diameter_px: float,
        contrast_dn: float,
        floor_dn: float = -np.inf,
        hole_px: int = 0,
    ) -> Blobs:
        """Find and measure the marker-like spots of a signal.

        Parameters
        ----------
        signal
            (h, w) counts.
        diameter_px
            About how wide the markers are, px; a factor of two either way does no harm.
        contrast_dn
            Least contrast of a spot above its surroundings.
        floor_dn
            Where the signal is cut off: a pixel near it shows another layer's colour.
        hole_px
            How wide the holes are that are filled, px: then rings are spots.
        """
        if hole_px:
            signal = grey_closing(signal, hole_px)
        # windows are as large: none is larger than the picture
        diameter_px = min(diameter_px, float(max(signal.shape)))
        half = max(1, round(0.3 * diameter_px))
        wide = max(2 * half + 2, round(1.5 * diameter_px))
        smooth = uniform_filter(signal, 2 * half + 1, mode="nearest")
        broad = uniform_filter(signal, 2 * wide + 1, mode="nearest")
        peaks = np.empty((MOST_SPOTS, 2), np.int64)
        radius = max(2, round(0.5 * diameter_px))
        peaks = peaks[: _peaks(smooth, broad, radius, np.float32(contrast_dn), peaks)]
        out = np.zeros((len(peaks), 8))
        reach, rim = int(np.ceil(1.5 * diameter_px)) + 2, int(np.ceil(0.5 * diameter_px))
        mark = np.zeros(signal.shape, np.int32)
        work = (mark, np.empty(((2 * reach + 3) ** 2 * 4, 2), np.int64), np.empty(4, np.int64))
        sizes = (reach, rim + 3, rim + 7)
        _measure(signal, smooth, peaks, *sizes, CROWD * float(floor_dn), *work, out)
        out = out[(out[:, 5] >= 4) & (out[:, 4] >= contrast_dn)]
        # of peaks that flooded into one spot (equal centres) only the first
        _, first = np.unique(np.rint(out[:, :2] * 4).astype(np.int64), axis=0, return_index=True)
        out = out[np.sort(first)]
        return Blobs(
            centre_px=np.ascontiguousarray(out[:, :2]),
            sd_px=np.sqrt(np.mean(out[:, 2:4], axis=1) + SD_FLOOR_PX**2),
            level_dn=out[:, 4].copy(),
            area_px=out[:, 5].copy(),
            crowding=out[:, 6].copy(),
            whole=out[:, 7] == 1.0,
            cut=out[:, 7] == 0.5,
        )


@njit(cache=True)
def _ring(signal, column, row, inner, outer, top):
    """Mean and variance of the ground: of a ring, then its pixels nearer to that than to ``top``,
    then within 3 sd."""
    height, width = signal.shape
    low, high = -1e30, 1e30
    mean, variance = 0.0, 0.0
    for turn in range(3):
        count, total, squares = 0, 0.0, 0.0
        for y in range(max(row - outer, 0), min(row + outer, height - 1) + 1):
            for x in range(max(column - outer, 0), min(column + outer, width - 1) + 1):
                distance = (x - column) ** 2 + (y - row) ** 2
                if inner * inner <= distance <= outer * outer:
                    value = np.float64(signal[y, x])
                    if low <= value <= high:
                        count += 1
                        total += value
                        squares += value * value
        if count < 4:
            break
        mean = total / count
        variance = max(squares / count - mean * mean, 0.0)
        reach = 3.0 * math.sqrt(variance) + 1.0
        low, high = (-1e30, 0.5 * (mean + top)) if turn == 0 else (mean - reach, mean + reach)
    return mean, variance


@njit(cache=True)
def _cut_out(signal, column, row, level, reach, mark, stamp, stack):
    """Flood from a peak: area, centroid, second moments (xx, xy, yy) of the pixels above ``level``;
    1 if whole, .5 if cut by the picture's frame, else 0."""
    height, width = signal.shape
    top, area = 1, 0
    stack[0, 0], stack[0, 1] = column, row
    mark[row, column] = stamp
    sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0
    whole, at_border = True, False
    while top > 0:
        top -= 1
        x, y = stack[top, 0], stack[top, 1]
        dx, dy = np.float64(x - column), np.float64(y - row)
        area += 1
        sx += dx
        sy += dy
        sxx += dx * dx
        sxy += dx * dy
        syy += dy * dy
        if abs(dx) >= reach or abs(dy) >= reach:
            whole = False
            continue
        if x == 0 or y == 0 or x == width - 1 or y == height - 1:
            at_border = True
        for nx, ny in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            if nx < 0 or ny < 0 or nx >= width or ny >= height:
                continue
            if mark[ny, nx] != stamp and signal[ny, nx] > level and top < stack.shape[0]:
                mark[ny, nx] = stamp
                stack[top, 0], stack[top, 1] = nx, ny
                top += 1
    mx, my = sx / area, sy / area
    if at_border:
        gap = (
            min(min(column + mx, width - 1 - column - mx), min(row + my, height - 1 - row - my))
            + 0.5
        )
        at_border = gap <= CUT * math.sqrt(area / np.pi)
    return (
        area,
        column + mx,
        row + my,
        sxx / area - mx * mx,
        sxy / area - mx * my,
        syy / area - my * my,
        0.0 if not whole else 0.5 if at_border else 1.0,
    )


@njit(cache=True)
def _levelling(signal, cx, cy, ixx, ixy, iyy, core, box, ground, level):
    """Plane a + b x + c y about (cx, cy) through a marker's inner pixels, the noise's variance, and
    a slope's.

    The weights fall smoothly to zero at the share ``core`` of the semi-axes: a sharp limit would
    tilt the plane as single pixels of a bead's darker rim come and go. The noise is read off 2 x 2
    differences, which neither a slope nor a round marker's shading changes.
    """
    n, sx, sy, sxx, sxy, syy, nn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    t0, tx, ty, rough = 0.0, 0.0, 0.0, 0.0
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            dx, dy = x - cx, y - cy
            inside = core * core - (ixx * dx * dx + 2 * ixy * dx * dy + iyy * dy * dy)
            if inside > 0.0:
                w = (inside / (core * core)) ** 2
                value = w * (signal[y, x] - ground)
                n += w
                nn += w * w
                sx += w * dx
                sy += w * dy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
                t0 += value
                tx += value * dx
                ty += value * dy
                twist = signal[y, x] - signal[y + 1, x] - signal[y, x + 1] + signal[y + 1, x + 1]
                rough += w * w * twist * twist
    if n < 4.0:
        return level, 0.0, 0.0, 0.0, 0.0
    mx, my, mean = sx / n, sy / n, t0 / n
    vxx, vxy, vyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    wx, wy = tx / n - mean * mx, ty / n - mean * my
    determinant = vxx * vyy - vxy * vxy
    if determinant < 1e-6:
        return mean, 0.0, 0.0, 0.0, 0.0
    b = (vyy * wx - vxy * wy) / determinant
    c = (vxx * wy - vxy * wx) / determinant
    variance = 0.25 * rough / nn
    slope_variance = variance * max(vxx, vyy) / determinant * nn / (n * n)
    return mean - b * mx - c * my, b, c, variance, slope_variance


@njit(cache=True)
def _ellipse(xx, xy, yy):
    """Inverse form (xx, xy, yy), equal to 1 on the edge, and semi-axes of the ellipse with these
    second moments."""
    xx, yy = xx + 1 / 12, yy + 1 / 12
    determinant = max(xx * yy - xy * xy, 1e-6)
    middle, gap = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    major, minor = 2 * math.sqrt(middle + gap), 2 * math.sqrt(max(middle - gap, 0.01))
    return yy / determinant / 4, -xy / determinant / 4, xx / determinant / 4, major, minor


@njit(cache=True, fastmath=True)
def _window(form, inner, per_width):
    """Weight of a pixel: 1 up to a little outside the edge, then half a cosine down to 0.

    ``form`` is the squared radius, ``inner`` where the fall begins, ``per_width`` 1 over its width.
    The sine is its series up to the 15th power, 6e-12 off: the vector unit has none.
    """
    share = min(max((math.sqrt(form) - inner) * per_width, 0.0), 1.0)
    angle = np.pi * (0.5 - share)
    square = angle * angle
    series = 1.0 - square / 210.0
    series = 1.0 - square / 156.0 * series
    series = 1.0 - square / 110.0 * series
    series = 1.0 - square / 72.0 * series
    series = 1.0 - square / 42.0 * series
    series = 1.0 - square / 20.0 * series
    return 0.5 + 0.5 * angle * (1.0 - square / 6.0 * series)


@njit(cache=True, fastmath=True)
def _centroid(signal, cx, cy, ixx, ixy, iyy, limits, box, plane, ground):
    """One pass: mass, and mean offset from (cx, cy), of the levelled signal under the window."""
    a, b, c, px, py = plane
    mass, sx, sy = 0.0, 0.0, 0.0
    inner, per_width, least = limits[0], 1.0 / (limits[1] - limits[0]), 0.3 * a
    for y in range(box[2], box[3] + 1):
        dy, row = y - cy, signal[y]
        for x in range(box[0], box[1] + 1):
            dx = x - cx
            form = ixx * dx * dx + 2 * ixy * dx * dy + iyy * dy * dy
            full = CEILING * max(a + b * (x - px) + c * (y - py), least)
            value = _window(form, inner, per_width) * min((row[x] - ground) / full, 1.0)
            mass += value
            sx += value * dx
            sy += value * dy
    return mass, sx / max(mass, 1e-9), sy / max(mass, 1e-9)


@njit(cache=True)
def _spread(signal, ellipse, limits, box, plane, ground, noise, mass, crowd_level):
    """Variances (x, y) of a centre from ``noise`` (inside, outside, slope), and the crowding of the
    ring outside."""
    cx, cy, ixx, ixy, iyy = ellipse
    a, b, c, px, py = plane
    sxx, syy, vx, vy, ring, crowded = 0.0, 0.0, 0.0, 0.0, 0, 0
    last = limits[1] * limits[1]
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            dx, dy = x - cx, y - cy
            form = ixx * dx * dx + 2 * ixy * dx * dy + iyy * dy * dy
            if form >= last:
                continue
            full = CEILING * max(a + b * (x - px) + c * (y - py), 0.3 * a)
            weight = _window(form, limits[0], 1.0 / (limits[1] - limits[0]))
            value = (signal[y, x] - ground) / full
            if value < 1.0:
                sxx += weight * value * dx * dx
                syy += weight * value * dy * dy
                share = weight * weight * (noise[0] if form < 1.0 else noise[1]) / (full * full)
                vx += share * dx * dx
                vy += share * dy * dy
            if form > 1.0:
                ring += 1
                crowded += 1 if signal[y, x] <= crowd_level else 0
    tilt = noise[2] / (a * a) if a > 0 else 0.0
    vx = vx / (mass * mass) + tilt * (sxx / mass) ** 2
    vy = vy / (mass * mass) + tilt * (syy / mass) ** 2
    return vx, vy, crowded / max(ring, 1)


@njit(cache=True)
def _measure(signal, smooth, peaks, reach, inner, outer, crowd_level, mark, stack, box, out):
    """Fill ``out`` (n, 8): column, row, variance x, variance y, level, area, crowding, whole (see
    `_cut_out`); area 0 for no spot.

    ``reach`` is how far a spot may go, ``inner`` and ``outer`` are radii of the ground around it;
    ``mark`` (zeros), ``stack`` and ``box`` are work arrays.
    """
    height, width = signal.shape
    for k in range(len(peaks)):
        column, row = peaks[k, 0], peaks[k, 1]
        top = np.float64(smooth[row, column])
        ground, outside = _ring(signal, column, row, inner, outer, top)
        level = top - ground
        out[k, 4], out[k, 5] = level, 0.0
        if level <= 0:
            continue
        area, cx, cy, xx, xy, yy, whole = _cut_out(
            signal, column, row, ground + THRESHOLD * level, reach, mark, k + 1, stack
        )
        ixx, ixy, iyy, major, minor = _ellipse(xx, xy, yy)
        mean_radius = math.sqrt(major * minor)
        limits = (1.0 + EDGE_START / mean_radius, 1.0 + EDGE_END / mean_radius)
        span = math.ceil(min(major, 2.0 * reach) * limits[1]) + 1
        box[0], box[1] = max(int(cx) - span, 0), min(int(cx) + span, width - 1)
        box[2], box[3] = max(int(cy) - span, 0), min(int(cy) + span, height - 1)
        core = max(1.0 - CORE_PX / minor, 0.2)
        plane, inside, slope = (level, 0.0, 0.0, cx, cy), 0.0, 0.0
        mass = 0.0
        for turn in range(TURNS):
            if turn % 2 == 0:
                a, b, c, inside, slope = _levelling(
                    signal, cx, cy, ixx, ixy, iyy, core, box, ground, level
                )
                plane = (a, b, c, cx, cy)
            mass, step_x, step_y = _centroid(
                signal, cx, cy, ixx, ixy, iyy, limits, box, plane, ground
            )
            if mass <= 0.0:
                whole = 0.0
                break
            cx += min(max(step_x, -2.0), 2.0)
            cy += min(max(step_y, -2.0), 2.0)
            if turn >= 2 and step_x * step_x + step_y * step_y < 1e-6:
                break
        noise = (inside, outside, slope)
        ellipse, mass = (cx, cy, ixx, ixy, iyy), max(mass, 1e-9)
        out[k, 2], out[k, 3], out[k, 6] = _spread(
            signal, ellipse, limits, box, plane, ground, noise, mass, crowd_level
        )
        out[k, 0], out[k, 1], out[k, 5], out[k, 7] = cx, cy, area, whole


@njit(cache=True)
def _peaks(smooth, broad, radius, contrast, found):
    """Fill ``found`` (most, 2) with local maxima of smooth - broad within a square of ``radius``,
    above ``contrast``: (column, row) each; return their number."""
    height, width = smooth.shape
    count = 0
    for row in range(height):
        for column in range(width):
            here = smooth[row, column]
            if here - broad[row, column] < contrast:
                continue
            before = max(smooth[row, max(column - 1, 0)], smooth[max(row - 1, 0), column])
            if here < before:
                continue
            if column + 1 < width and smooth[row, column + 1] >= here:
                continue
            if row + 1 < height and smooth[row + 1, column] >= here:
                continue
            highest = True
            for other in range(max(row - radius, 0), min(row + radius, height - 1) + 1):
                for along in range(max(column - radius, 0), min(column + radius, width - 1) + 1):
                    value = smooth[other, along]
                    later = other > row or (other == row and along > column)
                    if value > here or (value == here and later):
                        highest = False
                        break
                if not highest:
                    break
            if highest and count < len(found):
                found[count, 0] = column
                found[count, 1] = row
                count += 1
    return count


MOST_SPOTS = 20_000
"""Spots of a picture that are looked at."""
