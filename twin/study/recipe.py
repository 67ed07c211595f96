"""Scenes: found by path or name, put together from their files and overrides, validated, written.

A scene is built from several files, later ones winning: the body recipe named by ``body.recipe``,
the scene named by ``base``, with that scene's own base under it, and the scene itself; then come
the overrides. Every value has a provenance of its own (``source`` or ``assumed``), also where a
recipe gives one for a whole table: a replaced value loses its own, and its neighbours keep theirs.

Files that a recipe names (calibration, a body's and probes' surfaces, a camera's intrinsics) lie
next to it, or next to its base; a resolved scene holds whole paths, so that it can be read from
anywhere, and the numbers of the intrinsics themselves.
"""

from __future__ import annotations

import os
import re
import tomllib
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from twin.errors import InputError, RecipeError, TwinError, did_you_mean, require
from twin.files import MESHES, SCENES
from twin.parts.part import in_words, unit_of
from twin.parts.press import BY_AXIS, Step
from twin.parts.scene import Scene
from twin.parts.shape import StlFile
from twin.parts.vary import flat

Table = dict[str, Any]

PROVENANCE = ("source", "assumed")
ALTERNATIVES = ("steps", "force_n", "indentation_mm")
"""Ways to give a press its path: one of them replaces the others."""

_FRAMES = (
    "twin reconstruct takes pictures as frames, twin check REST1 REST2 --scene SCENE two of a "
    "sensor at rest, twin view the folder of a run or of a dataset"
)
_FOLDERS = "twin check and twin view take the folder of a run or of a dataset"

_OTHERS = {
    b"\x89PNG": ("a picture (PNG)", _FRAMES),
    b"\xff\xd8\xff": ("a picture (JPEG)", _FRAMES),
    b"GIF8": ("a picture (GIF)", _FRAMES),
    b"PK\x03\x04": ("an archive", f"twin check takes a calibration (.npz); {_FOLDERS}"),
    b"PAR1": ("a table (Parquet)", _FOLDERS),
    b"{": ("JSON", _FOLDERS),
    b"<": ("a page", "open it in a browser"),
    b"ISO-10303": ("a STEP file", "export an STL file, in mm, from the program that made it"),
}
"""Other files that people name, by their first bytes, with what takes them."""

_SURFACE = (
    "a surface (STL)",
    "name it in a scene, as file of a [body] with shape = 'solid'; twin view shows it "
    "(docs/own_body.md)",
)
"""A binary STL file may begin with anything, so it is known by its ending."""


def read_recipe(path: Path) -> Table:
    """Return a recipe file's table, its provenance by key; `RecipeError` or `InputError` if
    unreadable."""
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise TwinError.unreadable(path, problem) from None
    kinds = [kind for begins, kind in _OTHERS.items() if data.startswith(begins)]
    if path.suffix.lower() == ".stl":
        kinds = [_SURFACE]
    for what, remedy in kinds:
        raise RecipeError(
            f"is {what}, and a scene or a sweep is a text file (TOML); {remedy}", str(path)
        )
    if len(data) > 1_000_000:
        raise RecipeError(f"{len(data)} bytes: a recipe is at most 1 MB", str(path))
    if not data.strip():
        text = "is empty: begin with base = 'gelpad_press', or let twin scenes --new write a recipe"
        raise RecipeError(text, str(path))
    kind = "" if path.suffix == ".toml" else "; a scene or a sweep is a text file, NAME.toml"
    try:
        # editors on Windows write a byte order mark
        table = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as problem:
        text = f"byte {problem.start + 1} is no text in UTF-8; save the file in this encoding"
        raise RecipeError(f"not valid TOML: {text}{kind}", str(path)) from None
    except (ValueError, RecursionError) as problem:  # a number of 4,300 digits: a ValueError
        if re.search(rb"(?m)^[^#\"'\[{]*=\s*[-+]?\d+,\d", data):
            kind += "; numbers have a point, such as 0.15, not a comma"
        raise RecipeError(f"not valid TOML: {problem}{kind}", str(path)) from None
    picture = table.get("picture")
    if isinstance(picture, dict) and picture.keys() == {"renderer"} and "renderer" not in table:
        table = {k: v for k, v in table.items() if k != "picture"} | picture
    try:
        return _by_key(table)
    except RecursionError:  # tables of a dotted header are read without recursion
        raise RecipeError("its tables lie hundreds deep, a recipe's a few", str(path)) from None


def _by_key(table: Table) -> Table:
    """Spell a table-wide provenance text out by key, so that merging can follow single values."""
    spelt = {
        k: _by_key(v) if isinstance(v, dict) and k not in PROVENANCE else v
        for k, v in table.items()
    }
    for kind in PROVENANCE:
        if isinstance(spelt.get(kind), str):
            spelt[kind] = {
                k: spelt[kind]
                for k, v in table.items()
                if k not in PROVENANCE and not isinstance(v, dict)
            }
    return spelt


def _merged(below: Table, above: Table) -> Table:
    """Return a table with another laid over it; neither is changed."""
    table = dict(below)
    if set(ALTERNATIVES) & set(above):
        table = {k: v for k, v in table.items() if k not in ALTERNATIVES}
    for key, value in above.items():
        if key in PROVENANCE:
            continue
        old = table.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and _same_kind(old, value):
            table[key] = _merged(old, value)
        else:
            table[key] = value
            _forget_provenance(table, key)
    for kind in PROVENANCE:
        if above.get(kind):
            given = above[kind]
            table[kind] = {**table.get(kind, {}), **given} if isinstance(given, dict) else given
    return table


def _same_kind(below: Table, above: Table) -> bool:
    """Return whether the probe's kind or the body's shape stays: another one shares no number."""
    return all(above.get(tag, below.get(tag)) == below.get(tag) for tag in ("kind", "shape"))


def _forget_provenance(table: Table, key: str) -> None:
    """Drop the provenance of the value of ``key``."""
    for kind in PROVENANCE:
        if isinstance(table.get(kind), dict):
            table[kind] = {k: v for k, v in table[kind].items() if k != key}


def _settled(table: Table, given: Iterable[str]) -> Table:
    """Return a table whose [vary] leaves alone what is ``given`` a value later, by dotted keys."""
    vary = table.get("vary")
    if not isinstance(vary, dict):
        return table
    keys = [f"{key}." for key in given]
    left = {
        name: axis
        for name, axis in flat(vary).items()
        if not any(key.startswith(f"{name}.") or f"{name}.".startswith(key) for key in keys)
    }
    return {**table, "vary": left}


def _override(table: Table, dotted: str, value: Any) -> None:
    """Put a value at a dotted key, and note that it is assumed; refuse a key through a value."""
    *parents, last = ["renderer"] if dotted == "picture.renderer" else dotted.split(".")
    if parents and parents[-1] in BY_AXIS:  # press.force_n.z: the vector is one value of its table
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
    one_value = not isinstance(value, dict) or last in BY_AXIS
    if last not in PROVENANCE and one_value and parents != ["markers"]:
        here["assumed"] = {**(here.get("assumed") or {}), last: "override"}


def paths_given(overrides: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the keys among overrides that give the press its path, by the way in which they do."""
    found: dict[str, list[str]] = {}
    for key, value in overrides.items():
        way = ".".join(key.split(".")[:2])
        if value is not None and way in {f"press.{each}" for each in ALTERNATIVES}:
            found.setdefault(way, []).append(key)
    return found


def _table_at(table: Table, names: list[str], dotted: str) -> Table:
    """Return the table at ``names``, made or copied on the way."""
    here = table
    for name in names:
        if not isinstance(here.setdefault(name, {}), dict):
            what = "a list: give it whole" if isinstance(here[name], list) else "not a table"
            raise RecipeError(f"{dotted}: '{name}' is {what}", "override")
        here[name] = dict(here[name])
        here = here[name]
    return here


def parse_overrides(texts: Sequence[str]) -> Table:
    """Return the values of ``key.path=value`` by key, in their order; a value is TOML, or a bare
    string. `InputError` where one can't be read, or would silently replace another."""
    found: Table = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not key:
            raise InputError(
                f"-s {text}: write key.path=value, for example -s material.poisson_ratio=0.49"
            )
        try:
            given = tomllib.loads(f"value = {value}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError) as problem:
            if value.startswith(("[", "{")):
                raise InputError(
                    f"-s {key}: {value} is no list or table as TOML writes it ({problem}); numbers "
                    "need a digit before the point, text needs quotes"
                ) from None
            given = value
        except ValueError as problem:
            raise InputError(f"-s {key}: {problem}") from None
        if key in found and given != found[key]:
            both = f"{found[key]!r} and {given!r}"
            raise InputError(f"{key} is given twice, as {both}: leave one out")
        for before in found:
            if before.startswith(f"{key}."):
                raise InputError(f"-s {key} comes after -s {before} and replaces it: put it first")
        found[key] = given
    return found


def _find_files(table: Table, path: Path, folders: Sequence[Path]) -> None:
    """Replace files' names by whole paths found in ``folders``, and a camera's file by its
    numbers."""

    def found(holder: Any, where: str, remedy: str = "; check the path", *more: Path) -> Any:
        """Return a table with the whole path of its file, if it names one."""
        if not isinstance(holder, dict) or not isinstance(holder.get("file"), str):
            return holder
        for folder in (*folders, *more):
            if (folder / holder["file"]).is_file():
                return {**holder, "file": str((folder / holder["file"]).resolve())}
        raise RecipeError(
            f"{where}.file = '{holder['file']}': there is no such file next to the recipe{remedy}",
            str(path),
        )

    def probe_found(press: Any, where: str) -> Any:
        probe = press.get("probe") if isinstance(press, dict) else None
        if not isinstance(probe, dict) or probe.get("kind") != "stl":
            return press
        return {**press, "probe": found(probe, f"{where}probe")}

    if "calibration" in table:
        remedy = " or the shipped scenes; make it with twin calibrate, or leave the key out"
        table["calibration"] = found(table["calibration"], "calibration", remedy, SCENES)
    if isinstance(table.get("body"), dict) and table["body"].get("shape") == "solid":
        table["body"] = found(table["body"], "body")
    press = table.get("press")
    if isinstance(press, dict):
        if isinstance(press.get("also"), list):
            press = {**press, "also": [probe_found(p, "press.also.") for p in press["also"]]}
        table["press"] = probe_found(press, "press.")
    _read_intrinsics(table, path, folders)
    if isinstance(table.get("vary"), dict):
        key = "vary.press.probe"
        table["vary"] = StlFile.renamed(
            flat(table["vary"]), lambda file: found({"file": file}, key)["file"]
        )


def _read_intrinsics(table: Table, path: Path, folders: Sequence[Path]) -> None:
    """Put the numbers of the camera's file of intrinsics in the place of its name."""
    camera = table.get("camera")
    if not isinstance(camera, dict) or "intrinsics" not in camera:
        return
    from twin.study.intrinsics import read_intrinsics

    given = Path(str(camera["intrinsics"])).expanduser()
    places = [folder / given for folder in folders]
    try:
        numbers = read_intrinsics(next(filter(Path.is_file, places), places[0]))
    except InputError as problem:
        raise RecipeError(f"camera.intrinsics: {problem}", str(path)) from None
    camera = {key: value for key, value in camera.items() if key != "intrinsics"}
    for key, value in numbers.items():
        camera[key] = list(value) if isinstance(value, tuple) else value
        _forget_provenance(camera, key)
    for kind in PROVENANCE:
        if isinstance(camera.get(kind), dict):
            camera[kind].pop("intrinsics", None)
    if not isinstance(camera.get("source"), str):
        camera["source"] = {
            **(camera.get("source") or {}),
            **dict.fromkeys(numbers, f"file {given.name}"),
        }
    table["camera"] = camera


SWEEP = "sweep_"
"""What names of shipped sweeps begin with, which lie among the scenes."""


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

    Examples
    --------
    >>> import twin
    >>> scene = twin.load_scene("block_bare", {"material.poisson_ratio": 0.3})
    >>> scene.material.poisson_ratio
    0.3
    """
    require(scene, (str, Path), "the scene", "give a shipped scene's name (twin scenes) or a path")
    require(
        overrides or {},
        Mapping,
        "overrides",
        'give values by key, such as {"material.poisson_ratio": 0.3}',
    )
    for key in overrides or {}:
        require(key, str, "an override's key", "write it with dots, such as material.poisson_ratio")
    if len(ways := paths_given(overrides or {})) > 1:
        raise InputError(
            f"overrides: {' and '.join(ways)} are given together, and a press has one path: leave "
            "the others out"
        )
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
        where = f"override of {scene}" if all(others) else f"{scene} and its overrides"
        raise RecipeError(problem.problems, where) from None


def _own_problems(path: Path) -> list[str]:
    """Return what is wrong with a scene before anything in it is overridden."""
    try:
        _resolved(path, {})
    except RecipeError as problem:
        return problem.problems
    return []


def _resolved(path: Path, overrides: Mapping[str, Any]) -> Scene:
    table, folders = _read_with_bases(path)
    if {"scene", "axes"} <= table.keys():
        raise RecipeError(
            "is a sweep over many designs, not a scene: give it to twin sweep", str(path)
        )
    if "material" not in {*table, *(key.partition(".")[0] for key in overrides)}:
        _require_material(table, overrides, path.stem, path)
    layers = [*(table.get("markers") or {})]
    added = [each for each in overrides if re.fullmatch(r"markers\.[^.]+\.[^.]+", each)]
    added = [each for each in added if each.split(".")[1] not in layers]
    if len(added) == 1:  # a new layer needs more
        name = added[0].split(".")[1]
        hint = did_you_mean(name, layers, f"its layers are {', '.join(layers) or 'none'}")
        raise RecipeError(f"{added[0]}: the scene has no markers.{name}; {hint}", "override")
    table = _settled(table, overrides)
    for key, value in overrides.items():
        _override(table, key, value)
    body = table.get("body")
    if isinstance(body, dict) and "recipe" in body:
        recipe = _find(str(body["recipe"]), folders, "body recipe", path)
        below = read_recipe(recipe)
        folders.append(recipe.parent)
        if extra := sorted(set(below) - {"body", "material", "title"}):
            raise RecipeError(
                f"unknown tables {', '.join(extra)}: a body recipe has body, material", str(recipe)
            )
        below.pop("title", None)
        table = _merged(below, {**table, "body": {k: v for k, v in body.items() if k != "recipe"}})
    _find_files(table, path, folders)
    return validate_scene(table, str(path))


def validate_scene(table: Table, where: str) -> Scene:
    """Turn a merged table into a `Scene`, or raise one `RecipeError` with all its problems."""
    try:
        return Scene.model_validate(table)
    except ValidationError as problem:
        raise RecipeError(_complaints(problem, table), where) from None


def _complaints(problem: ValidationError, table: Mapping[str, Any]) -> list[str]:
    """Return one line for every error of a failed validation of ``table`` as a `Scene`."""
    errors = [dict(error) for error in problem.errors(include_url=False)]
    errors = [error for error in errors if not _is_other_word(error, errors)]
    if any(error["loc"] == ("body",) for error in errors):  # a body's recipe brings its material
        errors = [error for error in errors if error["loc"] != ("material",)]
    return [_line(error, table) for error in _nearest(errors, table)]


def _is_other_word(error: dict[str, Any], errors: list[dict[str, Any]]) -> bool:
    """Return whether an error is about a word in place of numbers, whose range is more useful."""
    if error["type"] != "literal_error" or isinstance(error.get("input"), str):
        return False
    key = error["loc"][:-1]
    return any(other is not error and other["loc"][: len(key)] == key for other in errors)


def _nearest(errors: list[dict[str, Any]], table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Keep, of a value that fits no kind, the errors of the kind that it is nearest to."""
    by_value: dict[tuple[Any, ...], dict[Any, list[dict[str, Any]]]] = {}
    for error in errors:
        # without the tags of distributions, of which there is one for a value
        loc = tuple(part for part in error["loc"] if not str(part).startswith("["))
        keys = _keys(loc, table)
        place = next(
            (i for i, part in enumerate(loc) if i >= len(keys) or keys[i] != part), len(loc)
        )
        kind = loc[place] if place < len(loc) else None
        by_value.setdefault(loc[:place], {}).setdefault(kind, []).append(error)
    kept: list[dict[str, Any]] = []
    for kinds in by_value.values():
        plain = kinds.pop(None, [])
        far = {kind: (len(some), -max(len(e["loc"]) for e in some)) for kind, some in kinds.items()}
        near = [some for kind, some in kinds.items() if far[kind] == min(far.values())]
        if len(near) > 1 and len(near[0]) == 1:
            # the value is none of them: what each wants, in one line
            words = {
                some[0]["type"]: _worded(some[0], table).removeprefix("must be ") for some in near
            }
            plain.append(
                {**near[-1][0], "type": "", "msg": "must be " + " or ".join(words.values())}
            )
        else:
            plain += [error for some in near for error in some]
        kept += plain
    return kept


def _worded(error: dict[str, Any], table: Mapping[str, Any]) -> str:
    """Return `in_words` with an example of the list that a key takes."""
    return in_words(error, _field_at(_keys(error["loc"], table), table))


def _field_at(keys: list[Any], table: Mapping[str, Any]) -> FieldInfo | None:
    """Return what the description of a key is."""
    model = _model_at(keys[:-1], table) if keys else None
    return None if model is None else model.model_fields.get(str(keys[-1]))


def _line(error: dict[str, Any], table: Mapping[str, Any]) -> str:
    keys = _keys(error["loc"], table)
    dotted = _dotted(keys) or "scene"
    last = str(keys[-1]) if keys else ""
    if error["type"] == "extra_forbidden":
        known = _known_keys(keys[:-1], table)
        hint = did_you_mean(last, known, f"known are {', '.join(known)}", 0.5)
        if "steps" in known and last in Step.model_fields:
            given = "{z = 1}" if last in BY_AXIS else "1"
            hint = (
                f"it belongs to a step of the path: steps = [{{force_n = {{z = 1}}}}, {{{last} = "
                f"{given}}}]"
            )
        hint = _belongs_to(keys) or hint
        if dotted == "base":
            hint = "a scene file names its base; give that file in this scene's place"
        if dotted == "camera.fov_deg":
            hint = "give focal_px; twin scenes --new --fov-deg computes it from a field of view"
        return f"{dotted}: unknown key; {hint}"
    if error["type"] == "missing":
        return f"{dotted}: missing; {_wanted(keys, table)}"
    if error["type"] == "union_tag_not_found":
        return f"{dotted}: {_wanted(keys, table)}"
    message = _worded(error, table)
    if error["type"] == "tuple_type" and last in ("force_n", "move_mm"):
        message = "must name its components, such as {z = 1}"
    if error["type"] == "union_tag_invalid":
        context = error["ctx"]
        dotted = f"{dotted}.{context['discriminator'].strip(chr(39))} = '{context['tag']}'"
        return f"{dotted}: must be one of {context['expected_tags']}"
    value = error.get("input")
    if isinstance(value, dict | BaseModel):
        return f"{dotted}: {message}"
    unit = next((u for u in (unit_of(str(k)) for k in reversed(keys)) if u), "")
    shown = f"'{value}'" if isinstance(value, str) else f"{value!r} {unit}".rstrip()
    if unit and error["type"].startswith(("greater_than", "less_than")):
        message = f"{message} {unit}"
    allowed = _range(keys, table, unit)
    if isinstance(value, str) and error["type"].startswith(("float", "int")) and not allowed:
        message += f" in {unit}" if unit else ""
    return f"{dotted} = {shown}: {message}" + (f" (allowed: {allowed})" if allowed else "")


def _belongs_to(keys: list[Any]) -> str:
    """Return to which other shape of body or kind of probe an unknown key belongs, if to any."""
    field = _field_at(keys[:-1], {})
    for model in _models_in(field.annotation) if field is not None else []:
        for tag in _tags(model) if keys[-1] in model.model_fields else ():
            return f"it belongs to {tag} = '{model.model_fields[tag].default}'"
    return ""


def _wanted(keys: list[Any], table: Mapping[str, Any]) -> str:
    """Return what a missing value may be."""
    field = _field_at(keys, table)
    kinds = _models_in(field.annotation) if field is not None else []
    if len(kinds) > 1:
        tags = [(key, kind.model_fields[key].default) for kind in kinds for key in _tags(kind)]
        known = " or ".join(f"'{word}'" for _, word in tags)
        return f"give a table with {tags[0][0]} = {known}"
    if kinds:
        return f"give a table with keys of {', '.join(_known_keys(keys, table))}"
    if field is not None and (words := _words(field.annotation)):
        return f"give {' or '.join(words)}"
    unit = unit_of(str(keys[-1]))
    allowed = _range(keys, table, unit)
    return "give a value" + (f" in {unit}" if unit else "") + (f", {allowed}" if allowed else "")


def _dotted(keys: list[Any]) -> str:
    """Return keys as recipes write them: parts of a vector are named, not numbered."""
    named = [
        "xyz"[key] if key in (0, 1, 2) and before in BY_AXIS else str(key)
        for before, key in zip([None, *keys], keys, strict=False)
    ]
    return ".".join(named)


def _range(keys: list[Any], table: Mapping[str, Any], unit: str) -> str:
    """Return the allowed interval of a number, or an empty string."""
    field = _field_at(keys, table)
    if field is None:
        return ""
    members = typing.get_args(field.annotation)
    numbers = [m for m in members if typing.get_origin(m) is typing.Annotated]
    others = [each for number in numbers for each in number.__metadata__]
    rules = [*field.metadata, *(r for each in others for r in getattr(each, "metadata", [each]))]
    low, high = (
        next(
            (v for rule in rules for n in names if (v := getattr(rule, n, None)) is not None), None
        )
        for names in (("gt", "ge"), ("lt", "le"))
    )
    if low is None or high is None:
        return ""
    words = _words(field.annotation)
    return " or ".join([f"{low:g} to {high:g}{' ' + unit if unit else ''}", *words])


def _words(annotation: Any) -> list[str]:
    """Return the words, in quotes, that may be given, or may stand in a number's place."""
    kinds = (annotation, *typing.get_args(annotation))
    found = [kind for kind in kinds if typing.get_origin(kind) is typing.Literal]
    return [f"'{word}'" for literal in found for word in typing.get_args(literal)]


def _keys(location: tuple[Any, ...], table: Any) -> list[Any]:
    """Drop the union tags that the validator puts among the keys."""
    keys: list[Any] = []
    here = table
    for position, part in enumerate(location):
        if isinstance(here, Mapping):
            is_tag = part in (here.get("kind"), here.get("shape")) and part not in here
            if is_tag or (part not in here and str(part).endswith("]")):
                continue
            keys.append(part)
            here = here.get(part)
        elif isinstance(here, list | tuple) and isinstance(part, int):
            keys.append(part)
            here = here[part] if part < len(here) else None
        elif position == 0:
            keys.append(part)
    return keys


def _known_keys(keys: list[Any], table: Mapping[str, Any]) -> list[str]:
    model = _model_at(keys, table)
    known = [k for k in model.model_fields if k not in {"source", "assumed"}] if model else []
    return known + (["base"] if not keys else []) + (["recipe"] if keys == ["body"] else [])


def _model_at(keys: list[Any], table: Any) -> type[BaseModel] | None:
    """Return the description that lives at ``keys``."""
    model: Any = Scene
    here = table
    for key in keys:
        here = (
            here.get(key)
            if isinstance(here, Mapping)
            else here[key]
            if isinstance(here, list | tuple)
            else None
        )
        if isinstance(model, type) and issubclass(model, BaseModel):
            field = model.model_fields.get(str(key))
            model = field.annotation if field else None
        else:  # dict[str, Part] or tuple[Part, ...]
            model = next(
                (a for a in typing.get_args(model) if a is not Ellipsis and a is not str), None
            )
        model = _choose(model, here)
    return model if isinstance(model, type) and issubclass(model, BaseModel) else None


def _choose(annotation: Any, value: Any) -> Any:
    """Pick the member of a union that the value's tag names."""
    if typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    if typing.get_origin(annotation) in {typing.Union, types.UnionType}:
        members = [_choose(a, value) for a in typing.get_args(annotation) if a is not type(None)]
        models = _models_in(annotation)
        tag = (value.get("kind") or value.get("shape")) if isinstance(value, Mapping) else None
        named = (m for m in models if tag in [m.model_fields[k].default for k in _tags(m)])
        return next(named, models[0] if models else members[0])
    return annotation


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the descriptions that a value may follow."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if typing.get_origin(annotation) is typing.Annotated:
        return _models_in(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) in {typing.Union, types.UnionType}:
        return [model for each in typing.get_args(annotation) for model in _models_in(each)]
    return []


def _tags(model: type[BaseModel]) -> list[str]:
    """Return the keys whose value names a description among others."""
    fields = model.model_fields
    return [key for key in ("kind", "shape") if key in fields and not fields[key].is_required()]


def shipped_scenes() -> dict[str, Path]:
    """Return the shipped scenes by name; sweeps lie among them."""
    return {
        path.stem: path for path in sorted(SCENES.glob("*.toml")) if not path.stem.startswith(SWEEP)
    }


def find_scene(scene: str | Path, what: str = "scene") -> Path:
    """Return the file of a scene, or of a "sweep", by path or shipped name, whose first part may be
    left out. A folder hides no shipped scene of its name."""
    if what == "scene" and scene and os.path.isdir(scene) and str(scene) not in shipped_scenes():
        raise InputError(
            f"{scene}: is a folder; give a scene file, such as {Path(scene) / 'scene.toml'}"
        )
    return _find(str(scene), [Path()], what)


def _find(name: str, near: Sequence[Path], what: str, where: Path | None = None) -> Path:
    is_sweep = what == "sweep"
    given = [each / os.path.expanduser(name) for each in near]
    folder = MESHES if what == "body recipe" else SCENES
    shipped = [folder / f"{first}{name}.toml" for first in ("", *[SWEEP] * is_sweep)]
    for candidate in (*given, *shipped):
        if os.path.isfile(candidate):  # Path.is_file raises where a name is too long
            return candidate
    known = [p.stem for p in sorted(folder.glob("*.toml")) if p.stem.startswith(SWEEP) == is_sweep]
    files = {file.stem: file.name for file in given[0].absolute().parent.glob("*.toml")}
    otherwise = f"there is no such file, and shipped ones are: {', '.join(known)}"
    text = f"no {what} '{name}': {did_you_mean(Path(name).stem, known, otherwise, files=files)}"
    if name and any(os.path.lexists(file) for file in given):
        text = f"{what} '{name}': is no file to read, but a folder, a device, or a link to nowhere"
    raise InputError(text) if where is None else RecipeError(text, str(where))


def _read_with_bases(path: Path, above: Sequence[Path] = ()) -> tuple[Table, list[Path]]:
    """Return a scene's table over those of its bases, and their folders; ``above`` build on it."""
    table = read_recipe(path)
    base = table.pop("base", None)
    if base is None:
        return table, [path.parent]
    if not isinstance(base, str):
        raise RecipeError(f"base = {base!r}: must be the name or path of a scene", str(path))
    base_path = _find(base, [path.parent], "base scene", path)
    chain = [*above, path]
    if any(base_path.samefile(each) for each in chain):
        raise RecipeError(f"base = '{base}': a scene can't be its own base", str(path))
    below, folders = _read_with_bases(base_path, chain)
    _require_material(below, table, base, path)
    return _merged(_settled(below, flat(table, lambda _: False)), table), [path.parent, *folders]


def _require_material(below: Table, above: Mapping[str, Any], base: str, path: Path) -> None:
    """Refuse to replace the base's body recipe by a shape alone: its material would be lost."""
    old, new = below.get("body"), above.get("body")
    if not isinstance(old, dict) or not isinstance(new, dict):
        return
    if "recipe" in old and "material" not in above and "shape" in new and "recipe" not in new:
        raise RecipeError(
            f"body.shape = '{new['shape']}' replaces the body of base '{base}', and with it the "
            f"recipe '{old['recipe']}', which also holds [material]: give a [material] table, too, "
            "or name a body by body.recipe",
            str(path),
        )
