"""What all reports share: the page around them with its colours, tables, and numbers in words.

A page is one file without scripts that loads nothing. It fits light and dark screens (`LIGHT`,
`DARK`), laptops, phones and paper (``page.css``).
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from twin.arrays import Picture, eight_bits
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
