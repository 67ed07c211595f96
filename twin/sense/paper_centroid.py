"""The flat paper's centroid (Kamiyama et al., sections 2.1 and 2.2): of the signal in a mesh cell
around the nominal, then the rest position, taken a second time with the cell centred on the first.

It is the baseline. A marker must stay in its cell; ground and shading pull the centroid. So motion
that is too small to move the cell by a pixel is measured too small. By how much is found by moving
the cells in the rest picture: centroids should not follow (`PaperCentroid.gain_error`). On the flat
sensor under an NTSC camera they follow by .11; shifts of .1 to .6 px are .045 too small, at the
border .2, and total forces 0.12. Where two passes from the nominal position have not arrived, the
rest picture moves against itself (`PaperCentroid.drift_px`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.arrays import Picture, Pixels
from twin.compiled import njit
from twin.sense.centre import MISSING, CentreEstimator, Look, Seen
from twin.sense.detect import SD_FLOOR_PX
from twin.sense.match import Neighbourhood

PASSES = 2

_SD_PX = 0.07
"""Stated where too few markers have neighbours. Measured: .02 to .6, by noise, cell and JPEG."""


class PaperCentroid(CentreEstimator):
    """Centroids of cells; no marker is searched."""

    @classmethod
    def at_rest(
        cls, picture: Picture, looks: list[Look], spacing_px: float, given: bool
    ) -> Sequence[PaperCentroid]:
        groups = []
        for look in looks:
            rest_px = cls._centroids(picture, look, look.nominal_px, spacing_px)
            nothing = np.full(len(rest_px), np.nan)
            around = Neighbourhood.of(rest_px, spacing_px)
            followed: list[float] = []
            for axis, step in enumerate(np.eye(2)):
                ahead, behind = (
                    cls._centroids(picture, look, rest_px + side, spacing_px, passes=1)[:, axis]
                    for side in (step, -step)
                )
                followed += list((ahead - behind)[np.isfinite(ahead - behind)] / 2)
            gain = float(abs(np.mean(followed))) if followed else 0.0
            group = cls(look=look, around=around, sd_px=nothing, usual_sd_px=nothing)
            drift_px = np.nan_to_num(group.measure(picture, None).shift_px)
            groups.append(replace(group, gain_error=gain, drift_px=drift_px))
        return groups

    def measure(self, picture: Picture, start_px: Pixels | None) -> Seen:
        known = self.around.rest_px
        cell_px = self.around.spacing_px
        shift = self._centroids(picture, self.look, known, cell_px) - known
        state = np.full(len(known), MISSING, np.uint8)
        scatter = self.around.scatter(shift)
        sd_px = _SD_PX if scatter is None else max(scatter, SD_FLOOR_PX)
        return Seen(shift_px=shift, sd_px=np.full(len(known), sd_px), state=state)

    @staticmethod
    def _centroids(
        picture: Picture, look: Look, start_px: Pixels, cell_px: float, passes: int = PASSES
    ) -> Pixels:
        """Return the (n, 2) centroids of square cells of side ``cell_px`` around ``start_px``, px;
        NaN where a cell's brightest pixel stays below the contrast, a test that the paper lacks."""
        out = np.empty((len(start_px), 2))
        colour = (*map(float, look.weights), float(look.ground_dn))
        half = max(1, round(cell_px / 2))
        _cell_centroids(picture, colour, start_px, half, look.contrast_dn, passes, out)
        return out


@njit(cache=True)  # not fastmath, which takes NaN for a number
def _cell_centroids(image, colour, start, half, least, passes, out):
    """Fill ``out`` (n, 2) with the centroids of the positive signal in the cells."""
    height, width = image.shape[0], image.shape[1]
    red, green, blue, ground = colour
    for k in range(len(start)):
        x, y = start[k, 0], start[k, 1]
        for _ in range(passes):
            mass, sx, sy, highest = 0.0, 0.0, 0.0, 0.0
            if math.isfinite(x) and math.isfinite(y):
                column, row = int(np.rint(x)), int(np.rint(y))
                for j in range(max(row - half, 0), min(row + half, height - 1) + 1):
                    for i in range(max(column - half, 0), min(column + half, width - 1) + 1):
                        r, g, b = image[j, i, 0], image[j, i, 1], image[j, i, 2]
                        value = max(red * r + green * g + blue * b - ground, 0.0)
                        mass += value
                        sx += i * value
                        sy += j * value
                        highest = max(highest, value)
            x, y = (sx / mass, sy / mass) if mass > 0 and highest >= least else (np.nan, np.nan)
        out[k, 0], out[k, 1] = x, y
