"""The page on pictures: ``python -m benchmarks.picture_page`` writes docs/picture.md's tables and draws its plot.

Everything is taken from the stored rows of the stages picture and referee.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from benchmarks import ROOT
from benchmarks.__main__ import table
from benchmarks.elasticity_page import stored
from benchmarks.fronts import seconds_to

PAGE = ROOT / "docs" / "picture.md"
PLOT = ROOT / "docs" / "picture.png"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

GOAL_PX = 0.003
"""Centroid error, rms, at which methods are compared."""

Row = dict[str, Any]


def method_of(row: Row) -> str:
    """Return a row's method without its number of samples."""
    return str(row["method"]).split(",")[0] if row["method"].startswith("mi.render") else str(row["method"])


def to_the_goal(rows: list[Row]) -> list[Row]:
    """Return one row for every scene and method with shadows: CPU time to the goal, and over the splat's.

    Samples drawn at random err by the inverse root of their number: stock Mitsuba's time is continued so.
    """
    out = []
    for scene in dict.fromkeys(row["scene"] for row in rows if "centroid_rms_px" in row):
        mine = [row for row in rows if row["scene"] == scene and row.get("shadows") is True]
        needed = {}
        for method in dict.fromkeys(map(method_of, mine)):
            runs = [(row["cpu_ms"], row["centroid_rms_px"]) for row in mine if method_of(row) == method]
            needed[method] = seconds_to(runs, GOAL_PX)
            if needed[method] is None:
                cost, error = min(runs, key=lambda run: run[1])
                needed[method] = cost * (error / GOAL_PX) ** 2
        best = needed.get("twin, splat")
        for method, cost in needed.items():
            out.append(
                {"scene": scene, "method": method, "CPU ms": cost, "over the splat": cost / best if best else ""}
            )
    return out


def page_tables() -> str:
    """Return the Markdown between the page's marks."""
    rows = stored("picture")
    traced = [{**row, "k": row["k"]} for row in rows if "centroid_rms_px" in row]
    others = [row for row in rows if "centroid_rms_px" not in row]
    parts = [
        "",
        f"**CPU time to a centroid error of {GOAL_PX} px rms, with shadows**",
        "",
        table(to_the_goal(rows)),
        "",
        "![Centroid error against CPU time](picture.png)",
        "",
        "**Every method and grid**",
        "",
        table(traced),
        "",
        "**CCD, what comes before rays, first pictures, memory**",
        "",
        table(others),
        "",
        "**Against a path integrator with real plates of glass and rubber**",
        "",
        table(stored("referee")),
        "",
    ]
    return "\n".join(parts)


def draw() -> None:
    """Draw error against CPU time, one line for every method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in stored("picture") if row.get("shadows") is True]
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = plt.subplots(1, len(scenes), figsize=(10, 4), layout="constrained", sharey=True)
    for panel, scene in zip(np.atleast_1d(panels), scenes, strict=True):
        mine = [row for row in rows if row["scene"] == scene]
        for method in dict.fromkeys(map(method_of, mine)):
            runs = sorted((row["cpu_ms"], row["centroid_rms_px"]) for row in mine if method_of(row) == method)
            panel.loglog(*zip(*runs, strict=True), "o-", label=method)
        panel.axhline(GOAL_PX, color="grey", lw=0.8)
        panel.set(title=scene, xlabel="CPU time of a picture, ms")
        shown = [t for t in (5, 10, 20, 50, 100, 200, 500) if panel.get_xlim()[0] <= t <= panel.get_xlim()[1]]
        panel.set_xticks(shown, [str(t) for t in shown])
        panel.set_xticks([], minor=True)
        panel.legend()
    np.atleast_1d(panels)[0].set_ylabel("centroid error, px rms")
    figure.savefig(PLOT, dpi=100)


if __name__ == "__main__":
    draw()
    PAGE.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), PAGE.read_text(), flags=re.DOTALL))
