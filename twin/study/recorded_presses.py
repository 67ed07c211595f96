"""Calibrate a real sensor from a folder: rest.png, pictures of presses, and presses.csv with places and forces.

presses.csv has a row a press: frame (the picture's file name), x_mm, y_mm, z_mm (the place on the outer surface that
the probe is pressed on; z_mm may be empty: then the surface met from above), fx_n, fy_n, fz_n (the load cell).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import InputError, RecipeError
from twin.parts.scene import Scene
from twin.results import make_folder
from twin.study.calibrate import BY_PRESSES, calibrate_by_design, fitted_calibration, measured_calibration
from twin.study.calibration_presses import FOOTPRINT, hertz_radius
from twin.study.frames import read_picture
from twin.study.sensor import Sensor
from twin.study.sites import on_surface

TABLE = "presses.csv"
PLACES = ("x_mm", "y_mm", "z_mm")
FORCES = ("fx_n", "fy_n", "fz_n")
LARGEST = 1e6
"""Of a place, mm, and of a force, N."""

SAME_PLACE_MM = 0.01
OFF_GRID = 0.25
"""Share of the pitch by which a press may miss its place of the grid (method sato)."""

SMALLEST_SHARE = 0.5
"""Share of the markers that the rest picture must show."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """The folder's presses: (q,) file names, (q, 3) places in mm (z NaN where left out) and forces in N."""

    frames: tuple[str, ...]
    place_mm: Points
    force_n: Floats


def read_presses(folder: Path) -> Table:
    """Read presses.csv.

    Raises
    ------
    InputError
        It is absent, empty, lacks a column, or holds what is no number: with the line.
    """
    path = folder / TABLE
    if not path.is_file():
        raise InputError(f"{path}: there is none; it has the columns frame, {', '.join((*PLACES, *FORCES))}")
    names, numbers = [], []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            lacking = [name for name in ("frame", *PLACES, *FORCES) if name not in (reader.fieldnames or ())]
            if lacking:
                raise InputError(f"{path}: lacks the columns {', '.join(lacking)}")
            for row in reader:
                names.append((row["frame"] or "").strip())
                numbers.append([_number(path, reader.line_num, key, row[key]) for key in (*PLACES, *FORCES)])
                if not names[-1]:
                    raise InputError(f"{path}, line {reader.line_num}: frame is empty; give the picture's file name")
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise InputError(f"{path}: can't be read ({problem})") from None
    if not names:
        raise InputError(f"{path}: holds no presses")
    table = np.array(numbers)
    return Table(frames=tuple(names), place_mm=table[:, :3], force_n=table[:, 3:])


def _number(path: Path, line: int, key: str, text: str | None) -> float:
    if key == "z_mm" and not (text or "").strip():
        return float("nan")
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not abs(value) <= LARGEST:
        unit = key.rsplit("_", 1)[1].replace("n", "N")
        raise InputError(
            f"{path}, line {line}: {key} = {text!r} must be a finite number, {unit}, from {-LARGEST:g} to {LARGEST:g}"
        )
    return value


def calibrate_from_folder(scene: Scene, folder: Path, out: Path, progress: Any = None) -> str:
    """Calibrate the sensor in the pictures by the scene's method, write the file and return a line about it.

    Raises
    ------
    InputError
        Files that can't be used; fewer than half of the design's markers at rest.
    """
    from twin.sense.calibration import write_calibration
    from twin.sense.fit_design import Presses
    from twin.sense.track import Tracker

    if scene.reconstruction is None or scene.camera is None:
        raise RecipeError("calibrating needs [camera], and [reconstruction] with sites")
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a calibration file ends in .npz")
    method = scene.calibration.method
    sensor = Sensor(scene, progress)
    tracker = Tracker(read_picture(folder / "rest.png"), sensor.layout_px, method=scene.tracking.method)
    rest_px = tracker.rest.rest_px
    known = np.asarray(np.isfinite(rest_px).all(axis=1))
    if known.mean() < SMALLEST_SHARE:
        raise InputError(
            f"{folder / 'rest.png'}: shows {int(known.sum())} of the design's {len(known)} markers; is it this scene's "
            "sensor, upright and of its camera's size?"
        )
    table = read_presses(folder) if method in BY_PRESSES else None
    if table is None:
        made = calibrate_by_design(sensor)
    else:
        shifts, spread = [], []
        for number, name in enumerate(table.frames):
            tracker.forget()
            found = tracker.track(read_picture(folder / name))
            shifts.append(found.shift_px)
            spread.append(found.sd_px)
            if progress is not None:
                progress(f"tracking, press {number + 1} of {len(table.frames)}", 0.3 * (number + 1) / len(table.frames))
        presses = Presses(
            place=np.zeros(len(shifts), np.int64), force_n=table.force_n, shift_px=np.stack(shifts), rest_px=rest_px,
            load_cell_n=scene.calibration.load_cell_n, noise_px=float(np.nanmedian(np.concatenate(spread))),
        )  # fmt: skip
        made = _by_presses(sensor, _charts(sensor, table), presses)
    if method != "fitted":
        made = replace(made, layout_px=np.where(known[:, None], rest_px, made.layout_px))
    make_folder(out.parent)
    write_calibration(made, out)
    if progress is not None:
        progress("done", 1.0)
    count = f", {len(table.frames)} presses" if table else ""
    return f"{out}: {method}, {len(made.site_mm)} sites, {int(known.sum())} of {len(known)} markers{count}"


def _charts(sensor: Sensor, table: Table) -> Floats:
    """Return the (q, 2) surface coordinates of the presses, mm."""
    body = sensor.nominal.body
    points = body.surface_from_above(table.place_mm[:, :2])
    given = np.isfinite(table.place_mm[:, 2])
    points = np.where(given[:, None], table.place_mm, points)
    if not np.isfinite(points).all():
        raise InputError(f"{TABLE}: some presses lie beside the body")
    return np.asarray(body.chart_of(points))


def _by_presses(sensor: Sensor, charts: Floats, presses: Any) -> Any:
    scene = sensor.nominal
    assert scene.reconstruction is not None
    half_mm = FOOTPRINT * hertz_radius(scene, scene.calibration.press_force_n)
    if scene.calibration.method == "fitted":
        rounded = np.rint(charts / SAME_PLACE_MM).astype(np.int64)
        _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        places = on_surface(scene.body, charts[first], half_mm, TABLE)
        return fitted_calibration(sensor, places, replace(presses, place=which.ravel().astype(np.int64)))
    grid = scene.calibration.presses or scene.reconstruction.sites
    wanted = grid.chart()
    distance = np.linalg.norm(charts[:, None] - wanted[None], axis=2)
    nearest = distance.argmin(axis=1)
    if (far := distance.min(axis=1)).max() > OFF_GRID * grid.pitch_mm:
        raise InputError(
            f"{TABLE}: press {int(far.argmax()) + 1} is {far.max():.2f} mm from the nearest place of the scene's grid "
            f"of presses (up to {OFF_GRID * grid.pitch_mm:.2f} mm): mend [calibration.presses] or use --method fitted"
        )
    counts = np.bincount(nearest, minlength=len(wanted))
    if (counts != 3).any():
        bad = int(np.flatnonzero(counts != 3)[0])
        raise InputError(
            f"{TABLE}: the place at {wanted[bad].tolist()} mm has {counts[bad]} presses; method sato needs 3 at each "
            f"of the grid's {len(wanted)} places (along z, x and y). Fewer or others: --method fitted"
        )
    order = np.argsort(nearest, kind="stable")
    ordered = replace(presses, place=nearest[order], force_n=presses.force_n[order], shift_px=presses.shift_px[order])
    return measured_calibration(sensor, on_surface(scene.body, wanted, half_mm, TABLE), grid, ordered)
