"""What a scene asks for in accuracy, and what is said where it is not met."""

import warnings

import numpy as np
import pytest

from twin.errors import AccuracyWarning
from twin.parts.load import Traction
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.elasticity.ladder import Ladder
from twin.world.mesh.sizing import WORLD

POINTS = np.array([[0.0, 0.0, 3.0]])


@pytest.mark.parametrize("name", ["block_bare", "finger_bare"])
def test_central_loads_meet_what_the_bare_scenes_ask(name):
    Sensor(load_scene(name)).displacement(POINTS, Traction.bump((0, 0), 1.0, (0, 0, 1)))


def test_an_edge_load_warns_once_with_asked_got_and_remedy():
    sensor, load = Sensor(load_scene("block_bare")), Traction.rectangle((45, 0), (4, 4), (0, 0, 1))
    points = np.array([[40.0, 0.0, 1.0]])
    with pytest.warns(AccuracyWarning, match=r"0\.001 is asked.*move the load"):
        sensor.displacement(points, load)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sensor.displacement(points, load)


class Rung:
    """A level whose estimated error is given."""

    def __init__(self, level, error):
        self.level, self._error = level, error

    def answer(self, points, load, enough=0.0):
        return np.full((1, 3), WORLD.index(self.level), float), self._error


ERRORS = {"coarse": 8e-3, "standard": 2e-3, "fine": 5e-4}


@pytest.mark.parametrize(
    ("asked", "errors", "level"),
    [
        (3e-2, ERRORS, "coarse"),
        (5e-3, ERRORS, "standard"),
        (1e-3, ERRORS, "fine"),
        (5e-3, {**ERRORS, "standard": 8e-3}, "fine"),  # worse than expected, but within reach of the next level
        (5e-3, {**ERRORS, "standard": 3e-2}, "standard"),  # so bad that no level would do: said, not computed in vain
        (1e-5, ERRORS, "fine"),
    ],
)
def test_an_accuracy_takes_the_cheapest_level_that_meets_it(asked, errors, level):
    scene = load_scene("finger_bare")
    ladder = Ladder(scene.body, scene.material, asked)
    ladder._rungs = {name: Rung(name, error) for name, error in errors.items()}
    answer = ladder.displacement(POINTS, None)
    assert (answer.compliance.level, answer.error) == (level, errors[level])
    assert answer.displacement_mm[0, 0] == WORLD.index(level)
