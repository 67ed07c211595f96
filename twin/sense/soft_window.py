"""The soft-window centroid of spots found in the whole picture (`twin.sense.detect`).

Spots are matched to markers (`twin.sense.match`); markers without one get a state that names the
reason.

Edges that are sharper than light leaves them on pixels are drawn, not filmed, or are no ellipses'
(squares, crosses): no soft edge shows a place between pixels. Such markers, and rings, are measured
by the plain centroid of all their light (`SoftWindow.sharp`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels
from twin.sense.centre import (
    AMBIGUOUS,
    AREA_RATIO,
    DIM,
    LEVEL_RATIO,
    MERGED,
    MISSING,
    OCCLUDED,
    CentreEstimator,
    Look,
    Seen,
)
from twin.sense.colour import LUMA, Signal, project
from twin.sense.detect import SD_FLOOR_PX, Blobs
from twin.sense.match import GATE, Neighbourhood, spacing

CROWDED = 0.08
"""From this share of foreign colour around its edge on, a marker's outline may be cut by
another."""

CROWDED_SD_PX = 0.1

FOUND = 0.15
"""At rest a spot is found whose middle is beyond the frame by less than this share of its width; of
those at .2, in half the light, every other one."""

HIDDEN_AREA = 0.92
"""A crowded marker below this share of its area at rest counts as hidden."""

FARTHEST = 1.65
"""Over the radius of the disc of its area, how far a triangle reaches at most."""

BETWEEN, CLEAR_SD, OF_LIGHT = (0.08, 0.4), 4.0, 4.8
"""A pixel is between a marker and its ground if it is farther from either than these shares of the
brightness at least and at most, by so many deviations of noise; and how many there are, over the
radius and what is left of the range, where pixels gather light over their area: a disc's edge
crosses eight times the radius, .6 of them evenly."""

GATHERED = 0.047
"""Standard deviation of a centroid, times the radius, where all of an edge lies alike on pixels
that gather light: a pixel's share f of it has its middle f (1 - f) / 2 off the pixel's."""

LEAST_WAVE_DN, QUANTISED = 0.8, 0.06
"""Amplitude that rounding to counts leaves of waves that a JPEG has left out (.3, standard
deviation), and by how much more of them its own blocks lack."""

BLOCKS = 1000
"""About so many of a picture's blocks are looked at."""

FINE = np.add.outer(np.arange(8), np.arange(8)) > 5
"""Waves of a block that a JPEG leaves out first."""

BEYOND_PX = 2.0
"""A JPEG's noise is largest in blocks with an edge: taken is that from so far off the edge on."""

LOST = 1.5
"""Standard deviations of sharp markers' light up to which one has less than others by chance."""


@dataclass(frozen=True, kw_only=True)
class SoftWindow(CentreEstimator):
    """Spots of the whole picture.

    Attributes
    ----------
    level_dn, area_px
        (n,) brightness and area of every marker's spot at rest.
    spot_px
        (n, 2) centres of these spots, px.
    cut
        (n,) whether the picture's frame cuts the spot. This method leaves it out.
    sharp
        Whether markers are measured by the plain centroid of all their light.
    """

    level_dn: Floats
    area_px: Floats
    spot_px: Pixels
    cut: Bools
    sharp: bool = False

    @classmethod
    def at_rest(
        cls, picture: Picture, looks: list[Look], spacing_px: float, given: bool
    ) -> Sequence[SoftWindow]:
        spots = [look.blobs.centre_px[look.blobs.whole] for look in looks]
        drawn = [look.nominal_px for look in looks]
        pairs = Neighbourhood.match_layout(drawn, spots, spacing_px, looks[0].picture_px)
        return [cls._matched(look, pair) for look, pair in zip(looks, pairs, strict=True)]

    @classmethod
    def _matched(cls, look: Look, pair: Ints) -> SoftWindow:
        """Return the markers with the whole spots that they are, ``pair`` (n,), and cut ones."""
        blobs = look.blobs
        if (pair >= 0).any():
            pair = np.where(pair >= 0, np.flatnonzero(blobs.whole)[pair], -1)
        if (pair >= 0).any() and blobs.cut.any():
            drawn = Neighbourhood.of(look.nominal_px, spacing(look.nominal_px))
            pair = drawn.complete(blobs.centre_px, pair, blobs.cut)
        return cls._of_spots(look, pair)

    @classmethod
    def _of_spots(cls, look: Look, pair: Ints) -> SoftWindow:
        """Return the markers that are the spots ``pair`` (n,), -1 for none."""
        blobs, found = look.blobs, pair >= 0
        spot_px = np.full((len(pair), 2), np.nan)
        spot_px[found] = blobs.centre_px[pair[found]]
        cut = np.zeros(len(pair), np.bool_)
        level = area = sd = np.full(len(pair), np.nan)
        if len(blobs):
            cut = found & blobs.cut[pair]
            level = np.where(found, blobs.level_dn[pair], np.nan)
            area = np.where(found, blobs.area_px[pair], np.nan)
            usual = float(np.nanmedian(area[~cut])) if found.any() else 0.0
            area[cut] = usual
            hidden = (blobs.crowding[pair] > CROWDED) & (area < 0.8 * usual)
            more = np.where(hidden, CROWDED_SD_PX, 0.0)
            sd = np.where(found, np.hypot(blobs.sd_px[pair], more), np.nan)
        rest_px = np.where(cut[:, None], np.nan, spot_px)
        return cls(
            look=look,
            around=Neighbourhood.of(rest_px, spacing(look.nominal_px)),
            level_dn=level,
            area_px=area,
            sd_px=sd,
            usual_sd_px=np.sqrt(2.0) * sd,
            spot_px=spot_px,
            cut=cut,
        )

    @property
    def roughness_px(self) -> float:
        return 0.0 if self.sharp else math.inf

    def of_sharp(self, picture: Picture) -> SoftWindow:
        """Return this for markers with sharp edges, measured again in the ``picture`` at rest."""
        look, found = self.look, np.isfinite(self.spot_px[:, 0])
        pair = np.full(len(found), -1)
        if found.any():
            pair[found] = cKDTree(look.blobs.centre_px).query(self.spot_px[found])[1]
        signal = self._above_ground(picture)
        plain = _plain_centroids(signal, look.blobs, _is_compressed(picture))
        return replace(self._of_spots(replace(look, blobs=plain), pair), sharp=True)

    def _above_ground(self, picture: Picture) -> Signal:
        """Return the layer's signal above its ground, cut off at its floor."""
        look = self.look
        signal = project(picture, look.weights, look.ground_dn + look.floor_dn)
        signal -= np.float32(look.ground_dn)
        return signal

    def measure(self, picture: Picture, start_px: Pixels | None) -> Seen:
        blobs, spot, state, spurious = self._search(picture, start_px)
        known = self.around.rest_px
        shift, sd = np.full(known.shape, np.nan), np.full(len(known), np.nan)
        kept = np.flatnonzero(spot >= 0)
        spot = spot[kept]
        crowded = blobs.crowding[spot] > CROWDED
        hidden = crowded & (blobs.area_px[spot] < HIDDEN_AREA * self.area_px[kept])
        state[kept[hidden]] = OCCLUDED
        rows, spot, crowded = kept[~hidden], spot[~hidden], crowded[~hidden]
        shift[rows] = blobs.centre_px[spot] - known[rows]
        cut = np.where(crowded, CROWDED_SD_PX, 0.0)
        sd[rows] = np.hypot(np.hypot(blobs.sd_px[spot], cut), self.sd_px[rows])
        if self.sharp and len(rows):  # a part that is hidden takes its light along
            lost = 1.0 - blobs.area_px[spot] / self.area_px[rows]
            lost -= np.median(lost)
            lost -= LOST * 1.4826 * np.median(np.abs(lost))
            most = FARTHEST / np.sqrt(2.0) * 0.5 * blobs.diameter_px[spot]
            sd[rows] = np.hypot(sd[rows], most * np.fmax(lost, 0.0))
        return Seen(shift_px=shift, sd_px=sd, state=state, spurious_px=spurious)

    def _search(
        self, picture: Picture, start_px: Pixels | None
    ) -> tuple[Blobs, Ints, NDArray[np.uint8], Pixels]:
        """Return the spots of the whole picture; (n,) which of them every marker is, -1 for none;
        (n,) why the others are lost; and (s, 2) spots that look like markers and are none's."""
        look = self.look
        signal = self._above_ground(picture)
        blobs = Blobs.found_in(
            signal, look.diameter_px, look.contrast_dn, look.floor_dn, look.hole_px
        )
        if self.sharp:
            blobs = _plain_centroids(signal, blobs, _is_compressed(picture))
        # From a cold start the whole lattice is followed, also where it goes on beyond the layout.
        here = self._whole_lattice if start_px is None and len(self._spare[1]) else self
        with np.errstate(invalid="ignore", divide="ignore"):
            area = blobs.area_px[None] / here.area_px[:, None]
            level = blobs.level_dn[None] / here.level_dn[:, None]
        good = (
            (area > AREA_RATIO[0])
            & (area < AREA_RATIO[1])
            & (level > LEVEL_RATIO[0])
            & (level < LEVEL_RATIO[1])
        )
        spot, ambiguous = self._followed(here.around, blobs.centre_px, good & blobs.whole, start_px)
        spot, good = spot[: len(self.area_px)], good[: len(self.area_px)]
        state = self._lost_state(blobs, spot, ~good & blobs.whole)
        spurious = self._spurious(blobs, spot)
        if ambiguous:
            state[spot >= 0] = AMBIGUOUS
            spot = np.full_like(spot, -1)
        return blobs, spot, state, spurious

    def _followed(
        self, around: Neighbourhood, spots: Pixels, alike: Bools, start_px: Pixels | None
    ) -> tuple[Ints, bool]:
        """Return the result of `Neighbourhood.follow`, which takes in what else is seen at
        rest."""
        look, (spare, beyond) = self.look, self._spare
        spare = np.setdiff1d(spare, beyond) if around.goes_on else spare
        spare_px = np.concatenate([look.blobs.centre_px[spare], self.spot_px[self.cut]])
        found_px = FOUND * look.diameter_px
        return around.follow(spots, alike, start_px, look.picture_px, spare_px, found_px)

    @cached_property
    def _spare(self) -> tuple[Ints, Ints]:
        """Which spots at rest are none of the markers, and which of these go on with the markers'
        lattice beyond the layout."""
        blobs, marks = self.look.blobs, self.spot_px[np.isfinite(self.spot_px[:, 0])]
        if not len(marks):
            return np.arange(len(blobs)), np.arange(0)
        away, _ = cKDTree(marks).query(blobs.centre_px)
        spare = np.flatnonzero(away > 0.0)
        alike = spare[blobs.whole[spare]]
        return spare, alike[self.around.beyond(blobs.centre_px[alike])]

    @cached_property
    def endless(self) -> bool:
        _, beyond = self._spare
        if not len(beyond):
            return False
        around = self._whole_lattice.around
        spots = around.rest_px[np.isfinite(around.rest_px[:, 0])]
        alike = np.ones((len(around.rest_px), len(spots)), np.bool_)
        return self._followed(around, spots, alike, None)[1]

    @cached_property
    def _whole_lattice(self) -> SoftWindow:
        """The markers and, after them, the spots at rest that go on with their lattice."""
        blobs = self.look.blobs
        _, beyond = self._spare
        rest_px = np.concatenate([self.around.rest_px, blobs.centre_px[beyond]])
        around = Neighbourhood.of(rest_px, self.around.spacing_px)
        return SoftWindow(
            **{f.name: getattr(self, f.name) for f in fields(SoftWindow)}
            | {
                "around": replace(around, goes_on=True),
                "level_dn": np.append(self.level_dn, blobs.level_dn[beyond]),
                "area_px": np.append(self.area_px, blobs.area_px[beyond]),
            }
        )

    def _lost_state(self, blobs: Blobs, spot: Ints, odd: Bools) -> NDArray[np.uint8]:
        """Return why markers without a spot are lost: the spot near the expected place is odd, or
        there is none."""
        state = np.full(len(spot), MISSING, np.uint8)
        lost = np.flatnonzero((spot < 0) & np.isfinite(self.around.rest_px[:, 0]))
        if not len(lost) or not len(blobs):
            return state
        rest = self.around.rest_px
        motion = np.where((spot >= 0)[:, None], blobs.centre_px[spot] - rest, np.nan)
        expected, _ = self.around.predict(motion)
        distance, near = cKDTree(blobs.centre_px).query(rest[lost] + expected[lost])
        close = (distance < GATE * self.around.spacing_px) & odd[lost, near]
        lost, near = lost[close], near[close]
        with np.errstate(invalid="ignore", divide="ignore"):
            area = blobs.area_px[near] / self.area_px[lost]
            level = blobs.level_dn[near] / self.level_dn[lost]
        state[lost] = np.where(
            area > AREA_RATIO[1], MERGED, np.where(level < LEVEL_RATIO[0], DIM, OCCLUDED)
        )
        return state

    def _spurious(self, blobs: Blobs, spot: Ints) -> Pixels:
        """Return (s, 2) spots that look like markers and are none's."""
        free = np.ones(len(blobs), np.bool_)
        free[spot[spot >= 0]] = False
        if not len(blobs) or not np.isfinite(self.area_px).any():
            return np.asarray(blobs.centre_px[free])
        area = blobs.area_px / np.nanmedian(self.area_px)
        level = blobs.level_dn / np.nanmedian(self.level_dn)
        return np.asarray(
            blobs.centre_px[free & blobs.whole & (area > AREA_RATIO[0]) & (level > LEVEL_RATIO[0])]
        )


def _is_compressed(picture: Picture) -> bool:
    """Return whether a picture is a JPEG's: more fine waves have no amplitude in its own blocks of
    8 x 8 pixels, where these aren't even, than in blocks that lie across."""
    shares = []
    for begin in (0, 4):
        part = picture[begin:, begin:]
        rows, columns = part.shape[0] // 8, part.shape[1] // 8
        every = max(1, rows * columns // BLOCKS)
        while math.gcd(every, columns) > 1:  # else some columns of blocks alone are looked at
            every += 1
        row, column = np.divmod(np.arange(0, rows * columns, every), max(columns, 1))
        blocks = part[: 8 * rows, : 8 * columns].reshape(rows, 8, columns, 8, 3)
        waves = np.abs(dctn(blocks[row, :, column] @ LUMA, axes=(1, 2), norm="ortho"))
        uneven = waves[:, FINE].max(axis=1) > LEAST_WAVE_DN
        shares.append((waves[uneven][:, FINE] < LEAST_WAVE_DN).mean() if uneven.any() else 0.0)
    return bool(shares[0] > shares[1] + QUANTISED)


def _plain_centroids(signal: Signal, blobs: Blobs, compressed: bool) -> Blobs:
    """Return the spots with the centroids of all their light, how far these may be off, and the
    light over its brightness for the area.

    Where pixels gather no light over their area, an edge lies anywhere within a pixel: what is in a
    row, or column, moves by whole pixels, which is 1/12 of variance for the outermost ones. Others
    average out, as those of a slanting edge end at all parts of a pixel.
    """
    count, height, width = len(blobs), *signal.shape
    centre, by_noise, by_steps = blobs.centre_px.copy(), np.zeros(count), np.zeros(count)
    area = blobs.area_px.copy()
    between = np.full(count, np.nan)
    radius = 0.5 * blobs.diameter_px
    for k in range(count):
        reach = FARTHEST * radius[k] + 2.0
        low = np.fmax(np.ceil(blobs.centre_px[k] - reach), 0.0).astype(int)
        x, y = (
            np.arange(low[axis], min(low[axis] + int(2 * reach) + 1, most)) - centre[k, axis]
            for axis, most in enumerate((width, height))
        )
        light = signal[low[1] : low[1] + len(y), low[0] : low[0] + len(x)].astype(float)
        far = y[:, None] ** 2 + x**2
        near, rim = far < reach**2, (far < reach**2) & (far > (reach - 1.5) ** 2)
        light = np.where(near, light - np.median(light[rim]), 0.0) / blobs.level_dn[k]
        inside, mass = light > 0.5, light.sum()
        if not inside.any() or mass <= 0.0:
            continue
        area[k] = mass
        centre[k] += (light.sum(axis=0) @ x / mass, light.sum(axis=1) @ y / mass)
        noisy = near & (far > (radius[k] + BEYOND_PX) ** 2) if compressed else rim
        by_noise[k] = 0.5 * light[noisy].var() * far[near].sum() / mass**2
        for axis, place in enumerate((x, y)):
            line = inside.sum(axis=axis)
            ends = np.flatnonzero(line)[[0, -1]]
            by_steps[k] += ((line[ends] * place[ends]) ** 2).sum() / 24.0 / mass**2
        clear = np.clip(CLEAR_SD * light[noisy].std(), *BETWEEN)
        soft = np.count_nonzero(np.abs(light - 0.5) < 0.5 - clear)
        between[k] = soft / (OF_LIGHT * radius[k] * (1.0 - 2.0 * clear))
    usual = np.nanmedian(between[blobs.whole]) if blobs.whole.any() else 0.0
    by_steps *= np.clip(1.0 - usual, 0.0, 1.0)
    sd = np.sqrt(by_noise + by_steps + (GATHERED / radius) ** 2 + SD_FLOOR_PX**2)
    return replace(blobs, centre_px=centre, sd_px=sd, area_px=area)
