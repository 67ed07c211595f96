"""Several materials in one mesh: patch tests, columns in closed form, extreme layers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from slabs import slab
from standard_bodies import assert_holder_balances, assert_near, forces_on, on_boundary

from twin.errors import InputError
from twin.files import MESHES
from twin.parts.body import Block
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import Mesh

BLOCK = Block(width_mm=6, length_mm=5, thickness_mm=4)
INTERFACE = 1.5


@pytest.fixture(scope="module")
def mesh():
    x, y = np.linspace(-3, 3, 5), np.linspace(-2.5, 2.5, 4)
    z = np.array([0.0, 0.8, INTERFACE, 2.6, 4.0])
    return slab(BLOCK, x, y, z, lambda middle: middle < INTERFACE)


def layered(mesh, nu, ratio, nu_layer, **keys):
    return TaylorHood(mesh, nu, layers=[TaylorHood.Layer(modulus_ratio=ratio, poisson_ratio=nu_layer)], **keys)


def assert_exact(mesh, exact, atol, *moduli):
    """The field that is given on the boundary is the one inside."""
    system = layered(mesh, *moduli, held=on_boundary(mesh))
    assert_allclose(system.solve(np.zeros_like(exact), exact), exact, atol=atol)
    return system.pressures


def column(mesh, axis, slope_above, slope_below):
    """Displacement along an axis, zero at the base, bent at the interface, of size one."""
    z, size = mesh.points[:, 2], max(slope_above, slope_below)
    below = (4.0 - np.maximum(z, INTERFACE)) * slope_below / size
    exact = np.zeros((len(z), 3, 1))
    exact[:, axis, 0] = below + np.maximum(INTERFACE - z, 0.0) * slope_above / size
    return exact


def oedometric(ratio, nu):
    return ratio * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) if nu < 0.5 else np.inf


CASES = [(1.0, 0.3), (10.0, 0.3), (0.1, 0.45), (1e6, 0.2), (1e-6, 0.49), (10.0, -0.4)]


@pytest.mark.parametrize("name", ["kamiyama_block", "sato_finger"])
@pytest.mark.parametrize("nu", [0.5, 0.3, -0.4])
def test_patch_test_of_shipped_meshes(name, nu):
    """At nu = 1/2 without change of volume."""
    mesh, gradient = Mesh.read(MESHES / f"{name}.nominal.npz"), np.random.default_rng(2).normal(size=(3, 3))
    if nu == 0.5:
        gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (mesh.points @ gradient.T)[:, :, None]
    solved = TaylorHood(mesh, nu, held=on_boundary(mesh)).solve(np.zeros_like(linear), linear)
    assert_near(solved, linear, 1e-10)


def test_patch_test_of_equal_materials_and_of_doubled_pressures(mesh):
    gradient = np.random.default_rng(1).normal(size=(3, 3))
    linear = (mesh.points @ gradient.T)[:, :, None]
    assert assert_exact(mesh, linear, 1e-10, 0.3, 1.0, 0.3) == mesh.corners
    # equal shear moduli, other bulk moduli: without change of volume there is no tension
    gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (mesh.points @ gradient.T)[:, :, None]
    on_interface = np.abs(mesh.points[: mesh.corners, 2] - INTERFACE) < 1e-9
    for nu in (0.5, -0.2):
        pressures = assert_exact(mesh, linear, 1e-10, 0.3, (1 + nu) / 1.3, nu)
        assert pressures == mesh.corners + on_interface.sum()


@pytest.mark.parametrize(("ratio", "nu"), CASES)
@pytest.mark.parametrize("nu_body", [0.3, 0.5])
def test_squeezed_column_is_exact(mesh, ratio, nu, nu_body):
    """Uniaxial strain: one tension in both layers, strains by the oedometric moduli."""
    if nu_body == 0.5 and ratio == 1e6:
        pytest.skip("an incompressible body shut up by its boundary and a rigid layer")
    slopes = 1.0 / oedometric(ratio, nu), 1.0 / oedometric(1.0, nu_body)
    assert_exact(mesh, column(mesh, 2, *slopes), 1e-8, nu_body, ratio, nu)


@pytest.mark.parametrize(("ratio", "nu"), [*CASES, (10.0, 0.5), (1e6, 0.5), (1e-6, 0.5)])
def test_sheared_column_is_exact(mesh, ratio, nu):
    assert_exact(mesh, column(mesh, 0, (1 + nu) / ratio, 1.5), 1e-8, 0.5, ratio, nu)


@pytest.mark.parametrize("ratio", [1e-6, 1.0, 10.0, 1e6])
def test_equilibrium_reciprocity_and_definiteness(mesh, ratio):
    system = layered(mesh, 0.5, ratio, 0.5)
    surface = np.unique(mesh.faces[mesh.piece == 0])[::7]
    units = np.eye(3 * len(surface)).reshape(len(surface), 3, -1)
    forces = forces_on(mesh, surface, units)
    compliance = system.solve(forces)[surface].reshape(3 * len(surface), -1)
    assert_allclose(compliance, compliance.T, atol=1e-7 * np.abs(compliance).max())
    assert np.linalg.eigvalsh((compliance + compliance.T) / 2).min() > 0 or ratio == 1e6
    assert system.factor.residual < 1e-9
    assert_holder_balances(system, 1e-6)


def test_a_region_without_material_and_impossible_moduli_are_refused(mesh):
    with pytest.raises(InputError, match="regions 0 to 1"):
        TaylorHood(mesh, 0.3)
    with pytest.raises(InputError, match=r"-0.5 to 0.5"):
        layered(mesh, 0.51, 1.0, 0.4)
    with pytest.raises(InputError, match=r"poisson_ratio = 0.6 of region 1"):
        layered(mesh, 0.3, 1.0, 0.6)
    with pytest.raises(InputError, match="above 0"):
        layered(mesh, 0.3, 0.0, 0.4)
