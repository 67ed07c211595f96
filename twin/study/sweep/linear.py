"""The second fidelity: what a design's transfer matrix can tell, from the real lens and the finite body, no picture.

The nominal design is what the sensor's software is told; the truth is a made sensor, drawn from the tolerances and
solved on another level, its markers projected exactly and pulled by the shadows of others. Noise enters as a
covariance, so that one design's figures are not one draw of luck. The estimator is the sensor's own, with the weight
that it would choose.

Validity: constraints on the field (``push_only``, ``friction``) are left out, as the totals come from the linear solve;
method ``local``, which is not linear, is judged as ``smooth``; loads are patches of given traction; the noise is that
of `twin.study.sweep.noise`, doubted as `twin.study.sweep.shadows` has it. With the sweep's own ``noise_px`` shadows are
taken to be in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import RecipeError
from twin.judge.resolution import dip, full_width, two_point_distance
from twin.parts.load import Rectangles
from twin.parts.scene import Scene
from twin.parts.sweep import GF, Sweep
from twin.sense.problem import in_classes
from twin.study.actual import make
from twin.study.sites import on_grid
from twin.study.sweep.information import Information, information
from twin.study.sweep.loads import Bodies, Pushes
from twin.study.sweep.mirror import Quarter, Signs, blocks_of, classes, fold, mirrored
from twin.study.sweep.noise import shift_sd
from twin.study.sweep.shadows import Shadows, shadows_of
from twin.study.sweep.sites import reached, told_by_sites
from twin.study.sweep.view import View
from twin.theory.optics import project

STRAIN = 0.15
"""Mean pressure over Young's modulus at which linear theory ends (docs/validity.md)."""

REACH = 0.65
"""Motion that a tracker follows, over the distance of neighbours in the picture."""

MARKER_MS, ENTRY_MS = 1.6e-3, 6e-8
"""Time of the software per marker (tracking) and per entry of the map from shifts to forces, on one core of two."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A design's expected estimate of the push in the middle: what the report draws.

    Attributes
    ----------
    site_mm, force_n
        (k, 3), mm and N.
    """

    site_mm: Points
    force_n: Floats


def linear(scene: Scene, view: View, sweep: Sweep, bodies: Bodies, pushes: Pushes) -> tuple[dict[str, float], Shown]:
    """Return a design's metrics by name, and its expected estimate of the middle push.

    Parameters
    ----------
    scene, view
        The design, and how its camera sees it.
    sweep
        What is asked.
    bodies, pushes
        What answers, and what pushes.

    Raises
    ------
    RecipeError
        The sites don't cover the presses, or too few markers are usable.
    """
    assert scene.reconstruction is not None
    assert scene.camera is not None
    grid = scene.reconstruction.sites
    sites = on_grid(scene.body, grid, grid.pitch_mm / 2, "reconstruction.sites")
    _require_cover(scene, pushes)
    shadows = shadows_of(scene, view) if sweep.noise_px is None else None
    even = noise_of(scene, view, sweep)
    spread, told = (even, even) if shadows is None else (even * shadows.spread, even * shadows.doubt)
    used = view.usable & (told > 0) & np.isfinite(told)
    if used.sum() < 2:
        raise RecipeError(f"only {int(used.sum())} of {len(used)} markers are usable in the picture")
    noise = np.zeros(len(used))
    noise[used] = in_classes(told[used])  # as the software weighs markers
    known = _problem(scene, view, noise, used, sites, bodies)
    sensors = [_shifts(scene, shadows, number, bodies, pushes) for number in range(sweep.sensors)]
    loads = np.concatenate([shifts + pulled for shifts, pulled in sensors], axis=2)
    whitened = np.where(used[:, None, None], loads / np.where(used, noise, 1.0)[:, None, None], 0.0)
    reduced = known.info.reduced(known.folded(whitened))
    singles = 1 + pushes.presses
    single = np.arange(whitened.shape[2]) % len(pushes.loads) < singles
    energy = float((whitened[:, :, single] ** 2).sum() / single.sum())
    seen = known.info.spectrum([b[:, single] for b in reduced], energy)
    mean_noise = float(noise[used].mean())
    weight = known.info.weight(scene.reconstruction, seen, mean_noise)
    force = known.info.forces(reduced, weight).reshape(len(sites), 3, sweep.sensors, len(pushes.loads))
    figures = _figures(scene, sweep, known.info, sites, pushes, force, weight)
    singular = known.info.singular
    figures |= {
        "condition": float(singular[0] / max(singular[-1], 1e-6 * singular[0])),
        "directions": float((singular**2 > max(weight, 1e-300)).sum()),
        "weight": weight * 2.0 * mean_noise**2,
        "markers_seen": float(used.sum()),
        "sd_px": _off_px(spread[used], [pulled[used] for _, pulled in sensors], pushes.asked(sweep.loads.pair_mm)),
        "told_sd_px": float(np.sqrt(np.mean(told[used] ** 2))),
        "noise_px": float(np.median(spread[used])),
        "range_n": _range(scene, view, sweep, loads[:, :, 0]),
        "frame_ms": MARKER_MS * len(used) + ENTRY_MS * 6 * len(used) * len(sites),
    }
    return figures, Shown(site_mm=sites.centre_mm, force_n=np.asarray(force[:, :, 0, 0]))


def noise_of(scene: Scene, view: View, sweep: Sweep) -> Floats:
    """Return (n,) standard deviations of the markers' shifts, per axis, px."""
    if sweep.noise_px is not None:
        return np.full(len(view.markers), sweep.noise_px)
    out = np.zeros(len(view.markers))
    for name in scene.markers:
        part = view.markers.of(name)
        out[part] = shift_sd(scene, name, np.nan_to_num(view.diameter_px[part]))
    return out


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """A factorised design, and how its data are brought into the classes."""

    info: Information
    signs: list[Signs]
    layers: list[tuple[slice, Quarter]]

    def folded(self, data: Floats) -> list[Floats]:
        """Return by class the (m, loads) parts of (n, 2, loads) data."""
        return [
            np.concatenate(
                [fold(data[part].reshape(q.columns, q.rows, *data.shape[1:]), each) for part, q in self.layers]
            )
            for each in self.signs
        ]


def _problem(scene: Scene, view: View, noise: Floats, used: Bools, sites: Rectangles, bodies: Bodies) -> _Problem:
    assert scene.reconstruction is not None
    mirrors = mirrored(scene)
    grid = scene.reconstruction.sites
    quarters = [
        (view.markers.of(name), Quarter(layer.columns, layer.rows, mirrors)) for name, layer in scene.markers.items()
    ]
    taken = np.concatenate([quarter.taken().ravel() for _, quarter in quarters])
    points = view.markers.points[taken]
    if scene.calibration.method == "halfspace":
        from twin.study.calibrate import half_space_compliance

        compliance = half_space_compliance(scene, points, sites)
    else:
        compliance = bodies.moved(scene, "nominal", points, sites)
    scaled = np.where(used[taken][:, None, None], view.jacobian[taken], 0.0)
    scaled /= np.where(used[taken], noise[taken], 1.0)[:, None, None]
    signs, size = classes(mirrors), (grid.columns, grid.rows)
    by_class = blocks_of(compliance, scaled, [quarter for _, quarter in quarters], size, signs)
    info = information(by_class, signs, size, scene.reconstruction.method, 2 * int(used.sum()))
    return _Problem(info=info, signs=signs, layers=quarters)


def _off_px(spread: Floats, pulled: list[Floats], asked: list[int]) -> float:
    """Return by how much shifts are off, per axis: by noise of (n,) standard deviations, and by the pull of shadows."""
    pull = [np.mean(each[:, :, asked] ** 2) for each in pulled]
    return float(np.sqrt(np.mean(spread**2) + np.mean(pull)))


def _shifts(
    scene: Scene, shadows: Shadows | None, number: int, bodies: Bodies, pushes: Pushes
) -> tuple[Floats, Floats]:
    """Return (n, 2, loads) noise-free shifts of a made sensor's markers, and how far shadows pull them besides, px."""
    actual = make(seeded(scene, number))
    points, camera = actual.markers.points, actual.scene.camera
    assert camera is not None
    moved = bodies.moved(actual.scene, "truth", points, pushes.patches) @ pushes.loads.reshape(len(pushes.loads), -1).T
    optics = (camera, actual.scene.material.refractive_index, actual.scene.body.base_z_mm)
    everywhere = points[:, :, None] + moved.reshape(len(points), 3, -1)
    seen = project(everywhere.transpose(0, 2, 1).reshape(-1, 3), *optics).reshape(len(points), -1, 2)
    shifts = np.nan_to_num(seen - project(points, *optics)[:, None]).transpose(0, 2, 1)
    return shifts, np.zeros_like(shifts) if shadows is None else shadows.pulled(moved.reshape(len(points), 3, -1))


def seeded(scene: Scene, number: int) -> Scene:
    """Return a design with the seed of its made sensor ``number``; number 0 is that of ``twin run``."""
    return scene if number == 0 else scene.model_copy(update={"seed": scene.seed + number})


def _figures(
    scene: Scene, sweep: Sweep, info: Information, sites: Rectangles, pushes: Pushes, force: Floats, weight: float
) -> dict[str, float]:
    """Return errors and widths of expected forces (k, 3, sensors, loads)."""
    assert scene.reconstruction is not None
    totals = np.zeros((3, len(sites), 3))
    totals[np.arange(3), :, np.arange(3)] = 1.0
    noise = info.noise(totals.reshape(3, -1), weight)
    truth = pushes.loads.sum(axis=1)
    press = slice(1, 1 + pushes.presses)
    size = np.linalg.norm(truth[press], axis=1)
    bias = np.linalg.norm(force[:, :, :, press].sum(axis=0) - truth[press].T[:, None], axis=0) / size
    variance = np.trace(noise) / size**2
    each = bias**2 + variance
    normal = pushes.patches.frames[0, 2]
    figures = {
        "total_force_error": float(np.sqrt(each.mean())),
        "total_force_error_se": standard_error(np.sqrt(each).ravel()),
        "total_force_bias": float(np.sqrt((bias**2).mean())),
        "resolution_gf": float(np.sqrt(max(normal @ noise @ normal, 0.0)) / GF),
    }
    profiles = [Profiles(scene, sites, force[:, :, sensor]) for sensor in range(force.shape[2])]
    widths = [p.width(0) for p in profiles]
    dips = np.mean([p.dips(pushes) for p in profiles], axis=0)
    figures["fwhm_mm"] = float(np.mean(widths))
    figures["sites_mm"] = told_by_sites(scene.reconstruction.sites, sweep.loads)
    over = reached(scene.reconstruction.sites, pushes.pair_mm)
    figures["two_point_mm"] = two_point_distance(pushes.pair_mm[over], dips[over]) if over.any() else float("nan")
    figures["dip"] = float(np.interp(sweep.loads.pair_mm, pushes.pair_mm, dips)) if len(dips) else float("nan")
    return figures


class Profiles:
    """Profiles of the push along s and t through the middle, read off the sites' forces.

    Parameters
    ----------
    scene
        With the sites' grid.
    sites
        The sites.
    force
        (k, 3, loads) forces, N.
    """

    def __init__(self, scene: Scene, sites: Rectangles, force: Floats) -> None:
        assert scene.reconstruction is not None
        grid = scene.reconstruction.sites
        self._axes = grid.axes()
        push = np.einsum("kcl,kc->kl", force, sites.frames[:, 2])
        self._push = push.reshape(grid.columns, grid.rows, -1)

    def along(self, load: int, axis: int) -> tuple[Floats, Floats]:
        """Return places, mm, and the push there, N, along s (0) or t (1) through the middle."""
        other = self._axes[1 - axis]
        field = np.moveaxis(self._push[:, :, load], axis, 0)
        place = np.interp(0.0, other, np.arange(len(other)))
        low = min(int(place), len(other) - 1)
        share = place - low
        high = min(low + 1, len(other) - 1)
        return self._axes[axis], np.asarray((1 - share) * field[:, low] + share * field[:, high])

    def width(self, load: int) -> float:
        """Return the full width at half maximum, mm: the mean of both directions that have one."""
        widths = [full_width(*self.along(load, axis)) for axis in (0, 1)]
        known = [w for w in widths if np.isfinite(w)]
        return float(np.mean(known)) if known else float("nan")

    def dips(self, pushes: Pushes) -> Floats:
        """Return (pairs,) dips between the pairs of pushes."""
        first = 1 + pushes.presses
        return np.array([dip(*self.along(first + k, 0), float(apart)) for k, apart in enumerate(pushes.pair_mm)])


def _range(scene: Scene, view: View, sweep: Sweep, shift: Floats) -> float:
    """Return the largest force, N, that the sensor takes: linear theory and the tracker's reach."""
    area = sweep.loads.size_mm**2
    soft = STRAIN * scene.material.youngs_modulus_mpa * area
    across = np.sqrt(np.abs(np.linalg.det(view.jacobian[:, :, :2])))
    pitch = np.array([scene.markers[str(name)].pitch_mm for name in view.markers.layer]) * across
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = REACH * pitch / np.linalg.norm(shift, axis=1) * sweep.loads.force_n
    return float(min(soft, np.nanmin(reach[view.usable])))


def _require_cover(scene: Scene, pushes: Pushes) -> None:
    assert scene.reconstruction is not None
    grid = scene.reconstruction.sites
    chart = scene.body.chart_of(pushes.patches.centre_mm[: 1 + pushes.presses])
    if (np.abs(chart) > np.array(grid.half_mm) + grid.pitch_mm / 2 + 1e-9).any():
        raise RecipeError("reconstruction.sites: they don't cover the sweep's presses; use more sites or a wider pitch")


def standard_error(values: Floats) -> float:
    """Return the standard error of the mean of (m,) values; NaN of one."""
    return float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
