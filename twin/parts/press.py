"""Presses: a rigid probe and the path it takes, held by force or by motion.

Each of the degrees of freedom x, y, z and the turn about z is controlled in every step either by force (torque) or by
motion. A component that is given in ``force_n`` is held by force, one in ``move_mm`` by motion, and one in neither
stays where it is.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from twin.parts.part import Part

Component = float | None
Triple = tuple[Component, Component, Component]


class Sphere(Part):
    """A rigid sphere."""

    kind: Literal["sphere"] = "sphere"
    diameter_mm: float = Field(gt=0, le=1000)


class Cylinder(Part):
    """A rigid flat-ended cylinder, its axis along z."""

    kind: Literal["cylinder"] = "cylinder"
    diameter_mm: float = Field(gt=0, le=1000)


class Pillar(Part):
    """A rigid flat-ended pillar of ``width_mm`` along x and ``length_mm`` along y (a square one if not given)."""

    kind: Literal["pillar"] = "pillar"
    width_mm: float = Field(gt=0, le=1000)
    length_mm: float | None = Field(default=None, gt=0, le=1000)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Extents along x and y, mm."""
        return self.width_mm, self.length_mm if self.length_mm is not None else self.width_mm


Probe = Annotated[Sphere | Cylinder | Pillar, Field(discriminator="kind")]


def _triple(value: Any) -> Any:
    if isinstance(value, dict):
        if extra := sorted(set(value) - {"x", "y", "z"}):
            raise ValueError(f"unknown components {', '.join(extra)}: allowed are x, y and z")
        return tuple(value.get(axis) for axis in "xyz")
    return value


class Step(Part):
    """One step of a path; what it gives is the state at its end.

    Attributes
    ----------
    force_n
        Total force of the probe on the body at the end of the step, N: a table ``{z = 1.0}`` or (x, y, z) with None
        for components that are held by motion.
    move_mm
        Motion of the probe during this step, mm, same form.
    torque_nmm
        Total torque about the probe's axis (z through its place), N mm, positive from x to y.
    turn_deg
        Turn about that axis during this step, degrees.
    """

    force_n: Triple = (None, None, None)
    move_mm: Triple = (None, None, None)
    torque_nmm: float | None = None
    turn_deg: float | None = None

    _tables = field_validator("force_n", "move_mm", mode="before")(_triple)

    @model_validator(mode="after")
    def _one_control_each(self) -> Step:
        for axis, force, move in zip("xyz", self.force_n, self.move_mm, strict=True):
            if force is not None and move is not None:
                raise ValueError(f"{axis} is given both as force_n and as move_mm: hold it by one of them")
        if self.torque_nmm is not None and self.turn_deg is not None:
            raise ValueError("torque_nmm and turn_deg are both given: hold the turn by one of them")
        return self


class Press(Part):
    """A probe at a place, taken along a path.

    Attributes
    ----------
    probe
        The rigid probe.
    at_mm
        (x, y) of the probe's axis; it comes from -z.
    steps
        The path. ``force_n`` (three numbers) or ``indentation_mm`` (a motion along z from first touch) are shorthand
        for a path of one step; without friction a side force of 0 there means that the probe is guided along z.
    direction
        Way of approach; None is +z, the only one until the contact solver takes others.
    friction
        Coulomb's coefficient mu, the same at rest and in motion: a patch carries at most mu times its normal force
        sideways, and slips when it would need more. 0 is frictionless, inf sticks whatever the force.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=True, validate_default=True)

    probe: Probe
    at_mm: tuple[float, float] = (0.0, 0.0)
    steps: tuple[Step, ...] = ()
    force_n: Triple | None = None
    indentation_mm: float | None = None
    direction: tuple[float, float, float] | None = None
    friction: float = 0.0

    _tables = field_validator("force_n", mode="before")(_triple)

    @field_validator("direction")
    @classmethod
    def _along_z(cls, value: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if value is not None and value != (0.0, 0.0, 1.0):
            raise ValueError("allowed is (0, 0, 1), along z, or nothing")
        return value

    @field_validator("friction")
    @classmethod
    def _known_law(cls, value: float) -> float:
        if not value >= 0.0:
            raise ValueError("allowed are 0 (frictionless) or more, up to inf (sticking)")
        return value

    @model_validator(mode="after")
    def _one_path(self) -> Press:
        numbers = (*self.at_mm, self.indentation_mm or 0.0, *(f or 0.0 for f in self.force_n or ()))
        if not all(math.isfinite(n) for n in numbers):
            raise ValueError("at_mm, force_n and indentation_mm must be finite")
        given = [bool(self.steps), self.force_n is not None, self.indentation_mm is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of steps, force_n and indentation_mm")
        if self.indentation_mm is not None and self.indentation_mm <= 0:
            raise ValueError("indentation_mm must be greater than 0: a push is +z")
        first = self.path[0]
        if first.force_n[2] is not None and first.force_n[2] <= 0:
            raise ValueError("the first step's force along z must be greater than 0: a push is +z")
        if first.force_n[2] is None and (first.move_mm[2] is None or first.move_mm[2] <= 0):
            raise ValueError("the first step must push: force_n.z > 0 or move_mm.z > 0")
        return self

    @property
    def path(self) -> tuple[Step, ...]:
        """The steps, shorthand spelt out."""
        if self.steps:
            return self.steps
        if self.indentation_mm is not None:
            return (Step(move_mm=(None, None, self.indentation_mm)),)
        fx, fy, fz = self.force_n or (None, None, None)
        if self.friction == 0.0:  # a frictionless probe can't be steered by forces: no side force means guided
            fx, fy = fx or None, fy or None
        return (Step(force_n=(fx, fy, fz)),)
