"""The page on contact: ``python -m benchmarks.contact_page`` puts the stored rows into docs/contact.md, with a plot."""

from __future__ import annotations

import json
import re
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table
from benchmarks.contact import CLOSED, HELD, extrapolated, order
from benchmarks.contact_peer import PEER, SAID, to_bounds
from benchmarks.contact_speed import SPEED
from benchmarks.presses import BODIES, summary

PAGE, PICTURE = ROOT / "docs" / "contact.md", ROOT / "docs" / "contact.png"
STORED = RESULTS / "contact.json"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

Rows = list[dict[str, Any]]


def stored_rows() -> Rows:
    """Return the rows of the last run of the stage."""
    rows: Rows = json.loads(STORED.read_text())["rows"]
    return rows


def of(rows: Rows, what: str) -> Rows:
    """Return the rows of one table, without its name."""
    return [{k: v for k, v in row.items() if k != "what"} for row in rows if row["what"] == what]


def series(rows: Rows) -> list[Rows]:
    """Return the rows of closed forms by case, Poisson's ratio and quantity."""

    def key(row: dict[str, Any]) -> tuple[str, float, str]:
        return row["case"], row["nu"], row["quantity"]

    names = list(dict.fromkeys(map(key, of(rows, CLOSED))))
    return [[row for row in of(rows, CLOSED) if key(row) == name] for name in names]


def closed_table(rows: Rows) -> Rows:
    """Return one row a quantity: the error on the finest grid, the order, and what three grids lead to."""
    shown, sizes = [], sorted({row["across"] for row in of(rows, CLOSED)})
    for one in series(rows):
        last, errors = one[-1], {row["across"]: 100 * row["error"] for row in one}
        row = {"case": last["case"], "nu": last["nu"], "quantity": last["quantity"]}
        row |= {f"{across} across, %": errors.get(across, "") for across in sizes}
        if last["quantity"] not in ("total force", "collinear residual"):
            row["order"] = order(one)
        if last["case"].startswith(("flat", "stuck")):
            row["extrapolated, %"] = 100 * extrapolated(one)
        shown.append(row | {"finest, CPU s": last["cpu_s"]})
    return shown


def presses_tables() -> list[str]:
    """Return the parts of the page on random presses, of the bodies that have been pressed."""
    parts = []
    for body in BODIES:
        kept = RESULTS / f"presses_{body}.json"
        if kept.is_file():
            found = json.loads(kept.read_text())
            refused = ", ".join(f"{words} {count}" for words, count in sorted(found["refused"].items())) or "none"
            parts += [
                f"**{found['done']} random presses on the {body}: {len(found['failed'])} failed** (refused: {refused})",
                table(summary(found)),
            ]
    return parts


def page_tables() -> str:
    """Return the Markdown between the page's marks."""
    rows = stored_rows()
    processor = json.loads(STORED.read_text())["machine"]["processor"]
    peers = of(rows, PEER)
    parts = [f"**{CLOSED}** (error over the closed form's value)", table(closed_table(rows))]
    parts += [f"**{HELD}** (over the weight or the peak pressure)", table(of(rows, HELD))]
    if peers:
        parts += [
            f"**{PEER}** (tamaas on 512 x 512 cells is the truth)",
            table(peers),
            "CPU seconds to an indentation as good or better, by each program's own best runs",
            table([{k: "not reached" if v is None else v for k, v in row.items()} for row in to_bounds(peers)]),
        ]
    parts += [row["remark"] for row in of(rows, SAID)]
    parts += [f"**{SPEED}**", table(of(rows, SPEED)), *presses_tables(), f"On {processor}."]
    return "\n" + "\n\n".join(parts) + "\n\n"


def draw() -> None:
    """Draw errors against patches across, and against CPU seconds.

    What is compared has its colour, the case its mark; Poisson's ratios other than 0.5 are dashed.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    drawn = [one for one in series(stored_rows()) if one[-1]["quantity"] not in ("total force", "collinear residual")]
    compared = list(dict.fromkeys((one[-1]["case"], one[-1]["quantity"]) for one in drawn))
    cases = list(dict.fromkeys(case for case, _ in compared))
    paired = plt.get_cmap("tab20").colors  # strong and pale by turns
    colours = dict(zip(compared, [*paired[::2], *paired[1::2]], strict=False))
    marks = dict(zip(cases, "osD^v<>P", strict=False))
    for one in drawn:
        case, quantity, nu = one[-1]["case"], one[-1]["quantity"], one[-1]["nu"]
        style = {
            "color": colours[case, quantity], "marker": marks[case], "ls": "-" if nu == 0.5 else "--",
            "ms": 4, "lw": 1.2,
        }  # fmt: skip
        errors = [max(abs(row["error"]), 1e-6) for row in one]
        left.loglog([row["across"] for row in one], errors, label=f"{case}: {quantity}, nu {nu}", **style)
        right.loglog([row["cpu_s"] for row in one], errors, **style)
    left.set(xlabel="patches across the contact", ylabel="error over the closed form's value")
    left.set_xticks(sorted({row["across"] for one in drawn for row in one}))
    left.xaxis.set_major_formatter(ScalarFormatter())
    left.xaxis.set_minor_formatter(NullFormatter())
    right.set(xlabel="CPU seconds of the whole path")
    figure.legend(loc="outside right center", fontsize=7)
    figure.savefig(PICTURE, dpi=100)
    plt.close(figure)


def main() -> None:
    """Draw, and put the stored rows between the page's marks."""
    draw()
    text = PAGE.read_text()
    PAGE.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    main()
