"""Newton's linear systems on a matrix, by one kept inverse from which some patches are released.

The inverse A of the compliance of patches that were in contact answers with forces to displacements u: f = A u. All
that a step's pattern changes is that some displacements aren't given. A slipping patch moves freely along its drag, so
that its force there is mu times its normal one, and across it by a law of its own; a patch that left moves freely, and
has no force. With E the released directions and d the unknown motions along them,

    f = A (u + E d - M q),

the released patches' own laws and the balance of the probe are a small system for d and q. It is solved exactly, so
that a step needs two products with A, however the patches slip. Iteration (`twin.world.contact.krylov`) needs ten and
more, each with a dozen calls around it: on a matrix of 460 patches twice the time.

The inverse serves all sets that follow until a patch comes that it doesn't know. It then takes over those that it knew,
as patches that come and go in turns would have it made each time.

Validity: single precision; 1e-4 of a step is left, which the next step mends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.world.contact.bordered import SINGULAR
from twin.world.contact.linear import LinearSystem
from twin.world.contact.singles import SinglesArray, full_inverse, symmetric_product

SLACK = 1.3
"""Over how many times as many patches as are in contact an inverse is used before a smaller one is made."""


@dataclass(frozen=True, kw_only=True)
class _Directions:
    """Directions in which patches are released.

    ``slipping`` is how many patches slip, whose directions come first. ``at`` (r,) are the patches' places in the
    inverse, ``along`` (r, 3) the directions; the law of each is that ``felt`` (r, 3) times the force, and ``own`` (r,)
    times the motion, are ``right`` (r,).
    """

    slipping: int
    at: Ints
    along: SinglesArray
    felt: SinglesArray
    own: SinglesArray
    right: SinglesArray


class Released:
    """A `twin.world.contact.linear.LinearSolver` for a compliance (k, 3, k, 3), mm/N, under probes ``carried`` so."""

    def __init__(self, compliance: Floats, carried: Floats) -> None:
        k = len(compliance)
        self._unit = float(np.mean(compliance.reshape(3 * k, 3 * k).diagonal()))
        self._compliance, self._carried = compliance, carried
        self._kept: Ints = np.zeros(0, int)
        self._place: Ints = np.full(k, -1)

    @property
    def inverts(self) -> bool:
        """Whether an inverse is at hand."""
        return len(self._kept) > 0

    @cached_property
    def _whole(self) -> SinglesArray:
        whole: SinglesArray = np.empty(self._compliance.shape, np.float32)
        np.divide(self._compliance, self._unit, out=whole, casting="same_kind")
        return whole

    def moved(self, force: Floats) -> Floats:
        """See `LinearSolver`."""
        size = 3 * len(force)
        pushed: SinglesArray = force.astype(np.float32).reshape(size)
        moved = symmetric_product(self._whole.reshape(size, size).T, pushed)
        return np.asarray(moved.reshape(-1, 3).T.astype(float) * self._unit)

    def solve(self, system: LinearSystem, right: Floats, balance: Floats, left: float) -> tuple[Floats, Floats] | None:
        """See `LinearSolver`; ``left`` is as good as it gets."""
        pattern = system.pattern
        if not self._make_room(pattern.touching, system.jumping):
            return None
        at, size, count = self._place[pattern.touching], 3 * len(self._kept), len(system.free)
        jump = system.jump[self._kept].T
        right = right / self._unit
        released = self._released(system, at, jump, right)
        given: SinglesArray = np.zeros((3, len(self._kept)), np.float32)
        given[:, at] = _given(system, right)
        pushed = symmetric_product(self._inverse, given.reshape(size))
        carried, held = self._held(system, at)
        # Forces on all patches under what is given, and under each motion; and those that hold the probe's points.
        columns = np.column_stack([pushed, held, self._stiff[:, system.free]]).reshape(3, len(self._kept), -1)
        sides = columns[:, released.at].transpose(1, 0, 2)
        border = np.einsum("ra,rac->rc", released.felt, sides[..., : 1 + count])
        border[:, 0] = released.right - border[:, 0]
        answer = self._answer(released, border)
        if answer is None:
            return None
        pulled = np.einsum("ra,rac->rc", released.along, sides[..., 1 + count :]).astype(float)
        points = self._points[:, system.free].astype(float)
        felt = points.T @ held - pulled.T @ answer[:, 1:]
        if count and not np.linalg.cond(felt / system.reach / system.reach[:, None]) < SINGULAR:
            return None
        missing = balance + points.T @ jump.reshape(size) - points.T @ pushed - pulled.T @ answer[:, 0]
        motion = np.linalg.solve(felt, missing)
        given += (carried @ motion).reshape(given.shape)
        _add(given, released.at, released.along, answer[:, 0] - answer[:, 1:] @ motion)
        force = symmetric_product(self._inverse, given.reshape(size)).reshape(3, -1)[:, at]
        return pattern.seen(force.astype(float)), motion * self._unit

    def _part(self, rows: Ints) -> SinglesArray:
        """Return (3 n, 3 n) the compliance over its unit between some patches, axis by axis."""
        part: SinglesArray = np.empty((3 * len(rows), 3 * len(rows)), np.float32)
        _gather(self._whole, rows, part)
        return part

    def knows(self, touching: Ints, jumping: Ints) -> bool:
        """Return whether the inverse serves patches in contact and those that jump."""
        known = (self._place[touching] >= 0).all() and (self._place[jumping] >= 0).all()
        return bool(known and len(self._kept) <= SLACK * len(touching))

    def _make_room(self, touching: Ints, jumping: Ints) -> bool:
        """Take over the patches in contact and those that jump; return whether their compliance can be inverted."""
        if not self.knows(touching, jumping):
            needed = np.union1d(touching, jumping)
            both = np.union1d(needed, self._kept)
            kept = both if len(both) <= SLACK * len(touching) else needed
            inverse = full_inverse(self._part(kept))
            self._place[:], self._kept = -1, np.zeros(0, int)
            if inverse is None:
                return False
            self._inverse, self._kept = inverse.T, kept
            self._place[kept] = np.arange(len(kept))
            self._points = self._carried[kept].transpose(1, 0, 2).reshape(3 * len(kept), -1).astype(np.float32)
            self._stiff = self._inverse @ self._points
        return True

    def _released(self, system: LinearSystem, at: Ints, jump: Floats, right: Floats) -> _Directions:
        """Return what is released: slipping patches along their drags and across them, those that left altogether."""
        pattern = system.pattern
        slipping = np.flatnonzero(pattern.slips)
        here, ahead, flat = at[slipping], pattern.ahead[slipping], np.zeros(len(slipping))
        aside = np.column_stack([-ahead[:, 1], ahead[:, 0], flat])
        away = np.ones(len(self._kept), bool)
        away[at] = False
        gone = np.flatnonzero(away)
        axes = np.tile(np.eye(3), (len(gone), 1))
        along = np.concatenate([np.column_stack([ahead, flat]), aside, axes])
        shift = system.shift[slipping, None] / self._unit
        felt = [np.column_stack([ahead, -pattern.mu[slipping]]), aside * shift, axes]
        too_much = np.einsum("ra,ar->r", ahead, jump[:2, here])
        own = [flat, pattern.share[slipping], np.zeros(len(axes))]
        law = [too_much, right[pattern.aside][slipping], jump[:, gone].T.reshape(-1)]
        return _Directions(
            slipping=len(slipping), at=np.concatenate([here, here, np.repeat(gone, 3)]), along=along.astype(np.float32),
            felt=np.concatenate(felt).astype(np.float32), own=np.concatenate(own).astype(np.float32),
            right=np.concatenate(law).astype(np.float32),
        )  # fmt: skip

    def _held(self, system: LinearSystem, at: Ints) -> tuple[SinglesArray, SinglesArray]:
        """Return (size, m) displacements -M of the patches under unit motions, and the forces that these answer to.

        Gaps change by what carries a patch that touched before, and otherwise where the probe's shape tells them.
        """
        points, stiff = self._points[:, system.free], self._stiff[:, system.free]
        beside: SinglesArray = (system.slope + system.carried[2]).astype(np.float32)
        for motion in np.flatnonzero(beside.any(axis=0)):
            more: SinglesArray = np.zeros((3, len(self._kept)), np.float32)
            more[2, at] = beside[:, motion]
            points[:, motion] -= more.reshape(-1)
            stiff[:, motion] -= symmetric_product(self._inverse, more.reshape(-1))
        return points, stiff

    def _answer(self, released: _Directions, border: SinglesArray) -> Floats | None:
        """Return the motions (r, c) along the released directions that meet laws (r, c); None if singular."""
        count = len(border)
        if count == 0:
            return np.zeros((0, border.shape[1]))
        laws: SinglesArray = np.empty((count, count), np.float32)
        _laws(self._inverse.T, released.slipping, released.at, released.along, released.felt, laws)
        laws[np.diag_indices(count)] += released.own
        factor, swaps, wrong = lapack.sgetrf(laws.T, overwrite_a=1)
        if wrong:
            return None
        found: Floats = lapack.sgetrs(factor, swaps, border, trans=1)[0].astype(float)
        return found if np.isfinite(found).all() else None


def _given(system: LinearSystem, right: Floats) -> Floats:
    """Return (3, n) the displacements that are given; those across a slipping patch's drag aren't."""
    pattern = system.pattern
    known = right.copy()
    known[pattern.aside] = np.where(pattern.slips, 0.0, known[pattern.aside])
    return pattern.unseen(known)


@njit(cache=True)
def _gather(whole: SinglesArray, rows: Ints, out: SinglesArray) -> None:
    """Set ``out`` (3 n, 3 n) to the compliance between some of the patches of (k, 3, k, 3), axis by axis."""
    n = len(rows)
    for i in range(n):
        for a in range(3):
            line = whole[rows[i], a]
            for b in range(3):
                for j in range(n):
                    out[a * n + i, b * n + j] = line[rows[j], b]


@njit(cache=True)
def _add(displacement: SinglesArray, at: Ints, along: SinglesArray, motion: Floats) -> None:
    for i in range(len(at)):
        for a in range(3):
            displacement[a, at[i]] += along[i, a] * motion[i]


@njit(cache=True, fastmath=True)
def _laws(
    stiffness: SinglesArray, slipping: int, at: Ints, along: SinglesArray, felt: SinglesArray, out: SinglesArray
) -> None:
    """Set ``out`` (r, r) to what each direction's law feels of a unit motion along every other.

    The directions along drags come first, then as many across them, at the same patches: rows of both are read once.
    """
    n, r, pairs = stiffness.shape[0] // 3, len(at), 2 * slipping
    row, other = np.empty(3 * n, np.float32), np.empty(3 * n, np.float32)
    end = 3 * n if r > pairs else 2 * n  # slipping patches don't move along their normals
    for i in range(slipping):
        _felt(stiffness, at[i], felt[i], row[:end])
        _felt(stiffness, at[i], felt[slipping + i], other[:end])
        for j in range(pairs):
            x, y = along[j, 0], along[j, 1]
            out[i, j] = x * row[at[j]] + y * row[n + at[j]]
            out[slipping + i, j] = x * other[at[j]] + y * other[n + at[j]]
        for j in range(pairs, r):
            x, y, z = along[j]
            out[i, j] = x * row[at[j]] + y * row[n + at[j]] + z * row[2 * n + at[j]]
            out[slipping + i, j] = x * other[at[j]] + y * other[n + at[j]] + z * other[2 * n + at[j]]
    for i in range(pairs, r):
        _felt(stiffness, at[i], felt[i], row)
        for j in range(r):
            out[i, j] = along[j, 0] * row[at[j]] + along[j, 1] * row[n + at[j]] + along[j, 2] * row[2 * n + at[j]]


@njit(cache=True, fastmath=True)
def _felt(stiffness: SinglesArray, at: int, felt: SinglesArray, out: SinglesArray) -> None:
    """Set ``out`` to a combination of the rows of one patch's three axes."""
    n = stiffness.shape[0] // 3
    x, y, z = stiffness[at], stiffness[n + at], stiffness[2 * n + at]
    for c in range(len(out)):
        out[c] = felt[0] * x[c] + felt[1] * y[c] + felt[2] * z[c]
