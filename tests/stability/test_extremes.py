"""Extreme values: what ``python -m benchmarks extremes`` tries by running is read here; some are run."""

import math
import warnings

import pytest

from benchmarks.extremes import SCENES, cases, extremes, outcome, scene_of
from benchmarks.random_recipes import Table
from twin.errors import RecipeError
from twin.study.recipe import validate_scene


@pytest.mark.parametrize("name", SCENES)
def test_every_extreme_value_is_taken_or_refused_by_name(name: str) -> None:
    told = [(key, value, _problem(recipe)) for key, value, recipe in cases(name)]
    taken = sum(problem == "" for _, _, problem in told)
    assert 0.3 * len(told) < taken < len(told)
    # A body may be refused by its shape's name, or because the camera would stand in it.
    unnamed = [one for one in told if one[2] and one[0].split(".")[0] not in one[2] and "camera.pupil_mm" not in one[2]]
    assert not unnamed


def _problem(recipe: Table) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            validate_scene(recipe, "changed")
        except RecipeError as problem:
            return str(problem)
    return ""


def test_the_ends_of_a_range_are_tried() -> None:
    field = type(scene_of("block").material).model_fields["poisson_ratio"]
    assert {-0.5, 0.0, 5e-324, 0.5} <= set(extremes(field.metadata, float))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["block", "tractions"])
def test_extreme_loads_and_pictures_are_computed_or_refused(name: str) -> None:
    """The tables that cost neither mesh nor solve; the command tries all, and looks at the time too."""
    tried = [case for case in cases(name) if case[0].startswith(("camera.tilt", "ccd.", "press.steps", "tractions"))]
    became = {f"{key} = {value!r}": outcome(recipe, math.inf) for key, value, recipe in tried}
    assert not {key: what for key, what in became.items() if what.startswith("failed")}
