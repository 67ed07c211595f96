"""The tables of one body's rest at one Poisson ratio: which there are, which loads they answer, how one is come by.

Of the roles in `twin.world.elasticity.tabulate` a compliance needs two: the table that answers, of the truth or of the
sensor's own mesh, and the check, whose difference from it tells the error.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.progress import Progress
from twin.world.elasticity.known import Known
from twin.world.elasticity.solve import Solver
from twin.world.elasticity.table import NU_RANGE, SIZES, Table, TableAtNu
from twin.world.elasticity.tabulate import Role, find_table


class Tables:
    """What `Compliance` knows of its body's tables, each looked for when it is first needed.

    Parameters
    ----------
    body, poisson_ratio
        Whose they are.
    nominal
        Whether the sensor's own table answers.
    use
        Whether tables may be used; or the one to use, which then has no check.
    solver, progress
        For making one.
    """

    def __init__(
        self, body: Body, poisson_ratio: float, *, nominal: bool, use: bool | Table, solver: Solver,
        progress: Progress | None,
    ) -> None:  # fmt: skip
        self.nominal = nominal
        self._body, self._nu, self._use, self._solver, self._progress = body, poisson_ratio, use, solver, progress
        self._tried = False

    def covering(self, known: Known, load: Rectangles) -> TableAtNu | None:
        """Return the table that answers a load at these points, if there is one."""
        table = self._table
        if table and table.covers(load, self._nu) and known.basis(table.box_mm).inside:
            return self._at_nu
        return None

    def spanning(self, patches: Rectangles) -> TableAtNu | None:
        """Return the table that answers patches at each other's middles, if there is one."""
        table, away = self._table, np.abs(patches.centre_mm[:, :2])
        if table and bool((away <= table.box_mm[:2]).all()) and table.covers(patches, self._nu):
            return self._at_nu
        return None

    @property
    def found(self) -> bool:
        """Whether there is one."""
        return self._table is not None

    @cached_property
    def check(self) -> TableAtNu | None:
        """The table of a coarser mesh, if there is one."""
        found = self._find("check")
        return found.at(self._nu) if found else None

    @cached_property
    def between(self) -> float:
        """How far Poisson's ratio is from those solved for: 0 at them, 1 in the middle between two and at the ends."""
        low, high = NU_RANGE
        return abs(math.cos(SIZES[0] * math.acos(min(max((2.0 * self._nu - low - high) / (high - low), -1.0), 1.0))))

    def make(self) -> None:
        """Make, and keep in the cache, the tables of a block that has none; nothing where they would be of no use."""
        low, high = NU_RANGE
        of_use = isinstance(self._body, Block) and low <= self._nu <= high
        if not self.found and of_use and not self.nominal and not self._tried:
            self._tried = True  # a block too thin for a table has none, however often it is asked
            self._find("check", make=True)
            self.__dict__["_table"] = self._find("truth", make=True)
            for name in ("_at_nu", "check"):
                self.__dict__.pop(name, None)

    @cached_property
    def _table(self) -> Table | None:
        return self._find("nominal" if self.nominal else "truth")

    @cached_property
    def _at_nu(self) -> TableAtNu | None:
        return self._table.at(self._nu) if self._table else None

    def _find(self, role: Role, make: bool = False) -> Table | None:
        if isinstance(self._use, Table):
            return self._use if role != "check" else None
        if not self._use:
            return None
        return find_table(self._body, role, make=make, solver=self._solver, progress=self._progress)
