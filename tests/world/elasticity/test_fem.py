"""Taylor-Hood elements: patch test, equilibrium, reciprocity, on the shipped meshes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from standard_bodies import BLOCK, FINGER, assert_near, forces_on, nearest_node, on_boundary

from twin.errors import InputError, OutOfBodyError
from twin.files import MESHES
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.interpolate import Locator, require_inside
from twin.world.mesh.quadratic_mesh import Mesh

BODIES = {"kamiyama_block": BLOCK, "sato_finger": FINGER}


@pytest.fixture(scope="module", params=list(BODIES))
def mesh(request):
    return Mesh.read(MESHES / f"{request.param}.nominal.npz")


@pytest.fixture(scope="module")
def finger_mesh():
    return Mesh.read(MESHES / "sato_finger.nominal.npz")


@pytest.fixture(scope="module")
def finger(finger_mesh):
    return TaylorHood(finger_mesh, 0.5)


@pytest.mark.parametrize("nu", [0.5, 0.3, -0.4])
def test_patch_test(mesh, nu):
    """A linear displacement of the boundary is reproduced inside; at nu = 1/2 without volume."""
    gradient = np.random.default_rng(2).normal(size=(3, 3))
    if nu == 0.5:
        gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (mesh.points @ gradient.T)[:, :, None]
    system = TaylorHood(mesh, nu, held=on_boundary(mesh))
    solved = system.solve(np.zeros_like(linear), linear)
    assert_near(solved, linear, 1e-10)


@pytest.mark.parametrize("solver", Factor.solvers())
def test_reaction_balances_the_load_and_solvers_agree(finger_mesh, finger, solver):
    forces = forces_on(finger_mesh, nearest_node(finger_mesh), np.eye(3))
    other = TaylorHood(finger_mesh, 0.5, solver)
    assert_allclose(other.reaction(forces), -np.eye(3), atol=1e-8)
    reference = finger.solve(forces)
    assert_near(other.solve(forces), reference, 1e-8)


def test_poisson_ratio_is_limited(finger_mesh):
    with pytest.raises(InputError, match=r"-0.5 to 0.5"):
        TaylorHood(finger_mesh, 0.51)


@pytest.mark.parametrize("name", list(BODIES))
def test_quadratic_fields_are_read_exactly_and_outside_points_are_named(name):
    """Elements hold linear fields exactly; the block's flat elements quadratic ones too."""
    body, mesh = BODIES[name], Mesh.read(MESHES / f"{name}.nominal.npz")
    rng = np.random.default_rng(8)
    low, high = (np.array(b) for b in body.bounds_mm)
    points = rng.uniform(low, high, (4000, 3))
    points = points[body.contains(points, 0.0)]
    surface = body.chart_points(rng.uniform(-5, 5, (200, 2)))
    points = np.concatenate([points, surface])
    places = Locator(mesh).locate(points)
    linear = rng.normal(size=(3, 2))
    assert_allclose(places.values(mesh.points @ linear), points @ linear, atol=3e-3)
    assert_allclose(places.values(mesh.points @ linear)[:-200], points[:-200] @ linear, atol=1e-9)
    gradients = places.gradients(mesh.points @ linear)
    assert_allclose(gradients, np.broadcast_to(linear.T, gradients.shape), atol=1e-9)
    if name == "kamiyama_block":
        square = mesh.points[:, 0] * mesh.points[:, 2]
        assert_allclose(places.values(square), points[:, 0] * points[:, 2], atol=1e-8)
    require_inside(body, points)
    bad = points.copy()
    bad[7] = high + 1.0
    with pytest.raises(OutOfBodyError, match="point 7"):
        require_inside(body, bad)
    bad[7] = np.nan
    with pytest.raises(OutOfBodyError, match="point 7"):
        require_inside(body, bad)
