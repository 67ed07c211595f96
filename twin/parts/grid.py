"""Grids over the sensing surface, in its coordinates (s, t), and their one order: s outer, t inner."""

from __future__ import annotations

import numpy as np

from twin.arrays import Chart, Floats


def grid_axes(columns: int, rows: int, pitch_mm: float) -> tuple[Floats, Floats]:
    """Return the s and the t of a centred grid, mm."""
    s, t = (pitch_mm * (np.arange(count, dtype=np.float64) - (count - 1) / 2) for count in (columns, rows))
    return s, t


def grid_chart(s: Floats, t: Floats) -> Chart:
    """Return the (columns * rows, 2) surface coordinates of a grid, s outer and t inner."""
    return np.stack(np.meshgrid(s, t, indexing="ij"), axis=-1).reshape(-1, 2)
