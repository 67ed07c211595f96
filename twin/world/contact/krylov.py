"""The linear system of one Newton step of contact with friction, solved by iteration.

A step's unknowns x (`twin.world.contact.pattern`) and the motion of the probe meet

    C x + M q = right,    B^T x = balance,

C being the compliance between unknowns, with (1 - c) / r added where a patch slips. Dense elimination of 1500 unknowns
takes fifty times a product with them. So x is sought by GMRES, preconditioned with rough inverses of the
normal and of the tangential compliance of the patches in contact, each by itself. What those leave out (normal forces
that move patches sideways, the turns of slipping patches) is small or local: a thousandth is left after four or five
products, whatever the number of patches. The outer Newton steps mend the rest, as they measure what is left of the
equations in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.world.contact.between import Between, between
from twin.world.contact.bordered import Bordered
from twin.world.contact.pattern import Pattern

LEFT = 1e-3
"""Share of the right-hand side that may be left at most."""


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """One Newton step's equations.

    Attributes
    ----------
    pattern
        The n patches in contact and their unknowns.
    shift
        (n,) (1 - c) / r of the equations across the drag, mm/N.
    motion, pull
        (size, m) M and B for the m motions that are held by force.
    reach
        (m,) sizes of those motions: 1 of a translation, an arm of a turn, mm.
    """

    pattern: Pattern
    shift: Floats
    motion: Floats
    pull: Floats
    reach: Floats


class Krylov:
    """The solver of a contact's linear systems.

    Parameters
    ----------
    compliance
        (k, 3, k, 3) compliance between patches, mm/N, or what stands for it.
    """

    def __init__(self, compliance: Floats | Between) -> None:
        self._operator = between(compliance).operator

    @property
    def saves(self) -> bool:
        """Whether `moved` costs much less than a product in double precision."""
        return self._operator.saves

    def moved(self, force: Floats) -> Floats:
        """Return the (3, k) displacements of all patches under forces (k, 3) on them, mm, to 1e-7 of the largest."""
        return self._operator.displaced(force)

    def solve(
        self, system: LinearSystem, right: Floats, balance: Floats, left: float = LEFT
    ) -> tuple[Floats, Floats] | None:
        """Return x (size,) and q (m,) with the share ``left`` of the right-hand sides left, None if out of reach.

        Parameters
        ----------
        system
            The equations.
        right, balance
            (size,) mm and (m,) N and N mm.
        left
            As far as the operator's precision allows it.
        """
        pattern, operator = system.pattern, self._operator
        if not operator.make_room(pattern.touching):
            return None
        aside, unit, precision = pattern.aside, operator.unit, operator.precision
        share = np.maximum(pattern.share, 1e-20).astype(precision)
        shift = (system.shift / unit).astype(precision)
        root = np.ones((pattern.size, 1), precision)
        root[aside, 0] = np.sqrt(share)

        def rows(x: Floats) -> Floats:
            out = pattern.seen(operator.product(pattern.forces(x)))
            out[aside] = share * out[aside] + shift * x[aside]
            return out

        def roughly(y: Floats) -> Floats:
            """Return (size, ...) unknowns for which `rows` are about y."""
            return np.asarray(pattern.seen(operator.roughly(pattern.unseen(y / root))) * root)

        bordered = Bordered(
            rows=rows, roughly=roughly, motion=(system.motion / system.reach).astype(precision),
            pull=(system.pull / system.reach).T.astype(precision),
        )  # fmt: skip
        found = bordered.solve(right / unit, balance / system.reach, min(LEFT, max(left, operator.finest)))
        return None if found is None else (found[0], found[1] * unit / system.reach)
