"""What can be computed but no sensor would show is said once, everywhere; `twin scenes --new` writes nothing of it."""

import inspect
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from twin.arrays import mean_spacing
from twin.errors import InputError, RecipeError
from twin.study.doubts import View, doubts
from twin.study.new_scene import Pad
from twin.study.recipe import load_scene, shipped_scenes
from twin.study.run import run
from twin.study.sensor import Sensor

FLAT = "kamiyama_pillar"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"material.youngs_modulus_mpa": 150}, r"material.youngs_modulus_mpa = 150 MPa: rubbers have 0.003 to 50 MPa"),
        ({"cover.youngs_modulus_mpa": 1000.0}, "cover.youngs_modulus_mpa = 1000 MPa"),
        ({"markers.red.kind": "print", "markers.red.diameter_mm": 2.0}, "prints merge at pitch_mm = 1.5 mm"),
        ({"markers.blue.depth_mm": 0.15, "markers.blue.diameter_mm": 0.1}, "within the cover of 0.2 mm"),
        ({"markers.red.diameter_mm": 0.05, "markers.blue.diameter_mm": 0.05}, "px wide in the picture .usual: 3 to"),
        ({"camera.focal_px": 25.0}, r"0\.1\d* px wide"),
        ({"camera.focal_px": 20000.0}, r"% of them lie outside the picture .* check camera.focal_px .in px"),
        ({"camera.tilt_deg": [0.0, 30.0, 0.0]}, "markers.red: 100 % of them lie outside"),
        ({"renderer": "path", "markers.red.gloss": [2, 0.2], "markers.red.texture": [0.3, 0.2]}, "texture: .* none"),
        ({"tolerance.depth_mm": 2.0}, "tolerance.depth_mm = 2 mm: .* take at most 1.2 mm"),
        ({"tolerance.print_mm": 0.5}, "neighbours change places; take at most 0.3 mm"),
        ({"press.probe.diameter_mm": 0.005}, "press.probe: 0.005 mm wide, a needle"),
        ({"press.force_n": {"z": 1e6}}, r"press.force_n: 1e\+06 N over 5 mm is 4e\+04 times Young's modulus"),
        ({"reconstruction.sites.pitch_mm": 1e-5}, "sites.pitch_mm = 1e-05 mm: usual are 0.1 to 10 mm"),
        ({"press.friction": 40.0}, "press.friction = 40: .* no angle"),
        ({"ccd.exposure": 100.0}, "= 2e.04 counts for the brightest marker"),
        ({"ccd.white_dn": 2.0}, "= 2 counts"),
    ],
)
def test_what_is_useless_is_doubted(overrides, words):
    lines = doubts(load_scene(FLAT, overrides))
    assert any(re.search(words, line) for line in lines), lines
    assert len(lines) == len(set(lines))


def test_shipped_scenes_are_not_doubted():
    assert {name: lines for name in shipped_scenes() if (lines := doubts(load_scene(name)))} == {}


def test_beads_wider_than_their_pitch_are_refused():
    with pytest.raises(RecipeError, match=r"markers.red.diameter_mm = 2 mm: beads can't be wider .* pitch_mm = 1.5 mm"):
        Sensor(load_scene(FLAT, {"markers.red.diameter_mm": 2.0})).picture(None)


def test_the_noise_of_a_mosaic_video_or_compression_has_no_closed_form():
    assert View.noise_bound(load_scene(FLAT)) is not None
    for ccd in ({"bayer": "rggb"}, {"bandwidth_mhz": [4.2, 1.3, 0.4]}, {"jpeg_quality": 85}, {"interlace": True}):
        assert View.noise_bound(load_scene(FLAT, {f"ccd.{key}": value for key, value in ccd.items()})) is None


def test_dots_that_three_channels_show_have_the_information_of_three() -> None:
    grey, one = (load_scene("gelpad_press", {"markers.dots.colour": c}) for c in ([0.03] * 3, [0.35, 0.03, 0.35]))
    np.testing.assert_allclose(View.noise_bound(one)[0] / View.noise_bound(grey)[0], np.sqrt(3.0), rtol=1e-3)


def test_check_warns(tmp_path, says):
    scene = tmp_path / "stiff.toml"
    scene.write_text(f'base = "{FLAT}"\n[material]\nyoungs_modulus_mpa = 150\n')
    assert "warning: material.youngs_modulus_mpa = 150 MPa" in says(0, "check", str(scene))


@pytest.mark.slow
def test_a_press_that_moves_nothing_visibly_is_said_once_everywhere(tmp_path, says):
    keys = ["material.youngs_modulus_mpa=1e6", "camera.width_px=320", "camera.height_px=240", "camera.focal_px=907.4"]
    told = says(0, "run", FLAT, "--out", str(tmp_path), *(word for key in keys for word in ("-s", key)))
    page, facts = (tmp_path / "report.html").read_text(), json.loads((tmp_path / "score.json").read_text())["facts"]
    for words in ("1e+06 MPa: rubbers have", "o marker moves by more than"):
        assert told.count(words) == 1
        assert page.count(words) == 1
        assert sum(words in line for line in facts["warnings"]) == 1


@pytest.mark.parametrize(
    "pad",
    [
        Pad(),
        Pad(size_mm=(5, 5, 1)),
        Pad(size_mm=(20, 10, 1)),
        Pad(size_mm=(100, 100, 40)),
        Pad(size_mm=(100, 60, 5), modulus_mpa=2),
        Pad(size_mm=(100, 6, 3)),
        Pad(pitch_mm=(3,), fov_deg=60),
        Pad(depth_mm=(0.5, 1.5)),
        Pad(size_mm=(250, 250, 20)),
        Pad(size_mm=(8.4, 30.4, 2.4), depth_mm=(0.5, 1)),
        Pad(size_mm=(20, 30, 3), camera_mm=20),
        Pad(size_mm=(9.5, 12.9, 8.8), camera_mm=95, fov_deg=47),
        Pad(camera_mm=250, fov_deg=8),
        Pad(pitch_mm=(2,), camera_mm=60, sensor_mm=4.8, focal_mm=8, resolution=(1280, 960)),
    ],
)
def test_what_is_written_is_a_scene_without_doubts(pad: Pad, tmp_path: Path) -> None:
    file, (line, *unseen) = pad.write(tmp_path / "mine")
    assert file == tmp_path / "mine.toml"
    assert line.startswith(str(file))
    scene = twin.load_scene(tmp_path / "mine.toml")
    assert not doubts(scene)
    assert View.of(scene).inside.all(), "the camera sees every dot"
    for seed in (1, 2, 3):
        sensor = twin.Sensor(scene.model_copy(update={"seed": seed}))
        made = sensor.project(sensor.actual.markers.points)
        assert ((made > 1) & (made < (scene.camera.width_px - 2, scene.camera.height_px - 2))).all(), "as made, too"
        first, drawn = next(iter(sensor.layout_px.items()))
        off = (made - np.concatenate(list(sensor.layout_px.values()))).mean(axis=0)
        assert np.abs(off).max() < 0.5 * mean_spacing(drawn), f"no other dot of {first} is nearer"
    half = sensor.sites.half_mm.max()
    assert half > 0, "every site lies on the surface, or this is refused"
    assert scene.reconstruction is not None
    assert scene.reconstruction.method == "local"
    assert pad.camera_mm or not unseen, "a distance that is left out lets all dots be seen"
    for text in unseen:
        assert text.startswith(("the pad has room for", "the dots fill only"))
        further = replace(pad, camera_mm=float(text.split()[-3]))
        assert len(further.write(tmp_path / "further")[1]) == 1, "every dot is seen, and they fill the picture"


def test_sparse_dots_on_thin_rubber_are_doubted(tmp_path: Path) -> None:
    *_, line = Pad(size_mm=(30, 30, 3), pitch_mm=(3,)).write(tmp_path / "mine")[1]
    assert line.startswith(
        "warning: markers.dots.pitch_mm = 3 mm: sparse on rubber 3 mm thick (usual: up to 0.8 of it)"
    )


@pytest.mark.slow
def test_forces_on_a_thin_pad_with_few_dots_are_off_by_what_is_stated(tmp_path: Path) -> None:
    """By sites as far apart as the dots they came out half as large, 2 to 3.4 stated deviations off."""
    Pad(size_mm=(30, 30, 3), pitch_mm=(2.25,), resolution=(1280, 720)).write(tmp_path / "mine")
    for seed in (1, 2, 3):
        score = twin.run(twin.load_scene(tmp_path / "mine.toml", {"seed": seed}), want={"score"}).score["force"]
        assert score["total_force_error"] < min(0.2, 2 * score["total_force_stated"])


def test_a_chip_and_a_lens_give_the_angle(tmp_path: Path) -> None:
    Pad(sensor_mm=4.8, focal_mm=6).write(tmp_path / "a")
    camera = twin.load_scene(tmp_path / "a.toml").camera
    assert camera is not None
    assert camera.focal_px == pytest.approx(640 * 6 / 4.8, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size-mm", "2", "20", "4"], "--size-mm 2 mm: allowed are 5 to 250 mm"),
        (["--size-mm", "20", "20", "400"], "--size-mm 400 mm: allowed are 1 to 100 mm"),
        (["--modulus-mpa", "200"], "--modulus-mpa 200 MPa: allowed are 0.003 to 50 MPa; 1 MPa = 1000 kPa"),
        (["--depth-mm", "4"], "--depth-mm 4 mm: allowed are 0.05 to 3.95 mm"),
        (["--pitch-mm", "1", "--diameter-mm", "1"], "--diameter-mm 1 mm: allowed are 0.02 to 0.9 mm"),
        (["--pitch-mm", "8", "--camera-mm", "20", "--fov-deg", "20"], "reduce the pitch, increase --fov-deg"),
        (["--fov-deg", "200"], "--fov-deg 200 deg: allowed are 5 to 120 deg"),
        (["--sensor-mm", "4"], "--sensor-mm and --focal-mm belong together"),
        (["--resolution", "10", "480"], "--resolution 10 px: allowed are 64 to 8192 px"),
        (["--depth-mm", "1", "--depth-mm", "2", "--depth-mm", "3"], "3 layers of dots: allowed are one or two"),
    ],
)
def test_wrong_numbers_are_told(arguments, words, tmp_path, monkeypatch, says):
    monkeypatch.chdir(tmp_path)
    assert words in says(2, "scenes", "--new", "mine", *arguments)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("precious")
    with pytest.raises(twin.TwinError, match="is there already"):
        Pad().write(tmp_path / "mine")
    assert (tmp_path / "mine.toml").read_text() == "precious"


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
        (lambda _: twin.Sphere(diameter_mm=True), "diameter_mm = 'true': must be a number in mm"),
        (lambda _: twin.track(PICTURE, PICTURE, list(LAYOUT)), "the layout must be a Mapping"),
        (lambda _: twin.track(PICTURE, PICTURE, LAYOUT, channels=3), "channels must be a Mapping"),
        (lambda _: twin.track(PICTURE, PICTURE, LAYOUT, diameter_px={"red": 3}), "diameter_px must be a Real"),
        (lambda _: twin.reconstruct(LAYOUT, None), "the motion must be a Found"),
        (lambda _: twin.run(twin.load_scene("block_bare"), want="displacements"), "did you mean 'displacement'"),
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
    with pytest.raises(InputError, match=r"holds truth\.npz, scene\.toml, which would be replaced"):
        run_to_folder(scene, tmp_path, {"displacement"})
    assert (tmp_path / "scene.toml").read_text() == "mine"


def test_a_descriptions_signature_holds_names_and_defaults() -> None:
    assert str(inspect.signature(twin.Sphere)) == "(*, kind='sphere', diameter_mm)"
    shown = inspect.signature(twin.Scene).parameters
    assert set(shown) == set(twin.Scene.model_fields) - {"source", "assumed"}
    assert shown["markers"].default == {}


def test_a_picture_of_leds_that_take_turns_is_said_to_show_the_first_group():
    for lit, count in (([[0], [1, 2]], 1), ([[0, 1]], 0), ([], 0)):
        small = {"camera.width_px": 80, "camera.height_px": 60, "renderer": "splat"}
        scene = load_scene("gelpad_press", {"light.lit": lit, **small})
        facts = run(scene, want=("picture",)).facts
        assert sum("only the first of 2 groups" in line for line in facts.get("warnings", ())) == count
