"""What a sweep would do and how long it takes, from a few designs made here and thrown away.

The time is told from CPU seconds: those of the clock would be of whatever else the machine was doing meanwhile.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from twin.arrays import Ints
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.batch.job import Job, one_thread, unpacked
from twin.study.dataset.estimate import counted
from twin.study.recipe import dump_scene
from twin.study.sweep.closed import closed
from twin.study.sweep.designs import Designs, designs_of
from twin.study.sweep.recipe import load_sweep
from twin.study.sweep.run import check
from twin.study.sweep.sites import advice, told_by_sites
from twin.study.sweep.work import WORK, make_rows

TRIED = {"linear": 4, "full": 1}


def estimate(sweep: Sweep, scene: Scene, *, workers: int = 1) -> list[str]:
    """Return lines that say what a sweep would do.

    Raises
    ------
    RecipeError
        The sweep can't be run.
    """
    lines, good, designs = _overview(sweep, scene)
    left = len(good)
    for stage in sweep.ladder:
        if stage == "closed" or not left:
            continue
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        left = min(left, most) if most and stage != sweep.ladder[0] else left
        tried = good[:: max(1, len(good) // TRIED[stage])][: TRIED[stage]]
        told = {
            "sweep": sweep.model_dump(mode="json"), "stage": stage, "chunk": 1,
            "designs": [designs.values(int(n)) for n in (tried[0], *tried)],  # the first twice: it begins
        }  # fmt: skip
        files = {"sweep.json": json.dumps(told).encode(), "scene.toml": dump_scene(scene).encode()}
        with one_thread(), unpacked(Job(files=files, work=WORK)) as folder:
            began = time.process_time()
            make_rows(Path(folder), 0)
            started = time.process_time()
            rows = [make_rows(Path(folder), k).rows[0] for k in range(1, 1 + len(tried))]
            each, start = (time.process_time() - started) / len(rows), started - began
        start = max(start - each, 0.0)
        lines.append(
            f"{stage:11s} {counted(left, 'design')}, about {start + left * each / workers:.3g} s with "
            f"{counted(workers, 'worker')}, a free core each: {each:.3g} s of CPU a design (of {len(rows)} tried), "
            f"{start:.2g} s to begin"
        )
        lines += [f"            {row['status']}: {row['error']}" for row in rows if row["status"] != "ok"]
    return lines


def looked_over(path: Path) -> list[str]:
    """Return lines about a sweep file in which nothing is wrong; raises like `estimate`."""
    sweep, scene = load_sweep(path)
    lines, good, designs = _overview(sweep, scene)
    if len(good):
        designs.scene_of(int(good[0]))
    return [f"{path}: ok", *lines]


def _overview(sweep: Sweep, scene: Scene) -> tuple[list[str], Ints, Designs]:
    """Return lines about a sweep's designs, the numbers of those that are possible, and all."""
    check(sweep, scene)
    designs = designs_of(sweep, scene)
    first = closed(designs)
    good = np.flatnonzero(first.reason == "")
    lines = [
        f"designs     {len(designs)} ({sweep.sampling}) over {', '.join(sweep.axes)}",
        f"dropped     {len(designs) - len(good)} before anything is solved",
    ]
    for reason in sorted({str(r) for r in first.reason if r}):
        lines.append(f"            {int((first.reason == reason).sum())}: {reason}")
    target = sweep.targets.get("two_point_mm")
    if target is not None and scene.reconstruction is not None and not designs.swept("reconstruction.sites.pitch_mm"):
        told = told_by_sites(scene.reconstruction.sites, sweep.loads)
        if told > target:
            lines.append(f"warning     targets.two_point_mm = {target:g} can't be met: {advice(told, target)}")
    return lines, good, designs
