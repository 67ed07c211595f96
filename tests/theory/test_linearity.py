"""Strain and turn of known gradients, the law of linearity's cost against the study; contact's closed forms agree."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import twin
from benchmarks.contact_theory import punch_stiffness
from benchmarks.record import stored
from twin.errors import InputError
from twin.parts.material import plane_strain_modulus
from twin.theory.contact import (
    KNOWN_RADIUS,
    cone_contact_radius,
    hertz,
    largest_strain_and_turn,
    law_of,
    punch_pressure,
)
from twin.world.contact.finite_strain import measured_linearity

PROBES = ("sphere", "cylinder", "pillar")


def test_a_turn_strains_nothing_and_is_found_about_any_axis():
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    spin = 0.02 * np.cross(np.eye(3), axis)
    assert largest_strain_and_turn(spin[None]) == pytest.approx((0.0, math.degrees(0.02)), abs=1e-12)


def test_largest_principal_strain_counts_whatever_its_sign_and_frame():
    turned = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    squeezed = turned @ np.diag([0.05, 0.07, -0.12]) @ turned.T
    assert largest_strain_and_turn(np.stack([0.5 * squeezed, squeezed])) == pytest.approx((0.12, 0.0), abs=1e-6)


def test_simple_shear_is_half_strain_and_half_turn():
    shear = np.zeros((1, 3, 3))
    shear[0, 0, 2] = 0.1
    assert largest_strain_and_turn(shear) == pytest.approx((0.05, math.degrees(0.05)))
    assert largest_strain_and_turn(np.zeros((0, 3, 3))) == (0.0, 0.0)


def test_a_press_costs_less_than_a_bar_that_is_strained_all_over():
    """Neo-Hookean bar under dead compression s E: s = (1/l^2 - l)/3; linear theory: 1 - l = s."""

    def error(s):
        stretch = brentq(lambda x: (1 / x**2 - x) / 3 - s, 0.5, 1.0)
        return abs(s - (1 - stretch)) / (1 - stretch)

    assert error(1e-3) / 1e-3 == pytest.approx(1.0, abs=0.01)  # the law's form, with the factor 1
    for probe in PROBES:
        assert all(0 < law_of(probe, 0.0, sheared=sheared).factor < 1 for sheared in (True, False))


def test_law_is_on_the_safe_side_of_every_press_of_the_study_and_not_far():
    over: dict[tuple[bool, bool], list[float]] = {}
    for row in stored("validity"):
        flat, sheared = row["a/R"] == "", row["shear, N"] != ""
        law = law_of("cylinder" if flat else "sphere", 0.0, sheared=sheared)  # rubber thick for its contact
        over.setdefault((flat, sheared), []).append(row["largest error, %"] / 100 / (law.factor * row["p/E"]))
    assert len(over) == 4
    for (flat, _), ratios in over.items():
        # Presses on thin layers set the spheres' factor, below.
        assert (0.8 if flat else 0.6) < max(ratios) <= 1.0


@pytest.mark.parametrize(("thick_mm", "diameter_mm", "force_n"), [(4, 6, 1.5), (2, 6, 1.0), (2, 12, 4.0)])
def test_on_thin_rubber_the_law_is_on_the_safe_side_of_a_measurement_and_not_far(thick_mm, diameter_mm, force_n):
    """A factor for thick rubber says 1 to 3 % where linear theory is 3 to 10 % off."""
    sensor = twin.Sensor(twin.load_scene("block_bare", {"body.thickness_mm": thick_mm}))
    press = twin.Press(probe=twin.Sphere(diameter_mm=diameter_mm), force_n=(0, 0, 0.5 * force_n))  # E = 0.5 MPa
    state = sensor.press(press)
    along = np.linspace(0.0, 2.0 * state.contact_radius_mm, 12)
    places = np.column_stack([along, 0.0 * along, np.full(12, 0.25 * thick_mm)])
    rubber = sensor.nominal.material
    found = measured_linearity(press, sensor.nominal.body, rubber, state, places).linearisation_error
    assert found < state.validity.linearisation_error < 1.5 * found


def test_contacts_and_strains_are_called_known_up_to_the_largest_of_the_study():
    rows = stored("validity")
    spheres = [row for row in rows if row["a/R"] != ""]
    assert pytest.approx(max(row["a/R"] for row in spheres), abs=0.005) == KNOWN_RADIUS
    studied = {
        ("sphere", False): spheres, ("sphere", True): [row for row in spheres if row["shear, N"]],
        ("pillar", False): [row for row in rows if row not in spheres],
    }  # fmt: skip
    for (probe, sheared), mine in studied.items():
        largest = max(row["p/E"] for row in mine)
        assert law_of(probe, 0.0, sheared=sheared).known_strain == pytest.approx(largest, rel=0.05)


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


@pytest.mark.parametrize(
    "given", [{}, {"force_n": 1.0, "indentation_mm": 1.0}, {"force_n": 0.0}, {"indentation_mm": -1.0}]
)
def test_hertz_refuses_what_is_not_a_press(given):
    with pytest.raises(InputError):
        hertz(radius_mm=1.0, **RUBBER, **given)


@pytest.mark.parametrize("given", [{"poisson_ratio": 1.0}, {"poisson_ratio": -1.0}, {"youngs_modulus_mpa": 0.0}])
def test_closed_forms_refuse_what_no_solid_has(given):
    rubber = {**RUBBER, **given}
    with pytest.raises(InputError, match=f"{next(iter(given))} = {next(iter(given.values())):g}"):
        hertz(radius_mm=1.0, force_n=1.0, **rubber)
    with pytest.raises(InputError, match=r"above -1 and at most 0\.5"):
        cone_contact_radius(1.0, 150.0, **rubber)
