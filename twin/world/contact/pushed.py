"""Frictionless contact on a plane, all in one compiled loop: the patches in contact, their forces, the probes' depths.

Probes that come straight onto a flat surface change every gap by as much as they come. What is left of
`twin.world.contact.unilateral` is then a symmetric linear complementarity problem with one depth a probe,

    N f + gap = depth of its probe, f >= 0    in contact,
    N f + gap >= depth of its probe, f = 0    elsewhere,    sum f = force, or the depth is given,

and the set in contact is sought as there. For a set, conjugate gradients run among the forces of the given sum: what
they look for is moved by a mean, which is the depth (constraint preconditioning; I. A. Polonsky and L. M. Keer, Wear
231 (1999) 206, do so for even cells). Why not elimination: a product with the matrix of a hundred patches takes 3 us,
and a set that is not the last one is told from the next by a few of them.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.parts.probe import Cone
from twin.world.contact.gap import MOTIONS, Z
from twin.world.contact.inner import inner
from twin.world.contact.together import Contacts, Control
from twin.world.contact.unilateral import TOLERANCE, Equilibrium

MOST = 800
"""Equal patches up to which a matrix is faster than transforms (`twin.world.contact.lattice`)."""

_END_OF_CONE = 1.0 - 2.0 / math.pi
"""Overlap at rest where contact ends, over the indentation (Sneddon): under a sphere it is 1 / 2 (Hertz)."""

_SETS, _PRODUCTS = 60, 400
_LEFT = (1e-2, 1e-5, 1e-13)
"""Largest gap left in contact over the largest displacement, until a set follows itself: three times in turn."""


def pushed(contacts: Contacts, control: Control, place: Floats, touch_z: Floats) -> Equilibrium | None:
    """Return the equilibrium of probes that come straight onto a plane and are held in all else; None of any others.

    Parameters
    ----------
    contacts, control
        The probes, their patches and what holds them.
    place
        (6 p,) a guess, with what is held.
    touch_z
        (p,) z of the probes at first touch, mm.
    """
    k, half, z = len(contacts.patches), contacts.patches.half_mm, slice(Z, None, MOTIONS)
    if np.count_nonzero(control.by_force) > np.count_nonzero(control.by_force[z]) or not all(contacts.upright):
        return None
    if (k > MOST and (half == half[0]).all()) or contacts.normal is None:
        return None
    normal, owner, by_force = contacts.normal, contacts.owner, control.by_force[z]
    found = np.where(control.by_force, place, control.given)
    high = found.copy()
    high[z] = 0.0
    gap = contacts.gap(high)[0]
    reach = found[z] - ends_at(contacts) * (found[z] - touch_z)
    steps, residual, active, force, moved, depth = _equilibrium(normal, gap, owner, by_force, control.given[z], reach)
    if not residual <= TOLERANCE:
        return None
    found[z] = depth
    return Equilibrium(
        force_n=force, displacement_mm=moved, place=found, active=active, total=_total(contacts, found, force),
        slipping=np.zeros(k, bool), residual=residual, steps=steps,
    )  # fmt: skip


@njit(cache=True)
def _equilibrium(
    normal: Floats, gap: Floats, owner: Ints, by_force: Bools, given: Floats, reach: Floats
) -> tuple[int, float, Bools, Floats, Floats, Floats]:
    """Return how many sets were tried, what is left, the set, forces and motions (k, 3) and the probes' depths (p,).

    Parameters as of `settle`; from (p,) how far each probe reaches where it touches, at first.
    """
    k = len(gap)
    active, push = _overlapping(gap, owner, reach)
    depth, sunk = np.empty(len(given)), np.empty(k)
    steps = settle(normal, gap, owner, by_force, given, active, push, depth, sunk)
    left = _residual(gap, depth, owner, by_force, given, active, push, sunk) if steps else math.inf
    force, moved = np.zeros((k, 3)), np.full((k, 3), np.nan)
    force[:, 2], moved[:, 2] = push, sunk
    return steps, left, active, force, moved, depth


def ends_at(contacts: Contacts) -> Floats:
    """Return (p,) about how far each probe overlaps the body at rest where its contact ends, over the indentation."""
    return np.array([_END_OF_CONE if isinstance(one.probe, Cone) else 0.5 for one in contacts.settings])


def _total(contacts: Contacts, place: Floats, force: Floats) -> Floats:
    """Return (6 p,) what normal forces (k, 3) add up to, about the probes' axes."""
    total = np.zeros(len(place))
    for (setting, rows, motions), grid in zip(contacts.rows, contacts.grids, strict=True):
        first = setting.first
        _add_up(grid.centre_mm, force[rows, 2], first.axis_mm, first.axes, place[motions], total[motions])
    return total


@njit(cache=True)
def _add_up(centre: Floats, push: Floats, axis_mm: Floats, axes: Floats, place: Floats, total: Floats) -> None:
    whole, x, y, z = 0.0, 0.0, 0.0, 0.0
    for i in range(len(push)):
        whole += push[i]
        x += push[i] * (centre[i, 0] - axis_mm[0])
        y += push[i] * (centre[i, 1] - axis_mm[1])
        z += push[i] * (centre[i, 2] - axis_mm[2])
    total[2] = whole
    total[3] = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - whole * place[1]
    total[4] = whole * place[0] - (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z)


@njit(cache=True)
def _overlapping(gap: Floats, owner: Ints, reach: Floats) -> tuple[Bools, Floats]:
    """Return (k,) which gaps are smaller than how far their probe (p,) reaches, and forces like a sphere's there."""
    active, force = np.zeros(len(gap), np.bool_), np.zeros(len(gap))
    for i in range(len(gap)):
        over = reach[owner[i]] - gap[i]
        if over > 0.0:
            active[i], force[i] = True, math.sqrt(over)
    return active, force


@njit(cache=True)
def _residual(
    gap: Floats, depth: Floats, owner: Ints, by_force: Bools, given: Floats, active: Bools, force: Floats,
    sunk: Floats,
) -> float:  # fmt: skip
    """Return the largest relative error of gap, overlap, pull and balance; inf where it is not finite."""
    deep, push, load, off, pull = 1e-300, 1e-300, 1e-300, 0.0, 0.0
    total = np.zeros(len(depth))
    for i in range(len(gap)):
        opening = gap[i] + sunk[i] - depth[owner[i]]
        met = math.isfinite(gap[i]) if active[i] else gap[i] > -math.inf
        if not (met and math.isfinite(sunk[i] + force[i] + depth[owner[i]])):
            return math.inf  # max() passes NaN over
        deep, push = max(deep, abs(sunk[i])), max(push, force[i])
        off = max(off, abs(opening) if active[i] else -opening)
        pull = max(pull, -force[i])
        total[owner[i]] += force[i]
    unbalanced = 0.0
    for q in range(len(depth)):
        load = max(load, abs(total[q]))
        unbalanced = max(unbalanced, abs(total[q] - given[q]) if by_force[q] else 0.0)
    return max(off / deep, pull / push, unbalanced / load)


@njit(cache=True, fastmath={"reassoc", "contract"})
def settle(
    normal: Floats, gap: Floats, owner: Ints, by_force: Bools, given: Floats, active: Bools, force: Floats,
    depth: Floats, sunk: Floats,
) -> int:  # fmt: skip
    """Set ``active``, ``force``, ``depth`` and ``sunk`` to the equilibrium's.

    Parameters
    ----------
    normal
        (k, k) symmetric normal displacement of each patch per unit normal force on each, mm/N.
    gap
        (k,) gaps at first touch, mm; inf where a probe can't be met.
    owner
        (k,) the probe above each patch.
    by_force, given
        (p,) whether a probe is held by its force, and the force, N, more than 0, or the depth, mm.
    active, force
        (k,) guesses of the set in contact and of the normal forces there, N, of any size.
    depth, sunk
        (p,) mm and (k,) mm, set only.

    Returns
    -------
    How many sets were tried; 0 where they didn't settle.
    """
    k, stage = len(gap), 0
    for tried in range(1, _SETS + 1):
        _touch_somewhere(gap, owner, by_force, active)
        rows = np.flatnonzero(active)
        n, share = len(rows), _LEFT[stage]
        part = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                part[i, j] = normal[rows[i], rows[j]]
        f, moved = force[rows], np.empty(n)
        if not _solve(part, gap[rows], owner[rows], by_force, given, f, depth, moved, share):
            return 0
        force[:] = 0.0
        largest = 1e-12
        for i in range(n):
            force[rows[i]] = f[i]
            sunk[rows[i]] = moved[i]
            largest = max(largest, abs(moved[i]))
        changed = False
        for i in range(k):
            if active[i]:
                follows = not force[i] * normal[i, i] < -share * largest
            else:
                sunk[i] = inner(normal[i], force)
                follows = sunk[i] + gap[i] - depth[owner[i]] < -share * largest
            changed = changed or follows != active[i]
            active[i] = follows
        if changed:
            continue
        stage += 1
        if stage == len(_LEFT):
            for i in range(n):
                sunk[rows[i]] = inner(normal[rows[i]], force)
            return int(tried)
    return 0


@njit(cache=True)
def _touch_somewhere(gap: Floats, owner: Ints, by_force: Bools, active: Bools) -> None:
    """Let every probe that is pushed touch the nearest patch, if it touches none; leave out what can't be met."""
    touched, nearest = np.zeros(len(by_force), np.bool_), np.full(len(by_force), -1)
    for i in range(len(gap)):
        active[i] = active[i] and math.isfinite(gap[i])
        p = owner[i]
        touched[p] = touched[p] or active[i]
        if nearest[p] < 0 or gap[i] < gap[nearest[p]]:
            nearest[p] = i
    for p in range(len(by_force)):
        if by_force[p] and not touched[p]:
            active[nearest[p]] = True


@njit(cache=True, fastmath={"reassoc", "contract"})
def _solve(
    part: Floats, gap: Floats, owner: Ints, by_force: Bools, given: Floats, f: Floats, depth: Floats,
    moved: Floats, share: float,
) -> bool:  # fmt: skip
    """Set forces ``f`` (n,), depths (p,) and displacements (n,) of a set in contact, from a guess of f; if found."""
    n, p = len(f), len(depth)
    weight = np.zeros(p)
    along, right, made, kept = np.zeros(n), np.empty(n), np.empty(n), np.empty(p)
    for q in range(p):
        depth[q] = given[q]
        total = 0.0
        for i in range(n):
            if owner[i] == q:
                weight[q] += 1.0 / part[i, i]
                f[i] = max(f[i], 0.0)
                total += f[i]
        if by_force[q]:
            for i in range(n):
                if owner[i] == q:
                    f[i] = f[i] * given[q] / total if total > 0.0 else given[q] / part[i, i] / weight[q]
    for i in range(n):
        right[i] = -gap[i] - inner(part[i], f)
    before = 0.0
    for step in range(_PRODUCTS):
        kept[:] = 0.0
        for i in range(n):
            kept[owner[i]] -= right[i] / part[i, i]
        for q in range(p):
            if by_force[q]:
                depth[q] = kept[q] / weight[q] if weight[q] > 0.0 else 0.0
        size, left, largest = 0.0, 0.0, 1e-12
        for i in range(n):
            here = right[i] + depth[owner[i]]
            size += here * here / part[i, i]
            left = max(left, abs(here))
            moved[i] = -gap[i] - right[i]
            largest = max(largest, abs(moved[i]))
        if not math.isfinite(size):
            return False
        if left <= share * largest:
            return True
        for i in range(n):
            here = (right[i] + depth[owner[i]]) / part[i, i]
            along[i] = here + (size / before * along[i] if step else 0.0)
        before = size
        for i in range(n):
            made[i] = inner(part[i], along)
        far = size / inner(along, made)
        for i in range(n):
            f[i] += far * along[i]
            right[i] -= far * made[i]
    return False
