"""The dome's elastic field: against an independent program, its symmetries, the half-space.

How the reference was made: ``tests/reference/make_linear.py``.
"""

import json
from functools import cache

import numpy as np
import pytest
from standard_bodies import BLOCK, DOME, REFERENCE, relative_error, traction_of

from twin.files import MESHES
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.quadratic_mesh import Mesh
from twin.world.mesh.quality import Quality
from twin.world.mesh.sizing import WORLD, Sizing

TRUTH = np.load(REFERENCE / "dome.npz")
CASES = json.loads(str(TRUTH["cases"]))


@cache
def compliance(level, nu):
    """Return the dome's compliance on a shipped mesh."""
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
    return Compliance(DOME, material, Mesh.read(MESHES / f"dome.{level}.npz"), level=level)


def error(level, case):
    """Return the largest error over the largest displacement of one case of the reference."""
    load = tile(traction_of(case), DOME)
    moved = compliance(level, case["nu"]).displacement(TRUTH["points"], load)
    return relative_error(moved, TRUTH[case["key"]])


@pytest.mark.parametrize("level", ["nominal", *WORLD])
def test_shipped_meshes_pass_the_gates_and_are_the_ones_that_would_be_made(level):
    path = MESHES / f"dome.{level}.npz"
    measured = Quality.of(Mesh.read(path), DOME)
    assert not measured.failures()
    assert measured.least_dihedral_deg > 12
    assert abs(measured.volume_error) < 1e-4
    assert Mesh.load(path)[1]["key"] == Sizing.of(DOME, level).mesh_key(DOME)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("level", "bound"), [("nominal", 3e-3), ("sketch", 1e-2), ("coarse", 5e-3), ("standard", 1.5e-3), ("fine", 1e-3)]
)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case["key"])
def test_every_level_against_the_independent_program(level, bound, case):
    assert error(level, case) < bound


def test_a_push_on_the_apex_moves_nothing_sideways_there_and_a_twist_only_turns():
    stiff = compliance("nominal", 0.5)
    axis = np.column_stack([np.zeros((5, 2)), np.linspace(0.3, 6, 5)])
    pushed = stiff.displacement(axis, tile(Traction.disk((0, 0), 1.5, (0, 0, 1)), DOME))
    assert np.abs(pushed[:, :2]).max() < 1e-3 * np.abs(pushed).max()
    ring = DOME.chart_points(3 * np.array([[1.0, 0], [0, 1], [-0.6, 0.8]]), 1.0)
    twisted = stiff.displacement(ring, tile(Traction.twist((0, 0), 2.0, 10.0), DOME))
    around = np.column_stack([-ring[:, 1], ring[:, 0]]) / np.hypot(ring[:, 0], ring[:, 1])[:, None]
    along = np.einsum("ni,ni->n", twisted[:, :2], around)
    assert (along > 0).all()
    np.testing.assert_allclose(along, along.mean(), rtol=0.01)
    assert np.abs(twisted - along[:, None] * np.column_stack([around, np.zeros(3)])).max() < 0.01 * along.mean()


@pytest.mark.parametrize("force", [(0, 0, 1), (1, 0, 0)])
def test_the_smaller_the_load_the_nearer_its_own_field_is_to_the_half_space(force):
    off = []
    for radius in (0.8, 0.4, 0.2):
        load = tile(Traction.disk((0, 0), radius, force), DOME)
        below = radius * np.array([[0.0, 0, 0.5], [0.3, 0.2, 1.0], [0, 0.8, 1.5]])
        moved = compliance("nominal", 0.5).displacement(below, load)
        flat = tile(Traction.disk((0, 0), radius, force), BLOCK)
        alone = halfspace.displacement(below, flat, 0.5, 0.5)
        off.append(np.abs(moved - alone).max() / np.abs(alone).max())
    assert off[0] < 0.25
    assert off[2] < off[1] < off[0]
    assert 1.5 < off[1] / off[2] < 2.3
