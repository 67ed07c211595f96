"""The designs of a sweep: the recipe file, columns of values by axis, and the scene of each design.

Design number i follows from the recipe alone, so any worker can make it. Columns stay arrays,
because the closed form evaluates a hundred thousand designs a second and a scene takes
milliseconds to validate.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from twin.arrays import Floats
from twin.errors import InputError, RecipeError, did_you_mean
from twin.parts.part import Purpose, in_words, unit_of
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.batch.draw import SceneTable
from twin.study.recipe import find_scene, load_scene, paths_given, read_recipe, validate_scene


@dataclass(frozen=True)
class Designs:
    """Values of m designs of a sweep over a scene: (m,) lists by axis key, and by key that
    follows."""

    sweep: Sweep
    scene: Scene
    columns: Mapping[str, list[Any]]

    @classmethod
    def of(cls, sweep: Sweep, scene: Scene) -> Designs:
        """Return all designs; `RecipeError` for an axis that the scene lacks, or a key that follows
        no number."""
        _check_keys(sweep, scene)
        return cls.at(sweep, scene, _unit(sweep) if sweep.sampling != "grid" else None)

    @classmethod
    def at(cls, sweep: Sweep, scene: Scene, u: Floats | None) -> Designs:
        """Return the designs at (m, axes) numbers in [0, 1), axes in their order; the grid's if
        None."""
        if u is None:
            grids = [axis.grid() for axis in sweep.axes.values()]
            places = np.indices([len(grid) for grid in grids]).reshape(len(grids), -1).tolist()
            lists = [[grid[k] for k in place] for grid, place in zip(grids, places, strict=True)]
        else:
            lists = [axis.at(u[:, number]) for number, axis in enumerate(sweep.axes.values())]
        columns = dict(zip(sweep.axes, lists, strict=True))
        table = SceneTable.of(scene)
        for key, rule in sweep.derived.items():
            names = [rule.follows, *columns]
            followed = next(
                (columns[n] for n in names if n in columns and _matches(n, rule.follows)), None
            )
            if followed is None:
                followed = [table.look_up(rule.follows)] * len(next(iter(columns.values())))
            try:
                columns[key] = [
                    float(f"{rule.times * float(v) + rule.plus:.12g}") for v in followed
                ]
            except (TypeError, ValueError):
                raise RecipeError(
                    f"derived.{key}: follows '{rule.follows}', which is not a number"
                ) from None
        return cls(sweep, scene, columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def values(self, number: int) -> dict[str, Any]:
        """Return a design's values by axis key and by key that follows."""
        return {key: column[number] for key, column in self.columns.items()}

    def swept(self, key: str) -> str | None:
        """Return the axis or derived key by which a scene's key differs between designs; None
        without."""
        named = (*self.sweep.derived, *self.sweep.axes)
        return next((name for name in named if _matches(name, key)), None)

    def numbers(self, key: str, otherwise: float) -> Floats:
        """Return (m,) a number of every design by a scene's key."""
        if (name := self.swept(key)) is not None:
            return np.asarray(self.columns[name], float)
        return np.full(len(self), float(otherwise))

    def scene_of(self, number: int, base: SceneTable | None = None) -> Scene:
        """Return a design's scene, layers keeping their extent; `RecipeError` where a value is not
        allowed."""
        base = base or SceneTable.of(self.scene)
        table = copy.deepcopy(base)
        for name, column in self.columns.items():
            for key in _spelt_out(name, table):
                table.put({key: column[number]})
        for name, layer in table.get("markers", {}).items() if self.sweep.keep_extent else ():
            was = base["markers"][name]
            pitch = float(layer["pitch_mm"])
            for count in ("columns", "rows"):
                if pitch > 0 and not self.swept(f"markers.{name}.{count}"):
                    layer[count] = int(_kept_count(was[count], was["pitch_mm"], np.array(pitch)))
        return validate_scene(table, "design")

    def marker_counts(self, layer: str) -> tuple[Floats, Floats]:
        """Return (m,) columns and rows of a layer's markers, which may keep its extent."""
        own = self.scene.markers[layer]
        pitch = self.numbers(f"markers.{layer}.pitch_mm", own.pitch_mm)

        def counts(name: str, own_count: int) -> Floats:
            key = f"markers.{layer}.{name}"
            if self.sweep.keep_extent and not self.swept(key):
                return _kept_count(own_count, own.pitch_mm, pitch)
            return self.numbers(key, own_count)

        return counts("columns", own.columns), counts("rows", own.rows)


def _matches(name: str, key: str) -> bool:
    """Return whether an axis's name, perhaps with ``*``, means a scene's key."""
    ours, theirs = name.split("."), key.split(".")
    return len(ours) == len(theirs) and all(
        a in ("*", b) for a, b in zip(ours, theirs, strict=True)
    )


def _spelt_out(name: str, table: SceneTable) -> list[str]:
    """Return the scene's keys that an axis's name means."""
    keys = [""]
    for part in name.split("."):
        keys = [
            f"{key}.{each}".lstrip(".")
            for key in keys
            for each in (table.look_up(key) if part == "*" and key else [part])
        ]
    return keys


def _unit(sweep: Sweep) -> Floats:
    from scipy.stats import qmc

    width = len(sweep.axes)
    rng = Purpose.SAMPLING.stream(sweep.seed)
    if sweep.sampling == "random":
        return np.asarray(rng.random((sweep.count, width)))
    if sweep.sampling == "latin":
        return np.asarray(qmc.LatinHypercube(width, rng=rng).random(sweep.count))
    whole = int(np.ceil(np.log2(max(sweep.count, 2))))
    return np.asarray(qmc.Sobol(width, scramble=True, rng=rng).random_base2(whole)[: sweep.count])


def _check_keys(sweep: Sweep, scene: Scene, where: str | None = None) -> None:
    """Refuse, all at once, axes and derived keys that the scene doesn't have, and values that are
    no number."""
    table = SceneTable.of(scene)
    filled = copy.deepcopy(table)
    problems = []
    for part in ("axes", "derived"):
        for name in getattr(sweep, part):
            if name.split(".")[0] in ("title", "seed", "press", "vary", "dataset"):
                problems.append(
                    f"{part}.{name}: {name.split('.')[0]} is no part of a sensor's design"
                )
                continue
            try:
                for key in _spelt_out(name, table):
                    table.look_up(key.rpartition(".")[0] or key)
                    filled.put({key: _telling(sweep, name) if part == "axes" else 1.0})
                    wrong = _wrong_values(sweep, table, name, key)
                    problems += [line for line in wrong if line not in problems]
            except RecipeError as problem:
                problems.append(f"{part}.{name}: {str(problem).split(': ', 1)[-1]}")
    try:
        validate_scene(filled, "design")
    except RecipeError as problem:
        # optional keys are not in the table: only the scene's validation knows them
        for line in problem.problems:
            if "unknown key" in line:
                follows = any(_matches(name, line.split(":")[0]) for name in sweep.derived)
                problems.append(f"{'derived' if follows else 'axes'}.{line}")
            elif "whole number" in line:
                problems.append(f"axes.{line}; set whole = true in a range")
    for key, rule in sweep.derived.items():
        if not any(_matches(name, rule.follows) for name in sweep.axes):
            try:
                table.look_up(rule.follows)
            except RecipeError as problem:
                problems.append(f"derived.{key}.follows: {str(problem).split(': ', 1)[-1]}")
    if problems:
        raise RecipeError(problems, where)


def _telling(sweep: Sweep, name: str) -> Any:
    """Return a value of an axis: one that is no whole number, if there is any."""
    axis = sweep.axes[name]
    values = axis.grid() if sweep.sampling == "grid" else axis.at(np.full(1, 0.37))
    return next((v for v in values if isinstance(v, float) and v % 1), values[0])


def _wrong_values(sweep: Sweep, table: SceneTable, name: str, key: str) -> list[str]:
    """Return the scene's problems with an axis: with texts and lists, and with its least and
    largest number where the key's own range, or that of one that follows it, excludes them."""
    rule = sweep.derived.get(name)
    followed = name if rule is None else rule.follows
    axis = next((sweep.axes[each] for each in sweep.axes if _matches(each, followed)), None)
    values: Sequence[Any] = () if axis is None else axis.ends()
    if rule is not None:
        values = [rule.times * v + rule.plus for v in values if isinstance(v, int | float)]
    found = []
    for value in values:
        changed = copy.deepcopy(table)
        changed.put({key: value})
        try:
            validate_scene(changed, "design")
        except RecipeError as problem:
            part = "axes" if rule is None else "derived"
            wrong = "" if isinstance(value, str | list) else " = "
            found += [
                f"{part}.{line}"
                for line in problem.problems
                if line.startswith(key + wrong) and (not wrong or "(allowed: " in line)
            ]
    return found


def _kept_count(count: int, pitch_mm: float, new_pitch_mm: Floats) -> Floats:
    """Return how many markers at another pitch are about as wide as ``count`` were, of the same
    parity."""
    more = np.rint(((count - 1) * pitch_mm / new_pitch_mm - (count - 1)) / 2)
    return np.asarray(np.maximum(count + 2 * more, 1 + (count - 1) % 2))


def load_sweep(name: str | Path, overrides: Mapping[str, Any] | None = None) -> tuple[Sweep, Scene]:
    """Return a sweep, given by path or shipped name, and its scene with ``set`` in place.

    ``overrides`` are keys of the scene; they go over those of ``set``.

    Raises
    ------
    RecipeError
        With every problem of the sweep at once, or of its scene.
    InputError
        There is no such file.
    """
    path = find_scene(name, "sweep")
    sweep = _sweep_of(read_recipe(path), str(path))
    below = sweep.set
    if overrides and paths_given(overrides):
        replaced = {key for keys in paths_given(below).values() for key in keys}
        below = {key: value for key, value in below.items() if key not in replaced}
    sweep = sweep.model_copy(update={"set": {**below, **(overrides or {})}})
    near = path.parent / sweep.scene
    base = near if near.is_file() else sweep.scene
    try:
        scene = load_scene(base, sweep.set)
    except RecipeError as problem:
        load_scene(base)  # if the scene alone is wrong, it is named
        raise RecipeError([f"set.{line}" for line in problem.problems], str(path)) from None
    except InputError as problem:
        raise InputError(f"{path}: scene: {problem}") from None
    _check_keys(sweep, scene, str(path))
    inverse = scene.reconstruction
    is_linear = inverse is None or inverse.method != "local"
    if not is_linear and "fidelity" not in sweep.model_fields_set:
        sweep = sweep.model_copy(update={"fidelity": ("full",)})
    return sweep, scene


def _sweep_of(table: dict[str, Any], where: str) -> Sweep:
    """Return the sweep of a table read from ``where``."""
    if "axes" not in table and table.keys() & {"base", *Scene.model_fields} - {*Sweep.model_fields}:
        raise RecipeError("is a scene, not a sweep over designs: give it to twin run", where)
    try:
        return Sweep.model_validate(table)
    except ValidationError as problem:
        errors: list[dict[str, Any]] = [dict(error) for error in problem.errors(include_url=False)]
        # a wrong item shortens its list
        wrong = [error["loc"] for error in errors if error["type"] != "too_short"]
        inside = {place[0] for place in wrong if len(place) > 1}
        kept = [e for e in errors if not (e["type"] == "too_short" and e["loc"][0] in inside)]
        raise RecipeError([_line(e) for e in kept], where) from None


def _line(error: dict[str, Any]) -> str:
    keys = [str(k) for k in error["loc"] if not str(k).startswith("[")]
    dotted = ".".join(keys) or "sweep"
    last = keys[-1] if keys else ""
    if error["type"] == "extra_forbidden":
        table = Sweep.Range if keys[0] == "axes" else getattr(Sweep, keys[0].capitalize(), Sweep)
        known = table.model_fields
        hint = did_you_mean(last, known, f"known are {', '.join(known)}")
        return f"{dotted}: unknown key; {hint}"
    if error["type"] == "missing":
        return f"{dotted}: {in_words(error)}"
    value = error.get("input")
    unit = "" if isinstance(value, str) else unit_of(last)
    shown = ""
    if keys and not isinstance(value, dict | Sweep):
        shown = f" = {value!r}{' ' + unit if unit else ''}"
    return f"{dotted}{shown}: {in_words(error)}"
