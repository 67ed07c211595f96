"""Small regular meshes of blocks for tests: boxes cut into six tetrahedra each, flat layers marked as regions."""

import numpy as np

from twin.parts.body import Block
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import quadratic, snapped

CORNERS = [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]
"""Tetrahedra of a box whose corner (i, j, k) has number i + 2 j + 4 k."""


def slab(body: Block, x: np.ndarray, y: np.ndarray, z: np.ndarray, region_of_z=None) -> Mesh:
    """Return the quadratic mesh of a block on the grid x, y, z; ``region_of_z`` takes element middles (m,)."""
    shape = (len(x), len(y), len(z))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(shape)
    box = np.stack(
        [number[i : i + shape[0] - 1, j : j + shape[1] - 1, k : k + shape[2] - 1].ravel()
         for k in (0, 1) for j in (0, 1) for i in (0, 1)], axis=1,
    )  # fmt: skip
    tets = box[:, np.array(CORNERS)].reshape(-1, 4).astype(np.int64)
    on_surface, triangles, piece = snapped(body, points, tets)
    made = quadratic(body, on_surface, tets, triangles, piece)
    middle = made.points[made.tets[:, :4], 2].mean(axis=1)
    region = np.zeros(len(tets), np.int64) if region_of_z is None else region_of_z(middle).astype(np.int64)
    return Mesh(**vars(made), region=region)
