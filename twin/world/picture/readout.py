"""From light to electrons to counts, row by row, in numba: the loops of the CCD.

Each function works on rows ``begin`` to ``end`` of the picture and writes nothing else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Ints, Picture, Singles
from twin.compiled import njit
from twin.world.picture.noise import normal_numbers
from twin.world.picture.segments import Segments, at_segments

_QUICK = {"contract", "arcp", "reassoc", "nsz"}

Weights = NDArray[np.float32]


@njit(cache=True, nogil=True, fastmath=_QUICK)
def shares_rows(
    begin: int, end: int, light: Singles, before: Singles, weights: Weights, response: Weights, interlaced: bool,
    colours: Ints, gain: Singles, dark: Singles, key: NDArray[np.uint64], deviates: Segments, read_e: float,
    well_e: float, out: Singles,
) -> None:  # fmt: skip
    """Write what is read out of the wells, in shares of a full one: (height, width, 3), or (height, width, 1) mosaic.

    Parameters
    ----------
    light, before
        (height, width, 3) light now and a field earlier, of which an interlaced CCD sees even rows.
    weights, response
        (2 r + 1,) of the blur, and the (3, 3) mixing of colours.
    interlaced
        A row is the mean of two, its own and the next.
    colours
        (2, 2) of the mosaic, or nothing.
    gain, dark
        The pixels' own, shaped like ``out``, or nothing.
    key
        Two numbers of the noise, or nothing for no noise; ``deviates`` are the normal distribution's.

    Notes
    -----
    Electrons: gain light + dark, of variance their number, plus read noise; a well holds no more than ``well_e``. Shot
    and read noise are independent and normal, so that one number of the summed variance stands for both.
    """
    height, width, _ = light.shape
    reach = len(weights) // 2
    line = np.empty((width + 2 * reach) * 3, np.float32)
    sums = np.empty(width * 3, np.float32)
    mosaic = np.empty(width if len(colours) else 0, np.float32)
    noise = np.empty(out.shape[1] * out.shape[2], np.float32)
    inverse, floor = np.float32(1 / well_e), np.float32((read_e / well_e) ** 2)
    one, nothing = np.float32(1), np.float32(0)
    for row in range(begin, end):
        source = before if interlaced and row % 2 == 0 else light
        halves = 2 if interlaced and row + 1 < height else 1
        sums[:] = 0
        for half in range(halves):
            for step in range(-reach, reach + 1):
                _add(source[min(max(row + half + step, 0), height - 1)], weights[step + reach] / halves, sums)
        _mix(sums, response, line[3 * reach : 3 * (reach + width)])
        for i in range(reach):
            for c in range(3):
                line[3 * i + c] = line[3 * reach + c]
                line[3 * (reach + width + i) + c] = line[3 * (reach + width - 1) + c]
        share = sums
        share[:] = 0
        for step in range(2 * reach + 1):
            weight = weights[step]
            for i in range(width * 3):
                share[i] += weight * line[i + 3 * step]
        if len(colours):
            for i in range(width):
                mosaic[i] = share[3 * i + colours[row % 2, i % 2]]
            share = mosaic
        target = out[row].reshape(-1)
        if len(gain):
            own, floor_of = gain[row].reshape(-1), dark[row].reshape(-1)
            for i in range(len(target)):
                share[i] = share[i] * own[i] + floor_of[i]
        if len(key):
            normal_numbers(key, np.uint64(row * len(target)), deviates, noise)
            for i in range(len(target)):
                share[i] += noise[i] * np.sqrt(max(share[i], nothing) * inverse + floor)
        for i in range(len(target)):
            target[i] = min(share[i], one)


@njit(cache=True, nogil=True, fastmath=_QUICK)
def _add(line: Singles, weight: float, sums: Singles) -> None:
    flat, share = line.reshape(-1), np.float32(weight)
    for i in range(len(sums)):
        sums[i] += share * flat[i]


@njit(cache=True, nogil=True, fastmath=_QUICK)
def _mix(line: Singles, matrix: Weights, out: Singles) -> None:
    """Write (3 n,) colours times a (3, 3) matrix."""
    m00, m01, m02 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    m10, m11, m12 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    m20, m21, m22 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    for i in range(len(line) // 3):
        red, green, blue = line[3 * i], line[3 * i + 1], line[3 * i + 2]
        out[3 * i] = m00 * red + m01 * green + m02 * blue
        out[3 * i + 1] = m10 * red + m11 * green + m12 * blue
        out[3 * i + 2] = m20 * red + m21 * green + m22 * blue


@njit(cache=True, nogil=True, fastmath=_QUICK)
def demosaic_rows(begin: int, end: int, raw: Singles, colours: Ints, out: Singles) -> None:
    """Give each pixel its missing colours: the mean of the nearest that have them, edges reflected.

    Notes
    -----
    A green pixel has one colour beside it and the other above and below; the others have four greens beside them, and
    the fourth colour at their corners.
    """
    height, width = raw.shape[0], raw.shape[1]
    lines = np.empty((3, width + 2), np.float32)
    half, quarter = np.float32(0.5), np.float32(0.25)
    for row in range(begin, end):
        for step in range(3):
            there = min(abs(row + step - 1), 2 * height - 2 - (row + step - 1))
            there = min(max(there, 0), height - 1)
            for column in range(width):
                lines[step, column + 1] = raw[there, column, 0]
            lines[step, 0] = lines[step, min(2, width)]
            lines[step, width + 1] = lines[step, max(width - 1, 1)]
        for first in range(2):
            own, beside, below = colours[row % 2, first], colours[row % 2, 1 - first], colours[1 - row % 2, first]
            for i in range(first, width, 2):
                sides = lines[1, i] + lines[1, i + 2]
                over = lines[0, i + 1] + lines[2, i + 1]
                out[row, i, own] = lines[1, i + 1]
                if own == 1:
                    out[row, i, beside] = half * sides
                    out[row, i, below] = half * over
                else:
                    corners = lines[0, i] + lines[0, i + 2] + lines[2, i] + lines[2, i + 2]
                    out[row, i, 1] = quarter * (sides + over)
                    out[row, i, 2 - own] = quarter * corners


@njit(cache=True, nogil=True, fastmath=_QUICK)
def composite_rows(
    begin: int, end: int, shares: Singles, curve: Segments, into: Weights, out_of: Weights,
    filters: tuple[Weights, Weights, Weights],
) -> None:  # fmt: skip
    """Send red, green and blue through a composite line, in place.

    They are corrected by a ``curve`` (or none, if it is empty) and mixed ``into`` three signals, which are blurred
    along rows each by its own (2 r + 1,) weights, edges repeated, and mixed ``out_of`` them.
    """
    width, nothing = shares.shape[1], np.float32(0)
    reach = 0
    for weights in filters:
        reach = max(reach, len(weights) // 2)
    mixed, filtered = np.empty(width * 3, np.float32), np.empty((3, width), np.float32)
    signal = np.empty(width + 2 * reach, np.float32)
    for row in range(begin, end):
        line = shares[row].reshape(-1)
        for i in range(len(line)):
            line[i] = max(line[i], nothing)
        if len(curve):
            at_segments(curve, line)
        _mix(line, into, mixed)
        for c in range(3):
            weights = filters[c]
            r = len(weights) // 2
            for i in range(width):
                signal[r + i] = mixed[3 * i + c]
            signal[:r] = mixed[c]
            signal[r + width : width + 2 * r] = mixed[3 * (width - 1) + c]
            target = filtered[c]
            target[:] = 0
            for step in range(2 * r + 1):
                weight = weights[step]
                for i in range(width):
                    target[i] += weight * signal[i + step]
        for i in range(width):
            for c in range(3):
                mixed[3 * i + c] = filtered[c, i]
        _mix(mixed, out_of, line)


@njit(cache=True, nogil=True)
def counts_rows(begin: int, end: int, shares: Singles, curve: Segments, black_dn: float, out: Picture) -> None:
    """Round shares, corrected by a curve (or none, if it is empty), to 8 bits above ``black_dn``."""
    scale, offset = np.float32(255 - black_dn), np.float32(black_dn + 0.5)
    least, most = np.float32(0), np.float32(255)
    for row in range(begin, end):
        line, target = shares[row].reshape(-1), out[row].reshape(-1)
        if len(curve):
            at_segments(curve, line)
        for i in range(len(line)):
            target[i] = np.uint8(np.int32(min(max(line[i] * scale + offset, least), most)))
