"""Axes of contact: friction, force, depth, probe, patches, place and tilt, pressed on the standard block.

A step holds where the residual of complementarity and friction, the forces that it should hold (imbalance), and what
theory says comes out (departure) are within bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.stress_elastic import BLOCK, Axis, Measured
from twin.parts.material import Material
from twin.parts.press import Cylinder, Press, Probe, Sphere, Step
from twin.theory.contact import hertz
from twin.world.contact.pressing import ContactState, press
from twin.world.elasticity.compliance import Compliance

RUBBER = Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5)
ACROSS, BALL_MM = 10, 6.0
CONTACT = Measured(residual=1e-8, imbalance=1e-8, departure=0.05)
"""Bounds: complementarity and Coulomb's law over the peak, held forces over themselves, and 5 % from theory."""


def contact_axes() -> list[Axis]:
    """Return the axes of contact on the block."""
    ball = Sphere(diameter_mm=BALL_MM)
    return [
        _axis("friction up (departure: over the cone)", (0.0, 0.1, 1.0, 10.0, 1e3, 1e6, math.inf), _of_friction),
        _axis("friction down (departure: over the cone)", (0.1, 1e-3, 1e-6, 1e-12, 1e-100, 0.0, -1e-6), _of_friction),
        _axis("force up, N (6 mm ball)", (0.1, 1.0, 10.0, 100.0, 1e3, 1e4), lambda n: _pushed(ball, n)),
        _axis("force down, N (6 mm ball; departure: Hertz)", (0.1, 1e-2, 1e-3, 1e-6, 1e-9, 1e-12, 0.0),
              lambda n: _pushed(ball, n, theory=True)),
        _axis("indentation up, mm (6 mm ball)", (0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 20.0, 50.0),
              lambda mm: _state(ball, indentation_mm=mm)),
        _axis("ball up, mm (departure: Hertz)", (6.0, 20.0, 100.0, 1000.0, 2000.0),
              lambda mm: _pushed(Sphere(diameter_mm=mm), 0.01, theory=True)),
        _axis("ball down, mm, under 1 uN (departure: Hertz)", (6.0, 1.0, 0.1, 1e-2, 1e-4, 0.0),
              lambda mm: _pushed(Sphere(diameter_mm=mm), 1e-6, theory=True)),
        _axis("patches across (departure: Hertz)", (6.0, 16.0, 32.0, 64.0),
              lambda n: _pushed(ball, 0.1, across=int(n), theory=True)),
        _axis("middle of a 4 mm pillar from the edge, mm", (20.0, 5.0, 3.0, 2.1, 2.0, 1.0, 0.0, -5.0),
              lambda gap: _pushed(Cylinder(diameter_mm=4), 1.0, at=(50.0 - gap, 3.0))),
        _axis("tilt of a 4 mm pillar, deg", (0.0, 1.0, 5.0, 15.0, 30.0, 60.0, 61.0),
              lambda deg: _pushed(Cylinder(diameter_mm=4, edge_mm=0.5), 0.2, tilt_deg=(deg, 0.0, 0.0))),
        _axis("twist of a stuck ball, deg", (0.1, 1.0, 10.0, 90.0, 1e3),
              lambda deg: _state(ball, friction=math.inf, steps=(Step(force_n=(None, None, 0.5)),
                                                                 Step(force_n=(None, None, 0.5), turn_deg=deg)))),
        _axis("side force over the pressing one, friction 0.5", (0.1, 0.4, 0.49, 0.4999, 0.5, 0.6), _sheared),
        _axis("steps of a path", (2.0, 20.0, 100.0), _long),
    ]  # fmt: skip


def _axis(name: str, steps: tuple[float, ...], attempt: Callable[[float], Any]) -> Axis:
    def measured(step: float) -> Measured:
        found = attempt(step)
        return found if isinstance(found, Measured) else _measured(found)

    bounds = CONTACT if "departure" in name else replace(CONTACT, departure=math.nan)
    return Axis(name=name, steps=steps, attempt=measured, bounds=bounds)


@cache
def _stiff() -> Compliance:
    return Compliance(BLOCK, RUBBER)


def _state(
    probe: Probe, *, at: tuple[float, float] = (0.5, -0.3), across: int = ACROSS, friction: float = 0.0, **path: Any
) -> ContactState:
    asked = Press(probe=probe, at_mm=at, friction=friction, **path)
    return press(
        asked, BLOCK, _stiff(), patches_across=across, youngs_modulus_mpa=RUBBER.youngs_modulus_mpa,
        poisson_ratio=RUBBER.poisson_ratio,
    )  # fmt: skip


def _measured(state: ContactState, *, force: tuple[float | None, ...] = (), departure: float = math.nan) -> Measured:
    if not state.complete:  # the answer says so: what is told is all of it
        return Measured(residual=math.inf, asymmetry=0.0, told=1.0)
    asked = [(found, f) for found, f in zip(state.force_n, force, strict=False) if f is not None]
    off = max((abs(found - f) / abs(f) for found, f in asked if f), default=0.0)
    finite = bool(np.isfinite(state.traction_mpa).all())
    pieces = state.load.force_n.sum(axis=0) if hasattr(state.load, "force_n") else state.force_n
    off = max(off, float(np.abs(pieces - state.force_n).max() / max(np.abs(state.force_n).max(), 1e-300)))
    return Measured(residual=state.residual if finite else math.inf, imbalance=off, departure=departure)


def _pushed(probe: Probe, push: float, *, theory: bool = False, **how: Any) -> Measured:
    state = _state(probe, force_n=(None, None, push), **how)
    departure = math.nan
    if theory and isinstance(probe, Sphere):
        wanted = hertz(
            radius_mm=probe.diameter_mm / 2, force_n=push, youngs_modulus_mpa=RUBBER.youngs_modulus_mpa,
            poisson_ratio=RUBBER.poisson_ratio,
        )  # fmt: skip
        departure = abs(state.peak_pressure_mpa / wanted.peak_pressure_mpa - 1)
    return _measured(state, force=(None, None, push), departure=departure)


def _of_friction(friction: float) -> Measured:
    steps = (Step(force_n=(None, None, 0.5)), Step(force_n=(None, None, 0.5), move_mm=(0.05, None, None)))
    state = _state(Sphere(diameter_mm=BALL_MM), friction=friction, steps=steps)
    side = float(np.hypot(*state.force_n[:2]))
    return _measured(state, force=(None, None, 0.5), departure=max(0.0, side / 0.5 - friction))


def _sheared(share: float) -> Measured:
    steps = (Step(force_n=(None, None, 0.5)), Step(force_n=(0.5 * share, 0.0, 0.5)))
    state = _state(Sphere(diameter_mm=BALL_MM), friction=0.5, steps=steps)
    return _measured(state, force=(0.5 * share, None, 0.5))


def _long(count: float) -> Measured:
    around = np.linspace(0, 4 * math.pi, int(count) - 1)
    steps = [Step(force_n=(None, None, 0.5))]
    steps += [Step(force_n=(0.1 * math.cos(a), 0.1 * math.sin(a), 0.5)) for a in around]
    return _measured(_state(Sphere(diameter_mm=BALL_MM), friction=0.5, steps=tuple(steps)), force=(None, None, 0.5))
