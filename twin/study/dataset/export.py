"""Datasets in other programs' formats: README card, Croissant, HDF5, COCO keypoints, WebDataset.

Samples that failed are left out; every exporter writes under a temporary name first.
"""

from __future__ import annotations

import hashlib
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
from twin.files import make_folder, write_json, write_whole
from twin.parts.material import Material
from twin.parts.shape import StlFile
from twin.study.dataset.audit import FIGURES
from twin.study.dataset.columns import Column
from twin.study.dataset.plan import Places, Plan
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
        An unknown format, or a dataset without what it needs.
    MissingCapability
        A package that the format needs is not installed.
    """
    if form not in FORMATS:
        raise InputError(
            f"--format {form}: must be one of {', '.join(FORMATS)}, or mitsuba for a scene"
        )
    reader = DatasetReader(folder, decode=form == "hdf5")
    make_folder(out)
    write = {"hdf5": _hdf5, "coco": _coco, "webdataset": _webdataset}[form]
    return write(reader, out, progress)


def _samples(reader: DatasetReader, progress: Progress | None) -> Iterator[tuple[int, Any]]:
    """Yield the samples that did not fail, counted from 0."""
    number = 0
    for row in range(len(reader)):
        sample = reader[row]
        if progress is not None:
            progress(f"{row}/{len(reader)} rows", row / len(reader))
        if sample["status"] == "ok":
            yield number, sample
            number += 1
    if progress is not None:
        progress("done", 1.0)


def _hdf5(reader: DatasetReader, out: Path, progress: Progress | None) -> list[Path]:
    try:
        import h5py
    except ImportError:
        raise MissingCapability("HDF5 needs h5py: pip install h5py") from None
    status = reader.table(["status"])["status"].to_pylist()
    count = status.count("ok")
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
                        sets[name] = _room(file, name, value, count)
                    _put(sets[name], number, value)
            rests = [reader.sensor(n) for n in reader.sensor_numbers]
            if rests and rests[0].get("picture") is not None:
                file["tactile/rest"] = np.stack([row["picture"] for row in rests])
        os.replace(part, path)
    except OSError as problem:
        raise TwinError(f"{path}: can't be written ({problem})") from None
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


_LICENCE = "https://creativecommons.org/publicdomain/zero/1.0/"


def write_card(plan: Plan, places: Places, audit: dict[str, Any], failed: int) -> None:
    """Write the dataset's card (README.md) and its Croissant metadata."""
    write_whole(places.folder / "README.md", _card_text(plan, places, audit, failed).encode())
    write_json(places.folder / "croissant.json", _croissant(plan))


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
    return f"""---
license: cc0-1.0
tags: [tactile, simulation, physics, robotics]
configs:
- config_name: samples
  data_files: data/*.parquet
  default: true
- config_name: sensors
  data_files: sensors/*.parquet
---
# {scene.title or "Presses on a tactile sensor"}

{plan.samples} presses on {sensors} made sensor{"s" if sensors > 1 else ""} of one design,
simulated with `twin`; {failed} of them failed and are rows with their error. Lengths in mm, forces
in N, z into the body; x is right and y is up in the picture, whose pixel (0, 0) is the centre of
the top left one.

```python
import datasets, pyarrow.parquet, twin

samples = datasets.load_dataset("parquet", data_files="data/*.parquet", split="train")
samples = samples.cast_column("picture", datasets.Image())  # if it has pictures
samples = pyarrow.parquet.read_table("data")
sample = twin.open_dataset(".")[0]
```

`meta/` has the scene (`scene.toml`), the meshes, `info.json` with schema, units and versions, and
`SHA256SUMS`. The same command makes the same bytes.

## What varies

{varies or "Nothing: every sample is the same press."}
Sampling is {scene.dataset.sampling}, seed {scene.seed}; a new sensor is made every
{scene.dataset.samples_per_sensor} samples.

## How far off the truth is

{again} computed again at the highest accuracy (twice the contact patches and steps, no patches
gathered, the body's finest mesh, 12 x 12 rays per pixel). Differences:

| quantity | median | largest |
| --- | --- | --- |
{figures}
Projection is closed form, good to 1e-6 px. The error of the finest mesh or table stands in
`docs/elasticity.md` (0.02 % on the standard block, 0.09 % on the finger), that of linear theory
in the column `linearisation_error`. {_model(scene.material)}

## Columns

| column | unit | what |
| --- | --- | --- |
{_rows(plan.row_columns)}
Of the sensors:

| column | unit | what |
| --- | --- | --- |
{_rows(plan.sensor_columns)}
## Made with

{versions}{"; renderer " + info["renderer"] if info["renderer"] else ""}.
"""


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
    """Return the dataset's Croissant 1.0 metadata (MLCommons), as JSON-LD.

    Its files are named from the folder of the metadata, which is the dataset's: readers look for a
    file set that is contained in nothing else there.
    """
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
            _record_set("samples", plan.row_columns),
            _record_set("sensors", plan.sensor_columns),
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


def _record_set(name: str, columns: tuple[Column, ...]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "field": [
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
        ],
    }


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
