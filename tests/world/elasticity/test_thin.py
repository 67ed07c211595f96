"""Thin bonded blocks: the closed-form layer where the sides are far, estimates near them."""

from dataclasses import replace

import numpy as np
import pytest
from standard_bodies import BLOCK, relative_error

from benchmarks.layered import Layered, bump_displacement
from twin.arrays import frozen
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.body_mesh import body_mesh

PAD = Block(width_mm=40, length_mm=40, thickness_mm=2)
POINTS = np.array([[x, 0.3 * x, z] for x in (0.0, 0.5, 1.0, 2.0, 3.0) for z in (0.1, 0.3, 0.5, 1.0, 1.6)])


def pad(nu):
    """A pad on the thick block's coarsest mesh, squeezed: no mesher is needed."""
    mesh = body_mesh(BLOCK, "sketch")
    squeezed = replace(mesh, points=frozen(mesh.points * [0.4, 40 / 90, 0.05]))
    return Compliance(PAD, Material(youngs_modulus_mpa=0.5, poisson_ratio=nu), squeezed)


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_inside_the_coarsest_mesh_is_exact(nu):
    stiff = pad(nu)
    rock = Layered(thickness_mm=2.0, layer=(0.5, nu), below=(1e9, 0.3))
    for radius, force in ((0.5, (0, 0, 1)), (1.5, (0, 0, 1)), (1.5, (1, 0, 0))):
        load = tile(Traction.bump((0, 0), radius, force), PAD, 0.04 * radius)
        got = stiff.displacement(POINTS, load)
        assert relative_error(got, bump_displacement(POINTS, rock, radius, force)) < 1e-4
        turned = stiff.gradient(POINTS[::7], load)
        moved = [stiff.displacement(POINTS[::7] + move, load) for move in (-1e-4 * np.eye(3)[0], 1e-4 * np.eye(3)[0])]
        assert np.abs((moved[1] - moved[0]) / 2e-4 - turned[:, :, 0]).max() < 1e-3 * np.abs(turned).max()


def test_every_way_to_ask_gives_the_same_field():
    stiff, near = pad(0.5), POINTS + np.array([16.0, 2.0, 0.0])
    patches = tile(Traction.rectangle((17.0, 3.0), (2, 2), (0.2, -0.1, 1)), PAD, 0.5)
    field = stiff.displacement(near, patches)
    matrix = stiff.to_points(near, patches)
    assert relative_error((matrix @ patches.force_n.ravel()).reshape(-1, 3), field) < 2e-3
    stiff.surface(patches)
    assert stiff.asymmetry < 1e-2
