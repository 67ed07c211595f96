"""The markers as the picture shows them: true shifts, tracked shifts, and what the tracker got wrong."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np

from twin.arrays import Bools, Pixels
from twin.results import RunResult, Truth
from twin.show import plots
from twin.show.maps import around, figure, layers, longest, magnification, scale_note, spacing
from twin.show.words import digits

GROSS_PX = 1.0
"""A tracking error above this is a wrong match and not noise: it is counted instead of drawn."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """Markers in the picture; what is unknown is NaN.

    Attributes
    ----------
    layer
        (n,) layer names.
    true_rest_px, true_shift_px
        (n, 2) true rest places and shifts, px.
    tracked_rest_px, tracked_shift_px
        (n, 2) tracked ones, px.
    tracked
        Whether a tracker was run at all.
    """

    layer: np.ndarray
    true_rest_px: Pixels
    true_shift_px: Pixels
    tracked_rest_px: Pixels
    tracked_shift_px: Pixels
    tracked: bool

    @property
    def place_px(self) -> Pixels:
        """(n, 2) rest places: true ones where known, tracked ones elsewhere."""
        return np.where(np.isfinite(self.true_rest_px), self.true_rest_px, self.tracked_rest_px)

    @property
    def lost(self) -> Bools:
        """(n,) markers that the tracker didn't find."""
        return np.asarray(self.tracked & ~np.isfinite(self.tracked_shift_px).all(axis=1))


def sighting(result: RunResult) -> Sighting | None:
    """Gather what a run knows of its markers in the picture; None if it knows nothing."""
    truth, found = result.truth, result.estimate
    tracked = found is not None and len(found.marker_rest_px) > 0
    projected = truth is not None and len(truth.marker_rest_px) > 0
    if not (tracked or projected):
        return None
    count = len(truth.marker_rest_px) if truth is not None and projected else len(found.marker_rest_px) if found else 0
    nothing = np.full((count, 2), np.nan)
    rest, shift = true_pixels(truth) if truth is not None and projected else (nothing, nothing)
    named = truth is not None and len(truth.marker_layer) == count
    return Sighting(
        layer=truth.marker_layer if truth is not None and named else np.full(count, "markers"),
        true_rest_px=rest,
        true_shift_px=shift,
        tracked_rest_px=found.marker_rest_px if found is not None and tracked else nothing,
        tracked_shift_px=found.marker_shift_px if found is not None and tracked else nothing,
        tracked=tracked,
    )


def true_pixels(truth: Truth) -> tuple[Pixels, Pixels]:
    """Return (n, 2) rest places and shifts in the picture, px: of the visible outlines, else of the centres.

    Outlines come first because they are what a tracker can see: in the finger the two differ by up to 0.4 px.
    """
    if len(truth.marker_outline_rest_px) and len(truth.marker_outline_pressed_px):
        return truth.marker_outline_rest_px, truth.marker_outline_pressed_px - truth.marker_outline_rest_px
    return truth.marker_rest_px, truth.marker_pressed_px - truth.marker_rest_px


def panels(seen: Sighting, size_px: tuple[int, int] | None) -> str:
    """Return one drawing of the shifts per layer and one of the tracking errors.

    Parameters
    ----------
    seen
        The markers.
    size_px
        (height, width) of the picture, if there is one.
    """
    axes = _window(seen, size_px)
    # the truth sets the scale if there is one: a few wild tracks must not shrink everything else
    size = longest(seen.true_shift_px) or longest(seen.tracked_shift_px)
    scale = magnification(axes, seen.layer, seen.place_px, size)
    figures = [_shifts(seen, axes, scale, name, style, mask) for name, style, mask in layers(seen.layer)]
    keys = ""
    if np.isfinite(seen.true_shift_px).any():
        keys += '<span class="key truth">truth</span> '
    if seen.tracked:
        keys += '<span class="key tracked">tracked</span> '
    note = scale_note(scale, size, "px", "x points right and y up; the row grows downward.")
    shifts = f'<div class="two">{"".join(figures)}</div><p class="note">{keys}{note}</p>'
    return shifts + _errors(seen, axes)


def _window(seen: Sighting, size_px: tuple[int, int] | None) -> plots.Axes:
    """Return the part of the picture in which the markers are: the finger's fill but a quarter of theirs."""
    left, right, low, high = around(np.vstack([seen.true_rest_px, seen.tracked_rest_px]))
    if size_px is not None:
        left, right = max(left, -0.5), min(right, size_px[1] - 0.5)
        low, high = max(low, -0.5), min(high, size_px[0] - 0.5)
    return plots.Axes.equal(left, right, high, low)


def _shifts(seen: Sighting, axes: plots.Axes, scale: float, name: str, style: str, mask: Bools) -> str:
    lost = int((mask & seen.lost).sum())
    content = (
        plots.arrows(axes, seen.true_rest_px[mask], scale * seen.true_shift_px[mask], f"truth {style}")
        + plots.dots(axes, seen.place_px[mask], f"dot {style}", 1.4)
        + plots.arrows(axes, seen.tracked_rest_px[mask], scale * seen.tracked_shift_px[mask], f"tracked {style}")
        + plots.crosses(axes, seen.place_px[mask & seen.lost], "lost")
    )
    markers = f"{int(mask.sum())} markers"
    say = f"Shifts of the {name} layer in the picture, {markers}, {lost} not tracked"
    caption = f"{escape(name)} layer, {markers}" + (f", {lost} not tracked (×)" if lost else "")
    return figure(plots.drawing(axes, content, "column (px)", "row (px)", say), caption)


def _errors(seen: Sighting, axes: plots.Axes) -> str:
    """Return the map of tracked minus true shifts: noise looks random in it, a bias (of shading, say) ordered."""
    error = seen.tracked_shift_px - seen.true_shift_px
    size = np.hypot(error[:, 0], error[:, 1])
    fine = size <= GROSS_PX
    if not fine.any():
        return ""
    usual = float(np.sqrt(np.mean(error[fine] ** 2)))
    pitch = spacing(seen.place_px)
    scale = plots.nice(max(pitch, 20 / axes.per_unit) / usual / 1.5) if usual > 0 else 1.0
    content = ""
    for _, style, mask in layers(seen.layer):
        kept = mask & fine
        content += plots.arrows(axes, seen.true_rest_px[kept], scale * error[kept], f"tracked {style}")
    gross = int((size > GROSS_PX).sum())
    left_out = f"; {gross} above {digits(GROSS_PX)} px are left out" if gross else ""
    say = f"Tracking errors of {int(fine.sum())} markers, root mean square {digits(usual)} px per axis"
    caption = (
        f"Tracking error (tracked minus true shift), drawn {digits(scale)} times as long as it is; root mean square "
        f"{digits(usual)} px per axis{left_out}. Noise looks random here, a bias ordered."
    )
    svg = plots.drawing(axes, content, "column (px)", "row (px)", say)
    return f'<figure class="single">{svg}<figcaption>{caption}</figcaption></figure>'
