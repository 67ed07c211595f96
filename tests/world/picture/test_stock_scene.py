"""Scenes for stock Mitsuba: as they are written, rendered by it alone, against Snell's law and our own picture."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_scenes import SPLAT, block, changed, measured, mitsuba, rest_of, seen_at

from twin.errors import RecipeError
from twin.study.export_scene import export_scene
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.picture.render import Renderer
from twin.world.picture.stock_scene import check_stock, write_stock_scene

CORNERS = [(x, y, 105.0) for x in (-55.0, 55.0) for y in (-45.0, 45.0)]
WIDE = {"positions_mm": CORNERS, "radius_mm": 40.0, "ambient": 0.0}
"""Discs so wide that chance finds them."""


@pytest.mark.slow
def test_stock_mitsuba_renders_what_is_written_as_we_do(tmp_path):
    """Places, exposure and a turned camera; light between markers, a few per cent, is in theirs only."""
    scene = changed(block(), light=WIDE, camera={"principal_px": (61.5, 43.0), "tilt_deg": (0.05, -0.08, 2.0)})
    scene = scene.model_copy(update={"cover": None})
    markers = rest_of(scene)
    moved = replace(markers, centres=markers.centres + np.array([0.1, -0.05, 0.2]))
    places = seen_at(moved.centres, scene)
    inside = ((places > 10) & (places < (109, 79))).all(axis=1)
    renderer = Renderer(scene, markers, SPLAT, subpixels=4)
    mitsuba()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    written = mi.load_file(str(write_stock_scene(tmp_path, "pressed", scene, renderer.exposure, moved)))
    theirs = np.mean([mi.render(written, spp=132, seed=n) for n in range(4)], axis=0)
    ours, seen = renderer.radiance(moved), (places[inside], moved.colour[inside].argmax(axis=1))
    centroid, light = measured(theirs, *seen)
    expected, bright = measured(ours, *seen)
    assert len(centroid) > 8
    assert_allclose(centroid, expected, atol=0.1)
    assert_allclose(centroid, places[inside], atol=0.4)  # a marker is brighter on the side of an LED
    red = moved.colour[inside][:, 0] > 0.5
    assert_allclose(light[red], bright[red], rtol=0.03)
    assert_allclose(light, bright, rtol=0.12)  # the red ones shadow the blue: seven points stand for a disc


def test_a_scene_is_written_with_its_parts_and_what_is_left_out(tmp_path):
    scene = changed(block(), light={"ambient": 0.3}, tolerance={"preset": "none"})
    (file,) = export_scene(scene, tmp_path / "made")
    assert file.name == "rest.xml"
    readme = (tmp_path / "made" / "README.md").read_text()
    assert "light.ambient` = 0.3" in readme
    assert "discs of 1 mm" in readme
    assert "minus 45 mm" in readme
    mitsuba()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    shapes = {shape.id(): shape for shape in mi.load_file(str(file)).shapes()}
    assert set(shapes) == {"interface0", "interface1", "led0", "led1", "led2", "led3", "rest_markers", "rest_cover"}
    assert shapes["rest_markers"].face_count() == 1280 * len(rest_of(scene))
    box = shapes["rest_markers"].bbox()
    assert_allclose([box.min.z, box.max.z], [3 - 0.25 - 45, 6 + 0.25 - 45], atol=1e-3)
    assert_allclose(shapes["rest_cover"].bbox().max.z, scene.cover.thickness_mm - 45, atol=1e-3)


@pytest.mark.slow
def test_a_press_moves_the_triangles_of_its_markers(tmp_path):
    import trimesh

    scene = load_scene("kamiyama_pillar")
    files = export_scene(scene, tmp_path)
    assert [file.name for file in files] == ["rest.xml", "pressed.xml"]
    rest, pressed = (
        trimesh.load(tmp_path / f"{name}_markers.ply", process=False).vertices.reshape(636, -1, 3).mean(axis=1)
        for name in ("rest", "pressed")
    )
    sensor = Sensor(scene)
    assert_allclose(rest + np.array([0, 0, 45]), sensor.actual.markers.points, atol=1e-4)
    assert_allclose(pressed - rest, sensor.motion(sensor.press().load).displacement_mm, atol=1e-4)


def test_a_scene_without_a_camera_is_refused(tmp_path):
    with pytest.raises(RecipeError, match=r"no \[camera\] table"):
        export_scene(load_scene("block_bare"), tmp_path)


WIDE_PUPIL = {"aperture_mm": 2.0, "focus_z_mm": 5.0}


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        ("camera", {"distortion": (0.1, 0.0)}),
        ("camera", {"aspect": 1.1}),
        ("camera", {"vignetting": 4.0}),
        ("camera", {"lens": "equidistant"}),
        ("camera", {"principal_px": (50.0, 44.5), **WIDE_PUPIL}),
        ("light", {"exponent": 2.0}),
        ("light", {"profile": ((0.0, 1.0), (60.0, 0.0))}),
    ],
)
def test_what_stock_mitsuba_lacks_is_refused_by_its_key(table, keys):
    check_stock(changed(block(), camera=WIDE_PUPIL))
    with pytest.raises(RecipeError, match=f"{table}.{next(iter(keys))}.*stock Mitsuba has no plug-in"):
        check_stock(changed(block(), **{table: keys}))
