"""Candidate contact patches: plane rectangles on the true surface, cut from a grid under the probe.

The grid lies in a plane at the place that is touched first and is projected along the plane's normal onto the body, so
that flat-ended probes keep their exact footprint and curved bodies are tiled without a chart. Rows of a round
footprint end where the row's piece of the disc has its exact area. Why graded cells at a footprint's border: the
pressure under a sharp edge grows like 1/sqrt(distance), and cells that shrink like its inverse carry equal forces.
Under a rounded rim that cells resolve it ends like a sphere's: equal cells, a lattice on a flat body, serve as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin.arrays import Bools, Floats, Points, frozen
from twin.compiled import njit
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.probe import Cylinder, Pillar
from twin.world.contact.probe_shape import half_extent

Face = Cylinder | Pillar | None
"""The probe whose flat face bounds the contact; None where nothing but the contact itself does."""

_STEEP = 0.15


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane with its own axes: rows of ``axes`` are u, v and the direction of projection (into the body)."""

    origin_mm: Floats
    axes: Floats


@dataclass(frozen=True, kw_only=True)
class Box:
    """The piece (u0, u1, v0, v1) of a plane in which contact is sought, mm."""

    u0: float
    u1: float
    v0: float
    v1: float

    @property
    def size(self) -> tuple[float, float]:
        """Extents along u and v, mm."""
        return self.u1 - self.u0, self.v1 - self.v0

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


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Candidate patches.

    Attributes
    ----------
    centre_mm, frames, half_mm
        As in `Rectangles`: (k, 3), (k, 3, 3), (k, 2).
    middle_mm, cell_mm
        (k, 2) middles and half sizes of the cells in the plane of the grid.
    border
        (k,) whether contact there means that the grid is too small.
    edge
        (k,) whether a neighbour lies off the sensing surface.
    """

    centre_mm: Points
    frames: Floats
    half_mm: Floats
    middle_mm: Floats
    cell_mm: Floats
    border: Bools
    edge: Bools

    def __post_init__(self) -> None:
        for array in vars(self).values():
            frozen(array)

    def __len__(self) -> int:
        return len(self.centre_mm)

    @property
    def area_mm2(self) -> Floats:
        """(k,) areas."""
        return np.asarray(4.0 * self.half_mm[:, 0] * self.half_mm[:, 1])

    @property
    def unloaded(self) -> Rectangles:
        """All patches under no force."""
        return Rectangles(
            centre_mm=self.centre_mm, frames=self.frames, half_mm=self.half_mm, force_n=np.zeros((len(self), 3))
        )

    def rectangles(self, force_n: Floats, chosen: Bools) -> Rectangles:
        """Return the chosen patches under the forces (k, 3) of all, global axes."""
        return Rectangles(
            centre_mm=self.centre_mm[chosen], frames=self.frames[chosen], half_mm=self.half_mm[chosen],
            force_n=np.array(force_n[chosen]),
        )  # fmt: skip

    def bounds(self, chosen: Bools) -> Box:
        """Return the box around the chosen cells, in the grid's plane."""
        low = (self.middle_mm - self.cell_mm)[chosen].min(axis=0)
        high = (self.middle_mm + self.cell_mm)[chosen].max(axis=0)
        return Box(u0=float(low[0]), u1=float(high[0]), v0=float(low[1]), v1=float(high[1]))


def joined(parts: Sequence[Patches]) -> Patches:
    """Return the patches under several probes, one after the other."""
    if len(parts) == 1:
        return parts[0]
    return Patches(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})


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
    sides = [size / (2 * count) for size, count in zip(box.size, across, strict=True)]
    u, v = (
        np.arange(1, 2 * count, 2) * side + low
        for low, count, side in zip((box.u0, box.v0), across, sides, strict=True)
    )
    grid = np.empty((len(v), len(u), 2))
    grid[..., 0], grid[..., 1] = u, v[:, None]
    middle = grid.reshape(-1, 2)
    if isinstance(face, Cylinder):
        middle = middle[np.hypot(middle[:, 0], middle[:, 1]) < face.diameter_mm / 2]
    half = np.empty_like(middle)
    half[:] = sides
    return middle, half


def _cells(face: Face, box: Box, across: tuple[int, int]) -> tuple[Floats, Floats]:
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


def _projected(body: Body, plane: Plane, middle: Floats) -> tuple[Points, Floats, Bools]:
    """Project (n, 2) middles along the plane's normal; return points, inward normals and whether they are on it."""
    along = plane.axes[2]
    points = plane.origin_mm + middle @ plane.axes[:2]
    for _ in range(30):
        normals = body.piece_normals(points)[:, 0]
        slope = np.maximum(normals @ along, _STEEP)
        step = -body.depth(points) / slope
        points = points + step[:, None] * along
        if np.abs(step).max() < 1e-13 * (1.0 + np.abs(points).max()):
            break
    normals = np.array(body.piece_normals(points)[:, 0])
    return points, normals, (np.abs(body.depth(points)) < 1e-9) & (normals @ along > _STEEP)


def _tangent_rectangles(plane: Plane, cell: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return frames (n, 3, 3) and half sizes (n, 2) of cells projected onto their own tangent planes.

    A projected cell is a parallelogram; the rectangle keeps its first side's length and direction, and its area.
    """
    u, v, along = plane.axes
    slope = np.maximum(normals @ along, _STEEP)
    side_u = u - np.outer(normals @ u / slope, along)
    side_v = v - np.outer(normals @ v / slope, along)
    length = np.linalg.norm(side_u, axis=1)
    first = side_u / length[:, None]
    area = np.linalg.norm(np.cross(side_u, side_v), axis=1)
    half = np.column_stack([cell[:, 0] * length, cell[:, 1] * area / length])
    return np.stack([first, np.cross(normals, first), normals], axis=1), half


@njit(cache=True)  # type: ignore[untyped-decorator]
def _touching(middle: Floats, cell: Floats, others: Bools) -> Bools:
    """Return (n,) whether each cell is one of the others, or has one for a neighbour, corners included."""
    rows, found = np.flatnonzero(others), others.copy()
    for i in np.flatnonzero(~others):
        for j in rows:
            u, v = cell[i, 0] + cell[j, 0], cell[i, 1] + cell[j, 1]
            near = abs(middle[i, 0] - middle[j, 0]) <= u * (1 + 1e-6)
            if near and abs(middle[i, 1] - middle[j, 1]) <= v * (1 + 1e-6):
                found[i] = True
                break
    return found


def _all_level(body: Body, plane: Plane, box: Box) -> bool:
    """Return whether a box, with a hair's breadth around it, lies on a plane piece of a convex body's surface."""
    if not body.is_convex:
        return False
    wide = box.grown(1e-6 * box.size[0], 1e-6 * box.size[1])
    places = np.array([(0.0, 0.0), *((u, v) for u in (wide.u0, wide.u1) for v in (wide.v0, wide.v1))])
    points = plane.origin_mm + places @ plane.axes[:2]
    distances = body.piece_distances(points)
    return bool(np.abs(distances[:, 0]).max() == 0.0 and distances[:, 1:].min() > 0.0)


def _on_body(body: Body, plane: Plane, middle: Floats, cell: Floats) -> tuple[Points, Floats, Floats, Bools]:
    """Return points, frames and half sizes of cells projected on the body, and (n,) which don't lie on it wholly."""
    points, normals, found = _projected(body, plane, middle)
    frames, half = _tangent_rectangles(plane, cell, normals)
    off = ~found
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        side = np.array(signs) * half
        corners = points + side[:, :1] * frames[:, 0] + side[:, 1:] * frames[:, 1]
        # A tangent corner stands out of a curved surface a little; only the other pieces of the boundary count.
        off |= np.any(body.piece_distances(corners)[:, 1:] < -1e-9, axis=1)
    return points, frames, half, off


def candidate_patches(body: Body, face: Face, plane: Plane, box: Box, across: tuple[int, int]) -> Patches:
    """Cut the candidate patches under a probe.

    Parameters
    ----------
    body, face
        The undeformed body, and the probe whose flat face bounds the contact, if one does.
    plane
        Plane of the grid, at the place touched first, or of the face.
    box
        The piece of the plane to fill; without a face only the ellipse inscribed in it.
    across
        Cells along u and v.

    Returns
    -------
    Patches on the sensing surface. Cells beyond the body are left out, and their neighbours marked as ``edge``.
    """
    flat = face is not None
    middle, cell = _cells(face, box, across)
    if _all_level(body, plane, box):
        points, frames = plane.origin_mm + middle @ plane.axes[:2], np.empty((len(middle), 3, 3))
        frames[:], half, off = plane.axes, cell, np.zeros(len(middle), bool)
    else:
        points, frames, half, off = _on_body(body, plane, middle, cell)
    kept = ~off
    outer = np.zeros(len(middle), bool)
    a, b = half_extent(face) if face is not None else (math.inf, math.inf)
    near = 1e-6 * max(a, b) if flat else 0.0
    for axis, (low, high), limit in ((0, (box.u0, box.u1), a), (1, (box.v0, box.v1), b)):
        reach = cell[:, axis] * (1 + 1e-6)
        if not flat or low > near - limit:
            outer |= middle[:, axis] - reach <= low
        if not flat or high < limit - near:
            outer |= middle[:, axis] + reach >= high
    if not flat:
        round_in = (middle - [(box.u0 + box.u1) / 2, (box.v0 + box.v1) / 2]) / (np.array(box.size) / 2)
        outside = np.hypot(round_in[:, 0], round_in[:, 1]) > 1.0
        outer |= _touching(middle, cell, outside)
        kept &= ~outside
    edge = _touching(middle, cell, off) if off.any() else off
    return Patches(
        centre_mm=points[kept], frames=frames[kept], half_mm=half[kept], middle_mm=middle[kept], cell_mm=cell[kept],
        border=outer[kept], edge=edge[kept],
    )  # fmt: skip
