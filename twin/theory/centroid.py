"""How well a marker's place in a picture can be known, in closed form: the Cramer-Rao bound of a blurred disc.

A disc of radius R and contrast A, blurred by a Gaussian of standard deviation s that is small against R, changes only
at its rim: df/dx = A cos(angle) g(r - R), g the Gaussian's density. With noise of standard deviation n a pixel there,
the Fisher information of x is

    I = int (df/dx)^2 / n^2 = A^2 / n^2  pi R  int g^2 dr = A^2 R sqrt(pi) / (2 s n^2),

and no unbiased estimate of x has a smaller standard deviation than I^(-1/2) (H. Cramer 1946). A square pixel adds 1/12
to s^2. Inside and outside the disc the picture is even and tells nothing, so only the noise of the rim counts.

Validity: R well above s (at R = 2 s it is 3 % off, `tests/theory/test_centroid.py`), one channel, markers apart, a disc
of even brightness. What real markers and trackers add is a factor, see `twin.study.sweep.noise`.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats

PIXEL_VARIANCE = 1.0 / 12.0
"""Of a square pixel, px^2."""


def centre_bound(diameter_px: Floats, contrast: float, psf_px: float, noise: float) -> Floats:
    """Return the least standard deviation of a disc's centre, per axis, px.

    Parameters
    ----------
    diameter_px
        Of the discs.
    contrast
        Its brightness over the ground's, in any unit.
    psf_px
        Standard deviation of the blur.
    noise
        Standard deviation of a pixel at the disc's rim, in the contrast's unit.
    """
    radius = np.asarray(diameter_px, float) / 2
    blur = np.sqrt(np.asarray(psf_px, float) ** 2 + PIXEL_VARIANCE)
    information = (np.asarray(contrast) / noise) ** 2 * radius * np.sqrt(np.pi) / (2 * blur)
    return np.asarray(information**-0.5)


def pixel_sd(counts: float, full_scale: float, full_well_e: float, read_noise_e: float) -> float:
    """Return the standard deviation of a pixel, counts: shot, read and rounding noise.

    Parameters
    ----------
    counts
        Of the pixel; halfway up a marker's rim the mean of its own and the ground's.
    full_scale
        Counts of a full well.
    full_well_e, read_noise_e
        Electrons.
    """
    gain = full_well_e / full_scale
    return float(np.sqrt((counts * gain + read_noise_e**2) / gain**2 + 1 / 12))
