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
from numba import njit

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

IMPERFECT, SHARE = 0.02, 0.25
"""What the model is trusted to: as a share of the brightness, and of the mean squared residual that it has (a marker
that has changed its shape misses at its edge, where its place is to be read)."""

PARAMETERS = 11
"""Centre x, y, ground, level, level's slope x, y, bulge, growth, stretch along the axes and the diagonals, blur."""

WEAK = 1e-4
"""Pull of every parameter towards its start, relative to its own information."""


@njit(cache=True, fastmath=True)
def _gather(image, own, others, column, row, offset, signal, use):  # type: ignore[no-untyped-def]
    """Project the pixels at ``offset`` (2, m); those outside, or where one of ``others`` shows, don't count."""
    height, width = image.shape[0], image.shape[1]
    red, green, blue, ground = own
    for p in range(offset.shape[1]):
        x, y = column + offset[0, p], row + offset[1, p]
        if x < 0 or y < 0 or x >= width or y >= height:
            signal[p], use[p] = np.float32(0.0), np.float32(0.0)
            continue
        r, g, b = np.float32(image[y, x, 0]), np.float32(image[y, x, 1]), np.float32(image[y, x, 2])
        signal[p] = red * r + green * g + blue * b - ground
        seen = np.float32(1.0)
        for k in range(others.shape[0]):
            if others[k, 0] * r + others[k, 1] * g + others[k, 2] * b > others[k, 3]:
                seen = np.float32(0.0)
        use[p] = seen


@njit(cache=True, fastmath=True, error_model="numpy")
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
def _doubtful(noise, level, step):  # type: ignore[no-untyped-def]
    """Return the squared residual at which a pixel counts a quarter; wide while the centre still moves by ``step``."""
    return OUTLIER_SD**2 * (noise + (IMPERFECT * level) ** 2) + (0.5 * level * min(step, 2.0)) ** 2


@njit(cache=True)
def disc(radius):  # type: ignore[no-untyped-def]
    """Return (2, m) int64 offsets of the pixels within ``radius``, px, filled up to a multiple of 8 by far ones."""
    reach = int(np.ceil(radius))
    count = 0
    for fill in range(2):
        if fill:
            offset = np.full((2, (count + 7) // 8 * 8), 1 << 30)
            count = 0
        for y in range(-reach, reach + 1):
            for x in range(-reach, reach + 1):
                if x * x + y * y <= radius * radius:
                    if fill:
                        offset[0, count], offset[1, count] = x, y
                    count += 1
    return offset


@njit(cache=True)
def _inverse_form(xx, xy, yy, scale):  # type: ignore[no-untyped-def]
    """Return the inverse square of a symmetric matrix of semi-axes (times ``scale``): xx, xy, yy."""
    a, b, c = scale * scale * (xx * xx + xy * xy), scale * scale * xy * (xx + yy), scale * scale * (yy * yy + xy * xy)
    determinant = max(a * c - b * b, 1e-6)
    return c / determinant, -b / determinant, a / determinant


@njit(cache=True)
def fit_centres(image, own, others, start, shape, ground, noise, slopes, reach, turns, out):  # type: ignore[no-untyped-def]
    """Fit every marker's centre, level, ground and scale; rows of ``out`` are `COLUMNS` numbers, NaN where it failed.

    Parameters
    ----------
    image
        (h, w, 3) uint8.
    own, others
        (4,) projection and ground; (m, 4) projections and limits above which another layer shows; float32.
    start
        (n, 2) px; NaN rows are left out.
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
    signal, use = np.empty(offset.shape[1], np.float32), np.empty(offset.shape[1], np.float32)
    total = np.empty(16, np.float64)
    for k in range(len(start)):
        out[k, :] = np.nan
        cx, cy = start[k, 0], start[k, 1]
        if not (np.isfinite(cx) and np.isfinite(cy) and np.isfinite(shape[k, 0])):
            continue
        xx, xy, yy, blur, level, here = shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 6], shape[k, 7], ground[k]
        mean_radius = np.sqrt(max(xx * yy - xy * xy, 0.25))
        scale, step, column, row = 1.0, 1e9, 0, 0
        for turn in range(turns):
            middle_x, middle_y = int(np.rint(cx)), int(np.rint(cy))
            if middle_x < 0 or middle_y < 0 or middle_x >= columns or middle_y >= rows:
                step = 1e9
                break
            if turn == 0 or abs(cx - column) > 1.0 or abs(cy - row) > 1.0:
                column, row = middle_x, middle_y
                _gather(image, own, others, column, row, offset, signal, use)
            u, v = cx / columns - 0.5, cy / rows - 0.5
            slope_x = shape[k, 3] + slopes[0, 0] + slopes[0, 1] * u + slopes[0, 2] * v
            slope_x += slopes[0, 3] * u * u + slopes[0, 4] * u * v + slopes[0, 5] * v * v
            slope_y = shape[k, 4] + slopes[1, 0] + slopes[1, 1] * u + slopes[1, 2] * v
            slope_y += slopes[1, 3] * u * u + slopes[1, 4] * u * v + slopes[1, 5] * v * v
            fxx, fxy, fyy = _inverse_form(xx, xy, yy, scale)
            left = SHARE * total[14] / total[0] if turn > 0 else 0.0
            narrow = 1.0 / _doubtful(max(noise[1], left), level, np.sqrt(step) if turn > 0 else 1.0)
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
            limit = 0.5 * mean_radius
            step_x, step_y = min(max(step_x, -limit), limit), min(max(step_y, -limit), limit)
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


@njit(cache=True)
def _model(dx, dy, p, form, derivative):  # type: ignore[no-untyped-def]
    """Return the signal at an offset and its derivatives by the `PARAMETERS`."""
    xx, xy, yy = form
    ax, ay = xx * dx + xy * dy, xy * dx + yy * dy
    squared = ax * dx + ay * dy
    steep = np.sqrt(ax * ax + ay * ay) + 1e-9
    radius = np.sqrt(squared)
    inside = (1.0 - radius) * (radius + 1e-3) / (steep + 1e-3 * np.sqrt(xx))
    v = min(max(inside / p[10], -1.0), 1.0)
    v2 = v * v
    cover = 0.5 + v * (15 / 16 - v2 * (10 / 16 - v2 * 3 / 16))
    fall = 15 / 16 * (1.0 - v2) ** 2 / p[10]
    light = p[3] + p[4] * dx + p[5] * dy + p[6] * min(squared, 1.0)
    nx, ny = ax / steep, ay / steep
    tilt = light * fall
    derivative[0], derivative[1], derivative[2], derivative[3] = tilt * nx, tilt * ny, 1.0, cover
    derivative[4], derivative[5], derivative[6] = cover * dx, cover * dy, cover * min(squared, 1.0)
    derivative[7], derivative[8], derivative[9] = tilt, tilt * (nx * nx - ny * ny), tilt * 2.0 * nx * ny
    derivative[10] = -tilt * v
    return p[2] + light * cover


@njit(cache=True)
def _solve(matrix, right, count):  # type: ignore[no-untyped-def]
    """Solve a symmetric positive system in place (Cholesky); whether it is one."""
    for i in range(count):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if i == j:
                if s <= 0.0:
                    return False
                matrix[i, i] = np.sqrt(s)
            else:
                matrix[i, j] = s / matrix[j, j]
    for i in range(count):
        s = right[i]
        for k in range(i):
            s -= matrix[i, k] * right[k]
        right[i] = s / matrix[i, i]
    for i in range(count - 1, -1, -1):
        s = right[i]
        for k in range(i + 1, count):
            s -= matrix[k, i] * right[k]
        right[i] = s / matrix[i, i]
    return True


@njit(cache=True)
def fit_shapes(image, own, others, start, radius, blur, bulge, free, noise, turns, out):  # type: ignore[no-untyped-def]
    """Fit every marker's whole picture at rest; rows of ``out`` (n, 10): `SHAPE` numbers, centre x, y.

    ``free`` is how many of the `PARAMETERS` are fitted for each marker: all, or with bulge and blur as given (then the
    relative ``bulge`` and ``blur`` are used). Rows are NaN where the fit failed.
    """
    offset = disc(1.3 * np.nanmax(radius) + 2.0 * blur + MARGIN_PX)
    signal, use = np.empty(offset.shape[1], np.float32), np.empty(offset.shape[1], np.float32)
    matrix = np.empty((PARAMETERS, PARAMETERS))
    right, derivative, p = np.empty(PARAMETERS), np.empty(PARAMETERS), np.empty(PARAMETERS)
    pull = np.empty(PARAMETERS)
    for k in range(len(start)):
        out[k, :] = np.nan
        if not np.isfinite(start[k, 0] + start[k, 1] + radius[k]):
            continue
        cx, cy, r = start[k, 0], start[k, 1], radius[k]
        sxx, sxy, syy = r, 0.0, r
        column, row = int(np.rint(cx)), int(np.rint(cy))
        _gather(image, own, others, column, row, offset, signal, use)
        p[:] = 0.0
        p[3], p[10] = signal[len(signal) // 2], blur
        fine, moved = True, 1.0
        for turn in range(turns):
            limit = _doubtful(noise[1], p[3], moved)
            p[6] = p[6] if free else bulge * p[3]
            form = _inverse_form(sxx, sxy, syy, 1.0)
            matrix[:] = 0.0
            right[:] = 0.0
            for i in range(len(signal)):
                if use[i] == 0.0:
                    continue
                dx, dy = column + offset[0, i] - cx, row + offset[1, i] - cy
                residual = signal[i] - _model(dx, dy, p, form, derivative)
                w = 1.0 / (1.0 + residual * residual / limit) ** 2
                if derivative[3] == 0.0:  # ground alone
                    right[2] += w * residual
                    matrix[2, 2] += w
                    continue
                if not free:
                    derivative[3] += bulge * derivative[6]
                    derivative[6], derivative[10] = 0.0, 0.0
                for a in range(PARAMETERS):
                    right[a] += w * derivative[a] * residual
                    for b in range(a + 1):
                        matrix[a, b] += w * derivative[a] * derivative[b]
            if not free:
                matrix[6, 6], matrix[10, 10] = 1.0, 1.0
            # a weak pull towards no slope, no bulge, round and the usual blur: small markers leave these open
            size = max(p[3], 1.0)
            pull[:] = 0.0
            pull[4] = pull[5] = 4.0 * (r / size) ** 2
            pull[6] = 4.0 / size**2
            pull[8] = pull[9] = 4.0 / r**2
            pull[10] = 1.0
            for a in range(PARAMETERS):
                matrix[a, a] += pull[a] + WEAK * matrix[a, a] + 1e-9
            right[4] -= pull[4] * p[4]
            right[5] -= pull[5] * p[5]
            if free:
                right[6] -= pull[6] * p[6]
                right[10] -= pull[10] * (p[10] - blur)
            if not _solve(matrix, right, PARAMETERS):
                fine = False
                break
            most = 0.5 * r
            cx += min(max(right[0], -most), most)
            cy += min(max(right[1], -most), most)
            for a in range(2, 7):
                p[a] += right[a]
            grow = min(max(right[7], -0.2 * r), 0.2 * r)
            stretch, skew = min(max(right[8], -0.2 * r), 0.2 * r), min(max(right[9], -0.2 * r), 0.2 * r)
            sxx, sxy, syy = sxx + grow + stretch, sxy + skew, syy + grow - stretch
            p[10] = min(max(p[10] + min(max(right[10], -0.4), 0.4), 0.7), 1.2 * r)
            if not (p[3] > 0.0 and min(sxx, syy) > 0.4 * r and max(sxx, syy) < 1.6 * r and abs(sxy) < 0.5 * r):
                fine = False
                break
            moved = np.sqrt(right[0] ** 2 + right[1] ** 2 + grow * grow)
            if turn > 1 and moved < 3e-3:
                break
        if not fine or abs(cx - start[k, 0]) > r or abs(cy - start[k, 1]) > r:
            continue
        out[k, 0], out[k, 1], out[k, 2] = sxx, sxy, syy
        out[k, 3], out[k, 4], out[k, 5] = p[4] / p[3], p[5] / p[3], (p[6] / p[3] if free else bulge)
        out[k, 6], out[k, 7] = p[10], p[3]
        out[k, SHAPE], out[k, SHAPE + 1] = cx, cy


@njit(cache=True)
def noise_variances(image, own, centre, shape, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` (n, 2): variance of the noise around, and inside, every marker, from 2 x 2 differences; NaN if none.

    Neither a slope nor a marker's round shading changes a 2 x 2 difference.
    """
    rows, columns = image.shape[0], image.shape[1]
    signal, use = np.empty(4, np.float32), np.empty(4, np.float32)
    others, square = np.empty((0, 4), np.float32), np.array([[0, 1, 0, 1], [0, 0, 1, 1]])
    for k in range(len(centre)):
        out[k, :] = np.nan
        if not np.isfinite(centre[k, 0] + shape[k, 0]):
            continue
        fxx, fxy, fyy = _inverse_form(shape[k, 0], shape[k, 1], shape[k, 2], 1.0)
        r = np.sqrt(1.0 / np.sqrt(fxx * fyy - fxy * fxy))
        reach = int(np.ceil(1.3 * r + shape[k, 6] + 4.0))
        inner, outer = (1.0 - shape[k, 6] / r) ** 2 if r > shape[k, 6] else 0.0, (1.0 + (shape[k, 6] + 0.5) / r) ** 2
        counts, sums = np.zeros(2), np.zeros(2)
        middle_x, middle_y = int(np.rint(centre[k, 0])), int(np.rint(centre[k, 1]))
        for y in range(max(middle_y - reach, 0), min(middle_y + reach, rows - 2) + 1):
            for x in range(max(middle_x - reach, 0), min(middle_x + reach, columns - 2) + 1):
                least, largest = 1e9, 0.0
                for j in range(2):
                    for i in range(2):
                        dx, dy = x + i - centre[k, 0], y + j - centre[k, 1]
                        f = fxx * dx * dx + 2 * fxy * dx * dy + fyy * dy * dy
                        least, largest = min(least, f), max(largest, f)
                if least > outer or largest < inner:
                    _gather(image, own, others, x, y, square, signal, use)
                    twist = signal[0] - signal[1] - signal[2] + signal[3]
                    side = 1 if largest < inner else 0
                    counts[side] += 1
                    sums[side] += 0.25 * twist * twist
        for side in range(2):
            if counts[side] > 2:
                out[k, side] = sums[side] / counts[side]
