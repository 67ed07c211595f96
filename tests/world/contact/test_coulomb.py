"""Coulomb's law against a slow iteration of another kind."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from presses import jacobian_of

from twin.errors import ContactError
from twin.world.contact.active_set import UnilateralProblem
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.influence import DenseInfluence

K = 9
CAP_N = 0.1
PUSHED = np.array([0.0, 0.0, 1.0, 0.0])


def random_problem(seed, *, by_force=False, **changes):
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.normal(size=(3 * K, 3 * K))
    compliance = (root @ root.T / K + np.eye(3 * K)).reshape(K, 3, K, 3)
    gap0, turning = rng.uniform(0.0, 1.0, K), rng.normal(size=(2, K))
    slope = np.tile(-PUSHED, (K, 1))
    held = np.array([by_force, False, by_force, False])
    problem = UnilateralProblem(
        influence=DenseInfluence(compliance),
        gap=lambda q: (gap0 + slope @ q, slope),
        contact_jacobian=jacobian_of(turning),
        by_force=held,
        given=np.where(held, [0.5, 0, 2.5, 0], [0.3, -0.2, 1.1, 0.1]),
        pushing=held & [False, False, True, False],
        area_mm2=np.ones(K),
        friction=rng.uniform(0.2, 0.8, K),
        offset=rng.normal(scale=0.2, size=(K, 2)),
    )
    return replace(problem, **changes)


class CappedLaw:
    """Coulomb's friction up to a largest force, as of a thin layer that yields."""

    def bound(self, friction, push, area_mm2):
        return np.minimum(friction * np.maximum(push, 0.0), CAP_N)

    def slope(self, friction, push, area_mm2):
        return np.where(friction * push < CAP_N, friction, 0.0)


def relaxed(problem, place):
    """Return the forces at a place by thousands of rounds over the patches, one by one."""
    force = np.zeros((K, 3))
    compliance = problem.influence.block(np.arange(K))
    gap, _ = problem.gap(place)
    for _ in range(3000):
        for i in range(K):
            step = 0.5 / compliance[i, range(3), i, range(3)].max()
            moved = np.einsum("alb,lb->a", compliance[i], force)
            force[i, 2] = max(0.0, force[i, 2] - step * (moved[2] + gap[i]))
            carried = problem.contact_jacobian[i, :2] @ place
            drag = force[i, :2] - step * (moved[:2] - carried - problem.offset[i])
            bound = float(problem.law.bound(problem.friction[i], force[i, 2], problem.area_mm2[i]))
            force[i, :2] = drag * min(1.0, bound / max(math.hypot(*drag), 1e-300))
    return force


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_a_slow_iteration_from_any_start(seed):
    problem = random_problem(seed)
    slow = relaxed(problem, problem.given)
    for start in (np.zeros((K, 3)), *np.random.default_rng(seed).normal(size=(3, K, 3))):
        found = solve_coulomb(problem, start, np.zeros(4))
        assert_allclose(found.force_n, slow, atol=1e-10)
        assert found.residual < 1e-10
    assert found.slipping.any()


@pytest.mark.parametrize("seed", range(4))
def test_given_forces_are_balanced_where_the_slow_iteration_finds_them_too(seed):
    problem = random_problem(seed, by_force=True)
    found = solve_coulomb(problem, np.zeros((K, 3)), PUSHED)
    assert_allclose(found.total[[0, 2]], [0.5, 2.5], rtol=1e-10)
    assert_allclose(relaxed(problem, found.pose), found.force_n, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_another_law_is_one_object(seed):
    problem = random_problem(seed, law=CappedLaw())
    found = solve_coulomb(problem, np.zeros((K, 3)), np.zeros(4))
    assert_allclose(found.force_n, relaxed(problem, problem.given), atol=1e-10)
    friction = np.hypot(*found.force_n[:, :2].T)
    assert friction.max() == pytest.approx(CAP_N, rel=1e-9)
    assert found.slipping.any()


def test_more_than_friction_carries_is_refused():
    problem = random_problem(1, by_force=True, given=np.array([2.5, 0.0, 2.5, 0.0]))
    with pytest.raises(ContactError):
        solve_coulomb(problem, np.zeros((K, 3)), PUSHED)
