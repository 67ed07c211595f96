"""Figures for light and for dark pages: the same drawing, saved twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import Collection
from matplotlib.colors import LinearSegmentedColormap, to_hex, to_rgba_array
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.spines import Spine
from matplotlib.text import Text

PAPER, INK = "#131416", "#d6d8da"

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#777777")
"""Colours that colour-blind readers can distinguish as well (Okabe and Ito)."""

DARK = {
    "#c8381e": "#ff7b6f",
    "#1f5fbf": "#72a9ff",
    "#1b7a5a": "#4cc79a",
    "#7a4fb5": "#b18cf2",
    "#946c00": "#e0b040",
    "#555555": "#b8bdc2",
    "#0072b2": "#3aa0e0",
}
"""Lines' and arrows' colours on a light page, and those that take their place on a dark one."""

FORCES = LinearSegmentedColormap.from_list("forces_dark", ["#b18cf2", "#2a2f36", "#ff9a3d"])
"""Force along z on a dark page: purple pulls, orange pushes, and no force is as dark as the page."""


def save_both(figure: Any, path: Path, **kind: Any) -> None:
    """Save a figure as NAME.png and, with the colours of a dark page, as NAME_dark.png; it stays dark."""
    figure.savefig(path, **kind)
    _darken(figure)
    figure.savefig(path.with_stem(f"{path.stem}_dark"), **kind)


def _darken(figure: Any) -> None:
    """Give a figure the colours of a dark page: backgrounds, then texts and lines, then maps of forces."""
    papers = [figure.patch, *(ax.patch for ax in figure.axes)]
    for patch in papers:
        patch.set_facecolor(PAPER)
    legends = [*figure.legends, *(ax.get_legend() for ax in figure.axes)]
    frames = [legend.get_frame() for legend in legends if legend is not None]
    for frame in frames:
        if np.all(to_rgba_array(frame.get_facecolor())[:, :3] > 0.9):
            frame.set(facecolor=PAPER, edgecolor=INK)
    for artist in set(figure.findobj()) - set(papers) - set(frames):
        if isinstance(artist, ScalarMappable) and artist.get_array() is not None:
            if artist.get_cmap().name == "PuOr_r":
                artist.set_cmap(FORCES)
        elif isinstance(artist, Text):
            artist.set_color(_dark(artist.get_color())[0])
        elif isinstance(artist, Line2D):
            for part in ("color", "markerfacecolor", "markeredgecolor"):
                given = getattr(artist, f"get_{part}")()
                if not (isinstance(given, str) and given in ("none", "auto")):
                    getattr(artist, f"set_{part}")(_dark(given)[0])
        elif isinstance(artist, Spine):
            artist.set_edgecolor(_dark(artist.get_edgecolor())[0])
        elif isinstance(artist, Patch) and artist.get_fill():
            artist.set_facecolor(_dark(artist.get_facecolor())[0])
        elif isinstance(artist, Collection):
            for part in ("facecolor", "edgecolor"):
                given = getattr(artist, f"get_{part}")()
                if len(given):
                    getattr(artist, f"set_{part}")(_dark(given))


def _dark(given: Any) -> np.ndarray:
    """Return (n, 4) colours for a dark page: black as ink, those of `DARK` by name, others as they are."""
    colours = to_rgba_array(given).copy()
    for row in colours:
        if row[:3].max() < 0.2:
            row[:3] = to_rgba_array(INK)[0, :3]
        elif (named := DARK.get(to_hex(row[:3]))) is not None:
            row[:3] = to_rgba_array(named)[0, :3]
    return colours
