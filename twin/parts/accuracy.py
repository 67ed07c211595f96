"""Accuracy knobs, stated as error targets; the program picks the cheapest method that meets them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from twin.parts.part import Part


class Accuracy(Part):
    """Error targets.

    Attributes
    ----------
    displacement
        Largest error of a marker's displacement over the largest displacement.
    centroid_px
        Largest error of a marker's place in the noise-free picture, px; ``auto`` balances it against the noise.
    contact_patches
        Contact patches across the contact's diameter.
    """

    displacement: float = Field(default=5e-3, ge=1e-5, le=0.2)
    centroid_px: Annotated[float, Field(ge=1e-4, le=1)] | Literal["auto"] = "auto"
    contact_patches: int = Field(default=16, ge=6, le=64)
