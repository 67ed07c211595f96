"""Light emitting diodes beside the camera."""

from __future__ import annotations

from pydantic import Field

from twin.parts.part import Part


class Light(Part):
    """Small LEDs that shine along -z, plus a weak even light.

    Attributes
    ----------
    positions_mm
        (x, y, z) of every LED; they stand in air behind the base and its layers.
    exponent
        Emission falls off as cos(angle to -z) to this power: 1 is Lambertian.
    ambient
        Share of the brightness that comes from all sides (scattering in the body), 0 to 1.
    """

    positions_mm: tuple[tuple[float, float, float], ...] = Field(min_length=1, max_length=64)
    exponent: float = Field(default=1.0, ge=0, le=50)
    ambient: float = Field(default=0.2, ge=0, le=1)
