"""The bound of a disc's centre against the Fisher information of a picture, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from twin.theory.centroid import centre_bound, pixel_sd


def fisher_sd(diameter: float, contrast: float, psf: float, noise: float) -> float:
    """Return the bound from a picture of a disc: fine samples blurred by the Gaussian, summed into pixels."""
    fine, half = 8, int(diameter) + 4
    place = (np.arange(2 * half * fine) + 0.5) / fine - half
    disc = np.hypot(place[:, None], place[None]) <= diameter / 2
    spread = np.arange(-6 * fine, 6 * fine + 1) / fine
    kernel = ndtr((spread + 0.5 / fine) / psf) - ndtr((spread - 0.5 / fine) / psf)
    blurred = np.apply_along_axis(np.convolve, 0, disc.astype(float), kernel, "same")
    blurred = np.apply_along_axis(np.convolve, 1, blurred, kernel, "same")
    total = 0.0
    for phase in range(fine):  # the mean over where the disc lies on the pixels
        slope = (np.roll(blurred, 1, axis=1) - np.roll(blurred, -1, axis=1)) * fine / 2
        pixels = np.roll(slope, phase, axis=1).reshape(2 * half, fine, 2 * half, fine).mean(axis=(1, 3))
        total += (contrast * pixels**2 * contrast).sum() / noise**2 / fine
    return float(total**-0.5)


@pytest.mark.parametrize(("diameter", "psf"), [(10.0, 0.7), (15.0, 0.7), (10.0, 1.2), (6.0, 0.6)])
def test_the_bound_is_that_of_the_pictures_fisher_information(diameter: float, psf: float) -> None:
    numeric = fisher_sd(diameter, 150.0, psf, 1.5)
    assert float(centre_bound(np.array(diameter), 150.0, psf, 1.5)) == pytest.approx(numeric, rel=0.03)


def test_more_light_less_blur_and_wider_markers_tell_more() -> None:
    base = float(centre_bound(np.array(10.0), 100.0, 0.7, 1.0))
    assert float(centre_bound(np.array(20.0), 100.0, 0.7, 1.0)) == pytest.approx(base / np.sqrt(2))
    assert float(centre_bound(np.array(10.0), 200.0, 0.7, 1.0)) == pytest.approx(base / 2)
    assert float(centre_bound(np.array(10.0), 100.0, 1.4, 1.0)) > 1.3 * base


def test_a_pixels_noise_is_shot_read_and_rounding_noise() -> None:
    electrons_per_count = 20000 / 255
    wanted = np.sqrt((110 * electrons_per_count + 12**2) / electrons_per_count**2 + 1 / 12)
    assert pixel_sd(110.0, 255.0, 20000.0, 12.0) == pytest.approx(wanted)
