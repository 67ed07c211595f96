"""Rigid probes press a body along a path: from the press's description to forces on the surface.

`press` checks the description and takes the path. Without friction every state depends on the
poses alone, and each step has grids of its own. With friction, or in time, one grid serves the
whole path (`twin.world.contact.load_step`); under a flat face that slides it goes along.

Validity: linear elasticity, small turns and slopes; forces act along the normals of the undeformed
surface. Every state has a measure of how far it strains that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate, zip_longest

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, InputError, NotSettled
from twin.parts.body import Body
from twin.parts.press import (
    FEWEST_PATCHES,
    INCREMENTS,
    MOST_PATCHES,
    Cone,
    Cylinder,
    Press,
    Sphere,
)
from twin.theory.relaxation import Relaxation
from twin.world.contact.active_set import Equilibrium
from twin.world.contact.contact_problem import (
    ContactHistory,
    ContactProblem,
    Control,
    FrictionalContact,
    LoadProgramme,
    ProbeSetup,
    SurfaceCompliance,
)
from twin.world.contact.contact_search import (
    closed_form_contact,
    find_contact,
    fitted_grids,
    solve_frictionless,
)
from twin.world.contact.contact_state import ContactState
from twin.world.contact.press_error import Estimates
from twin.world.contact.probe_gap import ABOUT_X, MOTIONS, TURN, Approach, X, Y, Z, half_extent
from twin.world.contact.surface_patches import Box, Plane

TRIES = 8
"""How often grids that contact outgrows are made larger."""

_OVERLAP = 0.02
"""How far a patch may lie inside another probe, over the indentation."""


def _counted_from(control: Control, pose: Floats) -> Control:
    """Return a step's control with its motions counted from a place."""
    return replace(control, given=np.where(control.by_force, control.given, pose + control.given))


def _is_lifted(control: Control, touch_z: float) -> bool:
    return bool(control.given[Z] <= (0.0 if control.by_force[Z] else touch_z + 1e-12))


def _refuse_untransmitted_forces(control: Control) -> None:
    """Raise a ContactError when a lateral force or a torque is asked of a probe that touches
    nothing."""
    asked = np.where(control.by_force, control.given, 0.0)
    if asked.any():
        whole = asked[ABOUT_X:]
        torque = ", ".join(f"{t:g}" for t in (whole if whole[:-1].any() else whole[-1:]))
        raise ContactError(
            f"contact: force ({', '.join(f'{f:g}' for f in asked[: Z + 1])}) N and torque {torque} "
            "N mm are asked of a probe that touches nothing at the end of the step: push along z "
            "as well"
        )


def _lifted_place(control: Control, pose: Floats, touch_z: float) -> Floats:
    moved = np.where(control.by_force, pose, control.given)
    if control.by_force[Z]:
        moved[Z] = touch_z
    return moved


def _combine_states(states: list[ContactState]) -> ContactState:
    """Return the first probe's state with the load of all and the other probes' states."""
    first, *others = states
    if not others:
        return first
    return replace(
        first, load=sum((other.load for other in others), first.load), also=tuple(others)
    )


def _stopped_at(programme: LoadProgramme, path: list[ContactState], why: object) -> str:
    return (
        f"step {len(path) + 1} of {len(programme.steps)} did not converge, the last state that did "
        f"is kept; {why}"
    )


def _refuse_overlap(contacts: ContactProblem, found: Equilibrium) -> None:
    """Raise a ContactError where one probe's patch would lie inside another probe."""
    for number, (setup, _, motions) in enumerate(contacts.rows):
        for other, (_, rows, _) in enumerate(contacts.rows):
            active = found.active[rows]
            if other == number or not active.any():
                continue
            grid = contacts.grids[other]
            gap, _ = setup.first.gap(
                grid.centre_mm[active], grid.frames[active, 2], found.pose[motions]
            )
            sunk = found.displacement_mm[rows][active, 2]
            worst = int(np.argmin(gap + sunk))
            if gap[worst] + sunk[worst] < -_OVERLAP * float(np.abs(sunk).max()):
                place = ", ".join(f"{c:.3g}" for c in grid.centre_mm[active][worst])
                raise ContactError(
                    f"contact: the {setup.name} and the {contacts.setups[other].name} press on the "
                    f"same place of the surface, near ({place}) mm: move them apart, or press one "
                    "after the other"
                )


def _outgrown(boxes: list[Box], contacts: ContactProblem, reached: Bools) -> bool:
    """Make those of the contacts' boxes a tenth larger whose patches (k,) were ``reached`` up to
    the border; whether any was."""
    grew = False
    for number, (_, rows, _) in enumerate(contacts.rows):
        grid = contacts.grids[number]
        own = reached[rows]
        if (own & grid.border).any():
            both = boxes[number].joined(grid.bounds(own))
            boxes[number] = both.grown(0.05 * both.size[0], 0.05 * both.size[1])
            grew = True
    return grew


def _grid_error(setup: ProbeSetup, contact: Box) -> ContactError:
    return ContactError(
        f"contact: it keeps growing beyond the grid ({contact.size[0]:.3g} by "
        f"{contact.size[1]:.3g} mm under the {setup.probe.kind}): reduce press.force_n, or hold "
        "the probe by motion"
    )


def _untouched(setup: ProbeSetup) -> ContactError:
    return ContactError(
        f"contact: the {setup.name} touches no patch: what touches is narrower than the patches "
        f"({setup.across} across), or its push is too small to be distinguished from rounding: "
        "raise accuracy.contact_patches, or press further (press.indentation_mm, or force_n or "
        "move_mm of the steps)"
    )


_SLIDE_WIDTHS = 8.0
"""How far a round probe may slide, over its contact's width: one grid holds its whole path."""


@dataclass(frozen=True, kw_only=True)
class _Reach:
    """How far one probe's contact reached by a step: the plane of its grid, along its first
    contact, the box (none yet: None), the place (6,), and the way sideways (2,).

    A contact that a harder push of the same kind holds is not sought: ``hardest`` is the last one
    that was. ``known`` keeps what was sought for longer paths.
    """

    plane: Plane
    touch_z: float
    known: dict[bytes, tuple[Plane, Box, Floats]]
    box: Box | None = None
    pose: Floats = field(default_factory=lambda: np.zeros(MOTIONS))
    sideways: Floats = field(default_factory=lambda: np.zeros(2))
    hardest: Control | None = None

    def after(
        self, programme: LoadProgramme, number: int, step: Control, following: Control | None
    ) -> _Reach:
        """Return it after a step, pressed without friction where the probe slides to."""
        setup = programme.setups[number]
        own = step.of_probe(number)
        if self.box is not None and _only_leaves(step, number):
            return replace(self, pose=_counted_from(own, self.pose).given)
        sideways = self.sideways + _aside(own)
        still = self._straight(programme, number, step)
        plane, touch_z = self.plane, self.touch_z
        if still.given[ABOUT_X:].any() and isinstance(setup.probe, Sphere | Cone):  # it rolls
            under, touch_z = setup.first_touch(still.given)
            plane = replace(plane, origin_mm=under.origin_mm)
        if _is_lifted(still, touch_z):
            pose = _lifted_place(still, self.pose, touch_z)
            return replace(self, pose=pose, sideways=sideways)
        there = replace(self, pose=np.where(still.by_force, self.pose, still.given))
        if not sideways.any() and there._is_held(programme, number, still, following):
            return there
        plane, contact, pose = self._sought(setup, still, plane, touch_z)
        u, v = plane.axes[:2] @ (plane.origin_mm - self.plane.origin_mm)
        plane = replace(plane, origin_mm=self.plane.origin_mm)
        grip_mm = float(programme.friction[number]) * (float(pose[Z]) - touch_z)
        if u or v:
            contact = contact.moved(u, v)
        contact = contact.joined(_slid(setup, contact, sideways, grip_mm, plane))
        box = contact if self.box is None else self.box.joined(contact)
        return replace(self, plane=plane, box=box, pose=pose, sideways=sideways, hardest=still)

    def _straight(self, programme: LoadProgramme, number: int, step: Control) -> Control:
        """Return how a step presses without friction, held sideways.

        A probe with friction on a slope carries part of a force along z by friction: its normal
        force is F n_z, for which a frictionless one that is held sideways needs F n_z^2 along z.
        """
        control = _counted_from(step.of_probe(number), self.pose)
        push = control.given[Z]
        if control.by_force[Z]:
            push *= float(self.plane.axes[2] @ programme.setups[number].first.axes[2]) ** 2
            if programme.relaxation is not None:
                push *= programme.relaxation.creep(step.time_s)
        turned = np.where(control.by_force, 0.0, control.given)
        turned[[X, Y, TURN]] = 0.0
        along_z = np.arange(MOTIONS) == Z
        return Control(by_force=control.by_force & along_z, given=np.where(along_z, push, turned))

    def _is_held(
        self, programme: LoadProgramme, number: int, still: Control, following: Control | None
    ) -> bool:
        """Return whether a step's contact lies within one that was sought, or the next step's, and
        no motion counts from where it ends under a force."""
        harder = [self.hardest]
        if following is not None:
            own = following.of_probe(number)
            if still.by_force[Z] and not own.by_force[Z]:
                return False
            if not _aside(own).any():
                harder.append(self._straight(programme, number, following))
        return any(
            one is not None
            and np.array_equal(one.by_force, still.by_force)
            and np.array_equal(np.delete(one.given, Z), np.delete(still.given, Z))
            and one.given[Z] >= still.given[Z]
            for one in harder
        )

    def _sought(
        self, setup: ProbeSetup, still: Control, plane: Plane, touch_z: float
    ) -> tuple[Plane, Box, Floats]:
        may_turn = self.box is None
        told = still.by_force, still.given, plane.origin_mm, plane.axes, [may_turn, touch_z]
        key = b"".join(np.asarray(each, float).tobytes() for each in told)
        if key not in self.known:
            start = setup, still, self.pose, plane, touch_z
            disc = closed_form_contact(*start)
            self.known[key] = (plane, *disc) if disc else find_contact(*start, may_turn=may_turn)
        return self.known[key]


def _aside(own: Control) -> Floats:
    """Return (2,) how far a step moves a probe sideways."""
    return np.asarray(np.where(own.by_force, 0.0, own.given)[:Z])


def _only_leaves(step: Control, number: int) -> bool:
    """Return whether a step in time holds a probe where it is, or only draws it back."""
    own = step.of_probe(number)
    aside = np.delete(own.given, Z)
    return step.time_s > 0.0 and not (own.by_force.any() or aside.any() or own.given[Z] > 0.0)


def _slid(setup: ProbeSetup, contact: Box, sideways: Floats, grip_mm: float, plane: Plane) -> Box:
    """Return the box of a contact that is moved sideways and slides when it can't be strained
    further.

    A sphere slides once it is mu (2 - nu) / (2 (1 - nu)) of its indentation off
    (`twin.theory.contact`), here the ``grip_mm`` = mu x indentation times the rest.
    """
    grip_mm *= (2.0 - setup.poisson_ratio) / (2.0 * (1.0 - setup.poisson_ratio))
    length = float(np.hypot(*sideways))
    if setup.face is not None or length <= grip_mm:
        return contact
    slide = length - grip_mm
    most = _SLIDE_WIDTHS * max(contact.size)
    if slide > most:
        raise ContactError(
            f"contact: the {setup.probe.kind} slides by about {slide:.3g} mm; allowed is "
            f"{most:.3g} mm, {_SLIDE_WIDTHS:g} times the contact's width, as one grid holds the "
            "whole path: move it less, or press it again further on"
        )
    u, v = plane.axes[:2] @ (slide / length * sideways @ setup.first.axes[:Z])
    return contact.moved(u, v)


@dataclass
class _OnGrid:
    """A path on one grid of patches: what they remember at its end, the states, which patches were
    ever in contact, and why it stopped before its end, if it did."""

    boxes: list[tuple[Plane, Box]]
    grid: FrictionalContact
    history: ContactHistory
    path: list[ContactState]
    reached: Bools
    reason: str = ""

    def take(self, programme: LoadProgramme, increments: int) -> None:
        """Take the steps that follow those taken."""
        for count in range(len(self.path) + 1, len(programme.steps) + 1):
            step = programme.steps[count - 1]
            try:
                history, state, touched, stopped = _frictional_step(
                    self.grid, programme, self.history, count, step, increments
                )
            except NotSettled as unsettled:
                if not self.path:
                    raise
                self.reason = _stopped_at(programme, self.path, unsettled)
                return
            except ContactError as refused:
                ContactState.keep_last(refused, self.path, len(programme.steps))
                raise
            if stopped:
                self.reason = _stopped_at(programme, self.path, stopped)
            self.history = history
            self.reached |= touched
            self.path.append(state)
            if stopped:
                return


class PathMemory:
    """What `press` keeps of a path that came to its end, so that a longer one goes on from there.

    Only a path that begins with all those steps, of the same probe at the same place, goes on;
    anything else starts from rest. Results are those of the whole path: where a step makes the
    contact outgrow its grid, the path is taken again on another one. One memory serves one body
    and one accuracy.

    Attributes
    ----------
    states
        The states at the ends of the steps taken.
    strained
        Those of them that are known at finite strain, by the state they were made of.
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._press: Press | None = None
        self._in_time = False
        self.states: list[ContactState] = []
        self.strained: list[tuple[ContactState, ContactState]] = []
        self.sought: list[dict[bytes, tuple[Plane, Box, Floats]]] = []  # of every probe
        self.tried: list[_OnGrid] = []  # with friction or in time: the last one held the contact
        self.pose: Floats | None = None  # without friction

    def begin(self, press: Press, in_time: bool) -> None:
        """Keep only what another press goes on from."""
        known = self._press
        goes_on = (
            known is not None
            and self._in_time == in_time
            and press.path[: len(known.path)] == known.path
            and press.model_copy(update={"steps": known.steps}) == known
        )
        if not goes_on:
            self._forget()

    def end(self, press: Press, in_time: bool, states: list[ContactState]) -> None:
        """Keep a path that came to its end."""
        self._press = press
        self._in_time = in_time
        self.states = states
        self.strained = [pair for pair in self.strained if any(pair[0] is one for one in states)]
        if self.tried:
            self.tried[-1].path = list(states)


def _frictional_path(
    programme: LoadProgramme, increments: int, memory: PathMemory
) -> tuple[list[ContactState], str]:
    """Take the whole path, with friction or in time, on one grid; return the states, and why it
    stopped before its end, if it did."""
    # Where the probes reach, and the grid for that.
    memory.sought = memory.sought or [{} for _ in programme.setups]
    reaches = []
    for number, setup in enumerate(programme.setups):
        plane, touch_z = setup.first_touch(np.zeros(MOTIONS))
        reach = _Reach(plane=plane, touch_z=touch_z, known=memory.sought[number])
        for step, following in zip_longest(programme.steps, programme.steps[1:]):
            reach = reach.after(programme, number, step, following)
        reaches.append(reach)
    planes = [one.plane for one in reaches]
    boxes: list[Box] = []
    for setup, reach in zip(programme.setups, reaches, strict=True):
        if reach.box is None:
            raise _untouched(setup)
        boxes.append(reach.box)
    # The path on that grid, or on one that is made larger until it holds the contact.
    tried: list[_OnGrid] = []
    for number in range(TRIES):
        places = list(zip(planes, boxes, strict=True))
        one = next((one for one in memory.tried[number : number + 1] if _same(one, places)), None)
        if one is None:
            contacts = ContactProblem(
                programme.setups, fitted_grids(programme.setups, planes, boxes)
            )
            grid = FrictionalContact(contacts, programme.effective_friction, programme.relaxation)
            nothing = np.zeros(len(grid.patches), bool)
            one = _OnGrid(places, grid, grid.at_first_touch(), [], nothing)
        else:
            one = replace(one, path=list(one.path), reached=one.reached.copy())
        one.take(programme, increments)
        tried.append(one)
        if not _outgrown(boxes, one.grid.contacts, one.reached):
            if not one.reason:
                memory.tried = tried
            return one.path, one.reason
    raise _grid_error(programme.setups[0], boxes[0])


def _same(one: _OnGrid, places: list[tuple[Plane, Box]]) -> bool:
    """Return whether a path was taken to its end on the grid for planes and boxes."""
    return not one.reason and all(
        old[1] == new[1]
        and np.array_equal(old[0].origin_mm, new[0].origin_mm)
        and np.array_equal(old[0].axes, new[0].axes)
        for old, new in zip(one.boxes, places, strict=True)
    )


def _frictional_step(
    grid: FrictionalContact,
    programme: LoadProgramme,
    history: ContactHistory,
    count: int,
    step: Control,
    increments: int,
) -> tuple[ContactHistory, ContactState, Bools, str]:
    """Take one step; return the state at its end, the patches in contact, and why it stopped before
    that, if it did."""
    control = _counted_from(step, history.pose)
    lifted = control.by_force[Z::MOTIONS] & (control.given[Z::MOTIONS] == 0.0)
    places = history.pose.reshape(-1, MOTIONS).copy()
    for number in np.flatnonzero(lifted).tolist():
        own = control.of_probe(number)
        _refuse_untransmitted_forces(own)
        places[number] = _lifted_place(own, places[number], 0.0)
    history = replace(history, pose=places.reshape(-1), lifted=lifted)
    if lifted.any():
        history = grid.release(history, lifted)
        # what is off the body is held where it is
        control = replace(
            control,
            by_force=control.by_force & ~np.repeat(lifted, MOTIONS),
            given=np.where(np.repeat(lifted, MOTIONS), history.pose, control.given),
        )
    found = None
    stopped = ""
    if lifted.all():
        history = grid.recovered(history, lifted, control.time_s, increments)
    else:
        from twin.world.contact.load_step import load_step

        _refuse_drag(grid, control, count)
        history, found, stopped = load_step(grid, history, control, increments)
        _refuse_overlap(grid.carried(history.slid_mm).contacts, found)
        apart = np.array([not found.active[rows].any() for _, rows, _ in grid.contacts.rows])
        if apart.any():
            history = grid.release(history, apart)
        lifted = lifted | apart
    touched = np.zeros(len(grid.patches), bool) if found is None else found.active
    return (
        history,
        _combine_states(_states(grid, programme.friction, history, control, found, lifted)),
        touched,
        stopped,
    )


def _states(
    grid: FrictionalContact,
    asked: Floats,
    history: ContactHistory,
    control: Control,
    found: Equilibrium | None,
    lifted: Bools,
) -> list[ContactState]:
    """Return the state of every probe after a step; ``asked`` (p,) are the coefficients given."""
    grid = grid.carried(history.slid_mm)
    states = []
    for number, (setup, rows, motions) in enumerate(grid.contacts.rows):
        friction = float(asked[number])
        if found is None or lifted[number]:
            _refuse_untransmitted_forces(control.of_probe(number))
            states.append(
                ContactState.lifted(
                    setup,
                    history.pose[motions],
                    friction=friction,
                    dissipated_nmm=history.dissipated_nmm,
                )
            )
            continue
        patches = grid.contacts.grids[number]
        own = found.part(rows, motions)
        slid, rolled = history.slid_mm[number].any(), setup.face is None
        touch_z = setup.touch_z(own.pose * [slid, slid, False, rolled, rolled, False])
        setup.check_inside(patches, own, float(own.pose[Z]) - touch_z)
        states.append(
            ContactState.touching(
                setup,
                patches,
                own,
                touch_z_mm=touch_z,
                friction=friction,
                dissipated_nmm=history.dissipated_nmm,
            )
        )
    memory = history.memory
    if memory is None:
        return states
    return [
        replace(one, load=replace(one.load, crept=grid.crept(memory, number)))
        for number, one in enumerate(states)
    ]


def _refuse_drag(grid: FrictionalContact, control: Control, count: int) -> None:
    """Raise a ContactError when a flat surface is asked for more force sideways than friction can
    carry."""
    for number, (setup, _, _) in enumerate(grid.contacts.rows):
        own = control.of_probe(number)
        friction = float(grid.friction[number])
        flat = np.all(grid.contacts.grids[number].frames[:, 2] @ setup.first.axes[2] > 1.0 - 1e-12)
        if not flat or not own.by_force[Z] or math.isinf(friction):
            continue
        asked = float(np.hypot(*np.where(own.by_force, own.given, 0.0)[[X, Y]]))
        most = friction * float(own.given[Z])
        if asked >= most > 0.0 or asked > most:
            raise ContactError(
                f"contact: step {count} asks for {asked:.6g} N sideways at {own.given[Z]:.6g} N "
                f"along z; with friction {friction:g} less than {most:.6g} N can be balanced: ask "
                "for less, push harder, raise press.friction, or hold x and y by motion"
            )


def _frictionless_path(
    programme: LoadProgramme, memory: PathMemory
) -> tuple[list[ContactState], str]:
    """Take the whole path; return the states, and why it stopped before its end, if it did."""
    path = list(memory.states)
    pose = np.zeros(MOTIONS * len(programme.setups)) if memory.pose is None else memory.pose
    for step in programme.steps[len(path) :]:
        try:
            state, pose = _frictionless_step(programme, _counted_from(step, pose), pose)
        except NotSettled as stopped:
            if not path:
                raise
            return path, _stopped_at(programme, path, stopped)
        except ContactError as refused:
            ContactState.keep_last(refused, path, len(programme.steps))
            raise
        path.append(state)
    memory.pose = pose
    return path, ""


def _frictionless_step(
    programme: LoadProgramme, control: Control, pose: Floats
) -> tuple[ContactState, Floats]:
    """Return the state at the end of a step, and the probes' places."""
    places = list(pose.reshape(-1, MOTIONS))
    states: list[ContactState | None] = [None] * len(programme.setups)
    touching = []
    starts = []
    planes = []
    touch_z = []
    for number, setup in enumerate(programme.setups):
        own = control.of_probe(number)
        plane, z = setup.first_touch(np.where(own.by_force, places[number], own.given))
        if _is_lifted(own, z):
            _refuse_untransmitted_forces(own)
            places[number] = _lifted_place(own, places[number], z)
            states[number] = ContactState.lifted(setup, places[number])
            continue
        touching.append(number)
        starts.append(places[number])
        planes.append(plane)
        touch_z.append(z)
    if touching:
        setups = tuple(programme.setups[number] for number in touching)
        controls = [control.of_probe(number) for number in touching]
        contacts, found = _frictionless(setups, controls, starts, planes, touch_z)
        for each, (number, (setup, rows, motions)) in enumerate(
            zip(touching, contacts.rows, strict=True)
        ):
            own_found = found.part(rows, motions)
            places[number] = own_found.pose
            states[number] = ContactState.touching(
                setup,
                contacts.grids[each],
                own_found,
                touch_z_mm=setup.touch_z(own_found.pose),
                friction=0.0,
                slope=contacts.gap_under(each, own_found.pose)[1],
            )
    return _combine_states([state for state in states if state is not None]), np.concatenate(places)


def _frictionless(
    setups: tuple[ProbeSetup, ...],
    controls: list[Control],
    places: list[Floats],
    planes: list[Plane],
    touch_z: list[float],
) -> tuple[ContactProblem, Equilibrium]:
    """Find the contacts, cut the grids that fit them, and solve on these; a grid grows while its
    border is reached."""
    boxes = []
    closed_form = dict[int, Box]()
    for number, setup in enumerate(setups):
        start = setup, controls[number], places[number], planes[number], touch_z[number]
        if disc := closed_form_contact(*start):
            box, places[number] = disc
            if setup.face is None:
                closed_form[number] = box
        else:
            planes[number], box, places[number] = find_contact(*start)
        boxes.append(box)
    control = Control.joined(controls)
    pose = np.concatenate(places)
    for _ in range(TRIES):
        contacts = ContactProblem(setups, fitted_grids(setups, planes, boxes))
        found = solve_frictionless(contacts, control, pose, np.array(touch_z))
        pose = found.pose
        missed = False
        for number, (setup, rows, motions) in enumerate(contacts.rows):
            grid, z, active = contacts.grids[number], touch_z[number], found.active[rows]
            setup.check_inside(grid, found.part(rows, motions), float(pose[motions][Z]) - z)
            known = closed_form.get(number)
            if known is not None and not (active.any() and grid.bounds(active).fills(known)):
                missed = True
                planes[number], boxes[number], pose[motions] = find_contact(
                    setup, controls[number], pose[motions], planes[number], z
                )
                del closed_form[number]
        if not _outgrown(boxes, contacts, found.active) and not missed:
            for setup, rows, _ in contacts.rows:
                if not found.active[rows].any():
                    raise _untouched(setup)
            _refuse_overlap(contacts, found)
            return contacts, found
    raise _grid_error(setups[0], boxes[0])


__all__ = ["ContactState", "SurfaceCompliance", "press"]


_MOST = 10_000
_MOST_RUBBED = 6_000
"""Patches at most under a probe of any shape, touching or not, without friction and with it."""

LEAST_N = 1e-9
"""Least force that presses: under less the gaps are lost in the round-off of the patches'
places."""


def press(
    press: Press,
    body: Body,
    compliance: SurfaceCompliance,
    *,
    patches_across: int = 16,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
    increments: int = INCREMENTS,
    watched: Estimates.Watched | None = None,
    relaxation: Relaxation | None = None,
    memory: PathMemory | None = None,
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
    watched
        Points whose displacement's error is of interest too.
    relaxation
        The rubber's: the path is then taken in time if a step has ``seconds``, and the modulus is
        the instantaneous one.
    memory
        Of the press before, which this one goes on from where it can.

    Returns
    -------
    The state at the end of the path; its ``path`` holds the states at the end of every step. Where
    a step after the first doesn't converge, the last state that did, with its ``complete`` false
    and its ``reason``. The ``error`` of each is computed when it is first looked at.

    Raises
    ------
    InputError
        A probe misses the body, a normal force pulls, or the number of patches is out of range.
    ContactError
        There is no equilibrium, contact runs over the edge, a probe sinks in, or the first step
        does not converge. Its ``last_state`` is the state before the step that was refused, if
        there is one.
    """
    if not FEWEST_PATCHES <= patches_across <= MOST_PATCHES:
        raise InputError(
            f"contact: {patches_across} patches across the contact; allowed are "
            f"{FEWEST_PATCHES} to {MOST_PATCHES}"
        )
    presses = (press, *press.also)
    if not any(step.seconds for step in press.path):
        relaxation = None
    memory = memory or PathMemory()
    memory.begin(press, relaxation is not None)
    setups = tuple(
        ProbeSetup(
            body=body,
            compliance=compliance,
            first=Approach.of_press(one, body),
            across=patches_across,
            most=_MOST_RUBBED if relaxation or any(each.friction for each in presses) else _MOST,
            youngs_modulus_mpa=youngs_modulus_mpa,
            poisson_ratio=poisson_ratio,
            albedo=one.albedo,
        )
        for one in presses
    )
    for number, setup in enumerate(setups):
        _refuse_overhang(setup)
        for other in setups[:number]:
            _refuse_crossing(setup.first, other.first)
    programme = LoadProgramme(
        setups=setups,
        friction=np.array([one.friction for one in presses]),
        steps=_controls(presses, setups),
        relaxation=relaxation,
    )
    if relaxation is not None:
        _refuse_unguided(programme)
    states, reason = _solved(programme, increments, memory)
    estimates = Estimates(programme, states, increments, _solved, watched)
    states = [
        state if state.estimate else replace(state, estimate=partial(estimates.of, step=step))
        for step, state in enumerate(states)
    ]
    estimates.judge_at_once(states[-1], len(states) - 1)
    if not reason:
        memory.end(press, relaxation is not None, states)
    return replace(states[-1], path=tuple(states), complete=not reason, reason=reason)


def _solved(
    programme: LoadProgramme, increments: int, memory: PathMemory | None = None
) -> tuple[list[ContactState], str]:
    memory = memory or PathMemory()
    if not any(programme.friction.tolist()) and programme.relaxation is None:
        return _frictionless_path(programme, memory)
    return _frictional_path(programme, increments, memory)


def _controls(presses: tuple[Press, ...], setups: tuple[ProbeSetup, ...]) -> tuple[Control, ...]:
    """Return every step's control; ``given`` holds motions since the step before, not places
    yet."""
    try:
        found = [
            one.in_own_axes(setup.first.axes) for one, setup in zip(presses, setups, strict=True)
        ]
    except ValueError as problem:
        raise InputError(f"press: {problem}") from None
    for steps in found:
        for number, (by_force, given) in enumerate(steps, start=1):
            if by_force[Z] and given[Z] < LEAST_N and given[Z] != 0.0:
                raise InputError(
                    f"press: step {number} asks for a normal force of {given[Z]:g} N; allowed is 0 "
                    f"(lift off), or {LEAST_N:g} N or more, as a probe can't pull, and feels "
                    "nothing under less"
                )
    times = accumulate(step.seconds for step in presses[0].path)
    return tuple(
        Control.joined(
            [
                Control(by_force=np.array(by_force), given=np.array(given))
                for by_force, given in step
            ],
            time_s,
        )
        for step, time_s in zip(zip(*found, strict=True), times, strict=True)
    )


def _refuse_unguided(programme: LoadProgramme) -> None:
    """Raise an InputError where a probe without friction is not only pressed along its way, as one
    grid serves a path in time."""
    for number, setup in enumerate(programme.setups):
        controls = [step.of_probe(number) for step in programme.steps]
        aside = np.any([one.by_force | (one.given != 0.0) for one in controls], axis=0)
        if programme.friction[number] == 0.0 and np.delete(aside, Z).any():
            raise InputError(
                f"press: the {setup.probe.kind} has no friction, and its steps move it sideways, "
                "turn it, or hold it so by force; in time, on rubber with material.relaxation, "
                "give press.friction a value, or hold x, y and the turns where they are"
            )


def _refuse_overhang(setup: ProbeSetup) -> None:
    """Raise a ContactError where a flat face is bound to run over the edge of a flat surface."""
    first = setup.first
    if first.level:
        return
    if setup.face is None or first.axes[2, 2] != 1.0 or any(first.tilt_deg):
        return
    angle = np.arange(16) * math.pi / 8
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    if not setup.face.is_round:
        around /= np.abs(around).max(axis=1, keepdims=True)
    under = first.axis_mm + around * half_extent(setup.probe) @ first.axes[:Z]
    height = setup.body.surface_from_above(under[:, :2])[:, 2] - under[:, 2]
    missing = np.isnan(height)
    # met all round at once: the surface is flat
    if missing.any() and not np.any(np.abs(height[~missing]) > 1e-12):
        raise ContactError(
            f"contact: the {setup.name} stands out over the edge of the sensing surface: press "
            "further inside (press.at_mm), or with a smaller press.probe"
        )


def _refuse_crossing(one: Approach, other: Approach) -> None:
    """Raise an InputError where two spheres, or two cylinders side by side, would stand inside each
    other."""
    away = one.axis_mm - other.axis_mm
    if isinstance(one.probe, Sphere) and isinstance(other.probe, Sphere):
        away -= (
            one.axes[2] * one.probe.diameter_mm / 2 - other.axes[2] * other.probe.diameter_mm / 2
        )
    elif (
        isinstance(one.probe, Cylinder)
        and isinstance(other.probe, Cylinder)
        and one.axes[2] @ other.axes[2] > 0.999
    ):
        away = away - (away @ one.axes[2]) * one.axes[2]
    else:
        return
    apart = float(np.linalg.norm(away))
    least = (one.probe.diameter_mm + other.probe.diameter_mm) / 2
    if apart < least:
        raise InputError(
            f"press: the {one.probe.kind}s at ({', '.join(f'{c:.3g}' for c in other.axis_mm)}) and "
            f"({', '.join(f'{c:.3g}' for c in one.axis_mm)}) mm are {apart:.3g} mm apart, less "
            f"than the {least:.3g} mm at which they touch each other: move them apart, or take "
            "smaller ones"
        )
