"""The design limit: rows against the half-space, scaling, a sensor solved by brute force.

The bound of a disc's centre against the Fisher information of a picture, pixel by pixel.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import j0, j1, ndtr
from standard_bodies import rectangles

from twin.errors import InputError
from twin.parts.camera import Ccd
from twin.theory import halfspace, limit
from twin.theory.limit import Limit
from twin.theory.optics import centre_bound

FLAT = dict(
    depth_mm=[[3.0, 6.0]],
    pitch_mm=[[1.5, 1.5]],
    noise_mm=[[0.0025, 0.0025]],
    youngs_modulus_mpa=1.0,
    poisson_ratio=0.5,
    force_n=3.0,
    radius_mm=2.5,
)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_rows_are_the_half_space(nu):
    """The Hankel integral of the rows is Boussinesq's and Cerruti's point force."""
    depth, r = 1.3, 0.9
    g = 1 / (2 * (1 + nu))
    point, across = np.array([[r, 0.0, depth]]), np.array([[0.0, r, depth]])

    def moved(force, at):
        return halfspace.displacement(at, rectangles(np.zeros(3), 0.0, force), 1.0, nu)[0]

    def hankel(f):
        return quad(lambda k: f(k) * k / (2 * np.pi), 1e-9, 40, limit=400)[0]

    def rows(k):
        return Limit.layer_rows(*(np.array(each) for each in (k, depth, g, nu)))

    def aside(k):
        return np.exp(-k * depth) / (g * k)

    def second(k):
        return 2 * j1(k * r) / (k * r) - j0(k * r)

    radial = hankel(lambda k: rows(k)[1] * j1(k * r))
    assert radial == pytest.approx(moved([0, 0, 1], point)[0], rel=1e-6)
    # a shear's motion at r: half the sum of both parts with J0, half the difference with J2
    both = hankel(lambda k: 0.5 * (rows(k)[0] + aside(k)) * j0(k * r))
    other = hankel(lambda k: 0.5 * (rows(k)[0] - aside(k)) * second(k))
    assert both - other == pytest.approx(moved([1, 0, 0], point)[0], rel=1e-6)
    assert both + other == pytest.approx(moved([1, 0, 0], across)[0], rel=1e-6)


def _flat(**changes):
    return Limit.of(**{**FLAT, **changes})


def test_lengths_scale_exactly_and_stiffness_acts_as_noise():
    one = _flat()
    double = _flat(
        depth_mm=[[6.0, 12.0]], pitch_mm=[[3.0, 3.0]], noise_mm=[[0.005, 0.005]], radius_mm=5.0, force_n=12.0
    )
    assert_allclose(double.fwhm_normal_mm, 2 * one.fwhm_normal_mm, rtol=1e-12)
    assert_allclose(double.force_sd_n, 4 * one.force_sd_n, rtol=1e-12)
    stiff, noisy = _flat(youngs_modulus_mpa=2.0), _flat(noise_mm=[[0.005, 0.005]])
    assert_allclose(stiff.two_point_mm, noisy.two_point_mm, rtol=1e-12)
    assert_allclose(stiff.force_sd_n, 2 * one.force_sd_n, rtol=1e-12)


def test_shallow_quiet_and_dense_is_sharper():
    noisy = {"noise_mm": [[0.03, 0.03]]}
    one = _flat(**noisy)
    for change in ({"depth_mm": [[1.5, 3.0]]}, {"noise_mm": [[0.01, 0.01]]}, {"pitch_mm": [[1.0, 1.0]]}):
        better = _flat(**{**noisy, **change})
        for name in ("fwhm_normal_mm", "two_point_mm"):
            assert getattr(better, name)[0] < getattr(one, name)[0], (change, name)


def test_the_size_of_a_wide_push_is_told_better_by_deep_markers():
    """In incompressible rubber a push moves markers sideways by z exp(-k z) / 2 G."""
    assert _flat(depth_mm=[[0.3, 0.6]]).force_sd_n[0] > 2 * _flat().force_sd_n[0]


def test_the_grid_of_waves_is_fine_enough(monkeypatch):
    rng = np.random.default_rng(3)
    depth = rng.uniform(0.3, 4, 40)
    designs = {
        "depth_mm": np.column_stack([depth, depth + rng.uniform(0.5, 4, 40)]),
        "noise_mm": rng.uniform(0.005, 0.05, (40, 1)) * [1, 1],
        "pitch_mm": np.full((40, 2), 1e-3),
        "youngs_modulus_mpa": rng.uniform(0.2, 2, 40),
    }
    coarse = _flat(**designs)
    k, r = np.geomspace(0.01, 90, 400), np.concatenate([[0.0], np.geomspace(0.01, 80, 400)])
    step = np.log(k[1] / k[0])
    monkeypatch.setattr(limit, "_K", k)
    monkeypatch.setattr(limit, "_R", r)
    monkeypatch.setattr(limit, "_STEP", step)
    monkeypatch.setattr(limit, "_HANKEL", (k**2 * step / (2 * np.pi))[:, None] * j0(np.outer(k, r)))
    monkeypatch.setattr(limit, "_HALVES", np.array([np.interp(r / 2, r, row) for row in np.eye(len(r))]))
    fine = _flat(**designs)
    for name in Limit.__annotations__:
        assert_allclose(getattr(coarse, name), getattr(fine, name), rtol=0.03, err_msg=name)


def test_pitch_sets_the_floor_of_a_shallow_design():
    finger = _flat(depth_mm=[[0.5, 2.0]], pitch_mm=[[2.5, 2.5]], noise_mm=[[0.001, 0.001]])
    assert finger.fwhm_normal_mm[0] == pytest.approx(1.41 * 2.5)


def test_a_grid_of_markers_solved_by_brute_force_has_this_width():
    """Markers and sites on a wide grid, half-space rectangles, the same prior."""
    pitch, depths, noise, force, radius = 1.0, (2.0, 4.0), 0.002, 3.0, 2.0
    across = np.arange(-12.0, 12.1, pitch)
    sites = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2)
    layers = zip(depths, (0.0, 0.5), strict=True)
    markers = [np.column_stack([sites + off, np.full(len(sites), z)]) for z, off in layers]
    markers = np.concatenate(markers)
    middle = int(np.argmin(np.linalg.norm(sites, axis=1)))
    on = rectangles(np.column_stack([sites, np.zeros(len(sites))]), pitch / 2, 0.0)
    whole = halfspace.compliance(markers, on, 1.0, 0.5).reshape(len(markers), 3, -1)
    transfer = whole[:, :2].reshape(2 * len(markers), -1)
    gram = transfer.T @ transfer / noise**2
    prior = np.eye(len(gram)) / (force**2 / (np.pi * radius**2) * pitch**2)
    known = np.linalg.solve(gram + prior, gram[:, 3 * middle + 2])[2::3]
    line = known.reshape(len(across), len(across))[:, len(across) // 2]
    fine = np.linspace(across[0], across[-1], 4001)
    above = fine[np.interp(fine, across, line) > line.max() / 2]
    design = {"depth_mm": [depths], "pitch_mm": [[pitch] * 2], "noise_mm": [[noise] * 2]}
    reached = _flat(**design, force_n=force, radius_mm=radius)
    assert np.ptp(above) == pytest.approx(reached.fwhm_normal_mm[0], rel=0.15)


def test_bad_designs_are_refused():
    with pytest.raises(InputError, match="positive"):
        _flat(noise_mm=[[0.0, 0.001]])


def test_pitch_and_noise_widen_together_and_alone_each_is_what_it_is():
    """Far below the noise's width pitch does not count; far above it the picture is a sinc's."""
    x = np.linspace(0, 1, 200_001)
    assert 2 * x[np.argmin(np.abs(np.sinc(x) - 0.5))] == pytest.approx(limit.SAMPLED, rel=1e-4)
    noise = {"sampling": "squares", "noise_mm": [[0.03, 0.03]]}
    dense, coarse = (_flat(**noise, pitch_mm=[[p, p]]).fwhm_normal_mm[0] for p in (0.01, 100.0))
    floor = _flat(noise_mm=[[0.03, 0.03]], pitch_mm=[[0.01, 0.01]]).fwhm_normal_mm[0]
    assert dense == pytest.approx(floor, rel=1e-3)
    assert coarse == pytest.approx(100 * limit.SAMPLED, rel=0.05)
    both = _flat(**noise).fwhm_normal_mm[0]
    alone = _flat(noise_mm=[[0.03, 0.03]], pitch_mm=[[1.5, 1.5]], sampling="floor").fwhm_normal_mm[0]
    assert alone < both < alone + 1.5 * limit.SAMPLED


def fisher_sd(diameter, contrast, psf, noise):
    """Return the bound from a picture of a disc: samples blurred, summed into pixels."""
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
def test_the_bound_is_that_of_the_pictures_fisher_information(diameter, psf):
    numeric = fisher_sd(diameter, 150.0, psf, 1.5)
    assert float(centre_bound(np.array(diameter), 150.0, psf, 1.5)) == pytest.approx(numeric, rel=0.03)


def test_a_pixels_noise_is_shot_read_and_rounding_noise():
    electrons_per_count = 20000 / 255
    wanted = np.sqrt((110 * electrons_per_count + 12**2) / electrons_per_count**2 + 1 / 12)
    assert Ccd(full_well_e=20000, read_noise_e=12).pixel_sd(110.0) == pytest.approx(wanted)
