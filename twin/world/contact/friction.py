"""Contact with friction has a history: what touches is carried along from where it touched, and slips by Coulomb's law.

The path matters, so patches stay where they are on the body for the whole path and remember where they touched, or
where they last slipped to (`twin.world.contact.friction_grid`). Sticking is the law with an unbounded coefficient. What
all patches slip in common is a slide of the whole probe; a sphere that slides meets the body elsewhere, so its gaps are
taken at the place that it slid to.

A step in which patches touch or slip is taken in up to `INCREMENTS` parts: fewer where it changes little, as in a path
of many small steps (`_parts`). A part with new patches is solved twice: once with the new ones free to slide, which
shows how far they would, and once with each of them held by friction from the moment at which it touched. A sticking
patch that is pulled off and pushed back within a part touches anew: it sticks from the part's end. With 8 parts the
force of a stuck sphere at nu = 0.3 is within 0.05 % of many parts, and the sideways motion under a force that grows
obliquely within 2 % of the closed form. A part that finds no equilibrium is halved, a few times.

Validity: friction is the same at rest and in motion. A flat face keeps the patches that it had at first touch, so it
may slide by a small part of its width only (`twin.world.contact.refused`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.parts.accuracy import INCREMENTS
from twin.parts.probe import Cone
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.first_guess import Guess, first_guess, foreseen, likely_touching, went_on
from twin.world.contact.friction_grid import FrictionGrid, Memory, Trend
from twin.world.contact.gap import Z
from twin.world.contact.refused import KNOWN_TO, explain, refuse_slide
from twin.world.contact.together import Control
from twin.world.contact.unilateral import Equilibrium, Unilateral, holding, solve

_HALVINGS, _SLIDE_ROUNDS = 3, 12
_SLID, _SLID_AT_LAST = 1e-3, 1e-2
"""How well a slide is known, over half a patch; the last where a patch comes and goes with it, so that it jumps."""


def _part(
    grid: FrictionGrid, memory: Memory, control: Control, guess: Equilibrium | Guess | None, held: Bools | None = None
) -> tuple[Memory, Equilibrium]:
    """Solve one part from a guess; return the state, and the memory with how far the probe slid as a whole."""
    problem = grid.problem(memory, control, held)
    if grid.sticks:
        place = np.where(control.by_force, memory.place, control.given)
        return memory, solve(problem, likely_touching(grid, memory, place, guess), place)
    found = _from_guess(problem, first_guess(grid, problem, memory, control, guess))
    start, share, before = memory.slid_mm, 1.0, np.zeros_like(memory.slid_mm)
    for turn in range(_SLIDE_ROUNDS):
        slid = start + _slide(grid, memory, problem, found)
        off, late = slid - memory.slid_mm, 2 * turn >= _SLIDE_ROUNDS
        flat = all(setting.face is not None for setting in grid.contacts.settings)
        known = _SLID_AT_LAST if late else _SLID
        if float(np.abs(off).max()) <= known * float(grid.patches.half_mm.min()) or flat:
            return replace(memory, slid_mm=slid), found
        if late and float(np.sum(off * before)) < 0.0:
            share /= 2  # to and fro: where a patch comes and goes lies between
        memory, before = replace(memory, slid_mm=slid - (1.0 - share) * off), off
        problem = grid.problem(memory, control, held)
        found = solve_coulomb(problem, found.force_n, found.place, found.displacement_mm)
    raise NotSettled("contact: the probe slides, and where it slides to does not settle: take smaller steps")


def _from_guess(problem: Unilateral, guess: Equilibrium | Guess) -> Equilibrium:
    """Solve Coulomb's law from a guess, and from a probe that sticks where the guess is too far off."""
    try:
        return solve_coulomb(problem, guess.force_n, guess.place, guess.displacement_mm)
    except ContactError:
        try:
            sticks = replace(problem, friction=np.where(problem.friction > 0, np.inf, 0.0))
            stuck = solve(sticks, guess.active, guess.place)
        except ContactError:
            pass  # the first error is the telling one
        else:
            return solve_coulomb(problem, stuck.force_n, stuck.place, stuck.displacement_mm)
        raise


def _slide(grid: FrictionGrid, memory: Memory, problem: Unilateral, found: Equilibrium) -> Floats:
    """Return (p, 2) what all patches of a probe slipped in common, along its x and y: nothing where one sticks.

    The mean of the least slips, as the least one alone may jump between patches that mirror each other; patches that
    touched within the part slipped for a part of it only and do not count.
    """
    slides = np.zeros_like(memory.slid_mm)
    counted = found.active & (memory.touched | grid.untouched(memory))
    for number, (setting, rows, _) in enumerate(grid.contacts.rows):
        active = np.flatnonzero(counted[rows]) + rows.start
        if len(active) == 0 or not found.slipping[active].all():
            continue
        slip = found.displacement_mm[active, :2] - problem.carried[active, :2] @ found.place - problem.offset[active]
        length = np.hypot(slip[:, 0], slip[:, 1])
        least = length <= 1.1 * length.min()
        back = np.einsum("ka,kai->ki", slip[least], grid.patches.frames[active[least], :2]).mean(axis=0)
        slides[number] = -setting.first.axes[:Z] @ back
    return slides


def _remember(grid: FrictionGrid, memory: Memory, found: Equilibrium) -> Memory:
    new = found.active & (~memory.touched | found.slipping)
    moved = np.einsum("kad,d->ka", grid.carried, found.place)
    away = found.displacement_mm - moved
    # What touched within the part has slipped from where it was held; where it slid before that, nothing pressed on it.
    slipped = np.where(found.slipping[:, None], away[:, :2] - grid.offset(memory), 0.0)
    return Memory(
        touched=found.active.copy(),
        slipping=found.slipping & found.active,
        closed_mm=np.where(new, -away[:, 2] - np.where(new, grid.moved_gap(memory.slid_mm), 0.0), memory.closed_mm),
        offset_mm=np.where(new[:, None], away[:, :2], memory.offset_mm),
        place=found.place.copy(),
        total=found.total.copy(),
        displacement_mm=found.displacement_mm.copy(),
        force_n=found.force_n.copy(),
        slid_mm=memory.slid_mm,
        lifted=memory.lifted,
        dissipated_nmm=memory.dissipated_nmm - float(np.sum(found.force_n[:, :2] * slipped)),
    )


def _held_on_the_way(grid: FrictionGrid, memory: Memory, free: Equilibrium, new: Bools) -> Memory:
    """Return the memory with the offsets of patches that touch during a part, which ``free`` let slide to its end.

    Notes
    -----
    Had the new patches not been stopped, they would overlap the probe by S f at the end, f being their normal forces
    and S their normal compliance with the old patches kept in touch (a Schur complement). Between the gap at the start
    and that overlap the gap is interpolated linearly; a patch slides until it is zero.
    """
    gap, _ = grid.gap(memory, memory.place)
    gap = np.maximum(gap[new] + memory.displacement_mm[new, 2], 0.0)
    old = free.active & memory.touched
    pushed = np.where(new, free.force_n[:, 2], 0.0)
    sunk = grid.between.sunk(pushed)
    relief = np.zeros_like(pushed)
    relief[old] = holding(grid.between, np.flatnonzero(old), sunk[old])
    overlap = (sunk - grid.between.sunk(relief))[new]
    met = np.isfinite(gap)
    share = np.where(met, np.where(met, gap, 0.0) / np.maximum(gap + np.maximum(overlap, 0.0), 1e-300), 1.0)
    tangential = grid.carried[new, :2]
    start = memory.displacement_mm[new, :2] - tangential @ memory.place
    end = free.displacement_mm[new, :2] - tangential @ free.place
    offset = memory.offset_mm.copy()
    offset[new] = start + share[:, None] * (end - start)
    return replace(memory, offset_mm=offset)


def _pass(
    grid: FrictionGrid, memory: Memory, control: Control, guess: Equilibrium | Guess | None
) -> tuple[Memory, Equilibrium]:
    """Solve one part, with the patches that touch within it held by friction from where they touched."""
    try:
        slid, found = _part(grid, memory, control, guess)
    except ContactError:
        if grid.sticks or not memory.touched.any():
            raise
        # The old patches alone may not carry what the new ones help to: hold those from the start of the part.
        return _part(grid, memory, control, guess, held=~memory.touched)
    new = found.active & ~memory.touched & ~grid.untouched(memory)
    if memory.touched.any() and new.any():
        return _part(grid, _held_on_the_way(grid, memory, found, new), control, found, held=new)
    return slid, found


def _advance(
    grid: FrictionGrid,
    memory: Memory,
    control: Control,
    guess: Equilibrium | Guess | None,
    wanted: Control,
    halvings: int = _HALVINGS,
) -> tuple[Memory, Equilibrium]:
    """Take one part of a step to ``wanted``, in halves where it finds no equilibrium at once."""
    try:
        slid, found = _pass(grid, memory, control, guess)
        return _remember(grid, slid, found), found
    except ContactError as problem_found:
        if grid.sticks:
            raise
        if halvings == _HALVINGS:
            explain(grid, memory, wanted, problem_found)
        if halvings == 0:
            raise
    start = np.where(control.by_force, memory.total, memory.place)
    half = replace(control, given=(start + control.given) / 2)
    memory, found = _advance(grid, memory, half, guess, wanted, halvings - 1)
    return _advance(grid, memory, control, found, wanted, halvings - 1)


def _parts(memory: Memory, found: Equilibrium, most: int) -> int:
    """Return in how many parts to take a step that leads to about ``found``: ``most`` where it changes half or more.

    What counts is the share of the patches that touch, stick or slip otherwise than before, or that of the forces.
    """
    changed = (found.active != memory.touched) | ((found.slipping & found.active) != memory.slipping)
    patches = float(changed.sum()) / float((found.active | memory.touched).sum())
    before, after = (float(np.linalg.norm(force, axis=1).sum()) for force in (memory.force_n, found.force_n))
    forces = float(np.linalg.norm(found.force_n - memory.force_n, axis=1).sum()) / max(before, after, 1e-300)
    return min(most, max(1, math.ceil(2.0 * most * max(patches, forces))))


def take_step(
    grid: FrictionGrid, memory: Memory, control: Control, increments: int = INCREMENTS
) -> tuple[Memory, Equilibrium, str]:
    """Take one step of the path.

    Parameters
    ----------
    grid, memory
        The patches, and where they touched so far.
    control
        What holds the probe at the end of the step.
    increments
        Parts of a step in which patches touch or slip.

    Returns
    -------
    The memory and the equilibrium at the end of the step, or of its last part that converged; why it stopped there, or
    an empty text.

    Raises
    ------
    ContactError
        A part has no equilibrium, or a flat face slides too far; `NotSettled` when the first part doesn't converge.
    """
    before, previous, first = None, None, memory
    start = np.where(control.by_force, memory.total, memory.place)

    def with_trend(then: Memory) -> Memory:
        force, place = then.force_n - first.force_n, then.place - first.place
        return replace(then, trend=Trend(force_n=force, place=place, given=control.given - start))

    if memory.touched.any():
        try:
            _, found = _part(grid, memory, control, foreseen(memory, control, start))
        except ContactError:
            pass  # a large step may fail where its parts succeed
        else:
            if not np.any(found.active & ~memory.touched | found.slipping):
                return with_trend(_remember(grid, memory, found)), found, ""
            increments = _parts(memory, found, increments)
            previous = found if increments == 1 else None
    powers = np.ones(len(start))
    for setting, rows, motions in grid.contacts.rows:
        if setting.face is None and memory.touched[rows].sum() <= 1:
            # Equal parts of the contact radius: a sphere's force grows with its cube, its motion with its square.
            force, motion = (2.0, 1.0) if isinstance(setting.probe, Cone) else (3.0, 2.0)
            powers[motions] = np.where(control.by_force[motions], force, motion)
    for part in range(1, increments + 1):
        share = (part / increments) ** powers
        now = Control(by_force=control.by_force, given=start + share * (control.given - start))
        refuse_slide(grid, memory)
        try:
            memory, found = _advance(grid, memory, now, went_on(before, previous), control)
            before, previous = previous, found
        except NotSettled as stopped:
            if part == 1 or previous is None:
                raise
            return memory, previous, f"stopped after {part - 1} of {increments} parts: {stopped}"
        except ContactError as refused:
            explain(grid, memory, control, refused, least=1.0 - KNOWN_TO)
            raise
    refuse_slide(grid, memory)
    assert previous is not None, "a step has at least one part"
    return with_trend(memory), previous, ""
