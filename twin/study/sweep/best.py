"""The best designs as scenes, ready for ``twin run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.parts.part import Part
from twin.parts.scene import Scene
from twin.results import make_folder, write_whole
from twin.study.recipe import dump_scene
from twin.study.sweep.designs import short
from twin.study.sweep.run import Swept

MOST = 5
"""Designs that get a scene of their own."""


@dataclass(frozen=True, kw_only=True)
class Best:
    """One of the best designs.

    Attributes
    ----------
    number
        Of the design.
    file
        Its scene, in the sweep's folder.
    words
        Its values and what it reaches.
    figures
        What it reaches, by column.
    """

    number: int
    file: Path
    words: str
    figures: dict[str, float]


def write_best(done: Swept, folder: Path) -> list[Best]:
    """Write ``best/01-design-<number>.toml`` and so on, the best first, and return what they are."""
    make_folder(folder / "best")
    for old in (folder / "best").glob("*.toml"):
        old.unlink()
    best = []
    for rank, number in enumerate(done.order[:MOST].tolist(), start=1):
        values = done.designs.values(number)
        title = f"Design {number} of the sweep '{done.designs.sweep.title or done.designs.sweep.scene}'"
        scene = design_scene(done, number, title)
        file = folder / "best" / f"{rank:02d}-design-{number}.toml"
        text = dump_scene(scene)
        write_whole(file, lambda f, text=text: f.write(text.encode()))  # type: ignore[misc]
        figures = {k: float(c[number]) for k, c in done.columns.items() if np.isfinite(c[number])}
        best.append(Best(number=number, file=file, words=f"{short(values)}: {reached(figures)}", figures=figures))
    return best


def design_scene(done: Swept, number: int, title: str) -> Scene:
    """Return a design's scene with its title, every number said to come from the sweep or from its base."""
    made = done.designs.scene_of(number)
    told = f"design {number} of a sweep of scene '{done.designs.sweep.scene}'; what was not swept is that scene's"
    scene: Scene = _assumed(made.model_copy(update={"title": title}), told)
    return scene


def _assumed(part: Any, told: str) -> Any:
    """Return a description with ``assumed`` said in it and in every description it holds."""
    if isinstance(part, Part):
        update = {name: _assumed(getattr(part, name), told) for name in type(part).model_fields}
        return part.model_copy(update={**update, "source": {}, "assumed": told})
    if isinstance(part, dict):
        return {key: _assumed(value, told) for key, value in part.items()}
    if isinstance(part, tuple):
        return tuple(_assumed(value, told) for value in part)
    return part


def reached(figures: dict[str, float]) -> str:
    """Return a design's figures in words, at the best fidelity that it was looked at with."""
    words = []
    for name, unit, what in (
        ("two_point_mm", " mm", "two points"), ("dip", "", "dip"), ("fwhm_mm", " mm", "width"),
        ("total_force_error", "", "force error"), ("resolution_gf", " gf", "force noise"),
    ):  # fmt: skip
        for stage in ("full", "linear", "closed"):
            if f"{stage}_{name}" in figures:
                words.append(f"{what} {figures[f'{stage}_{name}']:.3g}{unit} ({stage})")
                break
    return ", ".join(words)
