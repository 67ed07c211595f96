"""The half-space that presses are compared on: its own formulas, no finite elements."""

import numpy as np

from benchmarks.reference import BODIES
from twin.arrays import Floats, Points
from twin.parts.load import Rectangles
from twin.theory import halfspace

BLOCK = BODIES["block"]
"""Only its flat surface counts where a half-space stands for it."""


class HalfSpace:
    """The surface of a half-space of E = 1 MPa; without ``coupled`` as Mindlin's theory has it.

    Then normal forces move nothing sideways, and the other way round, which only at nu = 1/2 is so.
    """

    one_material = True

    def __init__(self, poisson_ratio: float, *, coupled: bool = True) -> None:
        self._poisson_ratio, self._coupled = poisson_ratio, coupled

    def to_points(self, points: Points, rectangles: Rectangles) -> Floats:
        """Return the (3 n, 3 k) displacements of points per unit force on each rectangle, mm/N."""
        whole = halfspace.compliance(points, rectangles, 1.0, self._poisson_ratio)
        if not self._coupled:
            parts = whole.reshape(len(points), 3, len(rectangles), 3)
            parts[:, 2, :, :2] = parts[:, :2, :, 2] = 0.0
        return whole

    def offset_part(self, points: Points, rectangle: Rectangles) -> Floats:
        """Return (3 n, 3): all there is on a half-space."""
        return self.to_points(points, rectangle)

    def smooth_part(self, _patches: Rectangles, nodes: Rectangles) -> Floats:
        """Return (3 n, 3 n) zeros."""
        return np.zeros((3 * len(nodes), 3 * len(nodes)))

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return the symmetric (3 k, 3 k) compliance, mm/N."""
        found = self.to_points(rectangles.centre_mm, rectangles)
        return (found + found.T) / 2.0
