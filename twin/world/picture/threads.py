"""Work on ranges of rows or pixels, on as many threads as numba may use: its kernels leave Python alone.

Why not numba's own threads: the layer that is always there ends the process when two threads call it at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
from numba import config

PARTS = 8
"""Into how many ranges work is cut, whatever the threads: random numbers are drawn by part."""


def in_parts(count: int, work: Callable[[int, int, int], Any]) -> list[Any]:
    """Call ``work(part, begin, end)`` on `PARTS` ranges of 0 to ``count``; return what it returns, in order."""
    edges = np.linspace(0, count, PARTS + 1).astype(int).tolist()
    threads = max(int(config.NUMBA_NUM_THREADS), 1)
    if threads == 1:
        return [work(part, edges[part], edges[part + 1]) for part in range(PARTS)]
    return list(_pool(threads, os.getpid()).map(work, range(PARTS), edges[:-1], edges[1:]))


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Return the threads of this process: a forked one needs its own."""
    return ThreadPoolExecutor(threads, thread_name_prefix=f"twin-{process}")
