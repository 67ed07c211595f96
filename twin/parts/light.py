"""Light emitting diodes beside the camera, or in the body."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Floats, Points
from twin.parts.part import Part
from twin.parts.ranges import Place


class Light(Part):
    """LEDs that shine along -z, plus a weak even light.

    Attributes
    ----------
    positions_mm
        (x, y, z) of every LED: in air behind the base and its layers, or in the body.
    exponent
        Emission falls off as cos(angle to -z) to this power: 1 is Lambertian.
    profile
        Emission as a table instead, of (angle to -z in degrees, share of the largest), joined by straight lines; 0
        beyond the last.
    radius_mm
        Radius of each LED's disc, which lies across z and is seen where the window mirrors it; 0 is a point, whose
        mirror image has no size.
    ambient
        Share of the brightness that comes from all sides (scattering in the body), 0 to 1.
    """

    positions_mm: tuple[tuple[Place, Place, Place], ...] = Field(min_length=1, max_length=64)
    exponent: float = Field(default=1.0, ge=0, le=50)
    profile: tuple[tuple[float, float], ...] | None = None
    radius_mm: float = Field(default=0.0, ge=0, le=50)
    ambient: float = Field(default=0.2, ge=0, le=1)

    @model_validator(mode="after")
    def _profile_is_a_table(self) -> Light:
        if self.profile is None:
            return self
        angles, shares = [row[0] for row in self.profile], [row[1] for row in self.profile]
        rising = all(a < b for a, b in pairwise(angles))
        if not (len(angles) >= 2 and angles[0] == 0 and angles[-1] <= 180 and rising):
            raise ValueError(f"profile: angles {angles} deg must rise from 0 to at most 180, at least two of them")
        if min(shares) < 0 or max(shares) <= 0:
            raise ValueError("profile: shares must be 0 or more, and one above 0")
        return self

    def emission(self, cosine: Floats) -> Floats:
        """Return the intensity at cosines of the angle to -z, 1 along -z for a power of the cosine."""
        if self.profile is None:
            falling: Floats = np.maximum(cosine, 0.0) ** self.exponent if self.exponent else np.ones_like(cosine)
            return falling
        angles, shares = np.array(self.profile).T
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
        table: Floats = np.interp(angle, angles, shares / shares.max(), right=0.0)
        return table

    def points(self) -> tuple[Points, Floats]:
        """Return (n, 3) points that stand for the LEDs, mm, and their (n,) shares of an LED's light.

        Notes
        -----
        A disc is seven points, its middle and a hexagon at sqrt(2/3) of the radius: exact for polynomials of degree 5.
        """
        places = np.array(self.positions_mm, float)
        if self.radius_mm == 0:
            return places, np.ones(len(places))
        around = np.arange(6) * np.pi / 3
        ring = self.radius_mm * np.sqrt(2 / 3) * np.column_stack([np.cos(around), np.sin(around), np.zeros(6)])
        disc = np.concatenate([np.zeros((1, 3)), ring])
        return (places[:, None] + disc).reshape(-1, 3), np.tile([0.25, *[0.125] * 6], len(places))
