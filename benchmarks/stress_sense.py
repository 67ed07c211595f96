"""Axes of the sensor's software: motion, missing markers, contrast, blur; wrong vectors, weights, noise of shifts.

Tracking runs on drawn pictures (`benchmarks.discs`). Departure is the share of markers that are given a shift more than
half a px wrong: an answer that is made up. What is not found is left out and said, which is no departure. For forces it
is the error of the total.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from benchmarks.discs import expose, scene
from benchmarks.inverse import case
from benchmarks.stress_axes import Axis, Measured
from benchmarks.tracking import FINGER, SIZE
from twin.arrays import Floats
from twin.errors import SolveError
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

MADE_UP, WRONG_PX = Measured(departure=0.02), 0.5
OFF = Measured(departure=0.1)
LAYOUT = FINGER.layout()
MARKS = np.concatenate(list(LAYOUT.values()))


def tracking_axes() -> list[Axis]:
    """Return the axes of tracking."""
    shares = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
    tracking: list[tuple[str, tuple[float, ...], Callable[[float], Measured]]] = [
        ("motion of all markers, over the pitch", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), lambda s: _tracked(motion=s)),
        ("motion, each its own, over the pitch", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), lambda s: _tracked(scatter=s)),
        ("share of markers missing", shares, lambda s: _tracked(missing=s)),
        ("contrast down, counts", (130.0, 40.0, 20.0, 10.0, 5.0, 2.0, 0.0), lambda c: _tracked(contrast=c)),
        ("brightness up, counts (255 saturate)", (130.0, 200.0, 400.0, 2e3, 1e5), lambda c: _tracked(contrast=c)),
        ("blur, px", (0.7, 2.0, 4.0, 8.0), lambda b: _tracked(blur=b)),
        (
            "rows of pixels cut off the picture's end, set black",
            (0.0, 50.0, 200.0, 479.0),
            lambda n: _tracked(cut=int(n)),
        ),
        ("share of spurious spots", (0.0, 0.1, 0.5, 1.0), lambda s: _tracked(spurious=s)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=MADE_UP) for n, s, a in tracking]


def inverse_axes() -> list[Axis]:
    """Return the axes of the inverse problem."""
    inverse: list[tuple[str, tuple[float, ...], Callable[[float], Measured]]] = [
        ("weight up (departure: error of the total)", (1.0, 1e3, 1e6, 1e9, 1e12, 1e300), lambda w: _solved(weight=w)),
        ("weight down", (1.0, 1e-3, 1e-6, 1e-12, 1e-300, 0.0), lambda w: _solved(weight=w)),
        ("weight by itself, noise of a shift, px", (0.05, 0.2, 1.0, 5.0, 50.0), lambda n: _solved(noise=n)),
        (
            "share of vectors wrong by 10 px, robust",
            (0.0, 0.02, 0.1, 0.2, 0.4),
            lambda s: _solved(wrong=s, robust=True),
        ),
        ("share of vectors wrong by 10 px, not robust", (0.0, 0.02, 0.1), lambda s: _solved(wrong=s)),
        ("share of vectors lost", (0.0, 0.2, 0.5, 0.9, 0.99, 1.0), lambda s: _solved(lost=s)),
        ("shifts, times", (1.0, 1e3, 1e9, 1e100), lambda k: _solved(scale=k)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=OFF) for n, s, a in inverse]


def _drawn(places: Floats, contrast: float = 130.0, blur: float = 0.7, seed: int = 0) -> np.ndarray:
    cut = len(LAYOUT["red"])
    return expose(scene(SIZE, [(places[:cut], 0), (places[cut:], 2)], FINGER.diameter, blur, contrast), seed)


def _tracked(
    *, motion: float = 0.0, scatter: float = 0.0, missing: float = 0.0, contrast: float = 130.0, blur: float = 0.7,
    cut: int = 0, spurious: float = 0.0,
) -> Measured:  # fmt: skip
    random = np.random.default_rng(5)
    shift = motion * FINGER.pitch * np.array([0.8, 0.6]) + random.uniform(-1, 1, MARKS.shape) * scatter * FINGER.pitch
    places = np.where(random.random(len(MARKS))[:, None] < missing, np.nan, MARKS + shift)
    picture = _drawn(places, contrast, blur, 1)
    if cut:
        picture[-cut:] = 0
    for x, y in random.uniform((20, 20), (620, 460), (round(spurious * len(MARKS)), 2)).astype(int):
        picture[y - 5 : y + 5, x - 5 : x + 5, random.integers(0, 3)] = 160
    rest = _drawn(MARKS, contrast, blur, 0)
    found = track(rest, picture, LAYOUT).shift_px
    gone = ~np.isfinite(places).all(axis=1)
    given = np.isfinite(found).all(axis=1)
    wrong = given & (gone | (np.hypot(*(found - shift).T) > WRONG_PX))
    return Measured(departure=float(wrong.mean()))


@cache
def _sensor() -> tuple[Any, Any]:
    sensor = Sensor(load_scene("kamiyama_pillar"))
    return calibration_of(sensor), case(sensor, calibration_of(sensor), 3)


def _solved(
    *, noise: float = 0.0, wrong: float = 0.0, lost: float = 0.0, scale: float = 1.0, robust: bool = False,
    weight: float | str = "auto",
) -> Measured:  # fmt: skip
    from dataclasses import replace

    calibration, (found, _, force, _) = _sensor()
    random = np.random.default_rng(8)
    shift = np.array(found.shift_px) * scale + random.normal(0, noise, found.shift_px.shape)
    bad = random.permutation(len(shift))[: round(wrong * len(shift))]
    shift[bad] += random.choice([-10.0, 10.0], (len(bad), 2))
    shift[random.permutation(len(shift))[: round(lost * len(shift))]] = np.nan
    given = replace(found, shift_px=shift, sd_px=np.full(len(shift), max(noise, 0.05) * scale))
    answer = reconstruct(given, calibration, weight=weight, robust=robust)
    if not np.isfinite(answer.total_force_n).all():
        raise SolveError("the total is not finite")
    return Measured(departure=float(np.linalg.norm(answer.total_force_n / scale - force) / np.linalg.norm(force)))
