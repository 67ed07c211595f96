"""The flat paper's own measurement of marker centres: the centroid of a mesh cell, taken twice.

Kamiyama et al., sections 2.1 and 2.2: the picture is cut into cells around the nominal (then the rest) positions, the
centroid of the signal in each cell is taken, the cell is centred on it (in whole pixels) and the centroid taken again.

Why it projects the colours itself: cells are read twice and what lies between them never, so that projecting the whole
picture first took as long again as all the rest.

Validity: a marker must stay in its cell and the cell must be free of others; ground and shading pull the centroid.
It is here as the baseline that the soft window is compared with.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Picture, Pixels
from twin.compiled import njit
from twin.sense.gather import LANES
from twin.sense.split import Weights


@njit(cache=True, fastmath=True)
def _add_rows(flat, start, stride, rows, columns, colour, mass, moment, top):  # type: ignore[no-untyped-def]
    """Sum up ``rows`` of pixels from byte ``start`` on by column: signal, signal times row, and its largest.

    Whole `LANES` at a time while there are pixels: what is too much belongs to columns that nobody reads.
    """
    red, green, blue, ground = colour
    mass[:], moment[:], top[:] = np.float32(0), np.float32(0), np.float32(0)
    whole = (columns + LANES - 1) // LANES * LANES
    for row in range(rows):
        down, at = np.float32(row), start + row * stride
        if at + 3 * whole > len(flat):
            whole = columns // LANES * LANES
        for first in range(0, whole, LANES):
            part = flat[at + 3 * first : at + 3 * (first + LANES)]
            m, d, t = mass[first : first + LANES], moment[first : first + LANES], top[first : first + LANES]
            for i in range(LANES):
                r, g, b = np.float32(part[3 * i]), np.float32(part[3 * i + 1]), np.float32(part[3 * i + 2])
                value = max(red * r + green * g + blue * b - ground, np.float32(0))
                m[i] += value
                d[i] += down * value
                t[i] = max(value, t[i])
        for i in range(whole, columns):
            p = at + 3 * i
            r, g, b = np.float32(flat[p]), np.float32(flat[p + 1]), np.float32(flat[p + 2])
            value = max(red * r + green * g + blue * b - ground, np.float32(0))
            mass[i] += value
            moment[i] += down * value
            top[i] = max(value, top[i])


@njit(cache=True)
def _cell_centroids(image, colour, start, half, passes, least, out):  # type: ignore[no-untyped-def]
    height, width = image.shape[0], image.shape[1]
    flat = image.reshape(-1)
    sums = np.empty((3, (2 * half + LANES) // LANES * LANES), np.float32)
    for k in range(len(start)):
        x, y = start[k, 0], start[k, 1]
        for _ in range(passes):
            mass, sx, sy, highest = 0.0, 0.0, 0.0, 0.0
            if np.isfinite(x) and np.isfinite(y):
                column, row = int(np.rint(x)), int(np.rint(y))
                left, right = max(column - half, 0), min(column + half, width - 1)
                above, below = max(row - half, 0), min(row + half, height - 1)
                rows, columns, stride = below + 1 - above, right + 1 - left, 3 * width
                _add_rows(flat, above * stride + 3 * left, stride, rows, columns, colour, sums[0], sums[1], sums[2])
                for i in range(columns):
                    mass += sums[0, i]
                    sx += np.float64(sums[0, i]) * (left + i)
                    sy += sums[1, i]
                    highest = max(highest, sums[2, i])
                sy += mass * above
            x, y = (sx / mass, sy / mass) if mass > 0 and highest >= least else (np.nan, np.nan)
        out[k, 0], out[k, 1] = x, y


def cell_centroids(
    picture: Picture,
    weights: Weights,
    ground_dn: float,
    start_px: Pixels,
    cell_px: float,
    least_dn: float,
    passes: int = 2,
) -> Pixels:
    """Return the (n, 2) centroids of square cells of side ``cell_px``, px; NaN where a cell shows no marker.

    Parameters
    ----------
    picture
        (h, w, 3) counts.
    weights, ground_dn
        The layer's projection (r, g, b), and what of it is the ground's: the positive part of the rest counts.
    start_px
        (n, 2) where the first cells are centred.
    least_dn
        A cell whose brightest pixel stays below this count shows no marker. (The paper has no such test, and takes the
        centroid of the noise.)
    """
    out = np.empty((len(start_px), 2))
    colour = (np.float32(weights[0]), np.float32(weights[1]), np.float32(weights[2]), np.float32(ground_dn))
    half = max(1, round(cell_px / 2))
    _cell_centroids(picture, colour, np.asarray(start_px, float), half, passes, least_dn, out)
    return out
