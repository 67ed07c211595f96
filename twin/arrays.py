"""Array aliases: what the axes are, and which unit, said once.

All coordinates are in the body frame of DESIGN: origin at the centre (block) or apex (finger) of the outer sensing
surface, right-handed, z into the body. Pixels are (column, row) with (0, 0) at the centre of the top-left pixel.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError

Floats: TypeAlias = NDArray[np.float64]
"""Any float64 array; its docstring says the shape."""

Ints: TypeAlias = NDArray[np.int64]
"""Any integer array."""

Bools: TypeAlias = NDArray[np.bool_]
"""Any mask."""

Singles: TypeAlias = NDArray[np.float32]
"""Any float32 array: light, which needs no more digits."""

Points: TypeAlias = NDArray[np.float64]
"""(n, 3) positions or displacements, mm, axes x, y, z."""

Chart: TypeAlias = NDArray[np.float64]
"""(n, 2) surface coordinates (s, t), mm: arc lengths along x and y on the outer surface; x and y on a flat one."""

Pixels: TypeAlias = NDArray[np.float64]
"""(n, 2) picture positions, px, (column, row)."""

Picture: TypeAlias = NDArray[np.uint8]
"""(height, width, 3) CCD counts, red, green, blue."""


def as_points(given: object, what: str) -> Points:
    """Return what was given as (n, 3) numbers.

    Raises
    ------
    InputError
        It is something else.
    """
    try:
        points = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what}: must be numbers of shape (n, 3), got {given!r:.60}") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{what}: must have shape (n, 3), got {points.shape}")
    return points


AnyArray = TypeVar("AnyArray", bound=NDArray[Any])


def frozen(array: AnyArray) -> AnyArray:
    """Mark an array read-only and return it: results are facts, not scratch space."""
    array.setflags(write=False)
    return array
