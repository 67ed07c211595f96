"""The error of a displacement: expected before a solve (`EXPECTED`), and estimated after it.

The estimate has up to four parts (`error_shares`): a share of the difference to another level's
result; a share of the displacement itself, which that difference does not show; on curved bodies,
whose largest errors are those of few elements near the load, and on bodies given by triangles, a
share of the difference to a smoother evaluation of the same field (`twin.world.mesh.interpolate`);
and, where a body is loaded near another free face or narrowly on a curved surface, what all meshes
miss there alike (`missed_by_mesh`).

The constants were fitted to independent converged solutions (``benchmarks/elasticity.py``), to the
finest level under 60 bumps on the finger and 54 disks on the block, and near edges to mirrored
loads.

Validity: the two reference bodies. Other bodies are meshed by the same rules: flat ones count as
blocks, curved ones as fingers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.world.mesh.sizing import Level

DIRECT = 0.3
"""Error of the direct method under loads narrower than its elements."""


@dataclass(frozen=True)
class _Expected:
    """Displacement error over the largest displacement: far inside, a fifth of the body's height
    from an edge, at most; and the shares of `error_shares`.

    ``unseen`` holds what levels share (how a load is cut into rectangles, where tractions are
    read), and the error of the solutions that the estimate was checked against.
    """

    inside: float
    at_fifth: float
    power: float
    most: float
    trust: float
    against: Level
    rough: float = 0.0
    unseen: float = 4e-5

    def compared(self, body: Body) -> Level:
        """Return the level by whose result the error of a body's is estimated: the coarsest tells
        nothing of an edge that is folded inwards (`DENTED`)."""
        dented = body.is_flat and not body.is_convex
        return "standard" if dented and self.against == "sketch" else self.against


EXPECTED: dict[tuple[bool, Level], _Expected] = {
    # inside, at_fifth, power, most, trust, against, rough, unseen
    (True, "fine"): _Expected(1e-4, 0.015, 3.5, 0.08, 0.35, "standard"),
    (True, "standard"): _Expected(4e-4, 0.026, 3.5, 0.1, 1.4, "coarse"),
    (True, "coarse"): _Expected(6e-4, 0.059, 3.0, 0.14, 0.7, "sketch"),
    (True, "nominal"): _Expected(8e-4, 0.059, 3.0, 0.14, 1.6, "standard"),
    (True, "sketch"): _Expected(2e-3, 0.1, 3.0, 0.2, 1.6, "coarse"),
    (False, "fine"): _Expected(1.5e-3, 0.012, 1.5, 0.04, 0.25, "standard", 0.9, 6e-4),
    (False, "standard"): _Expected(4e-3, 0.02, 1.5, 0.06, 0.4, "coarse", 1.3, 6e-4),
    (False, "coarse"): _Expected(7e-3, 0.03, 1.5, 0.09, 0.3, "sketch", 1.1, 6e-4),
    (False, "nominal"): _Expected(6e-3, 0.03, 1.5, 0.09, 0.8, "standard", 1.2, 2.5e-4),
    (False, "sketch"): _Expected(9e-3, 0.06, 1.5, 0.2, 1.5, "standard", 0.1, 4e-4),
}
"""By whether the sensing surface is a plane, and by level."""

DIRECT_TRUST = 1.5
"""Share of the difference that is the error, at least, of the direct method, and next to an edge of
forces that cancel, as a twist's."""

FINEST = 8e-6
"""Error that no difference shows on the block's finest mesh, but for the cutting: of stored
coefficients, and of the truth itself."""

CUT = 1.45e-6
"""Error of displacement at points 0.5 mm deep, by cutting a flat load: times Young's modulus, over
the sum of the sizes of the rectangles' forces; 1/mm."""

TRUTH_TABLE, BETWEEN = 0.25, 3.5e-4
"""Share of the difference of the standard block's two finer tables that is taken for the truth's
own error; and the error of interpolation between Poisson's ratios, over the correction, where
it is largest."""

NOMINAL_TABLE = 1.4
"""Share of a nominal table's difference to the check table that is taken for its error."""

RIM = 0.1
"""Distance from a held face, over the body's height, within which the error of a load has no bound:
no mesh follows the subtracted field on the clamp there."""

MISSED, TOWARDS = 0.27, 2.5
"""Displacement by what elements far longer than a load's distance d to a free face miss of the
tractions there, times Young's modulus and d, over the force; and how many times as much it is of a
force towards the face."""

RESOLVED, HALF = {True: 0.5, False: 0.3}, 2.0
"""Length of elements over d up to which other shares tell the error, by whether the sensing surface
is a plane, and about where half of `MISSED` is missed."""

FALL = 2.0
"""d over the distance from the tractions at which what is missed is half as large."""

PEAK, NARROW = (0.3, 0.03), 0.22
"""Displacement by what elements miss of the correction's peak under a load on a curved surface:
times E over force, mean curvature and the logarithm of how much nearer a point is than `NARROW` of
an element's length; by forces along the surface, and across it."""

REFINED = 1.6
"""``trust`` on flat bodies where a level and the one against it are refined in the same places, one
1.5 times less."""

DENTED = 1.7
"""Least ``trust`` on flat bodies with dents: at an edge that is folded inwards stress is singular,
and meshes leave more than half of the error to those of twice the unknowns. Under 15 bumps on three
brackets ``coarse`` is 0.02 to 1.6 % off ``fine``, and differs from ``standard`` by 0.59 to 2.2
times of that, from ``sketch``, by the mesh, by 0.5 to 12 times."""

TRIANGLES = 1.4
"""Shares of curved surfaces given by triangles, which aren't refined under narrow loads, over those
of others. Without that the estimate was 0.96 to 1.02 times the difference to the finest level on a
pad with fillets under bumps of 0.3 to 0.6 mm radius, and 0.74 to 3.0 on a cap under those of 2.4 to
3.7 mm, 0.1 mm deep."""

ROUGH = 0.8
"""Share of the difference to a smoother evaluation on flat bodies given by triangles. Of their
meshes the finer of two may be no better, and both differ by little: under bumps on a wedge
``standard`` was 0.2 to 0.45 % off, by 0.7 to 0.85 of which it differs from ``coarse``, times
``trust``; and by 0.6 to 0.95 from that evaluation."""

_REACH = 1.0 / np.sqrt(3.0)
"""How far from its centre a rectangle is taken to be, over how far it reaches: as far as its 2 x 2
Gauss points."""


def expected_error(body: Body, level: Level, load: Rectangles) -> float:
    """Return the largest displacement error over the largest displacement to be expected 0.3 mm
    deep and deeper.

    The mean over the load's force of a law in the least distance d to another face: constant far
    from it, then ``at_fifth`` (height / (5 d))^power up to ``most``; within a factor of three,
    mostly above. The share of the force that has no bound (`unbounded`) is added.
    """
    law = EXPECTED[body.is_flat, level]
    if len(load) == 0:
        return law.inside
    away = _away(body, load)
    near = (
        law.at_fifth
        * (body.base_z_mm / (5.0 * np.maximum(away[:, 1:].min(axis=1), 1e-9))) ** law.power
    )
    return _mean(load, np.minimum(np.maximum(near, law.inside), law.most) + _on_rim(body, away))


def unbounded(body: Body, load: Rectangles) -> float:
    """Return the share of a load's force so near to a held face (`RIM`) that its error, relative to
    the largest displacement, has no bound."""
    return _mean(load, _on_rim(body, _away(body, load)))


def missed_by_mesh(
    body: Body, points: Points, load: Rectangles, edges: Callable[[Points], Floats]
) -> Points:
    """Return (n, 3) mm, for E = 1 MPa: displacement that all meshes of a body miss alike, so that
    their difference does not show it.

    Parameters
    ----------
    body, points, load
        What was loaded, and (n, 3) points, mm.
    edges
        Lengths (k,) of the mesh's elements at places (k, 3), mm.
    """
    cut = load.cut_at_edges(body, edges)
    near = _missed_at_edges(body, points, cut, edges(cut.centre_mm))
    return near + _missed_on_curves(body, points, load, edges(load.centre_mm))


def _missed_at_edges(body: Body, points: Points, load: Rectangles, edge_mm: Floats) -> Points:
    """Return (n, 3) mm, for E = 1 MPa: displacement that a body's mesh misses where a load is near
    another free face.

    A force at the distance d from a free face leaves tractions there as wide as d, which elements
    of the length h follow only if h is less. Longer ones miss a displacement of about F / (E d);
    they keep the tractions' sum, so that it falls with the square of the distance at least. Two
    meshes miss alike, so that their difference does not show it.

    The constants were fitted to displacements 0.1 to 1 mm deep under disks of 0.5 to 2 mm radius, 1
    to 5 mm from an edge of four blocks at nu = 1/2 (h / d of 0.6 to 4), against meshes refined
    around the load. On the finger the median estimate is then 2.0 times the error, the least of 63
    0.73, the largest 4.7. Of a wide load that ends at a face the pieces next to it count, down to
    about an element's length.
    """
    missed = np.zeros((len(points), 3))
    free = body.edge_pieces
    if not free:
        return missed
    resolved = RESOLVED[body.is_flat]
    centre = load.within(body)
    to_faces = body.piece_distances(centre)[:, free]
    away = np.maximum(to_faces, load.half_mm.max(axis=1)[:, None])
    depth = body.piece_distances(points)[:, free]
    normal = body.piece_normals(centre)[:, free]
    for k, face in np.argwhere(edge_mm[:, None] > resolved * away):
        d, force, n = away[k, face], load.force_n[k], normal[k, face]
        long = (edge_mm[k] / d) ** 2
        share = MISSED * (long - resolved**2) / (long + HALF**2)
        apart = np.sum((points - load.centre_mm[k]) ** 2, axis=1) + 2.0 * depth[:, face] * d - d * d
        pushed = force + (TOWARDS - 1.0) * (force @ n) * n
        missed += share * pushed * (d / (d * d + FALL**2 * np.maximum(apart, 0.0)))[:, None]
    return missed


def _missed_on_curves(body: Body, points: Points, load: Rectangles, edge_mm: Floats) -> Points:
    """Return (n, 3) mm, for E = 1 MPa: displacement that a body's mesh misses next to a load on a
    curved surface.

    A force F leaves tractions of about F / (R r) at the distance r, R the radius of curvature, so
    that the correction peaks like F log(r) / (E R). Elements that are longer miss the peak, and two
    meshes miss it alike.

    The constants were fitted to displacements 0.1 to 1 mm deep under bumps of 0.1 to 0.8 mm radius
    on a dome of 15 mm radius at nu = 1/2, against a mesh refined around the load. With them
    estimates are 1.2 to 4.6 times the error there, at nu = 0.3, on a dome of 6 mm radius and on the
    finger; more where it is below 3e-4.
    """
    missed = np.zeros((len(points), 3))
    if body.is_flat:
        return missed
    step = edge_mm[:, None] / 2.0
    curved = np.zeros(len(load))
    for way in (0, 1):
        aside = step * load.frames[:, way]
        ends = (load.centre_mm + aside, load.centre_mm - aside)
        one, other = (body.piece_normals(end)[:, 0] for end in ends)
        curved += np.linalg.norm(one - other, axis=1) / (4.0 * step[:, 0])
    normal = load.frames[:, 2]
    across = np.sum(load.force_n * normal, axis=1)[:, None] * normal
    peak = curved[:, None] * (PEAK[0] * (load.force_n - across) + PEAK[1] * across)
    for k, width in enumerate(NARROW * edge_mm):
        apart = np.sum((points - load.centre_mm[k]) ** 2, axis=1) + load.half_mm[k].prod()
        missed += np.maximum(np.log(width**2 / apart) / 2.0, 0.0)[:, None] * peak[k]
    return missed


def _on_rim(body: Body, away: Floats) -> Bools:
    """Return (k,) whether rectangles so far ``away`` from the body's faces have no bound."""
    return np.asarray(away[:, list(body.held_pieces)].min(axis=1) < RIM * body.base_z_mm)


def _away(body: Body, load: Rectangles) -> Floats:
    """Return (k, pieces) distances of the rectangles' nearer Gauss points from the body's faces,
    mm."""
    return np.asarray(body.piece_distances(load.within(body)) - _REACH * load.reach_towards(body))


def _mean(load: Rectangles, each: Floats | Bools) -> float:
    """Return the mean of (k,) values over the rectangles' forces."""
    strength = np.sqrt(np.einsum("ki,ki->k", load.force_n, load.force_n))
    total = strength.sum()
    return float(strength @ each / total if total > 0.0 else each.mean())


def error_shares(
    body: Body,
    level: Level,
    load: Rectangles,
    size: float,
    *,
    direct: bool = False,
    refined: bool = False,
    table: Literal["truth", "nominal"] | None = None,
    between: float = 0.0,
    at_edge: bool = False,
) -> tuple[float, float, float]:
    """Return trust, rough and unseen.

    The error of a level's displacement over the largest one is trust times its difference to the
    other level's (or the check table's), plus rough times its difference to a smoother reading of
    the same field (both relative), plus unseen.

    Parameters
    ----------
    body, level, load
        What was loaded, and the level (of a table: that of its mesh).
    size
        Largest displacement times Young's modulus, N/mm.
    direct
        Whether the displacements are of the direct method.
    refined
        Whether both meshes are refined at the load.
    table
        Role of the table that the displacements are from, if any.
    between
        Of a table: its correction over the largest displacement, times `Tables.between`.
    at_edge
        Whether elements miss what the load leaves next to it (`missed_by_mesh`). Of forces that
        cancel that cancels too, though the error does not, and a finer mesh misses as much.
    """
    law = EXPECTED[body.is_flat, level]
    trust, unseen = law.trust, law.unseen
    if refined and body.is_flat:
        trust = REFINED
    elif body.is_flat and level == "fine" and table != "nominal":  # there all shares count
        cut = CUT * float(np.linalg.norm(load.force_n, axis=1).sum()) / size
        unseen = FINEST + (cut if len(load) > 1 else 0.0)
        if table:
            trust, unseen = TRUTH_TABLE, unseen + BETWEEN * between
    elif table == "nominal":
        trust = NOMINAL_TABLE
    elif direct:
        trust = max(trust, DIRECT_TRUST)
    if body.is_flat and not body.is_convex:
        trust = max(trust, DENTED)
    if at_edge and body.is_flat:
        forces = float(np.linalg.norm(load.force_n, axis=1).sum())
        cancelled = 1.0 - float(np.linalg.norm(load.total_force_n)) / forces
        trust = max(trust, DIRECT_TRUST * cancelled)
    rough = law.rough
    if body.own_surface is not None:
        rough = ROUGH if body.is_flat else TRIANGLES * rough
        trust *= 1.0 if body.is_flat else TRIANGLES
    return trust, rough, unseen + unbounded(body, load)
