"""The page on error budgets and growth: ``python -m benchmarks.budget_page`` writes docs/budget.md and draws its plot.

Everything is taken from the stored rows of the stages budget and scaling.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from benchmarks import ROOT
from benchmarks.__main__ import table
from benchmarks.elasticity_page import stored

PAGE = ROOT / "docs" / "budget.md"
PLOT = ROOT / "docs" / "budget.png"
MARKS = r"(<!-- {0} -->\n).*?(<!-- end of {0} -->)"
STAGES = ("contact", "elasticity", "optics", "CCD noise", "tracking", "inverse model", "regularisation")

Row = dict[str, Any]


def by_scene(rows: list[Row]) -> dict[str, dict[str, Row]]:
    """Return the rows of each stage of each scene, stages in the chain's order."""
    scenes: dict[str, dict[str, Row]] = {}
    for row in (row for row in rows if "stage" in row):
        scenes.setdefault(row["scene"], {})[row["stage"]] = row
    return {scene: {s: mine[s] for s in STAGES if s in mine} for scene, mine in scenes.items()}


def part(row: Row) -> float:
    """Return a stage's part of the error: its bias and its noise together."""
    return float(np.hypot(row["share"], row["sd"]))


def limits(rows: list[Row]) -> list[Row]:
    """Return a row a scene: its error, and which stage makes most of it and which takes most time."""
    out = []
    for scene, mine in by_scene(rows).items():
        worst, slowest = max(mine, key=lambda s: part(mine[s])), max(mine, key=lambda s: mine[s]["cpu_s"])
        seconds = sum(row["cpu_s"] for row in mine.values())
        out.append(
            {
                "scene": scene,
                "force error, %": 100 * next(iter(mine.values()))["total_force_error"],
                "most of it by": worst,
                "without that, %": 100 * mine[worst]["error_without"],
                "CPU s": seconds,
                "most of them in": f"{slowest} ({mine[slowest]['cpu_s']:.2f} s)",
            }
        )
    return out


def shares(rows: list[Row]) -> list[Row]:
    """Return a row a scene: every stage's part of the error over the force, %."""
    return [
        {"scene": scene, **{stage: 100 * part(row) for stage, row in mine.items()}}
        for scene, mine in by_scene(rows).items()
    ]


def tables() -> dict[str, str]:
    """Return the Markdown between the page's marks, by mark."""
    rows, grown = stored("budget"), stored("scaling")
    exponents = [{k: row[k] for k in ("axis", "stage", "exponent")} for row in grown if "exponent" in row]
    sizes = {
        (axis, stage): [
            row["size"] for row in grown if (row["axis"], row.get("stage")) == (axis, stage) and "size" in row
        ]
        for axis, stage in ((row["axis"], row["stage"]) for row in exponents)
    }
    told = [
        {"axis": r["axis"], "from": min(s), "to": max(s), "stage": r["stage"], "exponent": r["exponent"]}
        for r in exponents
        if (s := sizes[r["axis"], r["stage"]])
    ]
    nodes = [
        {"nodes": r["size"], "samples": r["samples"], "head, CPU s": r["head_cpu_s"], "nodes, CPU s": r["nodes_cpu_s"]}
        for r in grown
        if r["axis"] == "nodes"
    ]
    paper = [{k: v for k, v in row.items() if k != "axis"} for row in grown if row["axis"] == "on paper"]
    return {
        "budget": f"\n{table(limits(rows))}\n\n{table(shares(rows))}\n\n",
        "auto": f"\n{table([row for row in rows if 'stage' not in row])}\n\n",
        "scaling": f"\n{table(told)}\n\n",
        "nodes": f"\n{table(nodes)}\n\n{table(paper[:1])}\n\n{table(paper[1:])}\n\n",
    }


def draw() -> None:
    """Draw every scene's error and time by stage."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    scenes = by_scene(stored("budget"))
    colours = [mpl.colormaps["tab10"](k) for k in range(len(STAGES))]
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 0.6 + 0.62 * len(scenes)), sharey=True)
    places = np.arange(len(scenes))[::-1]
    for axes, value, name in (
        (left, lambda row: 100 * part(row), "part of the total force's error, % of the force"),
        (right, lambda row: row["cpu_s"], "CPU seconds of a first press"),
    ):
        edge = np.zeros(len(scenes))
        for stage, colour in zip(STAGES, colours, strict=True):
            width = np.array([value(mine[stage]) if stage in mine else 0.0 for mine in scenes.values()])
            axes.barh(places, width, left=edge, color=colour, label=stage, height=0.7)
            edge += width
        axes.set_xlabel(name)
        axes.spines[["top", "right"]].set_visible(False)
    errors = [100 * next(iter(mine.values()))["total_force_error"] for mine in scenes.values()]
    left.plot(errors, places, "k|", markersize=16, label="the whole")
    left.set_yticks(places, list(scenes))
    left.legend(fontsize=7, loc="best")
    figure.tight_layout()
    figure.savefig(PLOT, dpi=100)


def main() -> None:
    """Write the page's tables and draw its plot."""
    text = PAGE.read_text()
    for mark, told in tables().items():
        text = re.sub(MARKS.format(mark), lambda found, told=told: found[1] + told + found[2], text, flags=re.DOTALL)  # type: ignore[misc]
    PAGE.write_text(text)
    draw()


if __name__ == "__main__":
    main()
