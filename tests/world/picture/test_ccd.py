"""The CCD against photon transfer, blur and colour mixing it states."""

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import ndtr, ndtri

from twin.errors import InputError
from twin.parts.camera import PRESETS, Ccd
from twin.world.picture.ccd import Pattern, expose


def ideal(**keys):
    return Ccd(**{"preset": "ideal", "crosstalk": 0.0, **keys})


IDEAL = ideal()


def even(level, size=200):
    return np.full((size, size, 3), level, np.float32)


def rng():
    return np.random.default_rng(3)


def deviates(seed, height=683):
    """Return noise in counts, of a standard deviation of 25 about 127.5, and how many of these one count is."""
    noisy = ideal(noise=True, full_well_e=255e6 / 25, read_noise_e=1e6)
    return (expose(np.full((height, 1024, 3), 0.5, np.float32), noisy, np.random.default_rng(seed)) - 127.5) / 25


def test_noise_is_normal_out_to_its_tails_and_no_number_depends_on_another():
    """Moments and tails, to 4.5 standard deviations, of four million numbers of two keys."""
    numbers = np.stack([deviates(seed) for seed in (1, 2)])
    for power, expected, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs((numbers**power).mean() - expected) < 4 * np.sqrt(variance / numbers.size) + 1e-3 * power
    for limit in (0.0, 0.52, 1.0, 2.0, 3.0, 4.0, 4.48):  # whole numbers of counts from the middle
        share = ndtr(-limit)
        for side in (numbers > limit, numbers < -limit):
            assert abs(side.mean() - share) < 4 * np.sqrt(share / numbers.size)
    # Neighbours, the next rows, the other colour, the other key: signs and sizes.
    pairs = [(numbers[:, :, 1:], numbers[:, :, :-1]), (numbers[..., 0], numbers[..., 1]), tuple(numbers)]
    pairs += [(numbers[:, n:], numbers[:, :-n]) for n in (1, 2)]
    for a, b in pairs:
        for one, two in ((a, b), (a**2 - 1, b**2 - 1)):
            assert abs((one * two).mean()) < 4 * one.std() * two.std() / np.sqrt(one.size)
    assert len(np.unique(numbers[0], axis=0)) == 683


def test_squares_gives_its_authors_words():
    """The hash as published (arXiv:2004.06278, section 3), in Python's whole numbers."""
    first, key = map(int, np.random.default_rng(5).integers(2**64, size=2, dtype=np.uint64))
    key |= 1
    found = deviates(5, 1).ravel()
    for i, deviate in enumerate(found[:100]):
        y = (first + i) * key % 2**64
        z, x = (y + key) % 2**64, y
        for add in (y, z, y):
            x = (x * x + add) % 2**64
            x = (x >> 32) | (x << 32) % 2**64
        word = (x * x + z) % 2**64 >> 32
        exact = -ndtri(((word >> 1) + 0.5) / 2**32) * (1 if word & 1 else -1)
        assert deviate == pytest.approx(exact, abs=0.0201)  # half a count


@pytest.mark.parametrize("gamma", [0.7, 1.0, 2.2])
def test_an_ideal_ccd_only_rounds_the_exact_curve(gamma):
    light = np.linspace(-0.1, 1.2, 300 * 400 * 3, dtype=np.float32).reshape(300, 400, 3)
    counts = expose(light, ideal(gamma=gamma), rng())
    assert counts.dtype == np.uint8
    assert np.abs(counts - 255 * np.clip(light, 0, 1).astype(float) ** (1 / gamma)).max() < 0.505


def test_same_seed_same_bytes_and_the_light_is_left_alone():
    light = np.random.default_rng(1).uniform(0, 1, (50, 60, 3)).astype(np.float32)
    before = light.copy()
    first, second = expose(light, Ccd(), rng()), expose(light, Ccd(), rng())
    assert_array_equal(first, second)
    assert_array_equal(light, before)
    assert (expose(light, Ccd(), np.random.default_rng(4)) != first).any()


def test_psf_spreads_a_point_by_its_width_and_keeps_its_light():
    light = np.zeros((41, 41, 3), np.float32)
    light[20, 20] = 1
    ccd = ideal(psf_px=2.0)
    counts = expose(light * 20, ccd, rng())[..., 0].astype(float)
    offsets = np.arange(41) - 20.0
    assert counts.sum() == pytest.approx(20 * 255, rel=0.02)
    assert (counts.sum(axis=0) * offsets**2).sum() / counts.sum() == pytest.approx(4, rel=0.05)
    assert (counts.sum(axis=1) * offsets).sum() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("psf_px", "largest"), [(0.3, 0.08), (0.5, 0.075), (0.7, 0.04), (1.0, 0.02)])
def test_an_edge_is_blurred_by_the_point_spread_and_once_by_the_pixel(psf_px, largest):
    """The edge-spread function integrates the Gaussian's over a pixel (ISO 12233)."""
    phase = (np.arange(64) + 0.5) / 64 - 0.5
    column = np.arange(25) - 12.0
    away = column[None, :] - phase[:, None]
    light = np.repeat(np.clip(away + 0.5, 0, 1)[:, :, None], 3, axis=2).astype(np.float32)
    ccd = ideal(psf_px=psf_px)
    found = np.empty(away.shape)
    for row, edge in enumerate(light):  # each a picture of its own, so that rows are even
        found[row] = expose(np.tile(edge, (3, 1, 1)), ccd, rng())[1, :, 0] / 255

    def area(x):
        """Integral of the normal distribution's function."""
        return psf_px * (x / psf_px * ndtr(x / psf_px) + np.exp(-((x / psf_px) ** 2) / 2) / np.sqrt(2 * np.pi))

    exact = area(away + 0.5) - area(away - 0.5)
    assert np.abs(found - exact).max() < largest
    # The second moment of the line-spread function, by parts.
    order = np.argsort(away.ravel())
    x, rise = away.ravel()[order], found.ravel()[order]
    moment = 2 * np.sum(np.abs(x) * np.where(x < 0, rise, 1 - rise)) / 64
    assert np.sqrt(moment - 1 / 12) == pytest.approx(psf_px, rel=0.02)


@pytest.mark.parametrize("psf_px", [5e-324, 1e-200, 1e-12])
def test_a_psf_next_to_nothing_is_none(psf_px):
    light = np.linspace(0, 200, 41 * 41 * 3, dtype=np.float32).reshape(41, 41, 3)
    blurred = expose(light, ideal(psf_px=psf_px), rng())
    assert_array_equal(blurred, expose(light, IDEAL, rng()))


def test_crosstalk_leaks_its_share_into_each_other_channel():
    counts = expose(even(0.0, 8) + np.array([0.8, 0, 0], np.float32), ideal(crosstalk=0.1), rng())
    assert_allclose(counts[0, 0], 255 * np.array([0.64, 0.08, 0.08]), atol=0.5)
    assert_allclose(Ccd(crosstalk=0.07).response.sum(axis=1), 1)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_white_level_is_exposed_to_white_dn(gamma):
    ccd = Ccd(preset="ideal", gamma=gamma, white_dn=180)
    assert expose(even(ccd.white_level, 4), ccd, rng())[0, 0, 0] == 180


@pytest.mark.parametrize("preset", ["ideal", "industrial", "kamiyama_ntsc", "sato_60fps"])
def test_the_number_of_threads_changes_no_byte(preset, monkeypatch):
    light = np.random.default_rng(1).uniform(0, 1, (61, 80, 3)).astype(np.float32)
    ccd = Ccd(preset=preset)
    pattern = Pattern.drawn(ccd, (61, 80), rng())
    found = []
    for count in (1, 2):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", count)
        found.append(expose(light, ccd, rng(), pattern))
    assert_array_equal(*found)


def test_the_pattern_is_one_sensors_and_only_if_there_is_noise():
    ccd = Ccd(prnu_pct=1.0)
    one, two = (Pattern.drawn(ccd, (20, 30), rng()) for _ in range(2))
    assert_array_equal(one.gain, two.gain)
    assert Pattern.drawn(Ccd(), (20, 30), rng()) is None
    assert Pattern.drawn(Ccd(preset="ideal", prnu_pct=1.0), (20, 30), rng()) is None
    for light, keys, named in (
        (even(0.5), {"pattern": one}, r"pattern has shape \(20, 30, 3\)"),
        (even(0.5), {"before": even(0.5, 15)}, "light before"),
        (np.zeros((4, 4), np.float32), {}, "height, width, 3"),
    ):
        with pytest.raises(InputError, match=named):
            expose(light, ccd, rng(), **keys)


def test_wells_fill_and_black_stays_above_nothing():
    ccd = Ccd(psf_px=0.0, crosstalk=0.0, black_dn=8.0, full_well_e=4000.0, read_noise_e=16.0)
    assert (expose(even(3.0, 40), ccd, rng()) == 255).mean() > 0.999
    dark = expose(even(0.0), ccd, rng()).astype(float)
    assert dark.mean() == pytest.approx(8, abs=0.02)
    assert dark.var() == pytest.approx((247 / 4000 * 16) ** 2 + 1 / 12, rel=0.02)
    assert expose(even(0.5, 40), ideal(black_dn=55.0), rng())[0, 0, 0] == 155


@pytest.mark.parametrize("bayer", ["rggb", "bggr", "grbg", "gbrg"])
def test_a_mosaic_keeps_even_and_sloping_colours_and_greens_resolution(bayer):
    ccd = ideal(bayer=bayer)
    x, y = np.meshgrid(np.arange(30.0), np.arange(24.0))
    slopes = np.stack([0.2 + 0.01 * x, 0.5 - 0.01 * y, 0.1 + 0.01 * x + 0.01 * y], axis=-1).astype(np.float32)
    counts = expose(slopes, ccd, rng()).astype(float)
    assert_allclose(counts[1:-1, 1:-1], 255 * slopes[1:-1, 1:-1], atol=0.51)
    # A picture of one colour has that colour's own pixels untouched.
    for c, letter in enumerate("rgb"):
        only = np.zeros((24, 30, 3), np.float32)
        only[..., c] = np.random.default_rng(2).uniform(0.2, 0.8, (24, 30))
        counts = expose(only, ccd, rng())
        for place, own in zip(((0, 0), (0, 1), (1, 0), (1, 1)), bayer, strict=True):
            if own == letter:
                kept = counts[place[0] :: 2, place[1] :: 2, c]
                assert_array_equal(kept, np.rint(255 * only[place[0] :: 2, place[1] :: 2, c]))


def test_interlaced_fields_see_two_moments_and_the_mean_of_two_lines():
    ccd = ideal(interlace=True)
    _, y = np.meshgrid(np.arange(20.0), np.arange(16.0))
    rows = np.repeat((0.03 * y)[..., None], 3, axis=-1).astype(np.float32)
    assert_allclose(expose(rows, ccd, rng())[:-1, 3, 0], 255 * 0.03 * (np.arange(15) + 0.5), atol=0.51)
    still, moved = even(0.2, 16), even(0.6, 16)
    counts = expose(moved, ccd, rng(), before=still)
    assert (counts[::2] == 51).all()
    assert (counts[1::2] == 153).all()


def test_composite_video_blurs_colour_more_than_brightness():
    ccd = ideal(bandwidth_mhz=(4.2, 1.3, 0.4))
    light = np.full((4, 640, 3), 0.1, np.float32)
    light[:, 320:] += np.array([0.7, 0.1, 0.3], np.float32)
    signals = (
        expose(light, ccd, rng())[1].astype(float)
        @ np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]]).T
    )
    step = np.diff(signals, axis=0)
    offset = np.arange(639) - 319.0
    # Half the power at the bandwidth: a sine of 1.3 MHz loses 29 % of its height, exp(-2 pi^2 s^2 f^2) = 0.5^0.5.
    for i, spread in enumerate(np.sqrt(np.log(2)) / (2 * np.pi * np.array([4.2, 1.3, 0.4])) * 640 / 52.66):
        near = np.abs(offset) < 4 * spread + 1
        share = step[near, i] / step[near, i].sum()
        assert np.sqrt(share @ offset[near] ** 2) == pytest.approx(spread, rel=0.15)


def test_compression_leaves_errors_of_its_quality():
    light = np.random.default_rng(1).uniform(0.2, 0.8, (64, 64, 3)).astype(np.float32)
    clean = expose(light, IDEAL, rng()).astype(float)
    errors = [np.abs(expose(light, ideal(jpeg_quality=q), rng()) - clean).mean() for q in (100, 85, 20)]
    assert 0 < errors[0] < errors[1] < errors[2]


def test_a_presets_video_and_compression_can_be_switched_off():
    light = np.random.default_rng(1).uniform(0.2, 0.8, (64, 64, 3)).astype(np.float32)
    kept = {"noise": False, "crosstalk": 0.0}
    for preset, key in (("sato_60fps", "jpeg_quality"), ("kamiyama_ntsc", "bandwidth_mhz")):
        full = Ccd(preset=preset, **kept)
        assert getattr(full.spelt_out(), key) == PRESETS[preset][key] != "off"
        plain = Ccd(preset=preset, **kept, **{key: "off"})
        assert plain.spelt_out().spelt_out() == plain.spelt_out()
        same = {name: value for name, value in PRESETS[preset].items() if name not in {key, "noise"}}
        expected = expose(light, Ccd(preset="ideal", **kept, **same), rng())
        assert_array_equal(expose(light, plain, rng()), expected)
        assert (expose(light, full, rng()) != expected).mean() > 0.2


def test_a_matrix_of_crosstalk_and_efficiencies_is_the_response():
    mixing = ((0.8, 0.2, 0.0), (0.1, 0.8, 0.1), (0.0, 0.3, 0.7))
    ccd = Ccd(preset="ideal", crosstalk=mixing, quantum_efficiency=(0.3, 0.6, 0.45))
    assert_allclose(ccd.response, np.array(mixing) * np.array([[0.5], [1.0], [0.75]]))
    light = even(0.0, 8) + np.array([0.5, 0.25, 0.125], np.float32)
    expected = 255 * ccd.response @ [0.5, 0.25, 0.125]
    assert_allclose(expose(light, ccd, rng())[0, 0], expected, atol=0.51)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (2, 2)])
@pytest.mark.parametrize("preset", ["industrial", "kamiyama_ntsc", "sato_60fps"])
def test_tiny_pictures_have_counts_too(preset, size):
    ccd = Ccd(preset=preset)
    counts = expose(np.full((*size, 3), 0.5, np.float32), ccd, rng(), Pattern.drawn(ccd, size, rng()))
    assert counts.shape == (*size, 3)
    assert 90 < counts.mean() < 230
