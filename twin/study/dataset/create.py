"""Make a dataset: what must precede the first sample, the samples, and the facts and card at the
end.

Only this process writes into the folder, under a lock of the operating system. ``meta/`` with
scene, meshes and facts is written before the first sample, and every file appears complete under
its name. So whatever stops a run, the same command continues with the missing shards and ends with
the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from twin.arrays import Progress
from twin.blas_threads import one_thread
from twin.errors import InputError
from twin.files import Fact, fact, file_digest, make_folder, write_json, write_whole
from twin.parts.material import Material
from twin.parts.scene import Scene
from twin.parts.shape import StlFile
from twin.study.batch.pool import Job, Pool, counted, only_writer
from twin.study.dataset.audit import FIGURES, audit
from twin.study.dataset.columns import Column
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import portable, prepare
from twin.study.dataset.reader import DatasetReader
from twin.study.dataset.sample import audit_sample, make_shard

TRIED, TRIED_SEQUENCES = 3, 1
"""Samples of an estimate, after as many that warm up; and sequences, which take long."""

T = TypeVar("T")


@dataclass(frozen=True)
class _Outcome:
    """The outcome of a run: the dataset's samples and how many failed, with the first reason; the
    shards that could not be made; and the seconds of this run and the samples it made.
    """

    folder: Path
    samples: int
    failed: int
    missing: tuple[int, ...]
    reason: str
    seconds: float
    made: int


def create_dataset(
    scene: Scene,
    folder: Path,
    samples: int,
    *,
    workers: int = 1,
    scheduler: Pool.Scheduler | None = None,
    progress: Progress | None = None,
) -> _Outcome:
    """Make a dataset, or what is missing of it.

    Parameters
    ----------
    scene
        With ``[vary]``, and ``[dataset]`` if its defaults don't fit.
    folder, samples
        Where to, and how many; it may hold the beginning of the same dataset, which can grow.
    workers, scheduler
        See `twin.study.batch.pool.Pool`.

    Raises
    ------
    RecipeError
        The scene can't be sampled.
    InputError
        The folder holds something else, another process is writing there, or the scheduler can't
        be reached.

    Warns
    -----
    UserWarning
        Nothing of the press varies, so that all samples are the same one.
    """
    plan = Plan(scene, samples)
    plan.check()
    if "picture" in plan.needs and scheduler is None:
        from twin.world.picture.backend import Variant

        Variant.check_machine(scene, at_once=min(workers, plan.shards))
    if plan.alike:
        warnings.warn(plan.alike, stacklevel=2)
    if scheduler is not None:
        scheduler.reach()
    places = Places(folder)
    with only_writer(folder, places.meta / "writer.lock"):
        plan = prepare(plan, places, progress)
        whole = _undamaged(places)
        for wanted in (places.data, places.sensors):
            make_folder(wanted)
        with Pool(workers, scheduler) as pool:
            return _made(plan, places, whole, pool, progress)


def _made(
    plan: Plan, places: Places, whole: dict[str, str], pool: Pool, progress: Progress | None
) -> _Outcome:
    """Make the missing shards, and finish the dataset if none is missing."""
    job = places.job
    content = json.loads(places.info.read_text())["content"]
    started = time.perf_counter()
    waiting = [n for n in range(plan.shards) if not _is_whole(plan, places, n, content, whole)]
    if waiting:  # from a finished dataset to one that is being written
        _write_list(places.written, whole)
        places.sums.unlink(missing_ok=True)
    there = plan.samples - sum(len(plan.of_shard(n)) for n in waiting)
    made, failed, reason = 0, 0, ""
    missing: list[int] = []

    def show() -> None:
        if progress is not None:
            rate = made / max(time.perf_counter() - started, 1e-9)
            failures = f", {failed} failed" if failed else ""
            done = there + made
            progress(
                f"{done}/{plan.samples} samples, {rate:.3g}/s{failures}",
                min(0.999, done / plan.samples),
            )

    show()
    for done in pool.run(job, waiting):
        if done.problem is not None:
            missing.append(done.number)
            reason = reason or f"shard {done.number}: {done.problem}"
            continue
        whole |= _write(places, done)
        made += len(plan.of_shard(done.number))
        failed += done.result.failed
        reason = reason or done.result.reason
        show()
    seconds = time.perf_counter() - started
    if not missing:
        bad, first = _failures(plan, places)
        failed = len(bad)
        reason = reason or first
        # Compute some samples again; write the card, the Croissant metadata and the checksums, of
        # shards as they were written, which later damage does not change.
        kept = places.meta / "audit.json"
        found: dict[str, Any] = json.loads(kept.read_text()) if kept.is_file() else {}
        if found.get("of") != plan.samples:
            found = {"of": plan.samples, **audit(plan, job, bad, pool, progress)}
            write_json(kept, found)
        write_whole(places.folder / "README.md", _card_text(plan, places, found, failed).encode())
        write_json(places.folder / "croissant.json", _croissant(plan))
        _write_list(places.sums, places.sums_of_files(whole))
        places.written.unlink(missing_ok=True)
    if progress is not None:
        progress("done", 1.0)
    return _Outcome(
        folder=places.folder,
        samples=plan.samples,
        failed=failed,
        missing=tuple(missing),
        reason=reason,
        seconds=seconds,
        made=made,
    )


def _write(places: Places, done: Job.Done) -> dict[str, str]:
    """Write a shard's files, list their checksums, and return them."""
    shard: Any = done.result
    files = {places.shard(done.number): shard.samples}
    if shard.sensors is not None:
        files = {places.sensor_shard(done.number): shard.sensors, **files}
    for path, data in files.items():
        write_whole(path, data)
    new = {
        path.relative_to(places.folder).as_posix(): hashlib.sha256(data).hexdigest()
        for path, data in files.items()
    }
    with places.written.open("a") as file:
        file.writelines(_lines(new))
    return new


def _is_whole(
    plan: Plan, places: Places, number: int, content: str, whole: Collection[str]
) -> bool:
    """Return whether a shard is there, with all of its samples and sensors and of this dataset;
    ``whole`` are the undamaged files (`_undamaged`)."""
    paths = [places.shard(number)] + [places.sensor_shard(number)] * bool(plan.sensors_of(number))
    numbers = plan.of_shard(number)
    there = [_holds(path, content, f"{numbers.start}-{numbers.stop}") for path in paths]
    return all(there) and all(path.relative_to(places.folder).as_posix() in whole for path in paths)


def _holds(path: Path, content: str, samples: str) -> bool:
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        return False
    try:
        words = pq.read_schema(path).metadata or {}
    except (pa.ArrowException, OSError):
        return False
    if words.get(b"twin.content", b"") != content.encode():
        raise InputError(f"{path}: belongs to another dataset; give another --out, or remove it")
    return bool(words.get(b"twin.samples", b"") == samples.encode())


def _undamaged(places: Places) -> dict[str, str]:
    """Remove damaged shards and audits; return the checksums of the undamaged shards.

    Why: a damaged file may still open, and its new checksum would then hide the damage.
    """
    known = {**places.listed(places.sums), **places.listed(places.written)}
    whole = {}
    for name, digest in known.items():
        path = places.folder / name
        shard = path.parent in (places.data, places.sensors)
        if not (shard or path == places.meta / "audit.json") or not path.is_file():
            continue
        if file_digest(path) != digest:
            path.unlink()
        elif shard:
            whole[name] = digest
    return whole


def _failures(plan: Plan, places: Places) -> tuple[set[int], str]:
    """Return the numbers of the failed samples, and why the first failed."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    failed: set[int] = set()
    reason = ""
    for number in range(plan.shards):
        with DatasetReader.readable(places.shard(number)):
            table = pq.read_table(places.shard(number), columns=["index", "status", "error"])
            table.select(["index", "status", "error"])
        bad = table.filter(pc.equal(table["status"], "failed"))
        failed |= set(bad["index"].to_pylist())
        if bad.num_rows and not reason:
            reason = f"sample {bad['index'][0]}: {bad['error'][0]}"
    return failed, reason


_CARD = Path(__file__).with_name("card.md")
_LICENCE = "https://creativecommons.org/publicdomain/zero/1.0/"


def _card_text(plan: Plan, places: Places, audit: dict[str, Any], failed: int) -> str:
    """Return the card: Markdown under the header that dataset hubs read."""
    scene = plan.scene
    info = places.read_info()
    sensors = plan.sensor_of(plan.samples - 1) + 1
    varies = "".join(f"* `{key}`: {_in_words(axis)}\n" for key, axis in sorted(scene.vary.items()))
    figures = "".join(
        f"| {what} | {audit[name]['median']:.2g} | {audit[name]['largest']:.2g} |\n"
        for name, what in FIGURES.items()
        if name in audit
    )
    versions = ", ".join(f"{name} {version}" for name, version in info["versions"].items())
    again = "1 sample was" if audit["samples"] == 1 else f"{audit['samples']} samples were"
    return _CARD.read_text(encoding="utf-8").format(
        title=scene.title or "Presses on a tactile sensor",
        samples=plan.samples,
        sensors=sensors,
        s="s" if sensors > 1 else "",
        failed=failed,
        varies=varies or "Nothing: every sample is the same press.",
        dataset=scene.dataset,
        seed=scene.seed,
        again=again,
        figures=figures,
        model=_model(scene.material),
        row_columns=_rows(plan.row_columns),
        sensor_columns=_rows(plan.sensor_columns),
        versions=versions,
        renderer=f"; renderer {info['renderer']}" if info["renderer"] else "",
    )


def _model(material: Material) -> str:
    """Return what the rubber's model holds and leaves out."""
    law = material.law
    if material.relaxation:
        return "The rubber relaxes (material.relaxation) in steps\nwith seconds; strain is small."
    if law == "linear":
        return "The model is quasi-static and linear: no rate, creep,\nhysteresis or large strain."
    return (
        f"Large strain is included (material.law = {law}) in\nmotions, indentations, forces and "
        "pictures; each force is shared out on the surface as by linear contact. The\nmodel is "
        "quasi-static: no rate, creep or hysteresis."
    )


def _rows(columns: tuple[Column, ...]) -> str:
    entries = (column.described() for column in columns)
    return "".join(f"| `{c['name']}` | {c['unit']} | {c['what']} |\n" for c in entries)


def _in_words(axis: Any) -> str:
    plain = StlFile.bare(
        axis.model_dump(mode="json", exclude={"source", "assumed"}, exclude_defaults=True)
    )
    return ", ".join(f"{key} {json.dumps(value)}" for key, value in plain.items())


def _croissant(plan: Plan) -> dict[str, Any]:
    """Return the dataset's Croissant 1.0 metadata (MLCommons), as JSON-LD. Files are named from the
    metadata's folder: readers look for a file set that is contained in nothing else there."""
    return {
        "@context": json.loads(_CONTEXT.read_text(encoding="utf-8")),
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": _name(plan.scene.title) or "twin-dataset",
        "description": f"{plan.samples} simulated presses on a camera-based tactile sensor, with "
        f"their truth.",
        "license": _LICENCE,
        "url": "https://example.org/not-published",
        "version": "1.0.0",
        "datePublished": "2026-01-01",
        "citeAs": "see CITATION.cff of tactile-twin",
        "distribution": [_files("samples", "data"), _files("sensors", "sensors")],
        "recordSet": [
            {"@type": "cr:RecordSet", "@id": name, "name": name, "field": _fields(name, columns)}
            for name, columns in (("samples", plan.row_columns), ("sensors", plan.sensor_columns))
        ],
    }


def _files(name: str, folder: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": f"{name}-files",
        "name": f"{name}-files",
        "encodingFormat": "application/x-parquet",
        "includes": f"{folder}/*.parquet",
    }


def _fields(name: str, columns: tuple[Column, ...]) -> list[dict[str, Any]]:
    return [
        {
            "@type": "cr:Field",
            "@id": f"{name}/{column.name}",
            "name": column.name,
            "description": column.what,
            "dataType": _TYPES[column.kind],
            **({"repeated": True} if column.kind in _LISTS else {}),
            "source": {"fileSet": {"@id": f"{name}-files"}, "extract": {"column": column.name}},
        }
        for column in columns
    ]


_LISTS = {"numbers": "sc:Float", "flags": "sc:Boolean", "vectors": "sc:Float", "pixels": "sc:Float"}


_TYPES = {
    "integer": "sc:Integer",
    "number": "sc:Float",
    "text": "sc:Text",
    "png": "sc:ImageObject",
    **_LISTS,
}


_CONTEXT = Path(__file__).with_name("croissant_context.json")
"""The terms of Croissant 1.0, as its specification gives them."""


def _name(title: str) -> str:
    kept = "".join(c if c.isalnum() else "-" for c in title.lower())
    short = "-".join(part for part in kept.split("-") if part)[:60]
    return f"{short}-{hashlib.sha256(title.encode()).hexdigest()[:6]}" if short else ""


def _write_list(path: Path, digests: Mapping[str, str]) -> None:
    """Write checksums; ``sha256sum -c`` reads them from the dataset's folder."""
    write_whole(path, "".join(_lines(digests)).encode())


def _lines(digests: Mapping[str, str]) -> list[str]:
    return [f"{digest}  {name}\n" for name, digest in digests.items()]


def estimate(
    scene: Scene, samples: int, *, workers: int = 1, progress: Progress | None = None
) -> list[Fact]:
    """Return facts about a dataset's content, its size and its time, from a few samples made here
    and their CPU seconds, as the clock counts other work on the machine, too; `RecipeError` where
    the scene can't be sampled."""
    plan = Plan(scene, samples)
    sensors = plan.sensor_of(samples - 1) + 1
    audits = len(plan.audited())
    # Random draws cost as much, without loading scipy.stats for Sobol' sequences.
    count = TRIED_SEQUENCES if scene.dataset.every_step else TRIED
    cut = {"samples_per_shard": count, "samples_per_sensor": 2 * count, "sampling": "random"}
    tried = scene.model_copy(update={"dataset": scene.dataset.model_copy(update=cut)})
    Plan(tried, samples).check()
    several = sensors > 1
    found, again = Job.remembered(
        "dataset",
        [portable(tried)[0].to_toml(), several],
        lambda: _measured(tried, several, progress),
    )
    if progress is not None:
        progress("done", 1.0)
    each = found["made_s"] / count
    start = max(found["begun_s"] - found["made_s"], 0.0)
    sensor = max(found["another_s"] - each, 0.0)
    shared = samples * each + (sensors - 1) * sensor + audits * found["again_s"]
    size = found["meta_b"] + found["samples_b"] / count * samples + found["sensor_b"] * sensors
    rows = f" of {found['rows'] / count:g} rows each" if scene.dataset.every_step else ""
    on = f"{counted(sensors, 'sensor')}, in {counted(plan.shards, 'file')}"
    seconds = start + shared / workers
    text = (
        f"about {_duration(seconds)} with {counted(workers, 'worker')}, a free core each: "
        f"{{sample_s:.3g}} s of CPU a sample (of {count} tried{again}), {{again_s:.2g}} s for each "
        f"of the {audits} computed again, {{begin_s:.2g}} s to begin"
    )
    if sensors > 1:
        text += ", {sensor_s:.2g} s for each further sensor"
    times = {"seconds": seconds, "sample_s": each, "again_s": found["again_s"], "begin_s": start}
    times |= {"sensor_s": sensor}
    facts = [
        fact("samples", f"{samples}{rows} on {on}", {"sensors": sensors, "files": plan.shards}),
        fact("columns", ", ".join(c.name for c in plan.columns)),
        fact("varies", ", ".join(sorted(scene.vary)) or "nothing"),
        fact("size", f"about {_bytes(size)}", {"bytes": size}),
        fact("time", text, times),
    ]
    if plan.alike:
        facts.append(fact("warning", plan.alike))
    if found["failed"]:
        facts.append(fact("failures", f"{found['failed']} of {count} tried: {found['reason']}"))
    return facts


def _measured(tried: Scene, several: bool, progress: Progress | None) -> dict[str, Any]:
    """Return CPU seconds and bytes of a few samples of one made sensor, and of ``several``."""
    count = tried.dataset.samples_per_shard
    with tempfile.TemporaryDirectory(prefix="twin-estimate-") as name, one_thread():
        places = Places(Path(name))
        places.meta.mkdir()
        prepare(Plan(tried, 2 * count + 1), places, progress)
        with places.job.unpacked() as folder:
            first, begun = _timed(make_shard, folder, 0)
            shard, made = _timed(make_shard, folder, 1)
            _, again = _timed(audit_sample, folder, count)
            another = _timed(make_shard, folder, 2)[1] if several else 0.0
        size = float(sum(path.stat().st_size for path in places.meta.iterdir()))
    rows = count
    if tried.dataset.every_step:
        import pyarrow as pa
        import pyarrow.parquet as pq

        rows = pq.read_metadata(pa.BufferReader(shard.samples)).num_rows
    return {
        "begun_s": begun,
        "made_s": made,
        "again_s": again,
        "another_s": another,
        "meta_b": size,
        "samples_b": len(shard.samples),
        "sensor_b": len(first.sensors or b""),
        "rows": rows,
        "failed": shard.failed,
        "reason": shard.reason,
    }


def _timed(work: Callable[..., T], *arguments: Any) -> tuple[T, float]:
    """Return the result of ``work``, and its CPU seconds."""
    started = time.process_time()
    return work(*arguments), time.process_time() - started


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
