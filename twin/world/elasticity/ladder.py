"""Accuracy as a request: the cheapest level of a body's mesh that meets it, and the error that came out.

A level is chosen before anything is solved, by what it is expected to reach well inside the sensing surface. The error
of an answer is then estimated from the next coarser level's (`Compliance.error_estimate`); where that is above what
was asked, and the next finer level is likely to meet it, the answer is taken from there. What no level reaches is
answered by the last one tried, and said.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin.arrays import Points
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.expected import EXPECTED
from twin.world.mesh.mesh import Progress
from twin.world.mesh.sizing import WORLD, Level

if TYPE_CHECKING:
    from twin.world.elasticity.covered import Covered

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
    progress
        Told when a mesh or a table has to be made.
    """

    def __init__(self, body: Body, material: Material, asked: float, *, progress: Progress | None = None) -> None:
        self._body, self._material, self._progress = body, material, progress
        self.asked = asked
        self._rungs: dict[Level, Compliance] = {}

    def at(self, level: Level) -> Compliance:
        """Return the compliance on one level."""
        if level not in self._rungs:
            self._rungs[level] = Compliance(self._body, self._material, level=level, progress=self._progress)
        return self._rungs[level]

    @property
    def base(self) -> Compliance:
        """The cheapest level that is expected to do."""
        flat = self._body.is_flat
        return self.at(next((r for r in WORLD[1:] if EXPECTED[flat, r].inside <= self.asked), WORLD[-1]))

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
        expected = rung.expected_error(load, points)
        if not always and CLEAR * expected <= self.asked:
            return Answer(displacement_mm=rung.displacement(points, load), error=expected, compliance=rung)
        error = rung.error_estimate(points, load)
        while self.asked < error <= GAIN * self.asked and rung.level != WORLD[-1]:
            rung = self.at(WORLD[WORLD.index(rung.level) + 1])
            error = rung.error_estimate(points, load)
        return Answer(displacement_mm=rung.displacement(points, load), error=error, compliance=rung)
