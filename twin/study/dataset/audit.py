"""How far off the truth is: some samples computed again at the highest accuracy, and the differences.

Highest means twice as many contact patches across and, in path, twice as many parts of every step; the finest shipped
mesh of the body where there is one (a standard block's table was made on it); patches that are not gathered into
point forces; and 12 x 12 rays per pixel.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError, TwinError
from twin.places import pinned
from twin.progress import Progress
from twin.study.batch.draw import Table
from twin.study.batch.engine import Pool
from twin.study.batch.job import Job
from twin.study.dataset.plan import Plan, load_of, press_of
from twin.study.dataset.prepare import finest_mesh_file
from twin.study.dataset.sample import INTERNAL, MadeSensor, slips_of, truth_of
from twin.study.dataset.work import working

if TYPE_CHECKING:
    from twin.parts.press import Press
    from twin.world.contact.contact_state import ContactState

WORK = "twin.study.dataset.audit:audit_sample"
MOST, EVERY = 100, 100
"""One sample in a hundred is computed again, a hundred at most, one at least."""

MOST_PATCHES, MOST_INCREMENTS = 40, 64
BEST = 1e-4
"""Accuracy of displacements that takes the finest mesh."""

WHOLE = 0.98
"""Share of an outline that must be seen for its centroid to be compared."""

FINEST = 12
"""Rays per pixel and direction of the outlines that others are compared with."""

FIGURES = {
    "displacement": "marker displacement, over the largest of the sample",
    "site_force": "tractions on the sites, norm of the difference over the norm",
    "indentation": "indentation, relative",
    "outline_px": "visible outlines' centroids, px",
    "estimate": "column displacement_error: the same, for given tractions",
}


def audited(samples: int, failed: Collection[int]) -> list[int]:
    """Return which samples are computed again: spread over those that did not fail."""
    count = min(MOST, max(1, samples // EVERY), samples - len(failed))
    bad = np.array(sorted(failed), int)
    good = np.linspace(0, samples - len(bad) - 1, count).astype(int)
    for index in bad:  # the n-th good sample's number is n plus the failed ones before it
        good[good >= index] += 1
    return [int(number) for number in good]


def audit(plan: Plan, job: Job, failed: Collection[int], pool: Pool, progress: Progress | None) -> dict[str, Any]:
    """Return the differences: for every figure median and largest, and how many samples they are of."""
    numbers = audited(plan.samples, failed)
    found: dict[int, dict[str, float]] = {}
    again = replace(job, work=WORK)
    for done in pool.run(again, numbers):
        if done.result is not None:
            found[done.number] = done.result
        if progress is not None:
            progress(f"{len(found)}/{len(numbers)} samples computed again", min(0.999, len(found) / len(numbers)))
    told: dict[str, Any] = {"samples": sum(bool(f) for f in found.values())}
    for name in FIGURES:
        values = [found[n][name] for n in sorted(found) if name in found[n]]
        if values:
            told[name] = {"median": float(np.median(values)), "largest": float(np.max(values))}
    return told


def audit_sample(folder: Path, sample: int) -> dict[str, float]:
    """Return the differences of one sample; nothing if it fails."""
    with working(folder) as shop:
        plan = shop.plan
        values = plan.press_values(range(sample, sample + 1))[0]
        made = shop.sensor(plan.sensor_of(sample))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return _differences(made, values)
        except (TwinError, *INTERNAL):  # the sample is there; that it could not be made more finely ends no run
            return {}


def _differences(made: MadeSensor, values: Table) -> dict[str, float]:
    plan, finer = made.plan, _finer(made)
    for each in (made, finer):
        each.compliance.forget()
    table, out = plan.press_table(values), {}
    if plan.scene.tractions:
        load = load_of(table)
        usual, best = truth_of(made, load), truth_of(finer, load)
    else:
        press = press_of(table)
        states = _pressed(made, press), _pressed(finer, press)
        load = states[0].load
        usual, best = (
            truth_of(one, state.load, slips_of(state)) for one, state in zip((made, finer), states, strict=True)
        )
        out["indentation"] = _relative(states[0].indentation_mm, states[1].indentation_mm)
    if "site_force_n" in usual and not plan.scene.tractions:
        out["site_force"] = _relative(usual["site_force_n"], best["site_force_n"])
    if "marker_displacement_mm" in usual and np.any(usual["marker_displacement_mm"]):
        ours, true = usual["marker_displacement_mm"], best["marker_displacement_mm"]
        largest = float(np.linalg.norm(true, axis=1).max())
        out["displacement"] = float(np.linalg.norm(ours - true, axis=1).max()) / largest
        out["estimate"] = float(usual["displacement_error"])
    if "outlines" in plan.needs:
        shapes = made.sensor.ellipsoids(made.sensor.motion_of_patches(made.sensor.rectangles(load)))
        one, other = made.renderer.outlines(shapes), made.renderer.outlines(shapes, FINEST)
        seen = (one.visible > WHOLE) & (other.visible > WHOLE)
        if seen.any():
            out["outline_px"] = float(np.abs(one.centroid_px - other.centroid_px)[seen].max())
    return out


def _pressed(made: MadeSensor, press: Press) -> ContactState:
    state = made.sensor.press(press)
    if not state.complete:
        raise ContactError(f"press: {state.reason}")
    return state


def _relative(one: Floats | float, other: Floats | float) -> float:
    return float(np.linalg.norm(np.subtract(one, other)) / max(float(np.linalg.norm(other)), 1e-300))


def _finer(made: MadeSensor) -> MadeSensor:
    """Return the same sensor at the highest accuracy."""
    scene = made.plan.scene
    changes: dict[str, Any] = {
        "contact_patches": min(MOST_PATCHES, 2 * scene.contact_patches),
        "contact_increments": min(MOST_INCREMENTS, 2 * scene.accuracy.contact_increments),
        "surface_table": False,
    }
    if pinned(finest_mesh_file(scene.body)):
        changes["displacement"] = BEST
    finest = scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update=changes)})
    return MadeSensor(Plan(finest, made.plan.samples), made.number, made.values, gather=False)
