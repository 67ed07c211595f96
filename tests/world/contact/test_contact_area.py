"""The area of a contact from the polynomial nearest to its squared pressures."""

import math

import numpy as np
import pytest
from presses import HalfSpace
from standard_bodies import BLOCK

from twin.parts.press import Cone, Sphere
from twin.world.contact.active_set import Equilibrium
from twin.world.contact.contact_problem import ProbeSetup
from twin.world.contact.contact_state import ContactState
from twin.world.contact.probe_gap import Approach
from twin.world.contact.surface_patches import Patches

SIZE = 2.0
LATTICE = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 21)]), axis=-1).reshape(-1, 2)
U, V = LATTICE[np.linalg.norm(LATTICE, axis=1) <= 1.0].T
"""Places on a disc of `SIZE`, over it; their mean is the middle."""
SQUARE = U**2 + V**2
BALL, CONE = Sphere(diameter_mm=40), Cone(apex_deg=150, diameter_mm=20)


def area_of(probe, place, cell, pressure):
    """Return the area of a contact whose equal patches (k, 2) have known pressures, mm2."""
    k = len(place)
    half = np.full((k, 2), cell / 2)
    frames, never = np.tile(np.eye(3), (k, 1, 1)), np.zeros(k, bool)
    grid = {"centre_mm": np.c_[place, np.zeros(k)], "frames": frames, "half_mm": half, "middle_mm": place}
    patches = Patches(**grid, cell_mm=half, border=never, edge=never)
    force = np.zeros((k, 3))
    force[:, 2] = pressure * cell**2
    moved = {"displacement_mm": np.zeros((k, 3)), "pose": np.zeros(6), "total": np.zeros(6)}
    found = Equilibrium(force_n=force, active=~never, slipping=never, residual=0.0, steps=1, **moved)
    rubber = {"youngs_modulus_mpa": 1.0, "poisson_ratio": 0.5}
    first = Approach.of(probe, BLOCK, np.zeros(2))
    setup = ProbeSetup(body=BLOCK, compliance=HalfSpace(), first=first, across=16, most=1000, **rubber)
    slope = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], (k, 1))
    return ContactState.touching(setup, patches, found, touch_z_mm=0.0, friction=0.0, slope=slope).area_mm2


def area(squared, probe=BALL, chosen=slice(None)):
    """Return the area over that of a disc of `SIZE`."""
    place = SIZE * np.column_stack([U, V])[chosen]
    return area_of(probe, place, 0.1 * SIZE, np.sqrt(squared[chosen])) / (math.pi * SIZE**2)


@pytest.mark.parametrize("probe", [BALL, CONE])
def test_the_area_is_of_the_nearest_polynomial(probe):
    """By least squares, which do not see what is orthogonal to all terms; a cone's reads the outer half alone."""
    squared = 1.0 - (U / 1.05) ** 2 - (V / 1.1) ** 2 + 0.05 * U * V + 0.03 * U - 0.01 * SQUARE**2
    exact = area(squared, probe)
    used = squared <= np.median(squared) if probe is CONE else np.ones(len(U), bool)
    terms = np.column_stack([np.ones(len(U)), U, V, U * U, U * V, V * V, SQUARE**2])[used]
    basis = np.linalg.qr(terms)[0]
    noise = np.random.default_rng(0).uniform(-1, 1, len(terms))
    unseen = noise - basis @ (basis.T @ noise)
    unseen *= 0.2 * squared.min() / np.abs(unseen).max()
    noisy = squared.copy()
    noisy[used] += unseen
    noisy[~used] += 1.0
    assert area(noisy, probe) == pytest.approx(exact, rel=1e-9)
    assert area(squared - 0.03 * SQUARE, probe) < 0.99 * exact


@pytest.mark.parametrize("probe", [BALL, CONE])
def test_a_term_that_others_make_up_is_left_out(probe):
    """Of two rows v^2 is one, so that rounding of the places would decide on the area."""
    rng = np.random.default_rng(1)
    place = np.array([(a, b) for a in range(8) for b in range(2)], float)
    for _ in range(50):
        pressure = np.sqrt(1.0 - ((place[:, 0] - 3.5) / 4.0) ** 2) + rng.uniform(0.0, 0.1, len(place))
        exact, near = (area_of(probe, place + off * rng.normal(size=place.shape), 1.0, pressure) for off in (0, 1e-12))
        assert near == pytest.approx(exact, rel=1e-6)


def test_a_contact_ends_where_its_polynomial_first_vanishes():
    """On an ellipse (mean squared radius: product of its half axes); at the first of two ends; else patches count."""
    ellipse = 1.0 - (U / 1.02) ** 2 - (V / 1.1) ** 2
    assert area(ellipse) == pytest.approx(1.02 * 1.1, rel=1e-4)
    once, again = 0.7, 1.2
    both = (SQUARE - once**2) * (SQUARE - again**2)
    assert area(both, CONE, SQUARE < 0.68**2) == pytest.approx(once**2, rel=1e-4)
    assert area(1.0 + 0.1 * SQUARE) == pytest.approx(len(U) * 0.01 / math.pi)
