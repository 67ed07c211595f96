"""One process that makes pictures: the first one's time, and what many leave in memory.

``python -m benchmarks.picture_process VARIANT COUNT`` prints one line of JSON. The clock starts with the process.
"""

from __future__ import annotations

import json
import os
import sys
import time

SMALL = {
    "camera.width_px": 64, "camera.height_px": 48, "markers.red.columns": 5, "markers.red.rows": 4,
    "markers.blue.columns": 4, "markers.blue.rows": 3,
}  # fmt: skip
"""What makes many pictures quick: what a process would keep of each, it keeps of small ones, too."""


def main() -> int:
    """Make the pictures and print what they took."""
    import numpy as np

    from twin.parts.markers import place
    from twin.study.recipe import load_scene
    from twin.world.picture.backend import choose_variant
    from twin.world.picture.ccd import expose
    from twin.world.picture.ellipsoids import ellipsoids
    from twin.world.picture.render import Renderer

    variant, count = choose_variant(sys.argv[1]), int(sys.argv[2])
    scene = load_scene("kamiyama_pillar")
    markers = ellipsoids(place(scene.body, scene.markers), scene.markers)
    expose(Renderer(scene, markers, variant).radiance(markers), scene.ccd, np.random.default_rng(0))
    found = {"first_ms": 1000 * _age(), "first_cpu_ms": 1000 * time.process_time(), "first_mib": _peak()}
    small = load_scene("kamiyama_pillar", SMALL)
    points = place(small.body, small.markers)
    renderer = Renderer(small, ellipsoids(points, small.markers), variant)
    begun, wall, cpu = _now_mib(), time.perf_counter(), time.process_time()
    rng = np.random.default_rng(2)
    for n in range(count):
        moved = rng.uniform(-0.2, 0.2, (len(points), 3))
        expose(renderer.radiance(ellipsoids(points, small.markers, moved)), small.ccd, np.random.default_rng(n))
        if n == count // 10:  # what is allocated once is there by now
            begun = _now_mib()
    found |= {"each_ms": 1000 * (time.perf_counter() - wall) / count,
              "each_cpu_ms": 1000 * (time.process_time() - cpu) / count,
              "last_mib": _peak(), "grown_mib": _now_mib() - begun}  # fmt: skip
    print(json.dumps(found))
    return 0


def _peak() -> float:
    """Return the most memory since this program began; rusage would count the parent's, from before."""
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) / 1024 for line in file if line.startswith("VmHWM"))


def _now_mib() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def _age() -> float:
    """Return the seconds since this process began, imports included."""
    with open("/proc/self/stat") as file:
        began = int(file.read().rsplit(")", 1)[1].split()[19]) / os.sysconf("SC_CLK_TCK")
    with open("/proc/uptime") as file:
        return float(file.read().split()[0]) - began


if __name__ == "__main__":
    sys.exit(main())
