"""Forces held to pushes or friction cones, and fields that know where the load is."""

import dataclasses

import numpy as np
import pytest
import scipy.optimize
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, pressed, shifts
from scipy.ndimage import correlate1d, gaussian_filter

from benchmarks.inverse import widths
from twin.judge.score import into_cells
from twin.sense.constraints import Quadratic
from twin.sense.inverse import METHODS
from twin.sense.reconstruct import reconstruct
from twin.theory.limit import Limit

FLAT, FINGER = flat_sensor(), finger_sensor()


def drawn(sites, seed, decay=1.0):
    random = np.random.default_rng(seed)
    h = random.normal(0, 1, (4 * sites, 3 * sites)) * 10.0 ** (-decay * random.random(3 * sites))
    return h, random.normal(0, 1, 4 * sites) + h @ random.normal(0.3, 1, 3 * sites)


def test_pushes_are_the_non_negative_least_squares_solution():
    """Against another algorithm: bounded least squares by trust regions."""
    for seed in range(4):
        h, data = drawn(12, seed)
        quadratic = Quadratic(curvature=h.T @ h + 0.1 * np.eye(36))
        force, free, kkt = quadratic.pushes(h.T @ data)
        rows = np.vstack([h, np.sqrt(0.1) * np.eye(36)])
        low = np.where(np.arange(36) % 3 == 2, 0.0, -np.inf)
        other = scipy.optimize.lsq_linear(rows, np.r_[data, np.zeros(36)], (low, np.inf), method="bvls", tol=1e-14)
        assert force.ravel() == pytest.approx(other.x, abs=1e-7)
        assert kkt < 1e-12
        assert (force[~free, 2] == 0).all()
        again, _, _ = quadratic.pushes(h.T @ data, ~free)
        assert again == pytest.approx(force, abs=1e-12)


@pytest.mark.parametrize("mu", [0.2, 0.7, 3.0])
def test_cone_meets_its_optimality_conditions(mu):
    """F in the cone, gradient in the dual cone, both orthogonal: what makes a convex problem's solution."""
    for seed in range(4):
        h, data = drawn(15, seed)
        matrix, linear = h.T @ h + 0.05 * np.eye(45), h.T @ data
        force, kkt = Quadratic(curvature=matrix).cone(linear, mu)
        gradient = (matrix @ force.ravel() - linear).reshape(-1, 3)
        size = np.abs(linear).max()
        assert kkt < 1e-9
        assert (np.hypot(*force[:, :2].T) <= mu * force[:, 2] * (1 + 1e-12) + 1e-12).all()
        assert (mu * np.hypot(*gradient[:, :2].T) <= gradient[:, 2] + 1e-8 * size).all()
        assert np.abs((force * gradient).sum(axis=1)).max() < 1e-8 * size
        assert (force[:, 2] > 0).any()
        warm, _ = Quadratic(curvature=matrix).cone(linear, mu, 1.1 * force)
        assert warm == pytest.approx(force, abs=1e-7)


def field_error(field, points, forces):
    cells = into_cells(field.site_mm, points, forces)
    return np.linalg.norm(field.force_n - cells) / np.linalg.norm(cells)


def test_bounds_that_hold_in_truth_lower_the_field_error():
    """And the totals stay those of the linear estimate."""
    markers, seen, calibration = FLAT
    for centre, force in (((0, 0), (0, 0, 3.0)), ((4.3, -3.1), (0.4, 0.2, 2.0))):
        points, forces = disk(centre, 5.0, force)
        found = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1)
        plain = reconstruct(found, calibration)
        push = reconstruct(found, calibration, push_only=True)
        cone = reconstruct(found, calibration, friction=0.8)
        errors = [field_error(f, points, forces) for f in (plain, push, cone)]
        assert errors[1] < errors[0]
        assert errors[2] < 0.75 * errors[0]
        assert errors[2] < 0.37
        assert push.force_n[:, 2].min() >= 0
        assert max(push.kkt, cone.kkt) < 1e-9
        assert np.array_equal(cone.total_force_n, plain.total_force_n)
        apart = np.abs(cone.force_n.sum(axis=0) - cone.total_force_n)
        assert np.all((cone.sd_total_n >= apart) & (cone.sd_total_n > plain.sd_total_n)), "states the difference"
        again = reconstruct(found, calibration, friction=0.8, previous=cone)
        assert again.force_n == pytest.approx(cone.force_n, rel=0.1, abs=0.02)


def test_totals_state_how_far_off_a_calibration_read_its_own_presses():
    markers, seen, calibration = FLAT
    found = as_found(shifts(markers, seen, *disk((0, 0), 5.0, (0.4, 0.2, 2.0))), calibration, 0.05, 1)
    plain = reconstruct(found, calibration)
    told = dataclasses.replace(calibration, provenance='{"read_error": [0.1, 0.0, 0.2]}')
    expected = np.hypot(plain.sd_total_n, [0.1, 0.0, 0.2] * plain.total_force_n)
    assert reconstruct(found, told).sd_total_n == pytest.approx(expected)


def test_totals_do_not_state_what_a_wrong_coefficient_of_friction_makes_of_the_sites():
    """A load that needs 0.6: held to 0.3 its sites push too much, which the motion contradicts."""
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (1.2, 0, 2.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1)
    plain = reconstruct(found, calibration)
    wrong = reconstruct(found, calibration, friction=0.3)
    assert wrong.force_n[:, 2].sum() > 3.5
    assert wrong.total_force_n[2] == pytest.approx(2.0, abs=0.1)
    assert (wrong.sd_total_n < 3 * plain.sd_total_n).all()


def test_pushes_are_meant_along_the_inward_normal():
    """The sites' frames are turned by 30 degrees: forces along the turned normals are pushes, others aren't."""
    _, _, calibration = FINGER
    cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)
    frame = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    turned = dataclasses.replace(calibration, site_frames=np.tile(frame, (25, 1, 1)))
    force = np.zeros((25, 3))
    force[12] = 0.8 * frame[2]
    clean = as_found((calibration.transfer @ force.ravel()).reshape(-1, 2), turned)
    found = reconstruct(clean, turned, "norm", 1e-9, friction=0.05)
    assert found.force_n == pytest.approx(force, abs=1e-3)
    away = as_found(-clean.shift_px, turned)
    assert np.abs(reconstruct(away, turned, "norm", 1e-9, friction=0.05).force_n @ frame[2]).max() < 0.1


@pytest.mark.slow
def test_any_weight_is_survived():
    """From 1e-12 to 1e12, every way of solving: finite, and no larger than the pseudo-inverse's."""
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (0.2, 0, 3.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1)
    largest = np.linalg.norm(reconstruct(found, calibration, "pinv").force_n)
    for weight in 10.0 ** np.arange(-12, 13, 4):
        for method in ("smooth", "norm"):
            for options in ({}, {"push_only": True}, {"friction": 0.5}):
                field = reconstruct(found, calibration, method, weight, **options)
                assert np.linalg.norm(field.force_n) <= largest
                assert field.kkt < 1e-8
                assert np.isfinite(field.sd_force_n).all()
    assert np.linalg.norm(field.force_n) < 1e-4, "a weight beyond all data holds the forces at zero"


def expected_sizes(force, grid):
    """Sizes of the forces around every site, over the largest; 0 where less than 3 % is expected."""
    size = np.sqrt(gaussian_filter((force**2).sum(axis=1).reshape(grid), 1.0, mode="constant").ravel())
    return np.where(size > 0.03 * size.max(), size / size.max(), 0.0)


@pytest.mark.parametrize("lost", [False, True])
def test_it_solves_its_own_equation(lost):
    """Sites that carry force solve (R^T R + w A^-1 Q A^-1) F = R^T d, three times; also where markers are lost.

    Row i of R and d is over what isn't known of shift i, px: .002 of noise, and the second differences
    of its response from site to site, along and across, times sqrt(mean (x (1 - x)/2)^2) over x in 0..1.
    """
    markers, _, calibration = FLAT
    found = pressed(FLAT, (3, 1), 8.0, (0.3, 0, 2.0), noise=0.002)
    shift = found.shift_px.copy()
    if lost:
        shift[::40] = np.nan
    found = dataclasses.replace(found, shift_px=shift, usual_sd_px=np.full(len(markers), 0.002))
    omega_px2, seen = 1e-4, np.isfinite(shift.ravel())
    force, q = reconstruct(found, calibration).force_n, METHODS["local"].matrix(calibration.grid)
    places = np.linspace(0, 1, 1001)
    uneven = np.sqrt(np.trapezoid((places * (1 - places) / 2) ** 2, places))
    for _ in range(3):
        there = np.repeat(expected_sizes(force, calibration.grid), 3)
        carries = there > 0
        assert 0.05 < carries.mean() < 0.8
        field = force.reshape(*calibration.grid, 3)
        model = 0.0
        for axis in (0, 1):
            change = correlate1d(field, [1, -2, 1], axis, mode="constant")
            model += ((calibration.transfer @ change.ravel()).reshape(-1, 2) ** 2).sum(axis=1) / 2
        sd = np.repeat(np.sqrt(0.002**2 + uneven**2 * model), 2)
        weight, sd = omega_px2 * np.mean(sd**-2.0) / 2, sd[seen]
        rows = calibration.transfer[np.ix_(seen, carries)] / sd[:, None]
        matrix = q[np.ix_(carries, carries)] / np.outer(there[carries], there[carries])
        force = np.zeros_like(force)
        force.ravel()[carries] = np.linalg.solve(rows.T @ rows + weight * matrix, rows.T @ (shift.ravel()[seen] / sd))
    ours = reconstruct(found, calibration, "local", omega_px2).force_n
    assert ours == pytest.approx(force, rel=1e-5, abs=1e-8)
    assert not ours.ravel()[~carries].any()


def test_width_reaches_the_design_limit():
    """A point push is within a quarter of the limit at .05 px, where the smooth field is half as wide again."""
    markers, seen, calibration = flat_sensor(13, 13, pitch=1.0)
    clean = shifts(markers, seen, *disk((0.2, -0.3), 0.3, (0, 0, 3.0)))
    one = np.ones(1)
    limit = Limit.of(
        depth_mm=np.array([[3.0, 6.0]]), pitch_mm=np.full((1, 2), 1.5), noise_mm=np.full((1, 2), 0.05 / 20),
        youngs_modulus_mpa=one, poisson_ratio=0.5 * one, force_n=3.0 * one, radius_mm=2.5 * one,
    ).fwhm_normal_mm[0]  # fmt: skip
    wide = {}
    for method in ("smooth", "local"):
        field = reconstruct(as_found(clean, calibration, 0.05, 1), calibration, method)
        wide[method] = np.mean(widths(field.force_n[:, 2], calibration.grid, 1.0))
    assert wide["local"] < 1.1 * limit
    assert wide["local"] < 0.75 * wide["smooth"]


def test_totals_are_within_their_standard_deviations():
    """Random discs: totals within 2 %, better than the smooth ones, and the stated deviations are what is seen."""
    errors, smooth, stated = [], [], []
    for seed in range(10):
        random = np.random.default_rng(seed)
        force = np.array([*random.normal(0, 0.5, 2), random.uniform(1, 4)])
        found = pressed(FLAT, random.uniform([-9, -6], [9, 6]), random.uniform(3, 10), force, seed=seed)
        field = reconstruct(found, FLAT[2], "local")
        size = np.linalg.norm(force)
        errors.append(np.linalg.norm(field.total_force_n - force) / size)
        smooth.append(np.linalg.norm(reconstruct(found, FLAT[2]).total_force_n - force) / size)
        stated.append((field.total_force_n - force) / field.sd_total_n)
    assert np.sqrt(np.mean(np.square(errors))) < 0.015
    assert np.median(errors) < 0.7 * np.median(smooth)
    assert 0.5 < np.sqrt(np.mean(np.square(stated))) < 1.6


def test_a_small_press_beside_a_large_one_is_kept():
    markers, seen, calibration = FLAT
    clean = shifts(markers, seen, *disk((-8, -5), 4.0, (0, 0, 3.0))) + shifts(
        markers, seen, *disk((8, 5), 4.0, (0, 0, 0.3))
    )
    field = reconstruct(as_found(clean, calibration, 0.05, 2), calibration, "local")
    near = np.hypot(*(field.site_mm[:, :2] - [8, 5]).T) < 5
    assert field.force_n[near, 2].sum() == pytest.approx(0.3, rel=0.2)
    assert (field.sd_force_n > 0).all(), "a site that carries none has the smooth solution's"


def test_with_bounds_and_wrong_vectors():
    found = pressed(FLAT, (2, -3), 5.0, (0.8, 0, 2.0))
    shift = found.shift_px.copy()
    wrong = [10, 200, 500]
    shift[wrong] += 10.0
    field = reconstruct(
        dataclasses.replace(found, shift_px=shift), FLAT[2], "local", robust=True, friction=0.6
    )  # fmt: skip
    assert field.wrong[wrong].all()
    assert field.kkt < 1e-9
    assert (np.hypot(*field.force_n[:, :2].T) <= 0.6 * field.force_n[:, 2] + 1e-9).all()
    assert field.total_force_n == pytest.approx([0.8, 0, 2.0], abs=0.06)


@pytest.mark.parametrize("weight", [0.0, 1e-300, 1e-12, 1e12, 1e300])
def test_any_weight(weight):
    field = reconstruct(pressed(FINGER, (1, 0.5), 3.0, (0.3, 0, 3.0)), FINGER[2], "local", weight)
    assert np.isfinite(field.force_n).all()
    assert np.isfinite(field.sd_force_n).all()
    if weight < 1:
        assert field.total_force_n[2] == pytest.approx(3.0, rel=0.05)
