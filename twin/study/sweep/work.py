"""What a worker does: some designs of one fidelity in, their rows out.

A worker knows the sweep by the job's files only. It keeps the bodies that it prepared for the designs that follow; as
each answers one set of patches only, a row depends on nothing but its design.
"""

from __future__ import annotations

import dataclasses
import io
import json
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError, RecipeError, TwinError
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.batch.draw import plain_table
from twin.study.recipe import load_scene
from twin.study.sweep.closed import dropped_by_view
from twin.study.sweep.designs import scene_of
from twin.study.sweep.full import Taken, full
from twin.study.sweep.linear import Shown, linear
from twin.study.sweep.loads import REGION, Bodies, Pushes, pushes_of, thickness_range
from twin.study.sweep.view import view_of

Row = dict[str, Any]
WORK = "twin.study.sweep.work:make_rows"
SHOWN = ("picture", "site_mm", "middle_n", "pair_n")
"""What is kept of a design's full chain for the page."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """Rows of a task.

    Attributes
    ----------
    rows
        One for every design: ``status`` ok, dropped or failed, ``error``, ``seconds``, and metrics.
    shown
        Contents of npz files that hold what the report shows, where something is.
    asked, made
        How often a body was asked, and how many were prepared for it.
    """

    rows: list[Row]
    shown: list[bytes | None]
    asked: int
    made: int


class Workshop:
    """What a process keeps of one sweep."""

    def __init__(self, folder: Path) -> None:
        told = json.loads((folder / "sweep.json").read_text())
        self.sweep = Sweep.model_validate(told["sweep"])
        self.stage: str = told["stage"]
        self.chunk: int = told["chunk"]
        self.values: list[dict[str, Any]] = told["designs"]
        self.scene = load_scene(folder / "scene.toml")
        self.base = plain_table(self.scene)
        self.bodies = Bodies(thickness_mm=thickness_range(self.sweep))
        self._pushes: dict[str, Pushes] = {}

    def pushes(self, scene: Scene) -> Pushes:
        """Return what pushes on a design: the same patches for every design of one body."""
        key = json.dumps(scene.body.geometry(), sort_keys=True, default=str)
        if key not in self._pushes:
            loads = self.sweep.loads
            self._pushes[key] = pushes_of(scene.body, loads, region_of(self.sweep, self.scene), self.sweep.seed)
        return self._pushes[key]

    def row(self, values: dict[str, Any]) -> tuple[Row, bytes | None]:
        """Return a design's row; what goes wrong with it is its status."""
        started = time.perf_counter()
        row: Row = {"status": "ok", "error": ""}
        shown = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                figures, shown = self._judge(scene_of(self.sweep, self.base, values), row)
            row |= figures
        except RecipeError as problem:
            row |= {"status": "dropped", "error": "; ".join(problem.problems)}
        except TwinError as problem:
            row |= {"status": "failed", "error": str(problem)}
        except OSError:  # this machine's trouble, such as a full disk, and not the design's: its row is no row
            raise
        except Exception as problem:  # one design must not end a sweep of thousands
            row |= {"status": "failed", "error": f"{type(problem).__name__}: {problem}"}
        row["seconds"] = time.perf_counter() - started
        return row, shown

    def _judge(self, scene: Scene, row: Row) -> tuple[dict[str, float], bytes | None]:
        limits = self.sweep.limits
        view = view_of(scene)
        if reason := dropped_by_view(view, limits.overlap, limits.seen):
            row |= {"status": "dropped", "error": reason}
            return {}, None
        pushes = self.pushes(scene)
        if self.stage == "linear":
            return linear(scene, view, self.sweep, self.bodies, pushes)[0], None
        figures, taken = full(scene, self.sweep, self.bodies, pushes)
        return figures, packed(taken)


_SHOPS: dict[Path, Workshop] = {}


def make_rows(folder: Path, task: int) -> Rows:
    """Return the rows of a task."""
    if folder not in _SHOPS:
        _SHOPS.clear()
        _SHOPS[folder] = Workshop(folder)
    shop = _SHOPS[folder]
    before = shop.bodies.asked, shop.bodies.made
    done = [shop.row(values) for values in shop.values[task * shop.chunk : (task + 1) * shop.chunk]]
    asked, made = shop.bodies.asked - before[0], shop.bodies.made - before[1]
    return Rows([row for row, _ in done], [shown for _, shown in done], asked, made)


def region_of(sweep: Sweep, scene: Scene) -> tuple[float, float]:
    """Return the half sides of the presses' region.

    Raises
    ------
    InputError
        The scene has no sites and the sweep no region.
    """
    if sweep.loads.region_mm is not None:
        return sweep.loads.region_mm
    if scene.reconstruction is None:
        raise InputError("loads.region_mm: the scene has no [reconstruction] sites to take it from; give it")
    s, t = scene.reconstruction.sites.half_mm
    return REGION * s, REGION * t


def packed(taken: Taken) -> bytes:
    """Return a design's picture and fields as an npz file's contents."""
    file = io.BytesIO()
    np.savez_compressed(
        file, picture=taken.picture, site_mm=taken.middle.site_mm, middle_n=taken.middle.force_n,
        pair_n=taken.pair.force_n,
    )  # fmt: skip
    return file.getvalue()


def expected(sweep: Sweep, scene: Scene, values: dict[str, Any]) -> Shown:
    """Return a design's expected estimate of the push in the middle."""
    design = scene_of(sweep, plain_table(scene), values)
    pushes = pushes_of(design.body, sweep.loads, region_of(sweep, scene), sweep.seed)
    return linear(design, view_of(design), sweep, Bodies(thickness_mm=thickness_range(sweep)), pushes)[1]
