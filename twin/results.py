"""What a run leaves behind: frozen arrays under the names of the files, and how they are written and read.

Every file is written under a temporary name and renamed, so that after a kill or on a full disk each file is whole or
absent.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from twin.arrays import Bools, Floats, Picture, Pixels, Points
from twin.errors import InputError, TwinError


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What really happened (``truth.npz``); n markers in their one order, m surface pieces under load.

    Attributes
    ----------
    marker_rest_mm, marker_displacement_mm
        (n, 3) rest places and displacements, mm.
    marker_layer
        (n,) layer names.
    marker_rest_px, marker_pressed_px
        (n, 2) projected centres, px; empty without a camera.
    marker_outline_rest_px, marker_outline_pressed_px
        (n, 2) coverage centroids of the visible outlines, px, NaN where hidden; empty without pictures.
    marker_visible
        (n,) whether the whole outline is seen, at rest and pressed; empty without pictures.
    surface_mm, surface_force_n
        (m, 3) places and forces of the pieces of the contact, mm and N.
    total_force_n, total_torque_nmm
        (3,) resultants, N and N mm about the origin.
    """

    marker_rest_mm: Points
    marker_displacement_mm: Points
    marker_layer: np.ndarray
    marker_rest_px: Pixels
    marker_pressed_px: Pixels
    marker_outline_rest_px: Pixels
    marker_outline_pressed_px: Pixels
    marker_visible: Bools
    surface_mm: Points
    surface_force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """What the sensor's software made of the pictures (``estimate.npz``); k sites, markers in the truth's order.

    Attributes
    ----------
    marker_rest_px, marker_shift_px
        (n, 2) tracked rest places and shifts, px, NaN where not found.
    site_mm, force_n
        (k, 3) sites and forces, mm and N; empty if no forces were wanted.
    total_force_n, total_torque_nmm
        (3,) resultants of the linear solve, N and N mm about the origin; empty if no forces were wanted.
    """

    marker_rest_px: Pixels
    marker_shift_px: Pixels
    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats


@dataclass(frozen=True, kw_only=True)
class Touch:
    """What is under one probe, for pictures; k patches in contact.

    Attributes
    ----------
    probe
        Its kind.
    place_mm, half_mm
        (k, 2) centres along the surface from the contact's middle, and half sizes.
    pressure_mpa, shear_mpa
        (k,) pressures and (k, 2) tractions along the surface, on the body.
    slip
        (k,) whether each patch slips.
    friction
        Coefficient; 0 frictionless, inf sticking.
    expected
        (n, 2) distance from the middle and pressure by a closed form; empty where there is none.
    expected_name
        What the closed form is called.
    """

    probe: str
    place_mm: Floats
    half_mm: Floats
    pressure_mpa: Floats
    shear_mpa: Floats
    slip: Bools
    friction: float
    expected: Floats
    expected_name: str


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """Everything that a run computed; what was not wanted is None.

    Attributes
    ----------
    scene_toml
        The resolved scene.
    truth, estimate
        See their classes.
    rest, pressed
        CCD pictures.
    score
        Errors by stage: ``elastic``, ``tracking``, ``force``, ``reasons``.
    touches
        What is under each probe that touches.
    facts
        What the report tells beside the numbers: contact, calibration, validity, what truth and estimate share.
    timings
        Seconds by stage, in order.
    """

    scene_toml: str
    truth: Truth | None = None
    estimate: Estimate | None = None
    rest: Picture | None = None
    pressed: Picture | None = None
    score: dict[str, Any] | None = None
    touches: tuple[Touch, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write all files but the report into ``folder``; `remove_results` has removed those of an earlier run.

        Raises
        ------
        TwinError
            The folder can't be written, or the disk is full.
        """
        from PIL import Image

        make_folder(folder)
        write_json(folder / MARK, self.timings)
        write_whole(folder / "scene.toml", lambda f: f.write(self.scene_toml.encode()))
        for name, arrays in (("truth", self.truth), ("estimate", self.estimate)):
            if arrays is not None:
                table = {f.name: getattr(arrays, f.name) for f in fields(arrays)}
                write_whole(folder / f"{name}.npz", lambda f, table=table: np.savez(f, **table))  # type: ignore[misc]
        for name, picture in (("rest", self.rest), ("pressed", self.pressed)):
            if picture is not None:
                image = Image.fromarray(picture)
                # level 1: noisy pictures compress no better above it, and take five times as long
                write_whole(folder / f"{name}.png", lambda f, i=image: i.save(f, "PNG", compress_level=1))  # type: ignore[misc]
        if self.score is not None:
            write_json(folder / "score.json", {**self.score, "facts": self.facts})


MARK = "timings.json"
"""Written first and removed last: beside it, files of the names below are an earlier run's."""

RESULT_FILES = (
    "rest.png", "pressed.png", "truth.npz", "estimate.npz", "score.json", "scene.toml", "report.html", MARK,
)  # fmt: skip
"""What a run may write."""


def refuse_others_files(folder: Path) -> None:
    """Raise an `InputError` if ``folder`` holds a file that a run would replace and none has written."""
    there = [name for name in RESULT_FILES if (folder / name).exists()]
    if there and MARK not in there:
        raise InputError(
            f"--out {folder}: holds {', '.join(there)}, which no run wrote (there is no {MARK} beside), and which "
            "would be replaced; give another folder"
        )


def remove_results(folder: Path) -> None:
    """Remove an earlier run's files, so that a folder never mixes two runs."""
    for name in RESULT_FILES:
        (folder / name).unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make ``folder``, check that it can be written, and remove what a killed writer left half written in it.

    Raises
    ------
    InputError
        It can't.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(
            f"{folder}: the output folder can't be made, as there is a file of that name; give another"
        ) from None
    except OSError as problem:
        raise InputError(f"{folder}: the output folder can't be made ({problem.strerror}); give another") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: the output folder can't be written; give another")
    for part in folder.glob(".*.part"):
        writer = part.suffixes[-2].removeprefix(".") if len(part.suffixes) > 1 else ""
        if writer.isdecimal() and not _is_alive(int(writer)):
            part.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's, or no number of a process
        pass
    return True


def write_whole(path: Path, write: Callable[[IO[bytes]], object], *, first: bool = False) -> None:
    """Write a file so that it is either whole or absent; ``first``: keep one that another process wrote by then."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        if not (first and _linked(part, path)):
            os.replace(part, path)
    except OSError as problem:
        why = problem.strerror or problem  # numpy says how much it wrote, and no more
        raise TwinError(f"{path}: can't be written ({why}); files written so far are whole") from None
    finally:
        with contextlib.suppress(OSError):  # where there is no such folder there is no such file
            part.unlink(missing_ok=True)


def _linked(part: Path, path: Path) -> bool:
    """Give a file a name unless there is one of that name; False where the file system can't."""
    try:
        os.link(part, path)
    except FileExistsError:
        return True
    except OSError:
        return False
    return True


def write_json(path: Path, table: Mapping[str, Any]) -> None:
    """Write a JSON file; a number that is not finite becomes null."""
    text = json.dumps(_finite(table), indent=2)
    write_whole(path, lambda f: f.write(text.encode()))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
