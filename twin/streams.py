"""Random streams: one root seed, and a stream of its own for every purpose and index.

Why: adding a draw to one purpose never changes another, and a press draws the same noise whatever
was computed before.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What the numbers are drawn for; the values are part of the file format, never reuse one."""

    PRINT = 0
    TOLERANCE = 1
    EXPOSURE = 2
    LOAD_CELL = 3
    SAMPLING = 4
    SENSOR_PATTERN = 5
    SENSOR = 6


def stream(seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """Return the generator of ``purpose`` number ``index`` under the root ``seed``."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(purpose), index)))
