"""Rigid probes press a body along a path: from the press's description to forces on the surface.

Without friction every state depends on the probes' places alone, so each step gets grids of its own under them. With
friction the history counts and one grid serves the whole path (`twin.world.friction`). The unilateral problem itself is
in `twin.world.unilateral`, with Coulomb's friction in `twin.world.coulomb`, the probe's shape in
`twin.world.probe_shape`, its place in `twin.world.gap`, the patches in `twin.world.patches`.

Validity: linear elasticity, small turns and slopes; forces act along the normals of the undeformed surface. Every state
says how far it strains that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, InputError, NotSettled
from twin.parts.body import Body
from twin.parts.press import Press
from twin.parts.probe import Cylinder, Sphere
from twin.world.contact_state import ContactState, lifted_state, touching_state
from twin.world.friction import INCREMENTS, take_step
from twin.world.friction_grid import FrictionGrid, Memory, at_first_touch, let_go
from twin.world.gap import ABOUT_X, ABOUT_Y, MOTIONS, Approach, X, Y, Z, approach_of, meeting, outline
from twin.world.patches import Box, Plane
from twin.world.region import check_inside, find_contact, fitted_patches, solve_frictionless
from twin.world.together import Contacts, Control, Setting, SurfaceCompliance, all_controls, of_one, touch_at
from twin.world.unilateral import Equilibrium

__all__ = ["ContactState", "SurfaceCompliance", "press"]

_ACROSS_RANGE = (6, 40)
_TRIES = 8
_SLIDE_WIDTHS = 1.0
_OVERLAP = 0.02
"""How far a patch may lie inside another probe, over the indentation: it is as wide as a patch is."""


@dataclass(frozen=True, kw_only=True)
class _Job:
    """Presses that are solved together: every probe, its friction, and its control in every step, in its own axes."""

    settings: tuple[Setting, ...]
    friction: Floats
    steps: tuple[Control, ...]

    @property
    def everyone(self) -> range:
        return range(len(self.settings))


def press(
    press: Press,
    body: Body,
    compliance: SurfaceCompliance,
    *,
    patches_across: int = 16,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
    increments: int = INCREMENTS,
    with_error: bool = False,
) -> ContactState:
    """Press rigid probes on a body along a path.

    Parameters
    ----------
    press
        Probe, place, path and friction, and those of further probes.
    body
        The undeformed body.
    compliance
        How its surface moves under forces on patches.
    patches_across
        Contact patches across each contact.
    youngs_modulus_mpa, poisson_ratio
        Of the body; only for the first guess of the contact's size and for the validity report.
    increments
        With friction: parts of a step in which patches touch or slip.
    with_error
        Whether to press once more on patches twice as wide, to tell how far these may be off.

    Returns
    -------
    The state at the end of the path; its ``path`` holds the states at the end of every step. Where a step after the
    first doesn't converge, the last state that did, its ``complete`` false and its ``reason`` said.

    Raises
    ------
    InputError
        A probe misses the body, a normal force pulls, or the number of patches is out of range.
    ContactError
        There is no equilibrium, contact runs over the edge, a probe sinks in, or the first step does not converge.
    """
    low, high = _ACROSS_RANGE
    if not low <= patches_across <= high:
        raise InputError(f"contact: {patches_across} patches across the contact; allowed are {low} to {high}")
    presses = (press, *press.also)
    settings = tuple(
        Setting(
            body=body, compliance=compliance, first=approach_of(one, body), across=patches_across,
            youngs_modulus_mpa=youngs_modulus_mpa, poisson_ratio=poisson_ratio,
        )
        for one in presses
    )  # fmt: skip
    for number, setting in enumerate(settings):
        _refuse_overhang(setting)
        for other in settings[:number]:
            _refuse_crossing(setting.first, other.first)
    job = _Job(
        settings=settings, friction=np.array([one.friction for one in presses]), steps=_controls(presses, settings)
    )
    states, reason = _solved(job, increments)
    state = replace(states[-1], path=tuple(states), complete=not reason, reason=reason)
    if with_error and state.complete:
        from twin.world.patch_error import patch_error

        wider = tuple(replace(setting, across=max(low, patches_across // 2)) for setting in settings)
        coarse = _solved(replace(job, settings=wider), increments)
        state = replace(state, error=patch_error(state, coarse[0][-1]))
    return state


def _solved(job: _Job, increments: int) -> tuple[list[ContactState], str]:
    return _frictionless_path(job) if not job.friction.any() else _rubbing_path(job, increments)


def _controls(presses: tuple[Press, ...], settings: tuple[Setting, ...]) -> tuple[Control, ...]:
    """Return every step's control; ``given`` holds motions since the step before, not places yet."""
    try:
        found = [one.in_own_axes(setting.first.axes) for one, setting in zip(presses, settings, strict=True)]
    except ValueError as problem:
        raise InputError(f"press: {problem}") from None
    for steps in found:
        for number, (by_force, given) in enumerate(steps, start=1):
            if by_force[Z] and given[Z] < 0.0:
                raise InputError(
                    f"press: step {number} asks for a normal force of {given[Z]:g} N; allowed is 0 (lift off) or "
                    "more, as a probe can't pull"
                )
    return tuple(
        all_controls([Control(by_force=np.array(by_force), given=np.array(given)) for by_force, given in step])
        for step in zip(*found, strict=True)
    )


def _refuse_overhang(setting: Setting) -> None:
    """Raise a ContactError where a flat face is bound to run over the edge of a flat surface."""
    first = setting.first
    under = first.axis_mm + outline(setting.probe) @ first.axes[:Z]
    if not len(under) or first.axes[2, 2] != 1.0 or any(first.tilt_deg):
        return
    height, _ = meeting(setting.body, first.axes[2])(under)
    missing = np.isnan(height)
    if missing.any() and not np.any(np.abs(height[~missing]) > 1e-12):  # met all round at once: the surface is flat
        raise ContactError(
            f"contact: the {setting.name} stands out over the edge of the sensing surface: "
            "press further inside, or with a smaller probe"
        )


def _refuse_crossing(one: Approach, other: Approach) -> None:
    """Raise an InputError where two spheres, or two cylinders side by side, would stand inside each other."""
    away = one.axis_mm - other.axis_mm
    if isinstance(one.probe, Sphere) and isinstance(other.probe, Sphere):
        away = away - one.axes[2] * one.probe.diameter_mm / 2 + other.axes[2] * other.probe.diameter_mm / 2
    elif isinstance(one.probe, Cylinder) and isinstance(other.probe, Cylinder) and one.axes[2] @ other.axes[2] > 0.999:
        away = away - (away @ one.axes[2]) * one.axes[2]
    else:
        return
    apart, least = float(np.linalg.norm(away)), (one.probe.diameter_mm + other.probe.diameter_mm) / 2
    if apart < least:
        raise InputError(
            f"press: the {one.probe.kind}s at ({', '.join(f'{c:.3g}' for c in other.axis_mm)}) and "
            f"({', '.join(f'{c:.3g}' for c in one.axis_mm)}) mm are {apart:.3g} mm apart, less than the {least:.3g} mm "
            "at which they touch each other: move them apart, or take smaller ones"
        )


def _from(control: Control, place: Floats) -> Control:
    """Return a step's control with its motions counted from a place."""
    return replace(control, given=np.where(control.by_force, control.given, place + control.given))


def _of(control: Control, number: int) -> Control:
    motions = slice(MOTIONS * number, MOTIONS * (number + 1))
    return Control(by_force=control.by_force[motions], given=control.given[motions])


def _lifted(control: Control, touch_z: float) -> bool:
    return bool(control.given[Z] <= (0.0 if control.by_force[Z] else touch_z + 1e-12))


def _asks_nothing(control: Control) -> None:
    """Raise a ContactError when a lateral force or a torque is asked of a probe that touches nothing."""
    asked = np.where(control.by_force, control.given, 0.0)
    if asked.any():
        torque = f"{asked[-1]:g}" if not asked[ABOUT_X:-1].any() else ", ".join(f"{t:g}" for t in asked[ABOUT_X:])
        raise ContactError(
            f"contact: force ({', '.join(f'{f:g}' for f in asked[: Z + 1])}) N and torque {torque} N mm are asked of "
            "a probe that touches nothing at the end of the step: push along z as well"
        )


def _lifted_place(control: Control, place: Floats, touch_z: float) -> Floats:
    moved = np.where(control.by_force, place, control.given)
    if control.by_force[Z]:
        moved[Z] = touch_z
    return moved


def _together(states: list[ContactState]) -> ContactState:
    """Return the first probe's state with the load of all, and the other probes' states in it."""
    first, *others = states
    if not others:
        return first
    return replace(first, load=sum((other.load for other in others), first.load), also=tuple(others))


def _frictionless_path(job: _Job) -> tuple[list[ContactState], str]:
    """Take the whole path; return the states, and why it stopped before its end, if it did."""
    place, path = np.zeros(MOTIONS * len(job.settings)), list[ContactState]()
    for count, step in enumerate(job.steps, start=1):
        try:
            state, place = _frictionless_step(job, _from(step, place), place)
        except NotSettled as stopped:
            if not path:
                raise
            return path, _stopped(count, job, str(stopped))
        path.append(state)
    return path, ""


def _stopped(count: int, job: _Job, why: str) -> str:
    return f"step {count} of {len(job.steps)} did not converge, the last state that did is kept; {why}"


def _frictionless_step(job: _Job, control: Control, place: Floats) -> tuple[ContactState, Floats]:
    """Return the state at the end of a step, and the probes' places."""
    places = list(place.reshape(-1, MOTIONS))
    states: list[ContactState | None] = [None] * len(job.settings)
    touching, starts, planes, touch_z = [], [], [], []
    for number, setting in enumerate(job.settings):
        own = _of(control, number)
        plane, z = touch_at(setting, np.where(own.by_force, places[number], own.given))
        if _lifted(own, z):
            _asks_nothing(own)
            places[number] = _lifted_place(own, places[number], z)
            states[number] = lifted_state(setting, places[number])
            continue
        touching.append(number)
        starts.append(places[number])
        planes.append(plane)
        touch_z.append(z)
    if touching:
        settings = tuple(job.settings[number] for number in touching)
        controls = [_of(control, number) for number in touching]
        contacts, found = _frictionless(settings, controls, starts, planes, touch_z)
        for number, (setting, rows, motions), grid in zip(touching, contacts.rows, contacts.grids, strict=True):
            own_found = of_one(found, rows, motions)
            places[number] = own_found.place
            states[number] = touching_state(
                setting, grid, own_found, touch_z_mm=touch_at(setting, own_found.place)[1], friction=0.0
            )
    return _together([state for state in states if state is not None]), np.concatenate(places)


def _frictionless(
    settings: tuple[Setting, ...], controls: list[Control], places: list[Floats], planes: list[Plane],
    touch_z: list[float],
) -> tuple[Contacts, Equilibrium]:  # fmt: skip
    """Find the contacts, cut the grids that fit them, and solve on these; a grid grows while its border is reached."""
    boxes = []
    for number, setting in enumerate(settings):
        box, places[number] = find_contact(setting, controls[number], places[number], planes[number], touch_z[number])
        boxes.append(box)
    control, place = all_controls(controls), np.concatenate(places)
    for _ in range(_TRIES):
        contacts = Contacts(settings, tuple(map(fitted_patches, settings, planes, boxes)))
        found = solve_frictionless(contacts, control, place, np.array(touch_z))
        place = found.place
        grew = False
        for number, (setting, rows, motions) in enumerate(contacts.rows):
            grid, active = contacts.grids[number], found.active[rows]
            if np.any(active & grid.border):
                boxes[number], grew = _enlarged(boxes[number], grid.bounds(active)), True
            check_inside(setting, grid, of_one(found, rows, motions), float(place[motions][Z]) - touch_z[number])
        if not grew:
            _refuse_overlap(contacts, found)
            return contacts, found
    raise _no_grid(settings[0], boxes[0])


def _refuse_overlap(contacts: Contacts, found: Equilibrium) -> None:
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


def _enlarged(contact: Box, reached: Box) -> Box:
    """Return the box of a contact that reached its grid's border, a tenth larger: where it ends is not known yet."""
    both = contact.joined(reached)
    return both.grown(0.05 * both.size[0], 0.05 * both.size[1])


def _no_grid(setting: Setting, contact: Box) -> ContactError:
    return ContactError(
        f"contact: it keeps growing beyond the grid ({contact.size[0]:.3g} by {contact.size[1]:.3g} mm under the "
        f"{setting.probe.kind}): press with less force, or hold the probe by motion"
    )


def _largest_contact(job: _Job, number: int, plane: Plane, touch_z: float) -> Box:
    """Return the box that holds one probe's contact of every step, pressed without friction, where it slides to.

    A probe with friction on a slope carries part of a force along z by friction: its normal force is F n_z, for which a
    frictionless one that is held sideways needs F n_z^2 along z.
    """
    setting, friction = job.settings[number], float(job.friction[number])
    place, whole, sideways = np.zeros(MOTIONS), None, np.zeros(2)
    along_z = np.arange(MOTIONS) == Z
    upright = float(plane.axes[2] @ setting.first.axes[2])
    for step, following in zip_longest(job.steps, job.steps[1:]):
        if following is not None and _outdone(_of(step, number), _of(following, number)):
            continue
        control = _from(_of(step, number), place)
        sideways += np.where(control.by_force, 0.0, _of(step, number).given)[:Z]
        push = control.given[Z] * (upright**2 if control.by_force[Z] else 1.0)
        turned = np.where(control.by_force, 0.0, control.given) * np.isin(np.arange(MOTIONS), (ABOUT_X, ABOUT_Y))
        still = Control(by_force=control.by_force & along_z, given=np.where(along_z, push, turned))
        if _lifted(still, touch_z):
            place = _lifted_place(still, place, touch_z)
            continue
        contact, place = find_contact(setting, still, place, plane, touch_z)
        grip_mm = friction * (float(place[Z]) - touch_z)
        contact = contact.joined(_slid(setting, contact, sideways, grip_mm, plane))
        whole = contact if whole is None else whole.joined(contact)
    assert whole is not None, "the first step of a press pushes"
    return whole


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


def _rubbing_path(job: _Job, increments: int) -> tuple[list[ContactState], str]:
    planes, boxes = [], []
    for number, setting in enumerate(job.settings):
        plane, touch_z = touch_at(setting, np.zeros(MOTIONS))
        planes.append(plane)
        boxes.append(_largest_contact(job, number, plane, touch_z))
    for _ in range(_TRIES):
        contacts = Contacts(job.settings, tuple(map(fitted_patches, job.settings, planes, boxes)))
        states, reached, reason = _rubbing_on(FrictionGrid(contacts, job.friction), job, increments)
        grew = False
        for number, (_, rows, _) in enumerate(contacts.rows):
            grid, own = contacts.grids[number], reached[rows]
            if np.any(own & grid.border):
                boxes[number], grew = _enlarged(boxes[number], grid.bounds(own)), True
        if not grew:
            return states, reason
    raise _no_grid(job.settings[0], boxes[0])


def _rubbing_on(grid: FrictionGrid, job: _Job, increments: int) -> tuple[list[ContactState], np.ndarray, str]:
    """Take the whole path on given patches; return the states, which patches were ever in contact, and why it stopped
    before its end, if it did."""
    contacts = grid.contacts
    memory = at_first_touch(grid)
    path: list[ContactState] = []
    reached = np.zeros(len(grid.patches), bool)
    for count, step in enumerate(job.steps, start=1):
        control = _from(step, memory.place)
        lifted = np.array([_lifted_by_force(_of(control, number)) for number in job.everyone])
        places = memory.place.reshape(-1, MOTIONS).copy()
        for number in np.flatnonzero(lifted).tolist():
            own = _of(control, number)
            _asks_nothing(own)
            places[number] = _lifted_place(own, places[number], 0.0)
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
            try:
                memory, found, stopped = take_step(grid, memory, control, increments)
            except NotSettled as unsettled:
                if not path:
                    raise
                return path, reached, _stopped(count, job, str(unsettled))
            reached |= found.active
            _refuse_overlap(contacts, found)
            apart = np.array([not found.active[rows].any() for _, rows, _ in contacts.rows])
            if apart.any():
                memory = let_go(grid, memory, apart)
            lifted = lifted | apart
        path.append(_together(_states(grid, memory, control, found, lifted)))
        if stopped:
            return path, reached, _stopped(count, job, stopped)
    return path, reached, ""


def _states(
    grid: FrictionGrid, memory: Memory, control: Control, found: Equilibrium | None, lifted: np.ndarray
) -> list[ContactState]:
    """Return the state of every probe after a step."""
    states = []
    for number, (setting, rows, motions) in enumerate(grid.contacts.rows):
        friction = float(grid.friction[number])
        if found is None or lifted[number]:
            _asks_nothing(_of(control, number))
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
        own, friction = _of(control, number), float(grid.friction[number])
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
