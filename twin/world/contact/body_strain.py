"""What linear theory leaves out of presses on a curved body, of square pillars, of several probes
and of a sphere that sticks to a block: as `twin.world.contact.finite_strain.FiniteStrain`, on a
mesh of the whole body.

The displacement under a press is

    linear answer (`twin.world.contact.pressing`)
        + [finite-strain answer - linear contact answer, both on one coarse mesh],

under the same force. The mesh is the body's coarsest one, refined under the probes and at the rims
of flat faces. Its own error is in both answers and mostly cancels. The linear answer's Newton steps
begin at the contact of `pressing`, those of the other one at the linear answer.

A probe that sticks takes both answers along its path, in the same few parts of every step: what
this division leaves is in both, too. In a part what touches first slides freely; then it is held
from where it touched (`twin.world.contact.whole_body`), and the part is solved again.

A flat face's rim is rounded by a tenth of its half width at least, on which the difference hardly
depends.

Validity: rigid spheres, upright cylinders, pillars and cones, pressed along their ways without
friction on a block, a finger or a dome, several of them by forces; one sphere that sticks to a
block, pressed and moved by forces and torques; nu from 0.45. Where that sphere is guided it keeps
the force of linear theory, and `BodyStrain.error` states what is amiss with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import ContactError, InputError, NotSettled, SolveError
from twin.parts.body import Block, Body, Dome, Finger
from twin.parts.material import Material
from twin.parts.press import Press
from twin.parts.probe import Cone, Cylinder, Pillar, Sphere
from twin.world.contact.contact_state import ContactState, Share
from twin.world.contact.friction_law import STICKS_FROM
from twin.world.contact.probe_gap import MOTIONS, Approach, Z, approach_of, half_extent
from twin.world.contact.whole_body import (
    Equilibrated,
    Rubber,
    SurfaceTouch,
    newly_anchored,
    pressed_further,
    rows_of,
)
from twin.world.elasticity.mixed_rubber import largest, newton
from twin.world.elasticity.strain_law import LEAST_POISSON
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator, Places

_REACH = 1.6
"""Points so far from the contact's middle, over its radius, may touch."""


@dataclass(frozen=True)
class _Fineness:
    """The longest edge under the probe over the contact's radius, its growth away from there,
    mm/mm, the longest edge at a flat face's rim, and into how many parts the first step of a path
    with friction is divided, and a later one."""

    edge: float
    growth: float
    rim: float
    parts: tuple[int, int]


_FINE = _Fineness(0.85, 0.8, 0.3, (4, 2))
_COARSE = _Fineness(1.1, 0.9, 0.4, (3, 1))
"""The mesh of the answer, and the one that tells the error."""

LEAST_RIM = 0.1
"""Least radius of a flat face's rim over its half width: a sharper one is solved with this radius,
on which what linear theory leaves out hardly depends (docs/validity.md)."""

_TOLERANCE = 1e-3
_LAST_STEP = 3e-3
"""Newton's steps end at one that moves nothing by more than the second, a share of the largest
displacement; what is left then is below the first."""

_PART_STEP = 1.5e-2
"""The same within a part of a path with friction."""

_ERROR_OVER_CHANGE = 1.1
_FLAT_OVER_CHANGE = 1.5
"""The error over the change to the coarser mesh, and that under a flat face (docs/validity.md)."""

MOST_STEPS = 12
_LET_GO = 5
"""Newton's steps at most, and after how many of them points that lift off lose their anchors."""


@dataclass(frozen=True)
class _Pair:
    """The linear and the finite-strain answer on one mesh."""

    rubber: Rubber
    linear: Equilibrated
    finite: Equilibrated
    wider: Floats

    @cached_property
    def linear_mm(self) -> Points:
        """(N, 3) the linear displacement of the nodes, mm."""
        return self.rubber.displacement(self.linear.unknowns)

    @cached_property
    def change(self) -> Points:
        """(N, 3) what linear theory leaves out at the nodes, mm."""
        return self.rubber.displacement(self.finite.unknowns) - self.linear_mm

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.rubber.mesh)

    def places(self, points: Points) -> Places:
        """Return where points (n, 3) are in the mesh."""
        return self._locator.locate(points)


def _read(places: Places, field: Points) -> Points:
    """Return (n, 3) the values of a field (N, 3) of the nodes."""
    return np.asarray(np.einsum("qa,qai->qi", places.weights, field[places.nodes]))


class BodyStrain:
    """What linear theory leaves out of one state of a press on a whole body.

    Parameters, attributes and errors are those of
    `twin.world.contact.finite_strain.FiniteStrain`. It takes about 2 s under a sphere, 3 to 20 s
    under others; with ``coarse`` the others are refused. With ``like`` the mesh is that of a nearly
    equal press, so that the answers differ by the press alone, and the steps begin at its answers.
    A probe that sticks needs ``path``, all its states, and takes ``like`` from the state before.

    Raises
    ------
    InputError
        The press is not of the kind that is solved at finite strain.
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
        like: BodyStrain | None = None,
        path: Sequence[ContactState] = (),
    ) -> None:
        presses = (press.model_copy(update={"also": ()}), *press.also)
        approaches = [_rounded(approach_of(one, body)) for one in presses]
        self.axes = tuple(approach.axes for approach in approaches)
        problem = _unsolved(press, body, material, state, self.axes, path)
        if not problem and coarse:
            problem = _too_slow(press, body)
        if problem:
            raise InputError(
                f"material.law = {material.law}: {problem} at finite strain; change it, or set "
                "material.law = linear"
            )
        self._body = body
        self._material = material
        self._state = state
        self._path = tuple(path) or (state,)
        self._number = next(n for n, one in enumerate(self._path) if one is state)
        self._sticks = press.friction > 0.0
        self._controls = [
            one.in_own_axes(axes) for one, axes in zip(presses, self.axes, strict=True)
        ]
        self._contacts: list[tuple[Approach, list[tuple[Floats, float]]]] = [
            (
                approach,
                [
                    (_centre(one), one.contact_radius_mm)
                    for one in (_probes(there)[number] for there in self._history(state))
                ],
            )
            for number, approach in enumerate(approaches)
        ]
        if like is not None:
            self._contacts = like._contacts
        self._watched = watched if len(watched) else self._below_contact()
        self._pair: _Pair = self._solved(
            _COARSE if coarse else _FINE, None if like is None else like._pair
        )
        self.moved = self._pair.finite.pose - self._pair.linear.pose
        self.wider = self._pair.wider

    @property
    def indentation_mm(self) -> float:
        """How much deeper the first probe sinks than by linear theory, mm."""
        return float(self.moved[0, Z])

    def displacement(self, points: Points) -> Points:
        """Return (n, 3) what to add to the linear displacement of points (n, 3), mm."""
        return _read(self._pair.places(points), self._pair.change)

    def gradient(self, points: Points) -> Floats:
        """Return (n, 3, 3) what to add to the gradients du_i/dx_j."""
        return self._pair.places(points).gradients(self._pair.change)

    @cached_property
    def error(self) -> Share:
        """How far this may be off, over the linear answer: what a coarser mesh changes."""
        other = self._solved(_COARSE)
        moved = _read(other.places(self._watched), other.change)
        there = largest(moved - self.displacement(self._watched)) / largest(self._linear_there)
        deeper = (other.finite.pose - other.linear.pose - self.moved)[:, Z]
        deep = np.array([one.indentation_mm for one in _probes(self._state)])
        sunk = float(np.max(np.abs(deeper) / deep))
        flat = any(approach.is_flat for approach, _ in self._contacts)
        factor = _FLAT_OVER_CHANGE if flat else _ERROR_OVER_CHANGE
        along = slice(0, Z + 1)  # where a probe is guided it keeps the force of linear theory
        guided = (self._pair.finite.force - self._pair.linear.force)[0, along]
        force = self._pair.linear.force[0, along]
        return Share(
            force=float(np.linalg.norm(guided) / np.linalg.norm(force)) if self._sticks else 0.0,
            indentation=factor * sunk + _TOLERANCE,
            markers=factor * there + _TOLERANCE,
        )

    @cached_property
    def linear_error(self) -> float:
        """How far linear theory is off at the watched points, over the largest displacement."""
        return largest(self.displacement(self._watched)) / largest(self._linear_there)

    @cached_property
    def _linear_there(self) -> Points:
        """The mesh's linear displacement of the watched points: the scale of errors."""
        return _read(self._pair.places(self._watched), self._pair.linear_mm)

    def _below_contact(self) -> Points:
        """Return places below the contact, up to its radius deep."""
        _, near = self._contacts[0]
        centre, size = near[-1]
        inward = self._body.piece_normals(centre[None])[0, 0]
        return np.asarray(centre + size * np.linspace(0.3, 1.0, 8)[:, None] * inward)

    def _history(self, state: ContactState) -> Sequence[ContactState]:
        """Return the states on whose way friction makes the last one depend."""
        whole = [one for one in self._path if one.load.terms]
        return whole if self._sticks else (state,)

    def _solved(self, fineness: _Fineness, like: _Pair | None = None) -> _Pair:
        """Return both answers on a mesh, or on that of other ones, from where the steps begin."""

        # Mesh and contact.
        def wanted(points: Points) -> Floats:
            edges = np.full(len(points), np.inf)
            for approach, near in self._contacts:
                for centre, size in near:
                    away = np.linalg.norm(points - centre, axis=1) - size
                    here = fineness.edge * size + fineness.growth * np.maximum(away, 0.0)
                    edges = np.minimum(edges, here)
                    if approach.is_flat:
                        away = np.maximum(_from_rim(points, approach), 0.0)
                        edges = np.minimum(edges, fineness.rim * size + fineness.growth * away)
            return edges

        if like is None:
            mesh = refined(body_mesh(self._body, "sketch"), self._body, wanted, local=True)
            rubber = Rubber(mesh, self._body, self._material)
        else:
            rubber = like.rubber
        touches = [
            SurfaceTouch(
                rubber.mesh,
                self._body,
                approach,
                self._sticks,
                [(centre, _REACH * size) for centre, size in near],
            )
            for approach, near in self._contacts
        ]
        pair = self._along(rubber, touches, fineness, like)
        self._check_reach(touches, pair)
        return pair

    def _given(self, number: int) -> tuple[Bools, Floats]:
        """Return which motions (p, 6) forces hold at the end of a step, and these over Young's
        modulus, or the motions."""
        probes = zip(self._controls, self.axes, _probes(self._path[number]), strict=True)
        by_force, given = [], []
        for controls, axes, there in probes:
            forces, values = controls[number if len(self._path) > 1 else -1]
            held = np.array(forces)
            forced = np.array(values) / self._material.youngs_modulus_mpa
            pose = np.concatenate([axes @ there.move_mm, axes @ np.radians(there.turns_deg)])
            if not self._sticks:  # under the same force, whatever holds the probe
                held[Z] = True
                forced[Z] = axes[Z] @ there.force_n / self._material.youngs_modulus_mpa
            by_force.append(held)
            given.append(np.where(held, forced, pose))
        return np.array(by_force), np.array(given)

    def _along(
        self,
        rubber: Rubber,
        touches: list[SurfaceTouch],
        fineness: _Fineness,
        like: _Pair | None,
    ) -> _Pair:
        """Return both answers at the end of the path so far."""
        count = sum(len(touch.rest_mm) for touch in touches)
        none = Equilibrated.at_rest(rubber.size, len(touches), count)
        linear = finite = none
        first = self._number
        if self._sticks:
            first = 0
            if like is not None:
                linear, finite, first = like.linear, like.finite, self._number
        for number in range(first, self._number + 1):
            by_force, given = self._given(number)
            if not self._sticks:
                linear, finite = self._at_once(rubber, touches, like, none, by_force, given)
                continue
            parts = fineness.parts[min(number, 1)]
            begin = np.where(by_force, linear.force, linear.pose)
            for part in range(1, parts + 1):
                share = (part / parts) ** self._powers(by_force, number)
                now = begin + share * (given - begin)
                last = linear
                guess = linear
                if number == 0:
                    guess = self._grown(touches, linear, share)
                to = _LAST_STEP if part == parts else _PART_STEP
                linear = self._stuck_on(
                    rubber, touches, linear, guess, by_force, now, to, linear=True
                )
                lift = np.concatenate([touch.lift for touch in touches])
                guess = replace(
                    finite,
                    unknowns=finite.unknowns + linear.unknowns - last.unknowns,
                    pose=finite.pose + linear.pose - last.pose,
                    pressure=np.maximum(
                        finite.pressure + (linear.pressure - last.pressure) * lift, 0.0
                    ),
                )
                finite = self._stuck_on(
                    rubber, touches, finite, guess, by_force, now, to, linear=False
                )
        wider = [
            touch.spread_mm(finite.pressure[rows]) / touch.spread_mm(linear.pressure[rows])
            for touch, rows in zip(touches, rows_of(touches), strict=True)
        ]
        return _Pair(rubber=rubber, linear=linear, finite=finite, wider=np.array(wider))

    def _powers(self, by_force: Bools, number: int) -> Floats:
        """Return the powers of the share of a step with which what is given grows: parts are equal
        in the contact's radius."""
        powers = np.ones(by_force.shape)
        if number == 0:
            for own, held, (approach, _) in zip(powers, by_force, self._contacts, strict=True):
                if not approach.is_flat:
                    force, motion = (2.0, 1.0) if isinstance(approach.probe, Cone) else (3.0, 2.0)
                    own[:] = np.where(held, force, motion)
        return powers

    def _grown(
        self, touches: list[SurfaceTouch], before: Equilibrated, share: Floats
    ) -> Equilibrated:
        """Return where the steps of a part of the first step begin in the linear answer: its depth
        and contact by linear theory."""
        pose, active = before.pose.copy(), []
        for own, part, axes, there, touch in zip(
            pose, share, self.axes, _probes(self._path[0]), touches, strict=True
        ):
            own[Z] = part[Z] ** (2.0 / 3.0) * float(axes[Z] @ there.move_mm)
            gap, _ = touch.rest_gap(np.zeros(MOTIONS))
            active.append(gap <= 0.5 * own[Z])
        none = np.zeros(len(before.pressure))
        return replace(before, pose=pose, active=np.concatenate(active), pressure=none)

    def _at_once(
        self,
        rubber: Rubber,
        touches: list[SurfaceTouch],
        like: _Pair | None,
        none: Equilibrated,
        by_force: Bools,
        given: Floats,
    ) -> tuple[Equilibrated, Equilibrated]:
        """Return both answers without friction."""
        if like is None:
            probes = _probes(self._state)
            under = [
                _under_patches(one, touch.rest_mm)
                for one, touch in zip(probes, touches, strict=True)
            ]
            own = [axes @ one.move_mm for axes, one in zip(self.axes, probes, strict=True)]
            pose = none.pose.copy()
            pose[:, : Z + 1] = own
            start = replace(none, pose=pose, active=np.concatenate(under))
        else:
            start = like.linear
        linear = self._settled(rubber, touches, start, by_force, given, linear=True)
        if like is None:
            lift = np.concatenate([touch.lift for touch in touches])
            start = replace(linear, pressure=linear.pressure * lift)
        else:
            start = like.finite
        return linear, self._settled(rubber, touches, start, by_force, given, linear=False)

    def _stuck_on(
        self,
        rubber: Rubber,
        touches: list[SurfaceTouch],
        before: Equilibrated,
        guess: Equilibrated,
        by_force: Bools,
        given: Floats,
        to: float,
        *,
        linear: bool,
    ) -> Equilibrated:
        """Return the end of a part of a step: first what touches in it slides freely, then friction
        holds it from where it touched."""
        held, wanted = by_force, given
        if not before.anchors.on.any():
            held = by_force & (np.arange(MOTIONS) == Z)
            wanted = np.where(by_force & ~held, guess.pose, given)
        free = self._settled(rubber, touches, guess, held, wanted, _PART_STEP, linear=linear)
        start = newly_anchored(rubber, touches, before, free, linear=linear)
        return self._settled(rubber, touches, start, by_force, given, to, linear=linear)

    def _settled(
        self,
        rubber: Rubber,
        touches: list[SurfaceTouch],
        state: Equilibrated,
        by_force: Bools,
        given: Floats,
        to: float = _LAST_STEP,
        *,
        linear: bool,
    ) -> Equilibrated:
        """Take Newton's steps until one moves nothing."""
        problem: Exception | None = None
        still = False
        taken = 0

        def after(one: Equilibrated) -> Equilibrated:
            nonlocal taken
            taken += 1
            if taken > _LET_GO:  # a point that its own anchor pulls off comes and goes
                held = one.anchors.on & (one.pressure > 0.0)
                one = replace(one, anchors=replace(one.anchors, on=held))
            return pressed_further(rubber, touches, one, by_force, given, linear=linear)

        try:
            state, still = newton(
                after,
                lambda one: rubber.displacement(one.unknowns),
                state,
                MOST_STEPS,
                to,
            )
        except (NotSettled, SolveError) as found:
            problem = found
        if not still:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge in {MOST_STEPS}: press with less force, with a larger probe, or "
                "set material.law = linear"
            ) from problem
        return state

    def _check_reach(self, touches: list[SurfaceTouch], pair: _Pair) -> None:
        """Raise a ContactError where points touch that are as far off as any that may."""
        for state in (pair.linear, pair.finite):
            for touch, rows, (_, near) in zip(
                touches, rows_of(touches), self._contacts, strict=True
            ):
                on = touch.rest_mm[state.pressure[rows] > 0.0]
                away = [np.linalg.norm(on - centre, axis=1) / size for centre, size in near]
                if np.min(away, axis=0).max() > _REACH:
                    raise ContactError(
                        f"contact: at finite strain it grows beyond {_REACH:g} times its size by "
                        "linear theory: press with less force, or set material.law = linear"
                    )


def _under_patches(state: ContactState, points: Points) -> Bools:
    """Return (n,) whether points of the surface lie under patches in contact."""
    from scipy.spatial import cKDTree

    patches = state.patches
    assert patches is not None
    away, _ = cKDTree(patches.centre_mm).query(points)
    return np.asarray(away < 1.1 * patches.half_mm.max())


def _rounded(approach: Approach) -> Approach:
    """Return a probe at first touch whose face has a rim that is round enough."""
    probe = approach.probe
    if not isinstance(probe, Cylinder | Pillar):
        return approach
    edge = max(probe.edge_mm, LEAST_RIM * min(half_extent(probe)))
    return replace(approach, probe=probe.model_copy(update={"edge_mm": edge}))


def _from_rim(points: Points, approach: Approach) -> Floats:
    """Return (n,) how far points are from the rim of a flat face at first touch, mm."""
    own = np.abs((points - approach.axis_mm) @ approach.axes.T)
    half = np.array(half_extent(approach.probe))
    if isinstance(approach.probe, Cylinder):
        beside = np.hypot(own[:, 0], own[:, 1]) - half[0]
    else:
        beside = np.max(own[:, :Z] - half, axis=1)
        out = np.linalg.norm(np.maximum(own[:, :Z] - half, 0.0), axis=1)
        beside = np.where(beside > 0.0, out, beside)
    return np.asarray(np.hypot(beside, own[:, Z]))


def _probes(state: ContactState) -> tuple[ContactState, ...]:
    return (state, *state.also)


def _centre(state: ContactState) -> Floats:
    patches = state.patches
    assert patches is not None
    return np.asarray(patches.centre_mm.mean(axis=0))


def _too_slow(press: Press, body: Body) -> str:
    """Return why a press isn't solved to tell the error of linear theory alone: it takes more than
    3 s; empty if it is."""
    if press.friction > 0.0:
        return f"press.friction = {press.friction:g}: such a press takes about 10 s"
    single = not press.also and isinstance(press.probe, Sphere)
    return "" if single and not isinstance(body, Block) else "such a press takes 3 to 20 s"


def _unsolved(
    press: Press,
    body: Body,
    material: Material,
    state: ContactState,
    axes: tuple[Floats, ...],
    path: Sequence[ContactState],
) -> str:
    """Return why a press isn't solved at finite strain, and what is; empty if it is."""
    if not isinstance(body, Block | Finger | Dome):
        return f"body.shape = {body.geometry()['shape']}: blocks, fingers, domes are solved"
    if material.poisson_ratio < LEAST_POISSON:
        return (
            f"material.poisson_ratio = {material.poisson_ratio:g}: {LEAST_POISSON:g} to 0.5 is "
            "solved"
        )
    for one, own, there in zip((press, *press.also), axes, _probes(state), strict=True):
        held = np.array([by_force for by_force, _ in one.in_own_axes(own)])
        if not isinstance(one.probe, Sphere | Cylinder | Pillar | Cone):
            kind = one.probe.kind
            return f"press.probe.kind = {kind}: spheres, cylinders, pillars, cones are solved"
        if any(one.tilt_deg) and not isinstance(one.probe, Sphere):
            return "press.tilt_deg: upright probes are solved"
        if one.friction > 0.0:
            if press.also:
                return "press.also: several probes are solved without friction"
            if one.friction < STICKS_FROM:
                return f"press.friction = {one.friction:g}: friction 0 and inf are solved"
            if not held[:, Z].all():
                return "press: a probe that sticks is solved where a force presses it"
            given = [np.where(held, 0.0, value) for held, value in one.in_own_axes(own)]
            if np.any(given):
                return "press.steps: a probe that sticks is solved where forces and torques move it"
            if not (isinstance(body, Block) and isinstance(one.probe, Sphere)):
                return "press.friction = inf: a sphere that sticks to a block is solved"
            before = path[: next((n for n, other in enumerate(path) if other is state), 0)]
            if not all(other.load.terms for other in before):
                return "press.steps: a probe that sticks is solved until it is lifted"
        elif np.any(there.turns_deg) or held[:, np.arange(MOTIONS) != Z].any():
            return "press: probes that are guided along their way and don't turn are solved"
        if press.also and not held[:, Z].all():
            return "press.also: several probes are solved where forces press them all"
        if len(there.pressure_mpa) == 0:
            return "press: several probes are solved where all touch"
    return ""
