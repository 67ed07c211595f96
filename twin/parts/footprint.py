"""Tractions given outright: footprints that push on the sensing surface instead of a probe."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from twin.parts.load import Load, Traction
from twin.parts.part import Part
from twin.parts.ranges import Force, Place, Size

Spot = tuple[Place, Place] | tuple[Place, Place, Place]


class Footprint(Part):
    """One footprint under a traction of constant form; see `twin.parts.load.Traction`.

    Attributes
    ----------
    kind
        ``rectangle`` and ``disk`` are uniform, ``bump`` falls smoothly to nothing at its rim; ``twist`` is tangential
        and proportional to the distance from its centre.
    centre_mm
        (x, y), the sensing surface met there from -z; or (x, y, z), a place on it.
    size_mm
        Sides of a rectangle along x and y.
    radius_mm
        Of the others.
    force_n
        Total force on the body; not of a twist.
    torque_nmm
        Total torque of a twist about the surface's inward normal, positive from x to y.
    """

    kind: Literal["rectangle", "disk", "bump", "twist"] = "disk"
    centre_mm: Spot = (0.0, 0.0)
    size_mm: tuple[Size, Size] | None = None
    radius_mm: Size | None = None
    force_n: tuple[Force, Force, Force] | None = None
    torque_nmm: Force | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Footprint:
        flat, turns = self.kind == "rectangle", self.kind == "twist"
        if (self.size_mm is None) == flat or (self.radius_mm is not None) == flat:
            raise ValueError(
                f"a {self.kind} needs {'size_mm and no radius_mm' if flat else 'radius_mm and no size_mm'}"
            )
        if self.size_mm is not None and not min(self.size_mm) > 0:
            raise ValueError(f"size_mm = {self.size_mm} mm: both sides must be greater than 0")
        if (self.force_n is None) != turns or (self.torque_nmm is None) == turns:
            wanted = "torque_nmm and no force_n" if turns else "force_n and no torque_nmm"
            raise ValueError(f"a {self.kind} needs {wanted}")
        return self

    def load(self) -> Load:
        """Return it as a load."""
        if self.size_mm is not None:
            return Traction.rectangle(self.centre_mm, self.size_mm, self.force_n or (0.0, 0.0, 0.0))
        assert self.radius_mm is not None
        if self.kind == "twist":
            return Traction.twist(self.centre_mm, self.radius_mm, self.torque_nmm or 0.0)
        make = Traction.disk if self.kind == "disk" else Traction.bump
        return make(self.centre_mm, self.radius_mm, self.force_n or (0.0, 0.0, 0.0))
