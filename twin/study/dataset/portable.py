"""A dataset's scene without what only one machine has: files of the user's own get names, and lie beside it.

Why by their content: a probe's file may be one of several that vary, and one that was changed must be another name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin.parts.probe import Stl
from twin.parts.scene import Scene
from twin.parts.solid import Solid
from twin.parts.stl_file import each_file
from twin.parts.vary import Choice


def portable(scene: Scene) -> tuple[Scene, dict[str, Path]]:
    """Return the scene with bare names in place of paths, and by name the files that then lie beside it."""
    files: dict[str, Path] = {}

    def named(path: str) -> str:
        name = f"probe-{hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]}.stl"
        files[name] = Path(path)
        return name

    changes: dict[str, Any] = {"calibration": scene.calibration.model_copy(update={"file": None})}
    if isinstance(scene.body, Solid):
        files["body.stl"] = Path(scene.body.file)
        changes["body"] = scene.body.model_copy(update={"file": "body.stl"})
    if scene.press is not None:
        also = tuple(_renamed(each, named) for each in scene.press.also)
        changes["press"] = _renamed(scene.press, named).model_copy(update={"also": also})
    changes["vary"] = {
        key: Choice(**{**axis.model_dump(), "choice": each_file(axis.choice, named)})
        if isinstance(axis, Choice)
        else axis
        for key, axis in scene.vary.items()
    }
    return scene.model_copy(update=changes), files


def _renamed(press: Any, named: Callable[[str], str]) -> Any:
    if not isinstance(press.probe, Stl):
        return press
    return press.model_copy(update={"probe": press.probe.model_copy(update={"file": named(press.probe.file)})})


def bare(value: Any) -> Any:
    """Return a plain value with the files of probes by their names alone, wherever they lie."""
    return each_file(value, lambda file: Path(file).name)
