"""The sensor's software on recorded frames: rest picture and calibration in, a row of forces for every frame out.

One frame's failure is a row with its reason. Nothing grows with the number of frames but the output.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Bools, Picture
from twin.errors import InputError
from twin.sense.bump import Bump, camera_bump
from twin.sense.calibration import Calibration
from twin.sense.reconstruct import Field, reconstruct
from twin.sense.track import Found, Tracker
from twin.study.frames import Frame

MISFIT = 5.0
"""A frame whose motion fits the calibration worse than the tracker's noise by this factor, and by more than
`MISFIT_PX`, is doubted."""

MISFIT_PX = 0.3
FEW = 0.5
"""Share of the rest picture's markers below which a frame is doubted."""

WEIGHED_ANEW = 0.1
"""Share of markers that must be lost or come back before the weight is chosen anew."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One frame's result.

    Attributes
    ----------
    name, picture
        The frame.
    found, field
        Motion and forces; None where it failed.
    reason
        Why it failed, or why it is to be doubted; empty if neither.
    bump
        Shift that all markers share; None where it failed.
    seconds
        What it took, without reading.
    """

    name: str
    picture: Picture | None
    found: Found | None
    field: Field | None
    reason: str
    bump: Bump | None
    seconds: float

    def row(self, sites: int) -> dict[str, Any]:
        """Return the table's row: names carry units; NaN where it failed."""
        nothing = np.full(3, np.nan)
        field = self.field
        force, torque, sd = (field.total_force_n, field.total_torque_nmm, field.sd_total_n) if field else (nothing,) * 3
        centre = _centre(field) if field else nothing
        bump = self.bump.shift_px if self.bump else nothing
        values = {
            "fx_n": force[0], "fy_n": force[1], "fz_n": force[2],
            "tx_nmm": torque[0], "ty_nmm": torque[1], "tz_nmm": torque[2],
            "sd_fx_n": sd[0], "sd_fy_n": sd[1], "sd_fz_n": sd[2], "centre_x_mm": centre[0], "centre_y_mm": centre[1],
            "shared_x_px": bump[0], "shared_y_px": bump[1], "noise_px": field.noise_px if field else np.nan,
            "milliseconds": 1e3 * self.seconds,
        }  # fmt: skip
        return {
            "frame": self.name, "ok": field is not None, "reason": self.reason,
            "markers": int(self.found.seen.sum()) if self.found else 0,
            **{key: float(value) for key, value in values.items()},
            "force_n": field.force_n if field else np.full((sites, 3), np.nan),
        }  # fmt: skip


def answers(rest: Picture, calibration: Calibration, sequence: Iterable[Frame], **options: Any) -> Iterator[Answer]:
    """Yield every frame's answer.

    Parameters
    ----------
    rest
        The picture without load.
    calibration
        Of this sensor.
    options
        Of `twin.sense.reconstruct.reconstruct`.

    Raises
    ------
    InputError
        The rest picture shows fewer than 2 of the calibration's markers.
    """
    width = calibration.diameter_px
    tracker = Tracker(rest, calibration.layout, diameter_px=width if np.isfinite(width) else None)
    known: Bools = np.asarray(np.isfinite(tracker.rest.rest_px).all(axis=1))
    if known.sum() < 2:
        raise InputError(
            f"the rest picture shows {int(known.sum())} of the calibration's {len(known)} markers: is it this sensor's,"
            " upright, of the calibration's size, and exposed?"
        )
    before: Field | None = None
    bump: Bump | None = None
    for frame in sequence:
        started = time.perf_counter()
        found, field, reason = None, None, frame.problem
        if frame.picture is not None:
            try:
                found = tracker.track(frame.picture)
                if before is not None and (before.used != found.seen).mean() > WEIGHED_ANEW:
                    before, bump = None, None
                field = before = reconstruct(found, calibration, previous=before, **options)
                bump = camera_bump(found, calibration, bump.weight if bump else None)
                reason = _doubt(found, field, bump, int(known.sum()))
            except InputError as problem:
                reason, before, bump, field = str(problem), None, None, None
                tracker.forget()
        yield Answer(
            name=frame.name, picture=frame.picture, found=found if field else None, field=field, reason=reason,
            bump=bump if field else None, seconds=time.perf_counter() - started,
        )  # fmt: skip


def _doubt(found: Found, field: Field, bump: Bump, known: int) -> str:
    """Say what speaks against a frame's forces."""
    doubts = []
    if bump.certain:
        column, row = bump.shift_px
        doubts.append(
            f"the whole picture moved by {column:.1f}, {row:.1f} px: was the camera bumped? Take a new rest picture"
        )
    usual = float(np.nanmedian(found.sd_px))
    if field.noise_px > max(MISFIT * usual, MISFIT_PX):
        doubts.append(
            f"the motion fits no forces (misfit {field.noise_px:.2f} px, tracking {usual:.3f} px): is it this sensor's "
            "calibration, and the picture upright?"
        )
    if found.seen.sum() < FEW * known:
        doubts.append(f"only {int(found.seen.sum())} of {known} markers were found")
    return "; ".join(doubts)


def _centre(field: Field) -> np.ndarray:
    """Return the (x, y) centre of pressure from the total force and torque, mm; NaN without a push along z."""
    force, torque = field.total_force_n, field.total_torque_nmm
    if not force[2] > 3.0 * field.sd_total_n[2]:
        return np.full(2, np.nan)
    height = float(field.site_mm[:, 2].mean())
    return np.array([(height * force[0] - torque[1]) / force[2], (torque[0] + height * force[1]) / force[2]])
