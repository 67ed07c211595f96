"""Coulomb's friction on patches: each is open, sticks, or slips along its own motion.

Unknown are, as in `twin.world.contact.active_set`, the forces f of the patches and the pose q of
the probe. With the opening o = u_n + gap(q) and the slip w = u_t - T q - b since the stored offset,

    o >= 0,  f_n >= 0,  o f_n = 0                                       (touching or open)
    |f_t| <= mu f_n,  and w = -s f_t with s >= 0, s = 0 where |f_t| < mu f_n   (stick or slip)

Both are equations without inequalities, f_n = max(0, f_n - r o) and f_t = P(f_t - r w), where P
projects on the disc of radius mu f_n (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92
(1991) 353), solved by a semismooth Newton method. The scale r leaves the solution alone. Steps are
shortened to the one that leaves the smallest residual, as whole ones can cycle; where they still
do, the coefficient is raised from 1 in steps (continuation).

**Newton system.** A sticking patch has three unknowns. A slipping one has two, as its force along
the drag d is mu f_n: f_n and the force across d, which turns d. Unknowns and equations of n patches
in contact, s of which stick, are ordered (normal, n; across, n; along, s). Before solving, the
inadmissible force is removed: all of it on open patches, the part above mu f_n on slipping ones.
The unknowns x and the probe's motion q then satisfy

    C (jump + x) + M q = right,    B^T x = balance,

C being the compliance, with (1 - c) / r added where a patch slips. GMRES solves them
(`twin.world.contact.influence`); it works on the change of the trial, so that a thousandth is
good enough.

Validity: one increment's slip; `twin.world.contact.load_step` takes paths in increments. With a
large coefficient, or strong coupling of normal and tangential motion, there may be no solution, or
several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.errors import ContactError, NotSettled
from twin.world.contact.active_set import TOLERANCE, Equilibrium, UnilateralProblem
from twin.world.contact.influence import Influence, SaddlePoint

_AT_BOUND = 1.0 - 1e-9
"""A patch that slipped before stands at its bound, to round-off, and slips on unless its load
turns."""

_SLIPS = 1.0 + 1e-7
"""Trial force over the bound above which a patch slips: what is held at its bound does not, though
round-off moves it."""

_LEAST_SHARE = 1e-5
_MOST_SHARE = 1e-3
"""Residual over the right-hand side: the least that is asked of GMRES, as the next step measures
what is left, and the largest that a step may leave."""


@dataclass(frozen=True, kw_only=True)
class _ContactStatus:
    """Derivatives of the projection of trial forces on the admissible discs, at the trial."""

    touching: Ints  # (n,) the patches in contact
    slips: Bools  # (n,) which trial forces lie outside their disc
    ahead: Floats  # (n, 2) their directions; of a sticking patch, its own first axis
    mu: Floats  # (n,) slope of the bound over the normal force; 0 where it sticks
    constant_n: Floats  # (n,) bound minus slope times normal force: 0 under Coulomb's law
    # (n,) c, bound over the length of the trial force; 1 where it sticks. A slipping patch turns
    # across its drag by (1 - c) f / r + c w = 0.
    share: Floats

    @cached_property
    def stuck(self) -> Ints:
        """(s,) which of the n patches stick."""
        return np.flatnonzero(~self.slips)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 2 * len(self.touching) + len(self.stuck)

    @property
    def across(self) -> slice:
        """The unknowns and equations across the drag."""
        return slice(len(self.touching), 2 * len(self.touching))

    @cached_property
    def _third(self) -> Ints:
        """(n,) where each patch's force along is among the unknowns; 0 where it slips."""
        third = np.zeros(len(self.touching), int)
        third[self.stuck] = np.arange(2 * len(self.touching), self.size)
        return third

    def forces(self, unknowns: Floats) -> Floats:
        """Return (3, n, ...) the forces in the patches' frames for (size, ...) unknowns."""
        return self._to_vectors(unknowns, self.mu)

    @property
    def constant(self) -> Floats:
        """(3, n) the part of the friction that does not depend on the normal force."""
        return np.concatenate(
            [(self.constant_n[:, None] * self.ahead).T, np.zeros((1, len(self.touching)))]
        )

    def prolong(self, parts: Floats) -> Floats:
        """Return the (3, n, ...) vectors whose `restrict` is (size, ...), with no part along a
        slipping drag."""
        return self._to_vectors(parts, np.zeros_like(self.mu))

    def _to_vectors(self, parts: Floats, mu: Floats) -> Floats:
        columns = parts.reshape(self.size, math.prod(parts.shape[1:]))
        out = np.empty((3, len(self.touching), columns.shape[1]), parts.dtype)
        _turn_back(columns, self.ahead, mu, self._third, out)
        return out.reshape(3, len(self.touching), *parts.shape[1:])

    def restrict(self, vectors: Floats) -> Floats:
        """Return (size, ...) parts of (3, n, ...) vectors: normal, across the drag, and along it
        where it sticks."""
        columns = vectors.reshape(3, len(self.touching), math.prod(vectors.shape[2:]))
        out = np.empty((self.size, columns.shape[2]), vectors.dtype)
        _turn(columns, self.ahead, self._third, out)
        return out.reshape(self.size, *vectors.shape[2:])

    def adjoint(self, vectors: Floats) -> Floats:
        """Return (size, ...) the adjoint of `forces`: a slipping patch's normal force brings its
        friction along."""
        x, y, normal = vectors
        columns = (slice(None),) + (None,) * (x.ndim - 1)
        cosine = self.ahead[:, 0][columns]
        sine = self.ahead[:, 1][columns]
        along = cosine * x + sine * y
        return np.concatenate(
            [normal + self.mu[columns] * along, cosine * y - sine * x, along[self.stuck]]
        )


@njit(cache=True)
def _turn_back(unknowns: Floats, drag: Floats, mu: Floats, third: Ints, out: Floats) -> None:
    """Set ``out`` (3, n, c) to unknowns (size, c); compiled, as NumPy takes a dozen calls."""
    n = len(mu)
    for i in range(n):
        for c in range(unknowns.shape[1]):
            normal = unknowns[i, c]
            across = unknowns[n + i, c]
            along = mu[i] * normal
            if third[i] > 0:
                along += unknowns[third[i], c]
            out[0, i, c] = drag[i, 0] * along - drag[i, 1] * across
            out[1, i, c] = drag[i, 1] * along + drag[i, 0] * across
            out[2, i, c] = normal


@njit(cache=True)
def _turn(vectors: Floats, drag: Floats, third: Ints, out: Floats) -> None:
    """Set ``out`` (size, c) to the parts of vectors (3, n, c)."""
    n = len(third)
    for i in range(n):
        for c in range(vectors.shape[2]):
            x = vectors[0, i, c]
            y = vectors[1, i, c]
            out[i, c] = vectors[2, i, c]
            out[n + i, c] = drag[i, 0] * y - drag[i, 1] * x
            if third[i] > 0:
                out[third[i], c] = drag[i, 0] * x + drag[i, 1] * y


@dataclass(frozen=True, kw_only=True)
class _NewtonSystem:
    """One Newton step's equations of n patches in contact and m motions that are held by force."""

    status: _ContactStatus
    jump: Floats  # (k, 3) known change of the forces of all patches, N
    shift: Floats  # (n,) (1 - c) / r of the equations across the drag, mm/N
    jacobian: Floats  # (3, n, m) motion of the probe's points at the patches per motion
    slope: Floats  # (n, m) how the gaps change with the motions
    lever_arm: Floats  # (m,) 1 of a translation, an arm of a turn, mm

    @cached_property
    def motion(self) -> Floats:
        """(size, m) M."""
        return self.restrict(-self.jacobian, self.slope)

    @cached_property
    def pull(self) -> Floats:
        """(m, size) B^T: how the unknowns enter the balance."""
        return self.status.adjoint(self.jacobian).T

    def restrict(self, displacement: Floats, opening: Floats | None = None) -> Floats:
        """Return (size, ...) what (3, n, ...) displacements add to the equations; ``opening`` for
        their normal part."""
        out = self.status.restrict(displacement)
        if opening is not None:
            out[: len(self.status.touching)] = opening
        out[self.status.across] *= self.status.share.reshape(-1, *[1] * (out.ndim - 1))
        return out

    def solve(
        self, influence: Influence, right: Floats, balance: Floats, share: float
    ) -> tuple[Floats, Floats]:
        """Return x (size,) and q (m,) for ``right`` (size,), mm, and ``balance`` (m,), N and N mm;
        a ``share`` of these may be left. Raises numpy.linalg.LinAlgError where singular."""
        if self.jump.any():
            right = right - self.restrict(influence.apply(self.jump)[self.status.touching].T)
        found = self._iterate(influence, right, balance, share)
        if found is not None:
            return found
        return SaddlePoint.eliminate(
            self._matrix(influence), self.motion, self.pull, right, balance
        )

    def _iterate(
        self, influence: Influence, right: Floats, balance: Floats, share: float
    ) -> tuple[Floats, Floats] | None:
        """Return the solution by GMRES, lengths over the compliance's unit; None if out of reach.
        Equations across the drag are multiplied by c. The preconditioner shares its root between
        rows and columns, and adds 1 - c for the shift: at c = 0, without friction, nothing else is
        left."""
        status = self.status
        across = status.across
        unit = influence.unit
        rows = status.touching
        turned = status.share
        shift = self.shift / unit
        root = np.ones((status.size, 1))
        root[across, 0] = np.sqrt(turned)

        def product(x: Floats) -> Floats:
            out = status.restrict(influence.product(rows, status.forces(x)))
            out[across] = turned * out[across] + shift * x[across]
            return out

        def approx_solve(y: Floats) -> Floats:
            out = status.restrict(influence.approx_solve(rows, status.prolong(y * root))) * root
            out[across] += (1.0 - turned)[:, None] * y[across]
            return np.asarray(out)

        system = SaddlePoint(
            product=product,
            approx_solve=approx_solve,
            motion=self.motion / self.lever_arm,
            pull=self.pull / self.lever_arm[:, None],
        )
        found = system.solve(
            right / unit, balance / self.lever_arm, min(_MOST_SHARE, max(share, _LEAST_SHARE))
        )
        return None if found is None else (found[0], found[1] * unit / self.lever_arm)

    def _matrix(self, influence: Influence) -> Floats:
        """Return (size, size) C."""
        status = self.status
        across = np.arange(status.size)[status.across]
        columns = status.adjoint(influence.block(status.touching).transpose(3, 2, 1, 0))
        matrix = self.restrict(np.ascontiguousarray(columns.transpose(1, 2, 0)))
        matrix[across, across] += self.shift
        return matrix


_STEPS = 60
_GOAL = 1e-10
_FAR = 1e4
"""A step of the probe over the contact's size that only a singular system asks for."""

_SETTLES = 1.0
_FACTOR = 7.4
_MISSES = 8
"""Coefficient of friction from which it is raised, the largest factor at once, and how often a
coefficient may be missed: from 1 ten of ten problems were reached that Newton's steps missed."""

_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """Forces and a place, and what they leave of the equations.

    ``pushed`` is f_n - r o, ``dragged`` is f_t - r w; ``errors`` are (k, 3) in N, ``balance`` (m,)
    in N and N mm.
    """

    force: Floats
    displacement: Floats
    pose: Floats
    gap: Floats
    slope: Floats
    pushed: Floats
    dragged: Floats
    errors: Floats
    balance: Floats

    def size(self, lever_arm: Floats) -> float:
        return float(np.sqrt(np.sum(self.errors**2) + np.sum((self.balance / lever_arm) ** 2)))


def _tried(
    problem: UnilateralProblem, scale: Floats, force: Floats, displacement: Floats, pose: Floats
) -> _Trial:
    k = len(scale)
    gap, slope = problem.gap(pose)
    reachable = np.isfinite(gap)
    opening = displacement[:, 2] + np.where(reachable, gap, 0.0)
    slip = displacement[:, :2] - problem.contact_jacobian[:, :2] @ pose - problem.offset
    pushed = np.where(reachable, force[:, 2] - scale * opening, -np.inf)
    dragged = force[:, :2] - scale[:, None] * slip
    errors = np.empty((k, 3))
    errors[:, 2] = force[:, 2] - np.maximum(pushed, 0.0)
    errors[:, :2] = force[:, :2] - _project(problem, force[:, 2], dragged)
    total = problem.total(force)
    return _Trial(
        force=force,
        displacement=displacement,
        pose=pose,
        gap=gap,
        slope=slope,
        pushed=pushed,
        dragged=dragged,
        errors=errors,
        balance=np.where(problem.by_force, total - problem.given, 0.0),
    )


def _project(problem: UnilateralProblem, push: Floats, trial: Floats) -> Floats:
    """Return the admissible tangential forces (k, 2) nearest to trial forces (k, 2) under normal
    forces (k,)."""
    length = np.hypot(trial[:, 0], trial[:, 1])
    bound = problem.most_sideways(push)
    return np.asarray(trial * np.minimum(1.0, bound / np.maximum(length, 1e-300))[:, None])


def _status(problem: UnilateralProblem, trial: _Trial) -> _ContactStatus:
    """Return the derivatives of `_project` on the patches in contact."""
    touching = np.flatnonzero(trial.pushed > 0)
    if near := problem.apart(trial.pushed > 0, -trial.pushed):
        touching = np.union1d(touching, near)
    friction, area = problem.friction[touching], problem.area_mm2[touching]
    push = trial.pushed[touching]
    dragged = trial.dragged[touching]
    length = np.hypot(dragged[:, 0], dragged[:, 1])
    bound = problem.law.bound(friction, push, area)
    slips = length > _AT_BOUND * bound
    mu = np.where(slips, problem.law.slope(friction, push, area), 0.0)
    linear = mu * np.maximum(push, 0.0)
    safe = np.where(slips, np.maximum(length, 1e-300), 1.0)
    return _ContactStatus(
        touching=touching,
        slips=slips,
        ahead=np.where(slips[:, None], dragged / safe[:, None], [1.0, 0.0]),
        mu=mu,
        constant_n=np.where(slips, np.where(slips, bound, 0.0) - linear, 0.0),
        share=np.where(slips, bound, 1.0) / safe,
    )


def _newton_step(
    problem: UnilateralProblem, scale: Floats, trial: _Trial, share: float
) -> tuple[Floats, Floats]:
    """Return the forces (k, 3) and the place (m,) that solve, to a share, the equations linearised
    at a trial."""
    status = _status(problem, trial)
    touching = status.touching
    across = status.across
    pose = np.where(problem.by_force, trial.pose, problem.given)
    jacobian = problem.contact_jacobian[touching].transpose(1, 0, 2)
    slope = trial.slope[touching]
    # Before solving, remove the inadmissible force.
    unknowns = status.restrict(trial.force[touching].T)
    start = np.zeros_like(trial.force)
    start[touching] = (status.forces(unknowns) + status.constant).T
    # A motion that no patch resists (a sphere's x on a barrel) stays as it is.
    free = np.flatnonzero(problem.by_force & (np.abs(status.adjoint(jacobian)).max(axis=0) > 1e-9))
    system = _NewtonSystem(
        status=status,
        jump=start - trial.force,
        shift=(1.0 - status.share) / scale[touching],
        jacobian=jacobian[..., free],
        slope=slope[:, free],
        lever_arm=problem.lever_arm[free],
    )
    # Residual of the trial with the motions that are given.
    away = trial.displacement[touching].T
    away[:2] -= jacobian[:2] @ pose + problem.offset[touching].T
    away[2] += trial.gap[touching] + slope @ (pose - trial.pose)
    left = system.restrict(away)
    left[across] += system.shift * unknowns[across]
    balance = (problem.given - problem.total(start))[free]
    try:
        change, moved = system.solve(problem.influence, -left, balance, share)
    except np.linalg.LinAlgError as singular:
        raise _slides_off() from singular
    force = np.zeros_like(trial.force)
    force[touching] = (status.forces(unknowns + change) + status.constant).T
    pose[free] += moved
    return force, pose


def _slides_off() -> ContactError:
    return ContactError(
        "contact: every patch slips, so that nothing balances a force that is given along x or y, "
        "or a torque: push harder, ask for less, raise press.friction, or hold the component by "
        "motion"
    )


def solve_coulomb(
    problem: UnilateralProblem, force: Floats, pose: Floats, displacement: Floats | None = None
) -> Equilibrium:
    """Find open, sticking and slipping patches, their forces and the probe's pose.

    Where Newton's steps do not settle, the coefficient of friction is raised from 1 in steps as
    large as settle, each from the solution before (continuation).

    Parameters
    ----------
    problem
        The contact problem; patches of infinite friction stick while they are pushed.
    force
        (k, 3) first guess of the forces, in the patches' frames, N.
    pose
        (m,) first guess of the pose.
    displacement
        (k, 3) displacements of the patches under the guess's forces, mm, where they are known.

    Raises
    ------
    ContactError
        Nothing balances a given force; `NotSettled` when the steps do not settle.
    """
    try:
        return _newton(problem, force, pose, displacement)
    except NotSettled:
        finite = problem.friction[np.isfinite(problem.friction)]
        if finite.max(initial=0.0) <= _SETTLES:
            raise
        found = _continued(problem, force, pose, displacement, float(finite.max()))
        if found is None:
            raise
        return found


def _continued(
    problem: UnilateralProblem, force: Floats, pose: Floats, displacement: Floats | None, end: float
) -> Equilibrium | None:
    """Return the solution by raising the coefficient of friction to ``end``; None if out of
    reach."""
    found = None
    done = _SETTLES / _FACTOR
    factor = _FACTOR
    misses = 0
    while misses <= _MISSES:
        friction = min(end, done * factor)
        limited = np.where(np.isinf(problem.friction), np.inf, problem.friction.clip(max=friction))
        try:
            found = _newton(
                replace(problem, friction=limited), force, pose, displacement, _STEPS // 2
            )
        except ContactError:
            misses += 1
            if found is not None:
                factor = math.sqrt(factor)
                continue
            # Friction that small does not carry the given forces.
        else:
            if friction == end:
                return found
            force, pose, displacement = found.force_n, found.pose, found.displacement_mm
            factor = min(_FACTOR, factor**1.5)
        done = friction
    return None


def _newton(
    problem: UnilateralProblem,
    force: Floats,
    pose: Floats,
    displacement: Floats | None,
    most: int = _STEPS,
) -> Equilibrium:
    """Take up to ``most`` of Newton's steps from a guess, as `solve_coulomb`."""
    k = len(force)
    scale = 1.0 / problem.influence.own
    lever_arm = problem.lever_arm
    pushed = bool(problem.pushing.any())
    far = _FAR * float(lever_arm.max())
    pose = np.where(problem.by_force, pose, problem.given)
    if displacement is None:
        displacement = problem.displacement(force)
    trial = _tried(problem, scale, force, displacement, pose)
    left = trial.size(lever_arm)
    if trial.force.any() and left <= _GOAL * float(np.linalg.norm(trial.force)):
        return _settled(problem, trial, lever_arm, 0)
    for step in range(1, most + 1):
        if not pushed and not np.any(trial.pushed > 0) and not trial.force.any():
            return _settled(problem, trial, lever_arm, step)
        if np.any(trial.pushed > 0) or pushed:
            # The residual shrinks with its square: a linear system need be solved no better than
            # that.
            relative = left / float(np.linalg.norm(trial.force) or left)
            share = max(0.1 * relative, 0.3 * _GOAL / relative)
            force, pose = _newton_step(problem, scale, trial, share)
        else:
            # Nothing touches where the probe is held.
            force = np.zeros((k, 3))
            pose = trial.pose
        if not np.abs((pose - trial.pose) * lever_arm).max() < far:
            raise _slides_off()
        displacement = trial.displacement + problem.displacement(force - trial.force)
        # Take the step, shortened until the residual falls.
        best = trial
        best_left = np.inf
        for share in _SHARES:
            tried = _tried(
                problem,
                scale,
                trial.force + share * (force - trial.force),
                trial.displacement + share * (displacement - trial.displacement),
                trial.pose + share * (pose - trial.pose),
            )
            now = tried.size(lever_arm)
            if now < best_left:
                best = tried
                best_left = now
            if best_left < (1.0 - 0.5 * share) * left:
                break
        before = left
        trial = best
        left = best_left
        if left <= _GOAL * float(np.linalg.norm(trial.force)) or (
            left >= 0.5 * before and _residual(trial, lever_arm) <= 0.01 * TOLERANCE
        ):
            return _settled(problem, trial, lever_arm, step)
    if _residual(trial, lever_arm) <= TOLERANCE:
        return _settled(problem, trial, lever_arm, most)
    raise NotSettled(
        f"contact: stick and slip did not settle in {most} steps (left: "
        f"{_residual(trial, lever_arm):.1e} of the peak, allowed {TOLERANCE:g}): take "
        "smaller steps in the press, or another number of contact patches"
    )


def _residual(trial: _Trial, lever_arm: Floats) -> float:
    """Largest error of gap, sign, friction (as forces, over the peak normal force of a patch) and
    of balance."""
    peak = float(np.max(trial.force[:, 2], initial=0.0)) or 1.0
    load = float(np.abs(trial.force[:, 2]).sum()) or 1.0
    balance = np.abs(trial.balance) / (load * lever_arm)
    return max(float(np.abs(trial.errors).max()) / peak, float(balance.max()))


def _settled(
    problem: UnilateralProblem, trial: _Trial, lever_arm: Floats, steps: int
) -> Equilibrium:
    active = trial.pushed > 0
    force = np.where(active[:, None], trial.force, 0.0)
    dragged = np.hypot(trial.dragged[:, 0], trial.dragged[:, 1])
    return Equilibrium(
        force_n=force,
        displacement_mm=trial.displacement,
        pose=trial.pose,
        active=active,
        total=problem.total(force),
        slipping=active & (dragged > _SLIPS * problem.most_sideways(trial.force[:, 2])),
        residual=_residual(trial, lever_arm),
        steps=steps,
    )
