"""The papers' numbers, typed a second time from the papers alone; what ``auto`` takes of a scene; distributions."""

import numpy as np
import pytest
from scipy import constants
from scipy.stats import truncnorm

from twin.errors import RecipeError
from twin.parts.press import PATCHES_ACROSS
from twin.parts.scene import FEWEST, LOOSEST, TIGHTEST, Scene
from twin.parts.sweep import GF
from twin.parts.vary import CUT, Normal
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

GRAM_FORCE = 9.80665e-3


def test_a_gram_force_is_a_gram_under_standard_gravity():
    for stated in (GF, GRAM_FORCE):
        assert stated == pytest.approx(constants.g * constants.gram, rel=1e-12)


@pytest.mark.parametrize("name", ["kamiyama_pillar", "kamiyama_shear", "kamiyama_twist", "kamiyama_wide"])
def test_kamiyama(name):
    scene = load_scene(name)
    # "transparent elastic body of a height of 40mm, 90mm long, and 100mm wide"
    assert (scene.body.width_mm, scene.body.length_mm, scene.body.thickness_mm) == (100, 90, 40)
    # "sigma is a Poisson ratio, which is set to 0.5"
    assert scene.material.poisson_ratio == 0.5
    # "Blue markers are arranged at 3mm in depth and red markers at 6mm in depth"
    assert (scene.markers["blue"].depth_mm, scene.markers["red"].depth_mm) == (3, 6)
    # "The marker interval is about 1.5mm"
    assert all(abs(layer.pitch_mm - 1.5) < 0.06 for layer in scene.markers.values())


def test_kamiyama_pixel_is_a_twentieth_of_a_millimetre():
    # "One pixel corresponds to about 0.05mm"
    scene = load_scene("kamiyama_pillar")
    middle_depth = (scene.markers["blue"].depth_mm + scene.markers["red"].depth_mm) / 2
    assert apparent_mm_per_px(scene, middle_depth) == pytest.approx(0.05, rel=0.01)


def apparent_mm_per_px(scene, depth_mm):
    layers = [(scene.material.refractive_index, scene.body.base_z_mm - depth_mm)]
    layers += [(layer.index, layer.thickness_mm) for layer in scene.camera.layers]
    layers += [(1.0, scene.camera.pupil_mm[2] - scene.body.base_z_mm - sum(t for _, t in layers[1:]))]
    return sum(thickness / index for index, thickness in layers) / scene.camera.focal_px


def test_kamiyama_probe():
    # "using pillar which diameter is 5mm"
    assert load_scene("kamiyama_pillar").press.probe.diameter_mm == 5


@pytest.mark.parametrize("name", ["sato_press", "sato_shear"])
def test_sato(name):
    scene = load_scene(name)
    low, high = scene.body.bounds_mm
    # "dimensions of the transparent elastic body of the prototype are 16 x 16 x 10 mm3"
    assert tuple(b - a for a, b in zip(low, high, strict=True)) == (16, 16, 10)
    # "The red and blue markers are placed at depth of 0.5 and 2.0 mm"
    assert (scene.markers["red"].depth_mm, scene.markers["blue"].depth_mm) == (0.5, 2.0)
    # "their diameters are set to 0.5 mm"; "separated by a distance of 2.5 mm"
    assert {layer.diameter_mm for layer in scene.markers.values()} == {0.5}
    assert {layer.pitch_mm for layer in scene.markers.values()} == {2.5}
    # "The resolution of each image is 640 x 480 pixels"
    assert (scene.camera.width_px, scene.camera.height_px) == (640, 480)
    # "we apply a force at 25 points", "separated by a distance of 2.5 mm"
    sites = scene.calibration.presses
    assert (sites.columns * sites.rows, sites.pitch_mm) == (25, 2.5)
    # "The probe edge is spherical and the diameter is 3.0 mm"; "approximately 100 gf"
    assert (scene.press.probe.kind, scene.press.probe.diameter_mm) == ("sphere", 3)
    assert scene.press.path[0].force_n[2] == pytest.approx(100 * GRAM_FORCE)
    assert scene.calibration.press_force_n == pytest.approx(100 * GRAM_FORCE)
    assert scene.calibration.press_probe_mm == 3


def test_sato_marker_is_about_fifteen_pixels():
    scene = load_scene("sato_press")
    assert 0.5 / apparent_mm_per_px(scene, 0.5) == pytest.approx(15, abs=2)


AUTO = {"accuracy.displacement": "auto", "accuracy.contact_patches": "auto"}


def test_numbers_stay_what_they_are():
    fixed = Scene.Accuracy(displacement=2e-3, contact_patches=20)
    assert fixed.displacement_for(50.0) == 2e-3
    assert fixed.patches_for([100.0], [0.1]) == 20


def test_auto_follows_what_the_scene_leaves_open_within_bounds():
    auto = Scene.Accuracy(displacement="auto", contact_patches="auto")
    assert auto.displacement_for(1.5) == pytest.approx(5e-3)
    assert (auto.displacement_for(0.0), auto.displacement_for(50.0)) == (TIGHTEST, LOOSEST)
    assert auto.patches_for([5.0, 2.0], [3.0, 6.0]) == FEWEST, "the deep don't see narrow patches"
    assert auto.patches_for([5.0], [0.6]) == 10
    assert auto.patches_for([10.0], [0.5]) == PATCHES_ACROSS
    assert auto.patches_for([float("inf")], [3.0]) == auto.patches_for([], []) == PATCHES_ACROSS


def test_a_block_is_made_as_thick_as_its_tolerance_allows_its_camera_with_the_base():
    """Every other draw stays what it was; only a block has one thickness."""
    drawn, made = (
        Sensor(load_scene("kamiyama_pillar", {"tolerance.thickness_mm": sd})).actual.scene for sd in (0.0, 0.2)
    )
    thicker = made.body.thickness_mm - drawn.body.thickness_mm
    assert 0.01 < abs(thicker) <= CUT * 0.2
    assert np.subtract(made.camera.pupil_mm, drawn.camera.pupil_mm) == pytest.approx([0, 0, thicker])
    assert (made.material, made.markers) == (drawn.material, drawn.markers)
    with pytest.raises(RecipeError, match=r"tolerance.thickness_mm: only a block .* body.shape = 'finger'"):
        load_scene("sato_press", {"tolerance.thickness_mm": 0.1})
    with pytest.raises(RecipeError, match=r"tolerance.thickness_mm = 1.3 mm: .*; take at most 1.2 mm"):
        load_scene("gelpad_press", {"tolerance.thickness_mm": 1.3})


def test_what_is_not_known_of_the_design_scales_all_forces():
    assert load_scene("gelpad_press").scale_error == pytest.approx(np.hypot(0.015, 0.003))
    assert load_scene("gelpad_press", {"tolerance.preset": "none"}).scale_error == 0


def test_a_scene_balances_by_its_own_tolerances_probe_and_markers():
    scene = load_scene("kamiyama_pillar", AUTO)
    assert (scene.displacement_error, scene.contact_patches) == (pytest.approx(5e-3), FEWEST)
    shallow = load_scene("kamiyama_pillar", {**AUTO, "markers.blue.depth_mm": 0.5, "tolerance.preset": "none"})
    assert (shallow.displacement_error, shallow.contact_patches) == (TIGHTEST, 12)


@pytest.mark.parametrize("value", ["best", 0, -1.0])
def test_anything_else_is_refused_by_key(value):
    for key in ("displacement", "contact_patches"):
        with pytest.raises(RecipeError, match=f"accuracy.{key}"):
            load_scene("kamiyama_pillar", {f"accuracy.{key}": value})


@pytest.mark.parametrize("u", [0.0, 0.2, 0.5, 1.0])
def test_a_normal_number_grows_with_its_draw_and_is_cut_where_a_maker_rejects(u: float) -> None:
    wanted = truncnorm.ppf(u, -CUT, CUT, loc=3.0, scale=0.1)
    assert Normal(mean=3.0, sd=0.1).at(np.array([u])) == pytest.approx(wanted, rel=1e-9)
