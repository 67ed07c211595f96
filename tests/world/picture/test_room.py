"""Room for a picture: what it is estimated to take, and what is said where there is less."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from twin.errors import MissingCapability
from twin.study.dataset.create import create_dataset
from twin.study.recipe import load_scene
from twin.study.run import run
from twin.study.sensor import Sensor
from twin.world.picture import room

LARGE = {"camera.width_px": 8192, "camera.height_px": 8192}


def test_a_picture_is_not_estimated_to_take_less_than_what_is_kept_of_its_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_VARIANT", "splat")
    scene = load_scene("kamiyama_pillar", {"light.radius_mm": 0.5, "camera.width_px": 160, "camera.height_px": 120})
    view = Sensor(scene).renderer._view
    kept = sum(
        getattr(view, each.name).nbytes for each in fields(view) if isinstance(getattr(view, each.name), np.ndarray)
    )
    assert 0.7 * room.RAYS_BYTES < kept / view.sees.size < room.RAYS_BYTES


def test_no_camera_takes_nothing_and_a_pupil_takes_a_view_for_every_point() -> None:
    assert room.needed_bytes(load_scene("block_bare")) == 0
    point, wide = (room.needed_bytes(load_scene("kamiyama_pillar", {"camera.aperture_mm": a})) for a in (0.0, 0.5))
    assert 3.5 < wide / point < 5


def test_what_is_free_is_the_least_that_the_system_tells(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "meminfo").write_text("MemTotal: 9000 kB\nMemAvailable: 5000 kB\n")
    (tmp_path / "max").write_text("max\n")
    monkeypatch.setattr(room, "LEFT", (tmp_path / "meminfo", tmp_path / "max"))
    assert room.free_bytes() == 5000 * 1024
    (tmp_path / "max").write_text("1000000\n")
    assert room.free_bytes() == 1_000_000


def test_a_picture_without_room_is_refused_before_anything_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda: 8_000_000_000)
    monkeypatch.setattr(Sensor, "press", lambda *_, **__: pytest.fail("pressed"))
    with pytest.raises(
        MissingCapability, match=r"camera.width_px = 8192.* about 9.3 GB.* 8.0 GB are free .*fewer pixels"
    ):
        run(load_scene("kamiyama_pillar", LARGE))
    with pytest.raises(MissingCapability, match=r"aperture_mm = 0 "):
        Sensor(load_scene("kamiyama_pillar", {**LARGE, "camera.aperture_mm": 0.5})).picture(None)


def test_a_scene_of_many_pixels_runs_where_no_picture_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda: 1_000_000)
    assert run(load_scene("kamiyama_pillar", {**LARGE, "press.friction": 0.0}), {"displacement"}).truth is not None


def test_as_many_workers_of_a_dataset_as_have_work_need_room_beside_each_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(room, "free_bytes", lambda: 100_000_000)
    scene = load_scene("dataset_kamiyama", {"dataset.samples_per_shard": 5})
    with pytest.raises(MissingCapability, match=r"4 pictures at once .*fewer --workers"):
        create_dataset(scene, tmp_path / "set", samples=20, workers=8)
    assert not (tmp_path / "set").exists()
