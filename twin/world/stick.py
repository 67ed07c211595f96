"""Sticking contact: what touches the probe is carried along by it, from where it touched, until it lets go.

The path matters, so patches stay where they are on the body for the whole path and remember where they touched. A
patch that has touched moves with the probe in all three directions; the gap of one that has not is the exact one for
the probe's motion along z, while sideways the surface near a stuck probe goes along with it and the gap changes only
by the slope of the surface. When a step brings new patches into contact it is taken in `INCREMENTS` parts, and every
part is solved twice: once with the new patches free to slide, which shows how far they would, and once with each of
them held from the moment at which it touched. A patch that is pulled off and pushed back within a part touches anew:
it sticks from the part's end. With 8 parts the force of a stuck sphere at nu = 0.3 is within 0.05 %
of many parts, and the sideways motion under a force that grows obliquely within 2 % of the closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError
from twin.parts.press import Sphere
from twin.world.gap import TURN, X, Y, Z
from twin.world.patches import Patches
from twin.world.region import Control, Setting, carried, local_compliance
from twin.world.unilateral import Equilibrium, Unilateral, solve

INCREMENTS = 8


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Where each patch touched.

    Attributes
    ----------
    touched
        (k,) patches in contact.
    closed_mm
        (k,) gap of those at place 0, had they always moved with the probe.
    offset_mm
        (k, 2) tangential displacement of those at place 0, likewise.
    place
        (4,) the probe's place.
    total
        (4,) the force and torque on it.
    displacement_mm
        (k, 3) displacements of the patches, in their frames.
    """

    touched: Bools
    closed_mm: Floats
    offset_mm: Floats
    place: Floats
    total: Floats
    displacement_mm: Floats


@dataclass(frozen=True, kw_only=True)
class StuckGrid:
    """Patches, and what of them stays the same along the path."""

    setting: Setting
    patches: Patches
    compliance: Floats
    carried: Floats

    def gap(self, memory: Memory, place: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps and (k, 4) slopes at a place."""
        along_z = np.array([0.0, 0.0, place[Z], 0.0])
        gap, slope = self.setting.first.gap(self.patches.centre_mm, self.patches.frames[:, 2], along_z)
        normal = self.carried[:, 2]
        sideways = [X, Y, TURN]
        slope[:, sideways] = -normal[:, sideways]
        gap = gap - normal[:, sideways] @ place[sideways]
        stuck = memory.touched
        gap[stuck] = memory.closed_mm[stuck] - normal[stuck] @ place
        slope[stuck] = -normal[stuck]
        return gap, slope


def stuck_grid(setting: Setting, patches: Patches) -> StuckGrid:
    """Prepare patches for a path."""
    return StuckGrid(
        setting=setting, patches=patches, compliance=local_compliance(setting, patches),
        carried=carried(setting, patches, np.zeros(2)),
    )  # fmt: skip


def at_first_touch(grid: StuckGrid) -> Memory:
    """Return the memory of a probe that just touches: patches under a flat face on a flat body stick at once."""
    k = len(grid.patches)
    nothing = Memory(
        touched=np.zeros(k, bool), closed_mm=np.zeros(k), offset_mm=np.zeros((k, 2)), place=np.zeros(4),
        total=np.zeros(4), displacement_mm=np.zeros((k, 3)),
    )  # fmt: skip
    gap, _ = grid.gap(nothing, nothing.place)
    return replace(nothing, touched=gap <= 1e-9, closed_mm=np.where(gap <= 1e-9, gap, 0.0))


def let_go(memory: Memory, place: Floats) -> Memory:
    """Return the memory of a probe that has been lifted off."""
    return replace(
        memory, touched=np.zeros_like(memory.touched), place=place, total=np.zeros(4),
        displacement_mm=np.zeros_like(memory.displacement_mm),
    )  # fmt: skip


def _part(
    grid: StuckGrid, memory: Memory, control: Control, guess: Bools | None, held: Bools | None = None
) -> Equilibrium:
    """Solve one part; patches in ``held`` are carried along although they had not touched before it."""
    fresh = not memory.touched.any()
    if fresh and memory.place[:2].any() | memory.place[TURN].any():
        # After a lift the probe touches anew where it now is: its motion sideways counts from there.
        memory = replace(memory, offset_mm=-np.einsum("kad,d->ka", grid.carried[:, :2], _sideways(memory.place)))
    problem = Unilateral(
        compliance=grid.compliance, gap=lambda q: grid.gap(memory, q), carried=grid.carried,
        by_force=control.by_force, given=control.given,
        sticking=memory.touched | fresh | (False if held is None else held), offset=memory.offset_mm,
    )  # fmt: skip
    place = np.where(control.by_force, memory.place, control.given)
    active = guess if guess is not None else memory.touched.copy()
    if not active.any():
        gap, _ = grid.gap(memory, place)
        active = gap <= np.sort(gap)[min(4, len(gap) - 1)]
    return solve(problem, active, place)


def _sideways(place: Floats) -> Floats:
    still = place.copy()
    still[Z] = 0.0
    return still


def _remember(grid: StuckGrid, memory: Memory, found: Equilibrium) -> Memory:
    new = found.active & (~memory.touched | found.let_go)
    moved = np.einsum("kad,d->ka", grid.carried, found.place)
    away = found.displacement_mm - moved
    return Memory(
        touched=found.active.copy(),
        closed_mm=np.where(new, -away[:, 2], memory.closed_mm),
        offset_mm=np.where(new[:, None], away[:, :2], memory.offset_mm),
        place=found.place.copy(),
        total=found.total.copy(),
        displacement_mm=found.displacement_mm.copy(),
    )


def _held_on_the_way(grid: StuckGrid, memory: Memory, free: Equilibrium, new: Bools) -> Memory:
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
    normal = grid.compliance[:, 2, :, 2]
    relief = np.linalg.solve(normal[np.ix_(old, old)], normal[np.ix_(old, new)])
    overlap = (normal[np.ix_(new, new)] - normal[np.ix_(new, old)] @ relief) @ free.force_n[new, 2]
    met = np.isfinite(gap)
    share = np.where(met, np.where(met, gap, 0.0) / np.maximum(gap + np.maximum(overlap, 0.0), 1e-300), 1.0)
    tangential = grid.carried[new, :2]
    start = memory.displacement_mm[new, :2] - tangential @ memory.place
    end = free.displacement_mm[new, :2] - tangential @ free.place
    offset = memory.offset_mm.copy()
    offset[new] = start + share[:, None] * (end - start)
    return replace(memory, offset_mm=offset)


def take_step(
    grid: StuckGrid, memory: Memory, control: Control, increments: int = INCREMENTS
) -> tuple[Memory, Equilibrium]:
    """Take one step of the path.

    Parameters
    ----------
    grid, memory
        The patches, and where they touched so far.
    control
        What holds the probe at the end of the step.
    increments
        Parts of a step that brings new patches into contact.

    Raises
    ------
    ContactError
        A part has no equilibrium.
    """
    if memory.touched.any():
        try:
            found = _part(grid, memory, control, None)
        except ContactError:
            pass  # a large step may fail where its parts succeed
        else:
            if not np.any(found.active & ~memory.touched | found.let_go):
                return _remember(grid, memory, found), found
    start = np.where(control.by_force, memory.total, memory.place)
    powers = np.ones(4)
    if isinstance(grid.setting.probe, Sphere) and memory.touched.sum() <= 1:
        # Equal parts of the contact radius: the force grows with its cube, the motion with its square.
        powers = np.where(control.by_force, 3.0, 2.0)
    for part in range(1, increments + 1):
        share = (part / increments) ** powers
        now = Control(by_force=control.by_force, given=start + share * (control.given - start))
        found = _part(grid, memory, now, None if part == 1 else found.active)
        new = found.active & ~memory.touched
        if memory.touched.any() and new.any():
            memory = _held_on_the_way(grid, memory, found, new)
            found = _part(grid, memory, now, found.active, held=new)
        memory = _remember(grid, memory, found)
    return memory, found
