"""Benchmarks: ``python -m benchmarks [NAME ...] [--quick]``, or ``python -m benchmarks NAME [OPTIONS]``.

A benchmark is a module with a function `measure`, whose options are the command's. Stages and studies return rows,
which are printed and stored in benchmarks/results/NAME.json; checks print what they find, and their exit code is 1
where something is wrong. Without a name every stage runs, each in a process of its own, one after the other, so that
nothing is timed beside other work. ``--quick`` runs small versions, in two minutes, and stores nothing.
"""

import importlib
import subprocess
import sys
from itertools import takewhile

from cyclopts import App, CycloptsError

from benchmarks.clock import Clock
from benchmarks.record import store, table

STAGES = (
    "elasticity",
    "contact",
    "picture",
    "tracking",
    "conditions",
    "chain",
    "inverse",
    "dataset",
    "sweep",
    "budget",
)
STUDIES = ("calibrations", "fingers", "finite_strain", "inclusions", "live")
"""What is run when it is named: minutes of CPU time, a quarter of an hour for calibrations, for figures that have no
accuracy knob."""

CHECKS = (
    "endurance",
    "extremes",
    "frozen",
    "fuzz",
    "kills",
    "mutation",
    "pages",
    "presses",
    "random_bodies",
    "random_scenes",
)


def main() -> int:
    """Run what is wanted; return the exit code."""
    given = sys.argv[1:]
    names = list(takewhile(lambda word: not word.startswith("-"), given))
    if names and names[0] in CHECKS:
        return command(names[0], given[1:])
    options = given[len(names) :]
    if "--help" in options or "-h" in options:
        print(f"{__doc__}\nStages: {', '.join(STAGES)}\nStudies: {', '.join(STUDIES)}\nChecks: {', '.join(CHECKS)}")
        return 0
    unknown = sorted({*names} - {*STAGES, *STUDIES}) + [word for word in options if word != "--quick"]
    if unknown:
        print(
            f"unknown {', '.join(unknown)}: choose from {', '.join(STAGES + STUDIES)} and --quick, or one of "
            f"{', '.join(CHECKS)}",
            file=sys.stderr,
        )
        return 2
    quick = bool(options)
    wanted = names or STAGES
    if not quick and len(wanted) > 1:
        codes = [subprocess.run([sys.executable, "-m", "benchmarks", name], check=False).returncode for name in wanted]
        return int(any(codes))
    for name in wanted:
        _run(name, quick)
    return 0


def command(name: str, options: list[str]) -> int:
    """Run a check with the options of its `measure`; return the exit code, 2 for wrong options."""
    module = importlib.import_module(f"benchmarks.{name}")
    app = App(
        name=f"python -m benchmarks {name}",
        help=module.__doc__,
        help_format="plaintext",
        version_flags=(),
        result_action="return_value",
    )
    app.default(module.measure)
    try:
        return int(app(options, exit_on_error=False) or 0)
    except CycloptsError:
        return 2


def _run(name: str, quick: bool) -> None:
    """Run a stage or study here; print its table, and store it if it is not a quick one."""
    print(f"\n{name}\n", flush=True)
    clock = Clock()
    rows = importlib.import_module(f"benchmarks.{name}").measure(quick=quick)
    print(f"{table(rows)}\n\n{clock.lap().cpu:.3g} s of CPU", flush=True)
    if not quick:
        store(name, rows)


if __name__ == "__main__":
    sys.exit(main())
