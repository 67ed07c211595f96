"""The linear system of one Newton step of contact with friction.

A step changes the forces by a jump, which is known, and by the unknowns x (`twin.world.contact.pattern`); these and the
motion q of the probe meet

    C (jump + x) + M q = right,    B^T x = balance,

C being the compliance between unknowns, with (1 - c) / r added where a patch slips. The jump takes off what the trial's
forces have that the pattern doesn't allow: all of a patch that left, what is beyond Coulomb's bound of one that slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from twin.arrays import Floats, Ints
from twin.world.contact.pattern import Pattern


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """One Newton step's equations.

    Attributes
    ----------
    pattern
        The n patches in contact and their unknowns.
    jump
        (k, 3) known change of the forces of all patches, N.
    shift
        (n,) (1 - c) / r of the equations across the drag, mm/N.
    free
        (m,) the motions that are held by force, among all those of the place.
    carried
        (3, n, m) how the probe's points at the patches in contact move with them.
    slope
        (n, m) how the gaps change with them.
    reach
        (m,) their sizes: 1 of a translation, an arm of a turn, mm.
    """

    pattern: Pattern
    jump: Floats
    shift: Floats
    free: Ints
    carried: Floats
    slope: Floats
    reach: Floats

    @cached_property
    def jumping(self) -> Ints:
        """The patches whose forces jump."""
        return np.flatnonzero(self.jump.any(axis=1))

    @cached_property
    def motion(self) -> Floats:
        """(size, m) M."""
        return self.seen(-self.carried, self.slope)

    @cached_property
    def pull(self) -> Floats:
        """(size, m) B: how an unknown enters the balance; a slipping patch's normal force brings its friction along."""
        return self.pattern.pulled(self.carried)

    def seen(self, displacement: Floats, opening: Floats | None = None) -> Floats:
        """Return (size, ...) what (3, n, ...) displacements add to the equations; ``opening`` for their normal part."""
        pattern = self.pattern
        out = pattern.seen(displacement)
        if opening is not None:
            out[: len(pattern.touching)] = opening
        out[pattern.aside] *= pattern.share.reshape(-1, *[1] * (out.ndim - 1))
        return out


class LinearSolver(Protocol):
    """What solves these systems for one compliance between k patches."""

    def moved(self, force: Floats) -> Floats | None:
        """Return the (3, k) displacements of all patches under forces (k, 3) on them, mm, to 1e-7 of the largest.

        None where that doesn't cost much less than a product in double precision.
        """
        ...

    def solve(self, system: LinearSystem, right: Floats, balance: Floats, left: float) -> tuple[Floats, Floats] | None:
        """Return x (size,) and q (m,) with about the share ``left`` of the equations left, None if out of reach.

        Parameters
        ----------
        system
            The equations.
        right, balance
            (size,) mm and (m,) N and N mm.
        left
            As far as the solver's precision allows it.
        """
        ...
