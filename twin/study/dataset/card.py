"""What a dataset says of itself: a card for people, and Croissant metadata for machines."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from twin.study.dataset.audit import FIGURES
from twin.study.dataset.columns import ALWAYS, Column
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.portable import bare
from twin.study.dataset.prepare import described, read_info

LICENCE = "https://creativecommons.org/publicdomain/zero/1.0/"


def card_text(plan: Plan, places: Places, audit: dict[str, Any], failed: int) -> str:
    """Return the card: Markdown under the header that dataset hubs read."""
    scene, told = plan.scene, read_info(places)
    sensors = plan.sensor_of(plan.samples - 1) + 1
    varies = "".join(f"* `{key}`: {_in_words(axis)}\n" for key, axis in sorted(scene.vary.items()))
    figures = "".join(
        f"| {what} | {audit[name]['median']:.2g} | {audit[name]['largest']:.2g} |\n"
        for name, what in FIGURES.items()
        if name in audit
    )
    versions = ", ".join(f"{name} {version}" for name, version in told["versions"].items())
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

{plan.samples} presses on {sensors} made sensor{"s" if sensors > 1 else ""} of one design, simulated with `twin`;
{failed} of them failed and are rows with their error. Lengths in mm, forces in N, z into the body; x is right and y is
up in the picture, whose pixel (0, 0) is the centre of the top left one.

```python
import datasets, pyarrow.parquet, twin

samples = datasets.load_dataset("parquet", data_files="data/*.parquet", split="train")
samples = samples.cast_column("picture", datasets.Image())  # if it has pictures
samples = pyarrow.parquet.read_table("data")
sample = twin.open_dataset(".")[0]
```

`meta/` has the scene (`scene.toml`), the meshes, `info.json` with schema, units and versions, and `SHA256SUMS`. The
same command makes the same bytes.

## What varies

{varies or "Nothing: every sample is the same press."}
Sampling is {scene.dataset.sampling}, seed {scene.seed}; a new sensor is made every {scene.dataset.samples_per_sensor}
samples.

## How far off the truth is

{again} computed again at the highest accuracy (twice the contact patches and steps, no patches
gathered, the body's finest mesh, 12 x 12 rays per pixel). Differences:

| quantity | median | largest |
| --- | --- | --- |
{figures}
Projection is closed form, good to 1e-6 px. What the finest mesh or table itself is off is in the program's
`docs/elasticity.md` (0.02 % on the standard block, 0.09 % on the finger), what linear theory costs in the column
`linearisation_error`. The model is quasi-static and linear: no rate, creep, hysteresis or large strain.

## Columns

| column | unit | what |
| --- | --- | --- |
{_rows((*ALWAYS, *plan.drawn_columns, *plan.columns))}
Of the sensors:

| column | unit | what |
| --- | --- | --- |
{_rows(plan.sensor_columns)}
## Made with

{versions}{"; renderer " + told["renderer"] if told["renderer"] else ""}.
"""


def _rows(columns: tuple[Column, ...]) -> str:
    told = (described(column) for column in columns)
    return "".join(f"| `{c['name']}` | {c['unit']} | {c['what']} |\n" for c in told)


def _in_words(axis: Any) -> str:
    plain = bare(axis.model_dump(mode="json", exclude={"source", "assumed"}, exclude_defaults=True))
    return ", ".join(f"{key} {json.dumps(value)}" for key, value in plain.items())


def croissant(plan: Plan) -> dict[str, Any]:
    """Return the dataset's Croissant 1.0 metadata (MLCommons), as JSON-LD.

    Its files are named from the folder of the metadata, which is the dataset's: readers look for a file set that is
    contained in nothing else there.
    """
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": _name(plan.scene.title) or "twin-dataset",
        "description": f"{plan.samples} simulated presses on a camera-based tactile sensor, with their truth.",
        "license": LICENCE,
        "url": "https://example.org/not-published",
        "version": "1.0.0",
        "datePublished": "2026-01-01",
        "citeAs": "see CITATION.cff of tactile-twin",
        "distribution": [_files("samples", "data"), _files("sensors", "sensors")],
        "recordSet": [
            _record_set("samples", (*ALWAYS, *plan.drawn_columns, *plan.columns)),
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
                **({"repeated": True} if column.kind in ("numbers", "flags", "vectors", "pixels") else {}),
                "source": {"fileSet": {"@id": f"{name}-files"}, "extract": {"column": column.name}},
            }
            for column in columns
        ],
    }


_TYPES = {
    "integer": "sc:Integer", "number": "sc:Float", "text": "sc:Text", "flag": "sc:Boolean", "png": "sc:ImageObject",
    "numbers": "sc:Float", "flags": "sc:Boolean", "vectors": "sc:Float", "pixels": "sc:Float",
}  # fmt: skip

_CONTEXT = {
    "@language": "en", "@vocab": "https://schema.org/", "sc": "https://schema.org/", "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/", "dct": "http://purl.org/dc/terms/", "citeAs": "cr:citeAs",
    "column": "cr:column", "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn",
    "data": {"@id": "cr:data", "@type": "@json"}, "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "equivalentProperty": "cr:equivalentProperty", "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract", "field": "cr:field", "fileProperty": "cr:fileProperty", "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet", "format": "cr:format", "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5", "parentField": "cr:parentField", "path": "cr:path",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "separator": "cr:separator", "source": "cr:source",
    "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip


def _name(title: str) -> str:
    kept = "".join(c if c.isalnum() else "-" for c in title.lower())
    short = "-".join(part for part in kept.split("-") if part)[:60]
    return f"{short}-{hashlib.sha256(title.encode()).hexdigest()[:6]}" if short else ""
