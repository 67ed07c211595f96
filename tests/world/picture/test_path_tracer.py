"""Pictures by Mitsuba's path integrator, which has light that others leave out, and scenes for stock Mitsuba."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from small_scenes import SPLAT, beads, block, changed, finger, measured, mitsuba, rest_of, seen_at

from twin.errors import MissingCapability, RecipeError
from twin.study.export_scene import export_scene
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.picture.lamps import Lamps
from twin.world.picture.render import Renderer
from twin.world.picture.stock_scene import check_stock, write_stock_scene


def path_traced(scene, markers, paths):
    """Return the path-traced picture of markers at rest."""
    asked = changed(scene, accuracy={"paths": paths}).model_copy(update={"renderer": "path"})
    return Renderer(asked, markers, mitsuba()).radiance(markers)


def dark(scene, which):
    """Return a scene without cover, and some of its markers, so dark that they light no other."""
    bare = changed(scene.model_copy(update={"cover": None}), light={"ambient": 0.0})
    some = rest_of(scene).rows(which)
    return bare, replace(some, colour=0.01 * np.ones_like(some.colour))


def integrated(scene, markers):
    """Return (n, 2) intensity centroids, px, by sums over points of each surface, each lit from
    where it sees the LEDs."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    unit = np.asarray(ball.vertices)
    centroids = []
    for centre, axes in zip(markers.centres, markers.axes, strict=True):
        places = centre + unit @ axes.T
        normals = unit @ np.linalg.inv(axes)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        bright = Lamps.at(places, scene).irradiance(places, normals)[ball.faces].mean(axis=1)
        one, two, three = (seen_at(places, scene)[ball.faces[:, k]] for k in range(3))
        (x, y), (u, v) = (two - one).T, (three - one).T
        # Rows grow downwards: what faces the camera turns the other way round in the picture.
        weight = np.maximum(y * u - x * v, 0) / 2 * bright
        centroids.append(weight @ ((one + two + three) / 3) / weight.sum())
    return np.array(centroids)


@pytest.mark.parametrize(("make", "which", "paths"), [(block, [0, 3, 5], 256), (finger, [0, 7, 12, 24], 256)])
def test_a_marker_alone_is_as_bright_as_its_surface_is_lit(make, which, paths):
    scene, markers = dark(make(), which)
    expected = integrated(scene, markers)
    centroid, light = measured(path_traced(scene, markers, paths), expected, half=18)
    assert_allclose(centroid, expected, atol=0.01)
    splat = Renderer(scene, markers, SPLAT, subpixels=6).radiance(markers)
    assert_allclose(light, measured(splat, expected, half=18)[1], rtol=0.01)


def test_no_count_of_paths_is_rounded_with_a_warning(capfd):
    path_traced(block(), beads([(0, 0, 6)]), paths=17)
    assert not any(capfd.readouterr())


def test_exposure_and_even_light_are_those_of_the_other_renderers():
    scene = changed(block(), light={"ambient": 0.5})
    markers = beads([(0, 0, 6)], colour=(0.01, 0.01, 0.01))
    path = path_traced(scene, markers, paths=64)
    splat = Renderer(scene, markers, SPLAT, subpixels=4).radiance(markers)
    assert_allclose(path[20:70, 40:80].sum(), splat[20:70, 40:80].sum(), rtol=0.03)
    corner = np.s_[:15, :15]
    assert_allclose(path[corner].mean(), splat[corner].mean(), rtol=0.03)


def test_a_marker_lights_its_neighbour_and_shadows_the_cover():
    """A white bead beside a dark one brightens it; under both the cover lies in their shadow."""
    scene = changed(block(), light={"ambient": 0.0})
    pair = beads([(-0.35, 0, 6), (0.35, 0, 6)], colour=(0.0, 0.0, 0.0))
    white = replace(pair, colour=np.array([[0.9] * 3, [0.3] * 3]))
    alone = white.rows(slice(1, 2))
    place = np.rint(seen_at(pair.centres, scene)[1]).astype(int)
    left = np.s_[place[1] - 3 : place[1] + 4, place[0] - 5 : place[0]]
    beside, single = (path_traced(scene, each, paths=256)[left].mean() for each in (white, alone))
    splat = [Renderer(scene, each, SPLAT).radiance(each)[left].mean() for each in (white, alone)]
    assert beside * splat[1] > 1.01 * single * splat[0]


def test_where_mitsuba_does_not_work_a_path_traced_scene_is_refused(monkeypatch):
    monkeypatch.setenv("TWIN_VARIANT", "splat")
    with pytest.raises(MissingCapability, match="renderer = 'path' needs Mitsuba"):
        Renderer.method(block().model_copy(update={"renderer": "path"}))


# --- scenes for stock Mitsuba ---------------------------------------------------------------------


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
