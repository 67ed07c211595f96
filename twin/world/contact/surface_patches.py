"""Candidate contact patches: plane rectangles on the true surface, cut from a grid of cells under
the probe.

The grid lies in a plane at the place that is touched first and is projected along the plane's
normal onto the body, so that flat-ended probes keep their exact footprint and curved bodies are
covered without a chart.

Rows of a round footprint end where the row's piece of the disc has its exact area. Why graded cells
at a footprint's border: the pressure under a sharp edge grows like 1/sqrt(distance), and cells that
shrink like its inverse carry equal forces. They also follow where contact ends on a rounded rim, if
that is known about (`Footprint.pressed`).

A cell touches wholly or not at all. Sharp edges of the probe along the grid cut a whole row alike,
and forces jump by per cents from grid to grid. So cells end a little beyond such edges
(`Box.with_edges`, `Box.aligned`), and so do graded cells beyond the sharp rim of a flat face.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen
from twin.parts.body import Body
from twin.parts.load import Rectangles

_LONG = 3.0
"""Length over width of a box from which on no ellipse is cut out of it."""

_RASTER = 64
"""Places along each side at which edges are looked for."""

_HALVINGS = 10
"""Bisections of a step of the raster around an edge."""

_JUMP = 0.2
"""Least jump of the gap at a sharp edge, over the deepest overlap."""

_ALONG = 0.08
_STRAIGHT, _SPREAD = 0.05, 0.3
"""Share of the raster's rows that an edge along the grid crosses at least; how far it may lie apart
from row to row, and in all, in steps of the raster."""

_BEYOND_RIM = 0.2
"""How far graded cells end beyond a sharp rim, over the width of the last. Without that flat faces
act as smaller ones: at 8, 12 and 20 cells across forces at a given depth were 1.3, 0.6 and 0.24 %
too small under a square, 1.6, 0.8 and 0.36 % under a disc, whose rows end in steps. They are 0.03 %
at most and 0.5, 0.36 and 0.21 % so; alike sideways, and on layers."""

_FINEST, _WIDEST, _STEPS = 0.8, 1.1, 601
"""Widths of cells that are tried, over the width asked for, and how many."""

_AWAY = 0.1
"""How far edges may lie from there, over the cells' width, for a grid that is aligned."""

_AS_ASKED = 0.03
"""How much a change of the cells' width counts against a distance from edges."""

_FILLS = 0.85
"""Least extent of a contact over that of its closed form, below which the closed form is not
used."""


_RAYS = 60
_ALONG_RAY = 240
_NEAR = 0.3
_FAR = 1.5
"""Rays from a contact's middle along which its end is sought, steps along each, and where over its
size."""

_EVEN = 1.0 + 1e-9
"""Pressures of patches that lie alike are equal up to this."""

_OWN = 1e-9
"""Least singular value of a fit over the largest: terms that others make up (patches in two rows)
are left out."""

_FEWEST = 12
_APART = 0.15
"""Patches from which on a fit is made, and how far its area may be from their sum."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """The outline of a flat face in the plane of the grid, its middle over the plane's origin.

    Attributes
    ----------
    half_mm
        Half sizes along the grid's axes; a tilted face is seen shortened.
    is_round
        Whether it is an ellipse; else it is a rectangle.
    edge_mm
        Radius by which the rim is rounded; 0 is sharp.
    """

    half_mm: tuple[float, float]
    is_round: bool
    edge_mm: float = 0.0

    @property
    def area_mm2(self) -> float:
        """The area within the outline."""
        return (math.pi if self.is_round else 4.0) * math.prod(self.half_mm)

    def pressed(self, force_mm2: float) -> Footprint | None:
        """Return the outline of the part of a face with a rounded rim that touches, and a little
        more, under a force over E / (1 - nu^2); None where more of the rim touches than is flat.

        Notes
        -----
        A round face that is flat up to b and curved with the radius R beyond touches up to a, where
        its indentation is a / R (sqrt(a^2 - b^2) - b arccos(b / a)) (M. Ciavarella 1999). The flat
        face of that force, sunk by force / (2 b), stands for that, as it has about the same
        singularity at its rim; thin rubber has less of it.
        """
        from scipy.optimize import brentq

        rim = self.edge_mm
        b = max(math.sqrt(math.prod(half - rim for half in self.half_mm)), _POINTED * rim)

        def missing(a: float) -> float:
            sunk = a / rim * (math.sqrt(a * a - b * b) - b * math.acos(b / a))
            return sunk - force_mm2 / (2.0 * b)

        touched = float(brentq(missing, b, b + rim)) - b if missing(b + rim) > 0.0 else rim
        if touched > b:
            return None
        back = max(0.0, rim - _BEYOND * touched)
        half = (self.half_mm[0] - back, self.half_mm[1] - back)
        return replace(self, half_mm=half, edge_mm=0.0)


_BEYOND = 1.15
"""Extent of the cells on a rounded rim over that of the contact: cells at the border are narrow, so
that it matters little which of them touch."""

_POINTED = 1e-3
"""Least flat part of a face over its rim."""


class Box(NamedTuple):
    """The piece (u0, u1, v0, v1) of a plane in which contact is sought, mm.

    ``width_mm`` is the mean width of the pieces of a contact that fills little of it; inf of a
    contact in one piece that fills it. ``edges`` are the places along u and v of the probe's sharp
    edges across them, each with 1 where the probe ends upwards from there, else -1. ``face`` is
    what touches of a flat face, where it is known.
    """

    u0: float
    u1: float
    v0: float
    v1: float
    width_mm: float = math.inf
    edges: tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]] = ((), ())
    face: Footprint | None = None

    @property
    def size(self) -> tuple[float, float]:
        """Extents along u and v, mm."""
        return self.u1 - self.u0, self.v1 - self.v0

    @property
    def is_long(self) -> bool:
        """Whether it is so long that a contact in it is taken for a line."""
        return max(self.size) > _LONG * min(self.size)

    def is_even(self, face: Footprint | None, across: tuple[int, int]) -> bool:
        """Return whether all cells are equal: where no face bounds the contact, or its rim is as
        wide as a cell."""
        face = self.face or face
        return face is None or face.edge_mm >= max(
            size / count for size, count in zip(self.size, across, strict=True)
        )

    def fills(self, other: Box) -> bool:
        """Return whether the box is about as large as another."""
        pairs = zip(self.size, other.size, strict=True)
        return min(own / wanted for own, wanted in pairs) >= _FILLS

    def clipped(self, face: Footprint | None) -> Box:
        """Return the part under a flat face; without one, everything."""
        face = self.face or face
        if face is None:
            return self
        a, b = face.half_mm
        return self._replace(
            u0=max(self.u0, -a), u1=min(self.u1, a), v0=max(self.v0, -b), v1=min(self.v1, b)
        )

    def joined(self, other: Box) -> Box:
        """Return the box around this one and another."""
        return Box(
            u0=min(self.u0, other.u0),
            u1=max(self.u1, other.u1),
            v0=min(self.v0, other.v0),
            v1=max(self.v1, other.v1),
            width_mm=min(self.width_mm, other.width_mm),
            edges=self.edges if any(self.edges) else other.edges,
            face=(
                max(self.face, other.face, key=lambda face: math.prod(face.half_mm))
                if self.face and other.face
                else None
            ),
        )

    def grown(self, u: float, v: float) -> Box:
        """Return the box with margins u and v added on either side."""
        return self._replace(u0=self.u0 - u, u1=self.u1 + u, v0=self.v0 - v, v1=self.v1 + v)

    def moved(self, u: float, v: float) -> Box:
        """Return the box moved by u and v, without edges. Moved by more than its length, its
        shorter side sets the cells' size: a box that joins both places is much longer."""
        width = min(self.size) if math.hypot(u, v) > max(self.size) else math.inf
        return Box(self.u0 + u, self.u1 + u, self.v0 + v, self.v1 + v, width)

    def with_edges(self, gap_at: Callable[[Floats], Floats], wide: Box) -> Box:
        """Return the box with the places of a probe's sharp edges along its two sides.

        ``gap_at`` returns the (n,) gaps at places (n, 2) of the plane, NaN off the body; edges are
        looked for in the box ``wide``.
        """
        # 1. Gaps on a raster; where they are negative the probe overlaps the body at rest.
        u, v = (
            np.linspace(low, high, _RASTER)
            for low, high in ((wide.u0, wide.u1), (wide.v0, wide.v1))
        )
        places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
        gap = gap_at(places.reshape(-1, 2)).reshape(_RASTER, _RASTER)
        inside = gap <= 0.0
        if not inside.any():
            return self
        jump = -_JUMP * float(gap[inside].min())
        lines: list[tuple[tuple[float, float], ...]] = []
        for axis in range(2):
            first, second = np.nonzero(np.diff(inside, axis=axis))
            if len(first) == 0:
                lines.append(())
                continue
            one = places[first, second]
            other = places[first + (axis == 0), second + (axis == 1)]
            # 2. Bisect: `one` stays on the inner side of an edge, `other` on the outer one.
            swap = ~inside[first, second]
            one[swap], other[swap] = other[swap].copy(), one[swap].copy()
            for _ in range(_HALVINGS):
                middle = (one + other) / 2.0
                inner = gap_at(middle) <= 0.0
                one[inner] = middle[inner]
                other[~inner] = middle[~inner]
            # 3. The edge is sharp where the gap jumps; a smooth border moves with the load.
            outer = gap_at(other)
            sharp = np.isinf(outer) | (outer - gap_at(one) > jump)
            step = float(u[1] - u[0] if axis == 0 else v[1] - v[0])
            place = ((one + other) / 2.0)[:, axis]
            lines.append(
                tuple(
                    (common, way)
                    for way, ends in ((1.0, ~swap), (-1.0, swap))
                    for common in _common(place[sharp & ends], step)
                )
            )
        return self._replace(edges=(lines[0], lines[1]))

    def aligned(self, counts: tuple[int, int], thick_mm: float) -> tuple[Box, tuple[int, int]]:
        """Return a box and its cells along u and v, changed so that cells end a little beyond the
        box's edges as far as one width of cells allows that."""
        u, v = map(np.array, self.edges)
        u0, u1, across = _side(self.u0, self.u1, counts[0], u, thick_mm)
        v0, v1, along = _side(self.v0, self.v1, counts[1], v, thick_mm)
        return self._replace(u0=u0, u1=u1, v0=v0, v1=v1), (across, along)

    @staticmethod
    def beyond_edge(width_mm: Floats, thick_mm: float) -> Floats:
        """Return how far cells end beyond a sharp edge, over their width, as even pressures on them
        act as if it lay so far within their end.

        0.159 to 0.169 under a square; 0.171, 0.158, 0.131 and 0.11 under a strip on a layer 100, 5,
        2 and 1 cells thick (nu 0.49; 0.161 to 0.121 at 0.3).
        """
        return np.asarray(0.165 / (1.0 + width_mm / (2.0 * thick_mm)))


def _common(found: Floats, step: float) -> tuple[float, ...]:
    """Return the places that many rows of a raster of steps ``step`` have in common."""
    found = np.sort(found)
    groups = np.split(found, np.flatnonzero(np.diff(found) > _STRAIGHT * step) + 1)
    return tuple(
        float(one.mean())
        for one in groups
        if len(one) >= _ALONG * _RASTER and np.ptp(one) <= _SPREAD * step
    )


def _side(
    low: float, high: float, count: int, edges: Floats, thick_mm: float
) -> tuple[float, float, int]:
    """Return both ends of a side and the number of its cells, for (n, 2) edges and their ways."""
    if len(edges) == 0:
        return low, high, count
    place, way = edges[edges[:, 0].argsort()].T
    asked = (high - low) / count
    low, high = min(low, float(place[0])), max(high, float(place[-1]))
    widths = asked * np.linspace(_FINEST, _WIDEST, _STEPS)
    # Ridges as narrow as gaps leave no room beyond edges.
    for beyond in (edge := np.outer(Box.beyond_edge(widths, thick_mm), way), 0.0 * edge):
        at = (place - place[0]) / widths[:, None] + beyond
        off = at - at[:, :1]
        off -= np.rint(off)
        shift = off.mean(axis=1)
        away = np.sqrt(np.mean((off - shift[:, None]) ** 2, axis=1))
        best = int(np.argmin(away + _AS_ASKED * np.abs(widths / asked - 1.0)))
        if away[best] <= _AWAY:
            width = float(widths[best])
            start = float(place[0] + (shift[best] + beyond[best, 0]) * width)
            first = np.floor((low - start) / width + 1e-6)
            last = np.ceil((high - start) / width - 1e-6)
            return start + first * width, start + last * width, int(last - first)
    return low, high, count


def _cell_edges(low: float, high: float, count: int, *, graded: tuple[bool, bool]) -> Floats:
    """Return (count + 1,) cell borders between low and high, graded like a cosine towards the ends
    marked so."""
    x = np.linspace(0.0, 1.0, count + 1)
    shape = {
        (False, False): x,
        (True, False): 1.0 - np.cos(math.pi / 2 * x),
        (False, True): np.sin(math.pi / 2 * x),
        (True, True): (1.0 - np.cos(math.pi * x)) / 2,
    }[graded]
    return np.asarray(low + (high - low) * shape)


def _half_chord(face: Footprint, v0: float, v1: float) -> float:
    """Half the mean width of the footprint between v0 and v1: the strip's exact area over its
    height."""
    a, b = face.half_mm
    if not face.is_round:
        return a
    area = [
        (v * math.sqrt(max(b * b - v * v, 0.0)) + b * b * math.asin(max(-1.0, min(1.0, v / b)))) / 2
        for v in (v0, v1)
    ]
    return a / b * (area[1] - area[0]) / (v1 - v0)


def _even_cells(face: Footprint | None, box: Box, across: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return (n, 2) middles and (n, 2) half sizes of equal cells, those beyond a round face left
    out."""
    a, b = face.half_mm if face is not None and face.is_round else (math.inf, math.inf)
    half_u, half_v = (size / (2 * count) for size, count in zip(box.size, across, strict=True))
    u = (2 * np.arange(across[0]) + 1) * half_u + box.u0
    v = (2 * np.arange(across[1]) + 1) * half_v + box.v0
    middle = np.column_stack([np.tile(u, across[1]), np.repeat(v, across[0])])
    middle = middle[np.hypot(middle[:, 0] / a, middle[:, 1] / b) < 1.0]
    return middle, np.tile([half_u, half_v], (len(middle), 1))


def _cells(
    face: Footprint | None, box: Box, across: tuple[int, int], beyond: float
) -> tuple[Floats, Floats]:
    """Return (n, 2) middles and (n, 2) half sizes of the grid's cells; graded ones end ``beyond`` a
    face's rim by so much of the last one's width."""
    if face is None or box.is_even(face, across):
        return _even_cells(face, box, across)
    a, b = face.half_mm
    near = 1e-6 * max(a, b)
    graded = (box.v0 <= near - b, box.v1 >= b - near)
    rows = _cell_edges(box.v0, box.v1, across[1], graded=graded)
    middles = []
    halves = []
    for ends, (v0, v1) in zip(pairwise(rows), pairwise(_ending(rows, graded, beyond)), strict=True):
        chord = _half_chord(face, *map(float, ends))
        u0 = max(box.u0, -chord)
        u1 = min(box.u1, chord)
        if u1 <= u0:
            continue
        count = max(3, round(across[0] * math.sqrt((u1 - u0) / box.size[0])))
        at_rim = (u0 <= near - chord, u1 >= chord - near)
        columns = _ending(_cell_edges(u0, u1, count, graded=at_rim), at_rim, beyond)
        middles.append(
            np.column_stack([(columns[:-1] + columns[1:]) / 2, np.full(count, (v0 + v1) / 2)])
        )
        halves.append(np.column_stack([np.diff(columns) / 2, np.full(count, (v1 - v0) / 2)]))
    return np.concatenate(middles), np.concatenate(halves)


def _ending(borders: Floats, graded: tuple[bool, bool], beyond: float) -> Floats:
    """Return borders of cells whose graded ends lie ``beyond`` by so much of the last one's
    width."""
    widths = np.diff(borders)
    moved = borders.copy()
    moved[0] -= graded[0] * beyond * widths[0]
    moved[-1] += graded[1] * beyond * widths[-1]
    return moved


_STEEP = 0.15


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane with its own axes: rows of ``axes`` are u, v and the direction of projection (into
    the body)."""

    origin_mm: Floats
    axes: Floats

    def is_level(self, body: Body, box: Box) -> bool:
        """Return whether a box, with a hair's breadth around it, lies on a body's surface where
        that is level."""
        x, y, z = self.origin_mm.tolist()
        reach = math.hypot(max(-box.u0, box.u1), max(-box.v0, box.v1))
        return bool(
            z == 0.0 and self.axes[2, 2] == 1.0 and body.is_level_around(x, y, (1.0 + 1e-6) * reach)
        )

    def projected(self, body: Body, middle: Floats) -> tuple[Points, Floats, Bools]:
        """Project (n, 2) middles along the normal; return points of the body, inward normals and
        whether they are on its sensing surface."""
        along = self.axes[2]
        points = self.origin_mm + middle @ self.axes[:2]
        left = np.arange(len(points))  # those that are not on the surface yet
        for _ in range(30):
            here = points[left]
            slope = np.maximum(body.piece_normals(here)[:, 0] @ along, _STEEP)
            step = -body.depth(here) / slope
            points[left] = here + step[:, None] * along
            left = left[~(np.abs(step) < 1e-13 * (1.0 + np.abs(points).max()))]
            if len(left) == 0:
                break
        normals = np.array(body.piece_normals(points)[:, 0])
        return points, normals, (np.abs(body.depth(points)) < 1e-9) & (normals @ along > _STEEP)


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
        return self.rectangles(np.zeros((len(self), 3)), np.arange(len(self)))

    def rectangles(self, force_n: Floats, chosen: Ints) -> Rectangles:
        """Return the n chosen patches under their forces (n, 3), global axes."""
        return Rectangles(
            centre_mm=self.centre_mm[chosen],
            frames=self.frames[chosen],
            half_mm=self.half_mm[chosen],
            force_n=force_n,
        )

    def bounds(self, chosen: Bools) -> Box:
        """Return the box around the chosen cells, in the grid's plane."""
        middle = self.middle_mm[chosen]
        cell = self.cell_mm[chosen]
        u0, v0 = np.min(middle - cell, axis=0, initial=math.inf).tolist()
        u1, v1 = np.max(middle + cell, axis=0, initial=-math.inf).tolist()
        return Box(u0, u1, v0, v1)

    @staticmethod
    def outline(place: Floats, area: Floats, pressure: Floats, *, bent: bool) -> Floats | None:
        """Return places (60, 2) around a smooth probe's contact where it ends, in a plane, from the
        pressures of its k patches, their places (k, 2) and areas there; None where these don't
        tell.

        Notes
        -----
        Under any smooth probe the squared pressure vanishes linearly at the contact's border.
        Hertz's is a quadratic of the place; a deep sphere's has a fourth-order term, too, and near
        the border so have a cone's and that of a sphere that sticks to compressible rubber (D. A.
        Spence 1968): where it is so ``bent``, only the lower half of the pressures counts. The
        polynomial of 1, u, v, u^2, u v, v^2 and (u^2 + v^2)^2 is fitted by least squares, where (u,
        v) is the place from the mean of all places. The contact ends where it first vanishes on a
        ray from there, between 0.3 and 1.5 of the largest distance from the mean. Validity:
        contacts near an ellipse.
        """
        if len(place) < _FEWEST:
            return None
        used = pressure <= _EVEN * np.median(pressure) if bent else np.ones(len(place), bool)
        middle = place.mean(axis=0)
        size = float(np.abs(place - middle).max())
        u, v = (place - middle)[used].T / size
        squared = u * u + v * v
        terms = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v, squared**2])
        wanted = (pressure[used] / pressure.max()) ** 2
        found = np.linalg.lstsq(terms, wanted, rcond=_OWN)[0]
        angle = 2.0 * math.pi / _RAYS * np.arange(_RAYS)
        way = np.column_stack([np.cos(angle), np.sin(angle)])
        cosine, sine = way[:, :1], way[:, 1:]
        radius = np.linspace(_NEAR, _FAR, _ALONG_RAY)
        first = found[1] * cosine + found[2] * sine
        second = found[3] * cosine**2 + found[4] * cosine * sine + found[5] * sine**2
        height = found[0] + radius * (first + radius * (second + radius**2 * found[6]))
        end = (height < 0.0).argmax(axis=1)
        if np.any(end == 0):  # a ray that never, or at once, lies below 0
            return None
        rays = np.arange(_RAYS)
        here = height[rays, end]
        ends = radius[end] - (radius[1] - radius[0]) * here / (here - height[rays, end - 1])
        within = math.pi * float(size**2 * np.mean(ends**2))
        if abs(within / area.sum() - 1.0) > _APART:
            return None
        return np.asarray(middle + size * ends[:, None] * way)

    @classmethod
    def under(
        cls, body: Body, face: Footprint | None, plane: Plane, box: Box, across: tuple[int, int]
    ) -> Patches:
        """Cut the candidate patches under a probe.

        Parameters
        ----------
        body, face
            The undeformed body, and the flat face that bounds the contact, if one does.
        plane
            Plane of the grid, at the place touched first, or of the face.
        box
            The piece of the plane to fill; without a face only the ellipse inscribed in it, unless
            it is long or the contact has pieces.
        across
            Cells along u and v.

        Returns
        -------
        Patches on the sensing surface. Cells beyond the body are left out, and their neighbours
        marked as ``edge``.
        """
        sharp = face is not None and face.edge_mm == 0.0 and box.face is None
        # A rim that lies on the surface's own edge leaves no room beyond it.
        for beyond in (_BEYOND_RIM, 0.0) if sharp else (0.0,):
            middle, cell = _cells(face, box, across, beyond)
            if plane.is_level(body, box):
                points = plane.origin_mm + middle @ plane.axes[:2]
                frames = np.tile(plane.axes, (len(cell), 1, 1))
                half = cell
                off = np.zeros(len(cell), bool)
            else:
                points, frames, half, off = _on_body(body, plane, middle, cell)
            if not off.any():
                break
        outside, outer = _bordering(middle, cell, box, face)
        kept = ~(off | outside)
        edge = _touching(middle, cell, off) if off.any() else off
        return cls(
            centre_mm=points[kept],
            frames=frames[kept],
            half_mm=half[kept],
            middle_mm=middle[kept],
            cell_mm=cell[kept],
            border=outer[kept],
            edge=edge[kept],
        )


def _tangent_rectangles(plane: Plane, cell: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return frames (n, 3, 3) and half sizes (n, 2) of cells projected onto their own tangent
    planes: of each parallelogram the rectangle that keeps its first side's length and direction,
    and its area."""
    u, v, along = plane.axes
    slope = np.maximum(normals @ along, _STEEP)
    side_u = u - np.outer(normals @ u / slope, along)
    side_v = v - np.outer(normals @ v / slope, along)
    length = np.linalg.norm(side_u, axis=1)
    first = side_u / length[:, None]
    area = np.linalg.norm(np.cross(side_u, side_v), axis=1)
    half = np.column_stack([cell[:, 0] * length, cell[:, 1] * area / length])
    return np.stack([first, np.cross(normals, first), normals], axis=1), half


def _touching(middle: Floats, cell: Floats, others: Bools) -> Bools:
    """Return (n,) whether each cell is one of the others, or has one for a neighbour, corners
    included."""
    found = others.copy()
    u, v = (
        np.abs(place[~others, None] - place[others])
        <= (half[~others, None] + half[others]) * (1 + 1e-6)
        for place, half in zip(middle.T, cell.T, strict=True)
    )
    found[~others] = np.any(u & v, axis=1)
    return found


def _on_body(
    body: Body, plane: Plane, middle: Floats, cell: Floats
) -> tuple[Points, Floats, Floats, Bools]:
    """Return points, frames and half sizes of cells projected on the body, and (n,) which don't lie
    on it wholly."""
    points, normals, found = plane.projected(body, middle)
    frames, half = _tangent_rectangles(plane, cell, normals)
    off = ~found
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        side = np.array(signs) * half
        corners = points + side[:, :1] * frames[:, 0] + side[:, 1:] * frames[:, 1]
        # A tangent corner stands out of a curved surface a little; only the other pieces of the
        # boundary count.
        off |= np.any(body.piece_distances(corners)[:, 1:] < -1e-9, axis=1)
    return points, frames, half, off


def _bordering(
    middle: Floats, cell: Floats, box: Box, face: Footprint | None
) -> tuple[Bools, Bools]:
    """Return (n,) which cells lie outside the ellipse in a box, and which have a neighbour there,
    or outside the box. The ellipse counts where no face bounds a compact contact; beyond a flat
    face there are no neighbours."""
    low = np.array((box.u0, box.v0))
    high = np.array((box.u1, box.v1))
    limit = np.array(face.half_mm if face is not None else (math.inf, math.inf))
    near = 1e-6 * limit.max() if face is not None else 0.0
    reach = cell * (1 + 1e-6)
    # Without a face, whose half widths are then infinite, both comparisons hold.
    open_low = low > near - limit
    open_high = high < limit - near
    outer = np.any(
        (middle - reach <= low) & open_low | (middle + reach >= high) & open_high, axis=1
    )
    if face is not None or box.is_long or math.isfinite(box.width_mm):
        return np.zeros(len(middle), bool), outer
    outside = np.sum(((middle - (low + high) / 2) / ((high - low) / 2)) ** 2, axis=1) > 1.0
    return outside, outer | _touching(middle, cell, outside)
