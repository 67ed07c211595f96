"""What a scene asks for in accuracy, and what is said where it is not met."""

import warnings

import numpy as np
import pytest

from twin.errors import AccuracyWarning
from twin.parts.load import Traction
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

POINTS = np.array([[0.0, 0.0, 3.0]])


@pytest.mark.parametrize("name", ["block_bare", "finger_bare"])
def test_central_loads_meet_what_the_bare_scenes_ask(name):
    Sensor(load_scene(name)).displacement(POINTS, Traction.bump((0, 0), 1.0, (0, 0, 1)))


def test_an_edge_load_warns_once_with_asked_got_and_remedy():
    sensor, load = Sensor(load_scene("block_bare")), Traction.rectangle((45, 0), (4, 4), (0, 0, 1))
    with pytest.warns(AccuracyWarning, match=r"0\.001 is asked.*move the load"):
        sensor._warn_if_inaccurate(sensor.rectangles(load))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sensor._warn_if_inaccurate(sensor.rectangles(load))
