"""How well a known motion is measured: Kamiyama's Table 1 with Figs. 7 and 8, Sato's Table I.

The papers displace a picture by whole pixels in the computer. Here that is done as published, and
also the markers are moved and filmed again, which is what a shift in use looks like.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from twin.parts.methods import CentreMethod
from twin.sense.track import Found
from twin.show.reproduction_page import Panel
from twin.study.reproduce.bench import (
    KAMIYAMA,
    NO_NOISE,
    OUR_TRACKER,
    OUR_TRACKER_INSTEAD,
    QUIET,
    SATO,
    WAYS,
    Bench,
    Chain,
    Entry,
    Measure,
    Protocol,
    Reading,
    Way,
)
from twin.study.reproduce.record import Numbers, Quantity, Record, Unprinted

SECOND = (
    "noise common to both pictures off: a second exposure displaced instead of the rest "
    "picture itself"
)
BAND = "reading: the band of 95 % of the markers instead of the farthest one"
SHARE = 0.95
"""What a reader takes for the width of a histogram, and the share of the markers in it."""

BALANCE = Unprinted(
    "sensitivity to red over that to blue, noise fitted again",
    "",
    (0.5, 0.6, 0.8, 1.0, 1.5),
    "from a white LED of the time, poor in red, to a warm lamp; the camera's balance isn't printed",
)
REFITTED = dict(zip(BALANCE.values, (72.0, 82.0, 100.0, 112.0, 87.0), strict=True))
"""Read noise in electrons that gives the mean standard deviation of Kamiyama's Table 1, by
balance."""

QUALITY = Unprinted(
    "quality of the video compression",
    "of JPEG",
    (70.0, 85.0, 96.0, 98.0, 99.0, 100.0),
    "from what is visible to the least loss; the paper names a compression unit alone",
)
AXES = ("x", "y")
NEAR_PX = 0.1
"""Averages agree within this, px: half a standard deviation of the papers' single markers."""


def _causes(protocol: Protocol) -> dict[str, Chain]:
    own = Chain(paper=protocol.sensor)
    return {
        OUR_TRACKER_INSTEAD: replace(own, tracker=OUR_TRACKER),
        NO_NOISE: replace(own, overrides=QUIET),
        "capture chain off (no blur, no noise)": replace(own, overrides={"ccd.preset": "ideal"}),
        "print errors off": replace(own, overrides={"tolerance.print_mm": 0.0}),
    }


def _balanced(value: float) -> Chain:
    most = max(value, 1.0)
    colours = {"ccd.quantum_efficiency": [value / most, value**0.5 / most, 1.0 / most]}
    return Chain(paper="kamiyama", overrides=colours | {"ccd.read_noise_e": REFITTED[value]})


def _compressed(value: float) -> Chain:
    return Chain(paper="sato", overrides={"ccd.jpeg_quality": int(value)})


def _compared(
    bench: Bench,
    protocol: Protocol,
    way: Way,
    numbers: Callable[[Found], Numbers],
    causes: Mapping[str, Chain | Measure[Found] | Reading[Found]] | None = None,
    *,
    tracker: CentreMethod | None = None,
    ranged: bool = False,
    label: str = "",
) -> tuple[list[Record], list[Found]]:
    """Return records and runs of the test; where ``ranged``, also over what isn't printed of the
    capture."""
    ranges = {BALANCE: _balanced} if protocol is KAMIYAMA else {QUALITY: _compressed}
    # A picture displaced in the computer holds one frame and its noise twice.
    ranged &= not bench.quick and not (protocol is KAMIYAMA and way == "digital")
    records, runs, _ = bench.compare(
        partial(protocol.tracked, bench, way),
        numbers,
        Chain(paper=protocol.sensor, tracker=tracker),
        causes,
        bench.trials(protocol.sensor, pressed=False),
        ranges if ranged else {},
        f"{way} shift{label}",
    )
    return records, runs


def _moments(protocol: Protocol, found: Found, *, printed: bool) -> Numbers:
    """Return averages and deviations by layer and axis, with the paper's or without."""
    numbers: dict[Quantity, float] = {}
    for (layer, axis), (average, deviation) in protocol.paper.items():
        along = Protocol.samples(found, layer)[:, AXES.index(axis)]
        mean = Quantity(f"{layer} {axis} average", "px")
        spread = Quantity(f"{layer} {axis} standard deviation", "px")
        if printed:
            mean = replace(mean, paper=average, near=NEAR_PX)
            spread = replace(spread, paper=deviation)
        numbers |= {mean: float(along.mean()), spread: float(along.std(ddof=1))}
    return numbers


def _table(protocol: Protocol, bench: Bench) -> Entry.Outcome:
    """Return averages and standard deviations by layer and axis, both ways, with both trackers."""
    theirs: list[Record] = []
    ours: list[Record] = []
    for number, way in enumerate(WAYS):
        bench.progress(way, number / len(WAYS))
        causes: dict[str, Chain | Measure[Found]] = {**_causes(protocol)}
        if way == "digital" and protocol.exposure == 0:
            causes[SECOND] = partial(replace(protocol, exposure=7).tracked, bench, way)
        printed = partial(_moments, protocol, printed=True)
        label = ", the paper's tracker"
        theirs += _compared(bench, protocol, way, printed, causes, ranged=True, label=label)[0]
        measured = partial(_moments, protocol, printed=False)
        label = ", this project's tracker"
        ours += _compared(bench, protocol, way, measured, tracker=OUR_TRACKER, label=label)[0]
    panels = _histograms(bench, protocol, "x")
    return Entry.Outcome(records=theirs + ours, panels=panels)


def _histograms(bench: Bench, protocol: Protocol, axis: str) -> list[Panel]:
    found = {way: protocol.tracked(bench, way, Chain(paper=protocol.sensor)) for way in WAYS}
    middle = protocol.shift_px if axis == "x" else 0.0

    def histogram(layer: str) -> Panel:
        shifts = {way: Protocol.samples(f, layer)[:, AXES.index(axis)] for way, f in found.items()}
        reach = max(0.1, 1.1 * max(float(np.abs(s - middle).max()) for s in shifts.values()))

        def draw(axes: Any) -> None:
            ends = (middle - reach, middle + reach)
            for way, values in shifts.items():
                axes.hist(values, bins=40, range=ends, histtype="step", label=way)
            average = protocol.paper[layer, axis][0]
            axes.axvline(average, color="#1d2126", ls="--", lw=1, label="paper's average")
            axes.set(xlabel=f"measured {axis} shift (px)", ylabel="markers")

        return Panel(title=f"{layer}, {axis}: the paper's tracker", draw=draw)

    return [histogram("red"), histogram("blue")]


def _vectors(found: Found) -> Numbers:
    wrong = found.shift_px[found.seen] - (KAMIYAMA.shift_px, 0.0)
    return {
        Quantity("share of markers with a vector"): float(found.seen.mean()),
        Quantity("root mean square error of a vector", "px"): float(
            np.sqrt((wrong**2).sum(axis=1).mean())
        ),
    }


def _figure_7(bench: Bench) -> Entry.Outcome:
    records: list[Record] = []
    panels = []
    for way in WAYS:
        found, runs = _compared(bench, KAMIYAMA, way, _vectors)
        records += found
        panels.append(Panel.shifts(f"3 px to the right, {way}", runs[0], magnified=5.0))
    return Entry.Outcome(records=records, panels=panels)


def _largest(found: Found, share: float = 1.0) -> Numbers:
    """Return the deviation that a share of the markers doesn't exceed, by layer and axis."""
    numbers = {}
    for layer in ("blue", "red"):
        off = np.abs(Protocol.samples(found, layer) - (KAMIYAMA.shift_px, 0.0))
        for axis, values in zip(AXES, off.T, strict=True):
            name = f"largest deviation, {layer} {axis}"
            numbers[Quantity(name, "px", paper=0.4)] = float(np.quantile(values, share))
    return numbers


def _figure_8(bench: Bench) -> Entry.Outcome:
    records: list[Record] = []
    bands = []
    band = Reading(partial(_largest, share=SHARE))
    causes: dict[str, Chain | Reading[Found]] = {BAND: band, **_causes(KAMIYAMA)}
    for way in WAYS:
        found, _ = _compared(bench, KAMIYAMA, way, _largest, causes)
        width = np.mean([record.explained_by[BAND] for record in found])
        bands.append(f"{width:.2g} px {way}")
        records += found
    panels = _histograms(bench, KAMIYAMA, "x") + _histograms(bench, KAMIYAMA, "y")
    note = (
        "With standard deviations of 0.19 to 0.25 px no distribution of some 300 markers is likely "
        "to end at 0.4 px, a normal one ends at 0.6 to 0.75 px: the paper reads a band off its "
        f"histograms. 95 % of the markers lie within {' and '.join(bands)}."
    )
    return Entry.Outcome(records=records, panels=panels, notes=(note,))


SHIFTED: dict[str, Callable[[Bench], Entry.Outcome]] = {
    "kamiyama/table-1": partial(_table, KAMIYAMA),
    "kamiyama/fig-7": _figure_7,
    "kamiyama/fig-8": _figure_8,
    "sato/table-1": partial(_table, SATO),
}
