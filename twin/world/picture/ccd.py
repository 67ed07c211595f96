"""The CCD: from light on the sensor to counts.

The chain follows the hardware: haze and ghosts, exposure, blur by the optics, colour filters, the
mosaic, electrons with shot and read noise, dark current and the pixels' own gains and offsets (EMVA
1288, secs. 2 and 4), full wells, interpolation of the mosaic, gain and white balance, gamma,
composite video, rounding, compression. It acts on the rendered light, so one picture can be exposed
many times.

Noise is a hash of the pixel's number, so that the bytes are the same on any number of threads. A
counter and a key are hashed to 32 bits (Widynski, "Squares: a fast counter-based RNG",
arXiv:2004.06278, four of whose rounds pass TestU01's BigCrush). One bit is the sign, 31 are the
share of larger deviates; the deviate is read from a table of the quantiles.

Blur is a sampled Gaussian of the wanted variance. The light is a mean over each pixel's square
already; a Gaussian integrated over pixels would average a second time (.5 px becomes .57).

numba takes 3.6 ms for a picture of 640 x 480, NumPy 39.

Validity: blur acts on the pixels' means. Sums, centroids and spreads are right; a pixel at an edge
is up to 8 % of the edge's height off (psf_px .3 to .5), 4 % (.7), 2 % (1). Shot noise is the normal
approximation of Poisson's law, good above some 20 electrons; darker pixels are governed by read
noise. Deviates are off by less than 2e-5 and end at 6.3 standard deviations, which one in 4e9
exceeds.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from twin.arrays import Floats, Ints, Picture, Singles
from twin.compiled import in_parts, njit
from twin.errors import InputError
from twin.parts.camera import FULL_SCALE, Ccd
from twin.world.picture.cover import stretch

Segments = NDArray[np.float32]
"""(n, 2) value at 0 and slope of each straight piece of a function, 64 between two powers of 2."""

_STRETCHED = 65535
_NOTHING = np.zeros((0, 0), np.float32)
_LINEAR: Segments = np.zeros((0, 2), np.float32)
_REORDER = {"contract", "arcp", "reassoc", "nsz"}
"""What the compiler may do with sums."""

_SHIFT = 17
"""Bits of a float32's 23 that lie within a piece of `Segments`."""

_POSITIVE, _ONE_BITS = 0x7FFFFFFF, 127 << 23
"""All bits of a float32 but the sign; the bits of 1."""

_OCTAVES = 32

_STEP_PX, _STILL_PX = 0.3, 1e-3
"""How far a marker moves at most between two instants of an exposure, and how far it does while the
picture is taken for still."""

_MOST_GAIN = 100.0
"""The most by which a camera brightens a picture of itself."""

_ACTIVE_US = 52.66
"""Duration of the visible part of a line of composite video, us (SMPTE 170M)."""

_YIQ = np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
"""Luminance and the two colour signals of red, green and blue (SMPTE 170M)."""


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """What is the same in every picture of one sensor.

    Attributes
    ----------
    gain, dark
        (height, width, channels) factor on each pixel's light, and dark signal in shares of a full
        well.
    """

    gain: Singles
    dark: Singles

    @staticmethod
    def drawn(ccd: Ccd, shape: tuple[int, int], rng: np.random.Generator) -> Pattern | None:
        """Draw the pattern of a CCD for pictures of a height and width, px; None for a CCD without
        any."""
        full = ccd.spelt_out()
        gathered = full.dark_current_e_s * full.exposure_ms / 1000
        bad = full.hot_pixels, full.dead_pixels
        uneven = full.prnu_pct, full.dsnu_e, gathered, full.column_noise_e, *bad
        if not full.noise or not any(uneven):
            return None
        size = (*shape, 1 if full.bayer != "none" else 3)
        gain = 1 + np.float32(full.prnu_pct / 100) * rng.standard_normal(size, np.float32)
        dark = np.float32(gathered) + np.float32(full.dsnu_e) * rng.standard_normal(
            size, np.float32
        )
        if full.column_noise_e > 0:
            columns = rng.standard_normal((1, shape[1], 1), np.float32)
            dark += np.float32(full.column_noise_e) * columns
        if any(bad):
            hot, dead = np.split(rng.permutation(gain.size)[: min(sum(bad), gain.size)], [bad[0]])
            gain.ravel()[[*hot, *dead]] = 0
            dark.ravel()[dead] = 0
            dark.ravel()[hot] = 2 * full.full_well_e
        return Pattern(gain=gain, dark=dark / np.float32(full.full_well_e))


def expose(
    radiance: Singles,
    ccd: Ccd,
    rng: np.random.Generator,
    pattern: Pattern | None = None,
    before: Singles | None = None,
) -> Picture:
    """Expose one picture.

    Parameters
    ----------
    radiance
        (height, width, 3) light on the sensor, red, green, blue; 1 fills the wells at ``exposure``
        1.
    rng
        Source of the noise; nothing is drawn for a CCD without noise.
    pattern
        The pixels' own gains and dark signals.
    before
        The light a field earlier, for an interlaced CCD; None: the same.

    Returns
    -------
    (height, width, 3) counts of 255; of 65535 where ``ccd.bits`` are more than 8, stretched from
    the largest count of so many bits.

    Raises
    ------
    InputError
        Not a colour picture, or a pattern or earlier light of another size.
    """
    full = ccd.spelt_out()
    mosaic = None
    if full.bayer != "none":
        mosaic = np.array(["rgb".index(letter) for letter in full.bayer]).reshape(2, 2)
    _check(radiance, mosaic, pattern, before)
    height, width, _ = radiance.shape
    # Light to electrons: blur, colour mixing, noise, saturation.
    shares = _wells(radiance, before, full, mosaic, pattern, rng)
    if full.noise and full.row_noise_e > 0:
        rows = rng.standard_normal((height, 1), np.float32)
        shares += np.float32(full.row_noise_e / full.full_well_e) * rows
        np.minimum(shares, 1, out=shares)
    if full.adc_bits:
        steps = np.float32(2**full.adc_bits - 1)
        shares[:] = np.rint(shares * steps) / steps
    # The colour mosaic, gains, the gamma curve and the composite video line.
    if mosaic is not None:
        shares = _demosaic(shares, mosaic).reshape(height, -1)
    if full.auto_gain or full.white_balance != "off":
        shares *= np.tile(_gains(shares.reshape(height, width, 3), full), width)
    curve = _gamma_curve(full.gamma)
    if isinstance(full.bandwidth_mhz, tuple):
        # The line carries signals that are corrected by gamma already.
        _send(shares, curve, full.bandwidth_mhz)
        curve = _LINEAR
    counts = _counts(shares, curve, full)
    return _compressed(counts, full.jpeg_quality) if isinstance(full.jpeg_quality, int) else counts


def _wells(
    radiance: Singles,
    before: Singles | None,
    full: Any,
    mosaic: Ints | None,
    pattern: Pattern | None,
    rng: np.random.Generator,
) -> Singles:
    """Return what the wells hold, in shares of a full one: (height, 3 width), or (height, width)
    behind a mosaic."""
    height, width, _ = radiance.shape
    gain = dark = _NOTHING
    if pattern is not None and full.noise:
        gain, dark = _rows(pattern.gain), _rows(pattern.dark)
    # The noise's first count and its key, which is odd.
    key = np.zeros(0, np.uint64)
    if full.noise:
        key = rng.integers(2**64, size=2, dtype=np.uint64)
        key[1] |= np.uint64(1)
    # What falls on the chip, and what the LEDs and the transfer of charge add to it.
    light = _rows(_on_the_chip(radiance, full, rng))
    earlier = light if before is None else _rows(_on_the_chip(before, full, rng))
    weights = _blur_weights(full.psf_px)
    response = full.response.astype(np.float32)
    colours = np.zeros((0, 2), np.int64) if mosaic is None else mosaic
    optics = (light, earlier, weights, response, full.interlace, colours)
    noise = (gain, dark, key, _normal_deviates(), full.read_noise_e, full.full_well_e)
    shares: Singles = np.empty((height, width * (3 if mosaic is None else 1)), np.float32)

    def electrons(_: int, begin: int, end: int) -> None:
        scratch = np.empty((3, 3 * (width + len(weights))), np.float32)
        _electron_rows(begin, end, *optics, *noise, scratch, shares)

    in_parts(height, electrons)
    return shares


def _send(shares: Singles, curve: Segments, bandwidth_mhz: tuple[float, ...]) -> None:
    """Send (height, 3 width) shares, corrected by a curve, through a composite line, in place."""
    height, width = len(shares), shares.shape[1] // 3
    # Gaussians that pass half the power at the bandwidth, exp(-2 pi^2 s^2 f^2) = 1/sqrt 2.
    half = np.sqrt(np.log(2)) / (2 * np.pi * np.asarray(bandwidth_mhz))
    filters = tuple(map(_blur_weights, half * width / _ACTIVE_US))
    matrices = np.stack([_YIQ, np.linalg.inv(_YIQ)]).astype(np.float32)
    in_parts(
        height,
        lambda _, begin, end: _composite_rows(begin, end, shares, curve, matrices, filters),
    )


def _counts(shares: Singles, curve: Segments, full: Any) -> Picture:
    """Return (height, width, 3) counts of (height, 3 width) shares: curve, black level, gain and
    rounding."""
    height, width = len(shares), shares.shape[1] // 3
    most = 2**full.bits - 1
    counts: Picture = np.empty((height, width, 3), np.uint8 if full.bits == 8 else np.uint16)
    flat = counts.reshape(height, -1)
    black = full.black_dn * most / FULL_SCALE

    def counted(_: int, begin: int, end: int) -> None:
        line = shares[begin:end].reshape(-1)
        if len(curve):
            _at_segments(curve, line)
        level = line * np.float32(most - black) + np.float32(black + 0.5)
        whole = level.clip(0, most).astype(counts.dtype)
        if full.bits > 8:
            whole = np.rint(whole * np.float32(_STRETCHED / most))
        flat[begin:end].reshape(-1)[:] = whole

    in_parts(height, counted)
    return counts


def _on_the_chip(light: Singles, full: Any, rng: np.random.Generator) -> Singles:
    """Return the (height, width, 3) light that reaches the pixels of a CCD (one that is spelt out):
    with haze, ghost, auto exposure, flicker and smear."""
    height, width, _ = light.shape
    if full.haze:
        # The Gaussian is a mean on coarse nodes, and straight lines between them.
        down, lines = _scatter(height, full.haze_px)
        across, columns = _scatter(width, full.haze_px)
        blurred: Singles = down @ _rows(light)
        coarse: Singles = blurred.reshape(len(down), width, 3).swapaxes(1, 2) @ across.T
        finer: Singles = coarse @ columns.T
        spread: Singles = lines @ _rows(finer.swapaxes(1, 2))
        light = light + np.float32(full.haze) * (spread.reshape(light.shape) - light)
    if full.ghost:
        light = light + np.float32(full.ghost) * _moved(light, *full.ghost_px)
    if full.auto_exposure:
        brightest = (light[::2, ::2] @ full.response.T.astype(np.float32)).max(axis=2)
        level = float(np.quantile(brightest, full.auto_exposure))
        light = light * _gain_to(full.white_level, level)
    if full.noise and full.flicker:
        # The mean of the sine over a row's exposure.
        turns = full.flicker_hz * full.readout_ms / 1000 * np.arange(height) / max(height - 1, 1)
        phase = 2 * np.pi * (turns + rng.uniform())
        mean = np.sinc(full.flicker_hz * full.exposure_ms / 1000) * np.sin(phase)
        light = light * (1 + full.flicker * mean)[:, None, None].astype(np.float32)
    if full.smear:
        light = light + np.float32(full.smear) * light.mean(axis=0)
    return light


@lru_cache(maxsize=4)
def _scatter(size: int, spread_px: float) -> tuple[Singles, Singles]:
    """Return (n, size) means of a line of pixels under Gaussians at n places, a quarter of their
    standard deviation apart, and the (size, n) matrix of lines between these places."""
    count = min(size, math.ceil(4 * size / spread_px) + 1)
    nodes = np.linspace(0, size - 1, count)
    weights = np.exp(-(((nodes[:, None] - np.arange(size)) / spread_px) ** 2) / 2)
    means = weights / weights.sum(axis=1, keepdims=True)
    return means.astype(np.float32), stretch(nodes, size).astype(np.float32)


def _moved(light: Singles, columns: float, rows: float) -> Singles:
    """Return a (height, width, 3) picture moved aside by px, dark where it came from."""
    moved = light
    for axis, by in enumerate((rows, columns)):
        size = light.shape[axis]
        whole = min(max(math.floor(by), -size - 1), size)
        source, moved = np.moveaxis(moved, axis, 0), np.zeros_like(light)
        for step, part in ((whole, 1 - (by - math.floor(by))), (whole + 1, by - math.floor(by))):
            here = slice(max(step, 0), max(size + min(step, 0), 0))
            there = slice(max(-step, 0), max(size - max(step, 0), 0))
            np.moveaxis(moved, axis, 0)[here] += np.float32(part) * source[there]
    return moved


def _gains(shares: Singles, full: Any) -> Singles:
    """Return (3,) factors on the channels of a (height, width, 3) picture."""
    some = shares[::2, ::2]
    gains = np.ones(3)
    if full.white_balance == "grey":
        red, green, blue = some.mean(axis=(0, 1), dtype=float)
        gains = np.array([_gain_to(green, red), 1.0, _gain_to(green, blue)])
    elif full.white_balance != "off":
        gains = np.array(full.white_balance)
    if full.auto_gain:
        level = float(np.quantile((some * gains).max(axis=2), full.auto_gain))
        gains = gains * _gain_to(full.white_level, level)
    return gains.astype(np.float32)


def _gain_to(wanted: float, level: float) -> np.float32:
    return np.float32(_MOST_GAIN if level * _MOST_GAIN < wanted else wanted / level)


def shutter(ccd: Ccd, height: int, speed_px_s: float) -> tuple[Floats, Singles]:
    """Return the instants whose light makes a picture while markers move, and the rows' weights.

    Parameters
    ----------
    ccd
        Its exposure time and readout.
    height
        Rows of the picture.
    speed_px_s
        Speed of the fastest marker: it moves at most 0.3 px between two instants.

    Returns
    -------
    offset_s
        (k,) instants, from the middle of the middle row's exposure.
    weights
        (height, k) shares of each row's light; their sum is 1.

    Notes
    -----
    Rows exposed together take the middles of k equal parts of the exposure. Under a rolling shutter
    light changes along a straight line between two instants, and each row takes the mean over its
    own exposure, so that a centroid that moves evenly is exact. The variance of a blur of length l
    is (l^2 - d^2) / 12 in the first case and (l^2 + 2 d^2) / 12 on average in the second, d being
    the motion between two instants.
    """
    full = ccd.spelt_out()
    exposure = full.exposure_ms / 1000
    readout = full.readout_ms / 1000
    moved_px = speed_px_s * (exposure + readout)
    parts = max(1, math.ceil(moved_px / _STEP_PX))
    if readout == 0 or moved_px < _STILL_PX:
        offset = exposure * ((np.arange(parts) + 0.5) / parts - 0.5)
        return offset, np.full((height, parts), 1 / parts, np.float32)
    offset = (exposure + readout) * (np.arange(parts + 1) / parts - 0.5)
    step = (exposure + readout) / parts
    middle = readout * (np.arange(height) / max(height - 1, 1) - 0.5)

    def gathered(until: Floats) -> Floats:
        """Return the integrals of the hat functions about the instants, over ``step``."""
        u = np.clip((until[:, None] - offset) / step, -1, 1)
        integral: Floats = u - u * np.abs(u) / 2
        return integral

    seen = gathered(middle + exposure / 2) - gathered(middle - exposure / 2)
    return offset, (seen * step / exposure).astype(np.float32)


def _segments(function: Callable[[Floats], Floats], octaves: int) -> Segments:
    """Return a function of x in [2^-octaves, 1] as straight pieces, for `_at_segments`.

    The bits of a float32 are the index of its piece. The relative error is the same from 1e-19 to
    1: pieces between the ends of [x, x (1 + 1/64)] are off by x^2 f'' / 32768, 8e-6 of a root.
    """
    ends = np.arange(64 * octaves + 2)
    octave, step = np.divmod(ends, 64)
    x = 2.0 ** (octave - octaves) * (1 + step / 64)
    y = function(np.minimum(x, 1.0))
    slope = np.diff(y) / np.diff(x)
    return np.column_stack([y[:-1] - slope * x[:-1], slope]).astype(np.float32)


@njit(cache=True)
def _at_segments(pieces: Segments, line: Singles) -> None:
    """Replace (n,) arguments by the function's values, with the sign of each; arguments above 1
    count as 1."""
    octaves = (len(pieces) - 1) // 64
    least, least_bits = np.float32(2.0**-octaves), (127 - octaves) << 23
    bits = line.view(np.int32)  # those of positive numbers are in the numbers' order
    for i in range(len(line)):
        size = min(max(abs(line[i]), least), np.float32(1))
        at = (min(max(bits[i] & _POSITIVE, least_bits), _ONE_BITS) - least_bits) >> _SHIFT
        line[i] = np.copysign(pieces[at, 0] + pieces[at, 1] * size, line[i])


@cache
def _normal_deviates() -> Segments:
    """Return the deviate that a share x / 2 of all exceeds, x from 2^-32 to 1."""
    return _segments(lambda x: -ndtri(x / 2), _OCTAVES)


@njit(cache=True)
def _normal_numbers(
    key: NDArray[np.uint64], first: np.uint64, deviates: Segments, out: Singles
) -> None:
    """Write the normal numbers ``first``, ``first`` + 1, ... of a key into (n,) ``out``."""
    start = key[0] + first
    factor = key[1]
    half = np.uint64(32)
    scale = np.float32(2.0**-31)
    for i in range(len(out)):
        y = (start + np.uint64(i)) * factor
        z = y + factor
        x = y * y + y
        x = (x >> half) | (x << half)
        x = x * x + z
        x = (x >> half) | (x << half)
        x = x * x + y
        x = (x >> half) | (x << half)
        word = (x * x + z) >> half
        share = (np.float32(np.int32(word >> np.uint64(1))) + np.float32(0.5)) * scale
        out[i] = share if word & np.uint64(1) else -share
    _at_segments(deviates, out)


@njit(cache=True, fastmath=_REORDER)
def _electron_rows(
    begin: int,
    end: int,
    light: Singles,
    before: Singles,
    weights: Singles,
    response: Singles,
    interlaced: bool,
    colours: Ints,
    gain: Singles,
    dark: Singles,
    key: NDArray[np.uint64],
    deviates: Segments,
    read_e: float,
    well_e: float,
    scratch: Singles,
    out: Singles,
) -> None:
    """Write rows ``begin`` to ``end`` of what the wells hold, in shares of a full one.

    Pictures are (height, 3 width), or (height, width) behind a (2, 2) mosaic of ``colours``; empty
    arrays stand for no mosaic, no fixed pattern and no noise. Electrons are gain light + dark, of
    variance their number, plus read noise, both normal: one number of the summed variance stands
    for both.
    """
    height, span = light.shape
    width = span // 3
    reach = len(weights) // 2
    line, sums, noise = scratch[0], scratch[1], scratch[2]
    inverse = np.float32(1 / well_e)
    floor = np.float32((read_e / well_e) ** 2)
    one, nothing = np.float32(1), np.float32(0)
    for row in range(begin, end):
        # Blur along columns; an interlaced row is the mean of two, even rows of the field before.
        source = before if interlaced and row % 2 == 0 else light
        halves = 2 if interlaced and row + 1 < height else 1
        for i in range(span):
            sums[i] = nothing
        for half in range(halves):
            for step in range(-reach, reach + 1):
                there = source[min(max(row + half + step, 0), height - 1)]
                weight = np.float32(weights[step + reach] / halves)
                for i in range(span):
                    sums[i] += weight * there[i]
        # Mix colours.
        for i in range(width):
            red = sums[3 * i]
            green = sums[3 * i + 1]
            blue = sums[3 * i + 2]
            at = 3 * (reach + i)
            for c in range(3):
                line[at + c] = response[c, 0] * red + response[c, 1] * green + response[c, 2] * blue
        # Blur along the row, edges repeated.
        for i in range(reach):
            for c in range(3):
                line[3 * i + c] = line[3 * reach + c]
                line[3 * (reach + width + i) + c] = line[3 * (reach + width - 1) + c]
        for i in range(span):
            sums[i] = nothing
        for step in range(2 * reach + 1):
            weight = weights[step]
            for i in range(span):
                sums[i] += weight * line[i + 3 * step]
        # Electrons.
        target = out[row]
        if len(colours):
            for i in range(width):
                sums[i] = sums[3 * i + colours[row % 2, i % 2]]
        if len(gain):
            for i in range(len(target)):
                sums[i] = sums[i] * gain[row, i] + dark[row, i]
        if len(key):
            drawn = noise[: len(target)]
            _normal_numbers(key, np.uint64(row * len(target)), deviates, drawn)
            for i in range(len(target)):
                sums[i] += drawn[i] * np.sqrt(max(sums[i], nothing) * inverse + floor)
        for i in range(len(target)):
            target[i] = min(sums[i], one)


@njit(cache=True, fastmath=_REORDER)
def _composite_rows(
    begin: int,
    end: int,
    shares: Singles,
    curve: Segments,
    matrices: Singles,
    filters: tuple[Singles, Singles, Singles],
) -> None:
    """Send rows of (height, 3 width) ``shares`` through a composite line, in place: corrected by
    ``curve`` (none if empty), mixed into three signals by the first of ``matrices``, each blurred
    by its own filter, edges repeated, and mixed back by the second."""
    width = shares.shape[1] // 3
    nothing = np.float32(0)
    longest = 0
    for weights in filters:
        longest = max(longest, len(weights))
    filtered = np.empty((3, width), np.float32)
    signal = np.empty(width + longest, np.float32)
    for row in range(begin, end):
        # Gamma, as the camera applies it before the line.
        line = shares[row]
        for i in range(len(line)):
            line[i] = max(line[i], nothing)
        if len(curve):
            _at_segments(curve, line)
        for c in range(3):
            weights = filters[c]
            r = len(weights) // 2
            # One of Y, I and Q, low-pass filtered to its bandwidth, edges repeated.
            a, b, d = matrices[0, c]
            for i in range(width):
                signal[r + i] = a * line[3 * i] + b * line[3 * i + 1] + d * line[3 * i + 2]
            for i in range(r):
                signal[i] = signal[r]
                signal[r + width + i] = signal[r + width - 1]
            target = filtered[c]
            for i in range(width):
                target[i] = nothing
            for step in range(2 * r + 1):
                weight = weights[step]
                for i in range(width):
                    target[i] += weight * signal[i + step]
        for c in range(3):
            # Back to red, green and blue.
            a, b, d = matrices[1, c]
            for i in range(width):
                line[3 * i + c] = a * filtered[0, i] + b * filtered[1, i] + d * filtered[2, i]


def _demosaic(raw: Singles, colours: Ints) -> Singles:
    """Return (height, width, 3) colours of a mosaic: the mean of the nearest pixels that have each,
    edges reflected. A green pixel has one colour left and right and the other above and below; the
    others have green on all four sides and the third colour at the corners."""
    around = np.pad(raw, 1, mode="reflect")
    sides = around[1:-1, :-2] + around[1:-1, 2:]
    over = around[:-2, 1:-1] + around[2:, 1:-1]
    corners = around[:-2, :-2] + around[:-2, 2:] + around[2:, :-2] + around[2:, 2:]
    half, quarter = np.float32(0.5), np.float32(0.25)
    out = np.empty((*raw.shape, 3), np.float32)
    for row, column in np.ndindex(2, 2):
        own = colours[row, column]
        at = (slice(row, None, 2), slice(column, None, 2))
        out[at][:, :, own] = raw[at]
        if own == 1:
            out[at][:, :, colours[row, 1 - column]] = half * sides[at]
            out[at][:, :, colours[1 - row, column]] = half * over[at]
        else:
            out[at][:, :, 1] = quarter * (sides[at] + over[at])
            out[at][:, :, 2 - own] = quarter * corners[at]
    return out


def _compressed(counts: Picture, quality: int) -> Picture:
    """Return a picture after JPEG compression."""
    from PIL import Image

    stream: Any = io.BytesIO()
    Image.fromarray(counts).save(stream, "JPEG", quality=quality)
    stream.seek(0)
    return np.array(Image.open(stream, formats=("JPEG",)).convert("RGB"))


def _rows(picture: Singles) -> Singles:
    """Return a picture's rows as singles, (height, width * channels)."""
    return np.ascontiguousarray(picture, np.float32).reshape(len(picture), -1)


@lru_cache(maxsize=8)
def _blur_weights(spread_px: float) -> Singles:
    """Return (2 r + 1,) samples of a Gaussian, of sum 1 and variance ``spread_px`` squared."""
    if spread_px == 0:
        return np.ones(1, np.float32)
    reach = int(4 * spread_px + 1)
    squares = np.arange(-reach, reach + 1) ** 2

    def samples(ratio: float) -> Floats:
        """Return weights whose neighbours of the middle are ``ratio`` times the middle."""
        weights = np.power(ratio, squares)
        shares: Floats = weights / weights.sum()
        return shares

    # by halves: scipy.optimize takes long to import, and no run needs it before
    low, high = 0.0, 1.0
    while low < (ratio := (low + high) / 2) < high:
        narrow = samples(ratio) @ squares < spread_px**2
        low, high = (ratio, high) if narrow else (low, ratio)
    singles: Singles = samples(ratio).astype(np.float32)
    return singles


@lru_cache(maxsize=8)
def _gamma_curve(gamma: float) -> Segments:
    """Return share^(1 / gamma) as pieces, none for a linear CCD."""
    return _LINEAR if gamma == 1 else _segments(lambda share: share ** (1 / gamma), 64)


def _check(
    radiance: Singles, mosaic: Ints | None, pattern: Pattern | None, before: Singles | None
) -> None:
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise InputError(f"radiance has shape {radiance.shape}; it must be (height, width, 3)")
    if before is not None and before.shape != radiance.shape:
        raise InputError(
            f"the light before has shape {before.shape}; it must be that of radiance, "
            f"{radiance.shape}"
        )
    wanted = (*radiance.shape[:2], 3 if mosaic is None else 1)
    if pattern is not None and pattern.gain.shape != wanted:
        raise InputError(
            f"the pattern has shape {pattern.gain.shape}; this CCD's pictures need {wanted}"
        )
