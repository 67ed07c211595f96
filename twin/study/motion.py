"""What a load does to the markers, and to the cover behind them: arrays that pictures and scores are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from twin.arrays import Floats, Points
from twin.parts.load import Rectangles

if TYPE_CHECKING:
    from twin.world.elasticity.compliance import Compliance
    from twin.world.elasticity.covered import Covered
    from twin.world.elasticity.stiff import StiffBeads
    from twin.world.picture.cover import CoverMotion


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What a load does to the markers.

    Attributes
    ----------
    displacement_mm
        (n, 3) displacements of the marker centres, mm.
    gradient
        (n, 3, 3) displacement gradients du_i/dx_j there.
    error
        Estimated largest error of the displacements over the largest displacement.
    cover
        How the cover moves where the camera sees it; None where pictures don't show that.
    """

    displacement_mm: Points
    gradient: Floats
    error: float
    cover: CoverMotion | None = None


def with_stiff_beads(passive: Motion, beads: StiffBeads | None, field: Callable[[Points], Points]) -> Motion:
    """Return the motion of markers that push each other, if any do.

    Parameters
    ----------
    passive
        How the rubber alone would carry them.
    beads
        The rigid ones and how they push; None where all are passive.
    field
        The rubber's displacement, mm, at any (k, 3) points.
    """
    if beads is None or not passive.displacement_mm.any():
        return passive
    change = beads.change(field, passive.gradient)
    return replace(
        passive,
        displacement_mm=passive.displacement_mm + change,
        error=passive.error + beads.error(change, passive.displacement_mm),
    )


def cover_motion(compliance: Compliance | Covered, points: Points, rectangles: Rectangles) -> CoverMotion:
    """Return how the cover moves at (k, 3) points of its inside, where the camera looks."""
    from twin.world.picture.cover import CoverMotion

    return CoverMotion(
        displacement_mm=compliance.displacement(points, rectangles), gradient=compliance.gradient(points, rectangles)
    )
