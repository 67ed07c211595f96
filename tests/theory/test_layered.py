"""The layered half-space against the homogeneous one, and thin, thick, stiff, soft layers."""

import numpy as np
import pytest
from standard_bodies import assert_near

from benchmarks.layered import Layered, bump_displacement
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.theory import halfspace
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
