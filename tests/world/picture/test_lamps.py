"""LEDs through flat layers: inverse-square law, conservation of light, visibility."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_scenes import beads, block, changed

from twin.parts.camera import Camera
from twin.study.recipe import load_scene
from twin.theory.optics import air_tangents, rays, transmission
from twin.world.picture.backend import RAYS_BYTES
from twin.world.picture.camera_rays import View
from twin.world.picture.cover import Background, CoverMotion, cover_light
from twin.world.picture.lamps import Lamps
from twin.world.picture.picture_job import PictureJob

UP = np.array([[0.0, 0.0, 1.0]])
SMALL = {"camera.width_px": 160, "camera.height_px": 120}


def scene(index=1.41, glass=1.49, led=(10.0, 5.0, 70.0)):
    layers = [{"index": glass, "thickness_mm": 10}]
    return block(
        material={"refractive_index": index},
        cover={"albedo": (0.2, 0.1, 0.05)},
        camera={"focal_px": 500, "pupil_mm": (0, 0, 100), "layers": layers},
        light={"positions_mm": [led], "exponent": 1.0, "ambient": 0.0},
    )


def test_refraction_keeps_the_light_of_the_led():
    # All light of cos^1 emission is pi; a wide plane collects what is not reflected.
    wide = {"width_mm": 500, "length_mm": 500}
    made = changed(scene(1.41, 1.41, (0.0, 0.0, 55.0)), body=wide)
    r = np.linspace(0.005, 150, 4000)
    points = np.column_stack([r, 0 * r, np.full(len(r), 39.9)])
    up = np.tile([0.0, 0, 1], (len(r), 1))
    flux = np.sum(2 * np.pi * r * Lamps.at(points, made).irradiance(points, up))
    # Fresnel's reflection takes 6 % of evenly spread light beyond the 3 % of normal incidence.
    assert flux * (r[1] - r[0]) == pytest.approx(np.pi * 0.94, rel=0.02)


def test_the_image_on_the_axis_is_the_paraxial_one():
    points = np.array([[10.0, 5.0, 4.0]])
    lamps = Lamps.at(points, scene())
    apparent = 36 + 1.41 * (10 / 1.49 + 20)
    assert_allclose(lamps.place[0, 0], [10, 5, 4 + apparent], atol=1e-6)


def test_the_power_of_an_image_changes_as_its_light_does():
    """Close to a grazing LED: light at places around, from images of the place in the middle."""
    made = changed(scene(), light={"positions_mm": ((4.0, 4.0, 51.0), (-3.0, 0.0, 60.0))})
    middle, rng = np.array([[0.5, -2.0, 37.0]]), np.random.default_rng(3)
    lamps = Lamps.at(middle, made, changing=True)
    off = 0.1 * rng.normal(size=(40, 3))
    exact = Lamps.at(middle + off, made)
    wanted = exact.power / np.sum((exact.place - (middle + off)[:, None]) ** 2, axis=2)
    away = np.sum((lamps.place - (middle + off)[:, None]) ** 2, axis=2)
    still, moved = (wanted - (lamps.power + share * off @ lamps.change[0].T) / away for share in (0, 1))
    assert np.abs(moved).max() < 0.1 * np.abs(still).max()


def test_images_stand_along_the_rays_of_the_cameras_closed_form():
    layers = (Camera.Layer(index=1.49, thickness_mm=2.0), Camera.Layer(index=1.6, thickness_mm=0.5))
    lights = np.array([[4.0, 4, 42.5], [-20, 3, 43], [0, 0, 90]])
    made = changed(scene(), camera={"layers": layers}, light={"positions_mm": tuple(map(tuple, lights))})
    points = np.random.default_rng(1).uniform([-8, -8, 30], [8, 8, 40], (30, 3))
    lamps = Lamps.at(points, made)
    for j, light in enumerate(lights):
        aside, depth = light[:2] - points[:, :2], 40 - points[:, 2]
        reach = np.linalg.norm(aside, axis=1)
        p = air_tangents(reach, depth, 1.41, layers, np.full(30, light[2] - 42.5))
        lit = np.isfinite(p)  # no ray leads from a light that touches the layers to all places
        leaving = 1 / np.sqrt(1 + p**2)
        assert_allclose(
            lamps.power[:, j], np.where(lit, 1.41**2 * transmission(p, 1.41, layers) * leaving, 0), rtol=1e-9
        )
        tangent = p / np.sqrt(1.41**2 + (1.41**2 - 1) * p**2)
        ray = np.column_stack([aside * (tangent / reach)[:, None], np.ones(30)])
        assert_allclose(np.cross(ray, lamps.place[:, j] - points)[lit], 0, atol=1e-7)
        assert lit.any()
        assert lit.all() or j == 0


def test_the_cover_sends_its_albedo_back():
    made = changed(scene(), light={"ambient": 0.3})
    origins = np.array([[0.0, 0, 40], [0, 0, 40], [np.nan, 0, 40], [60, 0, 40]])
    directions = np.array([[0.0, 0, -1], [0.9, 0, -np.sqrt(0.19)], [0, 0, -1], [0, 0, -1]])
    light = cover_light(origins, directions, made, 1.0)
    below = np.array([[0.0, 0, 0.2]])
    expected = 0.3 + 0.7 * Lamps.at(below, made).irradiance(below, UP)
    assert_allclose(light[0], expected * np.array([0.2, 0.1, 0.05]), rtol=1e-6)
    assert (light[1:] == 0).all()  # out of the side wall, no ray, beside the body
    bare = made.model_copy(update={"cover": None})
    assert (cover_light(origins, directions, bare, 1.0) == 0).all()


def test_the_cover_ends_where_its_own_pixels_do():
    # Light is interpolated from every fourth pixel, but not over the finger's cut back face.
    made = load_scene("sato_press", SMALL | {"camera.focal_px": 57})
    view = View.of(made, 1.0)
    row, column = np.indices((120, 160)).reshape(2, -1)
    pixels = np.column_stack([column, row]).astype(float)
    back = rays(pixels, made.camera, made.material.refractive_index, made.body.base_z_mm)
    each = cover_light(*back, made, 1.0)
    truth = each.reshape(120, 160, 3) * (view.vignette * view.sees)[:, :, None]
    lit = truth.any(axis=2)
    assert (view.sees & ~lit).mean() > 0.1
    assert (view.cover.any(axis=2) == lit).all()
    assert np.abs(view.cover - truth).max() < 0.03 * truth.max()


def test_the_estimated_memory_of_rays_holds_what_is_kept_of_them():
    made = load_scene("kamiyama_pillar", SMALL | {"light.radius_mm": 0.5})
    arrays = [each for each in vars(View.of(made, 0.01)).values() if isinstance(each, np.ndarray)]
    kept = sum(each.nbytes for each in arrays)
    assert 0.7 * RAYS_BYTES < kept / (160 * 120) < RAYS_BYTES


@pytest.mark.parametrize("height", [100.0, 7.0])
def test_shadow_candidates_contain_every_true_shadow(height):
    rng = np.random.default_rng(2)
    centres = np.column_stack([rng.uniform(-5, 5, (200, 2)), rng.choice([3.0, 6.0], 200)])
    centres[7] = np.nan
    markers = beads(centres)
    places = ((25.0, 20.0, height), (-25.0, 20.0, height))
    made = changed(scene(), light={"positions_mm": places})
    given = {"unit_mm": 0.5, "full_power": 1.0, "subpixels": 1}
    view = View.of(made, 1.0)
    job = PictureJob.of(markers, made, view, **given)
    for led in range(2):
        lit = job.lamps[:, led, 3] > 0
        towards = job.lamps[:, led, :3] - job.centres
        length = np.linalg.norm(towards, axis=1)
        towards /= length[:, None]
        for i in np.delete(np.arange(200), 7):
            w = job.centres - job.centres[i]
            along = w @ towards[i]
            miss = np.linalg.norm(w - along[:, None] * towards[i], axis=1)
            between = (along > 0) & (along < length[i]) & (np.arange(200) != i)
            true = np.flatnonzero(between & (miss < 1.0))
            listed = job.occluder_members[job.occluder_first[2 * i + led] : job.occluder_first[2 * i + led + 1]]
            assert not lit[i] or set(true) <= set(listed)
    listed = np.diff(job.occluder_first) > 0
    assert not listed[14:16].any()
    assert 0.02 < listed.mean() < (0.9 if height > 50 else 1)
    assert not PictureJob.of(markers, made, view, **given, shadows=False).occluder_first.any()


def test_the_brightest_marker_sets_the_exposure():
    made = scene()
    markers = beads([(10.0, 5, 3), (-30, 5, 3)], colour=np.eye(3)[:2])
    top, white = Lamps.brightest(markers, made)
    lamps = Lamps.at(markers.centres, made)
    nearest = Lamps(place=lamps.place[:1], power=lamps.power[:1])
    assert top == pytest.approx(nearest.irradiance(markers.centres[:1], UP)[0])
    assert white == pytest.approx(1 - 2 * made.ccd.crosstalk)


@pytest.mark.parametrize("height", [20.0, 70.0])
def test_an_led_in_the_body_or_without_refraction_shines_straight_along_minus_z(height):
    led = (10.0, 5.0, height)
    made = scene(led=led) if height < 40 else scene(1.0, 1.0, led)
    points = np.array([[0.0, 0, 3], [20, -10, 6], [10, 5, 25]])
    towards = np.array(led) - points
    distance = np.linalg.norm(towards, axis=1)
    lit = Lamps.at(points, made).irradiance(points, towards / distance[:, None])
    assert_allclose(lit, np.maximum(towards[:, 2], 0) / distance**3, rtol=1e-9)
    assert (lit[2] == 0) == (height < 25)  # above the LED


def test_an_emission_profile_replaces_the_power_law():
    made = scene(1.0, 1.0)
    angles = np.linspace(0, 90, 181)
    table = tuple((float(a), float(np.cos(np.deg2rad(a)) ** 3)) for a in angles)
    points = np.array([[0.0, 0, 3], [40, -10, 6], [10, 5, 0]])
    kinds = ({"exponent": 3.0}, {"profile": table})
    found = [Lamps.at(points, changed(made, light=keys)).power for keys in kinds]
    assert_allclose(found[1], found[0], rtol=2e-4)


def test_a_disc_of_light_is_the_integral_over_it():
    disc = changed(scene(1.0, 1.0, (0.0, 0.0, 55.0)), light={"radius_mm": 6.0})
    points, up = np.array([[0.0, 0, 30], [8, 3, 20]]), np.tile([0.0, 0, 1], (2, 1))
    lamps = Lamps.at(points, disc)
    assert lamps.power.shape == (2, 7)
    r = np.repeat((np.arange(200) + 0.5) / 200 * 6, 64)
    a = np.tile(np.arange(64) / 64 * 2 * np.pi, 200)
    places = np.column_stack([r * np.cos(a), r * np.sin(a), np.full_like(r, 55.0)])
    for point, lit in zip(points, lamps.irradiance(points, up), strict=True):
        towards = places - point
        share = towards[:, 2] ** 2 / np.linalg.norm(towards, axis=1) ** 4
        exact = np.average(share, weights=r)
        assert lit == pytest.approx(exact, rel=2e-4)
    # On the axis in closed form: E = 1 / (d^2 + R^2) for a Lambertian disc of intensity 1.
    on_axis = Lamps.at(points[:1], disc).irradiance(points[:1], UP)[0]
    assert on_axis == pytest.approx(1 / (25**2 + 36), rel=1e-4)


def test_a_cover_that_moves_and_tilts_is_lit_like_one_that_stands_so():
    """A cover lifted and tilted by little, against light computed in the moved place."""
    made = scene(1.41, 1.49, (10.0, 5.0, 70.0))
    ground = Background(made, 1.0)
    points = ground.points
    assert len(points) > 800
    assert_allclose(points[:, 2], 0.2, atol=1e-3)
    height, tilt = 0.8, 0.05
    gradient = np.zeros((len(points), 3, 3))
    gradient[:, 2, 0] = tilt
    moved = np.zeros_like(points)
    moved[:, 2] = height
    factor = ground.change(CoverMotion(displacement_mm=moved, gradient=gradient))
    assert factor.shape == (480, 640, 1)
    middle = np.array([[0.0, 0.0, 0.2]])
    normal = np.array([[-tilt, 0.0, 1.0]]) / np.hypot(1, tilt)
    before = Lamps.at(middle, made).irradiance(middle, UP)
    lifted = middle + np.array([0.0, 0, height])
    after = Lamps.at(lifted, made).irradiance(lifted, normal)
    assert factor[239:241, 319:321].mean() == pytest.approx((after / before)[0], rel=1e-4)
    still = ground.change(CoverMotion(displacement_mm=0 * moved, gradient=0 * gradient))
    assert_allclose(still, 1, atol=1e-6)
    # With the sides in view, places lie in the body, where their motion is known.
    sides = made.model_copy(update={"camera": made.camera.model_copy(update={"focal_px": 300.0})})
    made.body.require_inside(Background(sides, 1.0).points)


def test_the_window_mirrors_a_disc_of_light_where_and_as_bright_as_it_stands():
    """One interface: the image of a disc in the base, by similar triangles and Fresnel."""
    camera = {"pupil_mm": (0.0, 0.0, 100.0), "layers": (), "focal_px": 2000.0}
    plain = scene(1.41, 1.0, (3.0, 0.0, 70.0))
    made = changed(plain, camera=camera, light={"radius_mm": 0.5})
    top = 0.01
    veil = View.of(made, top).veil[:, :, 0]
    # Down 60 mm and up 30 mm: 3 mm aside are 66.7 px, a radius of 0.5 mm 11.1 px.
    per_mm = 2000 / 90
    share = veil / veil.max()
    rows, columns = np.indices(share.shape)
    centre = np.array([np.sum(share * columns), np.sum(share * rows)]) / share.sum()
    assert_allclose(centre, [319.5 + 3 * per_mm, 239.5], atol=0.02)
    assert share.sum() == pytest.approx(np.pi * (0.5 * per_mm) ** 2, rel=0.01)
    # White paper under irradiance E sends E T / (pi n^2) into the air.
    sent_back = (0.41 / 2.41) ** 2
    disc, paper = sent_back / (np.pi * 0.5**2), top * (1 - sent_back) ** 2 / (np.pi * 1.41**2)
    assert veil.max() == pytest.approx(disc / paper, rel=1e-3)


def test_points_and_leds_in_the_body_have_no_mirror_image():
    made = scene()
    assert View.of(made, 1.0).veil is None
    inside = {"radius_mm": 5.0, "positions_mm": ((0.0, 0.0, 20.0),)}
    assert View.of(changed(made, light=inside), 1.0).veil is None


def test_every_interface_mirrors_and_none_makes_light():
    """A plate of glass adds a fainter, nearer image; matched to the body, it moves the one."""
    veil = View.of(changed(scene(led=(8.0, 0.0, 70.0)), light={"radius_mm": 0.3}), 0.01).veil[:, :, 0]
    levels = [veil[240, 319 + round(500 * 8 / reach)] for reach in (70, 70 + 20 / 1.49)]
    straight = [((1.49 - 1) / 2.49) ** 2, (1 - (0.49 / 2.49) ** 2) ** 2 * (0.08 / 2.9) ** 2]
    assert levels[1] / levels[0] == pytest.approx(straight[1] / straight[0], rel=0.02)


def test_a_lens_that_sees_the_horizon_shows_no_glare_there():
    made = load_scene("sato_press", {"light.radius_mm": 0.4})
    veil = View.of(made, 0.01).veil[:, :, 0]
    rows, columns = np.indices(veil.shape)
    away = np.hypot(rows - 239.5, columns - 319.5) / made.camera.focal_px
    # Mirrored by the window: 5.26 to 6.06 mm aside over 1.5 mm of air, at 74.1 to 76.1 deg.
    assert np.rad2deg(away[veil > 0].max()) < 76.3
    assert np.rad2deg(away[veil > 0].min()) > 67
