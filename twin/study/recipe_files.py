"""Files that a recipe names, found and read: calibration, a body's and probes' own surfaces, a camera's intrinsics.

A recipe names them relative to itself; a resolved scene holds whole paths, so that it can be read from anywhere, and
the numbers of the intrinsics themselves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twin.errors import RecipeError
from twin.parts.stl_file import each_file
from twin.parts.vary import flat
from twin.places import SCENES
from twin.study.recipe_tables import PROVENANCE, Table, forget_provenance


def find_files(table: Table, path: Path, folders: list[Path]) -> None:
    """Put what the files of a recipe hold, or where they lie, in the places of their names.

    Parameters
    ----------
    table
        Of the scene, with all that it inherits; changed.
    path
        The scene's file.
    folders
        Where a body's own file may lie: beside the scene or the body recipe.

    Raises
    ------
    RecipeError
        There is no such file.
    InputError
        The intrinsics can't be read.
    """
    _find_calibration(table, path)
    _find_solid(table, folders, path)
    _find_probes(table, path)
    _read_intrinsics(table, path)
    if isinstance(table.get("vary"), dict):
        table["vary"] = each_file(flat(table["vary"]), lambda file: _found_file(file, path, "vary.press.probe"))


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
        forget_provenance(camera, key)
    for kind in PROVENANCE:
        if isinstance(camera.get(kind), dict):
            camera[kind].pop("intrinsics", None)
    if not isinstance(camera.get("source"), str):
        camera["source"] = {**(camera.get("source") or {}), **dict.fromkeys(numbers, f"file {given.name}")}
    table["camera"] = camera
