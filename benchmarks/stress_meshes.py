"""Meshes that are wrong or extreme on purpose: flat elements, loose nodes, parts that nothing holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import EDGE_CORNERS, signed_volumes

ROUNDS = 8
"""Corrections of the height until the angle is right; each leaves the square of the error."""


def straightened(mesh: Mesh, points: Points) -> Mesh:
    """Return the mesh at other corners (n, 3), every edge straight; only for bodies with flat faces."""
    points = points.copy()
    points[mesh.tets[:, 4:]] = points[mesh.tets[:, :4][:, EDGE_CORNERS]].mean(axis=2)
    return replace(mesh, points=points)


def with_slivers(mesh: Mesh, angle_deg: float, most: int = 40) -> tuple[Mesh, int]:
    """Return the mesh with up to ``most`` elements as flat as ``angle_deg``, and how many there are.

    One inner corner of each is moved towards the middle of the opposite face; elements around it stay sound, and no
    corner belongs to the surroundings of two.
    """
    points, tets = mesh.points.copy(), mesh.tets[:, :4]
    inner = np.ones(mesh.corners, bool)
    inner[mesh.faces[:, :3]] = False
    sound = np.median(signed_volumes(points, tets)) * 0.02
    taken, flattened = np.zeros(mesh.corners, bool), []
    for corner in np.flatnonzero(inner):
        star = np.flatnonzero((tets == corner).any(axis=1))
        if taken[tets[star]].any():
            continue
        for element in star:
            others = tets[element][tets[element] != corner]
            trial = points.copy()
            trial[corner] = points[others].mean(axis=0)
            rest = star[star != element]
            if signed_volumes(trial, tets[rest]).min() > sound:
                taken[tets[star]] = True
                flattened.append(_lowered(points, tets[element], int(corner), others, angle_deg))
                break
        if len(flattened) == most:
            break
    return straightened(mesh, points), len(flattened)


def _lowered(points: Points, tet: Ints, corner: int, others: Ints, angle_deg: float) -> float:
    """Move ``corner`` in ``points`` towards the others' face until the least angle is ``angle_deg``; return it."""
    middle, away, height = points[others].mean(axis=0), points[corner] - points[others].mean(axis=0), 1.0
    for _ in range(ROUNDS):
        points[corner] = middle + height * away
        reached = least_angle_deg(points[tet[None]])
        height = min(height * angle_deg / max(reached, 1e-300), 1.0)
    points[corner] = middle + height * away
    return least_angle_deg(points[tet[None]])


def least_angle_deg(corners: Floats) -> float:
    """Return how far the flattest angle between faces of tetrahedra (m, 4, 3) is from 0 or 180 degrees, deg.

    By sines, 3 V e / (2 A B) of the volume, the edge and the two faces that meet there: cosines can't tell angles below
    1e-6 degrees from 0.
    """
    least = 90.0
    for a, b, c, d in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)):
        edge, one, other = (corners[:, i] - corners[:, a] for i in (b, c, d))
        normals = np.cross(edge, one), np.cross(edge, other)
        volume6 = np.abs(np.einsum("mi,mi->m", normals[0], other))
        size = np.linalg.norm(normals[0], axis=1) * np.linalg.norm(normals[1], axis=1)
        sine = volume6 * np.linalg.norm(edge, axis=1) / size
        least = min(least, float(np.degrees(np.arcsin(np.minimum(sine, 1.0))).min()))
    return least


def with_inverted_element(mesh: Mesh) -> Mesh:
    """Return the mesh with one inner corner pushed through the face opposite."""
    inner = np.setdiff1d(np.arange(mesh.corners), mesh.faces)[0]
    element = mesh.tets[np.flatnonzero((mesh.tets[:, :4] == inner).any(axis=1))[0], :4]
    points = mesh.points.copy()
    points[inner] += 1.5 * (points[element[element != inner]].mean(axis=0) - points[inner])
    return straightened(mesh, points)


def with_loose_node(mesh: Mesh) -> Mesh:
    """Return the mesh with one node more that no element uses."""
    return replace(mesh, points=np.concatenate([mesh.points, mesh.points.mean(axis=0, keepdims=True)]))


def with_loose_part(mesh: Mesh, away_mm: float) -> Mesh:
    """Return the mesh with a copy beside it along x, ``away_mm`` off, that is held nowhere."""
    nodes, corners = len(mesh.points), mesh.corners
    middles = np.arange(nodes - corners)
    first = np.concatenate([np.arange(corners), 2 * corners + middles])
    second = np.concatenate([corners + np.arange(corners), corners + nodes + middles])
    points = np.empty((2 * nodes, 3))
    points[first], points[second] = mesh.points, mesh.points + np.array([away_mm, 0.0, 0.0])
    held = mesh.piece.max()
    return Mesh(
        points=points,
        tets=np.concatenate([first[mesh.tets], second[mesh.tets]]),
        corners=2 * corners,
        faces=np.concatenate([first[mesh.faces], second[mesh.faces]]),
        piece=np.concatenate([mesh.piece, np.where(mesh.piece == held, held - 1, mesh.piece)]),
    )
