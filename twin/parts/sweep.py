"""A sweep: which designs of a sensor are looked at, how closely, and what is asked of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from twin.arrays import Floats
from twin.parts.part import Flag, Part
from twin.parts.vary import Follows, flat

Fidelity = Literal["closed", "linear", "full"]
FIDELITIES: tuple[Fidelity, ...] = ("closed", "linear", "full")
"""From the cheapest to the dearest; each is checked against the next."""

HalfSide = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]

GF = 9.80665e-3
"""A gram-force, N."""

METRICS = {
    "fwhm_mm": "width of the picture of one push, mm",
    "two_point_mm": "least distance at which two pushes are resolved, mm",
    "total_force_error": "error of the total force over the force",
    "resolution_gf": "standard deviation of a push's total, gf",
    "markers": "number of markers",
    "cost": "cost by the sweep's cost table",
}
"""What designs are judged by; of all of them less is better."""


def _kind(value: Any) -> str | None:
    keys = Part.keys_of(value)
    if "values" in keys:
        return "[values]"
    return "[range]" if "low" in keys or "high" in keys else None


class Sweep(Part):
    """A resolved sweep.

    Attributes
    ----------
    title
        One line for people.
    scene
        Path or name of the scene that designs are changed from.
    seed
        Root of the sampling; the made sensors and their noise come from the scene's own seed.
    set
        Values by dotted key that every design has instead of the scene's.
    axes
        Lists or ranges by dotted key; a ``*`` stands for every marker layer.
    derived
        Keys that follow others.
    fidelity
        Any of closed, linear, full; by default closed and linear, or full alone where the scene's
        ``reconstruction.method`` is ``local``, which is not linear.
    sampling
        ``grid``: every combination; ``latin``, ``sobol``, ``random``: ``count`` designs.
    count
        Number of designs of those.
    keep_extent
        Whether a layer keeps its extent where its pitch is changed: columns and rows follow (by
        even numbers, so that layers at half a pitch from each other stay so).
    loads, confirm, limits, cost
        See their classes.
    noise_px
        Standard deviation of a marker's shift, per axis; computed from the CCD
        (`twin.theory.limit`) if not given. For closed form and linear information: the full
        chain measures its own.
    sensors
        Made sensors a design, drawn from its tolerances, in the linear information and in the full
        chain.
    targets, weights
        What is asked, by metric, and how much each counts; see `METRICS`.
    """

    class Values(Part):
        """An axis of listed values.

        Attributes
        ----------
        values
            Numbers, texts or lists: what a scene allows there.
        """

        values: tuple[Any, ...] = Field(min_length=1)

        @model_validator(mode="after")
        def _finite(self) -> Sweep.Values:
            if any(isinstance(each, float) and not math.isfinite(each) for each in self.values):
                raise ValueError("its numbers must be finite")
            return self

        def grid(self) -> list[Any]:
            """Return the axis's values on a grid."""
            return list(self.values)

        def ends(self) -> list[Any]:
            """Return its least and its largest number, and all that is no number."""
            numbers = [each for each in self.values if isinstance(each, int | float)]
            others = [each for each in self.values if not isinstance(each, int | float)]
            return [*sorted({min(numbers), max(numbers)} if numbers else ()), *others]

        def at(self, u: Floats) -> list[Any]:
            """Return the values of (m,) numbers in [0, 1)."""
            count = len(self.values)
            return [self.values[min(int(each * count), count - 1)] for each in u]

    class Range(Part):
        """An axis between two numbers.

        Attributes
        ----------
        low, high
            Its ends.
        steps
            How many values a grid takes of it.
        log
            Even in the logarithm.
        whole
            Round to whole numbers.
        """

        low: float
        high: float
        steps: int = Field(default=5, ge=1, le=10_000)
        log: Flag = False
        whole: Flag = False

        @model_validator(mode="after")
        def _ordered(self) -> Sweep.Range:
            if self.low > self.high:
                raise ValueError(f"low = {self.low:g} must not be above high = {self.high:g}")
            if self.log and self.low <= 0:
                raise ValueError(f"low = {self.low:g}: with log = true it must be greater than 0")
            return self

        def ends(self) -> list[Any]:
            """Return its least and its largest value."""
            return self.at(np.arange(2.0))

        def grid(self) -> list[Any]:
            """Return the axis's values on a grid."""
            return self.at(np.linspace(0.0, 1.0, self.steps) if self.steps > 1 else np.array([0.5]))

        def at(self, u: Floats) -> list[Any]:
            """Return the values of (m,) numbers in [0, 1]."""
            value = self.low + (self.high - self.low) * u
            if self.log:
                value = self.low * (self.high / self.low) ** u
            value = np.clip(value, self.low, self.high)
            if self.whole:
                return [int(v) for v in np.rint(value)]
            return [float(f"{v:.12g}") for v in value]  # round numbers, not 1.7000000000000002

    class Loads(Part):
        """What pushes on every design, the same for all: square patches under even traction, or the
        scene's probe.

        Attributes
        ----------
        force_n
            Force of a press along the inward normal.
        probe
            Whether the scene's probe presses, with its friction, in place of the patches: by the
            full chain only, and without pairs. `Material.law` may be any.
        size_mm
            Side of the patch; with ``probe`` the room that a press needs on the surface.
        shear
            Tangential force over the normal one, in a direction of its own for every press. A probe
            needs friction above it.
        presses
            Presses at quasi-random places; one more, at the middle and without shear, is for the
            widths.
        region_mm
            Half sides of the region of the presses; six tenths of the scene's sites if not given.
        pair_mm
            Distance of the two pushes that the full chain is shown; the one that
            ``targets.two_point_mm`` asks for if not given.
        exposures
            Pictures of every load in the full chain: more tell its noise from its bias.
        """

        force_n: float = Field(default=1.0, gt=0, le=100)
        probe: Flag = False
        size_mm: float = Field(default=1.0, gt=0, le=20)
        shear: float = Field(default=0.3, ge=0, le=2)
        presses: int = Field(default=5, ge=1, le=100)
        region_mm: tuple[HalfSide, HalfSide] | None = None
        pair_mm: float = Field(default=2.0, gt=0, le=50)
        exposures: int = Field(default=1, ge=1, le=100)

    class Confirm(Part):
        """How many designs, the best first, go on to the next fidelity.

        Attributes
        ----------
        linear
            After the closed form; all if not given.
        full
            After the linear information (or the closed form).
        """

        linear: int | None = Field(default=None, ge=1)
        full: int = Field(default=5, ge=1)

    class Limits(Part):
        """When a design is dropped as impossible, with the reason kept.

        Attributes
        ----------
        overlap
            Largest share of markers that may overlap another one's picture.
        seen
            Least share of markers that must be inside the picture.
        """

        overlap: float = Field(default=0.1, ge=0, le=1)
        seen: float = Field(default=0.5, ge=0, le=1)

    class Cost(Part):
        """What a design costs, in any unit.

        Attributes
        ----------
        marker, megapixel, base
            Of each marker, of a million camera pixels, and of everything else.
        """

        marker: float = Field(default=1.0, ge=0)
        megapixel: float = Field(default=100.0, ge=0)
        base: float = Field(default=0.0, ge=0)

    title: str = ""
    scene: str
    seed: int = Field(default=1, ge=0, le=2**63 - 1)
    set: dict[str, Any] = Field(default_factory=dict)
    axes: dict[
        str,
        Annotated[
            Annotated[Values, Tag("[values]")] | Annotated[Range, Tag("[range]")],
            Discriminator(
                _kind,
                custom_error_type="no_axis",
                custom_error_message="must be a list, or {low, high, steps, log}",
            ),
        ],
    ] = Field(min_length=1)
    derived: dict[str, Follows] = Field(default_factory=dict)
    fidelity: tuple[Fidelity, ...] = Field(default=("closed", "linear"), min_length=1)
    sampling: Literal["grid", "latin", "sobol", "random"] = "grid"
    count: int = Field(default=100, ge=1, le=10_000_000)
    keep_extent: Flag = True
    loads: Loads = Loads()
    confirm: Confirm = Confirm()
    limits: Limits = Limits()
    cost: Cost = Cost()
    noise_px: float | None = Field(default=None, gt=0, le=10)
    sensors: int = Field(default=1, ge=1, le=100)
    targets: dict[str, Positive] = Field(
        default_factory=lambda: {"two_point_mm": 2.0, "total_force_error": 0.05}
    )
    weights: dict[str, Positive] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _as_far_apart_as_asked(cls, table: Any) -> Any:
        if not isinstance(table, Mapping):
            return table
        loads, targets = (table.get(name, {}) for name in ("loads", "targets"))
        asked = targets.get("two_point_mm") if isinstance(targets, Mapping) else None
        if isinstance(loads, Mapping) and isinstance(asked, int | float) and 0 < asked <= 50:
            return {**table, "loads": {"pair_mm": asked, **loads}}
        return table

    @field_validator("axes", "derived", mode="before")
    @classmethod
    def _by_dotted_key(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        marks = ("values", "low", "high", "follows")
        found = flat(value, lambda table: any(mark in table for mark in marks))
        return {k: {"values": v} if isinstance(v, list | tuple) else v for k, v in found.items()}

    @field_validator("set", mode="before")
    @classmethod
    def _values_by_dotted_key(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return _leaves(value)

    @model_validator(mode="after")
    def _fits_together(self) -> Sweep:
        if twice := sorted(set(self.axes) & set(self.derived)):
            raise ValueError(
                f"derived: {', '.join(twice)} is an axis already; leave one of them out"
            )
        for name in ("targets", "weights"):
            numbers: dict[str, float] = getattr(self, name)
            if unknown := sorted(set(numbers) - set(METRICS)):
                raise ValueError(
                    f"{name}: unknown metric {', '.join(unknown)}; known are {', '.join(METRICS)}"
                )
        if not self.targets:
            raise ValueError(f"targets: give at least one of {', '.join(METRICS)}")
        if len(set(self.fidelity)) < len(self.fidelity):
            raise ValueError("fidelity: each at most once")
        if self.sampling == "grid" and self.size > 10_000_000:
            raise ValueError(
                f"axes: a grid of {self.size} designs; at most 10000000, or use sampling = 'sobol'"
            )
        return self

    @property
    def ladder(self) -> tuple[Fidelity, ...]:
        """The requested fidelities, the cheapest first."""
        return tuple(f for f in FIDELITIES if f in self.fidelity)

    @property
    def size(self) -> int:
        """Number of designs."""
        if self.sampling != "grid":
            return self.count
        sizes = [
            axis.steps if isinstance(axis, Sweep.Range) else len(axis.values)
            for axis in self.axes.values()
        ]
        return int(np.prod(sizes, dtype=object))


def _leaves(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, Mapping) and not prefix.endswith("press.")
        found |= _leaves(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return found
