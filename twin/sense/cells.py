"""The flat paper's own measurement of marker centres: the centroid of a mesh cell, taken twice.

Kamiyama et al., sections 2.1 and 2.2: the picture is cut into cells around the nominal (then the rest) positions, the
centroid of the signal in each cell is taken, the cell is centred on it (in whole pixels) and the centroid taken again.

Validity: a marker must stay in its cell and the cell must be free of others; ground and shading pull the centroid.
It is here as the baseline that the soft window is compared with.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Pixels
from twin.compiled import njit
from twin.sense.split import Signal


@njit(cache=True)
def _cell_centroids(signal, start, half, passes, least, out):  # type: ignore[no-untyped-def]
    height, width = signal.shape
    for k in range(len(start)):
        x, y = start[k, 0], start[k, 1]
        for _ in range(passes):
            mass, sx, sy, top = 0.0, 0.0, 0.0, 0.0
            if np.isfinite(x) and np.isfinite(y):
                column, row = int(np.rint(x)), int(np.rint(y))
                for j in range(max(row - half, 0), min(row + half, height - 1) + 1):
                    for i in range(max(column - half, 0), min(column + half, width - 1) + 1):
                        value = max(np.float64(signal[j, i]), 0.0)
                        top = max(top, value)
                        mass += value
                        sx += value * i
                        sy += value * j
            x, y = (sx / mass, sy / mass) if mass > 0 and top >= least else (np.nan, np.nan)
        out[k, 0], out[k, 1] = x, y


def cell_centroids(signal: Signal, start_px: Pixels, cell_px: float, least_dn: float, passes: int = 2) -> Pixels:
    """Return the (n, 2) centroids of square cells of side ``cell_px``, px; NaN where a cell shows no marker.

    Parameters
    ----------
    signal
        (h, w) counts; its positive part counts.
    start_px
        (n, 2) where the first cells are centred.
    least_dn
        A cell whose brightest pixel stays below this count shows no marker. (The paper has no such test, and takes the
        centroid of the noise.)
    """
    out = np.empty((len(start_px), 2))
    _cell_centroids(signal, np.asarray(start_px, float), max(1, round(cell_px / 2)), passes, least_dn, out)
    return out
