"""Newton's linear systems on a matrix of many patches: by iteration, until a kept inverse pays.

An inverse (`twin.world.contact.released`) answers a step with two products, but making one takes as long as a hundred
and more of them: a press that is solved once need not wait for it, a path of many steps has it after a few. So systems
are solved by iteration (`twin.world.contact.krylov`) until that took as many products as an inverse costs; whatever
comes, this takes at most twice the least time.

Iteration needs a rough inverse that costs nothing to make. Patches of equal cells lie nearly on a plane lattice, curved
as the body may be, and near by every body is a half-space: so it is the half-space's on that lattice, wave by wave
(`twin.world.contact.convolution`). On the finger it leaves a thousandth after six products, where inverses of the
matrix's own parts for each axis need as many.

Validity: as a guess for iteration only, which measures what is left on the matrix itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import blas

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.world.contact.convolution import Convolution, inverse_of, on_lattice, spectra_of
from twin.world.contact.krylov import Krylov
from twin.world.contact.linear import LinearSystem
from twin.world.contact.patches import Patches
from twin.world.contact.released import SLACK, Released
from twin.world.contact.singles import SinglesArray

MANY = 300
"""Patches in contact from which on making an inverse takes longer than a few solutions by iteration."""

_PAYS = 0.25
"""Products, for every patch in contact, that cost as much as making an inverse."""

_EQUAL = 1e-6


class NearLattice:
    """A rough inverse of the compliance between patches in equal cells: a half-space's, on a plane lattice.

    Parameters
    ----------
    place
        (k, 2) whole numbers of steps of each patch along the lattice's sides.
    shape
        How many places there are along them.
    inverse
        The convolution.
    """

    def __init__(self, place: Ints, shape: tuple[int, ...], inverse: Convolution) -> None:
        self._cell, self._shape, self._inverse = place[:, 0] * shape[1] + place[:, 1], shape, inverse

    def forces(self, rows: Ints, displacement: SinglesArray) -> SinglesArray:
        """Return the forces (3, n, m) under which some patches (n,) move by about (3, n, m)."""
        cells, count = self._cell[rows], displacement.shape[2]
        field: SinglesArray = np.zeros((count, 3, self._shape[0] * self._shape[1]), np.float32)
        field[..., cells] = displacement.transpose(2, 0, 1)
        made = self._inverse.product(field.reshape(count, 3, *self._shape)).reshape(field.shape)
        return made[..., cells].transpose(1, 2, 0)


def near_lattice(patches: Patches, poisson_ratio: float) -> NearLattice | None:
    """Return a rough inverse of the compliance over the mean of the patches' own; None where cells aren't equal."""
    cell = 2.0 * patches.cell_mm[0]
    place = on_lattice(patches.middle_mm, cell)
    if place is None or np.ptp(patches.cell_mm, axis=0).max() > _EQUAL * cell.min():
        return None
    shape, side = tuple((place.max(axis=0) + 1).tolist()), 2.0 * patches.half_mm.mean(axis=0)
    flat = np.stack(np.meshgrid(*(np.arange(n) for n in shape), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    one = Rectangles(
        centre_mm=np.zeros((1, 3)), frames=np.eye(3)[None], half_mm=side[None] / 2.0, force_n=np.zeros((1, 3))
    )
    kernel = halfspace.compliance(flat * [*side, 1.0], one, 1.0, poisson_ratio).reshape(*shape, 3, 3)
    inverse = inverse_of(spectra_of(kernel / np.mean(np.diag(kernel[0, 0]))))
    return None if inverse is None else NearLattice(place, shape, Convolution(inverse, np.float32))


class _OnMatrix:
    """A `twin.world.contact.krylov.Operator` on a matrix, which counts its products.

    What it multiplies by is the part of the patches in contact, in single precision: gathered once, one half of it,
    packed column by column, so that patches that come are appended. Those that left stay, with no force on them.
    """

    precision, finest = np.float32, 1e-5

    def __init__(self, compliance: Floats, near: NearLattice) -> None:
        k = len(compliance)
        self.unit, self.products = float(np.mean(compliance.reshape(3 * k, 3 * k).diagonal())), 0
        self._whole, self._near = compliance, near
        self._place: Ints = np.full(k, -1)
        self._rows = self._kept = np.zeros(0, int)
        self._packed: SinglesArray = np.zeros(0, np.float32)

    def make_room(self, touching: Ints) -> bool:
        """See `Operator`."""
        new = touching[self._place[touching] < 0]
        if len(self._kept) + len(new) > SLACK * len(touching):
            self._place[:], self._kept, self._packed, new = -1, touching[:0], self._packed[:0], touching
        if len(new):
            known, self._kept = len(self._kept), np.concatenate([self._kept, new])
            self._place[new] = np.arange(known, len(self._kept))
            columns: SinglesArray = np.empty(_packed(len(self._kept)) - _packed(known), np.float32)
            _pack(self._whole, self._kept, known, 1.0 / self.unit, columns)
            self._packed = np.concatenate([self._packed, columns]) if known else columns
        self._rows, self._at = touching, self._place[touching]
        return True

    def felt(self, force: Floats) -> Floats:
        """See `Operator`; forces on patches that aren't kept are few."""
        moved = self._moved(force[self._kept].astype(np.float32)) * self.unit
        beyond = np.flatnonzero(force.any(axis=1) & (self._place < 0))
        if len(beyond):
            moved += np.einsum("ja,jaib->bi", force[beyond], self._whole[beyond][:, :, self._rows])
        return moved

    def product(self, force: Floats) -> Floats:
        """See `Operator`."""
        self.products += 1
        spread: SinglesArray = np.zeros((len(self._kept), 3), np.float32)
        spread[self._at] = force.T
        return self._moved(spread)

    def _moved(self, force: SinglesArray) -> Floats:
        """Return the (3, n) displacements of the patches in contact over the unit under forces (kept, 3)."""
        moved = blas.sspmv(force.size, 1.0, self._packed, force.reshape(-1))
        return np.ascontiguousarray(moved.reshape(-1, 3)[self._at].T)

    def roughly(self, displacement: Floats) -> Floats:
        """See `Operator`."""
        single: Any = displacement.astype(np.float32, copy=False)
        return np.asarray(self._near.forces(self._rows, single))


def _packed(patches: int) -> int:
    """Return how many numbers one half of a matrix of three axes a patch has."""
    return 3 * patches * (3 * patches + 1) // 2


@njit(cache=True)
def _pack(whole: Floats, rows: Ints, known: int, share: float, out: SinglesArray) -> None:
    """Set ``out`` to the columns of some patches, down to the diagonal, but for those of the first ``known``."""
    at = 0
    for j in range(known, len(rows)):
        for b in range(3):
            column = whole[rows[j], b]
            for i in range(j):
                for a in range(3):
                    out[at + a] = share * column[rows[i], a]
                at += 3
            for a in range(b + 1):
                out[at] = share * column[rows[j], a]
                at += 1


class Iterated:
    """A `twin.world.contact.linear.LinearSolver` that iterates on a matrix until a kept inverse pays.

    Parameters
    ----------
    compliance
        (k, 3, k, 3) mm/N.
    carried
        (k, 3, m) how the probes' points at the patches move with each of their motions.
    near
        A rough inverse of the compliance over its unit.
    """

    def __init__(self, compliance: Floats, carried: Floats, near: NearLattice) -> None:
        self._inverting, self._operator = Released(compliance, carried), _OnMatrix(compliance, near)
        self._iterating = Krylov(self._operator)

    def moved(self, force: Floats) -> Floats | None:
        """See `LinearSolver`; a whole copy in single precision is made together with an inverse only."""
        return self._inverting.moved(force) if self._inverting.inverts else None

    def solve(self, system: LinearSystem, right: Floats, balance: Floats, left: float) -> tuple[Floats, Floats] | None:
        """See `LinearSolver`."""
        touching = system.pattern.touching
        pays = len(touching) <= MANY or self._operator.products >= _PAYS * len(touching)
        if not pays and not self._inverting.knows(touching, system.jumping):
            found = self._iterating.solve(system, right, balance, left)
            if found is not None:
                return found
        self._operator.products = 0
        return self._inverting.solve(system, right, balance, left)
