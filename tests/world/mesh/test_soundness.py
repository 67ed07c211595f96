"""Systems that can't be solved are refused before they are tried, and the error names the likely cause."""

from dataclasses import replace

import numpy as np
import pytest
from slabs import slab

from twin.errors import InputError, MeshError, SolveError
from twin.parts.body import Block
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import EDGE_CORNERS

BLOCK = Block(width_mm=6, length_mm=5, thickness_mm=4)


@pytest.fixture(scope="module")
def mesh():
    return slab(BLOCK, np.linspace(-3, 3, 4), np.linspace(-2.5, 2.5, 4), np.array([0.0, 1.0, 2.5, 4.0]))


def push(mesh, node=0):
    force = np.zeros((len(mesh.points), 3, 1))
    force[node] = np.array([[0.3], [-0.2], [1.0]])
    return force


def with_middles(mesh, points):
    """Return the mesh at other corners, its edges straight."""
    points = points.copy()
    points[mesh.tets[:, 4:]] = points[mesh.tets[:, :4][:, EDGE_CORNERS]].mean(axis=2)
    return replace(mesh, points=points)


def pair(mesh, shared):
    """Return two copies side by side along x, the second held nowhere; coinciding nodes on ``shared`` are one."""
    whole = np.concatenate([mesh.points, mesh.points + np.array([6.0, 0.0, 0.0])])
    corner = np.concatenate([np.arange(len(mesh.points)) < mesh.corners] * 2)
    key = np.round(whole, 6)
    glued = shared(whole) & (np.abs(whole[:, 0] - 3.0) < 1e-9)
    key[~glued] += np.where(np.arange(len(whole)) < len(mesh.points), 0.0, 1e3)[~glued, None]
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(~corner[first], kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    number = rank[group.ravel()]
    near, far = number[: len(mesh.points)], number[len(mesh.points) :]
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
            TaylorHood(mesh, 0.5, held=nowhere).solve(force)
    on_edge = (mesh.points[:, 2] > 3.99) & (mesh.points[:, 0] > 2.99)
    with pytest.raises(SolveError, match="on one line only, and can turn"):
        TaylorHood(mesh, 0.5, held=on_edge).solve(push(mesh))
    on_face = nowhere.copy()
    on_face[mesh.faces[mesh.piece == 5][0]] = True
    system = TaylorHood(mesh, 0.5, held=on_face)
    np.testing.assert_allclose(system.reaction(push(mesh)), [[-0.3], [0.2], [-1.0]], atol=1e-9)


def test_a_part_that_is_not_held_is_named(mesh):
    apart, far = pair(mesh, lambda points: np.zeros(len(points), bool))
    with pytest.raises(SolveError, match=r"part 1 of the mesh, near \(6.*is held nowhere"):
        TaylorHood(apart, 0.5).solve(push(apart, far))


@pytest.mark.parametrize("hinge", ["corner", "edge"])
def test_a_part_that_hangs_on_a_node_or_an_edge_is_refused(mesh, hinge):
    """The parts are joined, so only the solver can tell: its answer is as long as the part can swing."""
    on_edge = {"corner": lambda p: (p[:, 2] < 1e-9) & (p[:, 1] > 2.49), "edge": lambda p: p[:, 2] < 1e-9}[hinge]
    swinging, far = pair(mesh, on_edge)
    with pytest.raises(SolveError, match="hangs on a single node or edge"):
        TaylorHood(swinging, 0.5).solve(push(swinging, far))
    joined, far = pair(mesh, lambda points: np.ones(len(points), bool))
    TaylorHood(joined, 0.5).solve(push(joined, far))


def test_a_loose_node_is_named(mesh):
    loose = replace(mesh, points=np.concatenate([mesh.points, [[0.5, 1.0, 2.0]]]))
    with pytest.raises(MeshError, match=rf"node {len(mesh.points)} of the mesh, at \(0.5, 1, 2\) mm, belongs to no"):
        TaylorHood(loose, 0.5).solve(push(loose))


def test_an_inverted_element_is_named(mesh):
    inner = np.setdiff1d(np.arange(mesh.corners), mesh.faces)[0]
    points = mesh.points.copy()
    points[inner] += [0.0, 0.0, 3.0]
    with pytest.raises(MeshError, match=r"element \d+ of the mesh, near .* is flat or turned inside out"):
        TaylorHood(with_middles(mesh, points), 0.5).solve(push(mesh))
    bent = mesh.points.copy()
    bent[mesh.tets[5, 4]] = mesh.points[mesh.tets[5, 3]]
    with pytest.raises(MeshError, match="turned inside out"):
        TaylorHood(replace(mesh, points=bent), 0.5).solve(push(mesh))


def test_numbers_that_are_not_finite_are_named(mesh):
    for bad in (np.nan, np.inf):
        force, moved, points = np.tile(push(mesh), 2), np.tile(push(mesh), 2), mesh.points.copy()
        force[9, 1, 1] = moved[9, 1, 1] = points[9, 1] = bad
        with pytest.raises(InputError, match=r"the force at node 9, .* in load case 1 .*check the load"):
            TaylorHood(mesh, 0.5).solve(force)
        with pytest.raises(InputError, match="the given displacement at node 9"):
            TaylorHood(mesh, 0.5).solve(np.zeros_like(force), moved)
        with pytest.raises(MeshError, match="node 9 of the mesh"):
            TaylorHood(replace(mesh, points=points), 0.5).solve(push(mesh))


def test_swelling_what_is_incompressible_and_shut_in_is_refused(mesh):
    boundary = np.zeros(len(mesh.points), bool)
    boundary[mesh.faces] = True
    with pytest.raises(SolveError, match="changes its volume"):
        TaylorHood(mesh, 0.5, held=boundary).solve(np.zeros_like(push(mesh)), mesh.points[:, :, None])


def test_layers_too_far_apart_in_stiffness_are_refused(mesh):
    """A layer 1e12 times stiffer leaves nothing of the body in double precision; what is solved is in balance."""
    layered = replace(mesh, region=(mesh.points[mesh.tets[:, :4], 2].mean(axis=1) < 1.0).astype(np.int64))
    stiff = TaylorHood(layered, 0.5, layers=[Layer(modulus_ratio=1e12, poisson_ratio=0.3)])
    with pytest.raises(SolveError, match="differ too much in stiffness"):
        stiff.solve(push(mesh))
    stiff = TaylorHood(layered, 0.5, layers=[Layer(modulus_ratio=1e7, poisson_ratio=0.3)])
    np.testing.assert_allclose(stiff.reaction(push(mesh)), [[-0.3], [0.2], [-1.0]], atol=1e-5)
