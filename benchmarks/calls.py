"""What one call costs a user of the standard block, whose loads are answered by its table: CPU time, no solve."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

import twin
from twin.parts.load import Rectangles

REPEATED, TIMES = 7, 200
"""The median of so many means over so many calls is taken."""

SITES = 16


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a kind of call: CPU milliseconds, and how many are asked for; the quick form is the same."""
    del quick
    sensor = twin.Sensor(twin.load_scene("kamiyama_pillar", {"tolerance.preset": "none"}))
    points = sensor.actual.markers.points
    places = np.random.default_rng(0).uniform((-12.0, -8.0), (12.0, 8.0), (300, 2))
    loads = [twin.Traction.rectangle(tuple(place), (4, 4), (0.1, 0, 1)) for place in places.tolist()]
    patches = Rectangles(
        centre_mm=np.column_stack([places, np.zeros(300)]), frames=np.tile(np.eye(3), (300, 1, 1)),
        half_mm=np.full((300, 2), 0.5), force_n=np.tile([0.0, 0.0, 0.01], (300, 1)),
    )  # fmt: skip
    few = np.ascontiguousarray(sensor.compliance.to_points(points, patches)[:, : 3 * SITES])
    forces, turn = np.ones(3 * SITES), iter(range(10**9))
    calls: tuple[tuple[str, int, Callable[[], object], float | str], ...] = (
        ("Sensor.displacement, a new patch", TIMES, lambda: sensor.displacement(points, loads[next(turn) % 300]), 0.3),
        ("displacement under 300 patches", 5, lambda: sensor.compliance.displacement(points, patches), 50.0),
        ("compliance of 300 patches", 5, lambda: sensor.compliance.to_points(points, patches), ""),
        (f"a load on {SITES} patches, with their compliance", TIMES, lambda: few @ forces, 0.02),
    )
    return [{"call": name, "markers": len(points), "CPU ms": _ms(call, n), "asked": ms} for name, n, call, ms in calls]


def _ms(call: Callable[[], object], times: int) -> float:
    for _ in range(30):  # more than the loads after which points are read by a product
        call()
    return median(_mean(call, times) for _ in range(REPEATED))


def _mean(call: Callable[[], object], times: int) -> float:
    start = time.process_time()
    for _ in range(times):
        call()
    return 1e3 * (time.process_time() - start) / times
