"""The bonded layer against the layered half-space on rock, its own derivatives, and Hooke's law."""

import numpy as np
import pytest
from standard_bodies import assert_near, rectangles

from benchmarks.layered import Layered, bump_displacement
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.theory import halfspace
from twin.theory.bonded_layer import REACH, BondedLayer
from twin.world.elasticity.discretise import tile

THICKNESS = 2.0
PAD = Block(width_mm=80, length_mm=80, thickness_mm=THICKNESS)
POINTS = np.array([[0.3, 0.2, 0.1], [1.0, -0.4, 1.0], [-2.5, 3.0, 0.4], [0.0, 0.0, 1.7], [9.0, 5.0, 0.7]])


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_half_space_and_correction_are_a_layer_on_rock(nu):
    for force in np.eye(3):
        load = tile(Traction.bump((0, 0), 1.5, tuple(force)), PAD, 0.03)
        got = BondedLayer(THICKNESS, nu).displacement(POINTS, load, 0.7)
        got += halfspace.displacement(POINTS, load, 0.7, nu)
        rock = Layered(thickness_mm=THICKNESS, layer=(0.7, nu), below=(1e9, 0.3))
        assert_near(got, bump_displacement(POINTS, rock, 1.5, tuple(force)), 2e-5)


def test_many_small_rectangles_are_one_large_one():
    layer = BondedLayer(THICKNESS, 0.5)
    one = tile(Traction.rectangle((0.4, -0.2), (3, 2), (0.3, -0.5, 1)), PAD)
    strips = np.linspace(-0.96, 0.96, 25)
    offsets = np.array([(1.5 * s, 1.0 * t, 0.0) for s in strips for t in strips])
    places = one.centre_mm + offsets
    many = rectangles(places, one.half_mm / 25, one.force_n / 625, one.frames)
    assert_near(layer.displacement(POINTS, many, 1.0), layer.displacement(POINTS, one, 1.0), 2e-5)
    each = layer.compliance(POINTS, many, 1.0) @ many.force_n.ravel()
    assert_near(each, layer.displacement(POINTS, many, 1.0).ravel(), 1e-12)


def test_the_base_is_at_rest_and_so_is_the_layer_far_away():
    load = tile(Traction.rectangle((0, 0), (1, 1), (0.5, 0, 1)), PAD)
    far = (REACH - 0.01) * THICKNESS
    points = np.array([[0.4, 0.1, 2.0], [1.5, -2.0, 2.0], [far, 0.0, 0.5], [far + 0.1, 0.0, 0.5]])
    for nu in (0.5, 0.3):
        moved = halfspace.displacement(points, load, 1.0, nu) + BondedLayer(THICKNESS, nu).displacement(
            points, load, 1.0
        )
        assert np.abs(moved[:2]).max() < 1e-5
        assert np.abs(moved[2:]).max() < 2e-5


def test_gradient_and_traction_follow_from_the_displacement():
    nu, step = 0.3, 1e-4
    layer, shear = BondedLayer(THICKNESS, nu), 1.0 / 2.6
    load = tile(Traction.rectangle((0.4, -0.2), (1, 2), (0.3, -0.5, 1)), PAD)
    points = np.vstack([POINTS, [[30.0, 2.0, 0.6]]])  # one where the layer is at rest
    differences = [
        (layer.displacement(points + move, load, 1.0) - layer.displacement(points - move, load, 1.0)) / (2 * step)
        for move in step * np.eye(3)
    ]
    gradient = layer.gradient(points, load, 1.0)
    assert_near(gradient, np.stack(differences, axis=2), 2e-5)
    areas = np.random.default_rng(2).normal(size=(len(points), 3))
    strain = (gradient + np.swapaxes(gradient, 1, 2)) / 2
    dilation = np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    stress = 2 * shear * (strain + nu / (1 - 2 * nu) * dilation)
    got = layer.tractions(points, areas, load, load.force_n[:, :, None])[..., 0]
    assert_near(got, np.einsum("nij,nj->ni", stress, areas), 1e-4)
