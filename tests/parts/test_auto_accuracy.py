"""What ``auto`` takes of a scene, and what is refused."""

import pytest

from twin.errors import RecipeError
from twin.parts.press import PATCHES_ACROSS
from twin.parts.scene import FEWEST, LOOSEST, TIGHTEST, Accuracy
from twin.study.recipe import load_scene

AUTO = {"accuracy.displacement": "auto", "accuracy.contact_patches": "auto"}


def test_numbers_stay_what_they_are():
    fixed = Accuracy(displacement=2e-3, contact_patches=20)
    assert fixed.displacement_for(50.0) == 2e-3
    assert fixed.patches_for([100.0], [0.1]) == 20


def test_auto_follows_what_the_scene_leaves_open_within_bounds():
    auto = Accuracy(displacement="auto", contact_patches="auto")
    assert auto.displacement_for(1.5) == pytest.approx(5e-3)
    assert (auto.displacement_for(0.0), auto.displacement_for(50.0)) == (TIGHTEST, LOOSEST)
    assert auto.patches_for([5.0, 2.0], [3.0, 6.0]) == FEWEST, "the deep don't see narrow patches"
    assert auto.patches_for([5.0], [0.6]) == 10
    assert auto.patches_for([10.0], [0.5]) == PATCHES_ACROSS
    assert auto.patches_for([float("inf")], [3.0]) == auto.patches_for([], []) == PATCHES_ACROSS


def test_a_scene_balances_by_its_own_tolerances_probe_and_markers():
    scene = load_scene("kamiyama_pillar", AUTO)
    assert (scene.displacement_error, scene.contact_patches) == (pytest.approx(5e-3), FEWEST)
    shallow = load_scene("kamiyama_pillar", {**AUTO, "markers.blue.depth_mm": 0.5, "tolerance.preset": "none"})
    assert (shallow.displacement_error, shallow.contact_patches) == (TIGHTEST, 12)


@pytest.mark.parametrize("value", ["best", 0, -1.0])
def test_anything_else_is_refused_by_key(value):
    for key in ("displacement", "contact_patches"):
        with pytest.raises(RecipeError, match=f"accuracy.{key}"):
            load_scene("kamiyama_pillar", {f"accuracy.{key}": value})
