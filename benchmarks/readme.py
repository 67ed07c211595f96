"""The README: ``python -m benchmarks.readme`` puts the stored results in and draws docs/chain.png."""

from __future__ import annotations

import json
import re
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.__main__ import RESULTS, table

README = Path(__file__).parent.parent / "README.md"
TITLES = {
    "elasticity": "Elasticity, against converged fields of an independent code (error: largest over all points, "
    "relative; direct is the same small mesh without the half-space)",
    "picture": "Picture, 640x480, against a converged picture",
    "chain": "Whole chain, one press",
}


def elasticity_in_short(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for every body and method: seconds of the first and of a later load case, worst error."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["case"].split()[0], row["method"].replace(", first press", "")), []).append(row)
    short = []
    for (body, method), cases in groups.items():
        first = [case["seconds"] for case in cases if case["method"].endswith("first press")]
        later = [case["seconds"] for case in cases if not case["method"].endswith("first press")]
        short.append(
            {
                "body": body,
                "method": method,
                "unknowns": cases[0]["unknowns"],
                "first load, s": max(first) if first else "",
                "next load, s": median(later) if later else "",
                "cases": len(cases),
                "worst error": max(case["error"] for case in cases),
            }
        )
    return short


def picture_in_short(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Leave out what no one would choose: pictures without shadows."""
    return [{k: v for k, v in row.items() if k != "shadows"} for row in rows if row.get("shadows") is not False]


SHORTER = {"elasticity": elasticity_in_short, "picture": picture_in_short}


def results_section() -> str:
    """Return the Markdown between the README's two result marks."""
    parts = []
    for stage, title in TITLES.items():
        stored = RESULTS / f"{stage}.json"
        if stored.is_file():
            result = json.loads(stored.read_text())
            machine, rows = result["machine"], SHORTER.get(stage, list)(result["rows"])
            where = f"On {machine['processor']}, {machine['cores']} cores."
            parts.append(f"**{title}.** {where}\n\n{table(rows)}\n")
    return "\n".join(["", *parts]) if parts else ""


def draw_chain() -> None:
    """Draw the README's picture from a run: CCD picture, marker motion, force field; both sensors."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    from twin.study.recipe import load_scene
    from twin.study.run import run

    figure, panels = plt.subplots(2, 3, figsize=(12, 6.2), layout="constrained")
    for row, name in zip(panels, ("kamiyama_shear", "sato_press"), strict=True):
        result = run(load_scene(name))
        truth, estimate = result.truth, result.estimate
        assert truth is not None
        assert estimate is not None
        assert result.pressed is not None
        row[0].imshow(np.minimum(result.pressed.astype(int) * 3 // 2, 255))
        row[0].set_title("what the CCD sees")
        rest, shift = estimate.marker_rest_px, estimate.marker_shift_px
        for layer, colour in (("red", "#c0392b"), ("blue", "#2457c5")):
            mine = truth.marker_layer == layer
            row[1].quiver(*rest[mine].T, *shift[mine].T, color=colour, angles="xy", width=0.003)
        row[1].set(xlim=(0, 640), ylim=(480, 0), aspect="equal", title="how the markers moved")
        x, y = estimate.site_mm[:, :2].T
        fx, fy, fz = estimate.force_n.T
        row[2].scatter(x, y, c=fz, cmap="magma_r", marker="s", s=60)
        pitch, largest = load_scene(name).reconstruction.sites.pitch_mm, np.hypot(fx, fy).max()
        scale = largest / (1.5 * pitch)
        row[2].quiver(x, y, fx, fy, color="#0b6", angles="xy", scale_units="xy", scale=scale, width=0.004)
        row[2].set(aspect="equal", title="the forces that the sensor reports")
        for panel in row:
            panel.set_xticks([])
            panel.set_yticks([])
    figure.savefig(README.parent / "docs" / "chain.png", dpi=100)


if __name__ == "__main__":
    draw_chain()
    print("docs/chain.png drawn")
    text = README.read_text()
    marks = r"(<!-- results -->\n).*?(<!-- end of results -->)"
    README.write_text(re.sub(marks, lambda m: m.group(1) + results_section() + m.group(2), text, flags=re.DOTALL))
