"""How far a real sensor is from its drawing: standard deviations from which the truth is drawn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from twin.parts.part import Part

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
