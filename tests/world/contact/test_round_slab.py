"""The slab of revolution: homogeneous stretch in closed form, and its tangent."""

import math

import numpy as np
import pytest
from stretched_rubber import LAWS, every_law, nominal_stress

from twin.world.contact.round_slab import Grid, Slab, graded_line

RADIUS, THICK = 5.0, 3.0


def slab_of(material):
    grid = Grid(graded_line(0.4, 4, RADIUS), graded_line(0.3, 3, THICK), 4)
    return grid, Slab(grid, material)


def nodes_of(grid):
    """Return the places (N, 2) of the nodes, corners and middles."""
    lines = []
    for corners in (grid.r_mm, grid.z_mm):
        line = np.empty(2 * len(corners) - 1)
        line[::2] = corners
        line[1::2] = (corners[1:] + corners[:-1]) / 2.0
        lines.append(line)
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("stretch", [0.5, 0.9, 1.5, 2.0])
@pytest.mark.parametrize("material", [LAWS[0], LAWS[2], LAWS[3]], ids=lambda one: one.law)
def test_homogeneous_stretch_is_in_balance_and_carries_the_closed_form(material, stretch):
    """A patch test at large strain: the nominal stress 2 (l - l^-2) (W1 + W2 / l), E = 1 MPa, the sides free."""
    grid, slab = slab_of(material)
    places = nodes_of(grid)
    moved = np.column_stack([(stretch**-0.5 - 1.0) * places[:, 0], (stretch - 1.0) * places[:, 1]])
    unknowns = np.zeros(slab.size)
    unknowns[: moved.size] = moved.ravel()
    before = slab.resistance(unknowns)
    sides = np.isclose(places[:, 0], RADIUS)
    # the pressure under which the sides are free, from what they carry without it
    unknowns[moved.size :] = 1.0
    per_pressure = slab.displacement(slab.resistance(unknowns) - before)[sides, 0].sum()
    unknowns[moved.size :] = -slab.displacement(before)[sides, 0].sum() / per_pressure
    left = slab.resistance(unknowns)
    force = slab.displacement(left)
    top, bottom = np.isclose(places[:, 1], 0.0), np.isclose(places[:, 1], THICK)
    stress = nominal_stress(material, stretch)
    assert force[bottom, 1].sum() == pytest.approx(math.pi * RADIUS**2 * stress, rel=1e-10)
    assert force[top, 1].sum() == pytest.approx(-math.pi * RADIUS**2 * stress, rel=1e-10)
    inner = ~(top | bottom | np.isclose(places[:, 0], 0.0))
    assert force[inner] == pytest.approx(np.zeros_like(force[inner]), abs=1e-10)
    assert left[moved.size :] == pytest.approx(np.zeros(slab.size - moved.size), abs=1e-10)


@every_law
def test_tangent_is_reciprocal_and_the_slope_of_the_resistance(material):
    grid, slab = slab_of(material)
    rng = np.random.default_rng(3)
    state = 0.02 * rng.standard_normal(slab.size)
    one, other = rng.standard_normal((2, slab.size))
    for node in (one, other, state):
        slab.displacement(node)[: 2 * len(grid.z_mm) - 1, 0] = 0.0  # nothing leaves the axis
    tangent = slab.tangent(state)
    assert other @ (tangent @ one) == pytest.approx(one @ (tangent @ other), rel=1e-10)
    step = 1e-6
    change = (slab.resistance(state + step * one) - slab.resistance(state - step * one)) / (2.0 * step)
    exact = tangent @ one
    assert np.abs(change - exact).max() < 1e-6 * np.abs(exact).max()
