"""Which edge length is wanted where in a body's mesh, and the background grid for the mesher.

The mesh carries the smooth correction that is left of the elastic field once the load's closed-form
field is subtracted. It is rough at the clamped rim, where stress is singular, and (on curved
bodies) below the surface that is pressed. All else must be coarse: a direct solver's cost climbs
steeply with the number of unknowns.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from twin.arrays import Floats, Ints, Points, grid_points
from twin.parts.body import Body
from twin.parts.part import identity
from twin.world.mesh.quadratic_mesh import FORMAT, kuhn_grid

Level = Literal["nominal", "sketch", "coarse", "standard", "fine"]
"""``nominal`` is the sensor's own model; the others are the world's, each about three times the
last."""

WORLD: tuple[Level, ...] = ("sketch", "coarse", "standard", "fine")
"""The world's levels, coarsest first."""

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
        Unknowns (three displacements at every node, one pressure at every corner) to aim at: all
        lengths are scaled together until the mesh has about that many.
    """

    coarse_mm: float
    fine_mm: float
    rim_mm: float
    growth: float
    window_mm: tuple[float, float]
    unknowns: int

    @staticmethod
    def of(body: Body, level: Level) -> Sizing:
        """Return the sizing of a body's mesh.

        Notes
        -----
        Lengths are proportions of the body; `unknowns` sets their scale. On the block a mesh's
        error is mostly one shift of the whole sensing face: under 4 mm patches the red layer is
        0.1 % off at 28 000 unknowns and 0.25 % at 9 500. A finer window under the load is no help.
        """
        low, high = np.array(body.bounds_mm)
        if body.is_flat:
            shares, size, growth = _FLAT[level], float(np.max(high - low)), 0.8
            window = (
                float(min(16.0, 0.4 * (high - low)[0])),
                float(min(12.0, 0.4 * (high - low)[1])),
            )
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

    def scaled(self, factor: float) -> Sizing:
        """Return the sizing with every edge length times ``factor``; growth and window stay."""
        edges = ("coarse_mm", "fine_mm", "rim_mm")
        return replace(self, **{edge: getattr(self, edge) * factor for edge in edges})

    def mesh_key(self, body: Body) -> str:
        """Return the SHA-256 of what a mesh depends on: the body's geometry (not its sources), the
        sizing, the format."""
        geometry = identity(body.geometry())
        text = json.dumps(
            {"body": geometry, "sizing": asdict(self), "format": FORMAT}, sort_keys=True
        )
        return hashlib.sha256(text.encode()).hexdigest()

    def mesh_file(self, body: Body) -> str:
        """Return the name of the file of the body's mesh."""
        return f"mesh-{self.mesh_key(body)[:32]}.npz"


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


def _along(edges: Floats, spacing_mm: float) -> Points:
    """Return points (n, 3) on straight edges (e, 2, 3), at most ``spacing_mm`` apart."""
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    parts = np.ceil(length / spacing_mm).astype(int) + 1
    share = np.concatenate([np.linspace(0.0, 1.0, number) for number in parts])[:, None]
    ends = np.repeat(edges, parts, axis=0)
    return np.asarray(ends[:, 0] * (1.0 - share) + ends[:, 1] * share)


def _rim_points(body: Body, spacing_mm: float) -> Points:
    """Return points (n, 3), mm, on the clamped rim: the curves where held pieces meet the
    others."""
    if body.own_rim is not None:
        return _along(body.own_rim, spacing_mm)
    samples = body.surface_samples(spacing_mm)
    near = np.abs(body.piece_distances(samples)) < 2 * spacing_mm
    found = []
    free = [other for other in range(len(body.pieces)) if other not in body.held_pieces]
    for pair in product(free, body.held_pieces):
        candidates = samples[near[:, pair].all(axis=1)]
        on = np.zeros((len(candidates), len(body.pieces)), dtype=bool)
        on[:, pair] = True
        rim = body.onto_sheets(candidates, on)
        found.append(rim[body.contains(rim, -1e-6)])
    return np.concatenate(found)


class WantedEdge:
    """The wanted edge length of a body's mesh as a function of position.

    Attributes
    ----------
    rim_mm
        (n, 3) points on the clamped rim: the curves where held pieces meet the others.
    """

    def __init__(self, body: Body, sizing: Sizing) -> None:
        from scipy.spatial import cKDTree

        low, high = np.array(body.bounds_mm)
        spacing = float(np.max(high - low)) / 100
        s, t = (np.linspace(-half, half, 41) for half in sizing.window_mm)
        window = body.chart_points(grid_points(s, t))
        window = window[body.contains(window, -1e-6)]
        self._sizing = sizing
        self._window = cKDTree(window)
        self.rim_mm = _rim_points(body, spacing)
        self._body = body
        self._rim = cKDTree(self.rim_mm)

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

    def background(self) -> tuple[Points, Ints, Floats]:
        """Return points (n, 3) and tetrahedra (m, 4) of a background mesh that pads the body by a
        cell, and the (n,) wanted edge lengths there, mm."""
        low, high = np.array(self._body.bounds_mm)
        step = float(np.max(high - low)) / _GRID_CELLS
        counts = np.ceil((high - low) / step).astype(int) + 3
        axes = [low[axis] + step * (np.arange(counts[axis]) - 1) for axis in range(3)]
        points, tets = kuhn_grid(*axes)
        return points, tets, self(points)
