"""Where files are: the shipped recipes and meshes, and the cache."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
_INSIDE = Path(__file__).resolve().parent
_SHIPPED = _INSIDE if (_INSIDE / "meshes").is_dir() else ROOT
MESHES = _SHIPPED / "meshes"
SCENES = _SHIPPED / "scenes"
"""An installed package carries them inside; in a checkout they lie beside it."""


@cache
def cache_folder() -> Path:
    """Return a writable cache folder: ``$TWIN_CACHE``, else the platform's, else a temporary one with a warning."""
    import platformdirs

    named = os.environ.get("TWIN_CACHE")
    for candidate in [Path(named)] if named else [Path(platformdirs.user_cache_dir("twin"))]:
        try:
            candidate.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=candidate):
                return candidate
        except OSError as problem:
            print(f"twin: the cache {candidate} can't be written ({problem.strerror}); using a temporary one. "
                  "Set TWIN_CACHE to a writable folder to keep results between runs.", file=sys.stderr)  # fmt: skip
    temporary = Path(tempfile.mkdtemp(prefix="twin-cache-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


_pinned: list[Path] = []


def pinned(name: str) -> Path | None:
    """Return the file of this name in the pinned folder, None if none is pinned or it has no such file."""
    for folder in _pinned:
        if (folder / name).is_file():
            return folder / name
    return None


@contextmanager
def pin(folder: Path) -> Iterator[None]:
    """Take meshes and tables from ``folder`` before all others, and make none while it is pinned.

    Why: making a mesh is not deterministic, so what must come out the same everywhere is given its mesh.
    """
    _pinned.insert(0, folder)
    try:
        yield
    finally:
        _pinned.remove(folder)


def is_pinned() -> bool:
    """Return whether meshes and tables are pinned."""
    return bool(_pinned)
