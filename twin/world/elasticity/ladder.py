"""Accuracy as a request: the cheapest level of a body's mesh that meets it, and the error that came out.

A level is chosen before anything is solved, by what it is expected to reach well inside the sensing surface. The error
of an answer is then estimated from another level's (`Compliance.error_estimate`); where that is above what
was asked, and the next finer level is likely to meet it, the answer is taken from there. What no level reaches is
answered by the last one tried, and said.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from twin.arrays import Points
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.progress import Progress
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.covered import Covered
from twin.world.elasticity.expected import EXPECTED
from twin.world.mesh.sizing import WORLD, Level

GAIN = 2.5
"""How many times smaller a level's error is than that of the next coarser one, at least."""

CLEAR = 3.0
"""An expected error so many times below the asked one needs no estimate."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Displacements, where they come from, and how good they are.

    Attributes
    ----------
    displacement_mm
        (n, 3), mm.
    error
        Estimated largest error over the largest displacement.
    compliance
        Of the level that the answer was taken from.
    """

    displacement_mm: Points
    error: float
    compliance: Compliance | Covered


class Ladder:
    """The levels of one body, each made when first needed.

    Parameters
    ----------
    body, material
        What it is.
    asked
        Largest error over the largest displacement.
    surface_table
        Whether the cheapest level that is expected to do has a table of a curved body's surface: see `Compliance`.
    progress
        Told when a mesh or a table has to be made.
    """

    def __init__(
        self,
        body: Body,
        material: Material,
        asked: float,
        *,
        surface_table: bool = False,
        progress: Progress | None = None,
    ) -> None:
        self._body, self._material, self._progress = body, material, progress
        self._surface_table = surface_table
        self.asked = asked
        self._rungs: dict[Level, Compliance] = {}

    def at(self, level: Level) -> Compliance:
        """Return the compliance on one level."""
        if level not in self._rungs:
            self._rungs[level] = Compliance(
                self._body,
                self._material,
                level=level,
                surface_table=self._surface_table and level == self._cheapest,
                progress=self._progress,
            )
        return self._rungs[level]

    @cached_property
    def _cheapest(self) -> Level:
        flat = self._body.is_flat
        return next((r for r in WORLD[1:] if EXPECTED[flat, r].inside <= self.asked), WORLD[-1])

    @property
    def base(self) -> Compliance:
        """The cheapest level that is expected to do."""
        return self.at(self._cheapest)

    def displacement(self, points: Points, load: Rectangles, *, always: bool = True) -> Answer:
        """Return the (n, 3) displacement of ``points`` under ``load``, from as fine a level as it takes.

        Parameters
        ----------
        points, load
            See `Compliance.displacement`, which also says what is raised.
        always
            Whether to estimate the error even where it is expected to be far below the asked one.
        """
        rung = self.base
        moved, error = rung.answer(points, load, enough=0.0 if always else self.asked / CLEAR)
        while self.asked < error <= GAIN * self.asked and rung.level != WORLD[-1]:
            rung = self.at(WORLD[WORLD.index(rung.level) + 1])
            moved, error = rung.answer(points, load)
        return Answer(displacement_mm=moved, error=error, compliance=rung)


class CoveredLadder:
    """One way to answer, whatever accuracy is asked; see `Ladder`."""

    def __init__(self, base: Covered) -> None:
        self.base = base

    def displacement(self, points: Points, load: Rectangles, *, always: bool = True) -> Answer:
        """Return the (n, 3) displacement of ``points`` under ``load``, and its estimated error."""
        del always
        moved, error = self.base.answer(points, load)
        return Answer(displacement_mm=moved, error=error, compliance=self.base)
