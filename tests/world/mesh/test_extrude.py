"""Layers grown on a body: exact thickness and volume, whole boundary, no element inside out, on every kind of body."""

import numpy as np
import pytest
from slabs import slab

from twin.errors import MeshError
from twin.parts.body import Block, Dome, Finger
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.elements import tet_quadrature, tet_shapes
from twin.world.mesh.extrude import extruded, squeezed, with_base, with_cover
from twin.world.mesh.mesh import read_mesh, write_mesh
from twin.world.mesh.quality import enclosed_volume, jacobian_ratios, offsets, open_edges
from twin.world.mesh.snap import boundary_triangles, signed_volumes

FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
BODIES = {"finger": FINGER, "block": BLOCK}


@pytest.fixture(scope="module", params=list(BODIES))
def given(request):
    return BODIES[request.param], body_mesh(BODIES[request.param], "nominal")


def volume(mesh, region):
    """Return the volume of a region's curved elements."""
    places, weights = tet_quadrature()
    slopes = tet_shapes(places)[1]
    nodes = mesh.points[mesh.tets[mesh.region == region]]
    return float(np.einsum("q,mq->", weights, np.linalg.det(np.einsum("mai,qaj->mqij", nodes, slopes))))


def conforms(mesh):
    """Every face of an element is shared by two or on the boundary, whose faces are closed and turned outward."""
    told = {tuple(sorted(face)) for face in mesh.faces[:, :3].tolist()}
    assert told == {tuple(sorted(face)) for face in boundary_triangles(mesh.tets[:, :4]).tolist()}
    assert open_edges(mesh.faces) == 0
    assert np.min(signed_volumes(mesh.points, mesh.tets)) > 0
    assert enclosed_volume(mesh.points, mesh.faces) == pytest.approx(sum(volume(mesh, k) for k in (0, 1, 2)), rel=1e-9)
    edges = mesh.tets[:, :4][:, [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]].reshape(-1, 2)
    middle = mesh.tets[:, 4:].reshape(-1)
    pairs = np.unique(np.column_stack([np.sort(edges, axis=1), middle]), axis=0)
    assert len(pairs) == len(np.unique(pairs[:, :2], axis=0)) == len(mesh.points) - mesh.corners


@pytest.mark.parametrize("thickness", [0.02, 0.2, 0.8])
@pytest.mark.parametrize("sheets", [1, 2])
def test_cover_is_exact(given, thickness, sheets):
    body, mesh = given
    covered = with_cover(mesh, body, thickness, sheets=sheets)
    conforms(covered)
    assert offsets(covered, body).max() < 1e-9
    within = np.unique(covered.tets[covered.region == 1][:, :4])
    depth = body.depth(covered.points[within])
    steps = np.round(depth / thickness * sheets, 9)
    assert set(np.unique(steps)) == set(range(sheets + 1))
    inner = np.unique(covered.tets[covered.region == 0])
    assert body.depth(covered.points[inner]).min() > thickness - 0.02
    assert jacobian_ratios(covered.points, covered.tets).min() > 0.2
    if isinstance(body, Block):
        exact = body.width_mm * body.length_mm * thickness
        assert volume(covered, 1) == pytest.approx(exact, rel=1e-9)
    else:
        core = Finger(radius_mm=8 - thickness, barrel_mm=8, skirt_mm=2)
        assert volume(covered, 1) == pytest.approx(body.volume_mm3 - core.volume_mm3, rel=3e-3)


def test_a_domes_cover_ends_at_its_sharp_rim_on_the_base():
    body = Dome(radius_mm=10, height_mm=7)
    covered = with_cover(body_mesh(body, "nominal"), body, 0.2)
    conforms(covered)
    assert offsets(covered, body).max() < 1e-9


def test_base_is_exact_and_its_faces_are_new_pieces(given):
    body, mesh = given
    based = with_base(with_cover(mesh, body, 0.2), body, 3.0, sheets=2)
    conforms(based)
    base = len(body.pieces) - 1
    assert not np.any(based.piece == base)
    under, side = based.nodes_on([base + 1]), based.nodes_on([base + 2])
    assert np.ptp(based.points[under, 2]) == 0.0
    assert based.points[under, 2].max() == pytest.approx(body.base_z_mm + 3.0)
    assert np.all(based.points[side, 2] >= body.base_z_mm - 1e-9)
    faces = based.faces[based.piece == base + 1]
    footprint = np.abs(np.cross(based.points[faces[:, 1]] - based.points[faces[:, 0]],
                                based.points[faces[:, 2]] - based.points[faces[:, 0]])[:, 2]).sum() / 2  # fmt: skip
    assert volume(based, 2) == pytest.approx(3.0 * footprint, rel=5e-3)


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_equal_materials_make_a_covered_body_a_bare_one(given, nu):
    """The same field on the covered mesh of one material as on the bare mesh, within what the meshes differ by."""
    body, mesh = given
    covered = with_cover(mesh, body, 0.2)
    gradient = np.random.default_rng(3).normal(size=(3, 3))
    gradient -= np.trace(gradient) / 3 * np.eye(3)
    linear = (covered.points @ gradient.T)[:, :, None]
    on = np.zeros(len(covered.points), bool)
    on[covered.faces] = True
    layer = Layer(modulus_ratio=(1 + 0.3) / (1 + nu), poisson_ratio=0.3)
    solved = TaylorHood(covered, nu, held=on, layers=[layer]).solve(np.zeros_like(linear), linear)
    np.testing.assert_allclose(solved, linear, atol=1e-9 * np.abs(linear).max())


def test_regions_are_stored_and_read_back(tmp_path, given):
    body, mesh = given
    covered = with_cover(mesh, body, 0.2)
    write_mesh(covered, tmp_path / "covered.npz", {})
    again = read_mesh(tmp_path / "covered.npz")
    assert np.array_equal(again.region, covered.region)
    assert again.digest() == covered.digest() != mesh.digest()


def test_covers_that_do_not_fit_are_refused(given):
    body, mesh = given
    for thickness in (0.0, -1.0, 30.0):
        with pytest.raises(MeshError, match="does not fit"):
            with_cover(mesh, body, thickness)


def test_a_sheet_takes_over_the_pieces_beside_it():
    body = Block(width_mm=6, length_mm=5, thickness_mm=4)
    mesh = slab(body, np.linspace(-3, 3, 3), np.linspace(-2.5, 2.5, 3), np.linspace(0, 4, 3))
    grown = extruded(squeezed(mesh, body, 0.5), 0, lambda points, on: points * [1, 1, 0], region=1)
    area = {k: 0.0 for k in range(6)}
    corner = grown.points[grown.faces[:, :3]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2
    for k in area:
        total = normal[grown.piece == k].sum(axis=0)
        inward = body.piece_normals(np.zeros((1, 3)))[0, k]
        area[k] = float(-total @ inward)
        np.testing.assert_allclose(total, -area[k] * inward, atol=1e-12)
    assert area == pytest.approx({0: 30, 1: 20, 2: 20, 3: 24, 4: 24, 5: 30})
