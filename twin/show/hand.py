"""The page of `twin run --live`: a probe moved by keyboard, sliders or pointer; nothing is fetched but answers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from twin.show.page import DARK, LIGHT


def hand_page(facts: Mapping[str, Any]) -> str:
    """Return the page.

    Parameters
    ----------
    facts
        What it must know once (`twin.study.live.LivePress.facts`).
    """
    text = Template(Path(__file__).with_suffix(".html").read_text(encoding="utf-8"))
    told = json.dumps(facts, allow_nan=False).replace("<", "\\u003c")
    return text.substitute(title=escape(str(facts["title"])), light=LIGHT, dark=DARK, facts=told)
