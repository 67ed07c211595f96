"""A contact sheet of a dataset: a page of pictures with the truth drawn in."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats, Pixels

GAIN = 4.0
"""Times by which the markers' shifts are drawn longer."""


@dataclass(frozen=True, kw_only=True)
class Card:
    """One sample of the sheet.

    Attributes
    ----------
    title
        Number, probe and force, in words.
    png
        The picture; None where there is none.
    size_px
        Its width and height.
    rest_px, pressed_px
        (n, 2) markers.
    contact_px
        (k, 2) places in contact, seen by the camera.
    error
        Why it failed, if it did.
    """

    title: str
    png: bytes | None
    size_px: tuple[int, int]
    rest_px: Pixels
    pressed_px: Pixels
    contact_px: Pixels
    error: str | None = None


def sheet(title: str, facts: Sequence[str], cards: Sequence[Card]) -> str:
    """Return a self-contained HTML page."""
    said = "".join(f"<li>{html.escape(fact)}</li>" for fact in facts)
    body = "".join(_card(card) for card in cards)
    return f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>
<style>body{{font:14px system-ui,sans-serif;margin:1.5em;background:#fafafa;color:#222}}
main{{display:grid;grid-template-columns:repeat(auto-fill,minmax(330px,1fr));gap:14px}}
figure{{margin:0;background:#fff;border:1px solid #ddd;border-radius:4px;overflow:hidden}}
figcaption{{padding:6px 8px;font-size:12px}}svg{{display:block;width:100%;background:#111}}
.bad{{color:#a00;padding:20px 8px}}</style>
<h1>{html.escape(title)}</h1><ul>{said}</ul>
<p>Lines: shift of each marker, {GAIN:g} times as long as it is. Yellow: where the body is touched.</p>
<main>{body}</main></html>
"""


def _card(card: Card) -> str:
    width, height = card.size_px
    caption = f"<figcaption>{html.escape(card.title)}</figcaption>"
    if card.error is not None:
        return f'<figure><div class="bad">{html.escape(card.error)}</div>{caption}</figure>'
    parts = []
    if card.png is not None:
        data = base64.b64encode(card.png).decode()
        parts.append(f'<image href="data:image/png;base64,{data}" width="{width}" height="{height}"/>')
    parts += [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="#fd0" opacity=".55"/>' for x, y in _finite(card.contact_px)
    ]
    lines = np.column_stack([card.rest_px, card.rest_px + GAIN * (card.pressed_px - card.rest_px)])
    path = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in _finite(lines))
    parts.append(f'<path d="{path}" stroke="#4f8" stroke-width="1.6" fill="none"/>')
    return f'<figure><svg viewBox="-0.5 -0.5 {width} {height}">{"".join(parts)}</svg>{caption}</figure>'


def _finite(rows: Floats) -> Any:
    return rows[np.isfinite(rows).all(axis=1)] if len(rows) else rows
