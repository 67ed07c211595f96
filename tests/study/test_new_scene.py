"""`twin scenes --new`: what it writes is a scene without doubts, and wrong numbers are told."""

from pathlib import Path

import pytest

import twin
from twin.cli import main
from twin.study.doubts import View, doubts
from twin.study.new_scene import Pad


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
