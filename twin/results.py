"""The result of a run: frozen arrays under the names of the files, and the files' names."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Picture, Pixels, Points
from twin.errors import InputError
from twin.files import make_folder, png_bytes, write_json, write_whole


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What really happened (``truth.npz``); n markers in their one order, m surface pieces under
    load.

    Attributes
    ----------
    marker_rest_mm, marker_displacement_mm
        (n, 3) rest places and displacements, mm.
    marker_layer
        (n,) layer names.
    marker_rest_px, marker_pressed_px
        (n, 2) projected centres, px; empty without a camera.
    marker_outline_rest_px, marker_outline_pressed_px
        (n, 2) coverage centroids of the visible outlines, px, NaN where hidden; empty without
        pictures.
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
    """What the sensor's software made of the pictures (``estimate.npz``); k sites, markers in the
    truth's order.

    Attributes
    ----------
    marker_rest_px, marker_shift_px
        (n, 2) tracked rest places and shifts, px, NaN where not found.
    site_mm, force_n
        (k, 3) sites and forces, mm and N; empty if no forces were wanted.
    total_force_n, total_torque_nmm
        (3,) resultants of the linear solve, N and N mm about the origin; empty if no forces were
        wanted.
    """

    marker_rest_px: Pixels
    marker_shift_px: Pixels
    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats


@dataclass(frozen=True, kw_only=True)
class Touch:
    """The contact under one probe, for pictures; k patches in contact.

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
        Name of the closed form.
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
        What the report adds to the numbers: contact, calibration, validity, what truth and
        estimate share.
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

    @staticmethod
    def refuse_other_files(folder: Path) -> None:
        """Raise an `InputError` if a run would replace a file that no run has written."""
        there = [name for name in RESULT_FILES if (folder / name).exists()]
        if there and MARK not in there:
            raise InputError(
                f"--out {folder}: holds {', '.join(there)}, which no run wrote (there is no "
                f"{MARK}), and which would be replaced; give another folder"
            )

    def write(self, folder: Path) -> None:
        """Write all files but the report into ``folder``, and remove those of an earlier run.

        Raises
        ------
        TwinError
            The folder can't be written, or the disk is full.
        """
        make_folder(folder)
        for name in RESULT_FILES:
            (folder / name).unlink(missing_ok=True)
        write_json(folder / MARK, self.timings)
        write_whole(folder / "scene.toml", self.scene_toml.encode())
        for name, arrays in (("truth", self.truth), ("estimate", self.estimate)):
            if arrays is not None:
                table = {f.name: getattr(arrays, f.name) for f in fields(arrays)}
                path = folder / f"{name}.npz"
                write_whole(path, lambda f, t=table: np.savez(f, **t))  # type: ignore[misc]
        for name, picture in (("rest", self.rest), ("pressed", self.pressed)):
            if picture is not None:
                write_whole(folder / f"{name}.png", png_bytes(picture))
        if self.score is not None:
            write_json(folder / "score.json", {**self.score, "facts": self.facts})


MARK = "timings.json"
"""Written first and removed last: it marks the files below as those of a run."""

RESULT_FILES = (
    "rest.png",
    "pressed.png",
    "truth.npz",
    "estimate.npz",
    "score.json",
    "scene.toml",
    "report.html",
    MARK,
)
