"""The solver of Coulomb's law against a slow iteration of another kind, and the limit load against closed forms."""

import math

import numpy as np
import pytest

from twin.errors import ContactError
from twin.world.contact.capacity import asked_share
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.unilateral import Unilateral

K = 9


def random_problem(seed: int, *, by_force: bool = False) -> Unilateral:
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.normal(size=(3 * K, 3 * K))
    compliance = (root @ root.T / K + np.eye(3 * K)).reshape(K, 3, K, 3)
    gap0 = rng.uniform(0.0, 1.0, K)
    carried = np.zeros((K, 3, 4))
    carried[:, 0, 0] = carried[:, 1, 1] = carried[:, 2, 2] = 1.0
    carried[:, 0, 3], carried[:, 1, 3] = rng.normal(size=(2, K))
    slope = np.tile([0.0, 0.0, -1.0, 0.0], (K, 1))
    held = np.array([by_force, False, by_force, False])
    return Unilateral(
        compliance=compliance, gap=lambda q: (gap0 + slope @ q, slope), carried=carried, by_force=held,
        given=np.where(held, [0.5, 0, 2.5, 0], [0.3, -0.2, 1.1, 0.1]), pushing=held & [False, False, True, False],
        friction=rng.uniform(0.2, 0.8, K),
        offset=rng.normal(scale=0.2, size=(K, 2)),
    )  # fmt: skip


def relaxed(problem: Unilateral, place: np.ndarray) -> np.ndarray:
    """Return the forces at a place by thousands of rounds over the patches, each mended by itself."""
    force = np.zeros((K, 3))
    gap, _ = problem.gap(place)
    for _ in range(3000):
        for i in range(K):
            step = 0.5 / problem.compliance[i, range(3), i, range(3)].max()
            moved = np.einsum("alb,lb->a", problem.compliance[i], force)
            force[i, 2] = max(0.0, force[i, 2] - step * (moved[2] + gap[i]))
            drag = force[i, :2] - step * (moved[:2] - problem.carried[i, :2] @ place - problem.offset[i])
            bound = problem.friction[i] * force[i, 2]
            force[i, :2] = drag * min(1.0, bound / max(math.hypot(*drag), 1e-300))
    return force


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_a_slow_iteration_from_any_start(seed: int) -> None:
    problem = random_problem(seed)
    slow = relaxed(problem, problem.given)
    starts = np.random.default_rng(seed).normal(size=(3, K, 3))
    for start in (np.zeros((K, 3)), *starts):
        found = solve_coulomb(problem, start, np.zeros(4))
        np.testing.assert_allclose(found.force_n, slow, atol=1e-10)
        assert found.residual < 1e-10
    assert found.slipping.any()


@pytest.mark.parametrize("seed", range(4))
def test_given_forces_are_balanced_where_the_slow_iteration_finds_them_too(seed: int) -> None:
    problem = random_problem(seed, by_force=True)
    found = solve_coulomb(problem, np.zeros((K, 3)), np.array([0.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(found.total[[0, 2]], [0.5, 2.5], rtol=1e-10)
    np.testing.assert_allclose(relaxed(problem, found.place), found.force_n, atol=1e-9)


def test_more_than_friction_carries_is_refused() -> None:
    problem = random_problem(1, by_force=True)
    much = Unilateral(**{**vars(problem), "given": np.array([2.5, 0.0, 2.5, 0.0])})
    with pytest.raises(ContactError):
        solve_coulomb(much, np.zeros((K, 3)), np.array([0.0, 0.0, 1.0, 0.0]))


def test_limit_load_of_a_ring() -> None:
    """All of the pressure at one radius: mu P sideways, mu P r about the axis, less when both are asked."""
    turn = np.arange(60) * math.pi / 30
    carried = np.zeros((60, 3, 4))
    carried[:, 0, 0] = carried[:, 1, 1] = carried[:, 2, 2] = 1.0
    carried[:, 0, 3], carried[:, 1, 3] = -3.0 * np.sin(turn), 3.0 * np.cos(turn)
    normal, mu = np.full(60, 2.0 / 60), 0.4
    every = np.ones(4, bool)

    def share(x: float, torque: float) -> float:
        return asked_share(carried, normal, mu, every, np.array([x, 0.0, 2.0, torque]))

    assert share(0.8, 0.0) == pytest.approx(1.0, rel=2e-3)
    assert share(0.0, -2.4) == pytest.approx(1.0, rel=2e-3)
    assert share(0.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert max(0.5, 0.7) < share(0.4, 0.7 * 2.4) < 1.2
