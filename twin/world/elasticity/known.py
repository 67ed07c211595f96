"""Points that were asked for before: found to be inside the body once, and placed once.

Why compared and not hashed: equality of two arrays is certain, sees every change, and costs a few microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin.arrays import Floats, Points, frozen
from twin.parts.body import Body
from twin.world.elasticity.spread import Readings
from twin.world.elasticity.table import Basis
from twin.world.mesh.interpolate import Locator, Places, Weighted, require_inside
from twin.world.mesh.recovery import Recovery

REMEMBERED = 8
"""Point sets that are kept, the latest ones."""

LOOKED_AT = 5000
"""Of more points than this, every so manieth is looked at for how rough a mesh is there."""


@dataclass(eq=False)
class Known:
    """Points inside a body, (n, 3) mm, and what was worked out for them.

    Attributes
    ----------
    points
        A copy of what was asked for.
    places
        Where they are in the mesh.
    cubics, rough_reading
        What reads a field more smoothly at `every` so manieth point, and a surface table there.
    readings
        Adjoint solves for them; large, so that one set at a time has any (`Memory.forget_readings`).
    reading, slopes
        What reads displacements and gradients there off a `twin.world.elasticity.surface_table.SurfaceTable`.
    often
        Whether many loads will be asked about, so that what reads a table is made at the first one.
    """

    points: Points
    often: bool = False
    places: Places | None = None
    cubics: Weighted | None = None
    rough_reading: Floats | None = None
    readings: Readings | None = None
    reading: Floats | None = None
    slopes: Floats | None = None
    _bases: dict[tuple[float, float, float], Basis] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points)

    def basis(self, box_mm: tuple[float, float, float]) -> Basis:
        """Return what a table with this box needs to know of the points."""
        if box_mm not in self._bases:
            self._bases[box_mm] = Basis(points=self.points, box_mm=box_mm, often=self.often)
        return self._bases[box_mm]

    @property
    def every(self) -> slice:
        """Which points are looked at for how rough a mesh is there."""
        return slice(None, None, max(1, -(-len(self) // LOOKED_AT)))

    def smoothed(self, recovery: Recovery) -> Weighted:
        """Return what reads fields on the recovery's mesh, which must always be the same, at `every` point."""
        if self.cubics is None:
            self.cubics = recovery.at(self.points[self.every])
        return self.cubics

    def placed(self, locator: Locator) -> Places:
        """Return where the points are in the locator's mesh, which must always be the same."""
        if self.places is None:
            self.places = locator.locate(self.points)
        return self.places


class Memory:
    """The point sets that were asked for last.

    Parameters
    ----------
    body
        The body that they must be in.
    """

    def __init__(self, body: Body) -> None:
        self._body = body
        self._sets: list[Known] = []
        self._kept: list[Known] = []

    def of(self, points: Points) -> Known:
        """Return what is known of ``points`` (n, 3).

        Raises
        ------
        OutOfBodyError
            A point is outside the body.
        """
        points = np.asarray(points, float)
        for known in (*self._kept, *reversed(self._sets)):
            if known.points.shape == points.shape and bool((known.points == points).all()):
                return known
        self._sets = [*self._sets[1 - REMEMBERED :], self._new(points)]
        return self._sets[-1]

    def keep(self, points: Points) -> None:
        """Never forget ``points`` (n, 3), at which many loads will be asked about. Raises like `of`."""
        self._kept.append(self._new(np.asarray(points, float), often=True))

    def forget(self) -> None:
        """Drop all sets but those that are kept."""
        self._sets = []

    def _new(self, points: Points, *, often: bool = False) -> Known:
        require_inside(self._body, points)
        return Known(points=frozen(np.array(points, order="C")), often=often)

    def forget_readings(self) -> None:
        """Drop all adjoint solves, which may take a hundred megabytes a set."""
        for known in (*self._kept, *self._sets):
            known.readings = None
