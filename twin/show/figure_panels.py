"""The figures of a reproduction: panels as data, and the SVG file that is drawn from them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from twin.arrays import Floats, Picture, Pixels, Points
from twin.show.html_page import data_uri, digits
from twin.show.svg_plots import (
    LEFT,
    RIGHT,
    TOP,
    VIEW,
    Axes,
    arrows,
    crosses,
    dots,
    drawing,
    force_field,
    line,
)

_RED = "#c22f26"
_BLUE = "#2161c2"
_INK = "#1d2126"
_SOFT = "#5a626b"
_PUSH = "#d8660a"
_CYCLE = (_PUSH, _BLUE, "#2f8f5b", "#6a3fa0", _RED, _SOFT, "#b59a00")
"""Colours of curves in order."""

_STYLE = f"""
svg {{ background: #fff; font-family: system-ui, sans-serif }}
text {{ font-size: 12px; fill: {_SOFT} }} .title {{ font-size: 13px; fill: {_INK} }}
path, polyline {{ stroke-linecap: round; stroke-linejoin: round }}
.frame {{ stroke: #c4c9cd; fill: none }} .push {{ fill: {_PUSH} }} .pull {{ fill: #6a3fa0 }}
"""

_COLUMNS = 2
"""Panels in a row."""

_HEIGHT = 290
"""Of a panel without a scale of its own, view units."""

_ROW = 16
"""Height of a row of text."""

_DOTTED = {":": "1 4", "--": "6 4"}


Key = list[tuple[str, str, str]]
"""Label, colour and pattern of dashes of the entries below a panel."""


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A drawing with a title."""

    title: str

    def draw(self) -> tuple[str, Key]:
        """Return the drawing (SVG) and the entries below it."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class PicturePanel(Panel):
    """A CCD picture, (h, w, 3) uint8, with (n, 2) places marked on it, px."""

    picture: Picture
    marks_px: Pixels | None = None

    def draw(self) -> tuple[str, Key]:
        height, width = self.picture.shape[:2]
        axes = Axes.equal(-0.5, width - 0.5, height - 0.5, -0.5)
        uri, _ = data_uri(self.picture)
        content = (
            f'<image href="{uri}" x="{LEFT}" y="{TOP}" width="{VIEW - LEFT - RIGHT}" '
            f'height="{axes.height:.1f}"/>'
        )
        if self.marks_px is not None:
            content += _stroked("white", crosses(axes, self.marks_px, "mark"), 1)
        return drawing(axes, content, "column (px)", "row (px)", self.title), []


@dataclass(frozen=True, kw_only=True)
class ArrowPanel(Panel):
    """Arrows in the picture from (n, 2) tails along (n, 2) shifts, px, with (n,) colours, drawn
    ``magnified`` times as long.
    """

    tails_px: Pixels
    shifts_px: Pixels
    colours: Sequence[str]
    magnified: float

    def draw(self) -> tuple[str, Key]:
        known = np.isfinite(self.tails_px).all(axis=1) & np.isfinite(self.shifts_px).all(axis=1)
        tails = self.tails_px[known]
        vectors = self.magnified * self.shifts_px[known]
        colours = np.asarray(self.colours, object)[known]
        low = tails.min(axis=0) - 15
        high = tails.max(axis=0) + 15
        axes = Axes.equal(low[0], high[0], high[1], low[1])
        content = "".join(
            _stroked(colour, arrows(axes, tails[mask], vectors[mask], "arrow"), 1.1)
            for colour in dict.fromkeys(colours.tolist())
            if (mask := colours == colour).any()
        )
        across = f"column (px); arrows {self.magnified:g} times"
        return drawing(axes, content, across, "row (px)", self.title), []


@dataclass(frozen=True, kw_only=True)
class HistogramPanel(Panel):
    """Histograms of samples by label, ``bounds`` apart into ``bins``; dashed lines at
    ``marked``."""

    samples: Mapping[str, Floats]
    across: str
    bounds: tuple[float, float]
    bins: int = 40
    marked: Mapping[str, float] = field(default_factory=dict)

    def draw(self) -> tuple[str, Key]:
        edges = np.linspace(*self.bounds, self.bins + 1)
        counts = {
            label: np.histogram(np.clip(samples[np.isfinite(samples)], *self.bounds), edges)[0]
            for label, samples in self.samples.items()
        }
        top = 1.05 * max((int(found.max()) for found in counts.values()), default=1) or 1.0
        axes = Axes(left=edges[0], right=edges[-1], bottom=0.0, top=top, height=_HEIGHT)
        parts: list[str] = []
        key: Key = []
        for (label, found), colour in zip(counts.items(), _CYCLE, strict=False):
            steps = np.column_stack([np.repeat(edges, 2)[1:-1], np.repeat(found, 2)])
            parts.append(_stroked(colour, line(axes, steps, "histogram")))
            key.append((label, colour, ""))
        for label, value in self.marked.items():
            mark = np.array([[value, 0.0], [value, top]])
            parts.append(_stroked(_INK, line(axes, mark, "mark"), 1, _DOTTED["--"]))
            key.append((label, _INK, _DOTTED["--"]))
        return drawing(axes, "".join(parts), self.across, "markers", self.title), key


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line, or dots, through (n,) points."""

    label: str
    x: Floats
    y: Floats
    style: str = "-"
    colour: str | None = None


@dataclass(frozen=True, kw_only=True)
class CurvePanel(Panel):
    """Curves over one axis; ``level`` is a named horizontal line."""

    curves: Sequence[Curve]
    across: str
    up: str
    levels: Mapping[str, float] = field(default_factory=dict)
    logarithmic: bool = False

    def draw(self) -> tuple[str, Key]:
        def scaled(values: Floats) -> Floats:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.log10(values) if self.logarithmic else np.asarray(values, float)

        levels = {label: scaled(np.array([value]))[0] for label, value in self.levels.items()}
        points = [np.column_stack([curve.x, scaled(curve.y)]) for curve in self.curves]
        points = [each[np.isfinite(each).all(axis=1)] for each in points]
        every = np.vstack(
            [*points, *([[each[0, 0], v]] for each in points[:1] for v in levels.values())]
        )
        (left, low), (right, high) = every.min(axis=0), every.max(axis=0)
        wide, tall = 0.04 * (right - left) or 0.5, 0.05 * (high - low) or 0.5
        axes = Axes(
            left=left - wide, right=right + wide, bottom=low - tall, top=high + tall, height=_HEIGHT
        )
        parts: list[str] = []
        key: Key = []
        for number, (curve, each) in enumerate(zip(self.curves, points, strict=True)):
            colour = curve.colour or _CYCLE[number % len(_CYCLE)]
            dashes = next((d for mark, d in _DOTTED.items() if mark in curve.style), "")
            if curve.style.strip("os."):
                parts.append(_stroked(colour, line(axes, each, "curve"), 1.4, dashes))
            if set(curve.style) & set("os."):
                radius = 1.6 if "." in curve.style else 2.4
                parts.append(f'<g fill="{colour}">{dots(axes, each, "dot", radius)}</g>')
            if curve.label:
                key.append((curve.label, colour, dashes))
        for label, value in levels.items():
            level = np.array([[axes.left, value], [axes.right, value]])
            parts.append(_stroked(_INK, line(axes, level, "level"), 1, _DOTTED["--"]))
            key.append((label, _INK, _DOTTED["--"]))
        upwards = _decades(axes.bottom, axes.top) if self.logarithmic else None
        return drawing(axes, "".join(parts), self.across, self.up, self.title, upwards), key


@dataclass(frozen=True, kw_only=True)
class FieldPanel(Panel):
    """Forces (k, 3), N, on sites (k, 3), mm, as squares of a side.

    Colour is the force along z, arrows those along the surface; the dashed contour is the (m, 2)
    border of the true contact.
    """

    site_mm: Points
    force_n: Floats
    side_mm: float
    outline_mm: Floats | None = None

    def draw(self) -> tuple[str, Key]:
        sites = self.site_mm[:, :2]
        force = self.force_n
        largest = float(np.abs(force[:, 2]).max()) or 1.0
        sideways = np.hypot(*force[:, :2].T)
        per_cell = max(float(sideways.max()), 0.1 * largest) / 1.5
        axes, content, pushed = force_field(sites, force, self.side_mm, largest, per_cell)
        content += _stroked(_INK, pushed, 1)
        if self.outline_mm is not None:
            closed = np.vstack([self.outline_mm, self.outline_mm[:1]])
            content += _stroked(_INK, line(axes, closed, "outline"), 1, _DOTTED["--"])
        across = (
            f"x (mm); an arrow of one cell is {per_cell:.2g} N, full colour {largest:.2g} N along z"
        )
        return drawing(axes, content, across, "y (mm)", self.title), []


@dataclass(frozen=True, kw_only=True)
class BarPanel(Panel):
    """Named lengths; ``marks`` are a value to set against each, called ``marked``."""

    values: Mapping[str, float]
    across: str
    marks: Mapping[str, float] = field(default_factory=dict)
    marked: str = ""

    def draw(self) -> tuple[str, Key]:
        names = list(self.values)
        values = np.array(list(self.values.values()), float)
        marks = np.array([self.marks.get(name, np.nan) for name in names], float)
        right = 1.2 * float(np.nanmax(np.concatenate([values, marks, [0.0]]))) or 1.0
        count = len(names)
        axes = Axes(left=0.0, right=right, bottom=count - 0.5, top=-0.5, height=26.0 * count)
        parts: list[str] = []
        for row, (value, mark) in enumerate(zip(values.tolist(), marks.tolist(), strict=True)):
            (x0, y0), (x1, y1) = axes.place(
                np.array([[0.0, row - 0.3], [np.nan_to_num(value), row + 0.3]])
            )
            parts.append(
                f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" '
                f'fill="#7d8894"/>'
            )
            clear = max(np.nan_to_num(value), np.nan_to_num(mark))
            ((x, y),) = axes.place(np.array([[clear, float(row)]]))
            shown = digits(value) if np.isfinite(value) else "not reached"
            parts.append(f'<text x="{x + 6:.1f}" y="{y + 4:.1f}">{shown}</text>')
            if np.isfinite(mark):
                stroke = np.array([[mark, row - 0.42], [mark, row + 0.42]])
                parts.append(_stroked(_PUSH, line(axes, stroke, "mark"), 2.5))
        labels = {float(row): name for row, name in enumerate(names)}
        key: Key = [(self.marked, _PUSH, "")] if self.marks else []
        return drawing(axes, "".join(parts), self.across, "", self.title, labels), key


def drawn(panels: Sequence[Panel]) -> bytes:
    """Return an SVG file of an entry's panels, two in a row."""
    content = []
    top = 0.0
    for row in (panels[i : i + _COLUMNS] for i in range(0, len(panels), _COLUMNS)):
        highest = 0.0
        for column, panel in enumerate(row):
            svg, height = _placed(panel, column * (VIEW + 24.0), top)
            content.append(svg)
            highest = max(highest, height)
        top += highest + 18
    width = min(len(panels), _COLUMNS) * (VIEW + 24) - 24
    size = f'viewBox="0 0 {width} {top:.0f}" width="{width}" height="{top:.0f}"'
    text = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{_STYLE}</style>'
    return (text + "".join(content) + "</svg>").encode()


def _placed(panel: Panel, left: float, top: float) -> tuple[str, float]:
    """Return a panel with title and key at a place of the figure, and its height."""
    svg, key = panel.draw()
    _, _, width, height = map(float, svg.split('viewBox="', 1)[1].split('"', 1)[0].split())
    shown = height * VIEW / width
    parts: list[str] = []
    for text in textwrap.wrap(panel.title, 68):
        top_of = top + 13 + _ROW * len(parts)
        parts.append(f'<text class="title" x="{left + 4}" y="{top_of:.1f}">{escape(text)}</text>')
    above = _ROW * len(parts) + 4
    place = f'x="{left}" y="{top + above:.1f}" width="{VIEW}" height="{shown:.1f}"'
    parts.append(svg.replace("<svg ", f"<svg {place} ", 1))
    for number, (label, colour, dashes) in enumerate(key):
        y = top + above + shown + _ROW * (number + 0.75)
        parts.append(
            f'<path d="M{left + LEFT} {y - 4:.1f}h26" stroke="{colour}" stroke-width="2" '
            f'stroke-dasharray="{dashes}"/>'
            f'<text x="{left + LEFT + 34}" y="{y:.1f}">{escape(label)}</text>'
        )
    return "".join(parts), above + shown + _ROW * len(key) + 4


def _stroked(colour: str, content: str, width: float = 1.4, dashes: str = "") -> str:
    return (
        f'<g stroke="{colour}" fill="none" stroke-width="{width}" '
        f'stroke-dasharray="{dashes}">{content}</g>'
    )


def _decades(low: float, high: float) -> dict[float, str]:
    """Return ticks of a logarithmic axis between two powers of ten."""
    factors = (1, 2, 5) if high - low < 3 else (1,)
    powers = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    values = [factor * 10.0**power for power in powers for factor in factors]
    return {float(np.log10(v)): f"{v:g}" for v in values if low <= np.log10(v) <= high}
