"""The first guess of a sheared contact against Cattaneo and Mindlin, and that it saves work and changes no result."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from test_contact import pressed

from twin.arrays import Floats
from twin.parts.press import Press, Sphere, Step
from twin.theory.friction import stick_radius
from twin.world.contact import first_guess, friction
from twin.world.contact.first_guess import sheared
from twin.world.contact.gap import MOTIONS, X, Y, Z
from twin.world.contact.unilateral import Equilibrium, Unilateral

MU = 0.4


def hertzian(x: float, y: float, across: int = 81) -> tuple[Unilateral, Floats, Floats]:
    """Return a problem that asks for x and y as shares of mu P, Hertz's forces on its patches, and their radii."""
    line = (np.arange(across) + 0.5) / across * 2.0 - 1.0
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    radius = np.hypot(*points.T)
    force = np.zeros((len(points), 3))
    force[:, Z] = np.sqrt(np.maximum(1.0 - radius**2, 0.0))
    carried = np.tile(np.eye(3, MOTIONS), (len(points), 1, 1))
    push = float(force[:, Z].sum())
    given = np.array([x * MU * push, y * MU * push, push, 0.0, 0.0, 0.0])
    problem = Unilateral(
        compliance=np.zeros((0, 3, 0, 3)), gap=lambda _: (np.zeros(0), np.zeros(0)), carried=carried,
        by_force=np.isin(np.arange(MOTIONS), (X, Y, Z)), given=given, pushing=np.arange(MOTIONS) == Z,
        friction=np.full(len(points), MU), offset=np.zeros((len(points), 2)),
    )  # fmt: skip
    return problem, force, radius


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.0), (-0.6, 0.4), (0.0, 0.95)])
def test_a_shear_is_guessed_as_cattaneo_and_mindlin_have_it(x: float, y: float) -> None:
    problem, force, radius = hertzian(x, y)
    found = sheared(problem, force)
    np.testing.assert_allclose(problem.total(found)[: Z + 1], problem.given[: Z + 1], rtol=1e-4, atol=1e-9)
    drag, most = np.hypot(found[:, X], found[:, Y]), MU * force[:, Z]
    np.testing.assert_allclose(found[:, X] * y, found[:, Y] * x, atol=1e-12)
    assert (drag <= most * (1 + 1e-12)).all()
    sticks = stick_radius(1.0, float(np.hypot(x, y)), 1.0, 1.0)
    slips = (drag >= most * (1 - 1e-9)) & (most > 0.0)
    assert radius[slips].min() == pytest.approx(sticks, abs=2 / 81)
    assert slips[(radius > sticks + 2 / 81) & (most > 0.0)].all()


def test_nothing_is_guessed_where_friction_carries_less_or_nothing_is_lacking() -> None:
    for x in (0.0, 1.01):
        problem, force, _ = hertzian(x, 0.0, across=21)
        assert np.array_equal(sheared(problem, force), force)


@contextmanager
def counted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Count the Newton steps of every equilibrium with friction."""
    steps, real = list[int](), friction.solve_coulomb

    def counting(*arguments: Any) -> Equilibrium:
        found = real(*arguments)
        steps.append(found.steps)
        return found

    with monkeypatch.context() as patch:
        patch.setattr(friction, "solve_coulomb", counting)
        yield steps


def test_the_guess_saves_newton_steps_and_changes_no_force(monkeypatch: pytest.MonkeyPatch) -> None:
    press = Press(probe=Sphere(diameter_mm=30), friction=MU, steps=(Step(force_n=(0.12, 0.0, 0.5)),))
    with counted(monkeypatch) as few:
        guessed = pressed(press, across=12, nu=0.5, increments=1)
    monkeypatch.setattr(first_guess, "sheared", lambda _, force: force)
    with counted(monkeypatch) as many:
        plain = pressed(press, across=12, nu=0.5, increments=1)
    assert few[0] < many[0]
    np.testing.assert_allclose(guessed.traction_mpa, plain.traction_mpa, atol=1e-9 * plain.peak_pressure_mpa)
