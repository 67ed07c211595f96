"""Halving edges: as fine as asked, whole, on the true surface, of bounded angles, and the same every time."""

import numpy as np
import pytest

from twin.parts.body import Block, Finger
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.quality import dihedral_angles, open_edges, quality
from twin.world.mesh.snap import EDGE_CORNERS

BODIES = {
    "block": (Block(width_mm=100, length_mm=90, thickness_mm=40), 3.0),
    "finger": (Finger(radius_mm=8, barrel_mm=8, skirt_mm=2), 0.5),
}


@pytest.mark.parametrize("name", list(BODIES))
def test_refined_mesh_is_fine_whole_and_on_the_surface(name):
    body, edge = BODIES[name]
    coarse = body_mesh(body, "sketch")

    def wanted(points):
        return edge + 1.5 * np.maximum(np.linalg.norm(points, axis=1) - edge, 0.0)

    mesh = refined(coarse, body, wanted)
    corner = mesh.points[mesh.tets[:, :4]]
    longest = np.linalg.norm(corner[:, EDGE_CORNERS[:, 0]] - corner[:, EDGE_CORNERS[:, 1]], axis=2).max(axis=1)
    assert np.all(longest <= 1.1 * wanted(corner.mean(axis=1)))  # moving onto the surface may stretch an edge
    got = quality(mesh, body)
    assert got.open_edges == got.unclassified == 0
    assert got.largest_offset_mm < 1e-9
    assert got.least_volume_mm3 > 0
    assert abs(got.volume_error) <= max(1.2 * abs(quality(coarse, body).volume_error), 1e-12)
    assert open_edges(mesh.faces) == 0
    assert dihedral_angles(mesh.points, mesh.tets).min() > 0.3 * dihedral_angles(coarse.points, coarse.tets).min()
    assert refined(coarse, body, wanted).digest() == mesh.digest()


def test_nothing_to_do_changes_nothing():
    body, _ = BODIES["block"]
    coarse = body_mesh(body, "sketch")
    assert refined(coarse, body, lambda points: np.full(len(points), 1e3)).digest() == coarse.digest()
