"""Contact: presses against closed forms, seconds beside errors.

On a half-space every case is pressed on finer and finer patches. The clock leaves out the first press on every number
of patches, which compiles, and counts the compliance of every grid. The sensors' own bodies: `benchmarks.presses`.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.clock import Clock
from benchmarks.contact_theory import (
    punch_stiffness,
    sheared_motion,
    stick_radius,
    tangential_stiffness,
    torsional_stiffness,
    twisted,
)
from benchmarks.flat import BLOCK, HalfSpace
from twin.blas_threads import one_thread
from twin.parts.load import Rectangles
from twin.parts.press import Cylinder, Press, Sphere, Step
from twin.theory.contact import hertz
from twin.world.contact.pressing import ContactState, press

MU = 0.5


FRICTIONLESS_ACROSS, RUBBING_ACROSS, QUICK_ACROSS = (10, 14, 20, 28, 40), (10, 14, 20, 28), (8, 12, 16)
"""Patches across the contact's diameter; 40 are 20 across the radius."""

BALL_MM, PUSH_N, SHARE, STUCK_SHARE = 100.0, 0.05, 0.6, 0.7
"""A large ball under a light push: a/R = 0.03, where Hertz's parabola and the ball differ by 2e-4."""


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row for every case, Poisson's ratio and number of patches; the quick form takes coarse grids."""
    return list(_rows(quick))


def _rows(quick: bool) -> Iterator[dict[str, Any]]:
    for case, ratios, rubs in CASES:
        for nu in ratios[-1:] if quick else ratios:
            across = QUICK_ACROSS if quick else RUBBING_ACROSS if rubs else FRICTIONLESS_ACROSS
            for count in across:
                case(count, nu)  # not counted: other numbers of patches take other compiled code
                yield from case(count, nu)


def _pressed(wanted: Press, across: int, nu: float, *, coupled: bool = True) -> tuple[ContactState, dict[str, Any]]:
    clock = Clock()
    state = press(
        wanted, BLOCK, HalfSpace(nu, coupled=coupled), patches_across=across, youngs_modulus_mpa=1.0, poisson_ratio=nu
    )
    said = {"across": across, "patches": len(state.pressure_mpa), "cpu_s": clock.lap().cpu}
    return state, said | {"residual": max(s.residual for s in state.path)}


def _row(case: str, nu: float, what: str, got: float, theory: float, said: dict[str, Any]) -> dict[str, Any]:
    return {"case": case, "nu": nu, "quantity": what, "error": got / theory - 1.0, **said}


def _hertz(across: int, nu: float) -> list[dict[str, Any]]:
    theory = hertz(radius_mm=BALL_MM / 2, youngs_modulus_mpa=1.0, poisson_ratio=nu, force_n=PUSH_N)
    state, said = _pressed(Press(probe=Sphere(diameter_mm=BALL_MM), force_n=(0, 0, PUSH_N)), across, nu)
    name = "Hertz"
    return [
        _row(name, nu, "contact radius", state.contact_radius_mm, theory.contact_radius_mm, said),
        _row(name, nu, "peak pressure", _top_pressure(state), theory.peak_pressure_mpa, said),
        _row(name, nu, "indentation", state.indentation_mm, theory.indentation_mm, said),
        _row(name, nu, "total force", state.force_n[2], PUSH_N, said),
    ]


def _top_pressure(state: ContactState) -> float:
    """Return the pressure in the middle: patches of an even grid are half a patch beside it."""
    (patches,) = state.load.terms
    assert isinstance(patches, Rectangles)
    squared = np.sum(patches.centre_mm[:, :2] ** 2, axis=1)
    inner = squared < 0.25 * state.contact_radius_mm**2
    line = np.polyfit(squared[inner], state.pressure_mpa[inner] ** 2, 1)
    return math.sqrt(float(line[1]))


def _punch(across: int, nu: float) -> list[dict[str, Any]]:
    state, said = _pressed(Press(probe=Cylinder(diameter_mm=5), indentation_mm=0.1), across, nu)
    return [_row("flat punch", nu, "stiffness", state.force_n[2] / 0.1, punch_stiffness(2.5, 1.0, nu), said)]


def _stuck(across: int, nu: float) -> list[dict[str, Any]]:
    path = (Step(move_mm=(None, None, 0.1)), Step(move_mm=(0.05, None, None)), Step(turn_deg=-2.0))
    state, said = _pressed(Press(probe=Cylinder(diameter_mm=5), friction=math.inf, steps=path), across, nu)
    torque = -math.radians(2.0) * torsional_stiffness(2.5, 1.0, nu)
    rows = [_row("stuck punch, turned", nu, "torque", state.torque_nmm, torque, said)]
    if nu == 0.5:
        side = 0.05 * tangential_stiffness(2.5, 1.0, nu)
        rows.append(_row("stuck punch, moved sideways", nu, "force", state.path[1].force_n[0], side, said))
    return rows


def _sheared(across: int, nu: float) -> list[dict[str, Any]]:
    """Return the rows of Cattaneo and Mindlin's sphere, whose theory leaves coupling out."""
    side = SHARE * MU * PUSH_N
    path = (Step(force_n=(0, 0, PUSH_N)), Step(force_n=(1e-3 * side, 0, PUSH_N)), Step(force_n=(side, 0, PUSH_N)))
    state, said = _pressed(Press(probe=Sphere(diameter_mm=BALL_MM), friction=MU, steps=path), across, nu, coupled=False)
    first, touched, end = state.path
    a, name = first.contact_radius_mm, "Cattaneo-Mindlin"
    stiff = (touched.force_n[0] - first.force_n[0]) / (touched.move_mm[0] - first.move_mm[0])
    along, across_it = (float(np.abs(end.traction_mpa[:, axis]).max()) for axis in (0, 1))
    return [
        _row(name, nu, "stick radius", a * _stuck_share(end), stick_radius(a, side, PUSH_N, MU), said),
        _row(name, nu, "first tangential stiffness", stiff, tangential_stiffness(a, 1.0, nu), said),
        _row(name, nu, "sideways motion", end.move_mm[0], sheared_motion(a, side, PUSH_N, MU, 1.0, nu), said),
        {"case": name, "nu": nu, "quantity": "collinear residual", "error": across_it / along, **said},
    ]


def _stuck_share(state: ContactState) -> float:
    """Return the radius of the patches that stick over that of all: averaged over direction, as both are uneven."""
    (patches,) = state.load.terms
    assert isinstance(patches, Rectangles)
    area = np.prod(patches.half_mm, axis=1)
    return math.sqrt(area[~state.slip].sum() / area.sum())


def _twisted(across: int, nu: float) -> list[dict[str, Any]]:
    theory = hertz(radius_mm=BALL_MM / 2, youngs_modulus_mpa=1.0, poisson_ratio=nu, force_n=PUSH_N)
    a = theory.contact_radius_mm
    small, (turn, torque) = 0.01 * MU * PUSH_N * a, twisted(STUCK_SHARE * a, a, PUSH_N, MU, 1.0, nu)
    path = [Step(force_n=(0, 0, PUSH_N), torque_nmm=t) for t in (None, small, torque)]
    state, said = _pressed(Press(probe=Sphere(diameter_mm=BALL_MM), friction=MU, steps=tuple(path)), across, nu)
    _, little, end = state.path
    stiff, name = small / math.radians(little.turn_deg), "Lubkin, a twisted sphere"
    return [
        _row(name, nu, "first torsional stiffness", stiff, torsional_stiffness(a, 1.0, nu), said),
        _row(name, nu, "turn", math.radians(end.turn_deg), turn, said),
        _row(name, nu, "stick radius", _stuck_share(end), STUCK_SHARE, said),
    ]


Case = Callable[[int, float], list[dict[str, Any]]]
CASES: tuple[tuple[Case, tuple[float, ...], bool], ...] = (
    (_hertz, (0.3, 0.5), False),
    (_punch, (0.5,), False),
    (_stuck, (0.3, 0.5), True),
    (_sheared, (0.3, 0.5), True),
    (_twisted, (0.5,), True),
)
"""What is pressed, at which Poisson's ratios, and whether with friction."""
