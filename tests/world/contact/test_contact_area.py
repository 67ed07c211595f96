"""The area of a contact from the polynomial nearest to its squared pressures."""

import math

import numpy as np
import pytest

from twin.world.contact.contact_state import area_under

SIZE = 2.0
LATTICE = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 21)]), axis=-1).reshape(-1, 2)
U, V = LATTICE[np.linalg.norm(LATTICE, axis=1) <= 1.0].T
"""Places on a disc of `SIZE`, over it; their mean is the middle."""
SQUARE = U**2 + V**2
EVERY = np.ones(len(U), bool)


def area(squared, used=EVERY, *, fourth):
    """Return the area over that of a disc of `SIZE`; unused pressures are of no account."""
    unused = np.random.default_rng(2).uniform(0, 1, len(U))
    pressure = np.where(used, np.sqrt(np.where(used, squared, 0.0)), unused)
    places = SIZE * np.column_stack([U, V])
    return area_under(places, pressure, used, fourth=fourth) / (math.pi * SIZE**2)


@pytest.mark.parametrize("fourth", [False, True])
def test_the_area_is_of_the_nearest_polynomial(fourth):
    """By least squares, which do not see what is orthogonal to all terms."""
    squared = 1.0 - (U / 1.2) ** 2 - (V / 1.3) ** 2 + 0.05 * U * V + 0.03 * U - 0.03 * fourth * SQUARE**2
    exact = area(squared, fourth=fourth)
    terms = np.column_stack([EVERY, U, V, U * U, U * V, V * V, SQUARE**2])[:, : 6 + fourth]
    basis = np.linalg.qr(terms)[0]
    noise = np.random.default_rng(0).uniform(-1, 1, len(U))
    unseen = noise - basis @ (basis.T @ noise)
    unseen *= 0.9 * squared.min() / np.abs(unseen).max()
    assert area(squared + unseen, fourth=fourth) == pytest.approx(exact, rel=1e-9)
    assert area(squared, SQUARE < 0.5, fourth=fourth) == pytest.approx(exact, rel=1e-9)
    assert area(squared + 0.1 * SQUARE, fourth=fourth) > 1.05 * exact


@pytest.mark.parametrize("fourth", [False, True])
@pytest.mark.parametrize("rows", [1, 2])
def test_a_term_that_others_make_up_is_left_out(rows, fourth):
    """Of two rows v^2 is one, so that rounding of the places would decide on the area."""
    rng = np.random.default_rng(1)
    place = np.array([(a, b) for a in range(6) for b in range(rows)], float)
    for _ in range(5):
        near = place + 1e-12 * rng.normal(size=place.shape)
        pressure, used = rng.uniform(0.1, 1.0, len(place)), np.ones(len(place), bool)
        exact = area_under(place, pressure, used, fourth=fourth)
        assert area_under(near, pressure, used, fourth=fourth) == pytest.approx(exact, rel=1e-6)


def test_a_contact_ends_where_its_polynomial_first_vanishes():
    """On an ellipse (mean squared radius: product of its half axes); at the first of two ends."""
    ellipse = 1.0 - (U / 1.05) ** 2 - (V / 1.3) ** 2
    assert area(ellipse, fourth=False) == pytest.approx(1.05 * 1.3, rel=1e-4)
    once, again = 0.7, 1.2
    both = (SQUARE - once**2) * (SQUARE - again**2)
    assert area(both, SQUARE < 0.65**2, fourth=True) == pytest.approx(once**2, rel=1e-4)
    assert area(1.0 + 0.1 * SQUARE, fourth=False) == math.inf
