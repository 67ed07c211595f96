"""``python -m benchmarks [STAGE ...] [--quick]``: run stages, print tables, write benchmarks/results/STAGE.json."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
from pathlib import Path

STAGES = (
    "elasticity",
    "calls",
    "contact",
    "peers",
    "growth",
    "picture",
    "referee",
    "tracking",
    "chain",
    "inverse",
    "calibrations",
    "stress",
    "dataset",
    "sweep",
    "budget",
    "scaling",
)
SLOW = ("peers", "growth", "referee", "calibrations", "scaling")
"""Stages that a quick run leaves out unless they are named: they need other programs, much memory, LLVM or
time."""

RESULTS = Path(__file__).parent / "results"


def main() -> int:
    """Run the wanted stages; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("stage", nargs="*", help=f"one or more of {', '.join(STAGES)} (default all)")
    parser.add_argument("--quick", action="store_true", help="small versions, in two minutes, written nowhere")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.stage) - set(STAGES)):
        parser.error(f"unknown stages {', '.join(unknown)}: choose from {', '.join(STAGES)}")
    everything = [stage for stage in STAGES if not (arguments.quick and stage in SLOW)]
    for stage in arguments.stage or everything:
        print(f"\n{stage}\n", flush=True)
        started = sum(os.times()[:4])
        rows = importlib.import_module(f"benchmarks.{stage}").run(quick=arguments.quick)
        print(f"{table(rows)}\n\n{sum(os.times()[:4]) - started:.3g} s of CPU", flush=True)
        if not arguments.quick:
            RESULTS.mkdir(exist_ok=True)
            (RESULTS / f"{stage}.json").write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
    return 0


def table(rows: list[dict[str, object]]) -> str:
    """Return rows as a Markdown table."""
    if not rows:
        return "(no rows)"
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [columns, ["---"] * len(columns)]
    lines += [[_cell(row.get(column, "")) for column in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def machine() -> dict[str, object]:
    """Return what the figures were measured on."""
    names = [line.split(":", 1)[1].strip() for line in _cpu_lines() if line.startswith("model name")]
    return {"processor": names[0] if names else platform.processor(), "cores": os.cpu_count(),
            "system": platform.platform(), "python": platform.python_version()}  # fmt: skip


def _cpu_lines() -> list[str]:
    try:
        return Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
