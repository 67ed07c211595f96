"""Taylor-Hood elements: patch test, equilibrium, reciprocity, and no locking, on the shipped (curved) meshes."""

from dataclasses import replace

import numpy as np
import pytest

from twin.errors import InputError, OutOfBodyError
from twin.parts.body import Block, Finger
from twin.places import MESHES
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.solve import available_solvers
from twin.world.mesh.interpolate import Locator, require_inside
from twin.world.mesh.mesh import read_mesh

BODIES = {
    "kamiyama_block": Block(width_mm=100, length_mm=90, thickness_mm=40),
    "sato_finger": Finger(radius_mm=8, barrel_mm=8, skirt_mm=2),
}


@pytest.fixture(scope="module", params=list(BODIES))
def mesh(request):
    return read_mesh(MESHES / f"{request.param}.nominal.npz")


@pytest.fixture(scope="module")
def finger_mesh():
    return read_mesh(MESHES / "sato_finger.nominal.npz")


@pytest.fixture(scope="module")
def finger(finger_mesh):
    return TaylorHood(finger_mesh, 0.5)


@pytest.mark.parametrize("nu", [0.5, 0.3, -0.4])
def test_patch_test(mesh, nu):
    """A linear displacement given on the whole boundary is reproduced inside; at nu = 1/2 a volume-preserving one."""
    gradient = np.random.default_rng(2).normal(size=(3, 3))
    if nu == 0.5:
        gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (mesh.points @ gradient.T)[:, :, None]
    boundary = np.zeros(len(mesh.points), bool)
    boundary[mesh.faces] = True
    solved = TaylorHood(mesh, nu, held=boundary).solve(np.zeros_like(linear), linear)
    np.testing.assert_allclose(solved, linear, atol=1e-10 * np.abs(linear).max())


@pytest.mark.parametrize("solver", available_solvers())
def test_reaction_balances_the_load_and_solvers_agree(finger_mesh, finger, solver):
    forces = np.zeros((len(finger_mesh.points), 3, 3))
    at = int(np.argmin(np.linalg.norm(finger_mesh.points, axis=1)))
    forces[at] = np.eye(3)
    other = TaylorHood(finger_mesh, 0.5, solver)
    np.testing.assert_allclose(other.reaction(forces), -np.eye(3), atol=1e-8)
    reference = finger.solve(forces)
    np.testing.assert_allclose(other.solve(forces), reference, atol=1e-8 * np.abs(reference).max())


def test_reciprocity_and_definiteness(finger_mesh, finger):
    nodes = np.unique(finger_mesh.faces[finger_mesh.piece == 0])
    nodes = nodes[~finger.held[nodes]][::97]
    forces = np.zeros((len(finger_mesh.points), 3, len(nodes), 3))
    for column, node in enumerate(nodes):
        forces[node, :, column] = np.eye(3)
    moved = finger.solve(forces.reshape(len(forces), 3, -1)).reshape(forces.shape)[nodes]
    compliance = moved.reshape(3 * len(nodes), -1)
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-9 * np.abs(compliance).max())
    assert np.linalg.eigvalsh(compliance).min() > 0


def test_size_scales_as_one_over_length(finger_mesh, finger):
    forces = np.zeros((len(finger_mesh.points), 3, 1))
    forces[int(np.argmin(np.linalg.norm(finger_mesh.points, axis=1))), 2] = 1.0
    doubled = TaylorHood(replace(finger_mesh, points=2 * finger_mesh.points), 0.5).solve(forces)
    np.testing.assert_allclose(doubled, finger.solve(forces) / 2, atol=1e-9)


def test_poisson_ratio_is_limited(finger_mesh):
    with pytest.raises(InputError, match=r"-0.5 to 0.5"):
        TaylorHood(finger_mesh, 0.51)


@pytest.mark.parametrize("name", list(BODIES))
def test_quadratic_fields_are_read_exactly_and_outside_points_are_named(name):
    """Isoparametric elements hold linear fields exactly; on the block's flat elements quadratic ones too."""
    body, mesh = BODIES[name], read_mesh(MESHES / f"{name}.nominal.npz")
    rng = np.random.default_rng(8)
    low, high = (np.array(b) for b in body.bounds_mm)
    points = rng.uniform(low, high, (4000, 3))
    points = points[body.contains(points, 0.0)]
    surface = body.chart_points(rng.uniform(-5, 5, (200, 2)))
    points = np.concatenate([points, surface])
    places = Locator(mesh).locate(points)
    linear = rng.normal(size=(3, 2))
    np.testing.assert_allclose(places.values(mesh.points @ linear), points @ linear, atol=3e-3)
    np.testing.assert_allclose(places.values(mesh.points @ linear)[:-200], points[:-200] @ linear, atol=1e-9)
    gradients = places.gradients(mesh.points @ linear)
    np.testing.assert_allclose(gradients, np.broadcast_to(linear.T, gradients.shape), atol=1e-9)
    if name == "kamiyama_block":
        square = mesh.points[:, 0] * mesh.points[:, 2]
        np.testing.assert_allclose(places.values(square), points[:, 0] * points[:, 2], atol=1e-8)
    require_inside(body, points)
    bad = points.copy()
    bad[7] = high + 1.0
    with pytest.raises(OutOfBodyError, match="point 7"):
        require_inside(body, bad)
    bad[7] = np.nan
    with pytest.raises(OutOfBodyError, match="point 7"):
        require_inside(body, bad)
