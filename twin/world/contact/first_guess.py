"""Where Newton's steps on one part of a path start: the forces and the place that it is likely to lead to.

The nearer the start, the fewer patches change between open, stick and slip on the way. A path that goes on as it did
is followed on a straight line. A probe that touches first is pushed without friction; and where it is then sheared, the
superposition of Cattaneo and Mindlin says which patches stick and what the others carry (`sheared`): two Newton steps
of seven are saved.

Validity: guesses only; nothing of them is left in a solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.world.contact.friction_grid import FrictionGrid, Memory
from twin.world.contact.gap import MOTIONS, Z
from twin.world.contact.together import Control
from twin.world.contact.unilateral import Equilibrium, Unilateral, solve

_FORESEEN = 4.0
"""How many times as far as the last step another may go on in the same way."""

_BISECTIONS = 20


@dataclass(frozen=True, kw_only=True)
class Guess:
    """Forces (k, 3), a place (6 p,) and patches in contact (k,) to start from, and displacements where known."""

    force_n: Floats
    place: Floats
    active: Bools
    displacement_mm: Floats | None = None


def foreseen(memory: Memory, control: Control, start: Floats) -> Guess | None:
    """Return what a step leads to if it changes as the last one did; None where it doesn't go on in the same way."""
    if memory.trend is None:
        return None
    wanted, last = control.given - start, memory.trend.given
    length = float(last @ last)
    share = float(wanted @ last) / length if length > 0.0 else 0.0
    if not 0.0 < share <= _FORESEEN or np.abs(wanted - share * last).max() > 1e-6 * np.abs(wanted).max():
        return None
    force = memory.force_n + share * memory.trend.force_n
    place = np.where(control.by_force, memory.place + share * memory.trend.place, control.given)
    return Guess(force_n=force, place=place, active=memory.touched)


def went_on(before: Equilibrium | None, now: Equilibrium | None) -> Equilibrium | Guess | None:
    """Return what the next part leads to if it changes as the last one did."""
    if before is None or now is None:
        return now
    return Guess(
        force_n=2.0 * now.force_n - before.force_n, place=2.0 * now.place - before.place, active=now.active,
        displacement_mm=2.0 * now.displacement_mm - before.displacement_mm,
    )  # fmt: skip


def first_guess(
    grid: FrictionGrid, problem: Unilateral, memory: Memory, control: Control, guess: Equilibrium | Guess | None
) -> Equilibrium | Guess:
    """Return where to start on a part: at a guess that has forces, else at the last forces or a push, and sheared."""
    if guess is not None and guess.force_n.any():
        return guess
    force, place = memory.force_n, np.where(control.by_force, memory.place, control.given)
    active = likely_touching(grid, memory, place, guess)
    if guess is not None or not force.any():
        pushed = without_friction(grid, problem, memory, control, active)
        force, place = pushed.force_n, pushed.place
    return Guess(force_n=sheared(problem, force), place=place, active=active)


def likely_touching(grid: FrictionGrid, memory: Memory, place: Floats, guess: Equilibrium | Guess | None) -> Bools:
    """Return a guess's patches in contact (k,), or the nearest ones where it has none."""
    return guess.active if guess is not None and guess.active.any() else nearest(grid, memory, place)


def nearest(grid: FrictionGrid, memory: Memory, place: Floats) -> Bools:
    """Return a first guess of the patches in contact: those that were, or the few that are nearest to the probe."""
    if memory.touched.any():
        return memory.touched.copy()
    gap, _ = grid.gap(memory, place)
    near = [gap[rows] <= np.sort(gap[rows])[min(4, len(gap[rows]) - 1)] for _, rows, _ in grid.contacts.rows]
    return np.concatenate(near) & np.isfinite(gap)


def without_friction(
    grid: FrictionGrid, problem: Unilateral, memory: Memory, control: Control, active: Bools
) -> Equilibrium:
    """Push along z only, without friction and held sideways: a first guess, and the pressure that friction rests on."""
    along_z = grid.along_z
    held = replace(
        problem, friction=np.zeros(len(active)), by_force=control.by_force & along_z,
        given=np.where(control.by_force & ~along_z, memory.place, control.given), pushing=control.pushing,
    )  # fmt: skip
    return solve(held, active, np.where(control.by_force, memory.place, control.given))


def sheared(problem: Unilateral, force: Floats) -> Floats:
    """Return forces (k, 3) with friction for the sideways forces that they lack: a ring slips, the middle sticks.

    Notes
    -----
    Friction is mu (p - p*), p* being the pressure of the smaller contact that sticks (M. Ciavarella, Int. J. Solids
    Struct. 35 (1998) 2349; Cattaneo's and Mindlin's superposition for any shape). Of a sphere p*^2 = p^2 - s^2.
    """
    force = force.copy()
    lacking = np.where(problem.by_force, problem.given - problem.total(force), 0.0).reshape(-1, MOTIONS)[:, :Z]
    for number, (x, y) in enumerate(lacking):
        most, push = math.hypot(x, y), np.maximum(force[:, 2], 0.0)
        along = problem.carried[:, :2, MOTIONS * number : MOTIONS * number + Z] @ np.array([x, y]) / (most or 1.0)
        friction = np.where(np.isfinite(problem.friction), problem.friction, 0.0)
        carries = friction * np.einsum("ka,ka->k", along, along)
        if not 0.0 < most < carries @ push:
            continue
        low, high = 0.0, float(push.max())
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            slips = push - np.sqrt(np.maximum(push**2 - middle**2, 0.0))
            low, high = (middle, high) if carries @ slips < most else (low, middle)
        force[:, :2] += along * (friction * slips)[:, None]
    return force
