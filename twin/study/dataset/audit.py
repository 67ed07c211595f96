"""Checks of a dataset: samples computed again at the highest accuracy, and checks of its files."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Progress
from twin.errors import InputError, RecipeError
from twin.files import Fact, fact
from twin.study.batch.pool import Job, Pool
from twin.study.dataset.plan import Places, Plan
from twin.study.dataset.reader import DatasetReader

WORK = "twin.study.dataset.sample:audit_sample"
FIGURES = {
    "displacement": "marker displacement, over the largest of the sample",
    "site_force": "tractions on the sites, norm of the difference over the norm",
    "indentation": "indentation, relative",
    "outline_px": "visible outlines' centroids, px",
    "estimate": "column displacement_error, of the same",
}


def audit(
    plan: Plan, job: Job, failed: Collection[int], pool: Pool, progress: Progress | None
) -> dict[str, Any]:
    """Return the differences: for every figure median and largest, and how many samples they are
    of."""
    numbers = plan.audited(failed)
    found: dict[int, dict[str, float]] = {}
    again = replace(job, work=WORK)
    for done in pool.run(again, numbers):
        if done.result is not None:
            found[done.number] = done.result
        if progress is not None:
            progress(
                f"{len(found)}/{len(numbers)} samples computed again",
                min(0.999, len(found) / len(numbers)),
            )
    figures: dict[str, Any] = {"samples": sum(bool(f) for f in found.values())}
    for name in FIGURES:
        values = [found[n][name] for n in sorted(found) if name in found[n]]
        if values:
            figures[name] = {"median": float(np.median(values)), "largest": float(np.max(values))}
    return figures


ROWS, LISTED = 50, 3
"""Rows that are read, evenly over the dataset, and files or rows that are named of each problem."""

BALANCE_N = 1e-6
PROJECTION_PX = 1e-6


def check_dataset(folder: Path) -> list[Fact]:
    """Check a finished dataset and return what was checked; `RecipeError` with everything that is
    wrong, `InputError` where it is no dataset, or was never finished."""
    places = Places(folder)
    info = places.read_info()
    if not places.sums.is_file():
        raise InputError(
            f"{folder}: has no meta/SHA256SUMS, so it was not finished; give the same command again"
        )
    # Files first: a wrong checksum explains everything after it.
    problems = _checksums(places)
    if problems:
        raise RecipeError(problems, str(folder))
    reader = DatasetReader(folder)
    problems = _schema(reader, info)
    if problems:
        raise RecipeError(problems, str(folder))
    # Some rows, evenly over the dataset: finite numbers, balance of forces, projection.
    rows = np.unique(np.linspace(0, len(reader) - 1, min(ROWS, len(reader))).astype(int))
    failed = 0
    infinite: dict[str, list[str]] = {}
    balances: list[float] = []
    misses: list[float] = []
    for row in rows:
        sample = reader[int(row)]
        if sample["status"] != "ok":
            failed += 1
            continue
        for name in _not_finite(sample):
            infinite.setdefault(f"{name} is not finite", []).append(f"row {row}")
        balances += _imbalances(sample)
        misses += _misprojections(sample, reader)
    problems = _listed(infinite)
    if (balance := max(balances, default=0.0)) > BALANCE_N:
        problems.append(
            f"forces: patches or sites sum to {balance:.2g} N away from force_n (allowed "
            f"{BALANCE_N:g} N)"
        )
    if (miss := max(misses, default=0.0)) > PROJECTION_PX:
        problems.append(
            f"pixels: {miss:.2g} px away from the projected places (allowed {PROJECTION_PX:g} px)"
        )
    if problems:
        raise RecipeError(problems, str(folder))
    forces = (
        "forces balance to {balance_n:.1e} N"
        if balances
        else "no columns whose forces should balance"
    )
    pixels = "projection to {projection_px:.1e} px" if misses else "no columns to project"
    values = {"balance_n": balance, "projection_px": miss, "failed": failed}
    return [
        fact(str(folder), "{rows} rows, checksums and schema ok", {"rows": len(reader)}, ": "),
        fact(f"{len(rows)} rows read", f"{forces}, {pixels}, {{failed}} failed", values, ": "),
    ]


def _checksums(places: Places) -> list[str]:
    wanted, found = places.listed(places.sums), places.sums_of_files()
    changed = [name for name in sorted(set(found) & set(wanted)) if found[name] != wanted[name]]
    return _listed(
        {
            "missing": sorted(set(wanted) - set(found)),
            "not in SHA256SUMS": sorted(set(found) - set(wanted)),
            "changed since it was written (its checksum differs)": changed,
        }
    )


def _listed(places: Mapping[str, Sequence[str]]) -> list[str]:
    """Return a line on each of the first places of every problem, and on how many more there
    are."""
    lines = []
    for problem, where in places.items():
        lines += [f"{place}: {problem}" for place in where[:LISTED]]
        if (more := len(where) - LISTED) > 0:
            lines.append(f"{more} more: {problem}")
    return lines


def _schema(reader: DatasetReader, info: dict[str, object]) -> list[str]:
    import pyarrow.parquet as pq

    from twin.study.dataset.columns import Column

    problems: dict[str, list[str]] = {}
    columns = info["columns"]
    wanted = {
        each["name"]: Column.arrow_type(each["kind"])
        for each in columns  # type: ignore[attr-defined]
    }
    for file in sorted(reader.places.data.glob("part-*.parquet")):
        with DatasetReader.readable(file):
            found = pq.read_schema(file)
        wrong = [
            f"{field.name} is {field.type}, not {wanted[field.name]}"
            for field in found
            if field.name in wanted and field.type != wanted[field.name]
        ]
        if found.names != list(wanted):
            wrong.append("has other columns than in info.json")
        for problem in wrong:
            problems.setdefault(problem, []).append(file.name)
    if problems:
        return _listed(problems)
    index = set(reader.table(["index"])["index"].to_pylist())
    samples = int(info["samples"])  # type: ignore[call-overload]
    if len(index) != samples or (index and not (min(index) == 0 and max(index) == samples - 1)):
        return [f"index: does not run from 0 to {info['samples']}"]
    return []


def _not_finite(sample: dict[str, object]) -> list[str]:
    may_be_nan = ("marker_outline_pressed_px",)
    return [
        name
        for name, value in sample.items()
        if isinstance(value, np.ndarray | float)
        and name not in may_be_nan
        and not np.all(np.isfinite(value))
    ]


def _imbalances(sample: dict[str, np.ndarray]) -> list[float]:
    """Return how far patches and sites, where they are kept, are from summing to the total
    force."""
    if sample.get("force_n") is None:
        return []
    names = [name for name in ("surface_force_n", "site_force_n") if sample.get(name) is not None]
    return [float(np.abs(sample[name].sum(axis=0) - sample["force_n"]).max()) for name in names]


def _misprojections(sample: dict[str, np.ndarray], reader: DatasetReader) -> list[float]:
    """Project the displaced markers, where they are kept, through the sensor's own camera."""
    if not {"marker_pressed_px", "marker_displacement_mm"} <= sample.keys():
        return []
    sensor = int(sample["sensor"])
    points = reader.sensor(sensor)["marker_rest_mm"] + sample["marker_displacement_mm"]
    if not len(points):
        return []
    return [float(np.abs(reader.project(points, sensor) - sample["marker_pressed_px"]).max())]
