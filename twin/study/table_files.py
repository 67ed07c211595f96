"""Rows of a sequence into a file, as they come: Parquet, CSV or npz by the suffix.

The file grows under a temporary name and gets its own when closed, also when the sequence was interrupted; a killed
program leaves the temporary file (of CSV, with every row so far).
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Points
from twin.errors import InputError, TwinError
from twin.results import make_folder

SUFFIXES = (".parquet", ".csv", ".npz")
ROWS = 256
"""Rows of a Parquet group, which are held in memory."""

FIELD = "force_n"
"""The column that holds every site's force; in Parquet and npz only."""


class TableFile:
    """A table that is written row by row; ``sites`` (k, 3) mm go along with it.

    Raises
    ------
    InputError
        Another suffix, or a folder that can't be written.
    """

    def __init__(self, path: Path, sites: Points) -> None:
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(f"--out {path}: the table's suffix must be one of {', '.join(SUFFIXES)}")
        make_folder(path.parent)
        self.path, self._sites = path, sites
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._kind = path.suffix.lower()
        self._rows: list[dict[str, Any]] = []
        self._writer: Any = None
        self._file: Any = None
        self.count = 0

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row; every row has the same keys."""
        self.count += 1
        try:
            if self._kind == ".csv":
                self._add_csv(row)
                return
            self._rows.append(dict(row))
            if self._kind == ".parquet" and len(self._rows) >= ROWS:
                self._flush_parquet()
        except OSError as problem:
            raise TwinError(f"{self.path}: can't be written ({problem.strerror})") from None

    def close(self) -> None:
        """Finish the file and give it its name; without rows there is none."""
        try:
            if self._kind == ".parquet" and self._rows:
                self._flush_parquet()
            if self._kind == ".npz" and self._rows:
                with open(self._part, "wb") as file:
                    np.savez_compressed(file, allow_pickle=False, site_mm=self._sites, **_columns(self._rows))
            for sink in (self._writer if self._kind == ".parquet" else None, self._file):
                if sink is not None:
                    sink.close()
            if self._part.exists():
                os.replace(self._part, self.path)
        except OSError as problem:
            raise TwinError(f"{self.path}: can't be written ({problem.strerror})") from None
        finally:
            self._part.unlink(missing_ok=True)

    def _add_csv(self, row: Mapping[str, Any]) -> None:
        plain = {key: value for key, value in row.items() if key != FIELD}
        if self._writer is None:
            self._file = open(self._part, "w", newline="", encoding="utf-8")  # noqa: SIM115  closed by close()
            self._writer = csv.DictWriter(self._file, list(plain))
            self._writer.writeheader()
        self._writer.writerow({k: "" if isinstance(v, float) and v != v else v for k, v in plain.items()})
        self._file.flush()

    def _flush_parquet(self) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = {}
        for key in self._rows[0]:
            values = [row[key] for row in self._rows]
            if key == FIELD:
                arrays[key] = pa.array([np.asarray(v, np.float32).ravel() for v in values], pa.list_(pa.float32()))
            else:
                arrays[key] = pa.array(values)
        table = pa.table(arrays)
        if self._writer is None:
            facts = {
                "site_mm": json.dumps(np.asarray(self._sites).tolist()),
                "units": "N, mm, px; force_n: site by site x, y, z",
            }
            self._writer = pq.ParquetWriter(self._part, table.schema.with_metadata(facts))
        self._writer.write_table(table.cast(self._writer.schema))
        self._rows = []


def _columns(rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    return {
        key: np.stack([np.asarray(row[key], np.float32) for row in rows]) if key == FIELD
        else np.array([row[key] for row in rows])
        for key in rows[0]
    }  # fmt: skip
