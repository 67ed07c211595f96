"""The rows of a sweep on disk: every finished row under its content's hash, and the table made of them.

``rows.jsonl`` grows by whole lines; what a kill cuts off is one line, which is left out and made again. A row's key
says everything it depends on (design, scene, loads, fidelity, versions), so a row is computed once whatever the order,
and a changed sweep reuses the designs that it has in common with the one before.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.results import write_whole
from twin.study.sweep.work import SHOWN, Row


class Store:
    """Finished rows by key; one process writes.

    Parameters
    ----------
    folder
        Of the sweep.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "rows.jsonl"
        self._shown = folder / "shown"
        self._rows: dict[str, Row] = {}
        whole = 0
        if self._path.is_file():
            data = self._path.read_bytes()
            for line in data.splitlines(keepends=True):
                try:
                    told = json.loads(line) if line.endswith(b"\n") else None
                except (ValueError, RecursionError):
                    told = None
                if not (isinstance(told, dict) and isinstance(told.get("key"), str) and _is_row(told.get("row"))):
                    break
                self._rows[told["key"]] = told["row"]
                whole += len(line)
            if whole < len(data):
                with open(self._path, "r+b") as file:
                    file.truncate(whole)

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

    def add(self, rows: Mapping[str, Row], shown: Mapping[str, bytes]) -> None:
        """Keep finished rows, and what belongs to them."""
        for key, data in shown.items():
            self._shown.mkdir(exist_ok=True)
            write_whole(self.shown(key), lambda file, data=data: file.write(data))  # type: ignore[misc]
        with open(self._path, "ab") as file:
            for key, row in rows.items():
                file.write(json.dumps({"key": key, "row": row}).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._rows |= rows

    def shown(self, key: str) -> Path:
        """Return the file of a design's picture and fields, which may not be there."""
        return self._shown / f"{key}.npz"

    def pictures(self, key: str) -> dict[str, np.ndarray] | None:
        """Return a design's picture and fields; None where they are missing or damaged."""
        try:
            with np.load(self.shown(key), allow_pickle=False) as kept:
                return {name: kept[name] for name in SHOWN}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            return None


def _is_row(row: Any) -> bool:
    return isinstance(row, dict) and {"status", "error"} <= row.keys()


def row_key(identity: str, stage: str, values: Mapping[str, Any]) -> str:
    """Return the key of a row."""
    told = json.dumps([identity, stage, values], sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()[:32]


def write_table(folder: Path, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> None:
    """Write ``designs.parquet`` and ``designs.csv``, a row for every design."""
    import pyarrow as pa
    import pyarrow.csv as csv
    import pyarrow.parquet as pq

    arrays = {}
    for name, column in columns.items():
        values = column.tolist() if isinstance(column, np.ndarray) else list(column)
        if any(isinstance(v, list | tuple | dict) for v in values) or len({type(v) for v in values}) > 1:
            numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
            values = (
                [float(v) for v in values] if numbers else [v if isinstance(v, str) else json.dumps(v) for v in values]
            )
        arrays[name] = pa.array(values)
    table = pa.table(arrays)
    write_whole(folder / "designs.parquet", lambda file: pq.write_table(table, file, compression="zstd"))
    write_whole(folder / "designs.csv", lambda file: csv.write_csv(table, file))
