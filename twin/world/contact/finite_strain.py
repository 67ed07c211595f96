"""What linear theory leaves out of a press: large strain, the turning of the surface, and contact
with the deformed instead of the undeformed surface.

The displacement under a press is

    linear solution (`twin.world.contact.pressing`)
        + [finite-strain solution - linear contact solution, both on one coarse mesh],

under the same force. Where a motion holds the probe, the force is sought under which it is there.
The mesh is a slab of revolution where that will do (`twin.world.contact.round_slab`), else one of
the whole body (`twin.world.contact.body_strain`); what these solve is stated there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import ContactError, InputError, MeshError, NotSettled, SolveError
from twin.parts.body import Body
from twin.parts.material import Material
from twin.parts.press import Press, Step
from twin.world.contact.contact_state import (
    ESTIMATED,
    MEASURED,
    ContactState,
    PressError,
    Share,
    Validity,
)
from twin.world.contact.pressing import PathMemory
from twin.world.contact.probe_gap import Approach, Z
from twin.world.contact.round_slab import FiniteStrain, SlabStrain

_FORCES = 8
"""Forces that are tried for a probe that a motion holds."""


def _strain_of(
    press: Press,
    body: Body,
    material: Material,
    state: ContactState,
    watched: Points,
    *,
    coarse: bool = False,
    like: FiniteStrain | None = None,
    path: Sequence[ContactState] = (),
) -> FiniteStrain:
    """Return what linear theory leaves out of a state of a press; parameters and errors are those
    of `SlabStrain` and `BodyStrain`."""
    if SlabStrain.solves(press, body, material, state):
        return SlabStrain(press, body, material, state, watched, coarse=coarse)
    from twin.world.contact.body_strain import BodyStrain

    near = like if isinstance(like, BodyStrain) else None
    return BodyStrain(press, body, material, state, watched, coarse=coarse, like=near, path=path)


def measured_linearity(
    press: Press, body: Body, material: Material, state: ContactState, watched: Points
) -> Validity:
    """Return a state's validity with how far linear theory is off under this very press.

    Neo-Hookean rubber is pressed on a coarse mesh: about .3 s on a slab of revolution, 1 s under
    a sphere on a curved body. Where that can't be done, or takes longer, the estimate stays,
    and `Validity.linearisation_basis` says why.
    """
    validity = state.validity
    rubber = material.model_copy(update={"law": "neo_hookean"})
    why = "nothing touches"
    more: FiniteStrain | None = None
    try:
        if state.load.terms:
            more = _strain_of(press, body, rubber, state, watched, coarse=True)
    except InputError as problem:
        cause = str(problem).removeprefix("material.law = neo_hookean: ").split(" at finite")[0]
        why = f"{cause} at finite strain"
    except MeshError:
        why = "the press's mesh failed"
    except (ContactError, SolveError):
        why = "Newton's steps at finite strain did not converge"
    if more is None:
        return replace(validity, linearisation_basis=f"{ESTIMATED}: {why}")
    deeper = more.indentation_mm / state.indentation_mm
    note = (
        f"linear theory is {100 * more.linear_error:.2g} % of the largest displacement off here, "
        f"and its indentation {100 * abs(deeper):.2g} % too {'small' if deeper > 0 else 'large'}; "
        "-s material.law=neo_hookean includes it"
    )
    return _measured(validity, more, note)


def _measured(validity: Validity, more: FiniteStrain, note: str) -> Validity:
    return replace(
        validity,
        linearisation_error=more.linear_error,
        linearisation_basis=MEASURED,
        warnings=(),
        notes=(note,),
    )


def at_finite_strain(
    press: Press,
    body: Body,
    material: Material,
    state: ContactState,
    watched: Points,
    judge: Callable[[PressError], None],
    solve: Callable[[Press], ContactState],
    memory: PathMemory | None = None,
) -> ContactState:
    """Return the state of a press, and of every step of its path, with what linear theory leaves
    out.

    Pressures and forces of patches stay linear theory's, but for what motions hold a probe with
    more (`FiniteStrain.more_force_n`); `Load.strained` is the difference. ``judge`` is called with
    every estimated error; ``solve`` returns the linear solution of another press; the others, and
    what is raised, are those of `SlabStrain` and `BodyStrain`. A ContactError has the state before
    the step that fails. States that a ``memory`` has are not solved again, unless a path with
    friction needs another mesh.
    """
    approaches = [Approach.of_press(one, body) for one in (press, *press.also)]
    approach = approaches[0]
    controls = press.in_own_axes(approach.axes)
    path: list[ContactState] = []
    more: FiniteStrain | None = None
    memory = PathMemory() if memory is None else memory
    if press.friction and memory.strained:
        from twin.world.contact.body_strain import BodyStrain

        ended = memory.strained[-1][1].load.strained
        if isinstance(ended, BodyStrain) and ended.leads_to(state.path):
            more = ended
        else:
            memory.strained.clear()
    known = {id(linear): found for linear, found in memory.strained}
    for one, (by_force, _) in zip(state.path, controls, strict=False):
        if not one.load.terms or id(one) in known:
            path.append(known.get(id(one), one))
            continue
        before = more if press.friction else None
        try:
            more = _strain_of(press, body, material, one, watched, like=before, path=state.path)
            found = _Found(one, more, 0.0, approach)
            if not by_force[Z]:
                found = _held_by_motion(found, press, body, material, watched, solve)
        except ContactError as problem:
            ContactState.keep_last(problem, path, len(controls))
            raise
        path.append(_strained(found, approaches, one, material.law, judge))
        memory.strained.append((one, path[-1]))
    return replace(path[-1], path=tuple(path), complete=state.complete, reason=state.reason)


@dataclass(frozen=True)
class _Found:
    linear: ContactState
    more: FiniteStrain  # what that leaves out
    stiffening: float  # d ln force / d ln indentation where a motion holds the probe, else 0
    approach: Approach

    @property
    def deep_mm(self) -> float:
        return self.linear.indentation_mm + self.more.indentation_mm

    @property
    def force_n(self) -> float:
        """The force along the probe's way."""
        return float(self.approach.axes[Z] @ self.linear.force_n)


def _held_by_motion(
    found: _Found,
    press: Press,
    body: Body,
    material: Material,
    watched: Points,
    solve: Callable[[Press], ContactState],
) -> _Found:
    """Return the solution under the force that takes a probe as deep as ``found.linear`` is.

    Secant steps of the logarithms: under most probes force is nearly a power of the indentation.
    """
    held = found.linear
    x, y, _ = found.approach.axes @ held.move_mm
    stiffening = 1.5
    for _ in range(_FORCES):
        aside = math.log(held.indentation_mm / found.deep_mm)
        if abs(aside) < found.more.held_within:
            return replace(found, stiffening=stiffening)
        force = found.force_n * math.exp(stiffening * aside)
        step = Step(
            force_n=(None, None, force),
            move_mm=(float(x), float(y), None),
            turn_deg=tuple(found.approach.axes @ held.turns_deg) if held.turns_deg.any() else None,
        )
        place = {"at_mm": press.at_mm, "direction": press.direction, "tilt_deg": press.tilt_deg}
        one = Press(probe=press.probe, axes="probe", steps=(step,), **place)
        linear = solve(one).path[-1]
        more = _strain_of(one, body, material, linear, watched, like=found.more)
        after = _Found(linear, more, stiffening, found.approach)
        if abs(aside) > 10.0 * found.more.held_within:
            gained = math.log(after.deep_mm / found.deep_mm)
            stiffening = float(np.clip(stiffening * aside / gained, 0.5, 4.0))
        found = after
    raise NotSettled(
        f"contact: at finite strain (material.law = {material.law}) no force was found that holds "
        f"the probe {held.indentation_mm:.3g} mm deep: hold it by a force, or set "
        "material.law = linear"
    )


def _strained(
    found: _Found,
    approaches: Sequence[Approach],
    asked: ContactState,
    law: str,
    judge: Callable[[PressError], None],
) -> ContactState:
    """Return a state with what linear theory leaves out of it, of these probes at first touch.

    ``asked`` is the linear solution of the press as it was given; where a motion holds the probe,
    an error of the indentation under a force becomes one of the force.
    """
    state = found.linear
    more = found.more

    def estimate(_: ContactState) -> PressError:
        linear = asked.error
        assert linear is not None
        strain = more.error
        if found.stiffening:
            off = found.stiffening * (strain.indentation + more.held_within)
            strain = Share(force=off, markers=strain.markers + off)
        error = PressError.of(
            body=linear.body, patches=linear.patches, increments=linear.increments, strain=strain
        )
        judge(error)
        return error

    if found.stiffening:
        what = "force"
        change = 100 * (found.force_n / float(found.approach.axes[Z] @ asked.force_n) - 1.0)
    else:
        what = "indentation"
        change = 100 * more.indentation_mm / state.indentation_mm
    note = (
        f"large strain is included (material.law = {law}): under this force linear theory is "
        f"{100 * more.linear_error:.2g} % of the largest displacement off, and the {what} is "
        f"{abs(change):.2g} % {'larger' if change > 0 else 'smaller'} than by it"
    )
    first, *also = (
        replace(
            _moved(one, moved, float(wider), axes), validity=_measured(one.validity, more, note)
        )
        for one, moved, wider, axes in zip(
            (state, *state.also), more.moved, more.wider, more.axes, strict=True
        )
    )
    pushed = [
        _pushed(one, number, more, approach)
        for number, (one, approach) in enumerate(zip((first, *also), approaches, strict=True))
    ]
    # The linear forces move the rubber with what they leave out.
    load = replace(state.load, strained=more)
    if any(one.load is not before.load for one, before in zip(pushed, (first, *also), strict=True)):
        under = tuple(term for one in pushed for term in one.load.terms[:1])
        load = replace(load, terms=under, crept=state.load)
    return replace(pushed[0], load=load, also=tuple(pushed[1:]), estimate=estimate)


def _pushed(
    state: ContactState, number: int, more: FiniteStrain, approach: Approach
) -> ContactState:
    """Return the state of one probe under the forces that hold it."""
    patches = state.patches
    assert patches is not None
    force = more.more_force_n(patches, number)
    if not force.any():
        return state
    torques = np.cross(patches.centre_mm - approach.axis_mm, force).sum(axis=0)
    under = replace(patches, force_n=patches.force_n + force)
    return replace(
        state,
        load=replace(state.load, terms=(under,)),
        force_n=state.force_n + force.sum(axis=0),
        torques_nmm=state.torques_nmm + torques,
        torque_nmm=state.torque_nmm + float(torques @ approach.axes[Z]),
        traction_mpa=state.traction_mpa + force / (4.0 * patches.half_mm.prod(axis=1)[:, None]),
    )


def _moved(state: ContactState, moved: Floats, wider: float, axes: Floats) -> ContactState:
    """Return the state of one probe that moved farther (6,), with a wider contact."""
    turns = state.turns_deg + np.degrees(moved[Z + 1 :]) @ axes
    return replace(
        state,
        indentation_mm=state.indentation_mm + float(moved[Z]),
        move_mm=state.move_mm + moved[: Z + 1] @ axes,
        turns_deg=turns,
        turn_deg=float(turns @ axes[Z]),
        contact_radius_mm=state.contact_radius_mm * wider,
        area_mm2=state.area_mm2 * wider**2,
        peak_pressure_mpa=state.peak_pressure_mpa / wider**2,
    )
