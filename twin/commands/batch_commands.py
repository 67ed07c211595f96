"""Commands that compute many samples, designs or experiments: dataset, export, sweep, reproduce."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.options import Batch, Overrides, SceneName, Whole, load
from twin.show.terminal import progress

MOST_SAMPLES = 1_000_000_000
"""Years of work, and a plan that still fits into memory."""

_DEFAULT = Batch()


def dataset(
    scene: SceneName,
    *,
    samples: Annotated[Whole, Parameter(help="How many samples; a dataset can grow later.")],
    columns: Annotated[
        tuple[str, ...],
        Parameter(
            help="What to keep, separated by commas (default all).",
            show_default=False,
            negative_iterable="",
        ),
    ] = (),
    batch: Batch = _DEFAULT,
    set_: Overrides = (),
) -> None:
    """Make a dataset of a scene whose [vary] table lists what differs between samples.

    DIR/data holds the samples as Parquet, DIR/sensors the sensors they were pressed on, DIR/meta
    everything else. An interrupted job continues when the same command is given again, and ends
    with the same bytes. A sample that fails is a row with its error (exit code 3).

    Examples:
    twin dataset dataset_kamiyama --samples 1000 --out data/flat
    twin dataset dataset_sato --samples 50 --columns force_n,marker_pressed_px
    twin dataset my_scene.toml --samples 100000 --scheduler tcp://10.0.0.1:8786
    """
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # read when numba is loaded; workers inherit it
    from twin.errors import InputError, SomeFailed
    from twin.study.dataset.create import create_dataset
    from twin.study.recipe import find_scene

    names = [part.strip() for name in columns for part in name.split(",") if part.strip()]
    if columns and not names:
        raise InputError("--columns names nothing: name some, or leave it out for all")
    loaded = load(scene, set_)
    if names:
        kept = loaded.dataset.model_copy(update={"columns": tuple(names)})
        loaded = loaded.model_copy(update={"dataset": kept})
    if not 1 <= samples <= MOST_SAMPLES:
        raise InputError(f"--samples {samples}: allowed are 1 to {MOST_SAMPLES:,}")
    workers, cluster = batch.workers_and_scheduler()
    folder = batch.out or Path("out") / find_scene(scene).stem
    if batch.dry_run:
        from twin.study.dataset.create import estimate

        for line in estimate(loaded, samples, workers=workers, progress=progress()):
            print(line)
        return
    done = create_dataset(
        loaded, folder, samples, workers=workers, scheduler=cluster, progress=progress()
    )
    rate = f" ({done.made / done.seconds:.3g} a second)" if done.made else ""
    print(f"samples     {done.samples}, {done.made} of them made now{rate}")
    print(f"written to  {done.folder}")
    if done.missing:
        raise SomeFailed(f"{len(done.missing)} shards are missing, {done.reason}")
    if done.failed:
        raise SomeFailed(
            f"{done.failed} of {done.samples} samples failed, the first: {done.reason}"
        )


def export(
    folder: Annotated[Path, Parameter(help="Folder of the dataset.")],
    *,
    format: Annotated[str, Parameter(help="hdf5, coco or webdataset.")],
    out: Annotated[Path, Parameter(help="Folder to write to.")],
) -> None:
    """Write a dataset as HDF5, as COCO keypoints, or as WebDataset tar files; failed samples are
    left out.

    Examples:
    twin export data/flat --format hdf5 --out flat_h5
    twin export data/flat --format coco --out flat_coco
    """
    from twin.study.dataset.export import export_dataset

    files = export_dataset(folder, format, out, progress())
    print(f"{files[0] if files else out}: {len(files)} file{'s' if len(files) != 1 else ''}")


def sweep(
    sweep: Annotated[str, Parameter(help="Path of a sweep file, or the name of a shipped sweep.")],
    *,
    optimise: Annotated[
        bool,
        Parameter(
            help="Search the best design between the axes' ends instead of sampling them.",
            negative="",
        ),
    ] = False,
    batch: Batch = _DEFAULT,
) -> None:
    """Judge many designs of a sensor: by a closed form, by their linear information, by pictures.

    Writes DIR/designs.parquet (and .csv) with a row for every design, DIR/report.html, and DIR/best
    with a scene for each of the best designs, ready for twin run. An interrupted job continues when
    the same command is given again, and ends with the same table. A design that fails is a row with
    its error (exit code 3).

    Shipped sweeps: sweep_kamiyama_depth_pitch, sweep_sato_pitch_diameter, sweep_lens,
    sweep_youngs_modulus.

    Examples:
    twin sweep sweep_lens --out out/lens
    twin sweep my_sweep.toml --workers 8
    twin sweep sweep_kamiyama_depth_pitch --optimise
    """
    from twin.errors import SomeFailed
    from twin.study.sweep.designs import load_sweep

    wanted, scene = load_sweep(sweep)
    workers, cluster = batch.workers_and_scheduler()
    if batch.dry_run:
        from twin.study.sweep.sweep_run import estimate

        for line in estimate(wanted, scene, workers=workers):
            print(line)
        return
    from twin.study.sweep.sweep_report import write_report
    from twin.study.sweep.sweep_run import run_sweep

    folder = batch.out or Path("out") / Path(sweep).stem
    bar = progress()
    done = run_sweep(
        wanted, scene, folder, workers=workers, scheduler=cluster, progress=bar, optimise=optimise
    )
    best = write_report(done, folder)
    if bar is not None:
        bar("done", 1.0)
    kinds = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    print(f"designs     {len(done.designs)}: {counts}")
    for warning in done.warnings:
        print(f"warning     {warning}")
    for note in done.notes:
        print(f"            {note}")
    for words in best[:3]:
        print(f"best        {words}")
    print(f"written to  {folder}")
    if done.failed:
        reason = next(str(e) for e, s in zip(done.error, done.status, strict=True) if s == "failed")
        raise SomeFailed(
            f"{done.failed} of {len(done.designs)} designs failed, the first: {reason}"
        )


def reproduce(
    *names: Annotated[
        str, Parameter(help="Entries (kamiyama/table-1), papers (sato), or all (default).")
    ],
    out: Annotated[
        Path, Parameter(help="Folder for the page, the records and the pictures.")
    ] = Path("reproduce"),
    quick: Annotated[
        bool, Parameter(help="One made sensor, fewer steps, no long entries.", negative="")
    ] = False,
    seed: Annotated[Whole, Parameter(help="Root seed of sensors and noise.")] = 1,
) -> None:
    """Reproduce the papers' tables and figures, with the papers' figures for comparison.

    Every experiment runs through the full chain: contact, picture, CCD, tracking, inverse. Writes
    DIR/index.html, DIR/results.json and an SVG for each. Results in DIR that are still valid are
    not computed again.

    Examples:
    twin reproduce all
    twin reproduce kamiyama/table-1 sato --out here
    """
    from twin.errors import InputError, SomeFailed
    from twin.study.reproduce.reproduction_run import reproduce as run

    if not 0 <= seed < 2**63 - 100:
        raise InputError(f"--seed {seed}: allowed are whole numbers from 0 to 2^63 - 101")
    done = run(names, out, seed=seed, quick=quick, progress=progress())
    print("\n".join(done.lines))
    if done.failed:
        raise SomeFailed(
            f"{len(done.failed)} of the entries failed: {', '.join(done.failed)}; see "
            f"{out / 'index.html'}"
        )
