"""The table [vary]: what differs between samples.

A distribution maps a fixed number of numbers u in [0, 1) to a value by its inverse, so random and
stratified sampling differ only in where the u come from. Its kind follows from its keys (`_MARKS`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from twin.arrays import Floats
from twin.parts.part import Flag, Part, in_words

CUT = 2.5
"""Standard deviations beyond which there are none: a maker rejects worse ones."""

Number = float | tuple[float, ...]


class Uniform(Part):
    """Evenly between two values, or two vectors component by component.

    Attributes
    ----------
    low, high
        Ends; numbers, or lists of equal length.
    log
        Even in the logarithm.
    """

    low: Number
    high: Number
    log: Flag = False

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        low, high = self._ends
        if low.shape != high.shape:
            raise ValueError(f"low has {low.size} and high {high.size} components: give as many")
        if not (low <= high).all():
            raise ValueError(f"low = {self.low} must not be above high = {self.high}")
        if self.log and low.min() <= 0:
            raise ValueError(f"low = {self.low}: with log = true it must be greater than 0")
        return self

    @cached_property
    def takes(self) -> int:
        """How many numbers u a draw takes."""
        return np.size(self.low)

    def at(self, u: Floats) -> Any:
        """Return the value of (takes,) numbers u."""
        low, high = self._ends
        value = low * (high / low) ** u if self.log else low + (high - low) * u
        return _plain(value, self.low)

    @property
    def _ends(self) -> tuple[Floats, Floats]:
        return np.atleast_1d(self.low), np.atleast_1d(self.high)


class Normal(Part):
    """Normal, cut at 2.5 standard deviations: a maker rejects worse ones.

    Attributes
    ----------
    mean, sd
        Numbers, or lists of equal length.
    """

    mean: Number
    sd: Number

    @model_validator(mode="after")
    def _positive(self) -> Normal:
        if np.shape(self.mean) != np.shape(self.sd):
            raise ValueError("mean and sd must have as many components")
        if np.min(self.sd) < 0:
            raise ValueError(f"sd = {self.sd}: must be 0 or more")
        return self

    @cached_property
    def takes(self) -> int:
        """How many numbers u a draw takes."""
        return np.size(self.mean)

    def at(self, u: Floats) -> Any:
        """Return the value of (takes,) numbers u."""
        from scipy.special import ndtr, ndtri  # here: a scene that varies nothing loads no scipy

        tail = ndtr(-CUT)
        value = np.atleast_1d(self.mean) + np.atleast_1d(self.sd) * ndtri(tail + (1 - 2 * tail) * u)
        return _plain(value, self.mean)


class Choice(Part):
    """One of several values; a value may be a table that holds distributions itself.

    Attributes
    ----------
    choice
        The values: numbers, texts, lists or tables.
    weights
        How often each comes, in any unit; equally if not given.
    """

    choice: tuple[Any, ...] = Field(min_length=1)
    weights: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _fits(self) -> Choice:
        if self.weights is not None and (
            len(self.weights) != len(self.choice) or min(self.weights) < 0
        ):
            raise ValueError(
                f"weights: give one of 0 or more for each of the {len(self.choice)} choices"
            )
        if self.weights is not None and sum(self.weights) <= 0:
            raise ValueError("weights: one must be greater than 0")
        for value in self.choice:
            _made(value)
        return self

    @cached_property
    def _made(self) -> tuple[Any, ...]:
        return tuple(_made(value) for value in self.choice)

    @cached_property
    def takes(self) -> int:
        """How many numbers u a draw takes: one to choose, and those of the choices."""
        return 1 + sum(_takes(value) for value in self._made)

    def at(self, u: Floats) -> Any:
        """Return the value of (takes,) numbers u; every choice has numbers of its own."""
        weights = np.array(self.weights or (1.0,) * len(self.choice))
        chosen = int(np.searchsorted(np.cumsum(weights / weights.sum()), u[0], side="right"))
        chosen = min(chosen, len(self.choice) - 1)
        start = 1 + sum(_takes(value) for value in self._made[:chosen])
        return _inside(self._made[chosen], u[start:])


class ForceCone(Part):
    """A force vector (x, y, z) in N in a cone about z: for ``press.force_n`` and
    ``steps.N.force_n``.

    Attributes
    ----------
    normal_n, ratio
        Its part along z, and that sideways over it: numbers or distributions. With friction mu on a
        flat face the ratio must stay below mu.
    """

    normal_n: Any
    ratio: Any = 0.0

    @model_validator(mode="after")
    def _numbers(self) -> ForceCone:
        for key in ("normal_n", "ratio"):
            value = getattr(self, key)
            try:
                made = _made(value)
                ends = [_inside(made, np.full(_takes(made), u)) for u in (0.0, 1.0)]
            except ValueError as problem:
                raise ValueError(f"{key}: {problem}") from None
            if not all(isinstance(end, int | float) and end >= 0 for end in ends):
                raise ValueError(
                    f"{key} = {value!r}: must be a number of 0 or more, or a distribution of such"
                )
        return self

    @cached_property
    def takes(self) -> int:
        """How many numbers u a draw takes."""
        return 1 + sum(_takes(value) for value in self._made)

    @cached_property
    def _made(self) -> tuple[Any, Any]:
        return _made(self.normal_n), _made(self.ratio)

    def at(self, u: Floats) -> Any:
        """Return (x, y, z) in N of (takes,) numbers u; all directions sideways are equally
        likely."""
        normal_n, ratio = self._made
        normal = float(_inside(normal_n, u[1:]))
        sideways = normal * float(_inside(ratio, u[1 + _takes(normal_n) :]))
        angle = 2.0 * math.pi * float(u[0])
        return [sideways * math.cos(angle), sideways * math.sin(angle), normal]


class Follows(Part):
    """A value tied to another key's: ``times`` its value ``plus`` something.

    Attributes
    ----------
    follows
        Dotted key of a number, drawn or not.
    times, plus
        Of the line.
    """

    follows: str
    times: float = 1.0
    plus: float = 0.0

    @cached_property
    def takes(self) -> int:
        """How many numbers u a draw takes: none."""
        return 0


def _kind(value: Any) -> str | None:
    keys = Part.keys_of(value)
    return next((kind for kind, marks in _MARKS.items() if any(m in keys for m in marks)), None)


_MARKS = {
    "[uniform]": ("low", "high"),
    "[normal]": ("mean", "sd"),
    "[choice]": ("choice",),
    "[cone]": ("normal_n",),
    "[follows]": ("follows",),
}

Distribution = Annotated[
    Annotated[Uniform, Tag("[uniform]")]
    | Annotated[Normal, Tag("[normal]")]
    | Annotated[Choice, Tag("[choice]")]
    | Annotated[ForceCone, Tag("[cone]")]
    | Annotated[Follows, Tag("[follows]")],
    Discriminator(
        _kind,
        custom_error_type="no_distribution",
        custom_error_message="must be {low, high}, {mean, sd}, {choice}, {normal_n, ratio} or "
        "{follows}",
    ),
]

_CLASSES: dict[str, type[Part]] = {
    "[uniform]": Uniform,
    "[normal]": Normal,
    "[choice]": Choice,
    "[cone]": ForceCone,
}


def flat(
    table: Mapping[str, Any],
    is_whole: Callable[[Mapping[str, Any]], bool] = lambda table: _kind(table) is not None,
    prefix: str = "",
) -> dict[str, Any]:
    """Return values by dotted key: distributions, or other tables that ``is_whole`` keeps."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if key in ("source", "assumed"):  # of a table that only holds others
            continue
        inner: dict[str, Any] = {}
        if isinstance(value, Mapping) and not is_whole(value):
            inner = flat(value, is_whole, f"{prefix}{key}.")
        # An empty table is kept, so that it is refused.
        for name, what in (inner or {f"{prefix}{key}": value}).items():
            both = isinstance(found.get(name), Mapping) and isinstance(what, Mapping)
            found[name] = {**found[name], **what} if both else what
    return found


def _made(value: Any) -> Any:
    """Return a plain value with the distributions inside it made, or raise ValueError where one is
    wrong."""
    if not isinstance(value, Mapping):
        return value
    kind = _kind(value)
    if kind == "[follows]":
        raise ValueError("follows can't stand inside another distribution")
    if kind is None:
        return {key: _made(inner) for key, inner in value.items()}
    try:
        return _CLASSES[kind].model_validate(value)
    except ValidationError as problem:
        first = problem.errors()[0]
        key = ".".join(str(k) for k in first["loc"])
        raise ValueError(f"{key}: {in_words(first)}".lstrip(": ")) from None


def _takes(value: Any) -> int:
    if isinstance(value, Mapping):
        return sum(_takes(inner) for inner in value.values())
    return int(value.takes) if isinstance(value, Part) else 0  # type: ignore[attr-defined]


def _inside(value: Any, u: Floats) -> Any:
    """Return what `_made` returned with its distributions drawn from u, in their order."""
    if isinstance(value, Part):
        return value.at(u[: value.takes])  # type: ignore[attr-defined]
    if not isinstance(value, Mapping):
        return value
    drawn = {}
    start = 0
    for key, inner in value.items():
        drawn[key] = _inside(inner, u[start:])
        start += _takes(inner)
    return drawn


def _plain(value: Floats, like: Number) -> float | list[float]:
    return [float(v) for v in value] if isinstance(like, tuple) else float(value[0])
