"""The schema of scene files: as JSON for editors, and validation errors in the recipe's words.

``python -m twin.study.schema`` writes scenes/scene.schema.json. It describes a file, not a resolved
scene: ``base`` and ``body.recipe`` may supply anything, so nothing is required, and a step's forces
may be given as a table.
"""

from __future__ import annotations

import json
import types
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.errors import did_you_mean
from twin.files import SCENES
from twin.parts.part import in_words, unit_of
from twin.parts.press import BY_AXIS, Step
from twin.parts.scene import Scene

SCHEMA_FILE = SCENES / "scene.schema.json"


def _schema_text() -> str:
    """Return the schema file's text: the JSON schema (draft 2020-12) of a scene file."""
    schema = Scene.model_json_schema()
    for definition in [schema, *schema["$defs"].values()]:
        definition.pop("required", None)
        if "description" in definition:  # Python's examples are not for recipes
            definition["description"] = definition["description"].partition("\n\nExamples\n")[0]
    schema["properties"]["base"] = {
        "type": "string",
        "description": "scene to inherit from, which may have a base itself",
    }
    recipe = {"type": "string", "description": "body recipe of the meshes folder"}
    for name in ("Block", "Dome", "Finger", "Solid"):
        schema["$defs"][name]["properties"]["recipe"] = recipe
    schema["$defs"]["Camera"]["properties"]["intrinsics"] = {
        "type": "string",
        "description": "file of size, focal length, principal point and distortion as OpenCV "
        "writes it (YAML, JSON)",
    }
    schema["properties"]["body"] = {"anyOf": schema["properties"]["body"]["oneOf"]}
    axes = {
        "type": "object",
        "additionalProperties": False,
        "properties": {a: {"type": "number"} for a in "xyz"},
    }
    for name, keys in (("Step", BY_AXIS), ("Press", ("force_n", "tilt_deg"))):
        properties = schema["$defs"][name]["properties"]
        properties.update({key: {"anyOf": [axes, properties[key]]} for key in keys})
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "twin scene"}
    return json.dumps({**head, **schema}, indent=1) + "\n"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(_schema_text())


def complaints(problem: ValidationError, table: Mapping[str, Any]) -> list[str]:
    """Return one line for every error of a failed validation of ``table`` as a `Scene`."""
    errors = [dict(error) for error in problem.errors(include_url=False)]
    errors = [error for error in errors if not _is_other_word(error, errors)]
    return [_line(error, table) for error in _nearest(errors, table)]


def _is_other_word(error: dict[str, Any], errors: list[dict[str, Any]]) -> bool:
    """Return whether an error is about a word that may stand in place of a number: the
    number's range is more useful."""
    if error["type"] != "literal_error" or isinstance(error.get("input"), str):
        return False
    return any(other is not error and other["loc"][:-1] == error["loc"][:-1] for other in errors)


def _nearest(errors: list[dict[str, Any]], table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Keep, of a value that fits none of the kinds it may be of, the errors of the kind that it
    is nearest to."""
    by_value: dict[tuple[Any, ...], dict[Any, list[dict[str, Any]]]] = {}
    for error in errors:
        loc = error["loc"]
        keys = _keys(error["loc"], table)
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
            words = {some[0]["type"]: in_words(some[0]).removeprefix("must be ") for some in near}
            plain.append(
                {**near[-1][0], "type": "", "msg": "must be " + " or ".join(words.values())}
            )
        else:
            plain += [error for some in near for error in some]
        kept += plain
    return kept


def _line(error: dict[str, Any], table: Mapping[str, Any]) -> str:
    keys = _keys(error["loc"], table)
    dotted = _dotted(keys) or "scene"
    last = str(keys[-1]) if keys else ""
    if error["type"] == "extra_forbidden":
        known = _known_keys(keys[:-1], table)
        hint = did_you_mean(last, known, f"known are {', '.join(known)}", 0.5)
        if "steps" in known and last in Step.model_fields:
            hint = (
                f"it belongs to a step of the path: steps = [{{force_n = {{z = 1}}}}, {{{last} = "
                "{z = 1}}]"
            )
        return f"{dotted}: unknown key; {hint}"
    if error["type"] == "missing":
        return f"{dotted}: missing; {_wanted(keys, table)}"
    message = in_words(error)
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
    shown = f"'{value}'" if isinstance(value, str) else repr(value)
    if unit and error["type"].startswith(("greater_than", "less_than")):
        message = f"{message} {unit}"
    allowed = _range(keys, table, unit)
    return f"{dotted} = {shown}{' ' + unit if unit else ''}: {message}" + (
        f" (allowed: {allowed})" if allowed else ""
    )


def _wanted(keys: list[Any], table: Mapping[str, Any]) -> str:
    """Return what a missing value may be."""
    holder = _model_at(keys[:-1], table)
    field = holder.model_fields.get(str(keys[-1])) if holder is not None else None
    kinds = _models_in(field.annotation) if field is not None else []
    if len(kinds) > 1:
        tags = [(key, kind.model_fields[key].default) for kind in kinds for key in _tags(kind)]
        return "give a table with " + " or ".join(f"{key} = '{word}'" for key, word in tags)
    if kinds:
        return f"give a table with keys of {', '.join(_known_keys(keys, table))}"
    unit = unit_of(str(keys[-1]))
    return "give a value" + (f" in {unit}" if unit else "")


def _dotted(keys: list[Any]) -> str:
    """Return keys as recipes write them: the parts of a force or a motion are named, not
    numbered."""
    named = [
        "xyz"[key] if key in (0, 1, 2) and before in BY_AXIS else str(key)
        for before, key in zip([None, *keys], keys, strict=False)
    ]
    return ".".join(named)


def _range(keys: list[Any], table: Mapping[str, Any], unit: str) -> str:
    """Return the allowed interval of a number, or an empty string."""
    model = _model_at(keys[:-1], table)
    field = model.model_fields.get(str(keys[-1])) if model and keys else None
    if field is None:
        return ""
    low = high = None
    rules = [*field.metadata, *_rules_of_members(field.annotation)]
    for rule in rules:
        low = getattr(rule, "gt", None) if low is None else low
        low = getattr(rule, "ge", None) if low is None else low
        high = getattr(rule, "lt", None) if high is None else high
        high = getattr(rule, "le", None) if high is None else high
    if low is None or high is None:
        return ""
    words = [f"'{word}'" for word in _words(field.annotation)]
    return " or ".join([f"{low:g} to {high:g}{' ' + unit if unit else ''}", *words])


def _rules_of_members(annotation: Any) -> list[Any]:
    """Return the rules of the numbers among a union's members."""
    members = [m for m in typing.get_args(annotation) if typing.get_origin(m) is typing.Annotated]
    return [
        rule
        for member in members
        for each in member.__metadata__
        for rule in getattr(each, "metadata", [each])
    ]


def _words(annotation: Any) -> list[str]:
    """Return the words that may stand in a number's place."""
    found = [m for m in typing.get_args(annotation) if typing.get_origin(m) is typing.Literal]
    return [str(word) for literal in found for word in typing.get_args(literal)]


def _keys(location: tuple[Any, ...], table: Any) -> list[Any]:
    """Drop the union tags that the validator puts among the keys."""
    keys: list[Any] = []
    here = table
    for position, part in enumerate(location):
        if isinstance(here, Mapping):
            is_tag = (
                part in (here.get("kind"), here.get("shape"))
                and part not in here
                and position < len(location) - 1
            )
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
        for model in models:
            if tag in [model.model_fields[key].default for key in _tags(model)]:
                return model
        return models[0] if models else members[0]
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
    return [key for key in ("kind", "shape") if key in model.model_fields]
