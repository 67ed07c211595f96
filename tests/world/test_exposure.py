"""The CCD against photon transfer, blur and colour mixing it states."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.ccd import Ccd
from twin.world.exposure import crosstalk_matrix, expose, white_level

IDEAL = Ccd(preset="ideal", crosstalk=0.0)


def even(level: float, size: int = 200) -> np.ndarray:
    return np.full((size, size, 3), level, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_photon_transfer_slope_and_floor_are_full_well_and_read_noise() -> None:
    # EMVA 1288: variance of the electrons = mean + read noise^2; in counts scaled by 255 / full well, plus 1/12.
    ccd = Ccd(psf_px=0.0, crosstalk=0.0, full_well_e=2000.0, read_noise_e=20.0)
    gain = 255 / 2000.0
    for level in (0.2, 0.4, 0.7):
        counts = expose(even(level), ccd, rng()).astype(float)
        expected = gain**2 * (level * 2000 + 20**2) + 1 / 12
        assert counts.mean() == pytest.approx(255 * level, abs=0.15)
        # 120 000 pixels: the variance is known to 0.4 %.
        assert counts.var() == pytest.approx(expected, rel=0.02)


def test_noise_has_no_pattern() -> None:
    counts = expose(even(0.5), Ccd(psf_px=0.7, crosstalk=0.0), rng()).astype(float)
    counts -= counts.mean()
    for a, b in ((counts[1:], counts[:-1]), (counts[:, 1:], counts[:, :-1]), (counts[..., 0], counts[..., 1])):
        assert abs((a * b).mean() / counts.var()) < 0.02


def test_an_ideal_ccd_only_rounds() -> None:
    light = np.linspace(-0.1, 1.2, 30 * 40 * 3, dtype=np.float32).reshape(30, 40, 3)
    counts = expose(light, IDEAL, rng())
    assert counts.dtype == np.uint8
    np.testing.assert_array_equal(counts, np.rint(255 * np.clip(light, 0, 1)))


def test_same_seed_same_bytes_and_the_light_is_left_alone() -> None:
    light = np.random.default_rng(1).uniform(0, 1, (50, 60, 3)).astype(np.float32)
    before = light.copy()
    first, second = expose(light, Ccd(), rng()), expose(light, Ccd(), rng())
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(light, before)
    assert (expose(light, Ccd(), np.random.default_rng(4)) != first).any()


def test_psf_spreads_a_point_by_its_width_and_keeps_its_light() -> None:
    light = np.zeros((41, 41, 3), np.float32)
    light[20, 20] = 1
    ccd = IDEAL.model_copy(update={"psf_px": 2.0})
    counts = expose(light * 20, ccd, rng())[..., 0].astype(float)
    offsets = np.arange(41) - 20.0
    assert counts.sum() == pytest.approx(20 * 255, rel=0.02)
    assert (counts.sum(axis=0) * offsets**2).sum() / counts.sum() == pytest.approx(4, rel=0.05)
    assert (counts.sum(axis=1) * offsets).sum() == pytest.approx(0, abs=1e-9)


def test_crosstalk_leaks_its_share_into_each_other_channel() -> None:
    counts = expose(
        even(0.0, 8) + np.array([0.8, 0, 0], np.float32), IDEAL.model_copy(update={"crosstalk": 0.1}), rng()
    )
    np.testing.assert_allclose(counts[0, 0], 255 * np.array([0.64, 0.08, 0.08]), atol=0.5)
    np.testing.assert_allclose(crosstalk_matrix(0.07).sum(axis=1), 1)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_white_level_is_exposed_to_white_dn(gamma: float) -> None:
    ccd = Ccd(preset="ideal", gamma=gamma, white_dn=180)
    assert expose(even(white_level(ccd), 4), ccd, rng())[0, 0, 0] == 180


def test_a_grey_picture_is_refused() -> None:
    with pytest.raises(InputError, match="height, width, 3"):
        expose(np.zeros((4, 4), np.float32), Ccd(), rng())
