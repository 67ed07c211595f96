"""The papers' numbers, typed a second time from the papers alone, against the shipped recipes."""

import pytest
from scipy import constants

from twin.parts.sweep import GF
from twin.study.recipe import load_scene

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
