"""Axes of the load's place and size: edges, the clamped rim, narrower than an element, as wide as the face.

Balance is told by the tractions that the half-space's field leaves on all faces: they must add up to the load. The
bodies are left unheld for that, so that the base counts as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.stress_axes import BLOCK, PUSH, SOUND, Axis, Measured, relative
from twin.arrays import Floats, Points
from twin.parts.body import Body, Finger
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.residual import nodal_forces
from twin.world.elasticity.tile import join, tile

FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
BODIES: dict[str, tuple[Body, Points]] = {
    "block": (BLOCK, np.array([-1.0, 1.0, 1.0])),
    "finger": (FINGER, np.array([1.0, -1.0, 1.0])),
}
"""Each with the mirror that it is symmetric under."""

LEAST_DEPTH_MM, ASIDE = 0.3, 0.05
"""Least depth of points, and their least distance to all other faces over the body's height: next to a free side, where
no marker is, mirrored answers differ up to twice as much."""
AT_LOAD = replace(SOUND, imbalance=0.01)
"""Quadrature is good to a few thousandths next to an edge; under mirrored loads the program's own estimate is asked."""


def load_axes() -> list[Axis]:
    """Return the axes; distances are of the load's middle, its width twice that, so that it touches the edge."""
    gaps = (20.0, 10.0, 3.0, 1.0, 0.1, 1e-2, 1e-3, 2e-4, 1e-4, 5e-5)
    widths = (4.0, 1.0, 0.1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-100, 0.0)
    return [
        Axis(name="block, load touching an edge, mm from its middle", steps=gaps,
             attempt=partial(_of_place, "block", lambda gap: (50 - gap, 3.0, 0.0)), bounds=AT_LOAD),
        Axis(name="block, load touching a corner", steps=gaps,
             attempt=partial(_of_place, "block", lambda gap: (50 - gap, 45 - gap, 0.0)), bounds=AT_LOAD),
        Axis(name="finger, load touching the back edge", steps=(4.0, *gaps[2:]),
             attempt=partial(_of_place, "finger", _beside_back), bounds=AT_LOAD),
        Axis(name="finger, load 0.5 mm wide, mm from its middle to the clamped rim (departure: motion of the clamp)",
             steps=(2.0, 1.5, 1.0, 0.75, 0.5, 0.3, 0.25), attempt=_of_rim,
             bounds=replace(AT_LOAD, departure=0.1)),
        Axis(name="block, width of the load, mm (departure: from 1 um)", steps=widths,
             attempt=partial(_of_width, "block", (2.0, 1.0)), bounds=replace(AT_LOAD, departure=0.2)),
        Axis(name="finger, width of the load, mm (departure: from 1 um)", steps=widths[1:],
             attempt=partial(_of_width, "finger", (1.0, 2.0)), bounds=replace(AT_LOAD, departure=0.2)),
        Axis(name="block, width of the load over the face's (departure: from its quarters)",
             steps=(0.1, 0.3, 0.6, 0.9, 0.99, 0.9999, 1.0, 1.0001, 10.0), attempt=_of_share,
             bounds=replace(AT_LOAD, departure=0.01)),
    ]  # fmt: skip


@cache
def _stiff(name: str) -> Compliance:
    return Compliance(BODIES[name][0], Material(youngs_modulus_mpa=1.0), level="nominal", table=False)


@cache
def _loose(name: str) -> Body:
    """Return the body, held nowhere."""
    body = BODIES[name][0]
    kind: Any = type("Loose", (type(body),), {"held_pieces": property(lambda self: ())})
    made: Body = kind(**body.geometry())
    return made


@cache
def _points(name: str) -> Points:
    """Return points (n, 3) all over a body, 0.3 mm deep or deeper, and a twentieth of its height off other faces."""
    body = BODIES[name][0]
    low, high = (np.array(b) for b in body.bounds_mm)
    points = np.random.default_rng(0).uniform(low, high, (3000, 3))
    away = body.piece_distances(points)
    return points[(away[:, 0] >= LEAST_DEPTH_MM) & (away[:, 1:].min(axis=1) >= ASIDE * body.base_z_mm)]


def _measured(name: str, load: Rectangles, mirrored: Rectangles) -> Measured:
    """Return residual, balance of the half-space's tractions, and difference to the mirrored load's mirrored answer."""
    stiff, mirror, points = _stiff(name), BODIES[name][1], _points(name)
    here = stiff.displacement(points, load)
    residual = stiff.system.factor.residual
    there = stiff.displacement(points * mirror, mirrored) * mirror
    total = load.force_n.sum(axis=0)
    left = nodal_forces(stiff.mesh, _loose(name), load, load.force_n[:, :, None], 0.5).sum(axis=0)[:, 0]
    return Measured(
        residual=max(residual, stiff.system.factor.residual),
        imbalance=float(np.linalg.norm(left - total) / np.linalg.norm(total)),
        asymmetry=relative(there, here),
        told=stiff.error_estimate(points, load),
    )


def _pair(name: str, centre: Floats, width: float) -> tuple[Rectangles, Rectangles]:
    """Return a square load of one width at a surface point (2 or 3,), and its mirror image."""
    body, mirror = BODIES[name]
    each = (
        Traction.rectangle(tuple(centre * m[: len(centre)]), (width, width), tuple(np.array(PUSH) * m))
        for m in (np.ones(3), mirror)
    )
    one, other = (tile(load, body) for load in each)
    return one, other


def _of_place(name: str, centre: Callable[[float], tuple[float, ...]], gap: float) -> Measured:
    return _measured(name, *_pair(name, np.array(centre(gap)), 2.0 * gap if gap < 5.0 else 4.0))


def _beside_back(gap: float) -> tuple[float, ...]:
    x, y, z = FINGER.chart_points(np.array([[gap - 8.0, 3.0]]))[0]
    return float(x), float(y), float(z)


def _of_rim(gap: float) -> Measured:
    load, mirrored = _pair("finger", np.array([-3.0, 8.0, 10.0 - gap]), 0.5)
    base = np.array([(x, y, 10.0) for x in np.linspace(-7.7, 0.0, 20) for y in np.linspace(-7.7, 7.7, 60)])
    clamped, points = (_stiff("finger").displacement(p, load) for p in (base, _points("finger")))
    still = np.linalg.norm(clamped, axis=1).max() / np.linalg.norm(points, axis=1).max()
    told = _stiff("finger").error_estimate(np.concatenate([base, _points("finger")]), load)
    return replace(_measured("finger", load, mirrored), departure=float(still), told=told)


@cache
def _under(name: str, place: tuple[float, float], width: float) -> Floats:
    body = BODIES[name][0]
    deep = body.chart_points(np.array([place]) + np.array([[0.0, 0.0], [3.0, 1.0], [-4.0, 2.0]]), 3.0)
    return _stiff(name).displacement(deep, tile(Traction.rectangle(_on(name, place), (width, width), PUSH), body))


def _on(name: str, place: tuple[float, float]) -> tuple[float, ...]:
    return tuple(float(c) for c in BODIES[name][0].chart_points(np.array([place]))[0])


def _of_width(name: str, place: tuple[float, float], width: float) -> Measured:
    pair = _pair(name, np.array(_on(name, place)), width)
    departure = relative(_under(name, place, width), _under(name, place, 1e-3)) if width < 1.0 else np.nan
    return replace(_measured(name, *pair), departure=departure if width < 1.0 else 0.0)


def _of_share(share: float) -> Measured:
    size = np.array([100.0, 90.0]) * share
    whole = tile(Traction.rectangle((0, 0), tuple(size), PUSH), BLOCK)
    corners = [np.array([a, b]) * size / 4 for a in (-1, 1) for b in (-1, 1)]
    quarter = tuple(np.array(PUSH) / 4)
    quarters = join([tile(Traction.rectangle(tuple(c), tuple(size / 2), quarter), BLOCK) for c in corners])
    mirrored = tile(Traction.rectangle((0, 0), tuple(size), (-PUSH[0], *PUSH[1:])), BLOCK)
    stiff, points = _stiff("block"), _points("block")
    departure = relative(stiff.displacement(points, whole), stiff.displacement(points, quarters))
    # under a load wider than the body is thick the base lies in the load's own footprint: its quarters are balanced
    balanced = _measured("block", quarters, quarters).imbalance
    return replace(_measured("block", whole, mirrored), departure=departure, imbalance=balanced)
