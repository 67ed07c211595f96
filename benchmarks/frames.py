"""Does a sequence grow? ``python -m benchmarks.frames [--frames 1000000]``: frames without end through one tracker.

Small pictures (64 x 48 px, 8 markers), so that a million take minutes: nothing that could grow hangs on their size.
Every frame is tracked and turned into forces by the linear map, every hundredth is reconstructed in full with another
marker lost, and every thousandth shows nothing. Resident memory after the first tenth and at the end is stored in
benchmarks/results/frames.json; exit code 1 if it grew by more than `GROWTH_MB`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.__main__ import RESULTS, machine, table
from benchmarks.arguments import at_least
from benchmarks.discs import expose, scene
from benchmarks.endurance import state
from twin.errors import InputError
from twin.sense.calibration import Calibration
from twin.sense.force_map import force_map
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Tracker

FRAMES = 1_000_000
GROWTH_MB = 5.0
SIZE = (64, 48)


def small_sensor() -> tuple[Calibration, dict[str, np.ndarray]]:
    """Return a made-up sensor of 8 markers and 4 sites, and its layout."""
    grid = np.stack(np.meshgrid([12.0, 36.0], [12.0, 36.0], indexing="ij"), axis=-1).reshape(-1, 2)
    layout = {"red": grid, "blue": grid + np.array([12.0, 0.0])}
    place = np.concatenate(list(layout.values()))
    sites = np.column_stack([grid + np.array([6.0, 0.0]), np.zeros(4)]) / 12.0
    transfer = np.random.default_rng(0).normal(0, 1.0, (2 * len(place), 12))
    calibration = Calibration(
        layer=np.repeat(["red", "blue"], 4), layout_px=place, site_mm=sites, site_frames=np.tile(np.eye(3), (4, 1, 1)),
        site_area_mm2=np.full(4, 4.0), grid=(2, 2), transfer=transfer,
    )  # fmt: skip
    return calibration, layout


def pictures(layout: dict[str, np.ndarray], count: int = 20) -> list[np.ndarray]:
    """Return pictures of markers that move by up to a pixel and a half; the first at rest."""
    random, out = np.random.default_rng(1), []
    for number in range(count):
        moved = [points + (number > 0) * random.uniform(-1.5, 1.5, points.shape) for points in layout.values()]
        out.append(expose(scene(SIZE, [(moved[0], 0), (moved[1], 2)], 8.0), number))
    return out


def follow(frames: int) -> list[dict[str, float]]:
    """Return the process's state a hundred times along so many frames."""
    calibration, layout = small_sensor()
    shown = pictures(layout)
    blank = np.full_like(shown[0], 20)
    tracker, live = Tracker(shown[0], layout), force_map(calibration, 0.01)
    random, states = np.random.default_rng(2), []
    for number in range(frames):
        picture = shown[number % len(shown)]
        if number % 1000 == 999:
            picture = blank
        elif number % 100 == 99:
            picture = picture.copy()
            column, row = np.rint(calibration.layout_px[random.integers(8)]).astype(int)
            picture[row - 6 : row + 7, column - 6 : column + 7] = 20
        found = tracker.track(picture)
        try:
            live.forces(found.shift_px)
            if number % 100 == 99:
                reconstruct(found, calibration)
        except InputError:
            tracker.forget()
        if number % max(frames // 100, 1) == 0:
            states.append(state())
    return states


def main() -> int:
    """Follow the frames, print what became of the process and store it; exit code 1 if it grew."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.frames", description=__doc__)
    parser.add_argument(
        "--frames", type=at_least(1000), default=FRAMES, help=f"how many (default {FRAMES}; fewer: not stored)"
    )
    arguments = parser.parse_args()
    started = time.process_time()
    states = follow(arguments.frames)
    seconds = time.process_time() - started
    early, late = states[len(states) // 10], states[-1]
    rows: list[dict[str, Any]] = [
        {"what": name, "after a tenth": early[name], "at the end": late[name], "largest": max(s[name] for s in states)}
        for name in early
    ]
    print(f"{table(rows)}\n\n{arguments.frames} frames in {seconds:.3g} s of CPU")
    grown = late["memory_mb"] - early["memory_mb"]
    if grown > GROWTH_MB:
        print(f"memory grew by {grown:.1f} MB", file=sys.stderr)
        return 1
    if arguments.frames < FRAMES:
        return 0
    stored = {"machine": machine(), "frames": arguments.frames, "cpu_s": seconds, "rows": rows}
    (RESULTS / "frames.json").write_text(json.dumps(stored, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
