"""The CCD: from light on the sensor to 8-bit counts.

The chain is the order of the hardware: blur by the optics, mixing by the colour filters, electrons with shot and read
noise (EMVA 1288, sec. 2), saturation, gamma, 8 bits. It acts on the rendered light, not inside the renderer, so one
picture can be exposed many times.

Validity: shot noise is the normal approximation of Poisson's law, good above some 20 electrons; darker pixels are
governed by read noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from twin.arrays import Floats, Picture
from twin.errors import InputError
from twin.parts.ccd import Ccd

FULL_SCALE = 255


def expose(radiance: NDArray[np.float32], ccd: Ccd, rng: np.random.Generator) -> Picture:
    """Expose one picture.

    Parameters
    ----------
    radiance
        (height, width, 3) light on the sensor, red, green, blue; 1 fills the wells.
    ccd
        The CCD.
    rng
        Source of the noise; one draw per pixel and channel whatever the light, none from a CCD without noise.

    Returns
    -------
    (height, width, 3) counts.

    Raises
    ------
    InputError
        Not a colour picture.
    """
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise InputError(f"radiance has shape {radiance.shape}; it must be (height, width, 3)")
    ccd = ccd.spelt_out()
    assert ccd.psf_px is not None
    assert ccd.gamma is not None
    light = np.asarray(radiance, np.float32)
    if ccd.crosstalk > 0:
        light = light @ crosstalk_matrix(ccd.crosstalk).T.astype(np.float32)
    if ccd.psf_px > 0:
        for axis in (0, 1):
            light = gaussian_filter1d(light, ccd.psf_px, axis=axis, mode="nearest")
    if ccd.noise:
        light = _noisy(light, ccd, rng)
    share = np.clip(light, 0, 1)
    if ccd.gamma != 1:
        share **= np.float32(1 / ccd.gamma)
    share *= FULL_SCALE
    counts: Picture = np.rint(share, out=share).astype(np.uint8)
    return counts


def crosstalk_matrix(crosstalk: float) -> Floats:
    """Return the (3, 3) matrix by which the colour filters mix red, green and blue; its rows sum to 1."""
    return np.full((3, 3), crosstalk) + (1 - 3 * crosstalk) * np.eye(3)


def white_level(ccd: Ccd) -> float:
    """Return the light (share of full wells) whose count is the CCD's ``white_dn``."""
    gamma = ccd.spelt_out().gamma
    assert gamma is not None
    return float((ccd.white_dn / FULL_SCALE) ** gamma)


def _noisy(light: NDArray[np.float32], ccd: Ccd, rng: np.random.Generator) -> NDArray[np.float32]:
    """Add noise of variance light/full_well + (read/full_well)^2."""
    assert ccd.full_well_e is not None
    assert ccd.read_noise_e is not None
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    spread = np.maximum(light, 0)
    spread *= np.float32(1 / ccd.full_well_e)
    spread += np.float32((ccd.read_noise_e / ccd.full_well_e) ** 2)
    np.sqrt(spread, out=spread)
    noise *= spread
    noise += light
    return noise
