"""Candidate contact patches: plane rectangles on the true surface, cut from a grid under the probe.

The grid lies in a plane at the place that is touched first and is projected along the plane's normal onto the body, so
that flat-ended probes keep their exact footprint and curved bodies are tiled without a chart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen
from twin.compiled import njit
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.world.contact.cells import Box, Face, cells
from twin.world.contact.probe_shape import half_extent

Corners = tuple[tuple[float, float], tuple[float, float]]
"""The lowest and the highest corner of a box."""

_STEEP = 0.15


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane with its own axes: rows of ``axes`` are u, v and the direction of projection (into the body)."""

    origin_mm: Floats
    axes: Floats


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

    def rectangles(self, force_n: Floats, chosen: Ints) -> Rectangles:
        """Return the n chosen patches under their forces (n, 3), global axes."""
        return Rectangles(
            centre_mm=self.centre_mm[chosen], frames=self.frames[chosen], half_mm=self.half_mm[chosen], force_n=force_n
        )

    def bounds(self, chosen: Bools) -> Box:
        """Return the box around the chosen cells, in the grid's plane."""
        return Box(*_around(self.middle_mm, self.cell_mm, chosen))


@njit(cache=True)
def _around(middle: Floats, cell: Floats, chosen: Bools) -> tuple[float, float, float, float]:
    """Return the least and largest u, the least and largest v of chosen cells."""
    u0, u1, v0, v1 = math.inf, -math.inf, math.inf, -math.inf
    for i in np.flatnonzero(chosen):
        u0, u1 = min(u0, middle[i, 0] - cell[i, 0]), max(u1, middle[i, 0] + cell[i, 0])
        v0, v1 = min(v0, middle[i, 1] - cell[i, 1]), max(v1, middle[i, 1] + cell[i, 1])
    return u0, u1, v0, v1


def joined(parts: Sequence[Patches]) -> Patches:
    """Return the patches under several probes, one after the other."""
    if len(parts) == 1:
        return parts[0]
    return Patches(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})


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


@njit(cache=True)
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


def all_level(body: Body, plane: Plane, box: Box) -> bool:
    """Return whether a box, with a hair's breadth around it, lies on a body's surface where that is level."""
    x, y, z = plane.origin_mm.tolist()
    reach = math.hypot(max(-box.u0, box.u1), max(-box.v0, box.v1))
    return bool(z == 0.0 and plane.axes[2, 2] == 1.0 and body.is_level_around(x, y, (1.0 + 1e-6) * reach))


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
        The piece of the plane to fill; without a face only the ellipse inscribed in it, unless it is long.
    across
        Cells along u and v.

    Returns
    -------
    Patches on the sensing surface. Cells beyond the body are left out, and their neighbours marked as ``edge``.
    """
    middle, cell = cells(face, box, across)
    limit = half_extent(face) if face is not None else (math.inf, math.inf)
    corners = (box.u0, box.v0), (box.u1, box.v1)
    is_round = face is None and not box.is_long
    if all_level(body, plane, box):
        centre, frames, middle, half, border = _in_plane(
            middle, cell, corners, limit, is_round, plane.origin_mm, plane.axes
        )
        return Patches(
            centre_mm=centre, frames=frames, half_mm=half, middle_mm=middle, cell_mm=half, border=border,
            edge=np.zeros(len(middle), bool),
        )  # fmt: skip
    outside, outer = _bordering(middle, cell, corners, limit, is_round)
    points, frames, half, off = _on_body(body, plane, middle, cell)
    kept = ~(off | outside)
    edge = _touching(middle, cell, off) if off.any() else off
    return Patches(
        centre_mm=points[kept], frames=frames[kept], half_mm=half[kept], middle_mm=middle[kept], cell_mm=cell[kept],
        border=outer[kept], edge=edge[kept],
    )  # fmt: skip


@njit(cache=True)
def _bordering(
    middle: Floats, cell: Floats, box: Corners, limit: tuple[float, float], is_round: bool
) -> tuple[Bools, Bools]:
    """Return (n,) which cells lie outside the ellipse in a box, and which have a neighbour there, or outside the box.

    The ellipse counts where the grid ``is_round``. Beyond a flat face, whose half widths are the ``limit``, there are
    no neighbours.
    """
    (low, high), flat = box, math.isfinite(limit[0])
    outside, outer = np.zeros(len(middle), np.bool_), np.zeros(len(middle), np.bool_)
    near = 1e-6 * max(limit[0], limit[1]) if flat else 0.0
    for i in range(len(middle)):
        squared = 0.0
        for axis in range(2):
            reach = cell[i, axis] * (1 + 1e-6)
            if not flat or low[axis] > near - limit[axis]:
                outer[i] = outer[i] or middle[i, axis] - reach <= low[axis]
            if not flat or high[axis] < limit[axis] - near:
                outer[i] = outer[i] or middle[i, axis] + reach >= high[axis]
            squared += ((middle[i, axis] - (low[axis] + high[axis]) / 2) / ((high[axis] - low[axis]) / 2)) ** 2
        outside[i] = is_round and squared > 1.0
    if is_round:
        outer |= _touching(middle, cell, outside)
    return outside, outer


@njit(cache=True)
def _in_plane(
    middle: Floats,
    cell: Floats,
    box: Corners,
    limit: tuple[float, float],
    is_round: bool,
    origin_mm: Floats,
    axes: Floats,
) -> tuple[Points, Floats, Floats, Floats, Bools]:
    """Return centres, frames, middles, half sizes and borders of the cells that aren't outside, left where they are."""
    outside, outer = _bordering(middle, cell, box, limit, is_round)
    rows = np.flatnonzero(~outside)
    k = len(rows)
    centre, frames, kept, half, border = (
        np.empty((k, 3)), np.empty((k, 3, 3)), np.empty((k, 2)), np.empty((k, 2)), np.empty(k, np.bool_),
    )  # fmt: skip
    for n, i in enumerate(rows):
        for axis in range(3):
            centre[n, axis] = origin_mm[axis] + (middle[i, 0] * axes[0, axis] + middle[i, 1] * axes[1, axis])
            for side in range(3):
                frames[n, side, axis] = axes[side, axis]
        for side in range(2):
            kept[n, side], half[n, side] = middle[i, side], cell[i, side]
        border[n] = outer[i]
    return centre, frames, kept, half, border
