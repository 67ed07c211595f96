"""Does a dataset of any size fit? ``python -m benchmarks.dataset_memory [--samples 100000]``: memory as samples grow.

One process makes prescribed tractions without pictures, the kind of sample that is made fastest, into a folder that is
thrown away; its resident memory is read whenever a shard is done, and at the end, counts, checksums and card included.
Stored in benchmarks/results/dataset_memory.json, with the slope of a line through what came after the first tenth; exit
code 1 if it grew by more than `GROWTH_MB`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.__main__ import RESULTS, machine
from benchmarks.arguments import at_least
from benchmarks.dataset import RECTANGLE, TRUTH
from benchmarks.endurance import state
from twin.arrays import Floats
from twin.study.dataset.create import create_dataset
from twin.study.recipe import load_scene

STORED = RESULTS / "dataset_memory.json"
WARM = 0.1
"""Share of the samples after which everything that is allocated once is there."""

GROWTH_MB = 20.0
SAMPLES = 100_000


def measured(samples: int) -> dict[str, Any]:
    """Return what a dataset of so many samples took, and memory beside samples made."""
    scene = load_scene("dataset_tractions", {"dataset.columns": TRUTH, "dataset.samples_per_shard": 250, **RECTANGLE})
    seen: list[tuple[float, float]] = []

    def told(what: str, share: float) -> None:
        if f"/{samples} samples," in what:  # and not those computed again
            seen.append((share, state()["memory_mb"]))

    started = time.process_time()
    with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder:
        done = create_dataset(scene, Path(folder) / "d", samples, progress=told)
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    share, memory = np.array(seen).T
    slope, error = slope_mb(samples * share[share > WARM], memory[share > WARM])
    return {
        "samples": samples, "failed": done.failed, "gb": size / 1e9,
        "cpu_ms_each": 1000 * (time.process_time() - started) / samples,
        "warm_mb": float(np.median(memory[(share > WARM) & (share <= 2 * WARM)])),
        "last_mb": float(np.median(memory[share > 1 - WARM])), "end_mb": state()["memory_mb"],
        "slope_mb": slope, "slope_error_mb": error,
        "memory_mb": [[round(samples * s), round(m, 1)] for s, m in seen[:: max(1, len(seen) // 40)]],
    }  # fmt: skip


def slope_mb(made: Floats, memory: Floats) -> tuple[float, float]:
    """Return by how many MB memory grows over 100,000 samples, by a line through (n,) readings, and its error."""
    line, spread = np.polyfit(made / 1e5, memory, 1, cov=True)
    return float(line[0]), float(np.sqrt(spread[0, 0]))


def grown(row: dict[str, Any]) -> bool:
    """Return whether memory was not flat."""
    return bool(max(row["last_mb"], row["end_mb"]) - row["warm_mb"] > GROWTH_MB)


def main() -> int:
    """Measure, store, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=at_least(1000), default=SAMPLES)
    row = measured(parser.parse_args().samples)
    if row["samples"] >= SAMPLES:  # fewer are a look, and stored nowhere
        STORED.write_text(json.dumps({"machine": machine(), **row}, indent=1) + "\n")
    print({key: value for key, value in row.items() if key != "memory_mb"})
    return int(grown(row))


if __name__ == "__main__":
    sys.exit(main())
