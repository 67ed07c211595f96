"""Everyday objects as closed surfaces: a letter, a gear, a screw, a brick, a grating and a ring.

Each stands as a probe does: z points into the body, and what touches first has the highest z.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from twin.arrays import Bools, Floats, frozen

_AROUND = 96
_STROKES = ("#####", "#...#", "#####", "#...#", "#...#")


def _halves(squares: Floats) -> Floats:
    """Return (2 m, 3, 3) the triangles of quadrilaterals (m, 4, 3)."""
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])


def _boxes(filled: Bools, sides_mm: tuple[float, float, float]) -> Floats:
    """Return the triangles around the ``filled`` (nx, ny, nz) boxes of a lattice."""
    squares = []
    for axis in range(3):
        ahead, first, second = (np.eye(3, dtype=int)[(axis + k) % 3] for k in range(3))
        change = np.diff(np.pad(filled, 1).astype(int), axis=axis)
        for sign in (1, -1):
            low = np.argwhere(change == -sign) - 1 + ahead
            corners = np.stack([low, low + first, low + first + second, low + second], axis=1)
            squares.append(corners[:, ::sign])
    return _halves(np.concatenate(squares) * np.array(sides_mm))


def _between(rows: Floats) -> Floats:
    """Return the triangles between neighbouring rows of points (n, m, 3); each row is closed."""
    here = rows[:-1]
    following = rows[1:]
    across = [here, following, np.roll(following, -1, axis=1), np.roll(here, -1, axis=1)]
    return _halves(np.stack(across, axis=2).reshape(-1, 4, 3))


def _fan(row: Floats) -> Floats:
    """Return the triangles between a closed row of points (m, 3) and their middle."""
    middle = np.broadcast_to(row.mean(axis=0), row.shape)
    return np.stack([row, np.roll(row, -1, axis=0), middle], axis=1)


def _at(flat: Floats, z: float) -> Floats:
    return np.column_stack([flat, np.full(len(flat), z)])


def _swept(sections: Floats) -> Floats:
    """Return the triangles of closed sections (n, m, 2) of radius and height around z."""
    angle = 2.0 * math.pi * np.arange(len(sections)) / len(sections)
    radius, height = np.moveaxis(sections, 2, 0)
    along = [np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius, height]
    rows = np.stack(along, axis=2)
    return _between(np.concatenate([rows, rows[:1]]))


def _letter() -> Floats:
    strokes = np.array([[mark == "#" for mark in row] for row in _STROKES])
    return _boxes(strokes.T[:, ::-1, None], (1.2, 1.2, 2.0))


def _grating() -> Floats:
    filled = np.ones((15, 1, 2), bool)
    filled[1::2, :, 1] = False
    return _boxes(filled, (0.5, 7.5, 1.0))


def _ring() -> Floats:
    around = 2.0 * math.pi * np.arange(48) / 48
    section = np.column_stack([3.2 + 0.8 * np.cos(around), 0.8 * np.sin(around)])
    return _swept(np.tile(section, (2 * _AROUND, 1, 1)))


def _gear() -> Floats:
    tooth = 12.0 * np.arange(_AROUND) / _AROUND % 1.0
    outer = 3.0 + np.clip(4.0 * np.abs(2.0 * tooth - 1.0) - 1.5, 0.0, 1.0)
    bore = np.full(_AROUND, 1.5)
    floor = np.zeros(_AROUND)
    top = np.full(_AROUND, 2.0)
    section = [(bore, floor), (outer, floor), (outer, top), (bore, top)]
    return _swept(np.moveaxis(np.array(section), 2, 0))


def _screw() -> Floats:
    around = 2.0 * math.pi * np.arange(_AROUND) / _AROUND
    along = np.linspace(4.0, -4.0, 129)[:, None]
    radius = 1.75 + 0.25 * np.cos(math.pi * along - around)
    x = np.broadcast_to(along, radius.shape)
    rows = np.stack([x, radius * np.cos(around), radius * np.sin(around)], axis=2)
    return np.concatenate([_between(rows), _fan(rows[0]), _fan(rows[-1, ::-1])])


def _outline(counts: tuple[int, int], side: float) -> Floats:
    """Return (m, 2) points around ``counts`` squares of a ``side``, eight along each."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * counts * side / 2.0
    sides = []
    for k in range(4):
        share = np.arange(8 * counts[k % 2])[:, None] / (8 * counts[k % 2])
        sides.append(corners[k] + share * (corners[(k + 1) % 4] - corners[k]))
    return np.concatenate(sides)


def _brick() -> Floats:
    counts = (3, 2)
    side = 2.6
    height = 3.0
    stud = 0.8
    border = _outline((1, 1), side)
    circle = stud * border / np.hypot(*border.T)[:, None]
    whole = _outline(counts, side)
    found = [_between(np.stack([_at(whole, 0.0), _at(whole, -height)]))]
    found.append(_fan(_at(whole, -height)[::-1]))
    for cell in np.ndindex(*counts):
        middle = (np.array(cell) - (np.array(counts) - 1) / 2.0) * side
        rows = [_at(middle + circle, 0.6), _at(middle + circle, 0.0), _at(middle + border, 0.0)]
        found += [_between(np.stack(rows)), _fan(rows[0])]
    return np.concatenate(found)


_MADE = {
    "letter": _letter,
    "gear": _gear,
    "screw": _screw,
    "brick": _brick,
    "grating": _grating,
    "ring": _ring,
}


@lru_cache(maxsize=32)
def object_triangles(shape: str, width_mm: float) -> Floats:
    """Return (m, 3, 3) the outward triangles of an object, as wide along x, its middle over z.

    ``shape`` is an A of square strokes a fifth of the width wide (``letter``), a spur ``gear`` of
    12 teeth on its face, a ``screw`` that lies along x (pitch a quarter of the width), a ``brick``
    with 3 by 2 round studs, a ``grating`` of 8 ridges along y and as wide gaps, or a ``ring`` of
    round section (a tenth of the width in radius).
    """
    found = np.asarray(_MADE[shape](), float)
    low, high = found.min(axis=(0, 1)), found.max(axis=(0, 1))
    found[..., :2] -= (low[:2] + high[:2]) / 2.0
    return frozen(found * (width_mm / (high[0] - low[0])))
