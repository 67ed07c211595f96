"""Numbers and keys in words: what a figure is called, how many digits it is worth, and which unit it has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

UNITS = {
    "mm": "mm", "n": "N", "nmm": "N mm", "mpa": "MPa", "deg": "°", "px": "px", "s": "s", "pct": "%", "mm3": "mm³",
}  # fmt: skip
"""Unit of a key by its suffix. `show` reads results only, so it doesn't ask the parts for theirs."""

NAMES = {
    "tracking.bias_px": ("bias", "mean of tracked minus true shift"),
    "tracking.sd_px": ("standard deviation", "of the two-frame shift, per axis, markers in full view"),
    "tracking.matched": ("matched", "visible markers found again in the pressed picture"),
    "tracking.gross": ("gross errors", "markers tracked to a wrong place"),
    "force.field_error": ("field error", "squared difference over squared truth, by site cell"),
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
    """Return name and meaning of a figure given as ``stage.key``."""
    return NAMES.get(key) or (split_unit(key.split(".", 1)[-1].replace(".", " "))[0], "")


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


def told(key: str, value: Any) -> str:
    """Return any value of a result as HTML: numbers in their unit, lists and tables spelt out, texts escaped."""
    if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
        return "none"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int | float):
        return f'<data value="{value!r}">{amount(key, value)}</data>'
    if isinstance(value, Mapping):
        return "<br>".join(f"{escape(split_unit(str(k))[0])}: {told(str(k), v)}" for k, v in value.items()) or "none"
    if isinstance(value, list | tuple | np.ndarray):
        if len(value) and all(isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in value):
            return ", ".join(told(key, v) for v in value)
        return "<ul>" + "".join(f"<li>{told(key, v)}</li>" for v in value) + "</ul>" if len(value) else "none"
    return escape(str(value))
