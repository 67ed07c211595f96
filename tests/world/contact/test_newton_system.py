"""Newton steps by GMRES and its preconditioner, against elimination."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from presses import HalfSpace, ball, pressed, punch, pushed
from standard_bodies import BLOCK, FINGER

from twin.world.contact import influence as storage
from twin.world.contact.influence import DenseInfluence
from twin.world.contact.surface_patches import Box, Plane, candidate_patches

UPRIGHT = Plane(origin_mm=np.zeros(3), axes=np.eye(3))
SQUARE = Box(u0=-1, u1=1, v0=-1, v1=1)


PATH = (pushed(z=0.3), pushed(0.05, 0.03, 0.3), pushed(0.05, 0.03, 0.3, torque=0.02))
KEYS = {"at_mm": (-3, 1), "steps": PATH}


@pytest.mark.parametrize(
    ("body", "nu", "wanted"),
    [
        (BLOCK, 0.3, ball(3, friction=0.5, **KEYS)),
        (BLOCK, 0.5, punch(2, friction=0.25, **KEYS)),  # graded cells
        pytest.param(FINGER, 0.5, ball(3, friction=0.5, **KEYS), marks=pytest.mark.slow),
    ],
)
def test_a_path_is_that_of_elimination(body, nu, wanted, monkeypatch):
    def walked(direct):
        monkeypatch.setattr(storage, "DIRECT", direct)
        return pressed(wanted, body, nu=nu, across=10, increments=2)

    fast, slow = walked(30), walked(10**6)
    assert 0 < slow.slip.sum() < len(slow.slip)
    for one, other in zip(fast.path, slow.path, strict=True):
        assert_array_equal(one.slip, other.slip)
        near = 1e-8 * other.peak_pressure_mpa
        assert_allclose(one.traction_mpa, other.traction_mpa, atol=near)
        assert_allclose(one.move_mm, other.move_mm, atol=1e-9)


def test_the_gathered_block_of_a_matrix_serves_sets_that_lost_and_gained_patches():
    rng, k = np.random.default_rng(4), 40
    root = rng.normal(size=(3 * k, 3 * k))
    matrix = (1e-3 * (root + root.T) + 2e-2 * np.eye(3 * k)).reshape(k, 3, k, 3)
    influence, force = DenseInfluence(matrix), rng.normal(size=(k, 3))
    few = np.arange(8, 14)  # too small a part of the block
    for rows in (np.arange(5, 25), np.r_[7:26, 30], np.r_[0:7, 9:26], few):
        influence.select(rows)
        own = np.einsum("kalb,bl->ak", matrix[rows][:, :, rows], force[rows].T)
        found = influence.product(force[rows].T.astype(np.float32)) * influence.unit
        assert_allclose(found, own, atol=3e-6 * np.abs(own).max())


def undone(back, force):
    return np.linalg.norm(back - force) < 0.3 * np.linalg.norm(force)


def test_two_balls_on_a_curved_body_have_an_inverse_each():
    """Their patches have the same places in planes of their own: one lattice would mix them up."""
    grids = [candidate_patches(BLOCK, None, UPRIGHT, SQUARE, (8, 8)) for _ in range(2)]
    one = HalfSpace(1.0, 0.3).surface(grids[0].unloaded)
    n = 2 * len(one) // 3
    whole = np.kron(np.eye(2), one).reshape(n, 3, n, 3)
    influence = DenseInfluence(whole, grids, 0.3)
    force, rows = np.random.default_rng(5).normal(size=(n, 3)), np.arange(n)
    influence.select(rows)
    moved = influence.product(force.T.astype(np.float32))
    assert undone(influence.approx_solve(moved[..., None])[..., 0].T, force)
    push = influence.approx_push(rows, influence.normal_displacement(force[:, 2]))
    assert undone(push, force[:, 2])
