"""How well a known motion is measured: Kamiyama's Table 1 with Figs. 7 and 8, Sato's Table I.

The papers displace a picture by whole pixels in the computer. Here that is done as published, and beside it the markers
are moved and filmed again, which is what a shift in use looks like.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from twin.arrays import Floats, Picture
from twin.sense.track import Found
from twin.show.panels import ArrowPanel, HistogramPanel
from twin.study.reproduce.bench import OUR_TRACKER, Bench, Rig
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.record import Cause, Outcome, Record, causes, over

SECOND = "noise common to both pictures off: a second exposure displaced instead of the rest picture itself"

Way = Literal["digital", "re-rendered"]
WAYS: tuple[Way, ...] = ("digital", "re-rendered")
AXES = ("x", "y")


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """One paper's test.

    Attributes
    ----------
    shift_px
        Displacement along x, px.
    exposure
        Which exposure is displaced digitally: 0 is the rest picture itself.
    paper
        (average, standard deviation) by layer and axis, px.
    """

    sensor: str
    shift_px: int
    exposure: int
    paper: Mapping[tuple[str, str], tuple[float, float]]


KAMIYAMA = Protocol(
    sensor="kamiyama", shift_px=3, exposure=0,
    paper={("blue", "x"): (3.09, 0.19), ("blue", "y"): (0.05, 0.22),
           ("red", "x"): (3.02, 0.25), ("red", "y"): (0.06, 0.19)},
)  # fmt: skip
SATO = Protocol(
    sensor="sato", shift_px=5, exposure=7,
    paper={("red", "x"): (4.87, 0.14), ("red", "y"): (0.03, 0.14),
           ("blue", "x"): (4.95, 0.13), ("blue", "y"): (0.00, 0.10)},
)  # fmt: skip

NEAR_PX = 0.1
"""Averages agree within this, px: half a standard deviation of the papers' single markers."""

OFF: dict[str, tuple[dict[str, Any], str | None]] = {
    "tracker: this project's instead of the paper's": ({}, OUR_TRACKER),
    "noise off": ({"ccd.noise": False}, None),
    "capture chain off (no blur, no noise)": ({"ccd.preset": "ideal"}, None),
    "print errors off": ({"tolerance.print_mm": 0.0}, None),
}
"""The causes: overrides of the scene, and another tracker."""


def displaced(picture: Picture, shift_px: int) -> Picture:
    """Return a picture moved to the right by whole pixels; its left edge is drawn out."""
    return np.concatenate([np.repeat(picture[:, :1], shift_px, axis=1), picture[:, :-shift_px]], axis=1)


def measured(rig: Rig, protocol: Protocol, way: Way, method: str | None = None) -> Found:
    """Shift the markers and track them."""
    if way == "digital":
        picture = displaced(rig.picture(None, protocol.exposure), protocol.shift_px)
    else:
        picture = rig.picture(rig.shifted((protocol.shift_px, 0.0)), 8)
    return rig.track(picture, method)  # type: ignore[arg-type]


def samples(found: Found, layer: str) -> Floats:
    """Return (m, 2) the shifts of a layer's tracked markers, px, x to the right and y up."""
    shift = found.shift_px[found.layer == layer]
    return np.asarray(shift[np.isfinite(shift).all(axis=1)] * (1, -1))


def _found(bench: Bench, protocol: Protocol, way: Way, seed: int, cause: str = "") -> Found:
    overrides, method = OFF[cause] if cause else ({}, None)

    def work() -> Found:
        return measured(bench.rig(protocol.sensor, seed, overrides), protocol, way, method)

    return bench.once((protocol.sensor, "shifted", way, seed, cause), work)


def _table(bench: Bench, protocol: Protocol) -> Outcome:
    """Return averages and standard deviations by layer and axis, both ways, with both trackers."""
    records, better = [], []
    ours = "tracker: this project's instead of the paper's"
    seeds = bench.seeds(protocol.sensor, pressed=False)
    work = len(WAYS) * (2 * len(seeds) + len(OFF) - 1)
    done = 0
    for way in WAYS:
        runs: dict[str, list[Found]] = {}
        for cause in ("", *OFF):
            chosen = seeds if cause in ("", ours) else seeds[:1]
            runs[cause] = []
            for seed in chosen:
                runs[cause].append(_found(bench, protocol, way, seed, cause))
                done += 1
                bench.progress(f"{way}, {cause or 'as published'}", done / work)
        if way == "digital" and protocol.exposure == 0:
            again = replace(protocol, exposure=7)
            runs[SECOND] = [measured(bench.rig(protocol.sensor), again, way)]
        for (layer, axis), paper in protocol.paper.items():
            for number, name in enumerate(("average", "standard deviation")):
                value = {
                    cause: [_figure(found, layer, axis, number) for found in founds] for cause, founds in runs.items()
                }
                near = NEAR_PX if number == 0 else None
                records.append(
                    Record(
                        quantity=f"{way} shift, the paper's tracker: {layer} {axis} {name}", unit="px",
                        paper=paper[number], near=near, **over(value[""]),
                        explained_by=tuple(Cause(cause=c, value=v[0]) for c, v in value.items() if c),
                    )
                )  # fmt: skip
                better.append(
                    Record(
                        quantity=f"{way} shift, this project's tracker: {layer} {axis} {name}", unit="px",
                        **over(value[ours]),
                    )
                )  # fmt: skip
    return Outcome(records=[*records, *better], panels=_histograms(bench, protocol, "x"), notes=(_note(protocol),))


def _figure(found: Found, layer: str, axis: str, number: int) -> float:
    shift = samples(found, layer)[:, AXES.index(axis)]
    return float(shift.mean() if number == 0 else shift.std(ddof=1))


def _note(protocol: Protocol) -> str:
    which = "the rest picture itself" if protocol.exposure == 0 else "a second exposure at rest"
    text = "" if protocol is KAMIYAMA else " The paper's section IV rounds its table to 0.15 px."
    return (
        f"Digital: {which}, displaced by {protocol.shift_px} px in the computer, windows fixed on the rest state. "
        "Re-rendered: every marker moved so that its centre shifts by as much, filmed anew with noise of its own. A "
        "displaced picture takes its mosaic, lines and compression along and so hides what they do to a moving "
        f"marker.{text}"
    )


def _histograms(bench: Bench, protocol: Protocol, axis: str) -> list[HistogramPanel]:
    k = AXES.index(axis)
    panels = []
    for layer in ("red", "blue"):
        shifts = {f"{way}": samples(_found(bench, protocol, way, bench.seed), layer)[:, k] for way in WAYS}
        centre = protocol.shift_px if axis == "x" else 0.0
        reach = max(0.1, 1.1 * max(float(np.abs(s - centre).max()) for s in shifts.values()))
        average, _ = protocol.paper[layer, axis]
        panels.append(
            HistogramPanel(
                title=f"{layer}, {axis}: the paper's tracker", samples=shifts, across=f"measured {axis} shift (px)",
                bounds=(centre - reach, centre + reach), marked={"paper's average": average},
            )
        )  # fmt: skip
    return panels


def _kamiyama_figure_7(bench: Bench) -> Outcome:
    found = _found(bench, KAMIYAMA, "digital", bench.seed)
    again = _found(bench, KAMIYAMA, "re-rendered", bench.seed)
    panels = []
    for way, one in (("digital", found), ("re-rendered", again)):
        colours = ["#c22f26" if name == "red" else "#2161c2" for name in one.layer]
        panels.append(
            ArrowPanel(
                title=f"3 px to the right, {way}",
                tails_px=one.rest_px,
                shifts_px=one.shift_px,
                colours=colours,
                magnified=5.0,
            )
        )
    records = []
    for way in WAYS:
        runs = [_found(bench, KAMIYAMA, way, seed) for seed in bench.seeds("kamiyama")]
        records += [
            Record(
                quantity=f"{way} shift: share of markers with a vector", unit="",
                **over(float(f.seen.mean()) for f in runs),
            ),
            Record(
                quantity=f"{way} shift: root mean square error of a vector", unit="px",
                **over(_rms(f, 3.0) for f in runs),
            ),
        ]  # fmt: skip
    return Outcome(records=records, panels=panels)


def _rms(found: Found, shift_px: float) -> float:
    error = found.shift_px[found.seen] - (shift_px, 0.0)
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def _widest(bench: Bench, way: Way, seed: int, layer: str, axis: str, centre: float, cause: str = "") -> float:
    shift = samples(_found(bench, KAMIYAMA, way, seed, cause), layer)[:, AXES.index(axis)]
    return float(np.abs(shift - centre).max())


def _kamiyama_figure_8(bench: Bench) -> Outcome:
    records = []
    for way in WAYS:
        for layer in ("blue", "red"):
            for axis, centre in (("x", 3.0), ("y", 0.0)):
                widest = [_widest(bench, way, seed, layer, axis, centre) for seed in bench.seeds("kamiyama")]
                without = {c: _widest(bench, way, bench.seed, layer, axis, centre, c) for c in OFF}
                records.append(
                    Record(
                        quantity=f"{way} shift: largest deviation, {layer} {axis}", unit="px", paper=0.4,
                        **over(widest), explained_by=causes(without),
                    )
                )  # fmt: skip
    panels = _histograms(bench, KAMIYAMA, "x") + _histograms(bench, KAMIYAMA, "y")
    return Outcome(records=records, panels=panels, notes=(_note(KAMIYAMA),))


KAMIYAMA_TABLE_1 = Entry(
    name="kamiyama/table-1",
    title="A picture displaced by 3 px: average and standard deviation of the measured movement",
    source="Kamiyama, section 4.2, Table 1",
    protocol="A picture at rest is displaced by 3 px to the right, and the movement of every marker is measured "
    "between the two; blue and red, x and y.",
    run=lambda bench: _table(bench, KAMIYAMA),
)
KAMIYAMA_FIGURE_7 = Entry(
    name="kamiyama/fig-7",
    title="Movement vectors from a displaced picture",
    source="Kamiyama, section 4.2, Fig. 7",
    protocol="As for Table 1; the vector of every marker is drawn.",
    run=_kamiyama_figure_7,
)
KAMIYAMA_FIGURE_8 = Entry(
    name="kamiyama/fig-8",
    title="Histograms of the measured movement",
    source="Kamiyama, section 4.2, Fig. 8, and section 5.1: a spread of about 0.4 px at most",
    protocol="As for Table 1; the distribution over the markers by layer and axis.",
    run=_kamiyama_figure_8,
)
SATO_TABLE_1 = Entry(
    name="sato/table-1",
    title="A second exposure displaced by 5 px: average and standard deviation of the measured movement",
    source="Sato, section III A, Table I",
    protocol="Two pictures at rest; the second is displaced by 5 px along x, and the movement of every marker is "
    "measured.",
    run=lambda bench: _table(bench, SATO),
)
