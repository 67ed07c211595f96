"""Random scenes: a few of what ``python -m benchmarks random_scenes`` draws by the thousand, and what it found."""

import importlib
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import random_scenes
from benchmarks.random_recipes import Spoilt, recipes, slots, spoilt_values
from benchmarks.random_scenes import (
    LEFT_OUT,
    Tally,
    check_spoilt,
    check_valid,
    just_over_base,
    spoilt_recipes,
    survey,
)
from twin.errors import ContactError, RecipeError
from twin.parts.press import Cone, Press
from twin.study.doubts import View
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

FOUND = Path(__file__).parent / "found"
AGAIN = "save the recipe as FILE: python -m benchmarks random_scenes --again FILE; once mended, keep it in found/"


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(FOUND.glob("*.toml")), ids=lambda file: file.stem)
def test_what_random_scenes_found_stays_mended(file: Path) -> None:
    assert check_valid(tomllib.loads(file.read_text()), Tally())


def test_what_is_drawn_depends_on_the_seed_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Not on numbers in the sources of what is imported: every change of the program would draw other scenes."""
    drawn: list[str] = []

    def keep(recipe: Any, tally: Tally) -> str:
        drawn.append(random_scenes.shown(recipe))
        return "kept"

    survey(recipes(), keep, 20, seed=1)

    numbers = tmp_path / "numbers_of_a_source.py"
    numbers.write_text("".join(f"N{n} = {n + 1000.5}\nT{n} = 'text {n}'\n" for n in range(100)))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, numbers.stem, raising=False)
    importlib.import_module(numbers.stem)
    assert survey(recipes(), keep, 20, seed=1).outcomes == {"kept": 20}
    assert len(drawn) == 40
    assert drawn[:20] == drawn[20:]


@pytest.mark.parametrize("count", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_spoilt_recipes_are_refused_with_file_and_key(count: int) -> None:
    tally = survey(spoilt_recipes(), check_spoilt, count, seed=0)
    assert tally.outcomes["failed"] == 0, tally.smallest_failure
    assert sum(tally.outcomes.values()) >= count


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_random_scenes_are_computed_or_refused_with_a_cause() -> None:
    """A hundred, or as many as 150 s allow: with nothing in the cache every body's first scene meshes it."""
    tally = survey(recipes(), check_valid, 100, seed=1, most_s=150.0)
    assert tally.outcomes["failed"] == 0, f"{tally.smallest_failure}\n{AGAIN}"
    drawn = sum(tally.outcomes.values()) - tally.outcomes[LEFT_OUT]
    done = sum(n for what, n in tally.outcomes.items() if what.startswith("computed"))
    assert drawn >= 5
    assert done >= 0.6 * drawn, tally.outcomes  # refusals must stay the exception, or nothing is tested


def test_a_wrong_answer_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message without the key, an exit code 0, and a pushed total must each fail the check that looks for it."""
    good = Spoilt({"base": "block_bare", "nonsense": 1}, "nonsense", "unknown key")
    assert check_spoilt(good, Tally()) == "unknown key"
    silent = replace(good, table={"base": "block_bare"})
    for bad, words in ((replace(good, key="other"), "not named"), (silent, "code 0")):
        with pytest.raises(AssertionError, match=words):
            check_spoilt(bad, Tally())
    run = random_scenes.run_scene

    def pushed(*arguments: Any) -> Any:
        result = run(*arguments)
        return replace(result, truth=replace(result.truth, total_force_n=result.truth.total_force_n * 1.001))

    monkeypatch.setattr(random_scenes, "run_scene", pushed)
    recipe = tomllib.loads(load_scene("first_press", {"accuracy.contact_patches": 6}).to_toml())
    blind = {k: v for k, v in recipe.items() if k not in ("camera", "reconstruction")}
    with pytest.raises(AssertionError, match="off their total"):
        check_valid(blind, Tally())
    monkeypatch.setattr(random_scenes, "run_scene", run)
    monkeypatch.setattr(random_scenes, "mirrored", lambda found: found)
    with pytest.raises(AssertionError, match="mirrored scene"):
        check_valid({**blind, "press": {**blind["press"], "at_mm": [1.0, 2.0]}}, Tally())


def test_a_mirrored_contact_may_be_refused_at_a_cones_base_within_the_error_of_the_mesh() -> None:
    sensor = Sensor(load_scene("block_bare", {"accuracy.contact_patches": 6}))
    cone = Cone(apex_deg=140, diameter_mm=1.0)
    with pytest.raises(ContactError) as found:
        sensor.press(Press(probe=cone, force_n=(0, 0, 0.2)))
    assert just_over_base(found.value, 10.0)
    assert not just_over_base(found.value, 0.01)
    assert not just_over_base(ContactError("contact: runs over the edge of the sensing surface"), 10.0)


def test_every_table_of_a_scene_is_spoilt() -> None:
    found = slots(load_scene("dataset_sato"))
    tables = {str(slot.path[0]) for slot in found if slot.field is not None and spoilt_values(slot)}
    assert tables == set(load_scene("dataset_sato").model_dump()) - {"source", "assumed"}


@pytest.mark.parametrize("distortion", [[0.01, 0.0, 1e-3, 0.0], [0.01, 0.0, 0.0, 0.0, 1e-3], []])
def test_a_camera_of_any_distortion_can_be_made_with_tolerances(distortion: list[float]) -> None:
    scene = load_scene("kamiyama_pillar", {"camera.distortion": distortion, "tolerance.distortion": 0.01})
    made = Sensor(scene).actual.scene.camera
    assert made.distortion[0] != (distortion or [0.0])[0]
    assert list(made.distortion[1:]) == (distortion or [0.0, 0.0])[1:]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("press.probe.kind", [[[1]]], "press.probe"),
        ("body.shape", [[1]], "body"),
        ("vary", {"press": {"probe": {}}}, "press.probe.*choice"),
        ("vary", {"press": {"probe": {"assumed": "x"}}}, "press.probe.*choice"),
    ],
)
def test_what_random_recipes_found_is_refused(key: str, value: Any, words: str) -> None:
    with pytest.raises(RecipeError, match=words):
        load_scene("dataset_kamiyama", {key: value})


def test_black_markers_on_black_ground_have_no_bound_and_no_error() -> None:
    black = {f"markers.{name}.colour": [0.0, 0.0, 0.0] for name in ("red", "blue")}
    black["cover.albedo"] = [0.0, 0.0, 0.0]
    scene = load_scene("kamiyama_pillar", black)
    assert np.isinf(View.noise_bound(scene)).all()
