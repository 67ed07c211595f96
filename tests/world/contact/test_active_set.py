"""The active-set solver against enumeration of every set of patches, on small problems."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from presses import jacobian_of

from twin.errors import ContactError
from twin.world.contact.active_set import TOLERANCE, Equilibrium, UnilateralProblem, solve
from twin.world.contact.influence import DenseInfluence


def random_problem(seed, *, by_force, k=7):
    """Return a problem small enough to try every set of patches, stuck or without friction."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * k, 3 * k))
    compliance = (root @ root.T + 0.3 * np.eye(3 * k)).reshape(k, 3, k, 3)
    gap0, turning = rng.uniform(0.0, 2.0, k), rng.normal(size=(2, k))
    slope = np.tile([0.0, 0.0, -1.0, 0.0], (k, 1))
    return UnilateralProblem(
        influence=DenseInfluence(compliance),
        gap=lambda q: (gap0 + slope @ q, slope),
        contact_jacobian=jacobian_of(turning),
        by_force=np.array([False, False, by_force, False]),
        given=np.array([0.3, -0.1, 0.8 if by_force else 1.2, 0.05]),
        pushing=np.array([False, False, by_force, False]),
        area_mm2=np.ones(k),
        friction=np.where(rng.random(k) < 0.5, np.inf, 0.0),
        offset=rng.normal(scale=0.1, size=(k, 2)),
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
    problem = random_problem(seed, by_force=by_force)
    result, other = solved(problem), solved(problem, active=False)
    assert isinstance(result, Equilibrium)
    solutions = every_solution(problem)
    assert any(np.allclose(result.force_n, force, atol=1e-9) for force in solutions)
    assert result.residual < 1e-10
    np.testing.assert_allclose(result.force_n, other.force_n, atol=1e-10)
    if by_force:
        assert result.total[2] == pytest.approx(0.8, rel=1e-10)


def test_a_gap_that_can_not_be_met_stays_open():
    problem = random_problem(1, by_force=False)
    shut, first = problem.gap, np.arange(7) == 0

    def gap(q):
        values, slope = shut(q)
        return np.where(first, np.inf, values), slope * ~first[:, None]

    result = solved(problem, gap=gap)
    assert not result.active[0]
    assert not result.force_n[0].any()


def test_a_patch_that_the_probe_moves_away_from_is_let_go():
    """A flat face that turns off a patch can't be met by it any more: no such set is in contact."""
    problem = replace(random_problem(1, by_force=True), friction=np.zeros(7))
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
        solved(random_problem(2, by_force=True), **free)
