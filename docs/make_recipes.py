"""The recipe reference, from the schema that validates recipes: every table, key, unit, range and default."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from twin.parts.part import unit_of
from twin.parts.scene import Scene

HEAD = """# Recipes: every table and key of a scene

A recipe is a TOML file. These are all tables and keys; whatever is not given has the default shown. Any key can be
overridden from the command line (`-s material.poisson_ratio=0.49`) and from Python
(`load_scene(name, {"material.poisson_ratio": 0.49})`). `base = "other_scene"` starts from another scene. Every table
takes `source` (where its numbers are from) or `assumed` (why they were chosen).
"""


def make_recipes(path: Path) -> None:
    """Write the page."""
    lines, done = [HEAD], set[type]()
    _table(Scene, "", lines, done)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines), encoding="utf-8")


def _table(model: type[BaseModel], path: str, lines: list[str], done: set[type]) -> None:
    if model in done:
        return
    done.add(model)
    said, meanings = _docstring(model)
    lines += [f"(recipe-{model.__name__.lower()})=", ""]
    lines += [f"## `[{path}]` {model.__name__}" if path else "## The scene itself", "", said, ""]
    lines += ["| key | unit | allowed | default | meaning |", "| --- | --- | --- | --- | --- |"]
    below, schema = [], _properties(model)
    for key, field in model.model_fields.items():
        if key in {"source", "assumed"}:
            continue
        models = _models(field.annotation)
        name = f"{path}.{key}" if path else key
        if get_origin(field.annotation) is dict or "dict[" in str(field.annotation):
            name += ".<name>"
        below += [(m, name) for m in models]
        default = "" if field.is_required() else _code(field.get_default(call_default_factory=True))
        allowed = " or ".join(f"[{m.__name__}](#recipe-{m.__name__.lower()})" for m in models) or _allowed(
            field, schema[key]
        )
        lines.append(f"| `{key}` | {unit_of(key) or ''} | {allowed} | {default} | {meanings.get(key, '')} |")
    lines.append("")
    for sub, name in below:
        _table(sub, name, lines, done)


def _properties(model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of every key; of a table that holds others of its kind it stands among the definitions."""
    schema = model.model_json_schema()
    found: dict[str, Any] = schema.get("properties") or schema["$defs"][model.__name__]["properties"]
    return found


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in get_args(annotation) for m in _models(part)]


def _code(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, BaseModel):
        return "its own"
    return f"`{value!r}`".replace("|", "\\|")


def _allowed(field: Any, schema: dict[str, Any]) -> str:
    if values := _literals(field.annotation):
        return ", ".join(f"`{v}`" for v in values)
    signs = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
    ways = [schema, *schema.get("anyOf", ())]
    limits = [(name, way[name]) for way in ways for name in signs if name in way]
    return ", ".join(f"{signs[name]}{limit:g}" for name, limit in limits if abs(limit) < 1e15)


def _literals(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [v for part in get_args(annotation) for v in _literals(part)]


def _docstring(model: type[BaseModel]) -> tuple[str, dict[str, str]]:
    """Return what a description's docstring says, and what it says of each key."""
    text = inspect.cleandoc(model.__doc__ or "").partition("\n\nExamples\n")[0]
    said, _, attributes = text.partition("\nAttributes\n----------\n")
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in attributes.splitlines():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.split(",")]
        else:
            for name in names:
                meanings[name] = f"{meanings.get(name, '')} {line.strip()}".strip()
    tidy = {name: text.replace("|", "\\|").replace("``", "`") for name, text in meanings.items()}
    return said.replace("``", "`").strip(), tidy
