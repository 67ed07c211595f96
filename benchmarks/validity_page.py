"""The page on linearity: ``python -m benchmarks.validity_page`` puts the stored rows into docs/validity.md.

Apart from the study itself, because the page and its test need no felupe.
"""

from __future__ import annotations

import json
import re
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table
from twin.theory.linearity import law_of

PAGE = ROOT / "docs" / "validity.md"
STORED = RESULTS / "validity.json"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"


def stored_rows() -> list[dict[str, Any]]:
    """Return the rows of the last study."""
    rows: list[dict[str, Any]] = json.loads(STORED.read_text())["rows"]
    return rows


def expected(row: dict[str, Any]) -> float:
    """Return what the law says for a row of the study."""
    flat = row["contact_over_probe_radius"] is None
    return law_of("cylinder" if flat else "sphere", sheared=row["shear_n"] > 0).error(row["mean_strain"])


def page_tables() -> str:
    """Return the Markdown between the page's marks."""
    presses = [row for row in stored_rows() if "mean_strain" in row]
    dead = [row for row in stored_rows() if "mean_strain" not in row]
    processor = json.loads(STORED.read_text())["machine"]["processor"]
    parts = [
        "",
        "**Neo-Hookean rubber against linear theory, same elements, same force**",
        "",
        table([_shown(row) for row in presses]),
        "",
        "**Largest error per strain, for three strains that a law could use: from least to most over all rows**",
        "",
        table(_ranges(presses)),
        "",
        "**The same, the probe replaced by the traction that linear theory finds under it**",
        "",
        table([_shown_dead(row) for row in dead]),
        "",
        f"Contact counted on the study's own meshes. On {processor}.",
        "",
    ]
    return "\n".join(parts)


def _ranges(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the least and largest error per strain by kind of probe: what a law of one factor has to span."""
    shown = []
    for flat in (False, True):
        same = [row for row in rows if (row["contact_over_probe_radius"] is None) == flat]
        line: dict[str, Any] = {"probe": "flat" if flat else "sphere", "rows": len(same)}
        for name, key in (("p/E", "mean_strain"), ("at a marker", "strain_markers"), ("0.3 mm deep", "strain_deep")):
            ratio = [row["error_max"] / row[key] for row in same]
            line[name] = f"{min(ratio):.2g} to {max(ratio):.2g}"
        shown.append(line)
    return shown


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    ratio = row["contact_over_probe_radius"]
    return {
        "press": row["case"],
        "push, N": row["push_n"],
        "shear, N": row["shear_n"] or "",
        "a/R": "" if ratio is None else ratio,
        "p/E": row["mean_strain"],
        "strain at a marker": row["strain_markers"],
        "0.3 mm deep": row["strain_deep"],
        "stretch - 1 there": row["stretch_deep"],
        "turn at a marker, deg": row["turn_markers_deg"],
        "largest error, %": 100 * row["error_max"],
        "rms, %": 100 * row["error_rms"],
        "law, %": 100 * expected(row),
        "indentation, %": 100 * row["indentation_error"],
        "unknowns": row["unknowns"],
    }


def _shown_dead(row: dict[str, Any]) -> dict[str, Any]:
    known = "error_max" in row
    return {
        "press": row["case"],
        "push, N": row["push_n"],
        "largest error, %": 100 * row["error_max"] if known else row["remark"],
        "rms, %": 100 * row["error_rms"] if known else "",
    }


def main() -> None:
    """Put the stored rows between the page's marks."""
    text = PAGE.read_text()
    PAGE.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    main()
