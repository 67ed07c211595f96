"""The CCD: from light on the sensor to 8-bit counts.

The chain is the order of the hardware: colour filters and blur by the optics, the mosaic, electrons with shot and read
noise, dark current and the pixels' own gains and offsets (EMVA 1288, sec. 2 and 4), full wells, interpolation of the
mosaic, gamma, video, 8 bits, compression. It acts on the rendered light, not inside the renderer, so one picture can be
exposed many times.

Why each pixel's noise has a number (`twin.world.picture.noise`): threads share the work, and the bytes stay the same on
any number of them.

Validity: shot noise is the normal approximation of Poisson's law, good above some 20 electrons; darker pixels are
governed by read noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Picture, Singles
from twin.errors import InputError
from twin.parts.ccd import Ccd
from twin.world.picture.noise import noise_key, normal_deviates
from twin.world.picture.readout import composite_rows, counts_rows, demosaic_rows, shares_rows
from twin.world.picture.segments import Segments, segments
from twin.world.picture.threads import in_parts
from twin.world.picture.video import YIQ, compress, spreads_px

FULL_SCALE = 255
_COLOURS = {"r": 0, "g": 1, "b": 2}
_NOTHING = np.zeros((0, 0, 0), np.float32)
_LINEAR: Segments = np.zeros((0, 2), np.float32)


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """What is the same in every picture of one sensor, drawn once.

    Attributes
    ----------
    gain, dark
        (height, width, channels) factor on each pixel's light, and dark signal in shares of a full well.
    """

    gain: Singles
    dark: Singles


def fixed_pattern(ccd: Ccd, shape: tuple[int, int], rng: np.random.Generator) -> Pattern | None:
    """Draw the pixels' own gains and dark signals; None for a CCD without any.

    Parameters
    ----------
    ccd
        The CCD.
    shape
        Height and width, px.
    rng
        Source of the pattern.
    """
    ccd = ccd.spelt_out()
    assert ccd.prnu_pct is not None
    assert ccd.dsnu_e is not None
    assert ccd.dark_current_e_s is not None
    assert ccd.exposure_ms is not None
    assert ccd.full_well_e is not None
    gathered = ccd.dark_current_e_s * ccd.exposure_ms / 1000
    if not ccd.noise or (ccd.prnu_pct == 0 and ccd.dsnu_e == 0 and gathered == 0):
        return None
    size = (*shape, 1 if ccd.bayer != "none" else 3)
    gain = 1 + np.float32(ccd.prnu_pct / 100) * rng.standard_normal(size, np.float32)
    dark = np.float32(gathered) + np.float32(ccd.dsnu_e) * rng.standard_normal(size, np.float32)
    return Pattern(gain=gain, dark=dark / np.float32(ccd.full_well_e))


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
        (height, width, 3) light on the sensor, red, green, blue; 1 fills the wells at ``exposure`` 1.
    ccd
        The CCD.
    rng
        Source of the noise; nothing is drawn for a CCD without noise.
    pattern
        The pixels' own gains and dark signals, of `fixed_pattern`.
    before
        The light a field earlier, for an interlaced CCD; None: the same.

    Returns
    -------
    (height, width, 3) counts.

    Raises
    ------
    InputError
        Not a colour picture, or a pattern or earlier light of another size.
    """
    _check(radiance, ccd, pattern, before)
    full = ccd.spelt_out()
    assert full.read_noise_e is not None
    assert full.full_well_e is not None
    assert full.gamma is not None
    assert full.psf_px is not None
    height, width, _ = radiance.shape
    light: Singles = np.ascontiguousarray(radiance, np.float32)
    earlier = light if before is None else np.ascontiguousarray(before, np.float32)
    mosaic = mosaic_of(full)
    colours = np.zeros((0, 2), np.int64) if mosaic is None else mosaic
    gain, dark = (pattern.gain, pattern.dark) if pattern is not None and full.noise else (_NOTHING, _NOTHING)
    key = noise_key(rng) if full.noise else np.zeros(0, np.uint64)
    weights, response = _weights(full.psf_px), response_matrix(full).astype(np.float32)
    shares: Singles = np.empty((height, width, 3 if mosaic is None else 1), np.float32)
    in_parts(height, lambda _, begin, end: shares_rows(
        begin, end, light, earlier, weights, response, full.interlace, colours, gain, dark, key, normal_deviates(),
        full.read_noise_e, full.full_well_e, shares))  # fmt: skip
    if mosaic is not None:
        raw, shares = shares, np.empty((height, width, 3), np.float32)
        in_parts(height, lambda _, begin, end: demosaic_rows(begin, end, raw, mosaic, shares))
    curve = _gamma_curve(full.gamma)
    if full.bandwidth_mhz is not None:
        filters = tuple(_weights(spread) for spread in spreads_px(full.bandwidth_mhz, width))
        into, out_of = YIQ.astype(np.float32), np.linalg.inv(YIQ).astype(np.float32)
        correction, curve = curve, _LINEAR
        in_parts(height, lambda _, begin, end: composite_rows(begin, end, shares, correction, into, out_of, filters))
    counts = np.empty((height, width, 3), np.uint8)
    in_parts(height, lambda _, begin, end: counts_rows(begin, end, shares, curve, full.black_dn or 0.0, counts))
    return counts if full.jpeg_quality is None else compress(counts, full.jpeg_quality)


def response_matrix(ccd: Ccd) -> Floats:
    """Return the (3, 3) matrix from red, green and blue light to the camera's channels, quantum efficiency included.

    An even crosstalk's rows sum to 1 before the quantum efficiencies, which count relative to the largest.
    """
    told, efficiency = ccd.crosstalk, np.asarray(ccd.spelt_out().quantum_efficiency, float)
    mixing = np.full((3, 3), told) + (1 - 3 * told) * np.eye(3) if isinstance(told, float) else np.array(told)
    response: Floats = mixing * (efficiency / efficiency.max())[:, None]
    return response


def white_level(ccd: Ccd) -> float:
    """Return the light (share of full wells) whose count is the CCD's ``white_dn``, times its ``exposure``."""
    full = ccd.spelt_out()
    assert full.gamma is not None
    black = full.black_dn or 0.0
    share = max(ccd.white_dn - black, 1.0) / (FULL_SCALE - black)
    return float(share**full.gamma) * ccd.exposure


def mosaic_of(ccd: Ccd) -> Ints | None:
    """Return the (2, 2) colours of the mosaic, 0 red, 1 green, 2 blue; None for none."""
    if ccd.bayer is None or ccd.bayer == "none":
        return None
    return np.array([_COLOURS[letter] for letter in ccd.bayer]).reshape(2, 2)


def _weights(spread_px: float) -> NDArray[np.float32]:
    """Return (2 r + 1,) samples of a Gaussian that sum to 1, out to four standard deviations."""
    reach = int(4 * spread_px + 0.5)
    steps = np.arange(-reach, reach + 1)
    weights = np.exp(-(steps**2) / (2 * spread_px**2)) if reach else np.ones(1)
    singles: NDArray[np.float32] = (weights / weights.sum()).astype(np.float32)
    return singles


@lru_cache(maxsize=8)
def _gamma_curve(gamma: float) -> Segments:
    """Return share^(1 / gamma) as pieces, none for a linear CCD."""
    return _LINEAR if gamma == 1 else segments(lambda share: share ** (1 / gamma), 64)


def _check(radiance: Singles, ccd: Ccd, pattern: Pattern | None, before: Singles | None) -> None:
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise InputError(f"radiance has shape {radiance.shape}; it must be (height, width, 3)")
    if before is not None and before.shape != radiance.shape:
        raise InputError(f"the light before has shape {before.shape}; it must be that of radiance, {radiance.shape}")
    channels = 1 if mosaic_of(ccd.spelt_out()) is not None else 3
    if pattern is not None and pattern.gain.shape != (*radiance.shape[:2], channels):
        wanted = (*radiance.shape[:2], channels)
        raise InputError(f"the pattern has shape {pattern.gain.shape}; this CCD's pictures need {wanted}")
