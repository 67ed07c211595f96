"""Rendered pictures against the closed-form camera: places, motion, occlusion, shadows, exposure.

The quick tests run Mitsuba's scalar variant and the splat on small pictures, so that they need no LLVM.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin.errors import RecipeError
from twin.parts.accuracy import Accuracy
from twin.parts.markers import place
from twin.parts.scene import Scene
from twin.theory.optics import Sight, project
from twin.world.picture import threads as pool
from twin.world.picture.crowded import shade_crowded
from twin.world.picture.defocus import through_the_pupil
from twin.world.picture.markers import Ellipsoids, ellipsoids
from twin.world.picture.render import Renderer, subpixels_for
from twin.world.picture.variant import Variant, choose_variant
from twin.world.picture.view import near_markers

SCALAR = Variant(name="scalar_rgb", library=None, reason="runs everywhere")
SPLAT = Variant(name="splat", library=None, reason="runs everywhere")
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.15, 0.9)


def layer(**keys: Any) -> dict[str, Any]:
    return {"depth_mm": 6, "pitch_mm": 1.5, "diameter_mm": 0.5, "columns": 3, "rows": 2, "colour": RED, **keys}


def block(**keys: Any) -> Scene:
    """The flat sensor around its middle: 120 x 90 px of it."""
    scene = {
        "body": {"shape": "block", "width_mm": 100, "length_mm": 90, "thickness_mm": 40},
        "material": {},
        "markers": {"red": layer(), "blue": layer(depth_mm=3, columns=2, rows=2, colour=BLUE, offset_mm=(0.0, 0.75))},
        "camera": {"width_px": 120, "height_px": 90, "focal_px": 1814.8, "pupil_mm": (0, 0, 108.85),
                   "layers": [{"index": 1.49, "thickness_mm": 10}]},
        "light": {"positions_mm": [(x, y, 105) for x in (-25, 25) for y in (-20, 20)]},
        "cover": {},
    }  # fmt: skip
    return Scene.model_validate({**scene, **keys})


def finger(**keys: Any) -> Scene:
    scene = {
        "body": {"shape": "finger", "radius_mm": 8, "barrel_mm": 8, "skirt_mm": 2},
        "material": {},
        "markers": {
            "red": layer(kind="print", depth_mm=0.5, pitch_mm=2.5, columns=5, rows=5),
            "blue": layer(kind="print", depth_mm=2, pitch_mm=2.5, columns=6, rows=6, colour=BLUE),
        },
        "camera": {"lens": "equidistant", "focal_px": 230, "pupil_mm": (0, 0, 12),
                   "layers": [{"index": 1.49, "thickness_mm": 1}]},
        "light": {"positions_mm": [(x, y, 11.5) for x in (-4, 4) for y in (-4, 4)]},
        "cover": {},
    }  # fmt: skip
    return Scene.model_validate({**scene, **keys})


def rest_of(scene: Scene) -> Ellipsoids:
    return ellipsoids(place(scene.body, scene.markers), scene.markers)


def seen_at(points: np.ndarray, scene: Scene) -> np.ndarray:
    assert scene.camera is not None
    return project(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)


def beads(
    centres: list[tuple[float, float, float]], radius_mm: float | list[float] = 0.25, colour: Any = RED
) -> Ellipsoids:
    n = len(centres)
    return Ellipsoids(
        centres=np.array(centres, float),
        axes=np.broadcast_to(radius_mm, n)[:, None, None] * np.eye(3),
        colour=np.broadcast_to(np.array(colour, float), (n, 3)).copy(),
    )


@pytest.fixture(name="scene", scope="module")
def _scene() -> Scene:
    return block()


@pytest.fixture(name="renderer", scope="module", params=[SCALAR, SPLAT], ids=lambda variant: variant.name)
def _renderer(scene: Scene, request: pytest.FixtureRequest) -> Renderer:
    return Renderer(scene, rest_of(scene), request.param)


def test_coverage_centroids_are_the_projected_centres(scene: Scene, renderer: Renderer) -> None:
    markers = rest_of(scene)
    outlines = renderer.outlines(markers)
    assert (outlines.visible > 0.999).all()
    np.testing.assert_allclose(outlines.centroid_px, seen_at(markers.centres, scene), atol=0.006)


def test_the_picture_shows_what_the_outlines_say(scene: Scene, renderer: Renderer) -> None:
    markers = rest_of(scene)
    light = renderer.radiance(markers)
    assert light.shape == (90, 120, 3)
    assert light.dtype == np.float32
    places = np.rint(renderer.outlines(markers).centroid_px).astype(int)
    middle = light[places[:, 1], places[:, 0]]
    assert (middle[:6, 0] > 4 * middle[:6, 2]).all()
    assert (middle[6:, 2] > 4 * middle[6:, 0]).all()
    # Black between the markers, and only the cover's faint light.
    assert np.median(light) < 0.05
    assert light[2, 2].min() > 0


def test_motion_in_millimetres_is_motion_in_pixels_without_mirror(scene: Scene, renderer: Renderer) -> None:
    rest = beads([(0, 0, 6)])
    start = renderer.outlines(rest)
    for move in ((0.31, 0, 0), (0, 0.17, 0), (-0.2, 0.1, 0.9)):
        there = beads([tuple(np.add((0, 0, 6), move))])
        shift = renderer.outlines(there).centroid_px - start.centroid_px
        expected = seen_at(there.centres, scene) - seen_at(rest.centres, scene)
        np.testing.assert_allclose(shift, expected, atol=0.01)
    up = renderer.radiance(beads([(0, 0.5, 6)]))[:, :, 0].sum(axis=1).argmax()
    right = renderer.radiance(beads([(0.5, 0, 6)]))[:, :, 0].sum(axis=0).argmax()
    assert up < 40
    assert right > 65


def test_moving_markers_keeps_the_mitsuba_scene(scene: Scene) -> None:
    renderer = Renderer(scene, rest_of(scene), SCALAR, subpixels=1)
    renderer.radiance(rest_of(scene))
    before = renderer._tracer._padded._scene
    moved = ellipsoids(place(scene.body, scene.markers), scene.markers, np.full((10, 3), 0.2))
    light = renderer.radiance(moved)
    assert renderer._tracer._padded._scene is before
    fresh = Renderer(scene, rest_of(scene), SCALAR, subpixels=1).radiance(moved)
    np.testing.assert_array_equal(light, fresh)


def test_the_nearer_marker_hides_the_farther(renderer: Renderer) -> None:
    # The camera is at large z: what lies deeper below the sensing surface is nearer to it.
    outlines = renderer.outlines(beads([(0, 0, 3), (0, 0, 6), (1, 0, 3)]))
    np.testing.assert_allclose(outlines.visible, [0, 1, 1])
    assert np.isnan(outlines.centroid_px[0]).all()
    assert outlines.area_px[0] == 0


def test_half_hidden_markers_tell_share_and_centroid_of_what_is_seen(scene: Scene, renderer: Renderer) -> None:
    outlines = renderer.outlines(beads([(0, 0, 3), (0.25, 0, 6)]), subpixels=6)
    places = seen_at(np.array([[0.0, 0, 3], [0.25, 0, 6]]), scene)
    radii = np.sqrt(outlines.area_px[1] / np.pi) * np.array([renderer_ratio(scene), 1.0])
    grid = np.stack(np.meshgrid(np.arange(30, 90, 0.05), np.arange(20, 70, 0.05)), axis=-1)
    far, near = (np.linalg.norm(grid - p, axis=-1) < r for p, r in zip(places, radii, strict=True))
    left = far & ~near
    assert outlines.visible[0] == pytest.approx(left.sum() / far.sum(), abs=0.02)
    np.testing.assert_allclose(outlines.centroid_px[0], grid[left].mean(axis=0), atol=0.05)


def renderer_ratio(scene: Scene) -> float:
    """How much smaller a marker looks at depth 3 than at depth 6."""
    assert scene.camera is not None
    at = seen_at(np.array([[0.0, 0, 3], [0.25, 0, 3], [0, 0, 6], [0.25, 0, 6]]), scene)[:, 0]
    return float((at[1] - at[0]) / (at[3] - at[2]))


def test_the_rest_picture_peaks_at_white(scene: Scene) -> None:
    for gamma in (1.0, 2.2):
        ccd = scene.ccd.model_copy(update={"gamma": gamma, "white_dn": 150.0, "crosstalk": 0.0})
        lit = scene.model_copy(update={"ccd": ccd})
        peak = Renderer(lit, rest_of(lit), SCALAR).radiance(rest_of(lit)).max()
        assert 255 * peak ** (1 / gamma) == pytest.approx(150, rel=0.02)


@pytest.mark.parametrize("variant", [SCALAR, SPLAT], ids=lambda variant: variant.name)
def test_a_marker_shadows_the_one_behind_it(scene: Scene, variant: Variant) -> None:
    led = np.array([20.0, 0, 105])
    lit = scene.model_copy(
        update={"light": scene.light.model_copy(update={"positions_mm": (tuple(led),), "ambient": 0.1})}
    )  # type: ignore[union-attr]
    renderer = Renderer(lit, rest_of(lit), variant)
    from twin.world.picture.lighting import lamps_at

    image = lamps_at(np.array([[0.0, 0, 3]]), lit).place[0, 0]
    on_the_way = np.array([0, 0, 3]) + 3 * (image - [0, 0, 3]) / (image[2] - 3)
    row, column = 45, 59
    alone = renderer.radiance(beads([(0, 0, 3)]))[row, column, 0]
    behind = renderer.radiance(beads([(0, 0, 3), tuple(on_the_way)]))[row, column, 0]
    beside = renderer.radiance(beads([(0, 0, 3), tuple(on_the_way * [-1, 1, 1])]))[row, column, 0]
    assert beside == pytest.approx(alone, rel=1e-4)
    assert behind == pytest.approx(0.1 * alone / (0.1 + 0.9 * 0.97), rel=0.1)


def test_lost_markers_and_empty_pictures_are_no_trouble(scene: Scene, renderer: Renderer) -> None:
    lost = beads([(0, 0, 6), (np.nan, 0, 6)])
    outlines = renderer.outlines(lost)
    np.testing.assert_allclose(outlines.visible, [1, 0])
    one = renderer.radiance(beads([(0, 0, 6)]))
    np.testing.assert_array_equal(renderer.radiance(lost), one)
    away = renderer.radiance(beads([(40, 0, 6)]))
    assert away.max() < 0.06
    np.testing.assert_array_equal(renderer.outlines(beads([(40, 0, 6)])).visible, [0])


def test_a_marker_on_the_edge_of_the_picture_is_seen_in_part(renderer: Renderer) -> None:
    outlines = renderer.outlines(beads([(-60 / 20.35, 0, 6)]))
    assert 0.35 < outlines.visible[0] < 0.65


@pytest.mark.parametrize("variant", [SCALAR, SPLAT], ids=lambda variant: variant.name)
def test_thin_prints_far_from_the_camera_keep_their_outline(variant: Variant) -> None:
    # Float32 rays that start at the base lose up to a third of such a print; these start just behind it.
    scene = finger()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, variant, subpixels=3)
    outlines = renderer.outlines(markers)
    assert (outlines.visible > 0.995).all()
    conjugate = near_markers(markers, scene, renderer._view, 3).conjugate
    np.testing.assert_allclose(outlines.area_px / (np.pi * np.sqrt(np.linalg.det(conjugate))), 1, atol=0.02)
    assert (outlines.area_px > 100).all()
    np.testing.assert_allclose(outlines.centroid_px, seen_at(markers.centres, scene), atol=0.2)


def test_a_stretched_print_looks_stretched() -> None:
    scene = finger(markers={"red": layer(kind="print", depth_mm=0.5, columns=1, rows=1)})
    gradient = np.zeros((1, 3, 3))
    gradient[:, 0, 0] = 0.3
    markers = ellipsoids(place(scene.body, scene.markers), scene.markers, None, gradient)
    renderer = Renderer(scene, rest_of(scene), SCALAR)
    ratio = renderer.outlines(markers).area_px / renderer.outlines(rest_of(scene)).area_px
    assert ratio[0] == pytest.approx(1.3, abs=0.02)


def test_a_wide_pupil_blurs_what_is_out_of_focus_by_its_disc(scene: Scene) -> None:
    camera = scene.camera
    assert camera is not None
    lit = scene.model_copy(update={"camera": camera.model_copy(update={"aperture_mm": 4.0, "focus_z_mm": 6.0})})
    sharp, wide = (Renderer(s, beads([(0, 0, 6), (1.5, 0, 0.5)]), SPLAT, subpixels=4) for s in (scene, lit))
    for z, blurred in ((6.0, 0.0), (0.5, 1.0)):
        markers = beads([(0, 0, z)])
        cover = sharp.radiance(beads([(40, 0, 6)]))
        moments = []
        for renderer in (sharp, wide):
            light = (renderer.radiance(markers) - cover)[:, :, 0].astype(float)
            columns = np.arange(120) - 59.5
            middle = (light.sum(axis=0) @ columns) / light.sum()
            assert abs(middle) < 0.02
            moments.append((light.sum(axis=0) @ (columns - middle) ** 2) / light.sum())
        # A disc of diameter d has variance d^2 / 16 along an axis; depths appear divided by the index.
        apparent = (40 - z) / 1.41 + 10 / 1.49 + 58.85
        focus = (40 - 6) / 1.41 + 10 / 1.49 + 58.85
        disc = 1814.8 * 4.0 * abs(1 / apparent - 1 / focus)
        assert moments[1] - moments[0] == pytest.approx(disc**2 / 16, abs=0.03)
        assert (disc > 1) == bool(blurred)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("focus_z_mm", 200.0, "camera.focus_z_mm = 200 mm"), ("tilt_deg", (170.0, 0.0, 0.0), "camera.tilt_deg")],
)
def test_a_lens_focused_on_what_it_cant_see_is_refused(scene: Scene, key: str, value: Any, words: str) -> None:
    assert scene.camera is not None
    turned = scene.camera.model_copy(update={"aperture_mm": 1.0, key: value})
    with pytest.raises(RecipeError, match=words):
        through_the_pupil(scene.model_copy(update={"camera": turned}))


@pytest.mark.parametrize("make", [block, finger])
def test_the_truth_beside_the_picture_is_what_the_picture_shows(make: Any) -> None:
    scene = make()
    rest = rest_of(scene)
    n = len(rest)
    layer = np.repeat([0, 1], [6, 4] if make is block else [25, 36])
    moved = ellipsoids(place(scene.body, scene.markers), scene.markers, np.tile([0.15, -0.1, 0.2], (n, 1)))
    renderer = Renderer(scene, rest, SPLAT)
    truth = renderer.truth(moved, rest, layer)
    light = renderer.radiance(moved)
    seen = truth.marker >= 0
    # Pixels of red markers are red, those of no marker are as dark as the cover.
    inner = seen & np.isin(truth.marker, np.flatnonzero(truth.visible > 0.999))
    for number, channel in ((0, 0), (1, 2)):
        of_layer = inner & (truth.layer == number)
        assert (np.argmax(light[of_layer], axis=-1) == channel).mean() > 0.98
    assert np.isnan(truth.z_mm[~seen]).all()
    radius = scene.markers["red"].diameter_mm / 2
    centre_z = moved.centres[truth.marker[seen], 2]
    assert (np.abs(truth.z_mm[seen] - centre_z) < 1.01 * radius).all()
    if make is block:
        assert (truth.z_mm[seen] >= centre_z - 1e-3).all()
    rows, columns = np.indices(truth.marker.shape)
    for i in np.flatnonzero(truth.visible > 0.999):
        mine = truth.marker == i
        assert mine.sum() == pytest.approx(truth.area_px[i], abs=3 + 0.06 * truth.area_px[i])
        middle = [columns[mine].mean(), rows[mine].mean()]
        np.testing.assert_allclose(middle, truth.outline_px[i], atol=0.25)
    np.testing.assert_allclose(truth.flow_px, seen_at(moved.centres, scene) - seen_at(rest.centres, scene))
    whole = (truth.visible > 0.999) & (renderer.outlines(rest).visible > 0.999)
    np.testing.assert_allclose(truth.outline_flow_px[whole], truth.flow_px[whole], atol=0.2)
    np.testing.assert_allclose(truth.depth_mm, scene.body.base_z_mm - moved.centres[:, 2])
    assert (truth.sight == Sight.SEEN).all()


def test_vignetting_dims_by_the_cosine_to_its_power(scene: Scene) -> None:
    camera = scene.camera
    assert camera is not None
    dim = scene.model_copy(update={"camera": camera.model_copy(update={"vignetting": 4.0, "focal_px": 200.0})})
    plain = scene.model_copy(update={"camera": camera.model_copy(update={"focal_px": 200.0})})
    ratio = (Renderer(s, rest_of(s), SPLAT).radiance(beads([(40, 0, 6)]))[:, :, 0] for s in (dim, plain))
    found = np.divide(*ratio)[0, 0]
    assert found == pytest.approx(np.cos(np.arctan(np.hypot(59.5, 44.5) / 200)) ** 4, rel=1e-3)


def test_without_camera_there_is_no_renderer(scene: Scene) -> None:
    bare = scene.model_copy(update={"camera": None})
    with pytest.raises(RecipeError, match="camera"):
        Renderer(bare, rest_of(scene), SCALAR)


def test_accuracy_chooses_the_grid() -> None:
    assert subpixels_for("auto") == 3
    wanted = [subpixels_for(e) for e in (0.1, 0.02, 0.006, 0.004, 1e-9)]
    assert wanted == sorted(wanted)
    assert wanted[0] == 1
    assert wanted[-1] == 16


def test_a_number_takes_the_cheapest_way_that_meets_it(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TWIN_VARIANT", raising=False)
    for asked in (0.3, 0.05, 0.01):
        wanted = scene.model_copy(update={"accuracy": Accuracy(centroid_px=asked)})
        renderer = Renderer(wanted, rest_of(wanted))
        assert renderer.variant.name == "splat"
        assert renderer.centroid_error_px <= asked
        assert renderer.shadows == (asked < 0.28)


@pytest.mark.parametrize("make", [block, finger])
def test_splat_and_scalar_make_one_picture(make: Any) -> None:
    scene = make()
    if scene.camera.lens == "equidistant":
        scene = scene.model_copy(update={"camera": scene.camera.model_copy(
            update={"width_px": 160, "height_px": 120, "focal_px": 60})})  # fmt: skip
    markers = rest_of(scene)
    one, two = (Renderer(scene, markers, variant) for variant in (SCALAR, SPLAT))
    a, b = one.radiance(markers), two.radiance(markers)
    # Edges of shadows are hard in one and smooth in the other.
    assert np.quantile(np.abs(a - b), 0.999) < 0.06
    # One ray inside an outline of 5 px misses a 300th of a bead's light: its curvature within a pixel.
    assert abs(a.mean() / b.mean() - 1) < 3e-3


@pytest.mark.parametrize("make", [block, finger])
@pytest.mark.parametrize("k", [1, 2, 7])
def test_pixels_of_one_marker_and_of_several_go_by_the_same_sums(make: Any, k: int) -> None:
    """All pixels of a picture one by one, as if each could show several markers, against many at once."""
    scene = make()
    renderer = Renderer(scene, rest_of(scene), SPLAT, subpixels=k)
    frame = renderer._frame(rest_of(scene), k)
    seen, near, lists = renderer._splat.look(frame), frame.near, frame.occluders
    assert 0.5 * len(near.pixels) < near.alone[-1]
    light, free = np.full((len(near.pixels), 3), np.nan, np.float32), np.full(len(near.pixels), np.nan, np.float32)
    tallies = np.zeros((len(frame), 4))
    shade_crowded(
        0, len(near.pixels), near.pixels, near.first, near.members, renderer._splat.corners, frame.base, frame.centres,
        frame.metric, frame.colour, frame.lamps, lists.first, lists.members, np.rint(near.centres_px).astype(np.int64),
        k, max(k // 3, 1), scene.light.ambient, True, light, free, tallies)  # fmt: skip
    # Lanes are singles: a thin print's metric, a hundred of them across it, costs two of their digits.
    np.testing.assert_allclose(seen.light, light, atol=5e-5)
    np.testing.assert_allclose(seen.free, free, atol=2e-5)
    # A sub-pixel's coverage may be rounded to the next of 4096 steps.
    np.testing.assert_allclose(np.column_stack([seen.whole, seen.seen]), tallies[:, :2], rtol=1e-5, atol=2)
    assert free.min() == 0
    only = renderer._splat.look(frame, bright=False)
    np.testing.assert_array_equal(only.moments, seen.moments)
    np.testing.assert_array_equal(only.seen, seen.seen)


@pytest.mark.parametrize("make", [block, finger])
def test_picture_and_outlines_in_one_pass_are_those_of_two(make: Any) -> None:
    scene = make()
    renderer = Renderer(scene, rest_of(scene), SPLAT)
    light, outlines = renderer.seen(rest_of(scene))
    np.testing.assert_array_equal(light, renderer.radiance(rest_of(scene)))
    for name in ("centroid_px", "visible", "area_px"):
        np.testing.assert_array_equal(getattr(outlines, name), getattr(renderer.outlines(rest_of(scene)), name))


def test_traced_pictures_share_their_preparation_with_outlines(scene: Scene, renderer: Renderer) -> None:
    markers = rest_of(scene)
    for moved in (markers, markers.rows(slice(0, 0))):
        light, outlines = renderer.seen(moved)
        np.testing.assert_array_equal(light, renderer.radiance(moved))
        np.testing.assert_array_equal(outlines.centroid_px, renderer.outlines(moved).centroid_px)


def test_outlines_are_what_traced_markers_cover(scene: Scene) -> None:
    """Outlines come in closed form; Mitsuba's rays say what markers leave free of each pixel, hit by hit."""
    markers = beads([(0, 0, 6), (1.3, 0.9, 3), (-1.2, 0.7, 6)])
    renderer = Renderer(scene, markers, SCALAR, subpixels=4)
    frame = renderer._frame(markers, 4)
    _, free = renderer._tracer.shade(frame)
    covered = np.zeros(90 * 120)
    covered[frame.near.pixels] = 1 - free
    covered = covered.reshape(90, 120)
    rows, columns = np.indices(covered.shape)
    outlines = renderer.outlines(markers)
    for centre, area in zip(outlines.centroid_px, outlines.area_px, strict=True):
        own = np.hypot(columns - centre[0], rows - centre[1]) < 10
        assert covered[own].sum() == pytest.approx(area, rel=1e-3)
        middle = [(covered * own * axis).sum() / covered[own].sum() for axis in (columns, rows)]
        np.testing.assert_allclose(middle, centre, atol=0.004)


def test_splat_has_the_same_bytes_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = finger()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, SPLAT)
    found = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(pool.config, "NUMBA_NUM_THREADS", threads)
        found.append((renderer.radiance(markers), renderer.outlines(markers).centroid_px))
    for light, centroids in found[1:]:
        np.testing.assert_array_equal(light, found[0][0])
        np.testing.assert_array_equal(centroids, found[0][1])


def fast() -> Variant:
    variant = choose_variant()
    if variant.name != "llvm_ad_rgb":
        pytest.skip(variant.reason)
    return variant


@pytest.mark.slow
@pytest.mark.parametrize("make", [block, finger])
def test_variants_agree(make: Any) -> None:
    scene = make()
    markers = rest_of(scene)
    one, two = Renderer(scene, markers, SCALAR), Renderer(scene, markers, fast())
    a, b = one.radiance(markers), two.radiance(markers)
    assert np.quantile(np.abs(a - b), 0.9999) < 0.02
    assert np.abs(a - b).mean() < 1e-5


@pytest.mark.slow
def test_finer_grids_converge() -> None:
    scene = block()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, fast())
    best = renderer.outlines(markers, subpixels=16).centroid_px
    errors = [np.abs(renderer.outlines(markers, subpixels=k).centroid_px - best).max() for k in (1, 2, 4)]
    assert (np.array(errors) < [0.025, 0.008, 0.0035]).all()


@pytest.mark.slow
def test_threads_do_not_change_a_byte() -> None:
    scene = finger()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, fast())
    import drjit

    before = drjit.thread_count()
    found = []
    for threads in (1, 2, 4):
        drjit.set_thread_count(threads)
        found.append((renderer.radiance(markers), renderer.outlines(markers).centroid_px))
    drjit.set_thread_count(before)
    for light, centroids in found[1:]:
        np.testing.assert_array_equal(light, found[0][0])
        np.testing.assert_array_equal(centroids, found[0][1])


@pytest.mark.slow
def test_moving_markers_compiles_nothing_again() -> None:
    scene = block()
    points = place(scene.body, scene.markers)
    renderer = Renderer(scene, rest_of(scene), fast(), subpixels=1)
    import drjit

    rng = np.random.default_rng(0)

    def picture() -> None:
        renderer.radiance(ellipsoids(points, scene.markers, rng.uniform(-0.2, 0.2, (len(points), 3))))

    for _ in range(3):
        picture()
    drjit.set_flag(drjit.JitFlag.KernelHistory, True)
    try:
        for _ in range(20):
            drjit.kernel_history_clear()
            picture()
            assert all(kernel["cache_hit"] for kernel in drjit.kernel_history() if "hash" in kernel)
    finally:
        drjit.set_flag(drjit.JitFlag.KernelHistory, False)
