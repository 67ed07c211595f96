"""Marker layers and their one order: layer by layer as in the scene, s (along x) outer, t (along y) inner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Bools, Chart, Floats, Points, frozen
from twin.errors import RecipeError
from twin.parts.body import Body
from twin.parts.grid import grid_axes, grid_chart
from twin.parts.part import Part
from twin.parts.ranges import LEAST_MM, Place, Share


class MarkerLayer(Part):
    """A grid of equal markers at one depth.

    Attributes
    ----------
    kind
        ``bead``: a rigid sphere that moves and turns; ``print``: a thin disc in its level set that strains with it.
    depth_mm
        Depth of the marker centres below the outer surface.
    pitch_mm
        Spacing along the surface (arc length), both directions.
    diameter_mm
        Marker diameter.
    columns, rows
        Number of markers along s (x) and t (y); the grid is centred on ``offset_mm``.
    offset_mm
        (s, t) of the grid's centre.
    colour
        Diffuse reflectance in the camera's red, green and blue channels.
    stiff
        Whether the truth takes the beads as rigid against the rubber: each moves with the mean of the field over its
        surface and pushes back on the rubber, which moves all markers, to first order in the beads' share of volume.
        Otherwise they are points that the rubber carries. For beads in an incompressible block (`twin.parts.stiff`);
        the sensor's software is not told.
    """

    kind: Literal["bead", "print"] = "bead"
    depth_mm: float = Field(ge=LEAST_MM, le=100)
    pitch_mm: float = Field(ge=LEAST_MM, le=100)
    diameter_mm: float = Field(ge=LEAST_MM, le=20)
    columns: int = Field(ge=1, le=200)
    rows: int = Field(ge=1, le=200)
    offset_mm: tuple[Place, Place] = (0.0, 0.0)
    colour: tuple[Share, Share, Share]
    stiff: bool = False

    @model_validator(mode="after")
    def _prints_are_soft(self) -> MarkerLayer:
        if self.stiff and self.kind != "bead":
            raise ValueError(
                f"stiff = true: a {self.kind} strains with its level set; only kind = 'bead' can be stiff, or leave "
                "stiff out"
            )
        return self

    def chart(self) -> Chart:
        """Return the (columns * rows, 2) surface coordinates of the markers, mm, s outer and t inner."""
        return grid_chart(*grid_axes(self.columns, self.rows, self.pitch_mm)) + self.offset_mm


@dataclass(frozen=True, kw_only=True)
class MarkerSet:
    """All markers of a sensor at rest, in their one order.

    Attributes
    ----------
    layer
        (n,) layer names.
    chart
        (n, 2) surface coordinates, mm.
    points
        (n, 3) centres, mm.
    normals
        (n, 3) unit inward normals of their level sets.
    """

    layer: np.ndarray
    chart: Chart
    points: Points
    normals: Floats

    def __len__(self) -> int:
        return len(self.points)

    def of(self, name: str) -> slice:
        """Return the slice of the layer called ``name``."""
        where = np.flatnonzero(self.layer == name)
        return slice(int(where[0]), int(where[-1]) + 1) if len(where) else slice(0, 0)


@dataclass(frozen=True, kw_only=True)
class Prints:
    """How single markers differ from the drawing, besides their places.

    Attributes
    ----------
    size, shade
        (n,) factors on diameter and reflectance.
    missing
        (n,) markers that are not there; they keep their rows.
    """

    size: Floats
    shade: Floats
    missing: Bools


def place(body: Body, layers: Mapping[str, MarkerLayer], jitter_mm: Floats | None = None) -> MarkerSet:
    """Place every marker of ``layers`` in ``body``.

    Parameters
    ----------
    jitter_mm
        (n, 2) print errors along (s, t), mm; None for a perfect print.

    Raises
    ------
    RecipeError
        A marker sticks out of the body.
    """
    charts = [layer.chart() for layer in layers.values()]
    chart = np.concatenate(charts) if charts else np.zeros((0, 2))
    if jitter_mm is not None:
        chart = chart + jitter_mm
    sizes = [len(c) for c in charts]
    values = list(layers.values())
    depth = np.repeat([v.depth_mm for v in values], sizes) if values else np.zeros(0)
    radius = np.repeat([v.diameter_mm / 2 if v.kind == "bead" else 0.0 for v in values], sizes) if values else depth
    names = np.repeat(list(layers), sizes) if values else np.zeros(0, "U1")
    points = body.chart_points(chart, depth)
    room = body.piece_distances(points).min(axis=1) - radius if len(points) else np.zeros(0)
    off_surface = np.abs(body.depth(points) - depth) > 1e-6 if len(points) else np.zeros(0, bool)
    bad = (room < 0) | off_surface
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        x, y, z = points[first]
        raise RecipeError(
            f"markers.{names[first]}: {int(bad.sum())} of {len(points)} markers lie outside the body, the first at "
            f"({x:.3g}, {y:.3g}, {z:.3g}) mm: reduce depth_mm, pitch_mm, columns, rows or diameter_mm"
        )
    normals = body.piece_normals(points)[:, 0] if len(points) else np.zeros((0, 3))
    return MarkerSet(layer=frozen(names), chart=frozen(chart), points=frozen(points), normals=frozen(np.array(normals)))
