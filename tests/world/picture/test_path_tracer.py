"""Pictures by Mitsuba's path integrator, which has light that others leave out, and scenes for stock Mitsuba."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.ndimage import map_coordinates
from small_scenes import SPLAT, beads, block, changed, faced, finger, measured, mitsuba, rest_of, seen_at

from twin.errors import InputError, MissingCapability, RecipeError
from twin.parts.camera import Camera
from twin.parts.material import Cover
from twin.study.export_scene import export_scene
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.lens import lens as lens_of
from twin.world.picture.cover import Background, CoverMotion
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
    splat_centroid, splat_light = measured(splat, expected, half=18)
    assert_allclose(splat_centroid, expected, atol=0.01)
    assert_allclose(light, splat_light, rtol=0.01)


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


CORNERS = [(x, y, 105.0) for x in (-55.0, 55.0) for y in (-45.0, 45.0)]
WIDE = {"positions_mm": CORNERS, "radius_mm": 40.0, "ambient": 0.0}
"""Discs so wide that chance finds them."""


OPENCV = {"distortion": (-0.3, 0.1, 0.003, -0.002), "aspect": 1.1, "vignetting": 4.0, "principal_px": (14.0, 17.0)}


def small(**camera):
    """Return a small picture of the block under wide LEDs."""
    return changed(block(), light=WIDE, camera={"width_px": 32, "height_px": 32, **camera}, accuracy={"paths": 16384})


def stock_picture(tmp_path, scene, markers, exposure, paths, cover=None):
    """Return what stock Mitsuba makes of the files, seen through the lens that is written beside them."""
    mitsuba()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    (file,) = write_stock_scene(tmp_path, scene, exposure, {"seen": (markers, cover)})
    written = mi.load_file(str(file))
    picture = np.mean([mi.render(written, spp=1024, seed=n) for n in range(paths // 1024)], axis=0)
    if not (tmp_path / "lens.npz").exists():
        return picture
    lens = np.load(tmp_path / "lens.npz")
    at = lens["rows"], lens["columns"]
    fine = np.stack([map_coordinates(picture[:, :, c], at, order=1) for c in range(3)], axis=2)
    return fine.reshape(scene.camera.height_px, 2, -1, 2, 3).mean(axis=(1, 3)) * lens["light"][:, :, None]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "paths", "off_px"),
    [
        ({"principal_px": (17.0, 14.5), "tilt_deg": (0.02, -0.03, 2.0)}, 32768, 0.01),
        (OPENCV, 8192, 0.01),  # of four pixels each
        ({"lens": "equidistant"}, 8192, 0.01),
    ],
)
def test_stock_mitsuba_renders_what_is_written_as_path_does(tmp_path, camera, paths, off_px):
    """Places, exposure, light between markers and the lens; bounds are the noise of stock Mitsuba's picture."""
    scene, markers = small(**camera), beads([(0, 0, 3)], 0.35)
    traced = Renderer(scene.model_copy(update={"renderer": "path"}), markers, mitsuba())
    ours, places = traced.radiance(markers), seen_at(markers.centres, scene)
    theirs = stock_picture(tmp_path, scene, markers, traced.exposure, paths)
    assert_allclose(theirs.mean(axis=(0, 1)), ours.mean(axis=(0, 1)), rtol=0.01)
    expected, bright = measured(ours, places, half=12)
    centroid, light = measured(theirs, places, half=12)
    assert_allclose(centroid, expected, atol=off_px)
    assert_allclose(light, bright, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("z_mm", [0.5, -1.0])
def test_stock_mitsuba_sees_a_probe_behind_clear_rubber_as_we_do(tmp_path, z_mm):
    """A face in touch, and one behind a gap: brighter by the index squared."""
    scene = small().model_copy(update={"cover": None})
    cover = CoverMotion(displacement_mm=np.zeros((0, 3)), gradient=np.zeros((0, 3, 3)), probes=(faced(z_mm, 1.0),))
    markers = beads([(0, 0, np.nan)])
    renderer = Renderer(scene, beads([(0, 0, 6)]), SPLAT)
    theirs = stock_picture(tmp_path, scene, markers, renderer.exposure, 4096, cover)
    ours = renderer.radiance(markers, cover)
    face = np.s_[11:19, 13:22]
    assert_allclose(theirs[face].mean(axis=(0, 1)), ours[face].mean(axis=(0, 1)), rtol=0.02)
    assert theirs[:, :, 0].sum() == pytest.approx(ours[:, :, 0].sum(), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("z_mm", [-1.0, -3.0])
def test_light_to_a_probe_behind_a_gap_passes_the_cover_beside_the_picture(tmp_path, z_mm):
    markers, exposure = beads([(0, 0, np.nan)]), Renderer(small(), beads([(0, 0, 6)]), SPLAT).exposure
    scene = small().model_copy(update={"cover": Cover(transmittance=0.4, albedo=(0.0, 0.0, 0.0))})
    cover = CoverMotion(displacement_mm=np.zeros((0, 3)), gradient=np.zeros((0, 3, 3)), probes=(faced(z_mm, 1.0),))
    renderer = Renderer(scene, beads([(0, 0, 6)]), SPLAT)
    ours = renderer.radiance(markers, cover) * exposure / renderer.exposure
    theirs = stock_picture(tmp_path, scene, markers, exposure, 4096, cover)
    assert theirs.sum() == pytest.approx(ours.sum(), rel=0.03)


@pytest.mark.slow
def test_a_probe_shadows_a_cover_that_it_does_not_lift(tmp_path):
    """All that stock Mitsuba sees darker than we do is a cover that stays beside a probe that stands out of it."""
    markers, exposure = beads([(0, 0, np.nan)]), Renderer(small(), beads([(0, 0, 6)]), SPLAT).exposure
    ratios = {}
    for lifts in (True, False):
        sheet = Cover(transmittance=0.4, albedo=(0.3, 0.3, 0.3), deforms=lifts)
        scene = small().model_copy(update={"cover": sheet})
        places = Background(scene, 1.0).moving
        cover = CoverMotion(
            displacement_mm=np.tile([0.0, 0.0, 0.5], (len(places), 1)),
            gradient=np.zeros((len(places), 3, 3)),
            probes=(faced(0.5, 1.0),),
        )
        ours = Renderer(scene, beads([(0, 0, 6)]), SPLAT).radiance(markers, cover)
        ratios[lifts] = stock_picture(tmp_path, scene, markers, exposure, 2048, cover).sum() / ours.sum()
    assert ratios[True] == pytest.approx(1.0, abs=0.01)
    assert ratios[False] < 0.95


def test_marks_and_probes_are_written_where_they_stand(tmp_path):
    bubbles = Camera.Marks(count=300, size_mm=0.4, hollow=0.7, albedo=0.3, depth_mm=2.0)
    scratches = Camera.Marks(count=7, size_mm=0.2, length_mm=3.0, albedo=0.2)
    scene = changed(block(), camera={"bubbles": bubbles, "scratches": scratches}, light=WIDE)
    scene = scene.model_copy(update={"cover": Cover(transmittance=0.4, albedo=(0.3, 0.3, 0.3))})
    places = Background(scene, 1.0).moving
    still = CoverMotion(
        displacement_mm=np.zeros_like(places), gradient=np.zeros((len(places), 3, 3)), probes=(faced(0.5),)
    )
    down = scene.window_middle_mm
    write_stock_scene(tmp_path, scene, 1.0, {"seen": (rest_of(scene), still)})
    parts = {
        name: trimesh.load(tmp_path / f"seen_{name}.ply", process=False)
        for name in ("specks0", "marks0", "probe0", "surface")
    }
    assert_allclose(parts["specks0"].bounds[:, 2] + down, 2 + 0.2 * np.sqrt(1 - 0.7**2) * np.array([-1, 1]), atol=0.012)
    # A ring covers the square of 0.7 less than a disc; seen from above it is there twice.
    across = np.abs(parts["specks0"].face_normals[:, 2]) @ parts["specks0"].area_faces
    assert across == pytest.approx(300 * 2 * np.pi * 0.2**2 * (1 - 0.7**2), rel=0.06)
    assert parts["marks0"].area == pytest.approx(7 * (3.0 * 0.2 + np.pi * 0.1**2), rel=0.01)
    assert_allclose(parts["marks0"].bounds[:, 2] + down, 50.001, atol=1e-4)
    assert parts["surface"].bounds[1, 2] + down == pytest.approx(0.0, abs=1e-4)
    # The face stands where it is, under a cover that lies on it.
    face = parts["probe0"].vertices[parts["probe0"].vertex_normals[:, 2] > 0.99]
    assert_allclose(face[:, 2] + down, 0.5 + 0.2 + 0.05, atol=1e-3)
    assert_allclose((face.max(axis=0) - face.min(axis=0))[:2], 2.0, rtol=0.01)
    assert "mask" in (tmp_path / "seen.xml").read_text()


def test_a_scene_is_written_with_its_parts_and_what_is_left_out(tmp_path):
    scene = changed(block(), light={"ambient": 0.3}, tolerance={"preset": "none"})
    (file,) = export_scene(scene, tmp_path / "made")
    assert file.name == "rest.xml"
    readme = (tmp_path / "made" / "README.md").read_text()
    assert "light.ambient` = 0.3" in readme
    assert "discs of 1 mm" in readme
    assert "make the picture 1 times as bright" in readme  # they are mirrored beside this picture
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


def test_a_scene_without_a_camera_is_refused_and_a_file_for_a_folder_before_a_sensor_is_made(tmp_path, monkeypatch):
    with pytest.raises(RecipeError, match=r"no \[camera\] table"):
        export_scene(load_scene("block_bare"), tmp_path)
    monkeypatch.setattr("twin.study.export_scene.Sensor", None)
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match="there is a file of that name"):
        export_scene(block(), tmp_path / "taken")


@pytest.mark.parametrize("keys", [{"exponent": 2.0}, {"profile": ((0.0, 1.0), (60.0, 0.0))}])
def test_leds_that_stock_mitsuba_lacks_are_refused_by_their_key(keys):
    check_stock(block())
    with pytest.raises(RecipeError, match=f"light.{next(iter(keys))}.*stock Mitsuba has no plug-in"):
        check_stock(changed(block(), light=keys))


@pytest.mark.parametrize(
    "keys",
    [
        {"distortion": (0.1, 0.0)},
        {"aspect": 1.1},
        {"vignetting": 4.0},
        {"lens": "equidistant"},
        {"principal_px": (50.0, 44.5), "aperture_mm": 2.0, "focus_z_mm": 5.0},
    ],
)
def test_a_lens_that_stock_mitsuba_lacks_is_written_beside_a_pinhole(tmp_path, keys):
    """Each pixel's place in the pinhole's picture is where that has the same direction."""
    scene = changed(block(), camera=keys, tolerance={"preset": "none"})
    export_scene(scene, tmp_path)
    assert "cv2.remap" in (tmp_path / "README.md").read_text()
    film = ElementTree.parse(tmp_path / "rest.xml").find("sensor/film")
    width, height = (int(film.find(f"integer[@name='{key}']").get("value")) for key in ("width", "height"))
    focal = 2 * scene.camera.focal_px * max(scene.camera.aspect, 1)
    lens = np.load(tmp_path / "lens.npz")
    right = (lens["columns"] - (width - 1) / 2) / focal
    up = ((height - 1) / 2 - lens["rows"]) / focal
    towards = np.stack([right, up, -np.ones_like(up)], axis=2).reshape(-1, 3)
    pixels = lens_of(towards, scene.camera).reshape(180, 240, 2)
    assert_allclose(pixels[..., 0], np.broadcast_to((np.arange(240) + 0.5) / 2 - 0.5, (180, 240)), atol=1e-3)
    assert_allclose(pixels[..., 1], np.broadcast_to((np.arange(180)[:, None] + 0.5) / 2 - 0.5, (180, 240)), atol=1e-3)
    vignetted = (1 + right**2 + up**2).reshape(90, 2, 120, 2).mean(axis=(1, 3)) ** (-scene.camera.vignetting / 2)
    assert_allclose(lens["light"], vignetted, rtol=1e-4)


def test_the_cover_is_drawn_to_the_bodys_edge():
    """Squares of the grid of rays that the edge cuts were black: 8 % of a picture as small as this, now 0.3."""
    light = []
    for renderer in ("splat", "path"):
        small = {"camera.width_px": 160, "camera.height_px": 120, "camera.focal_px": 57.5, "accuracy.paths": 64}
        sensor = Sensor(load_scene("sato_press", small | {"renderer": renderer, "tolerance.preset": "none"}))
        light.append(sensor.renderers[0].radiance(sensor.ellipsoids(None)).sum(axis=2))
    fast, path = light
    assert (fast > 0).mean() > 0.6
    assert (path < 0.6 * fast).mean() < 0.01
