"""Run a sweep: from its recipe to a ranked table of designs.

`run_sweep` computes the cheap fidelity for all designs and the expensive ones for the best, which
a score ranks. Instead of a grid of designs it can search for the best design. `estimate` predicts
the time, and `check` tests the recipe first.

Only this process writes into the folder, under a lock; what it computed before is used again
(`twin.study.sweep.design_rows`).

Why differential evolution (R. Storn and K. Price 1997): axes may be lists, designs may be
impossible, a generation is a batch for all cores, and SciPy has it. Why L-BFGS-B after it
(R. Byrd et al. 1995): a population finds the valley quickly and its lowest point slowly. The
gradient is taken by differences. On axes that are lists or whole numbers the descent finds nothing
better and costs the share `SHARE` of the designs.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Progress
from twin.errors import RecipeError
from twin.files import Fact, fact, make_folder, write_whole
from twin.parts.scene import Scene, Sites
from twin.parts.sweep import FIDELITIES, METRICS, Sweep
from twin.study.batch.pool import Pool, counted, only_writer
from twin.study.doubts import View
from twin.study.sweep.design_rows import Row, Rows, Shown
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import closed, linear, resolved_by_sites
from twin.study.sweep.loads import Bodies, Pushes

BEYOND = 0.1
"""What being better than a target counts for, over being worse."""

POPULATION, SHARE = 8, 0.2
"""Designs of a generation, times the axes; part of the designs that is for the gradient."""

STEP = 0.01
"""Differences of the gradient, over an axis's range."""

WORST = 1e3
"""Score of an impossible design: worse than any other, and finite."""

COMPARED = (
    ("closed", "linear", "two_point_mm"),
    ("closed", "linear", "fwhm_mm"),
    ("closed", "linear", "resolution_gf"),
    ("linear", "full", "fwhm_mm"),
    ("linear", "full", "total_force_error"),
    ("linear", "full", "dip"),
)

WRITTEN = ("designs.parquet", "designs.csv", "report.html", "best")
"""Results of a sweep, the first one first."""

NEAR = 1.1
"""A two-point distance up to this times the grid's own is the grid's."""

FINE = 0.375
"""Pitch of sites over the two-point distance that they shall resolve: two pushes need a site
each and one between."""

TRIED = 4
"""Designs whose linear rows are computed for an estimate of the time."""


@dataclass
class Swept:
    """A finished sweep.

    Attributes
    ----------
    columns
        (m,) numbers by ``<fidelity>_<metric>``; NaN where a design was not taken so far.
    status, error, fidelity, score
        (m,) ok, dropped or failed; why; the last fidelity; the distance to the targets.
    order
        The designs that are ok, the best first, those of the last fidelity before all others.
    keys
        Keys of the rows of the full chain by design.
    notes, warnings
        What was reused and how well fidelities agree; what makes figures other than they seem.
    """

    designs: Designs
    columns: dict[str, Floats]
    status: np.ndarray
    error: np.ndarray
    fidelity: np.ndarray
    score: Floats = field(default_factory=lambda: np.zeros(0))
    order: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    keys: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def failed(self) -> int:
        """How many designs failed (those that are dropped have not)."""
        return int((self.status == "failed").sum())

    def metric(self, name: str, upto: str = "full") -> Floats | None:
        """Return a metric at the best fidelity, ``upto`` at most, of each design; None if none has
        it."""
        return _metric(self.columns, name, upto)

    @staticmethod
    def agreement(one: Floats, other: Floats) -> tuple[float, float, int]:
        """Return two fidelities' rank correlation (Spearman), the median ratio of the second to the
        first (NaN where one of the first is zero), and how many designs have both."""
        from scipy.stats import spearmanr

        both = np.isfinite(one) & np.isfinite(other)
        a, b = one[both], other[both]
        ratio = float(np.median(b / a)) if len(a) and a.all() else float("nan")
        ranked = len(a) > 2 and np.ptp(a) > 0 and np.ptp(b) > 0
        return float(spearmanr(a, b).statistic) if ranked else float("nan"), ratio, len(a)

    @staticmethod
    def front(columns: Sequence[Floats]) -> Bools:
        """Return (m,) whether no other design is at least as good (less) in all columns and better
        in one."""
        table = np.column_stack(columns)
        front: Bools = np.array(np.isfinite(table).all(axis=1), np.bool_)
        candidates = np.flatnonzero(front)
        kept: list[int] = []
        for number in candidates[np.lexsort(table[candidates].T[::-1])]:
            row = table[number]
            front[number] = not any(
                (table[k] <= row).all() and (table[k] < row).any() for k in kept
            )
            if front[number]:
                kept.append(int(number))
        return front

    def expected(self, number: int) -> Shown:
        """Return what the page shows of a design by its linear information."""
        designs = self.designs
        design = designs.scene_of(number)
        pushes = Pushes.on_design(designs.sweep, designs.scene, design)
        return linear(design, View.of(design), designs.sweep, Bodies.of(designs.sweep), pushes)[1]


def _check(sweep: Sweep, scene: Scene, optimise: bool) -> None:
    """Raise a `RecipeError` with all reasons why a sweep, or its search, can't be run."""
    problems = []
    solved = sweep.ladder != ("closed",)
    where = f"scene = '{sweep.scene}'"
    method = scene.calibration.method
    if scene.camera is None:
        problems.append(f"{where}: it has no [camera] table, and designs are seen by a camera")
    if scene.reconstruction is None and solved:
        problems.append(f"{where}: it has no [reconstruction] table, so there are no sites")
    if method not in ("compliance", "halfspace") and solved:
        problems.append(
            f"calibration.method = '{method}': every design would have to be pressed; set "
            "calibration.method = 'compliance' or 'halfspace' under [set]"
        )
    if not scene.markers:
        problems.append(f"{where}: it has no markers")
    loads, press = sweep.loads, scene.press
    if loads.probe and sweep.ladder != ("full",):
        problems.append(
            "loads.probe: only the full chain presses a probe, the closed form and linear "
            "information know given tractions; set fidelity = ['full'], or probe = false"
        )
    if loads.probe and press is None:
        problems.append(f"{where}: it has no [press] table, and loads.probe presses its probe")
    slides = press is not None and 0.0 < loads.shear >= press.friction
    if loads.probe and press is not None and slides and "press.friction" not in sweep.axes:
        problems.append(
            f"loads.shear = {loads.shear:g}: the probe would slide, as press.friction = "
            f"{press.friction:g}; set it above that under [set], or loads.shear = 0"
        )
    if not loads.probe and (scene.material.law != "linear" or "material.law" in sweep.axes):
        problems.append(
            "material.law: loads of given tractions are solved by linear theory only; set "
            "loads.probe = true and fidelity = ['full'], so that the scene's probe presses, or "
            "leave the law linear"
        )
    if scene.material.relaxation:
        problems.append("material.relaxation: a sweep's loads take no time; leave it out")
    if optimise and sweep.ladder == ("full",):
        problems.append(
            "fidelity = ['full']: --optimise searches by the closed form or linear information; "
            "add 'closed' or 'linear', or sample designs without --optimise"
        )
    if problems:
        raise RecipeError(problems)
    Bodies.refuse(scene)


def run_sweep(
    sweep: Sweep,
    scene: Scene,
    folder: Path,
    *,
    workers: int = 1,
    scheduler: Pool.Scheduler | None = None,
    progress: Progress | None = None,
    optimise: bool = False,
) -> Swept:
    """Run a sweep, or what is missing of it, and write its table.

    Raises
    ------
    RecipeError
        The sweep can't be run.
    InputError
        The folder can't be written, another process is writing there, or the scheduler can't be
        reached.
    """
    _check(sweep, scene, optimise)
    designs = Designs.of(sweep, scene)
    if scheduler is not None:
        scheduler.reach()
    make_folder(folder, WRITTEN)
    with only_writer(folder, folder / "writer.lock"):
        rows = Rows(sweep, scene, folder, workers=workers, scheduler=scheduler, progress=progress)
        if optimise:
            designs = _optimised(designs, rows)
        done = _sweep_designs(designs, rows)
        table: dict[str, Any] = {
            "design": np.arange(len(designs)),
            **designs.columns,
            "fidelity": list(done.fidelity),
            "status": list(done.status),
            "error": list(done.error),
            "score": done.score,
            **done.columns,
        }
        _write_table(folder, table)
    return done


def _sweep_designs(designs: Designs, rows: Rows) -> Swept:
    """Take all designs through the fidelities."""
    sweep = designs.sweep
    count = len(designs)
    columns, reason = closed(designs)
    done = Swept(
        designs=designs,
        columns={f"closed_{k}": v for k, v in columns.items()},
        status=np.where(reason == "", "ok", "dropped").astype(object),
        error=reason,
        fidelity=np.full(count, "closed", dtype=object),
    )
    if "closed" not in sweep.ladder:
        kept = ("closed_markers", "closed_cost")
        done.columns = {k: v for k, v in done.columns.items() if k in kept}
    for number, stage in enumerate(sweep.ladder):
        if stage == "closed":
            continue
        # the first stage takes all designs, a later one the best of the stage before
        rank = _scores(sweep, done.columns) if number else np.zeros(count)
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        order = np.argsort(rank, kind="stable")
        chosen = order[(done.status == "ok")[order]][: most if number else None]
        values = [designs.values(int(n)) for n in chosen]
        found = rows.of(stage, values)
        done.fidelity[chosen] = stage
        done.status[chosen] = [row["status"] for row in found]
        done.error[chosen] = [row["error"] for row in found]
        _put(done.columns, stage, chosen, found, count)
        if stage == "full":
            done.keys = {int(n): rows.key(stage, v) for n, v in zip(chosen, values, strict=True)}
    done.score = _scores(sweep, done.columns)
    depth = np.array([FIDELITIES.index(f) for f in done.fidelity])
    order = np.lexsort((done.score, -depth))
    done.order = order[(done.status == "ok")[order]]
    coarse, done.warnings, enough = _coarse(done)
    inverse = done.designs.scene.reconstruction
    if inverse is not None and inverse.method == "local" and (done.fidelity == "linear").any():
        error = "differ" if len(done.designs.scene.markers) > 1 else "are far too large"
        done.warnings.append(
            "the linear fidelity takes method smooth for local, which is not linear: its force "
            f"errors {error}; leave fidelity out, and pictures judge every design"
        )
    if (done.fidelity == "full").any():
        done.warnings += done.designs.scene.imaging[1].turns()
    done.notes = [*enough, *_notes(done, rows, coarse)]
    return done


def _put(
    columns: dict[str, Floats], stage: str, chosen: Ints, rows: Sequence[Row], count: int
) -> None:
    """Put the numbers of rows into the columns of chosen designs."""
    for number, row in zip(chosen, rows, strict=True):
        for name, value in row.items():
            if name not in ("status", "error"):
                columns.setdefault(f"{stage}_{name}", np.full(count, np.nan))[number] = value


def _coarse(done: Swept) -> tuple[Bools, list[str], list[str]]:
    """Return which widths are only the sites', a warning where that is too wide, and else a
    note."""
    none = np.full(len(done.designs), np.nan)
    found = done.columns.get("linear_two_point_mm", none)
    sites = done.columns.get("linear_sites_mm", none)
    with np.errstate(invalid="ignore"):
        coarse: Bools = np.asarray(found <= NEAR * sites)
    if not coarse.any():
        return coarse, [], []
    sweep = done.designs.sweep
    wanted = sweep.targets.get("two_point_mm", sweep.loads.pair_mm)
    least = float(sites[coarse].max())
    said = (
        f"{int(coarse.sum())} of {int((~np.isnan(found)).sum())} designs tell two points apart as "
        f"finely as their sites allow, from {least:.3g} mm on, so this distance does not rank them"
    )
    if least <= wanted:
        finer = "finer sites under [set] would rank them"
        return coarse, [], [f"{said}. All of them reach the {wanted:.3g} mm wanted; {finer}"]
    assert done.designs.scene.reconstruction is not None
    return coarse, [f"{said}; {_finer(done.designs.scene.reconstruction.sites, wanted)}"], []


def _finer(sites: Sites, wanted_mm: float) -> str:
    """Return what to set for sites as fine as wanted over the same area."""
    pitch = float(f"{FINE * wanted_mm:.2g}")
    width, length = size = 2 * np.array(sites.half_mm)
    columns, rows = 1 + np.ceil(size / pitch - 1e-9).astype(int)
    return (
        f"set reconstruction.sites.pitch_mm = {pitch:g} or less under [set], with columns = "
        f"{columns} and rows = {rows} (now {sites.columns} and {sites.rows}) to cover the same "
        f"{width:.3g} x {length:.3g} mm"
    )


def _notes(done: Swept, rows: Rows, coarse: Bools) -> list[str]:
    """Return how fidelities agree, without widths that the sites limit, and what was reused."""
    notes = []
    for one, other, name in COMPARED:
        a, b = done.columns.get(f"{one}_{name}"), done.columns.get(f"{other}_{name}")
        if a is None or b is None:
            continue
        if name in ("two_point_mm", "fwhm_mm"):
            a = np.where(coarse, np.nan, a)
        rank, ratio, count = done.agreement(a, b)
        if count:
            ranks = f"rank correlation {rank:.2f}"
            if not np.isfinite(rank):
                ranks = "too few or equal for a rank correlation"
            words = METRICS.get(name, name).split(",")[0]
            notes.append(
                f"{words}: {one} against {other} over {count} designs: {ranks}"
                + (f", median ratio {ratio:.3g}" if np.isfinite(ratio) else "")
            )
    if rows.fresh:
        notes.append(
            f"{rows.fresh} rows computed now; a body's compliance was needed {rows.asked} "
            f"times and prepared {rows.made} times"
        )
    return notes


def _metric(columns: Mapping[str, Floats], name: str, upto: str = "full") -> Floats | None:
    """See `Swept.metric`."""
    found: Floats | None = None
    for fidelity in FIDELITIES:
        column = columns.get(f"{fidelity}_{name}")
        if column is not None:
            found = column if found is None else np.where(np.isnan(column), found, column)
        if fidelity == upto:
            break
    return found


def _scores(sweep: Sweep, columns: Mapping[str, Floats]) -> Floats:
    """Return (m,) distances to the targets, a weighted sum of log(metric / target); infinite where
    unknown. What is better than its target counts a tenth, so that meeting all comes first."""
    parts = []
    for name, target in sweep.targets.items():
        values = _metric(columns, name)
        if values is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(np.maximum(values, 1e-300) / target)
        part = sweep.weights.get(name, 1.0) * np.where(off > 0, off, BEYOND * off)
        parts.append(np.where(np.isnan(part), np.inf, part))
    if not parts:
        return np.full(len(next(iter(columns.values()), ())), np.inf)
    return np.asarray(np.sum(parts, axis=0))


def _optimised(designs: Designs, rows: Rows) -> Designs:
    """Return the designs that a search within the sweep's axes evaluated, ``count`` at most."""
    from scipy.optimize import differential_evolution

    sweep, scene = designs.sweep, designs.scene
    stage = "linear" if "linear" in sweep.ladder else "closed"
    # A population that begins with Sobol' points is a power of two, SciPy rounds it up.
    size = 2 ** math.ceil(math.log2(max(5, POPULATION * len(sweep.axes))))
    evaluated: list[Floats] = []

    def judged(u: Floats) -> Floats:
        points = np.clip(np.atleast_2d(np.asarray(u).T), 0.0, 1.0).reshape(-1, len(sweep.axes))
        evaluated.append(points)
        return _scored(sweep, Designs.at(sweep, scene, points), stage, rows)

    found = differential_evolution(
        judged,
        [(0.0, 1.0)] * len(sweep.axes),
        maxiter=max(1, round((1 - SHARE) * sweep.count) // size - 1),
        popsize=POPULATION,
        init="sobol",
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=np.random.default_rng(sweep.seed),
        tol=1e-4,
    )
    _descend(judged, np.clip(found.x, 0.0, 1.0), evaluated, sweep.count)
    return Designs.at(sweep, scene, np.concatenate(evaluated))


def _descend(
    judged: Callable[[Floats], Floats], start: Floats, evaluated: list[Floats], most: int
) -> None:
    """Go down the gradient until nothing is gained or ``most`` designs have been evaluated."""
    from scipy.optimize import minimize

    width = len(start)

    def batch(u: Floats) -> tuple[float, Floats]:
        if sum(map(len, evaluated)) + width + 1 > most:
            raise StopIteration
        step = np.where(u + STEP <= 1.0, STEP, -STEP)
        score = judged(np.concatenate([u[None], u + np.diag(step)]).T)
        slope = (score[1:] - score[0]) / step
        return float(score[0]), np.where(np.abs(score[1:]) < WORST, slope, 0.0)

    with suppress(StopIteration):
        minimize(batch, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * width)


def _scored(sweep: Sweep, designs: Designs, stage: str, rows: Rows) -> Floats:
    """Return (m,) finite scores of designs, impossible ones being worst."""
    found, reason = closed(designs)
    columns = {f"closed_{k}": v for k, v in found.items()}
    ok = reason == ""
    if stage == "linear":
        numbers = np.flatnonzero(ok)
        made = rows.of("linear", [designs.values(int(n)) for n in numbers])
        ok[numbers] = [row["status"] == "ok" for row in made]
        _put(columns, "linear", numbers, made, len(designs))
    score = _scores(sweep, columns)
    return np.where(ok & np.isfinite(score), np.minimum(score, WORST / 2), WORST)


def estimate(sweep: Sweep, scene: Scene, *, workers: int = 1, optimise: bool = False) -> list[Fact]:
    """Return what a sweep, or a search, would do and, unless ``workers`` is 0, how long it takes,
    from the CPU seconds of a few designs; `RecipeError` where it can't be run, or no design is
    possible."""
    facts, good, designs = _overview(sweep, scene, optimise)
    left = len(good)
    for stage in sweep.ladder if workers else ():
        if stage == "closed" or not left:
            continue
        most = sweep.confirm.linear if stage == "linear" else sweep.confirm.full
        left = min(left, most) if most and stage != sweep.ladder[0] else left
        tried = good[:: max(1, len(good) // TRIED)][: 1 if stage == "full" else TRIED]
        each, start, rows, how = Rows.cost(
            sweep, scene, stage, [designs.values(int(n)) for n in tried]
        )
        text = (
            f"{counted(left, 'design')}, about {{seconds:.3g}} s with {counted(workers, 'worker')}"
            f", a free core each: {{design_s:.3g}} s of CPU a design ({how}), {{begin_s:.2g}} s to "
            "begin"
        )
        times = {"seconds": start + left * each / workers, "design_s": each, "begin_s": start}
        facts.append(fact(stage, text, {"designs": left, **times}))
        bad = Counter((row["status"], row["error"]) for row in rows if row["status"] != "ok")
        for (status, why), count in bad.items():
            facts.append(fact(f"{'':12s}{count} of {len(rows)} tried {status}", why, mark=": "))
        # The next stage tries what this one didn't drop: a dropped design costs nothing.
        ok = np.array([row["status"] == "ok" for row in rows])
        good = tried[ok] if ok.any() else good
    return facts


def _overview(sweep: Sweep, scene: Scene, optimise: bool) -> tuple[list[Fact], Ints, Designs]:
    """Return facts about a sweep's designs, the numbers of those that are possible, and all."""
    _check(sweep, scene, optimise)
    designs = Designs.of(sweep, scene)
    found = closed(designs)[1]
    good = np.flatnonzero(found == "")
    if not len(good):
        ((reason, _),) = Counter(map(str, found)).most_common(1)
        raise RecipeError(f"None of {len(designs)} designs is possible: {reason}")
    designs.scene_of(int(good[0]))
    over = f"{len(designs)} ({sweep.sampling}) over {', '.join(sweep.axes)}"
    dropped = len(designs) - len(good)
    facts = [
        fact("designs", over, {"designs": len(designs)}),
        fact("dropped", "{dropped} before anything is solved", {"dropped": dropped}),
    ]
    for reason in sorted({str(r) for r in found if r}):
        facts.append(fact(f"{'':12s}{int((found == reason).sum())}", reason, mark=": "))
    target = sweep.targets.get("two_point_mm")
    swept = designs.swept("reconstruction.sites.pitch_mm")
    if target is not None and scene.reconstruction and not swept and not sweep.loads.probe:
        least = resolved_by_sites(scene.reconstruction.sites, sweep.loads)
        if least > target:
            text = (
                f"targets.two_point_mm = {target:g} can't be met: the sites resolve two points "
                f"from {least:.3g} mm on; {_finer(scene.reconstruction.sites, target)}"
            )
            facts.append(fact("warning", text))
    return facts, good, designs


def _write_table(folder: Path, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> None:
    """Write ``designs.parquet`` and ``designs.csv``, a row a design."""
    import pyarrow as pa
    import pyarrow.csv as csv
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(_plain(column)) for name, column in columns.items()})
    write_whole(
        folder / "designs.parquet", lambda file: pq.write_table(table, file, compression="zstd")
    )
    write_whole(folder / "designs.csv", lambda file: csv.write_csv(table, file))


def _plain(column: Sequence[Any] | np.ndarray) -> list[Any]:
    """Return values of one type; lists and mixtures as JSON."""
    values = column.tolist() if isinstance(column, np.ndarray) else list(column)
    types = {type(v) for v in values}
    if len(types) <= 1 and not types & {list, tuple, dict}:
        return values
    if types <= {int, float}:
        return [float(v) for v in values]
    return [v if isinstance(v, str) else json.dumps(v) for v in values]
