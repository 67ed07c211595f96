"""The patches of a press with friction: one grid for its whole path, what they remember, and their gaps.

Why gaps of two kinds: a patch that has touched moves with the probe in all three directions, from where it touched.
For one that has not, the exact shape of the probe counts as it comes down, while sideways the surface near a probe goes
along with it and the gap changes only by the slope of the surface. What the probe slides as a whole is taken off: a
sphere that slid meets the body elsewhere.

Validity: one slide for all patches of a probe, taken as the least slip of those in contact; a flat face has no patches
to slide to (`twin.world.contact.friction`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats
from twin.world.contact.between import Between, Dense
from twin.world.contact.gap import MOTIONS, Z
from twin.world.contact.lattice import Lattice
from twin.world.contact.linear import LinearSolver
from twin.world.contact.patches import Patches
from twin.world.contact.together import Contacts, Control, every
from twin.world.contact.unilateral import Unilateral

_FEW = 130
"""Patches from which on products with friction are faster by transforms than with a matrix."""


@dataclass(frozen=True, kw_only=True)
class Trend:
    """What the last step of a path changed: forces (k, 3), place (6 p,), and what was given (6 p,)."""

    force_n: Floats
    place: Floats
    given: Floats


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Where each patch touched, or slipped to, and the state that the probes and the body are in.

    Attributes
    ----------
    touched, slipping
        (k,) patches in contact, and which of them slipped last.
    closed_mm
        (k,) gap of those at place 0, had they always moved with the probe.
    offset_mm
        (k, 2) tangential displacement of those at place 0, likewise.
    place
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
    """

    touched: Bools
    slipping: Bools
    closed_mm: Floats
    offset_mm: Floats
    place: Floats
    total: Floats
    displacement_mm: Floats
    force_n: Floats
    slid_mm: Floats
    lifted: Bools
    dissipated_nmm: float = 0.0
    trend: Trend | None = None


@dataclass(frozen=True, eq=False)
class FrictionGrid:
    """Patches, and what of them stays the same along the path; ``friction`` (p,) is the coefficient of each probe."""

    contacts: Contacts
    friction: Floats

    @property
    def patches(self) -> Patches:
        """The patches of all probes."""
        return self.contacts.patches

    @cached_property
    def between(self) -> Between:
        """The compliance between the patches; few, and those that stick, are solved faster with a matrix."""
        found = self.contacts.between
        if isinstance(found, Lattice) and (len(found) < _FEW or self.sticks):
            return Dense(found.part(np.arange(len(found))))
        return found

    @cached_property
    def solver(self) -> LinearSolver:
        """The solver of linear systems on these patches, with what it keeps along the path."""
        return self.between.solver(self.carried)

    @property
    def sticks(self) -> bool:
        """Whether every probe with friction sticks whatever the force."""
        return bool(np.isinf(self.friction[self.friction > 0.0]).all())

    @cached_property
    def carried(self) -> Floats:
        """(k, 3, 6 p) motion of the probes' points at the patches per unit of the place, about first touch."""
        return self.contacts.carried(np.zeros(MOTIONS * len(self.friction)))

    @cached_property
    def along_z(self) -> Bools:
        """(6 p,) the components of the place along the probes' directions of approach."""
        return every(Z, MOTIONS * len(self.friction))

    def untouched(self, memory: Memory) -> Bools:
        """Return (k,) which patches belong to a probe that touches nothing."""
        none = [not memory.touched[rows].any() for _, rows, _ in self.contacts.rows]
        return np.asarray(np.array(none)[self.contacts.owner])

    def sideways(self, place: Floats) -> Floats:
        """Return a place without its motions along the directions of approach."""
        return np.where(self.along_z, 0.0, place)

    def _slid_gap(self, slid_mm: Floats, along_z: Floats) -> tuple[Floats, Floats]:
        """Return gaps and slopes of probes that were lowered, and slid but not carried the surface along."""
        gap, slope = np.zeros(len(self.patches)), np.zeros((len(self.patches), len(self.along_z)))
        for number, (setting, rows, motions) in enumerate(self.contacts.rows):
            grid, first = self.contacts.grids[number], setting.first
            lowered = np.zeros(MOTIONS)
            lowered[Z] = along_z[number]
            if setting.face is None:
                lowered[:Z] = slid_mm[number]
            gap[rows], slope[rows, motions] = self.contacts.gap_under(number, lowered)
            gap[rows] += grid.frames[:, 2] @ (slid_mm[number] @ first.axes[:Z])
        return gap, slope

    def gap(self, memory: Memory, place: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps and (k, 6 p) slopes at a place."""
        gap, slope = self._slid_gap(memory.slid_mm, place[self.along_z])
        normal = self.carried[:, 2]
        slope = np.where(self.along_z, slope, -normal)
        gap = gap - normal @ self.sideways(place)
        stuck = memory.touched
        gap[stuck] = memory.closed_mm[stuck] + self.moved_gap(memory.slid_mm)[stuck] - normal[stuck] @ place
        slope[stuck] = -normal[stuck]
        gap[memory.lifted[self.contacts.owner]] = np.inf
        return gap, slope

    def moved_gap(self, slid_mm: Floats) -> Floats:
        """Return (k,) by how much a slide changes the gaps; inf where the probe slid away."""
        if not slid_mm.any():
            return np.zeros(len(self.patches))
        still = np.zeros(len(self.friction))
        before = self._slid_gap(np.zeros_like(slid_mm), still)[0]
        after = self._slid_gap(slid_mm, still)[0]
        return np.where(np.isfinite(before), after - np.where(np.isfinite(before), before, 0.0), 0.0)

    def offset(self, memory: Memory) -> Floats:
        """Return (k, 2) from where each patch's slip counts.

        After a lift the probe touches anew where it now is: its motion sideways counts from there.
        """
        anew = -np.einsum("kad,d->ka", self.carried[:, :2], self.sideways(memory.place))
        return np.where(self.untouched(memory)[:, None], anew, memory.offset_mm)

    def problem(self, memory: Memory, control: Control, held: Bools | None = None) -> Unilateral:
        """Return a part's equations; patches in ``held`` feel friction although they had not touched before it."""
        rubs = memory.touched | self.untouched(memory) | (False if held is None else held)
        return Unilateral(
            compliance=self.between, gap=lambda q: self.gap(memory, q), carried=self.carried,
            by_force=control.by_force, given=control.given, pushing=control.pushing,
            friction=np.where(rubs, self.friction[self.contacts.owner], 0.0), offset=self.offset(memory),
            solver=self.solver,
        )  # fmt: skip


def at_first_touch(grid: FrictionGrid) -> Memory:
    """Return the memory of probes that just touch: patches under a flat face on a flat body stick at once.

    A single patch in the middle under a ball doesn't count: alone it would have to hold a probe on a slope.
    """
    k, p = len(grid.patches), len(grid.friction)
    nothing = Memory(
        touched=np.zeros(k, bool), slipping=np.zeros(k, bool), closed_mm=np.zeros(k), offset_mm=np.zeros((k, 2)),
        place=np.zeros(MOTIONS * p), total=np.zeros(MOTIONS * p), displacement_mm=np.zeros((k, 3)),
        force_n=np.zeros((k, 3)),
        slid_mm=np.zeros((p, 2)), lifted=np.zeros(p, bool),
    )  # fmt: skip
    gap, _ = grid.gap(nothing, nothing.place)
    touched = gap <= 1e-9
    for _, rows, _ in grid.contacts.rows:
        touched[rows] &= np.count_nonzero(touched[rows]) > 1
    return replace(nothing, touched=touched, closed_mm=np.where(touched, gap, 0.0))


def let_go(grid: FrictionGrid, memory: Memory, lifted: Bools) -> Memory:
    """Return the memory of probes (p,) that have been lifted off: they touch anew where they then are."""
    rows, motions = lifted[grid.contacts.owner], np.repeat(lifted, MOTIONS)
    here = memory.place.reshape(-1, MOTIONS)[:, :Z]
    return replace(
        memory, touched=memory.touched & ~rows, slipping=memory.slipping & ~rows,
        total=np.where(motions, 0.0, memory.total),
        displacement_mm=np.where(rows[:, None], 0.0, memory.displacement_mm),
        force_n=np.where(rows[:, None], 0.0, memory.force_n), slid_mm=np.where(lifted[:, None], here, memory.slid_mm),
    )  # fmt: skip
