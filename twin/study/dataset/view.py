"""What `twin view` shows of a dataset: some of its samples, with the truth drawn in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Pixels
from twin.errors import InputError
from twin.parts.camera import Camera
from twin.results import write_whole
from twin.show.sheet import Card, sheet
from twin.study.dataset.reader import DatasetReader
from twin.theory.optics import project

SHOWN = 24


def view_dataset(folder: Path, page: Path) -> str:
    """Write the contact sheet of a dataset and return a line that says where it is.

    Raises
    ------
    InputError
        It is no dataset, or holds no samples yet, or no pixels to draw.
    """
    reader = DatasetReader(folder, decode=False)
    if len(reader) == 0:
        raise InputError(f"{folder}: holds no samples yet")
    if "marker_pressed_px" not in reader.columns:
        raise InputError(f"{folder}: the sheet needs the column marker_pressed_px")
    rows = np.unique(np.linspace(0, len(reader) - 1, min(SHOWN, len(reader))).astype(int))
    cards = [_card(reader, reader[int(row)]) for row in rows]
    title = reader.info["title"] or "Dataset"
    facts = [f"{len(reader)} rows, {len(cards)} shown", f"columns: {', '.join(reader.columns)}"]
    text = sheet(title, facts, cards)
    write_whole(page, lambda file: file.write(text.encode()))
    return f"{page}: {len(cards)} of {len(reader)} samples"


def _card(reader: DatasetReader, sample: dict[str, Any]) -> Card:
    camera = reader.info["camera"]
    size = camera["width_px"], camera["height_px"]
    nothing = np.zeros((0, 2))
    if sample["status"] != "ok":
        return Card(
            title=f"sample {sample['index']}: failed", png=None, size_px=size, rest_px=nothing, pressed_px=nothing,
            contact_px=nothing, error=sample["error"],
        )  # fmt: skip
    sensor = reader.sensor(sample["sensor"])
    return Card(
        title=_title(sample), png=sample.get("picture"), size_px=size, rest_px=sensor["marker_rest_px"],
        pressed_px=sample["marker_pressed_px"], contact_px=_contact(sample, sensor, reader),
    )  # fmt: skip


def _title(sample: dict[str, Any]) -> str:
    press = json.loads(sample["press"])
    if isinstance(press, list):
        words = f"sample {sample['index']}: {', '.join(each['kind'] for each in press)}"
        return words + (", force ({:.2g}, {:.2g}, {:.2g}) N".format(*sample["force_n"]) if "force_n" in sample else "")
    probe = press["probe"]
    size = probe.get("diameter_mm", probe.get("width_mm"))
    words = f"sample {sample['index']}: {probe['kind']}" + (f" {size:.3g} mm" if size else "")
    if sample.get("force_n") is not None:
        words += " at ({:.2g}, {:.2g}) mm, force ({:.2g}, {:.2g}, {:.2g}) N".format(*press["at_mm"], *sample["force_n"])
    return words


def _contact(sample: dict[str, Any], sensor: dict[str, Any], reader: DatasetReader) -> Pixels:
    if sample.get("surface_mm") is None:
        return np.zeros((0, 2))
    from twin.study.recipe import load_scene

    actual = json.loads(sensor["actual"])
    base = load_scene(reader.places.meta / "scene.toml").body.base_z_mm
    camera = Camera.model_validate(actual["camera"])
    return project(sample["surface_mm"], camera, actual["material"]["refractive_index"], base)
