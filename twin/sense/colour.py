"""Split a colour picture into one signal per marker layer.

The flat paper takes the difference of the red and the blue component: its positive part is the red
layer, its negative part the blue one (section 4.1). Here every layer has a projection (r, g, b) of
the picture, of which the paper's (1, 0, -1) and (-1, 0, 1) are a case.

Why the projections are estimated from the rest picture: white balance, cross-talk and the dyes of a
real sensor are not known, whereas two colours in one picture are easily separated. Which colour
belongs to which layer is decided by the layout, never by a layer's name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, mean_spacing, medians
from twin.compiled import njit
from twin.errors import InputError
from twin.sense.template import MARGIN_PX, disc

Weights = tuple[float, float, float]
Signal = NDArray[np.float32]

SAMPLES = 4000
"""Marker pixels that are looked at for the colours."""

MARKED = (0.99, 0.999, 0.9999)
"""Quantiles of the contrast at which markers are looked for, until one is well above the ground's
spread."""

SHADED = 0.5
"""Where the ground varies so much that its own shading leaves less than this share of the spread of
colours, the shading is taken off before markers' colours are looked for."""

EVEN, STEEP = 2.0, 1.0
"""Over so many spacings of the markers their ground is taken for evenly lit; and where markers are
missing, light may fall off so steeply that it is over fewer only, of which markers cover more."""

HARDLY_SHOWN = 0.5
"""Share of a colour's contrast that another layer's signal must show, or it gets its own."""

ABSENT = 0.5
"""Share of a layer's markers that a colour of its own shows less than another layer's does, above
which it is a reflection's or the ground's, and no layer's."""

STRAY = 0.005
"""Colours of a smaller share of the markers' pixels are no layer's, but hot pixels', or dust's."""

UNSPLIT_COSINE = 0.97
"""Two marker colours closer than this in direction can't be split; their layers then share one
signal."""


@dataclass(frozen=True, kw_only=True)
class Flaws:
    """What a camera and a film's codec do to every picture, found in one.

    Attributes
    ----------
    blocks
        First (column, row) of the blocks of 2 x 2 pixels in which a film's decoder has repeated the
        colours; None where it has not.
    bad
        Row, column and channel of the pixels that are hot or dead.
    ground
        (h, q) brightness of the ground at rest, of some columns; None without bands.
    bands
        (h, 1) light of the rest picture's rows, over that without the bands of a light that
        flickers while a camera reads them one after the other; None where rows differ by noise of
        their reading, which adds to all brightness alike.
    """

    blocks: tuple[int, int] | None
    bad: tuple[Ints, Ints, Ints]
    ground: Floats | None = None
    bands: Floats | None = None

    @classmethod
    def of(cls, picture: Picture) -> Flaws:
        """Find the flaws of a picture."""
        return cls(blocks=_colour_blocks(picture), bad=_bad_pixels(picture))

    def mended(self, picture: Picture) -> Picture:
        """Return a picture less these flaws."""
        if len(self.bad[0]):
            picture = _repaired(picture, self.bad)
        return picture if self.blocks is None else _interpolate_colours(picture, self.blocks)

    def seen_without_bands(
        self, picture: Picture, marks_px: Pixels, clear_px: float, margin_px: float
    ) -> tuple[Flaws, Picture]:
        """Return these flaws, with the `ground`, and a rest picture without bands, if it has any.

        The ground of every row, over that of the columns, is a smooth function of the row: light,
        vignetting. What is left of it are bands. ``marks_px`` (n, 2) are all markers, whose ground
        begins ``clear_px`` from their centres; it is looked at ``margin_px`` around them.
        """
        ground = _bare_ground(picture, marks_px, clear_px, margin_px)
        with np.errstate(divide="ignore", invalid="ignore"):
            even = ground / _medians_of(ground, axis=0)
        seen = np.flatnonzero(np.isfinite(even).any(axis=0))
        if not len(seen) or np.nanmedian(ground) < DARK_DN:
            return self, picture
        # Light is the same on both halves of a row, the ground's texture is not.
        middle = seen[len(seen) // 2]
        parts = np.stack([_by_row(part) for part in (even, even[:, :middle], even[:, middle:])])
        rows = np.flatnonzero(np.isfinite(parts).all(axis=0))
        if len(rows) < LEAST_ROWS:
            return self, picture
        place = np.linspace(-1.0, 1.0, len(rows))
        trend = np.polynomial.polynomial.polyfit(place, parts[:, rows].T, TREND)
        smooth = np.polynomial.polynomial.polyval(place, trend)
        bands, *halves = parts[:, rows] / smooth
        if bands.std() < BANDED or not np.corrcoef(halves)[0, 1] > ALIKE:
            return self, picture
        # Bands go on from row to row, noise does not.
        left = _medians_of(even, axis=1)[rows] / smooth[0]
        if np.std(left - bands) > np.std(bands):
            return replace(self, ground=ground), _level_rows(picture, ground)
        by = np.interp(np.arange(len(picture)), rows, bands)[:, None]
        return replace(self, ground=ground, bands=by), _dimmed(picture, by)

    def without_bands(
        self, picture: Picture, marks_px: Pixels, clear_px: float, margin_px: float
    ) -> Picture:
        """Return a picture in the light of the rest picture, row by row; arguments as for
        `seen_without_bands`."""
        assert self.ground is not None
        now = _bare_ground(picture, marks_px, clear_px, margin_px)
        if self.bands is None:
            return _level_rows(picture, now)
        with np.errstate(divide="ignore", invalid="ignore"):
            change = _by_row(now / self.ground)
        rows = np.flatnonzero(np.isfinite(change) & (change > LEAST_LIGHT))
        if not len(rows):
            return picture
        since = np.interp(np.arange(len(change)), rows, change[rows])[:, None]
        return _dimmed(picture, since * self.bands)

    @staticmethod
    def as_rows_at_rest(
        picture: Picture, change: Floats, places: Pixels, layer: NDArray[np.str_]
    ) -> Picture | None:
        """Return a picture less what the light of its rows has changed by since rest, as markers
        show it where their ground is too dark to: mains make light a wave with an octave.

        Parameters
        ----------
        picture
            (h, w, 3) counts.
        change, places
            (n,) logarithm of what their brightness has changed by, and (n, 2) where they are, px;
            NaN where not known.
        layer
            (n,) their layers, each of which may have changed by a factor of its own.

        Returns
        -------
        None where the change is not one of rows: neither half of the picture, left and right, may
        leave more than `UNLIKE_ROWS` of the other's.
        """
        known = np.flatnonzero(np.isfinite(change + places[:, 1]))
        if len(known) < LEAST_MARKERS:
            return None
        height = len(picture)
        change, (column, row) = change[known], places[known].T / height
        which = layer[known][:, None] == np.unique(layer[known])
        change = change - which @ medians(np.where(which, change[:, None], np.nan))
        most = height / (ROWS_A_WAVE * mean_spacing(places[known]))
        number = _likeliest_wave(which, row, change, most)
        if number is None:
            return None
        best_terms = np.hstack([which, _waves(row, number, most)])
        half = column < medians(column)
        for part in (half, ~half):
            off = change - best_terms @ _bounded_fit(best_terms[part], change[part])
            if medians(np.abs(off[~part])) > UNLIKE_ROWS * medians(np.abs(change[~part])):
                return None
        factors = _bounded_fit(best_terms, change)[which.shape[1] :]
        light = _waves(np.arange(height) / height, number, most) @ factors
        return _dimmed(picture, np.exp(light - medians(light))[:, None])

    @staticmethod
    def covered(picture: Picture, marks_px: Pixels, radius: float) -> Bools:
        """Return (h, w) which pixels are nearer to the marks (n, 2) than ``radius`` and a margin,
        px."""
        covered = np.zeros(picture.shape[:2], np.bool_)
        middle = np.rint(marks_px[np.isfinite(marks_px).all(axis=1)]).astype(int)
        _cover(middle, disc(int((radius + MARGIN_PX) ** 2))[1], covered)
        return covered

    @staticmethod
    def repeats_blocks(before: Picture, picture: Picture) -> bool:
        """Return whether blocks of a picture (h, w, 3) are those of the picture ``before``."""
        least, most = sorted(_share_repeated(before, picture, begin) for begin in (0, BLOCK // 2))
        return bool(max(REPEATED, ACROSS * most) < least < SAME_PICTURE)

    @staticmethod
    def mosaic_sites(picture: Picture) -> Bools | None:
        """Return (3, 2, 2) which pixels, by parity of row and column, a camera's colour mosaic
        (Bayer) has measured in each channel, if the others are interpolated linearly; None if not.

        Why: what is interpolated has the lens' blur and the neighbours' mean, and its noise is
        theirs. Fits to the measured pixels alone have no such errors.
        """
        levels = picture[:, :, ::2].astype(np.int16)
        # by parity of row and column: the least share of red and blue between neighbours' means
        across, fits = _between(levels), np.empty((2, 2))
        if across.max() < MEASURED:  # nearly always
            return None
        down = _between(levels.transpose(1, 0, 2)).transpose(1, 0, 2)
        for r in range(2):
            for c in range(2):
                red = across[r, 1 - c, 0], down[1 - r, c, 0]
                blue = across[1 - r, c, 1], down[r, 1 - c, 1]
                fits[r, c] = min(*red, *blue)
        best = np.sort(fits.ravel())
        if best[-1] < MEASURED or best[-2] > AMBIGUOUS:
            return None
        row, column = np.unravel_index(fits.argmax(), fits.shape)
        sites = np.zeros((3, 2, 2), np.bool_)
        sites[0, row, column] = sites[2, 1 - row, 1 - column] = True
        sites[1] = ~(sites[0] | sites[2])
        return sites


@njit(cache=True)
def _cover(middle, runs, covered):
    """Set what of ``covered`` (h, w) is in one of the discs of ``runs`` about ``middle`` (n, 2)."""
    for column, row in middle:
        for line, first, count, _ in runs:
            if 0 <= row + line < len(covered):
                start = max(column + first, 0)
                covered[row + line, start : max(column + first + count, start)] = True


def as_picture(image: NDArray[np.generic], what: str) -> Picture:
    """Return ``image`` as a contiguous (h, w, 3) picture in counts of 255, singles if it has 16
    bits; a grey one is repeated in all channels.

    Raises
    ------
    InputError
        It isn't a picture of one or three channels of 8 bits, or of 16 that are used.
    """
    picture = np.asarray(image)
    known = picture.dtype in (np.uint8, np.uint16)
    if not known or picture.ndim not in (2, 3) or 0 in picture.shape:
        raise InputError(
            f"{what} must be counts of 8 or 16 bits of shape (height, width, 3) or (height, "
            f"width), got {picture.dtype} of shape {picture.shape}: convert it first, values from "
            "0 to 1 by np.rint(65535 * picture).astype(np.uint16)"
        )
    if picture.dtype == np.uint16:
        if picture.max() < _UNSTRETCHED:
            raise InputError(
                f"{what} has no count above {picture.max()}, but 65535 is the largest of 16 bits: "
                "multiply counts of 10 bits by 64, of 12 bits by 16"
            )
        picture = picture / np.float32(257)
    if picture.ndim == 2:
        picture = np.repeat(picture[:, :, None], 3, axis=2)
    if picture.shape[2] != 3:
        raise InputError(
            f"{what} must have 3 channels (red, green, blue), got {picture.shape[2]}: "
            "drop the others"
        )
    picture = np.ascontiguousarray(picture)
    # one type for the compiled kernels
    return picture if picture.flags.writeable else picture.copy()


_UNSTRETCHED = 4096
"""Counts of 16 bits below this are those of 12 bits that nobody has stretched."""

LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in the brightness that JPEG and H.264 keep at full resolution
(ITU-R BT.601); they halve that of the colours."""

DOUBLED = 0.1
"""Colours that change within blocks of 2 x 2 pixels by less than this share of what they change
from block to block, squared, were kept at half the resolution and repeated."""

COLOURLESS = 0.01
"""Colours that change by less than this share of what the brightness changes by, squared, show
nothing."""


def _colour_blocks(picture: Picture) -> tuple[int, int] | None:
    """Return `Flaws.blocks`."""
    bright = picture.astype(np.float32) @ LUMA[:, None].astype(np.float32)
    sample = picture[:, :, ::2] - bright
    first = []
    for axis in (1, 0):
        change = np.moveaxis(np.diff(sample, axis=axis) ** 2, axis, 0)
        even, odd = float(change[::2].mean()), float(change[1::2].mean())
        least = COLOURLESS * float((np.diff(bright, axis=axis) ** 2).mean())
        if min(even, odd) >= DOUBLED * max(even, odd) or max(even, odd) < least:
            return None
        first.append(int(odd < even))
    return first[0], first[1]


MEASURED, AMBIGUOUS = 0.97, 0.9
"""Share of the pixels that are the mean of their neighbours, to the last count, in a channel that
was interpolated between the sites of a mosaic; where other places of the mosaic fit a picture as
well, there is too little noise to know."""


def _between(levels: NDArray[np.int16]) -> Floats:
    """Return (2, 2, q) the share of pixels, by parity of row and column, that are the mean of those
    to the left and right, for ``levels`` (h, w, q)."""
    shares = np.zeros((2, 2, levels.shape[2]))
    for column in range(2):
        places = np.arange(2 - column, levels.shape[1] - 1, 2)
        off = 2 * levels[:, places] - levels[:, places - 1] - levels[:, places + 1]
        for row in range(2):
            if off[row::2].size:
                shares[row, column] = (np.abs(off[row::2]) <= 1).mean(axis=(0, 1))
    return shares


LEAST_ROWS, TREND, BANDED = 60, 4, 0.004
"""Rows of ground in which bands are looked for; the degree of what else the light does over these;
and the standard deviation of bands that are taken off, as a share of the light (without any .0001
to .002), where that is more than `DARK_DN`: darker ground shows rounding."""

ALIKE = 0.8
"""Correlation of bands in both halves of the rows; of grained ground it is -.15 to .12."""

LEAST_LIGHT = 0.05
"""A row that has a smaller share of its light at rest is dark, and no band."""

COLUMNS = 400
"""About so many columns of a picture are looked at."""

WITHIN = 3.0
"""Standard deviations of a pixel's noise within which the ground of a row is averaged."""

LEAST_GROUND = 12
"""Pixels of ground that show a row's brightness."""

ROWS = np.linalg.pinv(np.vander(np.arange(-7, 8), 4))[3]
"""Weights of a row and its neighbours in a local cubic, which noise moves less than one row."""


def _bare_ground(picture: Picture, marks: Pixels, clear: float, margin: float) -> Floats:
    """Return the brightness of some of the columns of a picture, (h, w); NaN at markers, and beyond
    ``margin`` around all."""
    places = marks[np.isfinite(marks).all(axis=1)]
    every = max(picture.shape[1] // COLUMNS, 1)
    bright: Floats = picture[:, ::every] @ LUMA
    ground = np.zeros(picture.shape[:2], np.bool_)
    if len(places):
        left, top = np.fmax(places.min(axis=0) - margin, 0.0).astype(int)
        right, bottom = (places.max(axis=0) + margin).astype(int) + 1
        ground[top:bottom, left:right] = True
    ground &= ~Flaws.covered(picture, places, clear)
    bright[~ground[:, ::every]] = np.nan
    return bright


def _medians_of(values: Floats, axis: int) -> Floats:
    """Return medians along an axis, NaN where fewer than `LEAST_GROUND` are known."""
    few = np.isfinite(values).sum(axis=axis) < LEAST_GROUND
    return np.where(few, np.nan, medians(values, axis))


def _by_row(values: Floats) -> Floats:
    """Return (h,) the medians of rows, smoothed; NaN where there are none."""
    row = _medians_of(values, axis=1)
    known = np.flatnonzero(np.isfinite(row))
    if len(known) < LEAST_ROWS:
        return np.full_like(row, np.nan)
    first, last = known[0], known[-1] + 1
    half = len(ROWS) // 2
    whole = np.interp(np.arange(first, last), known, row[known])
    # beyond its ends a row's brightness goes on as its mirror image through the last value
    before, after = 2 * whole[0] - whole[half:0:-1], 2 * whole[-1] - whole[-2 : -half - 2 : -1]
    row[first:last] = np.convolve(np.concatenate([before, whole, after]), ROWS[::-1], "valid")
    return row


def _level_rows(picture: Picture, ground: Floats) -> Picture:
    """Return a picture less what its rows' ``ground`` (h, q) differs by from smooth changes."""
    off = ground - _medians_of(ground, axis=0)
    usual = _medians_of(off, axis=1)[:, None]
    spread = WITHIN * 1.4826 * medians(np.abs(off - usual))
    rows = np.flatnonzero(np.isfinite(usual))
    if len(rows) < LEAST_ROWS:
        return picture
    # a mean shows less than a count, which a median of whole counts does not
    level = np.nanmean(np.clip(off, usual - spread, usual + spread)[rows], axis=1)
    place = np.linspace(-1.0, 1.0, len(rows))
    level -= np.polynomial.Polynomial.fit(place, level, TREND)(place)
    by = np.interp(np.arange(len(picture)), rows, level)
    return _in_counts(picture - by[:, None, None], picture)


ROWS_A_WAVE, LEAST_MARKERS, UNLIKE_ROWS = 2.2, 20, 0.7
"""Least length of a wave of light over rows, in distances of markers, that these show; how many
markers show it; and the share of the change, median, that one half of the picture's may leave of
the other's."""


def _waves(row: Floats, number: Floats | float, most: float) -> Floats:
    """Return (n, 3 or 5) a slope, a ``number`` of waves a picture, and the octave of these unless
    it is more than ``most``, at each ``row`` (n,), in heights of the picture; (t, n, 3 or 5) for
    numbers (t,) of which all or none have an octave."""
    phase = 2.0 * np.pi * np.asarray(number)[..., None, None] * row[:, None] * [1.0, 2.0]
    phase = phase[..., : 2 if np.all(2.0 * number < most) else 1]
    slope = np.broadcast_to(row[:, None], (*phase.shape[:-1], 1))
    return np.concatenate([slope, np.cos(phase), np.sin(phase)], axis=-1)


def _likeliest_wave(which: Bools, row: Floats, change: Floats, most: float) -> float | None:
    """Return the number of waves a picture, up to ``most``, by which least is left of ``change``
    (n,); None where there is no such number.

    It is found by ever smaller steps, of which the first turns ends by 1/8. ``which`` (n, q) tells
    the layers, ``row`` (n,) is in heights of the picture.
    """
    step = 0.125 / np.ptp(row)
    tried: Floats = np.arange(2.0 * step, most, step)
    number = None
    for _ in range(3 if len(tried) else 0):
        left = []
        parts = np.split(tried, [np.searchsorted(2.0 * tried, most)])
        for some in (part for part in parts if len(part)):
            known = np.broadcast_to(which, (len(some), *which.shape))
            values = np.broadcast_to(change[:, None], (len(some), len(change), 1))
            terms = np.concatenate([known, _waves(row, some, most), values], axis=2)
            # what is left of the last column is the last number of its triangle
            triangle = np.asarray(np.linalg.qr(terms, mode="r"))
            left.append(np.abs(triangle[:, -1, -1]))
        number = float(tried[np.argmin(np.concatenate(left))])
        step /= 4.0
        tried = number + step * np.arange(-4, 5)
    return number


def _bounded_fit(terms: Floats, values: Floats, turns: int = 3) -> Floats:
    """Return (m,) by what factors ``terms`` (n, m) add up to ``values`` (n,): least squares,
    outliers bounded from the second of the ``turns`` on."""
    weight: Floats = np.ones(len(values))
    factors: Floats = np.zeros(terms.shape[1])
    for _ in range(turns):
        factors = np.asarray(
            np.linalg.lstsq(terms * weight[:, None], weight * values, rcond=1e-6)[0], float
        )
        off = np.abs(values - terms @ factors)
        weight = np.sqrt(np.fmin(2.0 * 1.4826 * medians(off) / np.fmax(off, 1e-9), 1.0))
    return factors


def _dimmed(picture: Picture, by: Floats) -> Picture:
    """Return a picture divided by (h, 1), in its own kind of counts."""
    return _in_counts(picture / by[:, :, None], picture)


def _in_counts(light: Floats, picture: Picture) -> Picture:
    """Return ``light`` (h, w, 3) in the kind of counts of a ``picture``."""
    if picture.dtype == np.uint8:
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)
    return light.astype(picture.dtype)


BLOCK = 8
"""Side of the blocks by which a film's codec is known, px."""

REPEATED = 0.01
"""A film's codec repeats blocks of the picture before. It has if more than this share of them are
the same to the last count: no camera's noise repeats one. JPEG by itself may repeat blocks of its
own grid (3 in 100 at quality 60), but hardly any that lie across (.8 in 100), so both are looked
at."""

ACROSS = 0.5
"""And where those that lie across are at least this share of the others: JPEG of a dark ground
repeats up to 18 in 100, and .1 to .4 times as many across (films .65 to 1.8 times)."""

SAME_PICTURE = 0.9
"""If as many are the same, it is the same picture twice."""

DARK_DN = 24
"""Blocks that are nowhere brighter do not count: compression rounds the noise of dark ground away.
Nor do those that are all of one level."""


def _share_repeated(before: Picture, picture: Picture, begin: int) -> float:
    """Return the share of the blocks from row and column ``begin`` on, but dark and even ones, that
    are the same in both pictures."""
    height, width = picture.shape[:2]
    rows, columns = (height - begin) // BLOCK, (width - begin) // BLOCK
    part = slice(begin, begin + rows * BLOCK), slice(begin, begin + columns * BLOCK)

    def in_blocks(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(rows, BLOCK, columns, 3 * BLOCK)

    # rows of blocks first, as whole rows of pixels are for the vector unit
    now, then = picture[part], before[part]
    bright = in_blocks(now).max(axis=1).max(axis=2) > DARK_DN
    changed = np.any(in_blocks(np.not_equal(now, then)).any(axis=1), axis=2)
    row, column = np.nonzero(bright & ~changed)
    alike = in_blocks(now)[row, :, column].reshape(len(row), BLOCK * BLOCK, 3)
    same = int(np.count_nonzero((alike != alike[:, :1]).any(axis=(1, 2))))
    return same / max(same + int(np.count_nonzero(bright & changed)), 1)


STANDS_OUT, LEAST_STAND_DN = 8.0, 12.0
"""A pixel is bad if it is brighter, or darker, than all but one of its eight neighbours by so many
standard deviations of the noise, at least so many counts."""

PEAK = 3
"""And more, by so many times what these neighbours differ by: a lens spreads light over several
pixels, and so does a mosaic of colours."""

MOST_BAD = 0.01
"""If more than this share of the pixels are so, it is the picture's texture."""

RING = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if (row, column) != (0, 0)]
"""A pixel's eight neighbours."""


def _bad_pixels(picture: Picture) -> tuple[Ints, Ints, Ints]:
    """Return `Flaws.bad`."""
    levels = picture.astype(np.int16)
    steps = (
        np.abs(np.diff(levels[::3, ::2], axis=1)) if picture.shape[1] > 2 else np.zeros((1, 1, 3))
    )
    noise = 1.4826 * np.median(steps.reshape(-1, 3), axis=0) / np.sqrt(2.0)
    least = np.maximum(STANDS_OUT * noise, LEAST_STAND_DN)
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="edge")
    # Such a pixel stands out from one at least of any two neighbours: few do.
    limit = least.astype(np.int16)
    bright, dark = np.ones((2, *levels.shape), np.bool_)
    for one, other in (around[1:-1, :-2], around[1:-1, 2:]), (around[:-2, 1:-1], around[2:, 1:-1]):
        bright &= levels > np.minimum(one, other) + limit
        dark &= levels < np.maximum(one, other) - limit
    row, column, channel = np.nonzero(bright | dark)
    ring = [around[1 + row + down, 1 + column + right, channel] for down, right in RING]
    lowest, low, *_, high, highest = np.sort(ring, axis=0)
    level, least = levels[row, column, channel], least[channel]
    bad = level > high + least + PEAK * (high - lowest)
    bad |= level < low - least - PEAK * (highest - low)
    if bad.sum() > MOST_BAD * levels.size:
        bad[:] = False
    return row[bad], column[bad], channel[bad]


def _repaired(picture: Picture, bad: tuple[Ints, Ints, Ints]) -> Picture:
    """Return the picture with its ``bad`` pixels interpolated cubically along rows and columns."""
    row, column, channel = bad
    height, width = picture.shape[:2]
    out = picture.copy()

    def beside(down: int, right: int) -> Ints:
        rows, columns = np.clip(row + down, 0, height - 1), np.clip(column + right, 0, width - 1)
        return np.asarray(out[rows, columns, channel].astype(np.int64))

    # first by the neighbours' median, which other bad pixels do not move
    out[bad] = np.median([beside(*step) for step in RING], axis=0).astype(out.dtype)
    near = sum(beside(*step) for step in ((0, 1), (0, -1), (1, 0), (-1, 0)))
    far = sum(beside(*step) for step in ((0, 2), (0, -2), (2, 0), (-2, 0)))
    out[bad] = np.clip(np.rint((4 * near - far) / 12), 0, 255).astype(out.dtype)
    return out


def _interpolate_colours(picture: Picture, blocks: tuple[int, int]) -> Picture:
    """Return the picture with its repeated colours interpolated linearly between the ``blocks``.

    Why: steps every other pixel look like edges, and move a marker's by up to .3 px.
    """
    levels = picture.astype(np.uint8, copy=False)
    out = np.empty_like(levels)
    _interpolate(levels, np.rint(256 * LUMA).astype(np.float32), *blocks, out)
    return out


@njit(cache=True, fastmath=True)
def _interpolate(picture, weights, first_column, first_row, out):
    """Fill ``out`` with the brightness, and with colours between the four blocks that meet at a
    corner: of each block's pixel there 9/16 of its own, 3/16 of those beside, 1/16 across.

    Whole numbers in singles, and every loop over arrays that begin at 0: for the vector unit.
    """
    height, width = picture.shape[0], picture.shape[1]
    flat, filled = picture.reshape(-1), out.reshape(-1)
    red, green, blue = weights
    zero, three, full = np.float32(0.0), np.float32(3.0), np.float32(255.0)
    share, sixteenth, half = np.float32(1 / 256), np.float32(1 / 16), np.float32(8.0)
    # by channel, with the border's pixels once more beyond it
    bright, colour = np.empty((2, width), np.float32), np.empty((3, width + 2), np.float32)
    mixed = np.empty((2, 3, width + 2), np.float32)
    for top in range(first_row - 1, height, 2):  # two rows that meet
        for k in range(2):
            row = min(max(top + k, 0), height - 1)
            line, luma = flat[3 * row * width : 3 * (row + 1) * width], bright[k]
            reds, greens, blues = colour[0, 1:], colour[1, 1:], colour[2, 1:]
            for x in range(width):
                r, g, b = line[3 * x], line[3 * x + 1], line[3 * x + 2]
                r, g, b = np.float32(r), np.float32(g), np.float32(b)
                luma[x] = np.floor(share * (red * r + green * g + blue * b))
                reds[x], greens[x], blues[x] = r - luma[x], g - luma[x], b - luma[x]
            for i in range(3):
                colour[i, 0], colour[i, width + 1] = colour[i, 1], colour[i, width]
                pixels, between = colour[i, first_column:], mixed[k, i, first_column:]
                for x in range(len(pixels) // 2):
                    one, other = pixels[2 * x], pixels[2 * x + 1]
                    between[2 * x] = three * one + other
                    between[2 * x + 1] = three * other + one
        for k in range(max(-top, 0), min(height - top, 2)):
            line, luma = filled[3 * (top + k) * width : 3 * (top + k + 1) * width], bright[k]
            own, other = mixed[k], mixed[1 - k]
            reds, greens, blues = own[0, 1:], own[1, 1:], own[2, 1:]
            more_red, more_green, more_blue = other[0, 1:], other[1, 1:], other[2, 1:]
            for x in range(width):
                r = luma[x] + np.floor(sixteenth * (three * reds[x] + more_red[x] + half))
                g = luma[x] + np.floor(sixteenth * (three * greens[x] + more_green[x] + half))
                b = luma[x] + np.floor(sixteenth * (three * blues[x] + more_blue[x] + half))
                line[3 * x] = np.uint8(min(max(r, zero), full))
                line[3 * x + 1] = np.uint8(min(max(g, zero), full))
                line[3 * x + 2] = np.uint8(min(max(b, zero), full))


def project(image: Picture, weights: Weights, floor_dn: float = -np.inf) -> Signal:
    """Return the (h, w) signal r R + g G + b B, counts, cut off below ``floor_dn``.

    Why a floor a little below zero instead of the paper's positive part: cutting at zero rectifies
    the noise of the background, which the centroid then feels; without a floor a marker of the
    other layer would count as negative mass.
    """
    red, green, blue = np.asarray(weights, np.float32)
    signal = red * image[:, :, 0]
    signal += green * image[:, :, 1]
    signal += blue * image[:, :, 2]
    return np.asarray(np.maximum(signal, np.float32(floor_dn)))


def estimate_channels(
    rest_image: Picture,
    layout: Mapping[str, Pixels],
    spacing_px: float,
    polarity: str | None = None,
    pair: tuple[Weights, Weights] | None = None,
    even: float = EVEN,
) -> dict[str, Weights]:
    """Estimate every layer's projection from the rest picture.

    Parameters
    ----------
    rest_image
        (h, w, 3) counts.
    layout
        Nominal rest positions by layer, px; they may be off by about a third of the spacing.
    spacing_px
        Typical distance of neighbouring markers in a layer, px.
    polarity
        ``bright`` or ``dark`` markers on their ground; None: found from the picture.
    pair
        The two projections to choose from where there are two layers of different colour, instead
        of estimates.
    even
        Over so many spacings the ground is taken for evenly lit.

    Returns
    -------
    dict
        (r, g, b) by layer, the largest magnitude 1. All layers share one projection where the
        colours can't be separated; a picture without contrast yields the grey one.
    """
    grey = (1 / 3, 1 / 3, 1 / 3) if polarity != "dark" else (-1 / 3, -1 / 3, -1 / 3)
    away = _contrasts(rest_image, layout, spacing_px, even * spacing_px, polarity)
    samples = _strongest(away)
    if samples is None:
        return dict.fromkeys(layout, grey)
    weights = projections(samples, len(layout))
    if len(weights) == 1 < len(layout):
        # A layer may be so faint that none of its pixels are among the strongest.
        shown = away @ _unit(samples.mean(axis=0))
        fainter = _strongest(away[shown < HARDLY_SHOWN * np.linalg.norm(away, axis=1)])
        if fainter is not None:
            apart = projections(np.concatenate([samples, fainter]), len(layout))
            weights = apart if len(apart) > 1 else weights
    if len(weights) == 1:
        return dict.fromkeys(layout, weights[0])
    if pair is not None and len(layout) == len(pair):
        weights = list(pair)
    return _assign(rest_image, layout, weights, spacing_px)


def _contrasts(
    image: Picture,
    layout: Mapping[str, Pixels],
    spacing_px: float,
    even_px: float,
    polarity: str | None,
) -> Floats:
    """Return (n, 3) colours minus the ground's colour around the markers, whose shading is followed
    over squares of ``even_px``."""
    height, width = image.shape[:2]
    points = np.concatenate([np.asarray(p, float) for p in layout.values()])
    low = np.maximum(np.floor(points.min(axis=0) - spacing_px), 0).astype(int)
    high = np.ceil(points.max(axis=0) + spacing_px)
    high = np.minimum(high, [width - 1, height - 1]).astype(int)
    if np.any(high <= low):
        return np.zeros((0, 3))
    part = image[low[1] : high[1] + 1, low[0] : high[0] + 1]
    every = max(1, part.size // 300_000)
    pixels = part.reshape(-1, 3)[::every].astype(float)
    away = pixels - np.median(pixels, axis=0)
    level = pixels - _shading(part, even_px).reshape(-1, 3)[::every]
    if _spread(level) < SHADED * _spread(away):
        away = level
    if polarity is not None:
        away = away[(away.sum(axis=1) > 0) == (polarity == "bright")]
    return np.asarray(away)


def _strongest(away: Floats) -> Floats | None:
    """Return those of the colours (n, 3) that surely belong to markers, or None."""
    if not len(away):
        return None
    strength = np.linalg.norm(away, axis=1)
    # Few or small markers far apart fill less than a hundredth of the picture.
    least = max(8.0, 3.0 * _spread(away))
    top = next((q for q in np.quantile(strength, MARKED) if q >= least), None)
    if top is None:
        return None
    strong = away[strength > 0.5 * top]
    return np.asarray(strong[:: max(1, len(strong) // SAMPLES)])


def _spread(away: Floats) -> float:
    """Return how far colours (n, 3) lie from the ground's, robustly, counts."""
    return float(1.4826 * np.median(np.linalg.norm(away, axis=1)))


def _shading(part: Picture, size_px: float) -> Floats:
    """Return the ground (h, w, 3): the medians of squares, linear between them."""
    sizes = part.shape[:2]
    rows, columns = counts = [max(1, round(n / size_px)) for n in sizes]
    high, wide = np.floor_divide(sizes, counts)
    squares = part[: rows * high, : columns * wide].reshape(rows, high, columns, wide, 3)
    middle = np.median(squares, axis=(1, 3))
    # (n, count) shares of the squares along either axis
    down, across = (
        np.fmax(1.0 - np.abs(np.clip(at, 0, count - 1)[:, None] - np.arange(count)), 0.0)
        for count, at in (
            (count, (np.arange(n) + 0.5) * count / n - 0.5)
            for n, count in zip(sizes, counts, strict=True)
        )
    )
    return np.asarray(np.tensordot(down, across @ middle, axes=1))


def projections(samples: Floats, count: int) -> list[Weights]:
    """Return the projections (r, g, b) that show one of ``count`` colours (n, 3) each and hide the
    others, the largest magnitude 1; one for all where they can't be separated."""
    colours = _directions(samples, count)
    if colours is None:
        return [_as_weights(samples.mean(axis=0))]
    others = [np.mean(np.delete(colours, i, axis=0), axis=0) for i in range(count)]
    apart = colours - np.array(others)
    if count > 2:  # differences may show other colours; what is blind to them may show little
        blind = np.asarray(np.linalg.pinv(colours, rcond=0.05).T, np.float64)
        better = _separation(blind, colours) > _separation(apart, colours)
        apart = np.where(better[:, None], blind, apart)
    return [_as_weights(direction) for direction in apart]


def _separation(weights: Floats, colours: Floats) -> Floats:
    """Return (n,) how much more of its own colour each of ``weights`` (n, 3) shows than of the
    others, over its length."""
    shown = weights @ colours.T
    own = shown.diagonal().copy()
    np.fill_diagonal(shown, 0.0)
    return np.asarray((own - shown.max(axis=1)) / np.linalg.norm(weights, axis=1))


def _as_weights(direction: Floats) -> Weights:
    red, green, blue = (float(v) for v in direction / max(np.abs(direction).max(), 1e-12))
    return red, green, blue


def _directions(samples: Floats, count: int) -> Floats | None:
    """Return the (count, 3) unit directions of the colours, or None where they can't be
    separated."""
    if count == 1:
        return None
    unit = samples / np.linalg.norm(samples, axis=1, keepdims=True)
    while True:
        directions, nearest = _clusters(unit, count)
        number = np.bincount(nearest, minlength=count)
        few = (number > 0) & (number < STRAY * len(unit))
        if not few.any():
            break
        unit = unit[~few[nearest]]
    if not number.all():
        return None
    likeness = directions @ directions.T - 2.0 * np.eye(count)
    return None if likeness.max() > UNSPLIT_COSINE else directions


def _clusters(unit: Floats, count: int) -> tuple[Floats, Ints]:
    """Return ``count`` directions about which ``unit`` vectors (n, 3) lie, and (n,) the nearest of
    these to each; some have none where there are fewer."""
    centres = [unit[np.argmin(unit @ _unit(unit.mean(axis=0)))]]
    while len(centres) < count:
        centres.append(unit[np.argmin(np.max(unit @ np.array(centres).T, axis=1))])
    directions = np.array(centres)
    for _ in range(20):
        nearest = np.argmax(unit @ directions.T, axis=1)
        if len(np.unique(nearest)) < count:
            break
        directions = np.array([_unit(unit[nearest == i].mean(axis=0)) for i in range(count)])
    return directions, nearest


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


def _assign(
    image: Picture, layout: Mapping[str, Pixels], weights: list[Weights], spacing_px: float
) -> dict[str, Weights]:
    """Give every layer the colour that the picture shows at its places, allowing one common shift
    of all of them."""
    from scipy.ndimage import uniform_filter

    size = max(3, round(0.2 * spacing_px))
    signals = []
    for w in weights:
        signal = project(image, w)
        above = np.maximum(signal - np.median(signal[::4, ::4]), np.float32(0.0))
        signals.append(uniform_filter(above, size))
    levels = [max(float(np.quantile(signal, 0.99)), 1e-6) for signal in signals]
    steps = np.linspace(-0.4, 0.4, 11) * spacing_px
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    height, width = image.shape[:2]
    score = np.zeros((len(layout), len(weights), len(shifts)))
    for i, points in enumerate(layout.values()):
        places = np.rint(np.asarray(points, float)[:, None] + shifts).astype(int)
        inside = (places >= 0).all(axis=2) & (places < [width, height]).all(axis=2)
        column, row = np.clip(places, 0, [width - 1, height - 1]).transpose(2, 0, 1)
        for j, signal in enumerate(signals):
            score[i, j] = (np.minimum(signal[row, column] / levels[j], 1.0) * inside).mean(axis=0)
    score -= 0.02 * np.linalg.norm(shifts, axis=1) / spacing_px
    orders = list(permutations(range(len(weights))))
    totals = [score[np.arange(len(layout)), list(order)].sum(axis=0).max() for order in orders]
    best = orders[int(np.argmax(totals))]
    any_colours = score.max(axis=1).sum(axis=0)
    if any_colours.max() > max(totals) + ABSENT:
        best = tuple(score[:, :, any_colours.argmax()].argmax(axis=1))
    return {name: weights[j] for name, j in zip(layout, best, strict=True)}
