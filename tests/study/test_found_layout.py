"""`twin calibrate --layout-from`: the program's own rest pictures, found without their drawing; what is written."""

import json
import tomllib

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

import twin
from twin.files import png_bytes
from twin.study.recipe import shipped_scenes

QUICK = ("gelpad_press", "sato_press", "kamiyama_pillar")


def check_scene(name):
    """Every marker that shows whole is found under the number that the scene gives it, and nothing else."""
    sensor = twin.Sensor(twin.load_scene(name))
    found = twin.find_layout(sensor.picture(None))
    centres = sensor.project(sensor.ellipsoids(None).centres)
    outlines = sensor.renderer.outlines(sensor.ellipsoids(None))
    scene = sensor.nominal
    assert len(found.layers) == len(scene.markers)
    start = 0
    places = {}
    for key, layer in scene.markers.items():
        rows = slice(start, start + layer.columns * layer.rows)
        places[key], start = rows, rows.stop
    for layer in found.layers.values():
        off = {key: np.median(cKDTree(centres[rows]).query(layer.centre_px)[0]) for key, rows in places.items()}
        key = min(off, key=off.get)
        rows, drawn = places[key], scene.markers[key]
        distance, spot = cKDTree(centres[rows]).query(layer.centre_px)
        assert distance.max() < 0.3 * layer.pitch_px, key
        assert len(set(spot)) == len(spot)
        seen = np.flatnonzero(outlines.visible[rows] > 0.95)
        assert not (set(seen) - set(spot)), key
        assert (layer.columns, layer.rows) == (drawn.columns, drawn.rows)
        assert np.array_equal(layer.index @ [drawn.rows, 1], spot), "columns from the left, rows from the bottom"


@pytest.mark.parametrize("name", QUICK)
def test_whole_markers_of_a_shipped_scene_are_found(name):
    check_scene(name)


@pytest.mark.slow
def test_whole_markers_of_all_shipped_scenes_are_found():
    for name in shipped_scenes():
        if name not in QUICK and twin.load_scene(name).camera is not None:
            check_scene(name)


@pytest.fixture(scope="module")
def rest(tmp_path_factory):
    sensor = twin.Sensor(twin.load_scene("gelpad_press", {"camera.tilt_deg": [0, 0, 4]}))
    path = tmp_path_factory.mktemp("pad") / "rest.png"
    path.write_bytes(png_bytes(sensor.picture(None)))
    return path


def test_tables_that_are_written_make_a_scene_whose_markers_are_in_the_picture(rest, tmp_path, monkeypatch, says):
    monkeypatch.chdir(tmp_path)
    said = says(0, "calibrate", "--layout-from", str(rest), "--pitch-mm", "1.25", "--depth-mm", "0.5")
    assert "143 dark dots, 13 columns x 11 rows, square" in said
    text = (tmp_path / "markers.toml").read_text()
    turn = float(text.split("tilt_deg = [0, 0, ")[1].split("]")[0])
    assert turn == pytest.approx(4, abs=0.5)  # the tolerance turns the camera as well
    own = twin.load_scene("gelpad_press").markers["dots"]
    table = tomllib.loads(text)["markers"]["black"]
    assert table["diameter_mm"] == pytest.approx(own.diameter_mm, rel=0.05)
    scene = tmp_path / "mine.toml"
    scene.write_text('base = "gelpad_press"\ncamera.tilt_deg = [0, 0, 4]\n' + text)
    layout = twin.Sensor(twin.load_scene(scene)).layout_px["black"]
    picture = np.array(Image.open(rest))
    assert twin.track(picture, picture, {"black": layout}).seen.all()
    shown = np.array(Image.open(tmp_path / "markers.png")).astype(int)
    green = (shown[..., 1] - shown[..., 0] > 100).sum()
    assert green > 143 * 50, "a ring around every dot"


def test_without_a_scale_millimetres_are_left_to_be_filled_in(rest, tmp_path, says):
    says(0, "calibrate", "--layout-from", str(rest), "--out", str(tmp_path / "m.toml"))
    table = tomllib.loads((tmp_path / "m.toml").read_text())["markers"]["black"]
    assert not {"pitch_mm", "diameter_mm", "depth_mm"} & set(table)
    (tmp_path / "s.toml").write_text('base = "block_bare"\n' + (tmp_path / "m.toml").read_text())
    with pytest.raises(twin.TwinError, match=r"markers\.black\.pitch_mm: missing; give a value in mm"):
        twin.load_scene(tmp_path / "s.toml")


def test_a_scene_gives_the_scale_and_the_names(rest, tmp_path, monkeypatch, says):
    made = ["calibrate", "--layout-from", str(rest), "--out", str(tmp_path / "m.toml"), "--scene"]
    said = says(0, *made, "gelpad_press")
    table = tomllib.loads((tmp_path / "m.toml").read_text())["markers"]["dots"]
    assert table["pitch_mm"] == pytest.approx(1.25, rel=0.01)
    assert table["depth_mm"] == 0.5
    _, scale, written = json.loads(says(0, *made, "gelpad_press", "--json"))["rows"]
    focal_px = scale["focal_px"]
    assert f"equal with focal_px = {focal_px:.4g} or" in said
    assert written["files"] == [str(tmp_path / name) for name in ("m.toml", "m.png")]
    assert f"pitch {table['pitch_mm']:g} mm by the scene's camera, drawn 1.25 mm" in said
    assert focal_px == pytest.approx(900 * table["pitch_mm"] / 1.25, rel=1e-3)
    # A lens that the recipe has 6 mm too near: where it is instead, if its focal length is measured.
    place_mm = twin.load_scene("gelpad_press").camera.pupil_mm[2]
    near = tmp_path / "near.toml"
    near.write_text(f'base = "gelpad_press"\ncamera.pupil_mm = [0, 0, {place_mm - 6}]\n')
    assert float(says(0, *made, str(near)).split("z of about ")[1].split()[0]) == pytest.approx(place_mm, abs=0.3)
    # Dots off by more than half a pitch, and a lens whose axis is off the picture's middle, which moves no dot.
    off = {"camera.principal_px": [331.5, 239.5], "camera.tilt_deg": [0, 0, 4], "markers.dots.offset_mm": [0.8, 0]}
    Image.fromarray(twin.Sensor(twin.load_scene("gelpad_press", off)).picture(None)).save(tmp_path / "off.png")
    made[2] = str(tmp_path / "off.png")
    says(0, *made, "gelpad_press", "-s", "camera.principal_px=[331.5, 239.5]")
    moved = tomllib.loads((tmp_path / "m.toml").read_text())["markers"]["dots"]["offset_mm"]
    assert np.subtract(moved, table["offset_mm"]) == pytest.approx([0.8, -0.056], abs=0.02), "turned by 4 deg"
    # Without --out the camera is told and the tables that the pitch made stay as they are.
    monkeypatch.chdir(tmp_path)
    there = set(tmp_path.iterdir())
    said = says(0, "calibrate", "--layout-from", str(rest), "--scene", str(near))
    assert "equal with focal_px" in said
    assert "written" not in said
    assert set(tmp_path.iterdir()) == there


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--pitch-mm", "1", "--pitch-mm", "2"], "--pitch-mm has 2 numbers, and the picture shows 1 layer"),
        (["--out", "x.npz"], "must end in .toml"),
        (["--method", "sato"], "--layout-from makes no calibration"),
        (["--scene", "gelpad_press", "--pitch-mm", "1"], "leave --pitch-mm and --depth-mm out"),
        (["--scene", "block_bare"], "no [camera] table"),
        (["--scene", "gelpad_press", "-s", "camera.width_px=320"], "is 640x480 px, the scene's camera 320x480 px"),
    ],
)
def test_wrong_options_are_told(rest, arguments, words, tmp_path, monkeypatch, says):
    monkeypatch.chdir(tmp_path)
    assert words in says(2, "calibrate", "--layout-from", str(rest), *arguments)
    assert not list(tmp_path.iterdir())
