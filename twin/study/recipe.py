"""Recipe files: read, inherit, override, validate, and write back.

A scene is built from up to three files, later ones winning: the body recipe named by ``body.recipe``, the scene named
by ``base`` (one level deep) and the scene itself; then come the overrides. A value that is replaced loses the
provenance of the value it replaces.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.errors import InputError, RecipeError, did_you_mean, require
from twin.parts.scene import Scene
from twin.parts.stl_file import each_file
from twin.parts.vary import flat
from twin.places import MESHES, SCENES
from twin.study.complaints import complaints

PROVENANCE = ("source", "assumed")
ALTERNATIVES = ("steps", "force_n", "indentation_mm")
"""Ways to give a press its path: one of them replaces the others."""
VECTORS = ("force_n", "move_mm", "torque_nmm", "turn_deg")
"""Keys whose value may be a table of components."""

_PICTURE = "which twin reconstruct takes as a frame; twin check and twin view take the folder of a run"
OTHERS = {
    b"\x89PNG": f"a picture (PNG), {_PICTURE}",
    b"\xff\xd8\xff": f"a picture (JPEG), {_PICTURE}",
    b"GIF8": f"a picture (GIF), {_PICTURE}",
    b"PK\x03\x04": "an archive: twin check takes a calibration by its ending .npz, and the folder of a run",
    b"PAR1": "a table (Parquet): twin check and twin view take the folder of the dataset",
    b"{": "JSON: twin check takes the folder of a run or of a dataset",
    b"<": "a page: open it in a browser",
}
"""What else people name, by its first bytes."""

SWEEP = "sweep_"
"""What names of shipped sweeps begin with, which lie beside the scenes."""

Table = dict[str, Any]


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
    path = find_scene(scene)
    table = _read_with_base(path)
    if {"scene", "axes"} <= table.keys():
        raise RecipeError("is a sweep over many designs, not a scene: give it to twin sweep", str(path))
    folders = [path.parent]
    for key, value in (overrides or {}).items():
        require(key, str, "an override's key", "write it with dots, such as material.poisson_ratio")
        _set(table, key, value)
    body = table.get("body")
    if isinstance(body, dict) and "recipe" in body:
        recipe = _find(str(body["recipe"]), MESHES, path.parent, "body recipe", path)
        below = _read(recipe)
        folders.append(recipe.parent)
        if extra := sorted(set(below) - {"body", "material", "title"}):
            raise RecipeError(f"unknown tables {', '.join(extra)}: a body recipe has body, material", str(recipe))
        below.pop("title", None)
        table = _merge(below, {**table, "body": {k: v for k, v in body.items() if k != "recipe"}})
    _find_calibration(table, path)
    _find_solid(table, folders, path)
    _find_probes(table, path)
    _read_intrinsics(table, path)
    if isinstance(table.get("vary"), dict):
        table["vary"] = each_file(flat(table["vary"]), lambda file: _found_file(file, path, "vary.press.probe"))
    return validate_scene(table, str(path))


def _find_calibration(table: Table, path: Path) -> None:
    """Make the calibration file's path absolute: it is relative to the recipe, or names a shipped file."""
    calibration = table.get("calibration")
    if not isinstance(calibration, dict) or not isinstance(calibration.get("file"), str):
        return
    name = calibration["file"]
    for folder in (path.parent, SCENES):
        if (folder / name).is_file():
            table["calibration"] = {**calibration, "file": str((folder / name).resolve())}
            return
    raise RecipeError(
        f"calibration.file = '{name}': there is no such file beside the recipe or the shipped scenes; make it with "
        "twin calibrate, or leave the key out",
        str(path),
    )


def _find_solid(table: Table, folders: list[Path], path: Path) -> None:
    """Make the path of a body's own file absolute: it is relative to the scene, or to the body recipe."""
    body = table.get("body")
    if not isinstance(body, dict) or body.get("shape") != "solid" or not isinstance(body.get("file"), str):
        return
    for folder in folders:
        if (folder / body["file"]).is_file():
            table["body"] = {**body, "file": str((folder / body["file"]).resolve())}
            return
    raise RecipeError(
        f"body.file = '{body['file']}': there is no such file beside the recipe; check the path", str(path)
    )


def _find_probes(table: Table, path: Path) -> None:
    """Make the paths of probes' own files absolute: they are relative to the recipe."""
    press = table.get("press")
    if not isinstance(press, dict):
        return
    also = press.get("also")
    table["press"] = {
        **press,
        **({"also": [_found_probe(p, path, "also.") for p in also]} if isinstance(also, list) else {}),
    }
    table["press"] = _found_probe(table["press"], path, "")


def _found_probe(press: Any, path: Path, which: str) -> Any:
    probe = press.get("probe") if isinstance(press, dict) else None
    if not isinstance(probe, dict) or probe.get("kind") != "stl" or not isinstance(probe.get("file"), str):
        return press
    return {**press, "probe": {**probe, "file": _found_file(probe["file"], path, f"press.{which}probe")}}


def _found_file(file: str, path: Path, which: str) -> str:
    found = path.parent / file
    if not found.is_file():
        told = f"{which}.file = '{file}': there is no such file beside the recipe; check the path"
        raise RecipeError(told, str(path))
    return str(found.resolve())


def _read_intrinsics(table: Table, path: Path) -> None:
    """Put the numbers of the camera's file of intrinsics, relative to the scene, in the place of its name."""
    camera = table.get("camera")
    if not isinstance(camera, dict) or not isinstance(camera.get("intrinsics"), str):
        return
    from twin.study.intrinsics import read_intrinsics

    given = Path(camera["intrinsics"]).expanduser()
    numbers = read_intrinsics(given if given.is_absolute() else path.parent / given)
    camera = {key: value for key, value in camera.items() if key != "intrinsics"}
    for key, value in numbers.items():
        camera[key] = list(value) if isinstance(value, tuple) else value
        _forget_provenance(camera, key)
    for kind in PROVENANCE:
        if isinstance(camera.get(kind), dict):
            camera[kind].pop("intrinsics", None)
    if not isinstance(camera.get("source"), str):
        camera["source"] = {**(camera.get("source") or {}), **dict.fromkeys(numbers, f"file {given.name}")}
    table["camera"] = camera


def validate_scene(table: Table, where: str) -> Scene:
    """Turn a merged table into a `Scene`, or raise one `RecipeError` with all its problems."""
    try:
        return Scene.model_validate(table)
    except ValidationError as problem:
        raise RecipeError(complaints(problem, table), where) from None


def parse_override(text: str) -> tuple[str, Any]:
    """Split ``key.path=value``; the value is TOML, or a bare string.

    Raises
    ------
    InputError
        There is no ``=``.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"-s {text}: write key.path=value, for example -s material.poisson_ratio=0.49")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return key.strip(), value.strip()
    except ValueError as problem:
        raise InputError(f"-s {key}: {problem}") from None


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
    prefix = f"{where}: " if where else ""
    if name and os.path.lexists(given):
        raise InputError(f"{prefix}{what} '{name}': is no file to read, but a folder, a device, or a link to nowhere")
    raise InputError(f"{prefix}{nothing_named(name, known, what)}")


def nothing_named(name: str, known: list[str], what: str) -> str:
    """Return what is said of a name that is neither a file nor one of the shipped recipes."""
    otherwise = f"there is no such file, and shipped ones are: {', '.join(known)}"
    return f"no {what} '{name}': {did_you_mean(Path(name).stem, known, otherwise)}"


def read_recipe(path: Path) -> Table:
    """Return a recipe file's table.

    Raises
    ------
    RecipeError, InputError
        It is not valid TOML, or can't be read.
    """
    return _read(path)


def _read(path: Path) -> Table:
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise InputError(f"{path}: can't be read ({problem.strerror})") from None
    for begins, what in OTHERS.items():
        if data.startswith(begins):
            raise RecipeError(f"is {what}; a scene or a sweep is a text file (TOML)", str(path))
    if len(data) > 1_000_000:
        raise RecipeError(f"{len(data)} bytes: a recipe is at most 1 MB", str(path))
    try:
        return _by_key(tomllib.loads(data.decode()))
    except UnicodeDecodeError as problem:
        raise RecipeError(f"not valid TOML: byte {problem.start + 1} is no text in UTF-8", str(path)) from None
    except (ValueError, RecursionError) as problem:  # a number of 4,300 digits is a ValueError of its own
        raise RecipeError(f"not valid TOML: {problem}", str(path)) from None


def _read_with_base(path: Path) -> Table:
    table = _read(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise RecipeError(f"base = {base!r}: must be the name or path of a scene", str(path))
    base_path = _find(base, SCENES, path.parent, "base scene", path)
    below = _read(base_path)
    if "base" in below:
        raise RecipeError(f"base = '{base}' has a base itself: inheritance is one level deep", str(path))
    _require_material(below, table, base, path)
    return _merge(below, table)


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


def _by_key(table: Table) -> Table:
    """Spell a table-wide provenance text out by key, so that merging can follow single values."""
    spelt = {k: _by_key(v) if isinstance(v, dict) and k not in PROVENANCE else v for k, v in table.items()}
    for kind in PROVENANCE:
        if isinstance(spelt.get(kind), str):
            spelt[kind] = {k: spelt[kind] for k, v in table.items() if k not in PROVENANCE and not isinstance(v, dict)}
    return spelt


def _merge(below: Table, above: Table) -> Table:
    merged = dict(below)
    if set(ALTERNATIVES) & set(above):
        merged = {k: v for k, v in merged.items() if k not in ALTERNATIVES}
    for key, value in above.items():
        if key in PROVENANCE:
            continue
        old = merged.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and _same_kind(old, value):
            merged[key] = _merge(old, value)
        else:
            merged[key] = value
            _forget_provenance(merged, key)
    for kind in PROVENANCE:
        if above.get(kind):
            merged[kind] = {**merged.get(kind, {}), **above[kind]} if isinstance(above[kind], dict) else above[kind]
    return merged


def _same_kind(below: Table, above: Table) -> bool:
    """Another kind of probe, or another shape of body, shares no number with the one below it."""
    return all(above.get(tag, below.get(tag)) == below.get(tag) for tag in ("kind", "shape"))


def _forget_provenance(table: Table, key: str) -> None:
    for kind in PROVENANCE:
        if isinstance(table.get(kind), dict):
            table[kind] = {k: v for k, v in table[kind].items() if k != key}


def _set(table: Table, dotted: str, value: Any) -> None:
    *parents, last = dotted.split(".")
    if parents and parents[-1] in VECTORS:  # press.force_n.z: the vector is one value of its table
        *parents, vector = parents
        here = _table_at(table, parents, dotted)
        old = here.get(vector)
        last, value = vector, {**(old if isinstance(old, dict) else {}), last: value}
    here = _table_at(table, parents, dotted)
    if parents == ["press"] and last in ALTERNATIVES:
        for other in ALTERNATIVES:
            here.pop(other, None)
    here[last] = value
    _forget_provenance(here, last)
    one_value = not isinstance(value, dict) or last in VECTORS
    if last not in PROVENANCE and one_value and parents != ["markers"]:
        here["assumed"] = {**(here.get("assumed") or {}), last: "override"}


def _table_at(table: Table, names: list[str], dotted: str) -> Table:
    """Return the table at ``names``, made or copied on the way."""
    here = table
    for name in names:
        if not isinstance(here.setdefault(name, {}), dict):
            raise RecipeError(f"{dotted}: '{name}' is not a table", "override")
        here[name] = dict(here[name])
        here = here[name]
    return here


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
