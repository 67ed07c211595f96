"""Which markers may stand between a marker and a lamp: a list for each pair, found in a grid over the markers.

Why lists: one marker in three has another before an LED, and then mostly one or two. Who knows them needs no search
among all markers for a shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit

_ROOM = 1.05


@dataclass(frozen=True, kw_only=True)
class Occluders:
    """What may shadow what.

    Attributes
    ----------
    first
        (n * lamps + 1,) where the list of marker i and lamp l, number i * lamps + l, begins in ``members``.
    members
        Numbers of markers.
    flags
        (n, lamps) whether the list holds any.
    """

    first: NDArray[np.int32]
    members: NDArray[np.int32]
    flags: Bools


def occluders(centres: Floats, radii: Floats, places: Floats, wanted: Bools) -> Occluders:
    """Return, for each marker and lamp, the markers that may shadow it; too many when in doubt, never too few.

    Parameters
    ----------
    centres, radii
        (n, 3) and (n,) spheres around the markers, mm; rows that aren't finite are no markers.
    places
        (n, lamps, 3) lamps as each marker sees them.
    wanted
        (n, lamps) the pairs that matter.

    Notes
    -----
    Two markers are in each other's way only if the second's centre is within both radii of the way to the lamp, and
    not farther than the lamp. The way is cut where it leaves the heights of all markers.
    """
    n, lamps = wanted.shape
    here = np.flatnonzero(np.isfinite(centres).all(axis=1) & np.isfinite(radii))
    if len(here) == 0 or lamps == 0:
        empty = np.zeros(n * lamps + 1, np.int32)
        return Occluders(first=empty, members=np.zeros(0, np.int32), flags=np.zeros((n, lamps), bool))
    first, members = _lists(np.ascontiguousarray(centres, float), np.asarray(radii, float), here, places, wanted)
    return Occluders(first=first, members=members, flags=np.diff(first).reshape(n, lamps) > 0)


@njit(cache=True, nogil=True)
def _grid(x: Floats, y: Floats, side: int) -> tuple[Ints, Ints, Floats, Floats]:
    """Return places in the order of side * side cells, where each begins, the cells' corner, and how many make a mm."""
    low = np.array([x.min(), y.min()])
    a_mm = np.array([side / max(x.max() - low[0], 1e-9), side / max(y.max() - low[1], 1e-9)])
    cell, begin = np.empty(len(x), np.int64), np.zeros(side * side + 1, np.int64)
    for i in range(len(x)):
        column, row = min(int((x[i] - low[0]) * a_mm[0]), side - 1), min(int((y[i] - low[1]) * a_mm[1]), side - 1)
        cell[i] = row * side + column
        begin[cell[i] + 1] += 1
    begin = np.cumsum(begin)
    order, at = np.empty(len(x), np.int64), begin.copy()
    for i in range(len(x)):
        order[at[cell[i]]] = i
        at[cell[i]] += 1
    return order, begin, low, a_mm


@njit(cache=True, nogil=True)
def _lists(
    centres: Floats, radii: Floats, here: Ints, places: Floats, wanted: Bools
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    n, lamps = wanted.shape
    # About one marker a cell; cells of one row of the grid lie one after the other.
    side = int(np.ceil(np.sqrt(len(here))))
    order, begin, origin, a_mm = _grid(centres[here, 0], centres[here, 1], side)
    order = here[order]
    xs, ys, zs, rs = centres[order, 0], centres[order, 1], centres[order, 2], radii[order]
    largest = rs.max()
    bottom, top = zs.min() - 2 * _ROOM * largest, zs.max() + 2 * _ROOM * largest
    first = np.zeros(n * lamps + 1, np.int32)
    members = np.empty(max(4 * n, 16), np.int32)
    used = 0
    for i in range(n):
        cx, cy, cz = centres[i, 0], centres[i, 1], centres[i, 2]
        for lamp in range(lamps):
            if wanted[i, lamp]:
                dx, dy, dz = places[i, lamp, 0] - cx, places[i, lamp, 1] - cy, places[i, lamp, 2] - cz
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                short = 1 / length
                end = 1.0
                if dz > 0:
                    end = min(end, (top - cz) / dz)
                elif dz < 0:
                    end = min(end, (bottom - cz) / dz)
                room = _ROOM * (radii[i] + largest)
                left, right = _cells(cx, cx + dx * end, room, origin[0], a_mm[0], side)
                low, high = _cells(cy, cy + dy * end, room, origin[1], a_mm[1], side)
                dx, dy, dz = dx * short, dy * short, dz * short
                for row in range(low, high + 1):
                    for at in range(begin[row * side + left], begin[row * side + right + 1]):
                        wx, wy, wz = xs[at] - cx, ys[at] - cy, zs[at] - cz
                        along = wx * dx + wy * dy + wz * dz
                        reach = _ROOM * (radii[i] + rs[at])
                        aside = wx * wx + wy * wy + wz * wz - along * along
                        if along > -reach and along < length + reach and aside < reach * reach and order[at] != i:
                            if used == len(members):
                                members = np.concatenate((members, np.empty_like(members)))
                            members[used] = order[at]
                            used += 1
            first[i * lamps + lamp + 1] = used
    return first, members[:used].copy()


@njit(cache=True, nogil=True)
def _cells(one: float, other: float, room: float, origin: float, a_mm: float, side: int) -> tuple[int, int]:
    """Return the first and the last row or column of cells near a way from one place to another."""
    low, high = (min(one, other) - room - origin) * a_mm, (max(one, other) + room - origin) * a_mm
    return int(max(min(low, side - 1.0), 0.0)), int(max(min(high, side - 1.0), 0.0))
