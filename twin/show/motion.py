"""How the markers moved: one drawing per layer, truth below, tracked above."""

from __future__ import annotations

from html import escape

import numpy as np

from twin.arrays import Bools, Floats, Pixels
from twin.results import RunResult, Truth
from twin.show import plots
from twin.show.words import digits, table

STYLES = {"red": "red", "blue": "blue"}
"""Layers that are named after their colour; others take the remaining styles in turn."""


def motion(result: RunResult) -> str:
    """Return drawings and table of the markers' motion; empty if nothing moved or nobody looked."""
    truth, found = result.truth, result.estimate
    if truth is not None and len(truth.marker_rest_mm) == 0:
        truth = None
    tracked = found is not None and len(found.marker_rest_px) > 0
    if truth is None and not tracked:
        return ""
    if tracked or (truth is not None and len(truth.marker_rest_px)):
        panels = _in_picture(result)
    else:
        assert truth is not None
        panels = _in_body(truth)
    return panels + (_table(truth) if truth is not None else "")


def layers(names: np.ndarray) -> list[tuple[str, str, Bools]]:
    """Return name, style and mask of every layer, in their order of appearance."""
    spare = ["blue", "red", "other"]
    ordered = list(dict.fromkeys(names.tolist()))
    taken = {STYLES[n] for n in ordered if n in STYLES}
    rest = iter([s for s in spare if s not in taken] + ["other"] * len(ordered))
    return [(str(n), STYLES.get(n) or next(rest), names == n) for n in ordered]


def true_pixels(truth: Truth) -> tuple[Pixels, Pixels]:
    """Return (n, 2) rest places and shifts in the picture, px: of the visible outlines, else of the centres.

    Outlines come first because they are what a tracker can see: in the finger the two differ by up to 0.4 px.
    """
    if len(truth.marker_outline_rest_px) and len(truth.marker_outline_pressed_px):
        return truth.marker_outline_rest_px, truth.marker_outline_pressed_px - truth.marker_outline_rest_px
    return truth.marker_rest_px, truth.marker_pressed_px - truth.marker_rest_px


def _in_picture(result: RunResult) -> str:
    truth, found = result.truth, result.estimate
    rest = shift = tracked_rest = tracked_shift = np.empty((0, 2))
    if truth is not None and len(truth.marker_rest_px):
        rest, shift = true_pixels(truth)
    if found is not None and len(found.marker_rest_px):
        tracked_rest, tracked_shift = found.marker_rest_px, found.marker_shift_px
    count = max(len(rest), len(tracked_rest))
    names = truth.marker_layer if truth is not None and len(truth.marker_layer) == count else np.full(count, "markers")
    left, right, low, high = _around(np.vstack([rest, tracked_rest]))
    picture = result.rest if result.rest is not None else result.pressed
    if picture is not None:
        # the finger's markers fill a quarter of its picture: show their part of it, but nothing outside the picture
        left, right = max(left, -0.5), min(right, picture.shape[1] - 0.5)
        low, high = max(low, -0.5), min(high, picture.shape[0] - 0.5)
    axes = plots.Axes.equal(left, right, high, low)
    # the truth sets the scale if there is one: a few wild tracks must not shrink everything else
    longest = _longest(shift) or _longest(tracked_shift)
    scale = _magnification(axes, names, rest if len(rest) else tracked_rest, longest)
    panels = []
    for name, style, mask in layers(names):
        content, lost = "", 0
        if len(rest):
            content += plots.arrows(axes, rest[mask], scale * shift[mask], f"truth {style}")
            content += plots.dots(axes, rest[mask], f"dot {style}", 1.4)
        if len(tracked_rest):
            content += plots.arrows(axes, tracked_rest[mask], scale * tracked_shift[mask], f"tracked {style}")
            missing = mask & ~np.isfinite(tracked_shift).all(axis=1)
            lost = int(missing.sum())
            places = np.where(np.isfinite(tracked_rest), tracked_rest, rest if len(rest) else np.nan)
            content += plots.crosses(axes, places[missing], "lost")
        say = f"Shifts of the {name} markers in the picture, {int(mask.sum())} markers, {lost} not tracked"
        caption = f"{escape(name)} layer, {int(mask.sum())} markers" + (f", {lost} not tracked (×)" if lost else "")
        panels.append(_figure(plots.drawing(axes, content, "column (px)", "row (px)", say), caption))
    keys = []
    if len(rest):
        keys.append('<span class="key truth">truth</span>')
    if len(tracked_rest):
        keys.append('<span class="key tracked">tracked</span>')
    note = _scale_note(scale, longest, "px", "x points right and y up; the row grows downward.")
    return f'<div class="two">{"".join(panels)}</div><p class="note">{" ".join(keys)} {note}</p>'


def _in_body(truth: Truth) -> str:
    places, steps = truth.marker_rest_mm[:, :2], truth.marker_displacement_mm[:, :2]
    axes = plots.Axes.equal(*_around(places))
    longest = _longest(steps)
    scale = _magnification(axes, truth.marker_layer, places, longest)
    panels = []
    for name, style, mask in layers(truth.marker_layer):
        content = plots.arrows(axes, places[mask], scale * steps[mask], f"tracked {style}")
        content += plots.dots(axes, places[mask], f"dot {style}", 1.4)
        say = f"Displacement of the {name} markers along x and y, {int(mask.sum())} markers"
        caption = f"{escape(name)} layer, {int(mask.sum())} markers"
        panels.append(_figure(plots.drawing(axes, content, "x (mm)", "y (mm)", say), caption))
    note = _scale_note(scale, longest, "mm", "Seen from the camera: x to the right, y up, z towards you.")
    return f'<div class="two">{"".join(panels)}</div><p class="note">{note}</p>'


def _table(truth: Truth) -> str:
    heads, columns = [], []
    for name, style, mask in layers(truth.marker_layer):
        moved = truth.marker_displacement_mm[mask]
        size = np.linalg.norm(moved, axis=1)
        depths = truth.marker_rest_mm[mask, 2]
        low, high = digits(float(depths.min())), digits(float(depths.max()))
        heads.append(f'<span class="swatch {style}"></span>{escape(name)}')
        columns.append(
            [
                str(int(mask.sum())),
                low if low == high else f"{low} to {high}",
                digits(float(size.max())),
                digits(float(np.sqrt(np.mean(size**2)))),
                digits(float(moved[np.argmax(np.abs(moved[:, 2])), 2])),
            ]
        )
    names = ["markers", "z at rest, mm", "largest, mm", "root mean square, mm", "largest along z, mm"]
    rows = [(name, list(cells)) for name, cells in zip(names, zip(*columns, strict=True), strict=True)]
    return table("True displacement of the markers", heads, rows)


def _figure(drawing: str, caption: str) -> str:
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def _scale_note(scale: float, longest: float, unit: str, directions: str) -> str:
    if longest == 0:
        return f"No marker moves. {directions}"
    drawn = f"Arrows are drawn {digits(scale)} times as long as they are" if scale != 1 else "Arrows are true to scale"
    return f"{drawn}; the longest is {digits(longest)} {unit}. {directions}"


def _longest(vectors: Floats) -> float:
    sizes = np.hypot(vectors[:, 0], vectors[:, 1])
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.max()) if len(sizes) else 0.0


def _magnification(axes: plots.Axes, names: np.ndarray, places: Floats, longest: float) -> float:
    """Return the round factor at which the longest arrow is about as long as markers of a layer are apart."""
    pitches = [spacing(places[mask]) for _, _, mask in layers(names)] if len(places) else []
    pitch = min((p for p in pitches if p > 0), default=40 / axes.per_unit)
    return plots.nice(1.5 * max(pitch, 20 / axes.per_unit) / longest) if longest > 0 else 1.0


def spacing(points: Floats) -> float:
    """Return the median distance to the nearest neighbour of (n, 2) points; 0 for fewer than two."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return 0.0
    nearest = []
    for block in np.array_split(points, -(-len(points) // 500)):
        apart = np.hypot(*(block[:, None] - points[None]).transpose(2, 0, 1))
        nearest.append(np.partition(apart, 1, axis=1)[:, 1])
    return float(np.median(np.concatenate(nearest)))


def _around(points: Floats) -> tuple[float, float, float, float]:
    """Return left, right, low and high of a window with a margin around (n, 2) points."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return -1.0, 1.0, -1.0, 1.0
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * max(right - left, high - low) or 1.0
    return float(left - margin), float(right + margin), float(low - margin), float(high + margin)
