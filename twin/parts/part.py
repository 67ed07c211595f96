"""The base class of every description in a recipe.

A `Part` is frozen, and refuses unknown keys and NaN. Every number has a provenance (``source`` or
``assumed``). `in_words` turns errors of validation into sentences. Ranges that many keys share and
the random streams of a recipe's seed are here too.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from enum import IntEnum
from functools import cache
from inspect import Parameter, Signature
from typing import Annotated, Any, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from twin.errors import RecipeError, did_you_mean

UNITS = {
    "mm": "mm",
    "n": "N",
    "nmm": "N mm",
    "mpa": "MPa",
    "deg": "deg",
    "px": "px",
    "pct": "%",
    "mm2": "mm2",
    "mm3": "mm3",
    "dn": "DN",
    "e": "electrons",
    "s": "s",
}


LATER: dict[str, object] = {
    "back": "free",
    "youngs_modulus_mpa": None,
    "poisson_ratio": None,
    "stiff": False,
    "distortion": 0.0,
    "thickness_mm": 0.0,
    "deforms": False,
    "shadows": False,
    "law": "linear",
    "law_ratios": [],
    "relaxation": [],
    "seconds": 0.0,
    "renderer": "auto",
    "paths": 64,
    "colours": [],
    "dust": None,
    "gloss": None,
    "texture": None,
    "hot_pixels": 0,
    "dead_pixels": 0,
    "row_noise_e": 0.0,
    "column_noise_e": 0.0,
    "frames_per_second": None,
    "readout_ms": 0.0,
    "haze": 0.0,
    "haze_px": 30.0,
    "ghost": 0.0,
    "ghost_px": [8.0, 0.0],
    "smear": 0.0,
    "flicker": 0.0,
    "flicker_hz": 100.0,
    "auto_exposure": 0.0,
    "auto_gain": 0.0,
    "white_balance": "off",
    "adc_bits": 0,
    "bits": 8,
    "albedo": None,
    "transmittance": 0.0,
    "outside": [0.0, 0.0, 0.0],
    "lit": [],
    "depth_mm": None,
    "abbe_number": None,
    "scratches": None,
    "bubbles": None,
    "length_mm": 0.0,
    "hollow": 0.0,
    "print_oval_pct": 0.0,
    "print_colour_pct": 0.0,
}
"""Keys that came later, with the value that stands for what was before: hashes leave them out, so
that files stored under a hash of all keys stay valid."""


def identity(value: Any) -> Any:
    """Return a plain value as hashes take it: without provenance and the old values of `LATER`."""
    if isinstance(value, dict):
        kept = {k: v for k, v in value.items() if k not in ("source", "assumed")}
        return {k: identity(v) for k, v in kept.items() if k not in LATER or v != LATER[k]}
    return [identity(v) for v in value] if isinstance(value, list) else value


def hash_of(table: dict[str, Any]) -> str:
    """Return the SHA-256 of a table's `identity`, in hexadecimal."""
    return hashlib.sha256(json.dumps(identity(table), sort_keys=True).encode()).hexdigest()


def unit_of(key: str) -> str:
    """Return the unit that a key's suffix names (``depth_mm`` -> ``mm``), or an empty string."""
    return UNITS.get(key.rsplit("_", 1)[-1], "") if "_" in key else ""


class Part(BaseModel):
    """A frozen description.

    Attributes
    ----------
    source, assumed
        Where the numbers come from: a text for all numbers of the table, or a table of texts by
        key. ``source`` names a paper and its section, ``assumed`` gives the reason for a value that
        no paper states.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )

    source: str | dict[str, str] = Field(default_factory=dict, repr=False)
    assumed: str | dict[str, str] = Field(default_factory=dict, repr=False)

    def __init__(self, *unnamed: Any, **values: Any) -> None:
        """Validate and keep ``values``; raise a `RecipeError` with every problem at once."""
        known = [key for key in type(self).model_fields if key not in ("source", "assumed")]
        if unnamed:
            raise RecipeError(
                f"{unnamed[0]!r:.60}: give every value by its name: {', '.join(known)}",
                type(self).__name__,
            )
        try:
            super().__init__(**values)
        except ValidationError as problem:
            lines = [
                _complaint(dict(error), type(self), known)
                for error in problem.errors(include_url=False)
            ]
            raise RecipeError(lines, type(self).__name__) from None

    # Whole files are validated without a call of this constructor, so that their complaints can
    # name the file's keys.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Give the class a signature that can be read: keys and defaults, without types."""
        super().__pydantic_init_subclass__(**kwargs)
        shown = {k: f for k, f in cls.model_fields.items() if k not in ("source", "assumed")}
        cls.__signature__ = Signature(
            [
                Parameter(
                    key,
                    Parameter.KEYWORD_ONLY,
                    default=Parameter.empty
                    if one.is_required()
                    else one.get_default(call_default_factory=True),
                )
                for key, one in shown.items()
            ]
        )

    @model_validator(mode="before")
    @classmethod
    def _true_is_no_number(cls, table: Any) -> Any:
        """Make ``true``, which would be taken as 1, a word where only a number fits: it is then
        refused."""
        if not isinstance(table, Mapping):
            return table
        return {
            key: _spelt(value) if key in _numbers(cls) else value for key, value in table.items()
        }

    @model_validator(mode="after")
    def _provenance_names_keys(self) -> Part:
        for table in (self.source, self.assumed):
            if table and isinstance(table, dict):
                unknown = sorted(set(table) - set(type(self).model_fields))
                if unknown:
                    raise ValueError(
                        "source or assumed names keys that this table does not have: "
                        f"{', '.join(unknown)}"
                    )
        return self

    @staticmethod
    def keys_of(value: Any) -> Collection[str]:
        """Return the keys of a plain table or of a description; none of anything else."""
        if isinstance(value, Mapping):
            return value.keys()
        return type(value).model_fields if isinstance(value, Part) else ()

    def unsourced(self) -> list[str]:
        """Return the keys with numbers of the recipe that have neither ``source`` nor
        ``assumed``."""
        if isinstance(self.source, str) or isinstance(self.assumed, str):
            return []
        sourced = set(self.source) | set(self.assumed)
        return [
            k
            for k in sorted(self.model_fields_set)
            if k not in sourced and _holds_number(getattr(self, k))
        ]


class Purpose(IntEnum):
    """What random numbers are drawn for, part of the file format: never reuse a value. Every
    purpose and index has its own stream under one root seed, so that a draw more for one changes no
    other."""

    PRINT = 0
    TOLERANCE = 1
    EXPOSURE = 2
    LOAD_CELL = 3
    SAMPLING = 4
    SENSOR_PATTERN = 5
    SENSOR = 6

    def stream(self, seed: int, index: int = 0) -> np.random.Generator:
        """Return the generator of this purpose number ``index`` under the root ``seed``."""
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(self), index)))


@cache
def _numbers(part: type[Part]) -> frozenset[str]:
    """Return the keys that take neither truth values nor texts."""

    def other(kind: Any) -> bool:
        return kind in (bool, str, Any) or (isinstance(kind, type) and issubclass(kind, BaseModel))

    fields = part.model_fields.items()
    return frozenset(key for key, field in fields if not any(map(other, _leaves(field.annotation))))


def _leaves(annotation: Any) -> set[Any]:
    return {annotation}.union(*map(_leaves, get_args(annotation)))


def _spelt(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return {key: _spelt(one) for key, one in value.items()}
    return [_spelt(one) for one in value] if isinstance(value, tuple | list) else value


WORDS = {
    "missing": "missing; give a value",
    "extra_forbidden": "unknown key",
    "string_type": "must be a text",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
}
"""What the validation library's errors say, in the words of a recipe."""


def in_words(error: Mapping[str, Any], field: FieldInfo | None = None) -> str:
    """Return a validation error in the words of a recipe; ``field``'s list is the example."""
    kind = str(error["type"])
    if kind == "tuple_type":
        return f"must be a list, such as {_example(field and field.annotation) or '[1, 1]'}"
    facts = error.get("ctx") or {}
    if kind in ("too_short", "too_long") and "field_type" in facts:
        bound = (
            f"at least {facts['min_length']}"
            if kind == "too_short"
            else f"at most {facts['max_length']}"
        )
        return (
            f"must be a list of {bound} values"
            if facts["field_type"] == "Tuple"
            else f"must have {bound} entries"
        )
    return WORDS.get(kind) or str(error["msg"]).removeprefix("Value error, ").replace(
        "Input should be", "must be"
    )


def _example(annotation: Any) -> str:
    """Return a list as a key of a type takes it, empty where that takes none."""
    inside = [each for each in get_args(annotation) if each is not Ellipsis]
    inside *= 2 if Ellipsis in get_args(annotation) else 1
    if get_origin(annotation) is tuple:
        return f"[{', '.join(_example(each) or '1' for each in inside)}]"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "{...}"
    return next((example for each in inside if (example := _example(each)).startswith("[")), "")


def _complaint(error: dict[str, Any], part: type[Part], known: Sequence[str]) -> str:
    key = ".".join(
        str(k) for k in error["loc"] if k != "constrained-float"
    )  # no key: a union's number
    unit = unit_of(str(error["loc"][-1])) if error["loc"] else ""
    message = in_words(error, part.model_fields.get(key))
    if isinstance(error["input"], str) and unit:
        message += f" in {unit}" if error["type"].startswith(("float", "int")) else ""
        unit = ""
    if error["type"] == "extra_forbidden" and len(error["loc"]) == 1:
        message += f"; {did_you_mean(key, known, 'known are ' + ', '.join(known), 0.5)}"
    in_message = isinstance(error["input"], dict) or error["type"] in ("missing", "extra_forbidden")
    given = "" if in_message or not key else f" = {error['input']!r}{' ' + unit if unit else ''}"
    return f"{key}{given}: {message}" if key else message


def _holds_number(value: Any) -> bool:
    if isinstance(value, bool):
        return False
    if isinstance(value, int | float):
        return True
    return isinstance(value, tuple | list) and any(_holds_number(v) for v in value)


LEAST_MM, LEAST_MPA = 1e-6, 1e-6
"""The least length and the least stiffness: a nanometre, one pascal."""

Place = Annotated[float, Field(ge=-1e4, le=1e4)]
"""A coordinate or a motion, mm: ten metres either way."""

Force = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A component of a force or of a torque, N or N mm."""

Angle = Annotated[float, Field(ge=-3600, le=3600)]
"""Degrees: ten turns either way."""

Share = Annotated[float, Field(ge=0, le=1)]
"""Of light: reflectances and shares of a colour."""

Size = Annotated[float, Field(ge=LEAST_MM, le=1000)]
"""How wide, long or thick something is, mm: from a nanometre to a metre."""

Pixel = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A coordinate in a picture, px."""

Flag = Annotated[bool, Field(strict=True)]
"""True or false; a recipe's 1 or "yes" is neither."""

Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Of a lens's distortion, whatever its power."""
