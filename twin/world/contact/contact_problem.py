"""What is pressed: probes on one body, what holds them in every step, and the patches under them.

Every probe adds six motions to the pose and has patches of its own; the body's compliance couples
them. So two probes are no special case: the solvers see more patches and more motions.

**History.** One grid of patches serves a whole path with friction. A patch stores where it touched
or last slipped to, and moves with the probe from there. The gap of one that has not touched follows
the exact shape of the probe as it comes along the normal; sideways the surface near a probe moves
with it. What all patches of a probe slip in common is a slide of the whole probe, and gaps are
taken where it slid to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate
from typing import Protocol

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.load import Load, Rectangles
from twin.parts.press import Cone, Cylinder, Object, Pillar, Press, Probe, Stl
from twin.theory.relaxation import Relaxation, RubberMemory
from twin.world.contact.active_set import Equilibrium, UnilateralProblem
from twin.world.contact.friction_law import STICKS_FROM
from twin.world.contact.influence import DenseInfluence, Influence, LatticeInfluence
from twin.world.contact.probe_gap import (
    ABOUT_X,
    ABOUT_Y,
    MOTIONS,
    Approach,
    PlacedProbe,
    Z,
    half_extent,
)
from twin.world.contact.surface_patches import Box, Footprint, Patches, Plane

_STAYS = 0.05
"""How far a flat face slides before its patches go along, over its smaller width."""


class SurfaceCompliance(Protocol):
    """A body's surface, solved: whatever can say how patches move under forces on patches.

    Attributes
    ----------
    one_material
        Whether a half-space's closed forms give the size of a contact on it.
    """

    one_material: bool

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return (3k, 3k) displacements of the patch centres under unit forces on the patches,
        global axes, mm/N.

        Symmetric (Betti): products read one half of it.
        """
        ...

    def to_points(self, points: Points, rectangles: Rectangles) -> Floats:
        """Return (3n, 3k) displacements of points (n, 3) under unit forces on the patches,
        likewise."""
        ...


@dataclass(frozen=True, kw_only=True)
class ProbeSetup:
    """A probe over an undeformed body with its compliance.

    ``first`` is the probe at first touch of the path, from which places count; ``across`` the
    patches across the contact, or across its pieces; ``most`` those under it at most, at 16 across.
    The moduli serve the first guess of the contact's size. ``albedo`` is that of a probe that
    pictures show.
    """

    body: Body
    compliance: SurfaceCompliance
    first: Approach
    across: int
    most: int
    youngs_modulus_mpa: float
    poisson_ratio: float
    albedo: tuple[float, float, float] | None = None

    @property
    def probe(self) -> Probe:
        """The rigid probe."""
        return self.first.probe

    def placed(self, pose: Floats) -> tuple[PlacedProbe, ...]:
        """Return the probe at a pose, if pictures show it."""
        if self.albedo is None:
            return ()
        return (PlacedProbe(first=self.first, pose=np.array(pose), albedo=self.albedo),)

    @cached_property
    def face(self) -> Footprint | None:
        """The flat face, seen along the approach, if it bounds the contact."""
        probe = self.probe
        if not (self.first.is_flat and isinstance(probe, Cylinder | Pillar)):
            return None
        edge = probe.edge_mm
        upright = float(self.first.tilt[2, 2])
        # a round face is shortened along its steepest line; a square one's first side by as much
        # as it is inclined, and the other one so that the area is the right one
        is_round = isinstance(probe, Cylinder)
        first = upright if is_round else float(np.hypot(*self.first.tilt[:2, 0]))
        a, b = half_extent(probe)
        half = (edge + (a - edge) * first, edge + (b - edge) * upright / first)
        return Footprint(half_mm=half, is_round=is_round, edge_mm=edge)

    @property
    def stays_mm(self) -> float:
        """How far its flat face slides before the patches under it go along, mm."""
        return 0.0 if self.face is None else _STAYS * 2.0 * min(self.face.half_mm)

    @property
    def is_free_form(self) -> bool:
        """Whether contact may be of any shape, in any number of pieces."""
        return isinstance(self.probe, Stl | Object)

    @property
    def has_inclined_face(self) -> bool:
        """Whether its flat face is inclined, so that it touches with its rim or a corner first."""
        return isinstance(self.probe, Cylinder | Pillar) and any(self.first.tilt_deg[:Z])

    @property
    def name(self) -> str:
        """The probe and where it stands, for messages."""
        return f"{self.probe.kind} at ({', '.join(f'{c:.4g}' for c in self.first.axis_mm)}) mm"

    def patches(self, plane: Plane, box: Box, across: tuple[int, int]) -> Patches:
        """Cut the candidate patches under the probe, as `Patches.under`.

        Raises
        ------
        ContactError
            None lies on the sensing surface.
        """
        found = Patches.under(self.body, box.face or self.face, plane, box, across)
        if len(found) == 0:
            raise ContactError(
                f"contact: under the {self.name} no patch lies on the sensing surface: move it "
                "away from the edge"
            )
        return found

    def carried(self, patches: Patches, by_mm: Floats) -> Patches:
        """Return the patches of a level surface, carried along by (2,), along the probe's x and y.

        Raises
        ------
        ContactError
            The surface is not level there.
        """
        if not by_mm.any():
            return patches
        centre = patches.centre_mm + by_mm @ self.first.axes[:Z]
        x, y, z = ((centre.max(axis=0) + centre.min(axis=0)) / 2.0).tolist()
        reach = float(np.abs(centre - (x, y, z)).max() + patches.half_mm.max())
        if z != 0.0 or np.ptp(centre[:, 2]) or not self.body.is_level_around(x, y, reach):
            raise ContactError(
                f"contact: the {self.probe.kind} slides to ({x:.3g}, {y:.3g}) mm, where the "
                f"sensing surface is not level for {reach:.3g} mm around: move it less, or raise "
                "press.friction"
            )
        return replace(patches, centre_mm=centre)

    def compliance_between(self, loads: Sequence[Rectangles], frames: Floats) -> Floats:
        """Return the compliance (k, 3, k, 3) between the patches under several probes, in their
        frames (k, 3, 3), mm/N.

        Raises
        ------
        ContactError
            It is not finite.
        """
        k = len(frames)
        if len(loads) == 1:
            whole = np.asarray(self.compliance.surface(loads[0]))
        else:  # probe by probe: what is solved for one probe's patches doesn't serve those far away
            centres = np.concatenate([load.centre_mm for load in loads])
            whole = np.concatenate(
                [self.compliance.to_points(centres, load) for load in loads], axis=1
            )
            whole = (whole + whole.T) / 2.0
        if not np.isfinite(whole).all():
            raise ContactError(
                f"contact: the body's compliance is not finite on {k} patches: check mesh and "
                "material"
            )
        if not np.any(frames - np.eye(3)):
            return whole.reshape(k, 3, k, 3)
        half = np.matmul(frames, whole.reshape(k, 3, 3 * k)).reshape(3 * k, 3 * k)
        turned = np.matmul(frames, np.ascontiguousarray(half.T).reshape(k, 3, 3 * k))
        return np.ascontiguousarray(turned.reshape(3 * k, 3 * k).T).reshape(k, 3, k, 3)

    def check_inside(self, patches: Patches, found: Equilibrium, depth: float) -> None:
        """Refuse contact that runs over the edge of the surface, or a probe that sinks in.

        Raises
        ------
        ContactError
            With place, value and allowed range.
        """
        over = found.active & patches.edge
        if over.any():
            place = patches.centre_mm[over][0]
            raise ContactError(
                "contact: runs over the edge of the sensing surface at "
                f"({', '.join(f'{c:.3g}' for c in place)}) mm: press further inside "
                "(press.at_mm), or with less press.force_n or a smaller press.probe"
            )
        low, high = self.body.bounds_mm
        probe = self.probe
        limit, what = Press.deepest_mm(probe, high[2] - low[2])
        if depth > limit:
            raise ContactError(
                f"contact: the {probe.kind} sinks in by {depth:.3g} mm, allowed is up to "
                f"{limit:.3g} mm ({what}): reduce press.force_n or press.indentation_mm, or give "
                "a larger press.probe or material.youngs_modulus_mpa"
            )
        if isinstance(probe, Cone):
            axes = self.first.axes
            pivot = self.first.axis_mm
            away = (patches.centre_mm[found.active] - pivot) @ axes[:Z].T - found.pose[:Z]
            width = 2.0 * float(np.max(np.hypot(away[:, 0], away[:, 1]), initial=0.0))
            if width > probe.diameter_mm:
                raise ContactError(
                    f"contact: it reaches {width:.3g} mm across, over the cone's base of "
                    f"{probe.diameter_mm:g} mm: press with less force, or give a larger "
                    "probe.diameter_mm"
                )

    def first_touch(self, pose: Floats) -> tuple[Plane, float]:
        """Return the grid's plane under the probe at a place (6,), and the z from first touch at
        which it would just touch.

        Raises
        ------
        InputError
            It would miss the sensing surface.
        """
        first = self.first
        there = self._touching(pose)
        if self.face is None:
            plane = Plane(origin_mm=there.touch_mm, axes=self.body.frames(there.touch_mm[None])[0])
        elif not pose[ABOUT_X:].any() and not any(first.tilt_deg):
            plane = Plane(origin_mm=there.axis_mm, axes=first.axes)
        else:
            turned = Approach.rotation_of(pose[ABOUT_X:]) @ first.tilt
            inclined = self.face.is_round and any(first.tilt_deg[:Z])
            side = turned[:, 2] if inclined else turned[:, 0]
            side = np.array([side[0], side[1], 0.0]) / np.hypot(side[0], side[1])
            own = np.stack([side, np.cross([0.0, 0.0, 1.0], side), [0.0, 0.0, 1.0]])
            plane = Plane(origin_mm=there.axis_mm, axes=own @ first.axes)
        return plane, self._height(there)

    def touch_z(self, pose: Floats) -> float:
        """Return the second of what `first_touch` does."""
        return self._height(self._touching(pose))

    def _height(self, there: Approach) -> float:
        first = self.first
        return 0.0 if there is first else float((there.axis_mm - first.axis_mm) @ first.axes[2])

    def _touching(self, pose: Floats) -> Approach:
        first = self.first
        (x, y, _, *turns) = pose.tolist()
        if not (x or y or any(turns)):
            return first
        over = first.axis_mm + pose[:Z] @ first.axes[:Z]
        return Approach.of(self.probe, self.body, over, first.axes, first.tilt_deg, pose[ABOUT_X:])


@dataclass(frozen=True, kw_only=True)
class Control:
    """What holds the probes: for each one's six motions whether force (torque) does, and the force
    or place given; and when, in seconds since the path's beginning."""

    by_force: Bools
    given: Floats
    time_s: float = 0.0

    @property
    def pushing(self) -> Bools:
        """Which components push by force: every z that is held so, with a force that isn't 0."""
        along_z = np.arange(len(self.given)) % MOTIONS == Z
        return np.asarray(self.by_force & along_z & (self.given > 0.0))

    def of_probe(self, number: int) -> Control:
        """Return what holds one of the probes."""
        motions = slice(MOTIONS * number, MOTIONS * (number + 1))
        return Control(by_force=self.by_force[motions], given=self.given[motions])

    @classmethod
    def joined(cls, controls: Sequence[Control], time_s: float = 0.0) -> Control:
        """Return what holds several probes, one after the other."""
        return cls(
            time_s=time_s,
            by_force=np.concatenate([one.by_force for one in controls]),
            given=np.concatenate([one.given for one in controls]),
        )


@dataclass(frozen=True, kw_only=True)
class LoadProgramme:
    """Presses that are solved together: every probe, its friction, and its control in every step,
    in its own axes; and the rubber's relaxation, if the path takes time."""

    setups: tuple[ProbeSetup, ...]
    friction: Floats
    steps: tuple[Control, ...]
    relaxation: Relaxation | None = None

    @cached_property
    def effective_friction(self) -> Floats:
        """(p,) the coefficients that are solved with: inf from `STICKS_FROM` on."""
        return np.where(self.friction >= STICKS_FROM, np.inf, self.friction)


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """The p probes and the patches under each of them."""

    setups: tuple[ProbeSetup, ...]
    grids: tuple[Patches, ...]

    @cached_property
    def patches(self) -> Patches:
        """The patches of all probes, k in all."""
        if len(self.grids) == 1:
            return self.grids[0]
        parts = [vars(grid) for grid in self.grids]
        return Patches(**{name: np.concatenate([one[name] for one in parts]) for name in parts[0]})

    @cached_property
    def rows(self) -> tuple[tuple[ProbeSetup, slice, slice], ...]:
        """Every probe with its piece of the patches and of the place."""
        ends = list(accumulate(map(len, self.grids), initial=0))
        return tuple(
            (setup, slice(*ends[n : n + 2]), slice(MOTIONS * n, MOTIONS * (n + 1)))
            for n, setup in enumerate(self.setups)
        )

    @cached_property
    def along_z(self) -> Bools:
        """(6 p,) the components of the place along the probes' directions of approach."""
        return np.asarray(np.arange(MOTIONS * len(self.setups)) % MOTIONS == Z)

    @cached_property
    def owner(self) -> Ints:
        """(k,) which probe each patch belongs to."""
        return np.repeat(np.arange(len(self.grids)), [len(grid) for grid in self.grids])

    @cached_property
    def influence(self) -> Influence:
        """The compliance between patches: a convolution where they are a lattice in a plane, else a
        matrix."""
        return self.influence_on_lattice or DenseInfluence(
            self.compliance, self.grids, self.setups[0].poisson_ratio
        )

    @cached_property
    def normal_influence(self) -> Influence:
        """The same for normal forces and displacements alone, computed faster where the compliance
        has a ``normal_surface``."""
        surface = getattr(self.setups[0].compliance, "normal_surface", None)
        if surface is None or self.influence_on_lattice is not None:
            return self.influence
        normal = surface(self.patches.unloaded)
        if normal is None or not np.isfinite(normal).all():
            return self.influence
        return DenseInfluence(normal[:, None, :, None], self.grids, self.setups[0].poisson_ratio)

    @cached_property
    def influence_on_lattice(self) -> LatticeInfluence | None:
        """The same where patches are a lattice in a plane; None where not."""
        return LatticeInfluence.between(self.patches, self.setups[0].compliance)

    @cached_property
    def compliance(self) -> Floats:
        """(k, 3, k, 3) compliance between patches in their own frames, mm/N."""
        loads = [grid.unloaded for grid in self.grids]
        return self.setups[0].compliance_between(loads, self.patches.frames)

    def contact_jacobian(self, pose: Floats) -> Floats:
        """Return (k, 3, 6 p): motion of the probes' points at the patches, in their frames, per
        unit of the place.

        Turns are about the probes' axes at a place, at the height of first touch.
        """
        whole = np.zeros((len(self.patches), 3, len(pose)))
        for (setup, rows, motions), grid in zip(self.rows, self.grids, strict=True):
            first = setup.first
            aside = pose[motions][:Z] @ first.axes[:Z]
            whole[rows, :, motions] = first.jacobian(grid.centre_mm, grid.frames, aside)
        return whole

    def gap(self, pose: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps, mm, and their (k, 6 p) slopes at a place."""
        gap = np.zeros(len(self.patches))
        slope = np.zeros((len(self.patches), len(pose)))
        for number, (_, rows, motions) in enumerate(self.rows):
            gap[rows], slope[rows, motions] = self.gap_under(number, pose[motions])
        return gap, slope

    def gap_under(self, number: int, pose: Floats) -> tuple[Floats, Floats]:
        """Return the gaps of the patches under one probe at its place (6,), and their slopes.

        A probe along the normals of all its patches changes their gaps by as much as it comes: the
        rest is kept.
        """
        grid = self.grids[number]
        first = self.setups[number].first
        normals = grid.frames[:, 2]
        if not self.upright[number]:
            return first.gap(grid.centre_mm, normals, pose)
        at_touch = pose.copy()
        at_touch[Z] = 0.0
        key, (gap, slope) = self._last.get(number, (b"", (pose, pose)))
        if key != at_touch.tobytes():
            gap, slope = first.gap(grid.centre_mm, normals, at_touch)
            self._last[number] = at_touch.tobytes(), (gap, slope)
        return gap - pose[Z], slope

    @cached_property
    def upright(self) -> list[bool]:
        """Whether each probe comes along the normals of all its patches."""
        pairs = zip(self.setups, self.grids, strict=True)
        return [bool((grid.frames[:, 2] == setup.first.axes[2]).all()) for setup, grid in pairs]

    @cached_property
    def _last(self) -> dict[int, tuple[bytes, tuple[Floats, Floats]]]:
        return {}


@dataclass(frozen=True, kw_only=True)
class ContactHistory:
    """Where each patch touched, or slipped to, and the state that the probes and the body are in.

    Attributes
    ----------
    touched, slipping
        (k,) patches in contact, and which of them slipped last.
    closed_mm
        (k,) gap of those at place 0, had they always moved with the probe.
    shape_mm
        (k,) gap of the probe's shape at the height of first touch, where it slid to when they
        touched or slipped last.
    offset_mm
        (k, 2) tangential displacement of those at place 0, likewise.
    pose
        (6 p,) the probes' places.
    total
        (6 p,) the forces and torques on them.
    displacement_mm, force_n
        (k, 3) displacements of the patches and forces on them, in their frames.
    slid_mm
        (p, 2) how far each probe slid as a whole, along its own x and y.
    lifted
        (p,) probes that are off the body and stay off.
    dissipated_nmm
        Work that friction has taken so far, N mm.
    time_s
        Time since the path's beginning, s.
    memory
        What relaxing rubber remembers; None of elastic rubber.
    moved_mm
        (k, 3) how far the memory alone moves the patches within a part; None outside.
    """

    touched: Bools
    slipping: Bools
    closed_mm: Floats
    shape_mm: Floats
    offset_mm: Floats
    pose: Floats
    total: Floats
    displacement_mm: Floats
    force_n: Floats
    slid_mm: Floats
    lifted: Bools
    dissipated_nmm: float = 0.0
    time_s: float = 0.0
    memory: RubberMemory | None = None
    moved_mm: Floats | None = None


@dataclass(frozen=True, eq=False)
class FrictionalContact:
    """Patches, and what of them stays the same along the path; ``friction`` (p,) is the coefficient
    of each probe, ``relaxation`` the rubber's."""

    contacts: ContactProblem
    friction: Floats
    relaxation: Relaxation | None = None
    carried_mm: Floats | None = None
    """(p, 2) how far the patches under flat faces were carried along, along each probe's x and
    y."""

    @property
    def patches(self) -> Patches:
        """The patches of all probes."""
        return self.contacts.patches

    def carried(self, slid_mm: Floats) -> FrictionalContact:
        """Return the patches where probes slid to (p, 2): those under a flat face go along once it
        slid by more than a twentieth of its width.

        The patches that a sliding face presses on have no history. On relaxing rubber they have,
        and stay where they are.

        Raises
        ------
        ContactError
            The surface is not level around a face's new place.
        """
        away = np.zeros_like(slid_mm)
        for number, setup in enumerate(self.contacts.setups):
            if setup.face is not None and self.relaxation is None:
                away[number] = slid_mm[number] * (math.hypot(*slid_mm[number]) > setup.stays_mm)
        if not away.any():
            return self
        if away.tobytes() not in self._places:
            self._places.clear()
            pairs = zip(self.contacts.setups, self.contacts.grids, away, strict=True)
            grids = tuple(setup.carried(grid, moved) for setup, grid, moved in pairs)
            self._places[away.tobytes()] = replace(
                self, contacts=ContactProblem(self.contacts.setups, grids), carried_mm=away
            )
        return self._places[away.tobytes()]

    @cached_property
    def _places(self) -> dict[bytes, FrictionalContact]:
        """The patches at the last place that they were carried to."""
        return {}

    @cached_property
    def influence(self) -> Influence:
        """The compliance between patches; as a matrix where all stick, whose systems are solved by
        elimination."""
        found = self.contacts.influence
        if isinstance(found, LatticeInfluence) and self.sticks and self.friction.any():
            return DenseInfluence(found.block(np.arange(len(found))))
        return found

    @property
    def sticks(self) -> bool:
        """Whether every probe with friction sticks whatever the force."""
        return bool(np.isinf(self.friction[self.friction > 0.0]).all())

    @cached_property
    def contact_jacobian(self) -> Floats:
        """(k, 3, 6 p) motion of the probes' points at the patches per unit of the place, about
        first touch, or where the patches were carried to."""
        place = np.zeros((len(self.friction), MOTIONS))
        if self.carried_mm is not None:
            place[:, :Z] = self.carried_mm
        return self.contacts.contact_jacobian(place.ravel())

    @cached_property
    def rubs(self) -> Bools:
        """(k,) which patches belong to a probe with friction."""
        return np.asarray(self.friction[self.contacts.owner] > 0.0)

    def untouched(self, history: ContactHistory) -> Bools:
        """Return (k,) which patches belong to a probe that touches nothing."""
        none = [not history.touched[rows].any() for _, rows, _ in self.contacts.rows]
        return np.asarray(np.array(none)[self.contacts.owner])

    @cached_property
    def _rolls(self) -> Bools:
        """(6 p,) the turns of round probes about x and y, with which contact moves on."""
        turns = np.isin(np.arange(MOTIONS), [ABOUT_X, ABOUT_Y])
        return np.concatenate([turns & (setup.face is None) for setup in self.contacts.setups])

    def _slid_gap(self, slid_mm: Floats, moved: Floats) -> tuple[Floats, Floats]:
        """Return gaps, and slopes, of probes that slid by (p, 2) but not carried the surface along,
        and then moved by (p, 6) along and about their own axes."""
        gap = np.zeros(len(self.patches))
        slope = np.zeros((len(self.patches), len(self.contacts.along_z)))
        for number, (setup, rows, motions) in enumerate(self.contacts.rows):
            grid = self.contacts.grids[number]
            place = moved[number].copy()
            if setup.face is None:
                place[:Z] += slid_mm[number]
            elif self.carried_mm is not None:
                place[:Z] += self.carried_mm[number]
            gap[rows], slope[rows, motions] = self.contacts.gap_under(number, place)
            gap[rows] += grid.frames[:, 2] @ (slid_mm[number] @ setup.first.axes[:Z])
        return gap, slope

    def _normal_motion(self, history: ContactHistory) -> Floats:
        """Return (p, 3) how far a motion by 1 along a probe's z brings it towards the surface that
        it touches, along its own axes: its part along the mean normal there, and all of it where
        the surface isn't carried along."""
        near = self.gap_at_touch(history.slid_mm)
        normals = self.patches.frames[:, 2]
        found = np.tile([0.0, 0.0, 1.0], (len(self.friction), 1))
        for number, (setup, rows, _) in enumerate(self.contacts.rows):
            if self.friction[number] == 0.0:
                continue
            touched = np.flatnonzero(history.touched[rows]) + rows.start
            if len(touched) == 0:
                touched = np.array([rows.start + np.argmin(near[rows])])
            normal = setup.first.axes @ normals[touched].mean(axis=0)
            normal /= np.linalg.norm(normal)
            found[number] = normal[Z] * normal
        return found

    def gap(self, history: ContactHistory, pose: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps and (k, 6 p) slopes at a place."""
        return self._gap_along(self._normal_motion(history), history, pose)

    def _gap_along(
        self, towards: Floats, history: ContactHistory, pose: Floats
    ) -> tuple[Floats, Floats]:
        """Return `gap` from `_normal_motion`, which no place changes."""
        moved = np.where(self._rolls, pose, 0.0).reshape(-1, MOTIONS)
        moved[:, : Z + 1] = towards * pose[self.contacts.along_z][:, None]
        gap, slope = self._slid_gap(history.slid_mm, moved)
        own = slope.reshape(len(gap), -1, MOTIONS)[:, :, : Z + 1]
        slope[:, self.contacts.along_z] = np.einsum("kpi,pi->kp", own, towards)
        normal = self.contact_jacobian[:, 2]
        comes = self.contacts.along_z | self._rolls
        slope = np.where(comes, slope, -normal)
        gap = gap - normal @ np.where(comes, 0.0, pose)
        stuck = history.touched & self.rubs
        gap[stuck] = (
            history.closed_mm[stuck] + self._slid_since(history)[stuck] - normal[stuck] @ pose
        )
        slope[stuck] = -normal[stuck]
        if history.moved_mm is not None:
            gap += history.moved_mm[:, 2]
        gap[history.lifted[self.contacts.owner]] = np.inf
        return gap, slope

    def gap_at_touch(self, slid_mm: Floats) -> Floats:
        """Return (k,) the gaps of probes at the height of first touch that slid there; inf where
        they can't be met along a patch's normal."""
        key = slid_mm.tobytes()
        if key not in self._gaps:
            self._gaps.clear()
            self._gaps[key] = self._slid_gap(slid_mm, np.zeros((len(self.friction), MOTIONS)))[0]
        return self._gaps[key]

    @cached_property
    def _gaps(self) -> dict[bytes, Floats]:
        """The gaps at touch where the probes slid last."""
        return {}

    def _slid_since(self, history: ContactHistory) -> Floats:
        """Return (k,) by how much slides have changed the gaps of patches since they touched or
        slipped; inf where the probe slid away."""
        now = self.gap_at_touch(history.slid_mm)
        known = np.isfinite(history.shape_mm)
        then = np.where(known, history.shape_mm, 0.0)
        return np.where(known, now - then, 0.0)

    def offset(self, history: ContactHistory) -> Floats:
        """Return (k, 2) from where each patch's slip counts.

        After a lift the probe touches again where it now is: its motion sideways counts from there.
        """
        aside = np.where(self.contacts.along_z, 0.0, history.pose)
        here = -np.einsum("kad,d->ka", self.contact_jacobian[:, :2], aside)
        offset = history.offset_mm
        if history.moved_mm is not None:
            offset = offset - history.moved_mm[:, :2]
        return np.where(self.untouched(history)[:, None], here, offset)

    def problem(
        self, history: ContactHistory, control: Control, held: Bools | None = None
    ) -> UnilateralProblem:
        """Return a part's equations; patches in ``held`` feel friction although they had not
        touched before it."""
        frictional = history.touched | self.untouched(history) | (False if held is None else held)
        return UnilateralProblem(
            influence=self.influence,
            gap=partial(self._gap_along, self._normal_motion(history), history),
            contact_jacobian=self.contact_jacobian,
            by_force=control.by_force,
            given=control.given,
            pushing=control.pushing,
            area_mm2=self.patches.area_mm2,
            friction=np.where(frictional, self.friction[self.contacts.owner], 0.0),
            offset=self.offset(history),
            sideways=bool(self.friction.any()),
        )

    def at_first_touch(self) -> ContactHistory:
        """Return the history of probes that just touch: patches under a flat face on a flat body
        stick at once.

        A single patch in the middle under a ball doesn't count: alone it would have to hold a probe
        on a slope.
        """
        k = len(self.patches)
        p = len(self.friction)
        nothing = ContactHistory(
            touched=np.zeros(k, bool),
            slipping=np.zeros(k, bool),
            closed_mm=np.zeros(k),
            shape_mm=np.zeros(k),
            offset_mm=np.zeros((k, 2)),
            pose=np.zeros(MOTIONS * p),
            total=np.zeros(MOTIONS * p),
            displacement_mm=np.zeros((k, 3)),
            force_n=np.zeros((k, 3)),
            slid_mm=np.zeros((p, 2)),
            lifted=np.zeros(p, bool),
            memory=RubberMemory.at_rest(self.relaxation, (k, 3)) if self.relaxation else None,
        )
        gap, _ = self.gap(nothing, nothing.pose)
        touched = gap <= 1e-9
        for _, rows, _ in self.contacts.rows:
            touched[rows] &= np.count_nonzero(touched[rows]) > 1
        closed = np.where(touched, gap, 0.0)
        return replace(
            nothing, touched=touched, closed_mm=closed, shape_mm=self.gap_at_touch(nothing.slid_mm)
        )

    def release(self, history: ContactHistory, lifted: Bools) -> ContactHistory:
        """Return the history of probes (p,) that have been lifted off: they touch again where they
        then are."""
        rows = lifted[self.contacts.owner]
        motions = np.repeat(lifted, MOTIONS)
        at_rest = -np.einsum("kad,d->ka", self.contact_jacobian, history.pose)
        here = history.pose.reshape(-1, MOTIONS)[:, :Z]
        return replace(
            self.recovered(history, lifted, history.time_s),
            touched=history.touched & ~rows,
            slipping=history.slipping & ~rows,
            total=np.where(motions, 0.0, history.total),
            slid_mm=np.where(lifted[:, None], here, history.slid_mm),
            dissipated_nmm=history.dissipated_nmm
            + self.lost_nmm(
                history, history.touched & rows, np.zeros_like(history.force_n), at_rest
            ),
        )

    def slid(self, start: Floats, history: ContactHistory, found: Equilibrium) -> Floats:
        """Return (p, 2) mm how far each probe slid as a whole so far, along its x and y: as far as
        at the ``start`` (p, 2), and where all its patches slip, as far on as it came ahead of those
        that it carries along furthest. Counted from the start, a slide that turns back begins with
        none, as one from rest does.

        The mean over those in the first tenth of all distances, as the least one alone may jump
        between patches that mirror each other; their weights fall to zero at that tenth, as a patch
        that counts in full or not at all keeps a slide from settling. A patch stays where it is in
        the body, so that slips of patches, which come and go under a probe, don't add up to its
        slide.
        """
        whole = start.copy()
        for number, (setup, rows, _) in enumerate(self.contacts.rows):
            active = np.flatnonzero(found.active[rows]) + rows.start
            if len(active) == 0 or not found.slipping[active].all():
                continue
            behind = (
                found.displacement_mm[active, :2] - self.contact_jacobian[active, :2] @ found.pose
            )
            if history.moved_mm is not None:
                behind += history.moved_mm[active, :2]
            frames = self.patches.frames[active, :2]
            behind += frames @ (start[number] @ setup.first.axes[:Z])
            length = np.hypot(behind[:, 0], behind[:, 1])
            further = (length - length.min()) / max(0.1 * float(np.ptp(length)), 1e-300)
            weights = np.maximum(1.0 - further, 0.0)
            mean = np.einsum("k,ka,kai->i", weights / weights.sum(), behind, frames)
            whole[number] -= setup.first.axes[:Z] @ mean
        return whole

    def lost_nmm(
        self, history: ContactHistory, slipped: Bools, force_n: Floats, away: Floats
    ) -> float:
        """Return the work that is lost where patches (k,) move over their probe, slipping or as
        they lift off, N mm.

        ``force_n`` and ``away`` (k, 3) are forces afterwards, and displacements over the probes'
        points at place 0, in the patches' frames.

        Notes
        -----
        The mean of the tangential forces before and after times the slip. A patch that stuck slips
        only once its force has grown to its bound, so that a greater force counts from the start,
        as does one that has turned round. One that lifts off loses its force on the way. What
        touched in between has slipped from where it was held; where it slid before that, nothing
        pressed on it.
        """
        if not self.friction.any():
            return 0.0
        before = history.force_n[:, :2]
        after = force_n[:, :2]
        grown = ~history.slipping & (np.hypot(*before.T) < np.hypot(*after.T))
        grown |= np.sum(before * after, axis=1) < 0.0
        mean = np.where(grown[:, None], after, (before + after) / 2.0)
        return -float(np.sum((mean * (away[:, :2] - self.offset(history)))[slipped]))

    def crept(self, memory: RubberMemory, number: int) -> Load:
        """Return the elastic forces under one probe, global axes."""
        _, rows, _ = self.contacts.rows[number]
        grid = self.contacts.grids[number]
        own = memory.elastic[rows]
        moving = np.flatnonzero(own.any(axis=1))
        force = np.einsum("kij,ki->kj", grid.frames[moving], own[moving])
        return Load((grid.rectangles(force, moving),)) if len(moving) else Load()

    def recovered(
        self, history: ContactHistory, lifted: Bools, time_s: float, parts: int = 1
    ) -> ContactHistory:
        """Return the history at a time up to which probes (p,) are off the body, and nothing else
        changes; relaxing rubber recovers."""
        rows = lifted[self.contacts.owner][:, None]
        force = np.where(rows, 0.0, history.force_n)
        displacement = np.zeros_like(force)
        memory = history.memory
        if memory is not None:
            for _ in range(parts):
                memory = memory.after((time_s - history.time_s) / parts, force)
            displacement = self.influence.apply(memory.elastic)
        return replace(
            history,
            time_s=time_s,
            memory=memory,
            force_n=force,
            displacement_mm=np.where(rows, displacement, history.displacement_mm),
        )
