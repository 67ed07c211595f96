"""The page of ``twin run --live``: CPU milliseconds of an update, over places, pushes, side forces and twists.

An update is contact, displacement, picture, tracking, reconstruction, and the page's bytes. Hands are drawn within half
of the sliders' range, each computed twice, the first time to warm up; those that friction can't carry are refused, and
counted. ``open_cpu_s`` is what the page takes to open with empty caches: on a curved body its surface's table.
"""

from typing import Any

import numpy as np

from benchmarks.clock import Clock, empty_cache
from twin.blas_threads import one_thread
from twin.errors import ContactError
from twin.study.live import QUICK, LivePress
from twin.study.recipe import load_scene

SCENES = ("kamiyama_pillar", "sato_press")
HANDS = 24
REACH = 0.5
"""Of the sliders' ranges."""
FRICTION = 1.2
"""What Sato's shear presses need."""


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a scene; the quick form takes few hands on the flat block."""
    with empty_cache():
        return [_row(name, 4 if quick else HANDS) for name in (SCENES[:1] if quick else SCENES)]


def _row(name: str, count: int) -> dict[str, Any]:
    _opened("kamiyama_pillar")  # compiles
    clock = Clock()
    live = _opened(name)
    opening = clock.lap().cpu
    spent, refused = [], 0
    for hand in _hands(live, count):
        try:
            live.answer(hand)
        except ContactError:
            refused += 1
            continue
        clock.lap()
        live.answer(hand)
        spent.append(1e3 * clock.lap().cpu)
    middle = float(np.median(spent))
    return {"scene": name, "updates": len(spent), "refused": refused, "median_cpu_ms": middle,
            "worst_cpu_ms": max(spent), "updates_per_s": 1e3 / middle, "open_cpu_s": opening}  # fmt: skip


def _opened(name: str) -> LivePress:
    live = LivePress(load_scene(name, QUICK))
    live.answer(live.start().question())
    return live


def _hands(live: LivePress, count: int) -> list[dict[str, Any]]:
    """Draw questions."""
    rng, start, sliders = np.random.default_rng(3), live.start().question(), live.facts()["range"]
    both = ("x_mm", "y_mm", "side_x", "side_y", "twist")
    return [
        start
        | {key: float(rng.uniform(-REACH, REACH) * sliders[key][1]) for key in both}
        | {"push_n": float(rng.uniform(0.2, 1.0) * start["push_n"]), "friction": FRICTION}
        for _ in range(count)
    ]
