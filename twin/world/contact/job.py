"""Presses that are solved together along one path, and what paths with and without friction share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError
from twin.world.contact.cells import Box
from twin.world.contact.contact_state import ContactState
from twin.world.contact.gap import ABOUT_X, MOTIONS, Z
from twin.world.contact.together import Contacts, Control, Setting
from twin.world.contact.unilateral import Equilibrium

TRIES = 8
"""How often grids that contact outgrows are made larger."""

_OVERLAP = 0.02
"""How far a patch may lie inside another probe, over the indentation: it is as wide as a patch is."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Presses that are solved together: every probe, its friction, and its control in every step, in its own axes."""

    settings: tuple[Setting, ...]
    friction: Floats
    steps: tuple[Control, ...]

    @property
    def everyone(self) -> range:
        return range(len(self.settings))


def counted_from(control: Control, place: Floats) -> Control:
    """Return a step's control with its motions counted from a place."""
    return Control(by_force=control.by_force, given=np.where(control.by_force, control.given, place + control.given))


def of_probe(control: Control, number: int) -> Control:
    motions = slice(MOTIONS * number, MOTIONS * (number + 1))
    return Control(by_force=control.by_force[motions], given=control.given[motions])


def is_lifted(control: Control, touch_z: float) -> bool:
    return bool(control.given[Z] <= (0.0 if control.by_force[Z] else touch_z + 1e-12))


def refuse_forces_on_nothing(control: Control) -> None:
    """Raise a ContactError when a lateral force or a torque is asked of a probe that touches nothing."""
    asked = np.where(control.by_force, control.given, 0.0)
    if asked.any():
        torque = f"{asked[-1]:g}" if not asked[ABOUT_X:-1].any() else ", ".join(f"{t:g}" for t in asked[ABOUT_X:])
        raise ContactError(
            f"contact: force ({', '.join(f'{f:g}' for f in asked[: Z + 1])}) N and torque {torque} N mm are asked of "
            "a probe that touches nothing at the end of the step: push along z as well"
        )


def lifted_place(control: Control, place: Floats, touch_z: float) -> Floats:
    moved = np.where(control.by_force, place, control.given)
    if control.by_force[Z]:
        moved[Z] = touch_z
    return moved


def together(states: list[ContactState]) -> ContactState:
    """Return the first probe's state with the load of all, and the other probes' states in it."""
    first, *others = states
    if not others:
        return first
    return replace(first, load=sum((other.load for other in others), first.load), also=tuple(others))


def stopped_at(count: int, job: Job, why: str) -> str:
    return f"step {count} of {len(job.steps)} did not converge, the last state that did is kept; {why}"


def keep_states(refused: ContactError, path: list[ContactState], count: int, job: Job) -> None:
    """Give an error the last state before the step that it refuses, as far as there is one."""
    if path:
        reason = f"step {count} of {len(job.steps)} was refused, the state before it is kept; {refused}"
        refused.last_state = replace(path[-1], path=tuple(path), complete=False, reason=reason)


def refuse_overlap(contacts: Contacts, found: Equilibrium) -> None:
    """Raise a ContactError where one probe's patch would lie inside another probe."""
    for number, (setting, _, motions) in enumerate(contacts.rows):
        for other, (_, rows, _) in enumerate(contacts.rows):
            active = found.active[rows]
            if other == number or not active.any():
                continue
            grid = contacts.grids[other]
            gap, _ = setting.first.gap(grid.centre_mm[active], grid.frames[active, 2], found.place[motions])
            sunk = found.displacement_mm[rows][active, 2]
            worst = int(np.argmin(gap + sunk))
            if gap[worst] + sunk[worst] < -_OVERLAP * float(np.abs(sunk).max()):
                place = ", ".join(f"{c:.3g}" for c in grid.centre_mm[active][worst])
                raise ContactError(
                    f"contact: the {setting.name} and the {contacts.settings[other].name} press on the same place of "
                    f"the surface, near ({place}) mm: move them apart, or press one after the other"
                )


def outgrown(boxes: list[Box], contacts: Contacts, reached: Bools) -> bool:
    """Make those of the contacts' boxes larger whose patches (k,) were ``reached`` up to the border; whether any was.

    By a tenth: where such a contact ends is not known yet.
    """
    grew = False
    for number, (_, rows, _) in enumerate(contacts.rows):
        grid, own = contacts.grids[number], reached[rows]
        if (own & grid.border).any():
            both = boxes[number].joined(grid.bounds(own))
            boxes[number], grew = both.grown(0.05 * both.size[0], 0.05 * both.size[1]), True
    return grew


def no_grid(setting: Setting, contact: Box) -> ContactError:
    return ContactError(
        f"contact: it keeps growing beyond the grid ({contact.size[0]:.3g} by {contact.size[1]:.3g} mm under the "
        f"{setting.probe.kind}): press with less force, or hold the probe by motion"
    )
