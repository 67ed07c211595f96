"""Reading a dataset: samples by number, columns as arrays, and a sheet of samples as a page."""

from __future__ import annotations

import bisect
import io
import json
import operator
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Ints, Picture, Pixels, Points, nice
from twin.errors import InputError, did_you_mean
from twin.files import LARGEST_PX, picture_of_png, write_whole
from twin.parts.camera import Camera
from twin.show import html_page
from twin.show.html_page import small_picture, two_columns
from twin.study.dataset.plan import TEST_EACH, Places
from twin.theory.optics import project

if TYPE_CHECKING:
    import pyarrow as pa

_SHAPES = {"vectors": 3, "pixels": 2}

_SPLITS = ("train", "test", "all")


class DatasetReader:
    """A dataset on disk; ``len()`` rows, each a dictionary of numpy arrays, texts and numbers.

    It is a map-style dataset in the sense of torch (``__len__``, ``__getitem__``), can be sent to
    other processes, and keeps no file open.

    Parameters
    ----------
    folder
        Of the dataset, finished or not: what is there is read.
    columns
        Those of the samples that are wanted; all if not given.
    split
        See `open_dataset`.
    decode
        Whether pictures come as arrays; else as the PNG files' bytes.

    Raises
    ------
    InputError
        It is no dataset, or has no such column or part.
    """

    def __init__(
        self,
        folder: Path | str,
        columns: Sequence[str] | None = None,
        *,
        split: str | None = None,
        decode: bool = True,
    ) -> None:
        import pyarrow.parquet as pq

        self._decode = decode
        self.places = Places(Path(folder))
        self.info: dict[str, Any] = self.places.read_info()
        self._kinds = {c["name"]: c["kind"] for c in self.info["columns"]}
        self._sensor_kinds = {c["name"]: c["kind"] for c in self.info["sensor_columns"]}
        self.columns = tuple(columns) if columns is not None else tuple(self._kinds)
        self._known(self.columns)
        self._files = sorted(self.places.data.glob("part-*.parquet"))
        with self.readable(self.places.data):
            counts = [pq.read_metadata(file).num_rows for file in self._files]
        self._starts = [int(start) for start in np.concatenate([[0], np.cumsum(counts)])]
        self._group: tuple[tuple[int, int], Any] | None = None
        self._sensors: dict[int, dict[str, Any]] | None = None
        self._base_z_mm: float | None = None
        self._rows: Ints = np.arange(self._starts[-1])
        if split is not None:
            self._rows = self._rows_of(split)

    def __repr__(self) -> str:
        names = ", ".join(self.columns[:5])
        more = f" and {len(self.columns) - 5} more in .columns" if len(self.columns) > 5 else ""
        return f"DatasetReader({self.places.folder}, {len(self)} rows of {names}{more})"

    @staticmethod
    @contextmanager
    def readable(path: Path) -> Iterator[None]:
        """Say of a file that it can't be read, whatever the libraries that read it say of a damaged
        one."""
        import pyarrow as pa

        try:
            yield
        except (
            pa.ArrowException,
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            SyntaxError,
        ) as problem:
            text = str(problem).splitlines()[0][:200] if str(problem) else type(problem).__name__
            raise InputError(
                f"{path}: can't be read ({text}); copy it again, or remove it and make it again"
            ) from None

    @staticmethod
    def decoded(data: bytes) -> Picture:
        """Return the (height, width, 3) picture in PNG bytes.

        Raises
        ------
        ValueError
            They are none, or larger than any picture of this program.
        """
        from PIL import Image

        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            if image.width * image.height > LARGEST_PX:
                raise ValueError(f"{image.width}x{image.height} px are more than {LARGEST_PX:,}")
            deep = picture_of_png(data)
            return np.array(image) if deep is None else deep

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, row: int) -> dict[str, Any]:
        row = operator.index(row)  # a TypeError, as for a list
        number = row + len(self) if row < 0 else row
        if not 0 <= number < len(self):
            raise IndexError(f"row {row}: the dataset has {len(self)}")
        number = int(self._rows[number])
        file = bisect.bisect_right(self._starts, number) - 1
        with self.readable(self._files[file]):
            table, first = self._rows_near(file, number - self._starts[file])
            place = number - self._starts[file] - first
            return {
                name: _value(table[name][place], self._kinds[name], self._decode)
                for name in self.columns
            }

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[row] for row in range(len(self)))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_group": None}

    def column(self, name: str, *, only_ok: bool = True) -> Any:
        """Return a column of all rows: an array where all rows are as long, else a list of arrays.

        ``only_ok`` leaves out the rows of samples that failed.
        """
        self._known([name])
        table = self.table([name, "status"])
        status = table["status"].to_pylist()
        values = [
            _value(value, self._kinds[name])
            for value, how in zip(table[name], status, strict=True)
            if how == "ok" or not only_ok
        ]
        whole = all(v is not None for v in values) and len({np.shape(v) for v in values}) == 1
        return np.array(values) if whole else values

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return columns as an Arrow table, pictures as PNG bytes."""
        import pyarrow.parquet as pq

        wanted = list(dict.fromkeys(columns if columns is not None else self.columns))
        self._known(wanted)
        with self.readable(self.places.data):
            table = pq.read_table([str(file) for file in self._files], columns=wanted)
        return table if len(self) == len(table) else table.take(self._rows)

    def _rows_of(self, split: str) -> Ints:
        """Return the rows of a part's samples that did not fail."""
        if split not in _SPLITS:
            raise InputError(f"split = '{split}': must be one of {', '.join(_SPLITS)}")
        in_sequences = "split" in self._kinds
        table = self.table(["status", "split" if in_sequences else "sensor"])
        good = np.array(table["status"].to_pylist()) == "ok"
        if split == "all":
            return np.flatnonzero(good)
        if in_sequences:
            part = np.array(table["split"].to_pylist())
        else:
            part = np.where(table["sensor"].to_numpy() % TEST_EACH == 1, "test", "train")
        rows = np.flatnonzero(good & (part == split))
        if not len(rows):
            raise InputError(
                f"{self.places.folder}: has no sample to {split}: it takes five sequences, or two "
                "made sensors (-s dataset.samples_per_sensor=20 makes one for 20 samples)"
            )
        return rows

    def _known(self, names: Sequence[str]) -> None:
        """Refuse columns that the samples don't have, each with the nearest that they have."""
        every = f"known are {', '.join(self._kinds)}"
        text = [
            f"no column {name}; {did_you_mean(name, self._kinds, every)}"
            for name in names
            if name not in self._kinds
        ]
        if text:
            raise InputError(f"{self.places.folder}: {', '.join(text)}")

    def sensor(self, number: int) -> dict[str, Any]:
        """Return a row of the sensors table: rest picture, rest places, camera, what was drawn."""
        rows = self._sensor_rows()
        if number not in rows:
            raise IndexError(f"sensor {number}: known are {sorted(rows)}")
        return rows[number]

    def project(self, points_mm: Points, sensor: int) -> Pixels:
        """Return the (n, 2) pixels of (n, 3) points, mm, in a sensor's own camera."""
        from twin.study.recipe import load_scene

        if self._base_z_mm is None:
            self._base_z_mm = load_scene(self.places.meta / "scene.toml").body.base_z_mm
        actual = json.loads(self.sensor(sensor)["actual"])
        camera = Camera.model_validate(actual["camera"])
        index = actual["material"]["refractive_index"]
        return project(points_mm, camera, index, self._base_z_mm)

    @property
    def sensor_numbers(self) -> list[int]:
        """The numbers of the sensors that are there."""
        return sorted(self._sensor_rows())

    def _sensor_rows(self) -> dict[int, dict[str, Any]]:
        if self._sensors is None:
            import pyarrow.parquet as pq

            rows = {}
            for file in sorted(self.places.sensors.glob("part-*.parquet")):
                with self.readable(file):
                    table = pq.read_table(file)
                    for place, found in enumerate(table["sensor"].to_pylist()):
                        row = {
                            name: _value(table[name][place], kind)
                            for name, kind in self._sensor_kinds.items()
                        }
                        rows[found] = row
            self._sensors = rows
        return self._sensors

    def _rows_near(self, file: int, row: int) -> tuple[Any, int]:
        """Return the row group that holds a row, and the number of its first row."""
        import pyarrow.parquet as pq

        opened = pq.ParquetFile(self._files[file])
        with opened:
            first, group = 0, 0
            while row >= first + (size := opened.metadata.row_group(group).num_rows):
                first = first + size
                group = group + 1
            if self._group is None or self._group[0] != (file, group):
                self._group = (
                    (file, group),
                    opened.read_row_group(group, columns=list(self.columns)),
                )
        return self._group[1], first

    def write_sheet(self, page: Path) -> str:
        """Write the contact sheet and return a line about it.

        Raises
        ------
        InputError
            It holds no samples yet, or no pixels to draw.
        """
        if len(self) == 0:
            raise InputError(f"{self.places.folder}: holds no samples yet")
        if "marker_pressed_px" not in self.columns:
            raise InputError(f"{self.places.folder}: the sheet needs the column marker_pressed_px")
        rows = np.unique(np.linspace(0, len(self) - 1, min(SHOWN, len(self))).astype(int))
        samples = [self[int(row)] for row in rows]
        gain = _gain(self, samples)
        figures = two_columns([_figure(self, sample, gain) for sample in samples])
        facts = [f"{len(self)} rows, {len(rows)} shown", f"columns: {', '.join(self.columns)}"]
        items = "".join(f"<li>{escape(fact)}</li>" for fact in facts)
        note = (
            f"Lines: shift of each marker, {gain:g} times as long as it is. Yellow: where the body "
            "is touched."
        )
        sections = [("The set", f"<ul>{items}</ul>"), ("Samples", figures)]
        text = html_page.page(self.info["title"] or "Dataset", note, [], sections)
        write_whole(page, text.encode())
        return f"{page}: {len(rows)} of {len(self)} samples"


def open_dataset(
    folder: Path | str, columns: Sequence[str] | None = None, *, split: str | None = None
) -> DatasetReader:
    """Open a dataset made by ``twin dataset``.

    Parameters
    ----------
    folder
        Where it is.
    columns
        Those that are wanted; all if not given. What is not wanted is not read.
    split
        ``"train"``, ``"test"``, or ``"all"`` for both, without the samples that failed. Of samples
        that are sequences, every fifth is for tests, whole; else every fifth made sensor, from the
        second on, as samples of one sensor share its errors. Every row if not given.

    Returns
    -------
    DatasetReader
        ``len(d)``, ``d[7]["force_n"]``, ``d.column("force_n")``, ``d.sensor(0)["picture"]``.

    Examples
    --------
    After ``twin dataset dataset_kamiyama --samples 10 --out data/flat``:

    >>> import twin
    >>> data = twin.open_dataset("data/flat", ["force_n"])  # doctest: +SKIP
    >>> len(data), data[0]["force_n"]  # doctest: +SKIP
    >>> train = twin.open_dataset("data/flat", split="train")  # doctest: +SKIP
    """
    return DatasetReader(folder, columns, split=split)


def _value(scalar: Any, kind: str, decode: bool = True) -> Any:
    if not scalar.is_valid:
        return None
    if kind == "png":
        return DatasetReader.decoded(scalar.as_py()) if decode else scalar.as_py()
    if kind in _SHAPES:
        flat = scalar.values.flatten().to_numpy(zero_copy_only=False, writable=True)
        return flat.reshape(-1, _SHAPES[kind])
    if kind in ("numbers", "flags"):
        return scalar.values.to_numpy(zero_copy_only=False, writable=True)
    return scalar.as_py()


SHOWN = 24
"""Samples on the sheet at most."""

_LONGEST = 0.05
"""Length of a drawn shift over the picture's width, of the sample with the median largest one."""


def _gain(reader: DatasetReader, samples: Sequence[dict[str, Any]]) -> float:
    """Return how many times as long as they are the samples' shifts are drawn."""
    largest = []
    for sample in samples:
        if sample["status"] == "ok":
            rest = reader.sensor(sample["sensor"])["marker_rest_px"]
            shift = _finite(sample["marker_pressed_px"] - rest)
            largest.append(np.hypot(*shift.T).max(initial=0.0))
    usual = float(np.median(largest)) if largest else 0.0
    return nice(_LONGEST * reader.info["camera"]["width_px"] / usual) if usual > 0 else 1.0


def _figure(reader: DatasetReader, sample: dict[str, Any], gain: float) -> str:
    """Return a sample as a figure of the sheet: its picture and markers, or why it failed."""
    if sample["status"] != "ok":
        alarm = f'<p class="alarm">{escape(sample["error"])}</p>'
        return html_page.figure(alarm, f"sample {sample['index']}: failed")
    camera = reader.info["camera"]
    rest = reader.sensor(sample["sensor"])["marker_rest_px"]
    size = f'width="{camera["width_px"]}" height="{camera["height_px"]}"'
    parts = []
    if sample.get("picture") is not None:
        parts.append(f'<image href="{small_picture(sample["picture"])}" {size}/>')
    if sample.get("surface_mm") is not None:
        parts += [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="#fd0" opacity=".55"/>'
            for x, y in _finite(reader.project(sample["surface_mm"], sample["sensor"]))
        ]
    steps = "".join(
        f"M{a:.1f} {b:.1f}L{a + gain * (c - a):.1f} {b + gain * (d - b):.1f}"
        for a, b, c, d in _finite(np.column_stack([rest, sample["marker_pressed_px"]]))
    )
    parts.append(f'<path d="{steps}" stroke="#4f8" stroke-width="1.6"/>')
    box = f'viewBox="-0.5 -0.5 {camera["width_px"]} {camera["height_px"]}"'
    svg = f'<svg style="background:#111" {box}>{"".join(parts)}</svg>'
    return html_page.figure(svg, escape(_title(sample)))


def _finite(rows: Floats) -> Floats:
    return rows[np.isfinite(rows).all(axis=1)]


def _title(sample: dict[str, Any]) -> str:
    press = json.loads(sample["press"])
    if isinstance(press, list):
        words = ", ".join(each["kind"] for each in press)
    else:
        probe = press["probe"]
        size = probe.get("diameter_mm", probe.get("width_mm"))
        words = probe["kind"] + (f" {size:.3g} mm" if size else "")
        words += " at ({:.2g}, {:.2g}) mm".format(*press["at_mm"])
    if sample.get("force_n") is not None:
        words += ", force ({:.2g}, {:.2g}, {:.2g}) N".format(*sample["force_n"])
    return f"sample {sample['index']}: {words}"
