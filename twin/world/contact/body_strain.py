"""What linear theory leaves out of presses on a curved body, of square pillars, of several probes,
of tilted ones and of triangles, and of probes with friction, on a mesh of the whole body.

The mesh is the body's coarsest one, refined under the probes and at the rims of flat faces. The
linear solution's Newton steps begin at the contact of `pressing`, the other one's at the linear
solution, or go on from one load to the next.

Probes with friction take both solutions along their path, in the same few parts of every step. What
touches in a part first slides freely; then friction acts from where it touched
(`twin.world.contact.whole_body`), and the part is solved again.

A flat face's rim is rounded by a tenth of its half width at least, on which the difference hardly
depends.

Triangles (STL probes, objects) are replaced by smooth splines around the contact: Newton's steps
don't settle on normals that jump. Without friction a probe that motions turn is as one that was
tilted.

Validity: rigid probes, tilted or not, pressed along their ways without friction on any body,
triangles of probes where they are smooth, several by forces; with one coefficient of
friction where forces press them, moved sideways and turned about their ways, or spheres that roll,
flat faces while a part of them sticks; nu from 0.44.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from itertools import pairwise, takewhile

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import InputError, NotSettled
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.press import Cone, Cylinder, Object, Pillar, Press, Probe, Sphere, Stl
from twin.world.contact.contact_state import ContactState, Share
from twin.world.contact.mixed_rubber import MixedRubber
from twin.world.contact.probe_gap import ABOUT_X, MOTIONS, TURN, Approach, Z, half_extent
from twin.world.contact.round_slab import FiniteStrain, SlabStrain
from twin.world.contact.whole_body import (
    LAST_STEP,
    PART_STEP,
    RubberContact,
    SurfaceTouch,
)
from twin.world.elasticity.strain_law import LEAST_POISSON, strain_law
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator

_REACH = 1.6
"""Points so far from the contact's middle, over its radius, may touch."""


_ASIDE, _WIDER = 0.2, 0.1
"""Contacts of a path whose middles and radii differ by less, over the radius, are one to the mesh:
less than half its edges."""


@dataclass(frozen=True)
class _Fineness:
    """The longest edge under the probe over the contact's radius, that at a flat face's rim, and
    the parts of the first step of a path with friction, and of a later one."""

    edge: float
    rim: float
    parts: tuple[int, int]


_FINE = _Fineness(0.6, 0.3, (4, 2))
_COARSE = _Fineness(0.85, 0.4, (3, 1))
_GROWTH = 0.8
"""The mesh of the displacement, the one that estimates its error, and how edges grow away from the
contact on both."""

_WAY = 0.4
"""Most that a probe with friction moves sideways in a part of a step, or its contact where it
rolls, over the contact's radius."""

_LEAST_RIM, _COARSE_RIM = 0.1, 0.2
"""Least radius of a flat face's rim over its half width, and on the coarser mesh. On rubber thicker
than the face is wide what linear theory leaves out hardly depends on it (docs/validity.md)."""

_HARDEST, _SUNK = 0.2, 0.35
"""Mean pressure over Young's modulus, and indentation over the half width, beyond both of which
Newton's steps hardly settle on a face whose rim is solved rounder."""

_TOLERANCE = Share(indentation=2e-4, markers=1.5e-3)
"""What Newton's steps leave, and both meshes miss, over the largest displacement."""


@dataclass(frozen=True)
class _Shares:
    """The least error over what linear theory leaves out at a point, its growth per contact radius
    away from the contact's middle, the error over the change to the coarser mesh, the indentation's
    error over what linear theory leaves out of the displacement, the least error times a point's
    distance from the contact over its radius, which hardly depends on the strain, and the least
    error of the force across its way that friction and motions hold, over the whole force."""

    near: float
    growth: float
    change: float
    sunk: float
    shallow: float = 0.0
    across: float = 0.0

    @staticmethod
    def under(probe: Probe, radius_mm: float, *, rounded: bool, stiffens: bool) -> _Shares:
        """Return those under a probe whose contact has this radius, by whether its rim is solved
        rounder and its rubber stiffens."""
        if isinstance(probe, Sphere):
            return _ROUND
        if isinstance(probe, Cone):
            own = _SHARP if probe.tip_mm < _SHARP_TIP * radius_mm else _BLUNT
        elif isinstance(probe, Stl | Object):
            own = _SMOOTHED
        else:
            own = _ROUNDED if rounded else _FLAT
        if not stiffens:
            return own
        more = _STIFF if isinstance(probe, Cone) else 1.0
        near, growth, sunk = own.near * more, own.growth * more, own.sunk * _STIFF_SUNK
        return replace(own, near=near, growth=growth, sunk=sunk)


_ROUND = _Shares(0.025, 0.08, 0.4, 0.04)
_BLUNT = _Shares(0.11, 0.11, 0.7, 0.04)
_SMOOTHED = _Shares(0.08, 0.09, 0.7, 0.12, 0.0, 0.0015)
_FLAT = _Shares(0.11, 0.11, 0.7, 0.08, 0.0026, 0.0015)
_ROUNDED = _Shares(0.11, 0.11, 1.2, 0.08, 0.0026, 0.0015)
_SHARP = _Shares(0.3, 0.3, 0.7, 0.04)
"""Under spheres, under cones, under smooth triangles, under flat faces, under those that are solved
with a rounder rim, and under cones with sharp tips (docs/validity.md): from mesh to mesh of one
body the change scatters four times as much as the error."""

_STIFF, _STIFF_SUNK = 2.0, 2.5
"""How many times larger these are on rubber that stiffens, where the tips of cones strain it most,
and those of the indentation under cones and flat faces."""

_DEEPER = 0.07
"""The indentation's error over what linear theory leaves out of it: meshes as coarse under the
probe have this in common, most of it at the contact's end."""

_CELLS, _SEEN, _HIGH, _OFF = (16, 32), 1.8, 1.0, 0.02
"""Cells of the splines that stand for a probe's triangles along a side, first those of the coarser
mesh; half of the side over the contact's radius; how high above its lowest point, over the
indentation, the surface has to be smooth; and how far it may lie off, over that."""

_LONG = 1.4
"""A contact whose patches lie farther from its middle, over its radius, is a long one."""

_CLOSE = 0.3
"""Points closer to the contact, over its radius, have the error of those."""

_SHARP_TIP = 0.5
"""A cone whose tip has a smaller radius, over the contact's, is sharp."""

_RUBBED_TIP = 0.3
"""Friction under a cone with a sharper tip, over the contact's radius, mostly doesn't settle."""

_SLIPPING = 0.8
"""The largest share of a flat face with friction that may slip: points come under its front as it
slides, and the linear solution does not settle."""

_STUCK_OVER_CUBE = 20.0
"""What a probe that sticks adds to the error, over the cube of what linear theory leaves out: both
meshes miss what rubber does that is held and stretched far."""

_GUIDED = 0.12
"""The least error of what linear theory leaves out of a force or torque that a motion holds, over
that (docs/validity.md)."""


@dataclass(frozen=True, kw_only=True)
class _Pair(FiniteStrain.Solutions):
    contact: RubberContact
    linear: RubberContact.State
    finite: RubberContact.State


class BodyStrain(FiniteStrain):
    """What linear theory leaves out of one state of a press on a whole body.

    Parameters and errors are those of `twin.world.contact.round_slab.SlabStrain`, and an InputError
    where a press isn't solved. It takes about 2 s under a sphere, 3 to 20 s under others, which
    ``coarse`` refuses. ``like`` is a nearly equal press, whose mesh and solutions are begun with. A
    probe with friction needs ``path``, all its states, and ``like`` from the state before.
    """

    held_within = 5e-4

    _pair: _Pair

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
        sharp = [Approach.of_press(one, body) for one in presses]
        axes = tuple(approach.axes for approach in sharp)
        _refuse(material, _unsolved(press, body, material) or _unsolved_state(press, state, path))
        if coarse:
            _refuse(material, _too_slow(press, body))
        if not press.friction:
            sharp = [
                one.held_turned(one.axes @ np.radians(at.turns_deg))
                for one, at in zip(sharp, _probes(state), strict=True)
            ]
        touching = [one for one in path if one.load.terms] if press.friction and path else [state]
        along = zip(*map(_probes, touching), strict=True)
        turns = press.friction > 0.0
        smooth = [_smooth(one, to, turns=turns) for one, to in zip(sharp, along, strict=True)]
        approaches = [_rounded(one, _LEAST_RIM) for one, _, _ in smooth]
        self._rounder = [_rounded(one, _COARSE_RIM) for _, one, _ in smooth]
        for one, made, at in zip(sharp, approaches, _probes(state), strict=True):
            if made.probe is not one.probe:
                _refuse(material, _too_sharp(one, at, material))
        off = max(share for _, _, share in smooth)
        if off > _OFF:
            part = f"{100 * off:.2g} % of the indentation" if math.isfinite(off) else "its border"
            _refuse(
                material,
                f"press.probe: edges, steps or borders lie under the contact ({part} off a smooth "
                "surface); smooth ones are solved",
            )
        self._body = body
        self._drawn = [one.probe for one in presses]
        self._material = material
        self._path = tuple(path) or (state,)
        self._number = next(n for n, one in enumerate(self._path) if one is state)
        self._friction = press.friction
        self._rubs = press.friction > 0.0
        self._controls = [one.in_own_axes(own) for one, own in zip(presses, axes, strict=True)]
        if not path:
            self._controls = [steps[-1:] for steps in self._controls]
        self._like = like
        self._contacts = [
            (approach, _touched(touching, number)) for number, approach in enumerate(approaches)
        ]
        if like is not None:
            self._contacts = like._contacts
        if len(watched) == 0:  # below the contact, up to its radius deep
            centre, size = self._contacts[0][1][-1]
            inward = body.piece_normals(centre[None])[0, 0]
            deep = min(size, float(np.ptp(body.bounds_mm, axis=0)[Z]) / 2.0)
            watched = centre + deep * np.linspace(0.3, 1.0, 8)[:, None] * inward
        # Each share is the largest of all probes'.
        stiffens, radius_mm = strain_law(material).stiffens, state.contact_radius_mm
        shares = [
            _Shares.under(one.probe, radius_mm, rounded=one is not made, stiffens=stiffens)
            for one, made in zip(sharp, approaches, strict=True)
        ]
        self._shares = _Shares(*map(max, zip(*map(astuple, [_ROUND, *shares]), strict=True)))
        self._first = _COARSE if coarse else _FINE
        least = _TOLERANCE, Share(indentation=self._shares.sunk)
        super().__init__(axes, state, watched, self._shares.change, least)

    @staticmethod
    def check(press: Press, body: Body, material: Material) -> None:
        """Raise an InputError where a press is solved neither on a whole body nor on a slab."""
        if not SlabStrain.solves(press, body, material):
            _refuse(material, _unsolved(press, body, material))

    @cached_property
    def error(self) -> Share:
        """What a coarser mesh changes, or a share of what linear theory leaves out, and what
        friction adds."""
        found = super().error
        probes = _probes(self._state)
        places = [_place(one) for one in probes]
        away = [np.linalg.norm(self._watched - middle, axis=1) / size for middle, size in places]
        shares = self._shares.near + self._shares.growth * np.min(away, axis=0)
        least = MixedRubber.largest(shares[:, None] * self.displacement(self._watched))
        close = min(_away(one, self._watched).min() / one.contact_radius_mm for one in probes)
        shallow = self._shares.shallow / max(close, _CLOSE)
        markers = max(found.markers, least / self._largest_mm + _TOLERANCE.markers, shallow)
        deep = np.array([one.indentation_mm for one in probes])
        share = max(self._shares.near, _DEEPER) if self._rubs else _DEEPER
        sunk = found.indentation + share * float(np.max(np.abs(self.moved[:, Z]) / deep))
        found = replace(found, markers=markers, indentation=sunk)
        if not self._rubs:
            return found
        force = 0.0
        for number in range(len(probes)):
            held, other = self._held(self._pair, number), self._held(self._other, number)
            changed = self._held_share(other - held, number)
            across = self._shares.across * held[:Z].any()
            force = max(force, _GUIDED * self._held_share(held, number), changed, across)
        sticks = 1.0 - min(map(_slipping, probes))
        stuck = sticks * _STUCK_OVER_CUBE * self.linear_error**3
        return replace(found, force=force, markers=found.markers + stuck)

    def _held(self, pair: FiniteStrain.Solutions, probe: int) -> Floats:
        """Return (6,) how much larger, over Young's modulus, the force is with which motions hold
        a probe aside, and the torque about where it slid to once a motion turned it."""
        assert isinstance(pair, _Pair)
        linear, finite = pair.linear, pair.finite
        until = self._controls[probe][: self._number + 1]
        held = ~np.array(until[-1][0])
        held[Z:] = False
        turned = any(given[TURN] and not by_force[TURN] for by_force, given in until)
        held[TURN] = turned and not until[-1][0][TURN]
        more = finite.force[probe] - linear.force[probe]
        (x, y), (along, across) = linear.slid_mm[probe], linear.force[probe, :Z]
        more[TURN] += x * across - y * along
        return np.where(held, more, 0.0)

    def _held_share(self, more: Floats, probe: int) -> float:
        """Return such a force over the whole force, or torque over the path's: the larger."""
        force = self._pair.linear.force[probe, : Z + 1]
        share = float(np.linalg.norm(more[:Z]) / np.linalg.norm(force))
        if more[TURN]:
            until = self._path[: self._number + 1]
            torque = max(abs(_probes(one)[probe].torque_nmm) for one in until)
            share = max(share, abs(more[TURN]) * self._material.youngs_modulus_mpa / torque)
        return float(share)

    def more_force_n(self, patches: Rectangles, probe: int) -> Floats:
        if not self._rubs:
            return super().more_force_n(patches, probe)
        # A push and a turn, over the patches as the pressure is.
        approach, axes = self._contacts[probe][0], self.axes[probe]
        held = self._held(self._pair, probe) * self._material.youngs_modulus_mpa
        push = held[:Z] @ axes[:Z]
        share = patches.force_n @ axes[Z] / (patches.force_n @ axes[Z]).sum()
        middle = share @ patches.centre_mm
        arm = np.cross(axes[Z], patches.centre_mm - middle)
        from_axis = middle - approach.axis_mm - self._pair.linear.slid_mm[probe] @ axes[:Z]
        torque = held[TURN] - np.cross(from_axis, push) @ axes[Z]
        turn = torque / float(share @ (arm**2).sum(axis=1))
        return np.asarray(share[:, None] * (push + turn * arm))

    def leads_to(self, path: Sequence[ContactState]) -> bool:
        """Return whether a longer path has the same mesh, so that it goes on from here."""
        return all(
            len(_touched(path, number)) == len(near)
            for number, (_, near) in enumerate(self._contacts)
        )

    def _solved(self, other: bool) -> _Pair:
        """Return both solutions on a mesh; where a press is nearly equal, on its own."""
        fineness = _COARSE if other else self._first
        before = {} if self._like is None else vars(self._like)
        like = before.get("_other" if other else "_pair") if self._rubs or not other else None
        contacts = self._contacts
        if other:
            pairs = zip(self._rounder, contacts, strict=True)
            contacts = [(approach, near) for approach, (_, near) in pairs]

        # Mesh and contact.
        def wanted(points: Points) -> Floats:
            edges = np.full(len(points), np.inf)
            for approach, near in contacts:
                for centre, size in near:
                    away = np.linalg.norm(points - centre, axis=1) - size
                    here = fineness.edge * size + _GROWTH * np.maximum(away, 0.0)
                    edges = np.minimum(edges, here)
                    if approach.has_face:
                        away = np.maximum(_from_rim(points, approach), 0.0)
                        edges = np.minimum(edges, fineness.rim * size + _GROWTH * away)
            return edges

        if like is None:
            mesh = refined(body_mesh(self._body, "sketch"), self._body, wanted, local=True)
            touches = []
            for approach, near in contacts:
                reaches = [(centre, _REACH * size) for centre, size in near]
                touches.append(SurfaceTouch(mesh, self._body, approach, self._rubs, reaches))
            size = max(size for _, near in contacts for _, size in near)
            contact = RubberContact(mesh, self._body, self._material, touches, size, self._friction)
        else:
            contact = like.contact
        if self._rubs:
            linear, finite = self._along(contact, fineness, like)
        else:
            linear, finite = self._at_once(contact, like)
        moved = contact.rubber.displacement(finite.unknowns)
        wider = []
        for touch, rows, (_, near) in zip(contact.touches, contact.rows, contacts, strict=True):
            for one in (linear, finite):
                on = touch.rest_mm[one.pressure[rows] > 0.0]
                away = [np.linalg.norm(on - centre, axis=1) / size for centre, size in near]
                MixedRubber.check_reach(np.min(away, axis=0), _REACH)
            radius = touch.radius_mm(finite.pressure[rows], moved)
            wider.append(radius / touch.radius_mm(linear.pressure[rows]))
        locator = Locator(contact.rubber.mesh)

        def read(points: Points, field: Floats) -> tuple[Points, Floats]:
            places = locator.locate(points)
            values = np.einsum("qa,qai->qi", places.weights, field[places.nodes])
            return np.asarray(values), places.gradients(field)

        linear_mm = contact.rubber.displacement(linear.unknowns)
        return _Pair(
            read=read,
            linear_mm=linear_mm,
            change=moved - linear_mm,
            moved=finite.pose - linear.pose,
            wider=np.array(wider),
            contact=contact,
            linear=linear,
            finite=finite,
        )

    def _given(self, number: int) -> tuple[Bools, Floats, Floats]:
        """Return which motions (p, 6) forces hold at the end of a step, these over Young's modulus,
        or the motions, and all motions by linear theory."""
        by_force, given, poses = [], [], []
        for controls, axes, there in zip(
            self._controls, self.axes, _probes(self._path[number]), strict=True
        ):
            forces, values = controls[number]
            held = np.array(forces)
            forced = np.array(values) / self._material.youngs_modulus_mpa
            pose = np.concatenate([axes @ there.move_mm, axes @ np.radians(there.turns_deg)])
            if not self._rubs:  # under the same force, whatever holds the probe; turned as tilted
                held[Z] = True
                pose[ABOUT_X:] = 0.0
                forced[Z] = axes[Z] @ there.force_n / self._material.youngs_modulus_mpa
            by_force.append(held)
            given.append(np.where(held, forced, pose))
            poses.append(pose)
        return np.array(by_force), np.array(given), np.array(poses)

    def _along(
        self, contact: RubberContact, fineness: _Fineness, like: _Pair | None
    ) -> tuple[RubberContact.State, RubberContact.State]:
        """Return both solutions at the end of the path so far of probes with friction."""
        linear = finite = contact.at_rest()
        first = 0
        if like is not None:
            linear, finite, first = like.linear, like.finite, self._number
        for number in range(first, self._number + 1):
            parts = fineness.parts[min(number, 1)]
            if number:
                ends = zip(*map(_probes, self._path[number - 1 : number + 1]), strict=True)
                for axes, (before, after) in zip(self.axes, ends, strict=True):
                    aside = axes[:Z] @ (after.move_mm - before.move_mm)
                    rolled = _place(after)[0] - _place(before)[0]
                    way = float(max(np.linalg.norm(aside), np.linalg.norm(rolled)))
                    parts = max(parts, math.ceil(way / after.contact_radius_mm / _WAY))
            try:
                linear, finite = self._one_step(contact, number, parts, linear, finite)
            except NotSettled:
                linear, finite = self._one_step(
                    contact, number, 3 * parts, linear, finite, guided=True
                )
        return linear, finite

    def _one_step(
        self,
        contact: RubberContact,
        number: int,
        parts: int,
        linear: RubberContact.State,
        finite: RubberContact.State,
        *,
        guided: bool = False,
    ) -> tuple[RubberContact.State, RubberContact.State]:
        """Return both solutions after a step of a path with friction, taken in parts.

        ``guided``: where forces push the probe aside or turn it, motions do so in the linear
        solution, and their forces in the other one: this mesh may hold a little less by friction.
        """
        by_force, given, pose = self._given(number)
        pushed = by_force
        if guided:
            pushed = by_force & (np.arange(MOTIONS) == Z)
            given = np.where(by_force & ~pushed, pose, given)
        begin = np.where(pushed, linear.force, linear.pose)
        for part in range(1, parts + 1):
            # Parts of the first step are equal in the contact's radius.
            share = (part / parts) ** (np.where(pushed, 3.0, 2.0) if number == 0 else 1.0)
            now = begin + share * (given - begin)
            last = linear
            guess = self._grown(contact, linear, share) if number == 0 else linear
            to = LAST_STEP if part == parts else PART_STEP
            linear = contact.rubbed(linear, guess, pushed, now, to, linear=True)
            now = np.where(by_force & ~pushed, linear.force, now)
            guess = replace(finite, pose=finite.pose + linear.pose - last.pose)
            if np.array_equal(linear.slid_mm, last.slid_mm):
                pressure = finite.pressure + (linear.pressure - last.pressure) * contact.lift
                guess = replace(
                    guess,
                    unknowns=finite.unknowns + linear.unknowns - last.unknowns,
                    pressure=np.maximum(pressure, 0.0),
                )
            finite = contact.rubbed(finite, guess, by_force, now, to, linear=False)
        return linear, finite

    def _grown(
        self, contact: RubberContact, before: RubberContact.State, share: Floats
    ) -> RubberContact.State:
        """Return where a part of the first step begins in the linear solution: by its depth."""
        pose, active = before.pose.copy(), before.active.copy()
        for number, (touch, rows) in enumerate(zip(contact.touches, contact.rows, strict=True)):
            there = self.axes[number][Z] @ _probes(self._path[0])[number].move_mm
            deep = share[number, Z] ** (2.0 / 3.0) * float(there)
            pose[number, Z] = deep
            active[rows] = touch.rest_gap(np.zeros(MOTIONS))[0] <= 0.5 * deep
        return replace(before, pose=pose, active=active, pressure=0.0 * before.pressure)

    def _at_once(
        self, contact: RubberContact, like: _Pair | None
    ) -> tuple[RubberContact.State, RubberContact.State]:
        """Return both solutions without friction."""
        by_force, given, _ = self._given(self._number)
        if like is not None:
            start = like.linear
        else:
            start = contact.at_rest()
            pose, under = start.pose.copy(), []
            for number, one in enumerate(_probes(self._state)):
                pose[number, : Z + 1] = self.axes[number] @ one.move_mm
                under.append(_under_patches(one, contact.touches[number].rest_mm))
            start = replace(start, pose=pose, active=np.concatenate(under))

        def settle(
            state: RubberContact.State, share: float, *, linear: bool
        ) -> RubberContact.State:
            to = LAST_STEP if share == 1.0 else PART_STEP
            return contact.settled(state, by_force, share * given, to, linear=linear)

        linear = settle(start, 1.0, linear=True)
        if like is not None:
            return linear, settle(like.finite, 1.0, linear=False)
        pressure, tilt = linear.pressure * contact.lift, self._tilts(contact, linear)
        start = replace(linear, pressure=pressure, tilt=tilt)
        return linear, contact.rubber.loaded(settle, start)

    def _tilts(self, contact: RubberContact, linear: RubberContact.State) -> Floats:
        """Return by how much (p, 3) the direction of the force per pressure is tilted across each
        probe's way, so that the mesh's uneven pressure pushes the rubber no more aside than that
        of `pressing` does: of what a mesh is off, this reaches farthest."""
        moved = contact.rubber.displacement(linear.unknowns)
        locator = Locator(contact.rubber.mesh)
        tilts = np.zeros((len(contact.touches), Z + 1))
        for number, (touch, rows, one) in enumerate(
            zip(contact.touches, contact.rows, _probes(self._state), strict=True)
        ):
            if touch.approach.probe != self._drawn[number]:
                continue  # the peak of pressure at a sharper rim belongs to other slopes
            patches, axes, pose = one.patches, touch.axes, linear.pose[number]
            assert patches is not None
            at = locator.locate(patches.centre_mm)
            there = patches.centre_mm + np.einsum("qa,qai->qi", at.weights, moved[at.nodes])
            force = touch.area_mm2 * touch.lift * linear.pressure[rows]
            aside = touch.mean_push(there, patches.force_n @ axes[Z], pose)
            aside -= touch.mean_push(touch.deformed(moved), force, pose)
            tilts[number] = aside @ axes[:Z].T @ axes[:Z]
        return tilts


def _away(state: ContactState, points: Points) -> Floats:
    """Return (n,) how far points are from a contact's nearest patch, mm."""
    from scipy.spatial import cKDTree

    assert state.patches is not None
    return np.asarray(cKDTree(state.patches.centre_mm).query(points)[0])


def _under_patches(state: ContactState, points: Points) -> Bools:
    """Return (n,) whether points of the surface lie under patches in contact."""
    assert state.patches is not None
    return np.asarray(_away(state, points) < 1.1 * state.patches.half_mm.max())


def _rounded(approach: Approach, share: float) -> Approach:
    """Return a probe at first touch whose rim has this share of its half width, where its own is
    too sharp."""
    probe = approach.probe
    if not isinstance(probe, Cylinder | Pillar):
        return approach
    half = min(half_extent(probe))
    return approach if probe.edge_mm >= _LEAST_RIM * half else approach.with_edge(share * half)


def _smooth(
    approach: Approach, states: Sequence[ContactState], *, turns: bool
) -> tuple[Approach, Approach, float]:
    """Return a probe whose triangles are smooth around its contacts in these states, by the first
    number of cells that is close to them or the last; that of the first number; and how far the
    former is off, over the least indentation. ``turns``: whether it turned since first touch."""
    lows, highs = [], []
    for state in states:
        middle, size = _place(state)
        at = approach.axes @ (middle - approach.axis_mm - state.move_mm)
        if turns:
            at = at @ Approach.rotation_of(approach.axes @ np.radians(state.turns_deg))
        lows.append(at[:Z] - _SEEN * size)
        highs.append(at[:Z] + _SEEN * size)
    deep = [state.indentation_mm for state in states]
    fits = []
    for count in _CELLS:
        corners = np.min(lows, axis=0), np.max(highs, axis=0)
        fits.append(approach.smoothed(*corners, _HIGH * max(deep), count))
        if fits[-1][1] < _OFF * min(deep):
            break
    (smooth, off_mm), (coarse, _) = fits[-1], fits[0]
    return smooth, coarse, off_mm / min(deep)


def _too_sharp(approach: Approach, state: ContactState, material: Material) -> str:
    """Return why a flat face isn't solved with a rounder rim than its own; empty if it is."""
    half = min(half_extent(approach.probe))
    if any(approach.tilt_deg[:Z]):
        return (
            "press.probe.edge_mm: a tilted face touches with its rim, solved from "
            f"{_LEAST_RIM * half:.3g} mm on"
        )
    force_n = float(approach.axes[Z] @ state.force_n)
    hard = force_n / (state.area_mm2 * material.youngs_modulus_mpa)
    if hard < _HARDEST or state.indentation_mm < _SUNK * half:
        return ""
    return (
        f"press.probe.edge_mm: a sharp face's mean pressure is {hard:.2g} of Young's modulus; to "
        f"{_HARDEST:g} (less force), or with a rim of {_COARSE_RIM * half:.3g} mm it is solved"
    )


def _from_rim(points: Points, approach: Approach) -> Floats:
    """Return (n,) how far points are from the rim of a flat face at first touch, mm."""
    return np.asarray(np.hypot(approach.beyond_face(points), approach.own(points)[:, Z]))


def _probes(state: ContactState) -> tuple[ContactState, ...]:
    return (state, *state.also)


def _slipping(state: ContactState) -> float:
    """Return which share of the contact under one probe slips."""
    assert state.patches is not None
    return float(np.average(state.slip, weights=state.patches.half_mm.prod(axis=1)))


def _place(state: ContactState) -> tuple[Floats, float]:
    """Return the middle (3,) and the radius of a contact, mm."""
    patches = state.patches
    assert patches is not None
    return np.asarray(patches.centre_mm.mean(axis=0)), state.contact_radius_mm


def _touched(path: Sequence[ContactState], number: int = 0) -> list[tuple[Floats, float]]:
    """Return middles and radii of a probe's contacts along a path, also between the ends of its
    steps; none much like one before."""
    near = [_place(_probes(one)[number]) for one in path if one.load.terms]
    found = near[:1]
    for (before, small), (after, size) in pairwise(near):
        count = math.ceil(float(np.linalg.norm(after - before)) / min(small, size))
        for share in np.arange(1, count + 1) / max(count, 1):
            middle, radius = before + share * (after - before), small + share * (size - small)
            apart = [(np.linalg.norm(middle - at), abs(radius - r), r) for at, r in found]
            if all(max(aside / _ASIDE, wider / _WIDER) > r for aside, wider, r in apart):
                found.append((middle, radius))
    return found


def _too_slow(press: Press, body: Body) -> str:
    """Return why a press isn't solved for the error of linear theory alone; empty if it is."""
    if press.friction > 0.0:
        return f"press.friction = {press.friction:g}: such a press takes about 3 s"
    single = not press.also and isinstance(press.probe, Sphere)
    return "" if single and not body.is_flat else "such a press takes 3 to 20 s"


def _unsolved(press: Press, body: Body, material: Material) -> str:
    """Return why a press isn't solved on a whole body, and what is; empty if it is."""
    if material.poisson_ratio < LEAST_POISSON:
        return f"material.poisson_ratio: as made below {LEAST_POISSON:g}, from which it is solved"
    for one in (press, *press.also):
        controls = one.in_own_axes(Approach.of_press(one, body).axes)
        held = np.array([by_force for by_force, _ in controls])
        turned = np.abs(np.where(held, 0.0, [given for _, given in controls])).max(axis=0)
        if one.friction > 0.0:
            if isinstance(one.probe, Cone) and one.probe.tip_mm == 0.0:
                return (
                    "press.probe.tip_mm = 0: a cone with friction is solved with a round tip, from "
                    f"{_RUBBED_TIP:g} of the contact's radius on"
                )
            if not held[:, Z].all():
                return "press: a probe with friction is solved where a force presses it"
            if turned[ABOUT_X:TURN].any() and (
                not isinstance(one.probe, Sphere) or turned[TURN] or any(one.tilt_deg)
            ):
                return (
                    "press.steps turn the probe about x or y: with friction a sphere that rolls is "
                    "solved, neither tilted before nor turned about its way"
                )
        elif held[:, np.arange(MOTIONS) != Z].any():
            what = "press.steps give forces or torques"
            if one.force_n is not None:
                what = f"press.force_n = {one.force_n} has parts"
            return (
                f"{what} across its direction: without friction a probe that is guided along it "
                '(press.axes = "probe", press.force_n = (0, 0, force)) is solved'
            )
        if one.friction != press.friction:
            return "press.also: several probes are solved with the same friction"
        if press.also and not held[:, Z].all():
            return "press.also: several probes are solved where forces press them all"
    return ""


def _unsolved_state(press: Press, state: ContactState, path: Sequence[ContactState]) -> str:
    """Return why a state of a press isn't solved on a whole body; empty if it is."""
    before = takewhile(lambda other: other is not state, path)
    if press.friction > 0.0 and not all(other.load.terms for other in before):
        return "press.steps: a probe with friction is solved until it is lifted"
    if not all(len(one.pressure_mpa) for one in _probes(state)):
        return "press: several probes are solved where all touch"
    for probe, one in zip((press, *press.also), _probes(state), strict=True):
        flat = isinstance(probe.probe, Cylinder | Pillar)
        if flat and press.friction > 0.0 and _slipping(one) > _SLIPPING:
            return "press.steps: a flat face with friction is solved while a fifth of it sticks"
        middle, size = _place(one)
        if press.friction > 0.0 and isinstance(probe.probe, Cone):
            least = _RUBBED_TIP * size
            if probe.probe.tip_mm < least:
                return f"press.probe.tip_mm: a cone with friction is solved from {least:.2g} mm on"
        assert one.patches is not None
        far = np.linalg.norm(one.patches.centre_mm - middle, axis=1).max()
        if isinstance(probe.probe, Stl | Object) and far > _LONG * size:
            return "press.probe: its contact is long or hollow; round ones are solved"
    return ""


def _refuse(material: Material, problem: str) -> None:
    if problem:
        raise InputError(
            f"material.law = {material.law}: {problem} at finite strain; change it, or set "
            "material.law = linear"
        )
