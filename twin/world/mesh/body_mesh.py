"""Where a body's mesh comes from: the cache, those that ship with the program, one of those stretched, or the mesher.

Why stored: the mesher is not deterministic and takes minutes, so a mesh is made once, checked, and kept under a key
made of the geometry and the wanted sizes. The reference bodies' meshes ship with the program.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Points, frozen
from twin.errors import InputError, MeshError, TwinError
from twin.parts.body import Body
from twin.parts.part import without_later
from twin.places import MESHES, cache_folder, is_pinned, pinned
from twin.progress import Progress
from twin.world.mesh.mesh import FORMAT, Mesh, load_mesh, read_mesh, write_mesh
from twin.world.mesh.quality import quality
from twin.world.mesh.sizing import Level, Sizing, default_sizing


def mesh_key(body: Body, sizing: Sizing) -> str:
    """Return the SHA-256 of what a mesh depends on: the body's geometry (not its sources), the sizing, the format."""
    geometry = without_later(body.geometry())
    told = json.dumps({"body": geometry, "sizing": sizing.described(), "format": FORMAT}, sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()


def mesh_file(key: str) -> str:
    """Return the name of the file of a mesh."""
    return f"mesh-{key[:32]}.npz"


def body_mesh(body: Body, level: Level, *, rebuild: bool = False, progress: Progress | None = None) -> Mesh:
    """Return a body's mesh: the cached or shipped one if its key matches, else a shipped one stretched, else a new one.

    Stretching (`_stretched`) saves the minute that meshing takes, and makes bodies of a sweep share their mesh's error.

    Parameters
    ----------
    body
        The body.
    level
        See `twin.world.mesh.sizing.Level`.
    rebuild
        Make a new mesh even if there is one, and put it into the cache.
    progress
        Called with a line of text and the share that is done while a mesh is being made.

    Raises
    ------
    MeshError
        If no mesh passes the quality gates, or the mesher fails.
    """
    sizing = default_sizing(body, level)
    key = mesh_key(body, sizing)
    if is_pinned():
        if (path := pinned(mesh_file(key))) is None:
            raise MeshError(f"mesh of level {level}: not among the given ones, and none is made beside those")
        return read_mesh(path)
    cached = cache_folder() / mesh_file(key)
    if not rebuild:
        for path in [cached, *sorted(MESHES.glob(f"*.{level}.npz"))]:
            found = _matching(path, key)
            if found is not None:
                return found
        if (stretched := _stretched(body, level)) is not None:
            return stretched
    from twin.world.mesh.build import build_mesh

    damaged = cached.exists()
    mesh, measured = build_mesh(body, sizing, progress=progress)
    provenance = {
        "key": key,
        "level": level,
        "body": body.geometry(),
        "sizing": sizing.described(),
        "quality": measured.described(),
    }
    with suppress(TwinError):  # a full disk costs the time to make it again
        write_mesh(mesh, cached, provenance, first=not (rebuild or damaged))
    # another process may have been first: all that is made of this body is then made of that one's mesh
    return _matching(cached, key) or mesh


def shipped_mesh(body: Body, level: Level) -> Mesh | None:
    """Return the mesh of exactly this body that ships with the program, None if there is none."""
    key = mesh_key(body, default_sizing(body, level))
    found = (_matching(path, key) for path in sorted(MESHES.glob(f"*.{level}.npz")))
    return next((mesh for mesh in found if mesh is not None), None)


def _stretched(body: Body, level: Level) -> Mesh | None:
    """Return the shipped mesh of a body of this shape, stretched to this one, if that passes the quality gates.

    A block is any other block stretched along its axes; other shapes must be scaled copies.
    """
    for path in sorted(MESHES.glob(f"*.{level}.npz")):
        mesh, provenance = load_mesh(path)
        ratio = _ratio(without_later(provenance["body"]), without_later(body.geometry()))
        if ratio is not None:
            made = replace(mesh, points=frozen(mesh.points * ratio))
            if not quality(made, body).failures():
                return made
    return None


def _ratio(one: dict[str, Any], other: dict[str, Any]) -> Points | None:
    """Return (3,) by what the first geometry must be stretched along x, y and z to be the other, None if it can't."""
    lengths = [key for key in one if key.endswith("_mm") and isinstance(one[key], int | float)]
    if set(one) != set(other) or any(one[key] != other[key] for key in one if key not in lengths):
        return None
    ratio = np.array([other[key] / one[key] for key in lengths])
    if one["shape"] != "block":
        return np.full(3, ratio[0]) if np.allclose(ratio, ratio[0], rtol=1e-9) else None
    by_key = dict(zip(lengths, ratio, strict=True))
    return np.array([by_key["width_mm"], by_key["length_mm"], by_key["thickness_mm"]])


def _matching(path: Path, key: str) -> Mesh | None:
    """Return the mesh in ``path`` if it is whole and made for ``key``; a broken cache entry counts as absent."""
    if not path.exists():
        return None
    try:
        mesh, provenance = load_mesh(path)
    except InputError:
        return None
    return mesh if provenance.get("key") == key else None
