"""Axes of the elastic system itself: material, size, load, elements, threads; and systems that have no answer."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache, partial

import numpy as np

from benchmarks import ROOT
from benchmarks.stress_meshes import with_inverted_element, with_loose_node, with_loose_part, with_slivers
from twin.arrays import Bools, Floats
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.elasticity.tile import tile
from twin.world.mesh.extrude import with_cover
from twin.world.mesh.mesh import Mesh, read_mesh

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
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

EXACT = replace(SOUND, departure=1e-11)


def system_axes() -> list[Axis]:
    """Return the axes of the elastic system on shipped meshes of the block."""
    decades = tuple(10.0**k for k in (0, 3, 6, 12, 50, 100, 150))
    small = tuple(1.0 / d for d in decades)
    return [
        Axis(name="Poisson's ratio, down", steps=(0.3, 0.0, -0.3, -0.49, -0.5, -0.51), attempt=_of_nu, bounds=SOUND),
        Axis(name="Poisson's ratio, up", steps=(0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999, 0.4999999, 0.5, 0.51),
             attempt=_of_nu, bounds=SOUND),
        Axis(name="1/2 - nu (departure: from nu = 1/2, over 1/2 - nu)",
             steps=(1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9), attempt=_of_compressibility,
             bounds=replace(SOUND, departure=10.0)),
        Axis(name="13 slivers, deg (departure: markers)", attempt=_of_slivers,
             steps=(10.0, 1.0, 0.1, 0.01, 1e-3, 1e-5, 1e-7, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13),
             bounds=replace(SOUND, departure=0.01)),
        Axis(name="cover, times stiffer", steps=(1.0, 1e3, 1e6, 1e7, 1e8, 1e9), attempt=_of_cover, bounds=SOUND),
        Axis(name="cover, times as stiff", steps=(1.0, 1e-3, 1e-6, 1e-9, 1e-12), attempt=_of_cover, bounds=SOUND),
        Axis(name="E up, MPa", steps=(1.0, 1e3, 1e6, 1e7), attempt=_of_modulus, bounds=EXACT),
        Axis(name="E down, MPa", steps=(1.0, 1e-2, 1e-4, 1e-6, 9e-7, 0.0), attempt=_of_modulus,
             bounds=EXACT),
        Axis(name="length of the mesh up", steps=decades, attempt=_of_length, bounds=EXACT),
        Axis(name="length of the mesh down", steps=small, attempt=_of_length, bounds=EXACT),
        Axis(name="length of body, load and points up", steps=(1.0, 2.0, 5.0, 6.0), attempt=_of_size, bounds=EXACT),
        Axis(name="length of body, load and points down", steps=(1.0, 0.5, 0.1, 0.06, 0.05), attempt=_of_size,
             bounds=EXACT),
        Axis(name="force up, N", steps=(*decades, 1e300, np.inf), attempt=_of_force, bounds=EXACT),
        Axis(name="force down, N", steps=(*small, 1e-300), attempt=_of_force, bounds=EXACT),
        Axis(name="threads", steps=(1.0, 2.0, 4.0), attempt=_of_threads, bounds=replace(SOUND, departure=1e-10)),
    ]  # fmt: skip


def unsolvable() -> dict[str, Callable[[], Measured]]:
    """Return systems that have no answer, or none in double precision, by name."""
    mesh = _mesh("sketch")
    nowhere = np.zeros(len(mesh.points), bool)
    edge = (mesh.points[:, 2] > 40 - 1e-9) & (mesh.points[:, 0] > 50 - 1e-9)
    shut = nowhere.copy()
    shut[mesh.faces] = True
    hole = mesh.points.copy()
    hole[7] = np.nan
    return {
        "body held nowhere": partial(solved, mesh, held=nowhere),
        "body held on one edge": partial(solved, mesh, held=edge),
        "mesh with a loose node": partial(solved, with_loose_node(mesh)),
        "mesh of two parts, one not held": partial(solved, with_loose_part(mesh, 200.0)),
        "inverted element": partial(solved, with_inverted_element(mesh)),
        "node at NaN": partial(solved, replace(mesh, points=hole)),
        "NaN in a load": partial(solved, mesh, size=np.nan),
        "incompressible, shut in, told to swell": lambda: _swollen(mesh, shut),
        "cover a billion times stiffer": lambda: _of_cover(1e9),
    }


@cache
def _mesh(level: str) -> Mesh:
    return read_mesh(MESHES / f"kamiyama_block.{level}.npz")


def solved(
    mesh: Mesh, nu: float = 0.5, size: float = 1.0, held: Bools | None = None, layers: tuple[Layer, ...] = ()
) -> Measured:
    """Solve unit forces, times ``size``, on two nodes of the sensing surface: residual, reaction and reciprocity."""
    return _answer(mesh, nu, size, held, layers)[0]


def _answer(
    mesh: Mesh, nu: float = 0.5, size: float = 1.0, held: Bools | None = None, layers: tuple[Layer, ...] = ()
) -> tuple[Measured, Floats]:
    system = TaylorHood(mesh, nu, held=held, layers=layers)
    extent = float(np.ptp(mesh.points[:, 0]))
    sites = [
        int(np.argmin(np.linalg.norm(mesh.points - np.array(place) * extent, axis=1)))
        for place in ((0, 0, 0), (0.2, 0.1, 0))
    ]
    forces = np.zeros((len(mesh.points), 3, 6))
    for k, site in enumerate(sites):
        forces[site, :, 3 * k : 3 * k + 3] = np.where(np.eye(3) > 0, size, 0.0)
    moved = system.solve(forces)
    residual = system.factor.residual
    compliance = moved[sites].reshape(6, 6) / size
    apart = np.abs(compliance - compliance.T).max() / np.abs(compliance).max()
    imbalance = np.abs(system.reaction(forces) / size + np.tile(np.eye(3), 2)).max()
    return Measured(residual=residual, imbalance=float(imbalance), asymmetry=float(apart)), moved


def relative(one: Floats, other: Floats) -> float:
    """Return the largest difference over the largest entry."""
    return float(np.abs(one - other).max() / np.abs(other).max())


def _of_nu(nu: float) -> Measured:
    return solved(_mesh("nominal"), nu)


def _of_compressibility(compressibility: float) -> Measured:
    measured, moved = _answer(_mesh("nominal"), 0.5 - compressibility)
    return replace(measured, departure=relative(moved, _unit("nominal")) / compressibility)


@cache
def _unit(level: str) -> Floats:
    return _answer(_mesh(level))[1]


@cache
def _marker_motion(mesh_with_slivers: float) -> Floats:
    mesh = _mesh("nominal") if mesh_with_slivers == 0 else with_slivers(_mesh("nominal"), mesh_with_slivers)[0]
    return _moved(BLOCK, mesh, 1.0)


def _moved(body: Block, mesh: Mesh, modulus: float, scale: float = 1.0) -> Floats:
    """Return the motion (63, 3) of a grid of points under a load, mm; lengths scaled, the force not."""
    grid = np.stack(np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-8, 8, 3), [3.0, 6.0, 12.0]), axis=-1)
    load = tile(Traction.rectangle((2 * scale, 1 * scale), (4 * scale, 3 * scale), PUSH), body)
    material = Material(youngs_modulus_mpa=modulus, poisson_ratio=0.5)
    return Compliance(body, material, mesh, table=False).displacement(grid.reshape(-1, 3) * scale, load)


def _of_slivers(angle_deg: float) -> Measured:
    spoilt = with_slivers(_mesh("nominal"), angle_deg)[0]
    return replace(solved(spoilt), departure=relative(_marker_motion(angle_deg), _marker_motion(0)))


def _of_cover(ratio: float) -> Measured:
    layered = with_cover(_mesh("nominal"), BLOCK, COVER_MM)
    return solved(layered, layers=(Layer(modulus_ratio=ratio, poisson_ratio=0.5),))


def _of_modulus(modulus: float) -> Measured:
    departure = relative(_moved(BLOCK, _mesh("sketch"), modulus) * modulus, _moved(BLOCK, _mesh("sketch"), 1.0))
    return replace(solved(_mesh("sketch")), departure=departure)


def _of_length(scale: float) -> Measured:
    measured, moved = _answer(replace(_mesh("sketch"), points=_mesh("sketch").points * scale))
    return replace(measured, departure=relative(moved * scale, _unit("sketch")))


def _of_size(scale: float) -> Measured:
    body = Block(width_mm=100 * scale, length_mm=90 * scale, thickness_mm=40 * scale)
    mesh = replace(_mesh("sketch"), points=_mesh("sketch").points * scale)
    departure = relative(_moved(body, mesh, 1.0, scale) * scale, _moved(BLOCK, _mesh("sketch"), 1.0))
    return replace(solved(mesh), departure=departure)


def _of_force(size: float) -> Measured:
    measured, moved = _answer(_mesh("sketch"), size=size)
    return replace(measured, departure=relative(moved / size, _unit("sketch")))


def _swollen(mesh: Mesh, held: Bools) -> Measured:
    system = TaylorHood(mesh, 0.5, held=held)
    system.solve(np.zeros((len(mesh.points), 3, 1)), mesh.points[:, :, None])
    return Measured(residual=system.factor.residual)


def _of_threads(number: float) -> Measured:
    measured, moved = _with_threads(int(number))
    return replace(measured, departure=relative(moved, _with_threads(1)[1]))


@cache
def _with_threads(number: int) -> tuple[Measured, Floats]:
    """Solve in a child process whose libraries are told to use so many threads, and that finds no solved fields."""
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    with tempfile.TemporaryDirectory() as folder:
        code = f"from benchmarks.stress_axes import threaded; threaded({folder!r})"
        environment = {**os.environ, **dict.fromkeys(names, str(number)), "TWIN_CACHE": folder}
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True)
        with np.load(f"{folder}/answer.npz") as file:
            figures = [float(v) for v in file["figures"]]
            return Measured(residual=figures[0], imbalance=figures[1], asymmetry=figures[2]), file["moved"]


def threaded(folder: str) -> None:
    """Write answers into ``folder``: nodal forces on the nominal mesh, and the markers' motion."""
    measured, moved = _answer(_mesh("nominal"))
    both = np.concatenate([moved.ravel(), _marker_motion(0).ravel()])
    figures = [measured.residual, measured.imbalance, measured.asymmetry]
    np.savez(f"{folder}/answer.npz", figures=figures, moved=both)
