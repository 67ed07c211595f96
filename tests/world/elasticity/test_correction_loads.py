"""Narrow loads: the correction removes exactly what the half-space's field brings."""

import numpy as np
import pytest
from standard_bodies import FINGER, LOOSE

from twin.files import MESHES
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.correction import unbalanced
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import Mesh

CHART = np.vstack([[0.0, 0.0], np.random.default_rng(3).uniform([-5, -8], [8, 8], (14, 2))])
KINDS = ("disk", "bump", "rectangle", "twist")


def traction(kind, centre, radius, force):
    if kind == "rectangle":
        return Traction.rectangle(centre, (2 * radius, 2 * radius), force)
    if kind == "twist":
        return Traction.twist(centre, radius, 10.0)
    return getattr(Traction, kind)(centre, radius, force)


@pytest.fixture(scope="module")
def stiff():
    return Compliance(FINGER, Material(youngs_modulus_mpa=0.5), Mesh.read(MESHES / "sato_finger.nominal.npz"))


def assert_width_does_not_matter(stiff, place, kind, axis, radii, bound=0.01):
    centre = tuple(FINGER.chart_points(CHART[place : place + 1])[0])
    below = FINGER.chart_points(CHART[place : place + 1], 3.0)[0]
    points = below + np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.3]])
    force = tuple(np.eye(3)[axis])
    wide = stiff.displacement(points, tile(traction(kind, centre, 0.3, force), FINGER))
    for radius in radii:
        narrow = stiff.displacement(points, tile(traction(kind, centre, radius, force), FINGER))
        assert np.abs(narrow - wide).max() < bound * np.abs(wide).max(), (radius, centre)


@pytest.mark.parametrize("place", range(len(CHART)))
def test_narrow_loads_move_deep_points_like_wide_ones(stiff, place):
    assert_width_does_not_matter(stiff, place, KINDS[place % 3], place // 3 % 3, (0.03, 0.001))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", range(len(CHART)))
def test_narrow_loads_of_all_kinds_and_directions(stiff, place, kind):
    """A twist is two forces that grow like 1 / radius and nearly cancel, as their errors do."""
    for axis in range(1 if kind == "twist" else 3):
        radii = (0.1,) if kind == "twist" else (0.1, 0.03, 0.01)
        assert_width_does_not_matter(stiff, place, kind, axis, radii, 0.06 if kind == "twist" else 0.01)


@pytest.mark.parametrize("radius", [0.001, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("place", [0, 1, 2, 3])
@pytest.mark.parametrize("nu", [0.5, 0.4])
def test_tractions_of_the_rest_and_flux_through_the_base_balance_the_load(stiff, place, radius, nu):
    """sigma n of the half-space has no total over a closed surface: what is left is the load."""
    centre = tuple(FINGER.chart_points(CHART[place : place + 1])[0])
    tiles = tile(Traction.bump(centre, radius, (0.3, -0.5, 1.0)), FINGER)
    forces = unbalanced(TaylorHood(stiff.mesh, nu), LOOSE["finger"], [tiles])[0]
    np.testing.assert_allclose(forces.sum(axis=0)[:, 0], (0.3, -0.5, 1.0), atol=5e-3)
