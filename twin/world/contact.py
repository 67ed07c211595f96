"""A rigid probe presses a body along a path: from the press's description to forces on the surface.

Without friction every state depends on the probe's place alone, so each step gets a grid of its own under the probe.
With friction the history counts and one grid serves the whole path (`twin.world.friction`). The unilateral problem
itself is in `twin.world.unilateral`, with Coulomb's friction in `twin.world.coulomb`, the probe's shape in
`twin.world.gap`, the patches in `twin.world.patches`.

Validity: linear elasticity, small turns and slopes; forces act along the normals of the undeformed surface. Every state
says how far it strains that.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, InputError
from twin.parts.body import Body
from twin.parts.press import Press, Sphere, Step
from twin.world.contact_state import ContactState, lifted_state, touching_state
from twin.world.friction import INCREMENTS, take_step
from twin.world.friction_grid import FrictionGrid, Memory, at_first_touch, friction_grid, let_go
from twin.world.gap import TURN, Z, approach, outline
from twin.world.patches import Box, Patches, Plane
from twin.world.region import (
    Control,
    Setting,
    SurfaceCompliance,
    check_inside,
    check_somewhere,
    find_contact,
    fitted_patches,
    solve_frictionless,
    touch_at,
)
from twin.world.unilateral import Equilibrium

__all__ = ["ContactState", "SurfaceCompliance", "press"]

_ACROSS_RANGE = (6, 40)
_TRIES = 8
_SLIDE_WIDTHS = 1.0


def press(
    press: Press,
    body: Body,
    compliance: SurfaceCompliance,
    *,
    patches_across: int = 16,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
    increments: int = INCREMENTS,
) -> ContactState:
    """Press a rigid probe on a body along a path.

    Parameters
    ----------
    press
        Probe, place, path and friction.
    body
        The undeformed body.
    compliance
        How its surface moves under forces on patches.
    patches_across
        Contact patches across the contact.
    youngs_modulus_mpa, poisson_ratio
        Of the body; only for the first guess of the contact's size and for the validity report.
    increments
        With friction: parts of a step in which patches touch or slip.

    Returns
    -------
    The state at the end of the path; its ``path`` holds the states at the end of every step.

    Raises
    ------
    InputError
        The probe misses the body, a normal force pulls, or the number of patches is out of range.
    ContactError
        There is no equilibrium, contact runs over the edge, the probe sinks in, or the solution does not converge.
    """
    low, high = _ACROSS_RANGE
    if not low <= patches_across <= high:
        raise InputError(f"contact: {patches_across} patches across the contact; allowed are {low} to {high}")
    for number, step in enumerate(press.path, start=1):
        normal_n = step.force_n[Z]
        if normal_n is not None and normal_n < 0:
            raise InputError(
                f"press: step {number} asks for a normal force of {normal_n:g} N; allowed is 0 (lift off) or "
                "more, as a probe can't pull"
            )
    setting = Setting(
        body=body, compliance=compliance, first=approach(press.probe, body, press.at_mm), across=patches_across,
        youngs_modulus_mpa=youngs_modulus_mpa, poisson_ratio=poisson_ratio,
    )  # fmt: skip
    _refuse_overhang(setting)
    states = (
        _frictionless_path(setting, press.path)
        if press.friction == 0
        else _rubbing_path(setting, press.path, press.friction, increments)
    )
    return replace(states[-1], path=tuple(states))


def _refuse_overhang(setting: Setting) -> None:
    """Raise a ContactError where a flat face is bound to run over the edge of a flat surface."""
    place = np.array(setting.first.axis_mm[:2])
    under = setting.body.surface_from_above(place + outline(setting.probe))
    missing = np.isnan(under[:, 2])
    if missing.any() and not np.any(under[~missing, 2]):  # depth 0 all round: the surface is flat here
        x, y = place
        raise ContactError(
            f"contact: the {setting.probe.kind} at ({x:g}, {y:g}) mm stands out over the edge of the sensing surface: "
            "press further inside, or with a smaller probe"
        )


def _control(step: Step, place: Floats) -> Control:
    by_force = np.array([force is not None for force in (*step.force_n, step.torque_nmm)])
    moves = [move or 0.0 for move in step.move_mm] + [math.radians(step.turn_deg or 0.0)]
    forces = [force or 0.0 for force in (*step.force_n, step.torque_nmm)]
    return Control(by_force=by_force, given=np.where(by_force, forces, place + moves))


def _lifted(control: Control, touch_z: float) -> bool:
    return bool(control.given[Z] <= (0.0 if control.by_force[Z] else touch_z + 1e-12))


def _asks_nothing(control: Control) -> None:
    """Raise a ContactError when a lateral force or a torque is asked of a probe that touches nothing."""
    asked = np.where(control.by_force, control.given, 0.0)
    if asked.any():
        raise ContactError(
            f"contact: force ({', '.join(f'{f:g}' for f in asked[:3])}) N and torque {asked[TURN]:g} N mm are asked of "
            "a probe that touches nothing at the end of the step: push along z as well"
        )


def _lifted_place(control: Control, place: Floats, touch_z: float) -> Floats:
    moved = np.where(control.by_force, place, control.given)
    if control.by_force[Z]:
        moved[Z] = touch_z
    return moved


def _frictionless_path(setting: Setting, path: tuple[Step, ...]) -> list[ContactState]:
    place, states = np.zeros(4), []
    for step in path:
        control = _control(step, place)
        plane, touch_z = touch_at(setting, np.where(control.by_force, place, control.given))
        if _lifted(control, touch_z):
            _asks_nothing(control)
            place = _lifted_place(control, place, touch_z)
            states.append(lifted_state(setting.probe, place))
            continue
        patches, found, touch_z = _frictionless(setting, control, place, plane, touch_z)
        place = found.place
        states.append(
            touching_state(
                setting.probe, setting.body, patches, found, touch_z_mm=touch_z, friction=0.0,
                youngs_modulus_mpa=setting.youngs_modulus_mpa,
            )
        )  # fmt: skip
    return states


def _frictionless(
    setting: Setting, control: Control, place: Floats, plane: Plane, touch_z: float
) -> tuple[Patches, Equilibrium, float]:
    """Find the contact, cut the grid that fits it, and solve on it; the grid grows while contact reaches its border."""
    contact, place = find_contact(setting, control, place, plane, touch_z)
    for _ in range(_TRIES):
        patches = fitted_patches(setting, plane, contact)
        check_somewhere(setting, patches)
        found = solve_frictionless(setting, patches, control, place, touch_z)
        place = found.place
        if not np.any(found.active & patches.border):
            check_inside(setting, patches, found, float(place[Z]) - touch_z)
            return patches, found, touch_at(setting, place)[1]
        contact = _enlarged(contact, patches.bounds(found.active))
        check_inside(setting, patches, found, float(place[Z]) - touch_z)
    raise _no_grid(setting, contact)


def _joined(one: Box, other: Box) -> Box:
    return Box(u0=min(one.u0, other.u0), u1=max(one.u1, other.u1), v0=min(one.v0, other.v0), v1=max(one.v1, other.v1))


def _enlarged(contact: Box, reached: Box) -> Box:
    """Return the box of a contact that reached its grid's border, a tenth larger: where it ends is not known yet."""
    both = _joined(contact, reached)
    return both.grown(0.05 * both.size[0], 0.05 * both.size[1])


def _no_grid(setting: Setting, contact: Box) -> ContactError:
    return ContactError(
        f"contact: it keeps growing beyond the grid ({contact.size[0]:.3g} by {contact.size[1]:.3g} mm under the "
        f"{setting.probe.kind}): press with less force, or hold the probe by motion"
    )


def _largest_contact(setting: Setting, path: tuple[Step, ...], friction: float, plane: Plane, touch_z: float) -> Box:
    """Return the box that holds the contact of every step, pressed without friction, where a sphere slides to.

    A probe with friction on a slope carries part of a force along z by friction: its normal force is F n_z, for which a
    frictionless one that is held sideways needs F n_z^2 along z.
    """
    place, whole, sideways = np.zeros(4), None, np.zeros(2)
    for step in path:
        control = _control(step, place)
        sideways += [move or 0.0 for move in step.move_mm[:2]]
        along_z = control.given[Z] * (plane.axes[2, 2] ** 2 if control.by_force[Z] else 1.0)
        still = Control(
            by_force=control.by_force & (np.arange(4) == Z), given=np.where(np.arange(4) == Z, along_z, 0.0)
        )
        if _lifted(still, touch_z):
            place = _lifted_place(still, place, touch_z)
            continue
        contact, place = find_contact(setting, still, place, plane, touch_z)
        contact = _joined(contact, _slid(setting, contact, sideways, friction * (float(place[Z]) - touch_z), plane))
        whole = contact if whole is None else _joined(whole, contact)
    assert whole is not None, "the first step of a press pushes"
    return whole


def _slid(setting: Setting, contact: Box, sideways: Floats, grip_mm: float, plane: Plane) -> Box:
    """Return the box of a contact that is moved sideways and slides when it can't be strained further.

    A sphere slides once it is mu (2 - nu) / (2 (1 - nu)) of its indentation off (`twin.theory.friction`), here the
    ``grip_mm`` = mu x indentation times the rest.
    """
    grip_mm *= (2.0 - setting.poisson_ratio) / (2.0 * (1.0 - setting.poisson_ratio))
    length = float(np.hypot(*sideways))
    if not isinstance(setting.probe, Sphere) or length <= grip_mm:
        return contact
    slide, most = length - grip_mm, _SLIDE_WIDTHS * max(contact.size)
    if slide > most:
        raise ContactError(
            f"contact: the sphere slides by about {slide:.3g} mm; allowed is {most:.3g} mm, "
            f"{_SLIDE_WIDTHS:g} times the contact's width, as one grid holds the whole path: move it "
            "less, or press it anew further on"
        )
    u, v = plane.axes[:2] @ [*(slide / length * sideways), 0.0]
    return Box(u0=contact.u0 + u, u1=contact.u1 + u, v0=contact.v0 + v, v1=contact.v1 + v)


def _rubbing_path(setting: Setting, path: tuple[Step, ...], friction: float, increments: int) -> list[ContactState]:
    plane, touch_z = touch_at(setting, np.zeros(4))
    contact = _largest_contact(setting, path, friction, plane, touch_z)
    for _ in range(_TRIES):
        patches = fitted_patches(setting, plane, contact)
        check_somewhere(setting, patches)
        states, reached = _rubbing_on(friction_grid(setting, patches, friction), path, increments)
        if not np.any(reached & patches.border):
            return states
        contact = _enlarged(contact, patches.bounds(reached))
    raise _no_grid(setting, contact)


def _rubbing_on(grid: FrictionGrid, path: tuple[Step, ...], increments: int) -> tuple[list[ContactState], np.ndarray]:
    """Take the whole path on given patches; return the states and which patches were ever in contact."""
    setting, patches = grid.setting, grid.patches
    memory = at_first_touch(grid)
    states: list[ContactState] = []
    reached = np.zeros(len(patches), bool)
    for number, step in enumerate(path, start=1):
        control = _control(step, memory.place)
        if control.by_force[Z] and control.given[Z] == 0.0:
            _asks_nothing(control)
            memory = let_go(memory, _lifted_place(control, memory.place, 0.0))
            states.append(_lifted_from(grid, memory))
            continue
        _refuse_drag(grid, control, number)
        memory, found = take_step(grid, memory, control, increments)
        reached |= found.active
        if not found.active.any():
            _asks_nothing(control)
            memory = let_go(memory, found.place)
            states.append(_lifted_from(grid, memory))
            continue
        check_inside(setting, patches, found, float(found.place[Z]) - _touch_z(grid, memory))
        states.append(
            touching_state(
                setting.probe, setting.body, patches, found, touch_z_mm=_touch_z(grid, memory),
                friction=grid.friction, dissipated_nmm=memory.dissipated_nmm,
                youngs_modulus_mpa=setting.youngs_modulus_mpa,
            )
        )  # fmt: skip
    return states, reached


def _lifted_from(grid: FrictionGrid, memory: Memory) -> ContactState:
    return lifted_state(grid.setting.probe, memory.place, friction=grid.friction, dissipated_nmm=memory.dissipated_nmm)


def _touch_z(grid: FrictionGrid, memory: Memory) -> float:
    """Return the z of first touch where the probe slid to."""
    if not memory.slid_mm.any():
        return 0.0
    return touch_at(grid.setting, np.array([*memory.slid_mm, 0.0, 0.0]))[1]


def _refuse_drag(grid: FrictionGrid, control: Control, number: int) -> None:
    """Raise a ContactError when a flat surface is asked for more force sideways than friction can carry."""
    flat = bool(np.all(grid.patches.frames[:, 2, 2] > 1.0 - 1e-12))
    if not flat or not control.by_force[Z] or math.isinf(grid.friction):
        return
    asked = float(np.hypot(*np.where(control.by_force, control.given, 0.0)[:2]))
    most = grid.friction * float(control.given[Z])
    if asked >= most:
        raise ContactError(
            f"contact: step {number} asks for {asked:.6g} N sideways at {control.given[Z]:.6g} N along z; with "
            f"friction {grid.friction:g} less than {most:.6g} N can be balanced: ask for less, push harder, raise "
            "press.friction, or hold x and y by motion"
        )
