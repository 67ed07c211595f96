"""One step of a path with friction, from the history of its patches to their next one.

A step in which patches touch or slip is taken in up to `INCREMENTS` parts, fewer where little
changes (`_parts`). A part with new patches is solved twice: with the new ones free to slide, and
with each held by friction from the moment at which it touched. With 8 parts the force of a stuck
sphere at nu = 0.3 is within 0.05 % of many parts, and the motion under a force that grows obliquely
within 2 % of the closed form. A part without an equilibrium is halved, a few times.

**Predictors** are where Newton's steps start: the straight continuation of the path within a step,
or, as a probe touches first, a frictionless push.

**Limit load.** A side force and a torque are balanced by friction forces of at most mu f_n if and
only if no motion v of the probe gains more work from them than friction takes, the sum of
mu f_n |v| (upper bound of limit analysis; S. Goyal, A. Ruina and J. Papadopoulos, Wear 143 (1991)
307). It explains why there is no equilibrium; it uses the frictionless pressure, which is a few per
cent off at nu < 0.5 or on a slope, and refuses nothing by itself.

Validity: friction is the same at rest and in motion; one slide for all patches of a probe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.parts.press import INCREMENTS, Cone
from twin.world.contact.active_set import Equilibrium, UnilateralProblem, solve
from twin.world.contact.contact_problem import ContactHistory, Control, FrictionalContact
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.friction_law import LAW
from twin.world.contact.probe_gap import TURN, X, Y, Z


@dataclass(frozen=True, kw_only=True)
class _Guess:
    """Forces (k, 3), a place (6 p,) and patches in contact (k,) to start from, and displacements
    where known."""

    force_n: Floats
    pose: Floats
    active: Bools
    displacement_mm: Floats | None = None

    @classmethod
    def of(cls, found: Equilibrium) -> _Guess:
        """Return an equilibrium."""
        return cls(
            force_n=found.force_n,
            pose=found.pose,
            active=found.active,
            displacement_mm=found.displacement_mm,
        )

    @classmethod
    def at(cls, history: ContactHistory) -> _Guess:
        """Return where a history ends."""
        return cls(
            force_n=history.force_n,
            pose=history.pose,
            active=history.touched,
            displacement_mm=history.displacement_mm,
        )

    def on_line(self, other: _Guess, share: float) -> _Guess:
        """Return what lies on a straight line to another, at a share of the way; above 1 beyond
        it."""
        moved = None
        if self.displacement_mm is not None and other.displacement_mm is not None:
            moved = self.displacement_mm + share * (other.displacement_mm - self.displacement_mm)
        return _Guess(
            force_n=self.force_n + share * (other.force_n - self.force_n),
            pose=self.pose + share * (other.pose - self.pose),
            active=(self if share < 1.0 else other).active,
            displacement_mm=moved,
        )


def _predict(
    grid: FrictionalContact,
    problem: UnilateralProblem,
    history: ContactHistory,
    control: Control,
    guess: _Guess | None,
) -> _Guess:
    """Return where to start on a part: at a guess that has forces, else at the last forces or a
    push."""
    if guess is not None and guess.force_n.any():
        return guess
    force = history.force_n
    pose = np.where(control.by_force, history.pose, control.given)
    active = _nearest(grid, history, pose, guess)
    if guess is not None or not force.any():
        pushed = _predict_frictionless(grid, problem, history, control, active)
        force = pushed.force_n
        pose = pushed.pose
    return _Guess(force_n=force, pose=pose, active=active)


def _nearest(
    grid: FrictionalContact, history: ContactHistory, pose: Floats, guess: _Guess | None = None
) -> Bools:
    """Return a guess's patches in contact (k,), or those that were, or the few that are nearest to
    the probe."""
    if guess is not None and guess.active.any():
        return guess.active
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


_DIRECTIONS = 4000


def _directions(count: int) -> Floats:
    """Return (n, count) unit vectors in all directions."""
    vectors = np.random.default_rng(0).standard_normal((_DIRECTIONS, count))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _limit_load_share(
    jacobian: Floats, normal_n: Floats, bound_n: Floats, by_force: Bools, given: Floats
) -> float:
    """Return given side forces and a torque over the largest of their kind that friction carries: 0
    where none is given; above 1 there is no balance.

    The (k, 3, 4) jacobian is of x, y, z and turn, as are the (4,) components held ``by_force`` and
    ``given``; ``normal_n`` and ``bound_n`` (k,) are normal forces and the tangential ones at most.
    """
    free = np.flatnonzero(by_force & (np.arange(4) != Z))
    if len(free) == 0 or not normal_n.any() or np.isinf(bound_n).any():
        return 0.0
    arm = float(np.abs(jacobian[:, :2, 3]).max()) or 1.0
    motion = _directions(len(free)) * np.array([1.0, 1.0, 1.0, 1.0 / arm])[free]
    asked = (given - np.einsum("k,kd->d", normal_n, jacobian[:, 2]))[free]
    pushing = normal_n > 0
    moved = np.einsum("kad,md->mka", jacobian[pushing][:, :2, free], motion)
    taken = np.hypot(moved[..., 0], moved[..., 1]) @ bound_n[pushing]
    return float(np.max(motion @ asked / np.maximum(taken, 1e-300)))


_KNOWN_TO = 0.05
"""How well the limit load is known, over the whole."""

_RUBBED = [X, Y, Z, TURN]
"""The motions that the limit load takes into account."""


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
    for number, (setup, rows, motions) in enumerate(grid.contacts.rows):
        jacobian = grid.contact_jacobian[rows, :, motions][..., _RUBBED]
        friction = float(grid.friction[number])
        held = control.by_force[motions][_RUBBED]
        given = control.given[motions][_RUBBED]
        normal_n = pushed.force_n[rows, 2]
        bound_n = LAW.bound(np.full(len(normal_n), friction), normal_n, grid.patches.area_mm2[rows])
        share = _limit_load_share(jacobian, normal_n, bound_n, held, given)
        if share < least:
            continue
        asked = [f"{value:.4g}" for value in np.where(held, given, 0.0)]
        than = f"(allowed is less than 1 times, known to {_KNOWN_TO:g})"
        falls_mm = float(np.ptp(grid.patches.centre_mm[rows] @ setup.first.axes[Z]))
        if setup.face is not None and falls_mm > 0.0:
            slope = normal_n @ jacobian[:, 2, :Z]
            words = (
                f"the flat face of the {setup.name} slides off, as the sensing surface falls away "
                f"by {falls_mm:.3g} mm under it: the forces ({', '.join(asked[:Z])}) N sideways "
                f"(torque {asked[3]} N mm) are {share:.4g} times as far from the slope's own "
                f"({', '.join(f'{value:.4g}' for value in slope)}) N as friction {friction:g} can "
                f"carry {than}, more farther down: give press.force_n nearer to these or "
                f"press.friction over {share * (1.0 + _KNOWN_TO) * friction:.3g}"
            )
        else:
            words = (
                f"the forces ({', '.join(asked[:3])}) N and the torque {asked[3]} N mm can't be "
                f"balanced: sideways and about z they are {share:.4g} times what friction "
                f"{friction:g} can carry on this surface {than}, so that the probe slides: ask for "
                "less, push harder, raise press.friction"
            )
        raise ContactError(
            f"contact: {words}, or hold x, y and the turn by motion"
        ) from problem_found


def _refuse_slide(grid: FrictionalContact, history: ContactHistory) -> None:
    """Raise a ContactError when the probe slid, or was lifted over, to where there are no
    patches."""
    from scipy.spatial import cKDTree

    grid = grid.carried(history.slid_mm)
    for number, (setup, _, _) in enumerate(grid.contacts.rows):
        patches = grid.contacts.grids[number]
        moved = history.slid_mm[number]
        if not moved.any():
            continue
        slid = float(np.hypot(*moved))
        if setup.face is None:
            flat = patches.centre_mm @ setup.first.axes[:Z].T
            off = float(cKDTree(flat).query(flat + moved)[0].min())
            allowed = 4.0 * float(patches.half_mm.max())
            what = "beyond the patches, which lie around where it touched first"
        else:
            carried = 0.0 if grid.carried_mm is None else grid.carried_mm[number]
            off = float(np.hypot(*(moved - carried)))
            allowed = setup.stays_mm
            what = "as a whole, on rubber that remembers what pressed on it"
        if off > allowed:
            raise ContactError(
                f"contact: the {setup.probe.kind} slides (or is lifted) by {slid:.3g} mm, {what} "
                f"(off by {off:.3g} mm, allowed {allowed:.3g} mm): move it less, raise "
                "press.friction, or press it again where it ends"
            )


_HALVINGS = 3
_SLIDE_ROUNDS = 16
_SLID = 1e-3
_SLID_AT_LAST = 1e-2
"""How well a slide is known, over half a patch; the last where a patch comes and goes with it, so
that it jumps."""

_TO_AND_FRO = 0.9
"""A slide that comes back by more than this share of itself is sought between its two ends."""


@dataclass(frozen=True, kw_only=True)
class _SlideEnd:
    """A state of patches that are carried by ``slid_mm`` (p, 2), and by how much farther it slides,
    ``off_mm``.

    A slide that goes to and fro between two ends stops between them: where a patch comes or goes
    with it, or where, on a curved surface, friction carries the forces again. Before that place all
    patches slip, so that it slides on, behind it one holds, so that it seems not to have slid. The
    forces are the same: that patch's friction is at its bound.
    """

    slid_mm: Floats
    off_mm: Floats
    found: Equilibrium

    @property
    def seems_mm(self) -> Floats:
        """(p, 2) the slide by this state itself."""
        return self.slid_mm + self.off_mm

    def points_to(self, other: _SlideEnd) -> bool:
        """Return whether it slides on towards the other end."""
        return float(np.sum(self.off_mm * (other.slid_mm - self.slid_mm))) > 0.0

    def is_like(self, other: _SlideEnd) -> bool:
        """Return whether the other end has the same forces, to `_SLID_AT_LAST` of their sum."""
        here, there = self.found.force_n, other.found.force_n
        return float(np.abs(there - here).sum()) <= _SLID_AT_LAST * float(np.abs(here).sum())

    def and_back(self, other: _SlideEnd) -> bool:
        """Return whether the other end, where this one leads, leads back, and not to a place
        between."""
        length = np.linalg.norm(other.slid_mm - self.slid_mm)
        return other.points_to(self) and bool(np.linalg.norm(other.off_mm) > _TO_AND_FRO * length)


def _part(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: _Guess | None,
    held: Bools | None = None,
) -> tuple[ContactHistory, Equilibrium]:
    """Solve one part from a guess; return the state, and the history with how far the probe slid as
    a whole; of relaxing rubber, the elastic contact of the part's interval (`RubberMemory`)."""
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
        guess = replace(guess, force_n=guess.force_n / share, displacement_mm=None)
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
    guess: _Guess | None,
    held: Bools | None,
) -> tuple[ContactHistory, Equilibrium]:
    """Solve one part as `_part`, of elastic rubber."""
    here = grid.carried(history.slid_mm)
    problem = here.problem(history, control, held)
    if grid.sticks:
        pose = np.where(control.by_force, history.pose, control.given)
        active = _nearest(grid, history, pose, guess)
        if guess is None:
            return history, solve(problem, active, pose)
        return history, solve(problem, active, guess.pose, guess.force_n)
    start = history.slid_mm
    faces = all(setup.face is not None for setup in grid.contacts.setups)
    predicted = _predict(here, problem, history, control, guess)
    if faces and start.any():  # the displacement may be that of patches elsewhere
        predicted = replace(predicted, displacement_mm=None)
    found = _from_guess(problem, predicted)
    half_mm = float(here.patches.half_mm.max() if faces else here.patches.half_mm.min())
    last: _SlideEnd | None = None
    ends: tuple[_SlideEnd, _SlideEnd] | None = None
    for turn in range(_SLIDE_ROUNDS):
        slid = here.slid(start, history, found)
        off = slid - history.slid_mm
        known = _SLID_AT_LAST if 2 * turn >= _SLIDE_ROUNDS else _SLID
        stays = faces and grid.carried(slid) is here  # nothing depends on how far it slid
        if stays or float(np.abs(off).max()) <= known * half_mm:
            return replace(history, slid_mm=slid), found
        now = _SlideEnd(slid_mm=history.slid_mm, off_mm=off, found=found)
        if ends is not None:
            ends = (now, ends[1]) if now.points_to(ends[1]) else (ends[0], now)
        elif last is not None and last.and_back(now):
            ends = (last, now)
        if ends is not None:
            between = ends[1].slid_mm - ends[0].slid_mm
            near = float(np.abs(between).max()) <= _SLID_AT_LAST * half_mm
            if near and ends[0].is_like(ends[1]):
                rests = min(ends, key=lambda end: float(np.linalg.norm(end.seems_mm - start)))
                return replace(history, slid_mm=rests.slid_mm), rests.found
            slid = ends[0].slid_mm + 0.5 * between
        last = now
        history = replace(history, slid_mm=slid)
        there = grid.carried(slid)
        problem = there.problem(history, control, held)
        moved_mm = found.displacement_mm if there is here else None
        found = solve_coulomb(problem, found.force_n, found.pose, moved_mm)
        here = there
    raise NotSettled(
        "contact: the probe slides, and where it slides to does not settle: take smaller steps"
    )


def _from_guess(problem: UnilateralProblem, guess: _Guess) -> Equilibrium:
    """Solve Coulomb's law from a guess, or from a probe that sticks where the guess is too far
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
        closed_mm=np.where(new, -away[:, 2], history.closed_mm),
        shape_mm=np.where(new, grid.gap_at_touch(history.slid_mm), history.shape_mm),
        offset_mm=np.where(new[:, None], away[:, :2], history.offset_mm),
        pose=found.pose.copy(),
        total=found.total.copy(),
        displacement_mm=found.displacement_mm.copy(),
        force_n=found.force_n.copy(),
        slid_mm=history.slid_mm,
        lifted=history.lifted,
        dissipated_nmm=history.dissipated_nmm
        + grid.lost_nmm(history, left | found.slipping, found.force_n, away),
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
    relief[old] = grid.influence.pushes_for_depth(np.flatnonzero(old), sunk[old])
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
    guess: _Guess | None,
    known: tuple[ContactHistory, Equilibrium] | None,
) -> tuple[ContactHistory, Equilibrium]:
    """Return one part, with the patches that touch within it held by friction from where they
    touched; ``known`` is what it leads to where these slide, if that is solved."""
    try:
        slid, found = known or _part(grid, history, control, guess)
    except ContactError:
        if grid.sticks or not history.touched.any():
            raise
        # The old patches alone may not carry what the new ones help to: hold those from the start
        # of the part.
        return _part(grid, history, control, guess, held=~history.touched)
    new = found.active & ~history.touched & ~grid.untouched(history) & grid.rubs
    if history.touched.any() and new.any():
        seconds = control.time_s - history.time_s
        touching = _held_on_the_way(grid, history, found, new, seconds)
        return _part(grid, touching, control, _Guess.of(found), held=new)
    return slid, found


def _advance(
    grid: FrictionalContact,
    history: ContactHistory,
    control: Control,
    guess: _Guess | None,
    wanted: Control,
    known: tuple[ContactHistory, Equilibrium] | None = None,
    halvings: int = _HALVINGS,
) -> tuple[ContactHistory, Equilibrium]:
    """Take one part of a step to ``wanted``, in halves where it finds no equilibrium; ``known`` as
    of `_pass`."""
    try:
        slid, found = _pass(grid, history, control, guess, known)
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
    history, found = _advance(grid, history, half, guess, wanted, halvings=halvings - 1)
    return _advance(grid, history, control, _Guess.of(found), wanted, halvings=halvings - 1)


def _parts(
    grid: FrictionalContact, history: ContactHistory, control: Control, most: int, changed: float
) -> int:
    """Return in how many parts to take a step: ``most`` where it changes half or more.

    Under a force that creeps, the share by which the rubber relaxes counts, too. Without friction
    only relaxation asks for parts: the error is that share of the change, over the square of the
    parts.
    """
    if history.memory is not None:
        relaxed = 1.0 - history.memory.over(control.time_s - history.time_s)[0]
        if not grid.rubs.any():
            changed = math.sqrt(relaxed * max(changed, relaxed))
        elif control.by_force.any():
            changed = max(changed, relaxed)
    return min(most, max(1, math.ceil(2.0 * most * changed)))


_COMES = 2.0
"""What a first touch counts for in `_parts`: a contact that begins grows unlike any straight line,
and a sphere's force is .13 % off with 1, .06 % with this."""


def _changed(history: ContactHistory, force_n: Floats) -> float:
    """Return the share by which the forces on the patches (k, 3) N change."""
    apart, before, after = (
        float(np.linalg.norm(force, axis=1).sum())
        for force in (force_n - history.force_n, history.force_n, force_n)
    )
    return apart / max(before, after, 1e-300)


def _slide_parts(
    grid: FrictionalContact, history: ContactHistory, way: Floats, increments: int
) -> int:
    """Return in how many parts, at least ``increments``, to take a step whose motions by (6 p,) are
    given: in the usual number a smooth probe moves by up to its contact's radius in each. Patches
    that touch within a part are held from where they touched, before they have turned to where the
    probe slides."""
    parts = increments
    for setup, rows, motions in grid.contacts.rows:
        area = float(grid.patches.area_mm2[rows][history.touched[rows]].sum())
        if setup.face is None and area > 0.0 and not grid.sticks:
            radii = float(np.hypot(*way[motions][:Z])) / math.sqrt(area / math.pi)
            parts = max(parts, math.ceil(increments * radii / INCREMENTS))
    return parts


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
        A part has no equilibrium, or a probe slides too far; `NotSettled` when the first part
        doesn't converge.
    """
    whole = None
    guess = None
    before = None
    first = history
    start = np.where(control.by_force, history.total, history.pose)
    if history.touched.any():
        try:
            whole = _part(grid, history, control, None)
        except ContactError:
            pass  # a large step may fail where its parts succeed
        else:
            _, there = whole
            changed = there.active & ~history.touched | there.slipping
            if history.memory is not None:
                # Elastic forces change linearly in time where the same patches are moved.
                changed |= (there.active != history.touched) | bool(control.by_force.any())
            if not changed.any():
                return _remember(grid, history, there, control.time_s), there, ""
            slips = there.slipping & there.active
            turned = (there.active != history.touched) | (slips != history.slipping)
            share = float(turned.sum()) / float((there.active | history.touched).sum())
            share = max(share, _changed(history, there.force_n))
            increments = _parts(grid, history, control, increments, share)
            before = _Guess.at(history)
            guess = before.on_line(_Guess.of(there), 1.0 / increments)
    elif history.memory is not None and not grid.rubs.any():
        increments = _parts(grid, history, control, increments, _COMES)
    way = np.where(control.by_force, 0.0, control.given - start)
    increments = _slide_parts(grid, history, way, increments)
    powers = np.ones(len(start))
    for setup, rows, motions in grid.contacts.rows:
        if setup.face is None and history.touched[rows].sum() <= 1:
            # Equal parts of the contact radius: a sphere's force grows with its cube, its motion
            # with its square.
            force, motion = (2.0, 1.0) if isinstance(setup.probe, Cone) else (3.0, 2.0)
            powers[motions] = np.where(control.by_force[motions], force, motion)
    if history.memory is not None:
        powers[:] = powers.max()  # all that is given changes linearly in time
    found = None
    for part in range(1, increments + 1):
        shares = (part / increments) ** powers
        now = Control(
            by_force=control.by_force,
            given=start + shares * (control.given - start),
            time_s=first.time_s + float(shares.max()) * (control.time_s - first.time_s),
        )
        _refuse_slide(grid, history)
        try:
            history, found = _advance(
                grid, history, now, guess, control, whole if increments == 1 else None
            )
        except NotSettled as stopped:
            if found is None:
                raise
            return history, found, f"stopped after {part - 1} of {increments} parts: {stopped}"
        except ContactError as refused:
            _raise_limit_load(grid, history, control, refused, least=1.0 - _KNOWN_TO)
            raise
        here = _Guess.at(history)
        guess = here if before is None else before.on_line(here, 2.0)
        before = here
    _refuse_slide(grid, history)
    assert found is not None, "a step has at least one part"
    return history, found, ""
