"""The nominal design with free parameters, which `twin.sense.fit_design` fits.

It is the nominal body on the nominal mesh, never the truth. Displacements scale with stiffness,
moved markers are interpolated in the same fields, Poisson's ratio and a block's thickness between
two bodies each, so a set of parameters costs milliseconds.

A cover of another material adds what it does to the markers as drawn, whatever the parameters.

A probe's footprint is Hertz's pressure on the nominal contact radius times a fitted factor. The
shear of a contact that sticks lies between Hertz's spread (pressed down a slope) and a stuck disc's
(moved sideways): the middle of both, with half their difference as a standard deviation of each
press. The half-space part is summed over small squares; the smooth rest of the finite body over
five places only, which have the same second moments.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Pixels, Points
from twin.errors import InputError
from twin.parts.camera import Camera
from twin.parts.load import Rectangles
from twin.parts.scene import Scene
from twin.sense.fit_design import Fit, Presses
from twin.theory import halfspace
from twin.theory.optics import project, project_with_jacobian
from twin.world.elasticity.compliance import Compliance

SPREAD = 1 / 3 - 1 / 5
"""How far the second moments of two contacts' tractions lie apart, radius^2 per axis: a disc's that
sticks, and Hertz's pressure. Next to a contact the motion depends on it."""

FOOTPRINT_PCT = 10.0
"""Standard deviation of the footprint's radius against Hertz's, percent: what sticking and
curvature leave open."""

SHORTFALL, SHORTFALL_SD = 0.8, 0.6
"""Mean and standard deviation of a half-normal deviation, in its scale: the shortfall of Poisson's
ratio where the drawing has (nearly) 0.5."""

NU_STEP = 0.005
"""How far below the nominal Poisson's ratio the second body is, between which it is interpolated,
where the drawing lies nearer to 0.5 than this."""

NU_UNSURE = 0.5
"""Standard deviation, at least, of a drawing's Poisson's ratio below 0.5, over what it lacks of
0.5: it is mostly a guess, and may be too small or too large."""

MODULUS_UNSURE = 0.3
"""Relative standard deviation, at least, of a drawing's Young's modulus, which presses show: with
1.5 %, a load cell of 5 mN that reads 0.06 N would rather be wrong than a modulus drawn 15 % off."""

STEP_MM = 0.02
"""Step of the slope along the surface, mm."""

REACH = 0.7
"""Distance of the five squares of a footprint from its middle, over its radius."""

CUTS = 8
"""Squares across a footprint."""

AXES = ("x", "y", "z")


class FittedDesign:
    """The nominal design with its tolerances as unknowns; see `twin.sense.fit_design.Design`.

    Parameters
    ----------
    scene
        The nominal scene; what its ``tolerance`` gives no room is not fitted.
    places
        Squares on the surface where presses were made (`twin.study.sensor.on_surface`).
    radius_mm
        (p,) nominal contact radius of the presses there.
    covered
        The compliance (3n, 3k), mm/N, of points (n, 3) under forces on k patches, of the nominal
        body with its cover, where that is of another material.
    stage_mm
        Standard deviation along each axis of the surface, mm, of where the origin of all presses'
        places lies; 0 where it is the scene's.
    """

    CHECK = (
        "check presses.csv (N, mm from the recipe's origin, +z into the rubber, x along the "
        "picture's columns, y against its rows), the body's size, the markers' depth, and "
        "press_probe_mm"
    )
    """What may be wrong where presses do not fit."""

    def __init__(
        self,
        scene: Scene,
        places: Rectangles,
        radius_mm: Floats,
        covered: Callable[[Points, Rectangles], Floats] | None = None,
        progress: Any = None,
        stage_mm: float = 0.0,
    ) -> None:
        self.covered = covered
        self.scene, self.places, self.radius_mm = scene, places, np.asarray(radius_mm, float)
        room = scene.tolerance
        modulus_sd = room.youngs_modulus_pct / 100
        sizes = {
            "youngs_modulus": max(modulus_sd, MODULUS_UNSURE) if modulus_sd else 0.0,
            "poisson_ratio": self._unsure_ratio,
            "thickness": room.thickness_mm,
            **{f"depth_{name}": room.depth_mm for name in scene.markers},
            **{f"pupil_{axis}": room.pupil_mm for axis in AXES},
            **{f"tilt_{axis}": room.tilt_deg for axis in AXES},
            "focal": room.focal_pct / 100,
            "distortion": room.distortion,
            "footprint": FOOTPRINT_PCT / 100,
            "stage_x": stage_mm,
            "stage_y": stage_mm,
        }
        self._parameters = tuple(sizes)
        self.sizes = {name: size for name, size in sizes.items() if size > 0}
        self.names = tuple(self.sizes)
        self.print_mm = max(room.print_mm, 1e-3)
        self._progress = progress
        self._added: dict[bytes, Floats] = {}
        counts = [layer.columns * layer.rows for layer in scene.markers.values()]
        self._chart = np.concatenate([layer.chart() for layer in scene.markers.values()])
        self._layer = np.repeat(list(scene.markers), counts)

    @property
    def _unsure_ratio(self) -> float:
        """The scale of Poisson's ratio's deviation: 0 if it isn't fitted."""
        room = self.scene.tolerance.poisson_ratio
        return max(room, NU_UNSURE * self._below_half) if room and self._both_ways else room

    @property
    def _below_half(self) -> float:
        return 0.5 - self.scene.material.poisson_ratio

    @property
    def _both_ways(self) -> bool:
        """Whether Poisson's ratio may also be larger than drawn."""
        return self._below_half >= NU_STEP

    def _compliance_of(self, scene: Scene) -> Compliance:
        return Compliance(scene.body, scene.material, level="nominal", progress=self._progress)

    @cached_property
    def _nominal(self) -> Compliance:
        return self._compliance_of(self.scene)

    @cached_property
    def _of_ratios(self) -> dict[float, Compliance]:
        """Bodies of other Poisson's ratios, by their deviations."""
        steps = [-NU_STEP]
        if self._both_ways:
            steps = [-min(self.sizes["poisson_ratio"], 0.5), self._below_half]
        drawn, found = self.scene.material, {}
        for step in steps:
            other = drawn.model_copy(update={"poisson_ratio": drawn.poisson_ratio + step})
            found[step] = self._compliance_of(self.scene.model_copy(update={"material": other}))
        return found

    @cached_property
    def _thicker(self) -> Compliance:
        return self._compliance_of(self.scene.thicker(self.sizes["thickness"]))

    def _by_cover(self, sites: Rectangles) -> Floats | float:
        """Return (3n, 3k) mm/N, by how much the nominal cover moves the markers as drawn more."""
        if self.covered is None:
            return 0.0
        key = sites.centre_mm.tobytes() + sites.half_mm.tobytes()
        if key not in self._added:
            none_seen = np.full((len(self._chart), 2), np.nan)
            drawn, _ = self.markers_of(np.zeros(len(self.names)), none_seen)
            bare = self._nominal.to_points(drawn, sites)
            self._added[key] = self.covered(drawn, sites) - bare
        return self._added[key]

    def _values(self, scaled: Floats) -> dict[str, float]:
        """Return the deviations of all parameters in their own units, 0 of those not fitted."""
        found = dict.fromkeys(self._parameters, 0.0)
        for (name, size), z in zip(self.sizes.items(), scaled, strict=True):
            found[name] = size * float(z)
            if name == "poisson_ratio" and not self._both_ways:
                found[name] = SHORTFALL_SD * found[name] - SHORTFALL * size
            if name == "poisson_ratio":
                found[name] = min(found[name], self._below_half)
        return found

    def optics_of(self, scaled: Floats) -> tuple[Camera, float, float]:
        """Return the camera that the parameters say, the refractive index, and the height of the
        base, mm."""
        found = self._values(scaled)
        nominal, _, base = self.scene.optics
        camera = nominal.deviating(
            base,
            [found[f"pupil_{axis}"] for axis in AXES],
            [found[f"tilt_{axis}"] for axis in AXES],
            found["focal"],
            found["distortion"],
        )
        deviating = self.scene.model_copy(update={"camera": camera})
        return deviating.thicker(found["thickness"]).optics

    def markers_of(self, scaled: Floats, rest_px: Pixels) -> tuple[Points, Floats]:
        """Return the (n, 3) markers, mm, that are seen at ``rest_px``, and their (n, 2) print
        errors, mm."""
        optics, found = self.optics_of(scaled), self._values(scaled)
        depths = {
            name: layer.depth_mm + found[f"depth_{name}"]
            for name, layer in self.scene.markers.items()
        }
        depth = np.array([depths[str(name)] for name in self._layer])
        error = np.zeros_like(self._chart)
        seen = np.asarray(np.isfinite(rest_px).all(axis=1))
        body = self.scene.body
        step = 1e-4
        for _ in range(3):
            here = body.chart_points(self._chart + error, depth)
            along = [
                (body.chart_points(self._chart + error + step * d, depth) - here) / step
                for d in np.eye(2)
            ]
            slope = project_with_jacobian(here, *optics)[1] @ np.stack(along, axis=2)
            miss = np.where(seen[:, None], rest_px - project(here, *optics), 0.0)
            error = error + np.clip(np.linalg.solve(slope, miss[:, :, None])[:, :, 0], -1.0, 1.0)
        return body.chart_points(self._chart + error, depth), error

    def unsure_px(self, presses: Presses) -> Floats:
        """See `twin.sense.fit_design._Design.unsure_px`: what the unknown pressure under the
        contact does, whose force is known.

        At a distance d from a contact of radius a it is of the order of (a/d)^2 times the second
        moment of the pressure's error (Saint-Venant).
        """
        markers, _ = self.markers_of(np.zeros(len(self.names)), presses.rest_px)
        here = self.places.centre_mm[presses.place]
        away = np.linalg.norm(markers - here[:, None], axis=2) / self.radius_mm[presses.place, None]
        size = np.nan_to_num(np.linalg.norm(presses.shift_px, axis=2)) / 2**0.5
        size = np.where(away < 1, size.max(axis=1, keepdims=True), size)
        return np.asarray(SPREAD * size / away**2)

    def predict(
        self, scaled: Floats, rest_px: Pixels, place: Ints, force_n: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """See `twin.sense.fit_design._Design.predict`.

        Raises
        ------
        InputError
            Markers lie outside the body: the parameters try to explain presses of another sensor.
        """
        optics = self.optics_of(scaled)
        markers, prints = self.markers_of(scaled, rest_px)
        if not self.scene.body.contains(markers, -1e-6).all():
            raise InputError(
                "the presses do not fit this sensor: they would need markers outside its body; "
                f"{self.CHECK}"
            )
        by_place = self._footprints(scaled, markers)
        rest = project(markers, *optics)
        shifts, slopes = [], []
        for where, force in zip(place, force_n, strict=True):
            here, *others = by_place[where]
            moved = markers + (here @ force).reshape(-1, 3)
            shifts.append(project(moved, *optics) - rest)
            by_others = np.stack([(slope @ force).reshape(-1, 3) for slope in others], axis=2)
            columns = np.concatenate([here.reshape(-1, 3, 3), by_others], axis=2)
            slopes.append(project_with_jacobian(moved, *optics)[1] @ columns)
        return prints, np.stack(shifts), np.stack(slopes)

    def compliance(
        self,
        scaled: Floats,
        markers: Points,
        sites: Rectangles,
        grid: tuple[int, int] | None = None,
    ) -> Floats:
        """Return (3n, 3k) mm/N of markers at their fitted places per force on squares of the
        surface.

        What bodies of another Poisson's ratio or thickness change is solved for at every other site
        of a ``grid`` (columns, rows), if one is given.
        """
        found = self._values(scaled)
        parts: list[tuple[float, float, Compliance]] = []  # share, step of the ratio, body
        if off := found["poisson_ratio"]:
            # Lagrange's polynomial through the drawing and the other bodies.
            for step, other in self._of_ratios.items():
                rest = [(off - s) / (step - s) for s in self._of_ratios if s != step]
                parts.append((off / step * math.prod(rest), step, other))
        if found["thickness"]:
            parts.append((found["thickness"] / self.sizes["thickness"], 0.0, self._thicker))
        drawn = self._nominal.to_points(markers, sites, moving=True)
        whole = drawn + self._by_cover(sites)
        for share, step, body in parts:
            if grid is None:
                change = body.to_points(markers, sites, moving=True) - drawn
            else:
                near = self._by_half_space(markers, sites, step) if step else np.zeros_like(drawn)
                change = near + self._smooth_part(grid, body, markers, sites, drawn + near)
            whole = whole + share * change
        return np.asarray(whole / (1 + found["youngs_modulus"]))

    def _smooth_part(
        self,
        grid: tuple[int, int],
        body: Compliance,
        markers: Points,
        sites: Rectangles,
        less: Floats,
    ) -> Floats:
        """Return (3n, 3k) mm/N, a body's compliance less a matrix that lies near it."""

        def change(chosen: Bools) -> Floats:
            there = body.to_points(markers, sites[chosen], moving=True)
            return there - less[:, np.repeat(chosen, 3)]

        return from_every_other_site(grid, change)

    def _by_half_space(self, markers: Points, sites: Rectangles, step: float) -> Floats:
        """Return (3n, 3k) mm/N that a half-space of the drawn rubber gains where its Poisson's
        ratio is larger by ``step``."""
        drawn = self.scene.material
        modulus, nu = drawn.youngs_modulus_mpa, drawn.poisson_ratio
        here, there = (
            halfspace.compliance(markers, sites, modulus, one) for one in (nu, nu + step)
        )
        return there - here

    def transfer(self, scaled: Floats, markers: Points, compliance: Floats) -> Floats:
        """Return (2n, 3k) px/N: the compliance through the fitted camera."""
        from twin.sense.calibration import from_compliance

        seen = project_with_jacobian(markers, *self.optics_of(scaled))[1]
        return from_compliance(compliance, seen)

    def deviations(self, fit: Fit) -> dict[str, dict[str, float]]:
        """Return the fitted deviations from the drawing and their standard deviations, in the
        parameters' units."""
        values = self._values(fit.scaled)
        spread = np.sqrt(np.diag(fit.covariance))
        sizes = zip(self.sizes.items(), spread, strict=True)
        return {
            name: {"deviation": values[name], "sd": size * float(s)} for (name, size), s in sizes
        }

    def _footprints(self, scaled: Floats, markers: Points) -> list[Floats]:
        """Return (4, 3n, 3) for every place: mm/N under its footprint, how that changes by a
        standard deviation of the shear's spread, and its slopes along the surface's two axes, 1/N.
        """
        found = self._values(scaled)
        material = self.scene.material
        modulus, nu = material.youngs_modulus_mpa, material.poisson_ratio
        coarse, weights = self._few
        softness = 1 / (1 + found["youngs_modulus"])
        rest = self.compliance(scaled, markers, coarse) / softness
        nu_now = nu + found["poisson_ratio"]
        rest -= halfspace.compliance(markers, coarse, modulus, nu_now)
        rest = rest.reshape(len(rest), len(self.places), -1, 3)
        out = []
        squares, shares = self.shares()
        stage = np.array([found["stage_x"], found["stage_y"]])
        for index, nominal in enumerate(self.radius_mm):
            radius = nominal * (1 + found["footprint"])
            normal = self.places.frames[index, 2]
            # How the rest of the body changes along each axis: by opposite squares of the five.
            opposite = rest[:, index, 1::2] - rest[:, index, 2::2]
            along_rest = opposite.transpose(1, 0, 2) / (2 * REACH * nominal)
            # Under both spreads of the force: the half-space part, and the rest of the body.
            near = []
            for aside in np.array([(0.0, 0.0), (STEP_MM, 0.0), (0.0, STEP_MM)]) + stage:
                fine = self._squares(index, radius, squares + aside / radius)
                each = halfspace.compliance(markers, fine, modulus, nu_now)
                near.append(each.reshape(3 * len(markers), -1, 3))
            hertz, stuck = np.einsum("mri,kr->kmi", near[0], shares) + np.einsum(
                "mri,kr->kmi", rest[:, index], weights
            )
            hertz, stuck = np.stack([hertz, stuck]) + np.tensordot(stage, along_rest, axes=1)
            wider = 0.5 * (stuck - hertz) @ (np.eye(3) - np.outer(normal, normal))
            along = [
                np.einsum("mri,r->mi", near[1 + axis] - near[0], shares[0]) / STEP_MM
                + along_rest[axis]
                for axis in range(2)
            ]
            parts = np.stack([hertz + wider, wider, *along])
            out.append(softness * parts)
        return out

    @cached_property
    def _few(self) -> tuple[Rectangles, Floats]:
        """Five squares a place, and (2, 5) weights of the second moments of Hertz's pressure and of
        a stuck disc's shear, radius^2 / 5 and / 3 per axis."""
        offsets = REACH * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], float)
        outer = np.array([1 / 5, 1 / 3]) / (2 * REACH**2)
        weights = np.stack([1 - 4 * outer, *[outer] * 4], axis=1)
        squares = [self._squares(i, r, offsets) for i, r in enumerate(self.radius_mm)]
        return Rectangles.joined(squares), weights

    def _squares(self, index: int, radius: float, offsets: Floats) -> Rectangles:
        """Return squares on the surface around a place, at offsets in radii."""
        body = self.scene.body
        centre = self.places.centre_mm[index]
        points = body.chart_points(body.chart_of(centre[None]) + radius * offsets)
        return Rectangles.at(body, points, radius / CUTS)

    @staticmethod
    def shares() -> tuple[Floats, Floats]:
        """Return a contact's tractions on a disc as shares of squares.

        Returns
        -------
        Offsets (s, 2) of the squares' centres from the disc's, in its radii, and the shares (2, s)
        of the force on them, whose sums are 1: Hertz's pressure, and the shear of a disc that
        sticks. The squares are `CUTS` to the disc's diameter.
        """
        sub = 12
        fine = (np.arange(CUTS * sub) + 0.5) / (CUTS * sub) * 2 - 1
        inside = np.maximum(1 - fine[:, None] ** 2 - fine[None, :] ** 2, 0.0)
        stuck = np.divide(1.0, np.sqrt(inside), out=np.zeros_like(inside), where=inside > 0)
        cells = np.stack([np.sqrt(inside), stuck]).reshape(2, CUTS, sub, CUTS, sub)
        cells = cells.sum(axis=(2, 4)).reshape(2, -1)
        axis = (np.arange(CUTS) + 0.5) / CUTS * 2 - 1
        offsets = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        keep = cells[0] > 0
        return offsets[keep], cells[:, keep] / cells.sum(axis=1, keepdims=True)


def from_every_other_site(grid: tuple[int, int], change: Callable[[Bools], Floats]) -> Floats:
    """Return (m, 3k) values at all sites of a grid (columns, rows), by splines between those
    of ``change``: from (k,) which sites to (m, 3c) values there.

    For what is smooth, such as what a thicker body changes: on three pads 2.5 to 3 % of its
    size off, 7.5 % where the drawn body has a stored table (another mesh).
    """
    from scipy.interpolate import make_interp_spline

    few = [np.unique(np.append(np.arange(0, count, 2), count - 1)) for count in grid]
    chosen = np.zeros(grid, np.bool_)
    chosen[np.ix_(*few)] = True
    values = change(chosen.ravel())
    values = values.reshape(len(values), *map(len, few), 3)
    for axis, (at, count) in enumerate(zip(few, grid, strict=True), start=1):
        degree = min(3, len(at) - 1)
        spline = make_interp_spline(at, values, degree, axis=axis, check_finite=False)
        values = spline(np.arange(count))  # what a picture doesn't show stays NaN
    return np.asarray(values.reshape(len(values), -1))
