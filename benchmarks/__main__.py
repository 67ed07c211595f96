"""``python -m benchmarks [STAGE ...] [--quick]``: run stages, print tables, write benchmarks/results/STAGE.json.

Each full stage runs in a process of its own, one after the other, so that nothing is timed beside other work.
"""

import argparse
import importlib
import subprocess
import sys

from benchmarks.clock import Clock
from benchmarks.record import store, table

STAGES = (
    "elasticity",
    "contact",
    "peers",
    "picture",
    "referee",
    "tracking",
    "conditions",
    "chain",
    "inverse",
    "dataset",
    "sweep",
    "budget",
)
SLOW = ("peers", "referee")
"""Stages that a quick run leaves out unless they are named: they need other programs, much memory, LLVM or
time."""

STUDIES = ("calibrations", "live", "realism")
"""What is run when it is named: minutes of CPU time, a quarter of an hour for calibrations, for figures that have no
accuracy knob."""


def main() -> int:
    """Run the wanted stages; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "stage", nargs="*", help=f"one or more of {', '.join(STAGES)} (default all stages); or {', '.join(STUDIES)}"
    )
    parser.add_argument("--quick", action="store_true", help="small versions, in two minutes, written nowhere")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.stage) - {*STAGES, *STUDIES}):
        parser.error(f"unknown stages {', '.join(unknown)}: choose from {', '.join(STAGES + STUDIES)}")
    wanted = arguments.stage or [stage for stage in STAGES if not (arguments.quick and stage in SLOW)]
    if not arguments.quick and len(wanted) > 1:
        codes = [
            subprocess.run([sys.executable, "-m", "benchmarks", stage], check=False).returncode for stage in wanted
        ]
        return int(any(codes))
    for stage in wanted:
        _run(stage, arguments.quick)
    return 0


def _run(stage: str, quick: bool) -> None:
    """Run a stage here; print its table, and store it if it is not a quick one."""
    print(f"\n{stage}\n", flush=True)
    clock = Clock()
    rows = importlib.import_module(f"benchmarks.{stage}").run(quick=quick)
    print(f"{table(rows)}\n\n{clock.lap().cpu:.3g} s of CPU", flush=True)
    if not quick:
        store(stage, rows)


if __name__ == "__main__":
    sys.exit(main())
