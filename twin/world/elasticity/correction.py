"""The smooth rest w of the elastic field, u = half-space + w, by Taylor-Hood on a small mesh.

Why: a load's field is steep near the load, where the closed form knows it exactly; what a finite body adds is smooth
and needs few elements. 7 000 unknowns with the subtraction beat 50 000 without it.

Under a cover of another modulus the half-space is made of the cover, so that w is smooth where the load is. At the
interface, a cover's thickness below, w must turn the cover's field into the body's: there it is as steep as the field.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Floats
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.world.elasticity.dilation import dilation
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.residual import nodal_forces
from twin.world.elasticity.solve import GOAL


def correction(
    system: TaylorHood,
    body: Body,
    loads: Sequence[Rectangles],
    columns: Sequence[Floats] | None = None,
    goal: float = GOAL,
) -> Floats:
    """Return w at the nodes, (N, 3, sum of m) in mm for E = 1 MPa; all load cases are solved together.

    Parameters
    ----------
    system, body
        The elastic system and the body it belongs to.
    loads
        Loads of (k) rectangles, each in the plane of its own half-space.
    columns
        For every load (k, 3, m) forces in m load cases, N; if not given one case each, the load's own ``force_n``.
    goal
        Relative residual at which the solver's refinement stops.

    Raises
    ------
    SolveError
        See `twin.world.elasticity.solve.Factor.solve`.
    """
    forces, held, swollen = unbalanced(system, body, loads, columns)
    return system.solve(forces, held, goal, swollen)


def unbalanced(
    system: TaylorHood, body: Body, loads: Sequence[Rectangles], columns: Sequence[Floats] | None = None
) -> tuple[Floats, Floats, Floats]:
    """Return what drives w: nodal forces and given displacements (N, 3, m), and dilations (P, m); see `correction`."""
    mesh, top = system.mesh, system.under_load
    shares = np.array([of.shear_ratio / top.shear_ratio for of in system.made_of])
    swelling = (top.softness - shares * [of.softness for of in system.made_of])[mesh.region]
    forces, held, swollen = [], [], []
    for load, cases in zip(loads, columns or [load.force_n[:, :, None] for load in loads], strict=True):
        forces.append(nodal_forces(mesh, body, load, cases, top.poisson_ratio, shares))
        swollen.append(dilation(mesh, system.pressure, swelling, load, cases, top.poisson_ratio))
        known = halfspace.compliance(mesh.points[system.held], load, top.modulus_ratio, top.poisson_ratio)
        moved = known @ cases.reshape(-1, cases.shape[2])
        held.append(np.zeros_like(forces[-1]))
        held[-1][system.held] = -moved.reshape(-1, 3, cases.shape[2])
    return np.concatenate(forces, axis=2), np.concatenate(held, axis=2), np.concatenate(swollen, axis=1)
