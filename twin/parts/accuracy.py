"""Accuracy knobs, stated as error targets; the program picks the cheapest method that meets them.

``auto`` takes of every stage what the scene needs and no more. What can't be told of the force anyhow is what the
making leaves open of Young's modulus, so that displacements need a third of that, and a tenth of the error is theirs at
most. Markers at a depth d don't see tractions that vary over less than d, as these die out like exp(-2 pi d / length),
so that patches need not be narrower than d. Measured: ``python -m benchmarks budget`` (docs/budget.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from twin.parts.part import Part

SHARE = 1 / 3
"""Error of displacements over the tolerance of Young's modulus, with ``auto``."""

PER_DEPTH = 1.2
"""Patches on the least depth of a marker, with ``auto``."""

FEWEST, USUAL, LOOSEST, TIGHTEST = 8, 16, 1e-2, 1e-3
INCREMENTS = 8
"""Parts of a step with friction: the force of a stuck sphere is within 0.05 % of many then."""


class Accuracy(Part):
    """Error targets.

    Attributes
    ----------
    displacement
        Largest error of a marker's displacement over the largest displacement, or ``auto``.
    centroid_px
        Largest error of a marker's place in the noise-free picture, px; ``auto`` balances it against the noise.
    contact_patches
        Contact patches across the contact's diameter, or ``auto``.
    contact_increments
        With friction: parts of a step in which patches touch or slip, at most.
    surface_table
        Whether a curved body's answers are interpolated between patches solved all over its sensing surface, for many
        loads: a minute or two once, milliseconds a load afterwards, and a thousandth more of error, which is told.
    """

    displacement: Annotated[float, Field(ge=1e-5, le=0.2)] | Literal["auto"] = 5e-3
    centroid_px: Annotated[float, Field(ge=1e-4, le=1)] | Literal["auto"] = "auto"
    contact_patches: Annotated[int, Field(ge=6, le=40)] | Literal["auto"] = USUAL
    contact_increments: Annotated[int, Field(ge=1, le=64)] = INCREMENTS
    surface_table: bool = False

    def displacement_for(self, modulus_pct: float) -> float:
        """Return the largest error of displacements of a sensor whose Young's modulus is known to so many percent."""
        if not isinstance(self.displacement, str):
            return self.displacement
        return min(max(SHARE * modulus_pct / 100, TIGHTEST), LOOSEST)

    def patches_for(self, widths_mm: Sequence[float], depths_mm: Sequence[float]) -> int:
        """Return the contact patches across probes of given widths, over markers at given depths, mm."""
        if not isinstance(self.contact_patches, str):
            return self.contact_patches
        if not widths_mm or not depths_mm:
            return USUAL
        return math.ceil(min(max(PER_DEPTH * max(widths_mm) / min(depths_mm), FEWEST), USUAL))
