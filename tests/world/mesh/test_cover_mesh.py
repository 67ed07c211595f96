"""Covers and refined meshes: exact thickness and volume, whole boundary, fine as asked."""

import numpy as np
import pytest
from slabs import jacobians, slab
from standard_bodies import BLOCK, DOME, FINGER

from twin.errors import MeshError
from twin.parts.body import Block, Finger
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.cover_mesh import with_cover
from twin.world.mesh.quadratic_mesh import TET_EDGES, boundary_triangles, signed_volumes
from twin.world.mesh.quality import Quality, open_edges


@pytest.fixture(scope="module", params=[BLOCK, FINGER, DOME], ids=["block", "finger", "dome"])
def body(request):
    return request.param


@pytest.fixture(scope="module")
def mesh(body):
    return body_mesh(body, "nominal")


def volume(mesh, region):
    """Return the volume of a region's curved elements."""
    determinants, weights = jacobians(mesh)
    return float((determinants @ weights)[mesh.region == region].sum())


def assert_conforms(mesh, body):
    """Each face of an element is shared by two or on the closed boundary, which is on the body."""
    faces, outer = (
        {tuple(sorted(face)) for face in each.tolist()}
        for each in (mesh.faces[:, :3], boundary_triangles(mesh.tets[:, :4]))
    )
    assert faces == outer
    assert open_edges(mesh.faces) == 0
    assert np.min(signed_volumes(mesh.points, mesh.tets)) > 0
    total = sum(volume(mesh, region) for region in (0, 1, 2))
    assert mesh.enclosed_volume() == pytest.approx(total, rel=1e-9)
    edges = np.sort(mesh.tets[:, TET_EDGES].reshape(-1, 2), axis=1)
    pairs = np.unique(np.column_stack([edges, mesh.tets[:, 4:].reshape(-1)]), axis=0)
    ends = np.unique(pairs[:, :2], axis=0)
    assert len(pairs) == len(ends) == len(mesh.points) - mesh.corners
    assert Quality.of(mesh, body).largest_offset_mm < 1e-9


@pytest.mark.parametrize("thickness", [0.02, 0.2, 0.8])
def test_cover_is_exact(body, mesh, thickness):
    if body is DOME and thickness > 0.5:
        pytest.skip("too thick for the elements at its sharp rim")
    covered = with_cover(mesh, body, thickness)
    assert_conforms(covered, body)
    within = np.unique(covered.tets[covered.region == 1][:, :4])
    assert set(np.round(body.depth(covered.points[within]) / thickness, 9)) == {0.0, 1.0}
    inner = np.unique(covered.tets[covered.region == 0])
    assert body.depth(covered.points[inner]).min() > thickness - 0.02
    assert covered.jacobian_ratios().min() > 0.2
    if body is DOME:  # the cover ends at its sharp rim, on the base
        return
    if body is BLOCK:
        exact, near = body.width_mm * body.length_mm * thickness, 1e-9
    else:
        core = Finger(radius_mm=8 - thickness, barrel_mm=8, skirt_mm=2)
        exact, near = body.volume_mm3 - core.volume_mm3, 3e-3
    assert volume(covered, 1) == pytest.approx(exact, rel=near)


def test_a_cover_takes_over_the_faces_of_the_sensing_piece_and_of_those_around_it():
    body = Block(width_mm=6, length_mm=5, thickness_mm=4)
    axes = np.linspace(-3, 3, 3), np.linspace(-2.5, 2.5, 3), np.linspace(0, 4, 3)
    covered = with_cover(slab(body, *axes), body, 0.5)
    a, b, c = (covered.points[covered.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a) / 2
    area = {}
    for k, inward in enumerate(body.piece_normals(np.zeros((1, 3)))[0]):
        total = normal[covered.piece == k].sum(axis=0)
        area[k] = float(-total @ inward)
        np.testing.assert_allclose(total, -area[k] * inward, atol=1e-12)
    assert area == pytest.approx({0: 30, 1: 20, 2: 20, 3: 24, 4: 24, 5: 30})


@pytest.mark.parametrize("thickness", [0.0, -1.0, 30.0])
def test_covers_that_do_not_fit_are_refused(body, mesh, thickness):
    with pytest.raises(MeshError, match="does not fit"):
        with_cover(mesh, body, thickness)


@pytest.mark.parametrize(("body", "edge", "local"), [(BLOCK, 3.0, False), (FINGER, 0.5, False), (FINGER, 0.5, True)])
def test_refined_mesh_is_fine_whole_and_on_the_surface(body, edge, local):
    coarse = body_mesh(body, "sketch")

    def wanted(points):
        return edge + 1.5 * np.maximum(np.linalg.norm(points, axis=1) - edge, 0.0)

    mesh = refined(coarse, body, wanted, local=local)
    ends = mesh.points[mesh.tets[:, TET_EDGES]]
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    middle = ends.mean(axis=2) if local else np.repeat(mesh.points[mesh.tets[:, :4]].mean(axis=1)[:, None], 6, axis=1)
    # moving onto the surface may stretch an edge
    assert np.all(length <= 1.1 * wanted(middle.reshape(-1, 3)).reshape(-1, 6))
    got = Quality.of(mesh, body)
    assert got.open_edges == got.unclassified == 0
    assert got.largest_offset_mm < 1e-9
    assert got.least_volume_mm3 > 0
    assert abs(got.volume_error) <= max(1.2 * abs(Quality.of(coarse, body).volume_error), 1e-12)
    least, before = (Quality.dihedral_angles(m.points, m.tets).min() for m in (mesh, coarse))
    assert least > 0.3 * before
    assert refined(coarse, body, wanted, local=local).digest() == mesh.digest()


def test_nothing_to_do_changes_nothing():
    coarse = body_mesh(BLOCK, "sketch")
    same = refined(coarse, BLOCK, lambda points: np.full(len(points), 1e3))
    assert same.digest() == coarse.digest()
