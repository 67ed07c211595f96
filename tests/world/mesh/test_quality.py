"""Quality against closed forms, each gate closes on its fault, unsolvable systems are refused."""

from dataclasses import replace

import numpy as np
import pytest
from slabs import block_boxes, slab
from standard_bodies import assert_holder_balances, forces_on, on_boundary

from twin.errors import InputError, MeshError, SolveError
from twin.parts.body import Block
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh
from twin.world.mesh.quality import Quality
from twin.world.mesh.snap import snapped_mesh

CUBE = Block(width_mm=5, length_mm=5, thickness_mm=5)
REGULAR = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], dtype=float)
CORNER = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
ONE_TET = np.arange(10)[None]


@pytest.fixture
def cube():
    """Return the cube cut into six tetrahedra."""
    return snapped_mesh(CUBE, *block_boxes(CUBE, (1, 1, 1)))


def with_middles(corners):
    return np.concatenate([corners, corners[TET_EDGES].mean(axis=1)])


def one_tet(nodes):
    """Return the mesh of one tetrahedron of ten nodes."""
    faces = [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]]
    return Mesh(points=nodes, tets=ONE_TET, corners=4, faces=np.array(faces), piece=np.zeros(4, int))


def figures(corners):
    """Return the quality of one straight tetrahedron."""
    return Quality.of(one_tet(with_middles(corners)), CUBE)


def test_angles_and_scaled_jacobians_of_known_tetrahedra():
    regular, corner = figures(REGULAR), figures(CORNER)
    assert regular.least_dihedral_deg == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert abs(regular.least_scaled_jacobian) == pytest.approx(1)
    assert corner.least_dihedral_deg == pytest.approx(np.degrees(np.arctan(np.sqrt(2))))
    # longest corner: 1 x sqrt 2 x sqrt 2
    assert corner.least_scaled_jacobian == pytest.approx(np.sqrt(2) / 2)


def test_the_jacobian_ratio_of_one_moved_middle_has_its_closed_form():
    nodes = with_middles(CORNER)
    assert one_tet(nodes).jacobian_ratios()[0] == pytest.approx(1)
    # x = r + .05 * 4 (1 - r - s - t) r: determinant 1 + .2 (1 - 2 r - s - t), from .8 to 1.2
    nodes[4, 0] += 0.05
    assert one_tet(nodes).jacobian_ratios()[0] == pytest.approx(0.8 / 1.2)


def test_a_straight_cube_passes_every_figure(cube):
    measured = Quality.of(cube, CUBE)
    assert measured.failures() == []
    assert measured.volume_error == pytest.approx(0, abs=1e-14)
    assert measured.least_volume_mm3 == pytest.approx(125 / 6)
    assert measured.least_dihedral_deg == pytest.approx(45)


def moved(mesh, node, by):
    points = mesh.points.copy()
    points[node] += by
    return {"points": points}


def replaced(array, value, row=0):
    array = array.copy()
    array[row] = value
    return array


TWICE = [0, *range(12)]
FAULTS = {
    "negative": ("smallest volume", lambda m: {"tets": m.tets[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]}),
    "offset": ("offset of a boundary node", lambda m: moved(m, m.faces[0, 3], 1e-6)),
    "hole": ("open boundary edges: 3 ", lambda m: {"faces": m.faces[1:], "piece": m.piece[1:]}),
    "face twice": ("open boundary edges: 3 ", lambda m: {"faces": m.faces[TWICE], "piece": m.piece[TWICE]}),
    "turned face": ("open boundary edges", lambda m: {"faces": replaced(m.faces, m.faces[0, [0, 2, 1, 5, 4, 3]])}),
    "wrong piece": ("boundary node", lambda m: {"piece": replaced(m.piece, (m.piece[0] + 1) % 6)}),
    "no piece": ("boundary faces of no piece: 1 ", lambda m: {"piece": replaced(m.piece, 6)}),
    "curled": ("Jacobian ratio", lambda m: moved(m, m.tets[0, 4], 0.2 * np.diff(m.points[m.tets[0, :2]], axis=0)[0])),
    "flat": ("dihedral angle", lambda m: {"points": m.points * [1, 1, 0.05]}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_gate_closes_on_its_fault(cube, name):
    message, fault = FAULTS[name]
    assert any(message in line for line in Quality.of(replace(cube, **fault(cube)), CUBE).failures())


BLOCK = Block(width_mm=6, length_mm=5, thickness_mm=4)
FORCE = np.array([[0.3], [-0.2], [1.0]])


@pytest.fixture(scope="module")
def mesh():
    z = np.array([0.0, 1.0, 2.5, 4.0])
    return slab(BLOCK, np.linspace(-3, 3, 4), np.linspace(-2.5, 2.5, 4), z)


def push(mesh, node=0):
    return forces_on(mesh, node, FORCE)


def solve(mesh, force=None, nu=0.5, **keys):
    return TaylorHood(mesh, nu, **keys).solve(push(mesh) if force is None else force)


def pair(mesh, shared):
    """Return copies side by side along x, the second held nowhere, and its farthest node.

    Nodes that coincide on ``shared`` are one.
    """
    whole = np.concatenate([mesh.points, mesh.points + np.array([6.0, 0.0, 0.0])])
    corner = np.concatenate([np.arange(len(mesh.points)) < mesh.corners] * 2)
    key = np.round(whole, 6)
    glued = shared(whole) & (np.abs(whole[:, 0] - 3.0) < 1e-9)
    key[~glued] += np.where(np.arange(len(whole)) < len(mesh.points), 0.0, 1e3)[~glued, None]
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(~corner[first], kind="stable")
    near, far = np.split(np.argsort(order)[group.ravel()], 2)
    made = Mesh(
        points=whole[first][order],
        tets=np.concatenate([near[mesh.tets], far[mesh.tets]]),
        corners=int(corner[first].sum()),
        faces=np.concatenate([near[mesh.faces], far[mesh.faces]]),
        piece=np.concatenate([mesh.piece, np.where(mesh.piece == 5, 2, mesh.piece)]),
    )
    return made, int(far[np.argmax(mesh.points[:, 0])])


def test_a_body_held_nowhere_or_on_a_line_is_refused(mesh):
    nowhere = np.zeros(len(mesh.points), bool)
    for force in (push(mesh), push(mesh) - push(mesh, 7)):
        with pytest.raises(SolveError, match="the body is held nowhere"):
            solve(mesh, force, held=nowhere)
    with pytest.raises(SolveError, match="on one line only, and can turn"):
        solve(mesh, held=(mesh.points[:, 2] > 3.99) & (mesh.points[:, 0] > 2.99))
    on_face = replaced(nowhere, True, mesh.faces[mesh.piece == 5][0])
    assert_holder_balances(TaylorHood(mesh, 0.5, held=on_face), 1e-9)


def test_a_part_that_is_not_held_is_named(mesh):
    apart, far = pair(mesh, lambda points: np.zeros(len(points), bool))
    with pytest.raises(SolveError, match=r"part 1 of the mesh, near \(6.*is held nowhere"):
        solve(apart, push(apart, far))


@pytest.mark.parametrize("least_y", [2.49, -9.0], ids=["corner", "edge"])
def test_a_part_that_hangs_on_a_node_or_an_edge_is_refused(mesh, least_y):
    """The parts are joined, so only the solver can see it: its answer is as long as the swing."""
    swinging, far = pair(mesh, lambda p: (p[:, 2] < 1e-9) & (p[:, 1] > least_y))
    with pytest.raises(SolveError, match="hangs on a single node or edge"):
        solve(swinging, push(swinging, far))
    joined, far = pair(mesh, lambda points: np.ones(len(points), bool))
    solve(joined, push(joined, far))


def test_a_loose_node_is_named(mesh):
    loose = replace(mesh, points=np.concatenate([mesh.points, [[0.5, 1.0, 2.0]]]))
    words = rf"node {len(mesh.points)} of the mesh, at \(0.5, 1, 2\) mm, belongs to no"
    with pytest.raises(MeshError, match=words):
        solve(loose)


def test_an_inverted_element_is_named(mesh):
    inner = np.setdiff1d(np.arange(mesh.corners), mesh.faces)[0]
    points = replaced(mesh.points, mesh.points[inner] + [0.0, 0.0, 3.0], inner)
    points[mesh.tets[:, 4:]] = points[mesh.tets[:, TET_EDGES]].mean(axis=2)
    words = r"element \d+ of the mesh, near .* is flat or turned inside out"
    with pytest.raises(MeshError, match=words):
        solve(replace(mesh, points=points))
    bent = replaced(mesh.points, mesh.points[mesh.tets[5, 3]], mesh.tets[5, 4])
    with pytest.raises(MeshError, match="turned inside out"):
        solve(replace(mesh, points=bent))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_named(mesh, bad):
    force = np.tile(push(mesh), 2)
    wrong = replaced(force, bad, (9, 1, 1))
    with pytest.raises(InputError, match=r"the force at node 9, .* in load case 1 .*check the load"):
        solve(mesh, wrong)
    with pytest.raises(InputError, match="the given displacement at node 9"):
        TaylorHood(mesh, 0.5).solve(np.zeros_like(force), wrong)
    with pytest.raises(MeshError, match="node 9 of the mesh"):
        solve(replace(mesh, points=replaced(mesh.points, bad, (9, 1))))


def test_swelling_what_is_incompressible_and_shut_in_is_refused(mesh):
    shut = TaylorHood(mesh, 0.5, held=on_boundary(mesh))
    with pytest.raises(SolveError, match="changes its volume"):
        shut.solve(np.zeros_like(push(mesh)), mesh.points[:, :, None])


def test_layers_too_far_apart_in_stiffness_are_refused(mesh):
    """Double precision leaves nothing of the body under a layer 1e12 times stiffer."""
    middle = mesh.points[mesh.tets[:, :4], 2].mean(axis=1)
    layered = replace(mesh, region=(middle < 1.0).astype(np.int64))
    with pytest.raises(SolveError, match="differ too much in stiffness"):
        solve(layered, layers=[TaylorHood.Layer(modulus_ratio=1e12, poisson_ratio=0.3)])
    stiff = TaylorHood(layered, 0.5, layers=[TaylorHood.Layer(modulus_ratio=1e7, poisson_ratio=0.3)])
    assert_holder_balances(stiff, 1e-5)
