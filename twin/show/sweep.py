"""The page of a sweep: fronts, maps, sensitivity, and the best designs with their pictures and fields."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.show import plots
from twin.show.page import page
from twin.show.sweep_map import Map, map_figure
from twin.show.words import digits, table

MOST_DOTS = 3000
"""Dots of a drawing; of more designs every so-and-so-many-th is drawn, and the front."""

FAR = 0.6
"""How far outside the designs a target is drawn, in their ranges: a farther one would press them into a corner."""


@dataclass(frozen=True, kw_only=True)
class Front:
    """Designs by two metrics.

    Attributes
    ----------
    across, up
        Names, with units.
    x, y
        (m,) values.
    on_front
        (m,) whether no other design is better in both.
    target
        (x, y) asked for; NaN where nothing is.
    """

    across: str
    up: str
    x: Floats
    y: Floats
    on_front: Bools
    target: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Card:
    """One of the best designs.

    Attributes
    ----------
    heading, words, file
        Its number, its values and figures, and its scene's file.
    picture
        PNG under the push in the middle; None without the full chain.
    fields
        (name, sites (k, 3) mm, forces (k, 3) N).
    """

    heading: str
    words: str
    file: str
    picture: bytes | None = None
    fields: Sequence[tuple[str, Points, Floats]] = ()


@dataclass(frozen=True, kw_only=True)
class SweepPage:
    """Everything that the page shows.

    Attributes
    ----------
    title, verdict
        Of the sweep.
    alarms
        What a reader must know first.
    notes
        What was reused, and how well the fidelities agree.
    counts
        Designs by what became of them.
    dropped
        Designs by the reason for which they were dropped or failed.
    fronts, maps, cards
        See their classes.
    sensitivity
        (metric, axis, first, total, rank correlation).
    recipe
        The sweep, as TOML.
    """

    title: str
    verdict: str
    alarms: list[str] = field(default_factory=list)
    notes: Sequence[str] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)
    fronts: Sequence[Front] = ()
    maps: Sequence[Map] = ()
    cards: Sequence[Card] = ()
    sensitivity: Sequence[tuple[str, str, float, float, float]] = ()
    recipe: str = ""


def sweep_page(told: SweepPage) -> str:
    """Return the page (HTML), one file."""
    sections = [
        ("Best designs", _cards(told.cards)),
        ("Fronts", _fronts(told.fronts)),
        ("Maps", _maps(told.maps)),
        ("What matters", _sensitivity(told.sensitivity)),
        ("Fidelities and reuse", "".join(f'<p class="note">{escape(note)}</p>' for note in told.notes)),
        ("What became of the designs", _counts(told)),
    ]
    return page(told.title, told.verdict, told.alarms, sections, told.recipe)


def _cards(cards: Sequence[Card]) -> str:
    out = []
    for card in cards:
        parts = []
        if card.picture is not None:
            data = base64.b64encode(card.picture).decode()
            parts.append(
                f'<figure><img src="data:image/png;base64,{data}" alt="CCD picture of {escape(card.heading)} under the '
                'push in the middle"><figcaption>Picture under the push in the middle</figcaption></figure>'
            )
        parts += [_field(name, sites, force) for name, sites, force in card.fields]
        out.append(
            f"<h3>{escape(card.heading)}</h3><p>{escape(card.words)}</p>"
            f'<p class="note">Ready to run, in this page&rsquo;s folder: <code>twin run {escape(card.file)}</code></p>'
            f'<div class="two">{"".join(parts)}</div>'
        )
    return "".join(out)


def _field(name: str, sites: Points, force: Floats) -> str:
    """Return the drawing of a field: colour is the force along z, arrows those along x and y."""
    low, high = sites[:, :2].min(axis=0), sites[:, :2].max(axis=0)
    apart = np.linalg.norm(sites[1:, :2] - sites[:1, :2], axis=1)
    side = float(apart.min()) if len(apart) else 1.0
    axes = plots.Axes.equal(float(low[0] - side), float(high[0] + side), float(low[1] - side), float(high[1] + side))
    largest = float(np.abs(force[:, 2]).max()) or 1.0
    content = plots.cells(axes, sites[:, :2], side, force[:, 2], largest)
    content += plots.arrows(axes, sites[:, :2], force[:, :2] * side * 1.5 / largest, "force")
    svg = plots.drawing(axes, content, "x (mm)", "y (mm)", f"Force field, {name}")
    return f"<figure>{svg}<figcaption>{escape(name)}; darkest is {digits(largest)} N a site</figcaption></figure>"


def _fronts(fronts: Sequence[Front]) -> str:
    drawn = []
    for front in fronts:
        known = np.isfinite(front.x) & np.isfinite(front.y)
        if known.sum() < 2 or min(np.ptp(v[known]) for v in (front.x, front.y)) == 0:
            continue
        x, y = front.x[known], front.y[known]
        # a few hopeless designs must not press all others into a corner
        ends = [(float(v.min()), float(np.quantile(v, 0.95))) for v in (x, y)]
        targets = [t if a - FAR * (b - a) <= t <= b + FAR * (b - a) else np.nan
                   for t, (a, b) in zip(front.target, ends, strict=True)]  # fmt: skip
        for k, target in enumerate(targets):
            if np.isfinite(target):
                ends[k] = (min(ends[k][0], target), max(ends[k][1], target))
        (left, right), (bottom, top) = [(a - 0.05 * (b - a) - 1e-12, b + 0.05 * (b - a) + 1e-12) for a, b in ends]
        axes = plots.Axes(left=left, right=right, bottom=bottom, top=top, height=280)
        shown = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
        step = max(1, int(shown.sum()) // MOST_DOTS)
        points = np.column_stack([x, y])
        content = plots.dots(axes, points[shown][::step], "dot other", 2.2)
        on = points[shown & front.on_front[known]]
        on = on[np.argsort(on[:, 0])]
        if len(on):
            content += plots.line(axes, on, "profile estimate") + plots.dots(axes, on, "dot red", 3.2)
        for k, target in enumerate(targets):
            if np.isfinite(target):
                ends_of = [[target, bottom], [target, top]] if k == 0 else [[left, target], [right, target]]
                content += plots.line(axes, np.array(ends_of), "contact")
        svg = plots.drawing(axes, content, front.across, front.up, f"{front.up} against {front.across} of all designs")
        drawn.append(
            f"<figure>{svg}<figcaption>Each dot is a design; red ones are bettered by none in both. The worst "
            f"twentieth lies outside. {_said(front, targets)}</figcaption></figure>"
        )
    return f'<div class="two">{"".join(drawn)}</div>' if drawn else ""


def _said(front: Front, drawn: Sequence[float]) -> str:
    """Return what to say of a front's targets, those that are too far away to be drawn in numbers."""
    said = ["Dashed: the targets."] if np.isfinite(drawn).any() else []
    for name, target, shown in zip((front.across, front.up), front.target, drawn, strict=True):
        if np.isfinite(target) and not np.isfinite(shown):
            said.append(f"Wanted {escape(name)}: {digits(float(target))}, far from here.")
    return " ".join(said)


def _maps(maps: Sequence[Map]) -> str:
    drawn = [figure for each in maps if (figure := map_figure(each))]
    return f'<div class="two">{"".join(drawn)}</div>' if drawn else ""


def _sensitivity(rows: Sequence[tuple[str, str, float, float, float]]) -> str:
    if not rows:
        return ""
    cells = [
        (f"{metric}: {axis}", [f"{first:.2f}", f"{total:.2f}", f"{rank:+.2f}" if np.isfinite(rank) else "–"])
        for metric, axis, first, total, rank in rows
    ]
    caption = (
        "Share of the variance of the metric's logarithm that an axis makes alone and with the others (Sobol' indices "
        "by the closed form), and rank correlation of axis and metric over this sweep's designs"
    )
    return table(caption, ["alone", "with others", "rank correlation"], cells)


def _counts(told: SweepPage) -> str:
    rows = [(kind, [str(count)]) for kind, count in told.counts.items()]
    rows += [(reason, [str(count)]) for reason, count in told.dropped.items()]
    return table("Designs", ["number"], rows)
