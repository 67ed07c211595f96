"""Which edge length is wanted where in a body's mesh, and the background grid that tells the mesher.

Why graded so: the mesh carries the smooth rest that is left of the elastic field once the load's closed-form half-space
field is subtracted. That rest is rough in two places only: at the clamped rim, where the held piece meets the free
sides and stress is singular, and (on curved bodies) below the surface that is pressed. Everything else may be coarse,
and must be, for a direct solver's cost climbs steeply with the number of unknowns.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.parts.body import Body
from twin.world.mesh.snap import onto_pieces
from twin.world.mesh.surface import surface_samples

Level = Literal["nominal", "sketch", "coarse", "standard", "fine"]
"""``nominal`` is the sensor's own model; the others are the world's, each about three times the last."""

WORLD: tuple[Level, ...] = ("sketch", "coarse", "standard", "fine")
"""The world's levels, coarsest first."""

_KUHN = [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]
"""Six tetrahedra of a unit cube whose corner (i, j, k) has number i + 2 j + 4 k."""

_GRID_CELLS = 40
"""Cells of the background grid along the body's longest side."""


@dataclass(frozen=True, kw_only=True)
class Sizing:
    """Wanted edge lengths; the finest demand wins at every point.

    Attributes
    ----------
    coarse_mm
        Longest edge anywhere, mm.
    fine_mm
        Edge on the working window of the sensing surface, mm.
    rim_mm
        Edge at the clamped rim, mm.
    growth
        Growth of the wanted edge with distance from rim or window, mm/mm.
    window_mm
        Half sizes (s, t) of the working window in the body's chart, centred on the origin, mm.
    unknowns
        Unknowns (three displacements at every node, one pressure at every corner) to aim at: all lengths are scaled
        together until the mesh has about that many.
    """

    coarse_mm: float
    fine_mm: float
    rim_mm: float
    growth: float
    window_mm: tuple[float, float]
    unknowns: int

    def scaled(self, factor: float) -> Sizing:
        """Return the sizing with every edge length times ``factor``; growth and window stay."""
        return replace(
            self,
            coarse_mm=self.coarse_mm * factor,
            fine_mm=self.fine_mm * factor,
            rim_mm=self.rim_mm * factor,
        )

    def described(self) -> dict[str, object]:
        """Return the plain numbers, for the cache key and the file's provenance."""
        return asdict(self)


@dataclass(frozen=True)
class _Shares:
    """Edges as shares of the body's size, and the unknowns that set their common scale."""

    coarse: float
    fine: float
    rim: float
    unknowns: int


_FLAT: dict[Level, _Shares] = {
    "nominal": _Shares(0.18, 0.18, 0.05, 9500),
    "sketch": _Shares(0.22, 0.22, 0.08, 3600),
    "coarse": _Shares(0.11, 0.11, 0.06, 14800),
    "standard": _Shares(0.11, 0.11, 0.018, 28000),
    "fine": _Shares(0.075, 0.075, 0.009, 90000),
}

_CURVED: dict[Level, _Shares] = {
    "nominal": _Shares(0.3, 0.18, 0.16, 13000),
    "sketch": _Shares(0.4, 0.27, 0.24, 5500),
    "coarse": _Shares(0.29, 0.175, 0.15, 14000),
    "standard": _Shares(0.225, 0.1375, 0.1125, 28000),
    "fine": _Shares(0.15, 0.085, 0.06, 80000),
}


def default_sizing(body: Body, level: Level) -> Sizing:
    """Return the sizing of a body's mesh.

    Parameters
    ----------
    body
        The body.
    level
        Which of the meshes: the sensor's own model and the world never share one.

    Notes
    -----
    Lengths are proportions of the body; `Sizing.unknowns` sets their scale. On the block a mesh's error is mostly one
    shift of the whole sensing face, the slab's shear stiffness: under 4 mm patches the red layer is 0.1 % off
    at 28 000 unknowns and 0.25 % at 9 500. A finer window under the load doesn't help there, so there is none.
    """
    low, high = np.array(body.bounds_mm)
    if body.is_flat:
        shares, size, growth = _FLAT[level], float(np.max(high - low)), 0.8
        window = (float(min(16.0, 0.4 * (high - low)[0])), float(min(12.0, 0.4 * (high - low)[1])))
    else:
        shares, size, growth = _CURVED[level], float(np.min((high - low)[:2])) / 2.0, 0.4
        window = (0.875 * size, 0.875 * size)
    return Sizing(
        coarse_mm=shares.coarse * size,
        fine_mm=shares.fine * size,
        rim_mm=shares.rim * size,
        growth=growth,
        window_mm=window,
        unknowns=shares.unknowns,
    )


def along(edges: Floats, spacing_mm: float) -> Points:
    """Return points (n, 3) on straight edges (e, 2, 3), at most ``spacing_mm`` apart."""
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    parts = np.ceil(length / spacing_mm).astype(int) + 1
    share = np.concatenate([np.linspace(0.0, 1.0, number) for number in parts])[:, None]
    ends = np.repeat(edges, parts, axis=0)
    return np.asarray(ends[:, 0] * (1.0 - share) + ends[:, 1] * share)


def rim_points(body: Body, spacing_mm: float) -> Points:
    """Return points (n, 3), mm, on the clamped rim: the curves where held pieces meet the others."""
    if body.own_rim is not None:
        return along(body.own_rim, spacing_mm)
    samples = surface_samples(body, spacing_mm)
    near = np.abs(body.piece_distances(samples)) < 2 * spacing_mm
    found = []
    free = [other for other in range(len(body.pieces)) if other not in body.held_pieces]
    for pair in product(free, body.held_pieces):
        candidates = samples[near[:, pair].all(axis=1)]
        on = np.zeros((len(candidates), len(body.pieces)), dtype=bool)
        on[:, pair] = True
        rim = onto_pieces(body, candidates, on)
        found.append(rim[body.contains(rim, -1e-6)])
    return np.concatenate(found)


class WantedEdge:
    """The wanted edge length as a function of position, with its two distance trees built once."""

    def __init__(self, body: Body, sizing: Sizing) -> None:
        from scipy.spatial import cKDTree

        low, high = np.array(body.bounds_mm)
        spacing = float(np.max(high - low)) / 100
        s, t = (np.linspace(-half, half, 41) for half in sizing.window_mm)
        window = body.chart_points(np.stack(np.meshgrid(s, t, indexing="ij"), axis=-1).reshape(-1, 2))
        window = window[body.contains(window, -1e-6)]
        self._sizing = sizing
        self._window = cKDTree(window)
        self._rim = cKDTree(rim_points(body, spacing))

    def __call__(self, points: Points) -> Floats:
        """Return the (n,) wanted edge lengths, mm, at (n, 3) points, mm."""
        sizing = self._sizing
        to_window = self._window.query(points)[0]
        to_rim = self._rim.query(points)[0]
        wanted = np.minimum(
            sizing.fine_mm + sizing.growth * to_window,
            sizing.rim_mm + sizing.growth * to_rim,
        )
        return np.asarray(np.minimum(wanted, sizing.coarse_mm))


def background(body: Body, sizing: Sizing) -> tuple[Points, Ints, Floats]:
    """Return a background mesh that pads the body by a cell, and the edge wanted at its points.

    Returns
    -------
    points
        (n, 3), mm.
    tets
        (m, 4) indices.
    edge_mm
        (n,) wanted edge lengths, mm.
    """
    low, high = np.array(body.bounds_mm)
    step = float(np.max(high - low)) / _GRID_CELLS
    counts = np.ceil((high - low) / step).astype(int) + 3
    axes = [low[axis] + step * (np.arange(counts[axis]) - 1) for axis in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(counts)
    cube = np.stack(
        [
            number[i : i + counts[0] - 1, j : j + counts[1] - 1, k : k + counts[2] - 1].ravel()
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ],
        axis=1,
    )
    tets = cube[:, np.array(_KUHN)].reshape(-1, 4).astype(np.int64)
    return points, tets, WantedEdge(body, sizing)(points)
