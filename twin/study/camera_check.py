"""Is a camera good enough? What two rest pictures of a sensor say about its noise, exposure, focus
and compression, and what errors of shifts and forces follow.

Two exposures of a sensor that nothing touches differ by noise alone, so the motion that the tracker
finds between them is its error, to be compared with the one that it states.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.arrays import Floats, Picture
from twin.errors import InputError, RecipeError
from twin.parts.scene import Scene

if TYPE_CHECKING:
    from twin.sense.track import Found

SATURATED_DN = 254
"""Counts from which on a pixel is saturated: compression takes one off."""

FEW = 0.9
"""Share of the markers that must be found."""

BLURRED = 0.25
"""Blur's standard deviation over the markers' width above which their edge is mostly blur."""

UNTRUE = 1.5
"""The largest ratio of measured to stated errors, either way, of true ones."""

MOVED = 5.0
"""Standard errors of the mean motion above which the sensor, or the camera, has moved."""


def check_camera(first: Path, second: Path, scene: Scene) -> list[str]:
    """Return lines about a camera, the last one whether it is good enough and why not.

    Parameters
    ----------
    first, second
        Pictures of the sensor without load: PNG, BMP or JPEG.
    scene
        The sensor's nominal design, with ``[camera]``.

    Raises
    ------
    RecipeError
        The scene has no camera.
    InputError
        Pictures that can't be used: of another size, the same picture twice, without markers.
    """
    from twin.sense.disc_fit import DiscFit
    from twin.sense.track import COHERENT, analyse_rest, track_frame
    from twin.study.recorded import read_picture
    from twin.study.sensor import SATURATED, Sensor

    if scene.camera is None:
        raise RecipeError("this scene has no [camera] table: two rest pictures can't be compared")
    sensor = Sensor(scene)
    one, two = read_picture(first), read_picture(second)
    if np.array_equal(one, two):
        raise InputError(f"{second}: is the same picture as {first}: expose the sensor twice")
    rest = analyse_rest(one, sensor.layout_px)
    found = track_frame(rest, two)
    seen = found.seen
    if seen.sum() < 2:
        raise InputError(
            f"{first}, {second}: show {int(seen.sum())} of the scene's {len(seen)} markers: are "
            "they this sensor's, upright, of its camera mode, and exposed?"
        )
    common = np.median(found.shift_px[seen], axis=0)
    measured = found.scatter_px
    stated = float(np.median(found.sd_px[seen]))
    usual = rest.usual_sd_px[seen]
    assert found.usual_sd_px is not None
    coherence = float(np.median(found.usual_sd_px[seen] / usual))
    fits = [group for group in rest.groups if isinstance(group, DiscFit)]
    blur = max(float(np.nanmedian(fit.templates.blur_px)) for fit in fits)
    width = min(fit.look.diameter_px for fit in fits)
    full = max(_saturated(one), _saturated(two))
    noise = _noise(one, two)
    problems = []
    if seen.mean() < FEW:
        problems.append(f"only {100 * seen.mean():.3g} % of the markers are found")
    if full > SATURATED:
        problems.append(f"{100 * full:.2g} % of the pixels are saturated: expose less")
    if blur > BLURRED * width:
        problems.append(f"edges are blurred by {blur:.2g} px in markers {width:.3g} px wide: focus")
    if coherence > COHERENT:
        problems.append(
            f"compression or a colour mosaic makes errors {coherence:.2g} times as large as the "
            "noise of single pixels would: record without compression"
        )
    if not 1 / UNTRUE < measured / stated < UNTRUE:
        problems.append(
            f"shifts differ by {measured:.2g} px, not by the stated {stated:.2g} px: does the "
            "light flicker, or something move?"
        )
    if np.hypot(*common) > max(MOVED * 1.25 * stated / np.sqrt(seen.sum()), 0.01):
        problems.append(
            f"all markers moved by {common[0]:.2g}, {common[1]:.2g} px: mount the camera tighter"
        )
    return [
        f"markers     {int(seen.sum())} of {len(seen)} found, {width:.3g} px wide",
        f"noise       {noise:.2g} counts, {100 * full:.2g} % of the pixels saturated",
        f"blur        {blur:.2g} px (standard deviation, lens and pixel)",
        f"compression errors {coherence:.2g} times as large as from noise in single pixels",
        f"shifts      {measured:.2g} px measured, {stated:.2g} px stated (standard deviation)",
        *_forces(sensor.nominal, found),
        f"good enough: {'no: ' + '; '.join(problems) if problems else 'yes'}",
    ]


def _forces(scene: Scene, found: Found) -> list[str]:
    """Return what a total force is known to; nothing where the scene reconstructs none."""
    from twin.sense.reconstruct import reconstruct
    from twin.study.calibrate import calibration_of
    from twin.study.sensor import Sensor

    if scene.reconstruction is None:
        return []
    design = scene.calibration.model_copy(update={"method": "compliance"})
    nominal = Sensor(scene.model_copy(update={"calibration": design}))
    field = reconstruct(found, calibration_of(nominal))
    x, y, z = field.sd_total_n
    return [f"force       Fx {x:.2g}, Fy {y:.2g}, Fz {z:.2g} N of noise in a total without load"]


def _saturated(picture: Picture) -> float:
    """Return the share of pixels with a saturated channel."""
    full = picture >= SATURATED_DN
    return float((full.any(axis=2) if picture.ndim == 3 else full).mean())


def _noise(one: Picture, two: Picture) -> float:
    """Return the noise of one picture, counts (standard deviation over pixels and channels)."""
    change: Floats = one.astype(float) - two
    return float(np.sqrt(0.5 * np.mean((change - change.mean()) ** 2)))
