"""The page of a reproduction: every table and figure of the papers with the twin's numbers.

The page is made from the files of the entries alone, so an interrupted reproduction has a page of
the entries that are finished.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.show.html_page import digits, page

PAPERS = {
    "kamiyama": "Flat sensor (Kamiyama et al., A Vision-based Tactile Sensor)",
    "sato": "Finger (Sato et al., Measurement of Force Vector Field of Robotic Finger)",
    "beyond": "Beyond the papers",
}


_LEAST_PX = 1e-4
"""Places of pixels are shown to this: a mean over all markers is hardly better known."""


def _known(value: float, unit: str) -> str:
    """Return a number's digits; of pixels without those that mean nothing."""
    if unit == "px" and abs(value) < 100 * _LEAST_PX:
        value = round(value / _LEAST_PX) * _LEAST_PX
    return digits(value)


def _difference(record: Mapping[str, Any]) -> float | None:
    """Return twin less paper, to three digits of the paper's number."""
    value: float | None = record["difference"]
    paper: float | None = record["paper"]
    if value is None or not paper:
        return value
    return round(value, 2 - math.floor(math.log10(abs(paper))))


def reproduction(
    tables: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, Sequence[tuple[str, bytes]]],
    sensors: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str],
    short: Mapping[str, Sequence[str]],
    unprinted: Sequence[Mapping[str, Any]],
    *,
    seed: int,
    quick: bool,
    renderer: str = "auto",
) -> str:
    """Return the page as one self-contained HTML file.

    ``tables`` are the entries' files in order, ``pictures`` titles and SVG by entry, ``sensors``
    scene, hash and what was fitted by paper, ``failed`` the reason by entry that could not be
    finished, ``short`` the sentences of the first screen by heading, ``unprinted`` what no paper
    prints, as `twin.study.reproduce.record.Record.settled` has it.
    """
    from jinja2 import Environment, FileSystemLoader

    made = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    made.filters |= {"digits": digits, "base64": lambda data: base64.b64encode(data).decode()}
    made.filters |= {"known": _known, "difference": _difference}
    both = [(table, record) for table in tables for record in table["records"]]
    verdicts = [
        r["verdict"] for _, r in both if r["paper"] is not None and not r["timed"] and not r["ours"]
    ]
    explained = [verdict for verdict in verdicts if "explained by:" in verdict]
    counts = {
        "printed": len(verdicts),
        "agree": verdicts.count("agrees"),
        "explained": len(explained),
        "unprinted": sum(" is plausible)" in verdict for verdict in explained),
        "read": sum("explained by: reading" in verdict for verdict in explained),
    }
    body = made.get_template("reproduction_page.html").render(
        tables=tables,
        pictures=pictures,
        sensors=sensors,
        short=short,
        unprinted=unprinted,
        counts=counts,
        left=[pair for pair in both if pair[1]["verdict"].startswith(("disagrees", "ruled out"))],
        papers=PAPERS,
    )
    form = "quick form: one made sensor, fewer steps" if quick else "full form"
    verdict = (
        "Every number went through contact, picture, CCD, tracking and inverse of a made sensor "
        f"that differs from its drawing. Seed {seed}, {form}, renderer {renderer}."
    )
    alarms = [f"{name} could not be finished: {reason}" for name, reason in failed.items()]
    title = "The papers' tables and figures, made again"
    style = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    return page(title, verdict, alarms, [], body=body, style=style)
