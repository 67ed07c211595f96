"""From light to electrons to shares of full scale, row by row, in numba: the loops of the CCD.

Each function works on rows ``begin`` to ``end`` of the picture and writes nothing else.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Picture, Singles

_QUICK = {"contract", "arcp", "reassoc", "nsz"}

Weights = NDArray[np.float32]


@njit(cache=True, nogil=True, fastmath=_QUICK)  # type: ignore[untyped-decorator]
def blur_columns(begin: int, end: int, light: Singles, weights: Weights, response: Weights, out: Singles) -> None:
    """Mix colours by the (3, 3) response and blur along columns by (2 r + 1,) weights; edges are repeated."""
    height, width, _ = light.shape
    reach = len(weights) // 2
    sums = np.empty(width * 3, np.float32)
    for row in range(begin, end):
        sums[:] = 0
        for step in range(-reach, reach + 1):
            line = light[min(max(row + step, 0), height - 1)].reshape(-1)
            weight = weights[step + reach]
            for i in range(width * 3):
                sums[i] += weight * line[i]
        for column in range(width):
            red, green, blue = sums[3 * column], sums[3 * column + 1], sums[3 * column + 2]
            for c in range(3):
                out[row, column, c] = response[c, 0] * red + response[c, 1] * green + response[c, 2] * blue


@njit(cache=True, nogil=True, fastmath=_QUICK)  # type: ignore[untyped-decorator]
def blur_rows(begin: int, end: int, light: Singles, weights: Weights, out: Singles) -> None:
    """Blur along rows by (2 r + 1,) weights; edges are repeated."""
    width = light.shape[1]
    reach = len(weights) // 2
    line = np.empty((width + 2 * reach) * 3, np.float32)
    for row in range(begin, end):
        for i in range(width + 2 * reach):
            for c in range(3):
                line[3 * i + c] = light[row, min(max(i - reach, 0), width - 1), c]
        target = out[row].reshape(-1)
        target[:] = 0
        for step in range(2 * reach + 1):
            weight = weights[step]
            for i in range(width * 3):
                target[i] += weight * line[i + 3 * step]


@njit(cache=True, nogil=True, fastmath=_QUICK)  # type: ignore[untyped-decorator]
def expose_rows(
    begin: int, end: int, electrons: Singles, gain: Singles, dark: Singles, noise: Singles, read_e: float, well_e: float
) -> None:
    """Turn light, in shares of a full well, into read out shares, in place; all arrays (height, width, channels).

    Notes
    -----
    Electrons: gain light + dark, of variance their number, plus read noise; a well holds no more than ``well_e``.
    ``noise`` holds standard normal numbers, or nothing for no noise.
    """
    _, width, channels = electrons.shape
    noisy = noise.shape[0] > 0
    patterned = gain.shape[0] > 0
    inverse, floor = np.float32(1 / well_e), np.float32((read_e / well_e) ** 2)
    one, nothing = np.float32(1), np.float32(0)
    for row in range(begin, end):
        for column in range(width):
            for c in range(channels):
                share = electrons[row, column, c]
                if patterned:
                    share = share * gain[row, column, c] + dark[row, column, c]
                if noisy:
                    share += noise[row, column, c] * np.sqrt(max(share, nothing) * inverse + floor)
                electrons[row, column, c] = min(share, one)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def mosaic_rows(begin: int, end: int, light: Singles, colours: Ints, out: Singles) -> None:
    """Keep of each pixel the one colour that its filter in the (2, 2) mosaic lets pass."""
    width = light.shape[1]
    for row in range(begin, end):
        for column in range(width):
            out[row, column, 0] = light[row, column, colours[row % 2, column % 2]]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def demosaic_rows(begin: int, end: int, raw: Singles, colours: Ints, out: Singles) -> None:
    """Give each pixel its missing colours: the mean of the nearest that have them, edges reflected."""
    height, width = raw.shape[0], raw.shape[1]
    sums, counts = np.zeros(3, np.float32), np.zeros(3, np.float32)
    for row in range(begin, end):
        for column in range(width):
            own = colours[row % 2, column % 2]
            for c in range(3):
                sums[c], counts[c] = 0, 0
            for down in range(-1, 2):
                for right in range(-1, 2):
                    there, across = abs(row + down), abs(column + right)
                    there = there if there < height else 2 * height - 2 - there
                    across = across if across < width else 2 * width - 2 - across
                    if there < 0 or across < 0:
                        continue
                    colour = colours[there % 2, across % 2]
                    # A green pixel's corners are green too; beside a red or blue one the four nearest greens count.
                    if colour != own and (colour != 1 or down == 0 or right == 0):
                        sums[colour] += raw[there, across, 0]
                        counts[colour] += 1
            for c in range(3):
                out[row, column, c] = sums[c] / counts[c] if counts[c] > 0 else raw[row, column, 0]
            out[row, column, own] = raw[row, column, 0]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def counts_rows(begin: int, end: int, shares: Singles, least: Floats, guess: NDArray[np.uint8], out: Picture) -> None:
    """Round shares to 8 bits: the count whose ``least`` is the largest below, from a table that nearly gives it."""
    _, width, channels = shares.shape
    top = len(guess) - 1
    for row in range(begin, end):
        for column in range(width):
            for c in range(channels):
                share = shares[row, column, c]
                count = int(guess[int(min(max(share, 0), 1) * top)])
                while count < 255 and share >= least[count + 1]:
                    count += 1
                while count > 0 and share < least[count]:
                    count -= 1
                out[row, column, c] = count
