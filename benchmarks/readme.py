"""The README: ``python -m benchmarks.readme`` puts the stored results in and draws docs/chain.png.

The page docs/elasticity.md, to which the README sends for other programs, is written with it.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from benchmarks import elasticity_page
from benchmarks.__main__ import RESULTS, table
from benchmarks.elasticity_page import ways_in_short

README = Path(__file__).parent.parent / "README.md"
TITLES = {
    "elasticity": "Elasticity, against converged fields of an independent code (error: largest over all points, over "
    "the largest displacement; direct is the same mesh without the half-space; other programs: "
    "[docs/elasticity.md](docs/elasticity.md))",
    "picture": "Picture, 640x480, against a converged picture (CPU time of all threads; more: "
    "[docs/picture.md](docs/picture.md))",
    "chain": "Whole chain, one press",
}


def elasticity_in_short(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Leave out what no one would choose: plain elements but for the standard mesh."""
    return [row for row in ways_in_short(rows) if not row["way"].startswith("direct") or "standard" in row["way"]]


def picture_in_short(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Leave out what no one would choose: pictures without shadows; and what docs/picture.md alone tells."""
    columns = ("scene", "method", "k", "cpu_ms", "centroid_rms_px", "centroid_max_px")
    return [
        {c: row.get(c, "") for c in columns} for row in rows if row.get("shadows") is True and row["k"] in (2, 3, 4, 8)
    ]


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
    said = {"kamiyama_shear": "flat sensor, pressed and sheared", "sato_press": "finger, pressed by a 3 mm sphere"}
    for row, name in zip(panels, said, strict=True):
        result = run(load_scene(name))
        truth, estimate = result.truth, result.estimate
        assert truth is not None
        assert estimate is not None
        assert result.pressed is not None
        row[0].imshow(np.minimum(result.pressed.astype(int) * 3 // 2, 255))
        row[0].set(title="what the CCD sees (brightened)", ylabel=said[name])
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
    elasticity_page.main()
    draw_chain()
    print("docs/elasticity.png and docs/chain.png drawn")
    text = README.read_text()
    marks = r"(<!-- results -->\n).*?(<!-- end of results -->)"
    README.write_text(re.sub(marks, lambda m: m.group(1) + results_section() + m.group(2), text, flags=re.DOTALL))
