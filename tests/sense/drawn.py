"""Pictures of two grids of markers, by `benchmarks.discs`."""

import numpy as np
import pytest

from benchmarks.discs import expose, scene


def flat_layout(columns=10, rows=8, pitch=30.0, origin=(40.0, 40.0)):
    """Red grid and blue grid at half a pitch inside it, as in the flat sensor."""
    red, blue = (
        np.stack(np.meshgrid(np.arange(columns - k), np.arange(rows - k), indexing="ij"), axis=-1).reshape(-1, 2)
        for k in (0, 1)
    )
    return {"red": red * pitch + origin, "blue": (blue + 0.5) * pitch + origin}


WIDTHS = [8.0, 10.0, pytest.param(15.0, marks=pytest.mark.slow)]


def wide(diameter):
    """Return layout and size of a picture of markers of this diameter."""
    pitch = max(30.0, 2.3 * diameter)
    return flat_layout(8, 6, pitch, (pitch, pitch)), (int(9 * pitch), int(7 * pitch))


SIZE, LAYOUT = (264, 204), flat_layout(8, 6, 30.0, (27.0, 27.0))


def joined(layout):
    return np.concatenate(list(layout.values()))


def picture(shift=0.0, seed=None, layout=LAYOUT, size=SIZE, diameter=10.0, **options):
    """Both layers moved by ``shift`` (a number, a vector, or one row a marker)."""
    count = len(layout["red"])
    moved = joined(layout) + shift
    drawn = scene(size, [(moved[:count], 0), (moved[count:], 2)], diameter, **options)
    return drawn if seed is None else expose(drawn, seed)
