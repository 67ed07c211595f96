"""``python -m benchmarks [STAGE ...] [--quick]``: run stages, print tables, write benchmarks/results/STAGE.json.

Full stages run two at a time, each in a process of its own, as methods are compared by CPU seconds; those that need
every core or the wall clock come after, alone. ``--jobs 1`` runs one after the other, for wall times without company.
"""

import argparse
import importlib
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from benchmarks.clock import Clock
from benchmarks.record import at_least, store, table

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
    "stress",
    "dataset",
    "sweep",
    "budget",
    "scaling",
)
SLOW = ("peers", "referee", "scaling")
"""Stages that a quick run leaves out unless they are named: they need other programs, much memory, LLVM or
time."""

STUDIES = ("calibrations", "live")
"""What is run when it is named: minutes of CPU time, a quarter of an hour for calibrations, for figures that have no
accuracy knob."""

ALONE = ("dataset", "sweep")
"""Stages of several workers, whose figures are of the wall clock."""

LONGEST = ("peers", "budget", "picture", "elasticity", "stress")
"""Stages that are begun first where several run at a time, so that all cores end at about the same moment."""


def main() -> int:
    """Run the wanted stages; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "stage", nargs="*", help=f"one or more of {', '.join(STAGES)} (default all stages); or {', '.join(STUDIES)}"
    )
    parser.add_argument("--quick", action="store_true", help="small versions, in two minutes, written nowhere")
    parser.add_argument("--jobs", type=at_least(1), help="full stages at a time (default: 2, or 1 on one core)")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.stage) - {*STAGES, *STUDIES}):
        parser.error(f"unknown stages {', '.join(unknown)}: choose from {', '.join(STAGES + STUDIES)}")
    jobs = arguments.jobs or min(2, os.cpu_count() or 1)
    wanted = arguments.stage or [stage for stage in STAGES if not (arguments.quick and stage in SLOW)]
    if arguments.quick or jobs == 1 or len(wanted) == 1:
        for stage in wanted:
            _run(stage, arguments.quick)
        return 0
    first = [*(s for s in LONGEST if s in wanted), *(s for s in wanted if s not in LONGEST)]
    ways = [(jobs, [s for s in first if s not in ALONE]), (1, [s for s in first if s in ALONE])]
    return max([together([[sys.executable, "-m", "benchmarks", s] for s in some], n) for n, some in ways if some])


def _run(stage: str, quick: bool) -> None:
    """Run a stage here; print its table, and store it if it is not a quick one."""
    print(f"\n{stage}\n", flush=True)
    clock = Clock()
    rows = importlib.import_module(f"benchmarks.{stage}").run(quick=quick)
    print(f"{table(rows)}\n\n{clock.lap().cpu:.3g} s of CPU", flush=True)
    if not quick:
        store(stage, rows)


def together(commands: Sequence[Sequence[str]], jobs: int) -> int:
    """Run commands, so many at a time; print what they say in their order; return 1 if any failed, after all.

    Those with company have one thread each in their linear algebra: waiting threads would spend CPU time.
    """
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"} if jobs > 1 else {}
    code, pool = 0, ThreadPoolExecutor(jobs)

    def each(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        print(f"started: {' '.join(command)}", file=sys.stderr, flush=True)
        return subprocess.run(command, stdout=subprocess.PIPE, text=True, env=os.environ | one, check=False)

    try:
        for done in pool.map(each, commands):
            print(done.stdout, end="", flush=True)
            if done.returncode:
                print(f"failed, exit code {done.returncode}: {' '.join(done.args)}", file=sys.stderr, flush=True)
                code = 1
    finally:
        pool.shutdown(cancel_futures=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
