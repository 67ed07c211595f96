import numpy as np
import pytest
from half_space_sensor import _sensor, as_found, grid, jacobian, shifts

from benchmarks.single_contact import RING, single_contact

MARKERS = np.vstack([grid(5, 5, 2.5, 0.5), grid(6, 6, 2.5, 2.0)])
SENSOR = _sensor(MARKERS, np.repeat(["red", "blue"], [25, 36]), (17, 17), 0.625, jacobian(MARKERS, 14.0, 30.0))


def hertz_disk(centre, radius, force, cuts=24):
    offsets = ((np.arange(cuts) + 0.5) / cuts - 0.5) * 2 * radius
    xy = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    xy = xy[np.hypot(*xy.T) < radius]
    share = np.sqrt(1 - (xy**2).sum(axis=1) / radius**2)
    return np.column_stack([xy + centre, np.zeros(len(xy))]), (share / share.sum())[:, None] * np.array(force)


def test_ring_rule():
    """Means of r^2 and r^4 under Hertz's pressure are 2/5 and 8/35."""
    squared, share = np.array(RING).T
    assert share.sum() == pytest.approx(1.0, abs=1e-6)
    assert share @ squared == pytest.approx(2 / 5, abs=1e-6)
    assert share @ squared**2 == pytest.approx(8 / 35, abs=1e-6)


@pytest.mark.parametrize(("noise", "place", "force_share"), [(0.0, 0.03, 0.004), (0.05, 0.1, 0.03)])
def test_place_and_force_of_one_contact(noise, place, force_share):
    markers, seen, calibration = SENSOR
    random = np.random.default_rng(5)
    for seed in range(6):
        centre, radius = random.uniform(-4.5, 4.5, 2), random.uniform(0.7, 1.2)
        force = np.array([*random.normal(0, 0.2, 2), 1.0])
        points, forces = hertz_disk(centre, radius, force)
        shift = shifts(markers, seen, points, forces)
        found = as_found(shift, calibration, 0.05, seed if noise else None)
        contact = single_contact(found, calibration, radius)
        assert np.linalg.norm(contact.place_mm[:2] - centre) < place
        assert np.linalg.norm(contact.force_n - force) < force_share * np.linalg.norm(force)
        if noise:
            known = single_contact(found, calibration, radius, tuple(centre / 0.625 + 8))
            assert np.linalg.norm(known.force_n - force) < 0.02 * np.linalg.norm(force)
