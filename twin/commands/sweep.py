"""`twin sweep`: many designs of a sensor, judged before silicone is cast."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Whole, progress


def sweep(
    sweep: Annotated[str, Parameter(help="Path of a sweep file, or the name of a shipped sweep.")],
    *,
    out: Annotated[Path | None, Parameter(help="Folder of the results (default out/<sweep>).")] = None,
    workers: Annotated[Whole | None, Parameter(help="Processes on this machine (default: its cores).")] = None,
    scheduler: Annotated[str | None, Parameter(help="dask scheduler whose workers do it: tcp://host:8786.")] = None,
    dry_run: Annotated[bool, Parameter(help="Only say what would be done and how long it takes.", negative="")] = False,
    optimise: Annotated[
        bool, Parameter(help="Look for the best design between the axes' ends instead of sampling them.", negative="")
    ] = False,
) -> None:
    """Judge many designs of a sensor: by a closed form, by their linear information, by pictures.

    Writes DIR/designs.parquet (and .csv) with a row for every design, DIR/report.html, and DIR/best with a scene for
    each of the best designs, ready for twin run. What is stopped, by whatever, goes on when the same command is given
    again, and ends with the same table. A design that fails is a row with its error (exit code 3).

    Shipped sweeps: sweep_kamiyama_depth_pitch, sweep_sato_pitch_diameter, sweep_lens, sweep_youngs_modulus.

    Examples:
    twin sweep sweep_lens --out out/lens
    twin sweep my_sweep.toml --workers 8
    twin sweep sweep_kamiyama_depth_pitch --optimise
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is loaded, so that workers inherit it
    from twin.errors import InputError, SomeFailed
    from twin.study.sweep.recipe import load_sweep
    from twin.study.sweep.report import write_report
    from twin.study.sweep.run import run_sweep

    wanted, scene = load_sweep(sweep)
    count = workers if workers is not None else len(os.sched_getaffinity(0))
    if count < 1:
        raise InputError(f"--workers {count}: give at least 1")
    if dry_run:
        from twin.study.sweep.estimate import estimate

        for line in estimate(wanted, scene, workers=count):
            print(line)
        return
    folder = out or Path("out") / Path(sweep).stem
    bar = progress()
    done = run_sweep(
        wanted, scene, folder, workers=count, scheduler=scheduler, progress=bar, optimise=optimise
    )  # fmt: skip
    from twin.study.sweep.best import write_best

    best = write_best(done, folder)
    write_report(done, best, folder)
    if bar is not None:
        bar("done", 1.0)
    kinds = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    print(f"designs     {len(done.designs)}: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items()))
    for warning in done.warnings:
        print(f"warning     {warning}")
    for note in done.notes:
        print(f"            {note}")
    for each in best[:3]:
        print(f"best        {each.words}")
    print(f"written to  {folder}")
    if done.failed:
        reason = next(str(e) for e, s in zip(done.error, done.status, strict=True) if s == "failed")
        raise SomeFailed(f"{done.failed} of {len(done.designs)} designs failed, the first: {reason}")
