"""Panels drawn as one PNG.

Why matplotlib here, and lines of SVG in the report of a run: these pictures must also be files of their own, and their
kinds (histograms, scatter, curves) are what a plotting library is for. pyvista brings it, so it costs no installation;
it takes a second to import, which a reproduction of minutes does not feel.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.show.panels import ArrowPanel, BarPanel, CurvePanel, FieldPanel, HistogramPanel, Panel, PicturePanel

RED, BLUE, INK, SOFT, PUSH = "#c22f26", "#2161c2", "#1d2126", "#5a626b", "#d8660a"
CYCLE = (PUSH, BLUE, "#2f8f5b", "#6a3fa0", RED, SOFT, "#b59a00")
"""Colours of curves in order; told apart by style as well where it matters."""

WIDE = 2
"""Panels beside each other."""

DPI = 110


def drawn(panels: Sequence[Panel]) -> bytes:
    """Return the PNG of an entry's panels, two in a row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = -(-len(panels) // WIDE)
    columns = min(len(panels), WIDE)
    figure = Figure(figsize=(5.4 * columns, 4.1 * rows), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for number, panel in enumerate(panels):
        axes = figure.add_subplot(rows, columns, number + 1)
        axes.set_title(panel.title, fontsize=10, loc="left", color=INK, wrap=True)
        axes.tick_params(labelsize=8, colors=SOFT)
        for spine in axes.spines.values():
            spine.set_color("#c4c9cd")
        _draw(axes, panel)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def _draw(axes: Any, panel: Panel) -> None:
    match panel:
        case PicturePanel():
            axes.imshow(panel.picture, interpolation="nearest")
            if panel.marks_px is not None:
                axes.plot(*panel.marks_px.T, "+", color="white", markersize=7)
            _named(axes, "column (px)", "row (px)")
        case ArrowPanel():
            _arrows(axes, panel)
        case HistogramPanel():
            _histogram(axes, panel)
        case CurvePanel():
            _curves(axes, panel)
        case FieldPanel():
            _field(axes, panel)
        case BarPanel():
            _bars(axes, panel)


def _named(axes: Any, across: str, up: str) -> None:
    axes.set_xlabel(across, fontsize=9, color=SOFT)
    axes.set_ylabel(up, fontsize=9, color=SOFT)


def _arrows(axes: Any, panel: ArrowPanel) -> None:
    known = np.isfinite(panel.tails_px).all(axis=1) & np.isfinite(panel.shifts_px).all(axis=1)
    tails, arrows = panel.tails_px[known], panel.magnified * panel.shifts_px[known]
    colours = np.asarray(panel.colours, object)[known]
    axes.quiver(*tails.T, *arrows.T, color=colours, angles="xy", scale_units="xy", scale=1.0, width=0.0028, headwidth=4)
    axes.set_aspect("equal")
    low, high = tails.min(axis=0) - 15, tails.max(axis=0) + 15
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])
    _named(axes, f"column (px); arrows {panel.magnified:g} times", "row (px)")


def _histogram(axes: Any, panel: HistogramPanel) -> None:
    edges = np.linspace(*panel.bounds, panel.bins + 1)
    for (label, samples), colour in zip(panel.samples.items(), CYCLE, strict=False):
        inside = np.clip(samples[np.isfinite(samples)], *panel.bounds)
        axes.hist(inside, edges, histtype="step", color=colour, label=label, linewidth=1.4)
    for label, value in panel.marked.items():
        axes.axvline(value, color=INK, linestyle="--", linewidth=1, label=label)
    axes.legend(fontsize=8, frameon=False)
    _named(axes, panel.across, "markers")


def _curves(axes: Any, panel: CurvePanel) -> None:
    for curve, colour in zip(panel.curves, CYCLE * (1 + len(panel.curves) // len(CYCLE)), strict=False):
        axes.plot(
            curve.x, curve.y, curve.style, color=curve.colour or colour, label=curve.label, linewidth=1.4, markersize=4
        )
    for label, value in panel.levels.items():
        axes.axhline(value, color=INK, linestyle="--", linewidth=1, label=label)
    if panel.logarithmic:
        axes.set_yscale("log")
    if any(curve.label for curve in panel.curves) or panel.levels:
        axes.legend(fontsize=8, frameon=False)
    axes.grid(color="#e8eaec", linewidth=0.6)
    axes.set_axisbelow(True)
    _named(axes, panel.across, panel.up)


def _bars(axes: Any, panel: BarPanel) -> None:
    names, values = list(panel.values), np.array(list(panel.values.values()), float)
    axes.barh(np.arange(len(names)), np.nan_to_num(values), color="#7d8894", height=0.6)
    for row, value in enumerate(values):
        told = f" {value:.3g}" if np.isfinite(value) else " not reached"
        clear = max(value if np.isfinite(value) else 0.0, panel.marks.get(names[row], 0.0))
        axes.text(clear, row, told, va="center", fontsize=8, color=INK)
    axes.set_yticks(np.arange(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    if panel.marks:
        places = [panel.marks.get(name, float("nan")) for name in names]
        axes.plot(
            places, np.arange(len(names)), "|", color=PUSH, markersize=22, markeredgewidth=2.5, label=panel.marked
        )
        axes.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    _named(axes, panel.across, "")


def _field(axes: Any, panel: FieldPanel) -> None:
    sites, force = panel.site_mm, panel.force_n
    largest = float(np.abs(force[:, 2]).max()) or 1.0
    half = panel.side_mm / 2
    from matplotlib.collections import PolyCollection

    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    squares = PolyCollection(
        sites[:, None, :2] + corners[None],
        array=force[:, 2],
        cmap="PuOr_r",
        clim=(-largest, largest),
        edgecolors="none",
    )
    axes.add_collection(squares)
    sideways = np.hypot(*force[:, :2].T)
    per_cell = max(float(sideways.max()), 0.1 * largest) / 1.5
    axes.quiver(
        *sites[:, :2].T, *(force[:, :2] * panel.side_mm / per_cell).T, angles="xy", scale_units="xy", scale=1.0,
        width=0.003, color=INK,
    )  # fmt: skip
    if panel.outline_mm is not None:
        axes.plot(*np.vstack([panel.outline_mm, panel.outline_mm[:1]]).T, "--", color=INK, linewidth=1)
    axes.set_aspect("equal")
    low, high = sites[:, :2].min(axis=0) - half, sites[:, :2].max(axis=0) + half
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    bar = axes.figure.colorbar(squares, ax=axes, shrink=0.8)
    bar.set_label("force along z (N)", fontsize=8, color=SOFT)
    bar.ax.tick_params(labelsize=7, colors=SOFT)
    _named(axes, f"x (mm); an arrow of one cell is {per_cell:.2g} N", "y (mm)")
