"""Quadratic tetrahedral meshes: what they are, how they are stored, and where a body's mesh comes from.

Why stored: the mesher is not deterministic and takes minutes, so a mesh is made once, checked, and kept under a key
made of the geometry and the wanted sizes. The reference bodies' meshes ship with the program.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.archive import read_arrays
from twin.arrays import Bools, Ints, Points, frozen
from twin.errors import InputError, MeshError, TwinError
from twin.parts.body import Body
from twin.parts.part import without_later
from twin.places import MESHES, cache_folder, is_pinned, pinned
from twin.progress import Progress
from twin.results import write_whole
from twin.world.mesh.sizing import Level, Sizing, default_sizing
from twin.world.mesh.snap import signed_volumes

__all__ = ["Level", "Mesh", "Sizing", "body_mesh", "mesh_key", "read_mesh", "read_provenance", "write_mesh"]

FORMAT = 1
"""Version of the file format and of the way meshes are made; part of every key."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Quadratic tetrahedra with a classified boundary.

    Attributes
    ----------
    points
        (n, 3) all nodes, mm; the corner nodes come first.
    tets
        (m, 10) indices in the order of VTK's quadratic tetrahedron: corners 0 to 3, then the middles of the edges 01,
        12, 02, 03, 13, 23. Volumes are positive.
    corners
        Number of corner nodes.
    faces
        (f, 6) boundary triangles in the order of VTK's quadratic triangle: three corners, then the middles of 01, 12,
        20; right-hand normals point out of the body.
    piece
        (f,) index into ``body.pieces`` of every boundary triangle: 0 is sensing, ``body.held_pieces`` are held.
    region
        (m,) what every element is made of: 0 the body (all of them, if not given), then its layers one by one.
    """

    points: Points
    tets: Ints
    corners: int
    faces: Ints
    piece: Ints
    region: Ints = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.region) == 0:
            object.__setattr__(self, "region", frozen(np.zeros(len(self.tets), np.int64)))

    def nodes_on(self, pieces: Sequence[int]) -> Bools:
        """Return (n,) which nodes lie on boundary triangles of ``pieces``."""
        on = np.zeros(len(self.points), bool)
        on[self.faces[np.isin(self.piece, pieces)]] = True
        return on

    def digest(self) -> str:
        """Return the SHA-256 of the arrays: equal for equal meshes, whatever file they came from."""
        sha = hashlib.sha256()
        for array, kind in ((self.points, "<f8"), (self.tets, "<i8"), (self.faces, "<i8"), (self.piece, "<i8")):
            sha.update(repr(array.shape).encode())
            sha.update(np.ascontiguousarray(array, dtype=kind).tobytes())
        sha.update(str(self.corners).encode())
        if np.any(self.region):
            sha.update(np.ascontiguousarray(self.region, dtype="<i8").tobytes())
        return sha.hexdigest()

    @property
    def unknowns(self) -> int:
        """Three displacements at every node and one pressure at every corner."""
        return 3 * len(self.points) + self.corners


def write_mesh(mesh: Mesh, path: Path | str, provenance: dict[str, Any], *, first: bool = False) -> None:
    """Write a mesh to an ``.npz`` file: under a temporary name first, so that a kill leaves no half file.

    Parameters
    ----------
    mesh
        The mesh.
    path
        Where to.
    provenance
        How it was made, as plain JSON values.
    first
        Whether a file that another process has written by then is kept.

    Raises
    ------
    TwinError
        It can't be written.
    """
    path = Path(path)
    told = json.dumps({**provenance, "format": FORMAT, "digest": mesh.digest()}, sort_keys=True)
    arrays: dict[str, Any] = {
        "points": mesh.points,
        "tets": mesh.tets.astype(np.int32),
        "corners": np.int64(mesh.corners),
        "faces": mesh.faces.astype(np.int32),
        "piece": mesh.piece.astype(np.int32),
        "region": mesh.region.astype(np.int32),
        "provenance": np.array(told),
    }
    write_whole(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays), first=first)


def read_mesh(path: Path | str) -> Mesh:
    """Read a mesh and make sure that it is whole.

    Raises
    ------
    InputError
        If the file is missing, truncated, of another kind, or its arrays don't make a mesh.
    """
    return _load(Path(path))[0]


def read_provenance(path: Path | str) -> dict[str, Any]:
    """Return how a mesh file was made: key, body, sizing, quality, format and digest; raises like `read_mesh`."""
    return _load(Path(path))[1]


def _load(path: Path) -> tuple[Mesh, dict[str, Any]]:
    try:
        file: dict[str, Any] = {**read_arrays(path)}
        mesh = Mesh(
            points=frozen(np.asarray(file["points"], np.float64)),
            tets=frozen(np.asarray(file["tets"], np.int64)),
            corners=int(file["corners"]),
            faces=frozen(np.asarray(file["faces"], np.int64)),
            piece=frozen(np.asarray(file["piece"], np.int64)),
            region=frozen(np.asarray(file.get("region", []), np.int64)),
        )
        provenance = json.loads(str(file["provenance"]))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such mesh file; make it with `twin mesh SCENE`") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as problem:
        raise InputError(
            f"{path}: not a whole mesh file ({type(problem).__name__}: {problem}); make it anew with "
            "`twin mesh SCENE --rebuild`"
        ) from problem
    problem_text = _problem(mesh)
    if not problem_text and (not isinstance(provenance, dict) or provenance.get("digest") != mesh.digest()):
        problem_text = "its arrays don't match the digest stored with them"
    if problem_text:
        raise InputError(f"{path}: {problem_text}; make it anew with `twin mesh SCENE --rebuild`")
    return mesh, provenance


def _problem(mesh: Mesh) -> str:
    """Return what keeps the arrays from being a mesh, or an empty string."""
    nodes = len(mesh.points)
    shapes = [("points", mesh.points, 3), ("tets", mesh.tets, 10), ("faces", mesh.faces, 6)]
    for name, array, width in shapes:
        if array.ndim != 2 or array.shape[1] != width or len(array) == 0:
            return f"{name} have shape {array.shape} (allowed: (n >= 1, {width}))"
    if mesh.piece.shape != (len(mesh.faces),):
        return f"piece has shape {mesh.piece.shape} (allowed: ({len(mesh.faces)},))"
    if mesh.region.shape != (len(mesh.tets),) or mesh.region.min() < 0:
        return f"region has shape {mesh.region.shape} or negative numbers (allowed: ({len(mesh.tets)},), 0 and up)"
    if not np.all(np.isfinite(mesh.points)):
        return "points are not finite"
    if not 4 <= mesh.corners <= nodes:
        return f"{mesh.corners} corner nodes (allowed: 4 to {nodes})"
    for name, array, own_corners in (("tets", mesh.tets, 4), ("faces", mesh.faces, 3)):
        if array.min() < 0 or array.max() >= nodes or array[:, :own_corners].max() >= mesh.corners:
            return f"{name} name nodes that are not there (allowed: corners below {mesh.corners}, nodes below {nodes})"
    if np.min(signed_volumes(mesh.points, mesh.tets)) <= 0:
        return "a tetrahedron has no positive volume"
    return ""


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
    from twin.world.mesh.quality import quality

    for path in sorted(MESHES.glob(f"*.{level}.npz")):
        mesh, provenance = _load(path)
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
        mesh, provenance = _load(path)
    except InputError:
        return None
    return mesh if provenance.get("key") == key else None
