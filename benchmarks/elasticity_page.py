"""The page on elasticity: ``python -m benchmarks.elasticity_page`` writes docs/elasticity.md and draws its picture.

Everything is taken from the stored rows of the stages elasticity, peers and growth. Apart from the stages, because the
page and its test need no other program.
"""

from __future__ import annotations

import json
import re
from statistics import median
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, table
from benchmarks.fronts import front, seconds_to
from benchmarks.growth_law import exponent
from benchmarks.reference import reference

PAGE = ROOT / "docs" / "elasticity.md"
PICTURE = ROOT / "docs" / "elasticity.png"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

GOAL = 0.003
"""Error at which programs are compared."""

COMPARED = ("0.5", "0.49")
"""Poisson's ratios at which they are."""

Row = dict[str, Any]


def stored(stage: str) -> list[Row]:
    """Return the rows of a stage's last run, none if it never ran."""
    path = RESULTS / f"{stage}.json"
    rows: list[Row] = json.loads(path.read_text())["rows"] if path.is_file() else []
    return rows


def worst(row: Row) -> float:
    """Return a row's error: the larger one of its two loads, over all points."""
    return max(row["error_z"], row["error_x"])


def programs(rows: list[Row], body: str, nu: str) -> dict[str, list[Row]]:
    """Return the rows of each program on a body at one Poisson's ratio; linear and quadratic elements apart."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row["body"] == body and row.get("nu") == nu and "remark" not in row:
            apart = f", {row['element']}" if row["program"] == "NGSolve" and row["element"] in ("P1", "P2") else ""
            found.setdefault(row["program"] + apart, []).append(row)
    return found


def to_the_goal(rows: list[Row]) -> list[Row]:
    """Return one row for every body, Poisson's ratio and program: seconds to the goal, also over twin's own."""
    out = []
    for body in ("block", "finger"):
        for nu in COMPARED:
            groups = programs(rows, body, nu)
            needed = {name: _seconds(group, "cpu_s") for name, group in groups.items()}
            for name, group in groups.items():
                best = min(group, key=worst)
                seconds, own = needed[name], needed.get("twin")
                out.append(
                    {
                        "body": body,
                        "nu": nu,
                        "program": name,
                        "CPU s": "not reached" if seconds is None else seconds,
                        "over twin's": seconds / own if seconds and own else "",
                        "wall s": _seconds(group, "wall_s") or "",
                        "best error, %": 100 * worst(best),
                        "its CPU s": best["cpu_s"],
                    }
                )
    return out


def _seconds(rows: list[Row], clock: str) -> float | None:
    return seconds_to([(row[clock], worst(row)) for row in rows], GOAL)


def ways_in_short(rows: list[Row]) -> list[Row]:
    """Return one row for every body and way: CPU seconds of first and next loads, errors, and how they were told."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["body"], row["way"]), []).append(row)
    short = []
    for (body, way), cases in groups.items():
        first, later = ([case["cpu_s"] for case in cases if case["load"] == which] for which in ("first", "next"))
        told = [case["estimate"] / case["error"] for case in cases if "estimate" in case]
        own = [reference(body).case(case["case"]).own_error for case in cases]
        fair = [
            case["estimate"] / (case["error"] + e) for case, e in zip(cases, own, strict=True) if "estimate" in case
        ]
        short.append(
            {
                "body": body,
                "way": way,
                "unknowns": cases[0]["unknowns"],
                "first load, CPU s": median(first) if first else "",
                "next load, CPU s": median(later) if later else "",
                "cases": len(cases),
                "worst error, %": 100 * max(case["error"] for case in cases),
                "at markers, %": 100 * max(case["marker_error"] for case in cases),
                "estimate over error": f"{min(told):.2g} to {max(told):.2g}" if told else "",
                "over error plus reference's own": f"{min(fair):.2g} to {max(fair):.2g}" if fair else "",
            }
        )
    return short


def all_runs(rows: list[Row]) -> list[Row]:
    """Return the rows of all programs as they are shown."""
    return [
        {
            "body": row["body"],
            "nu": row.get("nu", ""),
            "program": row["program"],
            "element": row.get("element", ""),
            "mesh": row.get("mesh", ""),
            "unknowns": row.get("unknowns", ""),
            "CPU s": row.get("cpu_s", row.get("remark", "")),
            "wall s": row.get("wall_s", ""),
            "next load, CPU s": row.get("next_cpu_s", ""),
            **{
                f"{which}, %": 100 * row[key] if key in row else ""
                for which, key in (("error z", "error_z"), ("error x", "error_x"))
            },
            "at markers, %": 100 * max(row["marker_error_z"], row["marker_error_x"]) if "error_z" in row else "",
        }
        for row in rows
    ]


def growth_powers(rows: list[Row]) -> list[Row]:
    """Return one row a body: the powers of the unknowns that seconds and memory grow with."""
    out = []
    for body in dict.fromkeys(row["body"] for row in rows):
        mine = [row for row in rows if row["body"] == body and "factor_cpu_s" in row]
        if len(mine) > 1:
            columns = {"factor": "factor_cpu_s", "solve": "solve_cpu_s", "memory": "peak_gib"}
            out.append({"body": body} | {name: exponent(mine, column) for name, column in columns.items()})
    return out


def page_tables() -> str:
    """Return the Markdown between the page's marks."""
    peers, growth = stored("peers"), stored("growth")
    parts = [""]
    for title, rows in (
        (
            f"Seconds to {100 * GOAL:g} %, from each program's best runs (straight lines between them)",
            to_the_goal(peers),
        ),
        ("Every way of the program, over all reference cases", ways_in_short(stored("elasticity"))),
        ("A call, on the standard block at Poisson's ratio 0.5: the median of seven means", stored("calls")),
        ("Growth: assembly with factor, and a solve, in the default solver; peak_gib is memory", growth),
        ("Powers of the number of unknowns", growth_powers(growth)),
        ("All runs of all programs", all_runs(peers)),
    ):
        if rows:
            parts.append(f"**{title}**\n\n{table(rows)}\n")
    processor = json.loads((RESULTS / "elasticity.json").read_text())["machine"]["processor"]
    return "\n".join([*parts, f"On {processor}.\n"])


COLOURS = {
    "twin": "#c0392b",
    "twin, table": "#e67e22",
    "NGSolve": "#2457c5",
    "scikit-fem": "#0a8a4a",
    "CalculiX": "#8e44ad",
    "NGSolve, P1": "#999999",
    "NGSolve, P2": "#555555",
}


def draw() -> None:
    """Draw error against time, a panel for each body and Poisson's ratio, with the front that no run is below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows, handles = stored("peers"), {}
    figure, panels = plt.subplots(2, 2, figsize=(11, 8), layout="constrained", sharex=True, sharey=True)
    for across, nu in zip(panels.T, COMPARED, strict=True):
        for panel, body in zip(across, ("block", "finger"), strict=True):
            groups = {name: group for name, group in programs(rows, body, nu).items() if name in COLOURS}
            runs = [(row["cpu_s"], worst(row)) for group in groups.values() for row in group]
            if runs:
                panel.plot(*zip(*front(runs), strict=True), "o-", color="black", linewidth=6, markersize=13, alpha=0.15)
            for name, group in groups.items():
                best = front([(row["cpu_s"], worst(row)) for row in group])
                panel.plot(*zip(*best, strict=True), color=COLOURS[name], linewidth=0.8)
                dots = [(row["cpu_s"], worst(row)) for row in group]
                handles[name] = panel.scatter(*zip(*dots, strict=True), color=COLOURS[name], s=22, zorder=3)
            panel.axhline(GOAL, color="black", linewidth=0.6, linestyle=":")
            panel.set(xscale="log", yscale="log", title=f"{body}, Poisson's ratio {nu}")
            panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("CPU seconds from the ready mesh")
    for panel in panels[:, 0]:
        panel.set_ylabel("largest error over largest displacement")
    shown = [name for name in COLOURS if name in handles]
    figure.legend([handles[name] for name in shown], shown, loc="outside lower center", ncols=len(shown))
    figure.savefig(PICTURE, dpi=100)


def main() -> None:
    """Write the page and its picture."""
    text = PAGE.read_text()
    PAGE.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))
    draw()


if __name__ == "__main__":
    main()
