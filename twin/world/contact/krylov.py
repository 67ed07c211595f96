"""The linear system of one Newton step of contact with friction, solved by iteration.

Dense elimination of 1500 unknowns takes fifty times a product with them. So the unknowns of a step
(`twin.world.contact.linear`) are sought by GMRES, preconditioned with rough inverses of the
normal and of the tangential compliance of the patches in contact, each by itself. What those leave out (normal forces
that move patches sideways, the turns of slipping patches) is small or local: a thousandth is left after four or five
products, whatever the number of patches. The outer Newton steps mend the rest, as they measure what is left of the
equations in double precision.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from twin.arrays import Floats, Ints
from twin.world.contact.bordered import Bordered
from twin.world.contact.linear import LinearSystem

LEFT = 1e-3
"""Share of the right-hand side that may be left at most."""


class Operator(Protocol):
    """Products with a compliance over its ``unit``, mm/N, on the patches in contact, and rough inverses of them."""

    @property
    def unit(self) -> float:
        """The mean of the patches' own compliances, mm/N."""
        ...

    @property
    def precision(self) -> type[np.floating[Any]]:
        """Of the arrays."""
        ...

    @property
    def finest(self) -> float:
        """Share of a right-hand side that iteration can reach."""
        ...

    def make_room(self, touching: Ints) -> bool:
        """Take over the n patches in contact; return whether their compliance can be inverted."""
        ...

    def felt(self, force: Floats) -> Floats:
        """Return the (3, n) displacements of the patches in contact under forces (k, 3) on all, mm, to 1e-7."""
        ...

    def product(self, force: Floats) -> Floats:
        """Return the (3, n) displacements of the patches in contact under forces (3, n)."""
        ...

    def roughly(self, displacement: Floats) -> Floats:
        """Return (3, n, m) forces that cause about (3, n, m) displacements of the patches in contact."""
        ...


class Krylov:
    """The solver of a contact's linear systems.

    Parameters
    ----------
    operator
        Products with the compliance between patches.
    """

    def __init__(self, operator: Operator) -> None:
        self._operator = operator

    def moved(self, force: Floats) -> None:
        """See `twin.world.contact.linear.LinearSolver`: a product in double precision is as good as any."""

    def solve(
        self, system: LinearSystem, right: Floats, balance: Floats, left: float = LEFT
    ) -> tuple[Floats, Floats] | None:
        """See `twin.world.contact.linear.LinearSolver`."""
        pattern, operator = system.pattern, self._operator
        if not operator.make_room(pattern.touching):
            return None
        if system.jump.any():
            right = right - system.seen(operator.felt(system.jump))
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
