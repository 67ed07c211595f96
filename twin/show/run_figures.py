"""The drawings of a run's report: marker motion, tracking errors, forces, and the contact.

`motion` draws the markers in the picture if there is one, otherwise in the body. `pushes` draws
true and estimated forces on the sites of the estimate, in the same colours and to the same scale.
`touch` draws which patches under the probe stick and which slip, and compares the pressure with the
closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

import numpy as np

from twin.arrays import Bools, Floats, Pixels, Points
from twin.results import RunResult, Touch, Truth
from twin.show.html_page import cleaned, digits, figure, finite, table, two_columns
from twin.show.svg_plots import Axes, arrows, crosses, dots, drawing, force_field, line, nice

_GROSS_PX = 1.0
"""A tracking error above this is a wrong match and not noise: it is counted instead of drawn."""


@dataclass(frozen=True, kw_only=True)
class _Sighting:
    """Markers in the picture: (n,) layer names, (n, 2) rest places and shifts, px, NaN where
    unknown, and whether a tracker was run at all."""

    layer: np.ndarray
    true_rest_px: Pixels
    true_shift_px: Pixels
    tracked_rest_px: Pixels
    tracked_shift_px: Pixels
    tracked: bool

    @property
    def place_px(self) -> Pixels:
        return np.where(np.isfinite(self.true_rest_px), self.true_rest_px, self.tracked_rest_px)

    @property
    def lost(self) -> Bools:
        return np.asarray(self.tracked & ~np.isfinite(self.tracked_shift_px).all(axis=1))


def _sighting(result: RunResult) -> _Sighting | None:
    """Return what a run knows of its markers in the picture; None if it knows nothing."""
    truth = result.truth if result.truth and len(result.truth.marker_rest_px) else None
    found = result.estimate if result.estimate and len(result.estimate.marker_rest_px) else None
    known = truth or found
    if known is None:
        return None
    count = len(known.marker_rest_px)
    nothing = np.full((count, 2), np.nan)
    rest, shift = _true_pixels(truth) if truth else (nothing, nothing)
    layer = np.full(count, "markers")
    if result.truth is not None and len(result.truth.marker_layer) == count:
        layer = result.truth.marker_layer
    return _Sighting(
        layer=layer,
        true_rest_px=rest,
        true_shift_px=shift,
        tracked_rest_px=found.marker_rest_px if found else nothing,
        tracked_shift_px=found.marker_shift_px if found else nothing,
        tracked=found is not None,
    )


def _true_pixels(truth: Truth) -> tuple[Pixels, Pixels]:
    """Return (n, 2) rest places and shifts, px, of the visible outlines, else of the centres.

    A tracker sees the outlines; in the finger the two differ by up to 0.4 px.
    """
    if len(truth.marker_outline_rest_px) and len(truth.marker_outline_pressed_px):
        return (
            truth.marker_outline_rest_px,
            truth.marker_outline_pressed_px - truth.marker_outline_rest_px,
        )
    return truth.marker_rest_px, truth.marker_pressed_px - truth.marker_rest_px


def _marker_panels(seen: _Sighting, size_px: tuple[int, int] | None) -> str:
    """Return one drawing of the shifts per layer and one of the tracking errors."""
    axes = _window(seen, size_px)
    # the truth sets the scale if there is one: a few wild tracks must not shrink everything else
    size = _longest(seen.true_shift_px) or _longest(seen.tracked_shift_px)
    scale = _magnification(axes, seen.layer, seen.place_px, size)
    figures = [
        _shifts(seen, axes, scale, name, style, mask) for name, style, mask in _layers(seen.layer)
    ]
    keys = ""
    if np.isfinite(seen.true_shift_px).any():
        keys += '<span class="key truth">truth</span> '
    if seen.tracked:
        keys += '<span class="key tracked">tracked</span> '
    note = _scale_note(scale, size, "px", "x points right and y up; the row grows downward.")
    return f'{two_columns(figures)}<p class="note">{keys}{note}</p>' + _errors(seen, axes)


def _window(seen: _Sighting, size_px: tuple[int, int] | None) -> Axes:
    """Return the part of the picture in which the markers are."""
    left, right, low, high = _around(np.vstack([seen.true_rest_px, seen.tracked_rest_px]))
    if size_px is not None:
        left, right = max(left, -0.5), min(right, size_px[1] - 0.5)
        low, high = max(low, -0.5), min(high, size_px[0] - 0.5)
    return Axes.equal(left, right, high, low)


def _shifts(seen: _Sighting, axes: Axes, scale: float, name: str, style: str, mask: Bools) -> str:
    lost = int((mask & seen.lost).sum())
    content = (
        arrows(axes, seen.true_rest_px[mask], scale * seen.true_shift_px[mask], f"truth {style}")
        + dots(axes, seen.place_px[mask], f"dot {style}", 1.4)
        + arrows(
            axes,
            seen.tracked_rest_px[mask],
            scale * seen.tracked_shift_px[mask],
            f"tracked {style}",
        )
        + crosses(axes, seen.place_px[mask & seen.lost], "lost")
    )
    markers = f"{int(mask.sum())} markers"
    say = f"Shifts of the {name} layer in the picture, {markers}, {lost} not tracked"
    caption = f"{escape(name)} layer, {markers}" + (f", {lost} not tracked (×)" if lost else "")
    return figure(drawing(axes, content, "column (px)", "row (px)", say), caption)


def _errors(seen: _Sighting, axes: Axes) -> str:
    """Return the map of tracked minus true shifts."""
    error = seen.tracked_shift_px - seen.true_shift_px
    size = np.hypot(error[:, 0], error[:, 1])
    fine = size <= _GROSS_PX
    if not fine.any():
        return ""
    usual = float(np.sqrt(np.mean(error[fine] ** 2)))
    pitch = _spacing(seen.place_px)
    scale = nice(max(pitch, 20 / axes.per_unit) / usual / 1.5) if usual > 0 else 1.0
    content = ""
    for _, style, mask in _layers(seen.layer):
        kept = mask & fine
        content += arrows(axes, seen.true_rest_px[kept], scale * error[kept], f"tracked {style}")
    gross = int((size > _GROSS_PX).sum())
    left_out = f"; {gross} above {digits(_GROSS_PX)} px are left out" if gross else ""
    say = (
        f"Tracking errors of {int(fine.sum())} markers, root mean square {digits(usual)} px "
        f"per axis"
    )
    caption = (
        f"Tracking error (tracked minus true shift), drawn {digits(scale)} times as long as it "
        f"is; root mean square "
        f"{digits(usual)} px per axis{left_out}. Noise looks random here, a bias ordered."
    )
    return figure(drawing(axes, content, "column (px)", "row (px)", say), caption, "single")


def motion(result: RunResult) -> str:
    """Return drawings and table of the markers' motion; empty if nobody looked."""
    truth, seen = result.truth, _sighting(result)
    if truth is not None and len(truth.marker_rest_mm) == 0:
        truth = None
    if seen is not None:
        picture = result.rest if result.rest is not None else result.pressed
        drawn = _marker_panels(seen, picture.shape[:2] if picture is not None else None)
    else:
        drawn = _in_body(truth) if truth is not None else ""
    return drawn + (_table(truth) if truth is not None else "")


def _in_body(truth: Truth) -> str:
    places, steps = truth.marker_rest_mm[:, :2], truth.marker_displacement_mm[:, :2]
    axes = Axes.equal(*_around(places))
    size = _longest(steps)
    scale = _magnification(axes, truth.marker_layer, places, size)
    figures = []
    for name, style, mask in _layers(truth.marker_layer):
        content = arrows(axes, places[mask], scale * steps[mask], f"tracked {style}")
        content += dots(axes, places[mask], f"dot {style}", 1.4)
        say = f"Displacement of the {name} markers along x and y, {int(mask.sum())} markers"
        caption = f"{escape(name)} layer, {int(mask.sum())} markers"
        figures.append(figure(drawing(axes, content, "x (mm)", "y (mm)", say), caption))
    note = _scale_note(
        scale, size, "mm", "Seen from the camera: x to the right, y up, z towards you."
    )
    return f'{two_columns(figures)}<p class="note">{note}</p>'


def _table(truth: Truth) -> str:
    heads, columns = [], []
    for name, style, mask in _layers(truth.marker_layer):
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
    names = [
        "markers",
        "z at rest, mm",
        "largest, mm",
        "root mean square, mm",
        "largest along z, mm",
    ]
    return _by_column("True displacement of the markers", heads, names, columns)


_CHUNK = 512
"""Pieces of the truth whose distances to all sites are held at once."""


def pushes(result: RunResult) -> str:
    """Return drawings, profile and resultants of the force field; without sites resultants only."""
    truth, found = result.truth, result.estimate
    if found is None or len(found.site_mm) == 0:
        return _resultants(result)
    fields: list[tuple[str, Floats]] = []
    if truth is not None and len(truth.surface_mm):
        fields.append(("truth", _truth_by_site(truth, found.site_mm)))
    if len(found.force_n) == len(found.site_mm):
        fields.append(("estimate", found.force_n))
    if not fields:
        return _resultants(result)
    return (
        _maps(result, found.site_mm, fields) + _profile(found.site_mm, fields) + _resultants(result)
    )


def _truth_by_site(truth: Truth, sites: Points) -> Floats:
    """Return (k, 3) true forces, N: each piece of the contact is added to its nearest site."""
    total = np.zeros((len(sites), 3))
    for start in range(0, len(truth.surface_mm), _CHUNK):
        pieces = truth.surface_mm[start : start + _CHUNK]
        squared = ((pieces[:, None] - sites[None]) ** 2).sum(axis=2)
        np.add.at(total, squared.argmin(axis=1), truth.surface_force_n[start : start + _CHUNK])
    return total


def _cell_side(sites: Points) -> float:
    """Return the least distance of two sites seen along z, mm."""
    if len(sites) < 2:
        return 1.0
    apart = np.hypot(*(sites[:, None, :2] - sites[None, :, :2]).transpose(2, 0, 1))
    apart[apart < 1e-6] = np.inf
    least = float(apart.min())
    return least if np.isfinite(least) else 1.0


def _maps(result: RunResult, sites: Points, fields: list[tuple[str, Floats]]) -> str:
    side = _cell_side(sites)
    normal = max(float(np.abs(f[:, 2]).max()) for _, f in fields)
    along = max(float(np.hypot(f[:, 0], f[:, 1]).max()) for _, f in fields)
    # a tenth of the normal force at least: under a frictionless press the estimate's noise must
    # look like noise
    per_cell = nice(max(along, 0.1 * normal) / 1.5)
    outline = _contact(result)
    panels = []
    for name, force in fields:
        axes, content, pushed = force_field(sites[:, :2], force, side, normal, per_cell)
        if outline is not None:
            content += _circle(axes, *outline, "contact")
        content += dots(axes, sites[:, :2], "site", 0.9) + pushed
        peak = int(np.argmax(np.abs(force[:, 2])))
        where = f"({digits(float(sites[peak, 0]))}, {digits(float(sites[peak, 1]))}) mm"
        say = (
            f"Force field, {name}: largest force along z {digits(float(force[peak, 2]))} N at "
            f"{where}"
        )
        panels.append(figure(drawing(axes, content, "x (mm)", "y (mm)", say), name.capitalize()))
    top = digits(normal)
    bar = (
        f'<div class="ramp"><span>−{top} N</span><span class="colours"></span><span>{top} '
        f"N</span></div>"
    )
    dashed = " The dashed circle is as large as the true contact." if outline is not None else ""
    note = (
        f"Colour is the force along z on each site (orange pushes into the body, purple pulls "
        f"out); arrows are the "
        f"force along x and y, one cell ({digits(side)} mm) long for {digits(per_cell)} N.{dashed}"
    )
    if len(fields) == 2:
        note += " The truth is summed into the cells of the estimate."
    return f'{two_columns(panels)}{bar}<p class="note">{note}</p>'


def _contact(result: RunResult) -> tuple[tuple[float, float], float] | None:
    """Return centre and radius of the true contact, mm, if the run has a radius."""
    contact, truth = result.facts.get("contact"), result.truth
    radius = finite(
        (contact if isinstance(contact, Mapping) else result.facts).get("contact_radius_mm")
    )
    if truth is None or not len(truth.surface_mm) or radius is None or radius <= 0:
        return None
    low, high = truth.surface_mm[:, :2].min(axis=0), truth.surface_mm[:, :2].max(axis=0)
    x, y = ((low + high) / 2).tolist()
    return (x, y), radius


def _profile(sites: Points, fields: list[tuple[str, Floats]]) -> str:
    """Return the force along z on the row of sites through the strongest one."""
    strongest = int(np.argmax(np.abs(fields[0][1][:, 2])))
    row = np.flatnonzero(np.abs(sites[:, 1] - sites[strongest, 1]) < _cell_side(sites) / 2)
    row = row[np.argsort(sites[row, 0])]
    if len(row) < 3:
        return ""
    x = sites[row, 0]
    values = np.concatenate([f[row, 2] for _, f in fields])
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    margin = 0.08 * (high - low) or 1.0
    axes = Axes(
        left=float(x[0]) - 0.5,
        right=float(x[-1]) + 0.5,
        bottom=low - margin,
        top=high + margin,
        height=200,
    )
    zero = np.array([[axes.left, 0.0], [axes.right, 0.0]])
    content = line(axes, zero, "zero")
    for name, force in fields:
        points = np.column_stack([x, force[row, 2]])
        content += line(axes, points, f"profile {name}") + dots(
            axes, points, f"profile-dot {name}", 2.4
        )
    at = digits(float(sites[strongest, 1]))
    keys = " ".join(f'<span class="key {name}-line">{name}</span>' for name, _ in fields)
    svg = drawing(
        axes, content, "x (mm)", "force along z (N)", f"Force along z on the sites at y = {at} mm"
    )
    return figure(svg, f"Through the contact, y = {at} mm. {keys}", "single")


def _resultants(result: RunResult) -> str:
    totals: list[tuple[str, Floats, Floats]] = []
    for name, arrays in (("truth", result.truth), ("estimate", result.estimate)):
        if arrays and len(arrays.total_force_n) == len(arrays.total_torque_nmm) == 3:
            totals.append((name, arrays.total_force_n, arrays.total_torque_nmm))
    estimate = result.estimate
    if estimate is not None and len(estimate.force_n) and len(estimate.total_force_n) == 3:
        total = estimate.force_n.sum(axis=0)
        if not np.allclose(total, estimate.total_force_n, rtol=1e-6, atol=1e-9):
            torque = np.cross(estimate.site_mm, estimate.force_n).sum(axis=0)
            totals.append(("sum of the estimate's sites, held to bounds", total, torque))
    if not totals:
        return ""
    heads, columns = [], []
    for head, force, torque in totals:
        # a torque below a billionth of the force times a millimetre is round-off
        scale = 1.0 * float(np.abs(force).max())
        numbers = cleaned(force.tolist()) + cleaned(torque.tolist(), scale)
        heads.append(head)
        columns.append([f'<data value="{n!r}">{digits(n)}</data>' for n in numbers])
    names = [f"force along {a}, N" for a in "xyz"] + [f"torque about {a}, N mm" for a in "xyz"]
    return _by_column("Total force, and torque about the origin", heads, names, columns)


def _by_column(caption: str, heads: list[str], names: list[str], columns: list[list[str]]) -> str:
    cells = zip(*columns, strict=True)
    return table(caption, heads, [(n, list(c)) for n, c in zip(names, cells, strict=True)])


def touch(result: RunResult) -> str:
    """Return the drawings under every probe; empty if nothing touches."""
    return "".join(two_columns([_map(one), _pressure(one)]) for one in result.touches)


def _map(one: Touch) -> str:
    axes = Axes.equal(*_around(one.place_mm))
    per_unit = axes.per_unit
    stuck = ~one.slip
    boxes = []
    for (x, y), (a, b), slips in zip(
        axes.place(one.place_mm).tolist(),
        (one.half_mm * per_unit).tolist(),
        one.slip.tolist(),
        strict=True,
    ):
        style = "push" if slips else "dot blue"
        boxes.append(
            f'<rect class="{style}" x="{x - a:.2f}" y="{y - b:.2f}" width="{2 * a:.2f}" '
            f'height="{2 * b:.2f}" fill-opacity="0.6"/>'
        )
    largest = _longest(one.shear_mpa)
    content = "".join(boxes)
    if one.friction > 0 and largest > 0:
        length = 4.0 * float(np.median(one.half_mm)) / largest
        content += arrows(axes, one.place_mm, one.shear_mpa * length, "force")
    share = float(np.prod(one.half_mm, axis=1)[stuck].sum() / np.prod(one.half_mm, axis=1).sum())
    if one.friction == 0:
        caption = f"Patches under the {one.probe}; without friction all of them slide."
    else:
        law = "sticking" if np.isinf(one.friction) else f"friction {digits(one.friction)}"
        caption = (
            f"Under the {one.probe}, {law}: blue sticks ({digits(100 * share)} % of the area), "
            f"orange slips. Arrows are the shear on the body, the longest {digits(largest)} N/mm²."
        )
    say = (
        f"Map of stick and slip under the {one.probe}, {len(one.slip)} patches, "
        f"{int(stuck.sum())} stick"
    )
    return figure(
        drawing(axes, content, "along the surface (mm)", "across that (mm)", say), caption
    )


def _pressure(one: Touch) -> str:
    distance = np.hypot(one.place_mm[:, 0], one.place_mm[:, 1])
    theory = one.expected
    shown = theory[theory[:, 1] <= 1.3 * one.pressure_mpa.max()]
    right = float(max(distance.max(), shown[:, 0].max(initial=0.0))) * 1.05
    top = float(max(one.pressure_mpa.max(), shown[:, 1].max(initial=0.0))) * 1.08
    axes = Axes(left=0.0, right=right, bottom=0.0, top=top, height=260)
    content = line(axes, shown, "profile truth") if len(shown) else ""
    content += dots(
        axes, np.column_stack([distance, one.pressure_mpa]), "profile-dot estimate", 2.0
    )
    keys = '<span class="key estimate-line">this press</span>'
    if len(shown):
        keys += f' <span class="key truth-line">{one.expected_name}, same force</span>'
    peak = digits(float(one.pressure_mpa.max()))
    say = f"Pressure of every patch against its distance from the middle, at most {peak} N/mm²"
    svg = drawing(axes, content, "from the contact's middle (mm)", "pressure (N/mm²)", say)
    return figure(svg, f"Pressure of each patch. {keys}")


_STYLES = {"red": "red", "blue": "blue"}
"""Layers that are named after their colour; others take the remaining styles in turn."""


def _layers(names: np.ndarray) -> list[tuple[str, str, Bools]]:
    """Return name, style and mask of every layer, in their order of appearance."""
    spare = ["blue", "red", "other"]
    ordered = list(dict.fromkeys(names.tolist()))
    taken = {_STYLES[n] for n in ordered if n in _STYLES}
    rest = iter([s for s in spare if s not in taken] + ["other"] * len(ordered))
    return [(str(n), _STYLES.get(n) or next(rest), names == n) for n in ordered]


def _scale_note(scale: float, size: float, unit: str, directions: str) -> str:
    """Return how arrows are drawn: ``scale`` times as long; the longest is ``size`` in ``unit``."""
    if size == 0:
        return f"No marker moves. {directions}"
    drawn = (
        f"Arrows are drawn {digits(scale)} times as long as they are"
        if scale != 1
        else "Arrows are true to scale"
    )
    return f"{drawn}; the longest is {digits(size)} {unit}. {directions}"


def _longest(vectors: Floats) -> float:
    """Return the length of the longest of (n, 2) vectors, NaN apart; 0 if there is none."""
    sizes = np.hypot(vectors[:, 0], vectors[:, 1])
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.max()) if len(sizes) else 0.0


def _magnification(axes: Axes, names: np.ndarray, places: Floats, size: float) -> float:
    """Return the round factor at which an arrow of ``size`` is about one pitch of a layer long."""
    pitches = [_spacing(places[mask]) for _, _, mask in _layers(names)] if len(places) else []
    pitch = min((p for p in pitches if p > 0), default=40 / axes.per_unit)
    return nice(1.5 * max(pitch, 20 / axes.per_unit) / size) if size > 0 else 1.0


def _spacing(points: Floats) -> float:
    """Return the median distance to the nearest neighbour; 0 for fewer than two points."""
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
    margin = 0.12 * max(right - left, high - low) or 1.0
    return float(left - margin), float(right + margin), float(low - margin), float(high + margin)


def _circle(axes: Axes, centre: tuple[float, float], radius: float, style: str) -> str:
    """Return a circle, its radius in data units."""
    x, y = axes.place(np.array([centre]))[0]
    return f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{radius * axes.per_unit:.1f}"/>'
