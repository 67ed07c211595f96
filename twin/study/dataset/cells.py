"""Tractions, contact and slip summed into the cells of a grid over the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from twin.arrays import Bools, Floats, Ints
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.pipeline import Sites

SPLIT = 6
"""Pieces per direction into which a patch is cut: of its longer side, or of a cell where that is smaller."""


def in_cells(
    grid: Sites, body: Body, groups: Sequence[Rectangles], slips: Sequence[Bools] | None
) -> tuple[Floats, Floats, Floats]:
    """Return (c, 3) forces, (c,) shares of cells in contact and (c,) shares of contact that slip.

    Parameters
    ----------
    grid, body
        The cells, over the body's surface.
    groups
        Patches, those of alike sizes together.
    slips
        Which patches of each group slip; None: none does.

    Raises
    ------
    ContactError
        The contact reaches beyond the sites.
    """
    count = np.array([grid.columns, grid.rows])
    sums = np.zeros((grid.columns * grid.rows, 5))
    for number, group in enumerate(groups):
        if not len(group):
            continue
        sides = 2.0 * group.half_mm.max(axis=0)
        pieces = [math.ceil(SPLIT * side / min(grid.pitch_mm, sides.max()) - 1e-9) for side in sides]
        inside = [(np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in pieces]
        square = np.stack(np.meshgrid(*inside, indexing="ij"), axis=-1).reshape(-1, 2)
        aside = square @ (group.half_mm[:, :, None] * group.frames[:, :2])
        chart = body.chart_of((group.centre_mm[:, None] + aside).reshape(-1, 3))
        area = 4.0 * group.half_mm.prod(axis=1)
        slip = area * slips[number] if slips is not None else np.zeros(len(area))
        values = np.column_stack([group.force_n, area, slip]) / len(square)
        over = _add(chart / grid.pitch_mm + count / 2.0, count, values, sums) * grid.pitch_mm
        if over > 1e-6:
            raise ContactError(
                f"contact: it reaches {over:.3g} mm beyond the sites; enlarge [dataset.sites] or press further inside"
            )
    slipping = np.divide(sums[:, 4], sums[:, 3], out=np.zeros(len(sums)), where=sums[:, 3] > 0)
    return sums[:, :3], np.minimum(sums[:, 3] / grid.pitch_mm**2, 1.0), slipping


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _add(place: Floats, count: Ints, values: Floats, sums: Floats) -> float:
    """Add the values of (k,) patches to the cells where their (k q, 2) pieces lie; return how far one lies beyond."""
    each, beyond = len(place) // len(values), 0.0
    for i in range(len(place)):
        cell = 0
        for axis in range(2):
            beyond = max(beyond, -place[i, axis], place[i, axis] - count[axis])
            cell = cell * count[axis] + min(max(int(np.floor(place[i, axis])), 0), count[axis] - 1)
        for c in range(values.shape[1]):
            sums[cell, c] += values[i // each, c]
    return beyond
