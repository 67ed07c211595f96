"""EMVA 1288 of the program's own flat fields, against the electrons that presets and recipes state."""

import numpy as np
import pytest

from twin.errors import RecipeError
from twin.parts.camera import PRESETS, Ccd
from twin.study.photon_transfer import photon_transfer


@pytest.mark.parametrize("preset", [name for name, values in PRESETS.items() if values["noise"]])
def test_a_presets_chip_has_the_electrons_that_it_states(preset):
    full = Ccd(preset=preset).spelt_out()
    found = photon_transfer(full)
    dark = np.sqrt(full.read_noise_e**2 + full.dark_current_e_s * full.exposure_ms / 1000)
    # the black level takes a few of the 255 counts
    assert found.gain_dn_e == pytest.approx(252 / full.full_well_e, rel=0.01)
    assert found.dark_variance_dn2 >= 0.24
    assert found.dark_noise_e == pytest.approx(dark, rel=0.03)
    assert 0.94 * full.full_well_e < found.saturation_e < 1.01 * full.full_well_e
    assert found.snr_max == pytest.approx(np.sqrt(found.saturation_e))
    assert found.linearity_pct < 0.02
    assert found.prnu_pct == pytest.approx(full.prnu_pct, abs=0.06)
    assert found.dsnu_e == pytest.approx(full.dsnu_e, abs=0.7)


def test_what_a_recipe_adds_to_a_chip_is_found():
    noisy = Ccd(read_noise_e=60.0, dark_current_e_s=1e5, row_noise_e=40.0, column_noise_e=50.0, dsnu_e=30.0, gamma=2.2,
                quantum_efficiency=(0.5, 0.7, 1.0), jpeg_quality=60, bayer="rggb")  # fmt: skip
    found = photon_transfer(noisy)
    assert found.dark_noise_e == pytest.approx(np.sqrt(60**2 + 1000 + 40**2), rel=0.03)
    assert found.dsnu_e == pytest.approx(np.hypot(30, 50), rel=0.05)
    assert found.linearity_pct < 0.05


def test_noise_that_eight_bits_hide_is_said_to_be_hidden():
    hidden = Ccd(full_well_e=60000.0)
    found = photon_transfer(hidden)
    lines = {line.split()[0]: line for line in found.lines(hidden)}
    assert "unknown electrons, stated 32; variance" in lines["dark"]
    assert "too little, hidden by rounding" in lines["dark"]
    assert np.isnan(found.dark_noise_e)


@pytest.mark.parametrize("bits", [10, 12])
def test_more_bits_show_the_noise_that_eight_hide(bits):
    found = photon_transfer(Ccd(full_well_e=60000.0, bits=bits))
    assert found.gain_dn_e == pytest.approx((2**bits - 1) / 60000, rel=0.01)
    assert found.dark_noise_e == pytest.approx(32, rel=0.02)
    assert found.dark_variance_dn2 == pytest.approx((32 * found.gain_dn_e) ** 2 + 1 / 12, rel=0.02)
    assert found.linearity_pct < 0.01


def test_a_camera_without_noise_is_refused():
    with pytest.raises(RecipeError, match="noise = false: electrons are counted by their noise"):
        photon_transfer(Ccd(preset="ideal"))
