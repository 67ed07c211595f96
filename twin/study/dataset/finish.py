"""After the last sample: counts, checksums and the card. Nothing in here depends on when or where it was made."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.progress import Progress
from twin.results import write_json, write_whole
from twin.study.batch.engine import Pool
from twin.study.batch.job import Job
from twin.study.dataset.audit import audit
from twin.study.dataset.card import card_text, croissant
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.prepare import sha256
from twin.study.dataset.reader import readable


@dataclass(frozen=True)
class Counted:
    """What all shards say together.

    Attributes
    ----------
    numbers
        Of the samples that failed.
    reason
        Why the first did.
    """

    numbers: frozenset[int]
    reason: str


def finish(plan: Plan, places: Places, job: Job, pool: Pool, progress: Progress | None) -> Counted:
    """Count, compute some samples again, and write the card, the Croissant metadata and the checksums."""
    counted = count(plan, places)
    kept = places.meta / "audit.json"
    told: dict[str, Any] = json.loads(kept.read_text()) if kept.is_file() else {}
    if told.get("of") != plan.samples:
        told = {"of": plan.samples, **audit(plan, job, counted.numbers, pool, progress)}
        write_json(kept, told)
    card = card_text(plan, places, told, len(counted.numbers))
    write_whole(places.folder / "README.md", lambda file: file.write(card.encode()))
    write_json(places.folder / "croissant.json", croissant(plan))
    write_sums(places)
    return counted


def count(plan: Plan, places: Places) -> Counted:
    """Read the status of every sample."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    failed: set[int] = set()
    reason = ""
    for number in range(plan.shards):
        with readable(places.shard(number)):
            table = pq.read_table(places.shard(number), columns=["index", "status", "error"])
            table.select(["index", "status", "error"])
        bad = table.filter(pc.equal(table["status"], "failed"))
        failed |= set(bad["index"].to_pylist())
        if bad.num_rows and not reason:
            reason = f"sample {bad['index'][0]}: {bad['error'][0]}"
    return Counted(frozenset(failed), reason)


def sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a dataset, by relative path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in ("meta/SHA256SUMS", "meta/writer.lock"):
            found[name] = sha256(path)
    return found


def listed(places: Places) -> dict[str, str]:
    """Return the checksums that were written when the dataset was finished, by relative path; none if it was not."""
    if not places.sums.is_file():
        return {}
    lines = [line.split("  ", 1) for line in places.sums.read_text(errors="replace").splitlines() if "  " in line]
    return {name: digest for digest, name in lines}


def drop_changed(places: Places) -> None:
    """Remove of a finished dataset what is no longer as it was written, so that it is made again.

    Why: a file that still opens is taken for whole, and its new checksum would then hide that it was damaged.
    """
    for name, digest in listed(places).items():
        path = places.folder / name
        made = path.parent in (places.data, places.sensors) or path == places.meta / "audit.json"
        if made and path.is_file() and sha256(path) != digest:
            path.unlink()


def write_sums(places: Places) -> None:
    """Write meta/SHA256SUMS (``sha256sum -c`` reads it from the dataset's folder)."""
    lines = "".join(f"{digest}  {name}\n" for name, digest in sums(places.folder).items())
    write_whole(places.sums, lambda file: file.write(lines.encode()))
