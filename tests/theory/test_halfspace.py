"""The half-space kernels against each other, equilibrium, and Love's closed form."""

import numpy as np
import pytest
from block_truth import MODULUS_MPA, of_point_force
from numpy.testing import assert_allclose
from standard_bodies import assert_near, rectangles

from twin.theory import halfspace

AXES = np.eye(3)
NUS = (0.5, 0.3, -0.2)


@pytest.fixture
def points():
    """Below the rectangles, and over their plane beside them."""
    rng = np.random.default_rng(3)
    below = np.column_stack([rng.uniform(-2.5, 2.5, (25, 2)), rng.uniform(0.3, 4.0, 25)])
    return np.concatenate([below, [[2.0, -0.2, -0.6], [0.4, 1.4, -0.9], [-1.8, -2.0, -1.4], [9.0, 1.0, -6.0]]])


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("axis", range(3))
def test_rectangle_is_the_integral_of_point_forces(points, nu, axis):
    node, weight = np.polynomial.legendre.leggauss(40)
    x, y = np.meshgrid(0.3 + 1.0 * node, -0.2 + 0.6 * node, indexing="ij")
    share = np.outer(weight, weight).ravel() / 4.0
    cloud = rectangles(np.column_stack([x.ravel(), y.ravel(), 0.0 * share]), (0.0, 0.0), share[:, None] * AXES[axis])
    whole = rectangles([0.3, -0.2, 0.0], (1.0, 0.6), AXES[axis])
    for field in (halfspace.displacement, halfspace.gradient):
        expected = field(points, cloud, 0.5, nu)
        assert_near(field(points, whole, 0.5, nu), expected, 1e-6)


@pytest.mark.parametrize("nu", NUS)
def test_point_force_is_the_corrected_formula_of_the_flat_paper(nu):
    place, force = (0.7, -0.4, 1.1), (0.3, -0.5, 0.9)
    load = rectangles([0, 0, 0], (0, 0), force)
    expected = of_point_force(*place, force, nu, np.sqrt)
    assert_allclose(halfspace.displacement(np.array([place]), load, MODULUS_MPA, nu)[0], expected, rtol=1e-13)


@pytest.mark.parametrize("nu", NUS)
def test_gradient_and_stress_are_consistent_and_in_equilibrium(points, nu):
    load, step = rectangles([0.3, -0.2, 0.0], (1.0, 0.6), (0.3, -0.4, 1.0)), 1e-4
    points = np.vstack([points, [0.5, -0.3, -0.05]])  # the field goes on through the rectangle

    def slope(field):
        return np.stack([(field(points + step * e) - field(points - step * e)) / (2 * step) for e in AXES], axis=-1)

    gradient = halfspace.gradient(points, load, 0.5, nu)
    differences = slope(lambda p: halfspace.displacement(p, load, 0.5, nu))
    assert_allclose(gradient, differences, atol=1e-6 * np.abs(gradient).max())
    stress = halfspace.stress(points, load, nu)
    divergence = np.trace(slope(lambda p: halfspace.stress(p, load, nu)), axis1=2, axis2=3)
    assert_allclose(divergence, 0.0, atol=1e-6 * np.abs(stress).max())
    if nu < 0.5:
        shear, lame = 0.25 / (1 + nu), 0.5 * nu / ((1 + nu) * (1 - 2 * nu))
        law = shear * (gradient + gradient.transpose(0, 2, 1))
        law += lame * np.trace(gradient, axis1=1, axis2=2)[:, None, None] * AXES
        assert_allclose(stress, law, atol=1e-12)
    else:
        assert_allclose(np.trace(gradient, axis1=1, axis2=2), 0.0, atol=1e-12)
        tension = np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * AXES
        assert_allclose(stress - tension, (gradient + gradient.transpose(0, 2, 1)) / 6, atol=1e-12)


@pytest.mark.parametrize("nu", NUS)
def test_surface_edges_corners_and_far_points_are_finite_and_continuous(nu):
    load = rectangles([0, 0, 0], (0.5, 0.4), (0.3, 0.4, 1.0))
    on = np.array([[0.5, 0.4, 0.0], [0.5, 0.0, 0.0], [0.0, -0.4, 0.0], [0.5, 2.0, 0.0], [-3.0, 0.4, 0.0], [0, 0, 0]])
    at = halfspace.displacement(on, load, 0.5, nu)
    near = halfspace.displacement(on + np.array([1e-9, -1e-9, 1e-9]), load, 0.5, nu)
    assert_allclose(at, near, atol=1e-6)
    assert np.isfinite(halfspace.gradient(on, load, 0.5, nu)).all()
    assert np.isfinite(halfspace.stress(on, load, nu)).all()
    direction = np.array([0.5, 0.6, 0.3]) / np.linalg.norm([0.5, 0.6, 0.3])
    for reach in (8.0, 40.0):
        edge = reach * np.hypot(0.5, 0.4)
        pair = halfspace.displacement(np.outer([edge * (1 - 1e-9), edge * (1 + 1e-9)], direction), load, 0.5, nu)
        assert_allclose(pair[0], pair[1], rtol=3e-7)


def test_turned_rectangles_turn_the_field(points):
    angle = 0.7
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    flat = rectangles([0, 0, 0], (0.5, 0.3), (0.2, 0.5, 1.0))
    turned = rectangles([0, 0, 0], (0.5, 0.3), turn.T @ [0.2, 0.5, 1.0], frames=turn)
    for field in (halfspace.displacement, halfspace.gradient):
        here, there = field(points, flat, 0.5, 0.4), field(points @ turn, turned, 0.5, 0.4)
        back = there @ turn.T if here.ndim == 2 else np.einsum("pi,nij,qj->npq", turn, there, turn)
        assert_allclose(back, here, atol=1e-12)


@pytest.mark.parametrize("nu", NUS)
@pytest.mark.parametrize("half", [(0.5, 0.3), (0.0, 0.0)])
def test_compliance_times_force_is_displacement(points, nu, half):
    """Points are summed by a loop of their own, here in a turned frame too."""
    for frame in (AXES, np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])):
        load = rectangles([[0, 0, 0], [1.0, 0.5, 0]] @ frame, half, [[0.2, 0.5, 1.0], [-0.3, 0.1, 0.4]], frame)
        matrix = halfspace.compliance(points @ frame, load, 0.5, nu)
        moved = halfspace.displacement(points @ frame, load, 0.5, nu)
        assert_allclose((matrix @ load.force_n.ravel()).reshape(-1, 3), moved, rtol=1e-11)


def test_normal_compliance_is_that_part_of_the_whole_near_and_far():
    places = np.array([0.0, 0.9, 3.0, 5.0, 7.0, 14.0, 24.0, 28.0, 60.0])[:, None] * [1.0, 0.3, 0.0]
    patches = rectangles(places, (0.5, 0.4), [0.0, 0.0, 1.0])
    whole = halfspace.compliance(places, patches, 0.5, 0.3).reshape(9, 3, 9, 3)[:, 2, :, 2]
    assert_allclose(halfspace.normal_compliance(patches, 0.5, 0.3), whole, rtol=1e-9)


def test_the_place_of_a_point_force_is_refused(points):
    load = rectangles([[0, 0, 0], points[3]], (0.0, 0.0), [0.2, 0.5, 1.0])
    with pytest.raises(ZeroDivisionError, match="infinitely far"):
        halfspace.displacement(points, load, 0.5, 0.4)


def test_tension_under_and_beside_a_rectangle_is_its_solid_angle():
    """Mean tension under unit pressure: -(1 + nu) / (3 pi) times the solid angle."""
    load = rectangles([0, 0, 0], (0.5, 0.3), (0, 0, 4 * 0.5 * 0.3))
    places = np.array([[0.1, 0.2, 1e-9], [0.0, 0.0, 0.1], [0.0, 0.0, 3.0], [0.6, 0.0, 1e-9], [3.0, 2.0, 1e-3]])
    node, weight = np.polynomial.legendre.leggauss(400)
    x, y = np.meshgrid(0.5 * node, 0.3 * node, indexing="ij")
    area = 0.15 * np.outer(weight, weight)
    for place, exact in zip(places, (2 * np.pi, None, None, 0.0, None), strict=True):
        r = np.sqrt((x - place[0]) ** 2 + (y - place[1]) ** 2 + place[2] ** 2)
        angle = exact if exact is not None else np.sum(area * place[2] / r**3)
        mean = np.trace(halfspace.stress(place[None], load, 0.5)[0]) / 3.0
        assert mean == pytest.approx(-angle / (2.0 * np.pi), abs=1e-6)
