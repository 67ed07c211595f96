"""Pictures by Mitsuba's path integrator: the same optics, and the light that the others leave out."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from small_scenes import SPLAT, beads, block, changed, finger, measured, mitsuba, rest_of, seen_at

from twin.errors import MissingCapability
from twin.world.picture.lamps import Lamps
from twin.world.picture.render import Renderer


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
