"""What a scene asks for in accuracy, and what is said where it is not met."""

import re
import warnings

import numpy as np
import pytest

from twin.errors import AccuracyWarning
from twin.parts.load import Traction
from twin.parts.press import Object, Press
from twin.study.recipe import load_scene
from twin.study.run import run
from twin.study.sensor import Sensor
from twin.world.elasticity.coated import Ladder
from twin.world.elasticity.discretise import tile
from twin.world.mesh.sizing import WORLD

POINTS = np.array([[0.0, 0.0, 3.0]])


def warnings_of(do):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", AccuracyWarning)
        do()
    return [str(one.message) for one in told]


@pytest.mark.parametrize("name", ["block_bare", "finger_bare"])
def test_central_loads_meet_what_the_bare_scenes_ask(name):
    sensor = Sensor(load_scene(name))
    assert warnings_of(lambda: sensor.displacement(POINTS, Traction.bump((0, 0), 1.0, (0, 0, 1)))) == []


def test_points_on_a_held_face_stay_where_they_are_and_count_in_no_error():
    sensor, load = Sensor(load_scene("block_bare")), Traction.bump((0, 0), 1.0, (0, 0, 1))
    held = [[0.0, 0.0, 40.0], [50.0, -45.0, 40.0]]
    assert warnings_of(lambda: sensor.displacement(held, load)) == []
    assert not sensor.displacement(held, load).any()
    both, free = (sensor.displacement([*points, *POINTS], load) for points in (held, []))
    assert np.array_equal(both, np.vstack([np.zeros((2, 3)), free]))


def test_more_than_any_level_reaches_warns_once_with_asked_got_and_remedy():
    sensor = Sensor(load_scene("block_bare", {"accuracy.displacement": 1e-5}))
    load, points = Traction.disk((10, 5), 1.5, (1, 0, 1)), np.array([[9.0, 5.0, 1.0]])
    with pytest.warns(AccuracyWarning, match=r"1e-05 is asked.*move the load"):
        sensor.displacement(points, load)
    assert warnings_of(lambda: sensor.displacement(points, load)) == []


def test_a_press_on_few_patches_warns_of_them():
    few = {"accuracy.contact_patches": 8, "tolerance.preset": "none"}
    sensor = Sensor(load_scene("kamiyama_pillar", few))
    match = r"0\.002 is asked.*raise accuracy\.contact_patches \(8\)"
    with pytest.warns(AccuracyWarning, match=match) as warned:
        sensor.press().error  # noqa: B018
    assert {one.filename for one in warned} == {__file__}  # the line that asked, not one of the program


def letter(depth_mm):
    probe = Object(shape="letter", width_mm=8.0)
    return Press(probe=probe, at_mm=(0, 0), tilt_deg=(0, 0, 30), indentation_mm=depth_mm)


def test_a_press_whose_patches_cut_sharp_edges_warns_of_its_force_at_once():
    sensor = Sensor(load_scene("block_bare", {"accuracy.contact_patches": 8}))
    few = warnings_of(lambda: sensor.press(letter(0.05)))
    assert any(re.search(r"force 0\.\d+.*by the patches: raise accuracy.contact_patches \(8\)", one)
               for one in few)  # fmt: skip
    assert warnings_of(lambda: sensor.press(letter(0.05))) == []  # once
    enough = Sensor(load_scene("block_bare", {"accuracy.displacement": 0.2}))
    assert warnings_of(lambda: enough.press(letter(0.05)).error) == []


def test_a_press_warns_of_its_force_after_a_load_warned_of_displacements():
    sensor = Sensor(load_scene("block_bare", {"accuracy.displacement": 1e-5}))
    sensor_warns = warnings_of(lambda: sensor.displacement(POINTS, Traction.disk((10, 5), 1.5, (1, 0, 1))))
    assert len(sensor_warns) == 1
    assert "displacements" in sensor_warns[0]
    assert any("force 0." in one for one in warnings_of(lambda: sensor.press(letter(0.05))))


@pytest.mark.parametrize("name", ["kamiyama_pillar", "object_letter"])
def test_shipped_presses_meet_what_their_scenes_ask(name):
    sensor = Sensor(load_scene(name))
    assert warnings_of(lambda: sensor.press().error) == []


class Rung:
    """A level whose estimated error is given, and how far the surface moves under a load."""

    def __init__(self, level, error, under=0.0):
        self.level, self._error, self._under = level, error, under

    def answer(self, points, load):
        return np.full((1, 3), WORLD.index(self.level), float), self._error

    def displacement(self, points, load):
        return np.full((1, 3), self._under)


ERRORS = {"coarse": 8e-3, "standard": 2e-3, "fine": 5e-4}


@pytest.mark.parametrize(
    ("asked", "errors", "level"),
    [
        (3e-2, ERRORS, "coarse"),
        (5e-3, ERRORS, "standard"),
        (1e-3, ERRORS, "fine"),
        (5e-3, {**ERRORS, "standard": 8e-3}, "fine"),  # worse than expected, but within reach of the next level
        (5e-3, {**ERRORS, "standard": 3e-2}, "fine"),  # far worse than expected: climbing goes on until it is met
        (1e-5, ERRORS, "fine"),
        (4e-3, {**ERRORS, "standard": 6e-3, "fine": 7e-3}, "standard"),  # none meets it: the best one
    ],
)
def test_an_accuracy_takes_the_cheapest_level_that_meets_it(monkeypatch, asked, errors, level):
    def rung(body, material, *, level, **_):
        return Rung(level, errors[level])

    monkeypatch.setattr("twin.world.elasticity.coated.Compliance", rung)
    scene = load_scene("finger_bare")
    ladder = Ladder(scene.body, scene.material, asked)
    wide = tile(Traction.rectangle((0, 0), (4, 4), (0, 0, 1)), scene.body, 4.0)
    answer = ladder.displacement(POINTS, wide)
    assert (answer.compliance.level, answer.error) == (level, errors[level])
    assert answer.displacement_mm[0, 0] == WORLD.index(level)


@pytest.mark.parametrize(("under", "remedy"), [(5.0, "move the load away"), (50.0, "at most 0.02.*add points nearer")])
def test_points_that_hardly_move_are_named_as_the_cause_of_their_error(monkeypatch, under, remedy):
    monkeypatch.setattr("twin.world.elasticity.coated.Compliance", lambda *_, level, **__: Rung(level, 0.4, under))
    sensor = Sensor(load_scene("finger_bare"))
    with pytest.warns(AccuracyWarning, match=rf"displacements 0\.4 of the largest; .*{remedy}"):
        sensor.displacement(POINTS, Traction.rectangle((0, 0), (4, 4), (0, 0, 1)))


def test_a_saturated_picture_warns_once_and_the_runs_facts_say_so():
    small = {"camera.width_px": 160, "camera.height_px": 120, "camera.focal_px": 450, "ccd.exposure": 3.0,
             "press": {"at_mm": [0, 0], "indentation_mm": 0.01, "probe": {"kind": "sphere", "diameter_mm": 3}},
             "accuracy.centroid_px": 0.05}  # fmt: skip
    scene = load_scene("kamiyama_pillar", small)
    with pytest.warns(AccuracyWarning, match=r"% of the pixels are saturated.*lower ccd\.exposure \(3\)") as told:
        result = run(scene, want={"picture"})
    assert len(told) == 1
    assert result.facts["picture_warnings"] == [str(told[0].message)]
    sensor = Sensor(load_scene("kamiyama_pillar", small | {"ccd.exposure": 1.0}))
    assert warnings_of(lambda: sensor.picture(None)) == []
    assert sensor.saturation is None
