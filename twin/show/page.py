"""The page around a report: one file, no scripts, nothing fetched; light and dark, laptop, phone and paper."""

from __future__ import annotations

from html import escape

LIGHT = (
    "--paper:#fcfcfa;--ink:#1d2126;--soft:#5a626b;--line:#d8dcdf;--panel:#f2f3f0;--red:#c22f26;--blue:#2161c2;"
    "--other:#5a626b;--push:#d8660a;--pull:#6a3fa0;--bar:#7d8894;--alarm:#9a3412"
)
DARK = (
    "--paper:#14171a;--ink:#e6e8ea;--soft:#9ba4ad;--line:#353b42;--panel:#1d2125;--red:#ff7b6f;--blue:#72a9ff;"
    "--other:#9ba4ad;--push:#ff9a3d;--pull:#b18cf2;--bar:#7d8894;--alarm:#fdba74"
)

STYLE = f"""
:root {{ {LIGHT}; color-scheme: light dark }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ {DARK} }} }}
* {{ box-sizing: border-box }}
body {{ margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif }}
main {{ max-width: 1120px; margin: 0 auto; padding: 2.5rem 1.5rem 4rem }}
h1 {{ font-size: 1.7rem; line-height: 1.25; margin: 0 0 .5rem; text-wrap: balance; overflow-wrap: anywhere }}
h2 {{ font-size: 1.15rem; margin: 2.75rem 0 .9rem; padding-top: .9rem; border-top: 1px solid var(--line) }}
.verdict {{ font-size: 1.1rem; max-width: 46em; margin: 0 }}
.alarm {{ color: var(--alarm); max-width: 46em; margin: .6rem 0 0 }}
.two {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 1.25rem 1.5rem }}
.two > figure:only-child, figure.single {{ max-width: 560px }}
figure {{ margin: 0; break-inside: avoid }}
figure.single {{ margin-top: 1.25rem }}
figcaption, .note {{ color: var(--soft); font-size: .9rem }}
figcaption {{ margin-top: .25rem }}
.note {{ max-width: 60em; margin: .6rem 0 0 }}
img, svg {{ display: block; width: 100%; height: auto }}
img {{ border-radius: 3px; background: #000 }}
svg text {{ font-size: 12px; fill: var(--soft) }}
svg path, svg polyline {{ fill: none; stroke-linecap: round; stroke-linejoin: round }}
svg .frame {{ stroke: var(--soft); stroke-width: .7; stroke-linecap: butt }}
svg .red {{ stroke: var(--red) }} svg .blue {{ stroke: var(--blue) }} svg .other {{ stroke: var(--other) }}
svg .truth {{ stroke-width: 3.4; opacity: .35 }}
svg .tracked {{ stroke-width: 1.1 }}
svg .dot {{ stroke: none; opacity: .55 }}
svg .dot.red {{ fill: var(--red) }} svg .dot.blue {{ fill: var(--blue) }} svg .dot.other {{ fill: var(--other) }}
svg .lost {{ stroke: var(--ink); stroke-width: 1.2 }}
svg .push {{ fill: var(--push) }} svg .pull {{ fill: var(--pull) }}
svg .site {{ fill: var(--soft); opacity: .5 }}
svg .force {{ stroke: var(--ink); stroke-width: 1.2 }}
svg .contact {{ fill: none; stroke: var(--ink); stroke-width: 1; stroke-dasharray: 4 3 }}
svg .zero {{ stroke: var(--line); stroke-width: 1 }}
svg .profile.truth {{ stroke: var(--soft); stroke-width: 4; opacity: .55 }}
svg .profile.estimate {{ stroke: var(--push); stroke-width: 1.8 }}
svg .profile-dot.truth {{ fill: var(--soft); stroke: none; opacity: 1 }}
svg .profile-dot.estimate {{ fill: var(--push) }}
.key {{ color: var(--ink); white-space: nowrap; margin-right: .8rem }}
.key::before {{ content: ""; display: inline-block; width: 1.6em; vertical-align: .25em; margin-right: .4em;
  border-top: 1.5px solid var(--ink) }}
.key.truth::before {{ border-top: 4px solid var(--soft); opacity: .5 }}
.key.truth-line::before {{ border-top: 4px solid var(--soft); opacity: .55 }}
.key.estimate-line::before {{ border-top: 2px solid var(--push) }}
.swatch {{ display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin-right: .5em }}
.swatch.red {{ background: var(--red) }} .swatch.blue {{ background: var(--blue) }}
.swatch.other {{ background: var(--other) }}
.ramp {{ display: flex; gap: .7rem; align-items: center; font-size: .9rem; max-width: 420px; margin-top: .9rem;
  font-variant-numeric: tabular-nums }}
.ramp span {{ white-space: nowrap }}
.colours {{ flex: 1; height: .8rem; border: 1px solid var(--line);
  background: linear-gradient(to right, var(--pull), transparent, var(--push)) }}
.wide {{ overflow-x: auto; margin-top: 1.1rem }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .95rem }}
caption {{ text-align: left; color: var(--soft); font-size: .9rem; padding-bottom: .3rem }}
th, td {{ text-align: left; vertical-align: top; padding: .3rem 1.1rem .3rem 0; border-top: 1px solid var(--line);
  font-weight: 400 }}
thead th, thead td {{ color: var(--soft); font-size: .85rem; border-top: 0; vertical-align: bottom }}
small {{ display: block; color: var(--soft); font-size: .85rem }}
.errors {{ width: 100%; max-width: 640px }} .errors .figure {{ padding-right: 0 }}
.stage tr:first-child > * {{ border-top: 0; font-weight: 600; padding-top: .9rem }}
.numbers td, .numbers thead th:not(:first-child), .figure {{ text-align: right; white-space: nowrap }}
.times {{ width: 100%; max-width: 640px }}
.times td:last-child {{ width: 60%; padding-right: 0 }}
.bar {{ display: block; height: .8rem; margin-top: .35rem; min-width: 1px; background: var(--bar);
  border-radius: 0 2px 2px 0 }}
dl {{ display: grid; grid-template-columns: minmax(9em, 15em) 1fr; gap: .4rem 1.5rem; margin: 0; max-width: 60em }}
dt {{ color: var(--soft) }} dd {{ margin: 0; overflow-wrap: anywhere }} ul {{ margin: 0; padding-left: 1.1em }}
pre {{ background: var(--panel); padding: 1rem; overflow-x: auto; font-size: .85rem; line-height: 1.45;
  margin: .6rem 0 0 }}
summary {{ cursor: pointer }}
details {{ margin-top: 2.75rem; padding-top: .9rem; border-top: 1px solid var(--line) }}
@media (max-width: 600px) {{
  main {{ padding: 1.5rem 1rem 3rem }}
  h1 {{ font-size: 1.35rem }} .verdict {{ font-size: 1.02rem }}
  svg text {{ font-size: 15px }}
  dl {{ grid-template-columns: 1fr; gap: 0 }} dd {{ margin-bottom: .7rem }}
  th, td {{ padding-right: .7rem }}
}}
@media print {{
  body {{ font-size: 10.5pt }} main {{ padding: 0; max-width: none }}
  h2, tr {{ break-after: avoid; break-inside: avoid }}
  .two {{ grid-template-columns: 1fr 1fr }} .bar, .colours, .swatch, svg {{ print-color-adjust: exact }}
}}
"""


def page(title: str, verdict: str, alarms: list[str], sections: list[tuple[str, str]], scene: str) -> str:
    """Return the whole page.

    Parameters
    ----------
    title, verdict, alarms, scene
        Plain text.
    sections
        Heading (plain text) and content (HTML) in order; those without content are left out.
    """
    parts = [f"<section><h2>{escape(heading)}</h2>{content}</section>" for heading, content in sections if content]
    warnings = "".join(f'<p class="alarm">{escape(alarm)}</p>' for alarm in alarms)
    details = (
        f"<details><summary>The resolved scene</summary><pre>{escape(scene)}</pre></details>" if scene.strip() else ""
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f'<body><main><header><h1>{escape(title)}</h1><p class="verdict">{escape(verdict)}</p>{warnings}</header>\n'
        + "\n".join(parts)
        + f"\n{details}</main></body></html>\n"
    )
