"""What can be computed but no sensor would show is said once: on the terminal, in the report and in the score."""

import json
import re

import pytest

from twin.cli import main
from twin.errors import RecipeError
from twin.study.doubts import doubts, noise_bound
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
