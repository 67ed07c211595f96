"""Small regular meshes of blocks: boxes cut into six tetrahedra, flat layers marked as regions."""

from dataclasses import replace

import numpy as np

from twin.world.mesh.quadratic_mesh import quadrature, shapes
from twin.world.mesh.snap import snapped_mesh

KUHN = [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]
"""Tetrahedra of a box whose corner (i, j, k) has number i + 2 j + 4 k."""


def boxes(x, y, z):
    """Return points and linear tetrahedra that fill the grid x, y, z."""
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(len(x), len(y), len(z))
    halves = (slice(None, -1), slice(1, None))
    corners = [number[i, j, k].ravel() for k in halves for j in halves for i in halves]
    return points, np.stack(corners, axis=1)[:, np.array(KUHN)].reshape(-1, 4)


def block_boxes(body, cells, jitter_mm=0.0):
    """Return boxes in a block, the nodes moved at random by up to ``jitter_mm``."""
    low, high = body.bounds_mm
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells, strict=True)]
    points, tets = boxes(*axes)
    moves = np.random.default_rng(1).uniform(-jitter_mm, jitter_mm, points.shape)
    return points + moves, tets


def jacobians(mesh):
    """Return (m, q) determinants of the elements' maps at the points of `quadrature(3)`, and its weights."""
    places, weights = quadrature(3)
    slopes = shapes(places)[1]
    return np.linalg.det(np.einsum("tai,qaj->tqij", mesh.points[mesh.tets], slopes)), weights


def slab(body, x, y, z, region_of_z=None):
    """Return the quadratic mesh of a block; ``region_of_z`` takes element middles (m,)."""
    made = snapped_mesh(body, *boxes(x, y, z))
    if region_of_z is None:
        return replace(made, region=np.zeros(len(made.tets), np.int64))
    middle = made.points[made.tets[:, :4], 2].mean(axis=1)
    return replace(made, region=region_of_z(middle).astype(np.int64))
