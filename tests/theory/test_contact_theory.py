"""The closed forms of contact agree with one another.

Partial slip in closed form: its limits, and the torque that a traction of its own adds up to.
"""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks.contact_theory import (
    bonded_punch_stiffness,
    oblique_motion,
    punch_stiffness,
    sheared_motion,
    square_punch_stiffness,
    stick_radius,
    tangential_stiffness,
    torsional_stiffness,
    twisted,
)
from twin.errors import InputError
from twin.parts.material import plane_strain_modulus, shear_modulus
from twin.theory.contact import hertz, punch_pressure

RUBBER = {"youngs_modulus_mpa": 0.7, "poisson_ratio": 0.4}


def test_hertz_pressure_sums_to_the_force():
    contact = hertz(radius_mm=5.0, force_n=0.3, **RUBBER)
    total, _ = quad(lambda r: 2 * math.pi * r * float(contact.pressure(np.array(r))), 0, contact.contact_radius_mm)
    assert total == pytest.approx(0.3, rel=1e-8)
    assert contact.pressure(np.array([1.01 * contact.contact_radius_mm])) == 0.0


def test_hertz_centre_is_pushed_in_by_the_indentation():
    """Displacement of the middle: integral of p / (pi E*) 2 pi dr over the disc (Boussinesq)."""
    contact = hertz(radius_mm=5.0, force_n=0.3, **RUBBER)
    integral, _ = quad(lambda r: 2.0 * float(contact.pressure(np.array(r))), 0, contact.contact_radius_mm)
    assert integral / plane_strain_modulus(**RUBBER) == pytest.approx(contact.indentation_mm, rel=1e-8)


def test_hertz_from_force_and_from_indentation_agree():
    by_force = hertz(radius_mm=1.5, force_n=0.98, **RUBBER)
    by_motion = hertz(radius_mm=1.5, indentation_mm=by_force.indentation_mm, **RUBBER)
    assert by_motion.force_n == pytest.approx(0.98, rel=1e-12)
    assert by_motion.peak_pressure_mpa == pytest.approx(by_force.peak_pressure_mpa, rel=1e-12)


def test_hertz_grows_like_a_punch_of_its_radius():
    """The slope dF/dd of a frictionless round contact is a flat punch's (Johnson 1985, ch. 5)."""
    low, middle, high = (hertz(radius_mm=5.0, indentation_mm=0.1 + step, **RUBBER) for step in (-1e-5, 0.0, 1e-5))
    slope = (high.force_n - low.force_n) / 2e-5
    assert slope == pytest.approx(punch_stiffness(middle.contact_radius_mm, 0.7, 0.4), rel=1e-6)


def test_punch_pressure_sums_to_the_force_and_pushes_evenly():
    def pressure(s):
        return float(punch_pressure(np.array(2.0 * math.sin(s)), 2.0, 0.4))

    end = math.pi / 2 - 1e-9
    total, _ = quad(lambda s: 8.0 * math.pi * math.sin(s) * math.cos(s) * pressure(s), 0, end)
    assert total == pytest.approx(0.4, rel=1e-6)
    middle, _ = quad(lambda s: 4.0 * math.cos(s) * pressure(s), 0, end)
    assert 0.4 / (middle / plane_strain_modulus(**RUBBER)) == pytest.approx(punch_stiffness(2.0, 0.7, 0.4), rel=1e-6)


def test_incompressible_limits():
    assert bonded_punch_stiffness(2.0, 0.7, 0.5) == pytest.approx(punch_stiffness(2.0, 0.7, 0.5), rel=1e-12)
    assert bonded_punch_stiffness(2.0, 0.7, 0.499999) == pytest.approx(punch_stiffness(2.0, 0.7, 0.5), rel=1e-5)
    assert bonded_punch_stiffness(2.0, 0.7, 0.0) / punch_stiffness(2.0, 0.7, 0.0) == pytest.approx(
        math.log(3), rel=1e-9
    )
    assert tangential_stiffness(2.0, 0.7, 0.5) / punch_stiffness(2.0, 0.7, 0.5) == pytest.approx(2 / 3, rel=1e-12)


def test_torsion_from_its_traction():
    """q = 3 T r / (4 pi a^3 sqrt(a^2 - r^2)) turns the disc by 3 T / (16 G a^3)."""
    a, angle = 2.0, 0.01
    torque = torsional_stiffness(a, 0.7, 0.4) * angle
    moment, _ = quad(
        lambda s: 2 * math.pi * (a * math.sin(s)) ** 2 * 3 * torque * math.sin(s) * a / (4 * math.pi * a**3),
        0,
        math.pi / 2,
    )
    assert moment == pytest.approx(torque, rel=1e-9)
    assert torque == pytest.approx(16 / 3 * shear_modulus(0.7, 0.4) * a**3 * angle, rel=1e-12)


def test_a_square_punch_is_between_the_discs_in_and_around_it():
    square = square_punch_stiffness(2.0, 0.7, 0.4)
    assert punch_stiffness(1.0, 0.7, 0.4) < square < punch_stiffness(math.sqrt(2), 0.7, 0.4)
    assert punch_stiffness(2.0 / math.sqrt(math.pi), 0.7, 0.4) < square


def test_oblique_motion_is_the_sum_over_a_growing_contact():
    loads = np.linspace(0.0, 1.0, 20001)
    radius = 2.0 * np.cbrt((loads[1:] + loads[:-1]) / 2)
    steps = [0.1 * d / tangential_stiffness(r, 0.7, 0.4) for d, r in zip(np.diff(loads), radius, strict=True)]
    assert oblique_motion(2.0, 0.1, 0.7, 0.4) == pytest.approx(sum(steps), rel=5e-4)


@pytest.mark.parametrize(
    "given", [{}, {"force_n": 1.0, "indentation_mm": 1.0}, {"force_n": 0.0}, {"indentation_mm": -1.0}]
)
def test_hertz_refuses_what_is_not_a_press(given):
    with pytest.raises(InputError):
        hertz(radius_mm=1.0, **RUBBER, **given)


A, P, MU, E, NU = 1.3, 0.7, 0.4, 0.8, 0.3


def test_shear_starts_stuck_and_ends_at_three_halves_of_the_stuck_motion():
    stuck = MU * P / tangential_stiffness(A, E, NU)
    assert sheared_motion(A, 1e-6 * MU * P, P, MU, E, NU) == pytest.approx(1e-6 * stuck, rel=1e-5)
    assert sheared_motion(A, MU * P, P, MU, E, NU) == pytest.approx(1.5 * stuck)
    assert stick_radius(A, MU * P, P, MU) == 0.0
    assert stick_radius(A, MU * P * 7 / 8, P, MU) == pytest.approx(A / 2)


def test_twist_starts_stuck_and_ends_at_the_torque_of_full_slip():
    turn, torque = twisted((1 - 1e-6) * A, A, P, MU, E, NU)
    assert torque / turn == pytest.approx(torsional_stiffness(A, E, NU), rel=1e-4)
    assert twisted(1e-9 * A, A, P, MU, E, NU)[1] == pytest.approx(3 * math.pi / 16 * MU * P * A, rel=1e-5)
    turns = [twisted(c * A, A, P, MU, E, NU) for c in (0.9, 0.6, 0.3)]
    assert turns[0] < turns[1] < turns[2]
