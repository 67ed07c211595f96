"""What this machine can do: versions, Mitsuba variant, solver, GL, caches."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
from dataclasses import dataclass

from twin.errors import MissingCapability
from twin.places import MESHES, SCENES, cache_folder

NEEDED = ("numpy", "scipy", "numba", "mitsuba", "drjit", "pytetwild", "trimesh", "pyvista", "pydantic")
OPTIONAL = {"pypardiso": "faster factorisation on x86-64: pip install 'tactile-twin[mkl]'"}

GL = ("GL", "EGL")
"""Looked for by loading them: the list that the system keeps of its libraries also has those that were taken away."""

LOADING_S = 20.0
"""How long a library is waited for."""


@dataclass(frozen=True, kw_only=True)
class Examination:
    """What was found.

    Attributes
    ----------
    lines
        For people, one fact each.
    missing
        What the main job lacks; empty if it can run.
    """

    lines: tuple[str, ...]
    missing: tuple[str, ...]


def examine() -> Examination:
    """Look at this machine without ever loading a package that could crash on it."""
    lines = [f"python      {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"]
    missing = []
    for name in NEEDED:
        version = _version(name)
        lines.append(f"{name:11s} {version or 'MISSING'}")
        if version is None:
            missing.append(f"{name} is not installed: pip install tactile-twin")
    for name, use in OPTIONAL.items():
        lines.append(f"{name:11s} {_version(name) or 'not installed (optional): ' + use}")
    if not missing:
        from twin.world.elasticity.solve import available_solvers
        from twin.world.picture.variant import choose_variant

        try:
            variant = choose_variant()
            lines.append(f"renderer    {variant.name}: {variant.reason}")
        except MissingCapability as problem:
            missing.append(str(problem))
        lines.append(f"solver      {', '.join(available_solvers())}")
    lines.append(f"GL          {'found' if _loads(*GL) else 'not found: only interactive 3-D windows need it'}")
    lines.append(f"cache       {cache_folder()}")
    if not (SCENES.is_dir() and MESHES.is_dir()):
        missing.append(f"the recipes are not beside the package ({SCENES.parent}): install with pip install -e")
    lines.append(f"recipes     {SCENES.parent}")
    return Examination(lines=tuple(lines), missing=tuple(missing))


def _loads(*names: str) -> bool:
    """Tell whether libraries can be loaded: in a process of its own, as a broken one may end it."""
    found = [ctypes.util.find_library(name) for name in names]
    code = "import ctypes, sys\nfor name in sys.argv[1:]: ctypes.CDLL(name)"
    command = [sys.executable, "-c", code, *(name for name in found if name)]
    try:
        return all(found) and subprocess.run(command, capture_output=True, timeout=LOADING_S).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _version(name: str) -> str | None:
    if importlib.util.find_spec(name) is None:
        return None
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown version"
