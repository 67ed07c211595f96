"""Seconds: Kamiyama's 0.08 s and 0.9 s and the 70 Hz it aims at, Sato's Table II.

Times are of this machine, one thread, and one frame that has arrived: capture is not part of them. They are the
thread's own, which a clock on the wall shows too while nothing else runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from twin.arrays import Pixels
from twin.sense.reconstruct import reconstruct
from twin.sense.rest import Rest
from twin.sense.track import track_frame
from twin.show.panels import Curve, CurvePanel
from twin.study.reproduce.bench import OUR_TRACKER, Bench
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.flat_picture import pillar_press
from twin.study.reproduce.record import Outcome, Record

FRAME_S, CALCULATED_US = 0.08, 545.0
"""What the papers print for one sensor: a frame with its capture (Kamiyama), its calculation alone (Sato)."""

TRIALS = 100
BEFORE = 0.9
"""Share of the markers' motion that the frame before had shown: a tracker that follows them starts from there."""

WARM = 3


def timed(work: Callable[[], object], trials: int) -> np.ndarray:
    """Return (trials,) CPU seconds of ``work``, after a few that don't count."""
    for _ in range(WARM):
        work()
    seconds = np.zeros(trials)
    for number in range(trials):
        started = time.process_time()
        work()
        seconds[number] = time.process_time() - started
    return seconds


def _record(quantity: str, unit: str, samples: np.ndarray, paper: float | None = None, scale: float = 1.0) -> Record:
    return Record(
        quantity=quantity, unit=unit, paper=paper, twin=float(samples.mean() * scale),
        spread=float(samples.std(ddof=1) * scale), n=len(samples), timed=True,
    )  # fmt: skip


def _kamiyama(bench: Bench) -> Outcome:
    rig = bench.rig("kamiyama")
    trials = 20 if bench.quick else TRIALS
    state = rig.press(pillar_press())
    picture = rig.picture(rig.motion(state), 1)
    told = rig.calibration
    fixed = reconstruct(rig.track(picture), told, method="smooth").weight
    ways: dict[str, tuple[str, dict[str, Any], float]] = {
        "paper's tracker and linear constraint": ("two-pass", {}, FRAME_S),
        "paper's tracker, pushes only (quadratic programme)": ("two-pass", {"push_only": True}, 0.9),
        "this project's tracker and linear constraint": (OUR_TRACKER, {}, FRAME_S),
    }
    records, curves = [], []
    for number, (name, (method, options, paper)) in enumerate(ways.items()):
        bench.progress(name, number / len(ways))
        rest = rig.rest(method)  # type: ignore[arg-type]
        before = BEFORE * rig.track(picture, method).shift_px  # type: ignore[arg-type]

        def work(rest: Rest = rest, before: Pixels = before, options: dict[str, Any] = options) -> None:
            reconstruct(track_frame(rest, picture, before), told, method="smooth", weight=fixed, **options)

        seconds = timed(work, trials)
        records.append(_record(f"{name}: from the frame to the force field", "s", seconds, paper))
        curves.append(Curve(label=name, x=np.arange(float(trials)), y=1e3 * np.sort(seconds)))
        rate = Record(
            quantity=f"{name}: frames a second (goal 70)", unit="Hz",
            twin=float(1 / np.median(seconds)), n=trials, timed=True,
        )  # fmt: skip
        records.append(rate)
    panel = CurvePanel(
        title=f"{trials} frames, sorted", curves=curves, across="frame", up="time (ms)", logarithmic=True,
        levels={"70 Hz": 1e3 / 70},
    )  # fmt: skip
    note = (
        "The paper's times are of a 1.8 GHz Pentium 4 in 2003 and hold 0.03 s of capture and 0.02 s of noise "
        "reduction; they differ from these by the machine and by capture, which nothing in the twin explains."
    )
    return Outcome(records=records, panels=(panel,), notes=(note,))


def _sato(bench: Bench) -> Outcome:
    rig = bench.rig("sato")
    trials = 20 if bench.quick else TRIALS
    told = rig.calibration
    pictures = [rig.picture(None, 20 + k) for k in range(4)]
    rest = rig.rest(rig.scene.tracking.method)
    before = np.zeros_like(rest.rest_px)
    records, curves = [], []
    for count, (average, deviation) in {1: (CALCULATED_US, 56.0), 4: (2159.0, 43.0)}.items():
        bench.progress(f"{count} sensors", count / 5)

        def work(count: int = count) -> None:
            for picture in pictures[:count]:
                reconstruct(track_frame(rest, picture, before), told, method="pinv")

        seconds = timed(work, trials)
        what = "one sensor" if count == 1 else f"{count} sensors"
        records.append(_record(f"{what}: average time from frame to force field", "µs", seconds, average, 1e6))
        records.append(
            Record(
                quantity=f"{what}: standard deviation of the time", unit="µs", paper=deviation,
                twin=1e6 * float(seconds.std(ddof=1)), n=trials, timed=True,
            )
        )  # fmt: skip
        curves.append(Curve(label=what, x=np.arange(float(trials)), y=1e6 * np.sort(seconds)))
    levels = {"60 frames a second": 1e6 / 60}
    panel = CurvePanel(
        title=f"{trials} trials, sorted", curves=curves, across="trial", up="time (µs)", levels=levels, logarithmic=True
    )
    note = "The paper's times are of a 2.8 GHz Pentium D in 2008; these are of this machine."
    return Outcome(records=records, panels=(panel,), notes=(note,))


KAMIYAMA_TIMES = Entry(
    name="kamiyama/times",
    title="Time from the frame to the force field",
    source="Kamiyama, sections 4.3.1 and 6",
    protocol="One frame of the pillar, tracked from where the markers were nine tenths of the way before and "
    "reconstructed, again and again on one thread, whose own time is taken; the weight is given, as the paper's was.",
    run=_kamiyama,
)
SATO_TABLE_2 = Entry(
    name="sato/table-2",
    title="Calculation time for one and for four sensors",
    source="Sato, section III D, Table II",
    protocol=f"Average and standard deviation of {TRIALS} runs from the frame to the force field, one sensor and "
    "four after each other, on one thread, whose own time is taken.",
    run=_sato,
)
