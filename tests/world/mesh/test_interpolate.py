"""Points are read from their own element; the smoother recovery is exact for cubics."""

from dataclasses import replace

import numpy as np
import pytest
from standard_bodies import BLOCK, FINGER

from twin.errors import InputError
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator, Recovery
from twin.world.mesh.quadratic_mesh import shapes

POINTS = 60_000


@pytest.mark.parametrize("body", [BLOCK, FINGER])
def test_points_are_read_from_their_own_element(body):
    """Points uniform over the volume, drawn towards faces; a neighbour's reading is 1e-5 off."""
    mesh, rng = body_mesh(body, "nominal"), np.random.default_rng(1)
    corners = mesh.points[mesh.tets[:, :4]]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    drawn = mesh.tets[rng.choice(len(volume), POINTS, p=volume / volume.sum())]
    values, _ = shapes(rng.dirichlet(np.full(4, 0.5), POINTS)[:, 1:])
    points = np.einsum("qa,qai->qi", values, mesh.points[drawn])
    field, places = (mesh.points**3).sum(axis=1), Locator(mesh).locate(points)
    read = places.values(field)
    assert np.abs(read - (values * field[drawn]).sum(axis=1)).max() < 1e-10 * np.abs(field).max()
    linear = rng.normal(size=(3, 2))
    gradients = places.gradients(mesh.points @ linear)
    np.testing.assert_allclose(gradients, np.broadcast_to(linear.T, gradients.shape), atol=1e-9)


@pytest.mark.parametrize("bad", [(9.0, 9.0, 11.0), (np.nan, 0.0, 1.0)])
def test_points_outside_are_named(bad):
    inside = FINGER.chart_points(np.array([(0.0, 0.0), (2.0, -5.0)]))
    FINGER.require_inside(inside)
    with pytest.raises(InputError, match="point 2"):
        FINGER.require_inside(np.vstack([inside, bad]))


def cubic(at):
    x, y, z = at.T
    return np.column_stack([1 + x - y * z + x**3, 0.1 * x * y * z - z**3, y**2 * z + x])


@pytest.fixture(scope="module")
def mesh():
    return body_mesh(FINGER, "nominal")


@pytest.fixture(scope="module")
def points():
    return FINGER.chart_points(np.random.default_rng(5).uniform(-4, 4, (700, 2)), 0.4)


def test_cubics_are_read_exactly_and_constants_in_any_way(mesh, points):
    read = Recovery(mesh).at(points)
    np.testing.assert_allclose(read.values(cubic(mesh.points)), cubic(points), atol=1e-9 * 500)
    np.testing.assert_allclose(read.weights.sum(axis=1), 1.0, atol=1e-10)
    assert read.nodes.shape == (len(points), 90)


def test_the_difference_to_the_elements_reading_is_their_error(mesh, points):
    """Of a field that elements don't quite follow: within a seventh at the worst point."""

    def wave(at):
        return np.sin(at @ np.array([0.25, 0.15, 0.2]))[:, None]

    field = wave(mesh.points)
    plain = Locator(mesh).locate(points).values(field)
    told, wrong = Recovery(mesh).at(points).values(field) - plain, wave(points) - plain
    assert np.abs(told).max() == pytest.approx(np.abs(wrong).max(), rel=0.15)
    assert np.linalg.norm(told - wrong) < 0.2 * np.linalg.norm(wrong)


def test_nodes_in_three_planes_tell_no_cubic_across_them(mesh, points):
    """As in a thin wall: values stay near, instead of a singular fit's."""
    flat = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0), np.array([0.0, 0.5, 1.0])), axis=-1).reshape(-1, 3)
    read = Recovery(replace(mesh, points=flat)).at(np.array([[5.3, 6.1, 0.2]]))
    assert read.values(flat[:, 2])[0] == pytest.approx(0.2, abs=1e-3)
    assert read.values(flat[:, 2] ** 2)[0] == pytest.approx(0.04, abs=0.01)
    assert np.abs(read.weights).sum() < 3.0
