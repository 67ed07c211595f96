"""Tiles: exact totals, the true surface, and footprints that leave it; what the correction takes off narrow loads."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from standard_bodies import BLOCK, FINGER, LOOSE

from twin.errors import InputError
from twin.files import MESHES
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.correction import unbalanced
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import Mesh

TIP = (4.588611490808368, 0.0, 1.4467836456880656)
FORCE = (0.1, -0.2, 1.0)


@pytest.mark.parametrize(("body", "centre"), [(BLOCK, (3.0, -2.0, 0.0)), (FINGER, (-2.0, 0.0, 0.0)), (FINGER, TIP)])
@pytest.mark.parametrize("kind", ["rectangle", "disk", "bump", "twist"])
def test_totals_are_exact_and_tiles_lie_on_the_surface(body, centre, kind):
    wanted, torque = np.array(FORCE), 0.0
    if kind == "rectangle":
        load = Traction.rectangle(centre, (3, 2), FORCE)
    elif kind == "twist":
        load, wanted, torque = Traction.twist(centre, 1.5, 10.0), np.zeros(3), 10.0
    else:
        load = getattr(Traction, kind)(centre, 1.5, FORCE)
    tiles = tile(load, body)
    assert_allclose(tiles.force_n.sum(axis=0), wanted, atol=1e-12)
    axis = body.piece_normals(np.array([centre]))[0, 0]
    arms = np.cross(tiles.centre_mm - centre, tiles.force_n).sum(axis=0)
    if kind == "twist":
        assert_allclose(arms, torque * axis, atol=1e-9)
    elif body is BLOCK:
        assert_allclose(arms, 0.0, atol=1e-12)
    assert_allclose(body.depth(tiles.centre_mm), 0.0, atol=1e-9)
    normals = body.piece_normals(tiles.centre_mm)[:, 0]
    assert_allclose(tiles.frames[:, 2], normals, atol=1e-9)
    assert_allclose(np.linalg.det(tiles.frames), 1.0)


def test_uniform_means_per_true_area_and_bumps_use_the_straight_distance():
    tiles = tile(Traction.rectangle(TIP, (4, 3), (0, 0, 1)), FINGER)
    traction = np.linalg.norm(tiles.force_n, axis=1) / (4 * tiles.half_mm.prod(axis=1))
    assert np.ptp(traction) < 2e-3 * traction.mean()
    bump = tile(Traction.bump(TIP, 2.0, (1, 0, 0)), FINGER, spacing_mm=0.1)
    distance = np.linalg.norm(bump.centre_mm - TIP, axis=1)
    shape = bump.force_n[:, 0] / (4 * bump.half_mm.prod(axis=1)) / np.maximum(1 - distance**2 / 4, 1e-9) ** 2
    inner = distance < 1.5
    assert np.ptp(shape[inner]) < 0.02 * shape[inner].mean()


def test_flat_rectangle_stays_one_and_twist_turns_x_to_y():
    assert len(tile(Traction.rectangle((1, 2), (4, 3), FORCE), BLOCK)) == 1
    twist = tile(Traction.twist((0, 0), 2.0, 5.0), BLOCK)
    on_x = np.argmax(twist.centre_mm[:, 0])
    assert twist.force_n[on_x, 1] > 0


@pytest.mark.parametrize("radius", [0.4, 2.3, 9.0])
def test_a_flat_bump_is_the_integral_of_its_traction_over_each_tile(radius):
    """All bumps on a plane are one bump, scaled: each is held against its own formula here."""
    tiles = tile(Traction.bump((1.0, -2.0), radius, FORCE), BLOCK)
    node, weight = np.polynomial.legendre.leggauss(8)
    offset = tiles.half_mm[:, None, :] * np.stack(np.meshgrid(node, node, indexing="ij"), axis=-1).reshape(1, -1, 2)
    place = tiles.centre_mm[:, None, :2] - (1.0, -2.0) + offset
    traction = 3.0 / (np.pi * radius**2) * np.maximum(1.0 - np.sum(place**2, axis=2) / radius**2, 0.0) ** 2
    share = traction @ np.outer(weight, weight).ravel() * tiles.half_mm.prod(axis=1)
    assert np.abs(tiles.force_n - share[:, None] * FORCE).max() < 0.01 * np.abs(tiles.force_n).max()


def test_wide_loads_are_cut_into_few_tiles_that_do_as_well_as_many():
    load = Traction.bump((0, 0), 44.0, (0, 0.3, 1))
    points = np.random.default_rng(0).uniform([-44, -44, 0.3], [44, 44, 0.31], (30, 3))
    few, many = tile(load, BLOCK), tile(load, BLOCK, spacing_mm=0.4)
    assert len(few) <= 10_000 < len(many)
    got, expected = (halfspace.displacement(points, tiles, 0.5, 0.5) for tiles in (few, many))
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()
    assert tile(Traction.bump((0, 0), 6.0, FORCE), BLOCK).half_mm.max() <= 0.1


@pytest.mark.parametrize(
    ("load", "body", "word"),
    [
        (Traction.rectangle((49, 0), (4, 4), FORCE), BLOCK, "partly off"),
        (Traction.disk((60, 0), 1, FORCE), BLOCK, "no sensing surface"),
        (Traction.rectangle((0, 0, 1.0), (1, 1), FORCE), BLOCK, "off the sensing"),
        (Traction.bump((-7.5, 0), 1, FORCE), FINGER, "partly off"),
    ],
)
def test_footprints_off_the_surface_are_refused(load, body, word):
    with pytest.raises(InputError, match=word):
        tile(load, body)


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
