"""The tables [accuracy] and [tolerance] of a scene.

`Accuracy` holds the requested errors, and `Tolerance` the standard deviations from which the made
sensor is drawn.

``auto`` selects for every stage what the scene needs. The tolerance of Young's modulus limits how
well a force can be known. The error of displacements is set to a third of it, which adds a tenth to
the force's error. Markers at a depth d don't see tractions that vary over less than d, which decay
like exp(-2 pi d / length), so patches need not be narrower. Measured: ``python -m benchmarks
budget`` (docs/budget.md).
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
        Largest error of a marker's place in the noise-free picture, px; ``auto`` balances it
        against the noise.
    contact_patches
        Contact patches across the contact's diameter, or ``auto``.
    contact_increments
        With friction: parts of a step in which patches touch or slip, at most.
    surface_table
        Whether a curved body's answers are interpolated between patches solved all over its sensing
        surface, for many loads: a minute or two once, milliseconds a load afterwards, and a
        thousandth more of error, which is told.
    """

    displacement: Annotated[float, Field(ge=1e-5, le=0.2)] | Literal["auto"] = 5e-3
    centroid_px: Annotated[float, Field(ge=1e-4, le=1)] | Literal["auto"] = "auto"
    contact_patches: Annotated[int, Field(ge=6, le=40)] | Literal["auto"] = USUAL
    contact_increments: Annotated[int, Field(ge=1, le=64)] = INCREMENTS
    surface_table: bool = False

    def displacement_for(self, modulus_pct: float) -> float:
        """Return the largest error of displacements of a sensor whose Young's modulus is known to
        so many percent."""
        if not isinstance(self.displacement, str):
            return self.displacement
        return min(max(SHARE * modulus_pct / 100, TIGHTEST), LOOSEST)

    def patches_for(self, widths_mm: Sequence[float], depths_mm: Sequence[float]) -> int:
        """Return the contact patches across probes of given widths, over markers at given depths,
        mm."""
        if not isinstance(self.contact_patches, str):
            return self.contact_patches
        if not widths_mm or not depths_mm:
            return USUAL
        return math.ceil(min(max(PER_DEPTH * max(widths_mm) / min(depths_mm), FEWEST), USUAL))


CUT = 2.5
"""Standard deviations beyond which there are none: a maker rejects worse ones."""

Percent = Annotated[float, Field(ge=0, le=30)]
"""Of a number that is positive, and stays so: the largest, `CUT` times, leaves a quarter of it."""


class Tolerance(Part):
    """Standard deviations (normal, cut at 2.5) of what a maker does not control.

    Attributes
    ----------
    preset
        ``standard`` uses the numbers below; ``none`` makes the sensor exactly as drawn (for tests).
    youngs_modulus_pct
        Of Young's modulus, percent.
    poisson_ratio
        Of the shortfall of Poisson's ratio below the nominal value (never above 0.5).
    depth_mm
        Of each marker layer's depth.
    print_mm
        Of each marker's place along the surface.
    print_diameter_pct, print_shade_pct
        Of each marker's diameter and of its reflectance, percent.
    missing
        Share of markers that the maker lost (not a standard deviation).
    pupil_mm
        Of each coordinate of the entrance pupil.
    tilt_deg
        Of each of the camera's small rotations.
    focal_pct
        Of the focal length, percent.
    distortion
        Of the lens's first radial coefficient.
    """

    preset: Literal["standard", "none"] = "standard"
    youngs_modulus_pct: Percent = 1.5
    poisson_ratio: float = Field(default=0.001, ge=0, le=0.2)
    depth_mm: float = Field(default=0.03, ge=0, le=5)
    print_mm: float = Field(default=0.03, ge=0, le=2)
    print_diameter_pct: Percent = 0.0
    print_shade_pct: Percent = 0.0
    missing: float = Field(default=0.0, ge=0, le=1)
    pupil_mm: float = Field(default=0.1, ge=0, le=10)
    tilt_deg: float = Field(default=0.1, ge=0, le=10)
    focal_pct: float = Field(default=0.3, ge=0, le=10)
    distortion: float = Field(default=0.0, ge=0, le=0.2)
