"""Intrinsics in OpenCV's files, against files that OpenCV wrote."""

import tomllib
from pathlib import Path

import pytest

from twin.errors import InputError
from twin.parts.camera import Camera
from twin.study.check import check_path
from twin.study.intrinsics import read_intrinsics, write_intrinsics
from twin.study.recipe import load_scene

REFERENCE = Path(__file__).parents[1] / "reference"
KNOWN = {
    "lens": "pinhole", "focal_px": 500.0, "aspect": 1.02, "principal_px": (331.5, 228.25),
    "distortion": (-0.1, 0.02, 0.003, -0.002, 0.01), "width_px": 640, "height_px": 480,
}  # fmt: skip


@pytest.mark.parametrize("name", ["opencv_camera.yml", "opencv_camera.json"])
def test_opencvs_own_files_are_read(name: str) -> None:
    assert read_intrinsics(REFERENCE / name) == KNOWN


@pytest.mark.parametrize("name", ["made.yml", "made.json"])
@pytest.mark.parametrize(("lens", "distortion"), [("pinhole", (-0.1, 0.02)), ("equidistant", (0.1, 0.2, 0.3, 0.4)),
                                                  ("pinhole", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0))])  # fmt: skip
def test_what_is_written_is_read_back(name: str, lens: str, distortion: tuple[float, ...], tmp_path: Path) -> None:
    camera = Camera(lens=lens, focal_px=431.25, aspect=0.9, distortion=distortion, pupil_mm=(0, 0, 60), width_px=320)
    write_intrinsics(camera, tmp_path / name)
    keys = read_intrinsics(tmp_path / name)
    assert keys["distortion"][: len(distortion)] == distortion
    assert not any(keys["distortion"][len(distortion) :])
    assert keys["focal_px"] == 431.25
    assert keys["aspect"] == pytest.approx(0.9)
    assert keys["principal_px"] == camera.centre_px
    assert (keys["lens"], keys["width_px"], keys["height_px"]) == (lens, 320, 480)


@pytest.mark.parametrize("name", ["camera.json", "camera.yml"])
def test_a_file_that_an_editor_marked_as_utf8_is_read(name: str, tmp_path: Path) -> None:
    write_intrinsics(Camera(focal_px=500, pupil_mm=(0, 0, 60)), tmp_path / name)
    plain = read_intrinsics(tmp_path / name)
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + (tmp_path / name).read_bytes())
    assert read_intrinsics(tmp_path / name) == plain


def test_ros_files_are_read(tmp_path: Path) -> None:
    file = tmp_path / "ros.yaml"
    file.write_text(
        "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [230, 0, 319.5, 0, 230, 239.5, 0, 0, 1]\ndistortion_model: equidistant\n"
        "distortion_coefficients: {rows: 1, cols: 4, data: [0.1, 0, 0, 0]}\n"
    )
    assert read_intrinsics(file)["lens"] == "equidistant"


def test_a_scene_takes_its_camera_from_a_file() -> None:
    scene = load_scene("kamiyama_pillar", {"camera.intrinsics": str(REFERENCE / "opencv_camera.yml")})
    assert scene.camera.focal_px == 500
    assert scene.camera.distortion == KNOWN["distortion"]
    assert scene.camera.pupil_mm == (0, 0, 108.85)
    assert scene.camera.source["focal_px"] == "file opencv_camera.yml"  # type: ignore[index]
    head, *lines = check_path(str(REFERENCE / "opencv_camera.yml"))
    assert '[camera] intrinsics = "opencv_camera.yml"' in head
    assert tomllib.loads("\n".join(lines))["focal_px"] == 500


@pytest.mark.parametrize(("text", "named"), [
    ("", "table"), ("a: [1", "not valid"), ("camera_matrix: 3", "3 x 3"), ("a: 1", "no camera_matrix"),
    ("camera_matrix: [1, 0, 0, 0, .nan, 0, 0, 0, 1]", "finite"),
    ("camera_matrix: [1, 5, 0, 0, 1, 0, 0, 0, 1]", "fx, 0, cx"),
    ("camera_matrix: [9, 0, 0, 0, 9, 0, 0, 0, 1]\nD: [0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]", "more than 8"),
    ("camera_matrix: !!python/object:os.system [1]", "not valid"),
])  # fmt: skip
def test_bad_files_are_refused_by_name(text: str, named: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.yml"
    file.write_text(text)
    with pytest.raises(InputError, match=named) as caught:
        read_intrinsics(file)
    assert "bad.yml" in str(caught.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can't be read"):
        read_intrinsics(tmp_path / "none.yml")
    with pytest.raises(InputError, match="can't be written"):
        write_intrinsics(Camera(focal_px=500, pupil_mm=(0, 0, 60)), tmp_path / "no" / "where.yml")
