"""The page of a sweep: fronts, maps, sensitivity, and the best designs with pictures and fields."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.show.html_page import digits, figure, page, table, two_columns
from twin.show.svg_plots import Axes, dots, drawing, force_field, line, path

BINS = 14
"""Bins of a map along an axis at most."""


def metric_map(
    *,
    across: str,
    up: str,
    metric: str,
    x: Floats,
    y: Floats,
    value: Floats,
    limit: Floats,
    target: float,
) -> str:
    """Return a map (HTML) of a metric over two axes: its median in every bin, and the borders.

    Parameters
    ----------
    across, up, metric
        Names, with units.
    x, y, value, limit
        (m,) axis values, the metric, and the metric by the design limit.
    target
        Of the metric, where the borders are; NaN if none.
    """
    edges = [_edges(v) for v in (x, y)]
    if min(len(e) for e in edges) < 2:
        return ""
    place = [
        np.clip(np.searchsorted(e, v, side="right") - 1, 0, len(e) - 2)
        for e, v in zip(edges, (x, y), strict=True)
    ]
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    binned, allowed = (_binned(place, v, shape) for v in (value, limit))
    known = np.isfinite(binned)
    if not known.any():
        return ""
    low, high = float(binned[known].min()), float(binned[known].max())
    (left, *_, right), (bottom, *_, top) = (e.tolist() for e in edges)
    axes = Axes(left=left, right=right, bottom=bottom, top=top, height=300)
    parts = []
    for i, j in np.argwhere(known):
        corners = axes.place(
            np.array([[edges[0][i], edges[1][j + 1]], [edges[0][i + 1], edges[1][j]]])
        )
        (x0, y0), (x1, y1) = corners.tolist()
        share = 1.0 - (binned[i, j] - low) / (high - low) if high > low else 1.0
        parts.append(
            f'<rect class="push" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" '
            f'height="{y1 - y0:.1f}" fill-opacity="{0.05 + 0.9 * share:.2f}">'
            f"<title>{binned[i, j]:.3g}</title></rect>"
        )
    if np.isfinite(target):
        parts.append(_border(axes, edges, allowed <= target, "contact"))
        parts.append(_border(axes, edges, binned <= target, "force"))
    words = f"{metric} over {across} and {up}"
    svg = drawing(axes, "".join(parts), across, up, words)
    border = ""
    if np.isfinite(target):
        border = (
            f" Inside the dashed border the design limit is at most {digits(target)}, "
            "inside the solid one it is."
        )
    return figure(svg, f"{escape(metric)}: {digits(low)} (darkest) to {digits(high)}.{border}")


def _edges(values: Floats) -> Floats:
    """Return bin edges: halfway between values if they are few, else even."""
    known = np.unique(values[np.isfinite(values)])
    if len(known) < 2:
        return np.zeros(0)
    if len(known) <= BINS:
        middle = (known[1:] + known[:-1]) / 2
        return np.concatenate([[2 * known[0] - middle[0]], middle, [2 * known[-1] - middle[-1]]])
    return np.linspace(known[0], known[-1], BINS + 1)


def _binned(place: Sequence[np.ndarray], values: Floats, shape: tuple[int, int]) -> Floats:
    """Return the median of finite values in every bin; NaN where there is none."""
    out = np.full(shape, np.nan)
    flat = place[0] * shape[1] + place[1]
    finite = np.isfinite(values)
    for number in np.unique(flat[finite]):
        out.flat[number] = np.median(values[finite & (flat == number)])
    return out


def _border(axes: Axes, edges: Sequence[Floats], inside: np.ndarray, style: str) -> str:
    """Return the border between bins that are inside and those that are not."""
    steps = []
    for i in range(inside.shape[0]):
        for j in range(inside.shape[1]):
            if not inside[i, j]:
                continue
            for di, dj, edge in (
                (1, 0, [[edges[0][i + 1], edges[1][j]], [edges[0][i + 1], edges[1][j + 1]]]),
                (-1, 0, [[edges[0][i], edges[1][j]], [edges[0][i], edges[1][j + 1]]]),
                (0, 1, [[edges[0][i], edges[1][j + 1]], [edges[0][i + 1], edges[1][j + 1]]]),
                (0, -1, [[edges[0][i], edges[1][j]], [edges[0][i + 1], edges[1][j]]]),
            ):
                a, b = i + di, j + dj
                outside = (
                    not (0 <= a < inside.shape[0] and 0 <= b < inside.shape[1]) or not inside[a, b]
                )
                if outside:
                    (x0, y0), (x1, y1) = axes.place(np.array(edge)).tolist()
                    steps.append(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")
    return path(steps, style)


MOST_DOTS = 3000
"""Dots of a drawing; of more designs every so-and-so-many-th is drawn, and the front."""

FAR = 0.6
"""How far outside the designs a target is drawn, in their ranges: a farther one would press them
into a corner."""


def sweep_page(
    *,
    title: str,
    verdict: str,
    alarms: Sequence[str],
    notes: Sequence[str],
    counts: Mapping[str, int],
    dropped: Mapping[str, int],
    fronts: Sequence[str],
    maps: Sequence[str],
    designs: Sequence[str],
    sensitivity: Sequence[tuple[str, str, float, float, float]],
    recipe: str,
) -> str:
    """Return the page (HTML), one file.

    Parameters
    ----------
    title, verdict, alarms, notes
        Of the sweep; what a reader must know first; what was reused and how fidelities agree.
    counts, dropped
        Designs by what became of them, and by the reason for which they were dropped or failed.
    fronts, maps, designs
        Made by `front`, `metric_map` and `design`.
    sensitivity
        (metric, axis, first, total, rank correlation).
    recipe
        The sweep, as TOML.
    """
    became = [(name, [str(count)]) for name, count in (*counts.items(), *dropped.items())]
    reuse = "".join(f'<p class="note">{escape(note)}</p>' for note in notes)
    sections = [
        ("Best designs", "".join(designs)),
        ("Fronts", two_columns([drawn for drawn in fronts if drawn])),
        ("Maps", two_columns([drawn for drawn in maps if drawn])),
        ("What matters", _sensitivity(sensitivity)),
        ("Fidelities and reuse", reuse),
        ("What became of the designs", table("Designs", ["number"], became)),
    ]
    return page(title, verdict, alarms, sections, recipe)


def design(
    *,
    heading: str,
    words: str,
    file: str,
    picture: bytes | None,
    fields: Sequence[tuple[str, Points, Floats]],
) -> str:
    """Return one of the best designs (HTML).

    Parameters
    ----------
    heading, words, file
        Its number, its values and figures, and its scene's file.
    picture
        PNG under the push in the middle; None without the full chain.
    fields
        (name, sites (k, 3) mm, forces (k, 3) N).
    """
    parts = []
    if picture is not None:
        data = base64.b64encode(picture).decode()
        image = (
            f'<img src="data:image/png;base64,{data}" alt="CCD picture of {escape(heading)} under '
            'the push in the middle">'
        )
        parts.append(figure(image, "Picture under the push in the middle"))
    parts += [_field(name, sites, force) for name, sites, force in fields]
    return (
        f"<h3>{escape(heading)}</h3><p>{escape(words)}</p>"
        f'<p class="note">Ready to run, in this page&rsquo;s folder: <code>twin run '
        f"{escape(file)}</code></p>{two_columns(parts)}"
    )


def _field(name: str, sites: Points, force: Floats) -> str:
    """Return the drawing of a field: colour is the force along z, arrows those along x and y."""
    apart = np.linalg.norm(sites[1:, :2] - sites[:1, :2], axis=1)
    side = float(apart.min()) if len(apart) else 1.0
    largest = float(np.abs(force[:, 2]).max()) or 1.0
    axes, colours, pushed = force_field(sites[:, :2], force, side, largest, largest / 1.5)
    svg = drawing(axes, colours + pushed, "x (mm)", "y (mm)", f"Force field, {name}")
    return figure(svg, f"{escape(name)}; darkest is {digits(largest)} N a site")


def front(
    *, across: str, up: str, x: Floats, y: Floats, on_front: Bools, target: tuple[float, float]
) -> str:
    """Return the drawing (HTML) of designs by two metrics; empty where they don't differ.

    Parameters
    ----------
    across, up
        Names, with units.
    x, y, on_front
        (m,) values, and whether no other design is better in both.
    target
        (x, y) wanted; NaN where nothing is.
    """
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 2 or min(np.ptp(v[known]) for v in (x, y)) == 0:
        return ""
    x, y = x[known], y[known]
    # a few hopeless designs must not press all others into a corner
    ends = [(float(v.min()), float(np.quantile(v, 0.95))) for v in (x, y)]
    targets = [
        t if a - FAR * (b - a) <= t <= b + FAR * (b - a) else np.nan
        for t, (a, b) in zip(target, ends, strict=True)
    ]
    for k, wanted in enumerate(targets):
        if np.isfinite(wanted):
            ends[k] = (min(ends[k][0], wanted), max(ends[k][1], wanted))
    (left, right), (bottom, top) = [
        (a - 0.05 * (b - a) - 1e-12, b + 0.05 * (b - a) + 1e-12) for a, b in ends
    ]
    axes = Axes(left=left, right=right, bottom=bottom, top=top, height=280)
    shown = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
    step = max(1, int(shown.sum()) // MOST_DOTS)
    points = np.column_stack([x, y])
    content = dots(axes, points[shown][::step], "dot other", 2.2)
    on = points[shown & on_front[known]]
    on = on[np.argsort(on[:, 0])]
    if len(on):
        content += line(axes, on, "profile estimate") + dots(axes, on, "dot red", 3.2)
    for k, wanted in enumerate(targets):
        if np.isfinite(wanted):
            upright, level = [[wanted, bottom], [wanted, top]], [[left, wanted], [right, wanted]]
            content += line(axes, np.array(level if k else upright), "contact")
    svg = drawing(axes, content, across, up, f"{up} against {across} of all designs")
    caption = (
        "Each dot is a design; red ones are bettered by none in both. The worst twentieth lies "
        f"outside. {_said((across, up), target, targets)}"
    )
    return figure(svg, caption)


def _said(names: tuple[str, str], targets: tuple[float, float], drawn: Sequence[float]) -> str:
    """Return what to say of a front's targets; those too far away to be drawn in numbers."""
    words = ["Dashed: the targets."] if np.isfinite(drawn).any() else []
    for name, target, shown in zip(names, targets, drawn, strict=True):
        if np.isfinite(target) and not np.isfinite(shown):
            words.append(f"Wanted {escape(name)}: {digits(float(target))}, far from here.")
    return " ".join(words)


def _sensitivity(rows: Sequence[tuple[str, str, float, float, float]]) -> str:
    if not rows:
        return ""
    cells = [
        (
            f"{metric}: {axis}",
            [f"{first:.2f}", f"{total:.2f}", f"{rank:+.2f}" if np.isfinite(rank) else "–"],
        )
        for metric, axis, first, total, rank in rows
    ]
    caption = (
        "Share of the variance of the metric's logarithm that an axis makes alone and with the "
        "others (Sobol' indices by the closed form), and rank correlation of axis and metric over "
        "this sweep's designs"
    )
    return table(caption, ["alone", "with others", "rank correlation"], cells)
