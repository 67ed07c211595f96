"""The page of a finished sweep: fronts, maps, sensitivity, and the best designs as scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats
from twin.files import make_folder, png_bytes, write_whole
from twin.parts.part import Part, unit_of
from twin.parts.scene import Scene
from twin.parts.sweep import METRICS
from twin.show.sweep_page import design, front, metric_map, sweep_page
from twin.study.recipe import dump_scene
from twin.study.sweep.closed_form_design import closed
from twin.study.sweep.designs import designs_at
from twin.study.sweep.sweep_rows import Store, expected
from twin.study.sweep.sweep_run import Swept, agreement, metric

MOST = 5
"""Designs that get a scene of their own."""


def _write_best(done: Swept, folder: Path) -> dict[int, tuple[Path, str]]:
    """Write ``best/01-design-<number>.toml`` and so on, the best first, and return by number the
    file of a design's scene, and its values and figures in words."""
    make_folder(folder / "best")
    for old in (folder / "best").glob("*.toml"):
        old.unlink()
    best = {}
    for rank, number in enumerate(done.order[:MOST].tolist(), start=1):
        file = folder / "best" / f"{rank:02d}-design-{number}.toml"
        write_whole(file, dump_scene(_design_scene(done, number)).encode())
        values = ", ".join(
            f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}"
            for key, value in done.designs.values(number).items()
        )
        best[number] = file, f"{values}: {_reached(done, number)}"
    return best


def _design_scene(done: Swept, number: int) -> Scene:
    """Return a design's scene, with where its numbers come from."""
    sweep = done.designs.sweep
    title = f"Design {number} of the sweep '{sweep.title or sweep.scene}'"
    made = done.designs.scene_of(number).model_copy(update={"title": title})
    origin = (
        f"design {number} of a sweep of scene '{sweep.scene}'; what was not swept is that scene's"
    )
    scene: Scene = _assumed(made, origin)
    return scene


def _assumed(part: Any, origin: str) -> Any:
    """Return a description in which ``assumed`` is set, also in every description it holds."""
    if isinstance(part, Part):
        update = {name: _assumed(getattr(part, name), origin) for name in type(part).model_fields}
        return part.model_copy(update={**update, "source": {}, "assumed": origin})
    if isinstance(part, dict):
        return {key: _assumed(value, origin) for key, value in part.items()}
    if isinstance(part, tuple):
        return tuple(_assumed(value, origin) for value in part)
    return part


def _reached(done: Swept, number: int) -> str:
    """Return a design's figures in words, at its best fidelity."""
    figures = {k: float(c[number]) for k, c in done.columns.items() if np.isfinite(c[number])}
    words = []
    for name, unit, what in (
        ("two_point_mm", " mm", "two points"),
        ("dip", "", "dip"),
        ("fwhm_mm", " mm", "width"),
        ("total_force_error", "", "force error"),
        ("resolution_gf", " gf", "force noise"),
    ):
        for stage in ("full", "linear", "closed"):
            if f"{stage}_{name}" in figures:
                words.append(f"{what} {figures[f'{stage}_{name}']:.3g}{unit} ({stage})")
                break
    return ", ".join(words)


SAMPLES = 512
"""Base samples of the Sobol' indices; each costs as many designs as there are axes and two more."""

EXPLAINED = ("two_point_mm", "fwhm_mm", "resolution_gf")


def _sensitivities(done: Swept) -> list[tuple[str, str, float, float, float]]:
    """Return for every metric and axis the Sobol' indices of log(metric) by the closed form (first
    and total), and the rank correlation over the designs, NaN for lists of texts.

    Designs that are dropped take the metric's mean, so that they add nothing to its variance.
    """
    from scipy.stats import sobol_indices, uniform

    sweep, scene = done.designs.sweep, done.designs.scene
    axes = list(sweep.axes)

    def metrics(u: Floats) -> Floats:
        found = closed(designs_at(sweep, scene, np.clip(np.asarray(u).T, 0.0, 1.0)))[0]
        values = np.log(np.stack([found[name] for name in EXPLAINED]))
        values[~np.isfinite(values)] = np.nan
        if not np.isfinite(values).any(axis=1).all():
            return np.nan_to_num(values, nan=0.0)
        return np.where(np.isnan(values), np.nanmean(values, axis=1, keepdims=True), values)

    indices = sobol_indices(
        func=metrics, n=SAMPLES, dists=[uniform()] * len(axes), rng=np.random.default_rng(0)
    )
    first, total = (
        np.asarray(a).reshape(len(EXPLAINED), len(axes))
        for a in (indices.first_order, indices.total_order)
    )
    found = []
    for row, explained in enumerate(EXPLAINED):
        closed_form = done.columns.get(f"closed_{explained}", np.full(len(done.designs), np.nan))
        deepest = done.columns.get(f"linear_{explained}", closed_form)
        for column, axis in enumerate(axes):
            values = _numbers(done.designs.columns[axis])
            rank = float("nan") if values is None else agreement(values, deepest)[0]
            indices = float(first[row, column]), float(total[row, column])
            found.append((explained, axis, *indices, rank))
    return found


FRONTS = (
    ("two_point_mm", "total_force_error"),
    ("two_point_mm", "resolution_gf"),
    ("two_point_mm", "total_force_bias"),
    ("two_point_mm", "range_n"),
    ("two_point_mm", "markers"),
    ("two_point_mm", "cost"),
    ("total_force_error", "frame_ms"),
)
NAMES = {
    "total_force_bias": "force error of the made sensors, without noise",
    "range_n": "largest force, the more the better (N)",
    "frame_ms": "software's time for a picture (ms)",
}
MORE = frozenset({"range_n"})
"""Metrics of which more is better."""

MOST_REASONS = 12


def write_report(done: Swept, folder: Path) -> list[str]:
    """Write the best designs' scenes into ``best``, and ``report.html``; return the best designs'
    values and figures in words, the best first."""
    import tomli_w

    best = _write_best(done, folder)
    sweep = done.designs.sweep
    counts = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    failed = (
        [f"{counts['failed']} designs failed: the reasons are in the table."]
        if counts["failed"]
        else []
    )
    reasons = Counter(str(e) for e in done.error if e)
    page = sweep_page(
        title=sweep.title or f"Sweep of {sweep.scene}",
        verdict=_verdict(done),
        alarms=[*done.warnings, *failed],
        notes=done.notes,
        counts=counts,
        dropped=dict(reasons.most_common(MOST_REASONS)),
        fronts=_fronts(done),
        maps=_maps(done),
        designs=_cards(done, best, folder),
        sensitivity=_sensitivities(done),
        recipe=tomli_w.dumps(
            sweep.model_dump(mode="json", exclude_none=True, exclude={"source", "assumed"})
        ),
    )
    write_whole(folder / "report.html", page.encode())
    return [words for _, words in best.values()]


def _verdict(done: Swept) -> str:
    if not len(done.order):
        return f"None of {len(done.designs)} designs is possible."
    best, met = int(done.order[0]), []
    for name, target in done.designs.sweep.targets.items():
        values = metric(done.columns, name)
        if values is not None and np.isfinite(values[best]):
            word = "meets" if values[best] <= target else "misses"
            met.append(f"{word} {name} = {target:g} ({values[best]:.3g})")
    return f"The best of {len(done.designs)} designs is number {best}: {'; '.join(met)}."


def _named(name: str) -> str:
    if name in NAMES:
        return NAMES[name]
    unit = unit_of(name) or ("gf" if name.endswith("_gf") else "")
    words = METRICS.get(name, name).split(",")[0] if name in METRICS else name.replace("_", " ")
    return f"{words} ({unit})" if unit else words


def _fronts(done: Swept) -> list[str]:
    fronts, ok, targets = [], done.status == "ok", done.designs.sweep.targets
    for x_name, y_name in FRONTS:
        x, y = metric(done.columns, x_name, "linear"), metric(done.columns, y_name, "linear")
        if x is None or y is None:
            continue
        x, y = np.where(ok, x, np.nan), np.where(ok, y, np.nan)
        fronts.append(
            front(
                across=_named(x_name),
                up=_named(y_name),
                x=x,
                y=y,
                on_front=pareto([x, -y if y_name in MORE else y]),
                target=(targets.get(x_name, np.nan), targets.get(y_name, np.nan)),
            )
        )
    return fronts


def pareto(columns: Sequence[Floats]) -> Bools:
    """Return (m,) whether no other design is at least as good in all columns and better in one;
    less is better."""
    table = np.column_stack(columns)
    front: Bools = np.array(np.isfinite(table).all(axis=1), np.bool_)
    candidates = np.flatnonzero(front)
    kept: list[int] = []
    for number in candidates[np.lexsort(table[candidates].T[::-1])]:
        row = table[number]
        front[number] = not any((table[k] <= row).all() and (table[k] < row).any() for k in kept)
        if front[number]:
            kept.append(int(number))
    return front


def _maps(done: Swept) -> list[str]:
    """Return maps over the first two axes that are numbers."""
    columns = {name: _numbers(done.designs.columns[name]) for name in done.designs.sweep.axes}
    axes = [(name, values) for name, values in columns.items() if values is not None][:2]
    if len(axes) < 2:
        return []
    (across, x), (up, y) = axes
    maps = []
    for name in ("two_point_mm", "fwhm_mm"):
        value, limit = metric(done.columns, name, "linear"), done.columns.get(f"closed_{name}")
        if value is None:
            continue
        maps.append(
            metric_map(
                across=across,
                up=up,
                metric=_named(name),
                x=x,
                y=y,
                value=value,
                limit=limit if limit is not None else np.full(len(x), np.nan),
                target=done.designs.sweep.targets.get(name, np.nan),
            )
        )
    return maps


def _numbers(values: Sequence[object]) -> Floats | None:
    return np.asarray(values, float) if all(isinstance(v, int | float) for v in values) else None


def _cards(done: Swept, best: Mapping[int, tuple[Path, str]], folder: Path) -> list[str]:
    store, designs = Store(folder), done.designs
    two = f"Estimate of two pushes {designs.sweep.loads.pair_mm:g} mm apart"
    cards = []
    for number, (file, words) in best.items():
        picture, fields = None, []
        key = done.keys.get(number)
        kept = store.pictures(key) if key is not None else None
        if kept is not None:
            picture, site_mm = png_bytes(kept["picture"]), kept["site_mm"]
            fields = [
                ("Estimate of the push in the middle", site_mm, kept["middle_n"]),
                (two, site_mm, kept["pair_n"]),
            ]
        elif done.fidelity[number] == "linear":
            kept = expected(designs.sweep, designs.scene, designs.values(number))
            title = "Expected estimate of the push in the middle"
            fields = [(title, kept["site_mm"], kept["middle_n"])]
        cards.append(
            design(
                heading=f"Design {number}",
                words=words,
                file=str(file.relative_to(folder)),
                picture=picture,
                fields=fields,
            )
        )
    return cards
