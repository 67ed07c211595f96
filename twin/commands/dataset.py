"""`twin dataset`: many samples of a scene, with their truth."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Overrides, SceneName, Whole, load, progress

MOST = 1_000_000_000
"""Samples of a dataset at most: years of work, and what its plan still holds in memory."""


def dataset(
    scene: SceneName,
    *,
    samples: Annotated[Whole, Parameter(help="How many samples; a dataset can grow later.")],
    out: Annotated[Path | None, Parameter(help="Folder of the dataset (default out/<scene>).")] = None,
    columns: Annotated[
        tuple[str, ...],
        Parameter(help="What to keep, separated by commas (default all).", show_default=False, negative_iterable=""),
    ] = (),
    workers: Annotated[Whole | None, Parameter(help="Processes on this machine (default: its cores).")] = None,
    scheduler: Annotated[str | None, Parameter(help="dask scheduler whose workers do it: tcp://host:8786.")] = None,
    dry_run: Annotated[
        bool, Parameter(help="Only say how large it will be and how long it takes.", negative="")
    ] = False,
    set_: Overrides = (),
) -> None:
    """Make a dataset of a scene whose [vary] table says what differs between samples.

    DIR/data holds the samples as Parquet, DIR/sensors the sensors they were pressed on, DIR/meta everything else. What
    is stopped, by whatever, goes on when the same command is given again, and ends with the same bytes. A sample that
    fails is a row with its error (exit code 3).

    Examples:
    twin dataset dataset_kamiyama --samples 1000 --out data/flat
    twin dataset dataset_sato --samples 50 --columns force_n,marker_pressed_px
    twin dataset my_scene.toml --samples 100000 --scheduler tcp://10.0.0.1:8786
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is loaded, so that workers inherit it
    from twin.errors import InputError, SomeFailed
    from twin.study.dataset.create import create_dataset
    from twin.study.recipe import find_scene

    names = [part.strip() for name in columns for part in name.split(",") if part.strip()]
    if columns and not names:
        raise InputError("--columns names nothing: name some, or leave it out for all")
    loaded = load(scene, set_)
    if names:
        loaded = loaded.model_copy(update={"dataset": loaded.dataset.model_copy(update={"columns": tuple(names)})})
    if not 1 <= samples <= MOST:
        raise InputError(f"--samples {samples}: allowed are 1 to {MOST:,}")
    count = workers if workers is not None else len(os.sched_getaffinity(0))
    if count < 1:
        raise InputError(f"--workers {count}: give at least 1")
    folder = out or Path("out") / find_scene(scene).stem
    if dry_run:
        from twin.study.dataset.estimate import estimate

        for line in estimate(loaded, samples, workers=count, progress=progress()):
            print(line)
        return
    done = create_dataset(loaded, folder, samples, workers=count, scheduler=scheduler, progress=progress())
    rate = f" ({done.made / done.seconds:.3g} a second)" if done.made else ""
    print(f"samples     {done.samples}, {done.made} of them made now{rate}")
    print(f"written to  {done.folder}")
    if done.missing:
        raise SomeFailed(f"{len(done.missing)} shards are missing, {done.reason}")
    if done.failed:
        raise SomeFailed(f"{done.failed} of {done.samples} samples failed, the first: {done.reason}")
