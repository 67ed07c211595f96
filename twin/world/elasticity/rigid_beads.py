"""Rigid beads in the made sensor: what their stiffness changes in the motion of all markers, press
after press.

Why a map is kept: how the beads push depends on their places alone, so it is worked out once for a
sensor; every further press is a product. Why only first order: the second changes the flat sensor's
markers by 0.02 % of the largest displacement, no more than the closed forms are off
(docs/inclusions.md).

Validity: see `twin.theory.inclusions` for the formulas, and `twin.parts.markers` for the scenes
that are refused. The rubber between the markers, the contact of the probe and the gradient at the
markers stay those of a body without beads; a rigid bead turns with the rubber (Faxen's second law),
less the turn that its neighbours' push adds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Points, frozen
from twin.parts.markers import MarkerLayer, MarkerSet
from twin.theory.inclusions import dipole_displacement, mean_on_sphere, shift_per_strain, stresslet

MODEL_ERROR = 0.1
"""Error of the change over the change: resolved finite elements differ by up to 7 % of it, and the
second order is up to 7 % of it where beads are as close as allowed (docs/inclusions.md)."""

MOST_KEPT = 5e7
"""Numbers (200 MB) up to which the map is kept: 1600 beads among as many markers."""


@dataclass(frozen=True, kw_only=True)
class StiffBeads:
    """Rigid beads among markers.

    Attributes
    ----------
    points
        (n, 3) all markers at rest, mm; the free surface is z = 0.
    rows
        (m,) which of them are rigid beads; the others are points that the beads push.
    radius_mm
        (m,) radii of the beads.
    per_strain
        See `shift_per_strain`; None where it would be too large to keep.
    """

    points: Points
    rows: Ints
    radius_mm: Floats
    per_strain: NDArray[np.float32] | None

    def change(self, field: Callable[[Points], Points], gradient: Floats) -> Points:
        """Return the (n, 3) motion of the markers less that of passive points, mm, in the ``field``
        of a body without beads, from points to displacements (k, 3), mm, and its ``gradient`` (n,
        3, 3) at all markers."""
        centres = self.points[self.rows]
        strain = 0.5 * (gradient + gradient.swapaxes(1, 2))[self.rows]
        if self.per_strain is None:
            dipoles = stresslet(strain, self.radius_mm, 1.0)
            change = dipole_displacement(self.points, centres, dipoles, 1.0, self._own)
        else:
            six = strain[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]] * self.radius_mm[:, None] ** 3
            change = (self.per_strain @ six.ravel().astype(np.float32)).astype(float).reshape(-1, 3)
        change[self.rows] += mean_on_sphere(field, centres, self.radius_mm) - field(centres)
        return change

    def error(self, change: Points, moved: Points) -> float:
        """Return the likely error of a change (n, 3) over the largest displacement (n, 3)."""
        return MODEL_ERROR * float(
            np.linalg.norm(change, axis=1).max() / np.linalg.norm(moved, axis=1).max()
        )

    @property
    def _own(self) -> Ints:
        own = np.full(len(self.points), -1)
        own[self.rows] = np.arange(len(self.rows))
        return own

    @staticmethod
    def of(markers: MarkerSet, layers: Mapping[str, MarkerLayer]) -> StiffBeads | None:
        """Return the beads of the layers that are ``stiff``, None if no layer is."""
        radius = np.zeros(len(markers))
        for name, layer in layers.items():
            radius[markers.of(name)] = layer.diameter_mm / 2 if layer.stiff else 0.0
        rows = np.flatnonzero(radius)
        if len(rows) == 0:
            return None
        beads = StiffBeads(
            points=markers.points,
            rows=frozen(rows),
            radius_mm=frozen(radius[rows]),
            per_strain=None,
        )
        if 18 * len(markers) * len(rows) > MOST_KEPT:
            return beads
        per_strain = shift_per_strain(markers.points, markers.points[rows], beads._own)
        return replace(beads, per_strain=frozen(per_strain))
