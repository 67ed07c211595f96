"""The last fidelity: every design's pictures, tracked and reconstructed, under the sweep's loads.

The made sensor, its optics, its CCD and the software are those of ``twin run``; only the contact is given, as patches
of even traction, so that designs are compared under the same load and no contact is solved. `twin run` on the recipes
of the best designs adds that.

As on a real sensor, a second exposure at rest sets the zero: what the tracker reads without any load is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from twin.arrays import Bools, Floats, Picture, Singles
from twin.errors import InputError
from twin.judge.resolution import dip
from twin.parts.load import Rectangles
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.streams import Purpose, stream
from twin.study.motion import Motion
from twin.study.sensor import Sensor
from twin.study.sweep.linear import Profiles, Shown, seeded, standard_error
from twin.study.sweep.loads import Bodies, Pushes

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration

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
    """Return a design's metrics by the full chain over its made sensors, and what the first of them looks like.

    Metrics are over all exposures of all made sensors. ``..._noise_se`` is the standard error that is left of noise,
    from the scatter over the exposures of the same made sensors; NaN of one exposure.

    Raises
    ------
    InputError
        The pictures show too little to track.
    """
    chosen = pushes.asked(sweep.loads.pair_mm)
    made = [
        _Made(Sensor(seeded(scene, number)), sweep, bodies, pushes, chosen).seen(scene)
        for number in range(sweep.sensors)
    ]
    truth = pushes.loads[chosen].sum(axis=1)
    press = slice(1, 1 + pushes.presses)
    size = np.linalg.norm(truth[press], axis=1)
    off = np.stack([np.linalg.norm(one.totals - truth, axis=2)[:, press] / size for one in made])
    grid = made[0].sites
    profiles = [Profiles(scene, grid, field) for one in made for field in one.forces]
    widths = np.reshape([each.width(0) for each in profiles], off.shape[:2])
    pair = len(pushes.pair_mm) > 0
    apart = float(pushes.pair_mm[pushes.nearest(sweep.loads.pair_mm)]) if pair else float("nan")
    dips = [dip(*each.along(len(chosen) - 1, 0), apart) if pair else np.nan for each in profiles]
    spread = [one.spread for one in made if one.spread is not None]
    figures = {
        "total_force_error": float(np.sqrt(np.mean(off**2))),
        "total_force_error_se": standard_error(off.mean(axis=(1, 2)) if len(made) > 1 else off.ravel()),
        "total_force_error_noise_se": standard_error(np.sqrt(np.mean(off**2, axis=(0, 2)))),
        "fwhm_mm": float(np.mean(widths)),
        "fwhm_noise_se_mm": standard_error(widths.mean(axis=0)),
        "dip": float(np.mean(dips)),
        **_tracking(np.concatenate([one.errors for one in made]), np.concatenate([one.told for one in made])),
        "noise_px": float(np.sqrt(np.nanmedian(np.concatenate(spread)))) if spread else float("nan"),
        "matched": float(np.mean([one.matched for one in made])),
    }
    first = made[0]
    taken = Taken(
        picture=first.picture, middle=Shown(site_mm=grid.centre_mm, force_n=first.forces[0, :, :, 0]),
        pair=Shown(site_mm=grid.centre_mm, force_n=first.forces[0, :, :, -1]),
    )  # fmt: skip
    return figures, taken


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """What one made sensor's pictures gave.

    Attributes
    ----------
    sites
        Where forces are told.
    totals
        (exposures, loads, 3) total forces, N.
    forces
        (exposures, k, 3, loads) forces at the sites, N.
    errors
        (loads x exposures n, 2) wrong by so much, px.
    told
        (n,) standard deviations that the tracker tells, px.
    spread
        (loads n, 2) variances over the exposures, px^2; None of one exposure.
    matched
        Share of markers found.
    picture
        Of the first load.
    """

    sites: Rectangles
    totals: Floats
    forces: Floats
    errors: Floats
    told: Floats
    spread: Floats | None
    matched: float
    picture: Picture


class _Made:
    """One made sensor of a design, and what it is asked.

    Parameters
    ----------
    sensor
        The sensor.
    sweep, bodies, pushes
        See `full`.
    chosen
        Numbers of the loads.
    """

    def __init__(self, sensor: Sensor, sweep: Sweep, bodies: Bodies, pushes: Pushes, chosen: list[int]) -> None:
        self._sensor, self._sweep, self._bodies = sensor, sweep, bodies
        self._motions = [_motion(sensor, bodies, pushes, load) for load in chosen]

    def seen(self, scene: Scene) -> _Seen:
        """Take the pictures, track and reconstruct them."""
        from twin.sense.reconstruct import reconstruct
        from twin.sense.track import analyse_rest, track_frame

        assert scene.reconstruction is not None
        sensor, motions = self._sensor, self._motions
        calibration = _calibration(sensor, self._bodies)
        # each round of exposures has a zero of its own, or one zero's noise would be in all of them
        again = range(self._sweep.loads.exposures)
        still = sensor.renderer.radiance(sensor.ellipsoids(None))
        rest = analyse_rest(_exposed(sensor, still, 0), sensor.layout_px, method=scene.tracking.method)
        zeros = [track_frame(rest, _exposed(sensor, still, 1 + k)) for k in again]
        # a marker's noise is the same in every picture, so that one factorisation serves them all
        told = np.nanmean([zero.sd_px for zero in zeros], axis=0) if len(zeros) > 1 else zeros[0].sd_px
        at_rest = sensor.project(sensor.actual.markers.points)
        options = scene.reconstruction.model_dump(exclude={"sites", "source", "assumed"})
        totals = np.zeros((len(again), len(motions), 3))
        forces = np.zeros((len(again), len(sensor.sites), 3, len(motions)))
        errors, spread, matched, first = [], [], [], None
        for place, motion in enumerate(motions):
            light = sensor.renderer.radiance(sensor.ellipsoids(motion))
            true = sensor.project(sensor.actual.markers.points + motion.displacement_mm) - at_rest
            shifts = []
            for k in again:
                picture = _exposed(sensor, light, 1 + len(again) * (1 + place) + k)
                first = picture if first is None else first
                found = track_frame(rest, picture)
                found = replace(found, shift_px=found.shift_px - zeros[k].shift_px, sd_px=told)
                field = reconstruct(found, calibration, **options)
                shifts.append(found.shift_px)
                errors.append(found.shift_px - true)
                matched.append(float(np.isfinite(found.shift_px[:, 0]).mean()))
                totals[k, place] = field.total_force_n
                forces[k, :, :, place] = field.force_n
            if len(shifts) > 1:
                spread.append(np.var(shifts, axis=0, ddof=1))
        assert first is not None
        return _Seen(
            sites=sensor.sites, totals=totals, forces=forces, errors=np.concatenate(errors), told=told,
            spread=np.concatenate(spread) if spread else None, matched=float(np.mean(matched)), picture=first,
        )  # fmt: skip


def _calibration(sensor: Sensor, bodies: Bodies) -> Calibration:
    """Return what the software of a design is told, which is the same for all its made sensors."""
    from twin.study.calibrate import half_space_compliance, nominal_calibration

    scene, points = sensor.nominal, sensor.nominal_markers.points
    if scene.calibration.method == "halfspace":
        return nominal_calibration(sensor, half_space_compliance(scene, points, sensor.sites))
    return nominal_calibration(sensor, bodies.moved(scene, "nominal", points, sensor.sites))


def _exposed(sensor: Sensor, light: Singles, number: int) -> Picture:
    """Return an exposure of rendered light."""
    from twin.world.picture.exposure import expose

    noise = stream(sensor.nominal.seed, Purpose.EXPOSURE, number)
    return expose(light, sensor.nominal.ccd, noise, sensor.pattern)


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
