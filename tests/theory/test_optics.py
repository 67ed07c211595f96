"""The camera in closed form: exact inversion, paraxial limit, Snell's law, differences."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import REFERENCE, assert_near

from twin.errors import RecipeError
from twin.parts.camera import Camera
from twin.theory.lens import lens, lens_inverse, lens_jacobian
from twin.theory.optics import air_tangents, project, project_with_jacobian, rays, sideways, transmission

GLASS = Camera.Layer(index=1.49, thickness_mm=10)
FLAT = Camera(focal_px=1814.8, pupil_mm=(0, 0, 108.85), layers=(GLASS,))
TURNED = FLAT.model_copy(update={"pupil_mm": (1, -2, 108.85), "tilt_deg": (0.5, -1, 2), "distortion": (-0.1, 0.02)})
PLATE = Camera.Layer(index=1.49, thickness_mm=1)
FISHEYE = {"lens": "equidistant", "layers": (PLATE,)}
WIDE = Camera(focal_px=230, pupil_mm=(0.1, 0, 12), tilt_deg=(0.5, -1, 2), distortion=(-0.02, 0.001), **FISHEYE)


def bent(kind, focal_px, *distortion):
    layers = (PLATE, Camera.Layer(index=1.33, thickness_mm=0.5))
    pose = {"aspect": 1.05, "pupil_mm": (0.5, 0.2, 13), "tilt_deg": (1, 2, 3), "layers": layers}
    return Camera(lens=kind, focal_px=focal_px, distortion=distortion, **pose)


BENT = [
    bent("pinhole", 300, -0.1, 0.02, 0.003, -0.002),
    bent("pinhole", 300, -0.1, 0.02, 0.003, -0.002, 0.01),
    bent("pinhole", 300, 0.2, 0.02, 0.003, -0.002, 0.01, 0.3, -0.01, 0.02),
    bent("equidistant", 230, -0.02, 0.001, 0.0005, -0.0002),
]
CASES = [(FLAT, 40.0, 16.0), (TURNED, 40.0, 16.0), (WIDE, 10.0, 8.0)]
RUBBER = 1.41


def points_in(base_mm, half_mm, camera):
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-half_mm, half_mm, (300, 2)), rng.uniform(0, base_mm, 300)])
    points[0, :2] = camera.pupil_mm[:2]
    return points


def assert_derivative(points, camera, base, step, near):
    ahead, behind = ([project(points + s * step * axis, camera, RUBBER, base) for axis in np.eye(3)] for s in (1, -1))
    numeric = (np.stack(ahead, axis=-1) - np.stack(behind, axis=-1)) / (2 * step)
    assert_near(numeric, project_with_jacobian(points, camera, RUBBER, base)[1], near)


@pytest.mark.parametrize(("camera", "base", "half"), CASES)
def test_jacobian_is_the_derivative(camera, base, half):
    assert_derivative(points_in(base - 0.01, half, camera), camera, base, 1e-4, 2e-6)


@pytest.mark.parametrize(("camera", "base"), [(camera, base) for camera, base, _ in CASES] + [(c, 10.0) for c in BENT])
def test_pixels_come_back_from_their_rays_and_bent_lenses_have_their_derivatives(camera, base):
    pixels = np.random.default_rng(6).uniform((40, 40), (600, 440), (300, 2))
    origins, directions = rays(pixels, camera, RUBBER, base)
    assert np.isfinite(origins).all()
    assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-14)
    points = origins + 3 * directions
    assert np.abs(project(points, camera, RUBBER, base) - pixels).max() < 1e-6
    if camera in BENT:
        assert_derivative(points, camera, base, 1e-5, 3e-6)


def test_magnification_on_the_axis_is_the_focal_length_over_the_apparent_distance():
    # A slab of index n looks n times thinner: 40 - z of rubber, 10 of glass, 58.85 of air.
    for z in (0.0, 4.5, 20.0):
        apparent = (40 - z) / RUBBER + 10 / 1.49 + 58.85
        jacobian = project_with_jacobian(np.array([[0.0, 0.0, z]]), FLAT, RUBBER, 40.0)[1][0]
        assert_allclose(jacobian[:, :2], np.diag([1, -1]) * 1814.8 / apparent, rtol=1e-12)
        assert_allclose(jacobian[:, 2], 0, atol=1e-12)


def test_without_refraction_it_is_a_straight_line():
    bare = Camera(focal_px=500, pupil_mm=(1, 2, 60), principal_px=(300, 200))
    points = points_in(40, 20, bare)
    ahead = 60 - points[:, 2]
    straight = np.column_stack([300 + 500 * (points[:, 0] - 1) / ahead, 200 - 500 * (points[:, 1] - 2) / ahead])
    assert_allclose(project(points, bare, 1.0, 40.0), straight, atol=1e-9)


def test_snells_law_holds_between_body_and_air():
    pixel = np.array([[600.0, 30.0]])
    _, inside = rays(pixel, FLAT, RUBBER, 40.0)
    flat = (pixel - FLAT.centre_px) / 1814.8
    in_air = np.arctan(np.linalg.norm(flat))
    in_rubber = np.arcsin(np.linalg.norm(inside[0, :2]))
    assert RUBBER * np.sin(in_rubber) == pytest.approx(np.sin(in_air), rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_tilt_turns_the_camera_about_its_axis(axis):
    tilt = [0.0, 0.0, 0.0]
    tilt[axis] = 90.0
    turn = FLAT.model_copy(update={"tilt_deg": tuple(tilt)}).tilt_matrix()
    assert_allclose(turn[:, (axis + 1) % 3], np.eye(3)[(axis + 2) % 3], atol=1e-12)


def test_tilts_are_applied_about_x_then_y_then_z():
    def alone(axis, angle):
        tilt = tuple(angle if i == axis else 0.0 for i in range(3))
        return FLAT.model_copy(update={"tilt_deg": tilt}).tilt_matrix()

    assert_allclose(
        FLAT.model_copy(update={"tilt_deg": (3.0, 5.0, 7.0)}).tilt_matrix(), alone(2, 7) @ alone(1, 5) @ alone(0, 3)
    )


@pytest.mark.parametrize("camera", [FLAT, TURNED, WIDE])
def test_straight_behind_the_camera_there_is_no_place_in_the_picture(camera):
    ahead, behind, beside_behind = np.eye(3)[[2]] * -1, np.eye(3)[[2]], np.array([[1e-13, 0, 1.0]])
    assert_allclose(lens(ahead, camera), [camera.centre_px])
    assert np.isfinite(lens_jacobian(ahead, camera)).all()
    for direction in (behind, beside_behind):
        assert np.isnan(lens(direction, camera)).all()
        assert np.isnan(lens_jacobian(direction, camera)[:, :, :2]).all()


def test_a_folding_distortion_shows_nothing_twice():
    folding = Camera(focal_px=300, pupil_mm=(0, 0, 60), distortion=(-0.3, 0.0))
    fold = np.sqrt(1 / 0.9)
    x = 60 * np.array([0.5, 0.99, 1.01, 2.0]) * fold
    places = project(np.column_stack([x, 0 * x, 0 * x]), folding, 1.0, 40.0)
    assert np.isfinite(places[:2]).all()
    assert np.isnan(places[2:]).all()
    assert np.isnan(rays(np.array([[319.5 + 300.0, 239.5]]), folding, 1.0, 40.0)[0]).all()


def test_newton_climbs_to_grazing_rays():
    p = np.array([0.0, 1e-6, 0.3, 3.0, 50.0, 1e4])
    reach, slope = sideways(p, np.full(6, 10.0), RUBBER, (GLASS,), 0.5)
    assert_allclose(air_tangents(reach, np.full(6, 10.0), RUBBER, (GLASS,), 0.5), p, rtol=1e-9, atol=1e-12)
    more, _ = sideways(p + 1e-6, np.full(6, 10.0), RUBBER, (GLASS,), 0.5)
    assert_allclose((more - reach) / 1e-6, slope, rtol=1e-4)


def test_fresnel_passes_everything_straight_and_nothing_grazing():
    passed = transmission(np.array([0.0, 0.5, 2.0, 1e6]), RUBBER, (GLASS,))
    assert passed[0] == pytest.approx(1)
    assert (np.diff(passed) < 0).all()
    assert passed[-1] < 1e-4
    # One interface at Brewster's angle: the polarisation along the plane passes whole.
    n = 1.5
    across = ((1 - n**2) / (1 + n**2)) ** 2
    straight = 1 - ((1 - n) / (1 + n)) ** 2
    assert transmission(np.array([n]), n, ())[0] == pytest.approx((1 - across / 2) / straight)


def test_a_pupil_inside_the_layers_is_refused():
    with pytest.raises(RecipeError, match="pupil_mm"):
        project(np.zeros((1, 3)), FLAT, RUBBER, 100.0)


def test_no_points_give_no_pixels():
    assert project(np.zeros((0, 3)), FLAT, RUBBER, 40.0).shape == (0, 2)
    assert project_with_jacobian(np.zeros((0, 3)), FLAT, RUBBER, 40.0)[1].shape == (0, 2, 3)


def test_lenses_agree_with_opencv():
    told = json.loads((REFERENCE / "opencv.json").read_text())
    points = np.array(told["points"])
    keys = {key: told[key] for key in ("focal_px", "aspect", "principal_px")}
    for row in told["rows"]:
        camera = Camera(lens=row["lens"], distortion=row["distortion"], pupil_mm=(0, 0, 60), **keys)
        wide = 4 if row["lens"] == "equidistant" else 1
        towards = points * [wide, -wide, -1]
        assert_allclose(lens(towards, camera), row["places_px"], atol=1e-9)
        back = lens_inverse(np.array(row["places_px"]), camera)
        assert_allclose(back, towards / np.linalg.norm(towards, axis=1, keepdims=True), atol=1e-9)


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.02, 0.001, 0.0005, -0.0002)])
@pytest.mark.parametrize("field_deg", [10, 60, 120, 170, 179.9])
def test_fields_of_view_up_to_half_the_sky_invert(field_deg, distortion):
    # A fisheye whose picture is about the field wide: at 180 deg its edge looks along the layers.
    half = np.deg2rad(field_deg / 2)
    camera = Camera(focal_px=320 / half, pupil_mm=(0, 0, 12), distortion=distortion, **FISHEYE)
    angle = np.linspace(0, half, 200)[:, None]
    pixels = lens(np.hstack([np.sin(angle) * [0.6, -0.8], -np.cos(angle)]), camera)
    origins, directions = rays(pixels, camera, RUBBER, 10.0)
    assert np.abs(project(origins + directions, camera, RUBBER, 10.0) - pixels).max() < 1e-6
    lean = np.rad2deg(np.arccos(-directions[:, 2]))
    assert (lean < np.rad2deg(np.arcsin(1 / RUBBER))).all(), "the critical angle"


def test_what_is_not_seen_has_no_place():
    points = np.array([[0.0, 0, 5], [0, 0, 41], [np.nan, 0, 5], [200, 0, 35]])
    touching = Camera(focal_px=500, pupil_mm=(0, 0, 50), layers=(GLASS,))
    seen = np.isfinite(project(points, touching, RUBBER, 40.0)).all(axis=1)
    assert_array_equal(seen, [True, False, False, False])  # behind the base, no number, total reflection
    folding = Camera(focal_px=300, pupil_mm=(0, 0, 60), distortion=(-0.3, 0.0))
    assert np.isnan(project(np.array([[70.0, 0, 0]]), folding, 1.0, 40.0)).all(), "outside the lens"
    centre = WIDE.centre_px
    pixels = np.array([centre, (centre[0] + 230 * 1.7, centre[1]), (centre[0] + 230 * 3.2, centre[1])])
    reached = np.isfinite(np.hstack(rays(pixels, WIDE, RUBBER, 10.0))).all(axis=1)
    assert_array_equal(reached, [True, False, False])


def test_any_number_of_layers_is_one_of_the_same_optical_path():
    # A layer cut in two is the same layer everywhere.
    cut = FLAT.model_copy(update={"layers": tuple(Camera.Layer(index=1.49, thickness_mm=t) for t in (4, 6))})
    points = points_in(40, 16, FLAT)
    assert_allclose(project(points, cut, RUBBER, 40.0), project(points, FLAT, RUBBER, 40.0), atol=1e-9)


@pytest.mark.parametrize("number", range(5))
def test_a_distortion_next_to_nothing_bends_nothing(number):
    told = [0.0] * 5
    told[number] = 5e-324
    plain, bent = (Camera(focal_px=200, pupil_mm=(0, 0, 60), distortion=d) for d in ((), tuple(told)))
    pixels = np.array([[0.0, 0.0], [319.5, 239.5], [600.0, 20.0]])
    assert_allclose(lens_inverse(pixels, bent), lens_inverse(pixels, plain), atol=1e-12)
