"""Several materials in one mesh: patch tests, columns in closed form, limits of very stiff and very soft layers."""

import numpy as np
import pytest
from slabs import slab

from twin.errors import InputError
from twin.parts.body import Block
from twin.world.elasticity.fem import Layer, TaylorHood

BLOCK = Block(width_mm=6, length_mm=5, thickness_mm=4)
INTERFACE = 1.5


@pytest.fixture(scope="module")
def mesh():
    x, y = np.linspace(-3, 3, 5), np.linspace(-2.5, 2.5, 4)
    return slab(BLOCK, x, y, np.array([0.0, 0.8, INTERFACE, 2.6, 4.0]), lambda z: z < INTERFACE)


def boundary(mesh):
    on = np.zeros(len(mesh.points), bool)
    on[mesh.faces] = True
    return on


def column(mesh, slope_above, slope_below):
    """Displacement along z and along x, both bent at the interface, zero at the base."""
    z = mesh.points[:, 2]
    below = (4.0 - np.maximum(z, INTERFACE)) * slope_below
    return below + np.maximum(INTERFACE - z, 0.0) * slope_above


def oedometric(ratio, nu):
    return ratio * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) if nu < 0.5 else np.inf


CASES = [(1.0, 0.3), (10.0, 0.3), (0.1, 0.45), (1e6, 0.2), (1e-6, 0.49), (10.0, -0.4)]


def test_patch_test_of_equal_materials_and_of_doubled_pressures(mesh):
    gradient = np.random.default_rng(1).normal(size=(3, 3))
    linear = (mesh.points @ gradient.T)[:, :, None]
    same = TaylorHood(mesh, 0.3, held=boundary(mesh), layers=[Layer(modulus_ratio=1.0, poisson_ratio=0.3)])
    np.testing.assert_allclose(same.solve(np.zeros_like(linear), linear), linear, atol=1e-10)
    assert same.pressures == mesh.corners
    # equal shear moduli, other bulk moduli: a field without change of volume has no tension on either side
    gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (mesh.points @ gradient.T)[:, :, None]
    for nu in (0.5, -0.2):
        layer = Layer(modulus_ratio=(1 + nu) / 1.3, poisson_ratio=nu)
        system = TaylorHood(mesh, 0.3, held=boundary(mesh), layers=[layer])
        np.testing.assert_allclose(system.solve(np.zeros_like(linear), linear), linear, atol=1e-10)
        on_interface = np.abs(mesh.points[: mesh.corners, 2] - INTERFACE) < 1e-9
        assert system.pressures == mesh.corners + on_interface.sum()


@pytest.mark.parametrize(("ratio", "nu"), CASES)
@pytest.mark.parametrize("nu_body", [0.3, 0.5])
def test_squeezed_column_is_exact(mesh, ratio, nu, nu_body):
    """Uniaxial strain: the same tension in both layers, strains as the oedometric moduli say; at nu = 1/2 none."""
    if nu_body == 0.5 and ratio == 1e6:
        pytest.skip("an incompressible body shut up on all sides by its boundary and a rigid layer has no tension")
    above, below = 1.0 / oedometric(ratio, nu), 1.0 / oedometric(1.0, nu_body)
    size = max(above, below)
    exact = np.zeros((len(mesh.points), 3, 1))
    exact[:, 2, 0] = column(mesh, above / size, below / size)
    system = TaylorHood(mesh, nu_body, held=boundary(mesh), layers=[Layer(modulus_ratio=ratio, poisson_ratio=nu)])
    np.testing.assert_allclose(system.solve(np.zeros_like(exact), exact), exact, atol=1e-8)


@pytest.mark.parametrize(("ratio", "nu"), [*CASES, (10.0, 0.5), (1e6, 0.5), (1e-6, 0.5)])
def test_sheared_column_is_exact(mesh, ratio, nu):
    above, below = (1 + nu) / ratio, 1.5
    size = max(above, below)
    exact = np.zeros((len(mesh.points), 3, 1))
    exact[:, 0, 0] = column(mesh, above / size, below / size)
    system = TaylorHood(mesh, 0.5, held=boundary(mesh), layers=[Layer(modulus_ratio=ratio, poisson_ratio=nu)])
    np.testing.assert_allclose(system.solve(np.zeros_like(exact), exact), exact, atol=1e-8)


@pytest.mark.parametrize("ratio", [1e-6, 1.0, 10.0, 1e6])
def test_equilibrium_reciprocity_and_definiteness(mesh, ratio):
    system = TaylorHood(mesh, 0.5, layers=[Layer(modulus_ratio=ratio, poisson_ratio=0.5)])
    surface = np.unique(mesh.faces[mesh.piece == 0])[::7]
    forces = np.zeros((len(mesh.points), 3, len(surface), 3))
    for column_of, node in enumerate(surface):
        forces[node, :, column_of] = np.eye(3)
    forces = forces.reshape(len(forces), 3, -1)
    compliance = system.solve(forces).reshape(len(forces), 3, -1)[surface].reshape(3 * len(surface), -1)
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-7 * np.abs(compliance).max())
    assert np.linalg.eigvalsh((compliance + compliance.T) / 2).min() > 0 or ratio == 1e6
    assert system.factor.residual < 1e-9
    np.testing.assert_allclose(system.reaction(forces), -forces.sum(axis=0), atol=1e-6)


def test_a_layer_a_million_times_stiffer_moves_like_a_rigid_plate(mesh):
    system = TaylorHood(mesh, 0.5, layers=[Layer(modulus_ratio=1e6, poisson_ratio=0.3)])
    forces = np.zeros((len(mesh.points), 3, 1))
    forces[int(np.argmin(np.linalg.norm(mesh.points - [2.0, 1.0, 0.0], axis=1))), :, 0] = [0.3, -0.2, 1.0]
    moved = system.solve(forces)[:, :, 0]
    plate = mesh.points[:, 2] <= INTERFACE
    points = np.column_stack([mesh.points[plate], np.ones(plate.sum())])
    fitted = np.linalg.lstsq(points, moved[plate], rcond=None)[0]
    np.testing.assert_allclose(points @ fitted, moved[plate], atol=1e-5 * np.abs(moved).max())
    turn = fitted[:3].T
    np.testing.assert_allclose(turn, -turn.T, atol=1e-5 * np.abs(turn).max())


def test_only_the_ratio_of_moduli_bends_the_field(mesh):
    """Everything of one layer's material is that material's own body: modulus 7, displacement over 7."""
    forces = np.zeros((len(mesh.points), 3, 1))
    forces[0, 2] = 1.0
    whole = type(mesh)(**{**vars(mesh), "region": np.ones_like(mesh.region)})
    stiff = TaylorHood(whole, 0.1, layers=[Layer(modulus_ratio=7.0, poisson_ratio=0.4)]).solve(forces)
    np.testing.assert_allclose(stiff, TaylorHood(mesh, 0.4, layers=[Layer(modulus_ratio=1.0, poisson_ratio=0.4)])
                               .solve(forces) / 7.0, atol=1e-12)  # fmt: skip


def test_a_region_without_material_and_impossible_moduli_are_refused(mesh):
    with pytest.raises(InputError, match="regions 0 to 1"):
        TaylorHood(mesh, 0.3)
    with pytest.raises(InputError, match=r"poisson_ratio = 0.6 of region 1"):
        TaylorHood(mesh, 0.3, layers=[Layer(modulus_ratio=1.0, poisson_ratio=0.6)])
    with pytest.raises(InputError, match="above 0"):
        TaylorHood(mesh, 0.3, layers=[Layer(modulus_ratio=0.0, poisson_ratio=0.4)])
