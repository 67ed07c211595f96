"""How large a dataset will be and how long it takes, from a few samples made here and thrown away."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from twin.parts.scene import Scene
from twin.progress import Progress
from twin.study.batch.job import one_thread, unpacked
from twin.study.dataset.audit import audit_sample, audited
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import job_of, prepare
from twin.study.dataset.work import make_shard

TRIED = 4


def estimate(scene: Scene, samples: int, *, workers: int = 1, progress: Progress | None = None) -> list[str]:
    """Return lines that say what a dataset would hold, its size and the time it takes.

    Raises
    ------
    RecipeError
        The scene can't be sampled.
    """
    tried = scene.model_copy(update={"dataset": scene.dataset.model_copy(update={"samples_per_shard": TRIED})})
    plan = Plan(scene, samples)
    plan.check()
    with tempfile.TemporaryDirectory(prefix="twin-estimate-") as name, one_thread():
        places = Places(Path(name))
        places.meta.mkdir()
        prepare(Plan(tried, 2 * TRIED), places, progress)
        with unpacked(job_of(places)) as folder:
            first = make_shard(folder, 0)
            started = time.perf_counter()
            shard = make_shard(folder, 1)
            made = time.perf_counter()
            audit_sample(folder, TRIED)
            seconds, again = (made - started) / TRIED, time.perf_counter() - made
        beside = sum(path.stat().st_size for path in places.meta.iterdir())
    if progress is not None:
        progress("done", 1.0)
    sensors, audits = plan.sensor_of(samples - 1) + 1, len(audited(samples, ()))
    size = len(shard.samples) / TRIED * samples + len(first.sensors or b"") * sensors + beside
    with_workers = f"{workers} worker{'s' if workers > 1 else ''}"
    lines = [
        f"samples     {samples} on {sensors} sensor{'s' if sensors > 1 else ''}, in {plan.shards} files",
        f"columns     {', '.join(c.name for c in plan.columns)}",
        f"varies      {', '.join(sorted(scene.vary)) or 'nothing: every sample is the same press'}",
        f"size        about {_bytes(size)}",
        f"time        about {_duration((samples * seconds + audits * again) / workers)} with {with_workers}, "
        f"from {TRIED} samples at {seconds:.3g} s each; {audits} are computed again, {again:.2g} s each",
    ]
    if shard.failed:
        lines.append(f"failures    {shard.failed} of {TRIED} tried: {shard.reason}")
    return lines


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
