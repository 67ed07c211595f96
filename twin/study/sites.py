"""Squares on the sensing surface under no force yet: where forces are reconstructed, and where presses were made."""

from __future__ import annotations

import numpy as np

from twin.arrays import Chart
from twin.errors import RecipeError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.pipeline import Sites


def on_grid(body: Body, grid: Sites, half_mm: float, key: str) -> Rectangles:
    """Return squares of a half side on a grid over the surface; see `on_surface`."""
    return on_surface(body, grid.chart(), half_mm, key)


def on_surface(body: Body, chart: Chart, half_mm: float, key: str) -> Rectangles:
    """Return squares of a half side at (k, 2) surface coordinates, under no force yet.

    Raises
    ------
    RecipeError
        A place lies outside the sensing surface.
    """
    points = body.chart_points(chart)
    if not body.contains(points, -1e-6).all():
        raise RecipeError(f"{key}: some lie outside the sensing surface; reduce columns, rows or pitch_mm")
    half = np.full((len(points), 2), half_mm)
    return Rectangles(centre_mm=points, frames=body.frames(points), half_mm=half, force_n=np.zeros((len(points), 3)))
