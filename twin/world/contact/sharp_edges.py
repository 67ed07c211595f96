"""Sharp edges of a probe along a grid's axes, and grids whose cells end there.

A cell touches wholly or not at all. Where an edge of the probe runs along the grid, a whole row of
cells is cut alike, and the contact is too wide or too narrow by up to half a cell: forces jumped by
some per cent from grid to grid. So cells are made to end at such edges. Edges askew to the grid cut
every row elsewhere, which evens out.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.parts.body import Body
from twin.world.contact.probe_gap import Approach
from twin.world.contact.surface_patches import Box, Plane, projected

_RASTER = 64
"""Places along each side at which edges are looked for."""

_HALVINGS = 10
"""Bisections of a step of the raster around an edge."""

_JUMP = 0.2
"""Least jump of the gap at a sharp edge, over the deepest overlap."""

_ALONG = 0.08
"""Share of the raster's rows that an edge along the grid crosses at least."""

_FINEST, _WIDEST, _STEPS = 0.8, 1.1, 121
"""Widths of cells that are tried, over the width asked for, and how many."""

_AWAY = 0.1
"""How far edges may lie from the cells' ends, over their width, for a grid that is aligned."""

_AS_ASKED = 0.03
"""How much a change of the cells' width counts against a distance from edges."""


def edges_along(body: Body, probe: Approach, plane: Plane, box: Box, pose: Floats) -> Box:
    """Return the box with the places of a probe's sharp edges along its two sides.

    Parameters
    ----------
    body, probe
        The undeformed body, and the probe at first touch.
    plane, box
        The grid's plane, and the contact in it.
    pose
        (6,) the probe's place.
    """

    def gap_at(place: Floats) -> Floats:
        points, normals, on_body = projected(body, plane, place)
        return np.where(on_body, probe.gap(points, normals, pose)[0], np.nan)

    # 1. Gaps on a raster over the box and a tenth more; where they are negative the probe overlaps
    #    the body at rest.
    wide = box.grown(0.1 * box.size[0], 0.1 * box.size[1])
    u, v = (
        np.linspace(low, high, _RASTER) for low, high in ((wide.u0, wide.u1), (wide.v0, wide.v1))
    )
    places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    gap = gap_at(places.reshape(-1, 2)).reshape(_RASTER, _RASTER)
    inside = gap <= 0.0
    if not inside.any():
        return box
    jump = -_JUMP * float(gap[inside].min())
    lines: list[tuple[float, ...]] = []
    for axis in range(2):
        ahead = np.diff(inside.astype(int), axis=axis) != 0
        first, second = np.nonzero(ahead)
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
        sharp = np.isfinite(outer - gap_at(one)) & (outer - gap_at(one) > jump) | np.isinf(outer)
        step = float(u[1] - u[0] if axis == 0 else v[1] - v[0])
        lines.append(_common(((one + other) / 2.0)[sharp, axis], step / 2.0**_HALVINGS))
    return box._replace(edges=(lines[0], lines[1]))


def _common(found: Floats, exact: float) -> tuple[float, ...]:
    """Return the places that many rows have in common, up to ``exact``."""
    if len(found) == 0:
        return ()
    found = np.sort(found)
    groups = np.split(found, np.flatnonzero(np.diff(found) > 4.0 * exact) + 1)
    return tuple(float(one.mean()) for one in groups if len(one) >= _ALONG * _RASTER)


def aligned(box: Box, counts: tuple[int, int]) -> tuple[Box, tuple[int, int]]:
    """Return a box and its cells along u and v, changed so that cells end at the box's edges as
    far as one width of cells allows that."""
    sides = []
    for low, high, count, edges in zip(
        (box.u0, box.v0), (box.u1, box.v1), counts, box.edges, strict=True
    ):
        sides.append(_side(low, high, count, np.array(edges)))
    (u0, u1, across), (v0, v1, along) = sides
    return box._replace(u0=u0, u1=u1, v0=v0, v1=v1), (across, along)


def _side(low: float, high: float, count: int, edges: Floats) -> tuple[float, float, int]:
    """Return both ends of a side and the number of its cells."""
    if len(edges) == 0:
        return low, high, count
    asked = (high - low) / count
    # Try cells of many widths, and exactly those of which a whole number lies between two edges.
    apart = edges[-1] - edges[0]
    widths = asked * np.linspace(_FINEST, _WIDEST, _STEPS)
    between = np.arange(1, 2 + int(apart / (_FINEST * asked)))
    exact = apart / between
    widths = np.concatenate([widths, exact[(exact > _FINEST * asked) & (exact < _WIDEST * asked)]])
    at = (edges - edges[0]) / widths[:, None]
    off = at - np.rint(at)
    shift = off.mean(axis=1)
    away = np.sqrt(np.mean((off - shift[:, None]) ** 2, axis=1))
    best = int(np.argmin(away + _AS_ASKED * np.abs(widths / asked - 1.0)))
    if away[best] > _AWAY:
        return low, high, count
    width = float(widths[best])
    start = float(edges[0] + shift[best] * width)
    first = np.floor((low - start) / width + 1e-6)
    last = np.ceil((high - start) / width - 1e-6)
    return start + first * width, start + last * width, int(last - first)
