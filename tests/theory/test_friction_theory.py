"""Partial slip in closed form: its limits, and the torque that a traction of its own adds up to."""

import math

import pytest

from twin.theory.contact import tangential_stiffness, torsional_stiffness
from twin.theory.friction import sheared_motion, stick_radius, twisted

A, P, MU, E, NU = 1.3, 0.7, 0.4, 0.8, 0.3


def test_shear_starts_stuck_and_ends_at_three_halves_of_the_stuck_motion() -> None:
    stuck = MU * P / tangential_stiffness(A, E, NU)
    assert sheared_motion(A, 1e-6 * MU * P, P, MU, E, NU) == pytest.approx(1e-6 * stuck, rel=1e-5)
    assert sheared_motion(A, MU * P, P, MU, E, NU) == pytest.approx(1.5 * stuck)
    assert stick_radius(A, MU * P, P, MU) == 0.0
    assert stick_radius(A, MU * P * 7 / 8, P, MU) == pytest.approx(A / 2)


def test_the_tractions_of_two_hertz_discs_add_up_to_the_force() -> None:
    """Mindlin's traction is mu p of the whole disc less (c/a) mu p of the stuck one: forces go like the radius^3."""
    force = 0.6 * MU * P
    c = stick_radius(A, force, P, MU)
    assert MU * P * (1 - (c / A) ** 3) == pytest.approx(force)


def test_twist_starts_stuck_and_ends_at_the_torque_of_full_slip() -> None:
    turn, torque = twisted((1 - 1e-6) * A, A, P, MU, E, NU)
    assert torque / turn == pytest.approx(torsional_stiffness(A, E, NU), rel=1e-4)
    assert twisted(1e-9 * A, A, P, MU, E, NU)[1] == pytest.approx(3 * math.pi / 16 * MU * P * A, rel=1e-5)
    turns = [twisted(c * A, A, P, MU, E, NU) for c in (0.9, 0.6, 0.3)]
    assert turns[0] < turns[1] < turns[2]
