"""Values drawn for a sample from (root seed, number) alone, and scenes with drawn values in place.

Random sampling takes the numbers u from a stream of the sample's own. Stratified sampling takes
them from one scrambled Sobol' sequence, whose point number i depends on nothing but the seed and i:
so a dataset is the beginning of every larger one, and any worker can draw any sample.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, Literal

import numpy as np

from twin.arrays import Floats, Ints
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
    first, last = min(numbers), max(numbers)
    points = sobol_points(taken + width, np.arange(first, last + 1), stream(seed, purpose))
    return points[np.asarray(numbers) - first, taken:]


_BITS = 30
"""Binary digits of a Sobol' number."""

_DIRECTIONS = (
    (3, 1),
    (7, 1, 3),
    (11, 1, 3, 1),
    (13, 1, 1, 1),
    (19, 1, 1, 3, 3),
    (25, 1, 3, 5, 13),
    (37, 1, 1, 5, 5, 17),
    (41, 1, 1, 5, 5, 5),
    (47, 1, 1, 7, 11, 19),
    (55, 1, 1, 5, 1, 1),
    (59, 1, 1, 1, 3, 11),
    (61, 1, 3, 5, 5, 31),
    (67, 1, 3, 3, 9, 7, 49),
    (91, 1, 1, 1, 15, 21, 21),
    (97, 1, 3, 1, 13, 27, 49),
    (103, 1, 1, 1, 15, 7, 5),
    (109, 1, 3, 1, 15, 13, 25),
    (115, 1, 1, 5, 5, 19, 61),
    (131, 1, 3, 7, 11, 23, 15, 103),
    (137, 1, 3, 7, 13, 13, 15, 69),
    (143, 1, 1, 3, 13, 7, 35, 63),
    (145, 1, 3, 5, 9, 1, 25, 53),
    (157, 1, 3, 1, 13, 9, 35, 107),
    (167, 1, 3, 1, 5, 27, 61, 31),
    (171, 1, 1, 5, 11, 19, 41, 61),
    (185, 1, 3, 5, 3, 3, 13, 69),
    (191, 1, 1, 7, 13, 1, 19, 1),
    (193, 1, 3, 7, 5, 13, 19, 59),
    (203, 1, 1, 3, 9, 25, 29, 41),
    (211, 1, 3, 5, 13, 23, 1, 55),
    (213, 1, 3, 7, 3, 13, 59, 17),
    (229, 1, 3, 1, 3, 5, 53, 69),
    (239, 1, 1, 5, 5, 23, 33, 13),
    (241, 1, 1, 7, 7, 1, 61, 123),
    (247, 1, 1, 7, 9, 13, 61, 49),
    (253, 1, 3, 3, 5, 3, 55, 33),
)
"""Primitive polynomial of each dimension but the first, and its first direction numbers (S. Joe and
F. Y. Kuo, SIAM J. Sci. Comput. 30 (2008) 2635)."""


def sobol_points(dimensions: int, numbers: Ints, rng: np.random.Generator) -> Floats:
    """Return (len(numbers), dimensions) points of a scrambled Sobol' sequence, by their numbers.

    They are those of `scipy.stats.qmc.Sobol`, which takes half a second to import, and serves more
    dimensions than the table here has.
    """
    if dimensions > len(_DIRECTIONS) + 1:
        from scipy.stats import qmc

        with warnings.catch_warnings():  # a part of the sequence need not be a power of two
            warnings.simplefilter("ignore", UserWarning)
            whole = qmc.Sobol(dimensions, scramble=True, rng=rng).random(int(numbers.max()) + 1)
        return np.asarray(whole[numbers])
    own = rng.spawn(1)[0]
    place = np.arange(_BITS)
    digits = own.integers(2, size=(dimensions, _BITS), dtype=np.uint32)
    mixes = own.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32)
    # Point number i combines the direction numbers at the ones of i's Gray code, modulo 2.
    used = (numbers ^ (numbers >> 1))[:, None] >> place & 1
    points = np.empty((len(numbers), dimensions))
    for axis in range(dimensions):
        mix = np.tril(mixes[axis], -1) + np.eye(_BITS, dtype=np.int64)
        ones = _direction_numbers(axis)[:, None] >> place[::-1] & 1
        combined = (used @ (ones @ mix.T) + digits[axis, ::-1]) % 2
        points[:, axis] = combined @ 0.5 ** (place + 1)
    return points


def _direction_numbers(axis: int) -> Ints:
    """Return the (`_BITS`,) direction numbers of a dimension, whole numbers of `_BITS` digits."""
    if axis == 0:
        return 1 << np.arange(_BITS)[::-1]
    polynomial, *found = _DIRECTIONS[axis - 1]
    degree = len(found)
    while len(found) < _BITS:
        new = found[-degree]
        for k in range(1, degree + 1):
            new ^= (polynomial >> (degree - k) & 1) * found[-k] << k
        found.append(new)
    return np.array(found) << np.arange(_BITS)[::-1]


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
    put_all(table, values, follows or {})
    made = validate_scene(table, "drawn scene")
    return made.model_copy(update={"vary": scene.vary, "dataset": scene.dataset})


def plain_table(scene: Scene) -> Table:
    """Return the scene's plain values, without provenance and without what varies."""
    table: Table = _bare(scene.model_dump(mode="python", exclude=set(_HOLDERS), exclude_none=True))
    return table


def put_all(table: Table, values: Mapping[str, Any], follows: Mapping[str, Distribution]) -> None:
    """Put values into a table at dotted keys, then those that follow others."""
    for key, value in values.items():
        put(table, key, value)
    for key, axis in follows.items():
        if isinstance(axis, Follows):
            value_of = look_up(table, axis.follows)
            if isinstance(value_of, bool) or not isinstance(value_of, int | float):
                raise RecipeError(
                    f"vary.{key}: follows '{axis.follows}', which is not a number but {value_of!r}"
                )
            put(table, key, axis.times * value_of + axis.plus)


def put(table: Table, dotted: str, value: Any) -> None:
    """Put a value at a dotted key; a path given to a press replaces the one it had."""
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
