"""How wrong a displacement may be: what is expected before a solve, and what is estimated after it.

What is estimated is a share of the difference to another level's answer; on curved bodies also one of the difference to
a smoother reading of the same field (`twin.world.mesh.recovery`), for there the largest errors are of few elements
near the load, which another mesh's elements elsewhere say little of.

Both were fitted to independent converged solutions (repeated by ``benchmarks/elasticity.py``), and to the finest level
under 60 bumps 1.2 to 6 mm wide at as many places of the finger, in six directions each, and 54 disks 1.5 to 12 mm wide
at 6 of the block; near edges to mirrored loads 1 and 4 mm wide and to the difference of two meshes.
``benchmarks/estimates.py`` tries them on loads at random.

Validity: the two reference bodies; other bodies are meshed by the same rules: flat ones count as blocks, curved ones as
fingers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.world.mesh.sizing import Level

DIRECT = 0.3
"""Error of the direct method under loads narrower than its elements."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Displacement error over largest displacement: far inside, a fifth of the body's height from an edge, at most.

    An estimate is ``trust`` times the difference to the level ``against``, plus ``rough`` times that to a smoother
    reading, plus ``unseen``: what levels share and so can't tell (how a load is cut into rectangles, where tractions
    are read), and the error of the solutions that the estimate was checked against.
    """

    inside: float
    at_fifth: float
    power: float
    most: float
    trust: float
    against: Level
    rough: float = 0.0
    unseen: float = 4e-5


EXPECTED: dict[tuple[bool, Level], Expected] = {
    (True, "fine"): Expected(inside=1e-4, at_fifth=0.015, power=3.5, most=0.08, trust=0.35, against="standard"),
    (True, "standard"): Expected(inside=4e-4, at_fifth=0.026, power=3.5, most=0.1, trust=1.4, against="coarse"),
    (True, "coarse"): Expected(inside=6e-4, at_fifth=0.059, power=3.0, most=0.14, trust=0.7, against="sketch"),
    (True, "nominal"): Expected(inside=8e-4, at_fifth=0.059, power=3.0, most=0.14, trust=1.6, against="standard"),
    (True, "sketch"): Expected(inside=2e-3, at_fifth=0.1, power=3.0, most=0.2, trust=1.6, against="coarse"),
    (False, "fine"): Expected(
        inside=1.5e-3, at_fifth=0.012, power=1.5, most=0.04, trust=0.25, against="standard", rough=0.9, unseen=6e-4
    ),
    (False, "standard"): Expected(
        inside=4e-3, at_fifth=0.02, power=1.5, most=0.06, trust=0.4, against="coarse", rough=1.3, unseen=6e-4
    ),
    (False, "coarse"): Expected(
        inside=7e-3, at_fifth=0.03, power=1.5, most=0.09, trust=0.3, against="sketch", rough=1.1, unseen=6e-4
    ),
    (False, "nominal"): Expected(
        inside=6e-3, at_fifth=0.03, power=1.5, most=0.09, trust=0.8, against="standard", rough=1.2, unseen=2.5e-4
    ),
    (False, "sketch"): Expected(
        inside=9e-3, at_fifth=0.06, power=1.5, most=0.2, trust=1.5, against="standard", rough=0.1, unseen=4e-4
    ),
}
"""By whether the sensing surface is a plane, and by level."""

DIRECT_TRUST = 1.5
"""Share of the difference that is the error of the direct method, at least."""

FINEST = 8e-6
"""Error that no difference tells on the block's finest mesh, but for the cutting: of stored coefficients, and of the
truth itself."""

CUT = 1.45e-6
"""Error of displacement at points 0.5 mm deep, by cutting a flat load: times Young's modulus, over the sum of the sizes
of the rectangles' forces; 1/mm. Disks and twists 1.5 to 12 mm wide, against sums of point forces."""

TRUTH_TABLE, BETWEEN = 0.25, 3.5e-4
"""Share of the difference of the standard block's two finer tables that is taken for the truth's own error; and the
error of interpolation between Poisson's ratios, over the rest, where it is largest."""

NOMINAL_TABLE = 1.4
"""Share of a nominal table's difference to the check table that is taken for its error."""

RIM = 0.1
"""Distance from a held face, over the body's height, within which the error of a load has no bound: the subtracted
field is steep on the clamp there, which no mesh follows, and what two meshes make of it is alike."""

_REACH = 1.0 / np.sqrt(3.0)
"""How far from its centre a rectangle is taken to be, over its half diagonal: as far as its 2 x 2 Gauss points."""


def expected_error(body: Body, level: Level, load: Rectangles) -> float:
    """Return the largest displacement error over the largest displacement to be expected 0.3 mm deep and deeper.

    The mean over the load's force of a law in the least distance d to another face: constant far from it, then
    ``at_fifth`` (height / (5 d))^power up to ``most`` (see `Expected`); within a factor of three, mostly above. The
    share of the force that has no bound (`unbounded`) is added.
    """
    law = EXPECTED[body.is_flat, level]
    if len(load) == 0:
        return law.inside
    away = _away(body, load)
    near = law.at_fifth * (body.base_z_mm / (5.0 * np.maximum(away[:, 1:].min(axis=1), 1e-9))) ** law.power
    return _mean(load, np.minimum(np.maximum(near, law.inside), law.most) + _on_rim(body, away))


def unbounded(body: Body, load: Rectangles) -> float:
    """Return the share of a load's force that is so near to a held face (`RIM`) that its error has no bound.

    Added to an estimate, which is relative to the largest displacement, it says that nothing may be right.
    """
    return _mean(load, _on_rim(body, _away(body, load)))


def _on_rim(body: Body, away: Floats) -> Bools:
    """Return (k,) whether rectangles so far ``away`` from the body's faces have no bound."""
    return np.asarray(away[:, list(body.held_pieces)].min(axis=1) < RIM * body.base_z_mm)


def _away(body: Body, load: Rectangles) -> Floats:
    """Return (k, pieces) distances of the rectangles' nearer Gauss points from the body's faces, mm."""
    return np.asarray(body.piece_distances(load.centre_mm) - _REACH * np.hypot(*load.half_mm.T)[:, None])


def _mean(load: Rectangles, each: Floats | Bools) -> float:
    """Return the mean of (k,) values over the rectangles' forces."""
    strength = np.sqrt(np.einsum("ki,ki->k", load.force_n, load.force_n))
    total = strength.sum()
    return float(strength @ each / total if total > 0.0 else each.mean())


def estimated_error(
    body: Body,
    level: Level,
    difference: float,
    load: Rectangles,
    *,
    rough: float = 0.0,
    nominal: bool = False,
    direct: bool = False,
) -> float:
    """Return the error of a level's answer, from its difference to the other level's (both relative).

    Parameters
    ----------
    body, level, load
        What was loaded.
    difference
        To the other level's answer, over the largest displacement.
    rough
        To a smoother reading of the same field, over the largest displacement.
    nominal
        Whether ``difference`` is that of a nominal table to the check table.
    direct
        Whether the answers are of the direct method.
    """
    law = EXPECTED[body.is_flat, level]
    trust = NOMINAL_TABLE if nominal else law.trust
    if direct:
        trust = max(trust, DIRECT_TRUST)
    return trust * difference + law.rough * rough + law.unseen + unbounded(body, load)


def finest_error(difference: float, load: Rectangles, size: float, between: float | None) -> float:
    """Return the error of the block's finest mesh, or of the table made of it: there all shares count.

    Parameters
    ----------
    difference
        To the next coarser mesh or its table, over the largest displacement.
    load
        The load.
    size
        Largest displacement times Young's modulus, N/mm.
    between
        Of a table: its rest over the largest displacement, times `twin.world.elasticity.tables.Tables.between`.
    """
    share = EXPECTED[True, "fine"].trust * difference
    if between is not None:
        share = TRUTH_TABLE * difference + BETWEEN * between
    cut = CUT * float(np.linalg.norm(load.force_n, axis=1).sum()) / size if len(load) > 1 else 0.0
    return share + FINEST + cut
