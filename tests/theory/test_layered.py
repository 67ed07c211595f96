"""The layered half-space and the bonded layer: against each other, limits, derivatives and Hooke's law."""

import numpy as np
import pytest
from layered import Layered, bump_displacement
from standard_bodies import assert_near, rectangles

from twin.parts.body import Block
from twin.parts.load import Traction
from twin.theory import halfspace
from twin.theory.bonded_layer import REACH, BondedLayer
from twin.world.elasticity.discretise import tile

WIDE = Block(width_mm=400, length_mm=400, thickness_mm=100)
POINTS = np.array([[0.3, 0.2, z] for z in (0.05, 0.3, 1.0, 6.0)] + [[-2.0, 1.0, 0.5], [1.0, 5.0, 3.0], [0.0, 0.0, 0.2]])
FORCES = np.eye(3)


def homogeneous(modulus, nu, force, points=POINTS, radius=1.0):
    tiles = tile(Traction.bump((0, 0), radius, tuple(force)), WIDE, 0.04)
    return halfspace.displacement(points, tiles, modulus, nu)


@pytest.mark.parametrize("nu", [0.5, 0.3, -0.4, 0.0])
@pytest.mark.parametrize("force", FORCES)
def test_equal_materials_are_one_half_space(nu, force):
    got = bump_displacement(POINTS, Layered(thickness_mm=0.7, layer=(2.0, nu), below=(2.0, nu)), 1.0, force)
    expected = homogeneous(2.0, nu, force)
    assert_near(got, expected, 1e-3)


@pytest.mark.parametrize("force", FORCES)
def test_a_thick_layer_hides_what_is_below_and_a_thin_one_is_not_felt(force):
    thick = bump_displacement(POINTS[:3], Layered(thickness_mm=4000.0, layer=(3.0, 0.4), below=(1e-3, 0.2)), 1.0, force)
    expected = homogeneous(3.0, 0.4, force, POINTS[:3])
    np.testing.assert_allclose(thick - thick[0], expected - expected[0], atol=2e-3 * np.abs(expected).max())
    thin = bump_displacement(POINTS, Layered(thickness_mm=1e-4, layer=(0.2, 0.5), below=(1.0, 0.3)), 1.0, force)
    expected = homogeneous(1.0, 0.3, force)
    assert_near(thin, expected, 2e-3)


def test_a_layer_on_rock_is_squeezed_like_a_column_under_a_wide_bump():
    """Thickness 0.1, bump 30: the middle sinks by p t / M, M the oedometric modulus."""
    peak = 3.0 / (np.pi * 30.0**2)
    got = bump_displacement(
        np.zeros((1, 3)), Layered(thickness_mm=0.1, layer=(1.0, 0.3), below=(1e9, 0.3)), 30.0, FORCES[2]
    )
    assert got[0, 2] == pytest.approx(peak * 0.1 * 1.3 * 0.4 / 0.7, rel=1e-3)
    pushed = bump_displacement(
        np.zeros((1, 3)), Layered(thickness_mm=0.1, layer=(1.0, 0.3), below=(1e9, 0.3)), 30.0, FORCES[0]
    )
    assert pushed[0, 0] == pytest.approx(peak * 0.1 * 2 * 1.3, rel=1e-3)


def test_a_stiff_sheet_bends_like_a_plate_on_rubber():
    """Under a bump much narrower than l: F l^2 / (3 sqrt(3) D), l^3 = 2 D / E*."""
    k, t, nu = 1e5, 0.02, 0.3
    rigidity = k * t**3 / 12 / (1 - nu**2)
    length = (2 * rigidity * 0.75) ** (1 / 3)
    got = bump_displacement(
        np.array([[0.0, 0.0, t]]), Layered(thickness_mm=t, layer=(k, nu), below=(1.0, 0.5)), 0.02, FORCES[2]
    )
    assert got[0, 2] == pytest.approx(length**2 / (3 * np.sqrt(3) * rigidity), rel=0.02)


THICKNESS = 2.0
PAD = Block(width_mm=80, length_mm=80, thickness_mm=THICKNESS)
INSIDE = np.array([[0.3, 0.2, 0.1], [1.0, -0.4, 1.0], [-2.5, 3.0, 0.4], [0.0, 0.0, 1.7], [9.0, 5.0, 0.7]])


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_half_space_and_correction_are_a_layer_on_rock(nu):
    for force in np.eye(3):
        load = tile(Traction.bump((0, 0), 1.5, tuple(force)), PAD, 0.03)
        got = BondedLayer(THICKNESS, nu).displacement(INSIDE, load, 0.7)
        got += halfspace.displacement(INSIDE, load, 0.7, nu)
        rock = Layered(thickness_mm=THICKNESS, layer=(0.7, nu), below=(1e9, 0.3))
        assert_near(got, bump_displacement(INSIDE, rock, 1.5, tuple(force)), 2e-5)


def test_many_small_rectangles_are_one_large_one():
    layer = BondedLayer(THICKNESS, 0.5)
    one = tile(Traction.rectangle((0.4, -0.2), (3, 2), (0.3, -0.5, 1)), PAD)
    strips = np.linspace(-0.96, 0.96, 25)
    offsets = np.array([(1.5 * s, 1.0 * t, 0.0) for s in strips for t in strips])
    places = one.centre_mm + offsets
    many = rectangles(places, one.half_mm / 25, one.force_n / 625, one.frames)
    assert_near(layer.displacement(INSIDE, many, 1.0), layer.displacement(INSIDE, one, 1.0), 2e-5)
    each = layer.compliance(INSIDE, many, 1.0) @ many.force_n.ravel()
    assert_near(each, layer.displacement(INSIDE, many, 1.0).ravel(), 1e-12)


def test_the_base_is_at_rest_and_so_is_the_layer_far_away():
    load = tile(Traction.rectangle((0, 0), (1, 1), (0.5, 0, 1)), PAD)
    far = (REACH - 0.01) * THICKNESS
    points = np.array([[0.4, 0.1, 2.0], [1.5, -2.0, 2.0], [far, 0.0, 0.5], [far + 0.1, 0.0, 0.5]])
    for nu in (0.5, 0.3):
        moved = halfspace.displacement(points, load, 1.0, nu) + BondedLayer(THICKNESS, nu).displacement(
            points, load, 1.0
        )
        assert np.abs(moved[:2]).max() < 1e-5
        assert np.abs(moved[2:]).max() < 2e-5


def test_gradient_and_traction_follow_from_the_displacement():
    nu, step = 0.3, 1e-4
    layer, shear = BondedLayer(THICKNESS, nu), 1.0 / 2.6
    load = tile(Traction.rectangle((0.4, -0.2), (1, 2), (0.3, -0.5, 1)), PAD)
    points = np.vstack([INSIDE, [[30.0, 2.0, 0.6]]])  # one where the layer is at rest
    differences = [
        (layer.displacement(points + move, load, 1.0) - layer.displacement(points - move, load, 1.0)) / (2 * step)
        for move in step * np.eye(3)
    ]
    gradient = layer.gradient(points, load, 1.0)
    assert_near(gradient, np.stack(differences, axis=2), 2e-5)
    areas = np.random.default_rng(2).normal(size=(len(points), 3))
    strain = (gradient + np.swapaxes(gradient, 1, 2)) / 2
    dilation = np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    stress = 2 * shear * (strain + nu / (1 - 2 * nu) * dilation)
    got = layer.tractions(points, areas, load, load.force_n[:, :, None])[..., 0]
    assert_near(got, np.einsum("nij,nj->ni", stress, areas), 1e-4)
