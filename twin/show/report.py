"""The page of a run: `report` writes it from the results alone.

A part that the run didn't compute is left out, so that every run has a report. Markers are drawn
in the picture if there is one, otherwise in the body; true and estimated forces in the same colours
and to the same scale; under the probe, which patches stick and which slip, and the pressure with
its closed form.
"""

from __future__ import annotations

import base64
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from twin.arrays import Bools, Floats, Picture, Pixels, Points, eight_bits, mean_spacing, nice
from twin.files import png_bytes
from twin.results import RunResult, Truth
from twin.show.explain import WORDS
from twin.show.html_page import Axes, Unit, digits, figure, finite, page, table, two_columns

_STAGES = ("elastic", "tracking", "force")
"""Order of the stages in the table of errors; others follow."""


def report(result: RunResult) -> str:
    """Return the report of anything from a bare scene to a full run as one HTML page."""
    sections = [
        ("The press", _press(result)),
        ("Pictures", _pictures(result)),
        ("Marker motion", _motion(result)),
        ("Under the probe", _touched(result)),
        ("Forces", _forces(result)),
        ("Errors by stage", _errors(result.score)),
        ("Time", _times(result.timings)),
        ("Facts", _facts({k: v for k, v in result.facts.items() if k not in _ELSEWHERE})),
    ]
    return page(
        _title(result.scene_toml),
        _verdict(result),
        _alarms(result.facts),
        sections,
        result.scene_toml,
    )


_ELSEWHERE = ("course", "one_layer")
"""Facts that stand in the section on the press."""


def _verdict(result: RunResult) -> str:
    """Return what the run came to, in one sentence."""
    score = result.score or {}
    said = []
    sd, centre = _figure(score, "tracking", "sd_px"), _figure(score, "force", "centre_error_mm")
    if sd is not None:
        said.append(f"the sensor follows its markers to {digits(sd)} px (standard deviation)")
    if (total := _figure(score, "force", "total_force_error")) is not None:
        said.append(f"its total force is off by {Unit('_error').amount(total)}")
    if centre is not None:
        said.append(f"it places the centre of the contact {digits(centre)} mm from the truth")
    if (field := _figure(score, "force", "field_error")) is not None:
        said.append(f"its force field is off by {Unit('_error').amount(field)}, site by site")
    if not said:
        said = [_without_score(result)]
    text = said[0] if len(said) == 1 else f"{', '.join(said[:-1])} and {said[-1]}"
    return f"{text[0].upper()}{text[1:]}."


def _without_score(result: RunResult) -> str:
    truth = result.truth
    if truth is None or not len(truth.marker_displacement_mm):
        seen = "the sensor is shown as it was seen"
        return "this run computed no motion" if result.rest is None else seen
    size = float(np.linalg.norm(truth.marker_displacement_mm, axis=1).max())
    if size == 0:
        return "nothing presses on the sensor, and no marker moves"
    force = float(np.linalg.norm(truth.total_force_n))
    under = f" under {digits(force)} N" if len(truth.total_force_n) == 3 else ""
    return f"the markers move by up to {digits(size)} mm{under}"


def _figure(score: Mapping[str, Any], stage: str, key: str) -> float | None:
    table = score.get(stage)
    return finite(table.get(key)) if isinstance(table, Mapping) else None


def _title(scene_toml: str) -> str:
    try:
        title = tomllib.loads(scene_toml).get("title")
    except tomllib.TOMLDecodeError:
        title = None
    return title.strip() if isinstance(title, str) and title.strip() else "Tactile sensor run"


def _pictures(result: RunResult) -> str:
    figures = []
    both = [picture for picture in (result.rest, result.pressed) if picture is not None]
    gain = min((_gain(picture) for picture in both), default=1.0)
    for name, alt, picture in (
        ("At rest", "Camera picture of the markers at rest", result.rest),
        ("Pressed", "Camera picture of the markers while the probe presses", result.pressed),
    ):
        if picture is not None:
            uri, shown = _data_uri(picture)
            height, width = picture.shape[:2]
            smaller = f", shown at {digits(100 * shown)} % of its size" if shown < 1 else ""
            style = f' style="filter:brightness({gain:g})"' if gain > 1 else ""
            brighter = f", {digits(gain)} times as bright as it is" if gain > 1 else ""
            image = f'<img src="{uri}" width="{width}" height="{height}" alt="{alt}"{style}>'
            figures.append(figure(image, f"{name}, {width} × {height} px{smaller}{brighter}"))
    if result.rest is None or result.pressed is None:
        return two_columns(figures)
    return _BLINK + two_columns(figures + _difference(result.rest, result.pressed))


_BLINK = (
    '<input type="checkbox" id="blink"><label for="blink"> blink: both pictures at one place, in '
    "turn, so that motion is seen</label>"
)
"""By the style sheet alone: pages have no scripts."""


_PICTURE_BYTES = 1_000_000
"""Largest PNG put into the page: two of them, in base64, and the drawings stay below 3 MB
together."""

_WIDEST_PX = 1280
"""Wider pictures are shown smaller at once: none is shown wider than half of a page."""


def _data_uri(picture: Picture) -> tuple[str, float]:
    """Return a picture as a data URI, and the share of its width that bounds the page's size."""
    step = -(-picture.shape[1] // _WIDEST_PX)
    while True:
        content = png_bytes(_reduced(eight_bits(picture), step))
        if len(content) <= _PICTURE_BYTES or step >= min(picture.shape[:2]):
            return f"data:image/png;base64,{base64.b64encode(content).decode()}", 1 / step
        step += 1


def _reduced(picture: Picture, step: int) -> Picture:
    """Return the means of squares of ``step`` pixels; what is left at the far edges is cut off."""
    if step == 1:
        return picture
    height, width = (size // step for size in picture.shape[:2])
    squares = picture[: height * step, : width * step].reshape(height, step, width, step, -1)
    means: Picture = np.rint(squares.mean(axis=(1, 3))).astype(np.uint8)
    return means.reshape(height, width, *picture.shape[2:])


_BRIGHT = 240.0
"""Count that the brightest thousandth of a dark picture is shown at."""

_LEAST_GAIN = 1.5
"""A picture that needs less is shown as it is."""


def _gain(picture: Picture) -> float:
    """Return the factor by which a dark picture is shown brighter; 1 for a bright one."""
    top = float(np.quantile(picture.max(axis=2), 0.999))
    gain = round(_BRIGHT / top, 1) if top > 0 else 1.0
    return gain if gain >= _LEAST_GAIN else 1.0


def _difference(rest: Picture, pressed: Picture) -> list[str]:
    """Return the pressed picture minus the rest picture, in grey; nothing where they are alike."""
    if rest.shape != pressed.shape or min(rest.shape[:2]) < 2:
        return []
    moved = pressed.astype(np.float32).sum(axis=2) - rest.astype(np.float32).sum(axis=2)
    height, width = (size // 2 * 2 for size in moved.shape)
    moved = moved[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
    largest = float(np.quantile(np.abs(moved), 0.999))
    if largest <= 0:
        return []
    grey = np.clip(128 + 127 * moved / largest, 0, 255).astype(np.uint8)
    uri, _ = _data_uri(grey)
    image = (
        f'<img src="{uri}" width="{width}" height="{height}" '
        'alt="Difference of the pressed picture and the rest picture">'
    )
    most = digits(largest / rest.shape[2])
    words = (
        f"Pressed minus rest: grey did not change, white became brighter by {most} counts or more "
        "(mean of the colours and of 2 × 2 px), black as much darker"
    )
    return [figure(image, words)]


def _press(result: RunResult) -> str:
    """Return the resultants, the contact, and why a single layer's push is uncertain."""
    contact = result.facts.get("contact", {})
    wanted = ("indentation_mm", "contact_radius_mm", "area_mm2", "peak_pressure_mpa")
    shown = _facts({key: contact[key] for key in wanted if finite(contact.get(key)) is not None})
    cause = result.facts.get("one_layer", "")
    said = WORDS["force.total_force_stated"]["one_layer"].format(cause)
    note = f'<p class="note">{escape(said)}</p>' if cause else ""
    return _resultants(result) + note + shown + _course(result.facts.get("course"))


def _course(course: Mapping[str, Any] | None) -> str:
    """Return the force along z against time; empty where the press takes none."""
    if course is None:
        return ""
    points = np.column_stack([course["time_s"], course["z_n"]])
    most, top = points.max(axis=0).tolist()
    axes = Axes(left=0.0, right=1.02 * most, bottom=0.0, top=1.08 * (top or 1.0), height=200)
    content = axes.line(points, "profile truth") + axes.dots(points, "profile-dot truth", 2.4)
    say = f"Force along z against time, at most {digits(top)} N"
    svg = axes.drawing(content, "time (s)", "force along z (N)", say)
    return figure(svg, "True force at the end of every step.", "single")


def _errors(score: Mapping[str, Any] | None) -> str:
    if not score:
        return ""
    reasons: Mapping[str, Any] = score.get("reasons", {})
    stages = [s for s in _STAGES if s in score] + [
        s for s in score if s not in (*_STAGES, "reasons", "facts")
    ]
    bodies = []
    for stage in stages:
        figures = list(_flat(stage, score[stage]))
        rows = []
        for key, value in figures:
            name, meaning = _name_of(key)
            shown = "—" if value is None else _as_html(key, value)
            meaning = meaning if value is not None else _reason(reasons, key)
            small = f"<small>{_as_html('', meaning)}</small>" if meaning else ""
            rows.append(
                f'<tr><th scope="row">{_as_html("", name)}{small}</th><td '
                f'class="figure">{shown}</td></tr>'
            )
        if rows:
            head = f'<tr><th scope="rowgroup" colspan="2">{_as_html("", stage)}</th></tr>'
            bodies.append(f'<tbody class="stage">{head}{"".join(rows)}</tbody>')
    return f'<table class="errors">{"".join(bodies)}</table>' if bodies else ""


def _flat(key: str, value: Any) -> list[tuple[str, Any]]:
    """Return a nested table's finite figures by dotted key, None for others."""
    if isinstance(value, Mapping):
        return [row for k, v in value.items() for row in _flat(f"{key}.{k}", v)]
    numbers = isinstance(value, list | tuple | np.ndarray | float | np.floating)
    return [(key, None if numbers and finite(value) is None else value)]


def _reason(reasons: Mapping[str, Any], key: str) -> str:
    """Return why a figure is missing: its own reason, or that of the table it stands in."""
    while key:
        if key in reasons:
            return str(reasons[key])
        key = key.rpartition(".")[0]
    return "not computed"


def _times(timings: Mapping[str, float]) -> str:
    times = {k: t for k, t in ((k, finite(v)) for k, v in timings.items()) if t is not None}
    if not times:
        return ""
    longest = max(times.values()) or 1.0
    rows = [
        f'<tr><th scope="row">{_as_html("", stage.replace("_", " "))}</th><td '
        f'class="figure">{_seconds(seconds)}</td><td><span class="bar" '
        f'style="width:{100 * max(seconds, 0) / longest:.1f}%"></span></td></tr>'
        for stage, seconds in times.items()
    ]
    if len(times) > 1:
        total = sum(times.values())
        rows.append(
            f'<tr><th scope="row">together</th><td '
            f'class="figure">{_seconds(total)}</td><td></td></tr>'
        )
    return f'<table class="times"><tbody>{"".join(rows)}</tbody></table>'


def _seconds(value: float) -> str:
    return f"{digits(1000 * value)} ms" if value < 1 else f"{digits(value)} s"


def _is_alarm(key: str, value: Any) -> bool:
    return ("warning" in key or key == "validity") and isinstance(value, str | list | tuple)


def _alarms(facts: Mapping[str, Any]) -> list[str]:
    """Return the warnings among the facts."""
    found: list[str] = []
    for key, value in facts.items():
        if isinstance(value, Mapping):
            found += _alarms(value)
        elif _is_alarm(key, value):
            found += [value] if isinstance(value, str) else [str(v) for v in value]
    return [_sentence(text) for text in map(str.strip, found) if text]


def _sentence(text: str) -> str:
    """Return a text with a capital letter at its start, unless it begins with a recipe's key."""
    first = text.split()[0]
    return text if "." in first else text[0].upper() + text[1:]


def _facts(facts: Mapping[str, Any]) -> str:
    rows = [
        f"<dt>{_as_html('', Unit(key).words)}</dt><dd>{_as_html(key, value)}</dd>"
        for key, value in _calm(facts).items()
    ]
    return f"<dl>{''.join(rows)}</dl>" if rows else ""


def _calm(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts without the warnings."""
    return {
        key: _calm(value) if isinstance(value, Mapping) else value
        for key, value in facts.items()
        if not _is_alarm(key, value)
    }


def _name_of(key: str) -> tuple[str, str]:
    """Return name and meaning of ``stage.key``; ``stage.group.key`` means the same."""
    stage, _, rest = key.partition(".")
    *groups, last = rest.split(".")
    if not last:
        return "all figures", ""
    words = WORDS.get(f"{stage}.{last}", {})
    name = words.get("name", Unit(last).words)
    return " ".join([*(g.replace("_", " ") + ":" for g in groups), name]), words.get("meaning", "")


def _as_html(key: str, value: Any) -> str:
    """Return any value as HTML: numbers in their unit, lists and tables spelt out, texts
    escaped."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f'<data value="{value!r}">{Unit(key).amount(value)}</data>'
    if isinstance(value, Mapping):
        kind, between = ("_error", ", ") if key.endswith("error") else ("", "<br>")
        rows = []
        for k, v in value.items():
            name, inside = escape(Unit(str(k)).words), _as_html(f"{k}{kind}", v)
            rows.append(f"{name} ({inside})" if isinstance(v, Mapping) else f"{name}: {inside}")
        return between.join(rows) or "none"
    if isinstance(value, list | tuple):
        return _list(key, value) if len(value) else "none"
    return escape(str(value))


def _list(key: str, values: Sequence[Any]) -> str:
    """Return a vector as ``(1, 2) mm``, any other list as bullets."""
    if all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values
    ):
        unit = Unit(key)
        shown = [(v, digits(unit.times * v)) for v in _cleaned(values)]
        numbers = ", ".join(f'<data value="{v!r}">{text}</data>' for v, text in shown)
        return f"({numbers}) {unit.name}".rstrip()
    return "<ul>" + "".join(f"<li>{_as_html(key, v)}</li>" for v in values) + "</ul>"


def _cleaned(numbers: Sequence[float], scale: float = 0.0) -> list[float]:
    """Return a vector's components with round-off (1e-9 of the largest, or of ``scale``) as
    zero."""
    largest = max(scale, *(abs(n) for n in numbers))
    return [0.0 if abs(n) < 1e-9 * largest else n for n in numbers]


_GROSS_PX = 1.0
"""A tracking error above this is a wrong match and not noise: it is counted instead of drawn."""


@dataclass(frozen=True, kw_only=True)
class _Sighting:
    """(n,) markers in the picture, px, NaN where unknown; whether a tracker was run."""

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
    """Return what a run knows of its markers in the picture, if anything."""
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
    """Return (n, 2) rest places and shifts, px, of the visible outlines, else of the centres."""
    rest, pressed = truth.marker_outline_rest_px, truth.marker_outline_pressed_px
    if not (len(rest) and len(pressed)):
        rest, pressed = truth.marker_rest_px, truth.marker_pressed_px
    return rest, pressed - rest


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
    return f'{two_columns(figures)}<p class="note">{keys}{note}</p>' + _error_map(seen, axes)


def _window(seen: _Sighting, size_px: tuple[int, int] | None) -> Axes:
    """Return the part of the picture in which the markers are."""
    left, right, low, high = _around(np.vstack([seen.true_rest_px, seen.tracked_rest_px]))
    if size_px is None:
        return Axes.equal(left, right, high, low)
    bottom, side = size_px[0] - 0.5, size_px[1] - 0.5
    return Axes.equal(max(left, -0.5), min(right, side), min(high, bottom), max(low, -0.5))


def _shifts(seen: _Sighting, axes: Axes, scale: float, name: str, style: str, mask: Bools) -> str:
    lost = int((mask & seen.lost).sum())
    content = (
        axes.arrows(seen.true_rest_px[mask], scale * seen.true_shift_px[mask], f"truth {style}")
        + axes.dots(seen.place_px[mask], f"dot {style}", 1.4)
        + axes.arrows(
            seen.tracked_rest_px[mask],
            scale * seen.tracked_shift_px[mask],
            f"tracked {style}",
        )
        + axes.crosses(seen.place_px[mask & seen.lost])
    )
    markers = f"{int(mask.sum())} markers"
    say = f"Shifts of the {name} layer in the picture, {markers}, {lost} not tracked"
    caption = f"{escape(name)} layer, {markers}" + (f", {lost} not tracked (×)" if lost else "")
    return figure(axes.drawing(content, "column (px)", "row (px)", say), caption)


def _error_map(seen: _Sighting, axes: Axes) -> str:
    """Return the map of tracked minus true shifts."""
    error = seen.tracked_shift_px - seen.true_shift_px
    size = np.hypot(error[:, 0], error[:, 1])
    fine = size <= _GROSS_PX
    if not fine.any():
        return ""
    usual = float(np.sqrt(np.mean(error[fine] ** 2)))
    pitch = mean_spacing(seen.place_px)
    scale = nice(max(pitch, 20 / axes.per_unit) / usual / 1.5) if usual > 0 else 1.0
    content = ""
    for _, style, mask in _layers(seen.layer):
        kept = mask & fine
        content += axes.arrows(seen.true_rest_px[kept], scale * error[kept], f"tracked {style}")
    gross = int((size > _GROSS_PX).sum())
    left_out = f"; {gross} above {digits(_GROSS_PX)} px are left out" if gross else ""
    spread = f"root mean square {digits(usual)} px per axis"
    say = f"Tracking errors of {int(fine.sum())} markers, {spread}"
    caption = (
        f"Tracking error (tracked minus true shift), drawn {digits(scale)} times as long as it "
        f"is; {spread}{left_out}. Noise looks random here, a bias ordered."
    )
    return figure(axes.drawing(content, "column (px)", "row (px)", say), caption, "single")


def _motion(result: RunResult) -> str:
    """Return drawings and table of the markers' motion; empty if nobody looked."""
    truth = result.truth
    seen = _sighting(result)
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
        content = axes.arrows(places[mask], scale * steps[mask], f"tracked {style}")
        content += axes.dots(places[mask], f"dot {style}", 1.4)
        say = f"Displacement of the {name} markers along x and y, {int(mask.sum())} markers"
        caption = f"{escape(name)} layer, {int(mask.sum())} markers"
        figures.append(figure(axes.drawing(content, "x (mm)", "y (mm)", say), caption))
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
    along = "largest along z, mm"
    names = ["markers", "z at rest, mm", "largest, mm", "root mean square, mm", along]
    return _by_column("True displacement of the markers", heads, names, columns)


def _forces(result: RunResult) -> str:
    """Return drawings and profile of the force field; empty without sites."""
    truth, found = result.truth, result.estimate
    if found is None or len(found.site_mm) == 0:
        return ""
    fields: list[tuple[str, Floats]] = []
    if truth is not None and len(truth.surface_mm):
        fields.append(("truth", truth.force_at(found.site_mm)))
    if len(found.force_n) == len(found.site_mm):
        fields.append(("estimate", found.force_n))
    if not fields:
        return ""
    return _maps(result, found.site_mm, fields) + _profile(found.site_mm, fields)


def _cell_side(sites: Points) -> float:
    """Return the least distance of two sites seen along z, mm."""
    apart = pdist(sites[:, :2])
    return float(min(apart[apart >= 1e-6], default=1.0))


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
        axes, content, pushed = Axes.force_field(sites[:, :2], force, side, normal, per_cell)
        if outline is not None:
            middle, radius = outline
            ((x, y),) = axes.place(np.array([middle]))
            reach = radius * axes.per_unit
            content += f'<circle class="contact" cx="{x:.1f}" cy="{y:.1f}" r="{reach:.1f}"/>'
        content += axes.dots(sites[:, :2], "site", 0.9) + pushed
        peak = int(np.argmax(np.abs(force[:, 2])))
        where = f"({digits(float(sites[peak, 0]))}, {digits(float(sites[peak, 1]))}) mm"
        say = (
            f"Force field, {name}: largest force along z {digits(float(force[peak, 2]))} N at "
            f"{where}"
        )
        panels.append(figure(axes.drawing(content, "x (mm)", "y (mm)", say), name.capitalize()))
    top = digits(normal)
    bar = (
        f'<div class="ramp"><span>−{top} N</span><span class="colours"></span>'
        f"<span>{top} N</span></div>"
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
    truth = result.truth
    radius = finite(result.facts.get("contact", {}).get("contact_radius_mm"))
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
    content = axes.line(zero, "zero")
    for name, force in fields:
        points = np.column_stack([x, force[row, 2]])
        content += axes.line(points, f"profile {name}") + axes.dots(
            points, f"profile-dot {name}", 2.4
        )
    at = digits(float(sites[strongest, 1]))
    keys = " ".join(f'<span class="key {name}-line">{name}</span>' for name, _ in fields)
    say = f"Force along z on the sites at y = {at} mm"
    svg = axes.drawing(content, "x (mm)", "force along z (N)", say)
    return figure(svg, f"Through the contact, y = {at} mm. {keys}", "single")


def _resultants(result: RunResult) -> str:
    totals: list[tuple[str, Floats, Floats]] = []
    note = ""
    for name, arrays in (("truth", result.truth), ("estimate", result.estimate)):
        if arrays and len(arrays.total_force_n) == len(arrays.total_torque_nmm) == 3:
            totals.append((name, arrays.total_force_n, arrays.total_torque_nmm))
    estimate = result.estimate
    if estimate is not None and len(estimate.force_n) and len(estimate.total_force_n) == 3:
        totals.append(("standard deviation", estimate.sd_total_n, estimate.sd_torque_nmm))
        total = estimate.force_n.sum(axis=0)
        if not np.allclose(total, estimate.total_force_n, rtol=1e-6, atol=1e-9):
            torque = np.cross(estimate.site_mm, estimate.force_n).sum(axis=0)
            totals.append(("sum of the sites", total, torque))
            note = f'<p class="note">{_TWO_TOTALS}</p>'
    if not totals:
        return ""
    heads = [head for head, *_ in totals]
    # a torque below a billionth of the force times a millimetre is round-off
    forces = [_cleaned(force.tolist()) for _, force, _ in totals]
    torques = [
        _cleaned(torque.tolist(), 1.0 * float(np.abs(force).max())) for _, force, torque in totals
    ]
    columns = [
        [*one, *other] for one, other in zip(_aligned(forces), _aligned(torques), strict=True)
    ]
    names = [f"force along {a},&nbsp;N" for a in "xyz"]
    names += [f"torque about {a}, N&nbsp;mm" for a in "xyz"]
    return _by_column("Total force, and torque about the origin", heads, names, columns) + note


def _aligned(columns: Sequence[Sequence[float]]) -> list[list[str]]:
    """Return columns of numbers with the decimals that give the largest three digits."""
    largest = max(abs(n) for column in columns for n in column)
    decimals = max(0, 2 - math.floor(math.log10(largest))) if largest > 0 else 0
    return [
        [
            f'<data value="{n!r}">{round(n, decimals) + 0.0:.{decimals}f}</data>'.replace(
                ">-", ">−"
            )
            for n in column
        ]
        for column in columns
    ]


_TWO_TOTALS = (
    "There are two estimates of the total. <b>Estimate</b> is solved without bounds: it has "
    "hardly a bias, but some sites may pull. <b>Sum of the sites</b> adds the forces drawn below, "
    "which only push or obey friction; bounds pull it to one side. How far the two differ shows "
    "how uncertain the force is."
)


def _by_column(caption: str, heads: list[str], names: list[str], columns: list[list[str]]) -> str:
    cells = zip(*columns, strict=True)
    return table(caption, heads, [(n, list(c)) for n, c in zip(names, cells, strict=True)])


def _touched(result: RunResult) -> str:
    """Return the drawings under every probe; empty if nothing touches."""
    return "".join(two_columns([_map(one), _pressure(one)]) for one in result.touches)


def _map(one: RunResult.Touch) -> str:
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
        content += axes.arrows(one.place_mm, one.shear_mpa * length, "force")
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
    return figure(axes.drawing(content, "along the surface (mm)", "across that (mm)", say), caption)


def _pressure(one: RunResult.Touch) -> str:
    distance = np.hypot(one.place_mm[:, 0], one.place_mm[:, 1])
    theory = one.expected
    shown = theory[theory[:, 1] <= 1.3 * one.pressure_mpa.max()]
    right = float(max(distance.max(), shown[:, 0].max(initial=0.0))) * 1.05
    top = float(max(one.pressure_mpa.max(), shown[:, 1].max(initial=0.0))) * 1.08
    axes = Axes(left=0.0, right=right, bottom=0.0, top=top, height=260)
    content = axes.line(shown, "profile truth") if len(shown) else ""
    content += axes.dots(np.column_stack([distance, one.pressure_mpa]), "profile-dot estimate", 2.0)
    keys = ""
    if len(shown):
        keys = (
            ' <span class="key estimate-line">this press</span>'
            f' <span class="key truth-line">{one.expected_name}, same force</span>'
        )
    peak = digits(float(one.pressure_mpa.max()))
    say = f"Pressure of every patch against its distance from the middle, at most {peak} N/mm²"
    svg = axes.drawing(content, "from the contact's middle (mm)", "pressure (N/mm²)", say)
    return figure(svg, f"Pressure of each patch.{keys}")


def _layers(names: np.ndarray) -> list[tuple[str, str, Bools]]:
    """Return name, style and mask of every layer: styles are colours' names, or the remaining ones
    in turn."""
    ordered = list(dict.fromkeys(names.tolist()))
    spare = iter([s for s in ("blue", "red") if s not in ordered] + ["other"] * len(ordered))
    own = ("red", "blue")
    return [(str(n), str(n) if n in own else next(spare), names == n) for n in ordered]


def _scale_note(scale: float, size: float, unit: str, directions: str) -> str:
    """Return how arrows are drawn: ``scale`` times as long; the longest is ``size`` in ``unit``."""
    if size == 0:
        return f"No marker moves. {directions}"
    drawn = f"drawn {digits(scale)} times as long as they are" if scale != 1 else "true to scale"
    return f"Arrows are {drawn}; the longest is {digits(size)} {unit}. {directions}"


def _longest(vectors: Floats) -> float:
    """Return the length of the longest of (n, 2) vectors, NaN apart; 0 if there is none."""
    sizes = np.hypot(vectors[:, 0], vectors[:, 1])
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.max()) if len(sizes) else 0.0


def _magnification(axes: Axes, names: np.ndarray, places: Floats, size: float) -> float:
    """Return the round factor at which an arrow of ``size`` is about a layer's pitch long."""
    pitch = min(mean_spacing(places[mask]) for _, _, mask in _layers(names))
    return nice(1.5 * max(pitch, 20 / axes.per_unit) / size) if size > 0 else 1.0


def _around(points: Floats) -> tuple[float, float, float, float]:
    """Return left, right, low and high of a window with a margin around (n, 2) points."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return -1.0, 1.0, -1.0, 1.0
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * max(right - left, high - low) or 1.0
    return float(left - margin), float(right + margin), float(low - margin), float(high + margin)
