"""The designs of a sweep: columns of values by axis, and the scene of each.

Design number i is known from the sweep alone, so any worker can make it. Columns stay arrays, because the closed form
judges a hundred thousand designs a second and a scene takes milliseconds to validate.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep, Values
from twin.streams import Purpose, stream
from twin.study.batch.draw import Table, look_up, plain_table, put
from twin.study.recipe import validate_scene


@dataclass(frozen=True)
class Designs:
    """Values of m designs.

    Attributes
    ----------
    sweep, scene
        What is swept, and the scene that designs are changed from.
    columns
        (m,) lists by axis key, and by key that follows.
    """

    sweep: Sweep
    scene: Scene
    columns: Mapping[str, list[Any]]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def values(self, number: int) -> dict[str, Any]:
        """Return a design's values by axis key and by key that follows."""
        return {key: column[number] for key, column in self.columns.items()}

    def numbers(self, key: str, otherwise: float) -> Floats:
        """Return (m,) a number of every design; ``key`` is a scene's, without ``*``."""
        for name in (*self.sweep.derived, *self.sweep.axes):
            if matches(name, key):
                return np.asarray(self.columns[name], float)
        return np.full(len(self), float(otherwise))

    def swept(self, key: str) -> bool:
        """Return whether a scene's key differs between designs."""
        return any(matches(name, key) for name in (*self.sweep.axes, *self.sweep.derived))

    def scene_of(self, number: int, base: Table | None = None) -> Scene:
        """Return a design's scene.

        Raises
        ------
        RecipeError
            A value is not allowed, or the scene has no such key.
        """
        return scene_of(self.sweep, base or plain_table(self.scene), self.values(number))


def matches(name: str, key: str) -> bool:
    """Return whether an axis's name, perhaps with ``*``, means a scene's key."""
    ours, theirs = name.split("."), key.split(".")
    return len(ours) == len(theirs) and all(a in ("*", b) for a, b in zip(ours, theirs, strict=True))


def spelt_out(name: str, table: Table) -> list[str]:
    """Return the scene's keys that an axis's name means."""
    keys = [""]
    for part in name.split("."):
        keys = [
            f"{key}.{each}".lstrip(".")
            for key in keys
            for each in (look_up(table, key) if part == "*" and key else [part])
        ]
    return keys


def designs_of(sweep: Sweep, scene: Scene) -> Designs:
    """Return all designs of a sweep.

    Raises
    ------
    RecipeError
        An axis names a key that the scene does not have, or a key follows what is not a number.
    """
    check_keys(sweep, scene)
    return designs_at(sweep, scene, _unit(sweep) if sweep.sampling != "grid" else None)


def designs_at(sweep: Sweep, scene: Scene, u: Floats | None) -> Designs:
    """Return the designs at (m, axes) numbers in [0, 1), axes in their order; the grid's if None."""
    columns: dict[str, list[Any]] = {}
    if u is None:
        lists = [axis.grid(sweep.count) for axis in sweep.axes.values()]
        places = np.indices([len(values) for values in lists]).reshape(len(lists), -1)
        for (key, _), values, place in zip(sweep.axes.items(), lists, places, strict=True):
            columns[key] = [values[k] for k in place.tolist()]
    else:
        for number, (key, axis) in enumerate(sweep.axes.items()):
            columns[key] = axis.at(u[:, number])
    table = plain_table(scene)
    for key, rule in sweep.derived.items():
        told = columns.get(rule.follows)
        if told is None:
            told = next((columns[name] for name in columns if matches(name, rule.follows)), None)
        if told is None:
            told = [look_up(table, rule.follows)] * len(next(iter(columns.values())))
        try:
            columns[key] = [float(f"{rule.times * float(v) + rule.plus:.12g}") for v in told]
        except (TypeError, ValueError):
            raise RecipeError(f"derived.{key}: follows '{rule.follows}', which is not a number") from None
    return Designs(sweep, scene, columns)


def _unit(sweep: Sweep) -> Floats:
    from scipy.stats import qmc

    width, rng = len(sweep.axes), stream(sweep.seed, Purpose.SAMPLING)
    if sweep.sampling == "random":
        return np.asarray(rng.random((sweep.count, width)))
    if sweep.sampling == "latin":
        return np.asarray(qmc.LatinHypercube(width, rng=rng).random(sweep.count))
    whole = int(np.ceil(np.log2(max(sweep.count, 2))))
    return np.asarray(qmc.Sobol(width, scramble=True, rng=rng).random_base2(whole)[: sweep.count])


def check_keys(sweep: Sweep, scene: Scene, where: str | None = None) -> None:
    """Refuse axes, and keys that follow, that the scene does not have; ``where`` is the sweep's file.

    A number that is not allowed is its design's failure, not the sweep's; what is no number in its place is.

    Raises
    ------
    RecipeError
        With every such key at once.
    """
    table = plain_table(scene)
    filled, problems = copy.deepcopy(table), []
    for part in ("axes", "derived"):
        for name in getattr(sweep, part):
            if name.split(".")[0] in ("title", "seed", "press", "vary", "dataset"):
                problems.append(f"{part}.{name}: {name.split('.')[0]} is no part of a sensor's design")
                continue
            try:
                for key in spelt_out(name, table):
                    look_up(table, key.rpartition(".")[0] or key)
                    put(filled, key, sweep.axes[name].at(np.zeros(1))[0] if part == "axes" else 1.0)
                    problems += _wrong_words(sweep, table, name, key)
            except RecipeError as problem:
                problems.append(f"{part}.{name}: {str(problem).split(': ', 1)[-1]}")
    try:
        validate_scene(filled, "design")
    except RecipeError as problem:  # optional keys are not in the table: only the scene's validation knows them
        for line in problem.problems:
            if "unknown key" in line:
                follows = any(matches(name, line.split(":")[0]) for name in sweep.derived)
                problems.append(f"{'derived' if follows else 'axes'}.{line}")
    for key, rule in sweep.derived.items():
        if not any(matches(name, rule.follows) or name == rule.follows for name in sweep.axes):
            try:
                look_up(table, rule.follows)
            except RecipeError as problem:
                problems.append(f"derived.{key}.follows: {str(problem).split(': ', 1)[-1]}")
    if problems:
        raise RecipeError(problems, where)


def _wrong_words(sweep: Sweep, table: Table, name: str, key: str) -> list[str]:
    """Return what the scene says about an axis's words and lists, which may stand where it takes a number."""
    axis, told = sweep.axes.get(name), []
    for value in axis.values if isinstance(axis, Values) else ():
        if not isinstance(value, int | float):
            changed = copy.deepcopy(table)
            put(changed, key, value)
            try:
                validate_scene(changed, "design")
            except RecipeError as problem:
                told += [f"axes.{line}" for line in problem.problems if line.startswith(key)]
    return told


def scene_of(sweep: Sweep, base: Table, values: Mapping[str, Any]) -> Scene:
    """Return the scene of a design: the base's plain table with the design's values, layers keeping their extent."""
    table = copy.deepcopy(base)
    for name in (*sweep.axes, *sweep.derived):
        for key in spelt_out(name, table):
            put(table, key, values[name])
    if sweep.keep_extent:
        _keep_extent(sweep, base, table)
    return validate_scene(table, "design")


def _keep_extent(sweep: Sweep, base: Table, table: Table) -> None:
    """Change the numbers of columns and rows by even numbers, so that each layer stays about as wide as it was."""
    named = (*sweep.axes, *sweep.derived)
    for name, layer in table.get("markers", {}).items():
        was = base["markers"][name]
        for count in ("columns", "rows"):
            if layer["pitch_mm"] > 0 and not any(matches(axis, f"markers.{name}.{count}") for axis in named):
                layer[count] = int(kept_count(was[count], was["pitch_mm"], np.array(float(layer["pitch_mm"]))))


def kept_count(count: int, pitch_mm: float, new_pitch_mm: Floats) -> Floats:
    """Return how many markers at another pitch are about as wide as ``count`` were: of the same parity, at least 1."""
    more = np.rint(((count - 1) * pitch_mm / new_pitch_mm - (count - 1)) / 2)
    return np.asarray(np.maximum(count + 2 * more, 1 + (count - 1) % 2))


def short(values: Mapping[str, Any], keys: Sequence[str] | None = None) -> str:
    """Return a design's values in a few words."""
    shown = keys if keys is not None else list(values)
    return ", ".join(f"{key} = {values[key]:.4g}" if isinstance(values[key], float) else f"{key} = {values[key]}"
                     for key in shown)  # fmt: skip
