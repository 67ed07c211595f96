"""Two forces at once, and one narrow one: what a design resolves, through the whole chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.parts.load import Traction
from twin.parts.methods import Method
from twin.sense.reconstruct import Field
from twin.sense.rest import Method as Tracker
from twin.sense.track import Found
from twin.study.motion import Motion
from twin.study.reproduce.bench import MADE, Bench, Rig
from twin.study.reproduce.fields import calibration, full_width, solved
from twin.study.reproduce.record import Record
from twin.theory.limit import DIP, Limit, design_limit

SPOT_MM = 0.5
"""Radius of the disc that stands for a narrow force."""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """A sensor with its software.

    Attributes
    ----------
    overrides
        Of the paper's scene.
    tracker, method, options
        How pictures are tracked and the inverse is solved; without a tracker by the scene's.
    told
        Calibration by another method than the scene's.
    """

    paper: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    tracker: Tracker | None = None
    method: Method = "norm"
    options: Mapping[str, Any] = field(default_factory=dict)
    told: str | None = None

    def rig(self, bench: Bench, seed: int | None = None) -> Rig:
        """Return the sensor."""
        return bench.rig(self.paper, seed, dict(self.overrides))

    def solved(self, bench: Bench, rig: Rig, found: Found) -> Field:
        """Reconstruct what was tracked."""
        return solved(found, calibration(bench, rig, self.told), self.method, self.options)


def along_x(found: Field, *, magnitude: bool = False) -> tuple[Floats, Floats]:
    """Return x and the push, or the magnitude, on the row of sites nearest to y = 0, mm and N, two rows averaged."""
    y = np.abs(found.site_mm[:, 1])
    row = y < y.min() + 1e-6
    x = np.unique(found.site_mm[row, 0].round(6))
    size = np.linalg.norm(found.force_n, axis=1) if magnitude else found.force_n[:, 2]
    return x, np.array([float(size[row & (np.abs(found.site_mm[:, 0] - at) < 1e-3)].mean()) for at in x])


def width_mm(x: Floats, size: Floats) -> float:
    """Return the full width at half maximum; the row's length, which it is at least, where it doesn't fall to half."""
    width = full_width(x, size)
    return width if np.isfinite(width) else float(x[-1] - x[0])


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One of several runs of the same thing: a made sensor, and where its exposures are counted from."""

    seed: int | None = None
    exposures: int = 0


ONCE = Trial()
APART = 20_000
"""Exposures from one trial to the next on the same made sensor."""


def trials(bench: Bench, paper: str) -> tuple[Trial, ...]:
    """Return the runs over which a number's spread is told: made sensors; exposures of one where probes touch it."""
    seeds = bench.seeds(paper)
    if bench.quick or len(seeds) > 1:
        return tuple(Trial(seed=seed) for seed in seeds)
    return tuple(Trial(exposures=APART * number) for number in range(MADE))


def pressed(
    bench: Bench, chain: Chain, at_mm: tuple[float, ...], force_n: float, exposure: int, trial: Trial = ONCE
) -> Field:
    """Push narrow forces at places along x and return the reconstructed field."""
    rig = chain.rig(bench, trial.seed)
    motion = bench.once(("narrow", id(rig), at_mm, force_n), lambda: _motion(rig, at_mm, force_n))
    found = rig.track(rig.picture(motion, exposure + trial.exposures), chain.tracker)
    return chain.solved(bench, rig, found)


def _motion(rig: Rig, at_mm: tuple[float, ...], force_n: float) -> Motion:
    spots = [Traction.disk((x, 0.0), SPOT_MM, (0.0, 0.0, force_n)) for x in at_mm]
    return rig.moved_by(sum(spots[1:], start=spots[0]))


def point_width_mm(bench: Bench, chain: Chain, force_n: float, trial: Trial = ONCE) -> float:
    """Return the full width at half maximum of the estimate of a narrow force, mm: of the magnitude, as Sato has it.

    Of the push alone it would flatter an inverse that swings from site to site.
    """
    return width_mm(*along_x(pressed(bench, chain, (0.0,), force_n, 60, trial), magnitude=True))


def two_points_mm(
    bench: Bench, chain: Chain, force_n: float, distances_mm: tuple[float, ...], trial: Trial = ONCE
) -> float:
    """Return the least distance of two narrow forces with a dip of a fifth between them, mm; else the largest."""
    for number, apart in enumerate(distances_mm):
        x, push = along_x(pressed(bench, chain, (-apart / 2, apart / 2), force_n, 70 + number, trial))
        peaks = np.interp((-apart / 2, apart / 2), x, push)
        if peaks.min() > 0 and 1.0 - float(np.interp(0.0, x, push)) / float(peaks.min()) >= DIP:
            return apart
    return distances_mm[-1]


def shift_noise_px(bench: Bench, chain: Chain) -> float:
    """Return the standard deviation of a shift per axis between two pictures at rest, px; robust to lost markers."""
    rig = chain.rig(bench)
    found = rig.track(rig.picture(None, 55), chain.tracker)
    shift = found.shift_px[found.seen]
    return float(1.4826 * np.median(np.abs(shift - np.median(shift, axis=0))))


def limit_records(name: str, limit: Limit) -> list[Record]:
    """Return the closed-form limits of a design as numbers of their own: no run, so they explain nothing."""
    two, wide = float(limit.two_point_mm[0]), float(limit.fwhm_normal_mm[0])
    return [
        Record(quantity=f"{name}: closed-form limit of the least distance of two forces", unit="mm", twin=two),
        Record(quantity=f"{name}: closed-form limit of the width of a narrow force", unit="mm", twin=wide),
    ]


def limit_of(rig: Rig, noise_px: float, force_n: float, radius_mm: float) -> Limit:
    """Return the closed-form limit of a sensor's nominal design at a tracker's noise."""
    scene = rig.scene
    scale = np.linalg.norm(rig.image_scale[:, 0, :2], axis=1)
    layers = list(scene.markers.items())
    noise = [noise_px / float(scale[rig.sensor.actual.markers.of(name)].mean()) for name, _ in layers]
    return design_limit(
        depth_mm=np.array([[layer.depth_mm for _, layer in layers]]),
        pitch_mm=np.array([[layer.pitch_mm for _, layer in layers]]),
        noise_mm=np.array([noise]), youngs_modulus_mpa=np.array([scene.material.youngs_modulus_mpa]),
        poisson_ratio=np.array([scene.material.poisson_ratio]), force_n=np.array([force_n]),
        radius_mm=np.array([radius_mm]),
    )  # fmt: skip
