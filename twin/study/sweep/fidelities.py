"""The three fidelities at which a design is judged: closed form, linear information, pictures.

docs/sweeps.md has what each models and leaves out, and how well they agree.

Linear information. With the whitened transfer matrix H and the penalty Q = L L^T, the
eigendecomposition L^-1 H^T H L^-T = V S^2 V^T gives the estimate for every weight. The smaller
matrix H^T H costs digits only where S is below 1e-6 of the largest, far below any noise. Noise
enters as a covariance, so a design's figures don't depend on one draw.

Mirror symmetry: a block, centred grids of markers and sites and a camera on the axis don't change
when x or y is mirrored, so fields that are even or odd under each mirror don't mix. In orthonormal
even and odd parts the problem falls into four of a quarter of the size, and only a quarter of the
markers is needed to make them: a third of the time for a design of 636 markers.

Validity: constraints on the field (``push_only``, ``friction``) are left out of the linear
information, because totals come from the linear solve. Method ``local``, which isn't linear, is
rated as ``smooth``.

Forces are estimated at sites, so two pushes are resolved only where a site between them carries
less force (`resolved_by_sites`). A coarse grid gives all designs the same two-point distance.
"""

from __future__ import annotations

import io
import json
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from twin.arrays import Bools, Floats, Picture, Points
from twin.errors import ContactError, InputError, RecipeError, TwinError
from twin.judge.score import GROSS_PX, dip, full_width, two_point_distance
from twin.parts.body import Block
from twin.parts.load import Rectangles
from twin.parts.methods import Method
from twin.parts.scene import Scene, Sites
from twin.parts.sweep import GF, Sweep
from twin.sense.inverse import METHODS, RULES, Factors, Problem
from twin.study.batch.draw import SceneTable
from twin.study.calibrate import half_space_compliance, nominal_calibration
from twin.study.doubts import View, shift_sd
from twin.study.recipe import load_scene
from twin.study.sensor import Motion, Sensor
from twin.study.sweep.design_rows import Row, Shown
from twin.study.sweep.designs import Designs
from twin.study.sweep.loads import PAIRS, Bodies, Pushes
from twin.theory.limit import Limit
from twin.theory.optics import project

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration

LEAST = 1e-12
"""Squared singular values below this share of the largest are round-off."""

STRAIN = 0.15
"""Mean pressure over Young's modulus at which linear theory ends (docs/validity.md)."""

REACH = 0.65
"""Motion that a tracker follows, over the distance of neighbours in the picture."""

MARKER_MS, ENTRY_MS = 1.6e-3, 6e-8
"""Time of the software per marker (tracking) and per entry of the map from shifts to forces, on one
core of two."""

_Signs = tuple[int, int]
"""Even (1) or odd (-1) under the mirrors of x and y; 0 where there is no mirror."""


def closed(designs: Designs) -> tuple[dict[str, Floats], np.ndarray]:
    """Return the closed form's (m,) figures of designs by metric, NaN for dropped ones, and (m,)
    why each is dropped, empty otherwise; `RecipeError` where the camera's noise has no closed
    form."""
    scene = designs.scene
    sweep = designs.sweep
    count = len(designs)
    reason = np.full(count, "", dtype=object)
    depths = []
    pitches = []
    noises = []
    markers = np.zeros(count)
    base_z = designs.numbers("body.thickness_mm", scene.body.base_z_mm)
    # Each layer: the numbers of all designs, and the designs that can't be built.
    for name, layer in scene.markers.items():
        depth = designs.numbers(f"markers.{name}.depth_mm", layer.depth_mm)
        pitch = designs.numbers(f"markers.{name}.pitch_mm", layer.pitch_mm)
        diameter = designs.numbers(f"markers.{name}.diameter_mm", layer.diameter_mm)
        columns, rows = designs.marker_counts(name)
        markers += columns * rows
        radius = diameter / 2 if layer.kind == "bead" else np.zeros(count)
        for bad, why in (
            (radius > depth, "larger than its depth, it sticks out of the surface"),
            (depth + radius > base_z, "deeper than the body is thick"),
            (diameter >= pitch, "diameter of its pitch or more, neighbours touch"),
        ):
            reason[bad & (reason == "")] = f"markers.{name}: {why}"
        # The noise of a shift, from the picture to the depth of the layer.
        scale = _axis_scale(designs, depth)
        if sweep.noise_px:
            noise = np.full(count, sweep.noise_px)
        else:
            noise = shift_sd(scene, name, diameter * scale)
        depths.append(depth)
        pitches.append(pitch)
        noises.append(noise / scale)
    # The closed form of the design limit, for all designs that can be built at once.
    good = np.flatnonzero(reason == "")
    material = scene.material
    found = {name: np.full(count, np.nan) for name in ("fwhm_mm", "two_point_mm", "resolution_gf")}
    if len(good):
        modulus = designs.numbers("material.youngs_modulus_mpa", material.youngs_modulus_mpa)
        ratio = designs.numbers("material.poisson_ratio", material.poisson_ratio)
        limit = Limit.of(
            depth_mm=np.column_stack(depths)[good],
            pitch_mm=np.column_stack(pitches)[good],
            noise_mm=np.column_stack(noises)[good],
            youngs_modulus_mpa=modulus[good],
            poisson_ratio=ratio[good],
            force_n=np.array(sweep.loads.force_n),
            radius_mm=np.array(sweep.loads.size_mm / np.sqrt(np.pi)),
            sampling="squares",
        )
        found["fwhm_mm"][good] = limit.fwhm_normal_mm
        found["two_point_mm"][good] = limit.two_point_mm
        found["resolution_gf"][good] = limit.force_sd_n / GF
    found["total_force_error"] = found["resolution_gf"] * GF / sweep.loads.force_n
    # What a design costs.
    camera, _ = scene.imaging
    pixels = designs.numbers("camera.width_px", camera.width_px)
    pixels = pixels * designs.numbers("camera.height_px", camera.height_px)
    cost = sweep.cost
    found["markers"] = markers
    found["cost"] = cost.base + cost.marker * markers + cost.megapixel * pixels / 1e6
    return found, reason


def _axis_scale(designs: Designs, depth_mm: Floats) -> Floats:
    """Return (m,) px/mm on the axis at depths: focal length over apparent distance (Snell,
    paraxial)."""
    scene = designs.scene
    camera, _ = scene.imaging
    base_z = designs.numbers("body.thickness_mm", scene.body.base_z_mm)
    index = designs.numbers("material.refractive_index", scene.material.refractive_index)
    pupils = designs.columns.get("camera.pupil_mm", [camera.pupil_mm])
    apparent = (
        np.array([place[2] for place in pupils], float)
        - base_z
        - camera.window_mm
        + sum(layer.thickness_mm / layer.index for layer in camera.layers)
        + (base_z - depth_mm) / index
    )
    return np.asarray(
        designs.numbers("camera.focal_px", camera.focal_px) / np.maximum(apparent, 1e-6)
    )


def linear(
    scene: Scene, view: View, sweep: Sweep, bodies: Bodies, pushes: Pushes
) -> tuple[dict[str, float], Shown]:
    """Return a design's metrics by name, and its expected estimate of the push in the middle;
    `RecipeError` where the sites don't cover the presses or too few markers are usable."""
    # The markers that the software can use, and their noise.
    grid = scene.inverse.sites
    sites = Rectangles.on_surface(
        scene.body, grid.chart(), grid.pitch_mm / 2, "reconstruction.sites"
    )
    _require_cover(scene, pushes)
    expected = _noise_of(scene, view, sweep)
    used = view.usable & (expected > 0) & np.isfinite(expected)
    if used.sum() < 2:
        raise RecipeError(
            f"only {int(used.sum())} of {len(used)} markers are usable in the picture"
        )
    noise = np.zeros(len(used))
    noise[used] = Problem.in_classes(expected[used])  # as the software weighs markers
    # The loads as whitened shifts: divided by the noise, so that every shift counts alike.
    known = _information(scene, view, noise, used, sites, bodies)
    loads = np.concatenate(
        [_shifts(scene, number, bodies, pushes) for number in range(sweep.sensors)], axis=2
    )
    whitened = np.where(used[:, None, None], loads / np.where(used, noise, 1.0)[:, None, None], 0.0)
    reduced = known.reduced(whitened)
    # The weight of the regularisation, from the singular values and from the energy of single
    # loads.
    single = np.arange(whitened.shape[2]) % len(pushes.loads) <= pushes.presses
    energy = float((whitened[:, :, single] ** 2).sum() / single.sum())
    spectrum = known.spectrum([b[:, single] for b in reduced], energy)
    mean_noise = float(noise[used].mean())
    weight = _weight(scene.inverse, spectrum, mean_noise)
    # The forces of all loads, and what is read from them.
    force = known.forces(reduced, weight).reshape(len(sites), 3, sweep.sensors, len(pushes.loads))
    singular = known.singular
    figures = _errors(known, pushes, force, weight) | _widths(scene, sweep, sites, pushes, force)
    figures |= {
        "condition": float(singular[0] / max(singular[-1], 1e-6 * singular[0])),
        "directions": float((singular**2 > max(weight, 1e-300)).sum()),
        "weight": weight * 2.0 * mean_noise**2,
        "markers_seen": float(used.sum()),
        "noise_px": float(np.median(expected[used])),
        "range_n": _range(scene, view, sweep, loads[:, :, 0]),
        "frame_ms": MARKER_MS * len(used) + ENTRY_MS * 6 * len(used) * len(sites),
    }
    return figures, {"site_mm": sites.centre_mm, "middle_n": np.asarray(force[:, :, 0, 0])}


def _noise_of(scene: Scene, view: View, sweep: Sweep) -> Floats:
    """Return (n,) standard deviations of the markers' shifts, per axis, px."""
    if sweep.noise_px is not None:
        return np.full(len(view.markers), sweep.noise_px)
    out = np.zeros(len(view.markers))
    for name in scene.markers:
        part = view.markers.of(name)
        out[part] = shift_sd(scene, name, np.nan_to_num(view.diameter_px[part]))
    return out


def _seeded(scene: Scene, number: int) -> Scene:
    """Return a design with the seed of its made sensor ``number``; 0 is that of ``twin run``."""
    return scene if number == 0 else scene.model_copy(update={"seed": scene.seed + number})


def _standard_error(values: Floats) -> float:
    """Return the standard error of the mean of (m,) values; NaN of one."""
    return float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")


class _Profiles:
    """Profiles of the push along s and t through the middle, from (k, 3, loads) forces at sites."""

    def __init__(self, scene: Scene, sites: Rectangles, force: Floats) -> None:
        grid = scene.inverse.sites
        self._axes = grid.axes()
        push = np.einsum("kcl,kc->kl", force, sites.frames[:, 2])
        self._push = push.reshape(grid.columns, grid.rows, -1)

    def along(self, load: int, axis: int) -> tuple[Floats, Floats]:
        """Return places, mm, and the push there, N, along s (0) or t (1) through the middle."""
        rows = np.moveaxis(self._push[:, :, load], axis, 0)
        middle = [np.interp(0.0, self._axes[1 - axis], row) for row in rows]
        return self._axes[axis], np.array(middle)

    def width(self, load: int) -> float:
        """Return the full width at half maximum, mm: the mean of both directions that have one."""
        widths = [full_width(*self.along(load, axis)) for axis in (0, 1)]
        known = [w for w in widths if np.isfinite(w)]
        return float(np.mean(known)) if known else float("nan")

    def dips(self, pushes: Pushes) -> Floats:
        """Return (pairs,) dips between the pairs of pushes."""
        first = 1 + pushes.presses
        return np.array(
            [dip(*self.along(first + k, 0), float(apart)) for k, apart in enumerate(pushes.pair_mm)]
        )


@dataclass(frozen=True, kw_only=True)
class _Class:
    """Factors of the fields of one symmetry: (r,) S^2; (3k, r) forces of unit reduced unknowns L^-T
    V; (m, r) data H L^-T V; (2n, m) sparse orthonormal basis of the data."""

    squared: Floats
    forces: Floats
    data: Floats
    fold: Any


@dataclass(frozen=True, kw_only=True)
class _Information:
    """A design's linear problem by class, and its number of data (2 for every marker used)."""

    classes: tuple[_Class, ...]
    count: int

    @property
    def singular(self) -> Floats:
        """(r,) singular values in the penalty's metric, the largest first."""
        return np.asarray(np.sqrt(np.sort(np.concatenate([c.squared for c in self.classes]))[::-1]))

    def reduced(self, whitened: Floats) -> list[Floats]:
        """Return by class the (r, loads) products V^T L^-1 H^T d of (n, 2, loads) data."""
        data = whitened.reshape(-1, whitened.shape[2])
        return [c.data.T @ (c.fold.T @ data) for c in self.classes]

    def spectrum(self, reduced: Sequence[Floats], energy: float) -> Factors.Spectrum:
        """Return the spectrum to expect; ``energy`` is the mean of |d|^2 over noise-free data,
        ``reduced`` theirs."""
        squared = np.concatenate([c.squared for c in self.classes])
        measured = np.concatenate([np.mean(b**2, axis=1) for b in reduced])
        seen = squared > LEAST * squared.max(initial=0.0)
        parts = np.where(seen, measured / np.where(seen, squared, 1.0), 0.0)
        noise = max(self.count - len(squared), 0)
        rest = max(energy - float(parts.sum()), 0.0) + noise
        return Factors.Spectrum(squared=squared, energy=parts + 1.0, rest=rest, count=self.count)

    def forces(self, reduced: Sequence[Floats], weight: float) -> Floats:
        """Return (3k, loads) expected forces, N."""
        parts = zip(self.classes, self._inverse(weight), reduced, strict=True)
        return np.asarray(sum(c.forces @ (inverse[:, None] * b) for c, inverse, b in parts))

    def covariance(self, rows: Floats, weight: float) -> Floats:
        """Return (q, q) covariance of ``rows`` (q, 3k) times the estimate, by the noise alone."""
        total = np.zeros((len(rows), len(rows)))
        for each, inverse in zip(self.classes, self._inverse(weight), strict=True):
            parts = rows @ each.forces
            total += (parts * (each.squared * inverse**2)) @ parts.T
        return total

    def _inverse(self, weight: float) -> list[Floats]:
        """Return by class 1 / (S^2 + weight), without what is round-off."""
        if weight > 0:
            return [1.0 / (c.squared + weight) for c in self.classes]
        cut = LEAST * max(c.squared.max(initial=0.0) for c in self.classes)
        return [
            np.where(c.squared > cut, 1.0 / np.maximum(c.squared, cut), 0.0) for c in self.classes
        ]


def _information(
    scene: Scene, view: View, noise: Floats, used: Bools, sites: Rectangles, bodies: Bodies
) -> _Information:
    """Factorise a design's whitened transfer matrix, class by class: a column of the data's basis
    holds a marker and its mirror images, and its row is the first's times the root of their
    number."""
    method, grid = scene.inverse.method, scene.inverse.sites
    layers = tuple((layer.columns, layer.rows) for layer in scene.markers.values())
    signs = list(product(*((1, -1) if mirror else (0,) for mirror in _mirrors(scene))))
    folds = [_data_basis(layers, each) for each in signs]
    firsts = [fold.indices[fold.indptr[:-1]] for fold in folds]
    markers = np.unique(np.concatenate(firsts) // 2)
    points = view.markers.points[markers]
    compliance = _nominal_compliance(scene, points, sites, bodies)
    jacobian = np.where(used[markers][:, None, None], view.jacobian[markers], 0.0)
    jacobian /= np.where(used[markers], noise[markers], 1.0)[:, None, None]
    transfer = (jacobian @ compliance.reshape(len(points), 3, -1)).reshape(2 * len(points), -1)
    classes = []
    for each, fold, first in zip(signs, folds, firsts, strict=True):
        basis, root = _force_basis((grid.columns, grid.rows), method, each)
        rows = 2 * np.searchsorted(markers, first // 2) + first % 2
        block = (basis.T @ transfer[rows].T).T / fold.data[fold.indptr[:-1], None]
        block = block @ root.T
        squared, vectors = np.linalg.eigh(block.T @ block)
        found = _Class(
            squared=np.maximum(squared, 0.0),
            forces=basis @ (root.T @ vectors),
            data=block @ vectors,
            fold=fold,
        )
        classes.append(found)
    return _Information(classes=tuple(classes), count=2 * int(used.sum()))


def _mirrors(scene: Scene) -> tuple[bool, bool]:
    """Return whether a scene's nominal design is symmetric under the mirrors of x and of y."""
    camera = scene.camera
    if not isinstance(scene.body, Block) or camera is None:
        return (False, False)
    decentred = camera.lens == "pinhole" and any(camera.distortion[2:4])
    if any(camera.tilt_deg) or camera.principal_px is not None or decentred:
        return (False, False)
    x, y = (
        camera.pupil_mm[axis] == 0
        and all(layer.offset_mm[axis] == 0 for layer in scene.markers.values())
        for axis in (0, 1)
    )
    return (x, y)


@lru_cache(maxsize=256)
def _even_or_odd(count: int, sign: int) -> Any:
    """Return the (count, r) orthonormal even or odd functions on a line of points; all if 0."""
    unit = np.eye(count)
    if sign == 0:
        return sp.csc_matrix(unit)
    half = count // 2
    basis = np.sqrt(0.5) * (unit + sign * unit[::-1])[:, :half]
    if sign > 0 and count % 2:
        basis = np.column_stack([basis, unit[half]])
    return sp.csc_matrix(basis)


@lru_cache(maxsize=256)
def _basis(grid: tuple[int, int], components: int, signs: _Signs) -> Any:
    """Return the (points x components, r) basis of vector fields of a class on a (columns, rows)
    grid."""
    flips = ((-1, 1), (1, -1), (1, 1))[:components]
    parts = []
    for component, flip in enumerate(flips):
        along, across = (_even_or_odd(grid[k], signs[k] * flip[k]) for k in (0, 1))
        unit = np.eye(components)[:, component : component + 1]
        parts.append(sp.kron(sp.kron(along, across), unit))
    basis = sp.hstack(parts, format="csc")
    basis.eliminate_zeros()
    basis.sort_indices()
    return basis


@lru_cache(maxsize=256)
def _data_basis(layers: tuple[tuple[int, int], ...], signs: _Signs) -> Any:
    """Return the basis of the shifts of the markers of all layers, (columns, rows) each."""
    return sp.block_diag([_basis(layer, 2, signs) for layer in layers], format="csc")


@lru_cache(maxsize=64)
def _force_basis(grid: tuple[int, int], method: Method, signs: _Signs) -> tuple[Any, Floats]:
    """Return the basis of the sites' forces, and L^-1 of the penalty in it."""
    basis = _basis(grid, 3, signs)
    folded = basis.T @ (basis.T @ METHODS[method].matrix(grid)).T
    lower = np.linalg.cholesky((folded + folded.T) / 2)
    return basis.tocsr(), np.asarray(
        scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True), np.float64
    )


def _weight(wanted: Scene.Reconstruction, spectrum: Factors.Spectrum, mean_noise: float) -> float:
    """Return the software's whitened weight; ``mean_noise``, px, is for one given in px^2/N^2."""
    if not METHODS[wanted.method].weighted:
        return 0.0
    if isinstance(wanted.weight, str):
        return float(RULES[wanted.weight](spectrum))
    return float(wanted.weight) / (2.0 * mean_noise**2)


def _shifts(scene: Scene, number: int, bodies: Bodies, pushes: Pushes) -> Floats:
    """Return (n, 2, loads) noise-free shifts of a made sensor's markers, px."""
    actual = Sensor(_seeded(scene, number)).actual
    points, optics = actual.markers.points, actual.scene.optics
    moved = (
        bodies.moved(actual.scene, "truth", points, pushes.patches)
        @ pushes.loads.reshape(len(pushes.loads), -1).T
    )
    everywhere = points[:, :, None] + moved.reshape(len(points), 3, -1)
    seen = project(everywhere.transpose(0, 2, 1).reshape(-1, 3), *optics)
    shifts = seen.reshape(len(points), -1, 2) - project(points, *optics)[:, None]
    return np.nan_to_num(shifts).transpose(0, 2, 1)


def _errors(known: _Information, pushes: Pushes, force: Floats, weight: float) -> dict[str, float]:
    """Return errors of the totals of expected forces (k, 3, sensors, loads)."""
    noise = known.covariance(np.tile(np.eye(3), len(force)), weight)
    truth = pushes.loads.sum(axis=1)
    press = slice(1, 1 + pushes.presses)
    size = np.linalg.norm(truth[press], axis=1)
    missing = force[:, :, :, press].sum(axis=0) - truth[press].T[:, None]
    bias = np.linalg.norm(missing, axis=0) / size
    each = bias**2 + np.trace(noise) / size**2
    normal = pushes.patches.frames[0, 2]
    return {
        "total_force_error": float(np.sqrt(each.mean())),
        "total_force_error_se": _standard_error(np.sqrt(each).ravel()),
        "total_force_bias": float(np.sqrt((bias**2).mean())),
        "resolution_gf": float(np.sqrt(max(normal @ noise @ normal, 0.0)) / GF),
    }


def _widths(
    scene: Scene, sweep: Sweep, sites: Rectangles, pushes: Pushes, force: Floats
) -> dict[str, float]:
    """Return widths and two-point distances of expected forces (k, 3, sensors, loads)."""
    grid = scene.inverse.sites
    apart = pushes.pair_mm
    profiles = [_Profiles(scene, sites, force[:, :, sensor]) for sensor in range(force.shape[2])]
    dips = np.mean([p.dips(pushes) for p in profiles], axis=0)
    over = _reached(grid, apart)
    nan = float("nan")
    return {
        "fwhm_mm": float(np.mean([p.width(0) for p in profiles])),
        "sites_mm": resolved_by_sites(grid, sweep.loads),
        "two_point_mm": two_point_distance(apart[over], dips[over]) if over.any() else nan,
        "dip": float(np.interp(sweep.loads.pair_mm, apart, dips)) if len(dips) else nan,
    }


def _range(scene: Scene, view: View, sweep: Sweep, shift: Floats) -> float:
    """Return the largest force, N, that the sensor takes: linear theory and the tracker's reach."""
    soft = STRAIN * scene.material.youngs_modulus_mpa * sweep.loads.size_mm**2
    across = np.sqrt(np.abs(np.linalg.det(view.jacobian[:, :, :2])))
    pitch = np.array([scene.markers[str(name)].pitch_mm for name in view.markers.layer]) * across
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = REACH * pitch / np.linalg.norm(shift, axis=1) * sweep.loads.force_n
    return float(min(soft, np.nanmin(reach[view.usable])))


def _require_cover(scene: Scene, pushes: Pushes) -> None:
    grid = scene.inverse.sites
    chart = scene.body.chart_of(pushes.patches.centre_mm[: 1 + pushes.presses])
    if (np.abs(chart) > np.array(grid.half_mm) + grid.pitch_mm / 2 + 1e-9).any():
        raise RecipeError(
            "reconstruction.sites: they don't cover the sweep's presses; use more sites or a "
            "wider pitch"
        )


def resolved_by_sites(grid: Sites, loads: Sweep.Loads) -> float:
    """Return the least distance, mm, at which an estimate without any error, which holds in every
    site what lies in its cell, shows two pushes along s; inf for none."""
    place = grid.axes()[0]
    half = loads.size_mm / 2
    apart = np.array(PAIRS) * loads.pair_mm
    apart = apart[_reached(grid, apart)]
    ends = place[:, None] + grid.pitch_mm / 2 * np.array([-1.0, 1.0])

    def held(middle: float) -> Floats:
        low, high = np.clip(ends, middle - half, middle + half).T
        return np.asarray(high - low)

    dips = np.array([dip(place, held(-a / 2) + held(a / 2), float(a)) for a in apart])
    return two_point_distance(apart, dips) if len(apart) else float("inf")


def _reached(grid: Sites, apart_mm: Floats) -> Bools:
    """Return (m,) whether two pushes so far apart along s are both over the sites."""
    return np.asarray(apart_mm / 2 <= grid.half_mm[0] + grid.pitch_mm / 2)


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """One made sensor's pictures: (exposures, loads, 3) totals and (exposures, k, 3, loads) forces,
    N; (loads x exposures n, 2) errors of the shifts, (n,) stated standard deviations, and (loads n,
    2) variances over exposures; the share of markers found; the first picture."""

    sites: Rectangles
    totals: Floats
    forces: Floats
    errors: Floats
    stated: Floats
    spread: Floats
    matched: float
    picture: Picture


def full(
    scene: Scene, sweep: Sweep, bodies: Bodies, pushes: Pushes
) -> tuple[dict[str, float], Shown]:
    """Return a design's metrics over all exposures of its made sensors, and the picture and fields
    of the first; `InputError` where pictures show too little to track.

    ``..._noise_se`` is the standard error that noise leaves, from the scatter over the exposures of
    the same made sensors; NaN of one exposure.
    """
    # Make the sensors of the design, and track and reconstruct all their exposures.
    chosen = pushes.chosen(sweep.loads.pair_mm)
    made = [
        _seen(Sensor(_seeded(scene, number)), scene, sweep, bodies, pushes, chosen)
        for number in range(sweep.sensors)
    ]
    # Error of the total force of every exposure.
    truth = pushes.loads[chosen].sum(axis=1)
    press = slice(1, 1 + pushes.presses)
    size = np.linalg.norm(truth[press], axis=1)
    off = np.stack([np.linalg.norm(one.totals - truth, axis=2)[:, press] / size for one in made])
    # Widths and the dip between two loads, from profiles through the field.
    first = made[0]
    grid = made[0].sites
    profiles = [_Profiles(scene, grid, each) for one in made for each in one.forces]
    widths = np.reshape([each.width(0) for each in profiles], off.shape[:2])
    dips = [np.nan]
    if len(pushes.pair_mm):
        apart = float(pushes.pair_mm[pushes.nearest(sweep.loads.pair_mm)])
        dips = [dip(*each.along(len(chosen) - 1, 0), apart) for each in profiles]
    # Errors of the shifts. Sensors are independent; exposures of one sensor are not.
    spread = np.concatenate([one.spread for one in made])
    errors = np.concatenate([one.errors for one in made])
    stated = np.concatenate([one.stated for one in made])
    each_sensor = off.mean(axis=(1, 2)) if len(made) > 1 else off.ravel()
    figures = {
        "total_force_error": float(np.sqrt(np.mean(off**2))),
        "total_force_error_se": _standard_error(each_sensor),
        "total_force_error_noise_se": _standard_error(np.sqrt(np.mean(off**2, axis=(0, 2)))),
        "fwhm_mm": float(np.mean(widths)),
        "fwhm_noise_se_mm": _standard_error(widths.mean(axis=0)),
        "dip": float(np.mean(dips)),
        "sd_px": _deviation_px(errors),
        "stated_sd_px": float(np.sqrt(np.nanmean(stated**2))),
        "noise_px": float(np.sqrt(np.nanmedian(spread))) if len(spread) else float("nan"),
        "matched": float(np.mean([one.matched for one in made])),
    }
    return figures, {
        "picture": first.picture,
        "site_mm": grid.centre_mm,
        "middle_n": first.forces[0, :, :, 0],
        "pair_n": first.forces[0, :, :, 1 + pushes.presses :],
    }


def _seen(
    sensor: Sensor, scene: Scene, sweep: Sweep, bodies: Bodies, pushes: Pushes, chosen: list[int]
) -> _Seen:
    """Take the pictures of one made sensor under the chosen loads, track and reconstruct them."""
    from twin.sense.reconstruct import reconstruct
    from twin.sense.track import Tracker, analyse_rest

    calibration = _calibration(sensor, bodies)
    count = sweep.loads.exposures
    points = sensor.actual.markers.points
    # each round of exposures has a zero of its own, or one zero's noise would be in all of them
    still = sensor.renderer.radiance(sensor.ellipsoids(None))
    rest = analyse_rest(sensor.exposed(still, 0), sensor.layout_px, method=scene.tracking.method)
    zeros = [Tracker.motion(rest, sensor.exposed(still, 1 + k)) for k in range(count)]
    # a marker's noise is the same in every picture, so that one factorisation serves them all
    stated = np.nanmean([zero.sd_px for zero in zeros], axis=0) if count > 1 else zeros[0].sd_px
    usual = zeros[0].usual_sd_px
    # Each load: one light, several exposures, each tracked and reconstructed.
    at_rest = sensor.project(points)
    options = scene.inverse.options()
    totals = np.zeros((count, len(chosen), 3))
    forces = np.zeros((count, len(sensor.sites), 3, len(chosen)))
    errors = []
    matched = []
    spread = [np.zeros((0, 2))]
    pictures: list[Picture] = []
    for place, motion in enumerate(_motions(sensor, bodies, pushes, chosen)):
        light = sensor.renderer.radiance(sensor.ellipsoids(motion))
        true = sensor.project(points + motion.displacement_mm) - at_rest
        shifts = []
        for k in range(count):
            picture = sensor.exposed(light, 1 + count * (1 + place) + k)
            pictures = pictures or [picture]
            found = Tracker.motion(rest, picture)
            moved = found.shift_px - zeros[k].shift_px
            found = replace(found, shift_px=moved, sd_px=stated, usual_sd_px=usual, drift_px=0.0)
            found_field = reconstruct(found, calibration, **options)
            shifts.append(found.shift_px)
            errors.append(found.shift_px - true)
            matched.append(float(np.isfinite(found.shift_px[:, 0]).mean()))
            totals[k, place] = found_field.total_force_n
            forces[k, :, :, place] = found_field.force_n
        # The spread between exposures of one load is the noise alone.
        if count > 1:
            spread.append(np.var(shifts, axis=0, ddof=1))
    return _Seen(
        sites=sensor.sites,
        totals=totals,
        forces=forces,
        errors=np.concatenate(errors),
        stated=stated,
        spread=np.concatenate(spread),
        matched=float(np.mean(matched)),
        picture=pictures[0],
    )


def _motions(
    sensor: Sensor, bodies: Bodies, pushes: Pushes, chosen: Sequence[int]
) -> Iterator[Motion]:
    """Yield how chosen loads move the actual markers; `ContactError` without equilibrium or full
    force."""
    actual = sensor.actual.scene
    points = sensor.actual.markers.points
    if pushes.probe:
        assert actual.press is not None
        for load in chosen:
            state = sensor.press(pushes.press(load, actual.press))
            if not state.complete:
                raise ContactError(f"press {load} of the sweep's loads ends before its force")
            yield sensor.motion(state.load)
        return
    printed = any(layer.kind == "print" for layer in actual.markers.values())
    compliance = bodies.moved(actual, "truth", points, pushes.patches)
    for load in chosen:
        moved = compliance @ pushes.loads[load].ravel()
        gradient = np.zeros((len(points), 3, 3))
        if printed:  # of a bead's turn no picture shows anything
            unit = bodies.unit(actual, "truth", pushes.patches)
            gradient = unit.gradient(points, pushes.rectangles(load))
            gradient = gradient / actual.material.youngs_modulus_mpa
        yield Motion(displacement_mm=moved.reshape(-1, 3), gradient=gradient, error=0.0)


def _nominal_compliance(scene: Scene, points: Points, sites: Rectangles, bodies: Bodies) -> Floats:
    """Return (3n, 3k) mm/N by which the sensor's software takes forces at sites to move points."""
    if scene.calibration.method == "halfspace":
        return half_space_compliance(scene, points, sites)
    return bodies.moved(scene, "nominal", points, sites)


def _calibration(sensor: Sensor, bodies: Bodies) -> Calibration:
    """Return the calibration of a design, which is the same for all its made sensors."""
    points = sensor.nominal_markers.points
    compliance = _nominal_compliance(sensor.nominal, points, sensor.sites, bodies)
    return nominal_calibration(sensor, compliance)


def _deviation_px(error: Floats) -> float:
    """Return the standard deviation of (m, 2) errors of shifts, per axis, px."""
    known: Bools = np.asarray(np.isfinite(error).all(axis=1), np.bool_)
    if not known.any():
        raise InputError("no marker was found in any picture")
    fine = known & (np.linalg.norm(np.where(known[:, None], error, 0.0), axis=1) <= GROSS_PX)
    return float(np.sqrt(np.mean(error[fine] ** 2))) if fine.any() else float("nan")


@dataclass(frozen=True)
class _Made:
    """A task's rows, npz contents shown, and compliances needed and made."""

    rows: list[Row]
    shown: list[bytes | None]
    asked: int
    made: int


def _make_rows(folder: Path, task: int) -> _Made:
    """Return the rows of a task of the job whose files are in ``folder``."""
    worker = _worker(folder)
    before = worker.bodies.asked, worker.bodies.made
    done = [worker.row(number) for number in worker.numbers(task)]
    asked, made = worker.bodies.asked - before[0], worker.bodies.made - before[1]
    return _Made([row for row, _ in done], [shown for _, shown in done], asked, made)


class _Worker:
    """What a process keeps of one sweep."""

    def __init__(self, folder: Path) -> None:
        job = json.loads((folder / "sweep.json").read_text())
        self.sweep = Sweep.model_validate(job["sweep"])
        self.stage: str = job["stage"]
        self.chunk: int = job["chunk"]
        self.scene = load_scene(folder / "scene.toml")
        columns = {key: [each[key] for each in job["designs"]] for key in job["designs"][0]}
        self.designs = Designs(self.sweep, self.scene, columns)
        self.base = SceneTable.of(self.scene)
        self.bodies = Bodies.of(self.sweep)
        self._pushes: dict[str, Pushes] = {}

    def numbers(self, task: int) -> range:
        """Return the numbers of the designs of a task."""
        return range(task * self.chunk, min((task + 1) * self.chunk, len(self.designs)))

    def row(self, number: int) -> tuple[Row, bytes | None]:
        """Return a design's row; what goes wrong with it is its status."""
        started = time.perf_counter()
        row: Row = {"status": "ok", "error": ""}
        shown = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                figures, shown = self._figures(self.designs.scene_of(number, self.base))
            row |= figures
        except RecipeError as problem:
            row |= {"status": "dropped", "error": "; ".join(problem.problems)}
        except TwinError as problem:
            row |= {"status": "failed", "error": str(problem)}
        except OSError:
            # this machine's trouble, such as a full disk, and not the design's: its row is no row
            raise
        except Exception as problem:  # one design must not end a sweep of thousands
            row |= {"status": "failed", "error": f"{type(problem).__name__}: {problem}"}
        row["seconds"] = time.perf_counter() - started
        return row, shown

    def _figures(self, scene: Scene) -> tuple[dict[str, float], bytes | None]:
        """Return a design's metrics, and of the full chain what the page shows."""
        view = View.of(scene)
        inside, hidden = view.inside.mean(), view.hidden.mean()
        if inside < self.sweep.limits.seen:
            raise RecipeError(f"only {100 * inside:.0f} % of the markers are inside the picture")
        if hidden > self.sweep.limits.overlap:
            raise RecipeError(
                f"{100 * hidden:.0f} % of the markers overlap another one in the picture"
            )
        key = json.dumps(scene.body.geometry(), sort_keys=True, default=str)
        if key not in self._pushes:  # the same patches for every design of one body
            self._pushes[key] = Pushes.on_design(self.sweep, self.scene, scene)
        if self.stage == "linear":
            return linear(scene, view, self.sweep, self.bodies, self._pushes[key])[0], None
        figures, shown = full(scene, self.sweep, self.bodies, self._pushes[key])
        file = io.BytesIO()
        np.savez_compressed(file, **shown)  # type: ignore[arg-type]
        return figures, file.getvalue()


_worker = lru_cache(maxsize=1)(_Worker)
