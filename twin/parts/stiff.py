"""Where the correction for stiff beads holds: what a scene must be like for `MarkerLayer.stiff`, checked as it is read.

Why a scene is refused rather than warned about: past these bounds the correction is no longer a correction, and a scene
that asks for stiff beads asks for them because a per cent matters. Each bound says what it costs: the figures are those
of docs/inclusions.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from twin.arrays import Floats
from twin.parts.block import Block
from twin.parts.body import Body
from twin.parts.grid import grid_axes
from twin.parts.markers import MarkerLayer
from twin.parts.material import Cover, Material

LEAST_GAP = 4.0
"""Distance of a bead's centre to the surface and to other markers, over its radius."""

LEAST_ROOM = 3.0
"""Distance of a bead from the body's other faces over its depth."""

LEAST_POISSON_RATIO = 0.49


def stiff_problems(
    body: Body, layers: Mapping[str, MarkerLayer], material: Material, cover: Cover | None, shortfall: float
) -> list[str]:
    """Return what keeps the layers that are stiff from being corrected, one line each; none if none is stiff.

    Parameters
    ----------
    body, layers, material, cover
        The sensor as designed.
    shortfall
        By how much the made rubber's Poisson's ratio may fall below the designed one.
    """
    stiff = {name: layer for name, layer in layers.items() if layer.stiff}
    if not stiff:
        return []
    key = f"markers.{next(iter(stiff))}.stiff"
    if not isinstance(body, Block):
        shape = type(body).__name__.lower()
        return [f"{key} = true: how stiff beads push is known in a block only, this body is a {shape}; leave it out"]
    problems = []
    if cover is not None and (
        cover.youngs_modulus_mpa not in (None, material.youngs_modulus_mpa)
        or cover.poisson_ratio not in (None, material.poisson_ratio)
    ):
        problems.append(
            f"{key} = true: a cover of another material than the body's reflects the beads' push-back in a way that "
            "is not known here: leave out cover.youngs_modulus_mpa and cover.poisson_ratio, or stiff"
        )
    poisson_ratio = material.poisson_ratio - shortfall
    if poisson_ratio < LEAST_POISSON_RATIO:
        problems.append(
            f"{key} = true: material.poisson_ratio may be as low as {poisson_ratio:.4g} with its tolerance, but must "
            f"be {LEAST_POISSON_RATIO} to 0.5: the beads' push-back is that of incompressible rubber"
        )
    for name, layer in stiff.items():
        least = LEAST_GAP * layer.diameter_mm / 2
        for what, gap in _gaps(name, layers):
            if gap < least:
                problems.append(
                    f"markers.{name}.stiff = true: its beads' centres are {gap:.3g} mm from {what}, but must be at "
                    f"least {least:.3g} mm (two diameters): increase depth_mm or pitch_mm, or reduce diameter_mm"
                )
        room, wanted = _room(body, layer), LEAST_ROOM * layer.depth_mm
        if room < wanted:
            problems.append(
                f"markers.{name}.stiff = true: its beads are {room:.3g} mm from a side or the base of the body, but "
                f"must be at least {wanted:.3g} mm (three depths): only the sensing surface reflects the push-back"
            )
    return problems


def _gaps(name: str, layers: Mapping[str, MarkerLayer]) -> list[tuple[str, float]]:
    """Return the smallest distance (mm) of a layer's centres to the surface, to each other and to each other layer."""
    layer = layers[name]
    gaps = [("the sensing surface", layer.depth_mm)]
    if layer.columns * layer.rows > 1:
        gaps.append(("each other", layer.pitch_mm))
    for other, neighbour in layers.items():
        if other != name:
            sideways = [
                float(np.abs(one[:, None] - two).min()) for one, two in zip(_axes(layer), _axes(neighbour), strict=True)
            ]
            gaps.append((f"those of markers.{other}", math.hypot(*sideways, layer.depth_mm - neighbour.depth_mm)))
    return gaps


def _room(body: Block, layer: MarkerLayer) -> float:
    """Return the smallest distance of a layer's centres to the sides and the base of a block, mm."""
    x, y = (float(np.abs(axis).max()) for axis in _axes(layer))
    return min(body.width_mm / 2 - x, body.length_mm / 2 - y, body.thickness_mm - layer.depth_mm)


def _axes(layer: MarkerLayer) -> tuple[Floats, Floats]:
    s, t = grid_axes(layer.columns, layer.rows, layer.pitch_mm)
    return s + layer.offset_mm[0], t + layer.offset_mm[1]
