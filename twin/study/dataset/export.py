"""Datasets in other programs' formats: HDF5, COCO keypoints, WebDataset.

Samples that failed are left out; every exporter writes under a temporary name first.
"""

from __future__ import annotations

import io
import json
import os
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Progress
from twin.errors import InputError, MissingCapability, TwinError
from twin.files import make_folder, write_whole
from twin.study.dataset.reader import DatasetReader

FORMATS = ("hdf5", "coco", "webdataset")
_PER_TAR = 1000


def export_dataset(
    folder: Path, form: str, out: Path, progress: Progress | None = None
) -> list[Path]:
    """Write a dataset in another format into the folder ``out`` and return the files.

    Parameters
    ----------
    form
        ``hdf5``: one file with ``tactile/rgb``, ``tactile/rest``, ``tactile/marker`` (rest and
        pressed pixels), ``tactile/marker_displacement``, ``wrench`` and the other columns under
        ``truth``, in the way of visuo-tactile simulators; ``coco``: ``images/`` and
        ``keypoints.json`` with every marker as a keypoint; ``webdataset``: tar files of
        ``NNNNNNNN.png``, ``.json`` and ``.npz``.

    Raises
    ------
    InputError
        An unknown format, a dataset without what it needs, or ``out`` lies in it.
    MissingCapability
        A package that the format needs is not installed.
    """
    if form not in FORMATS:
        raise InputError(
            f"--format {form}: must be one of {', '.join(FORMATS)}, or mitsuba for a scene"
        )
    reader = DatasetReader(folder, split="all", decode=form == "hdf5")
    if folder.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(
            f"--out {out}: lies in the dataset, whose files are all checked; name another"
        )
    make_folder(out)
    write = {"hdf5": _hdf5, "coco": _coco, "webdataset": _webdataset}[form]
    return write(reader, out, progress)


def _samples(reader: DatasetReader, progress: Progress | None) -> Iterator[tuple[int, Any]]:
    """Yield the samples, counted from 0."""
    for number, sample in enumerate(reader):
        if progress is not None:
            progress(f"{number}/{len(reader)} rows", number / len(reader))
        yield number, sample
    if progress is not None:
        progress("done", 1.0)


def _hdf5(reader: DatasetReader, out: Path, progress: Progress | None) -> list[Path]:
    try:
        import h5py
    except ImportError:
        raise MissingCapability("HDF5 needs h5py: pip install h5py") from None
    path = out / "dataset.hdf5"
    part = out / f".dataset.hdf5.{os.getpid()}.part"
    names = {"picture": "tactile/rgb", "marker_displacement_mm": "tactile/marker_displacement"}
    try:
        with h5py.File(part, "w") as file:
            file.attrs["info"] = json.dumps(reader.info)
            sets: dict[str, Any] = {}
            for number, sample in _samples(reader, progress):
                values = {names.get(k, f"truth/{k}"): v for k, v in sample.items()}
                if {"force_n", "torque_nmm"} <= sample.keys():
                    values["wrench"] = np.concatenate([sample["force_n"], sample["torque_nmm"]])
                if "marker_pressed_px" in sample:
                    rest = reader.sensor(sample["sensor"])["marker_rest_px"]
                    values["tactile/marker"] = np.stack([rest, sample["marker_pressed_px"]])
                for name, value in values.items():
                    if name not in sets:
                        sets[name] = _room(file, name, value, len(reader))
                    _put(sets[name], number, value)
            rests = [reader.sensor(n) for n in reader.sensor_numbers]
            for name, first in rests[0].items() if rests else ():
                if name.startswith("picture") and first is not None:
                    rest = name.replace("picture", "tactile/rest")
                    file[rest] = np.stack([row[name] for row in rests])
        os.replace(part, path)
    except OSError as problem:
        raise TwinError.unwritable(path, problem) from None
    finally:
        part.unlink(missing_ok=True)
    return [path]


_RAGGED = ("truth/surface_mm", "truth/surface_force_n", "truth/surface_slip")


def _room(file: Any, name: str, value: Any, count: int) -> Any:
    """Make a data set for ``count`` values like this one."""
    import h5py

    if isinstance(value, str) or value is None:
        return file.create_dataset(name, (count,), h5py.string_dtype())
    array = np.asarray(value)
    if name in _RAGGED:
        return file.create_dataset(name, (count,), h5py.vlen_dtype(array.dtype))
    return file.create_dataset(name, (count, *array.shape), array.dtype)


def _put(where: Any, number: int, value: Any) -> None:
    if value is None:
        where[number] = ""
    else:
        where[number] = np.asarray(value).ravel() if where.name.lstrip("/") in _RAGGED else value


def _coco(reader: DatasetReader, out: Path, progress: Progress | None) -> list[Path]:
    """Write every picture as an image with one object: the sensor, whose keypoints are its
    markers."""
    if not {"picture", "marker_pressed_px"} <= set(reader.columns):
        raise InputError("coco: the dataset needs the columns picture and marker_pressed_px")
    make_folder(out / "images")
    images = []
    annotations = []
    files = []
    keypoints = 0
    width, height = reader.info["camera"]["width_px"], reader.info["camera"]["height_px"]
    for number, sample in _samples(reader, progress):
        name = f"{number:08d}.png"
        png = sample["picture"]
        write_whole(out / "images" / name, png)
        images.append({"id": number, "file_name": name, "width": width, "height": height})
        pixels = sample["marker_pressed_px"]
        inside = np.isfinite(pixels).all(axis=1) & (
            (pixels > -0.5) & (pixels < [width - 0.5, height - 0.5])
        ).all(axis=1)
        seen = sample["marker_visible"] >= 0.5 if "marker_visible" in sample else inside
        flag = np.where(inside, np.where(seen, 2, 1), 0)
        # COCO's (0, 0) is the corner of the first pixel
        place = np.where(inside[:, None], pixels + 0.5, 0.0)
        keypoints = len(pixels)
        annotations.append(
            {
                "id": number,
                "image_id": number,
                "category_id": 1,
                "iscrowd": 0,
                "num_keypoints": int((flag > 0).sum()),
                "keypoints": np.column_stack([place, flag]).round(4).ravel().tolist(),
                "bbox": [0, 0, width, height],
                "area": width * height,
            }
        )
        files.append(out / "images" / name)
    names = [f"marker_{i}" for i in range(keypoints)]
    category = {"id": 1, "name": "sensor", "supercategory": "tactile"}
    category |= {"keypoints": names, "skeleton": []}
    found = {"images": images, "annotations": annotations, "categories": [category]}
    write_whole(out / "keypoints.json", json.dumps(found).encode())
    return [out / "keypoints.json", *files]


def _webdataset(reader: DatasetReader, out: Path, progress: Progress | None) -> list[Path]:
    """Write tar files; a sample is the members that share a name before the first point."""
    paths: list[Path] = []
    held = io.BytesIO()
    tar: tarfile.TarFile | None = None

    def close() -> None:
        if tar is not None:
            tar.close()
            paths.append(out / f"samples-{len(paths):06d}.tar")
            write_whole(paths[-1], held.getvalue())

    for number, sample in _samples(reader, progress):
        if number % _PER_TAR == 0:
            close()
            held = io.BytesIO()
            tar = tarfile.open(fileobj=held, mode="w", format=tarfile.USTAR_FORMAT)  # noqa: SIM115
        assert tar is not None
        arrays: dict[str, Any] = {k: v for k, v in sample.items() if isinstance(v, np.ndarray)}
        plain = {k: v for k, v in sample.items() if not isinstance(v, np.ndarray | bytes)}
        packed = io.BytesIO()
        np.savez(packed, **arrays)
        members = {"json": json.dumps(plain).encode(), "npz": packed.getvalue()}
        if "picture" in sample:
            members["png"] = sample["picture"]
        for ending, data in members.items():
            entry = tarfile.TarInfo(f"{number:08d}.{ending}")
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    close()
    return paths
