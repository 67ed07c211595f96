"""``python -m benchmarks.inverse_page``: write docs/inverse.md from the stored results of ``benchmarks inverse``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.__main__ import RESULTS, table
from benchmarks.inverse import FITTED, FRICTION, WAYS
from benchmarks.inverse import __doc__ as what

PAGE = Path(__file__).parent.parent / "docs" / "inverse.md"


def page() -> str:
    """Return the page."""
    stored = json.loads((RESULTS / "inverse.json").read_text())
    rows: list[dict[str, Any]] = stored["rows"]
    by_name = {row["what"]: row for row in rows}
    ways = [by_name[name] for name in (*WAYS, *(f"{name}, fitted twin" for name in FITTED))]
    wide = [row for row in rows if row["what"].startswith("point push")]
    speed = [row for row in rows if "CPU ms" in row]
    others = [row["what"] for row in rows if row not in [*ways, *speed, *wide]]
    about = (what or "").partition("\n\n")[2].strip()
    return (
        f"# Force fields: error and time\n\n{about}\n\nOn {stored['machine']['processor']}. Run again with "
        "`python -m benchmarks inverse`, then `python -m benchmarks.inverse_page`.\n\n"
        f"{table(ways)}\n\n"
        "`field error` is |F^ - F| / |F| over all sites; totals are those without bounds, so that bounds don't "
        "change them. The fitted twin is the nominal design fitted to pictures of five presses (each along z, then "
        "with shear along x and y), a load cell's forces and the rest picture.\n\n"
        f"## A wrong coefficient of friction\n\n{friction(by_name)}\n\n"
        f"## Weight and width\n\n{table(wide)}\n\n{width(by_name)}\n\n"
        + "\n".join(f"* {line}" for line in others)
        + "\n\n"
        f"## Time\n\n{table(speed)}\n\n"
        "Without a first guess unless `warm` (the last frame's contact). `KKT` is the largest violation of the "
        "optimality conditions over the largest gradient.\n"
    )


def friction(by_name: dict[str, dict[str, Any]]) -> str:
    """Say what a wrong coefficient of friction costs."""
    right = by_name["smooth, cone"]
    parts = []
    for name, told in (("half", "half"), ("twice", "twice")):
        row = by_name[f"smooth, cone, mu {name}"]
        more = 100 * (row["field error"] / right["field error"] - 1)
        parts.append(
            f"with {told} the true one the field error is {more:.0f} % larger and the centre {row['centre mm']:.2f} "
            f"mm off instead of {right['centre mm']:.2f}"
        )
    free = 100 * (by_name["smooth"]["field error"] / right["field error"] - 1)
    return (
        f"The loads need up to {FRICTION:g}. By the median of the loads, {parts[0]}; {parts[1]}. Without a cone the "
        f"field error is {free:.0f} % larger. So a coefficient that is too large costs little, and one that is too "
        "small forbids forces that are there: take the upper end of what is known. The total force stays as it is."
    )


def width(by_name: dict[str, dict[str, Any]]) -> str:
    """Say how wide a point push is, and why."""
    smooth, local, limit = (by_name[f"point push, {name}"] for name in ("smooth", "local", "design limit"))
    over = [row["width mm"] / limit["width mm"] for row in (smooth, local)]
    apart = [row["two points mm"] / limit["two points mm"] for row in (smooth, local)]
    return (
        "The design limit is `twin.theory.limit`'s, its width here the floor of 1.41 pitch; it expects a load where "
        "there is one. Smooth expects the same everywhere, so that the weight that suits the surface's empty rest is "
        f"too large for the push: {over[0]:.2f} of the limit's width, {apart[0]:.2f} of its distance of two points. "
        "Local expects forces only where a first solution has some (`twin.sense.local`): "
        f"{over[1]:.2f} and {apart[1]:.2f}. A width alone can be had by sharpening too much; the distance of two "
        "points (a dip of 20 % between them) can't. The same makes the totals: every site that may carry force adds "
        "its noise to them. A press weaker than about a thirtieth of the strongest one may go unseen by it."
    )


if __name__ == "__main__":
    PAGE.write_text(page())
