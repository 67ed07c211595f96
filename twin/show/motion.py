"""How the markers moved: in the picture if there is one, else in the body; and a table of the true displacements."""

from __future__ import annotations

from html import escape

import numpy as np

from twin.results import RunResult, Truth
from twin.show import plots
from twin.show.maps import around, figure, layers, longest, magnification, scale_note
from twin.show.sighting import panels, sighting
from twin.show.words import digits, table


def motion(result: RunResult) -> str:
    """Return drawings and table of the markers' motion; empty if there are no markers or nobody looked."""
    truth, seen = result.truth, sighting(result)
    if truth is not None and len(truth.marker_rest_mm) == 0:
        truth = None
    if seen is not None:
        picture = result.rest if result.rest is not None else result.pressed
        drawn = panels(seen, picture.shape[:2] if picture is not None else None)
    else:
        drawn = _in_body(truth) if truth is not None else ""
    return drawn + (_table(truth) if truth is not None else "")


def _in_body(truth: Truth) -> str:
    places, steps = truth.marker_rest_mm[:, :2], truth.marker_displacement_mm[:, :2]
    axes = plots.Axes.equal(*around(places))
    size = longest(steps)
    scale = magnification(axes, truth.marker_layer, places, size)
    figures = []
    for name, style, mask in layers(truth.marker_layer):
        content = plots.arrows(axes, places[mask], scale * steps[mask], f"tracked {style}")
        content += plots.dots(axes, places[mask], f"dot {style}", 1.4)
        say = f"Displacement of the {name} markers along x and y, {int(mask.sum())} markers"
        caption = f"{escape(name)} layer, {int(mask.sum())} markers"
        figures.append(figure(plots.drawing(axes, content, "x (mm)", "y (mm)", say), caption))
    note = scale_note(scale, size, "mm", "Seen from the camera: x to the right, y up, z towards you.")
    return f'<div class="two">{"".join(figures)}</div><p class="note">{note}</p>'


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
