"""The CCD: from light on the sensor to 8-bit counts.

The chain is the order of the hardware: colour filters and blur by the optics, the mosaic, electrons with shot and read
noise, dark current and the pixels' own gains and offsets (EMVA 1288, sec. 2 and 4), full wells, interpolation of the
mosaic, gamma, video, 8 bits, compression. It acts on the rendered light, not inside the renderer, so one picture can be
exposed many times.

Why noise is drawn in fixed parts: every part has a generator of its own, so that threads share the work and the bytes
stay the same on any number of them.

Validity: shot noise is the normal approximation of Poisson's law, good above some 20 electrons; darker pixels are
governed by read noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Picture, Singles
from twin.errors import InputError
from twin.parts.ccd import Ccd
from twin.world.readout import blur_columns, blur_rows, counts_rows, demosaic_rows, expose_rows, mosaic_rows
from twin.world.threads import in_parts
from twin.world.video import composite, compress, interlace

FULL_SCALE = 255
_COLOURS = {"r": 0, "g": 1, "b": 2}


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
    light = _through_the_lens(radiance, full)
    if full.interlace:
        light = interlace(light, light if before is None else _through_the_lens(before, full))
    colours = mosaic_of(full)
    if colours is not None:
        light = _on_rows(mosaic_rows, light, colours, out=np.empty((*light.shape[:2], 1), np.float32))
    none = np.zeros((0, 0, 0), np.float32)
    noise = _normal_numbers(light.shape, rng) if full.noise else none
    gain, dark = (pattern.gain, pattern.dark) if pattern is not None and full.noise else (none, none)
    in_parts(len(light), lambda _, begin, end: expose_rows(
        begin, end, light, gain, dark, noise, full.read_noise_e, full.full_well_e))  # fmt: skip
    if colours is not None:
        light = _on_rows(demosaic_rows, light, colours, out=np.empty((*light.shape[:2], 3), np.float32))
    gamma = full.gamma
    if full.bandwidth_mhz is not None:
        light, gamma = composite(np.maximum(light, 0) ** np.float32(1 / gamma), full.bandwidth_mhz), 1.0
    least, guess = _steps(gamma, full.black_dn or 0.0)
    counts = np.empty(light.shape, np.uint8)
    in_parts(len(light), lambda _, begin, end: counts_rows(begin, end, light, least, guess, counts))
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


def _through_the_lens(radiance: Singles, ccd: Ccd) -> Singles:
    """Return the light behind lens and colour filters, in an array of its own."""
    assert ccd.psf_px is not None
    light: Singles = np.ascontiguousarray(radiance, np.float32)
    response = response_matrix(ccd).astype(np.float32)
    weights = _weights(ccd.psf_px)
    mixed: Singles = _on_rows(blur_columns, light, weights, response, out=np.empty_like(light))
    return _on_rows(blur_rows, mixed, weights, out=np.empty_like(light)) if len(weights) > 1 else mixed


def _on_rows(work: Callable[..., None], light: Singles, *more: object, out: Singles) -> Singles:
    in_parts(len(light), lambda _, begin, end: work(begin, end, light, *more, out))
    return out


def _weights(spread_px: float) -> NDArray[np.float32]:
    """Return (2 r + 1,) samples of a Gaussian that sum to 1, out to four standard deviations."""
    steps = np.arange(-int(4 * spread_px + 0.5), int(4 * spread_px + 0.5) + 1)
    weights = np.exp(-(steps**2) / (2 * spread_px**2)) if spread_px > 0 else np.ones(1)
    singles: NDArray[np.float32] = (weights / weights.sum()).astype(np.float32)
    return singles


def _normal_numbers(shape: tuple[int, ...], rng: np.random.Generator) -> Singles:
    """Return standard normal numbers, drawn part by part of the rows."""
    root = int(rng.integers(2**63))
    noise: Singles = np.empty(shape, np.float32)

    def some(part: int, begin: int, end: int) -> None:
        own = np.random.Generator(np.random.SFC64(np.random.SeedSequence(root, spawn_key=(part,))))
        own.standard_normal(dtype=np.float32, out=noise[begin:end])

    in_parts(shape[0], some)
    return noise


@lru_cache(maxsize=8)
def _steps(gamma: float, black_dn: float) -> tuple[Floats, NDArray[np.uint8]]:
    """Return (256,) the least share of each count, and a table that nearly gives the count of a share."""
    edges = (np.arange(256) - 0.5 - black_dn) / (FULL_SCALE - black_dn)
    least = np.sign(edges) * np.abs(edges) ** gamma
    shares = np.arange(4096) / 4095
    guess: NDArray[np.uint8] = np.clip(np.searchsorted(least, shares, side="right") - 1, 0, 255).astype(np.uint8)
    return least, guess


def _check(radiance: Singles, ccd: Ccd, pattern: Pattern | None, before: Singles | None) -> None:
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise InputError(f"radiance has shape {radiance.shape}; it must be (height, width, 3)")
    if before is not None and before.shape != radiance.shape:
        raise InputError(f"the light before has shape {before.shape}; it must be that of radiance, {radiance.shape}")
    channels = 1 if mosaic_of(ccd.spelt_out()) is not None else 3
    if pattern is not None and pattern.gain.shape != (*radiance.shape[:2], channels):
        wanted = (*radiance.shape[:2], channels)
        raise InputError(f"the pattern has shape {pattern.gain.shape}; this CCD's pictures need {wanted}")
