"""The finger's back, free or held: its mesh stays, its nodes rest, near presses feel it."""

import numpy as np
import pytest
from standard_bodies import FINGER

from twin.parts.body import Finger
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.sizing import Sizing, WantedEdge

FREE = FINGER
HELD = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2, back="held")


@pytest.fixture(scope="module")
def mesh():
    return body_mesh(FREE, "nominal")


def test_only_a_held_back_asks_for_another_mesh():
    sizing = Sizing.of(FREE, "nominal")
    told = {**FREE.model_dump(), "back": "free"}
    assert sizing.mesh_key(Finger(**told)) == sizing.mesh_key(FREE) != sizing.mesh_key(HELD)


def test_rim_runs_around_a_held_back():
    free, held = (WantedEdge(body, Sizing.of(body, "nominal")).rim_mm for body in (FREE, HELD))
    assert np.any(held[np.abs(held[:, 0] + 8.0) < 1e-9, 2] < 0.5)
    assert not np.any(free[:, 2] < 9.9)


def test_held_nodes_stay_and_reactions_balance(mesh):
    system = TaylorHood(mesh, 0.5, held=mesh.nodes_on(HELD.held_pieces))
    forces = np.zeros((len(mesh.points), 3, 3))
    forces[int(np.argmin(np.linalg.norm(mesh.points, axis=1)))] = np.eye(3)
    moved = system.solve(forces)
    assert not np.any(moved[np.abs(mesh.points[:, 0] + 8.0) < 1e-9])
    np.testing.assert_allclose(system.reaction(forces), -np.eye(3), atol=1e-8)


@pytest.mark.slow
def test_a_held_back_stiffens_most_near_it(mesh):
    """Work of the same load: less with the back held, by more the nearer the load is."""
    saved = []
    for x in (-5.0, -2.0, 3.0):
        load = tile(Traction.bump((x, 0.0), 1.0, (0.0, 0.0, 1.0)), FREE)
        point = np.array([[x, 0.0, FREE.surface_from_above(np.array([[x, 0.0]]))[0, 2] + 1.0]])
        free, held = (Compliance(body, Material(), mesh).displacement(point, load)[0, 2] for body in (FREE, HELD))
        saved.append(1.0 - held / free)
    assert saved == sorted(saved, reverse=True)
    assert saved[0] > 0.05
    assert 0.0 < saved[2] < 0.02
