"""Contact without friction, or that sticks: tractions that only push, and gaps that never close
below zero.

Unknown are the forces f of the patches in contact, in each patch's frame (first side, second side,
inward normal), and the probe's place q, one number for each rigid motion, where it is held by
force. The motions are columns T of whatever each patch sees of them, so that nothing here knows
axes or how many probes there are. For the set A of patches in contact, of which the set S sticks,

    u_n + gap(q) = 0        on A              (touching)
    u_t = T q + b           on S              (carried along by the probe since they touched)
    T^T f = given           for each component of q that is held by force
    f = 0 elsewhere, and f_n >= 0 on A, u_n + gap >= 0 off A

with u = K f. Forces and place meet their conditions together, and the set A settles in a few
primal-dual (semi-smooth Newton) steps; M. Hintermueller, K. Ito and K. Kunisch, SIAM J. Optim. 13
(2002) 865. The exact gap is linearised at each step.

A sticking patch can be pulled off by the shear around it and, once free, be pushed back: then there
is no solution, and the set repeats itself. From there on a patch that lets go no longer sticks (it
may come back, and slides); if the set still repeats, patches that pull leave before others come,
and at last it changes by one patch at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.world.contact.friction_law import LAW, FrictionLaw
from twin.world.contact.influence import Influence, SaddlePoint

GapOfPlace = Callable[[Floats], tuple[Floats, Floats]]
TOLERANCE = 1e-8
_STEPS = 200
_PATIENCE = 40
_NEARER = 1e-4
_HELD = 1e-12
"""Shares of a right-hand side that iteration leaves: while the set in contact is sought, and where
it is known."""

_MET = 1e-10
"""Largest opening of a patch in contact over the largest displacement; its gap is computed again
after every step."""

_FEW = 180
"""Patches in contact up to which elimination is faster than iteration."""

_FELT = 1e-9
_ALL_AT_ONCE, _LETTING_GO, _PULLS_FIRST, _ONE_BY_ONE = range(4)


@dataclass(frozen=True, kw_only=True)
class UnilateralProblem:
    """One contact problem.

    Attributes
    ----------
    influence
        The compliance between the k patches.
    gap
        Returns (k,) gaps, mm, and their (k, m) slopes at a place (m,).
    contact_jacobian
        (k, 3, m) T: displacement of a point of the probe at each patch, in the patch's frame, per
        unit of each of the m rigid motions that make up the place; 0 at patches of another probe.
    by_force
        (m,) whether each component of the place is held by its force (torque).
    given
        (m,) total force and torque, N and N mm, or the place itself, mm and radians.
    pushing
        (m,) the components whose force pushes a probe on the body: each needs a patch in contact.
    area_mm2
        (k,) areas of the patches.
    friction
        (k,) coefficient of friction: 0 slides freely, inf is carried along whenever in contact.
    offset
        (k, 2) b, mm: the patch's motion over the probe, u_t - T q, from which its slip counts.
    law
        How large friction may be.
    sideways
        Whether the sideways motion of patches that slide freely is of interest.
    """

    influence: Influence
    gap: GapOfPlace
    contact_jacobian: Floats
    by_force: Bools
    given: Floats
    pushing: Bools
    area_mm2: Floats
    friction: Floats
    offset: Floats
    law: FrictionLaw = LAW
    sideways: bool = True

    def most_sideways(self, push: Floats) -> Floats:
        """Return (k,) the largest tangential forces that friction allows under normal forces (k,),
        N."""
        return self.law.bound(self.friction, push, self.area_mm2)

    def displacement(self, force: Floats) -> Floats:
        """Return the (k, 3) displacements of the patches under forces (k, 3), mm."""
        return self.influence.apply(force)

    @cached_property
    def lever_arm(self) -> Floats:
        """(m,) largest motion of a patch per unit of each component: 1 of a translation, the arm of
        a turn, mm."""
        squared = np.einsum("kam,kam->km", self.contact_jacobian, self.contact_jacobian)
        largest = np.sqrt(np.max(squared, axis=0, initial=0.0))
        return np.where(largest > 0.0, largest, 1.0)

    def total(self, force: Floats) -> Floats:
        """Return (m,) the force (torque) along every component of forces (k, 3)."""
        return np.asarray(
            self.contact_jacobian.reshape(-1, self.contact_jacobian.shape[2]).T @ force.reshape(-1)
        )

    def apart(self, active: Bools, gap: Floats) -> list[int]:
        """Return the nearest patch for every pushing component that has no patch in contact."""
        near = []
        for component in np.flatnonzero(self.pushing):
            own = np.flatnonzero(np.any(self.contact_jacobian[:, :, component] != 0.0, axis=1))
            if not active[own].any():
                near.append(int(own[np.argmin(gap[own])]))
        return near

    @property
    def sticking(self) -> Bools:
        """(k,) S: which patches are carried along when in contact, however hard they are
        sheared."""
        return np.isinf(self.friction)


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """A solved contact problem.

    Attributes
    ----------
    force_n
        (k, 3) forces of the patches on the body in their own frames.
    displacement_mm
        (k, 3) displacements of the patches in their own frames; NaN sideways where that is not of
        interest.
    pose
        (m,) the probe's pose.
    active
        (k,) patches in contact.
    total
        (m,) total force, N, and torque, N mm.
    slipping
        (k,) patches that slid, if in contact; sticking ones only where they had to let go for an
        equilibrium to exist.
    residual
        Largest of the relative errors of gap, sign, stick and balance.
    steps
        Linear solves that were needed.
    """

    force_n: Floats
    displacement_mm: Floats
    pose: Floats
    active: Bools
    total: Floats
    slipping: Bools
    residual: float
    steps: int

    def part(self, rows: slice, motions: slice) -> Equilibrium:
        """Return one probe's part: its patches and its motions."""
        return replace(
            self,
            force_n=self.force_n[rows],
            displacement_mm=self.displacement_mm[rows],
            pose=self.pose[motions],
            active=self.active[rows],
            total=self.total[motions],
            slipping=self.slipping[rows],
        )


def _linear_solve(
    problem: UnilateralProblem, active: Bools, pose: Floats, gap: Floats, slope: Floats
) -> tuple[Floats, Floats]:
    """Return forces (k, 3) and place (m,) that meet every equation for a fixed set in contact, by
    elimination."""
    k = len(active)
    touching = np.flatnonzero(active)
    stuck = np.flatnonzero(active & problem.sticking)
    # Equations and unknowns: the normal axis of every patch in contact, then both sides of those
    # that stick.
    rows = np.concatenate([3 * touching + 2, 3 * stuck, 3 * stuck + 1])
    normal = len(touching)
    jacobian = problem.contact_jacobian.reshape(3 * k, -1)[rows]
    # What these patches don't resist (a sphere's x on a barrel) stays put; the balance is checked.
    free = np.flatnonzero(problem.by_force & (np.abs(jacobian).max(axis=0) > _FELT))
    if len(stuck):
        block = problem.influence.block(touching).reshape(3 * normal, -1)
        # The patch's number among those in contact.
        own = np.searchsorted(3 * touching, rows, side="right") - 1
        within = 3 * own + rows % 3
        matrix = block[np.ix_(within, within)]
    else:
        matrix = problem.influence.normal_block(touching, touching)
    fixed = np.where(problem.by_force, pose, problem.given)
    motion = np.concatenate([slope[touching], -jacobian[normal:]])[:, free]
    right = np.concatenate(
        [
            -gap[touching] - slope[touching] @ (fixed - pose),
            jacobian[normal:] @ fixed + problem.offset[stuck].T.reshape(-1),
        ]
    )
    try:
        found, moved = SaddlePoint.eliminate(
            matrix, motion, jacobian[:, free].T, right, problem.given[free]
        )
    except np.linalg.LinAlgError as singular:
        raise ContactError(
            "contact: no place balances the given forces, as a component that is held by force can "
            "move freely (a probe without friction slides off a slope): hold x, y or the turn by "
            "motion (leave it out of force_n and torque_nmm; where force_n is to act along "
            'press.direction, press.axes = "probe" does so), or give press.friction a value'
        ) from singular
    force = np.zeros(3 * k)
    force[rows] = found
    fixed[free] += moved
    return force.reshape(k, 3), fixed


def _iterated(
    problem: UnilateralProblem,
    active: Bools,
    force: Floats,
    sunk: Floats,
    pose: Floats,
    gap: Floats,
    slope: Floats,
    share: float,
) -> tuple[Floats, Floats] | None:
    """Return forces and place as `_linear_solve`, by GMRES from a guess, of whose residual a
    ``share`` is left; ``sunk`` (k,) are the guess's normal displacements. None where patches stick,
    and where the goal is out of reach."""
    touching = np.flatnonzero(active)
    if np.any(active & problem.sticking):
        return None
    influence = problem.influence
    unit = influence.unit
    jacobian = problem.contact_jacobian[touching, 2]
    slope = slope[touching]
    free = np.flatnonzero(problem.by_force & (np.abs(jacobian).max(axis=0) > _FELT))
    fixed = np.where(problem.by_force, pose, problem.given)
    push = np.where(active, force[:, 2], 0.0)
    lever_arm = problem.lever_arm[free]
    system = influence.normal_system(
        touching, slope[:, free] / lever_arm, (jacobian[:, free] / lever_arm).T
    )
    # Before solving, remove the forces of the patches that left.
    left = np.flatnonzero(~active & (force[:, 2] != 0.0))
    right = -gap[touching] - slope @ (fixed - pose) - sunk[touching]
    if len(left):
        right += influence.normal_block(touching, left) @ force[left, 2]
    balance = (problem.given - problem.total(_normal_forces(push)))[free]
    found = system.solve(right / unit, balance / lever_arm, share)
    if found is None:
        return None
    push[touching] += found[0]
    fixed[free] += found[1] * unit / lever_arm
    return _normal_forces(push), fixed


def _normal_forces(push: Floats) -> Floats:
    """Return (k, 3) forces of which only the normal ones (k,) are not 0."""
    force = np.zeros((len(push), 3))
    force[:, 2] = push
    return force


def solve(
    problem: UnilateralProblem, active: Bools, pose: Floats, force_n: Floats | None = None
) -> Equilibrium:
    """Find the patches in contact, their forces and the probe's pose.

    Parameters
    ----------
    problem
        The contact problem.
    active
        (k,) first guess of the patches in contact.
    pose
        (m,) first guess of the pose.
    force_n
        (k, 3) first guess of the forces, where nothing sticks. Default: none.

    Raises
    ------
    ContactError
        The equations are singular; `NotSettled` when the set in contact does not settle, or the
        solution misses its tolerance.
    """
    k = len(active)
    stiffness = 1.0 / problem.influence.own
    pose = np.where(problem.by_force, pose, problem.given)
    seen: set[bytes] = set()
    mode = _ALL_AT_ONCE
    released = np.zeros(k, bool)
    left = np.inf
    smooth = not problem.sticking.any()
    force = np.zeros((k, 3))
    sunk = np.zeros(k)
    if smooth and force_n is not None:
        force = _normal_forces(force_n[:, 2])
        sunk = problem.influence.normal_displacement(force[:, 2])
    exact = not smooth
    gap, slope = problem.gap(pose)
    for step in range(1, _STEPS + 1):
        active = active & np.isfinite(gap)
        active[problem.apart(active, gap)] = True
        if active.any():
            found = None
            if np.count_nonzero(active) > _FEW:
                found = _iterated(
                    problem, active, force, sunk, pose, gap, slope, _HELD if exact else _NEARER
                )
            force, pose = found or _linear_solve(problem, active, pose, gap, slope)
        else:
            force = np.zeros((k, 3))
        gap, slope = problem.gap(pose)
        sunk = (
            problem.influence.normal_displacement(force[:, 2])
            if smooth
            else problem.displacement(force)[:, 2]
        )
        opening = gap + sunk
        scale = float(np.max(np.abs(sunk), initial=1e-12))
        following = _next_set(active, force[:, 2] / stiffness, opening, 1e-13 * scale, mode)
        curved = float(np.max(np.abs(opening[active & np.isfinite(opening)]), initial=0.0))
        # The gap of a large probe is known to round-off of its size, which is more than that of a
        # light touch's depth.
        met = curved <= _MET * scale or (curved >= 0.5 * left and curved <= 0.1 * TOLERANCE * scale)
        left = curved
        settled = np.array_equal(following, active)
        # What the probe has moved away from leaves in the next step.
        reachable = np.isfinite(gap[active]).all()
        if settled and ((met and reachable) or not active.any()):
            return _checked(problem, active, force, pose, sunk, opening, released, step)
        repeats = following.tobytes() + problem.sticking.tobytes() in seen
        if not settled and (repeats or (len(seen) >= _PATIENCE and mode == _ALL_AT_ONCE)):
            # a set may repeat as it isn't solved well enough
            mode = min(mode + int(exact), _ONE_BY_ONE)
            exact = True
            seen.clear()
            following = _next_set(active, force[:, 2] / stiffness, opening, 1e-13 * scale, mode)
        seen.add(following.tobytes() + problem.sticking.tobytes())
        if mode != _ALL_AT_ONCE:
            released |= active & ~following & problem.sticking
            problem = replace(problem, friction=np.where(released, 0.0, problem.friction))
        active = following
    raise NotSettled(
        f"contact: the patches in contact did not settle in {_STEPS} steps ({int(active.sum())} of "
        f"{k} in contact): take smaller steps in the press, or another number of contact patches; "
        "a sticking probe that is sheared far harder than it is pressed needs more normal force"
    )


def _next_set(active: Bools, push_mm: Floats, opening: Floats, slack: float, mode: int) -> Bools:
    """Return the next set in contact: without those that pull, with those that overlap; or only the
    worst changed. ``push_mm`` are the patches' normal forces times each one's own compliance."""
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


def _checked(
    problem: UnilateralProblem,
    active: Bools,
    force: Floats,
    pose: Floats,
    sunk: Floats,
    opening: Floats,
    released: Bools,
    steps: int,
) -> Equilibrium:
    total = problem.total(force)
    lever_arm = problem.lever_arm
    displacement = np.full_like(force, np.nan)
    displacement[:, 2] = sunk
    if problem.sideways:
        displacement = problem.displacement(force)
    depth = float(np.nanmax(np.abs(displacement), initial=0.0)) or 1.0
    push = float(np.max(force[:, 2], initial=0.0)) or 1.0
    load = float(np.max(np.abs(total / lever_arm))) or 1.0
    stuck = active & problem.sticking
    slip = (
        displacement[stuck, :2] - problem.contact_jacobian[stuck, :2] @ pose - problem.offset[stuck]
    )
    unbalanced = np.where(problem.by_force, np.abs(total - problem.given), 0.0) / (load * lever_arm)
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
            f"contact: the solution misses its conditions by {residual:.1e} (allowed "
            f"{TOLERANCE:g}; gap, overlap, pull, slip, balance: "
            f"{', '.join(f'{e:.1e}' for e in errors)}): take smaller steps"
        )
    return Equilibrium(
        force_n=force,
        displacement_mm=displacement,
        pose=pose,
        active=active,
        total=total,
        slipping=released,
        residual=residual,
        steps=steps,
    )
