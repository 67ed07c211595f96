"""Sensors and presses of a dataset are drawn from random streams of their own."""

import numpy as np
import pytest
from small_dataset import small_scene

from twin.study.dataset.plan import Plan

VARY = {
    "press.friction": {"low": 0.0, "high": 1.0},
    "material.youngs_modulus_mpa": {"low": 1.0, "high": 2.0},
}


@pytest.mark.parametrize("sampling", ["stratified", "random"])
def test_what_is_drawn_for_sensors_tells_nothing_of_the_presses(sampling):
    plan = Plan(small_scene(vary=VARY, dataset__sampling=sampling), 64)
    presses = [values["press.friction"] for values in plan.press_values(range(64))]
    sensors = [values["material.youngs_modulus_mpa"] - 1.0 for values in plan.sensor_values(range(64))]
    assert not np.isclose(presses, sensors).any()
    assert abs(np.corrcoef(presses, sensors)[0, 1]) < (0.4 if sampling == "random" else 0.1)
