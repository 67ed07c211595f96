"""Solved fields kept on disk, under a hash of all that they depend on, and read back memory-mapped.

Why: a second run of a scene, or a press near an earlier one, then needs no factor and no solve. The hash covers mesh,
materials, what is held, the load, and the very code that solves, so that a field can't outlive what made it. The oldest
fields go when they fill more than `LIMIT_BYTES`; a cache that can't be written costs time only.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from twin.arrays import Floats
from twin.errors import TwinError
from twin.parts.body import Body
from twin.places import cache_folder
from twin.results import write_whole
from twin.theory import halfspace
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh import elements

LIMIT_BYTES = 1_000_000_000
EVERY = 32
"""How many fields are written between two looks at the size of the cache."""

_written = {"fields": 0}


def field_key(system: TaylorHood, body: Body, *arrays: Floats) -> str:
    """Return the SHA-256 of an elastic system, its body, the arrays that a field depends on, and the solving code."""
    sha = hashlib.sha256(_code())
    sha.update(system.mesh.digest().encode())
    sha.update(repr((system.made_of, body)).encode())
    for array in (system.held, *arrays):
        sha.update(repr(array.shape).encode())
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


@cache
def _code() -> bytes:
    """Return a hash of the sources that a solved field depends on: elasticity's, meshes' and closed forms'."""
    sha = hashlib.sha256()
    for folder in (Path(__file__).parent, Path(elements.__file__).parent, Path(halfspace.__file__).parent):
        for path in sorted(folder.glob("*.py")):
            sha.update(path.read_bytes())
    return sha.digest()


def kept(key: str, make: Callable[[], Floats], *, single: bool = False) -> Floats:
    """Return the array kept under ``key``, memory-mapped, or make it and keep it.

    Parameters
    ----------
    key
        From `field_key`.
    make
        Called if there is none.
    single
        Keep, and return, float32: half the size, 6e-8 of the largest entry off.
    """
    path = cache_folder() / f"field-{key[:40]}.npy"
    try:
        found: Floats = np.load(path, mmap_mode="r", allow_pickle=False)
        os.utime(path)
        return found
    except (OSError, ValueError, EOFError):
        pass
    made = make()
    if single:
        made = made.astype(np.float32)
    try:
        write_whole(path, lambda file: np.save(file, made, allow_pickle=False))
        if _written["fields"] % EVERY == 0:
            _prune(path.parent)
        _written["fields"] += 1
    except (OSError, TwinError):
        pass
    return made


def _prune(folder: Path) -> None:
    """Remove the fields used longest ago until the others fit."""
    found = [(path, path.stat()) for path in folder.glob("field-*.npy")]
    size = sum(stat.st_size for _, stat in found)
    for path, stat in sorted(found, key=lambda pair: pair[1].st_mtime):
        if size <= LIMIT_BYTES:
            break
        path.unlink(missing_ok=True)
        size -= stat.st_size
