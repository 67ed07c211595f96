"""Pictures at the ends of what a scene can ask for; markers as ellipsoids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_scenes import RED, SPLAT, beads, block, changed, finger, rest_of, seen_at
from standard_bodies import FINGER

from twin.errors import InputError, RecipeError
from twin.parts.markers import MarkerLayer, MarkerSet
from twin.world.picture.ccd import expose
from twin.world.picture.ellipsoids import PRINT_THICKNESS, Ellipsoids
from twin.world.picture.render import Renderer


@pytest.mark.parametrize("field_deg", [10, 90, 180])
def test_any_field_of_view_shows_markers_where_they_are_projected(field_deg):
    scene = changed(finger(), camera={"width_px": 200, "height_px": 150, "focal_px": 100 / np.deg2rad(field_deg / 2)})
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, SPLAT)
    light, outlines = renderer.radiance(markers), renderer.outlines(markers)
    assert np.isfinite(light).all()
    assert light.max() > 0.1
    places = seen_at(markers.centres, scene)
    whole = (outlines.visible > 0.999) & (outlines.area_px > 20)
    assert whole.any()
    # Outline centroid and projected centre differ by the lens's bend over a marker.
    assert np.abs(outlines.centroid_px - places)[whole].max() < 0.02 * np.sqrt(outlines.area_px[whole].max()) + 0.02


@pytest.mark.parametrize("diameter_px", [2, 5, 15, 60])
def test_markers_of_any_size_keep_their_centre_and_area(diameter_px):
    scene = block()
    radius_mm = diameter_px / 20.35 / 2
    renderer = Renderer(scene, beads([(0, 0, 6)], radius_mm), SPLAT, subpixels=4)
    for x, y in np.random.default_rng(1).uniform(-0.5, 0.5, (12, 2)):
        markers = beads([(x, y, 6.0)], radius_mm)
        outlines = renderer.outlines(markers)
        off = outlines.centroid_px - seen_at(markers.centres, scene)
        assert np.abs(off).max() < 0.01
        assert outlines.area_px[0] == pytest.approx(np.pi * diameter_px**2 / 4, rel=0.02 if diameter_px > 2 else 0.05)


def test_markers_behind_the_base_at_the_window_and_beyond_the_edge():
    scene = finger()
    markers = beads([(0, 0, 11), (0, 0, 9.7), (0.4, 0.1, 9.9), (7.5, 0, 5), (0, 0, 4)])
    renderer = Renderer(scene, rest_of(scene), SPLAT)
    light, outlines = renderer.radiance(markers), renderer.outlines(markers)
    assert np.isfinite(light).all()
    assert outlines.visible[0] == 0
    assert outlines.area_px[1] > 1000
    assert outlines.visible[4] == 0  # behind the one at the window


def test_markers_in_one_place_and_within_each_other():
    scene = block()
    twins = beads([(0, 0, 6), (0, 0, 6), (0.1, 0, 6), (0, 0, 6.05)], [0.25, 0.25, 0.25, 0.1])
    renderer = Renderer(scene, rest_of(scene), SPLAT)
    outlines = renderer.outlines(twins)
    assert np.isfinite(renderer.radiance(twins)).all()
    # Together they cover what the union covers, nothing is counted twice.
    grid = np.stack(np.meshgrid(np.arange(40, 80, 0.05), np.arange(30, 60, 0.05)), axis=-1)
    middles = seen_at(twins.centres, scene)
    radius = 20.35 * 0.25
    union = np.any([np.linalg.norm(grid - m, axis=-1) < radius for m in middles[:3]], axis=0).sum() * 0.05**2
    assert outlines.area_px.sum() == pytest.approx(union, rel=0.02)
    assert outlines.area_px[3] == 0  # inside the others


def test_a_crowd_of_thousands_and_nobody():
    scene = changed(block(), camera={"width_px": 320, "height_px": 240})
    rng = np.random.default_rng(3)
    n = 5000
    crowd = Ellipsoids(
        centres=np.column_stack([rng.uniform(-9, 9, n), rng.uniform(-7, 7, n), rng.uniform(1, 12, n)]),
        axes=np.tile(0.06 * np.eye(3), (n, 1, 1)),
        colour=np.tile(RED, (n, 1)),
    )
    renderer = Renderer(scene, crowd, SPLAT, subpixels=2)
    light, outlines = renderer.radiance(crowd), renderer.outlines(crowd)
    assert np.isfinite(light).all()
    whole = outlines.visible > 0.999
    assert whole.sum() > 1000
    np.testing.assert_allclose(outlines.centroid_px[whole], seen_at(crowd.centres[whole], scene), atol=0.04)
    nobody = crowd.rows(slice(0, 0))
    assert renderer.radiance(nobody).max() < 0.06
    assert len(renderer.outlines(nobody).visible) == 0


def test_leds_in_the_body_behind_a_marker_and_within_one():
    scene = changed(block(), light={"positions_mm": ((0.0, 0.0, 20.0),), "ambient": 0.0})
    inside, shaded = beads([(0, 0, 3)]), beads([(0, 0, 3), (0, 0, 10)])
    renderer = Renderer(scene, inside, SPLAT)
    assert renderer.outlines(inside).visible[0] == 1
    free = renderer.radiance(inside)[44:46, 59:61, 0].mean()
    assert free > 0.1
    # The one at 10 mm hides the other and takes its light; beside it the light still arrives.
    aside = beads([(0.8, 0, 3), (0, 0, 10)])
    spot = np.rint(renderer.outlines(aside).centroid_px[0]).astype(int)
    assert renderer.radiance(aside)[spot[1], spot[0], 0] > 0.5 * free
    assert renderer.outlines(shaded).visible[0] == 0
    swallowed = changed(block(), light={"positions_mm": ((0.0, 0.0, 6.0), (0.0, 0.0, 20.0))})
    assert np.isfinite(Renderer(swallowed, inside, SPLAT).radiance(beads([(0, 0, 6)]))).all()
    in_the_plate = changed(block(), light={"positions_mm": ((0.0, 0.0, 45.0),)})
    with pytest.raises(RecipeError, match="positions_mm"):
        Renderer(in_the_plate, inside, SPLAT)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (3, 2)])
def test_tiny_pictures(width, height):
    scene = changed(block(), camera={"width_px": width, "height_px": height})
    markers = beads([(0, 0, 6)])
    renderer = Renderer(scene, markers, SPLAT)
    light = renderer.radiance(markers)
    assert light.shape == (height, width, 3)
    assert 0.1 < light.max() < np.inf
    assert 0 < renderer.outlines(markers).visible[0] <= 1


@pytest.mark.slow
def test_a_picture_of_16_million_pixels():
    scene = changed(block(), camera={"width_px": 4096, "height_px": 4096, "focal_px": 1814.8 * 4096 / 640})
    markers = rest_of(scene)
    renderer = Renderer(scene, markers, SPLAT, subpixels=1)
    np.testing.assert_allclose(renderer.outlines(markers).centroid_px, seen_at(markers.centres, scene), atol=0.05)
    counts = expose(renderer.radiance(markers), scene.ccd, np.random.default_rng(0))
    assert counts.shape == (4096, 4096, 3)


LAYERS = {
    "red": MarkerLayer(kind="print", depth_mm=0.5, pitch_mm=2.5, diameter_mm=0.5, columns=3, rows=3, colour=(1, 0, 0)),
    "blue": MarkerLayer(kind="bead", depth_mm=2, pitch_mm=2.5, diameter_mm=0.6, columns=2, rows=2, colour=(0, 0, 1)),
}


@pytest.fixture(name="markers")
def _markers():
    return MarkerSet.place(FINGER, LAYERS)


def metric(axes):
    return np.einsum("nij,nkj->nik", axes, axes)


def test_at_rest_prints_lie_in_their_level_set_and_beads_are_round(markers):
    found = Ellipsoids.of(markers, LAYERS)
    normals = markers.normals[:9]
    across = np.einsum("ni,nij,nj->n", normals, metric(found.axes)[:9], normals)
    assert_allclose(np.sqrt(across), PRINT_THICKNESS * 0.25, rtol=1e-12)
    assert_allclose(np.linalg.det(found.axes[:9]), PRINT_THICKNESS * 0.25**3, rtol=1e-12)
    assert_allclose(metric(found.axes)[9:], np.broadcast_to(0.3**2 * np.eye(3), (4, 3, 3)), atol=1e-15)
    assert_array_equal(found.centres, markers.points)
    assert (found.colour[:9] == (1, 0, 0)).all()
    assert not found.axes.flags.writeable


def test_strain_stretches_prints_and_only_turns_beads(markers):
    gradient = np.random.default_rng(0).normal(0, 0.1, (13, 3, 3))
    moved = np.random.default_rng(1).normal(0, 0.1, (13, 3))
    rest, found = Ellipsoids.of(markers, LAYERS), Ellipsoids.of(markers, LAYERS, moved, gradient)
    assert_allclose(found.centres - rest.centres, moved, atol=1e-14)
    assert_allclose(found.axes[:9], (np.eye(3) + gradient[:9]) @ rest.axes[:9], atol=1e-14)
    assert_allclose(metric(found.axes)[9:], metric(rest.axes)[9:], atol=1e-14)
    # By the antisymmetric part: here a turn about z.
    spin = np.zeros((13, 3, 3))
    spin[:, 1, 0], spin[:, 0, 1] = 0.3, -0.3
    c, s = np.cos(0.3), np.sin(0.3)
    turned = Ellipsoids.of(markers, LAYERS, None, spin).axes[9] / 0.3
    assert_allclose(turned, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-14)


def test_prints_of_their_own_size_shade_and_absence(markers):
    size, shade = np.linspace(0.9, 1.1, 13), np.linspace(0.5, 1.2, 13)
    missing = np.arange(13) == 3
    ones, drawn = np.ones((len(size), 3)), {"size": size, "shade": shade, "missing": missing}
    prints = MarkerSet.Prints(**drawn, longer=ones[:, 0], way_rad=ones[:, 0], tint=ones)
    found = Ellipsoids.of(markers, LAYERS, prints=prints)
    plain = Ellipsoids.of(markers, LAYERS)
    assert_array_equal(found.present, ~missing)
    assert_allclose(found.axes[~missing], (plain.axes * size[:, None, None])[~missing])
    assert_allclose(found.colour, np.clip(plain.colour * shade[:, None], 0, 1))


def test_a_lost_marker_keeps_its_row_and_rows_must_match(markers):
    moved = np.zeros((13, 3))
    moved[4] = np.nan
    assert_array_equal(Ellipsoids.of(markers, LAYERS, moved).present, np.arange(13) != 4)
    with pytest.raises(InputError, match="one row per marker"):
        Ellipsoids.of(markers, LAYERS, moved[:12])
