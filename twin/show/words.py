"""Numbers and keys in words: what a figure is called, how many digits it is worth, and which unit it has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

UNITS = {
    "mm": "mm", "n": "N", "nmm": "N mm", "mpa": "MPa", "deg": "°", "px": "px", "s": "s", "pct": "%", "mm2": "mm²",
    "mm3": "mm³",
}  # fmt: skip
"""Unit of a key by its suffix. `show` reads results only, so it doesn't ask the parts for theirs."""

NAMES = {
    "elastic.displacement_error": ("displacement error", "estimated, over the largest displacement"),
    "elastic.largest_displacement_mm": ("largest displacement", "of a marker, for comparison"),
    "elastic.largest_strain": ("largest strain", "principal, by linear theory, at a marker"),
    "elastic.largest_turn_deg": ("largest turn", "of the rubber at a marker"),
    "elastic.contact_over_probe_radius": ("contact radius / probe radius", "of a sphere; linear contact wants 0.3"),
    "elastic.linearisation_error": (
        "cost of linearity",
        "expected at most at the markers, over the largest displacement",
    ),
    "elastic.contact_residual": ("contact residual", "what is left of the contact's equations, as a share"),
    "tracking.bias_px": ("bias", "length of the mean of tracked minus true shift"),
    "tracking.bias_axes_px": ("bias by axis", "mean of tracked minus true shift, column and row"),
    "tracking.sd_px": ("standard deviation", "of the two-frame shift, per axis, markers in full view"),
    "tracking.sd_axes_px": ("standard deviation by axis", "column and row"),
    "tracking.false_positives": ("false positives", "markers given a shift though nothing of them is to be seen"),
    "tracking.bound_px": ("bound", "least standard deviation that the pictures' noise allows (Cramer and Rao)"),
    "tracking.over_bound": ("over the bound", "standard deviation over the bound"),
    "tracking.matched": ("matched", "visible markers found again in the pressed picture"),
    "tracking.gross": ("gross errors", "markers found at a wrong place; left out above"),
    "tracking.markers": ("markers", "that this stage counts"),
    "force.field_error": ("field error", "length of the difference over length of the truth, by site cell"),
    "force.field_error_normal": ("field error, normal", "the same of the forces along the inward normals"),
    "force.field_error_tangential": ("field error, tangential", "the same of the forces along the surface"),
    "force.total_force_error_axes": ("total force error by axis", "x, y and z, over the size of the resultant"),
    "force.total_force_error": ("total force error", "of the resultant, over its size"),
    "force.torque_error": ("torque error", "of the torque about the origin, over its size"),
    "force.centre_error_mm": ("centre error", "distance between true and estimated centre of force"),
}
"""Names and meanings of the figures of ``score.json``; others are named by their key."""

SHARES = ("_error", "matched", "share", "ratio")
"""Endings of keys that hold a ratio, told in percent."""


def split_unit(key: str) -> tuple[str, str]:
    """Return a key's words and its unit: ``contact_radius_mm`` -> ``("contact radius", "mm")``."""
    stem, _, suffix = key.rpartition("_")
    if stem and suffix in UNITS:
        return stem.replace("_", " "), UNITS[suffix]
    return key.replace("_", " "), ""


def name_of(key: str) -> tuple[str, str]:
    """Return name and meaning of a figure given as ``stage.key``; ``stage.group.key`` means what ``stage.key`` does."""
    if key in NAMES:
        return NAMES[key]
    stage, *groups = key.split(".")
    if not groups:
        return "all figures", ""
    *groups, last = groups
    name, meaning = NAMES.get(f"{stage}.{last}", (split_unit(last)[0], ""))
    return " ".join([*(g.replace("_", " ") + ":" for g in groups), name]), meaning


def digits(value: float) -> str:
    """Return a number with three significant digits and a true minus sign."""
    text = f"{value:.3g}"
    if "e+" in text and abs(value) < 1e6:
        text = f"{value:.0f}"
    return text.replace("-", "−")


def finite(value: Any) -> float | None:
    """Return a number, the largest finite one of a list of them, or None if there is none."""
    if isinstance(value, bool) or value is None or isinstance(value, str | Mapping):
        return None
    if isinstance(value, Sequence | np.ndarray):
        numbers = [n for n in map(finite, value) if n is not None]
        return max(numbers, key=abs) if numbers else None
    return float(value) if math.isfinite(value) else None


def amount(key: str, value: float) -> str:
    """Return a number in the unit of its key: ``1.2 %``, ``0.05 mm``, ``3``."""
    if not isinstance(value, int) and key.endswith(SHARES):
        return f"{digits(100 * value)} %"
    unit = split_unit(key)[1]
    return digits(value) + (f" {unit}" if unit else "")


def cleaned(numbers: Sequence[float], scale: float = 0.0) -> list[float]:
    """Return the components of one vector with round-off (1e-9 of the largest, or of ``scale``) as zero."""
    largest = max(scale, *(abs(n) for n in numbers))
    return [0.0 if abs(n) < 1e-9 * largest else n for n in numbers]


def told(key: str, value: Any) -> str:
    """Return any value of a result as HTML: numbers in their unit, lists and tables spelt out, texts escaped."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f'<data value="{value!r}">{amount(key, value)}</data>'
    if isinstance(value, Mapping):
        return "<br>".join(f"{escape(split_unit(str(k))[0])}: {told(str(k), v)}" for k, v in value.items()) or "none"
    if isinstance(value, list | tuple):
        return _list(key, value) if len(value) else "none"
    return escape(str(value))


def _list(key: str, values: Sequence[Any]) -> str:
    """Return a vector as ``(1, 2) mm``, any other list as bullets."""
    if all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values):
        unit = split_unit(key)[1]
        numbers = ", ".join(f'<data value="{v!r}">{digits(v)}</data>' for v in cleaned(values))
        return f"({numbers})" + (f" {unit}" if unit else "")
    return "<ul>" + "".join(f"<li>{told(key, v)}</li>" for v in values) + "</ul>"


def table(caption: str, heads: list[str], rows: list[tuple[str, list[str]]]) -> str:
    """Return a table of numbers as HTML: ``heads`` over the columns, each row a name and its cells (all HTML)."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "".join(
        f'<tr><th scope="row">{name}</th>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>' for name, cells in rows
    )
    return (
        f'<div class="wide"><table class="numbers"><caption>{caption}</caption>'
        f"<thead><tr><td></td>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )
