"""Tables of recipes: read from TOML, laid one over another, and changed value by value.

Every value has a provenance of its own (``source`` or ``assumed``), also where a recipe gives one for a whole table: so
a value that is replaced loses what was said of the one that it replaces, and its neighbours keep theirs.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from twin.errors import InputError, RecipeError
from twin.parts.press import BY_AXIS

Table = dict[str, Any]

PROVENANCE = ("source", "assumed")
ALTERNATIVES = ("steps", "force_n", "indentation_mm")
"""Ways to give a press its path: one of them replaces the others."""

OTHERS = {
    b"\x89PNG": ("a picture (PNG)", "twin reconstruct takes pictures as frames"),
    b"\xff\xd8\xff": ("a picture (JPEG)", "twin reconstruct takes pictures as frames"),
    b"GIF8": ("a picture (GIF)", "twin reconstruct takes pictures as frames"),
    b"PK\x03\x04": ("an archive", "twin check takes a calibration, whose name ends in .npz"),
    b"PAR1": ("a table (Parquet)", "twin check and twin view take the folder of the dataset"),
    b"{": ("JSON", "twin check and twin view take the folder of a run or of a dataset"),
    b"<": ("a page", "open it in a browser"),
}
"""What else people name, by its first bytes, and what takes that."""


def read_recipe(path: Path) -> Table:
    """Return a recipe file's table, its provenance spelt out by key.

    Raises
    ------
    RecipeError, InputError
        It is not valid TOML, or can't be read.
    """
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise InputError(f"{path}: can't be read ({problem.strerror})") from None
    for begins, (what, remedy) in OTHERS.items():
        if data.startswith(begins):
            raise RecipeError(f"is {what}, and a scene or a sweep is a text file (TOML); {remedy}", str(path))
    if len(data) > 1_000_000:
        raise RecipeError(f"{len(data)} bytes: a recipe is at most 1 MB", str(path))
    try:
        return _by_key(tomllib.loads(data.decode("utf-8-sig")))  # editors on Windows mark their files so
    except UnicodeDecodeError as problem:
        told = f"not valid TOML: byte {problem.start + 1} is no text in UTF-8; save the file in this encoding"
        raise RecipeError(told, str(path)) from None
    except (ValueError, RecursionError) as problem:  # a number of 4,300 digits is a ValueError of its own
        raise RecipeError(f"not valid TOML: {problem}", str(path)) from None


def _by_key(table: Table) -> Table:
    """Spell a table-wide provenance text out by key, so that merging can follow single values."""
    spelt = {k: _by_key(v) if isinstance(v, dict) and k not in PROVENANCE else v for k, v in table.items()}
    for kind in PROVENANCE:
        if isinstance(spelt.get(kind), str):
            spelt[kind] = {k: spelt[kind] for k, v in table.items() if k not in PROVENANCE and not isinstance(v, dict)}
    return spelt


def merged(below: Table, above: Table) -> Table:
    """Return a table with another laid over it; neither is changed."""
    table = dict(below)
    if set(ALTERNATIVES) & set(above):
        table = {k: v for k, v in table.items() if k not in ALTERNATIVES}
    for key, value in above.items():
        if key in PROVENANCE:
            continue
        old = table.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and _same_kind(old, value):
            table[key] = merged(old, value)
        else:
            table[key] = value
            forget_provenance(table, key)
    for kind in PROVENANCE:
        if above.get(kind):
            table[kind] = {**table.get(kind, {}), **above[kind]} if isinstance(above[kind], dict) else above[kind]
    return table


def _same_kind(below: Table, above: Table) -> bool:
    """Another kind of probe, or another shape of body, shares no number with the one below it."""
    return all(above.get(tag, below.get(tag)) == below.get(tag) for tag in ("kind", "shape"))


def forget_provenance(table: Table, key: str) -> None:
    """Drop what a table says of where the value of ``key`` comes from."""
    for kind in PROVENANCE:
        if isinstance(table.get(kind), dict):
            table[kind] = {k: v for k, v in table[kind].items() if k != key}


def override(table: Table, dotted: str, value: Any) -> None:
    """Put a value at a dotted key of ``table``, which is changed, and say there that it is assumed.

    Raises
    ------
    RecipeError
        A part of the key names a value, not a table.
    """
    *parents, last = dotted.split(".")
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
    forget_provenance(here, last)
    one_value = not isinstance(value, dict) or last in BY_AXIS
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
