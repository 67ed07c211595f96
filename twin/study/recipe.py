"""Scenes: found by path or name, put together from their files and overrides, validated, and written back.

A scene is built from up to three files, later ones winning: the body recipe named by ``body.recipe``, the scene named
by ``base`` (one level deep) and the scene itself; then come the overrides. How tables are laid over each other is in
`twin.study.recipe_tables`, what becomes of the files that they name in `twin.study.recipe_files`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.errors import InputError, RecipeError, did_you_mean, require
from twin.parts.scene import Scene
from twin.places import MESHES, SCENES
from twin.study.complaints import complaints
from twin.study.recipe_files import find_files
from twin.study.recipe_tables import PROVENANCE, Table, merged, override, read_recipe

SWEEP = "sweep_"
"""What names of shipped sweeps begin with, which lie beside the scenes."""


def load_scene(scene: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load a scene with everything it inherits.

    Parameters
    ----------
    scene
        Path of a TOML file, or the name of a shipped scene.
    overrides
        Values by dotted key (``{"material.poisson_ratio": 0.3}``), applied last.

    Raises
    ------
    RecipeError
        With every problem of the scene at once: file, key, value, unit, allowed range.
    InputError
        There is no such file, or an argument is of another kind.
    """
    require(scene, (str, Path), "the scene", "give a shipped scene's name (twin scenes) or a path")
    require(overrides or {}, Mapping, "overrides", 'give values by key, such as {"material.poisson_ratio": 0.3}')
    for key in overrides or {}:
        require(key, str, "an override's key", "write it with dots, such as material.poisson_ratio")
    path = find_scene(scene)
    try:
        return _resolved(path, overrides or {})
    except RecipeError as problem:
        if not overrides or problem.where != str(path):
            raise
        own = _own_problems(path)
        others = [line not in own for line in problem.problems]
        if not any(others):
            raise
        where = f"override of {path}" if all(others) else f"{path} and its overrides"
        raise RecipeError(problem.problems, where) from None


def _own_problems(path: Path) -> list[str]:
    """Return what is wrong with a scene before anything in it is overridden."""
    try:
        _resolved(path, {})
    except RecipeError as problem:
        return problem.problems
    return []


def _resolved(path: Path, overrides: Mapping[str, Any]) -> Scene:
    table = _read_with_base(path)
    if {"scene", "axes"} <= table.keys():
        raise RecipeError("is a sweep over many designs, not a scene: give it to twin sweep", str(path))
    for key, value in overrides.items():
        override(table, key, value)
    folders = [path.parent]
    body = table.get("body")
    if isinstance(body, dict) and "recipe" in body:
        recipe = _find(str(body["recipe"]), MESHES, path.parent, "body recipe", path)
        below = read_recipe(recipe)
        folders.append(recipe.parent)
        if extra := sorted(set(below) - {"body", "material", "title"}):
            raise RecipeError(f"unknown tables {', '.join(extra)}: a body recipe has body, material", str(recipe))
        below.pop("title", None)
        table = merged(below, {**table, "body": {k: v for k, v in body.items() if k != "recipe"}})
    find_files(table, path, folders)
    return validate_scene(table, str(path))


def validate_scene(table: Table, where: str) -> Scene:
    """Turn a merged table into a `Scene`, or raise one `RecipeError` with all its problems."""
    try:
        return Scene.model_validate(table)
    except ValidationError as problem:
        raise RecipeError(complaints(problem, table), where) from None


def shipped_scenes() -> dict[str, Path]:
    """Return the shipped scenes by name; sweeps lie beside them."""
    return {path.stem: path for path in sorted(SCENES.glob("*.toml")) if not path.stem.startswith(SWEEP)}


def find_scene(scene: str | Path) -> Path:
    """Return the file of a scene given by path or by the name of a shipped one."""
    if scene and os.path.isdir(scene):
        raise InputError(f"{scene}: is a folder; give a scene file, such as {Path(scene) / 'scene.toml'}")
    return _find(str(scene), SCENES, Path.cwd(), "scene")


def _find(name: str, shipped: Path, beside: Path, what: str, where: Path | None = None) -> Path:
    given = beside / os.path.expanduser(name)
    for candidate in (given, shipped / f"{name}.toml"):
        if os.path.isfile(candidate):  # Path.is_file raises where a name is too long
            return candidate
    known = [p.stem for p in sorted(shipped.glob("*.toml")) if not p.stem.startswith(SWEEP)]
    told = nothing_named(name, known, what)
    if name and os.path.lexists(given):
        told = f"{what} '{name}': is no file to read, but a folder, a device, or a link to nowhere"
    raise InputError(told) if where is None else RecipeError(told, str(where))


def nothing_named(name: str, known: list[str], what: str) -> str:
    """Return what is said of a name that is neither a file nor one of the shipped recipes."""
    otherwise = f"there is no such file, and shipped ones are: {', '.join(known)}"
    return f"no {what} '{name}': {did_you_mean(Path(name).stem, known, otherwise)}"


def _read_with_base(path: Path) -> Table:
    table = read_recipe(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise RecipeError(f"base = {base!r}: must be the name or path of a scene", str(path))
    base_path = _find(base, SCENES, path.parent, "base scene", path)
    below = read_recipe(base_path)
    if "base" in below:
        raise RecipeError(f"base = '{base}' has a base itself: inheritance is one level deep", str(path))
    _require_material(below, table, base, path)
    return merged(below, table)


def _require_material(below: Table, above: Table, base: str, path: Path) -> None:
    """Refuse a body of its own in place of the base's body recipe, whose material would go with it unsaid."""
    old, new = below.get("body"), above.get("body")
    if not isinstance(old, dict) or not isinstance(new, dict) or "recipe" not in old or "material" in above:
        return
    if "shape" in new and "recipe" not in new:
        raise RecipeError(
            f"body.shape = '{new['shape']}' replaces the body of base '{base}', and with it the recipe "
            f"'{old['recipe']}', which also holds [material]: add a [material] table to this scene, or name a body by "
            "body.recipe",
            str(path),
        )


def dump_scene(scene: Scene) -> str:
    """Return the resolved scene as TOML; reading it back gives the same scene."""
    import tomli_w

    return tomli_w.dumps(_plain(scene.model_dump(mode="python", exclude_none=True)))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if not (k in PROVENANCE and not v)}
    if isinstance(value, tuple | list):
        if any(v is None for v in value):  # a step's (None, None, 1.0): TOML has no null, the table form has
            return {axis: v for axis, v in zip("xyz", value, strict=True) if v is not None}
        return [_plain(v) for v in value]
    return value
