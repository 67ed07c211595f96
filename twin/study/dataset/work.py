"""What a worker does: shard number in, the bytes of the shard's files out.

A worker knows the dataset only by the job's files (resolved scene, meshes, info); it keeps what it made of them, the
sensor last pressed with its factor and its renderer, for the shards that follow.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import TwinError
from twin.places import cache_folder, pin
from twin.study.dataset.columns import ALWAYS, Column, schema, to_arrow
from twin.study.dataset.plan import Plan
from twin.study.dataset.sample import MadeSensor, Row, failed_row, rows_of_sample, sensor_seed
from twin.study.recipe import load_scene

Bytes = bytes | bytearray | memoryview
"""A file's contents; what came from another process is not copied to make it one type."""


@dataclass(frozen=True)
class ShardBytes:
    """A finished shard.

    Attributes
    ----------
    samples, sensors
        Contents of its files; no sensors if all of its samples are pressed on sensors of earlier shards.
    failed
        How many of its samples failed, and the first reason.
    """

    samples: Bytes
    sensors: Bytes | None
    failed: int
    reason: str

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        """Travel between processes without a copy of the files on the way: numpy's arrays know how."""
        files = [each if each is None else np.frombuffer(each, np.uint8) for each in (self.samples, self.sensors)]
        return _arrived, (*files, self.failed, self.reason)


def _arrived(samples: Any, sensors: Any, failed: int, reason: str) -> ShardBytes:
    return ShardBytes(samples.data, sensors if sensors is None else sensors.data, failed, reason)


class Workshop:
    """What a process keeps of one dataset."""

    def __init__(self, folder: Path) -> None:
        told = json.loads((folder / "info.json").read_text())
        self.content: str = told["content"]
        self.plan = Plan(load_scene(folder / "scene.toml"), told["samples"])
        self._made: MadeSensor | None = None

    def sensor(self, number: int) -> MadeSensor:
        """Return a made sensor; the last one is kept."""
        if self._made is None or self._made.number != number:
            self._made = MadeSensor(self.plan, number, self.plan.sensor_values(range(number, number + 1))[0])
        return self._made


_WORKSHOPS: dict[Path, Workshop] = {}


@contextmanager
def working(folder: Path) -> Iterator[Workshop]:
    """Work on the dataset whose job's files are in a folder: its meshes only, and fields solved in one thread only."""
    if folder not in _WORKSHOPS:
        _WORKSHOPS.clear()
        _WORKSHOPS[folder] = Workshop(folder)
    with pin(folder), own_cache():
        yield _WORKSHOPS[folder]


@contextmanager
def own_cache() -> Iterator[None]:
    """Keep solved fields apart from those of other runs, which may have been summed by several threads."""
    before, base = os.environ.get("TWIN_CACHE"), cache_folder()
    os.environ["TWIN_CACHE"] = str(base if base.name == "one-thread" else base / "one-thread")
    cache_folder.cache_clear()
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("TWIN_CACHE", None)
        else:
            os.environ["TWIN_CACHE"] = before
        cache_folder.cache_clear()


def make_shard(folder: Path, shard: int) -> ShardBytes:
    """Return a shard's files."""
    with working(folder) as shop:
        plan = shop.plan
        numbers, firsts = plan.of_shard(shard), plan.sensors_of(shard)
        rows: list[Row] = []
        sensors: dict[int, Row] = {}
        failed, reason = 0, ""
        for sample, values in zip(numbers, plan.press_values(numbers), strict=True):
            number = plan.sensor_of(sample)
            try:
                made = shop.sensor(number)
                if number in firsts and number not in sensors:
                    sensors[number] = made.row
                new = rows_of_sample(made, sample, values)
            except TwinError as problem:  # the drawn sensor itself can't be
                sensors.setdefault(number, {"sensor": number, "seed": sensor_seed(plan.scene.seed, number)})
                new = [failed_row(plan, sample, values, f"sensor {number}: {problem}")]
            if new[0]["status"] == "failed":
                failed, reason = failed + 1, reason or f"sample {sample}: {new[0]['error']}"
            rows += new
        words = {"twin.content": shop.content, "twin.samples": f"{numbers.start}-{numbers.stop}"}
        columns = (*ALWAYS, *plan.drawn_columns, *plan.columns)
        ours = [row for number, row in sensors.items() if number in firsts]
        return ShardBytes(
            samples=parquet(rows, columns, words),
            sensors=parquet(ours, plan.sensor_columns, words) if ours else None,
            failed=failed,
            reason=reason,
        )


def parquet(rows: list[Row], columns: tuple[Column, ...], words: dict[str, str]) -> bytes:
    """Return rows as a Parquet file; pictures are packed already and stored as they are, a few to a row group."""
    import pyarrow.parquet as pq

    table = to_arrow(rows, schema(columns, words))
    packing = {c.name: "NONE" if c.kind == "png" else "ZSTD" for c in columns}
    leaves = {f"{name}{tail}": how for name, how in packing.items() for tail in _TAILS}
    file = io.BytesIO()
    pq.write_table(
        table, file, compression=leaves, use_dictionary=False, write_statistics=False,
        row_group_size=8 if any(c.kind == "png" for c in columns) else 1024, version="2.6",
    )  # fmt: skip
    return file.getvalue()


_TAILS = ("", ".list.element", ".list.element.list.element")
"""Names of a column's leaves in Parquet: of itself, of a list, of a list of vectors."""
