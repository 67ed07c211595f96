"""Fit a marker's whole picture at rest, and measure the noise there. Compiled kernels only.

The model is `twin.sense.fit`'s with all its parameters free; what comes out is the template of every other picture.
"""

from __future__ import annotations

import numpy as np

from twin.compiled import njit
from twin.sense.fit import MARGIN_PX, SHAPE, doubtful, inverse_form
from twin.sense.gather import disc, gather

PARAMETERS = 11
"""Centre x, y, ground, level, level's slope x, y, bulge, growth, stretch along the axes and the diagonals, blur."""

WEAK = 1e-4
"""Pull of every parameter towards its start, relative to its own information."""


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
        gather(image, own, others, column, row, offset, signal, use)
        p[:] = 0.0
        p[3], p[10] = signal[len(signal) // 2], blur
        fine, moved = True, 1.0
        for turn in range(turns):
            limit = doubtful(noise[1], p[3], moved)
            p[6] = p[6] if free else bulge * p[3]
            form = inverse_form(sxx, sxy, syy, 1.0)
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
        fxx, fxy, fyy = inverse_form(shape[k, 0], shape[k, 1], shape[k, 2], 1.0)
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
                    gather(image, own, others, x, y, square, signal, use)
                    twist = signal[0] - signal[1] - signal[2] + signal[3]
                    side = 1 if largest < inner else 0
                    counts[side] += 1
                    sums[side] += 0.25 * twist * twist
        for side in range(2):
            if counts[side] > 2:
                out[k, side] = sums[side] / counts[side]
