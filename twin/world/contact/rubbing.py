"""A path with friction: the history counts, and one grid of patches serves it all (`twin.world.contact.friction`)."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.world.contact.cells import Box
from twin.world.contact.contact_state import ContactState, lifted_state, touching_state
from twin.world.contact.friction import take_step
from twin.world.contact.friction_grid import FrictionGrid, Memory, at_first_touch, let_go
from twin.world.contact.gap import ABOUT_X, ABOUT_Y, MOTIONS, X, Y, Z
from twin.world.contact.job import (
    TRIES,
    Job,
    counted_from,
    is_lifted,
    keep_states,
    lifted_place,
    no_grid,
    of_probe,
    outgrown,
    refuse_forces_on_nothing,
    refuse_overlap,
    stopped_at,
    together,
)  # fmt: skip
from twin.world.contact.patches import Plane
from twin.world.contact.region import check_inside, find_contact, fitted_grids, known_contact
from twin.world.contact.together import Contacts, Control, Setting, of_one, touch_at
from twin.world.contact.unilateral import Equilibrium

_SLIDE_WIDTHS = 1.0


def _largest_contact(job: Job, number: int, plane: Plane, touch_z: float) -> tuple[Plane, Box]:
    """Return the plane of one probe's grid, along its first contact, and the box that holds its contact of every step.

    It is pressed without friction, where it slides to.

    A probe with friction on a slope carries part of a force along z by friction: its normal force is F n_z, for which a
    frictionless one that is held sideways needs F n_z^2 along z.
    """
    setting, friction = job.settings[number], float(job.friction[number])
    place, whole, sideways = np.zeros(MOTIONS), None, np.zeros(2)
    along_z = np.arange(MOTIONS) == Z
    upright = float(plane.axes[2] @ setting.first.axes[2])
    for step, following in zip_longest(job.steps, job.steps[1:]):
        if following is not None and _outdone(of_probe(step, number), of_probe(following, number)):
            continue
        control = counted_from(of_probe(step, number), place)
        sideways += np.where(control.by_force, 0.0, of_probe(step, number).given)[:Z]
        push = control.given[Z] * (upright**2 if control.by_force[Z] else 1.0)
        turned = np.where(control.by_force, 0.0, control.given) * np.isin(np.arange(MOTIONS), (ABOUT_X, ABOUT_Y))
        still = Control(by_force=control.by_force & along_z, given=np.where(along_z, push, turned))
        if is_lifted(still, touch_z):
            place = lifted_place(still, place, touch_z)
            continue
        disc = known_contact(setting, still, place, plane, touch_z)
        plane, contact, place = (
            (plane, *disc) if disc else find_contact(setting, still, place, plane, touch_z, may_turn=whole is None)
        )
        grip_mm = friction * (float(place[Z]) - touch_z)
        contact = contact.joined(_slid(setting, contact, sideways, grip_mm, plane))
        whole = contact if whole is None else whole.joined(contact)
    if whole is None:
        raise ContactError(
            "contact: the probe touches no patch, as its push is too small to be told from rounding; press further "
            "(press.indentation_mm, or force_n or move_mm of the steps)"
        )
    return plane, whole


def _outdone(step: Control, following: Control) -> bool:
    """Return whether the following step pushes as hard or harder at the same place, so that its contact is larger."""
    still = not any(np.where(one.by_force, 0.0, one.given).any() for one in (step, following))
    push, next_push = float(step.given[Z]), float(following.given[Z])
    return still and bool(step.by_force[Z] and following.by_force[Z]) and 0.0 < push <= next_push


def _slid(setting: Setting, contact: Box, sideways: Floats, grip_mm: float, plane: Plane) -> Box:
    """Return the box of a contact that is moved sideways and slides when it can't be strained further.

    A sphere slides once it is mu (2 - nu) / (2 (1 - nu)) of its indentation off (`twin.theory.friction`), here the
    ``grip_mm`` = mu x indentation times the rest.
    """
    grip_mm *= (2.0 - setting.poisson_ratio) / (2.0 * (1.0 - setting.poisson_ratio))
    length = float(np.hypot(*sideways))
    if setting.face is not None or length <= grip_mm:
        return contact
    slide, most = length - grip_mm, _SLIDE_WIDTHS * max(contact.size)
    if slide > most:
        raise ContactError(
            f"contact: the {setting.probe.kind} slides by about {slide:.3g} mm; allowed is {most:.3g} mm, "
            f"{_SLIDE_WIDTHS:g} times the contact's width, as one grid holds the whole path: move it "
            "less, or press it anew further on"
        )
    u, v = plane.axes[:2] @ (slide / length * sideways @ setting.first.axes[:Z])
    return Box(u0=contact.u0 + u, u1=contact.u1 + u, v0=contact.v0 + v, v1=contact.v1 + v)


def rubbing_path(job: Job, increments: int) -> tuple[list[ContactState], str]:
    """Take the whole path on one grid; return the states, and why it stopped before its end, if it did."""
    planes, boxes = [], []
    for number, setting in enumerate(job.settings):
        plane, touch_z = touch_at(setting, np.zeros(MOTIONS))
        plane, box = _largest_contact(job, number, plane, touch_z)
        planes.append(plane)
        boxes.append(box)
    for _ in range(TRIES):
        contacts = Contacts(job.settings, fitted_grids(job.settings, planes, boxes))
        states, reached, reason = _rubbing_on(FrictionGrid(contacts, job.friction), job, increments)
        if not outgrown(boxes, contacts, reached):
            return states, reason
    raise no_grid(job.settings[0], boxes[0])


def _rubbing_on(grid: FrictionGrid, job: Job, increments: int) -> tuple[list[ContactState], Bools, str]:
    """Take the whole path on given patches; return the states, which patches were ever in contact, and why it stopped
    before its end, if it did."""
    memory = at_first_touch(grid)
    path: list[ContactState] = []
    reached = np.zeros(len(grid.patches), bool)
    for count, step in enumerate(job.steps, start=1):
        try:
            memory, state, touched, stopped = _rubbing_step(grid, job, memory, count, step, increments)
        except NotSettled as unsettled:
            if not path:
                raise
            return path, reached, stopped_at(count, job, str(unsettled))
        except ContactError as refused:
            keep_states(refused, path, count, job)
            raise
        reached |= touched
        path.append(state)
        if stopped:
            return path, reached, stopped_at(count, job, stopped)
    return path, reached, ""


def _rubbing_step(
    grid: FrictionGrid, job: Job, memory: Memory, count: int, step: Control, increments: int
) -> tuple[Memory, ContactState, Bools, str]:
    """Take one step; return the state at its end, the patches in contact, and why it stopped before that, if it did."""
    control = counted_from(step, memory.place)
    lifted = np.array([_lifted_by_force(of_probe(control, number)) for number in job.everyone])
    places = memory.place.reshape(-1, MOTIONS).copy()
    for number in np.flatnonzero(lifted).tolist():
        own = of_probe(control, number)
        refuse_forces_on_nothing(own)
        places[number] = lifted_place(own, places[number], 0.0)
    memory = replace(memory, place=places.reshape(-1), lifted=lifted)
    if lifted.any():
        memory = let_go(grid, memory, lifted)
        # what is off the body is held where it is
        control = Control(
            by_force=control.by_force & ~np.repeat(lifted, MOTIONS),
            given=np.where(np.repeat(lifted, MOTIONS), memory.place, control.given),
        )
    found, stopped = None, ""
    if not lifted.all():
        _refuse_drag(grid, control, count)
        memory, found, stopped = take_step(grid, memory, control, increments)
        refuse_overlap(grid.contacts, found)
        apart = np.array([not found.active[rows].any() for _, rows, _ in grid.contacts.rows])
        if apart.any():
            memory = let_go(grid, memory, apart)
        lifted = lifted | apart
    touched = np.zeros(len(grid.patches), bool) if found is None else found.active
    return memory, together(_states(grid, memory, control, found, lifted)), touched, stopped


def _states(
    grid: FrictionGrid, memory: Memory, control: Control, found: Equilibrium | None, lifted: Bools
) -> list[ContactState]:
    """Return the state of every probe after a step."""
    states = []
    for number, (setting, rows, motions) in enumerate(grid.contacts.rows):
        friction = float(grid.friction[number])
        if found is None or lifted[number]:
            refuse_forces_on_nothing(of_probe(control, number))
            states.append(
                lifted_state(setting, memory.place[motions], friction=friction, dissipated_nmm=memory.dissipated_nmm)
            )
            continue
        patches, own, touch_z = (
            grid.contacts.grids[number],
            of_one(found, rows, motions),
            _touch_z(setting, memory, number),
        )
        check_inside(setting, patches, own, float(own.place[Z]) - touch_z)
        states.append(
            touching_state(
                setting, patches, own, touch_z_mm=touch_z, friction=friction, dissipated_nmm=memory.dissipated_nmm
            )
        )
    return states


def _lifted_by_force(control: Control) -> bool:
    return bool(control.by_force[Z] and control.given[Z] == 0.0)


def _touch_z(setting: Setting, memory: Memory, number: int) -> float:
    """Return the z of first touch where a probe slid to."""
    if not memory.slid_mm[number].any():
        return 0.0
    return touch_at(setting, np.array([*memory.slid_mm[number], *np.zeros(MOTIONS - 2)]))[1]


def _refuse_drag(grid: FrictionGrid, control: Control, count: int) -> None:
    """Raise a ContactError when a flat surface is asked for more force sideways than friction can carry."""
    for number, (setting, _, _) in enumerate(grid.contacts.rows):
        own, friction = of_probe(control, number), float(grid.friction[number])
        flat = np.all(grid.contacts.grids[number].frames[:, 2] @ setting.first.axes[2] > 1.0 - 1e-12)
        if not flat or not own.by_force[Z] or math.isinf(friction):
            continue
        asked = float(np.hypot(*np.where(own.by_force, own.given, 0.0)[[X, Y]]))
        most = friction * float(own.given[Z])
        if asked >= most > 0.0 or asked > most:
            raise ContactError(
                f"contact: step {count} asks for {asked:.6g} N sideways at {own.given[Z]:.6g} N along z; with "
                f"friction {friction:g} less than {most:.6g} N can be balanced: ask for less, push harder, raise "
                "press.friction, or hold x and y by motion"
            )
