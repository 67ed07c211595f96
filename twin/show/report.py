"""The report of a run: one page for people, from the results alone.

Parts that a run didn't compute are left out: a report never fails for lack of something, and never makes up for it.
"""

from __future__ import annotations

import base64
import io
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.arrays import Picture
from twin.results import RunResult
from twin.show.motion import motion
from twin.show.page import page
from twin.show.pushes import pushes
from twin.show.touch import touch
from twin.show.words import amount, digits, finite, name_of, split_unit, told

PICTURE_BYTES = 1_000_000
"""Largest PNG put into the page: two of them, spelt in base64, and the drawings stay below 3 MB together."""

WIDEST_PX = 1280
"""Wider pictures are shown smaller at once: none is shown wider than half of a page."""

STAGES = ("elastic", "tracking", "force")
"""Order of the stages in the table of errors; others follow."""


def report(result: RunResult) -> str:
    """Return the report of a run as one self-contained HTML page.

    Parameters
    ----------
    result
        Anything from a bare scene to a full run.
    """
    sections = [
        ("Pictures", _pictures(result)),
        ("Marker motion", motion(result)),
        ("Under the probe", touch(result)),
        ("Forces", pushes(result)),
        ("Errors by stage", _errors(result.score)),
        ("Time", _times(result.timings)),
        ("Facts", _facts(result.facts)),
    ]
    return page(_title(result.scene_toml), verdict(result), _alarms(result.facts), sections, result.scene_toml)


def verdict(result: RunResult) -> str:
    """Return what the run came to, in one sentence."""
    score = result.score or {}
    said = []
    sd, centre = _figure(score, "tracking", "sd_px"), _figure(score, "force", "centre_error_mm")
    if sd is not None:
        said.append(f"the sensor follows its markers to {digits(sd)} px (standard deviation)")
    if (total := _figure(score, "force", "total_force_error")) is not None:
        said.append(f"its total force is off by {amount('_error', total)}")
    if centre is not None:
        said.append(f"it places the centre of the contact {digits(centre)} mm from the truth")
    if not said:
        said = [_without_score(result)]
    text = said[0] if len(said) == 1 else f"{', '.join(said[:-1])} and {said[-1]}"
    return f"{text[0].upper()}{text[1:]}."


def _without_score(result: RunResult) -> str:
    truth = result.truth
    if truth is None or not len(truth.marker_displacement_mm):
        return "the sensor is shown as it was seen" if result.rest is not None else "this run computed no motion"
    size = float(np.linalg.norm(truth.marker_displacement_mm, axis=1).max())
    if size == 0:
        return "nothing presses on the sensor, and no marker moves"
    force = f" under {digits(float(np.linalg.norm(truth.total_force_n)))} N" if len(truth.total_force_n) == 3 else ""
    return f"the markers move by up to {digits(size)} mm{force}"


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
    for name, alt, picture in (
        ("At rest", "Camera picture of the markers at rest", result.rest),
        ("Pressed", "Camera picture of the markers while the probe presses", result.pressed),
    ):
        if picture is not None:
            uri, shown = data_uri(picture)
            height, width = picture.shape[:2]
            smaller = f", shown at {digits(100 * shown)} % of its size" if shown < 1 else ""
            figures.append(
                f'<figure><img src="{uri}" width="{width}" height="{height}" alt="{alt}">'
                f"<figcaption>{name}, {width} × {height} px{smaller}</figcaption></figure>"
            )
    return f'<div class="two">{"".join(figures)}</div>' if figures else ""


def data_uri(picture: Picture) -> tuple[str, float]:
    """Return a picture as a data URI, and the share of its width and height that was kept to bound the page's size."""
    from PIL import Image

    image = Image.fromarray(picture)
    step = -(-image.width // WIDEST_PX)
    while True:
        file = io.BytesIO()
        # level 1: noisy pictures compress no better above it, and take five times as long
        (image.reduce(step) if step > 1 else image).save(file, "PNG", compress_level=1)
        if file.tell() <= PICTURE_BYTES or step >= min(image.size):
            return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}", 1 / step
        step += 1


def _errors(score: Mapping[str, Any] | None) -> str:
    if not score:
        return ""
    given = score.get("reasons")
    reasons: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    stages = [s for s in STAGES if s in score] + [s for s in score if s not in (*STAGES, "reasons", "facts")]
    bodies = []
    for stage in stages:
        figures = list(_flat(stage, score[stage]))
        rows = []
        for key, value in figures:
            name, meaning = name_of(key)
            shown = "—" if value is None else told(key, value)
            meaning = meaning if value is not None else _reason(reasons, key)
            small = f"<small>{told('', meaning)}</small>" if meaning else ""
            rows.append(f'<tr><th scope="row">{told("", name)}{small}</th><td class="figure">{shown}</td></tr>')
        if rows:
            head = f'<tr><th scope="rowgroup" colspan="2">{told("", stage)}</th></tr>'
            bodies.append(f'<tbody class="stage">{head}{"".join(rows)}</tbody>')
    return f'<table class="errors">{"".join(bodies)}</table>' if bodies else ""


def _flat(key: str, value: Any) -> list[tuple[str, Any]]:
    """Return every figure of a nested table under its dotted key; numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return [row for k, v in value.items() for row in _flat(f"{key}.{k}", v)]
    if isinstance(value, list | tuple | np.ndarray):
        return [(key, value if finite(value) is not None else None)]
    if isinstance(value, float | np.floating) and finite(value) is None:
        return [(key, None)]
    return [(key, value)]


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
        f'<tr><th scope="row">{told("", stage.replace("_", " "))}</th><td class="figure">{_seconds(seconds)}</td>'
        f'<td><span class="bar" style="width:{100 * max(seconds, 0) / longest:.1f}%"></span></td></tr>'
        for stage, seconds in times.items()
    ]
    if "total" not in times and len(times) > 1:
        total = sum(times.values())
        rows.append(f'<tr><th scope="row">together</th><td class="figure">{_seconds(total)}</td><td></td></tr>')
    return f'<table class="times"><tbody>{"".join(rows)}</tbody></table>'


def _seconds(value: float) -> str:
    return f"{digits(1000 * value)} ms" if value < 1 else f"{digits(value)} s"


def _is_alarm(key: str, value: Any) -> bool:
    return ("warning" in key or key == "validity") and isinstance(value, str | list | tuple)


def _alarms(facts: Mapping[str, Any]) -> list[str]:
    """Return the warnings among the facts: they stand at the top, where the numbers are read."""
    found: list[str] = []
    for key, value in facts.items():
        if isinstance(value, Mapping):
            found += _alarms(value)
        elif _is_alarm(key, value):
            found += [value] if isinstance(value, str) else [str(v) for v in value]
    return [text[0].upper() + text[1:] for text in map(str.strip, found) if text]


def _facts(facts: Mapping[str, Any]) -> str:
    rows = [
        f"<dt>{told('', split_unit(key)[0])}</dt><dd>{told(key, value)}</dd>" for key, value in _calm(facts).items()
    ]
    return f"<dl>{''.join(rows)}</dl>" if rows else ""


def _calm(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts without the warnings, which are told at the top."""
    return {
        key: _calm(value) if isinstance(value, Mapping) else value
        for key, value in facts.items()
        if not _is_alarm(key, value)
    }
