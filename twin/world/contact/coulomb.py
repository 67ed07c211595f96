"""Coulomb's friction on patches: each is open, sticks or slips, and a slipping one is dragged along its own motion.

Unknown are, as in `twin.world.contact.unilateral`, the forces f of the patches and the place q of the probe. With the
opening o = u_n + gap(q) and the slip w = u_t - T q - b of the surface over the probe since the offset b was remembered,

    o >= 0,  f_n >= 0,  o f_n = 0                                       (touching or open)
    |f_t| <= mu f_n,  and w = -s f_t with s >= 0, s = 0 where |f_t| < mu f_n   (stick or slip)

Both lines are equations without inequalities, f_n = max(0, f_n - r o) and f_t = P(f_t - r w), where P projects on the
disc of radius mu f_n (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353). They are solved by
Newton's method: each step fixes which patches are open, stick or slip and solves the linear system that is left, with
the balance of the probe in it. Nothing is penalised: r scales the equations and leaves their solution alone.

Why steps are shortened: far from the solution whole steps can cycle; the step that leaves the least of the equations is
taken. Why a step is solved for the change of the trial, not for the forces: an iterative solution
(`twin.world.contact.krylov`) need then be good to a thousandth only, as the next step mends the rest. For the same
reason a change's motion is a product in single precision, where a solver keeps what that takes, until what these lose
counts beside what is left of the equations: then the motion is taken anew in double precision.

Validity: the slip of one increment, from b to its end. Paths are walked in increments by `twin.world.contact.friction`.
With a large coefficient, or strong coupling of normal and tangential motion, there may be no solution or more than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, NotSettled
from twin.world.contact.between import Between, between
from twin.world.contact.linear import LinearSystem
from twin.world.contact.pattern import Pattern
from twin.world.contact.unilateral import TOLERANCE, Equilibrium, Unilateral

_STEPS, _GOAL = 60, 1e-10
_FEW = 60
"""Patches in contact up to which linear systems are solved by elimination; each has three unknowns."""
_FAR = 1e4
"""A step of the probe over the contact's size that only a singular system asks for."""

_AT_BOUND = 1.0 - 1e-9
"""A patch that slipped before stands at its bound, to round-off, and slips on unless its load turns."""

_LOST, _COUNTS = 2e-7, 0.03
"""Share of a motion that single precision loses at most; share of what is left of the equations that this may be."""

_HOLDS, _STAYS = 0.03, 1e-6
"""Least weight of a patch that slips in the fit of a first place, and that of the place staying as it is."""

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


def _most(friction: Floats, push: Floats) -> Floats:
    """Return (k,) the most that friction can carry; of a patch that sticks there is no limit while it is pushed."""
    return np.where(push > 0.0, np.where(push > 0.0, push, 1.0) * friction, 0.0)


def _scales(problem: Unilateral) -> Floats:
    """Return (k,) r, N/mm: the force that moves a patch by itself along its normal."""
    return np.asarray(1.0 / problem.between.own)


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
    bound = _most(problem.friction, force[:, 2])
    errors[:, :2] = force[:, :2] - _projected(dragged, bound)
    total = problem.total(force)
    return _Trial(
        force=force, displacement=displacement, place=place, gap=gap, slope=slope, pushed=pushed, dragged=dragged,
        errors=errors, balance=np.where(problem.by_force, total - problem.given, 0.0),
    )  # fmt: skip


def _pattern(problem: Unilateral, trial: _Trial) -> Pattern:
    touching = np.flatnonzero(trial.pushed > 0)
    if near := problem.apart(trial.pushed > 0, -trial.pushed):
        touching = np.union1d(touching, near)
    drag = trial.dragged[touching]
    length = np.hypot(drag[:, 0], drag[:, 1])
    bound = _most(problem.friction[touching], trial.pushed[touching])
    slips = length > _AT_BOUND * bound
    return Pattern(
        touching=touching, slips=slips,
        ahead=np.where(slips[:, None], drag / np.maximum(length, 1e-300)[:, None], [1.0, 0.0]),
        mu=np.where(slips, problem.friction[touching], 0.0),
        share=np.where(slips, bound, 1.0) / np.where(slips, np.maximum(length, 1e-300), 1.0),
    )  # fmt: skip


def _newton_step(problem: Unilateral, scale: Floats, trial: _Trial, share: float) -> tuple[Floats, Floats]:
    """Return the forces (k, 3) and the place (m,) that solve, to a share, the equations linearised at a trial."""
    pattern = _pattern(problem, trial)
    touching, aside = pattern.touching, pattern.aside
    place = np.where(problem.by_force, trial.place, problem.given)
    carried, slope = problem.carried[touching].transpose(1, 0, 2), trial.slope[touching]
    # The trial's forces as far as the pattern allows them, and what they leave of the equations.
    unknowns = pattern.seen(trial.force[touching].T)
    start = np.zeros_like(trial.force)
    start[touching] = pattern.forces(unknowns).T
    feels = problem.by_force & (np.abs(pattern.pulled(carried)).max(axis=0) > 1e-9)
    free = np.flatnonzero(feels)
    system = LinearSystem(
        pattern=pattern, jump=start - trial.force, shift=(1.0 - pattern.share) / scale[touching], free=free,
        carried=carried[..., free], slope=slope[:, free], reach=problem.reach[free],
    )  # fmt: skip
    away = trial.displacement[touching].T
    away[:2] -= carried[:2] @ place + problem.offset[touching].T
    away[2] += trial.gap[touching] + slope @ (place - trial.place)
    left = system.seen(away)
    left[aside] += system.shift * unknowns[aside]
    balance = (problem.given - problem.total(start))[free]
    found = problem.solver.solve(system, -left, balance, share) if problem.solver and len(touching) > _FEW else None
    change, moved = found if found is not None else _eliminated(problem.between, system, -left, balance)
    force = np.zeros_like(trial.force)
    force[touching] = pattern.forces(unknowns + change).T
    place[free] += moved
    return force, place


def _changed(problem: Unilateral, force: Floats) -> tuple[Floats, float]:
    """Return the motions (k, 3) under forces (k, 3) or their change, mm, and what is lost of them, N."""
    found = problem.solver.moved(force) if problem.solver and len(force) > _FEW else None
    if found is None:
        return problem.moved(force), 0.0
    moved = np.ascontiguousarray(found.T)
    return moved, _LOST * float(np.linalg.norm(_scales(problem)[:, None] * moved))


def _known(problem: Unilateral, scale: Floats, trial: _Trial, lost: float) -> tuple[_Trial, float, float]:
    """Return a trial, its motions taken anew where what is lost of them counts; what it leaves; and what is lost."""
    left, size = trial.size(problem.reach), float(np.linalg.norm(trial.force))
    next_left = min(left, 10.0 * left**2 / size) if size else left  # near the solution steps are quadratic
    if lost <= max(_COUNTS * next_left, 0.1 * _GOAL * size):
        return trial, left, lost
    anew = _tried(problem, scale, trial.force, problem.moved(trial.force), trial.place)
    return anew, anew.size(problem.reach), 0.0


def _fitted(problem: Unilateral, force: Floats, displacement: Floats, place: Floats) -> Floats:
    """Return the place that fits forces (k, 3) best: patches that are pushed touch, those within their cones stick.

    Least squares, weighted with the normal forces and with what friction has left to carry.
    """
    gap, slope = problem.gap(place)
    push = np.where(np.isfinite(gap), np.maximum(force[:, 2], 0.0), 0.0)
    used = np.hypot(force[:, 0], force[:, 1]) / np.maximum(_most(problem.friction, push), 1e-300)
    holds = push * np.clip(1.0 - used, _HOLDS, 1.0)
    free, size = np.flatnonzero(problem.by_force), float(push.sum())
    if len(free) == 0 or size == 0.0:
        return place
    root = np.sqrt(np.column_stack([holds, holds, push]))[..., None]
    behind = np.empty_like(force)
    behind[:, :2] = displacement[:, :2] - problem.carried[:, :2] @ place - problem.offset
    behind[:, 2] = displacement[:, 2] + np.where(push > 0.0, gap, 0.0)
    moves = problem.carried[..., free].copy()
    moves[:, 2] = -slope[:, free]
    moves = (moves * root).reshape(-1, len(free)) / problem.reach[free]
    found = np.linalg.solve(
        moves.T @ moves + _STAYS * size * np.eye(len(free)), moves.T @ (behind * root[..., 0]).reshape(-1)
    )
    fitted = place.copy()
    fitted[free] += found / problem.reach[free]
    return fitted


def _eliminated(
    compliance: Floats | Between, system: LinearSystem, right: Floats, balance: Floats
) -> tuple[Floats, Floats]:
    """Solve a step's equations by elimination, compliances (the first rows) and balances both scaled to about one."""
    pattern, count, compliance = system.pattern, len(balance), between(compliance)
    rows, size = pattern.touching, pattern.size
    if system.jump.any():
        right = right - system.seen(compliance.moved(system.jump)[rows].T)
    part = compliance.part(rows)
    columns = pattern.pulled(part.transpose(3, 2, 1, 0))
    matrix = np.zeros((size + count, size + count))
    matrix[:size, :size] = pattern.seen(columns.transpose(1, 2, 0))
    turning = np.arange(size)[pattern.aside]
    matrix[turning, :size] *= pattern.share[:, None]
    matrix[turning, turning] += system.shift
    matrix[:size, size:] = system.motion
    matrix[size:, :size] = system.pull.T
    typical = float(np.mean(np.abs(np.diag(matrix)[:size])))
    scale = np.concatenate([np.full(size, typical**-0.5), np.full(count, typical**0.5)])
    try:
        found = np.linalg.solve(matrix * scale[:, None] * scale[None, :], np.concatenate([right, balance]) * scale)
    except np.linalg.LinAlgError as problem_found:
        raise _slides_off() from problem_found
    found *= scale
    return found[:size], found[size:]


def _slides_off() -> ContactError:
    return ContactError(
        "contact: every patch slips, so that nothing balances a force that is given along x or y, or a torque: push "
        "harder, ask for less, raise press.friction, or hold the component by motion"
    )


def solve_coulomb(problem: Unilateral, force: Floats, place: Floats, displacement: Floats | None = None) -> Equilibrium:
    """Find open, sticking and slipping patches, their forces and the probe's place.

    Parameters
    ----------
    problem
        The contact problem; patches of infinite friction stick while they are pushed.
    force
        (k, 3) first guess of the forces, in the patches' frames, N.
    place
        (m,) first guess of the place.
    displacement
        (k, 3) displacements of the patches under the guess's forces, mm, where they are known.

    Raises
    ------
    ContactError
        Nothing balances a given force; `NotSettled` when the steps do not settle.
    """
    k = len(force)
    scale = _scales(problem)
    reach, pushed = problem.reach, bool(problem.pushing.any())
    far = _FAR * float(reach.max())
    place = np.where(problem.by_force, place, problem.given)
    if displacement is None:
        displacement, lost = _changed(problem, force)
        place = _fitted(problem, force, displacement, place)
    else:
        lost = 0.1 * _GOAL * float(np.linalg.norm(force))  # known as well as they were asked for
    trial, left, lost = _known(problem, scale, _tried(problem, scale, force, displacement, place), lost)
    if trial.force.any() and left <= _GOAL * float(np.linalg.norm(trial.force)):
        return _settled(problem, trial, reach, 0)
    for step in range(1, _STEPS + 1):
        if not pushed and not np.any(trial.pushed > 0) and not trial.force.any():
            return _settled(problem, trial, reach, step)
        if np.any(trial.pushed > 0) or pushed:
            # What is left of all equations shrinks with its square: a linear system need be solved no better than that.
            relative = left / float(np.linalg.norm(trial.force) or left)
            share = max(0.1 * relative, 0.3 * _GOAL / relative)
            force, place = _newton_step(problem, scale, trial, share)
        else:
            force, place = np.zeros((k, 3)), trial.place  # nothing touches where the probe is held
        if not np.abs((place - trial.place) * reach).max() < far:
            raise _slides_off()
        change, loses = _changed(problem, force - trial.force)
        displacement, lost = trial.displacement + change, lost + loses
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
        before = left
        trial, left, lost = _known(problem, scale, best, lost)
        if left <= _GOAL * float(np.linalg.norm(trial.force)) or (
            left >= 0.5 * before and _residual(problem, trial, reach) <= 0.01 * TOLERANCE
        ):
            return _settled(problem, trial, reach, step)
    if _residual(problem, trial, reach) <= TOLERANCE:
        return _settled(problem, trial, reach, _STEPS)
    raise NotSettled(
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
        slipping=active & (dragged > _most(problem.friction, trial.force[:, 2])),
        residual=_residual(problem, trial, reach), steps=steps,
    )  # fmt: skip
