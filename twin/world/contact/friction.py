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
may slide by a small part of its width only (`SLIDE_LIMIT`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.parts.accuracy import INCREMENTS
from twin.parts.probe import Cone
from twin.world.contact.capacity import asked_share
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.friction_grid import FrictionGrid, Memory, Trend
from twin.world.contact.gap import TURN, X, Y, Z
from twin.world.contact.probe_shape import half_extent
from twin.world.contact.together import Control, every
from twin.world.contact.unilateral import Equilibrium, Unilateral, holding, solve

SLIDE_LIMIT = 0.05
"""How far a flat face may slide as a whole, over its smaller width."""

_HALVINGS, _SLIDE_ROUNDS, _FORESEEN = 3, 12, 4.0
_KNOWN_TO = 0.05
"""How well `twin.world.contact.capacity` knows what friction can carry, over the whole."""
_RUBBED = [X, Y, Z, TURN]
"""The components of a probe's place that `twin.world.contact.capacity` knows."""


@dataclass(frozen=True, kw_only=True)
class _Guess:
    """Forces (k, 3), a place (6 p,) and patches in contact (k,) to start from, and displacements where known."""

    force_n: Floats
    place: Floats
    active: Bools
    displacement_mm: Floats | None = None


def _offset(grid: FrictionGrid, memory: Memory) -> Floats:
    """Return (k, 2) from where each patch's slip counts.

    After a lift the probe touches anew where it now is: its motion sideways counts from there.
    """
    anew = -np.einsum("kad,d->ka", grid.carried[:, :2], grid.sideways(memory.place))
    return np.where(grid.untouched(memory)[:, None], anew, memory.offset_mm)


def _problem(grid: FrictionGrid, memory: Memory, control: Control, held: Bools | None) -> Unilateral:
    """Return a part's equations; patches in ``held`` feel friction although they had not touched before it."""
    rubs = memory.touched | grid.untouched(memory) | (False if held is None else held)
    return Unilateral(
        compliance=grid.between, gap=lambda q: grid.gap(memory, q), carried=grid.carried,
        by_force=control.by_force, given=control.given, pushing=control.pushing,
        friction=np.where(rubs, grid.friction[grid.contacts.owner], 0.0), offset=_offset(grid, memory),
        solver=grid.solver,
    )  # fmt: skip


def _part(
    grid: FrictionGrid, memory: Memory, control: Control, guess: Equilibrium | _Guess | None, held: Bools | None = None
) -> tuple[Memory, Equilibrium]:
    """Solve one part from a guess; return the state, and the memory with how far the probe slid as a whole."""
    problem = _problem(grid, memory, control, held)
    place = np.where(control.by_force, memory.place, control.given)
    active = guess.active if guess is not None and guess.active.any() else _nearest(grid, memory, place)
    if grid.sticks:
        return memory, solve(problem, active, place)
    force, displacement = memory.force_n, None
    if guess is not None:
        force, displacement = guess.force_n, guess.displacement_mm
    if not force.any():
        pushed = _without_friction(grid, problem, memory, control, active)
        force, displacement, place = pushed.force_n, pushed.displacement_mm, _along(problem, pushed)
    elif guess is not None:
        place = guess.place
    found = _from_guess(problem, active, force, place, displacement)
    start = memory.slid_mm
    for _ in range(_SLIDE_ROUNDS):
        slid = start + _slide(grid, memory, problem, found)
        change = float(np.abs(slid - memory.slid_mm).max())
        memory = replace(memory, slid_mm=slid)
        flat = all(setting.face is not None for setting in grid.contacts.settings)
        if change <= 1e-3 * float(grid.patches.half_mm.min()) or flat:
            return memory, found
        problem = _problem(grid, memory, control, held)
        found = solve_coulomb(problem, found.force_n, found.place, found.displacement_mm)
    raise NotSettled("contact: the probe slides, and where it slides to does not settle: take smaller steps")


def _foreseen(memory: Memory, control: Control, start: Floats) -> _Guess | None:
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
    return _Guess(force_n=force, place=place, active=memory.touched)


def _went_on(before: Equilibrium | None, now: Equilibrium | None) -> Equilibrium | _Guess | None:
    """Return what the next part leads to if it changes as the last one did."""
    if before is None or now is None:
        return now
    return _Guess(
        force_n=2.0 * now.force_n - before.force_n, place=2.0 * now.place - before.place, active=now.active,
        displacement_mm=2.0 * now.displacement_mm - before.displacement_mm,
    )  # fmt: skip


def _from_guess(
    problem: Unilateral, active: Bools, force: Floats, place: Floats, displacement: Floats | None
) -> Equilibrium:
    """Solve Coulomb's law from a guess, and from a probe that sticks where the guess is too far off."""
    try:
        return solve_coulomb(problem, force, place, displacement)
    except ContactError:
        try:
            stuck = solve(replace(problem, friction=np.where(problem.friction > 0, np.inf, 0.0)), active, place)
        except ContactError:
            pass  # the first error is the telling one
        else:
            return solve_coulomb(problem, stuck.force_n, stuck.place, stuck.displacement_mm)
        raise


def _along(problem: Unilateral, pushed: Equilibrium) -> Floats:
    """Return the place at which a probe that is free sideways goes along with a body that it pushed without friction.

    A body that is pressed beside its middle moves sideways as a whole: held back, every patch would seem to slip.
    """
    along = every(X, len(pushed.place)) | every(Y, len(pushed.place)) | every(TURN, len(pushed.place))
    free = np.flatnonzero(problem.by_force & along)
    if len(free) == 0:
        return pushed.place
    weight = np.sqrt(np.maximum(pushed.force_n[:, 2], 0.0))[:, None]
    behind = pushed.displacement_mm[:, :2] - problem.carried[:, :2] @ pushed.place - problem.offset
    moved = problem.carried[:, :2, free] * weight[..., None]
    place = pushed.place.copy()
    place[free] += np.linalg.lstsq(moved.reshape(-1, len(free)), (behind * weight).reshape(-1), rcond=None)[0]
    return place


def _nearest(grid: FrictionGrid, memory: Memory, place: Floats) -> Bools:
    """Return a first guess of the patches in contact: those that were, or the few that are nearest to the probe."""
    if memory.touched.any():
        return memory.touched.copy()
    gap, _ = grid.gap(memory, place)
    near = [gap[rows] <= np.sort(gap[rows])[min(4, len(gap[rows]) - 1)] for _, rows, _ in grid.contacts.rows]
    return np.concatenate(near) & np.isfinite(gap)


def _without_friction(
    grid: FrictionGrid, problem: Unilateral, memory: Memory, control: Control, active: Bools
) -> Equilibrium:
    """Push along z only, without friction and held sideways: a first guess, and the pressure that friction rests on."""
    along_z = grid.along_z
    held = replace(
        problem, friction=np.zeros(len(active)), by_force=control.by_force & along_z,
        given=np.where(control.by_force & ~along_z, memory.place, control.given), pushing=control.pushing,
    )  # fmt: skip
    return solve(held, active, np.where(control.by_force, memory.place, control.given))


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
    slipped = np.where(found.slipping[:, None], away[:, :2] - _offset(grid, memory), 0.0)
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
    grid: FrictionGrid, memory: Memory, control: Control, guess: Equilibrium | _Guess | None
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
    guess: Equilibrium | _Guess | None,
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
            _explain(grid, memory, wanted, problem_found)
        if halvings == 0:
            raise
    start = np.where(control.by_force, memory.total, memory.place)
    half = replace(control, given=(start + control.given) / 2)
    memory, found = _advance(grid, memory, half, guess, wanted, halvings - 1)
    return _advance(grid, memory, control, found, wanted, halvings - 1)


def _explain(
    grid: FrictionGrid, memory: Memory, control: Control, problem_found: ContactError, least: float = 1.0
) -> None:
    """Raise a ContactError that names the cause when ``least`` times what friction can carry is asked, or more."""
    place = np.where(control.by_force, memory.place, control.given)
    nearest = _nearest(grid, memory, place)
    pushed = _without_friction(grid, _problem(grid, memory, control, None), memory, control, nearest)
    for number, (_, rows, motions) in enumerate(grid.contacts.rows):
        carried, friction = grid.carried[rows, :, motions][..., _RUBBED], float(grid.friction[number])
        held, given = control.by_force[motions][_RUBBED], control.given[motions][_RUBBED]
        share = asked_share(carried, pushed.force_n[rows, 2], friction, held, given)
        if share >= least:
            asked = [f"{value:.4g}" for value in np.where(held, given, 0.0)]
            raise ContactError(
                f"contact: the forces ({', '.join(asked[:3])}) N and the torque {asked[3]} N mm can't be balanced: "
                f"sideways and about z they are {share:.4g} times what friction {friction:g} can carry on this surface "
                f"(allowed is less than 1 times, known to {_KNOWN_TO:g}), so that the probe slides: ask for less, push "
                "harder, raise press.friction, or hold x, y and the turn by motion"
            ) from problem_found


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
            _, found = _part(grid, memory, control, _foreseen(memory, control, start))
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
        _refuse_slide(grid, memory)
        try:
            memory, found = _advance(grid, memory, now, _went_on(before, previous), control)
            before, previous = previous, found
        except NotSettled as stopped:
            if part == 1 or previous is None:
                raise
            return memory, previous, f"stopped after {part - 1} of {increments} parts: {stopped}"
        except ContactError as refused:
            _explain(grid, memory, control, refused, least=1.0 - _KNOWN_TO)
            raise
    _refuse_slide(grid, memory)
    assert previous is not None, "a step has at least one part"
    return with_trend(memory), previous, ""


def _refuse_slide(grid: FrictionGrid, memory: Memory) -> None:
    """Raise a ContactError when the probe slid, or was lifted over, to where there are no patches."""
    for (setting, _, _), patches, moved in zip(grid.contacts.rows, grid.contacts.grids, memory.slid_mm, strict=True):
        slid = float(np.hypot(*moved))
        if setting.face is None:
            under = (patches.centre_mm - setting.first.axis_mm) @ setting.first.axes[:Z].T - moved
            off, allowed = float(np.hypot(*under.T).min()), 4.0 * float(patches.half_mm.max())
            what = "beyond the patches, which lie around where it touched first"
        else:
            off, allowed = slid, SLIDE_LIMIT * 2 * min(half_extent(setting.face))
            what = "as a whole, while the patches under a flat face stay where they are"
        if off > allowed:
            raise ContactError(
                f"contact: the {setting.probe.kind} slides (or is lifted) by {slid:.3g} mm, {what} (off by {off:.3g} "
                f"mm, allowed {allowed:.3g} mm): move it less, raise press.friction, or press it anew where it ends"
            )
