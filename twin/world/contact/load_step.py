"""One step of a path with friction, and the history that it needs.

One grid of patches serves the whole path. A patch stores where it touched or last slipped to, and
moves with the probe from there. The gap of one that has not touched follows the exact shape of the
probe as it is lowered; sideways the surface near a probe moves with it. What all patches of a probe
slip in common is a slide of the whole probe, and gaps are taken where it slid to.

A step in which patches touch or slip is taken in up to `INCREMENTS` parts, fewer where little
changes (`_parts`). A part with new patches is solved twice: with the new ones free to slide, and
with each held by friction from the moment at which it touched. With 8 parts the force of a stuck
sphere at nu = 0.3 is within 0.05 % of many parts, and the motion under a force that grows obliquely
within 2 % of the closed form. A part without an equilibrium is halved, a few times.

**Predictors** are where Newton's steps start: the straight continuation of the path, or, as a probe
touches first, a frictionless push with the shear of Cattaneo and Mindlin (`_predict_shear`), which
saves two Newton steps of seven.

**Limit load.** A side force and a torque are balanced by friction forces of at most mu f_n if and
only if no motion v of the probe gains more work from them than friction takes, the sum of
mu f_n |v| (upper bound of limit analysis; S. Goyal, A. Ruina and J. Papadopoulos, Wear 143 (1991)
307). It explains why there is no equilibrium; it uses the frictionless pressure, which is a few per
cent off at nu < 0.5 or on a slope, and refuses nothing by itself.

Validity: friction is the same at rest and in motion; one slide for all patches of a probe. A flat
face keeps the patches of first touch, so it may slide by a small part of its width only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.parts.load import Load
from twin.parts.press import INCREMENTS
from twin.parts.probe import Cone
from twin.theory.relaxation import Relaxation, RubberMemory
from twin.world.contact.active_set import Equilibrium, UnilateralProblem, pushes_for_depth, solve
from twin.world.contact.contact_search import ContactProblem, Control
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.friction_law import LAW
from twin.world.contact.influence import DenseInfluence, Influence, LatticeInfluence
from twin.world.contact.probe_gap import MOTIONS, TURN, X, Y, Z
from twin.world.contact.surface_patches import Patches


@dataclass(frozen=True, kw_only=True)
class _Trend:
    """What the last step of a path changed: forces (k, 3), place (6 p,), and what was given (6
    p,)."""

    force_n: Floats
    pose: Floats
    given: Floats


@dataclass(frozen=True, kw_only=True)
class ContactHistory:
    """Where each patch touched, or slipped to, and the state that the probes and the body are in.

    Attributes
    ----------
    touched, slipping
        (k,) patches in contact, and which of them slipped last.
    closed_mm
        (k,) gap of those at place 0, had they always moved with the probe.
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
    trend
        What the last step changed, for a guess at what the next one does.
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
    offset_mm: Floats
    pose: Floats
    total: Floats
    displacement_mm: Floats
    force_n: Floats
    slid_mm: Floats
    lifted: Bools
    dissipated_nmm: float = 0.0
    trend: _Trend | None = None
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

    @property
    def patches(self) -> Patches:
        """The patches of all probes."""
        return self.contacts.patches

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
        first touch."""
        return self.contacts.contact_jacobian(np.zeros(MOTIONS * len(self.friction)))

    def untouched(self, history: ContactHistory) -> Bools:
        """Return (k,) which patches belong to a probe that touches nothing."""
        none = [not history.touched[rows].any() for _, rows, _ in self.contacts.rows]
        return np.asarray(np.array(none)[self.contacts.owner])

    def sideways(self, pose: Floats) -> Floats:
        """Return a place without its motions along the directions of approach."""
        return np.where(self.contacts.along_z, 0.0, pose)

    def _slid_gap(self, slid_mm: Floats, along_z: Floats) -> tuple[Floats, Floats]:
        """Return gaps and slopes of probes that were lowered, and slid but not carried the surface
        along."""
        gap = np.zeros(len(self.patches))
        slope = np.zeros((len(self.patches), len(self.contacts.along_z)))
        for number, (setup, rows, motions) in enumerate(self.contacts.rows):
            grid = self.contacts.grids[number]
            first = setup.first
            lowered = np.zeros(MOTIONS)
            lowered[Z] = along_z[number]
            if setup.face is None:
                lowered[:Z] = slid_mm[number]
            gap[rows], slope[rows, motions] = self.contacts.gap_under(number, lowered)
            gap[rows] += grid.frames[:, 2] @ (slid_mm[number] @ first.axes[:Z])
        return gap, slope

    def gap(self, history: ContactHistory, pose: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps and (k, 6 p) slopes at a place."""
        gap, slope = self._slid_gap(history.slid_mm, pose[self.contacts.along_z])
        normal = self.contact_jacobian[:, 2]
        slope = np.where(self.contacts.along_z, slope, -normal)
        gap = gap - normal @ self.sideways(pose)
        stuck = history.touched & (self.friction[self.contacts.owner] > 0.0)
        gap[stuck] = (
            history.closed_mm[stuck] + self.moved_gap(history.slid_mm)[stuck] - normal[stuck] @ pose
        )
        slope[stuck] = -normal[stuck]
        if history.moved_mm is not None:
            gap += history.moved_mm[:, 2]
        gap[history.lifted[self.contacts.owner]] = np.inf
        return gap, slope

    def moved_gap(self, slid_mm: Floats) -> Floats:
        """Return (k,) by how much a slide changes the gaps; inf where the probe slid away."""
        if not slid_mm.any():
            return np.zeros(len(self.patches))
        still = np.zeros(len(self.friction))
        before = self._slid_gap(np.zeros_like(slid_mm), still)[0]
        after = self._slid_gap(slid_mm, still)[0]
        return np.where(
            np.isfinite(before), after - np.where(np.isfinite(before), before, 0.0), 0.0
        )

    def offset(self, history: ContactHistory) -> Floats:
        """Return (k, 2) from where each patch's slip counts.

        After a lift the probe touches again where it now is: its motion sideways counts from there.
        """
        here = -np.einsum("kad,d->ka", self.contact_jacobian[:, :2], self.sideways(history.pose))
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
            gap=lambda q: self.gap(history, q),
            contact_jacobian=self.contact_jacobian,
            by_force=control.by_force,
            given=control.given,
            pushing=control.pushing,
            area_mm2=self.patches.area_mm2,
            friction=np.where(frictional, self.friction[self.contacts.owner], 0.0),
            offset=self.offset(history),
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
        return replace(nothing, touched=touched, closed_mm=np.where(touched, gap, 0.0))

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
            + _lost_nmm(
                self, history, history.touched & rows, np.zeros_like(history.force_n), at_rest
            ),
        )

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


def _lost_nmm(
    grid: FrictionalContact, history: ContactHistory, slipped: Bools, force_n: Floats, away: Floats
) -> float:
    """Return the work that is lost where patches move over their probe, slipping or as they lift
    off, N mm.

    Parameters
    ----------
    grid, history
        The patches, and their state before.
    slipped
        (k,) which of them move.
    force_n, away
        (k, 3) forces afterwards, and displacements over the probes' points at place 0, in the
        patches' frames.

    Notes
    -----
    The mean of the tangential forces before and after times the slip. A patch that stuck slips only
    once its force has grown to its bound, so that a greater force counts from the start. One that
    lifts off loses its force on the way: no probe does work on what then snaps back.

    What touched in between has slipped from where it was held; where it slid before that, nothing
    pressed on it.
    """
    before = history.force_n[:, :2]
    after = force_n[:, :2]
    grown = ~history.slipping & (np.hypot(*before.T) < np.hypot(*after.T))
    mean = np.where(grown[:, None], after, (before + after) / 2.0)
    return -float(np.sum((mean * (away[:, :2] - grid.offset(history)))[slipped]))


_FORESEEN = 4.0
"""How many times as far as the last step another may go on in the same way."""

_BISECTIONS = 20


@dataclass(frozen=True, kw_only=True)
class _Prediction:
    """Forces (k, 3), a place (6 p,) and patches in contact (k,) to start from, and displacements
    where known."""

    force_n: Floats
    pose: Floats
    active: Bools
    displacement_mm: Floats | None = None


def _extrapolate_step(
    history: ContactHistory, control: Control, start: Floats
) -> _Prediction | None:
    """Return what a step leads to if it changes as the last one did; None where it doesn't go on in
    the same way."""
    if history.trend is None:
        return None
    wanted = control.given - start
    last = history.trend.given
    length = float(last @ last)
    share = float(wanted @ last) / length if length > 0.0 else 0.0
    if (
        not 0.0 < share <= _FORESEEN
        or np.abs(wanted - share * last).max() > 1e-6 * np.abs(wanted).max()
    ):
        return None
    force = history.force_n + share * history.trend.force_n
    pose = np.where(control.by_force, history.pose + share * history.trend.pose, control.given)
    return _Prediction(force_n=force, pose=pose, active=history.touched)


def _extrapolate_part(
    before: Equilibrium | None, now: Equilibrium | None
) -> Equilibrium | _Prediction | None:
    """Return what the next part leads to if it changes as the last one did."""
    if before is None or now is None:
        return now
    return _Prediction(
        force_n=2.0 * now.force_n - before.force_n,
        pose=2.0 * now.pose - before.pose,
        active=now.active,
        displacement_mm=2.0 * now.displacement_mm - before.displacement_mm,
    )


def _predict(
    grid: FrictionalContact,
    problem: UnilateralProblem,
    history: ContactHistory,
    control: Control,
    guess: Equilibrium | _Prediction | None,
) -> Equilibrium | _Prediction:
    """Return where to start on a part: at a guess that has forces, else at the last forces or a
    push, and sheared."""
    if guess is not None and guess.force_n.any():
        return guess
    force = history.force_n
    pose = np.where(control.by_force, history.pose, control.given)
    active = _predict_active(grid, history, pose, guess)
    if guess is not None or not force.any():
        pushed = _predict_frictionless(grid, problem, history, control, active)
        force = pushed.force_n
        pose = pushed.pose
    return _Prediction(force_n=_predict_shear(problem, force), pose=pose, active=active)


def _predict_active(
    grid: FrictionalContact,
    history: ContactHistory,
    pose: Floats,
    guess: Equilibrium | _Prediction | None,
) -> Bools:
    """Return a guess's patches in contact (k,), or the nearest ones where it has none."""
    return (
        guess.active if guess is not None and guess.active.any() else _nearest(grid, history, pose)
    )


def _nearest(grid: FrictionalContact, history: ContactHistory, pose: Floats) -> Bools:
    """Return a first guess of the patches in contact: those that were, or the few that are nearest
    to the probe."""
    if history.touched.any():
        return history.touched.copy()
    gap, _ = grid.gap(history, pose)
    near = [
        gap[rows] <= np.sort(gap[rows])[min(4, len(gap[rows]) - 1)]
        for _, rows, _ in grid.contacts.rows
    ]
    return np.concatenate(near) & np.isfinite(gap)


def _predict_frictionless(
    grid: FrictionalContact,
    problem: UnilateralProblem,
    history: ContactHistory,
    control: Control,
    active: Bools,
) -> Equilibrium:
    """Push along z only, without friction and held sideways: a first guess, and the pressure that
    friction rests on."""
    along_z = grid.contacts.along_z
    held = replace(
        problem,
        friction=np.zeros(len(active)),
        by_force=control.by_force & along_z,
        given=np.where(control.by_force & ~along_z, history.pose, control.given),
        pushing=control.pushing,
    )
    return solve(held, active, np.where(control.by_force, history.pose, control.given))


def _predict_shear(problem: UnilateralProblem, force: Floats) -> Floats:
    """Return forces (k, 3) with friction for the sideways forces that they lack: a ring slips, the
    middle sticks.

    Notes
    -----
    Friction is mu (p - p*), p* being the pressure of the smaller contact that sticks (M.
    Ciavarella, Int. J. Solids Struct. 35 (1998) 2349; Cattaneo's and Mindlin's superposition for
    any shape). Of a sphere p*^2 = p^2 - s^2.
    """
    force = force.copy()
    lacking = np.where(problem.by_force, problem.given - problem.total(force), 0.0).reshape(
        -1, MOTIONS
    )[:, :Z]
    for number, (x, y) in enumerate(lacking):
        most = math.hypot(x, y)
        push = np.maximum(force[:, 2], 0.0)
        along = (
            problem.contact_jacobian[:, :2, MOTIONS * number : MOTIONS * number + Z]
            @ np.array([x, y])
            / (most or 1.0)
        )
        friction = np.where(np.isfinite(problem.friction), problem.friction, 0.0)
        carries = friction * np.einsum("ka,ka->k", along, along)
        if not 0.0 < most < carries @ push:
            continue
        low = 0.0
        high = float(push.max())
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            slips = push - np.sqrt(np.maximum(push**2 - middle**2, 0.0))
            low, high = (middle, high) if carries @ slips < most else (low, middle)
        force[:, :2] += along * (friction * slips)[:, None]
    return force


_MOTIONS = 4000


def _motions(count: int) -> Floats:
    """Return (n, count) unit vectors, spread evenly."""
    if count == 1:
        return np.array([[1.0], [-1.0]])
    turn = np.arange(_MOTIONS) * math.pi * (3.0 - math.sqrt(5.0))
    if count == 2:
        turn = np.arange(_MOTIONS) * 2.0 * math.pi / _MOTIONS
        return np.column_stack([np.cos(turn), np.sin(turn)])
    height = 1.0 - 2.0 * (np.arange(_MOTIONS) + 0.5) / _MOTIONS
    around = np.sqrt(1.0 - height**2)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), height])


def limit_load_share(
    contact_jacobian: Floats, normal_n: Floats, bound_n: Floats, by_force: Bools, given: Floats
) -> float:
    """Return the given side forces and torque over the largest of their kind that friction can
    carry.

    Parameters
    ----------
    contact_jacobian
        (k, 3, 4) motion of the probe's points at the patches, in their frames, per unit of x, y, z
        and turn.
    normal_n
        (k,) normal forces, N.
    bound_n
        (k,) the largest tangential forces that friction allows, N.
    by_force, given
        (4,) which of x, y, z and turn are held by force, and the forces and the torque.

    Returns
    -------
    0 when no force is given; above 1 there is no balance.
    """
    free = np.flatnonzero(by_force & (np.arange(4) != Z))
    if len(free) == 0 or not normal_n.any() or np.isinf(bound_n).any():
        return 0.0
    arm = float(np.abs(contact_jacobian[:, :2, 3]).max()) or 1.0
    size = np.array([1.0, 1.0, 1.0, 1.0 / arm])[free]
    motion = _motions(len(free)) * size
    asked = (given - np.einsum("k,kd->d", normal_n, contact_jacobian[:, 2]))[free]
    pushing = normal_n > 0
    moved = np.einsum("kad,md->mka", contact_jacobian[pushing][:, :2, free], motion)
    taken = np.hypot(moved[..., 0], moved[..., 1]) @ bound_n[pushing]
    return float(np.max(motion @ asked / np.maximum(taken, 1e-300)))


SLIDE_LIMIT = 0.05
"""How far a flat face may slide as a whole, over its smaller width."""

KNOWN_TO = 0.05
"""How well `twin.world.contact.load_step` knows what friction can carry, over the whole."""

_RUBBED = [X, Y, Z, TURN]
"""The components of a probe's place that `twin.world.contact.load_step` knows."""


def _raise_limit_load(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    problem_found: ContactError,
    least: float = 1.0,
) -> None:
    """Raise a ContactError that names the cause when ``least`` times what friction can carry is
    asked, or more."""
    pose = np.where(control.by_force, history.pose, control.given)
    near = _nearest(grid, history, pose)
    pushed = _predict_frictionless(grid, grid.problem(history, control), history, control, near)
    for number, (_, rows, motions) in enumerate(grid.contacts.rows):
        contact_jacobian = grid.contact_jacobian[rows, :, motions][..., _RUBBED]
        friction = float(grid.friction[number])
        held = control.by_force[motions][_RUBBED]
        given = control.given[motions][_RUBBED]
        normal_n, area_mm2 = pushed.force_n[rows, 2], grid.patches.area_mm2[rows]
        bound_n = LAW.bound(np.full(len(normal_n), friction), normal_n, area_mm2)
        share = limit_load_share(contact_jacobian, normal_n, bound_n, held, given)
        if share >= least:
            asked = [f"{value:.4g}" for value in np.where(held, given, 0.0)]
            raise ContactError(
                f"contact: the forces ({', '.join(asked[:3])}) N and the torque {asked[3]} N mm "
                f"can't be balanced: sideways and about z they are {share:.4g} times what friction "
                f"{friction:g} can carry on this surface (allowed is less than 1 times, known to "
                f"{KNOWN_TO:g}), so that the probe slides: ask for less, push harder, raise "
                "press.friction, or hold x, y and the turn by motion"
            ) from problem_found


def _refuse_slide(grid: FrictionalContact, history: ContactHistory) -> None:
    """Raise a ContactError when the probe slid, or was lifted over, to where there are no
    patches."""
    from scipy.spatial import cKDTree

    for (setup, _, _), patches, moved in zip(
        grid.contacts.rows, grid.contacts.grids, history.slid_mm, strict=True
    ):
        slid = float(np.hypot(*moved))
        if setup.face is None:
            flat = patches.centre_mm @ setup.first.axes[:Z].T
            off = float(cKDTree(flat).query(flat + moved)[0].min())
            allowed = 4.0 * float(patches.half_mm.max())
            what = "beyond the patches, which lie around where it touched first"
        else:
            off = slid
            allowed = SLIDE_LIMIT * 2 * min(setup.face.half_mm)
            what = "as a whole, while the patches under a flat face stay where they are"
        if off > allowed:
            raise ContactError(
                f"contact: the {setup.probe.kind} slides (or is lifted) by {slid:.3g} mm, {what} "
                f"(off by {off:.3g} mm, allowed {allowed:.3g} mm): move it less, raise "
                "press.friction, or press it again where it ends"
            )


_HALVINGS = 3
_SLIDE_ROUNDS = 12
_SLID = 1e-3
_SLID_AT_LAST = 1e-2
"""How well a slide is known, over half a patch; the last where a patch comes and goes with it, so
that it jumps."""


def _part(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: Equilibrium | _Prediction | None,
    held: Bools | None = None,
) -> tuple[ContactHistory, Equilibrium]:
    """Solve one part from a guess; return the state, and the history with how far the probe slid as
    a whole.

    Of relaxing rubber, the elastic contact of the part's interval (`RubberMemory`).
    """
    if history.memory is None:
        return _elastic_part(grid, history, control, guess, held)
    share, left = history.memory.over(control.time_s - history.time_s)
    moved = -grid.influence.apply(left) / share
    elastic = replace(
        history,
        force_n=history.force_n / share,
        displacement_mm=history.displacement_mm - moved,
        moved_mm=moved,
    )
    given = np.where(control.by_force, control.given / share, control.given)
    if guess is not None:
        guess = _Prediction(force_n=guess.force_n / share, pose=guess.pose, active=guess.active)
    slid, found = _elastic_part(grid, elastic, replace(control, given=given), guess, held)
    found = replace(
        found,
        force_n=found.force_n * share,
        total=found.total * share,
        displacement_mm=found.displacement_mm + moved,
    )
    return replace(history, slid_mm=slid.slid_mm), found


def _elastic_part(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: Equilibrium | _Prediction | None,
    held: Bools | None,
) -> tuple[ContactHistory, Equilibrium]:
    """Solve one part as `_part`, of elastic rubber."""
    problem = grid.problem(history, control, held)
    if grid.sticks:
        pose = np.where(control.by_force, history.pose, control.given)
        return history, solve(problem, _predict_active(grid, history, pose, guess), pose)
    found = _from_guess(problem, _predict(grid, problem, history, control, guess))
    start = history.slid_mm
    share = 1.0
    before = np.zeros_like(history.slid_mm)
    for turn in range(_SLIDE_ROUNDS):
        slid = start + common_slide(grid, history, problem, found)
        off = slid - history.slid_mm
        late = 2 * turn >= _SLIDE_ROUNDS
        flat = all(setup.face is not None for setup in grid.contacts.setups)
        known = _SLID_AT_LAST if late else _SLID
        if float(np.abs(off).max()) <= known * float(grid.patches.half_mm.min()) or flat:
            return replace(history, slid_mm=slid), found
        if late and float(np.sum(off * before)) < 0.0:
            share /= 2  # to and fro: where a patch comes and goes lies between
        history = replace(history, slid_mm=slid - (1.0 - share) * off)
        before = off
        problem = grid.problem(history, control, held)
        found = solve_coulomb(problem, found.force_n, found.pose, found.displacement_mm)
    raise NotSettled(
        "contact: the probe slides, and where it slides to does not settle: take smaller steps"
    )


def _from_guess(problem: UnilateralProblem, guess: Equilibrium | _Prediction) -> Equilibrium:
    """Solve Coulomb's law from a guess, and from a probe that sticks where the guess is too far
    off."""
    try:
        return solve_coulomb(problem, guess.force_n, guess.pose, guess.displacement_mm)
    except ContactError:
        try:
            sticks = replace(problem, friction=np.where(problem.friction > 0, np.inf, 0.0))
            stuck = solve(sticks, guess.active, guess.pose)
        except ContactError:
            pass  # the first error is the telling one
        else:
            return solve_coulomb(problem, stuck.force_n, stuck.pose, stuck.displacement_mm)
        raise


def common_slide(
    grid: FrictionalContact, history: ContactHistory, problem: UnilateralProblem, found: Equilibrium
) -> Floats:
    """Return (p, 2) mm by which all patches of a probe slipped in common, along its x and y.

    It is 0 where one patch sticks.

    The mean of the least slips, as the least one alone may jump between patches that mirror each
    other; patches that touched within the part slipped for a part of it only and do not count.
    """
    slides = np.zeros_like(history.slid_mm)
    counted = found.active & (history.touched | grid.untouched(history))
    for number, (setup, rows, _) in enumerate(grid.contacts.rows):
        active = np.flatnonzero(counted[rows]) + rows.start
        if len(active) == 0 or not found.slipping[active].all():
            continue
        slip = (
            found.displacement_mm[active, :2]
            - problem.contact_jacobian[active, :2] @ found.pose
            - problem.offset[active]
        )
        length = np.hypot(slip[:, 0], slip[:, 1])
        least = length <= 1.1 * length.min()
        back = np.einsum("ka,kai->ki", slip[least], grid.patches.frames[active[least], :2]).mean(
            axis=0
        )
        slides[number] = -setup.first.axes[:Z] @ back
    return slides


def _remember(
    grid: FrictionalContact, history: ContactHistory, found: Equilibrium, time_s: float
) -> ContactHistory:
    new = found.active & (~history.touched | found.slipping)
    moved = np.einsum("kad,d->ka", grid.contact_jacobian, found.pose)
    away = found.displacement_mm - moved
    left = history.touched & ~found.active
    memory = history.memory
    if memory is not None:
        memory = memory.after(time_s - history.time_s, found.force_n)
    return ContactHistory(
        time_s=time_s,
        memory=memory,
        touched=found.active.copy(),
        slipping=found.slipping & found.active,
        closed_mm=np.where(
            new,
            -away[:, 2] - np.where(new, grid.moved_gap(history.slid_mm), 0.0),
            history.closed_mm,
        ),
        offset_mm=np.where(new[:, None], away[:, :2], history.offset_mm),
        pose=found.pose.copy(),
        total=found.total.copy(),
        displacement_mm=found.displacement_mm.copy(),
        force_n=found.force_n.copy(),
        slid_mm=history.slid_mm,
        lifted=history.lifted,
        dissipated_nmm=history.dissipated_nmm
        + _lost_nmm(grid, history, left | found.slipping, found.force_n, away),
    )


def _held_on_the_way(
    grid: FrictionalContact,
    history: ContactHistory,
    free: Equilibrium,
    new: Bools,
    seconds: float,
) -> ContactHistory:
    """Return the history with the offsets of patches that touch during a part, which ``free`` let
    slide to its end, some ``seconds`` later.

    Notes
    -----
    Had the new patches not been stopped, they would overlap the probe by S f at the end, f being
    their normal forces and S their normal compliance with the old patches kept in touch (a Schur
    complement). Between the gap at the start and that overlap the gap is interpolated linearly; a
    patch slides until it is zero.
    """
    gap, _ = grid.gap(history, history.pose)
    gap = np.maximum(gap[new] + history.displacement_mm[new, 2], 0.0)
    old = free.active & history.touched
    share = 1.0 if history.memory is None else history.memory.over(seconds)[0]
    pushed = np.where(new, free.force_n[:, 2] / share, 0.0)
    sunk = grid.influence.normal_displacement(pushed)
    relief = np.zeros_like(pushed)
    relief[old] = pushes_for_depth(grid.influence, np.flatnonzero(old), sunk[old])
    overlap = (sunk - grid.influence.normal_displacement(relief))[new]
    met = np.isfinite(gap)
    way = np.where(
        met, np.where(met, gap, 0.0) / np.maximum(gap + np.maximum(overlap, 0.0), 1e-300), 1.0
    )
    tangential = grid.contact_jacobian[new, :2]
    start = history.displacement_mm[new, :2] - tangential @ history.pose
    end = free.displacement_mm[new, :2] - tangential @ free.pose
    offset = history.offset_mm.copy()
    offset[new] = start + way[:, None] * (end - start)
    return replace(history, offset_mm=offset)


def _pass(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: Equilibrium | _Prediction | None,
) -> tuple[ContactHistory, Equilibrium]:
    """Solve one part, with the patches that touch within it held by friction from where they
    touched."""
    try:
        slid, found = _part(grid, history, control, guess)
    except ContactError:
        if grid.sticks or not history.touched.any():
            raise
        # The old patches alone may not carry what the new ones help to: hold those from the start
        # of the part.
        return _part(grid, history, control, guess, held=~history.touched)
    new = found.active & ~history.touched & ~grid.untouched(history)
    if history.touched.any() and new.any():
        seconds = control.time_s - history.time_s
        touching = _held_on_the_way(grid, history, found, new, seconds)
        return _part(grid, touching, control, found, held=new)
    return slid, found


def _advance(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: Equilibrium | _Prediction | None,
    wanted: Control,
    halvings: int = _HALVINGS,
) -> tuple[ContactHistory, Equilibrium]:
    """Take one part of a step to ``wanted``, in halves where it finds no equilibrium at once."""
    try:
        slid, found = _pass(grid, history, control, guess)
        return _remember(grid, slid, found, control.time_s), found
    except ContactError as problem_found:
        if grid.sticks:
            raise
        if halvings == _HALVINGS:
            _raise_limit_load(grid, history, wanted, problem_found)
        if halvings == 0:
            raise
    start = np.where(control.by_force, history.total, history.pose)
    half = replace(
        control,
        given=(start + control.given) / 2,
        time_s=(history.time_s + control.time_s) / 2,
    )
    history, found = _advance(grid, history, half, guess, wanted, halvings - 1)
    return _advance(grid, history, control, found, wanted, halvings - 1)


def _parts(history: ContactHistory, found: Equilibrium, control: Control, most: int) -> int:
    """Return in how many parts to take a step that leads to about ``found``: ``most`` where it
    changes half or more.

    What counts is the share of the patches that touch, stick or slip otherwise than before, or that
    of the forces; under a force that creeps, the share by which the rubber relaxes.
    """
    changed = (found.active != history.touched) | (
        (found.slipping & found.active) != history.slipping
    )
    patches = float(changed.sum()) / float((found.active | history.touched).sum())
    before, after = (
        float(np.linalg.norm(force, axis=1).sum()) for force in (history.force_n, found.force_n)
    )
    forces = float(np.linalg.norm(found.force_n - history.force_n, axis=1).sum()) / max(
        before, after, 1e-300
    )
    relaxed = 0.0
    if history.memory is not None and control.by_force.any():
        relaxed = 1.0 - history.memory.over(control.time_s - history.time_s)[0]
    return min(most, max(1, math.ceil(2.0 * most * max(patches, forces, relaxed))))


def load_step(
    grid: FrictionalContact, history: ContactHistory, control: Control, increments: int = INCREMENTS
) -> tuple[ContactHistory, Equilibrium, str]:
    """Take one step of the path.

    Parameters
    ----------
    grid, history
        The patches, and where they touched so far.
    control
        What holds the probe at the end of the step.
    increments
        Parts of a step in which patches touch or slip.

    Returns
    -------
    The history and the equilibrium at the end of the step, or of its last part that converged; why
    it stopped there, or an empty text.

    Raises
    ------
    ContactError
        A part has no equilibrium, or a flat face slides too far; `NotSettled` when the first part
        doesn't converge.
    """
    before = None
    previous = None
    first = history
    start = np.where(control.by_force, history.total, history.pose)

    def with_trend(then: ContactHistory) -> ContactHistory:
        force = then.force_n - first.force_n
        pose = then.pose - first.pose
        return replace(then, trend=_Trend(force_n=force, pose=pose, given=control.given - start))

    if history.touched.any():
        try:
            _, found = _part(grid, history, control, _extrapolate_step(history, control, start))
        except ContactError:
            pass  # a large step may fail where its parts succeed
        else:
            changed = found.active & ~history.touched | found.slipping
            if history.memory is not None:
                # Elastic forces change linearly in time where the same patches are moved.
                changed |= (found.active != history.touched) | bool(control.by_force.any())
            if not changed.any():
                return with_trend(_remember(grid, history, found, control.time_s)), found, ""
            increments = _parts(history, found, control, increments)
            previous = found if increments == 1 else None
    powers = np.ones(len(start))
    for setup, rows, motions in grid.contacts.rows:
        if setup.face is None and history.touched[rows].sum() <= 1:
            # Equal parts of the contact radius: a sphere's force grows with its cube, its motion
            # with its square.
            force, motion = (2.0, 1.0) if isinstance(setup.probe, Cone) else (3.0, 2.0)
            powers[motions] = np.where(control.by_force[motions], force, motion)
    if history.memory is not None:
        powers[:] = powers.max()  # all that is given changes linearly in time
    for part in range(1, increments + 1):
        share = (part / increments) ** powers
        now = Control(
            by_force=control.by_force,
            given=start + share * (control.given - start),
            time_s=first.time_s + float(share.max()) * (control.time_s - first.time_s),
        )
        _refuse_slide(grid, history)
        try:
            history, found = _advance(
                grid, history, now, _extrapolate_part(before, previous), control
            )
            before = previous
            previous = found
        except NotSettled as stopped:
            if part == 1 or previous is None:
                raise
            return history, previous, f"stopped after {part - 1} of {increments} parts: {stopped}"
        except ContactError as refused:
            _raise_limit_load(grid, history, control, refused, least=1.0 - KNOWN_TO)
            raise
    _refuse_slide(grid, history)
    assert previous is not None, "a step has at least one part"
    return with_trend(history), previous, ""
