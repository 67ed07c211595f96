"""What a piece of work costs: wall and CPU seconds, child processes counted, nothing remembered from earlier runs.

CPU seconds are what methods are compared by: they hold on a busy machine, and two cores can't hide work.
"""

import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

from twin.files import cache_folder


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Seconds that a piece of work took: wall, and CPU of all threads and finished children."""

    wall: float
    cpu: float


class Clock:
    """Started when made; `lap` returns the cost since then or since the last lap."""

    def __init__(self) -> None:
        self._last = _now()

    def lap(self) -> Cost:
        """Return the cost since the last call."""
        now, last = _now(), self._last
        self._last = _now()
        return Cost(wall=now[0] - last[0], cpu=now[1] - last[1])


def repeated(work: Callable[[], object], times: int) -> list[Cost]:
    """Return the costs of so many runs."""
    clock, costs = Clock(), list[Cost]()
    for _ in range(times):
        work()
        costs.append(clock.lap())
    return costs


def _now() -> tuple[float, float]:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter(), time.process_time() + children.ru_utime + children.ru_stime


@contextmanager
def empty_cache() -> Iterator[None]:
    """Give the program a cache folder of its own that is empty, so that nothing solved before is read."""
    with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder:
        try:
            with patch.dict(os.environ, TWIN_CACHE=folder):
                cache_folder.cache_clear()
                yield
        finally:
            cache_folder.cache_clear()
