"""`twin reproduce`: the papers' tables and figures, made again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Whole, progress


def reproduce(
    *names: Annotated[str, Parameter(help="Entries (kamiyama/table-1), papers (sato), or all (default).")],
    out: Annotated[Path, Parameter(help="Folder for the page, the records and the pictures.")] = Path("reproduce"),
    quick: Annotated[bool, Parameter(help="One made sensor, fewer steps, no long entries.", negative="")] = False,
    seed: Annotated[Whole, Parameter(help="Root seed of sensors and noise.")] = 1,
) -> None:
    """Make the papers' tables and figures again, paper beside twin.

    Every experiment runs through the full chain: contact, picture, CCD, tracking, inverse. Writes DIR/index.html,
    DIR/results.json and a PNG for each. What DIR holds already and still stands is not run again.

    Examples:
    twin reproduce all
    twin reproduce kamiyama/table-1 sato --out here
    """
    from twin.errors import InputError, SomeFailed
    from twin.study.reproduce.runner import reproduce as run

    if not 0 <= seed < 2**63 - 100:
        raise InputError(f"--seed {seed}: allowed are whole numbers from 0 to 2^63 - 101")
    done = run(names, out, seed=seed, quick=quick, progress=progress())
    print("\n".join(done.lines))
    if done.failed:
        raise SomeFailed(
            f"{len(done.failed)} of the entries failed: {', '.join(done.failed)}; see {out / 'index.html'}"
        )
