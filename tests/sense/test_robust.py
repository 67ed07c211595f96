import numpy as np
import pytest
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.errors import InputError
from twin.sense.force_map import force_map, in_units
from twin.sense.reconstruct import reconstruct

FLAT, FINGER = flat_sensor(), finger_sensor()


def with_wrong(shift, share, seed):
    random = np.random.default_rng(seed)
    out = shift.copy()
    which = random.choice(len(out), int(share * len(out)), replace=False)
    out[which] += random.choice([-10.0, 10.0], (len(which), 2))
    return out, which


def test_wrong_vectors_are_found_and_left_out():
    """2 % of the vectors +-10 px off: the total's error rises by less than a point, and they are named."""
    markers, seen, calibration = FLAT
    rises = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        force = np.array([*random.normal(0, 0.3, 2), 2.0])
        points, forces = disk(random.uniform(-6, 6, 2), random.uniform(3, 8), force)
        clean = as_found(shifts(markers, seen, points, forces), calibration, 0.05, seed).shift_px
        dirty, which = with_wrong(clean, 0.02, seed)
        fields = [reconstruct(as_found(s, calibration, 0.05), calibration, robust=r)
                  for s, r in ((clean, False), (dirty, True), (dirty, False))]  # fmt: skip
        error = [np.linalg.norm(f.total_force_n - force) / np.linalg.norm(force) for f in fields]
        rises.append(error[1] - error[0])
        assert fields[1].wrong[which].all()
        assert fields[1].wrong.sum() <= len(which) + 12
        assert error[2] > error[1]
    assert np.mean(rises) < 0.005
    assert max(rises) < 0.03


def test_robust_solve_of_clean_data_changes_little():
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (0, 0, 3.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1)
    plain, robust = reconstruct(found, calibration), reconstruct(found, calibration, robust=True)
    assert robust.wrong.sum() < 6
    assert robust.total_force_n == pytest.approx(plain.total_force_n, abs=0.03)


def test_stated_deviations_cover_the_truth():
    """Forces drawn from the prior, noise as stated: errors over their standard deviations have unit variance."""
    _, _, calibration = FINGER
    random = np.random.default_rng(4)
    weight, noise = 20.0, 0.05
    total, site = [], []
    for _ in range(60):
        force = random.normal(0, noise / np.sqrt(weight / 2), (25, 3))
        shift = (calibration.transfer @ force.ravel()).reshape(-1, 2) + random.normal(0, noise, (61, 2))
        field = reconstruct(as_found(shift, calibration, noise), calibration, "norm", weight)
        total.append((field.total_force_n - force.sum(axis=0)) / field.sd_total_n)
        site.append((field.force_n - force) / field.sd_force_n)
    assert np.std(total) == pytest.approx(1.0, abs=0.15)
    assert np.std(site) == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(site) < 1.96) == pytest.approx(0.95, abs=0.03)


def test_map_is_the_solve_also_with_lost_markers():
    markers, seen, calibration = FLAT
    points, forces = disk((1, 2), 5.0, (0.3, 0, 3.0))
    shift = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1).shift_px
    lost = shift.copy()
    lost[::17] = np.nan
    one = force_map(calibration, 0.5)
    for data in (shift, lost):
        field = reconstruct(as_found(data, calibration, 0.05), calibration, "smooth", 0.5)
        assert one.forces(data) == pytest.approx(field.force_n, abs=1e-4)
        assert np.sqrt(np.mean((one.forces(data) - field.force_n) ** 2)) < 1e-3 * np.median(field.sd_force_n)


@pytest.mark.parametrize("sites", [1, 2, 3, 25, 27])
def test_map_of_any_number_of_sites(sites):
    """Rows are worked on in eight parts, which don't come out even."""
    random = np.random.default_rng(sites)
    matrix, shift = random.normal(0, 1, (3 * sites, 2 * 61)), random.normal(0, 1, (61, 2))
    one = in_units(matrix, np.zeros((122, 122)))
    assert one.forces(shift).ravel() == pytest.approx(matrix @ shift.ravel(), abs=5e-3)
    with pytest.raises(InputError, match="60 markers for a map of 61"):
        one.forces(shift[:60])
