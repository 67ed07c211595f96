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
        out = np.full((len(start_px), 2), np.nan)
        known = np.isfinite(start_px).all(axis=1)
        colour = (*map(float, look.weights), float(look.ground_dn))
        half = max(1, round(cell_px / 2))
        places = start_px.copy()
        known &= _cell_centroids(picture, colour, half, look.contrast_dn, passes, known, places)
        out[known] = places[known]
        return out


@njit(cache=True, fastmath=True)
def _cell_centroids(image, colour, half, least, passes, known, place):
    """Move each ``place`` (n, 2) that is ``known`` to the centroid of the positive signal in the
    cell around it; return (n,) where there is one. What is not known is no number of fast
    arithmetic, and left alone."""
    height, width = image.shape[0], image.shape[1]
    red, green, blue, ground = colour
    flat, value, found = image.reshape(-1), np.empty(2 * half + 1), known.copy()
    for k in range(len(place)):
        column, row = 0, 0
        for turn in range(passes if known[k] else 0):
            before_column, before_row = column, row
            column, row = int(np.rint(place[k, 0])), int(np.rint(place[k, 1]))
            if turn > 0 and column == before_column and row == before_row:
                break  # the same cell again
            left, right = max(column - half, 0), min(column + half, width - 1)
            mass, sx, sy, highest = 0.0, 0.0, 0.0, 0.0
            for j in range(max(row - half, 0), min(row + half, height - 1) + 1):
                pixels = flat[3 * (j * width + left) : 3 * (j * width + right + 1)]
                for i in range(right - left + 1):
                    light = (
                        red * pixels[3 * i] + green * pixels[3 * i + 1] + blue * pixels[3 * i + 2]
                    )
                    value[i] = max(light - ground, 0.0)
                line = 0.0
                for i in range(right - left + 1):
                    line += value[i]
                    sx += i * value[i]
                    highest = max(highest, value[i])
                mass += line
                sy += j * line
            if mass <= 0.0 or highest < least:
                found[k] = False
                break
            place[k, 0], place[k, 1] = left + sx / mass, sy / mass
    return found
