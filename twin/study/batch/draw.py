"""Values drawn for a sample from (root seed, number) alone, and scenes with drawn values in place.

Random sampling takes the numbers u from a stream of the sample's own. Stratified sampling takes
them from one scrambled Sobol' sequence (`scipy.stats.qmc`), whose point number i depends on nothing
but the seed and i: so a dataset is the beginning of every larger one, and any worker can draw any
sample.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, Literal

import numpy as np

from twin.arrays import Floats
from twin.errors import RecipeError, did_you_mean
from twin.parts.scene import Scene
from twin.parts.vary import Distribution, Follows
from twin.streams import Purpose, stream
from twin.study.recipe import ALTERNATIVES, PROVENANCE, validate_scene

Sampling = Literal["stratified", "random"]
Table = dict[str, Any]

_HOLDERS = (*PROVENANCE, "vary", "dataset")


def draws(
    axes: Mapping[str, Distribution],
    seed: int,
    purpose: Purpose,
    sampling: Sampling,
    numbers: Sequence[int],
    apart_from: Mapping[str, Distribution] | None = None,
) -> list[Table]:
    """Return the values of all axes by dotted key, a table for every sample number; keys that
    follow others are left out.

    Axes that are drawn for another purpose are named in ``apart_from``: the same dimension of two
    scrambled sequences is correlated (-0.6 over 64 points), so these take later dimensions.
    """
    width = sum(axis.takes for axis in axes.values())
    taken = sum(axis.takes for axis in (apart_from or {}).values())
    rows = _unit_numbers(seed, purpose, sampling, numbers, width, taken)
    found = []
    for u in rows:
        values = {}
        start = 0
        for key in sorted(axes):
            axis = axes[key]
            if not isinstance(axis, Follows):
                values[key] = axis.at(u[start : start + axis.takes])
                start += axis.takes
        found.append(values)
    return found


def _unit_numbers(
    seed: int, purpose: Purpose, sampling: Sampling, numbers: Sequence[int], width: int, taken: int
) -> Floats:
    """Return (len(numbers), width) numbers in [0, 1), a row for every sample number: of a sequence
    the dimensions after the first ``taken``."""
    if width == 0 or not numbers:
        return np.zeros((len(numbers), width))
    if sampling == "random":
        return np.array([stream(seed, purpose, number).random(width) for number in numbers])
    from scipy.stats import qmc

    sequence = qmc.Sobol(taken + width, scramble=True, rng=stream(seed, purpose))
    first, last = min(numbers), max(numbers)
    with warnings.catch_warnings():  # a part of the sequence need not be a power of two
        warnings.simplefilter("ignore", UserWarning)
        if first:
            sequence.fast_forward(first)
        points = sequence.random(last - first + 1)
    return np.asarray(points[np.asarray(numbers) - first, taken:])


def with_values(
    scene: Scene, values: Mapping[str, Any], follows: Mapping[str, Distribution] | None = None
) -> Scene:
    """Return the scene with other values at dotted keys, validated whole.

    Numbers in a key are places in a list (``press.steps.1.force_n``). Of ``follows`` only the axes
    that follow other keys count.

    Raises
    ------
    RecipeError
        A key is not there, or a value is not allowed.
    """
    table = plain_table(scene)
    put(table, values, follows)
    made = validate_scene(table, "drawn scene")
    return made.model_copy(update={"vary": scene.vary, "dataset": scene.dataset})


def plain_table(scene: Scene) -> Table:
    """Return the scene's plain values, without provenance and without what varies."""
    table: Table = _bare(scene.model_dump(mode="python", exclude=set(_HOLDERS), exclude_none=True))
    return table


def put(
    table: Table, values: Mapping[str, Any], follows: Mapping[str, Distribution] | None = None
) -> None:
    """Put values into a table at dotted keys, then those that follow others.

    A path given to a press replaces the one it had.
    """
    for key, value in values.items():
        _put(table, key, value)
    for key, axis in (follows or {}).items():
        if isinstance(axis, Follows):
            value_of = look_up(table, axis.follows)
            if isinstance(value_of, bool) or not isinstance(value_of, int | float):
                raise RecipeError(
                    f"vary.{key}: follows '{axis.follows}', which is not a number but {value_of!r}"
                )
            _put(table, key, axis.times * value_of + axis.plus)


def _put(table: Table, dotted: str, value: Any) -> None:
    *parents, last = dotted.split(".")
    here: Any = table
    for name in parents:
        here = _step(here, name, dotted)
    if isinstance(here, dict):
        if parents == ["press"] and last in ALTERNATIVES:
            for other in ALTERNATIVES:
                here.pop(other, None)
        here[last] = deepcopy(value)
    else:
        here[_place(here, last, dotted)] = deepcopy(value)


def look_up(table: Table, dotted: str) -> Any:
    """Return the value at a dotted key, or raise `RecipeError`."""
    here: Any = table
    for name in dotted.split("."):
        here = _step(here, name, dotted)
    return here


def _step(here: Any, name: str, dotted: str) -> Any:
    if isinstance(here, dict) and name in here:
        return here[name]
    if isinstance(here, list):
        return here[_place(here, name, dotted)]
    hint = "that is a single value"
    if isinstance(here, dict):
        hint = did_you_mean(name, here, f"known there are {', '.join(here)}")
    raise RecipeError(f"vary.{dotted}: the scene has no '{name}'; {hint}")


def _place(here: Any, name: str, dotted: str) -> int:
    if not isinstance(here, list) or not name.isdigit() or int(name) >= len(here):
        count = len(here) if isinstance(here, list) else 0
        raise RecipeError(
            f"vary.{dotted}: '{name}' is no place in a list of {count} (the first is 0)"
        )
    return int(name)


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if k not in PROVENANCE}
    if isinstance(value, tuple | list):
        return [_bare(v) for v in value]
    return value
