"""Marker layers: where the markers are, in which order, and which stiff beads are allowed.

`MarkerLayer` describes a layer and `place` computes the markers. Their order is the same
everywhere: layer by layer as in the scene, then along s (about x), then along t (about y).

A scene with stiff beads needs the per cent that their correction (`twin.theory.inclusions`) is
accurate to, so one outside its bounds (docs/inclusions.md) is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Bools, Chart, Floats, Points, frozen, grid_points
from twin.errors import RecipeError
from twin.parts.body import Block, Body, Solid
from twin.parts.material import Cover, Material
from twin.parts.part import LEAST_MM, Flag, Part, Place, Share

LEAST_GAP = 4.0
"""Distance of a bead's centre to the surface and to other markers, over its radius."""

LEAST_ROOM = 3.0
"""Distance of a bead from the body's other faces over its depth."""

LEAST_POISSON_RATIO = 0.49


class MarkerLayer(Part):
    """A grid of equal markers at one depth.

    Attributes
    ----------
    kind
        ``bead``: a rigid sphere that moves and turns; ``print``: a thin disc in its level set that
        strains with it.
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
    gloss
        Refractive index, above the rubber's, and roughness of a smooth skin over the colour: GGX's
        alpha, 0.01 to 1, small for sharp highlights.
    texture
        Relative standard deviation of the colour's brightness over a marker, and the width of its
        grains as a share of the diameter: ink that did not spread evenly. Each marker has its own,
        the same for every sensor and picture of the scene's ``seed``.
    stiff
        Whether the truth takes the beads as rigid against the rubber: each moves with the mean of
        the field over its surface and pushes back on the rubber, which moves all markers, to first
        order in the beads' share of volume. Otherwise they are points that the rubber carries. For
        beads in an incompressible block (`twin.parts.markers`); the sensor's software does not know
        of it.
    """

    kind: Literal["bead", "print"] = "bead"
    depth_mm: float = Field(ge=LEAST_MM, le=100)
    pitch_mm: float = Field(ge=LEAST_MM, le=100)
    diameter_mm: float = Field(ge=LEAST_MM, le=20)
    columns: int = Field(ge=1, le=200)
    rows: int = Field(ge=1, le=200)
    offset_mm: tuple[Place, Place] = (0.0, 0.0)
    colour: tuple[Share, Share, Share]
    gloss: (
        tuple[Annotated[float, Field(gt=1, le=3)], Annotated[float, Field(ge=0.01, le=1)]] | None
    ) = None
    texture: (
        tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0.02, le=2)]] | None
    ) = None
    stiff: Flag = False

    @model_validator(mode="after")
    def _prints_are_soft(self) -> MarkerLayer:
        if self.stiff and self.kind != "bead":
            raise ValueError(
                f"stiff = true: a {self.kind} strains with its level set; only kind = 'bead' can "
                "be stiff, or leave stiff out"
            )
        return self

    def chart(self) -> Chart:
        """Return the (columns * rows, 2) surface coordinates, mm, s outer and t inner."""
        return grid_points(*self.axes())

    def axes(self) -> tuple[Floats, Floats]:
        """Return the s and the t of the grid, mm."""
        s, t = (
            self.pitch_mm * (np.arange(count, dtype=np.float64) - (count - 1) / 2)
            for count in (self.columns, self.rows)
        )
        return s + self.offset_mm[0], t + self.offset_mm[1]

    @staticmethod
    def stiff_problems(
        body: Body,
        layers: Mapping[str, MarkerLayer],
        material: Material,
        cover: Cover | None,
        shortfall: float,
    ) -> list[str]:
        """Return what keeps stiff layers from being corrected, one line each; ``shortfall`` is by
        how much the made rubber's Poisson's ratio may fall below the designed one."""
        stiff = {name: layer for name, layer in layers.items() if layer.stiff}
        if not stiff:
            return []
        key = f"markers.{next(iter(stiff))}.stiff"
        if not isinstance(body, Block):
            shape = type(body).__name__.lower()
            return [
                f"{key} = true: how stiff beads push is known in a block only, this body is a "
                f"{shape}; leave it out"
            ]
        # The reflection at the surface is that of the body's own material.
        problems = []
        if cover is not None and (
            cover.youngs_modulus_mpa not in (None, material.youngs_modulus_mpa)
            or cover.poisson_ratio not in (None, material.poisson_ratio)
        ):
            problems.append(
                f"{key} = true: a cover of another material than the body's reflects the beads' "
                "push-back in a way that is not known here: leave out cover.youngs_modulus_mpa and "
                "cover.poisson_ratio, or stiff"
            )
        # The dipole of a rigid bead is that of an incompressible material.
        poisson_ratio = material.poisson_ratio - shortfall
        if poisson_ratio < LEAST_POISSON_RATIO:
            problems.append(
                f"{key} = true: material.poisson_ratio may be as low as {poisson_ratio:.4g} with "
                f"its tolerance, but must be {LEAST_POISSON_RATIO} to 0.5: the beads' push-back is "
                "that of incompressible rubber"
            )
        # Beads too near to each other, or to another face than the sensing surface.
        for name, layer in stiff.items():
            least = LEAST_GAP * layer.diameter_mm / 2
            for what, gap in _gaps(name, layers):
                if gap < least:
                    problems.append(
                        f"markers.{name}.stiff = true: its beads' centres are {gap:.3g} mm from "
                        f"{what}, but must be at least {least:.3g} mm (two diameters): increase "
                        "depth_mm or pitch_mm, or reduce diameter_mm"
                    )
            room = _room(body, layer)
            wanted = LEAST_ROOM * layer.depth_mm
            if room < wanted:
                problems.append(
                    f"markers.{name}.stiff = true: its beads are {room:.3g} mm from a side or the "
                    f"base of the body, but must be at least {wanted:.3g} mm (three depths): only "
                    "the sensing surface reflects the push-back"
                )
        return problems


@dataclass(frozen=True, kw_only=True)
class MarkerSet:
    """All markers of a sensor at rest, in their one order: (n,) layer names, (n, 2) surface
    coordinates and (n, 3) centres, mm, and (n, 3) unit inward normals of their level sets."""

    @dataclass(frozen=True, kw_only=True)
    class Prints:
        """How single markers differ from the drawing: (n,) factors on diameter and reflectance,
        which are not there (these keep their rows), (n,) factors on the diameter that lies at (n,)
        angles from s to t, those across being divided by them, and (n, 3) on each channel's
        reflectance."""

        size: Floats
        shade: Floats
        missing: Bools
        longer: Floats
        way_rad: Floats
        tint: Floats

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

    @staticmethod
    def place(
        body: Body, layers: Mapping[str, MarkerLayer], jitter_mm: Floats | None = None
    ) -> MarkerSet:
        """Place every marker, with (n, 2) print errors along (s, t), mm; `RecipeError` where one
        sticks out of the body, or beads are wider than their pitch."""
        if not layers:
            none = frozen(np.zeros((0, 3)))
            return MarkerSet(layer=np.zeros(0, "U1"), chart=none[:, :2], points=none, normals=none)
        for name, layer in layers.items():
            many = max(layer.columns, layer.rows) > 1
            if layer.kind == "bead" and many and layer.diameter_mm > layer.pitch_mm:
                raise RecipeError(
                    f"markers.{name}.diameter_mm = {layer.diameter_mm:g} mm: beads can't be wider "
                    f"than their pitch, pitch_mm = {layer.pitch_mm:g} mm (allowed: up to that): "
                    "reduce diameter_mm, or set them farther apart"
                )
        # All layers in one array, in their order.
        charts = [layer.chart() for layer in layers.values()]
        sizes = [len(chart) for chart in charts]
        chart = np.concatenate(charts)
        if jitter_mm is not None:
            chart = chart + jitter_mm
        names = np.repeat(list(layers), sizes)
        depth = np.repeat([layer.depth_mm for layer in layers.values()], sizes)
        radii = [
            layer.diameter_mm / 2 if layer.kind == "bead" else 0.0 for layer in layers.values()
        ]
        points = body.chart_points(chart, depth)
        # A marker must lie inside the body, and a bead whole.
        radii_mm = np.repeat(radii, sizes)
        room = body.piece_distances(points).min(axis=1) - radii_mm
        bad = (room < 0) | (np.abs(body.depth(points) - depth) > 1e-6)
        if bad.any():
            first = int(np.flatnonzero(bad)[0])
            x, y, z = points[first]
            raise RecipeError(
                f"markers.{names[first]}: {int(bad.sum())} of {len(points)} markers lie outside "
                f"the body, the first at ({x:.3g}, {y:.3g}, {z:.3g}) mm: reduce depth_mm, "
                f"pitch_mm, columns, rows or diameter_mm{_or_body(body, points, radii_mm)}"
            )
        return MarkerSet(
            layer=frozen(names),
            chart=frozen(chart),
            points=frozen(points),
            normals=frozen(np.array(body.piece_normals(points)[:, 0])),
        )


def _or_body(body: Body, points: Floats, radii_mm: Floats) -> str:
    """Return a hint where the body may be wrong: a file's origin beside the middle of its sensing
    surface, or a block's sides exchanged."""
    if isinstance(body, Solid):
        return "; or set body.origin_mm to the place in the file that is to be above their middle"
    turned = body.piece_distances(points[:, [1, 0, 2]]).min(axis=1) >= radii_mm
    if not (isinstance(body, Block) and turned.all()):
        return ""
    return "; or exchange body.width_mm (along x, the picture's rows) and body.length_mm"


def _gaps(name: str, layers: Mapping[str, MarkerLayer]) -> list[tuple[str, float]]:
    """Return the least distances (mm) of a layer's centres to the surface, each other and other
    layers."""
    layer = layers[name]
    gaps = [("the sensing surface", layer.depth_mm)]
    if layer.columns * layer.rows > 1:
        gaps.append(("each other", layer.pitch_mm))
    for other, neighbour in layers.items():
        if other != name:
            axes = zip(layer.axes(), neighbour.axes(), strict=True)
            sideways = [float(np.abs(one[:, None] - two).min()) for one, two in axes]
            gap = math.hypot(*sideways, layer.depth_mm - neighbour.depth_mm)
            gaps.append((f"those of markers.{other}", gap))
    return gaps


def _room(body: Block, layer: MarkerLayer) -> float:
    """Return the least distance of a layer's centres to the sides and the base of a block, mm."""
    x, y = (float(np.abs(axis).max()) for axis in layer.axes())
    return min(body.width_mm / 2 - x, body.length_mm / 2 - y, body.thickness_mm - layer.depth_mm)
