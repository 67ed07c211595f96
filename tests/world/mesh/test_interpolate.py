"""Points are read from the element that holds them, wherever they are."""

from __future__ import annotations

import numpy as np
import pytest

from twin.parts.body import Block, Body, Finger
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.elements import tet_shapes
from twin.world.mesh.interpolate import Locator

BODIES: list[Body] = [
    Block(width_mm=100, length_mm=90, thickness_mm=40),
    Finger(radius_mm=8, barrel_mm=8, skirt_mm=2),
]
POINTS = 60_000


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.shape)
def test_points_are_read_from_their_own_element(body: Body) -> None:
    """Uniform over the volume, so that large elements beside small ones count, and drawn towards faces and edges.

    What a neighbour says of a point that isn't in it differs as much as the field's third derivatives: here by 1e-5.
    """
    mesh, rng = body_mesh(body, "nominal"), np.random.default_rng(1)
    corners = mesh.points[mesh.tets[:, :4]]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    drawn = mesh.tets[rng.choice(len(volume), POINTS, p=volume / volume.sum())]
    shapes, _ = tet_shapes(rng.dirichlet(np.full(4, 0.5), POINTS)[:, 1:])
    points = np.einsum("qa,qai->qi", shapes, mesh.points[drawn])
    field = (mesh.points**3).sum(axis=1)
    read = Locator(mesh).locate(points).values(field)
    assert np.abs(read - (shapes * field[drawn]).sum(axis=1)).max() < 1e-10 * np.abs(field).max()
