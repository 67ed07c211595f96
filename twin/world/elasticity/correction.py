"""The correction w of the elastic field, u = known part + w, by Taylor-Hood on a small mesh.

The known part is the half-space field of the load, on thin flat bodies with that of an endless
bonded layer. A load's field is steep near the load, where the closed form is exact; what a finite
body adds is smooth and needs few elements: 7 000 unknowns with the subtraction beat 50 000 without.
The closed form holds where the body lies behind every load's plane, which `require_on_surface`
tests. Under a cover of another modulus the half-space is made of the cover; at the interface w is
then as steep as the field.

`direct_fields` is plain Taylor-Hood without the half-space, for soft covers and as an
independent check: it resolves only loads wider than the mesh's faces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Floats, grid_points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.theory.bonded_layer import BondedLayer
from twin.world.elasticity.correction_loads import dilation, nodal_forces
from twin.world.elasticity.factor import GOAL
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.quadratic_mesh import Mesh


def correction(
    system: TaylorHood,
    body: Body,
    loads: Sequence[Rectangles],
    columns: Sequence[Floats] | None = None,
    goal: float = GOAL,
) -> Floats:
    """Return w at the nodes, (N, 3, sum of m) in mm for E = 1 MPa; all load cases are solved
    together.

    Parameters
    ----------
    loads
        Loads of (k) rectangles, each in the plane of its own half-space.
    columns
        For every load (k, 3, m) forces in m load cases, N; if not given one case each, the load's
        own ``force_n``.
    goal
        See `twin.world.elasticity.factor.Factor.solve`, which raises a `SolveError`.
    """
    forces, held, swollen = unbalanced(system, body, loads, columns)
    return system.solve(forces, held, goal, swollen)


def unbalanced(
    system: TaylorHood,
    body: Body,
    loads: Sequence[Rectangles],
    columns: Sequence[Floats] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Return what drives w: nodal forces and given displacements (N, 3, m), and dilations (P, m);
    see `correction`."""
    mesh, top = system.mesh, system.under_load
    shares = np.array([of.shear_ratio / top.shear_ratio for of in system.made_of])
    swelling = (top.softness - shares * [of.softness for of in system.made_of])[mesh.region]
    layer = BondedLayer.of(body, top.poisson_ratio) if len(system.made_of) == 1 else None
    forces, held, swollen = [], [], []
    for load, cases in zip(
        loads, columns or [load.force_n[:, :, None] for load in loads], strict=True
    ):
        forces.append(nodal_forces(mesh, body, load, cases, top.poisson_ratio, shares, layer))
        swollen.append(dilation(mesh, system.pressure, swelling, load, cases, top.poisson_ratio))
        held.append(np.zeros_like(forces[-1]))
        if layer is None:  # else the known part is zero there
            known = halfspace.compliance(
                mesh.points[system.held], load, top.modulus_ratio, top.poisson_ratio
            )
            moved = known @ cases.reshape(-1, cases.shape[2])
            held[-1][system.held] = -moved.reshape(-1, 3, cases.shape[2])
    return (
        np.concatenate(forces, axis=2),
        np.concatenate(held, axis=2),
        np.concatenate(swollen, axis=1),
    )


PIECE_MM, MOST_PIECES = 0.5, 60
"""Largest distance of the points at which a rectangle acts, and most of them along one side."""


def direct_fields(
    system: TaylorHood, body: Body, locator: Locator, loads: Sequence[Rectangles]
) -> Floats:
    """Return (N, 3, m) displacement fields in mm for E = 1 MPa under m loads, without a half-space.

    Each rectangle acts at a grid of points, moved onto the surface; totals are kept. Raises an
    `InputError` where a load misses the surface.
    """
    forces = [_consistent_forces(body, system.mesh, locator, load) for load in loads]
    return system.solve(np.stack(forces, axis=2))


def _consistent_forces(body: Body, mesh: Mesh, locator: Locator, load: Rectangles) -> Floats:
    """Return the (N, 3) nodal forces, N, that do the same work as ``load`` on the elements'
    fields."""
    points, forces = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for centre, frame, half, force in zip(
        load.centre_mm, load.frames, load.half_mm, load.force_n, strict=True
    ):
        sides = [_middles(float(h)) for h in half]
        offsets = grid_points(*sides)
        points.append(centre + offsets @ frame[:2])
        forces.append(np.tile(force / len(offsets), (len(offsets), 1)))
    places = np.concatenate(points)
    places = places - body.depth(places)[:, None] * body.piece_normals(places)[:, 0]
    spread = locator.locate(places).matrix(len(mesh.points))
    nodal = np.asarray(spread.T @ np.concatenate(forces))
    total, wanted = nodal.sum(axis=0), load.force_n.sum(axis=0)
    if not np.allclose(total, wanted, rtol=1e-9, atol=1e-9 * float(np.abs(load.force_n).sum())):
        raise InputError(
            f"the load puts {total} N on the mesh, wanted are {wanted} N: it misses the surface"
        )
    return nodal


def _middles(half: float) -> Floats:
    number = min(max(math.ceil(2.0 * half / PIECE_MM), 1), MOST_PIECES)
    return (np.arange(number) + 0.5) / number * 2.0 * half - half
