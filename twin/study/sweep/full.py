"""The last fidelity: every design's pictures, tracked and reconstructed, under the sweep's loads.

The made sensor, its optics, its CCD and the software are those of ``twin run``; only the contact is given, as patches
of even traction, so that designs are compared under the same load and no contact is solved. `twin run` on the recipes
of the best designs adds that.

As on a real sensor, a second exposure at rest sets the zero: what the tracker reads without any load is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Bools, Floats, Picture, Singles
from twin.errors import InputError
from twin.judge.resolve import dip
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.streams import Purpose, stream
from twin.study.sensor import Motion, Sensor
from twin.study.sweep.linear import Profiles, Shown
from twin.study.sweep.loads import Bodies, Pushes

GROSS_PX = 1.0
"""A shift wrong by more than this is a mistaken marker, and counted apart."""


@dataclass(frozen=True, kw_only=True)
class Taken:
    """What the report shows of a design.

    Attributes
    ----------
    picture
        Under the push in the middle.
    middle, pair
        Its estimated field, and that of the pair.
    """

    picture: Picture
    middle: Shown
    pair: Shown


def full(scene: Scene, sweep: Sweep, bodies: Bodies, pushes: Pushes) -> tuple[dict[str, float], Taken]:
    """Return a design's metrics by the full chain, and what it looks like.

    Raises
    ------
    InputError
        The pictures show too little to track.
    """
    from twin.sense.reconstruct import reconstruct
    from twin.sense.track import analyse_rest, track_frame
    from twin.study.calibrate import half_space_compliance, nominal_calibration

    assert scene.reconstruction is not None
    sensor = Sensor(scene)
    chosen = _loads(sweep, pushes)
    motions = [_motion(sensor, bodies, pushes, load) for load in chosen]
    nominal = sensor.nominal_markers.points
    if scene.calibration.method == "halfspace":
        compliance = half_space_compliance(scene, nominal, sensor.sites)
    else:
        compliance = bodies.moved(scene, "nominal", nominal, sensor.sites)
    calibration = nominal_calibration(sensor, compliance)
    # of one exposure all pictures share a zero; of several each has its own, or its noise would be in all of them
    again = range(sweep.loads.exposures)
    still = sensor.renderer.radiance(sensor.ellipsoids(None))
    rest = analyse_rest(_exposed(sensor, still, 0), sensor.layout_px, method=scene.tracking.method)
    count = 1 if len(again) == 1 else len(again) * len(motions)
    zeros = [track_frame(rest, _exposed(sensor, still, 1 + k)) for k in range(count)]
    # a marker's noise is the same in every picture, so that one factorisation serves them all
    told = np.nanmean([zero.sd_px for zero in zeros], axis=0) if len(zeros) > 1 else zeros[0].sd_px
    at_rest = sensor.project(sensor.actual.markers.points)
    options = scene.reconstruction.model_dump(exclude={"sites", "source", "assumed"})
    forces, errors, spread, matched, totals, first = [], [], [], [], [], None
    for place, motion in enumerate(motions):
        light = sensor.renderer.radiance(sensor.ellipsoids(motion))
        true = sensor.project(sensor.actual.markers.points + motion.displacement_mm) - at_rest
        shifts = []
        for k in again:
            zero = zeros[(place * len(again) + k) % count]
            picture = _exposed(sensor, light, 1 + count + place * len(again) + k)
            first = picture if first is None else first
            found = track_frame(rest, picture)
            found = replace(found, shift_px=found.shift_px - zero.shift_px, sd_px=told)
            field = reconstruct(found, calibration, **options)
            shifts.append(found.shift_px)
            errors.append(found.shift_px - true)
            matched.append(float(np.isfinite(found.shift_px[:, 0]).mean()))
            if k == 0:
                forces.append(field.force_n)
            totals.append((place, field.total_force_n))
        if len(shifts) > 1:
            spread.append(np.var(shifts, axis=0, ddof=1))
    assert first is not None
    profiles = Profiles(scene, sensor.sites, np.stack(forces, axis=2))
    truth = pushes.loads[chosen].sum(axis=1)
    off = np.array(
        [
            np.linalg.norm(total - truth[place]) / np.linalg.norm(truth[place])
            for place, total in totals
            if 1 <= place <= pushes.presses
        ]
    )
    figures = {
        "total_force_error": float(np.sqrt(np.mean(off**2))),
        "total_force_error_se": float(off.std(ddof=1) / np.sqrt(len(off))) if len(off) > 1 else float("nan"),
        "fwhm_mm": profiles.width(0),
        "dip": dip(*profiles.along(len(chosen) - 1, 0), _pair_mm(sweep, pushes))
        if len(pushes.pair_mm)
        else float("nan"),
        **_tracking(np.concatenate(errors), told),
        "noise_px": float(np.sqrt(np.nanmedian(spread))) if spread else float("nan"),
        "matched": float(np.mean(matched)),
    }
    site_mm = sensor.sites.centre_mm
    taken = Taken(
        picture=first, middle=Shown(site_mm=site_mm, force_n=np.array(forces[0])),
        pair=Shown(site_mm=site_mm, force_n=np.array(forces[-1])),
    )  # fmt: skip
    return figures, taken


def _exposed(sensor: Sensor, light: Singles, number: int) -> Picture:
    """Return an exposure of rendered light."""
    from twin.world.exposure import expose

    noise = stream(sensor.nominal.seed, Purpose.EXPOSURE, number)
    return expose(light, sensor.nominal.ccd, noise, sensor.pattern)


def _loads(sweep: Sweep, pushes: Pushes) -> list[int]:
    """Return the loads that are shown: the middle, the presses, and the pair at the wanted distance."""
    singles = list(range(1 + pushes.presses))
    if not len(pushes.pair_mm):
        return singles
    return [*singles, 1 + pushes.presses + int(np.argmin(np.abs(pushes.pair_mm - sweep.loads.pair_mm)))]


def _pair_mm(sweep: Sweep, pushes: Pushes) -> float:
    return float(pushes.pair_mm[np.argmin(np.abs(pushes.pair_mm - sweep.loads.pair_mm))])


def _motion(sensor: Sensor, bodies: Bodies, pushes: Pushes, load: int) -> Motion:
    actual, points = sensor.actual.scene, sensor.actual.markers.points
    moved = bodies.moved(actual, "truth", points, pushes.patches) @ pushes.loads[load].ravel()
    gradient = np.zeros((len(points), 3, 3))
    if any(layer.kind == "print" for layer in actual.markers.values()):  # of a bead's turn no picture shows anything
        unit = bodies.unit(actual, "truth", pushes.patches)
        gradient = unit.gradient(points, pushes.rectangles(load)) / actual.material.youngs_modulus_mpa
    return Motion(displacement_mm=moved.reshape(-1, 3), gradient=gradient, error=0.0)


def _tracking(error: Floats, told: Floats) -> dict[str, float]:
    """Return the standard deviation of a shift, per axis, as it is and as the tracker tells it, px."""
    known: Bools = np.asarray(np.isfinite(error).all(axis=1), np.bool_)
    if not known.any():
        raise InputError("no marker was found in any picture")
    fine = known & (np.linalg.norm(np.where(known[:, None], error, 0.0), axis=1) <= GROSS_PX)
    return {
        "sd_px": float(np.sqrt(np.mean(error[fine] ** 2))) if fine.any() else float("nan"),
        "told_sd_px": float(np.sqrt(np.nanmean(told**2))),
    }
