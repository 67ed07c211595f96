"""The page of a reproduction: every table and figure of the papers with the twin's numbers.

The page is made from the files of the entries alone, so an interrupted reproduction has a page of
the entries that are finished.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from twin.show.html_page import digits, page

PAPERS = {
    "kamiyama": "Flat sensor (Kamiyama et al., A Vision-based Tactile Sensor)",
    "sato": "Finger (Sato et al., Measurement of Force Vector Field of Robotic Finger)",
    "beyond": "Beyond the papers",
}


def reproduction(
    tables: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, bytes],
    sensors: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str],
    short: Mapping[str, Sequence[str]],
    unprinted: Sequence[Mapping[str, Any]],
    *,
    seed: int,
    quick: bool,
) -> str:
    """Return the page as one self-contained HTML file.

    ``tables`` are the entries' files in order, ``pictures`` SVG by entry, ``sensors`` scene, hash
    and what was fitted by paper, ``failed`` the reason by entry that could not be finished,
    ``short`` the sentences of the first screen by heading, ``unprinted`` what no paper prints, as
    `twin.study.reproduce.record.Record.settled` has it.
    """
    links = "".join(
        f'<a href="#{_anchor(t)}">{escape(t["name"])}: {escape(t["title"])}</a>' for t in tables
    )
    parts = [
        *(_in_short(heading, sentences) for heading, sentences in short.items()),
        _counts(tables),
        _left(tables),
        _unprinted(unprinted),
        _sensors(sensors),
        f"<nav>{links}</nav>",
    ]
    for paper, heading in PAPERS.items():
        mine = [t for t in tables if str(t["name"]).split("/")[0] == paper]
        if mine:
            parts.append(f'<h2 class="paper">{escape(heading)}</h2>')
            parts += [_article(t, pictures.get(str(t["name"]), b"")) for t in mine]
    form = "quick form: one made sensor, fewer steps" if quick else "full form"
    verdict = (
        "Every number went through contact, picture, CCD, tracking and inverse of a made sensor "
        f"that differs from its drawing. Seed {seed}, {form}."
    )
    alarms = [f"{name} could not be finished: {reason}" for name, reason in failed.items()]
    title = "The papers' tables and figures, made again"
    style = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    return page(title, verdict, alarms, [], body="\n".join(parts), style=style)


def _in_short(heading: str, sentences: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<section><h2>{escape(heading)}</h2><ul>{items}</ul></section>"


def _unprinted(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return what no paper prints, and what the papers' numbers want it to be."""
    if not rows:
        return ""
    body = []
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        at_once = _between(*row["at_once"]) + unit if row["at_once"] else "no value at once"
        each = "".join(
            f"<li>{escape(a['number'])}: {_between(*a['intervals'])}{escape(unit)}</li>"
            for a in row["allowed"]
        )
        body.append(
            f"<tr><th>{escape(PAPERS[row['paper']].split(' (')[0])}: {escape(row['name'])}</th>"
            f"<td>{_between(row['plausible'])}{escape(unit)}: {escape(row['why'])}</td>"
            f"<td>{escape(at_once)}<details><summary>numbers: {len(row['allowed'])}</summary>"
            f"<ul>{each}</ul></details></td></tr>"
        )
    return (
        "<section><h2>What no paper prints, and what the printed numbers want it to be</h2>"
        '<div class="wide"><table class="records"><thead><tr><th>quantity</th><th>plausible</th>'
        f"<th>wanted</th></tr></thead><tbody>{''.join(body)}</tbody></table></div></section>"
    )


def _between(*parts: Sequence[float]) -> str:
    return " or ".join(f"{digits(low)} to {digits(high)}" for low, high in parts)


def _counts(tables: Sequence[Mapping[str, Any]]) -> str:
    records = [r for t in tables for r in t["records"]]
    verdicts = [
        r["verdict"] for r in records if r["paper"] is not None and not r["timed"] and not r["ours"]
    ]
    agreeing = sum(v == "agrees" for v in verdicts)
    explained = sum("explained by:" in v for v in verdicts)
    unprinted = sum("explained by:" in v and " is plausible)" in v for v in verdicts)
    read = sum("explained by: reading" in v for v in verdicts)
    left = len(verdicts) - agreeing - explained
    return (
        "<section><h2>How far the papers' numbers come out</h2>"
        f'<p class="verdict">Of {len(verdicts)} numbers that the papers print, {agreeing} agree, '
        f"{explained} are explained in whole or part ({unprinted} by what isn't printed, {read} by "
        f"another reading, the others by a cause that was switched off), {left} are not "
        "explained.</p>"
        '<p class="note">Two numbers agree when they differ by less than 15 % of '
        "the paper's (0.1 px for average shifts), or by twice the spread over runs, and at most by "
        "half. A cause explains a difference when the run without it comes as near as that to the "
        "paper; it explains it in part when it more than halves it. What isn't printed explains "
        "one where a plausible value gives the paper's number, and in part where the other numbers "
        "want another value.</p></section>"
    )


def _left(tables: Sequence[Mapping[str, Any]]) -> str:
    """Return what neither agrees nor is explained: a reader must know it first."""
    items = "".join(
        f'<li><a href="#{_anchor(t)}">{escape(t["name"])}</a> {escape(r["quantity"])}: paper '
        f"{_number(r['paper'])}, "
        f"twin {_with_spread(r)}{escape(_unit(r))}{_beyond(str(r['verdict']))}</li>"
        for t in tables
        for r in t["records"]
        if str(r["verdict"]).startswith(("disagrees", "ruled out"))
    )
    return (
        f"<section><h2>What no modelled cause explains</h2><ul>{items}</ul></section>"
        if items
        else ""
    )


def _beyond(verdict: str) -> str:
    """Return what a verdict adds to the heading that no modelled cause explains the number."""
    return "" if verdict.endswith("no modelled cause explains it") else f"; {escape(verdict)}"


def _sensors(sensors: Mapping[str, Mapping[str, Any]]) -> str:
    rows = "".join(
        f"<dt>{escape(PAPERS[paper].split(' (')[0])}</dt><dd>scene "
        f"{escape(str(facts['scene']))}, resolved sensor "
        f"{escape(str(facts['hash'])[:16])}; {escape('; '.join(facts['fitted']))}</dd>"
        for paper, facts in sensors.items()
    )
    return f"<section><h2>One sensor a paper</h2><dl>{rows}</dl></section>"


def _anchor(table: Mapping[str, Any]) -> str:
    return str(table["name"]).replace("/", "-")


def _article(table: Mapping[str, Any], picture: bytes) -> str:
    image = ""
    if picture:
        uri = "data:image/svg+xml;base64," + base64.b64encode(picture).decode()
        image = f'<img src="{uri}" alt="{escape(table["title"])}">'
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table["notes"])
    return (
        f'<article id="{_anchor(table)}"><h3>{escape(table["name"])}: {escape(table["title"])}</h3>'
        f'<p class="source">{escape(table["source"])}</p><p>{escape(table["protocol"])}</p>'
        f"{image}{notes}{_records(table['records'])}</article>"
    )


def _records(records: Sequence[Mapping[str, Any]]) -> str:
    alone = not any(record["paper"] is not None or record["explained_by"] for record in records)
    if alone:
        heads = '<th class="n">twin</th>'
        rows = [
            f'<tr><th>{escape(r["quantity"])}</th><td class="n">{_measured(r)}</td></tr>'
            for r in records
        ]
    else:
        heads = "".join(f'<th class="n">{head}</th>' for head in ("paper", "twin", "difference"))
        heads += "<th>agreement, and causes switched off</th>"
        rows = list(map(_row, records))
    return (
        f'<div class="wide"><table class="records{" alone" * alone}"><thead><tr><th>quantity</th>'
        f"{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _row(record: Mapping[str, Any]) -> str:
    unit = _unit(record)
    verdict = str(record["verdict"])
    gentle = "explained by:" in verdict or record["timed"] or record["ours"]
    said = "agrees" if verdict == "agrees" else "explained" if gentle else "disagrees"
    text = f'<span class="{said}">{escape(verdict)}</span>' if record["paper"] is not None else ""
    if record["explained_by"]:
        items = "".join(
            f"<li>{escape(c['cause'])}: {_number(c['value'])}{unit}</li>"
            for c in record["explained_by"]
        )
        text += f"<details><summary>with each cause off</summary><ul>{items}</ul></details>"
    for what in record.get("ranges", ()):
        pairs = "".join(
            f"<li>{digits(value)}: {_number(number)}{unit}</li>"
            for value, number in zip(what["values"], what["numbers"], strict=True)
        )
        name = f"{escape(what['name'])} ({escape(what['unit'])})".replace(" ()", "")
        text += f"<details><summary>{name}</summary><ul>{pairs}</ul></details>"
    paper = _number(record["paper"]) + (unit if record["paper"] is not None else "")
    return (
        f'<tr><th>{escape(record["quantity"])}</th><td class="n">{paper}</td>'
        f'<td class="n">{_measured(record)}</td><td '
        f'class="n">{_number(record["difference"])}</td><td>{text}</td></tr>'
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
