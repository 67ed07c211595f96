"""Elements drawn to the clamped rim: same surface and volume, and the singular exponent met."""

import numpy as np
import pytest
from slabs import jacobians
from standard_bodies import BLOCK, FINGER

from twin.parts.body import Finger
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.snap import drawn_to_rim

BODIES = {"block": BLOCK, "finger": FINGER, "back": Finger(radius_mm=8, barrel_mm=8, skirt_mm=2, back="held")}


@pytest.fixture(params=BODIES)
def body(request):
    return BODIES[request.param]


def on_rim(mesh, body):
    """Return (n,) which nodes lie on both held and other faces."""
    free = np.setdiff1d(mesh.piece, body.held_pieces)
    return mesh.nodes_on(body.held_pieces) & mesh.nodes_on(free)


def meshes(body):
    plain = body_mesh(body if body != BODIES["back"] else BODIES["finger"], "sketch")
    return plain, drawn_to_rim(plain, body)


def test_only_middles_of_edges_from_the_rim_move_and_stay_in_their_faces(body):
    plain, drawn = meshes(body)
    moved = np.linalg.norm(drawn.points - plain.points, axis=1) > 1e-12
    assert 20 < moved.sum() < len(moved) / 2
    assert not np.any(moved[: plain.corners])
    assert not np.any(moved & on_rim(plain, body))
    for piece in range(len(body.pieces)):
        on = plain.nodes_on([piece])
        assert np.abs(body.piece_distances(drawn.points[on])[:, piece]).max() < 1e-9


def test_elements_keep_their_volume_and_never_fold(body):
    plain, drawn = meshes(body)
    (before, weights), (after, _) = (jacobians(mesh) for mesh in (plain, drawn))
    assert after.min() > 0.0
    assert (after @ weights).sum() == pytest.approx((before @ weights).sum(), rel=2e-4)


def test_points_beside_the_rim_are_found_and_linear_fields_read_exactly(body):
    drawn = meshes(body)[1]
    rim = drawn.points[on_rim(drawn, body)]
    rng = np.random.default_rng(3)
    inward = np.mean(np.array(body.bounds_mm), axis=0) - rim
    points = rim + inward * rng.uniform(1e-6, 0.3, (len(rim), 1))
    points = points[body.contains(points, 0.0)]
    assert len(points) > 20
    places = Locator(drawn).locate(points)
    field = drawn.points @ rng.normal(size=(3, 3))
    slope = np.linalg.lstsq(drawn.points, field, rcond=None)[0].T
    assert np.abs(places.values(field) - points @ slope.T).max() < 1e-8
    assert np.abs(places.gradients(field) - slope).max() < 1e-5


@pytest.mark.parametrize(("name", "force"), [("block", (1, 0, 0)), ("finger", (0, 1, 0))])
def test_far_from_the_load_the_coarsest_mesh_now_tells_the_body_s_stiffness(name, force):
    """A shear load's far field against a finer mesh: half the plain mesh's difference."""
    body, material = BODIES[name], Material()
    load = tile(Traction.bump((0, 0), 2.0, force), body)
    size = 10.0 if name == "block" else 2.0
    points = np.array([[-2.0, 1.0, 2.0], [2.5, -1.0, 3.0], [0.0, 2.0, 2.5]]) * [size / 2, size / 2, 1.0]
    better = Compliance(body, material, level="standard", table=False).displacement(points, load)
    away = []
    for mesh in meshes(body):
        got = Compliance(body, material, mesh).displacement(points, load)
        away.append(np.linalg.norm(got - better, axis=1).max())
    assert away[1] < away[0] / 2.0
