"""What all reports share: the page around them with its colours, tables, plots, and numbers in
words.

A page is one file without scripts that loads nothing. It fits light and dark screens (`LIGHT`,
`DARK`), laptops, phones and paper (``page.css``).

Plots are inline SVG: `Axes` draws arrows, dots, cells and lines, and maps of marker arrows. Lengths
inside a drawing are in view units: every drawing is `VIEW` of them wide, at any size on the screen.

Why no plotting library: the seven drawings of a report take matplotlib .7 s including its import,
ten times as long as the rest of the report. An inline drawing is sharp on every screen, has the
page's light or dark colours, and its text can be searched.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from twin.arrays import Floats, Picture, eight_bits, nice
from twin.parts.part import UNITS

_UNITS = {**UNITS, "deg": "°", "s": "s", "mm2": "mm²", "mm3": "mm³"}
"""Unit of a key by its suffix."""

_SHARES = (
    *("_error", "_error_normal", "_error_tangential", "_error_axes"),
    *("matched", "share", "ratio", "_strain", "_residual", "_stated"),
    *("_over_probe_radius", "_over_thickness"),
)
"""Endings of keys that hold a ratio, in percent."""

_ROUND_OFF = 1e-9
"""Numbers below this are shown as 0: what a sum of doubles leaves is round-off."""


def digits(value: float) -> str:
    """Return a number with three significant digits and a true minus sign."""
    text = f"{value:.3g}"
    if "e+" in text and abs(value) < 1e6:
        text = f"{value:.0f}"
    return text.replace("-", "−")


class Unit:
    """The unit in which a number of a run is shown, by its key: ``contact_radius_mm`` in mm.

    Attributes
    ----------
    words, name
        Of the key without its unit, and of the unit; this is empty of a bare number.
    times
        The size of a stored number in that unit: 100 of a ratio, which is shown in percent.
    """

    def __init__(self, key: str) -> None:
        stem, _, suffix = key.rpartition("_")
        self.words = key.replace("_", " ")
        self.name = ""
        self.times = 1.0
        if stem and suffix in _UNITS:
            self.words = stem.replace("_", " ")
            self.name = _UNITS[suffix]
        elif key.endswith(_SHARES):
            self.name = "%"
            self.times = 100.0

    def amount(self, value: float) -> str:
        """Return a number in words: ``1.2 %``, ``0.05 mm``, ``3``; whole numbers are counts."""
        if isinstance(value, int) and self.times != 1.0:
            return digits(value)
        if self.name and abs(value) < _ROUND_OFF:
            value = 0.0
        return f"{digits(self.times * value)} {self.name}".rstrip()


def finite(value: Any) -> float | None:
    """Return a number, the largest finite one of a list of them, or None if there is none."""
    if isinstance(value, bool) or value is None or isinstance(value, str | Mapping):
        return None
    if isinstance(value, Sequence | np.ndarray):
        numbers = [n for n in map(finite, value) if n is not None]
        return max(numbers, key=abs) if numbers else None
    return float(value) if math.isfinite(value) else None


def table(caption: str, heads: list[str], rows: list[tuple[str, list[str]]]) -> str:
    """Return a table as HTML: ``heads`` over the columns, each row a name and its cells (all
    HTML)."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "".join(
        f'<tr><th scope="row">{name}</th>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
        for name, cells in rows
    )
    return (
        f'<div class="wide"><table class="numbers"><caption>{caption}</caption>'
        f"<thead><tr><td></td>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def figure(drawing: str, caption: str, style: str = "") -> str:
    """Return a drawing with its caption (HTML both); ``style`` is the figure's class."""
    begin = f'<figure class="{style}">' if style else "<figure>"
    return f"{begin}{drawing}<figcaption>{caption}</figcaption></figure>"


def small_picture(picture: Picture) -> str:
    """Return a picture as the source of an image: WebP, to look at, a tenth of the PNG's bytes."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(eight_bits(picture)).save(file, "WEBP", quality=80)
    return f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}"


def two_columns(figures: Sequence[str], three: bool = False) -> str:
    """Return figures in two columns, or ``three`` on a wide page; empty without any."""
    kind = "two three" if three else "two"
    return f'<div class="{kind}">{"".join(figures)}</div>' if figures else ""


LIGHT = (
    "--paper:#fcfcfa;--ink:#1d2126;--soft:#5a626b;--line:#d8dcdf;--panel:#f2f3f0;--red:#c22f26;"
    "--blue:#2161c2;"
    "--other:#5a626b;--push:#d8660a;--pull:#6a3fa0;--bar:#7d8894;--alarm:#9a3412"
)
DARK = (
    "--paper:#14171a;--ink:#e6e8ea;--soft:#9ba4ad;--line:#353b42;--panel:#1d2125;--red:#ff7b6f;"
    "--blue:#72a9ff;"
    "--other:#9ba4ad;--push:#ff9a3d;--pull:#b18cf2;--bar:#7d8894;--alarm:#fdba74"
)

STYLE = Template(Path(__file__).with_name("page.css").read_text(encoding="utf-8")).substitute(
    light=LIGHT, dark=DARK
)
"""Style sheet of every page."""


def page(
    title: str,
    verdict: str,
    alarms: Sequence[str],
    sections: Sequence[tuple[str, str]],
    scene: str = "",
    *,
    body: str = "",
    style: str = "",
) -> str:
    """Return the whole page of plain texts, sections (a plain heading and HTML, left out where
    empty), and more HTML, ``body``, with its style sheet."""
    parts = [
        f"<section><h2>{escape(heading)}</h2>{content}</section>"
        for heading, content in sections
        if content
    ]
    warnings = "".join(f'<p class="alarm">{escape(alarm)}</p>' for alarm in alarms)
    details = (
        f"<details><summary>The resolved scene</summary><pre>{escape(scene)}</pre></details>"
        if scene.strip()
        else ""
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}{style}</style></head>\n"
        f"<body><main><header><h1>{escape(title)}</h1><p "
        f'class="verdict">{escape(verdict)}</p>{warnings}</header>\n'
        + "\n".join(parts)
        + f"\n{details}{body}</main></body></html>\n"
    )


VIEW = 480
"""Width of every drawing: near its size in a column of a laptop's page, so that letters keep their
size."""

LEFT = 54
RIGHT = 10
TOP = 8
BOTTOM = 44
"""Margins for tick labels and axis names; wide enough for the larger letters that a phone is
given."""

FIT, WIDE = 2, 9
"""Letters of the vertical axis's ticks that fit the left margin next to the axis's name, and the
width of each more."""

SHORTEST = 0.3
"""Arrows below this many view units are not drawn: they can't be seen and their direction is
noise."""


@dataclass(frozen=True, kw_only=True)
class Axes:
    """A window of data coordinates, and its drawing's height in view units: a picture has its
    largest row at the ``bottom``, a map its smallest y. The width is fixed by `VIEW` and the
    margins."""

    left: float
    right: float
    bottom: float
    top: float
    height: float

    @classmethod
    def equal(cls, left: float, right: float, bottom: float, top: float) -> Axes:
        """Return axes on which one unit is equally long in both directions."""
        width = VIEW - LEFT - RIGHT
        return cls(
            left=left,
            right=right,
            bottom=bottom,
            top=top,
            height=width * abs(top - bottom) / abs(right - left),
        )

    @classmethod
    def force_field(
        cls, sites: Floats, force: Floats, side: float, largest: float, per_cell: float
    ) -> tuple[Axes, str, str]:
        """Return axes around (k, 2) sites, mm, squares of a ``side`` coloured by (k, 3) forces
        along z, N, full at ``largest``, and arrows of those along x and y, a cell long at
        ``per_cell``."""
        (left, low), (right, high) = sites.min(axis=0), sites.max(axis=0)
        axes = Axes.equal(left - side, right + side, low - side, high + side)
        colours = axes.cells(sites, side, force[:, 2], largest)
        return axes, colours, axes.arrows(sites, force[:, :2] * side / per_cell, "force")

    def place(self, points: Floats) -> Floats:
        """Return the (n, 2) view coordinates, to the right and down, of (n, 2) data points."""
        across = (points[:, 0] - self.left) / (self.right - self.left)
        down = (self.top - points[:, 1]) / (self.top - self.bottom)
        return np.column_stack([LEFT + across * (VIEW - LEFT - RIGHT), TOP + down * self.height])

    @property
    def per_unit(self) -> float:
        """View units per data unit along the horizontal axis."""
        return (VIEW - LEFT - RIGHT) / abs(self.right - self.left)

    def drawing(self, content: str, across: str, up: str, label: str) -> str:
        """Return the SVG of ``content``, of `arrows`, `cells` and the like, with frame, ticks and
        axis names; ``label`` stands for it for a reader who can't see it."""
        height = self.height + TOP + BOTTOM
        floor = TOP + self.height
        right = VIEW - RIGHT
        marks, text = [], []
        for value in _ticks(self.left, self.right):
            x, _ = self.place(np.array([[value, self.top]]))[0]
            marks.append(f"M{x:.1f} {floor:.1f}v4")
            text.append(
                f'<text x="{x:.1f}" y="{floor + 18:.1f}" text-anchor="middle">{value:g}</text>'
            )
        upwards = {value: f"{value:g}" for value in _ticks(self.bottom, self.top, 5)}
        more = WIDE * max(0, max(map(len, upwards.values()), default=0) - FIT)
        for value, words in upwards.items():
            _, y = self.place(np.array([[self.left, value]]))[0]
            marks.append(f"M{LEFT} {y:.1f}h-4")
            text.append(f'<text x="{LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{words}</text>')
        middle = TOP + self.height / 2
        text.append(
            f'<text x="{(LEFT + right) / 2}" y="{height - 5:.1f}" '
            f'text-anchor="middle">{escape(across)}</text>'
        )
        turned = (
            f'x="{14 - more}" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 '
            f'{14 - more} {middle:.1f})"'
        )
        text.append(f"<text {turned}>{escape(up)}</text>")
        frame = f"M{LEFT} {TOP}H{right}V{floor:.1f}H{LEFT}z{''.join(marks)}"
        return (
            f'<svg viewBox="{-more} 0 {VIEW + more} {height:.0f}" role="img" '
            f'aria-label="{escape(label)}">{content}'
            f'<path class="frame" d="{frame}"/>{"".join(text)}</svg>'
        )

    def arrows(self, tails: Floats, vectors: Floats, style: str) -> str:
        """Return one path with the arrows ``vectors`` (n, 2) at ``tails`` (n, 2); rows with NaN are
        left out."""
        known = np.isfinite(tails).all(axis=1) & np.isfinite(vectors).all(axis=1)
        starts = self.place(tails[known])
        ends = self.place(tails[known] + vectors[known])
        steps = []
        for (x0, y0), (x1, y1) in zip(starts.tolist(), ends.tolist(), strict=True):
            dx, dy = x1 - x0, y1 - y0
            length = math.hypot(dx, dy)
            if length < SHORTEST:
                continue
            # a head of 40 degrees, shorter on short arrows so that it never hides the shaft
            head = min(0.35 * length, 5.0) / length
            a, b = head * dx, head * dy
            steps.append(
                f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}m{-a - 0.36 * b:.1f} "
                f"{-b + 0.36 * a:.1f}L{x1:.1f} {y1:.1f}l{-a + 0.36 * b:.1f} {-b - 0.36 * a:.1f}"
            )
        return _path(steps, style)

    def crosses(self, points: Floats) -> str:
        """Return one path with an x at each of the (n, 2) ``points``, which were lost."""
        steps = [
            f"M{x - 3.0:.1f} {y - 3.0:.1f}l6 6m0 -6l-6 6"
            for x, y in self.place(points[np.isfinite(points).all(axis=1)]).tolist()
        ]
        return _path(steps, "lost")

    def dots(self, points: Floats, style: str, radius: float) -> str:
        """Return one path with a filled circle at each of the (n, 2) ``points``."""
        steps = [
            f"M{x - radius:.1f} {y:.1f}a{radius:g} {radius:g} 0 1 0 {2 * radius:g} 0"
            f"a{radius:g} {radius:g} 0 1 0 {-2 * radius:g} 0"
            for x, y in self.place(points[np.isfinite(points).all(axis=1)]).tolist()
        ]
        return _path(steps, style)

    def segments(self, ends: Sequence[list[list[float]]], style: str) -> str:
        """Return one path with a line between each of the (n, 2, 2) pairs of points."""
        steps = []
        for pair in ends:
            (x0, y0), (x1, y1) = self.place(np.array(pair)).tolist()
            steps.append(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")
        return _path(steps, style)

    def line(self, points: Floats, style: str) -> str:
        """Return a polyline through the (n, 2) ``points``."""
        steps = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.place(points).tolist())
        return f'<polyline class="{style}" points="{steps}"/>'

    def cells(self, centres: Floats, side: float, values: Floats, largest: float) -> str:
        """Return a square for each of the (n, 2) ``centres``, ``push`` or ``pull`` by sign. Its
        opacity over the page's background is its size, so that nothing looks like nothing in light
        and dark."""
        half = side * self.per_unit / 2
        squares = []
        for (x, y), value in zip(self.place(centres).tolist(), values.tolist(), strict=True):
            share = min(abs(value) / largest, 1.0) if largest > 0 else 0.0
            if share >= 0.005:
                squares.append(
                    f'<rect class="{"push" if value > 0 else "pull"}" x="{x - half:.2f}" '
                    f'y="{y - half:.2f}" '
                    f'width="{2 * half:.2f}" height="{2 * half:.2f}" fill-opacity="{share:.2f}"/>'
                )
        return "".join(squares)


def _ticks(low: float, high: float, about: int = 6) -> list[float]:
    """Return round values between ``low`` and ``high``, roughly ``about`` of them."""
    low, high = min(low, high), max(low, high)
    step = nice((high - low) / about * 1.5)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def _path(steps: Sequence[str], style: str) -> str:
    """Return one path of SVG steps, of a class; empty without steps."""
    return f'<path class="{style}" d="{"".join(steps)}"/>' if steps else ""
