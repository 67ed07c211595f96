"""What a finished sweep is shown as (`twin.show.sweep`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.arrays import Floats
from twin.parts.part import unit_of
from twin.parts.sweep import METRICS
from twin.png import png_bytes
from twin.results import write_whole
from twin.show.sweep import Card, Front, SweepPage, sweep_page
from twin.show.sweep_map import Map
from twin.study.sweep.best import Best
from twin.study.sweep.rank import metric, pareto
from twin.study.sweep.run import Swept
from twin.study.sweep.sensitivity import sensitivities
from twin.study.sweep.table import Store
from twin.study.sweep.work import expected

FRONTS = (("two_point_mm", "total_force_error"), ("two_point_mm", "resolution_gf"),
          ("two_point_mm", "total_force_bias"), ("two_point_mm", "range_n"), ("two_point_mm", "markers"),
          ("two_point_mm", "cost"), ("total_force_error", "frame_ms"))  # fmt: skip
TOLD = {"total_force_bias": "force error of the made sensors, without noise", "range_n": "largest force, the more the "
        "better (N)", "frame_ms": "software's time for a picture (ms)"}  # fmt: skip
MORE = frozenset({"range_n"})
"""Metrics of which more is better."""

MOST_REASONS = 12


def write_report(done: Swept, best: Sequence[Best], folder: Path) -> None:
    """Write ``report.html``."""
    import tomli_w

    sweep = done.designs.sweep
    counts = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    failed = [f"{counts['failed']} designs failed: the table says why."] if counts["failed"] else []
    reasons = Counter(str(e) for e in done.error if e)
    told = [(s.metric, s.axis, s.first, s.total, s.rank) for s in sensitivities(done)]
    page = sweep_page(
        SweepPage(
            title=sweep.title or f"Sweep of {sweep.scene}", verdict=_verdict(done, best),
            alarms=[*done.warnings, *failed],
            notes=done.notes, counts=counts, dropped=dict(reasons.most_common(MOST_REASONS)),
            fronts=_fronts(done), maps=_maps(done), cards=_cards(done, best, folder), sensitivity=told,
            recipe=tomli_w.dumps(sweep.model_dump(mode="json", exclude_none=True, exclude={"source", "assumed"})),
        )
    )  # fmt: skip
    write_whole(folder / "report.html", lambda file: file.write(page.encode()))


def _verdict(done: Swept, best: Sequence[Best]) -> str:
    if not best:
        return f"None of {len(done.designs)} designs is possible."
    sweep, first = done.designs.sweep, best[0]
    met = []
    for name, target in sweep.targets.items():
        values = metric(done.columns, name)
        if values is not None and np.isfinite(values[first.number]):
            word = "meets" if values[first.number] <= target else "misses"
            met.append(f"{word} {name} = {target:g} ({values[first.number]:.3g})")
    return f"The best of {len(done.designs)} designs is number {first.number}: {'; '.join(met)}."


def _named(name: str) -> str:
    if name in TOLD:
        return TOLD[name]
    unit = unit_of(name) or ("gf" if name.endswith("_gf") else "")
    words = METRICS.get(name, name).split(",")[0] if name in METRICS else name.replace("_", " ")
    return f"{words} ({unit})" if unit else words


def _fronts(done: Swept) -> list[Front]:
    fronts = []
    for x_name, y_name in FRONTS:
        x, y = metric(done.columns, x_name, "linear"), metric(done.columns, y_name, "linear")
        if x is None or y is None:
            continue
        ok = done.status == "ok"
        x, y = np.where(ok, x, np.nan), np.where(ok, y, np.nan)
        targets = done.designs.sweep.targets
        fronts.append(
            Front(
                across=_named(x_name), up=_named(y_name), x=x, y=y, on_front=pareto([x, -y if y_name in MORE else y]),
                target=(targets.get(x_name, np.nan), targets.get(y_name, np.nan)),
            )
        )  # fmt: skip
    return fronts


def _maps(done: Swept) -> list[Map]:
    """Return maps over the first two axes that are numbers."""
    axes = [k for k, v in done.designs.columns.items() if k in done.designs.sweep.axes and _numbers(v) is not None]
    if len(axes) < 2:
        return []
    x, y = (_numbers(done.designs.columns[name]) for name in axes[:2])
    assert x is not None
    assert y is not None
    maps = []
    for name in ("two_point_mm", "fwhm_mm"):
        value, limit = metric(done.columns, name, "linear"), done.columns.get(f"closed_{name}")
        if value is None:
            continue
        maps.append(
            Map(
                across=axes[0], up=axes[1], metric=_named(name), x=x, y=y, value=value,
                limit=limit if limit is not None else np.full(len(x), np.nan),
                target=done.designs.sweep.targets.get(name, np.nan),
            )
        )  # fmt: skip
    return maps


def _numbers(values: Sequence[object]) -> Floats | None:
    return np.asarray(values, float) if all(isinstance(v, int | float) for v in values) else None


def _cards(done: Swept, best: Sequence[Best], folder: Path) -> list[Card]:
    store = Store(folder)
    cards = []
    for each in best:
        picture, fields = None, []
        key = done.keys.get(each.number)
        kept = store.pictures(key) if key is not None else None
        if kept is not None:
            picture = png_bytes(kept["picture"])
            fields = [
                ("Estimate of the push in the middle", kept["site_mm"], kept["middle_n"]),
                (f"Estimate of two pushes {done.designs.sweep.loads.pair_mm:g} mm apart", kept["site_mm"],
                 kept["pair_n"]),
            ]  # fmt: skip
        elif done.fidelity[each.number] == "linear":
            shown = expected(done.designs.sweep, done.designs.scene, done.designs.values(each.number))
            fields = [("Expected estimate of the push in the middle", shown.site_mm, shown.force_n)]
        cards.append(
            Card(
                heading=f"Design {each.number}", words=each.words, file=str(each.file.relative_to(folder)),
                picture=picture, fields=fields,
            )
        )  # fmt: skip
    return cards
