"""Rendered pictures against the closed-form camera: places, motion, occlusion, shadows, exposure.

Tests run on small pictures with the splat, and with Mitsuba where a libLLVM of this machine works.
"""

from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_scenes import SPLAT, beads, block, changed, finger, measured, mitsuba, rest_of, seen_at

from twin.errors import RecipeError
from twin.parts.markers import MarkerSet
from twin.parts.scene import Scene
from twin.theory.optics import rays
from twin.world.picture.camera_rays import View
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.lamps import Lamps
from twin.world.picture.mitsuba_tracer import MitsubaTracer
from twin.world.picture.picture_job import PictureJob
from twin.world.picture.render import Renderer
from twin.world.picture.splat import Splat


def job_of(scene, markers, k):
    """Return the job of a picture, and the arguments of a renderer for it."""
    top, _ = Lamps.brightest(markers, scene)
    view = View.of(scene, top)
    job = PictureJob.of(markers, scene, view, unit_mm=0.25, full_power=top, subpixels=k)
    return job, (view, 0.25, scene.light.ambient)


@pytest.fixture(name="scene", scope="module")
def _scene():
    return block()


@pytest.fixture(name="variant", scope="module", params=["splat", "mitsuba"])
def _variant(request):
    return SPLAT if request.param == "splat" else mitsuba()


@pytest.fixture(name="renderer", scope="module")
def _renderer(scene, variant):
    return Renderer(scene, rest_of(scene), variant)


def test_coverage_centroids_are_the_projected_centres(scene, renderer):
    markers = rest_of(scene)
    outlines = renderer.outlines(markers)
    assert (outlines.visible > 0.999).all()
    assert_allclose(outlines.centroid_px, seen_at(markers.centres, scene), atol=0.006)


def test_the_picture_shows_what_the_outlines_say(scene, renderer):
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


def test_moved_markers_leave_nothing_of_the_picture_before(scene, renderer):
    renderer.radiance(rest_of(scene))
    moved = Ellipsoids.of(MarkerSet.place(scene.body, scene.markers), scene.markers, np.full((10, 3), 0.2))
    fresh = Renderer(scene, rest_of(scene), renderer.variant).radiance(moved)
    assert_array_equal(renderer.radiance(moved), fresh)


def test_hidden_markers_have_the_share_and_the_centroid_of_what_is_seen(scene, renderer):
    # The camera is at large z: what lies deeper below the sensing surface is nearer to it.
    outlines = renderer.outlines(beads([(0, 0, 3), (0, 0, 6), (1, 0, 3)]))
    assert_allclose(outlines.visible, [0, 1, 1])
    assert np.isnan(outlines.centroid_px[0]).all()
    assert outlines.area_px[0] == 0
    outlines = renderer.outlines(beads([(0, 0, 3), (0.25, 0, 6)]), subpixels=6)
    places = seen_at(np.array([[0.0, 0, 3], [0.25, 0, 6]]), scene)
    at = seen_at(np.array([[0.0, 0, 3], [0.25, 0, 3], [0, 0, 6], [0.25, 0, 6]]), scene)[:, 0]
    smaller = (at[1] - at[0]) / (at[3] - at[2])  # a marker looks so much smaller at depth 3 than at 6
    radii = np.sqrt(outlines.area_px[1] / np.pi) * np.array([smaller, 1.0])
    grid = np.stack(np.meshgrid(np.arange(30, 90, 0.05), np.arange(20, 70, 0.05)), axis=-1)
    far, near = (np.linalg.norm(grid - p, axis=-1) < r for p, r in zip(places, radii, strict=True))
    left = far & ~near
    assert outlines.visible[0] == pytest.approx(left.sum() / far.sum(), abs=0.02)
    assert_allclose(outlines.centroid_px[0], grid[left].mean(axis=0), atol=0.05)


def test_the_rest_picture_peaks_at_white(scene):
    for gamma in (1.0, 2.2):
        lit = changed(scene, ccd={"gamma": gamma, "white_dn": 150.0, "crosstalk": 0.0})
        peak = Renderer(lit, rest_of(lit), SPLAT).radiance(rest_of(lit)).max()
        assert 255 * peak ** (1 / gamma) == pytest.approx(150, rel=0.02)


def test_dark_markers_on_a_bright_ground_are_exposed_by_the_ground(scene):
    dark = {name: layer.model_copy(update={"colour": (0.05, 0.05, 0.05)}) for name, layer in scene.markers.items()}
    lit = changed(scene, cover={"albedo": (0.8, 0.7, 0.6)}).model_copy(update={"markers": dark})
    renderer = Renderer(lit, rest_of(lit), SPLAT)
    radiance = renderer.radiance(rest_of(lit))
    channels = 255 * (radiance @ lit.ccd.response.T)
    assert (channels > lit.ccd.white_dn + 0.5).any(axis=2).mean() <= 0.01
    assert channels.max() > 0.95 * lit.ccd.white_dn
    row, column = np.rint(renderer.outlines(rest_of(lit)).centroid_px[0, ::-1]).astype(int)
    assert channels[row, column].max() < 0.2 * lit.ccd.white_dn


def test_a_marker_shadows_the_one_behind_it(scene, variant):
    led = np.array([20.0, 0, 105])
    lit = changed(scene, light={"positions_mm": (tuple(led),), "ambient": 0.1})
    renderer = Renderer(lit, rest_of(lit), variant)
    image = Lamps.at(np.array([[0.0, 0, 3]]), lit).place[0, 0]
    on_the_way = np.array([0, 0, 3]) + 3 * (image - [0, 0, 3]) / (image[2] - 3)
    row, column = 45, 59
    alone = renderer.radiance(beads([(0, 0, 3)]))[row, column, 0]
    behind = renderer.radiance(beads([(0, 0, 3), tuple(on_the_way)]))[row, column, 0]
    beside = renderer.radiance(beads([(0, 0, 3), tuple(on_the_way * [-1, 1, 1])]))[row, column, 0]
    assert beside == pytest.approx(alone, rel=1e-4)
    assert behind == pytest.approx(0.1 * alone / (0.1 + 0.9 * 0.97), rel=0.1)
    # Light that just misses a marker half-way is still taken by the one behind it.
    missed = tuple(0.5 * on_the_way + np.array([0, 1.02 * 0.25, 1.5]))
    assert renderer.radiance(beads([(0, 0, 3), missed]))[row, column, 0] == pytest.approx(alone, rel=1e-3)
    both = renderer.radiance(beads([(0, 0, 3), missed, tuple(on_the_way)]))[row, column, 0]
    assert both == pytest.approx(behind, rel=1e-3)
    without = Renderer(lit, rest_of(lit), variant, shadows=False)
    unshaded = without.radiance(beads([(0, 0, 3), tuple(on_the_way)]))[row, column, 0]
    assert unshaded == pytest.approx(alone, rel=1e-3)


def test_lost_markers_and_empty_pictures_are_no_trouble(scene, renderer):
    lost = beads([(0, 0, 6), (np.nan, 0, 6)])
    outlines = renderer.outlines(lost)
    assert_allclose(outlines.visible, [1, 0])
    one = renderer.radiance(beads([(0, 0, 6)]))
    assert_array_equal(renderer.radiance(lost), one)
    away = renderer.radiance(beads([(40, 0, 6)]))
    assert away.max() < 0.06
    on_the_edge = (-60 / 20.35, 0, 6)
    off, half = renderer.outlines(beads([(40, 0, 6), on_the_edge])).visible
    assert off == 0
    assert 0.35 < half < 0.65


def test_thin_prints_far_from_the_camera_keep_their_outline(variant):
    # Float32 rays that start at the base lose up to a third of such a print.
    scene = finger()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, variant, subpixels=3)
    outlines = renderer.outlines(markers)
    assert (outlines.visible > 0.995).all()
    conjugate = job_of(scene, markers, 3)[0].conjugate
    assert_allclose(outlines.area_px / (np.pi * np.sqrt(np.linalg.det(conjugate))), 1, atol=0.02)
    assert (outlines.area_px > 100).all()
    assert_allclose(outlines.centroid_px, seen_at(markers.centres, scene), atol=0.2)


def test_a_wide_pupil_blurs_what_is_out_of_focus_by_its_disc(scene):
    lit = changed(scene, camera={"aperture_mm": 4.0, "focus_z_mm": 6.0})
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
        # A disc of diameter d has variance d^2 / 16 along an axis.
        apparent = (40 - z) / 1.41 + 10 / 1.49 + 58.85
        focus = (40 - 6) / 1.41 + 10 / 1.49 + 58.85
        disc = 1814.8 * 4.0 * abs(1 / apparent - 1 / focus)
        assert moments[1] - moments[0] == pytest.approx(disc**2 / 16, abs=0.03)
        assert (disc > 1) == bool(blurred)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("focus_z_mm", 200.0, "camera.focus_z_mm = 200 mm"), ("tilt_deg", (170.0, 0.0, 0.0), "camera.tilt_deg")],
)
def test_a_lens_focused_on_what_it_cant_see_is_refused(scene, key, value, words):
    with pytest.raises(RecipeError, match="camera"):
        Renderer(scene.model_copy(update={"camera": None}), rest_of(scene), SPLAT)
    with pytest.raises(RecipeError, match=words):
        View.pupil_cameras(changed(scene, camera={"aperture_mm": 1.0, key: value}))


def test_vignetting_dims_by_the_cosine_to_its_power(scene):
    plain = changed(scene, camera={"focal_px": 200.0})
    dim = changed(plain, camera={"vignetting": 4.0})
    ratio = (Renderer(s, rest_of(s), SPLAT).radiance(beads([(40, 0, 6)]))[:, :, 0] for s in (dim, plain))
    found = np.divide(*ratio)[0, 0]
    assert found == pytest.approx(np.cos(np.arctan(np.hypot(59.5, 44.5) / 200)) ** 4, rel=1e-3)


def test_a_number_takes_the_cheapest_way_that_meets_it(scene, monkeypatch):
    monkeypatch.delenv("TWIN_VARIANT", raising=False)
    grids = []
    for asked in (0.3, 0.1, 0.05, 0.02, 0.01, 0.006, 0.004):
        wanted = scene.model_copy(update={"accuracy": Scene.Accuracy(centroid_px=asked)})
        renderer = Renderer(wanted, rest_of(wanted))
        assert renderer.variant.name == "splat"
        assert renderer.centroid_error_px <= asked
        assert renderer.shadows == (asked < 0.28)
        grids.append(renderer.subpixels)
    assert grids == sorted(grids)
    assert grids[0] == 1
    finest = Renderer(scene.model_copy(update={"accuracy": Scene.Accuracy(centroid_px=1e-4)}), rest_of(scene))
    assert (finest.subpixels, Renderer(scene, rest_of(scene), SPLAT).subpixels) == (16, 3)


@pytest.mark.parametrize("make", [block, finger])
def test_splat_and_mitsuba_make_one_picture(make):
    scene = make()
    markers = rest_of(scene)
    one, two = (Renderer(scene, markers, variant) for variant in (mitsuba(), SPLAT))
    a, b = one.radiance(markers), two.radiance(markers)
    # Edges of shadows are hard in one and smooth in the other.
    assert np.quantile(np.abs(a - b), 0.999) < 0.06
    # One ray inside an outline of 5 px misses a 300th of a bead's light.
    assert abs(a.mean() / b.mean() - 1) < 3e-3


@pytest.mark.parametrize("make", [block, finger])
@pytest.mark.parametrize("k", [1, 2, 7])
def test_pixels_of_one_marker_and_of_several_go_by_the_same_sums(make, k):
    """All pixels one by one, as if each could show several markers, against many at once."""
    scene = make()
    job, view = job_of(scene, rest_of(scene), k)
    splat = Splat(*view)
    fast_light, fast_free, fast = splat.look(job)
    slow_light, slow_free, slow = splat.look(replace(job, isolated=np.zeros_like(job.isolated)))
    dark = splat.look(job, bright=False)[2]
    assert 0.5 * len(job.pixels) < job.isolated[-1]
    # Vectors are singles: a thin print's metric costs two of their digits.
    assert_allclose(fast_light, slow_light, atol=5e-5)
    assert_allclose(fast_free, slow_free, atol=2e-5)
    assert fast_free.min() == 0
    # A sub-pixel's coverage may be rounded to the next of 4096 steps.
    for name, atol in (("area_px", 1e-3), ("visible", 1e-5), ("centroid_px", 1e-3)):
        assert_allclose(getattr(fast, name), getattr(slow, name), rtol=1e-5, atol=atol)
        assert_array_equal(getattr(dark, name), getattr(fast, name))


def test_picture_and_outlines_in_one_pass_are_those_of_two(scene, renderer):
    markers = rest_of(scene)
    for moved in (markers, markers.rows(slice(0, 0))):
        light, outlines = renderer.seen(moved)
        assert_array_equal(light, renderer.radiance(moved))
        for name in ("centroid_px", "visible", "area_px"):
            assert_array_equal(getattr(outlines, name), getattr(renderer.outlines(moved), name))


def test_outlines_are_what_traced_markers_cover(scene):
    """Outlines come in closed form; Mitsuba's rays give what markers leave free of pixels."""
    markers = beads([(0, 0, 6), (1.3, 0.9, 3), (-1.2, 0.7, 6)])
    variant = mitsuba()
    job, view = job_of(scene, markers, 4)
    _, free = MitsubaTracer(variant.name, *view).shade(job)
    covered = np.zeros(90 * 120)
    covered[job.pixels] = 1 - free
    covered = covered.reshape(90, 120)
    outlines = Renderer(scene, markers, SPLAT, subpixels=4).outlines(markers)
    centroids, area = measured(covered[:, :, None], outlines.centroid_px)
    assert_allclose(area, outlines.area_px, rtol=1e-3)
    assert_allclose(centroids, outlines.centroid_px, atol=0.004)


@pytest.mark.parametrize("make", [block, finger])
def test_outlines_are_what_exact_rays_meet(make):
    """Outlines come in closed form; here every ray is bent by Snell's law and meets the nearest ellipsoid or none."""
    scene = make()
    markers = rest_of(scene).rows(slice(0, 4))
    outlines = Renderer(scene, rest_of(scene), SPLAT, subpixels=4).outlines(markers)
    assert (outlines.visible > 0.999).all()
    unit = np.linalg.inv(markers.axes)
    steps = np.arange(-14, 14, 0.05) + 0.025
    window = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for number, place in enumerate(np.rint(outlines.centroid_px)):
        origins, along = rays(place + window, *scene.optics)
        start = np.einsum("nij,kj->kni", unit, origins) - np.einsum("nij,nj->ni", unit, markers.centres)
        way = np.einsum("nij,kj->kni", unit, along)
        square, middle = (way**2).sum(axis=2), (way * start).sum(axis=2)
        left = middle**2 - square * ((start**2).sum(axis=2) - 1)
        far = np.where(left > 0, (-middle - np.sqrt(np.maximum(left, 0))) / square, np.inf)
        met = (far.argmin(axis=1) == number) & np.isfinite(far.min(axis=1))
        assert met.sum() * 0.05**2 == pytest.approx(outlines.area_px[number], rel=1e-3)
        assert_allclose((place + window[met]).mean(axis=0), outlines.centroid_px[number], atol=0.004)


def test_finer_grids_converge():
    scene = block()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, SPLAT)
    best = renderer.outlines(markers, subpixels=16).centroid_px
    errors = [np.abs(renderer.outlines(markers, subpixels=k).centroid_px - best).max() for k in (1, 2, 4)]
    assert (np.array(errors) < [0.025, 0.008, 0.0035]).all()


@pytest.mark.parametrize("name", ["splat", pytest.param("mitsuba", marks=pytest.mark.slow)])
def test_threads_do_not_change_a_byte(name, monkeypatch):
    import drjit

    scene = finger()
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, SPLAT if name == "splat" else mitsuba())
    before = drjit.thread_count()
    found = []
    for threads in (1, 2, 3, 4):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
        if name == "mitsuba":
            drjit.set_thread_count(threads)
        found.append((renderer.radiance(markers), renderer.outlines(markers).centroid_px))
    drjit.set_thread_count(before)
    for light, centroids in found[1:]:
        assert_array_equal(light, found[0][0])
        assert_array_equal(centroids, found[0][1])


@pytest.mark.slow
def test_mitsuba_takes_no_more_threads_than_are_given(scene, monkeypatch):
    import drjit

    before = drjit.thread_count()
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)
    drjit.set_thread_count(2)
    Renderer(scene, rest_of(scene), mitsuba(), subpixels=1).radiance(rest_of(scene))
    assert drjit.thread_count() == 1
    drjit.set_thread_count(before)


@pytest.mark.slow
def test_moving_markers_compiles_nothing_again():
    scene = block()
    points = MarkerSet.place(scene.body, scene.markers)
    renderer = Renderer(scene, rest_of(scene), mitsuba(), subpixels=1)
    import drjit

    rng = np.random.default_rng(0)

    def picture():
        renderer.radiance(Ellipsoids.of(points, scene.markers, rng.uniform(-0.2, 0.2, (len(points), 3))))

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
