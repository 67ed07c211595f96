"""What ``python -m twin.sense.compile_ahead`` does: it tracks two small pictures, so that numba
compiles and stores the tracker.

A first ``twin run`` starts it while contact and pictures are still compiled: the two take about
equally long.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Picture
from twin.sense.track import track

_PITCH_PX = 20
_LAYERS = {"red": (0, 0.0), "blue": (2, 10.0)}
"""Channel of each layer's colour, and how far it lies from the first, px."""


def _dots(moved_px: float) -> Picture:
    """Return a picture (120, 160, 3) of two layers of dots that have moved along the rows."""
    row, column = np.mgrid[0:120, 0:160]
    picture = np.full((120, 160, 3), 15.0)
    for channel, aside in _LAYERS.values():
        across = (column - aside - moved_px) % _PITCH_PX - _PITCH_PX / 2
        down = (row - aside) % _PITCH_PX - _PITCH_PX / 2
        picture[:, :, channel] += 180 * np.clip(4.5 - np.hypot(across, down), 0, 1)
    return picture.astype(np.uint8)


if __name__ == "__main__":
    rows = np.arange(10.0, 100.0, _PITCH_PX)
    columns = np.arange(10.0, 140.0, _PITCH_PX)
    places = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    layout = {name: places + aside for name, (_, aside) in _LAYERS.items()}
    track(_dots(0.0), _dots(1.5), layout)
