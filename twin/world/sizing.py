"""Which edge length is wanted where in a body's mesh, and the background grid that tells the mesher.

Why graded so: the mesh carries the smooth rest that is left of the elastic field once the load's closed-form half-space
field is subtracted. That rest is rough in two places only: at the clamped rim, where the held piece meets the free
sides and stress is singular, and (on curved bodies) below the surface that is pressed. Everything else may be coarse,
and must be, for a direct solver's cost climbs steeply with the number of unknowns.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.parts.body import Body, Finger
from twin.world.snap import onto_pieces
from twin.world.surface import surface_samples

Purpose = Literal["truth", "nominal"]

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


def default_sizing(body: Body, purpose: Purpose) -> Sizing:
    """Return the sizing of a body's mesh.

    Parameters
    ----------
    body
        The body.
    purpose
        ``truth`` for the world, ``nominal`` for the sensor's own model: coarser, so that the two never share a mesh.

    Notes
    -----
    Lengths are proportions of the body; `Sizing.unknowns` sets their scale. On the block a mesh's error is mostly one
    shift of the whole sensing face, the slab's shear stiffness: under 4 mm patches the red layer is 0.1 % off
    at 28 000 unknowns and 0.25 % at 9 500. A finer window under the load doesn't help there, so there is none.
    """
    low, high = np.array(body.bounds_mm)
    if isinstance(body, Finger):
        radius = body.radius_mm
        return Sizing(
            coarse_mm=(0.225 if purpose == "truth" else 0.3) * radius,
            fine_mm=(0.1375 if purpose == "truth" else 0.18) * radius,
            rim_mm=(0.1125 if purpose == "truth" else 0.16) * radius,
            growth=0.4,
            window_mm=(0.875 * radius, 0.875 * radius),
            unknowns=28000 if purpose == "truth" else 13000,
        )
    longest = float(np.max(high - low))
    edge = (0.11 if purpose == "truth" else 0.18) * longest
    return Sizing(
        coarse_mm=edge,
        fine_mm=edge,
        rim_mm=(0.018 if purpose == "truth" else 0.05) * longest,
        growth=0.8,
        window_mm=(float(min(16.0, 0.4 * (high - low)[0])), float(min(12.0, 0.4 * (high - low)[1]))),
        unknowns=28000 if purpose == "truth" else 9500,
    )


def rim_points(body: Body, spacing_mm: float) -> Points:
    """Return points (n, 3), mm, on the clamped rim: the curve where the held piece meets the other pieces."""
    samples = surface_samples(body, spacing_mm)
    near = np.abs(body.piece_distances(samples)) < 2 * spacing_mm
    found = []
    for other in range(len(body.pieces) - 1):
        candidates = samples[near[:, -1] & near[:, other]]
        on = np.zeros((len(candidates), len(body.pieces)), dtype=bool)
        on[:, [other, -1]] = True
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
