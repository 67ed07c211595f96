"""Two caches: solved fields on disk (`cached_field`), results for sets of points in memory
(`PointCaches`).

A field is stored under a hash of all that it depends on: mesh, materials, what is held, the load,
and the code that solves. A second run of a scene so needs neither a factorisation nor a solve. The
oldest fields are deleted when all take more than `LIMIT_BYTES`. Sets of points are compared, not
hashed: equality is certain and takes a few microseconds.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from twin.arrays import Floats, Points, frozen
from twin.errors import InputError
from twin.files import cache_folder, kept_if_possible, write_whole
from twin.parts.body import Body
from twin.theory import halfspace
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh import quadratic_mesh
from twin.world.mesh.interpolate import Locator, Recovery

_T = TypeVar("_T")

LIMIT_BYTES = 1_000_000_000
EVERY = 32
"""How many fields are written between two looks at the size of the cache."""

_written = {"fields": 0}


def field_key(system: TaylorHood, body: Body, *arrays: Floats) -> str:
    """Return the SHA-256 of an elastic system, its body, the arrays that a field depends on, and
    the solving code."""
    sha = hashlib.sha256(_code())
    sha.update(system.mesh.digest().encode())
    sha.update(repr((system.made_of, body)).encode())
    for array in (system.held, *arrays):
        sha.update(repr(array.shape).encode())
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


@cache
def _code() -> bytes:
    """Return a hash of the sources that a solved field depends on: elasticity's, meshes' and closed
    forms'."""
    sha = hashlib.sha256()
    for folder in (
        Path(__file__).parent,
        Path(quadratic_mesh.__file__).parent,
        Path(halfspace.__file__).parent,
    ):
        for path in sorted(folder.glob("*.py")):
            sha.update(path.read_bytes())
    return sha.digest()


def require_table(path: Path, table: NDArray[Any], shape: tuple[int, ...], kind: DTypeLike) -> None:
    """Raise an `InputError` unless a stored table has this shape and type, and only finite numbers.

    The one check of all that elasticity stores: solved fields, tables of a surface and of a block.
    """
    found = f"{table.dtype} {table.shape}"
    if table.shape != shape or table.dtype != kind:
        raise InputError(f"{path} is not a table of {np.dtype(kind)} {shape}, but {found}")
    if not np.isfinite(table.sum(dtype=float)):  # no mask as large as the table is needed
        raise InputError(f"{path} is not a table: it holds numbers that are not finite")


def cached_field(
    key: str, make: Callable[[], Floats], shape: tuple[int, ...], *, single: bool = False
) -> Floats:
    """Return the array stored under ``key`` (`field_key`), memory-mapped, or make and store it.

    What is stored in another ``shape`` or is not finite is made again. With ``single`` a new one is
    stored, and returned, in float32: half the size, 6e-8 of the largest entry off.
    """
    path = cache_folder() / f"field-{key[:40]}.npy"
    try:
        found: Floats = np.load(path, mmap_mode="r", allow_pickle=False)
        require_table(path, found, shape, np.float32 if single else np.float64)
        os.utime(path)
        return found
    except (OSError, ValueError, EOFError, InputError):
        pass
    made = make()
    if single:
        made = made.astype(np.float32)
    with kept_if_possible():
        write_whole(path, lambda file: np.save(file, made, allow_pickle=False))
        if _written["fields"] % EVERY == 0:
            _prune(path.parent)
        _written["fields"] += 1
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


REMEMBERED = 8
"""Point sets that are kept, the latest ones."""

LOOKED_AT = 5000
"""Of more points than this, one in so many is looked at for how rough a mesh is there."""


@dataclass(eq=False)
class PointCache:
    """Points inside a body, and what was computed for them.

    Attributes
    ----------
    points
        (n, 3) mm, a copy of what was given.
    often
        Whether many loads will follow, so that what evaluates a table is made at the first one.
    """

    points: Points
    often: bool = False
    _made: dict[Hashable, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points)

    def once(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return what ``make`` returns, made at the first call with this key."""
        if key not in self._made:
            self._made[key] = make()
        made: _T = self._made[key]
        return made

    def discard(self, key: Hashable) -> None:
        """Drop what was made for this key."""
        self._made.pop(key, None)

    @property
    def every(self) -> slice:
        """Which points are looked at for how rough a mesh is there."""
        return slice(None, None, max(1, -(-len(self) // LOOKED_AT)))

    def smoothed(self, recovery: Recovery) -> Recovery.Weighted:
        """Return the smoother recovery of fields at `every` point; of one mesh, always the same."""
        return self.once("smoothed", lambda: recovery.at(self.points[self.every]))

    def placed(self, locator: Locator) -> Locator.Places:
        """Return where the points are in a mesh, which must always be the same."""
        return self.once("places", lambda: locator.locate(self.points))


class PointCaches:
    """The latest sets of points in a body."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._sets: list[PointCache] = []
        self._kept: list[PointCache] = []

    def of(self, points: Points) -> PointCache:
        """Return the cache of ``points`` (n, 3); raise an `InputError` if one is outside."""
        points = np.asarray(points, float)
        for cached in (*self._kept, *reversed(self._sets)):
            if np.array_equal(cached.points, points):
                return cached
        self._sets = [*self._sets[1 - REMEMBERED :], self._new(points)]
        return self._sets[-1]

    def keep(self, points: Points) -> None:
        """Never forget ``points`` (n, 3), at which many loads will follow. Raises like `of`."""
        self._kept.append(self._new(np.asarray(points, float), often=True))

    def forget(self) -> None:
        """Drop all sets but those that are kept."""
        self._sets = []

    def make_sole(self, cached: PointCache, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return ``cached.once(key, make)``, dropping what other sets hold under this key: adjoint
        fields take a hundred megabytes."""
        for other in (*self._kept, *self._sets):
            if other is not cached:
                other.discard(key)
        return cached.once(key, make)

    def _new(self, points: Points, *, often: bool = False) -> PointCache:
        self._body.require_inside(points)
        return PointCache(points=frozen(np.array(points, order="C")), often=often)
