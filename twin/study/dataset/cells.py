"""Tractions, contact and slip summed into the cells of a grid over the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
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
        at = [(np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in pieces]
        middles, aside = group.centre_mm, group.half_mm[:, :, None] * group.frames[:, :2]
        area = 4.0 * group.half_mm.prod(axis=1)
        slip = area * slips[number] if slips is not None else np.zeros(len(area))
        values = np.column_stack([group.force_n, area, slip])
        if not body.is_flat:  # the pieces of a plane patch are then places of their own on the surface
            square = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1).reshape(-1, 2)
            middles = (middles[:, None] + square @ aside).reshape(-1, 3)
            values = np.repeat(values / len(square), len(square), axis=0)
            aside, at = np.zeros((len(middles), 2, 3)), [np.zeros(1)] * 2
        chart = body.chart_of(middles) / grid.pitch_mm + count / 2.0
        over = _add(chart, aside[:, :, :2] / grid.pitch_mm, *at, count, values, sums) * grid.pitch_mm
        if over > 1e-6:
            raise ContactError(
                f"contact: it reaches {over:.3g} mm beyond the sites; enlarge [dataset.sites] or press further inside"
            )
    force, shares, slipping = np.empty((len(sums), 3)), np.empty(len(sums)), np.empty(len(sums))
    _read(sums, grid.pitch_mm**2, force, shares, slipping)
    return force, shares, slipping


@njit(cache=True, nogil=True)
def _add(
    middle: Floats, aside: Floats, first: Floats, second: Floats, count: Ints, values: Floats, sums: Floats
) -> float:
    """Add (k, 5) values to the cells where the pieces of k patches lie; return how far one lies beyond.

    ``middle`` are (k, 2) places and ``aside`` (k, 2, 2) half sides, in cells; ``first`` and ``second`` say where a
    patch's pieces are along its two sides, -1 to 1.
    """
    beyond, share = 0.0, 1.0 / (len(first) * len(second))
    for p in range(len(middle)):
        for s in first:
            for t in second:
                cell = 0
                for axis in range(2):
                    at = middle[p, axis] + s * aside[p, 0, axis] + t * aside[p, 1, axis]
                    beyond = max(beyond, -at, at - count[axis])
                    cell = cell * count[axis] + min(max(math.floor(at), 0), count[axis] - 1)
                for c in range(values.shape[1]):
                    sums[cell, c] += values[p, c] * share
    return beyond


@njit(cache=True, nogil=True)
def _read(sums: Floats, area: float, force: Floats, shares: Floats, slipping: Floats) -> None:
    """Set what `in_cells` returns from the (c, 5) ``sums`` over cells of an ``area``, mm2."""
    for cell in range(len(sums)):
        for axis in range(3):
            force[cell, axis] = sums[cell, axis]
        touched = sums[cell, 3]
        shares[cell] = min(touched / area, 1.0)
        slipping[cell] = sums[cell, 4] / touched if touched > 0.0 else 0.0
