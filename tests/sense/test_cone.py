import dataclasses

import numpy as np
import pytest
import scipy.optimize
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.judge.score import into_cells
from twin.sense.constraints import Quadratic
from twin.sense.reconstruct import reconstruct

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
        again = reconstruct(found, calibration, friction=0.8, previous=cone)
        assert again.force_n == pytest.approx(cone.force_n, rel=0.1, abs=0.02)


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
