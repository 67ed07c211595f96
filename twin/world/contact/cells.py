"""The cells of a contact's grid in its plane, before they are projected onto the body.

Rows of a round footprint end where the row's piece of the disc has its exact area. Why graded cells at a footprint's
border: the pressure under a sharp edge grows like 1/sqrt(distance), and cells that shrink like its inverse carry equal
forces. Under a rounded rim that cells resolve it ends like a sphere's: equal cells, a lattice on a flat body, serve as
well.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit
from twin.parts.probe import Cylinder, Pillar
from twin.world.contact.probe_shape import half_extent

Face = Cylinder | Pillar | None
"""The probe whose flat face bounds the contact; None where nothing but the contact itself does."""


LONG = 3.0
"""Length over width of a box from which on no ellipse is cut out of it."""


class Box(NamedTuple):
    """The piece (u0, u1, v0, v1) of a plane in which contact is sought, mm."""

    u0: float
    u1: float
    v0: float
    v1: float

    @property
    def size(self) -> tuple[float, float]:
        """Extents along u and v, mm."""
        return self.u1 - self.u0, self.v1 - self.v0

    @property
    def is_long(self) -> bool:
        """Whether it is so long that a contact in it is taken for a line, which fills its corners."""
        return max(self.size) > LONG * min(self.size)

    def clipped(self, face: Face) -> Box:
        """Return the part under a flat face; without one, everything."""
        if face is None:
            return self
        a, b = half_extent(face)
        return Box(u0=max(self.u0, -a), u1=min(self.u1, a), v0=max(self.v0, -b), v1=min(self.v1, b))

    def joined(self, other: Box) -> Box:
        """Return the box around this one and another."""
        return Box(
            u0=min(self.u0, other.u0), u1=max(self.u1, other.u1), v0=min(self.v0, other.v0), v1=max(self.v1, other.v1)
        )

    def grown(self, u: float, v: float) -> Box:
        """Return the box with margins u and v added on either side."""
        return Box(u0=self.u0 - u, u1=self.u1 + u, v0=self.v0 - v, v1=self.v1 + v)


def cell_edges(low: float, high: float, count: int, *, graded: tuple[bool, bool]) -> Floats:
    """Return (count + 1,) cell borders between low and high, graded like a cosine towards the ends marked so."""
    x = np.linspace(0.0, 1.0, count + 1)
    shape = {
        (False, False): x,
        (True, False): 1.0 - np.cos(math.pi / 2 * x),
        (False, True): np.sin(math.pi / 2 * x),
        (True, True): (1.0 - np.cos(math.pi * x)) / 2,
    }[graded]
    return np.asarray(low + (high - low) * shape)


def _half_chord(face: Cylinder | Pillar, v0: float, v1: float) -> float:
    """Half the mean width of the footprint between v0 and v1: the strip's exact area over its height."""
    if isinstance(face, Pillar):
        return face.size_mm[0] / 2
    a = face.diameter_mm / 2
    area = [(v * math.sqrt(max(a * a - v * v, 0.0)) + a * a * math.asin(max(-1.0, min(1.0, v / a)))) / 2
            for v in (v0, v1)]  # fmt: skip
    return (area[1] - area[0]) / (v1 - v0)


def is_even(face: Face, box: Box, across: tuple[int, int]) -> bool:
    """Return whether all cells are equal: where no face bounds the contact, or its rim is as wide as a cell."""
    return face is None or face.edge_mm >= max(size / count for size, count in zip(box.size, across, strict=True))


def _even_cells(face: Face, box: Box, across: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return (n, 2) middles and (n, 2) half sizes of equal cells, those beyond a round face left out."""
    radius = face.diameter_mm / 2 if isinstance(face, Cylinder) else math.inf
    half_u, half_v = (size / (2 * count) for size, count in zip(box.size, across, strict=True))
    middle, half = _crossed(box.u0, box.v0, half_u, half_v, across[0], across[1], radius)
    return middle, half


@njit(cache=True)
def _crossed(
    u0: float, v0: float, half_u: float, half_v: float, columns: int, rows: int, radius: float
) -> tuple[Floats, Floats]:
    """Return (n, 2) crossings of columns and rows that lie within a disc, row by row, and (n, 2) the same halves."""
    middle, n = np.empty((columns * rows, 2)), 0
    for j in range(rows):
        for i in range(columns):
            u, v = (2 * i + 1) * half_u + u0, (2 * j + 1) * half_v + v0
            if math.hypot(u, v) < radius:
                middle[n, 0], middle[n, 1] = u, v
                n += 1
    half = np.empty((n, 2))
    half[:, 0], half[:, 1] = half_u, half_v
    return middle[:n], half


def cells(face: Face, box: Box, across: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return (n, 2) middles and (n, 2) half sizes of the grid's cells."""
    if face is None or is_even(face, box, across):
        return _even_cells(face, box, across)
    a, b = half_extent(face)
    near = 1e-6 * max(a, b)
    rows = cell_edges(box.v0, box.v1, across[1], graded=(box.v0 <= near - b, box.v1 >= b - near))
    middles, halves = [], []
    for v0, v1 in pairwise(rows):
        chord = _half_chord(face, float(v0), float(v1))
        u0, u1 = max(box.u0, -chord), min(box.u1, chord)
        if u1 <= u0:
            continue
        count = max(3, round(across[0] * math.sqrt((u1 - u0) / box.size[0])))
        columns = cell_edges(u0, u1, count, graded=(u0 <= near - chord, u1 >= chord - near))
        middles.append(np.column_stack([(columns[:-1] + columns[1:]) / 2, np.full(count, (v0 + v1) / 2)]))
        halves.append(np.column_stack([np.diff(columns) / 2, np.full(count, (v1 - v0) / 2)]))
    return np.concatenate(middles), np.concatenate(halves)
