"""How large a dataset will be and how long it takes, from a few samples made here and thrown away.

The time is told from CPU seconds: those of the clock would be of whatever else the machine was doing meanwhile.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from twin.parts.scene import Scene
from twin.progress import Progress
from twin.study.batch.job import one_thread, unpacked
from twin.study.dataset.audit import audit_sample, audited
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import job_of, prepare
from twin.study.dataset.work import make_shard

TRIED = 4

T = TypeVar("T")


def estimate(scene: Scene, samples: int, *, workers: int = 1, progress: Progress | None = None) -> list[str]:
    """Return lines that say what a dataset would hold, its size and the time it takes.

    Raises
    ------
    RecipeError
        The scene can't be sampled.
    """
    plan = Plan(scene, samples)
    plan.check()
    sensors, audits = plan.sensor_of(samples - 1) + 1, len(audited(samples, ()))
    cut = {"samples_per_shard": TRIED, "samples_per_sensor": 2 * TRIED}
    tried = scene.model_copy(update={"dataset": scene.dataset.model_copy(update=cut)})
    with tempfile.TemporaryDirectory(prefix="twin-estimate-") as name, one_thread():
        places = Places(Path(name))
        places.meta.mkdir()
        prepare(Plan(tried, 3 * TRIED), places, progress)
        with unpacked(job_of(places)) as folder:
            first, begun = _timed(make_shard, folder, 0)
            shard, made = _timed(make_shard, folder, 1)
            _, again = _timed(audit_sample, folder, TRIED)
            another = _timed(make_shard, folder, 2)[1] if sensors > 1 else made
        beside = sum(path.stat().st_size for path in places.meta.iterdir())
    if progress is not None:
        progress("done", 1.0)
    each, start, sensor = made / TRIED, max(begun - made, 0.0), max(another - made, 0.0)
    shared = samples * each + (sensors - 1) * sensor + audits * again
    size = len(shard.samples) / TRIED * samples + len(first.sensors or b"") * sensors + beside
    lines = [
        f"samples     {samples} on {counted(sensors, 'sensor')}, in {counted(plan.shards, 'file')}",
        f"columns     {', '.join(c.name for c in plan.columns)}",
        f"varies      {', '.join(sorted(scene.vary)) or 'nothing'}",
        f"size        about {_bytes(size)}",
        f"time        about {_duration(start + shared / workers)} with {counted(workers, 'worker')}, a free core each: "
        f"{each:.3g} s of CPU a sample (of {TRIED} tried), {again:.2g} s for each of the {audits} computed again, "
        f"{start:.2g} s to begin" + (f", {sensor:.2g} s for each further sensor" if sensors > 1 else ""),
    ]
    if plan.alike:
        lines.append(f"warning     {plan.alike}")
    if shard.failed:
        lines.append(f"failures    {shard.failed} of {TRIED} tried: {shard.reason}")
    return lines


def _timed(work: Callable[..., T], *arguments: Any) -> tuple[T, float]:
    """Return what work gives, and the CPU seconds that it takes."""
    started = time.process_time()
    return work(*arguments), time.process_time() - started


def counted(number: int, thing: str) -> str:
    """Return a number of things in words."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _bytes(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
