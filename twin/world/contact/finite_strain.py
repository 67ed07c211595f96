"""What linear theory leaves out of a straight press on a block: large strain, the turning of the
surface, and contact with the deformed instead of the undeformed surface.

The displacement under a press is

    linear answer (`twin.world.contact.pressing`)
        + [finite-strain answer - linear contact answer, both on one round slab],

under the same force. Where a motion holds the probe, the force is sought under which it is there.
Near the probe a block is a slab as thick, and the difference decays like the
third power of the distance, so that the slab may end where it likes: it is solved as a body of
revolution, in a few tenths of a second.

Newton's steps of the linear answer begin at the indentation and the contact of `pressing`, those of
the other one at the linear answer (`twin.world.contact.round_slab`).

A cylinder's rim is resolved; a sharp one is solved as one rounded by a fiftieth of the diameter.

Validity: one rigid sphere, cylinder, or cone, pressed straight and without friction on a block, its
axis five contact radii or more from the sides; nu from 0.45. For other probes, for several, near
the sides and on curved bodies a mesh of the whole body takes the slab's place
(`twin.world.contact.body_strain`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import ContactError, InputError, MeshError, NotSettled, SolveError
from twin.parts.body import Block, Body
from twin.parts.material import Material
from twin.parts.press import Press, Step
from twin.parts.probe import Cone, Cylinder, Sphere
from twin.world.contact.contact_state import (
    ESTIMATED,
    MEASURED,
    ContactState,
    PressError,
    Share,
    Validity,
)
from twin.world.contact.probe_gap import MOTIONS, Z, approach_of
from twin.world.contact.round_slab import (
    GAUSS_POINTS,
    Balance,
    Grid,
    RoundedRim,
    Slab,
    Touch,
    graded_line,
    rim_grid,
    stepped,
)
from twin.world.elasticity.mixed_rubber import largest, newton
from twin.world.elasticity.strain_law import LEAST_POISSON

if TYPE_CHECKING:
    from twin.world.contact.body_strain import BodyStrain

LEAST_EDGE = 0.02
"""Least radius of a cylinder's rim over its diameter: a sharper one is solved with this radius, on
which what linear theory leaves out hardly depends (docs/validity.md)."""

_ROUND_EDGE = 0.08
"""From this radius over the diameter, elements of equal size resolve a rim as they do a sphere."""

LEAST_BESIDE = 5.0
"""Least distance of the probe's axis from the block's sides over the contact's radius."""

_REACH = 1.6
"""Points so far from the axis, over the contact's radius, may touch."""

_UNDER = 14
"""Elements from the axis to `_REACH`."""

_COARSER = 0.7
_ERROR_OVER_CHANGE = 0.6
_TIP_OVER_CHANGE = 1.5
_RIM_OVER_CHANGE = 2.0
"""How many times as many elements the mesh has that tells the error; error over the change to it,
the same under a cone's tip and where the rim has its own mesh. Fitted to 22 presses whose error is
known, by another code or by a mesh of four times the elements (docs/validity.md)."""

_TOLERANCE = 1e-4
_STEPS = 20
"""Newton's steps end at one that moves nothing by more than this share of the largest displacement;
their largest number."""

_FORCES = 8
_HELD = 5e-5
_HELD_ON_CURVED = 5e-4
"""Forces that are tried for a probe that a motion holds, and how far its indentation may be off,
relative: on a block and on a curved body."""

LOAD_STEPS = 5
"""Equal steps of the force where Newton's steps fail from the linear answer."""


@dataclass(frozen=True)
class _Pair:
    """The linear and the finite-strain answer on one slab."""

    grid: Grid
    linear: Floats
    finite: Floats
    deeper_mm: float
    wider: float

    @cached_property
    def change(self) -> Floats:
        """(N, 2) what linear theory leaves out at the nodes, mm."""
        return self.finite - self.linear


class FiniteStrain:
    """What linear theory leaves out of one state of a press.

    Parameters
    ----------
    press
        The press; see the module for what is allowed.
    body, material
        Its `Material.law` is not linear.
    state
        The press by linear theory: a state in its path.
    watched
        (n, 3) points inside the body for which the error counts, mm.
    coarse
        Whether a coarser mesh and no load steps do: half of the time, for the size alone.

    Attributes
    ----------
    moved
        (p, 6) how much farther every probe moves than by linear theory, along and about its own
        axes, mm and radians.
    wider
        (p,) radius of its contact over that by linear theory.

    Raises
    ------
    ContactError
        Newton's steps don't converge: cause and remedy.
    """

    def __init__(
        self,
        press: Press,
        body: Body,
        material: Material,
        state: ContactState,
        watched: Points,
        *,
        coarse: bool = False,
    ) -> None:
        self._press = press
        self._approach = approach_of(press, body)
        self.axes = (self._approach.axes,)
        self._axis = (self._approach.axis_mm + state.move_mm)[:Z]
        self._material = material
        self._state = state
        low, high = np.array(body.bounds_mm)
        self._beside_mm = _beside_mm(body, self._approach.axis_mm + state.move_mm)
        self._thick_mm = float(high[Z] - low[Z])
        self._coarse = coarse
        self._watched = watched if len(watched) else self._below_contact()
        sides = (high - low)[:Z]
        share = _COARSER if coarse else 1.0
        self._pair = self._solved(share, math.sqrt(float(sides[0] * sides[1]) / math.pi))
        self.moved = np.zeros((1, MOTIONS))
        self.moved[0, Z] = self._pair.deeper_mm
        self.wider = np.array([self._pair.wider])

    @property
    def indentation_mm(self) -> float:
        """How much deeper the (first) probe sinks than by linear theory, mm."""
        return float(self.moved[0, Z])

    def displacement(self, points: Points) -> Points:
        """Return (n, 3) what to add to the linear displacement of points (n, 3), mm."""
        return self._at(points, self._pair.grid, self._pair.change)

    def gradient(self, points: Points) -> Floats:
        """Return (n, 3, 3) what to add to the gradients du_i/dx_j."""
        place, out = self._places(points)
        nodes, values, slopes = self._pair.grid.read(place)
        change = self._pair.change[nodes]
        gradient = np.einsum("nai,naj->nij", change, slopes)
        aside = np.einsum("na,na->n", values, change[:, :, 0])
        about = np.where(place[:, 0] > 0, aside / np.maximum(place[:, 0], 1e-12), gradient[:, 0, 0])
        axes = np.zeros((len(points), 3, 3))  # rows: r, about, z
        axes[:, 0, :Z] = out
        axes[:, 1, 0] = -out[:, 1]
        axes[:, 1, 1] = out[:, 0]
        axes[:, 2, 2] = 1.0
        own = np.zeros((len(points), 3, 3))
        own[:, ::2, ::2] = gradient
        own[:, 1, 1] = about
        return np.asarray(axes.transpose(0, 2, 1) @ own @ axes)

    @property
    def _rim(self) -> Cylinder | None:
        """The cylinder whose rim needs a mesh of its own."""
        probe = self._press.probe
        if isinstance(probe, Cylinder) and probe.edge_mm < _ROUND_EDGE * probe.diameter_mm:
            return probe
        return None

    @cached_property
    def error(self) -> Share:
        """How far this may be off, over the linear answer: what a coarser mesh changes, in a slab
        that ends at the block's nearest side."""
        other = self._solved(_COARSER, self._beside_mm)
        moved = self._at(self._watched, other.grid, other.change)
        there = largest(moved - self.displacement(self._watched)) / largest(self._linear_there)
        sunk = abs(other.deeper_mm - self.indentation_mm) / self._state.indentation_mm
        factor = _ERROR_OVER_CHANGE
        if self._rim:
            factor = _RIM_OVER_CHANGE
        elif isinstance(self._press.probe, Cone):
            factor = _TIP_OVER_CHANGE
        return Share(indentation=factor * sunk + _TOLERANCE, markers=factor * there + _TOLERANCE)

    @cached_property
    def linear_error(self) -> float:
        """How far linear theory is off at the watched points, over the largest displacement."""
        return largest(self.displacement(self._watched)) / largest(self._linear_there)

    @cached_property
    def _linear_there(self) -> Points:
        """The slab's linear displacement of the watched points: the scale of errors."""
        return self._at(self._watched, self._pair.grid, self._pair.linear)

    def _below_contact(self) -> Points:
        """Return places as deep as the contact is wide, from its axis to thrice its radius."""
        deep = self._state.contact_radius_mm
        away = deep * np.linspace(0.0, 3.0, 13)
        return np.column_stack(
            [self._axis[0] + away, 0.0 * away + self._axis[1], 0.0 * away + deep]
        )

    def _places(self, points: Points) -> tuple[Floats, Floats]:
        """Return (n, 2) places along r and z, and the (n, 2) unit vectors away from the axis."""
        away = points[:, :Z] - self._axis
        r = np.linalg.norm(away, axis=1)
        out = np.where(r[:, None] > 0.0, away / np.maximum(r, 1e-300)[:, None], [1.0, 0.0])
        return np.column_stack([r, points[:, Z]]), out

    def _at(self, points: Points, grid: Grid, field: Floats) -> Points:
        """Return the (n, 3) values of a slab's field (N, 2) at points (n, 3), 0 beyond its rim."""
        place, out = self._places(points)
        nodes, values, _ = grid.read(np.minimum(place, [grid.r_mm[-1], grid.z_mm[-1]]))
        own = np.einsum("na,nai->ni", values, field[nodes])
        own[place[:, 0] > grid.r_mm[-1]] = 0.0
        return np.column_stack([out * own[:, :1], own[:, 1]])

    def _solved(self, share: float, radius_mm: float) -> _Pair:
        """Return both answers on a slab of a radius, in so large a share of the elements."""
        state = self._state
        size = state.contact_radius_mm
        shape = self._approach.shape
        if self._rim is not None:
            outside = self._rim.diameter_mm / 2.0
            edge = self._rim.edge_mm
            least = LEAST_EDGE * self._rim.diameter_mm
            if edge < least:
                # The coarser answer has a rim twice as round: it shows what the rounding costs.
                edge = least if share == 1.0 else 2.0 * least
                shape = RoundedRim(outside - edge, edge)
            grid = rim_grid(edge, outside, share, radius_mm, self._thick_mm)
        else:
            count = round(share * _UNDER)
            edge = _REACH * size / count
            under = graded_line(edge, count // 2, self._thick_mm)
            grid = Grid(graded_line(edge, count, radius_mm), under, count)
        slab = Slab(grid, self._material)
        touch = Touch(grid, shape)
        force = float(state.force_n[Z]) / self._material.youngs_modulus_mpa
        none = np.zeros(len(touch.rest_mm))
        start = Balance(np.zeros(slab.size), state.indentation_mm, none, touch.rest_mm < size)
        linear = self.settled(slab, touch, start, force, linear=True)
        finite = self._finite(slab, touch, linear, force)
        return _Pair(
            grid=grid,
            linear=slab.displacement(linear.unknowns),
            finite=slab.displacement(finite.unknowns),
            deeper_mm=finite.place - linear.place,
            wider=touch.rms_radius(finite.pressure) / touch.rms_radius(linear.pressure),
        )

    def _finite(self, slab: Slab, touch: Touch, linear: Balance, force: float) -> Balance:
        """Return the finite-strain answer: from the linear one at once, else in load steps."""
        try:
            return self.settled(slab, touch, linear, force, linear=False)
        except (NotSettled, SolveError):
            if self._coarse:
                raise
            first = 1.0 / LOAD_STEPS
            state = replace(
                linear,
                unknowns=first * linear.unknowns,
                place=first * linear.place,
                pressure=first * linear.pressure,
            )
        try:
            for part in np.linspace(first, 1.0, LOAD_STEPS):
                state = self.settled(slab, touch, state, part * force, linear=False)
        except (NotSettled, SolveError) as problem:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge, nor did they in {LOAD_STEPS} load steps: press with less "
                "force, with a rounder probe, or set material.law = linear"
            ) from problem
        return state

    def settled(
        self, slab: Slab, touch: Touch, state: Balance, force: float, *, linear: bool
    ) -> Balance:
        """Take Newton's steps until one moves nothing."""
        state, still = newton(
            lambda one: stepped(slab, touch, one, force, linear=linear),
            lambda one: slab.displacement(one.unknowns),
            state,
            _STEPS,
            _TOLERANCE,
        )
        if not still:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge in {_STEPS}: press with less force, with a rounder probe, or "
                "set material.law = linear"
            )
        if np.any(state.pressure[-GAUSS_POINTS:] > 0.0):
            raise ContactError(
                f"contact: at finite strain it grows beyond {_REACH:g} times its size by linear "
                "theory: press with less force, or set material.law = linear"
            )
        return state


def _is_round(press: Press, body: Body, material: Material, state: ContactState) -> bool:
    """Return whether `FiniteStrain` solves a press: see the module."""
    return (
        not press.also
        and isinstance(body, Block)
        and isinstance(press.probe, Sphere | Cylinder | Cone)
        and press.friction == 0.0
        and not np.any(state.turns_deg)
        and not any(press.tilt_deg)
        and press.direction in (None, (0, 0, 1))
        and material.poisson_ratio >= LEAST_POISSON
        and _beside_mm(body, approach_of(press, body).axis_mm + state.move_mm)
        >= LEAST_BESIDE * state.contact_radius_mm
    )


def _beside_mm(body: Body, place: Floats) -> float:
    """Return how far a place is from the nearest side of a block, mm."""
    low, high = np.array(body.bounds_mm)
    return float(np.concatenate([place - low, high - place])[[0, 1, 3, 4]].min())


def _strain_of(
    press: Press,
    body: Body,
    material: Material,
    state: ContactState,
    watched: Points,
    *,
    coarse: bool = False,
    like: FiniteStrain | BodyStrain | None = None,
    path: Sequence[ContactState] = (),
) -> FiniteStrain | BodyStrain:
    """Return what linear theory leaves out of a state of a press: on a slab of revolution where
    that will do, else on a mesh of the whole body.

    Parameters and errors are those of `FiniteStrain` and `BodyStrain`.
    """
    if _is_round(press, body, material, state):
        return FiniteStrain(press, body, material, state, watched, coarse=coarse)
    from twin.world.contact.body_strain import BodyStrain

    near = like if isinstance(like, BodyStrain) else None
    return BodyStrain(press, body, material, state, watched, coarse=coarse, like=near, path=path)


def measured_linearity(
    press: Press, body: Body, material: Material, state: ContactState, watched: Points
) -> Validity:
    """Return a state's validity with how far linear theory is off under this very press.

    Neo-Hookean rubber is pressed on a coarse mesh: about .3 s on a slab of revolution, 1 to 3 s
    under a sphere on a curved body. Where that can't be done, or takes longer, the estimate stays,
    and `Validity.linearisation_basis` says why.
    """
    validity = state.validity
    if not state.load.terms:
        return replace(validity, linearisation_basis=f"{ESTIMATED}: nothing touches")
    rubber = material.model_copy(update={"law": "neo_hookean"})
    try:
        more = _strain_of(press, body, rubber, state, watched, coarse=True)
    except InputError as problem:
        cause = str(problem).removeprefix("material.law = neo_hookean: ").split(" at finite")[0]
        return replace(validity, linearisation_basis=f"{ESTIMATED}: {cause} at finite strain")
    except MeshError:
        return replace(validity, linearisation_basis=f"{ESTIMATED}: the press's mesh failed")
    except (ContactError, SolveError):
        cause = "Newton's steps at finite strain did not converge"
        return replace(validity, linearisation_basis=f"{ESTIMATED}: {cause}")
    deeper = more.indentation_mm / state.indentation_mm
    note = (
        f"linear theory is {100 * more.linear_error:.2g} % of the largest displacement off here, "
        f"and its indentation {100 * abs(deeper):.2g} % too {'small' if deeper > 0 else 'large'}; "
        "-s material.law=neo_hookean includes it"
    )
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
) -> ContactState:
    """Return the state of a press, and of every step of its path, with what linear theory leaves
    out.

    Loads and the pressures of patches stay those of the linear answer, on the undeformed surface;
    `Load.strained` is the difference. ``judge`` is called with every estimated error; the others
    are those of `FiniteStrain`, with what it raises. ``solve`` returns the linear answer of another
    press.
    """
    axes = approach_of(press, body).axes
    controls = press.in_own_axes(axes)
    path: list[ContactState] = []
    more: FiniteStrain | BodyStrain | None = None
    for one, (by_force, _) in zip(state.path, controls, strict=False):
        if not one.load.terms:
            path.append(one)
            continue
        before = more if press.friction > 0.0 else None
        more = _strain_of(press, body, material, one, watched, like=before, path=state.path)
        found = _Found(one, more, 0.0, axes)
        if not by_force[Z]:
            found = _held_by_motion(found, press, body, material, watched, solve)
        path.append(_strained(found, one, material.law, judge))
    return replace(path[-1], path=tuple(path), complete=state.complete, reason=state.reason)


@dataclass(frozen=True)
class _Found:
    """A linear answer, what it leaves out, d ln force / d ln indentation where a motion holds the
    probe, else 0, and the probe's own axes (3, 3)."""

    linear: ContactState
    more: FiniteStrain | BodyStrain
    stiffening: float
    axes: Floats

    @property
    def deep_mm(self) -> float:
        return self.linear.indentation_mm + self.more.indentation_mm

    @property
    def force_n(self) -> float:
        """The force along the probe's way."""
        return float(self.axes[Z] @ self.linear.force_n)

    @property
    def within(self) -> float:
        """How far the indentation may be off where a motion holds the probe, relative."""
        return _HELD if isinstance(self.more, FiniteStrain) else _HELD_ON_CURVED


def _held_by_motion(
    found: _Found,
    press: Press,
    body: Body,
    material: Material,
    watched: Points,
    solve: Callable[[Press], ContactState],
) -> _Found:
    """Return the answer under the force that takes a probe as deep as ``found.linear`` is.

    Secant steps of the logarithms: under most probes force is nearly a power of the indentation.
    """
    held = found.linear
    x, y, _ = found.axes @ held.move_mm
    stiffening = 1.5
    for _ in range(_FORCES):
        aside = math.log(held.indentation_mm / found.deep_mm)
        if abs(aside) < found.within:
            return replace(found, stiffening=stiffening)
        force = found.force_n * math.exp(stiffening * aside)
        step = Step(force_n=(None, None, force), move_mm=(float(x), float(y), None))
        one = Press(
            probe=press.probe,
            at_mm=press.at_mm,
            direction=press.direction,
            axes="probe",
            steps=(step,),
        )
        linear = solve(one).path[-1]
        more = _strain_of(one, body, material, linear, watched, like=found.more)
        after = _Found(linear, more, stiffening, found.axes)
        if abs(aside) > 10.0 * found.within:
            gained = math.log(after.deep_mm / found.deep_mm)
            stiffening = float(np.clip(stiffening * aside / gained, 0.5, 4.0))
        found = after
    raise NotSettled(
        f"contact: at finite strain (material.law = {material.law}) no force was found that holds "
        f"the probe {held.indentation_mm:.3g} mm deep: hold it by a force, or set "
        "material.law = linear"
    )


def _strained(
    found: _Found, asked: ContactState, law: str, judge: Callable[[PressError], None]
) -> ContactState:
    """Return a state with what linear theory leaves out of it.

    ``asked`` is the linear answer to the press as it was given; where a motion holds the probe, an
    error of the indentation under a force becomes one of the force.
    """
    state = found.linear
    more = found.more

    def estimate(_: ContactState) -> PressError:
        linear = asked.error
        assert linear is not None
        strain = more.error
        if found.stiffening:
            off = found.stiffening * (strain.indentation + found.within)
            strain = Share(force=off, markers=strain.markers + off)
        error = PressError.of(
            body=linear.body,
            patches=linear.patches,
            increments=linear.increments,
            strain=strain,
        )
        judge(error)
        return error

    if found.stiffening:
        what = "force"
        change = 100 * (found.force_n / float(found.axes[Z] @ asked.force_n) - 1.0)
    else:
        what = "indentation"
        change = 100 * more.indentation_mm / state.indentation_mm
    note = (
        f"large strain is included (material.law = {law}): under this force linear theory is "
        f"{100 * more.linear_error:.2g} % of the largest displacement off, and the {what} is "
        f"{abs(change):.2g} % {'larger' if change > 0 else 'smaller'} than by it"
    )
    also = tuple(
        _moved(other, more.moved[number], float(more.wider[number]), axes)
        for number, (other, axes) in enumerate(zip(state.also, more.axes[1:], strict=True), start=1)
    )
    return replace(
        _moved(state, more.moved[0], float(more.wider[0]), found.axes),
        also=also,
        load=replace(state.load, strained=more),
        validity=replace(
            state.validity,
            linearisation_error=more.linear_error,
            linearisation_basis=MEASURED,
            warnings=(),
            notes=(note,),
        ),
        estimate=estimate,
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
