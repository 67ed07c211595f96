"""A whole body of rubber on a coarse mesh, pressed by rigid probes: linear or at finite strain.

**Rubber.** `twin.world.contact.mixed_rubber` on tetrahedra.

**Contact.** Pressures at the integration points of the surface; g is a point's gap to the probe.

    pressure = -k g > 0, or pressure = 0 and g > 0;  the forces along each probe's way sum to the
    given one.

In the linear solution g and forces are along the surface's normal at the undeformed place, as in
`twin.world.contact.pressing`. In the other one g is measured at the deformed place, along the
probe's way, with forces along the probe's normal. The springs k are a film of rubber on the probe,
a hundredth of the contact's radius thick, in both: stiffer ones make the pressures of neighbouring
points alternate. The probes' places are unknowns.

**Friction.** A spring as stiff holds a point that has touched to its place on the probe, in the
plane of the probe's surface, up to the bound of the law of friction; at the end of a part of a step
that place follows what it slips. In the linear solution its gap is that of a point that moves with
the probe, and what all points slip in common is a slide of the probe, as in
`twin.world.contact.contact_problem`.

**Steps.** In each of Newton's the rubber is condensed to the nodes that may touch, by the Schur
complement of its tangent, and contact is balanced there by an active set of points. Without
friction the tangent at rest will do at finite strain, too, where the last steps are mixed: to
factor a tangent takes as long as five to ten steps. Else, and where such steps don't settle, an
earlier state's stays while steps shrink fast enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import NotSettled
from twin.parts.body import Body
from twin.parts.material import Material
from twin.world.contact.friction_law import LAW, STICKS_FROM
from twin.world.contact.mixed_rubber import MixedRubber
from twin.world.contact.probe_gap import (
    ABOUT_X,
    MOTIONS,
    TURN,
    Approach,
    Z,
    half_extent,
)
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.strain_law import cofactor_slope
from twin.world.mesh.quadratic_mesh import Mesh, inverses, quadrature, shapes

_SPRING = 100.0
_GAP_WEIGHT = 2.0
"""Pressure per overlap, and what a pressure is weighed against a gap with, times the contact's
radius over Young's modulus."""

_NEAR_END = 0.05, 0.6
"""Shares of the force beyond points from which a round contact's end is extrapolated."""

_CHUNK = 256
"""Elements whose slopes are computed at once."""

_NUDGE_MM = 1e-4

_BESIDE_FACE = 0.1
"""Points so far outside a flat face's outline, over its smaller half width, may come under it."""

_ALL_SLIP, _ANCHORED = 0.8, 0.98
"""A probe slides as a whole where points that slip carry more than this share of the force, looked
for from this share of the force on anchored points."""

_AT_BOUND = 1e-4
"""How far friction may pass its bound before a point slips, relative: all points of a probe that
slid and is held lie at it."""

_SLIDES, _SLID_MM, _SLID_MOST_MM = 16, 1e-4, 2e-3
"""How often such a slide is corrected, how well it is known then, and how well at least."""

_STEEPEST = 0.05
"""A probe's surface whose normal has a smaller part along its way doesn't touch."""

_SLOW = 0.3
"""Newton's steps that shrink by less than to this share need the tangent at the present state."""

_MIXED_STEPS = 10
"""Most of Newton's steps by the stiffness at rest."""

_FEW_BALANCES, _MOST_BALANCES, _BALANCED, _FULL_STEPS = 12, 100, 1e-6, 15
"""Most iterations of a balance of contact at finite strain by the stiffness at rest, and of others,
the relative step at which they end, and after how many steps are shortened."""

_STRAINED = 0.03
"""Elements with no larger change of F, or pressure over the shear modulus, have the tangent of
rest."""

_RESIDUAL = 1.0
"""Of a linear solution, relative: refinement is not worth its time, as Newton's steps go on."""

LAST_STEP = 3e-3
PART_STEP = 1.5e-2
"""Newton's steps end at one that moves nothing by more than this share of the largest displacement
(a thousandth is left then); within a path's step, by more than the other."""

MOST_STEPS = 12
_LET_GO = 5
"""Newton's steps at most, and after how many of them points that lift off lose their anchors."""


class Rubber(MixedRubber):
    """Rubber in the shape of a mesh, held on the body's held pieces; ``touching`` (k,) are nodes
    that may touch."""

    _axes = 3

    def __init__(
        self, mesh: Mesh, body: Body, material: Material, touching: Ints | None = None
    ) -> None:
        super().__init__(material)
        self.mesh = mesh
        places, weights = quadrature(3)
        slopes = shapes(places)[1]
        self._shares = np.column_stack([1.0 - places.sum(axis=1), places])
        jacobian = np.einsum("mai,qaj->mqij", mesh.points[mesh.tets], slopes, optimize=True)
        inverse, determinant = inverses(jacobian)
        self._volume = determinant * weights
        self._slopes = slopes @ inverse
        self._moves = 3 * len(mesh.points)
        self.size = self._moves + mesh.corners
        moved = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 30)
        self._row = np.hstack([moved, self._moves + mesh.tets[:, :4]])
        held = np.zeros(self.size, bool)
        held[: self._moves] = np.repeat(mesh.nodes_on(body.held_pieces), 3)
        self._hold(held, np.zeros(0, int) if touching is None else touching)
        tenth = np.repeat(self._volume.sum(axis=1) / 20.0 / self._shear, 4)
        self._scale = MixedRubber.gathered(self._row[:, 30:], tenth, self.size)
        nodes = np.arange(len(mesh.points))
        self._node = np.concatenate([np.repeat(nodes, 3), nodes[: mesh.corners]])

    def _gradient(self, moved: Floats, some: Ints) -> Floats:
        own = moved[:, None].reshape(-1, 1, 10, 3)
        return np.asarray(own.swapaxes(2, 3) @ self._slopes[some] + np.eye(3))

    def _forces(self, stress: Floats) -> Floats:
        return np.asarray((self._slopes @ stress.swapaxes(2, 3)).sum(axis=1).reshape(-1, 30))

    def _stiffness(self, slope: Floats, some: Ints) -> Floats:
        slopes = self._slopes[some]
        count, places = slopes.shape[:2]
        # d P_ik / d F_jl between the shapes a and b: first a's slope along k, then b's along l
        turned = slope.transpose(0, 1, 3, 2, 4, 5).reshape(count, places, 3, 27)
        half = (slopes @ turned).reshape(count, places, 90, 3).transpose(0, 2, 1, 3)
        along = slopes.transpose(0, 1, 3, 2).reshape(count, places * 3, 10)
        stiff = (half.reshape(count, 90, places * 3) @ along).reshape(count, 10, 3, 3, 10)
        return np.asarray(stiff.transpose(0, 1, 2, 4, 3).reshape(count, 30, 30))

    def _swelling(self, cofactor: Floats, some: Ints) -> Floats:
        return (self._slopes[some] @ cofactor.swapaxes(2, 3)).reshape(*cofactor.shape[:2], 30)

    def tangent(self, unknowns: Floats) -> Any:
        """See `MixedRubber.tangent`; that at rest where the strain is small."""
        gradient, _, _, pressure = self._strained(unknowns, np.arange(len(self._row)))
        change = np.abs(gradient - np.eye(3)).max(axis=(1, 2, 3))
        change = np.maximum(change, np.abs(pressure).max(axis=1) / self._shear)
        strained = np.flatnonzero(change > _STRAINED)
        more = self._chunked_blocks(unknowns, strained) - self._rest_blocks[strained]
        return self.at_rest + MixedRubber.summed(more, self._row[strained], self.size)

    @cached_property
    def at_rest(self) -> Any:
        """See `MixedRubber.at_rest`."""
        return MixedRubber.summed(self._rest_blocks, self._row, self.size)

    @cached_property
    def _rest_blocks(self) -> Floats:
        """`MixedRubber._blocks` at rest, where the slope of the stress is one everywhere."""
        count, places = self._volume.shape
        own = self._slopes.reshape(count, places, 30)
        weighted = self._volume[..., None] * self._shares
        products = (self._volume[..., None] * own).swapaxes(1, 2) @ own
        products = products.reshape(count, 10, 3, 10, 3).swapaxes(2, 3).reshape(-1, 9)
        one = np.eye(3)
        slope = self._shear * self._law.slope(one, one, np.ones(()), cofactor_slope(one))
        stiff = (products @ slope.transpose(1, 3, 0, 2).reshape(9, 9)).reshape(-1, 10, 10, 3, 3)
        by_volume = own.swapaxes(1, 2) @ weighted
        squares = -self._softness * (self._shares.T @ weighted)
        blocks = np.empty((count, 34, 34))
        blocks[:, :30, :30] = stiff.swapaxes(2, 3).reshape(count, 30, 30)
        blocks[:, :30, 30:] = by_volume
        blocks[:, 30:, :30] = by_volume.swapaxes(1, 2)
        blocks[:, 30:, 30:] = squares
        return blocks

    def _chunked_blocks(self, unknowns: Floats, some: Ints) -> Floats:
        parts = range(0, max(len(some), 1), _CHUNK)
        return np.concatenate([self._blocks(unknowns, some[n : n + _CHUNK]) for n in parts])


@dataclass(frozen=True)
class _Met:
    """How the points (q,) of a surface meet a probe."""

    gap: Floats  # (q,) mm; inf where the probe can't be met
    push: Floats  # (q, 3) its slope by the points' places: the direction of the force per pressure
    bend: Floats  # (q, 3, 3) the slope of ``push`` by the points' places, 1/mm
    per_motion: Floats  # (q, 6) the gap's slope by the probe's place
    lift: Floats  # (q, 6) the probe's force and torque per pressure
    normal: Floats  # (q, 3) of the plane in which friction acts
    away: Floats  # (q, 3) how far the points are from their anchors, global axes, mm
    carry: Floats  # (q, 3, 6) how the probe carries its points


@dataclass(frozen=True)
class _Rub:
    """Friction on the points (q,) of a surface."""

    force: Floats  # (q, 3) on the body, over Young's modulus, per area
    resistance: Floats  # (q, 3, 3) it over the way to the anchors, 1/mm
    along: Floats  # (q, 3) a root of what its slope lacks of that where points slip
    grip: Floats  # (q, 3) its slope by the pressure
    slips: Bools  # (q,) whether it is at its bound
    slipped: Floats  # (q, 3) how far the points slipped over the probe, mm


@dataclass(frozen=True)
class _Springs:
    """The springs of points that touch: their unknowns are some of the contact's displacements,
    with these numbers ``nodes``, then the probes' motions."""

    nodes: Ints
    force: Floats  # what they take from each unknown
    slope: Floats  # its slope
    lacks: Floats  # what this lacks where points slip
    after: Callable[[Floats, Floats], RubberContact.State]
    """The state after a change of the contact's displacements and a step of the motions."""


@dataclass(frozen=True)
class _Anchors:
    """Where the points (q,) of a surface hold on to the probe."""

    on: Bools  # (q,) which do
    place: Floats  # (q, 3) mm: on the probe, see `SurfaceTouch.place`
    closed: Floats  # (q,) linear gap of those, had they always moved with the probe, mm
    shape: Floats  # (q,) gap of the probe's shape where it had slid to when they touched, mm

    @classmethod
    def none(cls, count: int) -> _Anchors:
        return cls(
            np.zeros(count, bool), np.zeros((count, 3)), np.zeros(count), np.full(count, np.inf)
        )

    def of(self, rows: slice) -> _Anchors:
        return _Anchors(self.on[rows], self.place[rows], self.closed[rows], self.shape[rows])


class SurfaceTouch:
    """The integration points (q,) of the sensing surface that a probe may touch.

    Parameters
    ----------
    mesh, body
        The body and its mesh.
    approach
        The probe at first touch; ``lift`` (q,) is the force along its way per pressure.
    rubs
        Whether friction acts on points that touch it.
    near
        Centres (3,) and reaches, mm: faces with points so near to one of them may touch.
    """

    def __init__(
        self,
        mesh: Mesh,
        body: Body,
        approach: Approach,
        rubs: bool,
        near: Sequence[tuple[Floats, float]],
    ) -> None:
        faces = mesh.faces[mesh.piece == 0]
        places, share = quadrature(2)
        values, slopes = shapes(places)
        corner = mesh.points[faces]
        points = np.einsum("qa,fai->fqi", values, corner)
        used = np.zeros(len(faces), bool)
        for centre, reach_mm in near:
            used |= np.linalg.norm(points - centre, axis=2).min(axis=1) <= reach_mm
        if approach.has_face:
            aside = approach.beyond_face(points.reshape(-1, 3)).reshape(points.shape[:2])
            used &= aside.min(axis=1) <= _BESIDE_FACE * min(half_extent(approach.probe))
        along = np.einsum("qaj,fai->fqji", slopes, corner[used])
        area = np.linalg.norm(np.cross(along[:, :, 0], along[:, :, 1]), axis=2) * share
        self.rest_mm = points[used].reshape(-1, 3)
        self.area_mm2 = area.ravel()
        self.nodes = np.repeat(faces[used], len(places), axis=0)
        self.weights = np.tile(values, (int(used.sum()), 1))
        self.inward = body.piece_normals(self.rest_mm)[:, 0]
        self._rubs = rubs
        self.approach = approach
        self.axes = approach.axes
        self.lift = self.inward @ approach.axes[Z]
        self._frames = np.broadcast_to(np.eye(3), (len(self.inward), 3, 3))
        self._carry = approach.jacobian(self.rest_mm, self._frames, np.zeros(3))
        self._along = np.einsum("qi,qim->qm", self.inward, self._carry)

    def _shift(self, displacement: Floats) -> Floats:
        """Return the (q, 3) displacement of the points."""
        return np.asarray(np.einsum("qa,qai->qi", self.weights, displacement[self.nodes]))

    def place(self, displacement: Floats, pose: Floats, *, linear: bool) -> Floats:
        """Return where the points (q, 3) are in the probe's own axes, mm; in the linear solution
        how much farther than it they moved."""
        shift = self._shift(displacement)
        if linear:
            return np.asarray(shift - self._carry @ pose)
        return self._in_own_axes(self.rest_mm + shift, pose)

    def _in_own_axes(self, place: Points, pose: Floats) -> Points:
        """Return where deformed places (n, 3) are in the probe's own axes, mm."""
        own = (place - self.approach.axis_mm) @ self.axes.T
        return np.asarray((own - pose[: Z + 1]) @ Approach.rotation_of(pose[ABOUT_X:]))

    def own(self, ways: Floats, pose: Floats, *, linear: bool) -> Floats:
        """Return ways (q, 3) of points in the axes of `place`."""
        if linear:
            return ways
        return np.asarray(ways @ self.axes.T @ Approach.rotation_of(pose[ABOUT_X:]))

    def rest_gap(self, pose: Floats, slid_mm: Floats | None = None) -> tuple[Floats, Floats]:
        """Return the undeformed surface's gaps (q,) in the linear solution, and slopes (q, 6); with
        friction it moves sideways with the probe, and a round one rolls over it."""
        if not self._rubs:
            return self.approach.gap(self.rest_mm, self.inward, pose)
        motions = np.arange(MOTIONS)
        comes = (motions == Z) | (self.approach.is_round & (motions >= ABOUT_X) & (motions < TURN))
        lowered = np.where(comes, pose, 0.0)
        if slid_mm is not None:
            lowered[:Z] = slid_mm
        gap, slope = self.approach.gap(self.rest_mm, self.inward, lowered)
        slope = np.where(comes, slope, -self._along)
        return gap - self._along @ (pose - lowered), slope

    def anchored_gap(self, pose: Floats, slid_mm: Floats) -> tuple[Floats, Floats]:
        """Return the gaps (q,) at place 0 of points that touch at a place and then move with the
        probe, and those of the probe's shape at first touch where it slid to."""
        gap = self.rest_gap(pose, slid_mm)[0] + self._along @ pose
        return gap, self.rest_gap(np.zeros(MOTIONS), slid_mm)[0]

    def meet(
        self,
        displacement: Floats,
        pose: Floats,
        anchors: _Anchors | None = None,
        slid_mm: Floats | None = None,
        *,
        linear: bool,
    ) -> _Met:
        """Return how the points meet the probe at a place (6,); ``slid_mm`` is of the linear
        solution."""
        slid_mm = np.zeros(Z) if slid_mm is None else slid_mm
        anchors = _Anchors.none(len(self.rest_mm)) if anchors is None else anchors
        shift = self._shift(displacement)
        axes = self.approach.axes
        none = np.zeros((len(shift), 3, 3))
        if linear:
            gap, slope = self.rest_gap(pose, slid_mm)
            now = self.rest_gap(np.zeros(MOTIONS), slid_mm)[0]
            known = np.isfinite(anchors.shape)
            since = np.where(known, now - np.where(known, anchors.shape, 0.0), 0.0)
            gap = np.where(anchors.on, anchors.closed + since - self._along @ pose, gap)
            slope = np.where(anchors.on[:, None], -self._along, slope)
            return _Met(
                gap=gap + np.einsum("qi,qi->q", self.inward, shift),
                push=self.inward,
                bend=none,
                per_motion=slope,
                lift=self._along,
                normal=self.inward,
                away=shift - self._carry @ pose - anchors.place,
                carry=self._carry,
            )
        turned = Approach.rotation_of(pose[ABOUT_X:])
        place = self.rest_mm + shift
        aside = pose[: Z + 1] @ axes
        own = ((place - self.approach.axis_mm - aside) @ axes.T) @ turned
        upright = np.broadcast_to([0.0, 0.0, 1.0], own.shape)

        def met(points: Points) -> tuple[Floats, Floats, Floats]:
            gap, normal = self.approach.shape.met(points, upright)
            gap = np.where(normal[:, Z] > _STEEPEST, gap, np.inf)
            return gap, normal / np.maximum(normal[:, Z:], _STEEPEST), normal

        gap, push, normal = met(own)
        for axis in range(Z):
            nudge = _NUDGE_MM * np.eye(3)[axis]
            (above, more, _), (below, less, _) = met(own + nudge), met(own - nudge)
            sound = np.isfinite(gap) & np.isfinite(above) & np.isfinite(below)
            none[sound, :, axis] = ((more - less) / (2.0 * _NUDGE_MM))[sound]
        outer = turned.T @ axes  # the probe's own axes as rows
        push = push @ outer
        carry = self.approach.jacobian(place, self._frames, aside)
        carry[:, :, ABOUT_X:] = carry[:, :, ABOUT_X:] @ Approach.turning_of(pose[ABOUT_X:])
        lift = np.einsum("qi,qim->qm", push, carry)
        return _Met(
            gap=gap,
            push=push,
            bend=outer.T @ none @ outer,
            per_motion=-lift,
            lift=lift,
            normal=normal @ outer,
            away=(own - anchors.place) @ outer,
            carry=carry,
        )

    def deformed(self, displacement: Floats) -> Points:
        """Return where the points (q, 3) are, mm."""
        return np.asarray(self.rest_mm + self._shift(displacement))

    def mean_push(self, place: Points, force: Floats, pose: Floats) -> Floats:
        """Return the mean direction (3,) of the force per pressure of points of the surface at
        deformed places (n, 3), by their forces (n,) along the probe's way."""
        own = self._in_own_axes(place, pose)
        upright = np.broadcast_to([0.0, 0.0, 1.0], own.shape)
        normal = self.approach.shape.met(own, upright)[1]
        push = normal / np.maximum(normal[:, Z:], _STEEPEST)
        outer = Approach.rotation_of(pose[ABOUT_X:]).T @ self.axes  # the probe's own axes as rows
        return np.asarray((force @ push / force.sum()) @ outer)

    def radius_mm(self, pressure: Floats, displacement: Floats | None = None) -> float:
        """Return the radius of the contact, at rest or after a displacement, mm; of a flat face the
        root mean square distance of the pressure from its middle.

        Under Hertz's pressure the force beyond r is as (a^2 - r^2)^1.5.
        """
        place = self.rest_mm if displacement is None else self.deformed(displacement)
        force = pressure * self.area_mm2 / (pressure @ self.area_mm2)
        squared = ((place - force @ place) ** 2).sum(axis=1)
        if not self.approach.is_round:
            return float(np.sqrt(force @ squared))
        order = np.argsort(squared)
        beyond = 1.0 - np.cumsum(force[order]) + force[order] / 2.0
        low, high = _NEAR_END
        near = (beyond > low) & (beyond < high)
        line = np.polynomial.Polynomial.fit(squared[order][near], beyond[near] ** (2.0 / 3.0), 1)
        return float(np.sqrt(line.roots()[0].real))


class RubberContact:
    """Rubber and the points of its surface that each of the probes (p,) may touch, with one
    coefficient of friction, for whose law alone the rubber's modulus matters. ``size_mm`` is the
    contact's radius, which the springs depend on."""

    @dataclass(frozen=True)
    class State:
        """A state of a body and probes (p,)."""

        unknowns: Floats  # the rubber's
        pose: Floats  # (p, 6) the probes' places, mm and radians
        pressure: Floats  # (q,) of the points of one probe after the other, over Young's modulus
        active: Bools  # (q,) whether they were sought
        anchors: _Anchors  # where these hold on to the probes
        force: Floats  # (p, 6) forces and torques on the body, over Young's modulus
        slips: Bools  # (q,) points whose friction is at its bound
        slid_mm: Floats  # (p, 2) how far the probes slid as a whole, in the linear solution
        tilt: Floats  # (p, 3) what is added to the direction of the force per pressure

    def __init__(
        self,
        mesh: Mesh,
        body: Body,
        material: Material,
        touches: Sequence[SurfaceTouch],
        size_mm: float,
        friction: float = 0.0,
    ) -> None:
        self._spring = _SPRING / size_mm
        self._gap_weight = _GAP_WEIGHT / size_mm
        self._friction = friction
        self._rubs = friction > 0.0
        self._modulus_mpa = material.youngs_modulus_mpa
        self.touches = touches
        counts = [len(touch.rest_mm) for touch in touches]
        ends = np.cumsum([0, *counts])
        self.rows = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.lift = np.concatenate([touch.lift for touch in touches])
        self._owner = np.repeat(np.arange(len(touches)), counts)
        self._weight = np.concatenate([touch.weights for touch in touches])
        self._area = np.concatenate([touch.area_mm2 for touch in touches])
        # The contact's own unknowns: displacements of its nodes.
        nodes, local = np.unique(
            np.concatenate([touch.nodes for touch in touches]), return_inverse=True
        )
        self.rubber = Rubber(mesh, body, material, nodes)
        self._lately: Factor | None = None  # of an earlier state at finite strain, while it will do
        self._row = (3 * local.reshape(-1, 6)[:, :, None] + np.arange(3)).reshape(-1, 18)

    def at_rest(self) -> RubberContact.State:
        """Return the state in which nothing touches."""
        none = np.zeros((len(self.touches), MOTIONS))
        points = len(self._owner)
        return RubberContact.State(
            unknowns=np.zeros(self.rubber.size),
            pose=none,
            pressure=np.zeros(points),
            active=np.zeros(points, bool),
            anchors=_Anchors.none(points),
            force=none,
            slips=np.zeros(points, bool),
            slid_mm=none[:, :Z],
            tilt=none[:, : Z + 1],
        )

    def settled(
        self, state: RubberContact.State, by_force: Bools, given: Floats, to: float, *, linear: bool
    ) -> RubberContact.State:
        """Return the state after Newton's steps, which end at one that moves nothing.

        ``given`` (p, 6) are forces over Young's modulus, mm2, where ``by_force`` (p, 6), else
        places; ``to`` is `LAST_STEP` or `PART_STEP`.
        """
        rubber = self.rubber
        held = by_force, given

        def after(state: RubberContact.State, stiffness: Factor) -> RubberContact.State:
            return self._stepped(state, stiffness, *held, linear=linear)

        if linear:  # but for contact, whose balance each step ends in, it is linear: one will do
            return rubber.newton(
                partial(after, stiffness=rubber.rest_stiffness), state, 1, math.inf
            )
        if not self._rubs:
            with suppress(NotSettled):
                return rubber.mixed(after, state, _MIXED_STEPS, to)
        last_mm = math.inf

        def renewed(state: RubberContact.State) -> RubberContact.State:
            """Take one by the present stiffness, or an earlier one's while its steps are not
            slow."""
            nonlocal last_mm
            if self._lately is None:
                self._lately = rubber.stiffness(rubber.tangent(state.unknowns))
            end = after(state, self._lately)
            moved_mm = rubber.largest(rubber.displacement(end.unknowns - state.unknowns))
            if moved_mm > _SLOW * last_mm:
                self._lately = None
            last_mm = moved_mm
            return end

        try:
            return rubber.newton(renewed, state, MOST_STEPS, to)
        except NotSettled:
            self._lately = None  # steps from elsewhere don't begin with where these led
            raise

    def rubbed(
        self,
        before: RubberContact.State,
        guess: RubberContact.State,
        by_force: Bools,
        given: Floats,
        to: float,
        *,
        linear: bool,
    ) -> RubberContact.State:
        """Return the end of a part of a step: first what touches in it slides freely, from a
        ``guess``, then friction acts on it from where it touched."""
        pushed = by_force & (np.arange(MOTIONS) == Z)
        upright = pushed, np.where(by_force & ~pushed, guess.pose, given)
        first = not before.anchors.on.any()
        held, wanted = upright if first else (by_force, given)
        try:
            free = self.settled(guess, held, wanted, PART_STEP, linear=linear)
        except NotSettled:  # friction of what touched before doesn't hold the probe alone
            if np.array_equal(held, pushed):
                raise
            free = self.settled(guess, *upright, PART_STEP, linear=linear)
        start = self._anchored(before, free, linear=linear)
        # The friction of the first few points doesn't hold it either.
        held, wanted = upright if first and to == PART_STEP else (by_force, given)
        after = self.settled(start, held, wanted, to, linear=linear)
        if linear:
            after = self._slid_there(before, after, held, wanted, to)
        return self._dragged(after, linear=linear)

    def _slid_there(
        self,
        before: RubberContact.State,
        after: RubberContact.State,
        held: Bools,
        wanted: Floats,
        to: float,
    ) -> RubberContact.State:
        """Return the end of a part of the linear solution where the probes slid to as a whole."""
        goes = False
        for _ in range(_SLIDES):
            slid = self._slid(before, after)
            force = after.pressure * self._area
            if force @ after.anchors.on < _ANCHORED * force.sum():
                slid = after.slid_mm  # first friction on points that it slid to
            elif np.abs(slid - after.slid_mm).max() < _SLID_MM:
                return after
            elif goes and np.array_equal(slid, before.slid_mm):
                slid = (slid + after.slid_mm) / 2.0  # it stuck by going too far
            goes |= not np.array_equal(slid, before.slid_mm)
            start = replace(self._anchored(before, after, linear=True), slid_mm=slid)
            after = self.settled(start, held, wanted, to, linear=True)
        if np.abs(self._slid(before, after) - after.slid_mm).max() < _SLID_MOST_MM:
            return after
        raise NotSettled(
            "contact: the probe slides, and where it slides to does not settle: take smaller steps"
        )

    def _slid(self, before: RubberContact.State, after: RubberContact.State) -> Floats:
        """Return (p, 2) how far a linear solution's probes slid as a whole so far, as does
        `twin.world.contact.contact_problem.FrictionalContact.slid`; no further where points stick
        that touched before and carry more than a little."""
        slid = before.slid_mm.copy()
        moved = self.rubber.displacement(after.unknowns)
        for number, (touch, rows) in enumerate(zip(self.touches, self.rows, strict=True)):
            on = before.anchors.on[rows] & (after.pressure[rows] > 0.0)
            force = (after.pressure * self._area)[rows][on]
            if force @ after.slips[rows][on] > _ALL_SLIP * force.sum():
                behind = touch.place(moved, after.pose[number], linear=True)[on]
                normal = touch.inward[on]
                behind -= np.einsum("qi,qi->q", behind, normal)[:, None] * normal
                length = np.linalg.norm(behind, axis=1)
                least = length <= length.min() + 0.1 * np.ptp(length)
                slid[number] = -touch.axes[:Z] @ behind[least].mean(axis=0)
        return slid

    def _dragged(self, state: RubberContact.State, *, linear: bool) -> RubberContact.State:
        """Return a state whose slipping points are anchored where they slipped to."""
        if not state.slips.any():
            return state
        moved = self.rubber.displacement(state.unknowns)
        rub = self._rub(self._meet(moved, state.pose, state, linear=linear), state.anchors)
        place = state.anchors.place.copy()
        for touch, rows, pose in zip(self.touches, self.rows, state.pose, strict=True):
            place[rows] += touch.own(rub.slipped[rows], pose, linear=linear)
        return replace(state, anchors=replace(state.anchors, place=place))

    def _stepped(
        self,
        state: RubberContact.State,
        stiffness: Factor,
        by_force: Bools,
        given: Floats,
        *,
        linear: bool,
    ) -> RubberContact.State:
        """Return the state after one Newton step of the rubber, in balance with contact."""
        # The rubber without contact, condensed to the nodes that may touch
        rubber, nodal = self.rubber, self.rubber.nodal
        internal = rubber.internal(state.unknowns, linear=linear)
        loose = state.unknowns + rubber.moved_by(stiffness, -internal, _RESIDUAL)
        # Contact on these, and what its forces move elsewhere
        pose = np.where(by_force, state.pose, given)
        now, force = self._balanced(
            replace(state, pose=pose), loose[nodal], stiffness, by_force, given, linear=linear
        )
        push = np.zeros(rubber.size)
        push[nodal] = force
        return replace(now, unknowns=loose + rubber.moved_by(stiffness, push, _RESIDUAL))

    def _balanced(
        self,
        state: RubberContact.State,
        loose: Floats,
        stiffness: Factor,
        by_force: Bools,
        given: Floats,
        *,
        linear: bool,
    ) -> tuple[RubberContact.State, Floats]:
        """Return the state in which contact balances the rubber condensed to its nodes, and the
        forces on these (m,); ``loose`` is where they are without contact.

        Only nodes of points that touch bear forces: those alone are unknowns.
        """
        from scipy.sparse import csr_matrix

        free = self.rubber.nodal_free
        number = np.cumsum(free) - 1
        moved = self.rubber.displacement(state.unknowns).ravel()[self.rubber.nodal]
        pose, held = state.pose.ravel(), ~by_force.ravel()
        force = np.zeros(len(loose))
        force[free] = stiffness.schur @ (moved - loose)[free]
        trust, last, settled = 0.0, math.inf, False
        few = not linear and not self._rubs and stiffness is self.rubber.rest_stiffness
        for taken in range(_FEW_BALANCES if few else _MOST_BALANCES):
            if taken > _LET_GO:  # a point that its own anchor pulls off comes and goes
                on = state.anchors.on & (state.pressure > 0.0)
                state = replace(state, anchors=replace(state.anchors, on=on))
            springs = self._springs(state, moved, pose, linear=linear)
            out, nodes = springs.force, springs.nodes
            motions = len(nodes)
            out[motions:] -= np.where(held, 0.0, given.ravel())
            amiss = force.copy()
            amiss[nodes] += out[:motions]
            size = math.hypot(np.linalg.norm(amiss[free]), np.linalg.norm(out[motions:][~held]))
            # Where slip swings, friction keeps the resistance of its springs' secant, which settles
            # slowly: once points neither come nor go, any decrease ends it.
            trust = min(1.0, trust + 0.5) if size < (1.0 if settled else 0.7) * last else 0.0
            last = size
            matrix = springs.slope - trust * springs.lacks
            # How far nodes go from where they are loose, and the motions' step
            sought = np.concatenate([free[nodes], ~held])
            nodes = nodes[free[nodes]]
            rows, bearing = number[nodes], np.zeros_like(force)
            away = np.zeros(len(sought))
            away[:motions][sought[:motions]] = (moved - loose)[nodes]
            right = (matrix @ away - out)[sought]
            # The nodes' forces are sought: these times the compliance are how far nodes go
            count = len(nodes)
            matrix = matrix[np.ix_(sought, sought)]
            compliance = stiffness.compliance[np.ix_(rows, rows)]
            matrix[:, :count] = csr_matrix(matrix[:, :count]) @ compliance
            matrix[np.arange(count), np.arange(count)] += 1.0
            step = np.zeros(len(pose))
            try:
                found = np.linalg.solve(matrix, right)
            except np.linalg.LinAlgError as problem:
                raise NotSettled("contact: nothing holds the probe at finite strain") from problem
            bearing[nodes] = found[:count]
            step[~held] = found[count:]
            change = np.where(free, loose - moved, 0.0)
            change[free] += stiffness.compliance[:, rows] @ bearing[nodes]
            if not settled and taken > _FULL_STEPS:  # points that come and go
                share = 0.5 if taken < 2 * _FULL_STEPS else 0.25
                bearing = force + share * (bearing - force)
                change, step = share * change, share * step
            moved, pose, force = moved + change, pose + step, bearing
            before, state = state, springs.after(change, step)
            settled = np.array_equal(before.active, state.active)
            settled = settled and np.array_equal(before.slips, state.slips)
            most = max(np.abs(moved).max(), np.abs(pose).max())
            if settled and max(np.abs(change).max(), np.abs(step).max()) < _BALANCED * most:
                break
        else:
            raise NotSettled("contact: at finite strain the probe does not come to balance")
        return replace(state, pose=pose.reshape(-1, MOTIONS)), force

    def _meet(
        self, moved: Points, pose: Floats, state: RubberContact.State, *, linear: bool
    ) -> _Met:
        """Return how the points of all probes meet these."""
        probes = zip(self.touches, pose, self.rows, state.slid_mm, strict=True)
        parts = [
            vars(touch.meet(moved, one, state.anchors.of(rows), slid, linear=linear))
            for touch, one, rows, slid in probes
        ]
        return _Met(**{name: np.concatenate([one[name] for one in parts]) for name in parts[0]})

    def _rub(self, met: _Met, anchors: _Anchors) -> _Rub:
        """Return the friction on anchored points."""
        plane = np.eye(3) - met.normal[:, :, None] * met.normal[:, None, :]
        stiff = np.where(anchors.on, self._spring, 0.0)
        held = -stiff[:, None] * np.einsum("qij,qj->qi", plane, met.away)
        resistance = stiff[:, None, None] * plane
        if self._friction >= STICKS_FROM:
            none = np.zeros_like(held)
            return _Rub(held, resistance, none, none, np.zeros(len(held), bool), none)
        size = np.linalg.norm(held, axis=1)
        # The law is one of forces in N.
        steep = np.linalg.norm(met.push, axis=1)
        scale = self._modulus_mpa * self._area
        pressed = self._spring * np.maximum(-met.gap, 0.0) * steep
        friction = np.full(len(size), self._friction)
        bound = LAW.bound(friction, scale * pressed, self._area) / scale
        steep = steep * LAW.slope(friction, scale * pressed, self._area)
        slips = size > (1.0 + _AT_BOUND) * bound
        way = held / np.maximum(size, 1e-300)[:, None]
        share = np.where(slips, bound / np.maximum(size, 1e-300), 1.0)
        return _Rub(
            force=share[:, None] * held,
            resistance=share[:, None, None] * resistance,
            along=np.where(slips, np.sqrt(share * stiff), 0.0)[:, None] * way,
            grip=np.where(slips & (met.gap < 0.0), steep, 0.0)[:, None] * way,
            slips=slips,
            slipped=(share - 1.0)[:, None] * held / self._spring,
        )

    def _springs(
        self, state: RubberContact.State, moved: Floats, pose: Floats, *, linear: bool
    ) -> _Springs:
        """Return the springs of points that touch, where the contact's nodes and the probes went
        to."""
        # Which points touch?
        displacement = self.rubber.displacement(state.unknowns).copy()
        displacement.reshape(-1)[self.rubber.nodal] = moved
        met = self._meet(displacement, pose.reshape(-1, MOTIONS), state, linear=linear)
        weighed = state.pressure - self._gap_weight * (met.gap + state.pressure / self._spring)
        active = weighed > 0.0 if state.pressure.any() else state.active
        active = active & np.isfinite(met.gap)
        if not all(active[rows].any() for rows in self.rows):
            raise NotSettled("contact: at finite strain the probe touches nothing: press further")
        on = np.flatnonzero(active)
        rub = self._rub(met, state.anchors)
        resistance, rubbed, grip = rub.resistance[on], rub.force[on], rub.grip[on]
        pressed, area = state.pressure[on], self._area[on]
        nodes, row = np.unique(self._row[on], return_inverse=True)
        motions = len(nodes) + MOTIONS * self._owner[on, None] + np.arange(MOTIONS)
        row = np.hstack([row.reshape(-1, 18), motions])

        def spread(vectors: Floats, motions: Floats) -> Floats:
            at_nodes = (self._weight[on, :, None] * vectors[:, None, :]).reshape(len(on), 18)
            return np.hstack([at_nodes, motions])

        carried = spread(met.push[on] + state.tilt[self._owner[on]], -met.lift[on])
        slope = spread(met.push[on], met.per_motion[on])
        block = (self._spring * area)[:, None, None] * carried[:, :, None] * slope[:, None, :]
        axes = np.broadcast_to(np.eye(3), (len(on), 3, 3))
        across = np.stack([spread(axes[:, i], -met.carry[on, i]) for i in range(3)], axis=1)
        turning = resistance - pressed[:, None, None] * met.bend[on]
        block += across.swapaxes(1, 2) @ ((area[:, None, None] * turning) @ across)
        gripped = np.einsum("qkr,qk->qr", across, grip)
        block += (self._spring * area)[:, None, None] * gripped[:, :, None] * slope[:, None, :]
        out = (self._spring * area * met.gap[on])[:, None] * carried
        out -= np.einsum("qkr,qk->qr", across, area[:, None] * rubbed)
        size = len(nodes) + len(pose)
        place = size * row[:, :, None] + row[:, None, :]

        def matrix(blocks: Floats) -> Floats:
            return MixedRubber.gathered(place, blocks, size * size).reshape(size, size)

        def after(change: Floats, motion: Floats) -> RubberContact.State:
            pressure = np.zeros(len(active))
            step = np.concatenate([change[nodes], motion])[row]
            closed = np.einsum("qr,qr->q", slope, step)
            pressure[on] = -self._spring * (met.gap[on] + closed)
            pulled = rubbed - np.einsum("qij,qjr,qr->qi", resistance, across, step)
            pulled -= self._spring * closed[:, None] * grip
            forces = area[:, None] * (pressure[on, None] * met.lift[on])
            forces += area[:, None] * np.einsum("qi,qim->qm", pulled, met.carry[on])
            total = np.zeros_like(state.pose)
            np.add.at(total, self._owner[on], forces)
            slips = rub.slips & active
            return replace(state, pressure=pressure, active=active, slips=slips, force=total)

        along = np.einsum("qkr,qk->qr", across, rub.along[on])
        lacks = area[:, None, None] * along[:, :, None] * along[:, None, :]
        return _Springs(
            nodes=nodes,
            force=MixedRubber.gathered(row, out, size),
            slope=matrix(block),
            lacks=matrix(lacks),
            after=after,
        )

    def _anchored(
        self, before: RubberContact.State, free: RubberContact.State, *, linear: bool
    ) -> RubberContact.State:
        """Return ``free``, the end of a part of a step if points that touch within it slide freely,
        with anchors where they did touch, and none where points lift off. A point slides until the
        probe has come as near as it was away, under a smooth probe as the power 2/3 of its gap (1/2
        from rest)."""
        on = before.anchors.on & (free.pressure > 0.0)
        first = self.rubber.displacement(before.unknowns)
        last = self.rubber.displacement(free.unknowns)
        place, closed = before.anchors.place.copy(), before.anchors.closed.copy()
        shape = before.anchors.shape.copy()
        for number, (touch, rows) in enumerate(zip(self.touches, self.rows, strict=True)):
            new = (free.pressure[rows] > 0.0) & ~before.anchors.on[rows]
            if not new.any():
                continue
            slid = before.slid_mm[number]
            anchors = before.anchors.of(rows)
            met = touch.meet(first, before.pose[number], anchors, slid, linear=linear)
            gap = np.maximum(met.gap, 0.0)
            most = max(float(gap[new & np.isfinite(gap)].max(initial=0.0)), 1e-300)
            power = 2.0 / 3.0 if before.pressure[rows].any() else 0.5
            way = np.minimum(gap / most, 1.0) ** power
            way[gap < 1e-9] = 0.0
            start = touch.place(first, before.pose[number], linear=linear)
            end = touch.place(last, free.pose[number], linear=linear)
            held = start + way[:, None] * (end - start)
            place[rows] = np.where(new[:, None], held, place[rows])
            gap, there = touch.anchored_gap(free.pose[number], free.slid_mm[number])
            closed[rows] = np.where(new, gap, closed[rows])
            shape[rows] = np.where(new, there, shape[rows])
            on[rows] |= new
        return replace(free, anchors=_Anchors(on, place, closed, shape))
