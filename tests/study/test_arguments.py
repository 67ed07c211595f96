"""What is given to the Python interface by mistake is told in the field's terms, before anything is computed."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from twin.errors import InputError, RecipeError

PICTURE = np.zeros((48, 64, 3), np.uint8)
LAYOUT = {"red": np.array([[10.0, 10.0], [30.0, 10.0]])}
PUSH = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
PRESS = twin.Press(probe=twin.Sphere(diameter_mm=3), force_n=(0, 0, 1))


@pytest.fixture(scope="module")
def bare() -> twin.Sensor:
    return twin.Sensor(twin.load_scene("block_bare"))


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (lambda _: twin.load_scene(None), "the scene must be a str or a Path, not NoneType"),
        (lambda _: twin.load_scene("block_bare", "seed=3"), "overrides must be a Mapping, not str 'seed=3'"),
        (lambda _: twin.load_scene("block_bare", {3: 4}), "an override's key must be a str, not int 3"),
        (lambda _: twin.load_scene("block_bare", {"seed": True}), "seed = 'true': must be a whole number"),
        (lambda _: twin.Sensor("block_bare"), "not str 'block_bare': load one with twin.load_scene"),
        (lambda _: twin.Environment("sato_press"), "not str 'sato_press': load one with twin.load_scene"),
        (lambda s: s.displacement([[0, 0, 3.0]], PRESS), "the load must be a Load, not Press"),
        (lambda s: s.displacement([["a", 0, 0]], PUSH), "points_mm: must be numbers of shape"),
        (lambda s: s.displacement([[0, 0], [1, 2, 3]], PUSH), "points_mm: must be numbers of shape"),
        (lambda s: s.press(PUSH), "the press must be a Press, not Load"),
        (lambda s: s.picture(3), "the load must be a Load, not int 3"),
        (lambda s: s.project([[0, 0, 3.0]], "drawn"), "which = 'drawn': allowed are 'actual' and 'nominal'"),
        (lambda s: s.picture(None, exposure=-1), "exposure = -1: allowed are whole numbers from 0"),
        (lambda s: s.picture(None, exposure=1.5), "exposure = 1.5: allowed are whole numbers from 0"),
        (lambda _: twin.Traction.disk((0, 0), None, (0, 0, 1)), "radius_mm must be a Real"),
        (lambda _: twin.Traction.twist((0, 0), 1, (0, 0, 1)), "torque_nmm one, got"),
        (lambda _: twin.Sphere(radius_mm=3), "radius_mm: unknown key; did you mean 'diameter_mm'"),
        (lambda _: twin.Sphere(3), "Sphere: 3: give every value by its name: kind, diameter_mm"),
        (lambda _: twin.Sphere(diameter_mm=True), "diameter_mm = 'true' mm: must be a number"),
        (lambda _: twin.track(PICTURE, PICTURE, list(LAYOUT)), "the layout must be a Mapping"),
        (lambda _: twin.track(PICTURE, PICTURE, LAYOUT, channels=3), "channels must be a Mapping"),
        (lambda _: twin.track(PICTURE, PICTURE, LAYOUT, diameter_px={"red": 3}), "diameter_px must be a Real"),
        (lambda _: twin.reconstruct(LAYOUT, None), "the motion must be a Found"),
        (lambda _: twin.run(twin.load_scene("block_bare"), want="displacements"), "unknown displacements"),
        (lambda _: twin.Sphere(diameter_mm=-3), "diameter_mm = -3 mm: must be greater than"),
        (lambda _: twin.Press(probe=PRESS.probe, force_n=(0, 0, 1), friction=-0.5), "frictionless"),
        (lambda _: twin.Traction.rectangle((0, 0), 4, (0, 0, 1)), "size_mm"),
        (lambda _: twin.Traction.disk((0, 0), 4, (0, 1)), "force_n three"),
    ],
)  # fmt: skip
def test_what_was_meant_otherwise_is_told(mistake: Callable[[Any], object], words: str, bare: twin.Sensor) -> None:
    with pytest.raises((InputError, RecipeError)) as told:
        mistake(bare)
    assert words in str(told.value)


@pytest.mark.parametrize(
    "given",
    [
        lambda p: p.astype(np.float32), lambda p: p.tolist(), np.asfortranarray, lambda p: np.repeat(p, 2, axis=0)[::2],
        lambda p: np.frombuffer(p.tobytes()).reshape(p.shape),
    ],
    ids=["float32", "list", "by columns", "every second row", "read only"],
)  # fmt: skip
def test_points_may_come_in_any_layout_of_memory(given: Callable[[Any], Any], bare: twin.Sensor) -> None:
    points = np.array([[1.0, 0.0, 3.0], [2.0, 0.5, 4.0]])
    np.testing.assert_array_equal(bare.displacement(given(points), PUSH), bare.displacement(points, PUSH))


def test_the_state_of_a_press_is_a_load(bare: twin.Sensor) -> None:
    state = bare.press(PRESS)
    points = [[0.0, 0.0, 3.0], [1.0, 0.5, 4.0]]
    moved = bare.displacement(points, state)
    np.testing.assert_array_equal(moved, bare.displacement(points, state.load))
    assert np.abs(moved[:, 2]).min() > 0.01


def test_a_run_writes_over_its_own_files_only(tmp_path: Path) -> None:
    from twin.study.run import run_to_folder

    scene = twin.load_scene("block_bare")
    for _ in range(2):
        run_to_folder(scene, tmp_path, {"displacement"})
    (tmp_path / "timings.json").unlink()
    (tmp_path / "scene.toml").write_text("mine")
    with pytest.raises(InputError, match=r"holds truth\.npz, scene\.toml, which no run wrote"):
        run_to_folder(scene, tmp_path, {"displacement"})
    assert (tmp_path / "scene.toml").read_text() == "mine"


def test_a_descriptions_signature_holds_names_and_defaults() -> None:
    assert str(inspect.signature(twin.Sphere)) == "(*, kind='sphere', diameter_mm)"
    shown = inspect.signature(twin.Scene).parameters
    assert set(shown) == set(twin.Scene.model_fields) - {"source", "assumed"}
    assert shown["markers"].default == {}
