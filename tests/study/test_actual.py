"""The made sensor: what its tolerances draw, and from which streams."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.random_recipes import bounds
from twin.parts.load import Traction
from twin.parts.scene import Tolerance
from twin.parts.vary import CUT
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

DRAWN = {"tolerance.print_diameter_pct": 5.0, "tolerance.print_shade_pct": 8.0, "tolerance.missing": 0.1}


def test_prints_vary_as_told_and_change_no_other_draw() -> None:
    plain, drawn = (Sensor(load_scene("kamiyama_pillar", keys)).actual for keys in ({}, DRAWN))
    assert plain.prints is None
    np.testing.assert_array_equal(plain.jitter_mm, drawn.jitter_mm)
    assert plain.scene.camera == drawn.scene.camera
    prints = drawn.prints
    # 636 draws: standard deviations are known to 3 %, shares to 1.2 percent points.
    assert prints.size.std() == pytest.approx(0.05, rel=0.1)
    assert prints.shade.std() == pytest.approx(0.08, rel=0.1)
    assert np.abs(prints.size - 1).max() <= 0.05 * 2.5 + 1e-12
    assert prints.missing.mean() == pytest.approx(0.1, abs=0.04)
    again = Sensor(load_scene("kamiyama_pillar", DRAWN)).actual.prints
    np.testing.assert_array_equal(again.missing, prints.missing)
    assert Sensor(load_scene("kamiyama_pillar", {**DRAWN, "tolerance.preset": "none"})).actual.prints is None


@pytest.mark.parametrize("key", [key for key in Tolerance.model_fields if key.endswith("_pct")])
def test_no_tolerance_takes_what_is_positive_below_zero(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of Young's modulus was allowed as its standard deviation: one made sensor in fifty had a negative one."""
    worst = bounds(Tolerance.model_fields[key].metadata)[1]
    lowest = SimpleNamespace(standard_normal=lambda size=(): np.full(size, -2 * CUT), random=np.zeros)
    monkeypatch.setattr("twin.study.sensor.stream", lambda *_: lowest)
    made = Sensor(load_scene("kamiyama_pillar", {f"tolerance.{key}": worst})).actual
    assert min(made.scene.material.youngs_modulus_mpa, made.scene.camera.focal_px) > 0
    assert made.prints is None or min(made.prints.size.min(), made.prints.shade.min()) > 0


def test_a_missing_marker_is_neither_shown_nor_told_visible(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_VARIANT", "splat")
    sensor = Sensor(load_scene("sato_press", {"tolerance.missing": 0.2}))
    prints = sensor.actual.prints
    outlines = sensor.renderer.outlines(sensor.ellipsoids(None))
    assert prints.missing.any()
    np.testing.assert_array_equal(outlines.visible[prints.missing], 0)
    assert (outlines.visible[~prints.missing] > 0.9).all()
    assert np.isnan(outlines.centroid_px[prints.missing]).all()
    picture = sensor.picture(None).astype(int)
    assert picture.shape == (480, 640, 3)


def test_a_bright_cover_shows_its_bulge_when_asked_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_VARIANT", "splat")
    keys = {"ccd.preset": "ideal", "cover.albedo": [0.6, 0.6, 0.6], "camera.width_px": 160, "camera.height_px": 120,
            "camera.focal_px": 453.7, "light.positions_mm": [[45, 0, 60]], "tolerance.preset": "none"}  # fmt: skip
    load = Traction.disk((0, 0), 2.5, (0, 0, 3.0))
    still, moving = (Sensor(load_scene("kamiyama_pillar", {**keys, "cover.deforms": d})) for d in (False, True))
    assert still.motion(load).cover is None
    changed = moving.picture(load).astype(int) - still.picture(load)
    np.testing.assert_array_equal(moving.picture(None), still.picture(None))
    # Films and datasets show it, too.
    quick = moving.picture(moving.quick_motion(load)).astype(int)
    assert np.abs(quick - moving.picture(load)).max() <= 1
    assert moving.quick_motion(load, pictured=False).cover is None
    # The bulge around the press tilts the cover; far away nothing changes by more than a count.
    assert np.abs(changed[30:90, 50:110]).max() >= 2
    assert np.abs(changed[:5]).max() <= 1
