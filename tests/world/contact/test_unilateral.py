"""The active-set solver against enumeration, on problems small enough to try every set of patches."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from twin.errors import ContactError
from twin.world.contact.unilateral import TOLERANCE, Equilibrium, Unilateral, solve


def random_problem(seed: int, *, by_force: bool, k: int = 7) -> Unilateral:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * k, 3 * k))
    compliance = (root @ root.T + 0.3 * np.eye(3 * k)).reshape(k, 3, k, 3)
    gap0 = rng.uniform(0.0, 2.0, k)
    carried = np.zeros((k, 3, 4))
    carried[:, 0, 0] = carried[:, 1, 1] = carried[:, 2, 2] = 1.0
    carried[:, 0, 3], carried[:, 1, 3] = rng.normal(size=(2, k))
    slope = np.zeros((k, 4))
    slope[:, 2] = -1.0
    return Unilateral(
        compliance=compliance, gap=lambda q: (gap0 + slope @ q, slope), carried=carried,
        by_force=np.array([False, False, by_force, False]),
        given=np.array([0.3, -0.1, 0.8 if by_force else 1.2, 0.05]),
        pushing=np.array([False, False, by_force, False]), friction=np.where(rng.random(k) < 0.5, np.inf, 0.0),
        offset=rng.normal(scale=0.1, size=(k, 2)),
    )  # fmt: skip


def every_solution(problem: Unilateral) -> list[np.ndarray]:
    """Forces of all sets of patches that meet every condition, by dense linear algebra of its own."""
    k = len(problem.offset)
    flat = problem.compliance.reshape(3 * k, 3 * k)
    found = []
    for chosen in product([False, True], repeat=k):
        active = np.array(chosen)
        a, s = np.flatnonzero(active), np.flatnonzero(active & problem.sticking)
        rows = [3 * i + 2 for i in a] + [3 * i for i in s] + [3 * i + 1 for i in s]
        n = len(rows)
        matrix, right = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        matrix[:n, :n] = flat[np.ix_(rows, rows)]
        still = np.where(problem.by_force, 0.0, problem.given)
        gap, _ = problem.gap(still)
        for line, row in enumerate(rows):
            i, axis = divmod(row, 3)
            right[line] = -gap[i] if axis == 2 else problem.carried[i, axis] @ still + problem.offset[i, axis]
            matrix[line, n] = -problem.carried[i, axis, 2]
        if problem.by_force[2]:
            matrix[n, :n] = [1.0 if row % 3 == 2 else 0.0 for row in rows]
            right[n] = problem.given[2]
        else:
            matrix[n, n] = 1.0
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        x = np.linalg.solve(matrix, right)
        force = np.zeros(3 * k)
        force[rows] = x[:n]
        opening = (flat @ force)[2::3] + gap - x[n]
        if np.all(force[2::3][active] > -1e-12) and np.all(opening[~active] > -1e-12):
            found.append(force.reshape(k, 3))
    return found


@pytest.mark.parametrize("by_force", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_enumeration(seed: int, by_force: bool) -> None:
    problem = random_problem(seed, by_force=by_force)
    result = solve(problem, np.ones(7, bool), np.zeros(4))
    assert isinstance(result, Equilibrium)
    assert any(np.allclose(result.force_n, force, atol=1e-9) for force in every_solution(problem))
    assert result.residual < 1e-10
    if by_force:
        assert result.total[2] == pytest.approx(0.8, rel=1e-10)


def test_starts_anywhere() -> None:
    problem = random_problem(3, by_force=True)
    one = solve(problem, np.ones(7, bool), np.zeros(4))
    other = solve(problem, np.zeros(7, bool), np.zeros(4))
    np.testing.assert_allclose(one.force_n, other.force_n, atol=1e-10)


def test_a_gap_that_can_not_be_met_stays_open() -> None:
    problem = random_problem(1, by_force=False)
    shut = problem.gap

    def gap(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, slope = shut(q)
        return np.where(np.arange(7) == 0, np.inf, values), slope * (np.arange(7) != 0)[:, None]

    result = solve(Unilateral(**{**vars(problem), "gap": gap}), np.ones(7, bool), np.zeros(4))
    assert not result.active[0]
    assert not result.force_n[0].any()


def test_a_patch_that_the_probe_moves_away_from_is_let_go() -> None:
    """A flat face that turns off a patch can't be met by it any more: such a set in contact is none."""
    problem = random_problem(1, by_force=True)
    problem = replace(problem, friction=np.zeros(7))
    whole, met = solve(problem, np.ones(7, bool), np.zeros(4)), problem.gap
    lost = int(np.flatnonzero(whole.active)[0])

    def gap(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, slope = met(q)
        return np.where((np.arange(7) == lost) & (q[2] > 0.5 * whole.place[2]), np.inf, values), slope

    result = solve(replace(problem, gap=gap), whole.active, np.zeros(4))
    assert not result.active[lost]
    assert result.residual <= TOLERANCE


def test_no_equilibrium_is_an_error() -> None:
    """A lateral force on patches that all slide has nothing to balance it."""
    problem = random_problem(2, by_force=True)
    free = {"friction": np.zeros(7), "by_force": np.array([True, False, True, False])}
    with pytest.raises(ContactError):
        solve(Unilateral(**{**vars(problem), **free}), np.ones(7, bool), np.zeros(4))
