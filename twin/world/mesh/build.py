"""Making a body's mesh: surface, tetrahedra, snapping, gates, and the best of several tries.

Why several tries: the mesher gives another mesh every time, and its number of elements follows from the wanted edges
only roughly. So the wanted lengths are scaled together until the number of unknowns is right, and of the meshes that
pass the gates the one with the largest smallest dihedral angle is kept.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Ints, Points
from twin.errors import MeshError
from twin.parts.body import Body
from twin.progress import Progress
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.quality import Quality, quality
from twin.world.mesh.sizing import Sizing, background
from twin.world.mesh.snap import quadratic, snapped
from twin.world.mesh.surface import body_name, outer_surface
from twin.world.mesh.tetrahedralise import Request, tetrahedralise

GOOD_TRIES = 3
MOST_TRIES = 10

_FEWEST, _MOST = 0.88, 1.07
"""Allowed range of the number of unknowns over the wanted one; the solver's cost makes the upper end strict."""

_POWER = 2.3
"""The number of unknowns falls about with this power of the edge lengths; too high a power only converges slower."""

_ENVELOPE = 0.05
"""How far the raw surface may stray, in finest wanted edges: snapping mends it, and a tighter envelope forces small
elements on curved pieces (at half of it the finger gets half as many unknowns again, in three times the time)."""


def build_mesh(
    body: Body,
    sizing: Sizing,
    *,
    progress: Progress | None = None,
    good_tries: int = GOOD_TRIES,
    limit_s: float = 600.0,
) -> tuple[Mesh, Quality]:
    """Make a mesh.

    Parameters
    ----------
    body
        The body, convex.
    sizing
        Proportions of the wanted edges and the number of unknowns.
    progress
        Called with a line of text and the share that is done after every try.
    good_tries
        Meshes that must pass before the best of them is taken.
    limit_s
        Time limit of one try, s.

    Raises
    ------
    MeshError
        If no try passes the gates with about the wanted number of unknowns.
    """
    surface = outer_surface(body, min(sizing.fine_mm, sizing.rim_mm))
    good: list[tuple[Mesh, Quality]] = []
    spare: list[tuple[Mesh, Quality]] = []
    failures: list[str] = []
    tried: list[tuple[float, float]] = []
    scale = 1.0
    for attempt in range(1, MOST_TRIES + 1):
        mesh = _one(body, sizing.scaled(scale), surface, limit_s)
        measured = quality(mesh, body)
        ratio = measured.unknowns / sizing.unknowns
        faults = measured.failures()
        if not faults and _FEWEST / 2 <= ratio <= _MOST * 1.5:
            spare.append((mesh, measured))
        if not _FEWEST <= ratio <= _MOST:
            faults = [f"{measured.unknowns} unknowns (wanted: {sizing.unknowns})", *faults]
            tried.append((scale, ratio))
            scale = _next_scale(tried)
        if faults:
            failures.append("; ".join(faults))
        else:
            good.append((mesh, measured))
        if progress:
            verdict = "; ".join(faults) or f"good, smallest angle {measured.least_dihedral_deg:.1f} deg"
            progress(
                f"mesh of the {body_name(body)}, try {attempt}: {measured.unknowns} unknowns, {verdict}",
                len(good) / good_tries,
            )
        if len(good) >= good_tries:
            break
    if not good and spare:  # sound meshes, but of another size than wanted: the mesher differs from run to run
        return min(spare, key=lambda pair: abs(math.log(pair[1].unknowns / sizing.unknowns)))
    if not good:
        raise MeshError(
            f"none of {MOST_TRIES} meshes of the {body_name(body)} passed the gates, the last one: {failures[-1]}; "
            "try again (the mesher differs from run to run) or change the sizing"
        )
    return max(good, key=lambda pair: pair[1].least_dihedral_deg)


def _next_scale(tried: list[tuple[float, float]]) -> float:
    """Return the scale to try next, from scales and the unknowns they gave over the wanted ones.

    The usual power law until there is one scale with too many unknowns and one with too few, then the place between
    the two best of them: on bodies whose coarse part is a few elements thick the law is far steeper, and swings.
    """
    over, under = [t for t in tried if t[1] > 1], [t for t in tried if t[1] <= 1]
    if not over or not under:
        scale, ratio = tried[-1]
        return float(scale * ratio ** (1 / _POWER))
    (one, above), (other, below) = min(over, key=lambda t: t[1]), max(under, key=lambda t: t[1])
    share = math.log(above) / (math.log(above) - math.log(below))
    return math.exp((1 - share) * math.log(one) + share * math.log(other))


def _one(body: Body, sizing: Sizing, surface: tuple[Points, Ints], limit_s: float) -> Mesh:
    """Make one mesh, good or bad."""
    points, tets, edge_mm = background(body, sizing)
    diagonal = float(np.linalg.norm(np.ptp(np.array(body.bounds_mm), axis=0)))
    request = Request(
        vertices=surface[0],
        triangles=surface[1],
        background_points=points,
        background_tets=tets,
        background_edge_mm=edge_mm,
        coarse_mm=sizing.coarse_mm,
        envelope=_ENVELOPE * min(sizing.fine_mm, sizing.rim_mm) / diagonal,
    )
    raw_points, raw_tets = tetrahedralise(request, limit_s=limit_s)
    on_surface, triangles, piece = snapped(body, raw_points, raw_tets)
    made = quadratic(body, on_surface, raw_tets, triangles, piece)
    return Mesh(**vars(made))
