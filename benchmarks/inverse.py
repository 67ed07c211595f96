"""The inverse problem: ways of solving it on random loads, the automatic weight, wrong vectors, speed, other solvers.

The sensor is the shipped flat one, made from its tolerances, seen by its nominal calibration; shifts are projected,
with .05 px of noise in every component. Loads are discs of 3 to 10 mm with 1 to 4 N and shear up to 0.6 of it. CPU
times are of one thread, the best of several.
"""

from functools import partial
from typing import Any

import numpy as np

from benchmarks.clock import repeated
from twin.arrays import Floats
from twin.blas_threads import one_thread
from twin.judge.score import dip, full_width, into_cells, two_point_distance
from twin.parts.load import Traction
from twin.sense.calibration import Calibration
from twin.sense.inverse import Problem
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.limit import Limit

NOISE_PX, FRICTION = 0.05, 0.6
WAYS: dict[str, dict[str, Any]] = {
    "pseudo-inverse": {"method": "pinv"},
    "norm": {"method": "norm"},
    "norm, pushes": {"method": "norm", "push_only": True},
    "smooth": {},
    "smooth, pushes": {"push_only": True},
    "smooth, cone": {"friction": FRICTION},
    "smooth, cone, mu half": {"friction": FRICTION / 2},
    "smooth, cone, mu twice": {"friction": 2 * FRICTION},
    "smooth, robust, 2 % wrong vectors": {"robust": True},
    "local": {"method": "local"},
    "local, pushes": {"method": "local", "push_only": True},
    "local, cone": {"method": "local", "friction": FRICTION},
}
FITTED = ("smooth", "local")
"""The ways that are shown with the twin fitted as well."""

APART = np.arange(2.0, 6.1, 0.5)
"""Distances of two pushes, mm."""


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return rows of all parts; the quick form has few loads."""
    sensor = Sensor(load_scene("kamiyama_pillar"))
    calibration = calibration_of(sensor)
    loads = [case(sensor, calibration, seed) for seed in range(6 if quick else 200)]
    some = loads[: 3 if quick else 30]
    return [
        *(way(calibration, some, name) for name in WAYS),
        *by_fitted_twin(len(some)),
        weights(calibration, loads),
        *width(sensor, *((APART[2::4], 1) if quick else (APART, 5))),
        *speed(calibration, loads[0][0]),
    ]


def case(sensor: Sensor, calibration: Calibration, seed: int) -> tuple[Found, Floats, Floats, Floats]:
    """Return what is tracked under one load, the true field in the sites' cells, the total and the centre."""
    random = np.random.default_rng([seed, 7])
    x, y, radius = random.uniform(-9, 9), random.uniform(-6, 6), random.uniform(1.5, 5)
    push, ratio, angle = random.uniform(1, 4), random.uniform(0, FRICTION), random.uniform(0, 2 * np.pi)
    force = push * np.array([ratio * np.cos(angle), ratio * np.sin(angle), 1.0])
    load = sensor.rectangles(Traction.disk((x, y), radius, tuple(force)))
    points = sensor.actual.markers.points
    moved = sensor.compliance.displacement(points, load)
    shift = sensor.project(points + moved) - sensor.project(points) + random.normal(0, NOISE_PX, (len(points), 2))
    cells = into_cells(calibration.site_mm, *_fine_disc(x, y, radius, force))
    return as_found(calibration, shift), cells, force, np.array([x, y])


def _fine_disc(x: float, y: float, radius: float, force: Floats) -> tuple[Floats, Floats]:
    """Return points of a disc, far closer than the sites, and their forces: the solver's rectangles are too large."""
    axis = radius * ((np.arange(60) + 0.5) / 30 - 1)
    offsets = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    inside = offsets[np.hypot(*offsets.T) <= radius]
    points = np.column_stack([inside + np.array([x, y]), np.zeros(len(inside))])
    return points, np.tile(force / len(inside), (len(inside), 1))


def as_found(calibration: Calibration, shift_px: Floats) -> Found:
    """Return shifts as tracking hands them over."""
    sd = np.full(len(shift_px), NOISE_PX)
    return Found(
        rest_px=np.array(calibration.layout_px), shift_px=shift_px, sd_px=sd, layer=calibration.layer, channels={},
        method="drawn",
    )  # fmt: skip


def way(calibration: Calibration, loads: list[Any], name: str) -> dict[str, Any]:
    """Return the errors of one way of solving."""
    field, total, centre, kkt = [], [], [], 0.0
    for number, (found, cells, force, place) in enumerate(loads):
        if "wrong" in name:
            random = np.random.default_rng([number, 8])
            shift = found.shift_px.copy()
            bad = random.choice(len(shift), round(0.02 * len(shift)), replace=False)
            shift[bad] += random.choice([-10.0, 10.0], (len(bad), 2))
            found = as_found(calibration, shift)
        estimate = reconstruct(found, calibration, **WAYS[name])
        field.append(np.linalg.norm(estimate.force_n - cells) / np.linalg.norm(cells))
        total.append(np.linalg.norm(estimate.total_force_n - force) / np.linalg.norm(force))
        push = np.where(estimate.force_n[:, 2] > 0.2 * estimate.force_n[:, 2].max(), estimate.force_n[:, 2], 0.0)
        centre.append(np.linalg.norm(push @ calibration.site_mm[:, :2] / push.sum() - place))
        kkt = max(kkt, estimate.kkt)
    return {
        "what": name, "loads": len(loads), "field error": float(np.median(field)),
        "total %": 100 * float(np.median(total)), "total %, 95 of 100": 100 * float(np.quantile(total, 0.95)),
        "centre mm": float(np.median(centre)), "centre mm, 95 of 100": float(np.quantile(centre, 0.95)),
        "KKT": kkt if kkt else "",
    }  # fmt: skip


def by_fitted_twin(count: int) -> list[dict[str, Any]]:
    """Return the errors with the twin fitted to five pictured presses and the rest picture, on the same loads."""
    told = {"calibration.method": "fitted", "calibration.presses": None, "calibration.file": None}
    sensor = Sensor(load_scene("kamiyama_pillar", overrides=told))
    calibration = calibration_of(sensor)
    loads = [case(sensor, calibration, seed) for seed in range(count)]
    return [{**way(calibration, loads, name), "what": f"{name}, fitted twin"} for name in FITTED]


def weights(calibration: Calibration, loads: list[Any]) -> dict[str, Any]:
    """Return how far the automatic weight's field error is above the best possible one's."""
    ratios = []
    for found, cells, _, _ in loads:
        problem = Problem.of(found, calibration, "smooth")
        factors, data = problem.factors, problem.whiten(found.shift_px)

        def error(weight: float, factors: Any = factors, data: Floats = data, cells: Floats = cells) -> float:
            return float(np.linalg.norm(factors.forces(data, weight) - cells))

        top = float(factors.singular.max()) ** 2
        ratios.append(error(factors.weight("auto", data)) / min(error(top * 10.0**d) for d in np.arange(-12, 2, 0.1)))
    share = 100 * float(np.mean(np.array(ratios) <= 1.15))
    what = f"automatic weight: {share:.1f} % of loads within 15 % of the best, worst {max(ratios):.3f}"
    return {"what": what, "loads": len(loads)}


def width(sensor: Sensor, apart: Floats, times: int) -> list[dict[str, Any]]:
    """Return widths of the estimate of a point push of 3 N, and least distances of two, on sites of 1 mm.

    Widths are means over ``times`` noises. In the last row the design limit's.
    """
    sites = {"columns": 29, "rows": 23, "pitch_mm": 1.0}
    scene = load_scene("kamiyama_pillar", overrides={f"reconstruction.sites.{k}": v for k, v in sites.items()})
    calibration = calibration_of(Sensor(scene))
    points = sensor.actual.markers.points
    x, middle = np.arange(-14.0, 15.0), sites["rows"] // 2

    def seen(*places: float, seed: int) -> Found:
        """Return what is tracked under point pushes along x."""
        pushes = [Traction.disk((float(place), 0.0), 0.3, (0.0, 0.0, 3.0)) for place in places]
        load = sensor.rectangles(sum(pushes[1:], pushes[0]))
        shift = sensor.project(points + sensor.compliance.displacement(points, load)) - sensor.project(points)
        noise = np.random.default_rng([seed, 9]).normal(0, NOISE_PX, shift.shape)
        return as_found(calibration, shift + noise)

    rows = []
    for name in ("smooth", "smooth, cone", "local"):
        told = WAYS[name]
        one = [reconstruct(seen(0.0, seed=seed), calibration, **told).force_n[:, 2] for seed in range(times)]
        two = [reconstruct(seen(-d / 2, d / 2, seed=0), calibration, **told).force_n[:, 2] for d in apart]
        dips = [dip(x, push.reshape(calibration.grid)[:, middle], d) for push, d in zip(two, apart, strict=True)]
        wide = float(np.mean([widths(push, calibration.grid, 1.0) for push in one]))
        rows.append({
            "what": f"point push, {name}", "width mm": wide, "two points mm": two_point_distance(apart, np.array(dips)),
        })  # fmt: skip
    layers = scene.markers.values()
    limit = Limit.of(
        depth_mm=np.array([[v.depth_mm for v in layers]]), pitch_mm=np.array([[v.pitch_mm for v in layers]]),
        noise_mm=np.full((1, 2), NOISE_PX * 0.05), youngs_modulus_mpa=np.array([scene.material.youngs_modulus_mpa]),
        poisson_ratio=np.array([scene.material.poisson_ratio]), force_n=np.array([3.0]), radius_mm=np.array([2.5]),
    )  # fmt: skip
    told_limit = {"width mm": float(limit.fwhm_normal_mm[0]), "two points mm": float(limit.two_point_mm[0])}
    return [*rows, {"what": "point push, design limit", **told_limit}]


def speed(calibration: Calibration, found: Found) -> list[dict[str, Any]]:
    """Return CPU times of the first field after a picture, without a first guess."""
    return [
        {"what": f"{name}, {len(calibration.site_mm)} sites, {len(found.shift_px)} markers",
         "CPU ms": 1e3 * min(cost.cpu for cost in repeated(partial(reconstruct, found, calibration, **WAYS[name]), 5))}
        for name in ("smooth", "smooth, pushes", "smooth, cone", "local")
    ]  # fmt: skip


def widths(push_n: Floats, grid: tuple[int, int], pitch_mm: float) -> tuple[float, float]:
    """Return the full widths at half maximum of a field along s and t through its largest site, mm; inf if open.

    Parameters
    ----------
    push_n
        (k,) one component of the field, s outer and t inner.
    grid, pitch_mm
        (columns, rows) of the sites and their pitch.
    """
    picture = np.asarray(push_n, float).reshape(grid)
    column, row = np.unravel_index(int(np.argmax(picture)), grid)
    along, across = (np.asarray(pitch_mm * np.arange(count), float) for count in grid)
    found = full_width(along, picture[:, row]), full_width(across, picture[column])
    x, y = (width if np.isfinite(width) else float("inf") for width in found)
    return x, y
