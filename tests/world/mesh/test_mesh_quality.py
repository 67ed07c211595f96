"""Quality figures against closed forms, and every gate closes on the fault it is for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.errors import MeshError
from twin.parts.body import Block
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.quality import (
    check,
    dihedral_angles,
    enclosed_volume,
    jacobian_ratios,
    open_edges,
    quality,
    scaled_jacobians,
    shape_gradients,
)
from twin.world.mesh.snap import EDGE_CORNERS, quadratic, snapped

CUBE = Block(width_mm=5, length_mm=5, thickness_mm=5)
REGULAR = np.array([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)], dtype=float)
CORNER = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
ONE = np.array([[0, 1, 2, 3]])
KUHN = np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)])


def cube_mesh() -> Mesh:
    """Return the cube cut into six tetrahedra."""
    points = np.array([(x - 2.5, y - 2.5, z) for z in (0, 5.0) for y in (0, 5.0) for x in (0, 5.0)])
    on_surface, triangles, piece = snapped(CUBE, points, KUHN)
    return Mesh(**vars(quadratic(CUBE, on_surface, KUHN, triangles, piece)))


def with_middles(corners: np.ndarray) -> np.ndarray:
    return np.concatenate([corners, corners[EDGE_CORNERS].mean(axis=1)])


def test_angles_and_scaled_jacobians_of_known_tetrahedra():
    np.testing.assert_allclose(dihedral_angles(REGULAR, ONE[:, [0, 2, 1, 3]]), np.degrees(np.arccos(1 / 3)))
    assert abs(scaled_jacobians(REGULAR, ONE)[0]) == pytest.approx(1)
    angles = np.sort(dihedral_angles(CORNER, ONE)[0])
    np.testing.assert_allclose(angles, [np.degrees(np.arctan(np.sqrt(2)))] * 3 + [90] * 3)
    assert scaled_jacobians(CORNER, ONE)[0] == pytest.approx(np.sqrt(2) / 2)  # longest corner: 1 x sqrt 2 x sqrt 2


def test_shape_gradients_reproduce_quadratics():
    nodes = with_middles(CORNER)
    values = nodes[:, 0] ** 2 + 3 * nodes[:, 1] * nodes[:, 2] - 2 * nodes[:, 2]
    r, s, t = 0.2, 0.3, 0.4
    np.testing.assert_allclose(values @ shape_gradients(r, s, t), [2 * r, 3 * t, 3 * s - 2], atol=1e-14)


def test_the_jacobian_ratio_of_one_moved_middle_has_its_closed_form():
    nodes = with_middles(CORNER)
    quadratic_tet = np.arange(10)[None]
    assert jacobian_ratios(nodes, quadratic_tet)[0] == pytest.approx(1)
    nodes[4, 0] += 0.05  # x = r + .05 * 4 (1 - r - s - t) r: determinant 1 + .2 (1 - 2 r - s - t), from .8 to 1.2
    assert jacobian_ratios(nodes, quadratic_tet)[0] == pytest.approx(0.8 / 1.2)


def test_a_straight_cube_passes_every_figure():
    measured = quality(cube_mesh(), CUBE)
    assert measured.failures() == []
    assert measured.volume_error == pytest.approx(0, abs=1e-14)
    assert measured.least_volume_mm3 == pytest.approx(125 / 6)
    assert measured.least_dihedral_deg == pytest.approx(45)


def test_curved_faces_enclose_their_exact_volume():
    mesh = cube_mesh()
    points = mesh.points.copy()
    top = mesh.faces[mesh.piece == 0]
    middle = np.intersect1d(top[0, 3:], top[1, 3:])
    points[middle, 2] -= 1.0  # bulges both top faces: twice the integral of a middle's shape function, area / 3
    assert enclosed_volume(points, mesh.faces) == pytest.approx(125 + 25 / 3)


def fault_negative(mesh: Mesh) -> Mesh:
    return replace(mesh, tets=mesh.tets[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]])


def fault_offset(mesh: Mesh) -> Mesh:
    points = mesh.points.copy()
    points[mesh.faces[0, 3], :] += 1e-6
    return replace(mesh, points=points)


def fault_hole(mesh: Mesh) -> Mesh:
    return replace(mesh, faces=mesh.faces[1:], piece=mesh.piece[1:])


def fault_turned_face(mesh: Mesh) -> Mesh:
    faces = mesh.faces.copy()
    faces[0] = faces[0, [0, 2, 1, 5, 4, 3]]
    return replace(mesh, faces=faces)


def fault_wrong_piece(mesh: Mesh) -> Mesh:
    piece = mesh.piece.copy()
    piece[0] = (piece[0] + 1) % 6
    return replace(mesh, piece=piece)


def fault_no_piece(mesh: Mesh) -> Mesh:
    return replace(mesh, piece=np.where(np.arange(len(mesh.piece)) == 0, 6, mesh.piece))


def fault_curled(mesh: Mesh) -> Mesh:
    points = mesh.points.copy()
    middle = mesh.tets[0, 4]
    points[middle] += 0.2 * (mesh.points[mesh.tets[0, 1]] - mesh.points[mesh.tets[0, 0]])
    return replace(mesh, points=points)


def fault_flat(mesh: Mesh) -> Mesh:
    points = mesh.points * [1, 1, 0.05]
    return replace(mesh, points=points)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (fault_negative, "smallest volume"),
        (fault_offset, "boundary node"),
        (fault_hole, "open boundary edges"),
        (fault_turned_face, "open boundary edges"),
        (fault_wrong_piece, "boundary node"),
        (fault_curled, "Jacobian ratio"),
        (fault_flat, "dihedral angle"),
    ],
)
def test_each_gate_closes_on_its_fault(fault, message):
    check(cube_mesh(), CUBE)
    with pytest.raises(MeshError, match=message):
        check(fault(cube_mesh()), CUBE)


def test_a_face_of_no_piece_is_counted():
    with pytest.raises(MeshError, match="1 boundary faces of no piece"):
        check(fault_no_piece(cube_mesh()), CUBE)


def test_open_edges_are_counted():
    faces = cube_mesh().faces
    assert open_edges(faces) == 0
    assert open_edges(faces[1:]) == 3
