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
        shift = self._centroids(picture, self.look, known, self.around.spacing_px)
        shift -= known
        state = np.full(len(known), MISSING, np.uint8)
        scatter = self.around.scatter(shift, np.ones(len(known)))
        sd_px = _SD_PX if scatter is None else max(scatter, SD_FLOOR_PX)
        return Seen(shift_px=shift, sd_px=np.full(len(known), sd_px), state=state)

    @staticmethod
    def _centroids(
        picture: Picture, look: Look, start_px: Pixels, cell_px: float, passes: int = PASSES
    ) -> Pixels:
        """Return the (n, 2) centroids of square cells of side ``cell_px`` around ``start_px``, px;
        NaN where a cell's brightest pixel stays below the contrast, a test that the paper lacks."""
        colour = np.array((*look.weights, look.ground_dn), np.float32)
        half = max(1, round(cell_px / 2))
        places = start_px.copy()
        known = np.isfinite(start_px[:, 0])
        found = _cell_centroids(picture, colour, half, look.contrast_dn, passes, known, places)
        if not found.all():
            places[~found] = np.nan
        return places


SPARE_PX = 3
"""Columns beside a cell that are added up with it: so far its columns move without new sums."""


@njit(cache=True, fastmath=True)
def _cell_centroids(image, colour, half, least, passes, known, place):
    """Move each ``place`` (n, 2) that is ``known`` to the centroid of the positive signal in the
    cell around it; return (n,) where there is one. What is not known is no number of fast
    arithmetic, and left alone.

    The signal is added up column by column, which are worked on side by side; a cell that has moved
    gains rows and loses others. In singles, for the vector unit: they hold sums of whole counts
    exactly; of others errors are about 1e-6 px.
    """
    height, width = image.shape[0], image.shape[1]
    red, green, blue, ground = colour[0], colour[1], colour[2], colour[3]
    flat, found = image.reshape(-1), known.copy()
    zero, one, least = np.float32(0.0), np.float32(1.0), np.float32(least)
    sums = np.empty((3, min(2 * (half + SPARE_PX) + 1, width)), np.float32)
    light, moment, contrasting = sums[0], sums[1], sums[2]
    for k in range(len(place)):
        begin, left, right, top, bottom, middle = 0, -1, -1, -1, -1, 0
        for _ in range(passes if known[k] else 0):
            before, above, below = (left, right), top, bottom
            column, row = int(np.rint(place[k, 0])), int(np.rint(place[k, 1]))
            left, right = max(column - half, 0), max(min(column + half + 1, width), 0)
            top, bottom = min(max(row - half, 0), height), max(min(row + half + 1, height), 0)
            if (left, right) == before and top == above and bottom == below:
                break  # the same cell again
            apart = top >= below or bottom <= above
            if apart or left < begin or right > begin + len(light):  # also at first
                begin = min(max(column - half - SPARE_PX, 0), width - len(light))
                above, below, middle = top, top, row
                sums[:] = zero
            for first, last, sign in (
                (above, top, -one),
                (top, above, one),
                (bottom, below, -one),
                (below, bottom, one),
            ):
                for j in range(first, last):
                    start, down = 3 * (j * width + begin), np.float32(j - middle)
                    pixels = flat[start : start + 3 * len(light)]
                    for i in range(len(light)):
                        value = (
                            red * np.float32(pixels[3 * i])
                            + green * np.float32(pixels[3 * i + 1])
                            + blue * np.float32(pixels[3 * i + 2])
                        )
                        value = max(value - ground, zero)
                        contrasting[i] += sign if value >= least else zero
                        light[i] += sign * value
                        moment[i] += sign * down * value
            mass, sx, sy, highest = 0.0, 0.0, 0.0, zero
            for i in range(left - begin, right - begin):
                mass += light[i]
                sx += i * light[i]
                sy += moment[i]
                highest = max(highest, contrasting[i])
            if mass <= 0.0 or highest < one:
                found[k] = False
                break
            place[k, 0], place[k, 1] = begin + sx / mass, middle + sy / mass
    return found
