"""The page of a reproduction: every table and figure of the papers with the twin's numbers; and
the drawings of one entry (`Panel`).

The page is made from the files of the entries alone, so an interrupted reproduction has a page of
the entries that are finished.
"""

from __future__ import annotations

import base64
import io
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from twin.arrays import Floats, Picture, Pixels, Points
from twin.display import plot_forces, plot_shifts
from twin.show.html_page import digits, page

PAPERS = {
    "kamiyama": "Flat sensor (Kamiyama et al., A Vision-based Tactile Sensor)",
    "sato": "Finger (Sato et al., Measurement of Force Vector Field of Robotic Finger)",
    "beyond": "Beyond the papers",
}


_LEAST_PX = 1e-4
"""Places of pixels are shown to this: a mean over all markers is hardly better known."""


def _known(value: float, unit: str) -> str:
    """Return a number's digits; of pixels without those that mean nothing."""
    if unit == "px" and abs(value) < 100 * _LEAST_PX:
        value = round(value / _LEAST_PX) * _LEAST_PX
    return digits(value)


def _difference(record: Mapping[str, Any]) -> float | None:
    """Return twin less paper, to three digits of the paper's number."""
    value: float | None = record["difference"]
    paper: float | None = record["paper"]
    if value is None or not paper:
        return value
    return round(value, 2 - math.floor(math.log10(abs(paper))))


def reproduction(
    tables: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, Sequence[tuple[str, bytes]]],
    sensors: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str],
    short: Mapping[str, Sequence[str]],
    unprinted: Sequence[Mapping[str, Any]],
    *,
    seed: int,
    quick: bool,
    renderer: str = "auto",
) -> str:
    """Return the page as one self-contained HTML file.

    ``tables`` are the entries' files in order, ``pictures`` titles and SVG by entry, ``sensors``
    scene, hash and what was fitted by paper, ``failed`` the reason by entry that could not be
    finished, ``short`` the sentences of the first screen by heading, ``unprinted`` what no paper
    prints, as `twin.study.reproduce.record.Record.settled` has it.
    """
    from jinja2 import Environment, FileSystemLoader

    made = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    made.filters |= {"digits": digits, "base64": lambda data: base64.b64encode(data).decode()}
    made.filters |= {"known": _known, "difference": _difference}
    both = [(table, record) for table in tables for record in table["records"]]
    verdicts = [
        r["verdict"] for _, r in both if r["paper"] is not None and not r["timed"] and not r["ours"]
    ]
    explained = [verdict for verdict in verdicts if "explained by:" in verdict]
    counts = {
        "printed": len(verdicts),
        "agree": verdicts.count("agrees"),
        "explained": len(explained),
        "unprinted": sum(" is plausible)" in verdict for verdict in explained),
        "read": sum("explained by: reading" in verdict for verdict in explained),
    }
    body = made.get_template("reproduction_page.html").render(
        tables=tables,
        pictures=pictures,
        sensors=sensors,
        short=short,
        unprinted=unprinted,
        counts=counts,
        left=[pair for pair in both if pair[1]["verdict"].startswith(("disagrees", "ruled out"))],
        papers=PAPERS,
    )
    form = "quick form: one made sensor, fewer steps" if quick else "full form"
    verdict = (
        "Every number went through contact, picture, CCD, tracking and inverse of a made sensor "
        f"that differs from its drawing. Seed {seed}, {form}, renderer {renderer}."
    )
    alarms = [f"{name} could not be finished: {reason}" for name, reason in failed.items()]
    title = "The papers' tables and figures, made again"
    style = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    return page(title, verdict, alarms, [], body=body, style=style)


class _Shifts(Protocol):
    """Tracked markers, such as `twin.sense.track.Found`."""

    @property
    def layer(self) -> np.ndarray: ...

    @property
    def rest_px(self) -> Pixels: ...

    @property
    def shift_px(self) -> Pixels: ...


class _Forces(Protocol):
    """A force field, such as `twin.sense.reconstruct.Field`."""

    @property
    def site_mm(self) -> Points: ...

    @property
    def force_n(self) -> Points: ...


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A drawing with a title; ``draw`` puts it on matplotlib axes."""

    title: str
    draw: Callable[[Any], object]

    @classmethod
    def curves(
        cls,
        title: str,
        across: str,
        up: str,
        curves: Mapping[str, Sequence[Any]],
        *,
        levels: Mapping[str, float] | None = None,
        logarithmic: bool = False,
    ) -> Panel:
        """Return the drawing of curves, (n,) x, (n,) y and a style of matplotlib's, by name;
        ``levels`` are horizontal lines by name. Whole numbers x are counted."""

        def draw(axes: Any) -> None:
            if all(np.asarray(x).dtype.kind == "i" for x, *_ in curves.values()):
                axes.xaxis.get_major_locator().set_params(integer=True)
            for label, curve in curves.items():
                axes.plot(*curve, ms=4, label=label)
            for label, value in (levels or {}).items():
                axes.axhline(value, color=_INK, ls="--", lw=1, label=label)
            if logarithmic:
                axes.set_yscale("log")
            axes.set(xlabel=across, ylabel=up)

        return cls(title=title, draw=draw)

    @classmethod
    def strips(cls, title: str, across: str, values: Mapping[str, Floats]) -> Panel:
        """Return the drawing of (n,) positive values on a logarithmic axis, a row of dots by
        name."""

        def draw(axes: Any) -> None:
            for row, each in enumerate(values.values()):
                axes.plot(each, np.full(len(each), row), "o", ms=6, alpha=0.6)
            names = ["\n".join(textwrap.wrap(name, 26)) for name in values]
            axes.set_yticks(range(len(names)), names)
            axes.set(xscale="log", xlabel=across, ylim=(len(names) - 0.5, -0.5))
            axes.grid(axis="y", lw=0.5)

        return cls(title=title, draw=draw)

    @classmethod
    def picture(cls, title: str, picture: Picture, marks_px: Pixels | None = None) -> Panel:
        """Return the drawing of a CCD picture (h, w, 3) uint8 with (n, 2) marked places, px."""

        def draw(axes: Any) -> None:
            axes.imshow(picture, interpolation="none")
            if marks_px is not None:
                axes.plot(*np.transpose(marks_px), "wx", ms=4)
            axes.set(xlabel="column (px)", ylabel="row (px)")

        return cls(title=title, draw=draw)

    @classmethod
    def shifts(
        cls, title: str, found: _Shifts, layer: str = "", magnified: float | None = None
    ) -> Panel:
        """Return the drawing of a layer's tracked shifts; by default of all layers', as long as the
        distance of neighbours allows."""
        rows = (found.layer == layer) | (layer == "")
        drawn = found.rest_px[rows], found.shift_px[rows], found.layer[rows]

        def draw(axes: Any) -> None:
            plot_shifts(axes, *drawn, factor=magnified)
            axes.set_xlabel(f"column (px); {axes.get_title()}")

        return cls(title=title, draw=draw)

    @classmethod
    def field(
        cls,
        title: str,
        found: _Forces,
        radius_mm: float,
        at_mm: tuple[float, float] = (0.0, 0.0),
    ) -> Panel:
        """Return the drawing of a field, with the circle that is the true contact's border."""
        turn = np.linspace(0.0, 2.0 * np.pi, 60)
        x, y = at_mm

        def draw(axes: Any) -> None:
            plot_forces(axes, found.site_mm, found.force_n, title)
            axes.plot(x + radius_mm * np.cos(turn), y + radius_mm * np.sin(turn), "k--", lw=1)

        return cls(title=title, draw=draw)

    @staticmethod
    def svg(panels: Sequence[Panel]) -> bytes:
        """Return an SVG file of panels, one below the other so that a phone shows their words, for
        light and dark screens; equal panels give equal bytes."""
        import matplotlib
        from matplotlib.figure import Figure

        file = io.BytesIO()
        with matplotlib.rc_context(_STYLE):
            figure = Figure(figsize=(6.4, 4.0 * len(panels)), layout="constrained")
            for number, panel in enumerate(panels, start=1):
                axes = figure.add_subplot(len(panels), 1, number)
                panel.draw(axes)
                axes.set_title("")  # of drawings that have one of their own
                axes.set_title("\n".join(textwrap.wrap(panel.title, 56)), loc="left")
                if axes.get_legend_handles_labels()[1]:
                    axes.legend()
            figure.savefig(file, format="svg", metadata={"Date": None})
        return file.getvalue().replace(b"<defs>", _DARK.encode() + b"<defs>", 1)


_INK, _PAPER = "#1d2126", "#fcfcfa"
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "twin",
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.prop_cycle": "cycler('color', ['0072B2', 'D55E00', '009E73', 'CC79A7', 'E69F00', "
    "'56B4E9'])",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 2.0,
    "legend.fontsize": 9,
    "legend.edgecolor": "none",
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "legend.facecolor"), _PAPER),
    **dict.fromkeys(
        ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), _INK
    ),
}
"""Matplotlib's settings: six colours (Okabe and Ito's) that the colour-blind distinguish."""

_DARK = (
    f"<style>@media (prefers-color-scheme: dark) {{ text, [style*='fill: {_INK}'] {{ fill: #e6e8ea "
    f"!important }} [style*='fill: {_PAPER}'] {{ fill: #14171a !important }} "
    f"[style*='stroke: {_INK}'] {{ stroke: #e6e8ea !important }} }}</style>"
)
