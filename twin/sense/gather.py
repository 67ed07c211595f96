"""The pixels of one marker, projected onto its own colour. Compiled kernels only.

Why two ways: taking pixels row by row is work for the vector unit and several times as fast as one by one, but needs
all of them in the picture; near its border they are taken one by one.
"""

from __future__ import annotations

import numpy as np

from twin.compiled import njit

LANES = 16
"""So many pixels of a row are worked on at once."""

FILLING = 1 << 20
"""Offsets beyond are no pixels."""


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


@njit(cache=True, fastmath=True)
def gather(image, own, others, column, row, offset, signal, use):  # type: ignore[no-untyped-def]
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


@njit(cache=True)
def runs_of(offset):  # type: ignore[no-untyped-def]
    """Return (rows, 3) row, first column and number of the pixels of `disc`, row by row."""
    reach = 0
    for p in range(offset.shape[1]):
        if offset[1, p] < FILLING:
            reach = max(reach, offset[1, p])
    runs = np.zeros((2 * reach + 1, 3), np.int64)
    for p in range(offset.shape[1]):
        if offset[1, p] < FILLING:
            run = runs[offset[1, p] + reach]
            run[0], run[1] = offset[1, p], offset[0, p] if run[2] == 0 else run[1]
            run[2] += 1
    return runs


@njit(cache=True, fastmath=True)
def gather_inside(image, own, others, column, row, offset, runs, signal, use):  # type: ignore[no-untyped-def]
    """Do what `gather` does where all of a marker's pixels are in the picture; whether they are.

    Every row of pixels is worked on in whole `LANES`; what is too much is written over by the next row. ``signal`` and
    ``use`` have room for `LANES` more.
    """
    height, width = image.shape[0], image.shape[1]
    reach = len(runs) // 2
    longest = (runs[reach, 2] + LANES - 1) // LANES * LANES
    inside = row >= reach and column >= reach and row + reach < height and column + reach < width
    if not inside or (row + reach) * width + column + longest > height * width:
        return False
    flat = image.reshape(-1)
    red, green, blue, ground = own
    other_red, other_green, other_blue, limit = np.float32(0), np.float32(0), np.float32(0), np.float32(1)
    if len(others):
        other_red, other_green, other_blue, limit = others[0]
    done = 0
    for y, first, count in runs:
        for block in range(0, count, LANES):
            start = 3 * ((row + y) * width + column + first + block)
            pixels = flat[start : start + 3 * LANES]
            value, seen = signal[done + block : done + block + LANES], use[done + block : done + block + LANES]
            for x in range(LANES):
                r, g, b = np.float32(pixels[3 * x]), np.float32(pixels[3 * x + 1]), np.float32(pixels[3 * x + 2])
                value[x] = red * r + green * g + blue * b - ground
                hidden = other_red * r + other_green * g + other_blue * b > limit
                seen[x] = np.float32(0.0) if hidden else np.float32(1.0)
        done += count
    for p in range(done, offset.shape[1]):
        signal[p], use[p] = np.float32(0.0), np.float32(0.0)
    for k in range(1, len(others)):
        for p in range(done):
            x, y = column + offset[0, p], row + offset[1, p]
            r, g, b = np.float32(image[y, x, 0]), np.float32(image[y, x, 1]), np.float32(image[y, x, 2])
            if others[k, 0] * r + others[k, 1] * g + others[k, 2] * b > others[k, 3]:
                use[p] = np.float32(0.0)
    return True


LINE = 64
"""Bytes that memory hands over at once."""


@njit(cache=True)
def stream(flat):  # type: ignore[no-untyped-def]
    """Read a picture (bytes,) once in order, so that it is near when markers are fitted here and there; a checksum.

    Memory foresees a straight read, not the rows of scattered markers: it saves three times what it costs.
    """
    total = 0
    for i in range(0, len(flat), LINE):
        total += flat[i]
    return total
