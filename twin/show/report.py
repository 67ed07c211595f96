"""The page of a run: `report` writes it from the results alone.

A part that the run didn't compute is left out, so that every run has a report.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from twin.results import RunResult
from twin.show.html_page import cleaned, data_uri, digits, figure, finite, page, two_columns
from twin.show.run_figures import motion, pushes, touch

_STAGES = ("elastic", "tracking", "force")
"""Order of the stages in the table of errors; others follow."""

_UNITS = {
    "mm": "mm",
    "n": "N",
    "nmm": "N mm",
    "mpa": "MPa",
    "deg": "°",
    "px": "px",
    "s": "s",
    "pct": "%",
    "mm2": "mm²",
    "mm3": "mm³",
}
"""Unit of a key by its suffix. `show` reads results only, so it doesn't ask the parts for
theirs."""

_NAMES = {
    "elastic.displacement_error": (
        "displacement error",
        "estimated, over the largest displacement",
    ),
    "elastic.largest_displacement_mm": ("largest displacement", "of a marker, for comparison"),
    "elastic.largest_strain": ("largest strain", "principal, by linear theory, at a marker"),
    "elastic.largest_turn_deg": ("largest turn", "of the rubber at a marker"),
    "elastic.contact_over_probe_radius": (
        "contact radius / probe radius",
        "of a sphere; linear contact wants 0.3",
    ),
    "elastic.linearisation_error": (
        "cost of linearity",
        "expected at most at the markers, over the largest displacement",
    ),
    "elastic.contact_residual": (
        "contact residual",
        "what is left of the contact's equations, as a share",
    ),
    "tracking.bias_px": ("bias", "length of the mean of tracked minus true shift"),
    "tracking.bias_axes_px": ("bias by axis", "mean of tracked minus true shift, column and row"),
    "tracking.sd_px": (
        "standard deviation",
        "of the two-frame shift, per axis, markers in full view",
    ),
    "tracking.sd_axes_px": ("standard deviation by axis", "column and row"),
    "tracking.false_positives": (
        "false positives",
        "markers given a shift though nothing of them is to be seen",
    ),
    "tracking.bound_px": (
        "bound",
        "least standard deviation that the pictures' noise allows (Cramer and Rao)",
    ),
    "tracking.over_bound": ("over the bound", "standard deviation over the bound"),
    "tracking.matched": ("matched", "visible markers found again in the pressed picture"),
    "tracking.gross": ("gross errors", "markers found at a wrong place; left out above"),
    "tracking.markers": ("markers", "that this stage counts"),
    "force.field_error": (
        "field error",
        "length of the difference over length of the truth, by site cell",
    ),
    "force.field_error_normal": (
        "field error, normal",
        "the same of the forces along the inward normals",
    ),
    "force.field_error_tangential": (
        "field error, tangential",
        "the same of the forces along the surface",
    ),
    "force.total_force_error_axes": (
        "total force error by axis",
        "x, y and z, over the size of the resultant",
    ),
    "force.total_force_error": ("total force error", "of the resultant, over its size"),
    "force.sites_force_error": (
        "error of the sites' sum",
        "of the sum of the sites' forces; it is not the resultant where they may only push or "
        "obey friction",
    ),
    "force.torque_error": (
        "torque error",
        "of the torque about the origin, over its size or the force times 1 mm, whichever is "
        "larger",
    ),
    "force.torque_error_nmm": ("torque error", "of the torque about the origin"),
    "force.centre_error_mm": (
        "centre error",
        "distance between true and estimated centre of force",
    ),
}
"""Names and meanings of the figures of ``score.json``; others are named by their key."""

_SHARES = ("_error", "matched", "share", "ratio")
"""Endings of keys that hold a ratio, in percent."""


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
    return page(
        _title(result.scene_toml),
        _verdict(result),
        _alarms(result.facts),
        sections,
        result.scene_toml,
    )


def _verdict(result: RunResult) -> str:
    """Return what the run came to, in one sentence."""
    score = result.score or {}
    said = []
    sd, centre = _figure(score, "tracking", "sd_px"), _figure(score, "force", "centre_error_mm")
    if sd is not None:
        said.append(f"the sensor follows its markers to {digits(sd)} px (standard deviation)")
    if (total := _figure(score, "force", "total_force_error")) is not None:
        said.append(f"its total force is off by {_amount('_error', total)}")
    if centre is not None:
        said.append(f"it places the centre of the contact {digits(centre)} mm from the truth")
    if (field := _figure(score, "force", "field_error")) is not None:
        said.append(f"its force field is off by {_amount('_error', field)}")
    if not said:
        said = [_without_score(result)]
    text = said[0] if len(said) == 1 else f"{', '.join(said[:-1])} and {said[-1]}"
    return f"{text[0].upper()}{text[1:]}."


def _without_score(result: RunResult) -> str:
    truth = result.truth
    if truth is None or not len(truth.marker_displacement_mm):
        return (
            "the sensor is shown as it was seen"
            if result.rest is not None
            else "this run computed no motion"
        )
    size = float(np.linalg.norm(truth.marker_displacement_mm, axis=1).max())
    if size == 0:
        return "nothing presses on the sensor, and no marker moves"
    force = (
        f" under {digits(float(np.linalg.norm(truth.total_force_n)))} N"
        if len(truth.total_force_n) == 3
        else ""
    )
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
            image = f'<img src="{uri}" width="{width}" height="{height}" alt="{alt}">'
            figures.append(figure(image, f"{name}, {width} × {height} px{smaller}"))
    return two_columns(figures)


def _errors(score: Mapping[str, Any] | None) -> str:
    if not score:
        return ""
    given = score.get("reasons")
    reasons: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
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
    """Return every figure of a nested table under its dotted key; numbers that are not finite as
    None."""
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
        f'<tr><th scope="row">{_as_html("", stage.replace("_", " "))}</th><td '
        f'class="figure">{_seconds(seconds)}</td><td><span class="bar" '
        f'style="width:{100 * max(seconds, 0) / longest:.1f}%"></span></td></tr>'
        for stage, seconds in times.items()
    ]
    if "total" not in times and len(times) > 1:
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
        f"<dt>{_as_html('', _split_unit(key)[0])}</dt><dd>{_as_html(key, value)}</dd>"
        for key, value in _calm(facts).items()
    ]
    return f"<dl>{''.join(rows)}</dl>" if rows else ""


def _calm(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts without the warnings, which stand at the top."""
    return {
        key: _calm(value) if isinstance(value, Mapping) else value
        for key, value in facts.items()
        if not _is_alarm(key, value)
    }


def _split_unit(key: str) -> tuple[str, str]:
    """Return a key's words and its unit: ``contact_radius_mm`` -> ``("contact radius", "mm")``."""
    stem, _, suffix = key.rpartition("_")
    if stem and suffix in _UNITS:
        return stem.replace("_", " "), _UNITS[suffix]
    return key.replace("_", " "), ""


def _name_of(key: str) -> tuple[str, str]:
    """Return name and meaning of a figure given as ``stage.key``; ``stage.group.key`` means what
    ``stage.key`` does."""
    if key in _NAMES:
        return _NAMES[key]
    stage, *groups = key.split(".")
    if not groups:
        return "all figures", ""
    *groups, last = groups
    name, meaning = _NAMES.get(f"{stage}.{last}", (_split_unit(last)[0], ""))
    return " ".join([*(g.replace("_", " ") + ":" for g in groups), name]), meaning


def _amount(key: str, value: float) -> str:
    """Return a number in the unit of its key: ``1.2 %``, ``0.05 mm``, ``3``."""
    if not isinstance(value, int) and key.endswith(_SHARES):
        return f"{digits(100 * value)} %"
    unit = _split_unit(key)[1]
    return digits(value) + (f" {unit}" if unit else "")


def _as_html(key: str, value: Any) -> str:
    """Return any value of a result as HTML: numbers in their unit, lists and tables spelt out,
    texts escaped."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f'<data value="{value!r}">{_amount(key, value)}</data>'
    if isinstance(value, Mapping):
        return (
            "<br>".join(
                f"{escape(_split_unit(str(k))[0])}: {_as_html(str(k), v)}" for k, v in value.items()
            )
            or "none"
        )
    if isinstance(value, list | tuple):
        return _list(key, value) if len(value) else "none"
    return escape(str(value))


def _list(key: str, values: Sequence[Any]) -> str:
    """Return a vector as ``(1, 2) mm``, any other list as bullets."""
    if all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values
    ):
        unit = _split_unit(key)[1]
        numbers = ", ".join(f'<data value="{v!r}">{digits(v)}</data>' for v in cleaned(values))
        return f"({numbers})" + (f" {unit}" if unit else "")
    return "<ul>" + "".join(f"<li>{_as_html(key, v)}</li>" for v in values) + "</ul>"
