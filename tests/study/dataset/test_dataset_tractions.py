"""Datasets of tractions that are given outright, and how tractions are summed into cells."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_dataset import NO_PICTURE, contents, make, small_scene

import twin
from twin.errors import RecipeError
from twin.parts.load import Footprint, Load, Traction
from twin.parts.scene import Sites
from twin.study.dataset.audit import check_dataset
from twin.study.dataset.columns import in_cells
from twin.study.dataset.reader import DatasetReader
from twin.world.elasticity.discretise import tile

TWO: dict[str, Any] = {
    "tractions": [
        {"kind": "bump", "centre_mm": [0, 0], "radius_mm": 2.0, "force_n": [0, 0, 0.5]},
        {"kind": "disk", "centre_mm": [0, 0], "radius_mm": 1.5, "force_n": [0.1, 0, 0.2]},
    ],
    "vary": {
        "tractions.0.centre_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]},
        "tractions.1.radius_mm": {"low": 1.0, "high": 2.0},
        "tractions.1.force_n": {"normal_n": {"low": 0.1, "high": 0.5}, "ratio": {"low": 0.0, "high": 1.0}},
    },
}


@pytest.fixture(name="made", scope="module")
def _made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tractions") / "d"
    made = make(folder, 4, small_scene((*NO_PICTURE, "surface_mm"), **TWO))
    assert (made.failed, made.missing) == (0, ())
    return folder


def test_given_tractions_move_the_markers_as_a_sensor_under_that_load_says(made: Path) -> None:
    data = twin.open_dataset(made)
    for index in range(4):
        sample = data[index]
        given = [Footprint(**table) for table in json.loads(sample["press"])]
        row = data.sensor(sample["sensor"])
        sensor = twin.Sensor(small_scene(**TWO).model_copy(update={"seed": row["seed"]}))
        load = sum((each.load() for each in given), Load())
        moved = sensor.displacement(row["marker_rest_mm"], load)
        off = np.abs(sample["marker_displacement_mm"] - moved).max() / np.abs(moved).max()
        assert off < 1e-3, "the load is gathered into point forces, each footprint by itself"
        np.testing.assert_allclose(sample["force_n"], np.sum([each.force_n for each in given], axis=0), atol=1e-9)
        np.testing.assert_allclose(sample["site_force_n"].sum(axis=0), sample["force_n"], atol=1e-9)
    assert "checksums and schema ok" in check_dataset(made)[0][0]


def test_the_same_samples_whatever_the_files_and_a_sheet_of_them(made: Path, tmp_path: Path) -> None:
    make(tmp_path / "again", 4, small_scene((*NO_PICTURE, "surface_mm"), **TWO))
    assert contents(tmp_path / "again") == contents(made)
    make(tmp_path / "seen", 2, small_scene(("picture", "marker_outline_pressed_px", *NO_PICTURE), **TWO))
    assert "2 of 2" in DatasetReader(tmp_path / "seen").write_sheet(tmp_path / "sheet.html")


def test_how_many_samples_a_worker_made_before_does_not_matter(tmp_path: Path) -> None:
    """Points asked about often are read another way: that must not depend on what was asked before."""
    scene = small_scene(NO_PICTURE, **TWO, dataset__samples_per_shard=30, dataset__samples_per_sensor=60)
    make(tmp_path / "d", 60, scene)
    made = contents(tmp_path / "d")
    (tmp_path / "d" / "data" / "part-00001.parquet").unlink()
    make(tmp_path / "d", 60, scene)
    assert contents(tmp_path / "d") == made


def test_what_only_a_press_tells_is_refused_or_left_out(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match="indentation_mm' is known of a press only"):
        make(tmp_path / "a", 2, small_scene(("indentation_mm",), **TWO))
    with pytest.raises(RecipeError, match=r"vary.press.friction: no press is done"):
        make(tmp_path / "b", 2, small_scene(**{**TWO, "vary": {"press.friction": {"low": 0.1, "high": 0.2}}}))
    with pytest.raises(RecipeError, match=r"tractions.0.colour: unknown key; known are"):
        make(tmp_path / "c", 2, small_scene(**{**TWO, "vary": {"tractions.0.colour": {"low": 0.1, "high": 0.2}}}))


def test_a_single_run_takes_given_tractions_instead_of_its_press() -> None:
    result = twin.run(small_scene(**TWO), {"displacement"})
    np.testing.assert_allclose(result.truth.total_force_n, [0.1, 0, 0.7], atol=1e-9)
    assert np.abs(result.truth.marker_displacement_mm).max() > 1e-3


def test_cells_hold_the_share_of_a_rectangle_that_lies_in_them() -> None:
    """A rectangle of 2.25 x 1.4 mm off the grid: overlaps with the cells in closed form."""
    scene = small_scene()
    grid = Sites(columns=12, rows=10, pitch_mm=0.5)
    patch = tile(Traction.rectangle((0.3, -0.2), (2.25, 1.4), (0.2, 0.0, 1.0)), scene.body)
    force, contact, slip = in_cells(grid, scene.body, [patch], [np.ones(1, bool)])
    edges = [np.linspace(-n / 4, n / 4, n + 1) for n in (12, 10)]
    along = [
        np.clip(np.minimum(e[1:], c + s / 2) - np.maximum(e[:-1], c - s / 2), 0, None)
        for e, c, s in zip(edges, (0.3, -0.2), (2.25, 1.4), strict=True)
    ]
    share = np.outer(*along).ravel() / (2.25 * 1.4)
    # Pieces are a sixth of a cell wide, and whole ones are counted.
    np.testing.assert_allclose(force[:, 2], share, atol=0.18 * share.max())
    np.testing.assert_allclose(contact, share * 2.25 * 1.4 / 0.25, atol=0.18)
    np.testing.assert_allclose(force.sum(axis=0), [0.2, 0, 1])
    np.testing.assert_array_equal(slip > 0, contact > 0)
    # A disk is cut into long strips, which are cut where cells are: even contact, no stripes.
    disk = tile(Traction.disk((0.0, 0.0), 2.0, (0, 0, 1)), scene.body)
    _, contact, _ = in_cells(grid, scene.body, [disk], None)
    assert contact.reshape(12, 10)[4:8, 3:7].min() > 0.9
