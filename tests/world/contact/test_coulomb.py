"""Coulomb's law against a slow iteration, the active set against every set of patches of small problems."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from presses import jacobian_of

from twin.errors import ContactError
from twin.world.contact.active_set import TOLERANCE, Equilibrium, UnilateralProblem, solve
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.influence import DenseInfluence

K = 9
CAP_N = 0.1
PUSHED = np.array([0.0, 0.0, 1.0, 0.0])


def problem_of(rng, compliance, most, *, held, given, friction, offset):
    """Return a problem with gaps at random up to ``most``; ``friction`` draws its coefficients."""
    k = len(compliance) // 3
    gap0, turning = rng.uniform(0.0, most, k), rng.normal(size=(2, k))
    slope = np.tile(-PUSHED, (k, 1))
    return UnilateralProblem(
        influence=DenseInfluence(compliance.reshape(k, 3, k, 3)),
        gap=lambda q: (gap0 + slope @ q, slope),
        contact_jacobian=jacobian_of(turning),
        by_force=held,
        given=given,
        pushing=held & [False, False, True, False],
        area_mm2=np.ones(k),
        friction=friction(),
        offset=rng.normal(scale=offset, size=(k, 2)),
    )


def random_problem(seed, *, by_force=False, **changes):
    rng = np.random.default_rng(seed)
    root, held = 0.3 * rng.normal(size=(3 * K, 3 * K)), np.array([by_force, False, by_force, False])
    given = np.where(held, [0.5, 0, 2.5, 0], [0.3, -0.2, 1.1, 0.1])
    rubbed = {"friction": lambda: rng.uniform(0.2, 0.8, K), "offset": 0.2}
    problem = problem_of(rng, root @ root.T / K + np.eye(3 * K), 1.0, held=held, given=given, **rubbed)
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


def small_problem(seed, *, by_force, k=7):
    """Return a problem small enough to try every set of patches, stuck or without friction."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * k, 3 * k))
    return problem_of(
        rng,
        root @ root.T + 0.3 * np.eye(3 * k),
        2.0,
        held=np.array([False, False, by_force, False]),
        given=np.array([0.3, -0.1, 0.8 if by_force else 1.2, 0.05]),
        friction=lambda: np.where(rng.random(k) < 0.5, np.inf, 0.0),
        offset=0.1,
    )


def solved(problem, active=True, **changes):
    return solve(replace(problem, **changes), np.full(7, active), np.zeros(4))


def every_solution(problem):
    """Forces of all sets of patches that meet every condition, by linear algebra of its own."""
    k = len(problem.offset)
    matrix = problem.influence.block(np.arange(k)).reshape(3 * k, 3 * k)
    found = []
    for chosen in product([False, True], repeat=k):
        active = np.array(chosen)
        a, s = np.flatnonzero(active), np.flatnonzero(active & problem.sticking)
        rows = np.concatenate([3 * a + 2, 3 * s, 3 * s + 1]).astype(int)
        at, axis, n = rows // 3, rows % 3, len(rows)
        system, right = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        system[:n, :n] = matrix[np.ix_(rows, rows)]
        system[:n, n] = -problem.contact_jacobian[at, axis, 2]
        still = np.where(problem.by_force, 0.0, problem.given)
        gap, _ = problem.gap(still)
        carried = problem.contact_jacobian[at, axis] @ still
        stuck = carried + problem.offset[at, np.minimum(axis, 1)]
        right[:n] = np.where(axis == 2, -gap[at], stuck)
        if problem.by_force[2]:
            system[n, :n] = axis == 2
            right[n] = problem.given[2]
        else:
            system[n, n] = 1.0
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        x = np.linalg.solve(system, right)
        force = np.zeros(3 * k)
        force[rows] = x[:n]
        opening = (matrix @ force)[2::3] + gap - x[n]
        if np.all(force[2::3][active] > -1e-12) and np.all(opening[~active] > -1e-12):
            found.append(force.reshape(k, 3))
    return found


@pytest.mark.parametrize("by_force", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_enumeration_from_any_start(seed, by_force):
    problem = small_problem(seed, by_force=by_force)
    result, other = solved(problem), solved(problem, active=False)
    assert isinstance(result, Equilibrium)
    solutions = every_solution(problem)
    assert any(np.allclose(result.force_n, force, atol=1e-9) for force in solutions)
    assert result.residual < 1e-10
    np.testing.assert_allclose(result.force_n, other.force_n, atol=1e-10)
    if by_force:
        assert result.total[2] == pytest.approx(0.8, rel=1e-10)


def test_a_gap_that_can_not_be_met_stays_open():
    problem = small_problem(1, by_force=False)
    shut, first = problem.gap, np.arange(7) == 0

    def gap(q):
        values, slope = shut(q)
        return np.where(first, np.inf, values), slope * ~first[:, None]

    result = solved(problem, gap=gap)
    assert not result.active[0]
    assert not result.force_n[0].any()


def test_a_patch_that_the_probe_moves_away_from_is_let_go():
    """A flat face that turns off a patch can't be met by it any more: no such set is in contact."""
    problem = replace(small_problem(1, by_force=True), friction=np.zeros(7))
    whole, met = solved(problem), problem.gap
    lost = int(np.flatnonzero(whole.active)[0])

    def gap(q):
        values, slope = met(q)
        off = (np.arange(7) == lost) & (q[2] > 0.5 * whole.pose[2])
        return np.where(off, np.inf, values), slope

    result = solved(problem, active=whole.active, gap=gap)
    assert not result.active[lost]
    assert result.residual <= TOLERANCE


def test_no_equilibrium_is_an_error():
    """A lateral force on patches that all slide has nothing to balance it."""
    free = {"friction": np.zeros(7), "by_force": np.array([True, False, True, False])}
    with pytest.raises(ContactError):
        solved(small_problem(2, by_force=True), **free)
