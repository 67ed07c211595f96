"""The calibration: what the sensor's software knows about its sensor, and the file that holds it."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Pixels, Points, frozen
from twin.errors import InputError, TwinError
from twin.results import write_whole

VERSION = 1

UNREADABLE = (
    OSError, ValueError, EOFError, KeyError, TypeError, AttributeError, NotImplementedError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
"""What numpy raises on damaged archives."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Nominal layout, sites and transfer matrix.

    Attributes
    ----------
    layer
        (n,) layer of every marker, layers in the layout's order.
    layout_px
        (n, 2) nominal rest positions, px.
    site_mm
        (k, 3) places on the sensing surface where forces are reconstructed, mm; s (along x) outer, t (along y) inner.
    site_frames
        (k, 3, 3) frames there; rows are tangent s, tangent t and the inward normal.
    site_area_mm2
        (k,) surface area that each site stands for.
    grid
        (columns, rows) of the sites; columns * rows = k.
    transfer
        (2n, 3k) px/N. Rows: marker by marker, column then row; columns: site by site, force along global x, y, z.
        A marker whose rows hold NaN could not be calibrated and is left out of every reconstruction.
    noise_px
        Standard deviation of a shift's component where tracking states none, px.
    diameter_px
        Nominal marker width in the picture, px; NaN if not known.
    method
        Where the transfer comes from.
    provenance
        JSON text: how it was made, with a digest of the nominal scene.
    """

    layer: NDArray[np.str_]
    layout_px: Pixels
    site_mm: Points
    site_frames: Floats
    site_area_mm2: Floats
    grid: tuple[int, int]
    transfer: Floats
    noise_px: float = 0.03
    diameter_px: float = float("nan")
    method: str = "compliance"
    provenance: str = "{}"

    def __post_init__(self) -> None:
        markers, sites = len(self.layer), len(self.site_mm)
        shapes = {
            "layer": (markers,), "layout_px": (markers, 2), "site_mm": (sites, 3), "site_frames": (sites, 3, 3),
            "site_area_mm2": (sites,), "transfer": (2 * markers, 3 * sites),
        }  # fmt: skip
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), np.str_ if name == "layer" else np.float64)
            if array.shape != shape:
                raise InputError(f"calibration: {name} has shape {array.shape}, must be {shape}")
            if name not in ("layer", "transfer") and not np.isfinite(array).all():
                raise InputError(f"calibration: {name} must be finite")
            object.__setattr__(self, name, frozen(array))
        if not markers or not sites:
            raise InputError(f"calibration: needs markers and sites, got {markers} and {sites}")
        if np.isinf(self.transfer).any() or not np.isfinite(self.transfer).any():
            raise InputError("calibration: transfer must hold finite numbers (NaN only for markers not calibrated)")
        columns, rows = (int(v) for v in self.grid)
        if columns * rows != sites or columns < 1:
            raise InputError(f"calibration: grid {self.grid} does not make {sites} sites")
        object.__setattr__(self, "grid", (columns, rows))
        if not 0 < self.noise_px < 100:
            raise InputError(f"calibration: noise_px = {self.noise_px} px must lie between 0 and 100 px")
        try:
            json.loads(self.provenance)
        except ValueError as problem:
            raise InputError(f"calibration: provenance must be JSON text ({problem})") from None

    @property
    def layout(self) -> dict[str, Pixels]:
        """Nominal rest positions by layer, px: what `track` takes."""
        names = dict.fromkeys(str(name) for name in self.layer)
        return {name: np.asarray(self.layout_px[self.layer == name]) for name in names}


def write_calibration(calibration: Calibration, path: str | os.PathLike[str]) -> None:
    """Write a calibration file (npz), whole or not at all."""
    target = Path(path)
    arrays = {field.name: np.asarray(getattr(calibration, field.name)) for field in fields(Calibration)}

    def write(stream: IO[bytes]) -> None:
        np.savez_compressed(stream, allow_pickle=False, version=np.array(VERSION), **arrays)

    try:
        write_whole(target, write)
    except TwinError as problem:
        raise InputError(f"calibration file {problem}") from None


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    InputError
        There is none, it is damaged, or it was written by an incompatible version.
    """
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise InputError(f"calibration file {path} does not exist: make one with `twin calibrate`") from None
    except (
        OSError,
        ValueError,
        EOFError,
        KeyError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        NotImplementedError,
    ) as problem:
        raise InputError(f"calibration file {path} can't be read ({problem}): make it again") from None
    names = [field.name for field in fields(Calibration)]
    missing = [name for name in ["version", *names] if name not in arrays]
    if missing:
        raise InputError(f"{path} is no calibration file: it lacks {', '.join(missing)}")
    if arrays["version"].shape != () or arrays["version"] != VERSION:
        raise InputError(f"{path} has format version {arrays['version']}, this program reads {VERSION}: make it again")
    for name in ("layer", "method", "provenance"):
        if arrays[name].dtype.kind != "U":
            raise InputError(f"{path}: {name} must be text, got {arrays[name].dtype}")
    for name in set(names) - {"layer", "method", "provenance"}:
        if arrays[name].dtype.kind not in "fi":
            raise InputError(f"{path}: {name} must be numbers, got {arrays[name].dtype}")
    grid = arrays["grid"]
    scalars = ("noise_px", "diameter_px", "method", "provenance")
    if grid.shape != (2,) or any(arrays[name].shape != () for name in scalars):
        raise InputError(f"{path}: grid must be two numbers, and {', '.join(scalars)} single values")
    try:
        return Calibration(
            **{name: arrays[name] for name in names if name not in (*scalars, "grid")},
            grid=(int(grid[0]), int(grid[1])), noise_px=float(arrays["noise_px"]),
            diameter_px=float(arrays["diameter_px"]), method=str(arrays["method"]),
            provenance=str(arrays["provenance"]),
        )  # fmt: skip
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
