"""What the numbers of a run mean: a sentence each, with unit and verdict (``twin explain``).

Each verdict is printed with its limit of good.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.show.html_page import Unit, digits, finite

WORDS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("score_words.toml").read_text(encoding="utf-8")
)
"""Texts about each number of ``score.json``, by its key."""

LIMITS = {key: words["limits"] for key, words in WORDS.items() if "limits" in words}
"""Largest good and largest fair value; of the markers found, the share that is missing."""


@dataclass(frozen=True, kw_only=True)
class _Finding:
    """A number of a run by its key in ``score.json``, its unit (empty for a count or a factor), its
    sentence, and its verdict: ``good``, ``fair``, ``poor``, or empty where there is no scale."""

    key: str
    value: float | None
    unit: str
    sentence: str
    verdict: str

    def line(self) -> str:
        """Return it as a line for a terminal, the verdict first."""
        behind = f" ({_good(self.key, LIMITS[self.key][0])})" if self.verdict else ""
        return f"{self.verdict or '-':5s} {self.sentence}{behind}"


def explain(score: Mapping[str, Any], scene_toml: str = "") -> list[_Finding]:
    """Return a finding for every number of ``score.json`` that has a sentence; undefined ones have
    their reason. Causes that lie in the design are read from the run's resolved scene."""
    reasons, facts = score.get("reasons") or {}, score.get("facts") or {}
    large_strain = _table(scene_toml, "material").get("law", "linear") != "linear"
    found = []
    for key, words in WORDS.items():
        stage, name = key.split(".")
        table = score.get(stage)
        if "sentence" not in words or not isinstance(table, Mapping) or name not in table:
            continue
        sentence = words["sentence"]
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
        unit = Unit(key)
        shown = unit.amount(value)
        text = sentence.format(shown)
        verdict = _verdict(key, value)
        if key == "elastic.linearisation_error" and large_strain:
            text = f"Large strain, which is included, moves the markers by {shown} of the largest "
            text += "displacement more or less than linear theory."
            verdict = ""
        if key == "force.total_force_stated" and (cause := facts.get("one_layer")):
            text = f"{text} {words['one_layer'].format(cause)}"
        stored = unit.name if unit.times == 1.0 else "1"
        found.append(_Finding(key=key, value=value, unit=stored, sentence=text, verdict=verdict))
    return found


def _table(scene_toml: str, name: str) -> Mapping[str, Any]:
    """Return a table of a scene; empty where there is none."""
    try:
        table = tomllib.loads(scene_toml).get(name)
    except tomllib.TOMLDecodeError:
        return {}
    return table if isinstance(table, Mapping) else {}


def _good(key: str, limit: float) -> str:
    if key == "tracking.matched":
        return f"good: {digits(100 * (1 - limit))} % or more"
    return f"good: up to {Unit(key).amount(limit)}" if limit else "good: none"


def _verdict(key: str, value: float) -> str:
    if key not in LIMITS:
        return ""
    size = 1.0 - value if key == "tracking.matched" else abs(value)
    good, fair = LIMITS[key]
    return "good" if size <= good else "fair" if size <= fair else "poor"
