"""What the numbers of a run mean: a sentence each, with unit and verdict (``twin explain``).

The verdicts good, fair and poor are a scale of this program, not of a paper: `LIMITS` holds both
limits of every number, and each verdict is printed with the limit of good.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.show.html_page import digits, finite

LIMITS = {
    "elastic.displacement_error": (0.01, 0.05),
    "elastic.markers_error": (0.01, 0.05),
    "elastic.force_error": (0.01, 0.05),
    "elastic.linearisation_error": (0.02, 0.1),
    "tracking.bias_px": (0.02, 0.1),
    "tracking.sd_px": (0.03, 0.15),
    "tracking.over_bound": (1.5, 3.0),
    "tracking.unmatched": (0.02, 0.2),
    "tracking.gross": (0.0, 2.0),
    "tracking.false_positives": (0.0, 2.0),
    "force.total_force_error": (0.05, 0.2),
    "force.sites_force_error": (0.1, 0.3),
    "force.torque_error": (0.1, 0.3),
    "force.centre_error_mm": (0.1, 0.5),
    "force.field_error": (0.3, 0.7),
    "force.field_error_normal": (0.3, 0.7),
    "force.field_error_tangential": (0.3, 0.7),
}
"""Largest good and largest fair value of every number that has a verdict."""

_SENTENCES = {
    "elastic.largest_displacement_mm": "The marker that moves most moves by {}.",
    "elastic.displacement_error": "The computed displacements are off by at most {} of the largest "
    "one; this is an estimate of the mesh's error, at finite strain of all errors.",
    "elastic.markers_error": "All causes together, the markers' true displacements are off by at "
    "most {} of the largest one.",
    "elastic.force_error": "The force of the simulated probe is off by {}; 0 % where the press is "
    "held by its force.",
    "elastic.indentation_error": "The simulated indentation is off by {}.",
    "elastic.linearisation_error": "Large strain, which linear theory leaves out, would change the "
    "markers' displacements by {} of the largest one at most.",
    "elastic.largest_strain": "The rubber at the markers is strained by up to {}.",
    "elastic.contact_over_probe_radius": "The contact's radius is {} of the probe's; linear "
    "contact holds up to about 30 %.",
    "tracking.matched": "The tracker found {} of the markers in full view.",
    "tracking.sd_px": "It measures a marker's motion with a noise of {} (standard deviation along "
    "each axis).",
    "tracking.bias_px": "All its motions together are shifted by {} from the truth.",
    "tracking.over_bound": "Its noise is {} times the least that the pictures' noise allows "
    "(Cramer and Rao).",
    "tracking.gross": "{} markers were taken for another one, or are more than 1 px off.",
    "tracking.false_positives": "{} markers that are not in the picture were given a motion.",
    "force.total_force_error": "The recovered total force is off by {} of the true one.",
    "force.total_force_stated": "The software itself states an error of {} (one standard "
    "deviation).",
    "force.sites_force_error": "The sum of the forces of all sites is off by {}; it differs from "
    "the total where sites are left out or held to bounds.",
    "force.torque_error": "The recovered torque about the origin is off by {}.",
    "force.centre_error_mm": "The recovered centre of the contact is {} from the true one.",
    "force.field_error": "Site by site, the force field is off by {} (length of all differences "
    "over length of all true forces). Markers hardly see forces that vary over less than their "
    "depth, so this is large under small probes even where total and centre are right.",
    "force.field_error_normal": "The same of the forces into the surface: {}.",
    "force.field_error_tangential": "The same of the forces along the surface: {}.",
}
"""A sentence for every number, in the order in which they are explained."""

_COUNTS = ("tracking.gross", "tracking.false_positives")
_FACTORS = ("tracking.over_bound",)

NEARLY_INCOMPRESSIBLE = 0.45
"""Poisson's ratio from which a layer near the surface hardly moves sideways under a push."""


_ROUND_OFF = 1e-9
"""Errors below this are printed as 0."""


@dataclass(frozen=True, kw_only=True)
class _Finding:
    """One number of a run, explained.

    Attributes
    ----------
    key
        Where it stands in ``score.json``, such as ``force.total_force_error``.
    value, unit
        The number, None where it is not defined, and its unit; empty for a count or a factor.
    sentence
        What it means for this run.
    verdict
        ``good``, ``fair``, ``poor``, or empty where there is no scale.
    """

    key: str
    value: float | None
    unit: str
    sentence: str
    verdict: str

    def line(self) -> str:
        """Return it as a line for a terminal, the verdict first."""
        limit = LIMITS.get(_limit_key(self.key))
        behind = f" ({_good(self.key, limit[0])})" if limit is not None and self.verdict else ""
        return f"{self.verdict or '-':5s} {self.sentence}{behind}"


def explain(score: Mapping[str, Any], scene_toml: str = "") -> list[_Finding]:
    """Explain the numbers of a run.

    Parameters
    ----------
    score
        What ``score.json`` holds.
    scene_toml
        The run's resolved scene, for causes that lie in its design.

    Returns
    -------
    A finding for every number that has a sentence, stage by stage; numbers that are not defined
    have the reason as their sentence.
    """
    reasons = score.get("reasons") or {}
    large_strain = _table(scene_toml, "material").get("law", "linear") != "linear"
    found = []
    for key, sentence in _SENTENCES.items():
        stage, name = key.split(".")
        table = score.get(stage)
        if not isinstance(table, Mapping) or name not in table:
            continue
        value = finite(table[name])
        if value is None:
            reason = reasons.get(key)
            if reason is not None:
                none = f"not defined, as {reason}"
                if sentence.endswith(": {}."):
                    said = sentence.format(none)
                else:
                    said = f"{name.removesuffix('_mm').replace('_', ' ')}: {none}."
                found.append(_Finding(key=key, value=None, unit="", sentence=said, verdict=""))
            continue
        amount, unit = _amount(key, value)
        text = sentence.format(amount)
        verdict = _verdict(key, value)
        if key == "elastic.linearisation_error" and large_strain:
            text = f"Large strain, which is included, moves the markers by {amount} of the largest "
            text += "displacement more or less than linear theory."
            verdict = ""
        if key == "force.total_force_error" and verdict != "good":
            text = f"{text} {one_layer(scene_toml)}".rstrip()
        found.append(_Finding(key=key, value=value, unit=unit, sentence=text, verdict=verdict))
    return found


def one_layer(scene_toml: str) -> str:
    """Return why the force into the surface is uncertain where a scene has one layer of markers in
    nearly incompressible rubber; empty for any other."""
    layers = _table(scene_toml, "markers")
    ratio = _table(scene_toml, "material").get("poisson_ratio")
    if not isinstance(ratio, int | float):
        return ""
    if len(layers) != 1 or ratio < NEARLY_INCOMPRESSIBLE:
        return ""
    return (
        f"This sensor has one layer of markers in nearly incompressible rubber (Poisson's ratio "
        f"{ratio:g}): a push moves such a layer down more than sideways, and the camera sees "
        "sideways motion only. So the force into the surface is uncertain; a second layer at "
        "another depth, or bounds, help (docs/one_layer.md)."
    )


def _table(scene_toml: str, name: str) -> Mapping[str, Any]:
    """Return a table of a scene; empty where there is none."""
    try:
        table = tomllib.loads(scene_toml).get(name)
    except tomllib.TOMLDecodeError:
        return {}
    return table if isinstance(table, Mapping) else {}


def _limit_key(key: str) -> str:
    return "tracking.unmatched" if key == "tracking.matched" else key


def _good(key: str, limit: float) -> str:
    if key == "tracking.matched":
        return f"good: {digits(100 * (1 - limit))} % or more"
    return f"good: up to {_amount(key, limit)[0]}" if limit else "good: none"


def _verdict(key: str, value: float) -> str:
    limits = LIMITS.get(_limit_key(key))
    if limits is None:
        return ""
    size = 1.0 - value if key == "tracking.matched" else abs(value)
    good, fair = limits
    if size <= good:
        return "good"
    return "fair" if size <= fair else "poor"


def _amount(key: str, value: float) -> tuple[str, str]:
    """Return a number in words with its unit, and the unit of the number as it is stored."""
    if key in _COUNTS:
        return f"{value:.0f}", ""
    if abs(value) < _ROUND_OFF:
        value = 0.0
    if key in _FACTORS:
        return digits(value), ""
    for unit in ("mm", "px"):
        if key.endswith(f"_{unit}"):
            return f"{digits(value)} {unit}", unit
    return f"{digits(100 * value)} %", "1"
