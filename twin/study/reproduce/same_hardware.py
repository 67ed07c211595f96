"""What the papers' hardware reaches with today's software: the papers' figures, and their software's, beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.parts.press import Press
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track_frame
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import calibration, scored
from twin.study.reproduce.finger_forces import FIRST_EXPOSURE, READ_GF, TOLD_APART
from twin.study.reproduce.finger_forces import line as force_line
from twin.study.reproduce.finger_picture import GRAM_FORCE_N, above, sphere_press
from twin.study.reproduce.flat_picture import pillar_press
from twin.study.reproduce.reach import DISTANCES_MM, DRAWN, FORCE_N, OURS, QUIET
from twin.study.reproduce.record import Outcome, Record, causes, over
from twin.study.reproduce.shifted import KAMIYAMA, SATO, Protocol, measured, samples
from twin.study.reproduce.times import BEFORE, CALCULATED_US, FRAME_S, timed
from twin.study.reproduce.two_forces import (
    ONCE,
    Chain,
    Trial,
    limit_of,
    limit_records,
    point_width_mm,
    shift_noise_px,
    trials,
    two_points_mm,
)

CAMERA = "capture chain: an industrial camera"
PAPERS = "tracker, calibration and inverse: the paper's"
DEFAULT = "inverse: smooth, as scenes have it"
READINGS, RATED = 10, 20


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """A paper's sensor with its own software and with this project's, and what the paper prints.

    Attributes
    ----------
    own, ours
        The two chains.
    shift
        The test of Table 1 or I.
    presses
        Contacts whose fields are reconstructed, by name.
    width_mm, rate_hz
        Full width at half maximum, and frames a second, as printed.
    """

    own: Chain
    ours: Chain
    shift: Protocol
    presses: Mapping[str, Callable[[Rig], Press]]
    width_mm: float | None
    rate_hz: float

    @property
    def quiet(self) -> Chain:
        """This project's software behind an industrial camera."""
        return replace(self.ours, overrides={**self.ours.overrides, **QUIET})

    @property
    def others(self) -> dict[str, Chain]:
        """What stands beside this project's default, by name."""
        return {PAPERS: self.own, DEFAULT: replace(self.ours, method="smooth"), CAMERA: self.quiet}

    def press(self, rig: Rig) -> Press:
        """Return the first of the contacts."""
        return next(iter(self.presses.values()))(rig)


FINE: dict[str, Any] = {
    "reconstruction.sites.columns": 9, "reconstruction.sites.rows": 9, "reconstruction.sites.pitch_mm": 1.25,
}  # fmt: skip
HARDWARE = (
    Hardware(
        own=Chain(paper="kamiyama", method="norm"),
        ours=Chain(paper="kamiyama", overrides=OURS, tracker=OUR_TRACKER, method="local"),
        shift=KAMIYAMA, presses={"under the 5 mm pillar": lambda _: pillar_press()}, width_mm=None, rate_hz=1 / FRAME_S,
    ),
    Hardware(
        own=Chain(paper="sato", method="pinv"),
        ours=Chain(paper="sato", overrides=DRAWN | FINE, tracker=OUR_TRACKER, method="local"),
        shift=SATO,
        presses={
            "under the 3 mm sphere at 100 gf, on a calibrated point": lambda _: sphere_press((0.0, 0.0), 100.0),
            "between four": lambda rig: sphere_press(above(rig, (1.25, 1.25)), 100.0),
        },
        width_mm=5.0, rate_hz=1e6 / CALCULATED_US,
    ),
)  # fmt: skip


def _deviation_px(bench: Bench, hardware: Hardware, chain: Chain, seed: int) -> float:
    """Return the standard deviation of a re-rendered shift, mean over layers and axes, px."""
    rig = bench.rig(chain.paper, seed, QUIET if chain == hardware.quiet else None)
    found = measured(rig, hardware.shift, "re-rendered", chain.tracker)
    return float(np.mean([samples(found, layer).std(axis=0, ddof=1) for layer in ("red", "blue")]))


def _field_error(bench: Bench, press: Callable[[Rig], Press], chain: Chain, trial: Trial = ONCE) -> float:
    rig = chain.rig(bench, trial.seed)
    state = rig.press(press(rig))
    field = chain.solved(bench, rig, rig.seen(state, 90 + trial.exposures, chain.tracker))
    error = scored(rig, state, field)["field_error"]
    return float("nan") if error is None else float(error)


def _told_apart_gf(bench: Bench, hardware: Hardware, chain: Chain, trial: Trial = ONCE) -> float:
    """Return the smallest difference of pushes that two readings of one press tell apart at 95 %, gf."""
    rig = chain.rig(bench, trial.seed)
    state = rig.press(hardware.press(rig))
    first = 100 + trial.exposures
    fields = [chain.solved(bench, rig, rig.seen(state, first + k, chain.tracker)) for k in range(READINGS)]
    pushes = np.array([field.total_force_n[2] for field in fields])
    slope = float(pushes.mean() / state.force_n[2])
    return float(TOLD_APART * pushes.std(ddof=1) / abs(slope) / GRAM_FORCE_N)


def _rates(bench: Bench, hardware: Hardware, chain: Chain) -> np.ndarray:
    """Return (trials,) frames a second from a frame that has arrived to its force field, on one thread."""
    rig = chain.rig(bench)
    told = calibration(bench, rig, chain.told)
    rest = rig.rest(chain.tracker or rig.scene.tracking.method)
    picture = rig.picture(rig.motion(rig.press(hardware.press(rig))), 90)
    found = track_frame(rest, picture)
    before = BEFORE * found.shift_px
    weight = reconstruct(found, told, method=chain.method).weight
    return 1.0 / timed(
        lambda: reconstruct(track_frame(rest, picture, before), told, method=chain.method, weight=weight),
        RATED,
    )


def _records(bench: Bench, hardware: Hardware) -> list[Record]:
    paper, ours, runs = hardware.ours.paper, hardware.ours, trials(bench, hardware.ours.paper)
    others = hardware.others
    pushes = {"pushes only": replace(ours, options={"push_only": True})}

    def compared(
        quantity: str, unit: str, value: Callable[[Chain, Trial], float], printed: float | None, **more: Chain
    ) -> Record:
        return Record(
            quantity=f"{paper}{quantity}", unit=unit, paper=printed, ours=True,
            **over(value(ours, trial) for trial in runs),
            explained_by=causes({name: value(chain, ONCE) for name, chain in {**others, **more}.items()}),
        )  # fmt: skip

    bench.progress(f"{paper}, tracking", 0.05)
    printed_px = float(np.mean([deviation for _, deviation in hardware.shift.paper.values()]))
    deviation = Record(
        quantity=f"{paper}: standard deviation of a shift, re-rendered", unit="px", ours=True, paper=printed_px,
        **over(_deviation_px(bench, hardware, ours, seed) for seed in bench.seeds(paper, pressed=False)),
        explained_by=causes(
            {n: _deviation_px(bench, hardware, c, bench.seed) for n, c in others.items() if n != DEFAULT}
        ),
    )  # fmt: skip
    bench.progress(f"{paper}, fields", 0.2)
    records = [
        deviation,
        *(
            compared(
                f": field error {where}, on each one's sites", "",
                lambda c, t, press=press: _field_error(bench, press, c, t), None, **pushes,  # type: ignore[misc]
            )
            for where, press in hardware.presses.items()
        ),
        compared(
            ": full width at half maximum of a narrow force", "mm",
            lambda c, t: point_width_mm(bench, c, FORCE_N, t), hardware.width_mm,
        ),
        compared(
            ": least distance of two narrow forces", "mm",
            lambda c, t: two_points_mm(bench, c, FORCE_N, DISTANCES_MM, t), None,
        ),
        *limit_records(paper, limit_of(ours.rig(bench), shift_noise_px(bench, ours), FORCE_N, 1.0)),
    ]  # fmt: skip
    bench.progress(f"{paper}, magnitude", 0.6)
    if paper == "kamiyama":
        told = "z: smallest difference of force two readings of one press tell apart at 95 %"
        records.append(compared(f", {told}", "gf", lambda c, t: _told_apart_gf(bench, hardware, c, t), None))
    elif not bench.quick:
        records += _lines(bench, hardware, runs)
    rates = _rates(bench, hardware, ours)
    records.append(
        Record(
            quantity=f"{paper}: frames a second, from the frame to the force field", unit="Hz",
            paper=hardware.rate_hz, twin=float(np.median(rates)), n=len(rates), timed=True,
            explained_by=causes(
                {n: float(np.median(_rates(bench, hardware, c))) for n, c in others.items() if n != CAMERA}
            ),
        )
    )  # fmt: skip
    return records


def _lines(bench: Bench, hardware: Hardware, runs: tuple[Trial, ...]) -> list[Record]:
    """Return Fig. 8's resolution along every axis, two repeats a run."""

    def resolution_gf(chain: Chain, axis: int, trial: Trial) -> float:
        rig, first = chain.rig(bench), FIRST_EXPOSURE + 5000 + trial.exposures
        return force_line(rig, rig.calibration, axis, 10, 2, chain.method, chain.tracker, first).resolution_gf

    return [
        Record(
            quantity=f"sato, {name}: smallest difference of force two readings tell apart at 95 %", unit="gf",
            paper=READ_GF, ours=True, **over(resolution_gf(hardware.ours, axis, trial) for trial in runs),
            explained_by=causes(
                {n: resolution_gf(c, axis, ONCE) for n, c in hardware.others.items() if n != CAMERA}
            ),
        )
        for axis, name in enumerate("xyz")
    ]  # fmt: skip


NOTES = {
    "kamiyama": "Runs are made sensors. A field error is over the sites of each chain, finer ones being the harder "
    "test: 1 mm apart (the paper's 1.5). The paper's rate is of its machine, with capture.",
    "sato": "Runs are exposures of one made finger. A field error is over the sites of each chain, finer ones being "
    "the harder test: 81 sites 1.25 mm apart (the paper's 2.5). The paper's rate is of its machine, of the "
    "calculation alone.",
}


def _entry(hardware: Hardware) -> Entry:
    paper = hardware.ours.paper
    notes = (NOTES[paper], "The weight of the inverse is given when times are taken.")
    return Entry(
        name=f"beyond/same-hardware-{paper}",
        title=f"What {paper.title()}'s hardware reaches with this project's tracker, calibration and inverse",
        source="beyond the papers",
        protocol="The paper's body, markers, camera and capture chain; the disc-fit tracker, the nominal body's "
        "compliance, and the inverse that expects forces where a first solution has some (`local`). Beside them the "
        "paper's numbers, and the same with the paper's own tracker, calibration and inverse.",
        run=lambda bench: Outcome(records=_records(bench, hardware), notes=notes),
        long=True,
    )


SAME_HARDWARE = tuple(_entry(hardware) for hardware in HARDWARE)
