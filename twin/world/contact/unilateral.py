"""The unilateral contact problem: tractions that only push, gaps that never close below zero, a rigid probe.

Unknown are the forces f of the patches in contact, in each patch's frame (first side, second side, inward normal), and
the probe's place q, one number for each rigid motion, where it is held by force. The motions are columns T of whatever
each patch sees of them, so that nothing here knows axes or how many probes there are. For the set A of patches in
contact, of which the set S sticks,

    u_n + gap(q) = 0        on A              (touching)
    u_t = T q + b           on S              (carried along by the probe since they touched)
    T^T f = given           for each component of q that is held by force
    f = 0 elsewhere, and f_n >= 0 on A, u_n + gap >= 0 off A

with u = K f. Why one linear system and not a search for the place: forces and place then meet their conditions
together to round-off, and the set A settles in a few primal-dual (semi-smooth Newton) steps; M. Hintermueller, K. Ito
and K. Kunisch, SIAM J. Optim. 13 (2002) 865. The exact gap is linearised at each step.

A sticking patch can be pulled off by the shear around it and, once free, be pushed back: the conditions above then have
no solution, and the set repeats itself. From there on a patch that lets go no longer sticks (it may come back, and
slides), which leaves a problem that has one; if the set still repeats, patches that pull leave before others come, and
at last it changes by one patch at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.errors import ContactError, NotSettled
from twin.world.contact.between import Between, between
from twin.world.contact.bordered import Bordered
from twin.world.contact.linear import LinearSolver

GapOfPlace = Callable[[Floats], tuple[Floats, Floats]]
TOLERANCE = 1e-8
_STEPS, _PATIENCE = 200, 40
FEW = 120
"""Patches in contact up to which linear systems are solved by elimination."""

_NEARER, _HELD = 1e-4, 1e-12
"""Shares of a right-hand side that iteration leaves: while the set in contact is sought, and where it is known."""

_MET = 1e-10
"""Largest opening of a patch in contact over the largest displacement; its gap is taken anew after every step."""

_FELT = 1e-9
_ALL_AT_ONCE, _LETTING_GO, _PULLS_FIRST, _ONE_BY_ONE = range(4)


@dataclass(frozen=True, kw_only=True)
class Unilateral:
    """One contact problem.

    Attributes
    ----------
    compliance
        (k, 3, k, 3) displacement of patch i along its axis a under a unit force on patch j along its axis b, mm/N, or
        what stands for it.
    gap
        Returns (k,) gaps, mm, and their (k, m) slopes at a place (m,).
    carried
        (k, 3, m) T: displacement of a point of the probe at each patch, in the patch's frame, per unit of each of the
        m rigid motions that make up the place; 0 at patches of another probe.
    by_force
        (m,) whether each component of the place is held by its force (torque).
    given
        (m,) total force and torque, N and N mm, or the place itself, mm and radians.
    pushing
        (m,) the components whose force pushes a probe on the body: each needs a patch in contact.
    friction
        (k,) coefficient of friction: 0 slides freely, inf is carried along whenever in contact.
    offset
        (k, 2) b, mm: the patch's motion over the probe, u_t - T q, from which its slip counts.
    sideways
        Whether it is asked for how far patches that slide freely move sideways.
    solver
        Solver of linear systems with this compliance; all are solved by elimination without one.
    """

    compliance: Floats | Between
    gap: GapOfPlace
    carried: Floats
    by_force: Bools
    given: Floats
    pushing: Bools
    friction: Floats
    offset: Floats
    sideways: bool = True
    solver: LinearSolver | None = None

    @cached_property
    def between(self) -> Between:
        """The compliance between the patches."""
        return between(self.compliance)

    def moved(self, force: Floats) -> Floats:
        """Return the (k, 3) displacements of the patches under forces (k, 3), mm."""
        return self.between.moved(force)

    @cached_property
    def reach(self) -> Floats:
        """(m,) largest motion of a patch per unit of each component: 1 of a translation, the arm of a turn, mm."""
        squared = np.einsum("kam,kam->km", self.carried, self.carried)
        largest = np.sqrt(np.max(squared, axis=0, initial=0.0))
        return np.where(largest > 0.0, largest, 1.0)

    def total(self, force: Floats) -> Floats:
        """Return (m,) the force (torque) along every component of forces (k, 3)."""
        return np.asarray(self.carried.reshape(-1, self.carried.shape[2]).T @ force.reshape(-1))

    def apart(self, active: Bools, gap: Floats) -> list[int]:
        """Return the nearest patch for every pushing component that has no patch in contact."""
        near = []
        for component in np.flatnonzero(self.pushing):
            own = np.flatnonzero(np.any(self.carried[:, :, component] != 0.0, axis=1))
            if not active[own].any():
                near.append(int(own[np.argmin(gap[own])]))
        return near

    @property
    def sticking(self) -> Bools:
        """(k,) S: which patches are carried along when in contact, however hard they are sheared."""
        return np.isinf(self.friction)


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """A solved contact problem.

    Attributes
    ----------
    force_n
        (k, 3) forces of the patches on the body in their own frames.
    displacement_mm
        (k, 3) displacements of the patches in their own frames; NaN sideways where that is not asked for.
    place
        (m,) the probe's place.
    active
        (k,) patches in contact.
    total
        (m,) total force, N, and torque, N mm.
    slipping
        (k,) patches that slid, if in contact; sticking ones only where they had to let go for an equilibrium to exist.
    residual
        Largest of the relative errors of gap, sign, stick and balance.
    steps
        Linear solves that were needed.
    """

    force_n: Floats
    displacement_mm: Floats
    place: Floats
    active: Bools
    total: Floats
    slipping: Bools
    residual: float
    steps: int


def _linear_solve(
    problem: Unilateral, active: Bools, place: Floats, gap: Floats, slope: Floats
) -> tuple[Floats, Floats]:
    """Return forces (k, 3) and place (m,) that meet every equation for a fixed set in contact."""
    k = len(active)
    touching = np.flatnonzero(active)
    stuck = np.flatnonzero(active & problem.sticking)
    rows = np.concatenate([3 * touching + 2, 3 * stuck, 3 * stuck + 1])
    flat_carried = problem.carried.reshape(3 * k, -1)
    # A component that these patches don't feel at all (a sphere's x on a barrel) stays put; the balance is checked.
    felt = np.abs(flat_carried[rows]).max(axis=0) > _FELT
    free = np.flatnonzero(problem.by_force & felt)
    n, m = len(rows), len(free)
    matrix = np.zeros((n + m, n + m))
    if len(stuck):
        part = problem.between.part(touching).reshape(3 * len(touching), -1)
        own = np.searchsorted(3 * touching, rows, side="right") - 1  # the patch's number among those in contact
        within = 3 * own + rows % 3
        matrix[:n, :n] = part[np.ix_(within, within)]
    else:
        matrix[:n, :n] = problem.between.normal_part(touching, touching)
    fixed = np.where(problem.by_force, place, problem.given)
    n_touch = len(touching)
    matrix[:n_touch, n:] = slope[touching][:, free]
    matrix[n_touch:n, n:] = -flat_carried[rows[n_touch:]][:, free]
    matrix[n:, :n] = flat_carried[rows][:, free].T
    right = np.zeros(n + m)
    right[:n_touch] = -gap[touching] - slope[touching] @ (fixed - place)
    right[n_touch:n] = flat_carried[rows[n_touch:]] @ fixed + problem.offset[stuck].T.reshape(-1)
    right[n:] = problem.given[free]
    # Compliances and forces differ in size by the modulus: scale both blocks to about one.
    size = float(np.mean(np.diag(matrix)[:n]))
    scale = np.concatenate([np.full(n, size**-0.5), np.full(m, size**0.5)])
    try:
        found = np.linalg.solve(matrix * scale[:, None] * scale[None, :], right * scale) * scale
    except np.linalg.LinAlgError as problem_found:
        raise ContactError(
            "contact: no place balances the given forces, as a component that is held by force can move freely (a "
            "probe without friction slides off a slope): hold x, y or the turn by motion (leave it out of force_n and "
            "torque_nmm), or give press.friction a value"
        ) from problem_found
    force = np.zeros(3 * k)
    force[rows] = found[:n]
    moved = np.array(fixed)
    moved[free] += found[n:]
    return force.reshape(k, 3), moved


def _iterated(
    problem: Unilateral, active: Bools, force: Floats, sunk: Floats, place: Floats, gap: Floats, slope: Floats,
    share: float,
) -> tuple[Floats, Floats] | None:  # fmt: skip
    """Return forces and place nearer to those of `_linear_solve`: a share of what a guess leaves is left.

    ``sunk`` (k,) are the normal displacements under the guess's forces. None where patches are few or stick, where
    nothing iterates well, and where the goal is out of reach.
    """
    compliance, touching = problem.between, np.flatnonzero(active)
    rough = compliance.rough
    if rough is None or len(touching) <= FEW or np.any(active & problem.sticking):
        return None
    carried, slope = problem.carried[touching, 2], slope[touching]
    free = np.flatnonzero(problem.by_force & (np.abs(carried).max(axis=0) > _FELT))
    fixed = np.where(problem.by_force, place, problem.given)
    push, unit, reach = np.where(active, force[:, 2], 0.0), float(compliance.own.mean()), problem.reach[free]
    bordered = Bordered(
        rows=lambda x: compliance.sunk(_spread(len(active), touching, x))[touching] / unit,
        roughly=lambda y: unit * np.stack([rough.pushes(touching, column) for column in y.T], axis=1),
        motion=slope[:, free] / reach, pull=(carried[:, free] / reach).T,
    )  # fmt: skip
    left = np.flatnonzero(~active & (force[:, 2] != 0.0))
    sunk_now = sunk[touching] - compliance.normal_part(touching, left) @ force[left, 2]
    right = -gap[touching] - slope @ (fixed - place) - sunk_now
    balance = (problem.given - problem.total(np.column_stack([0.0 * push, 0.0 * push, push])))[free]
    found = bordered.solve(right / unit, balance / reach, share)
    if found is None:
        return None
    push[touching] += found[0]
    moved = np.array(fixed)
    moved[free] += found[1] * unit / reach
    return np.column_stack([0.0 * push, 0.0 * push, push]), moved


def _spread(k: int, rows: Ints, values: Floats) -> Floats:
    whole = np.zeros(k)
    whole[rows] = values
    return whole


def holding(compliance: Between, rows: Ints, depth: Floats) -> Floats:
    """Return (n,) the normal forces on some patches that move these by ``depth`` (n,), mm, along their normals."""
    rough = compliance.rough
    if rough is not None and len(rows) > FEW:
        unit, k = float(compliance.own.mean()), len(compliance)
        bordered = Bordered(
            rows=lambda x: compliance.sunk(_spread(k, rows, x))[rows] / unit,
            roughly=lambda y: unit * rough.pushes(rows, y.reshape(-1)).reshape(y.shape),
            motion=np.zeros((len(rows), 0)), pull=np.zeros((0, len(rows))),
        )  # fmt: skip
        found = bordered.solve(depth / unit, np.zeros(0), _HELD)
        if found is not None:
            return found[0]
    return np.asarray(np.linalg.solve(compliance.normal_part(rows, rows), depth))


def solve(problem: Unilateral, active: Bools, place: Floats) -> Equilibrium:
    """Find the patches in contact, their forces and the probe's place.

    Parameters
    ----------
    problem
        The contact problem.
    active
        (k,) first guess of the patches in contact.
    place
        (m,) first guess of the place.

    Raises
    ------
    ContactError
        The equations are singular; `NotSettled` when the set in contact does not settle, or the solution misses its
        tolerance.
    """
    k = len(active)
    stiffness = 1.0 / problem.between.own
    force, sunk, place = np.zeros((k, 3)), np.zeros(k), np.where(problem.by_force, place, problem.given)
    seen: set[bytes] = set()
    mode, let_go, left = _ALL_AT_ONCE, np.zeros(k, bool), np.inf
    smooth = not problem.sticking.any()
    exact = problem.between.rough is None or not smooth
    gap, slope = problem.gap(place)
    for step in range(1, _STEPS + 1):
        active = active & np.isfinite(gap)
        active[problem.apart(active, gap)] = True
        if active.any():
            found = _iterated(problem, active, force, sunk, place, gap, slope, _HELD if exact else _NEARER)
            force, place = found or _linear_solve(problem, active, place, gap, slope)
        else:
            force = np.zeros((k, 3))
        gap, slope = problem.gap(place)
        sunk = problem.between.sunk(force[:, 2]) if smooth else problem.moved(force)[:, 2]
        opening = gap + sunk
        scale = float(np.max(np.abs(sunk), initial=1e-12))
        following = _next_set(active, force[:, 2] / stiffness, opening, 1e-13 * scale, mode)
        curved = float(np.max(np.abs(opening[active & np.isfinite(opening)]), initial=0.0))
        # The gap of a large probe is known to round-off of its size, which is more than that of a light touch's depth.
        met = curved <= _MET * scale or (curved >= 0.5 * left and curved <= 0.1 * TOLERANCE * scale)
        left = curved
        settled = np.array_equal(following, active)
        reachable = np.isfinite(gap[active]).all()  # what the probe has moved away from leaves in the next step
        if settled and ((met and reachable) or not active.any()):
            return _checked(problem, active, force, place, sunk, opening, let_go, step)
        repeats = following.tobytes() + problem.sticking.tobytes() in seen
        if not settled and (repeats or (len(seen) >= _PATIENCE and mode == _ALL_AT_ONCE)):
            mode, exact = min(mode + int(exact), _ONE_BY_ONE), True  # a set may repeat as it isn't solved well enough
            seen.clear()
            following = _next_set(active, force[:, 2] / stiffness, opening, 1e-13 * scale, mode)
        seen.add(following.tobytes() + problem.sticking.tobytes())
        if mode != _ALL_AT_ONCE:
            let_go |= active & ~following & problem.sticking
            problem = replace(problem, friction=np.where(let_go, 0.0, problem.friction))
        active = following
    raise NotSettled(
        f"contact: the patches in contact did not settle in {_STEPS} steps ({int(active.sum())} of {k} in contact): "
        "take smaller steps in the press, or another number of contact patches; a sticking probe that is sheared far "
        "harder than it is pressed needs more normal force"
    )


def _next_set(active: Bools, push_mm: Floats, opening: Floats, slack: float, mode: int) -> Bools:
    """Return the next set in contact: without those that pull, with those that overlap; or only the worst changed.

    ``push_mm`` are the patches' normal forces in terms of the displacement that each would cause alone.
    """
    pulls = np.where(active & (push_mm < -slack), -push_mm, 0.0)
    overlaps = np.where(~active & (opening < -slack), -opening, 0.0)
    if mode >= _PULLS_FIRST and pulls.any():
        overlaps[:] = 0.0
    worst = pulls + overlaps
    if mode == _ALL_AT_ONCE:
        return active ^ (worst > 0)
    if mode != _ONE_BY_ONE:
        # Neighbours often right themselves once the worst have changed.
        return np.asarray(active ^ ((worst > 0) & (worst >= 0.25 * worst.max())))
    following = active.copy()
    if worst.max() > 0:
        index = int(np.argmax(worst))
        following[index] = not following[index]
    return following


def sunk_alone(sunk: Floats) -> Floats:
    """Return (k, 3) displacements of which only the normal ones (k,) are known."""
    moved = np.full((len(sunk), 3), np.nan)
    moved[:, 2] = sunk
    return moved


def _checked(
    problem: Unilateral,
    active: Bools,
    force: Floats,
    place: Floats,
    sunk: Floats,
    opening: Floats,
    let_go: Bools,
    steps: int,
) -> Equilibrium:
    total, reach = problem.total(force), problem.reach
    displacement = problem.moved(force) if problem.sideways else sunk_alone(sunk)
    depth = float(np.nanmax(np.abs(displacement), initial=0.0)) or 1.0
    push = float(np.max(force[:, 2], initial=0.0)) or 1.0
    load = float(np.max(np.abs(total / reach))) or 1.0
    stuck = active & problem.sticking
    slip = displacement[stuck, :2] - problem.carried[stuck, :2] @ place - problem.offset[stuck]
    unbalanced = np.where(problem.by_force, np.abs(total - problem.given), 0.0) / (load * reach)
    errors = [
        float(np.max(np.abs(opening[active]), initial=0.0)) / depth,
        float(np.max(-opening[~active], initial=0.0)) / depth,
        float(np.max(-force[active, 2], initial=0.0)) / push,
        float(np.max(np.abs(slip), initial=0.0)) / depth,
        float(unbalanced.max()) if active.any() else 0.0,
    ]
    residual = max(errors)
    if not residual <= TOLERANCE:
        raise NotSettled(
            f"contact: the solution misses its conditions by {residual:.1e} (allowed {TOLERANCE:g}; gap, overlap, "
            f"pull, slip, balance: {', '.join(f'{e:.1e}' for e in errors)}): take smaller steps"
        )
    return Equilibrium(
        force_n=force, displacement_mm=displacement, place=place, active=active, total=total, slipping=let_go,
        residual=residual, steps=steps,
    )  # fmt: skip
