"""Arrays: aliases with their axes and units, what is often done with them (read-only, grids,
medians, spacing), and the type of a progress callback.

All coordinates are in the body frame: origin at the centre (block) or apex (finger) of the outer
sensing surface, right-handed, z into the body. Pixels are (column, row) with (0, 0) at the centre
of the top-left pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
"""Any float64 array; its docstring gives the shape."""

Ints: TypeAlias = NDArray[np.int64]
"""Any integer array."""

Bools: TypeAlias = NDArray[np.bool_]
"""Any mask."""

Singles: TypeAlias = NDArray[np.float32]
"""Any float32 array: light, which needs no more digits."""

Points: TypeAlias = NDArray[np.float64]
"""(n, 3) positions or displacements, mm, axes x, y, z."""

Chart: TypeAlias = NDArray[np.float64]
"""(n, 2) surface coordinates (s, t), mm: arc lengths along x and y on the outer surface; x and y on
a flat one."""

Pixels: TypeAlias = NDArray[np.float64]
"""(n, 2) picture positions, px, (column, row)."""

Picture: TypeAlias = NDArray[np.uint8 | np.uint16]
"""(height, width, 3) CCD counts, red, green, blue, the largest of which is that of the array's
type: 255, or 65535 of cameras of more than 8 bits."""


def eight_bits(picture: Picture) -> NDArray[np.uint8]:
    """Return a picture in 8 bits, to look at."""
    return (picture >> 8 if picture.dtype == np.uint16 else picture).astype(np.uint8, copy=False)


AnyArray = TypeVar("AnyArray", bound=NDArray[Any])


def frozen(array: AnyArray) -> AnyArray:
    """Mark an array read-only and return it: results are facts, not scratch space."""
    array.setflags(write=False)
    return array


def for_kernel(array: NDArray[Any]) -> Floats:
    """Return an array, the same where it can be, in the one layout that kernels are compiled for.

    Numba compiles a function once more for every other layout (a strided column, a read-only
    array), and that takes seconds.
    """
    return np.require(array, np.float64, ["C", "W"])


def grid_points(*axes: Floats) -> Floats:
    """Return the (n, axes) points of a tensor grid, the last axis running fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def coordinates(point: Floats) -> str:
    """Return the coordinates of a point to four digits, for messages."""
    return ", ".join(f"{coordinate:.4g}" for coordinate in point)


def medians(values: Floats, axis: int = 0) -> Floats:
    """Return the medians along an axis of what is not NaN, NaN where nothing is: five to ten times
    as fast as NumPy's for small arrays."""
    ranked, whole = np.sort(values, axis=axis), values.shape[axis]  # NaN come last
    if np.isnan(ranked.take(-1, axis)).any():
        count = whole - np.isnan(ranked).sum(axis=axis, keepdims=True)
        low = np.take_along_axis(ranked, (count - 1) // 2, axis)
        high = np.take_along_axis(ranked, count // 2, axis)
        return np.asarray(0.5 * (low + high).squeeze(axis))
    return np.asarray(0.5 * (ranked.take((whole - 1) // 2, axis) + ranked.take(whole // 2, axis)))


def quantiles(values: Floats, *shares: float) -> list[float]:
    """Return which of the ``values`` (n,) these shares are below; NaN where all are."""
    ranked = np.sort(values)  # NaN come last
    last = max(int(ranked.searchsorted(np.inf)) - 1, 0)
    return [float(ranked[round(share * last)]) for share in shares]


def mean_spacing(places: Floats) -> float:
    """Return about the distance of neighbours among (n, 2 or 3) places, seen along z: the side of
    the square that each has of their bounding box. Rows with NaN are left out."""
    seen = places[np.isfinite(places).all(axis=1), :2]
    if len(seen) < 2:
        return 1.0
    return float(np.sqrt(np.prod(np.ptp(seen, axis=0)) / len(seen))) or 1.0


def nice(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten up to ``value`` (else 1)."""
    if not (value > 0 and math.isfinite(value)):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(m * power for m in (1.0, 2.0, 5.0) if m * power <= value * (1 + 1e-9))


Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0 to 1."""
