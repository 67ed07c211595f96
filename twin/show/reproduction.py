"""The page of a reproduction: every table and figure of the papers, paper beside twin.

It is made from the entries' files alone, so that an interrupted reproduction has a page of what was finished.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from twin.show.page import page
from twin.show.words import digits

PAPERS = {
    "kamiyama": "Flat sensor (Kamiyama et al., A Vision-based Tactile Sensor)",
    "sato": "Finger (Sato et al., Measurement of Force Vector Field of Robotic Finger)",
    "beyond": "Beyond the papers",
}

STYLE = """
.paper { font-size: 1.35rem; margin: 3.2rem 0 0 }
article { break-inside: avoid-page; margin: 2.2rem 0 0; padding-top: 1rem; border-top: 1px solid var(--line) }
article h3 { margin: 0 0 .3rem; font-size: 1.12rem } article p { max-width: 60em; margin: .2rem 0 }
article img { background: #fff; width: auto; max-width: 100%; margin-top: .9rem; border: 1px solid var(--line) }
.records { width: 100%; margin-top: .9rem } .records td.n, .records th.n { text-align: right; white-space: nowrap }
.records td, .records th { padding-right: .9rem } .records details { margin: 0; padding: 0; border: 0 }
.records summary { color: var(--soft) } .agrees { color: #19733b } .explained { color: #8a6100 }
.disagrees { color: var(--alarm); font-weight: 600 } nav { columns: 2; margin-top: 1rem; font-size: .92rem }
nav a { color: inherit; display: block } li a { color: inherit } .source { color: var(--soft); font-size: .92rem }
@media screen and (prefers-color-scheme: dark) { .agrees { color: #7fd6a0 } .explained { color: #e6bd5c } }
@media (max-width: 600px) { nav { columns: 1 } }
@media print { details::details-content { content-visibility: visible; display: block } nav { display: none }
  article { break-inside: auto; margin-top: 1.2rem } article h3, .source { break-after: avoid }
  article img { max-width: 15cm; break-inside: avoid } .records { font-size: 8.5pt } .records tr { break-after: auto }
  .records td, .records th { padding: .15rem .6rem .15rem 0 } .records li { display: inline }
  section, .records tr { break-inside: avoid } .records small { font-size: 7.5pt }
  .records:not(.alone) th:first-child { width: 25% } .records:not(.alone) td:last-child { width: 45% }
  .records summary { display: none } .records ul { padding: 0 } .records li:not(:last-child)::after { content: "; " } }
"""


def reproduction(
    tables: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, bytes],
    sensors: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str],
    *,
    seed: int,
    quick: bool,
) -> str:
    """Return the page as one self-contained HTML file.

    Parameters
    ----------
    tables
        The entries' files, in order.
    pictures
        PNG by entry; empty where there is none.
    sensors
        Scene, hash of the resolved sensor and what was fitted, by paper.
    failed
        Reason by entry that could not be finished.
    seed, quick
        How it was run.
    """
    parts = [_counts(tables), _left(tables), _sensors(sensors), _contents(tables)]
    for paper, heading in PAPERS.items():
        mine = [t for t in tables if str(t["name"]).split("/")[0] == paper]
        if mine:
            parts.append(f'<h2 class="paper">{escape(heading)}</h2>')
            parts += [_article(t, pictures.get(str(t["name"]), b"")) for t in mine]
    form = "quick form: one made sensor, fewer steps" if quick else "full form"
    verdict = (
        "Every number went through contact, picture, CCD, tracking and inverse of a made sensor that differs from its "
        f"drawing. Seed {seed}, {form}."
    )
    alarms = [f"{name} could not be finished: {reason}" for name, reason in failed.items()]
    body = page("The papers' tables and figures, made again", verdict, alarms, [], "")
    return body.replace("</style>", STYLE + "</style>").replace("</main>", "\n".join(parts) + "</main>")


def _counts(tables: Sequence[Mapping[str, Any]]) -> str:
    records = [r for t in tables for r in t["records"]]
    verdicts = [r["verdict"] for r in records if r["paper"] is not None and not r["timed"] and not r["ours"]]
    agreeing = sum(v == "agrees" for v in verdicts)
    explained = sum("explained by:" in v for v in verdicts)
    left = len(verdicts) - agreeing - explained
    return (
        f'<p class="verdict">Of {len(verdicts)} numbers that the papers print, {agreeing} agree, {explained} are '
        "explained "
        f"in whole or part by a cause that was switched off, {left} are not explained.</p>"
        '<p class="note">Two numbers agree when they differ by less than 15 % of the paper\'s (0.1 px for '
        "average shifts), or by twice the spread over runs, and at most by half. A cause explains a difference when "
        "the run without it comes as near as that to the paper; it explains it in part when it more than halves it.</p>"
    )


def _left(tables: Sequence[Mapping[str, Any]]) -> str:
    """Return what neither agrees nor is explained, before anything else: it is what a reader must know first."""
    items = "".join(
        f'<li><a href="#{_anchor(t)}">{escape(t["name"])}</a> {escape(r["quantity"])}: paper {_number(r["paper"])}, '
        f"twin {_with_spread(r)} {escape(r['unit'])}</li>"
        for t in tables
        for r in t["records"]
        if _plainly_off(r)
    )
    return f"<section><h2>What no modelled cause explains</h2><ul>{items}</ul></section>" if items else ""


def _plainly_off(record: Mapping[str, Any]) -> bool:
    return str(record["verdict"]).startswith("disagrees")


def _sensors(sensors: Mapping[str, Mapping[str, Any]]) -> str:
    rows = "".join(
        f"<dt>{escape(PAPERS[paper].split(' (')[0])}</dt><dd>scene {escape(str(facts['scene']))}, resolved sensor "
        f"{escape(str(facts['hash'])[:16])}; {escape('; '.join(facts['fitted']))}</dd>"
        for paper, facts in sensors.items()
    )
    return f"<section><h2>One sensor a paper</h2><dl>{rows}</dl></section>"


def _contents(tables: Sequence[Mapping[str, Any]]) -> str:
    links = "".join(f'<a href="#{_anchor(t)}">{escape(t["name"])}: {escape(t["title"])}</a>' for t in tables)
    return f"<nav>{links}</nav>"


def _anchor(table: Mapping[str, Any]) -> str:
    return str(table["name"]).replace("/", "-")


def _article(table: Mapping[str, Any], picture: bytes) -> str:
    image = ""
    if picture:
        uri = "data:image/png;base64," + base64.b64encode(picture).decode()
        image = f'<img src="{uri}" alt="{escape(table["title"])}">'
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table["notes"])
    return (
        f'<article id="{_anchor(table)}"><h3>{escape(table["name"])}: {escape(table["title"])}</h3>'
        f'<p class="source">{escape(table["source"])}</p><p>{escape(table["protocol"])}</p>'
        f"{image}{notes}{_records(table['records'])}</article>"
    )


def _records(records: Sequence[Mapping[str, Any]]) -> str:
    if not any(record["paper"] is not None or record["explained_by"] for record in records):
        rows = "".join(f'<tr><th>{escape(r["quantity"])}</th><td class="n">{_measured(r)}</td></tr>' for r in records)
        head = '<thead><tr><th>quantity</th><th class="n">twin</th></tr></thead>'
        return f'<div class="wide"><table class="records alone">{head}<tbody>{rows}</tbody></table></div>'
    head = (
        '<thead><tr><th>quantity</th><th class="n">paper</th><th class="n">twin</th><th class="n">difference</th>'
        "<th>agreement, and causes switched off</th></tr></thead>"
    )
    return f'<div class="wide"><table class="records">{head}<tbody>{"".join(map(_row, records))}</tbody></table></div>'


def _row(record: Mapping[str, Any]) -> str:
    unit = _unit(record)
    verdict = str(record["verdict"])
    gentle = "explained by:" in verdict or record["timed"] or record["ours"]
    said = "agrees" if verdict == "agrees" else "explained" if gentle else "disagrees"
    text = f'<span class="{said}">{escape(verdict)}</span>' if record["paper"] is not None else ""
    if record["explained_by"]:
        items = "".join(f"<li>{escape(c['cause'])}: {_number(c['value'])}{unit}</li>" for c in record["explained_by"])
        text += f"<details><summary>with each cause off</summary><ul>{items}</ul></details>"
    paper = _number(record["paper"]) + (unit if record["paper"] is not None else "")
    return (
        f'<tr><th>{escape(record["quantity"])}</th><td class="n">{paper}</td>'
        f'<td class="n">{_measured(record)}</td><td class="n">{_number(record["difference"])}</td><td>{text}</td></tr>'
    )


def _measured(record: Mapping[str, Any]) -> str:
    runs = f"<small>{record['n']} runs</small>" if record["n"] > 1 else ""
    return f"{_with_spread(record)}{escape(_unit(record))}{runs}"


def _unit(record: Mapping[str, Any]) -> str:
    return f" {record['unit']}" if record["unit"] else ""


def _with_spread(record: Mapping[str, Any]) -> str:
    spread = "" if record["spread"] is None else f" ± {digits(record['spread'])}"
    return _number(record["twin"]) + spread


def _number(value: float | None) -> str:
    return "" if value is None else digits(value)
