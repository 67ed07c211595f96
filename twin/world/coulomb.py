"""Coulomb's friction on patches: each is open, sticks or slips, and a slipping one is dragged along its own motion.

Unknown are, as in `twin.world.unilateral`, the forces f of the patches and the place q of the probe. With the opening
o = u_n + gap(q) and the slip w = u_t - T q - b of the surface over the probe since the offset b was remembered,

    o >= 0,  f_n >= 0,  o f_n = 0                                       (touching or open)
    |f_t| <= mu f_n,  and w = -s f_t with s >= 0, s = 0 where |f_t| < mu f_n   (stick or slip)

Both lines are equations without inequalities, f_n = max(0, f_n - r o) and f_t = P(f_t - r w), where P projects on the
disc of radius mu f_n (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353). They are solved by
Newton's method: each step fixes which patches are open, stick or slip and solves the linear system that is left, with
the balance of the probe in it. Nothing is penalised: r scales the equations and leaves their solution alone.

Why a slipping patch has two unknowns, not three: along its direction d the force is mu f_n, so that only f_n and the
force across d, which turns d, are left. Why steps are shortened: far from the solution whole steps can cycle; the step
that leaves the least of the equations is taken.

Validity: the slip of one increment, from b to its end. Paths are walked in increments by `twin.world.friction`. With a
large coefficient, or strong coupling of normal and tangential motion, there may be no solution or more than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError
from twin.world.unilateral import TOLERANCE, Equilibrium, Unilateral

_STEPS, _GOAL = 60, 1e-13
_FAR = 1e4
"""A step of the probe over the contact's size that only a singular system asks for."""

_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """Forces and a place, and what they leave of the equations.

    ``pushed`` is f_n - r o, ``dragged`` is f_t - r w; ``errors`` are (k, 3) in N, ``balance`` (m,) in N and N mm.
    """

    force: Floats
    displacement: Floats
    place: Floats
    gap: Floats
    slope: Floats
    pushed: Floats
    dragged: Floats
    errors: Floats
    balance: Floats

    def size(self, reach: Floats) -> float:
        return float(np.sqrt(np.sum(self.errors**2) + np.sum((self.balance / reach) ** 2)))


def _projected(vector: Floats, radius: Floats) -> Floats:
    """Return (k, 2) vectors shortened to at most (k,) radii."""
    length = np.hypot(vector[:, 0], vector[:, 1])
    return np.asarray(vector * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None])


def _scales(problem: Unilateral) -> Floats:
    """Return (k,) r, N/mm: the force that moves a patch by itself along its normal."""
    k = len(problem.friction)
    return np.asarray(1.0 / problem.compliance.reshape(3 * k, 3 * k).diagonal().reshape(k, 3)[:, 2])


def _tried(problem: Unilateral, scale: Floats, force: Floats, displacement: Floats, place: Floats) -> _Trial:
    k = len(scale)
    gap, slope = problem.gap(place)
    reachable = np.isfinite(gap)
    opening = displacement[:, 2] + np.where(reachable, gap, 0.0)
    slip = displacement[:, :2] - problem.carried[:, :2] @ place - problem.offset
    pushed = np.where(reachable, force[:, 2] - scale * opening, -np.inf)
    dragged = force[:, :2] - scale[:, None] * slip
    errors = np.empty((k, 3))
    errors[:, 2] = force[:, 2] - np.maximum(pushed, 0.0)
    bound = problem.friction * np.maximum(force[:, 2], 0.0)
    errors[:, :2] = force[:, :2] - _projected(dragged, bound)
    total = problem.total(force)
    return _Trial(
        force=force, displacement=displacement, place=place, gap=gap, slope=slope, pushed=pushed, dragged=dragged,
        errors=errors, balance=np.where(problem.by_force, total - problem.given, 0.0),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Pattern:
    """Which patches touch and which of them slip, each with axes along and across its drag.

    ``ahead`` (n, 2) is the drag's direction; of a sticking patch, its own first axis. ``mu`` is 0 where it sticks.
    ``share`` is c = mu f_n / drag: across its drag a slipping patch turns by (1 - c) f / r + c w = 0.
    """

    touching: np.ndarray
    slips: Bools
    ahead: Floats
    mu: Floats
    share: Floats

    def turned(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the parts along and across the drag of (n, ...) parts along the patches' own axes."""
        shape = (-1,) + (1,) * (x.ndim - 1)
        cosine, sine = self.ahead[:, 0].reshape(shape), self.ahead[:, 1].reshape(shape)
        return cosine * x + sine * y, cosine * y - sine * x


def _pattern(problem: Unilateral, trial: _Trial) -> _Pattern:
    touching = np.flatnonzero(trial.pushed > 0)
    if near := problem.apart(trial.pushed > 0, -trial.pushed):
        touching = np.union1d(touching, near)
    drag = trial.dragged[touching]
    length = np.hypot(drag[:, 0], drag[:, 1])
    bound = problem.friction[touching] * np.maximum(trial.pushed[touching], 0.0)
    slips = length > bound
    return _Pattern(
        touching=touching, slips=slips,
        ahead=np.where(slips[:, None], drag / np.maximum(length, 1e-300)[:, None], [1.0, 0.0]),
        mu=np.where(slips, problem.friction[touching], 0.0),
        share=np.where(slips, bound / np.maximum(length, 1e-300), 1.0),
    )  # fmt: skip


def _compliance(problem: Unilateral, pattern: _Pattern) -> Floats:
    """Return the compliance of normal forces (with their friction), across forces, and sticking along forces."""
    rows, stuck = pattern.touching, ~pattern.slips
    across = np.ix_(rows, rows)
    lines = []
    for axis in range(3):
        x, y, normal = (problem.compliance[:, axis, :, other][across].T for other in range(3))
        along, sideways = pattern.turned(x, y)
        lines.append(np.concatenate([normal + pattern.mu[:, None] * along, sideways, along[stuck]]).T)
    along, sideways = pattern.turned(lines[0], lines[1])
    return np.concatenate([lines[2], sideways, along[stuck]])


def _newton_step(problem: Unilateral, scale: Floats, trial: _Trial) -> tuple[Floats, Floats]:
    """Return the forces (k, 3) and the place (m,) that solve the equations linearised at a trial."""
    pattern = _pattern(problem, trial)
    touching, stuck = pattern.touching, ~pattern.slips
    n = len(touching)
    size = 2 * n + int(stuck.sum())
    place = np.where(problem.by_force, trial.place, problem.given)
    carried = problem.carried[touching]
    along, across = pattern.turned(carried[:, 0], carried[:, 1])
    offset_along, offset_across = pattern.turned(*problem.offset[touching].T)
    # How an unknown enters the balance: a slipping patch's normal force brings its friction along.
    pull = np.concatenate([carried[:, 2] + pattern.mu[:, None] * along, across, along[stuck]])
    slope = trial.slope[touching]
    motion = np.concatenate([slope, -across, -along[stuck]])
    right = np.concatenate(
        [
            -trial.gap[touching] - slope @ (place - trial.place),
            offset_across + across @ place,
            offset_along[stuck] + along[stuck] @ place,
        ]
    )
    weight = np.ones(size)
    weight[n : 2 * n] = pattern.share
    felt = np.abs(pull).max(axis=0) > 1e-9
    free = np.flatnonzero(problem.by_force & felt)
    matrix = np.zeros((size + len(free), size + len(free)))
    matrix[:size, :size] = _compliance(problem, pattern) * weight[:, None]
    turning = np.arange(n, 2 * n)
    matrix[turning, turning] += (1.0 - pattern.share) / scale[touching]
    matrix[:size, size:] = (motion * weight[:, None])[:, free]
    matrix[size:, :size] = pull[:, free].T
    found, moved = _solved(matrix, np.concatenate([right * weight, problem.given[free]]), size)
    force = np.zeros((len(scale), 3))
    force[touching, 2] = found[:n]
    ahead, aside = pattern.mu * found[:n], found[n : 2 * n]
    ahead[stuck] += found[2 * n :]
    cosine, sine = pattern.ahead.T
    force[touching, 0], force[touching, 1] = cosine * ahead - sine * aside, sine * ahead + cosine * aside
    place[free] += moved
    return force, place


def _solved(matrix: Floats, right: Floats, size: int) -> tuple[Floats, Floats]:
    """Solve a linear system of compliances (the first ``size`` rows) and balances, both scaled to about one."""
    typical = float(np.mean(np.abs(np.diag(matrix)[:size])))
    count = len(right) - size
    scale = np.concatenate([np.full(size, typical**-0.5), np.full(count, typical**0.5)])
    try:
        found = np.linalg.solve(matrix * scale[:, None] * scale[None, :], right * scale) * scale
    except np.linalg.LinAlgError as problem_found:
        raise _slides_off() from problem_found
    return found[:size], found[size:]


def _slides_off() -> ContactError:
    return ContactError(
        "contact: every patch slips, so that nothing balances a force that is given along x or y, or a torque: push "
        "harder, ask for less, raise press.friction, or hold the component by motion"
    )


def solve_coulomb(problem: Unilateral, force: Floats, place: Floats) -> Equilibrium:
    """Find open, sticking and slipping patches, their forces and the probe's place.

    Parameters
    ----------
    problem
        The contact problem, with a finite coefficient of friction on each patch.
    force
        (k, 3) first guess of the forces, in the patches' frames, N.
    place
        (m,) first guess of the place.

    Raises
    ------
    ContactError
        The steps do not settle, or nothing balances a given force.
    """
    k = len(force)
    flat = problem.compliance.reshape(3 * k, 3 * k)
    scale = _scales(problem)
    reach, pushed = problem.reach, bool(problem.pushing.any())
    far = _FAR * float(reach.max())
    place = np.where(problem.by_force, place, problem.given)
    trial = _tried(problem, scale, force, (flat @ force.reshape(-1)).reshape(k, 3), place)
    left = trial.size(reach)
    for step in range(1, _STEPS + 1):
        if not pushed and not np.any(trial.pushed > 0) and not trial.force.any():
            return _settled(problem, trial, reach, step)
        if np.any(trial.pushed > 0) or pushed:
            force, place = _newton_step(problem, scale, trial)
        else:
            force, place = np.zeros((k, 3)), trial.place  # nothing touches where the probe is held
        if not np.abs((place - trial.place) * reach).max() < far:
            raise _slides_off()
        displacement = (flat @ force.reshape(-1)).reshape(k, 3)
        best, best_left = trial, np.inf
        for share in _SHARES:
            tried = _tried(
                problem, scale, trial.force + share * (force - trial.force),
                trial.displacement + share * (displacement - trial.displacement),
                trial.place + share * (place - trial.place),
            )  # fmt: skip
            now = tried.size(reach)
            if now < best_left:
                best, best_left = tried, now
            if best_left < (1.0 - 0.5 * share) * left:
                break
        trial, before, left = best, left, best_left
        if left <= _GOAL * float(np.linalg.norm(trial.force)) or (
            left >= 0.5 * before and _residual(problem, trial, reach) <= 0.01 * TOLERANCE
        ):
            return _settled(problem, trial, reach, step)
    if _residual(problem, trial, reach) <= TOLERANCE:
        return _settled(problem, trial, reach, _STEPS)
    raise ContactError(
        f"contact: stick and slip did not settle in {_STEPS} steps (left: {_residual(problem, trial, reach):.1e} "
        f"of the peak, allowed {TOLERANCE:g}): take smaller steps in the press, or another number of contact patches"
    )


def _residual(problem: Unilateral, trial: _Trial, reach: Floats) -> float:
    """Largest error of gap, sign, friction (as forces, over the peak normal force of a patch) and of balance."""
    peak = float(np.max(trial.force[:, 2], initial=0.0)) or 1.0
    load = float(np.abs(trial.force[:, 2]).sum()) or 1.0
    balance = np.abs(trial.balance) / (load * reach)
    return max(float(np.abs(trial.errors).max()) / peak, float(balance.max()))


def _settled(problem: Unilateral, trial: _Trial, reach: Floats, steps: int) -> Equilibrium:
    active = trial.pushed > 0
    force = np.where(active[:, None], trial.force, 0.0)
    dragged = np.hypot(trial.dragged[:, 0], trial.dragged[:, 1])
    return Equilibrium(
        force_n=force, displacement_mm=trial.displacement, place=trial.place, active=active,
        total=problem.total(force),
        slipping=active & (dragged > problem.friction * np.maximum(trial.force[:, 2], 0.0)),
        residual=_residual(problem, trial, reach), steps=steps,
    )  # fmt: skip
