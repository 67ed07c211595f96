"""What a dataset becomes in other hands: exports, the contact sheet, the card, and a regression that learns from it."""

import io
import json
import math
import re
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from small_dataset import make, small_scene

import twin
from twin.errors import InputError
from twin.study.dataset.export import export_dataset
from twin.study.dataset.plan import Plan
from twin.study.dataset.reader import DatasetReader

SEEN = ("force_n", "torque_nmm", "surface_mm", "marker_displacement_mm", "marker_pressed_px", "picture")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four pressed samples of which one fails: it is pressed beside the body."""
    folder = tmp_path_factory.mktemp("formats") / "d"
    places = [[0.0, 0.0], [1.0, 1.0], [60.0, 0.0]]
    scene = small_scene(
        columns=(*SEEN, "contact_area_mm2"), vary={"press.at_mm": {"choice": places}}, dataset__samples_per_shard=6
    )
    assert 0 < make(folder, 6, scene).failed < 6
    return folder


@pytest.fixture(scope="module")
def good(made: Path) -> list[dict[str, Any]]:
    return [row for row in twin.open_dataset(made) if row["status"] == "ok"]


def test_coco_keypoints_are_the_markers(made: Path, good: list[dict[str, Any]], tmp_path: Path) -> None:
    export_dataset(made, "coco", tmp_path)
    told = json.loads((tmp_path / "keypoints.json").read_text())
    assert len(told["images"]) == len(told["annotations"]) == len(good)
    points = np.array(told["annotations"][1]["keypoints"]).reshape(-1, 3)
    inside = points[:, 2] > 0
    np.testing.assert_allclose(points[inside, :2] - 0.5, good[1]["marker_pressed_px"][inside], atol=1e-3)
    assert len(told["categories"][0]["keypoints"]) == len(points) == 59
    with Image.open(tmp_path / "images" / told["images"][1]["file_name"]) as image:
        np.testing.assert_array_equal(np.array(image), good[1]["picture"])


def test_webdataset_members_share_a_name(made: Path, good: list[dict[str, Any]], tmp_path: Path) -> None:
    (path,) = export_dataset(made, "webdataset", tmp_path)
    with tarfile.open(path) as tar:
        names = tar.getnames()
        assert sorted(names)[:3] == ["00000000.json", "00000000.npz", "00000000.png"]
        assert len(names) == 3 * len(good)
        held = tar.extractfile("00000001.npz")
        with np.load(io.BytesIO(held.read())) as arrays:
            np.testing.assert_array_equal(arrays["force_n"], good[1]["force_n"])


def test_hdf5_has_pictures_markers_and_wrench(made: Path, good: list[dict[str, Any]], tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (path,) = export_dataset(made, "hdf5", tmp_path)
    with h5py.File(path) as file:
        assert file["tactile/rgb"].shape == (len(good), 120, 160, 3)
        assert file["tactile/marker"].shape == (len(good), 2, 59, 2)
        np.testing.assert_array_equal(file["wrench"][1, :3], good[1]["force_n"])
        np.testing.assert_array_equal(file["truth/surface_mm"][1].reshape(-1, 3), good[1]["surface_mm"])


def test_an_unknown_format_is_refused(made: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hdf5, coco, webdataset"):
        export_dataset(made, "csv", tmp_path)
    with pytest.raises(InputError, match="lies in the dataset"):
        export_dataset(made, "coco", made / "coco")


def test_the_contact_sheet_shows_pictures_truth_and_failures(made: Path, tmp_path: Path) -> None:
    told = DatasetReader(made).write_sheet(tmp_path / "sheet.html")
    page = (tmp_path / "sheet.html").read_text()
    good = sum(row["status"] == "ok" for row in twin.open_dataset(made))
    assert "6 of 6 samples" in told
    assert page.count("data:image/webp;base64") == good
    assert page.count("failed") == 6 - good
    assert page.count(", force (") == good
    steps = [re.findall(r"M(\S+) (\S+)L([^\sM]+) ([^\sM]+)", path) for path in re.findall(r'<path d="(M[^"]*)"', page)]
    longest = [max(math.hypot(float(c) - float(a), float(d) - float(b)) for a, b, c, d in one) for one in steps]
    wide = twin.open_dataset(made).info["camera"]["width_px"]
    assert wide / 50 < np.median(longest) < wide / 8, "shifts are seen, and don't cover the picture"
    assert "http" not in page.replace("http://www.w3.org", "")


def test_the_card_tells_errors_and_croissant_names_every_column(made: Path) -> None:
    card = (made / "README.md").read_text()
    assert "marker displacement, over the largest" in card
    assert "| `contact_area_mm2` | mm2 |" in card
    assert Plan(small_scene(), 6).audited({0, 1, 4}) == [2]
    assert Plan(small_scene(), 500).audited({0, 499}) == [1, 125, 249, 373, 498]
    audit = json.loads((made / "meta" / "audit.json").read_text())
    assert 0 < audit["displacement"]["largest"] < 0.02
    told = json.loads((made / "croissant.json").read_text())
    named = {field["name"] for field in told["recordSet"][0]["field"]}
    assert named == set(twin.open_dataset(made).columns)
    for files, there in zip(told["distribution"], ("data", "sensors"), strict=True):  # as mlcroissant looks for them
        assert "containedIn" not in files
        assert sorted(made.glob(files["includes"])) == sorted((made / there).iterdir())


def test_a_sensors_pinhole_matrix_has_square_pixels_and_the_pictures_middle(made: Path) -> None:
    matrix = np.reshape(twin.open_dataset(made).sensor(0)["camera_matrix"], (3, 3))
    f = matrix[0, 0]
    assert f > 0
    assert matrix.tolist() == [[f, 0, 79.5], [0, f, 59.5], [0, 0, 1]]
