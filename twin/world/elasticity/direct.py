"""Loads on the elements themselves: what plain Taylor-Hood, without the half-space, is driven by.

Kept as an independent check. The mesh is made for the smooth rest, so it resolves only loads wider than its faces:
on the finger bumps 4 mm wide agree to 1.5 %, on the block a disk 28 mm wide to 4 to 8 %.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.spread import single
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.mesh import Mesh

PIECE_MM, MOST_PIECES = 0.5, 60
"""Largest distance of the points at which a rectangle acts, and most of them along one side."""


def consistent_forces(body: Body, mesh: Mesh, locator: Locator, load: Rectangles) -> Floats:
    """Return the (N, 3) nodal forces in N that do the same work as ``load`` on every field of the elements.

    Each rectangle acts at a grid of points, moved onto the surface; totals are kept.

    Raises
    ------
    InputError
        The load misses the surface.
    """
    points, forces = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for centre, frame, half, force in zip(load.centre_mm, load.frames, load.half_mm, load.force_n, strict=True):
        sides = [_middles(float(h)) for h in half]
        offsets = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        points.append(centre + offsets @ frame[:2])
        forces.append(np.tile(force / len(offsets), (len(offsets), 1)))
    places = np.concatenate(points)
    places = places - body.depth(places)[:, None] * body.piece_normals(places)[:, 0]
    spread = locator.locate(places).matrix(len(mesh.points))
    nodal = np.asarray(spread.T @ np.concatenate(forces))
    total, wanted = nodal.sum(axis=0), load.force_n.sum(axis=0)
    if not np.allclose(total, wanted, rtol=1e-9, atol=1e-9 * float(np.abs(load.force_n).sum())):
        raise InputError(f"the load puts {total} N on the mesh, wanted are {wanted} N: it misses the surface")
    return nodal


def direct_columns(system: TaylorHood, body: Body, locator: Locator, rectangles: Rectangles) -> Floats:
    """Return (N, 3, 3 k) fields in mm for E = 1 MPa under unit global forces on each rectangle. Raises likewise."""
    forces = []
    for i in range(len(rectangles)):
        for force in np.eye(3):
            unit = replace(single(rectangles, i), force_n=force[None])
            forces.append(consistent_forces(body, system.mesh, locator, unit))
    return system.solve(np.stack(forces, axis=2))


def _middles(half: float) -> Floats:
    number = min(max(math.ceil(2.0 * half / PIECE_MM), 1), MOST_PIECES)
    return (np.arange(number) + 0.5) / number * 2.0 * half - half
