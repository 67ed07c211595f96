"""Sweep files: read, checked against the scene that they change."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.errors import InputError, RecipeError, did_you_mean
from twin.parts.part import Part, in_words, unit_of
from twin.parts.scene import Scene
from twin.parts.sweep import Confirm, Cost, Limits, Loads, Range, Sweep
from twin.places import SCENES
from twin.study.recipe import SWEEP, load_scene, nothing_named
from twin.study.recipe_tables import read_recipe
from twin.study.sweep.designs import check_keys

PARTS: dict[str, type[Part]] = {"axes": Range, "loads": Loads, "confirm": Confirm, "limits": Limits, "cost": Cost}
"""What the tables of a sweep file hold."""


def shipped_sweeps() -> dict[str, Path]:
    """Return the shipped sweeps by name."""
    return {path.stem: path for path in sorted(SCENES.glob(f"{SWEEP}*.toml"))}


def load_sweep(name: str | Path) -> tuple[Sweep, Scene]:
    """Return a sweep, given by path or shipped name, and its scene with ``set`` in place.

    Raises
    ------
    RecipeError
        With every problem of the sweep at once, or of its scene.
    InputError
        There is no such file.
    """
    path = _find(str(name))
    sweep = sweep_of(read_recipe(path), str(path))
    beside = path.parent / sweep.scene
    base = beside if beside.is_file() else sweep.scene
    try:
        scene = load_scene(base, sweep.set)
    except RecipeError as problem:
        load_scene(base)  # if the scene alone is wrong, it is named
        raise RecipeError([f"set.{line}" for line in problem.problems], str(path)) from None
    except InputError as problem:
        raise InputError(f"{path}: scene: {problem}") from None
    check_keys(sweep, scene, str(path))
    return sweep, scene


def is_sweep(path: Path) -> bool:
    """Return whether a recipe is a sweep's: it has axes."""
    return path.suffix == ".toml" and "axes" in read_recipe(path)


def sweep_of(table: dict[str, Any], where: str) -> Sweep:
    """Return the sweep of a table read from ``where``."""
    if "axes" not in table and table.keys() & Scene.model_fields.keys() - Sweep.model_fields.keys():
        raise RecipeError("is a scene, not a sweep over designs: give it to twin run", where)
    try:
        return Sweep.model_validate(table)
    except ValidationError as problem:
        errors: list[dict[str, Any]] = [dict(error) for error in problem.errors(include_url=False)]
        inside = {error["loc"][0] for error in errors if len(error["loc"]) > 1}  # a wrong item shortens its list
        told = [_line(e) for e in errors if not (e["type"] == "too_short" and e["loc"][0] in inside)]
        raise RecipeError(told, where) from None


def _line(error: dict[str, Any]) -> str:
    keys = [str(k) for k in error["loc"] if not str(k).startswith("[")]
    dotted, last = ".".join(keys) or "sweep", keys[-1] if keys else ""
    if error["type"] == "extra_forbidden":
        known = PARTS.get(keys[0], Sweep).model_fields
        every = f"known are {', '.join(known)}"
        return f"{dotted}: unknown key; {did_you_mean(last, known, every)}"
    if error["type"] == "missing":
        return f"{dotted}: missing; give a value"
    told, value, unit = in_words(error), error.get("input"), unit_of(last)
    shown = "" if isinstance(value, dict | Sweep) or not keys else f" = {value!r}{' ' + unit if unit else ''}"
    return f"{dotted}{shown}: {told}"


def _find(name: str) -> Path:
    for candidate in (Path(os.path.expanduser(name)), SCENES / f"{name}.toml", SCENES / f"{SWEEP}{name}.toml"):
        if os.path.isfile(candidate):
            return candidate
    raise InputError(nothing_named(name, list(shipped_sweeps()), "sweep"))
