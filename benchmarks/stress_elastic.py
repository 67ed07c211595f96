"""Axes of the elastic system: material, size, load and its place, threads.

Balance is the sum of the tractions that the half-space's field leaves on all faces, against the load. The bodies are
left unheld for that, so that the base counts as well.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks import ROOT
from benchmarks.reference import BODIES
from twin.arrays import Floats, Points
from twin.files import MESHES
from twin.parts.body import Body
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.correction_loads import nodal_forces
from twin.world.elasticity.discretise import join, tile
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.mesh.cover_mesh import with_cover
from twin.world.mesh.quadratic_mesh import Mesh, read_mesh

BLOCK, FINGER = BODIES.values()
COVER_MM = 0.2
PUSH = (0.3, -0.5, 1.0)


SLACK = 3.0
"""Two answers are compared, each of them off, and what the program says is an estimate."""

FIGURES = ("residual", "imbalance", "asymmetry", "departure")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """How far an answer is from what must be true of it; NaN where a figure says nothing.

    ``told`` is the error that the program itself estimates; an asymmetry within `SLACK` times that holds.
    """

    residual: float = np.nan
    imbalance: float = np.nan
    asymmetry: float = np.nan
    departure: float = np.nan
    told: float = np.nan

    def beyond(self, bounds: Measured) -> str:
        """Return which figures are above their bounds, in words, or an empty string."""
        wrong = []
        for name in FIGURES:
            mine, most = getattr(self, name), getattr(bounds, name)
            if name == "asymmetry" and not np.isnan(self.told):
                most = SLACK * self.told
            if not (np.isnan(most) or mine <= most):
                wrong.append(f"{name} {mine:.1e}")
        return ", ".join(wrong)

    def or_worse(self, other: Measured) -> Measured:
        """Return the larger of each figure."""
        return Measured(**{f.name: float(np.fmax(getattr(self, f.name), getattr(other, f.name))) for f in fields(self)})

    def columns(self) -> dict[str, float | str]:
        """Return the figures as cells; empty where there is none."""
        each = {name: getattr(self, name) for name in FIGURES}
        return {f"worst {name}": "" if np.isnan(value) else value for name, value in each.items()}


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One way to go to extremes: steps from mild to extreme, and what is measured at a step."""

    name: str
    steps: tuple[float, ...]
    attempt: Callable[[float], Measured]
    bounds: Measured


SOUND = Measured(residual=1e-9, imbalance=1e-5, asymmetry=1e-5)
"""Bounds of every elastic system: the program's own on the residual, and a hundred thousandth of the load."""


def elastic_axes() -> list[Axis]:
    """Return the axes of the elastic system on shipped meshes, then of loads at a place.

    A load's distances are from its middle; its width is twice that, so that it touches the edge.
    """
    return [*_system_axes(), *_load_axes()]


def _system_axes() -> list[Axis]:
    return [
        Axis(name="Poisson's ratio, down", steps=(0.3, 0.0, -0.3, -0.49, -0.5, -0.51), attempt=_of_nu, bounds=SOUND),
        Axis(name="Poisson's ratio, up", steps=(0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999, 0.4999999, 0.5, 0.51),
             attempt=_of_nu, bounds=SOUND),
        Axis(name="1/2 - nu (departure: from nu = 1/2, over 1/2 - nu)",
             steps=(1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9), attempt=_of_compressibility,
             bounds=replace(SOUND, departure=10.0)),
        Axis(name="cover, times stiffer", steps=(1.0, 1e3, 1e6, 1e7, 1e8, 1e9), attempt=_of_cover, bounds=SOUND),
        Axis(name="cover, times as stiff", steps=(1.0, 1e-3, 1e-6, 1e-9, 1e-12), attempt=_of_cover, bounds=SOUND),
        Axis(name="threads", steps=(1.0, 2.0, 4.0), attempt=of_threads, bounds=replace(SOUND, departure=1e-10)),
    ]  # fmt: skip


@cache
def _nominal() -> Mesh:
    return read_mesh(MESHES / "kamiyama_block.nominal.npz")


def _solved(mesh: Mesh, nu: float = 0.5, layers: tuple[Layer, ...] = ()) -> tuple[Measured, Floats]:
    """Solve unit forces on two nodes of the sensing surface: residual, reaction and reciprocity, and what moved."""
    system = TaylorHood(mesh, nu, layers=layers)
    extent = float(np.ptp(mesh.points[:, 0]))
    sites = [
        int(np.argmin(np.linalg.norm(mesh.points - np.array(place) * extent, axis=1)))
        for place in ((0, 0, 0), (0.2, 0.1, 0))
    ]
    forces = np.zeros((len(mesh.points), 3, 6))
    for k, site in enumerate(sites):
        forces[site, :, 3 * k : 3 * k + 3] = np.eye(3)
    moved = system.solve(forces)
    residual = system.factor.residual
    compliance = moved[sites].reshape(6, 6)
    apart = np.abs(compliance - compliance.T).max() / np.abs(compliance).max()
    imbalance = np.abs(system.reaction(forces) + np.tile(np.eye(3), 2)).max()
    return Measured(residual=residual, imbalance=float(imbalance), asymmetry=float(apart)), moved


def _relative(one: Floats, other: Floats) -> float:
    """Return the largest difference over the largest entry."""
    return float(np.abs(one - other).max() / np.abs(other).max())


def _of_nu(nu: float) -> Measured:
    return _solved(_nominal(), nu)[0]


def _of_compressibility(compressibility: float) -> Measured:
    measured, moved = _solved(_nominal(), 0.5 - compressibility)
    return replace(measured, departure=_relative(moved, _solved(_nominal())[1]) / compressibility)


def _marker_motion() -> Floats:
    """Return the motion (63, 3) of a grid of points under a load, mm."""
    grid = np.stack(np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-8, 8, 3), [3.0, 6.0, 12.0]), axis=-1)
    stiff = Compliance(BLOCK, Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5), _nominal(), table=False)
    return stiff.displacement(grid.reshape(-1, 3), tile(Traction.rectangle((2, 1), (4, 3), PUSH), BLOCK))


def _of_cover(ratio: float) -> Measured:
    layered = with_cover(_nominal(), BLOCK, COVER_MM)
    return _solved(layered, layers=(Layer(modulus_ratio=ratio, poisson_ratio=0.5),))[0]


def of_threads(number: float) -> Measured:
    measured, moved = _with_threads(int(number))
    return replace(measured, departure=_relative(moved, _with_threads(1)[1]))


@cache
def _with_threads(number: int) -> tuple[Measured, Floats]:
    """Solve in a child process whose libraries are told to use so many threads, and that finds no solved fields."""
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    with tempfile.TemporaryDirectory() as folder:
        code = f"from benchmarks.stress_elastic import threaded; threaded({folder!r})"
        environment = {**os.environ, **dict.fromkeys(names, str(number)), "TWIN_CACHE": folder}
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True)
        with np.load(f"{folder}/answer.npz") as file:
            figures = [float(v) for v in file["figures"]]
            return Measured(residual=figures[0], imbalance=figures[1], asymmetry=figures[2]), file["moved"]


def threaded(folder: str) -> None:
    """Write answers into ``folder``: nodal forces on the nominal mesh, and the markers' motion."""
    measured, moved = _solved(_nominal())
    both = np.concatenate([moved.ravel(), _marker_motion().ravel()])
    figures = [measured.residual, measured.imbalance, measured.asymmetry]
    np.savez(f"{folder}/answer.npz", figures=figures, moved=both)


MIRRORS = {"block": np.array([-1.0, 1.0, 1.0]), "finger": np.array([1.0, -1.0, 1.0])}
"""Under which the bodies are symmetric."""

LEAST_DEPTH_MM, ASIDE = 0.3, 0.05
"""Least depth of points, and their least distance to all other faces over the body's height: next to a free side, where
no marker is, mirrored answers differ up to twice as much."""
AT_LOAD = replace(SOUND, imbalance=0.01)
"""Quadrature is good to a few thousandths next to an edge; under mirrored loads the program's own estimate is asked."""


def _load_axes() -> list[Axis]:
    gaps = (20.0, 10.0, 3.0, 1.0, 0.1, 1e-2, 1e-3, 2e-4, 1e-4, 5e-5)
    widths = (4.0, 1.0, 0.1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-100, 0.0)
    return [
        Axis(name="block, load touching an edge, mm from its middle", steps=gaps,
             attempt=partial(_of_place, "block", lambda gap: (50 - gap, 3.0, 0.0)), bounds=AT_LOAD),
        Axis(name="block, load touching a corner", steps=gaps,
             attempt=partial(_of_place, "block", lambda gap: (50 - gap, 45 - gap, 0.0)), bounds=AT_LOAD),
        Axis(name="finger, load touching the back edge", steps=(4.0, *gaps[2:]),
             attempt=partial(_of_place, "finger", _beside_back), bounds=AT_LOAD),
        Axis(name="finger, load 0.5 mm wide, mm from its middle to the clamped rim (departure: motion of the clamp)",
             steps=(2.0, 1.5, 1.0, 0.75, 0.5, 0.3, 0.25), attempt=_of_rim,
             bounds=replace(AT_LOAD, departure=0.1)),
        Axis(name="block, width of the load, mm (departure: from 1 um)", steps=widths,
             attempt=partial(_of_width, "block", (2.0, 1.0)), bounds=replace(AT_LOAD, departure=0.2)),
        Axis(name="finger, width of the load, mm (departure: from 1 um)", steps=widths[1:],
             attempt=partial(_of_width, "finger", (1.0, 2.0)), bounds=replace(AT_LOAD, departure=0.2)),
        Axis(name="block, width of the load over the face's (departure: from its quarters)",
             steps=(0.1, 0.3, 0.6, 0.9, 0.99, 0.9999, 1.0, 1.0001, 10.0), attempt=_of_share,
             bounds=replace(AT_LOAD, departure=0.01)),
    ]  # fmt: skip


@cache
def _stiff(name: str) -> Compliance:
    return Compliance(BODIES[name], Material(youngs_modulus_mpa=1.0), level="nominal", table=False)


@cache
def _loose(name: str) -> Body:
    """Return the body, held nowhere."""
    body = BODIES[name]
    kind: Any = type("Loose", (type(body),), {"held_pieces": property(lambda self: ())})
    made: Body = kind(**body.geometry())
    return made


@cache
def _points(name: str) -> Points:
    """Return points (n, 3) all over a body, 0.3 mm deep or deeper, and a twentieth of its height off other faces."""
    body = BODIES[name]
    low, high = (np.array(b) for b in body.bounds_mm)
    points = np.random.default_rng(0).uniform(low, high, (3000, 3))
    away = body.piece_distances(points)
    return points[(away[:, 0] >= LEAST_DEPTH_MM) & (away[:, 1:].min(axis=1) >= ASIDE * body.base_z_mm)]


def _measured(name: str, load: Rectangles, mirrored: Rectangles) -> Measured:
    """Return residual, balance of the half-space's tractions, and difference to the mirrored load's mirrored answer."""
    stiff, mirror, points = _stiff(name), MIRRORS[name], _points(name)
    here = stiff.displacement(points, load)
    residual = stiff.system.factor.residual
    there = stiff.displacement(points * mirror, mirrored) * mirror
    total = load.force_n.sum(axis=0)
    left = nodal_forces(stiff.mesh, _loose(name), load, load.force_n[:, :, None], 0.5).sum(axis=0)[:, 0]
    return Measured(
        residual=max(residual, stiff.system.factor.residual),
        imbalance=float(np.linalg.norm(left - total) / np.linalg.norm(total)),
        asymmetry=_relative(there, here),
        told=stiff.answer(points, load)[1],
    )


def _pair(name: str, centre: Floats, width: float) -> tuple[Rectangles, Rectangles]:
    """Return a square load of one width at a surface point (2 or 3,), and its mirror image."""
    body, mirror = BODIES[name], MIRRORS[name]
    each = (
        Traction.rectangle(tuple(centre * m[: len(centre)]), (width, width), tuple(np.array(PUSH) * m))
        for m in (np.ones(3), mirror)
    )
    one, other = (tile(load, body) for load in each)
    return one, other


def _of_place(name: str, centre: Callable[[float], tuple[float, ...]], gap: float) -> Measured:
    return _measured(name, *_pair(name, np.array(centre(gap)), 2.0 * gap if gap < 5.0 else 4.0))


def _beside_back(gap: float) -> tuple[float, ...]:
    x, y, z = FINGER.chart_points(np.array([[gap - 8.0, 3.0]]))[0]
    return float(x), float(y), float(z)


def _of_rim(gap: float) -> Measured:
    load, mirrored = _pair("finger", np.array([-3.0, 8.0, 10.0 - gap]), 0.5)
    base = np.array([(x, y, 10.0) for x in np.linspace(-7.7, 0.0, 20) for y in np.linspace(-7.7, 7.7, 60)])
    clamped, points = (_stiff("finger").displacement(p, load) for p in (base, _points("finger")))
    still = np.linalg.norm(clamped, axis=1).max() / np.linalg.norm(points, axis=1).max()
    told = _stiff("finger").answer(np.concatenate([base, _points("finger")]), load)[1]
    return replace(_measured("finger", load, mirrored), departure=float(still), told=told)


@cache
def _under(name: str, place: tuple[float, float], width: float) -> Floats:
    body = BODIES[name]
    deep = body.chart_points(np.array([place]) + np.array([[0.0, 0.0], [3.0, 1.0], [-4.0, 2.0]]), 3.0)
    return _stiff(name).displacement(deep, tile(Traction.rectangle(_on(name, place), (width, width), PUSH), body))


def _on(name: str, place: tuple[float, float]) -> tuple[float, ...]:
    return tuple(float(c) for c in BODIES[name].chart_points(np.array([place]))[0])


def _of_width(name: str, place: tuple[float, float], width: float) -> Measured:
    pair = _pair(name, np.array(_on(name, place)), width)
    departure = _relative(_under(name, place, width), _under(name, place, 1e-3)) if width < 1.0 else np.nan
    return replace(_measured(name, *pair), departure=departure if width < 1.0 else 0.0)


def _of_share(share: float) -> Measured:
    size = np.array([100.0, 90.0]) * share
    whole = tile(Traction.rectangle((0, 0), tuple(size), PUSH), BLOCK)
    corners = [np.array([a, b]) * size / 4 for a in (-1, 1) for b in (-1, 1)]
    quarter = tuple(np.array(PUSH) / 4)
    quarters = join([tile(Traction.rectangle(tuple(c), tuple(size / 2), quarter), BLOCK) for c in corners])
    mirrored = tile(Traction.rectangle((0, 0), tuple(size), (-PUSH[0], *PUSH[1:])), BLOCK)
    stiff, points = _stiff("block"), _points("block")
    departure = _relative(stiff.displacement(points, whole), stiff.displacement(points, quarters))
    # under a load wider than the body is thick the base lies in the load's own footprint: its quarters are balanced
    balanced = _measured("block", quarters, quarters).imbalance
    return replace(_measured("block", whole, mirrored), departure=departure, imbalance=balanced)
