"""Rigid probes press a body along a path: from the press's description to forces on the surface.

Without friction every state depends on the probes' places alone, so each step gets grids of its own under them. With
friction the history counts and one grid serves the whole path (`twin.world.contact.rubbing`). The unilateral problem
itself is in `twin.world.contact.unilateral`, with Coulomb's friction in `twin.world.contact.coulomb`, the probe's shape
in `twin.world.contact.probe_shape`, its first touch in `twin.world.contact.approach`, its gaps in
`twin.world.contact.gap`, the patches in `twin.world.contact.patches`.

Validity: linear elasticity, small turns and slopes; forces act along the normals of the undeformed surface. Every state
says how far it strains that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, InputError, NotSettled
from twin.parts.accuracy import INCREMENTS
from twin.parts.body import Body
from twin.parts.press import Press
from twin.parts.probe import Cylinder, Sphere
from twin.world.contact.approach import approach_of, meeting
from twin.world.contact.cells import Box
from twin.world.contact.contact_state import ContactState, lifted_state, touching_state
from twin.world.contact.gap import MOTIONS, Approach, Z, outline
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
from twin.world.contact.region import (
    check_inside,
    fills,
    find_contact,
    fitted_grids,
    known_contact,
    solve_frictionless,
)
from twin.world.contact.rubbing import rubbing_path
from twin.world.contact.together import (
    Contacts,
    Control,
    Setting,
    SurfaceCompliance,
    all_controls,
    of_one,
    touch_at,
    touch_z_at,
)
from twin.world.contact.unilateral import Equilibrium

__all__ = ["ContactState", "SurfaceCompliance", "press"]

_ACROSS_RANGE = (6, 40)

LEAST_N = 1e-9
"""Least force that presses: under less the gaps are lost in the round-off of the patches' places."""


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
        There is no equilibrium, contact runs over the edge, a probe sinks in, or the first step does not converge. Its
        ``last_state`` is the state before the step that was refused, if there is one.
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
    job = Job(
        settings=settings, friction=np.array([one.friction for one in presses]), steps=_controls(presses, settings)
    )
    states, reason = _solved(job, increments)
    state = replace(states[-1], path=tuple(states), complete=not reason, reason=reason)
    if with_error and state.complete:
        from twin.world.contact.patch_error import patch_error

        wider = tuple(replace(setting, across=max(low, patches_across // 2)) for setting in settings)
        coarse = _solved(replace(job, settings=wider), increments)
        state = replace(state, error=patch_error(state, coarse[0][-1]))
    return state


def _solved(job: Job, increments: int) -> tuple[list[ContactState], str]:
    return _frictionless_path(job) if not any(job.friction.tolist()) else rubbing_path(job, increments)


def _controls(presses: tuple[Press, ...], settings: tuple[Setting, ...]) -> tuple[Control, ...]:
    """Return every step's control; ``given`` holds motions since the step before, not places yet."""
    try:
        found = [one.in_own_axes(setting.first.axes) for one, setting in zip(presses, settings, strict=True)]
    except ValueError as problem:
        raise InputError(f"press: {problem}") from None
    for steps in found:
        for number, (by_force, given) in enumerate(steps, start=1):
            if by_force[Z] and given[Z] < LEAST_N and given[Z] != 0.0:
                raise InputError(
                    f"press: step {number} asks for a normal force of {given[Z]:g} N; allowed is 0 (lift off), or "
                    f"{LEAST_N:g} N or more, as a probe can't pull, and feels nothing under less"
                )
    return tuple(
        all_controls([Control(by_force=np.array(by_force), given=np.array(given)) for by_force, given in step])
        for step in zip(*found, strict=True)
    )


def _refuse_overhang(setting: Setting) -> None:
    """Raise a ContactError where a flat face is bound to run over the edge of a flat surface."""
    first = setting.first
    if first.level:
        return
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


def _frictionless_path(job: Job) -> tuple[list[ContactState], str]:
    """Take the whole path; return the states, and why it stopped before its end, if it did."""
    place, path = np.zeros(MOTIONS * len(job.settings)), list[ContactState]()
    for count, step in enumerate(job.steps, start=1):
        try:
            state, place = _frictionless_step(job, counted_from(step, place), place)
        except NotSettled as stopped:
            if not path:
                raise
            return path, stopped_at(count, job, str(stopped))
        except ContactError as refused:
            keep_states(refused, path, count, job)
            raise
        path.append(state)
    return path, ""


def _frictionless_step(job: Job, control: Control, place: Floats) -> tuple[ContactState, Floats]:
    """Return the state at the end of a step, and the probes' places."""
    places = list(place.reshape(-1, MOTIONS))
    states: list[ContactState | None] = [None] * len(job.settings)
    touching, starts, planes, touch_z = [], [], [], []
    for number, setting in enumerate(job.settings):
        own = of_probe(control, number)
        plane, z = touch_at(setting, np.where(own.by_force, places[number], own.given))
        if is_lifted(own, z):
            refuse_forces_on_nothing(own)
            places[number] = lifted_place(own, places[number], z)
            states[number] = lifted_state(setting, places[number])
            continue
        touching.append(number)
        starts.append(places[number])
        planes.append(plane)
        touch_z.append(z)
    if touching:
        settings = tuple(job.settings[number] for number in touching)
        controls = [of_probe(control, number) for number in touching]
        contacts, found = _frictionless(settings, controls, starts, planes, touch_z)
        for each, (number, (setting, rows, motions)) in enumerate(zip(touching, contacts.rows, strict=True)):
            own_found = of_one(found, rows, motions)
            places[number] = own_found.place
            states[number] = touching_state(
                setting, contacts.grids[each], own_found, touch_z_mm=touch_z_at(setting, own_found.place),
                friction=0.0, slope=contacts.gap_under(each, own_found.place)[1],
            )  # fmt: skip
    return together([state for state in states if state is not None]), np.concatenate(places)


def _frictionless(
    settings: tuple[Setting, ...], controls: list[Control], places: list[Floats], planes: list[Plane],
    touch_z: list[float],
) -> tuple[Contacts, Equilibrium]:  # fmt: skip
    """Find the contacts, cut the grids that fit them, and solve on these; a grid grows while its border is reached."""
    boxes, said = [], dict[int, Box]()
    for number, setting in enumerate(settings):
        own, start, z = controls[number], places[number], touch_z[number]
        disc = known_contact(setting, own, start, planes[number], z)
        planes[number], box, places[number] = (
            (planes[number], *disc) if disc else find_contact(setting, own, start, planes[number], z)
        )
        boxes.append(box)
        if disc is not None:
            said[number] = box
    control, place = all_controls(controls), np.concatenate(places)
    for _ in range(TRIES):
        contacts = Contacts(settings, fitted_grids(settings, planes, boxes))
        found = solve_frictionless(contacts, control, place, np.array(touch_z))
        place = found.place
        for (setting, rows, motions), grid, z in zip(contacts.rows, contacts.grids, touch_z, strict=True):
            check_inside(setting, grid, of_one(found, rows, motions), float(place[motions][Z]) - z)
        missed = [
            number for number, (_, rows, _) in enumerate(contacts.rows)
            if number in said and not (found.active[rows].any()
                                       and fills(contacts.grids[number].bounds(found.active[rows]), said[number]))
        ]  # fmt: skip
        for number in missed:
            motions = slice(MOTIONS * number, MOTIONS * (number + 1))
            planes[number], boxes[number], place[motions] = find_contact(
                settings[number], controls[number], place[motions], planes[number], touch_z[number]
            )
            del said[number]
        if not outgrown(boxes, contacts, found.active) and not missed:
            refuse_overlap(contacts, found)
            return contacts, found
    raise no_grid(settings[0], boxes[0])
