import dataclasses

import numpy as np
import pytest
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.errors import InputError
from twin.judge.resolution import widths
from twin.sense.force_map import force_map
from twin.sense.local import LEAST, expected, localised
from twin.sense.problem import penalty, problem_of
from twin.sense.reconstruct import reconstruct
from twin.theory.limit import design_limit

FLAT, FINGER = flat_sensor(), finger_sensor()


def pressed(sensor, centre, diameter, force, noise=0.05, seed=1):
    markers, seen, calibration = sensor
    return as_found(shifts(markers, seen, *disk(centre, diameter, force)), calibration, noise, seed)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_it_solves_its_own_equation(share):
    """(H^T H + w A^-1 Q A^-1) F = H^T d on the sites that carry force, also where a marker is lost."""
    markers, _, calibration = FLAT
    found = pressed(FLAT, (3, 1), 4.0, (0.3, 0, 2.0))
    shift = found.shift_px.copy()
    if not share:
        shift[::40] = np.nan
    found = dataclasses.replace(found, shift_px=shift, usual_sd_px=np.full(len(markers), 0.05))
    force = reconstruct(found, calibration).force_n * (np.hypot(*calibration.site_mm[:, :2].T) < 9)[:, None]
    problem = localised(problem_of(found, calibration, "smooth"), force)
    data, weight = problem.whiten(found.shift_px), 0.02
    there = np.repeat(expected(force, calibration.grid), 3)
    carries, seen = there > 0, np.isfinite(shift.ravel())
    assert 0.05 < carries.mean() < 0.8
    rows = calibration.transfer[np.ix_(seen, carries)] / 0.05
    matrix = penalty(calibration, "smooth")[np.ix_(carries, carries)] / np.outer(there[carries], there[carries])
    exact = np.linalg.solve(rows.T @ rows + weight * matrix, rows.T @ (shift.ravel()[seen] / 0.05))
    factors, told = problem.factors, problem.reweighed.filled(data, weight)
    ours = factors.back @ (factors.singular / (factors.singular**2 + weight) * (factors.left.T @ told))
    assert ours[carries] == pytest.approx(exact, rel=1e-6, abs=1e-9)
    assert not ours[~carries].any()


def test_width_reaches_the_design_limit():
    """A point push is within a quarter of the limit at .05 px, where the smooth field is half as wide again."""
    markers, seen, calibration = flat_sensor(13, 13, pitch=1.0)
    clean = shifts(markers, seen, *disk((0.2, -0.3), 0.3, (0, 0, 3.0)))
    one = np.ones(1)
    limit = design_limit(
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


def test_nothing_pressed_is_nothing_felt():
    for _, _, calibration in (FLAT, FINGER):
        nothing = np.zeros_like(calibration.layout_px)
        assert not reconstruct(as_found(nothing, calibration), calibration, "local").force_n.any()
        field = reconstruct(as_found(nothing, calibration, 0.05, 3), calibration, "local")
        assert np.abs(field.total_force_n).max() < 0.01


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


def test_expected_sizes():
    """A lone force is expected around its site, and far away none is."""
    force = np.zeros((9 * 9, 3))
    force[40, 0] = -2.0
    there = expected(force, (9, 9)).reshape(9, 9)
    assert there[4, 4] == there.max() == pytest.approx(1.0)
    assert there == pytest.approx(there.T)
    assert LEAST < there[4, 6] < there[4, 5] < 1.0
    assert not there[0].any()


def test_no_map():
    with pytest.raises(InputError, match="local"):
        force_map(FLAT[2], 1.0, "local")
