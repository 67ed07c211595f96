"""A bumped camera is told from forces, by either sensor, and forces are not taken for one."""

import numpy as np
import pytest
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.sense.bump import camera_bump


@pytest.mark.parametrize(("sensor", "strength"), [(flat_sensor, 1.0), (finger_sensor, 0.3)])
@pytest.mark.parametrize("case", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4))])
def test_a_bump_is_found_and_a_force_is_none(sensor, strength, case):
    markers, seen, calibration = sensor()
    random = np.random.default_rng(case)
    force = strength * np.array([random.normal(0, 0.7), random.normal(0, 0.7), random.uniform(0.2, 3.0)])
    if case == 4:
        force = strength * np.array([4.0, 0.0, 4.0])
    points, forces = disk(random.uniform(-0.5, 0.5, 2) * markers[:, :2].max(), 4.0, force)
    motion = shifts(markers, seen, points, forces)
    still = camera_bump(as_found(motion, calibration, sd=0.012, seed=case), calibration)
    assert not still.certain
    assert np.abs(still.shift_px).max() < max(0.1, 4 * still.sd_px)
    bumped = camera_bump(as_found(motion + np.array([3.0, -1.0]), calibration, sd=0.012, seed=case), calibration)
    assert bumped.certain
    assert bumped.shift_px == pytest.approx([3.0, -1.0], abs=max(0.1, 4 * bumped.sd_px))
