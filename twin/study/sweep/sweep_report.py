"""The page of a finished sweep: fronts, maps, sensitivity, and the best designs as scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binned_statistic_2d

from twin.arrays import Bools, Floats, Points
from twin.files import make_folder, write_whole
from twin.parts.part import Part, unit_of
from twin.parts.sweep import METRICS
from twin.show.html_page import Axes, digits, figure, page, small_picture, table, two_columns
from twin.study.sweep.design_rows import Rows
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import closed
from twin.study.sweep.sweep_run import Swept

MOST = 5
"""Designs that get a scene of their own."""


def _write_best(done: Swept, folder: Path) -> dict[int, Path]:
    """Write ``best/01-design-<number>.toml`` and so on; return the files by number."""
    make_folder(folder / "best")
    for old in (folder / "best").glob("*.toml"):
        old.unlink()
    sweep = done.designs.sweep
    best = {}
    for rank, number in enumerate(done.order[:MOST].tolist(), start=1):
        title = f"Design {number} of the sweep '{sweep.title or sweep.scene}'"
        origin = f"design {number} of a sweep of scene '{sweep.scene}'; what was not swept is its"
        scene = done.designs.scene_of(number).model_copy(update={"title": title})
        best[number] = folder / "best" / f"{rank:02d}-design-{number}.toml"
        write_whole(best[number], _assumed(scene, origin).to_toml().encode())
    return best


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


FIGURES = {
    "two_point_mm": ("two points (mm)", "least distance at which two pushes show as two peaks"),
    "fwhm_mm": ("push's width (mm)", "of the field of the push in the middle, at half its height"),
    "total_force_error": ("force error (%)", "of the total force, root mean square"),
    "resolution_gf": (
        "force noise (gf)",
        "standard deviation of the total force by noise; 1 gf is 9.81 mN",
    ),
    "dip": (
        "dip (%)",
        "how far the force falls between two pushes {pair:g} mm apart: 0 is one "
        "peak, 100 or more is two apart",
    ),
}
"""Head and meaning of a best design's figures."""


def _best_records(done: Swept) -> list[dict[str, Any]]:
    """Return number, swept values, metrics at their best fidelity and last fidelity of the best
    designs."""
    numbers = done.order[:MOST].tolist()
    records = [{"design": number, **done.designs.values(number)} for number in numbers]
    for name in FIGURES:
        values = done.metric(name)
        if values is not None and np.isfinite(values[numbers]).any():
            for record in records:
                record[name] = float(values[record["design"]])
    return [{**record, "fidelity": str(done.fidelity[record["design"]])} for record in records]


def _shown(record: Mapping[str, Any], axes: Collection[str]) -> dict[str, str]:
    """Return a design's record as it is shown, by the heads of a table."""
    cells = {}
    for key, value in record.items():
        if key in FIGURES:
            head, _ = FIGURES[key]
            cells[head] = _short(float(_scale(head) * value))
        else:
            cells[_axis_name(key) if key in axes else key] = _short(value)
    return cells


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{float(f'{value:.3g}'):g}" if np.isfinite(value) else "–"
    return str(value)


def _axis_name(key: str) -> str:
    """Return a swept key in words: ``markers.blue.depth_mm`` is "depth of blue (mm)"."""
    *tables, last = key.split(".")
    unit = unit_of(last)
    words = (last.removesuffix(f"_{last.rsplit('_', 1)[-1]}") if unit else last).replace("_", " ")
    if tables[:1] == ["markers"] and len(tables) == 2:
        words += " of all layers" if tables[1] == "*" else f" of {tables[1]}"
    elif tables and tables[-1] != "material":
        words = f"{tables[-1].replace('camera', 'picture')} {words}"
    words = words.replace("picture focal", "focal length").replace("youngs", "Young's")
    return f"{words} ({unit})" if unit else words


SAMPLES = 512
"""Base samples of the Sobol' indices; each costs as many designs as there are axes and two more."""

EXPLAINED = ("two_point_mm", "fwhm_mm", "resolution_gf")


def _sensitivities(done: Swept) -> list[tuple[str, str, float, float, float]]:
    """Return by metric and axis the first and total Sobol' index of log(metric) by the closed form,
    where dropped designs take the mean, and the rank correlation; NaN for texts. Nothing where only
    pictures judged."""
    from scipy.stats import sobol_indices, uniform

    sweep, scene = done.designs.sweep, done.designs.scene
    if sweep.ladder == ("full",):
        return []
    axes = list(sweep.axes)

    def metrics(u: Floats) -> Floats:
        found = closed(Designs.at(sweep, scene, np.clip(np.asarray(u).T, 0.0, 1.0)))[0]
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
            rank = float("nan") if values is None else done.agreement(values, deepest)[0]
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
    "total_force_error": "error of the total force (%)",
    "total_force_bias": "force error without noise (%)",
    "resolution_gf": "noise of the total force (gf)",
    "range_n": "largest force, more is better (N)",
    "frame_ms": "software's time a picture (ms)",
}
MORE = frozenset({"range_n"})
"""Metrics of which more is better."""

MOST_REASONS = 12
"""Reasons of dropped designs that are counted on the page, the most frequent first."""


def write_report(done: Swept, folder: Path) -> tuple[list[str], list[dict[str, Any]]]:
    """Write ``best`` and ``report.html``; return lines that say what to make, and the best
    designs."""
    import tomli_w

    best = _write_best(done, folder)
    sweep = done.designs.sweep
    counts = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    alarms = [*done.warnings]
    if counts["failed"]:
        alarms.append(f"{counts['failed']} designs failed: the reasons are in the table.")
    reasons = Counter(str(e) for e in done.error if e).most_common(MOST_REASONS)
    became = [(name, [str(count)]) for name, count in (*counts.items(), *reasons)]
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in done.notes)
    records = _best_records(done)
    rows = [_shown(record, done.designs.columns) for record in records]
    heads = list(rows[0]) if rows else []
    pair = done.designs.sweep.loads.pair_mm
    meanings = [
        f"{head.rpartition(' ')[0]}: {meaning.format(pair=pair)}"
        for head, meaning in FIGURES.values()
        if head in heads
    ]
    if rows:
        meanings.append("fidelity: full by pictures and tracking, linear and closed without")
    cells = [[escape(cell) for cell in row.values()] for row in rows]
    shown = [(first, others) for first, *others in cells]
    said = f'<p class="note">{escape("; ".join(meanings))}.</p>'
    sections = [
        ("The best", table("Designs", list(map(escape, heads[1:])), shown) + said if rows else ""),
        ("Each of them", _cards(done, best, folder)),
        ("Fronts", two_columns(_fronts(done))),
        ("Maps", two_columns(_maps(done))),
        ("What matters", _sensitivity_table(_sensitivities(done))),
        ("Fidelities and reuse", notes),
        ("What became of the designs", table("Designs", ["number"], became)),
    ]
    recipe = sweep.model_dump(mode="json", exclude_none=True, exclude={"source", "assumed"})
    title = sweep.title or f"Sweep of {sweep.scene}"
    text = page(title, _verdict(done), alarms, sections, tomli_w.dumps(recipe))
    write_whole(folder / "report.html", text.encode())
    lines = [_verdict(done)]
    if rows:
        # a design a column: five of them fit a terminal, however many axes there are
        name, cell = max(map(len, heads)), 2 + max(6, *(len(c) for r in rows for c in r.values()))
        lines += [head.ljust(name) + "".join(r[head].rjust(cell) for r in rows) for head in heads]
    return [*lines, *(f"({meaning})" for meaning in meanings)], records


def _verdict(done: Swept) -> str:
    """Return what to make, what it reaches, and which targets no design meets, or none was judged
    by."""
    if not len(done.order):
        ((reason, _),) = Counter(map(str, done.error)).most_common(1)
        return f"None of {len(done.designs)} designs is possible: {reason}"
    best = int(done.order[0])
    values = done.designs.values(best)
    made = [
        # "depth of blue (mm)", 1.2 -> "depth of blue 1.2 mm"
        " ".join([name.partition(" (")[0], _short(value), name.partition(" (")[2].rstrip(")")])
        for name, value in zip(map(_axis_name, values), values.values(), strict=True)
    ]
    reached, missed, unjudged = [], [], []
    for name, target in done.designs.sweep.targets.items():
        found = done.metric(name)
        if found is None or not np.isfinite(found[best]):
            unjudged.append(_as_asked(name, None, target))
            continue
        reached.append(_as_asked(name, float(found[best]), target))
        if found[best] > target:
            least = float(np.nanmin(np.where(done.status == "ok", found, np.nan)))
            missed.append(_as_asked(name, least, target) if least > target else "")
    inverse = done.designs.scene.reconstruction
    guessed = inverse is not None and inverse.method == "local" and done.fidelity[best] == "linear"
    text = f"Confirm design {best} by pictures" if guessed else f"Make design {best}"
    text += f": {', '.join(map(str.strip, made))}. "
    text += f"It reaches: {'; '.join(reached) or 'no target that was judged'}."
    if unjudged:
        text += f" Not judged at this fidelity: {'; '.join(unjudged)}."
    if never := [words for words in missed if words]:
        text += f" No design meets all targets; the least of all designs: {'; '.join(never)}."
    return text


def _as_asked(name: str, value: float | None, target: float) -> str:
    """Return a metric, with its value if it has one, and its target in words."""
    head = FIGURES[name][0] if name in FIGURES else _named(name)
    scale = _scale(head)
    head, _, unit = head.rstrip(")").partition(" (")
    reached = "" if value is None else f"{scale * value:.3g} {unit} "
    return f"{head} {reached}(asked: {scale * target:g} {unit})".replace(" )", ")")


def _scale(head: str) -> int:
    """Return what a metric is multiplied by to have the unit that its head ends with."""
    return 100 if head.endswith("(%)") else 1


def _named(name: str) -> str:
    if name in NAMES:
        return NAMES[name]
    unit = unit_of(name) or ("gf" if name.endswith("_gf") else "")
    words = METRICS[name].split(",")[0] if name in METRICS else name.replace("_", " ")
    return f"{words} ({unit})" if unit else words


MOST_DOTS = 3000
"""Dots of a drawing; of more designs every so-and-so-many-th is drawn, and the front."""

FAR = 0.6
"""How far outside the designs a target is drawn, in their ranges: a farther one would press them
into a corner."""


def _fronts(done: Swept) -> list[str]:
    """Return the drawings of designs by two metrics that differ between them."""
    fronts = []
    ok = done.status == "ok"
    targets = done.designs.sweep.targets
    for x_name, y_name in FRONTS:
        x, y = done.metric(x_name, "linear"), done.metric(y_name, "linear")
        if x is None or y is None:
            continue
        names = (_named(x_name), _named(y_name))
        across, up = map(_scale, names)
        x, y = np.where(ok, across * x, np.nan), np.where(ok, up * y, np.nan)
        known = np.isfinite(x) & np.isfinite(y)
        if known.sum() < 2 or min(np.ptp(v[known]) for v in (x, y)) == 0:
            continue
        on_front = done.front([x, -y if y_name in MORE else y])[known]
        target = (across * targets.get(x_name, np.nan), up * targets.get(y_name, np.nan))
        fronts.append(_front(names, x[known], y[known], on_front, target))
    return fronts


def _front(
    names: tuple[str, str], x: Floats, y: Floats, on_front: Bools, target: tuple[float, float]
) -> str:
    """Return the drawing (HTML) of (m,) designs by two metrics; NaN in ``target`` for none."""
    # a few hopeless designs must not press all others into a corner
    ends = [(float(v.min()), float(np.quantile(v, 0.95))) for v in (x, y)]
    targets = [
        t if a - FAR * (b - a) <= t <= b + FAR * (b - a) else np.nan
        for t, (a, b) in zip(target, ends, strict=True)
    ]
    for k, wanted in enumerate(targets):
        if np.isfinite(wanted):
            ends[k] = (min(ends[k][0], wanted), max(ends[k][1], wanted))
    (left, right), (bottom, top) = [
        (a - 0.05 * (b - a) - 1e-12, b + 0.05 * (b - a) + 1e-12) for a, b in ends
    ]
    axes = Axes(left=left, right=right, bottom=bottom, top=top, height=280)
    shown = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
    step = max(1, int(shown.sum()) // MOST_DOTS)
    points = np.column_stack([x, y])
    content = axes.dots(points[shown][::step], "dot other", 2.2)
    on = points[shown & on_front]
    on = on[np.argsort(on[:, 0])]
    if len(on):
        content += axes.line(on, "profile estimate") + axes.dots(on, "dot red", 3.2)
    for k, wanted in enumerate(targets):
        if np.isfinite(wanted):
            upright, level = [[wanted, bottom], [wanted, top]], [[left, wanted], [right, wanted]]
            content += axes.line(np.array(level if k else upright), "contact")
    svg = axes.drawing(content, *names, f"{names[1]} against {names[0]} of all designs")
    caption = (
        "Each dot is a design, without pictures; no other is better in both than those on the "
        "line. The worst "
        f"twentieth lies outside. {_said(names, target, targets)}"
    )
    return figure(svg, caption)


def _said(names: tuple[str, str], targets: tuple[float, float], drawn: Sequence[float]) -> str:
    """Return what to say of a front's targets, in numbers where they are too far away to be
    drawn."""
    words = ["Dashed: the targets."] if np.isfinite(drawn).any() else []
    for name, target, shown in zip(names, targets, drawn, strict=True):
        if np.isfinite(target) and not np.isfinite(shown):
            words.append(f"The target, {escape(name)}: {digits(float(target))}, lies far outside.")
    return " ".join(words)


BINS = 14
"""Bins of a map along an axis at most."""


def _maps(done: Swept) -> list[str]:
    """Return maps over the first two axes that are numbers."""
    columns = {name: _numbers(done.designs.columns[name]) for name in done.designs.sweep.axes}
    axes = [(name, values) for name, values in columns.items() if values is not None][:2]
    if len(axes) < 2:
        return []
    found = []
    for name in ("two_point_mm", "fwhm_mm"):
        value = done.metric(name, "linear")
        limit = done.columns.get(f"closed_{name}")
        if value is None:
            continue
        limit = limit if limit is not None else np.full(len(value), np.nan)
        target = done.designs.sweep.targets.get(name, np.nan)
        found.append(_map(axes, _named(name), value, limit, target))
    return [drawn for drawn in found if drawn]


def _map(
    over: Sequence[tuple[str, Floats]], label: str, value: Floats, limit: Floats, target: float
) -> str:
    """Return a map (HTML) of a metric's median over two axes, and the borders where it and its
    closed-form ``limit`` (m,) reach ``target``, NaN for none; empty without bins or values."""
    (across, x), (up, y) = over
    across, up = _axis_name(across), _axis_name(up)
    edges = [_edges(v) for v in (x, y)]
    if min(len(e) for e in edges) < 2:
        return ""
    binned, allowed = (_binned(x, y, v, edges) for v in (value, limit))
    known = np.isfinite(binned)
    if not known.any():
        return ""
    low, high = float(binned[known].min()), float(binned[known].max())
    (left, *_, right), (bottom, *_, top) = (e.tolist() for e in edges)
    axes = Axes(left=left, right=right, bottom=bottom, top=top, height=300)
    parts = []
    for i, j in np.argwhere(known):
        corners = axes.place(
            np.array([[edges[0][i], edges[1][j + 1]], [edges[0][i + 1], edges[1][j]]])
        )
        (x0, y0), (x1, y1) = corners.tolist()
        share = 1.0 - (binned[i, j] - low) / (high - low) if high > low else 1.0
        parts.append(
            f'<rect class="push" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" '
            f'height="{y1 - y0:.1f}" fill-opacity="{0.05 + 0.9 * share:.2f}">'
            f"<title>{binned[i, j]:.3g}</title></rect>"
        )
    if np.isfinite(target):
        parts.append(_border(axes, edges, allowed <= target, "contact"))
        parts.append(_border(axes, edges, binned <= target, "force"))
    words = f"{label} over {across} and {up}"
    svg = axes.drawing("".join(parts), across, up, words)
    border = ""
    if np.isfinite(target):
        border = (
            f" Inside the solid border it is at most {digits(target)}; inside the dashed one the "
            "design limit is."
        )
    ramp = (
        f'<div class="ramp"><span>{digits(low)}</span><span class="colours" style="background:'
        f'linear-gradient(to right,var(--push),transparent)"></span><span>{digits(high)}</span>'
        "</div>"
    )
    return figure(svg + ramp, f"{escape(label)}.{border}")


def _edges(values: Floats) -> Floats:
    """Return bin edges: halfway between values if they are few, else even."""
    known = np.unique(values[np.isfinite(values)])
    if len(known) < 2:
        return np.zeros(0)
    if len(known) <= BINS:
        middle = (known[1:] + known[:-1]) / 2
        return np.concatenate([[2 * known[0] - middle[0]], middle, [2 * known[-1] - middle[-1]]])
    return np.linspace(known[0], known[-1], BINS + 1)


def _binned(x: Floats, y: Floats, values: Floats, edges: Sequence[Floats]) -> Floats:
    """Return the median of finite values in every bin; NaN where there is none."""
    known = np.isfinite(values)
    if not known.any():
        return np.full([len(each) - 1 for each in edges], np.nan)
    found = binned_statistic_2d(x[known], y[known], values[known], "median", edges)
    return np.asarray(found.statistic)


def _border(axes: Axes, edges: Sequence[Floats], inside: np.ndarray, style: str) -> str:
    """Return the border between bins that are inside and those that are not."""
    across, up = edges
    wide = np.pad(inside, 1)  # nothing lies inside beyond the first and last bins
    sides = [
        [[across[i], up[j - 1]], [across[i], up[j]]] for i, j in np.argwhere(np.diff(wide, axis=0))
    ]
    sides += [
        [[across[i - 1], up[j]], [across[i], up[j]]] for i, j in np.argwhere(np.diff(wide, axis=1))
    ]
    return axes.segments(sides, style)


def _numbers(values: Sequence[object]) -> Floats | None:
    return np.asarray(values, float) if all(isinstance(v, int | float) for v in values) else None


def _cards(done: Swept, best: Mapping[int, Path], folder: Path) -> str:
    """Return the best designs (HTML): how to run each, picture and fields."""
    designs = done.designs
    two = f"Estimate of two pushes {designs.sweep.loads.pair_mm:g} mm apart"
    cards = []
    for number, file in best.items():
        parts = []
        key = done.keys.get(number)
        kept = Rows.shown(folder, key) if key is not None else None
        if kept is not None:
            image = (
                f'<img src="{small_picture(kept["picture"])}" alt="CCD picture of Design {number} '
                'under the push in the middle">'
            )
            parts.append(figure(image, "Picture under the push in the middle"))
            parts.append(
                _field("Estimate of the push in the middle", kept["site_mm"], kept["middle_n"])
            )
            if kept["pair_n"].size:
                parts.append(_field(two, kept["site_mm"], kept["pair_n"][:, :, 0]))
        elif done.fidelity[number] == "linear":
            kept = done.expected(number)
            title = "Expected estimate of the push in the middle"
            parts.append(_field(title, kept["site_mm"], kept["middle_n"]))
        head = (
            f"<h3>Design {number}</h3>"
            f'<p class="note">Ready to run, in this page&rsquo;s folder: <code>twin run '
            f"{escape(str(file.relative_to(folder)))}</code></p>"
        )
        cards.append((head, parts))
    if all(len(parts) < 2 for _, parts in cards):  # they stand next to each other
        return two_columns([f"<div>{head}{''.join(parts)}</div>" for head, parts in cards])
    return "".join(f"<div>{head}{two_columns(parts, three=True)}</div>" for head, parts in cards)


def _field(name: str, sites: Points, force: Floats) -> str:
    """Return the drawing of a field: colour is the force along z, arrows those along x and y."""
    apart = np.linalg.norm(sites[1:, :2] - sites[:1, :2], axis=1)
    side = float(apart.min()) if len(apart) else 1.0
    largest = float(np.abs(force[:, 2]).max()) or 1.0
    axes, colours, pushed = Axes.force_field(sites[:, :2], force, side, largest, largest / 1.5)
    svg = axes.drawing(colours + pushed, "x (mm)", "y (mm)", f"Force field, {name}")
    return figure(svg, f"{escape(name)}; the strongest is {digits(largest)} N a site")


def _hundredths(share: float) -> str:
    """Return a number to hundredths with a true minus sign; a dash for none."""
    return f"{share:z.2f}".replace("-", "−") if np.isfinite(share) else "–"


def _sensitivity_table(rows: Sequence[tuple[str, str, float, float, float]]) -> str:
    if not rows:
        return ""
    cells = [
        (
            escape(
                f"{_named(explained).partition(' (')[0]}: {_axis_name(axis).partition(' (')[0]}"
            ),
            [_hundredths(first), _hundredths(total), _hundredths(rank)],
        )
        for explained, axis, first, total, rank in rows
    ]
    caption = (
        "Share of the variance of the metric's logarithm that an axis makes alone and with the "
        "others (Sobol' indices by the closed form), and rank correlation of axis and metric over "
        "this sweep's designs"
    )
    return table(caption, ["alone", "with others", "rank correlation"], cells)
