"""What can be computed but no sensor would show is said once, everywhere; `twin scenes --new` writes nothing of it."""

import json
import re
from pathlib import Path

import pytest

import twin
from twin.cli import main
from twin.errors import RecipeError
from twin.study.doubts import View, doubts, noise_bound
from twin.study.new_scene import Pad
from twin.study.recipe import load_scene, shipped_scenes
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
        ({"tolerance.depth_mm": 2.0}, "tolerance.depth_mm = 2 mm: .* take at most 1.2 mm"),
        ({"tolerance.print_mm": 0.5}, "neighbours change places; take at most 0.3 mm"),
        ({"press.probe.diameter_mm": 0.005}, "press.probe: 0.005 mm wide, a needle"),
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
    assert noise_bound(load_scene(FLAT)) is not None
    for ccd in ({"bayer": "rggb"}, {"bandwidth_mhz": [4.2, 1.3, 0.4]}, {"jpeg_quality": 85}, {"interlace": True}):
        assert noise_bound(load_scene(FLAT, {f"ccd.{key}": value for key, value in ccd.items()})) is None


def test_check_warns(tmp_path, capsys):
    scene = tmp_path / "stiff.toml"
    scene.write_text(f'base = "{FLAT}"\n[material]\nyoungs_modulus_mpa = 150\n')
    with pytest.raises(SystemExit) as ended:
        main(["check", str(scene)])
    assert ended.value.code == 0
    assert "warning: material.youngs_modulus_mpa = 150 MPa" in capsys.readouterr().out


@pytest.mark.slow
def test_a_press_that_moves_nothing_visibly_is_said_once_everywhere(tmp_path, capsys):
    keys = ["material.youngs_modulus_mpa=1e6", "camera.width_px=320", "camera.height_px=240", "camera.focal_px=907.4"]
    with pytest.raises(SystemExit) as ended:
        main(["run", FLAT, "--out", str(tmp_path), *(word for key in keys for word in ("-s", key))])
    assert ended.value.code == 0
    page, facts = (tmp_path / "report.html").read_text(), json.loads((tmp_path / "score.json").read_text())["facts"]
    told = capsys.readouterr().out
    for words in ("1e+06 MPa: rubbers have", "o marker moves by more than"):
        assert told.count(words) == 1
        assert page.count(words) == 1
        assert sum(words in line for line in facts["warnings"]) == 1


# --- `twin scenes --new` --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "pad",
    [
        Pad(),
        Pad(size_mm=(5, 5, 1)),
        Pad(size_mm=(20, 10, 1)),
        Pad(size_mm=(100, 100, 40)),
        Pad(size_mm=(100, 60, 5), modulus_mpa=2),
        Pad(size_mm=(100, 6, 3)),
        Pad(pitch_mm=(8,), fov_deg=60),
        Pad(depth_mm=(0.5, 1.5)),
        Pad(pitch_mm=(2,), camera_mm=60, sensor_mm=4.8, focal_mm=8, resolution=(1280, 960)),
    ],
)
def test_what_is_written_is_a_scene_without_doubts(pad: Pad, tmp_path: Path) -> None:
    (line,) = pad.write(tmp_path / "mine")
    assert line.startswith(str(tmp_path / "mine.toml"))
    scene = twin.load_scene(tmp_path / "mine.toml")
    assert not doubts(scene)
    assert View.of(scene).inside.all(), "the camera sees every dot"
    half = twin.Sensor(scene).sites.half_mm.max()
    assert half > 0, "every site lies on the surface, or this is refused"
    assert scene.reconstruction is not None
    assert scene.reconstruction.method == ("local" if len(scene.markers) == 1 else "smooth")


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
        (["--pitch-mm", "8", "--fov-deg", "20"], "reduce the pitch, increase --fov-deg"),
        (["--fov-deg", "200"], "--fov-deg 200 deg: allowed are 5 to 120 deg"),
        (["--sensor-mm", "4"], "--sensor-mm and --focal-mm belong together"),
        (["--resolution", "10", "480"], "--resolution 10 px: allowed are 64 to 8192 px"),
        (["--depth-mm", "1", "--depth-mm", "2", "--depth-mm", "3"], "3 layers of dots: allowed are one or two"),
    ],
)
def test_wrong_numbers_are_told(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as done:
        main(["scenes", "--new", "mine", *arguments])
    assert done.value.code == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("precious")
    with pytest.raises(twin.TwinError, match="is there already"):
        Pad().write(tmp_path / "mine")
    assert (tmp_path / "mine.toml").read_text() == "precious"
