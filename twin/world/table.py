"""The smooth rest of the standard block, tabulated: presses on it need no mesh and no solve at all.

On a flat face the rest w of a point force varies smoothly with the force's place, the point's place and nu. So w is
solved once for unit forces at Chebyshev places of the working window, at four nu, read at Chebyshev points of the box
under the window, and kept as the coefficients of a product of Chebyshev polynomials T_a(x') T_b(y') T_i(x) T_j(y)
T_k(z), (x', y') the force's place. The block's two mirror planes kill three coefficients of four.

``python -m twin.world.table`` makes the two shipped tables anew from the shipped meshes (a minute).

Validity: forces in the window, points in the box, nu in [0.3, 0.5], the block and mesh that the table was made of;
`Table.covers` says so, and everything else is solved.
"""

from __future__ import annotations

import json
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.arrays import Bools, Floats, Points, frozen
from twin.errors import InputError
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.places import MESHES
from twin.world.correction import correction
from twin.world.fem import TaylorHood
from twin.world.interpolate import Locator
from twin.world.mesh import Level, Mesh, body_mesh
from twin.world.solve import Solver

STANDARD = Block(width_mm=100, length_mm=90, thickness_mm=40)
WINDOW_MM = (20.0, 18.0)
BOX_MM = (24.0, 20.0, 10.0)
NU_RANGE = (0.3, 0.5)
SIZES = (4, 5, 5, 8, 8, 5)
"""Numbers of polynomials in nu, in the force's x and y, and in the point's x, y and z."""

NEGLIGIBLE = 3e-7
"""Coefficients below this share of the largest are dropped."""

Words = dict[str, str | list[float]]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Chebyshev coefficients of w for E = 1 MPa, mm/N.

    Attributes
    ----------
    coefficients
        (nu, x', y', force axis, displacement axis, x, y, z).
    digest
        Of the mesh it was made of.
    """

    coefficients: Floats
    digest: str

    def covers(self, points: Points, load: Rectangles, poisson_ratio: float) -> bool:
        """Tell whether the table holds for these points, forces and nu."""
        reach = np.abs(load.centre_mm[:, :2]) + _reach(load)
        flat = np.abs(load.frames[:, 2] - [0.0, 0.0, 1.0]).max(initial=0.0) < 1e-9
        return bool(
            flat
            and NU_RANGE[0] <= poisson_ratio <= NU_RANGE[1]
            and np.all(reach <= WINDOW_MM)
            and np.all(np.abs(points[:, :2]) <= BOX_MM[:2])
            and np.all(points[:, 2] <= BOX_MM[2])
        )

    def at(self, poisson_ratio: float) -> TableAtNu:
        """Return the table of one nu."""
        low, high = NU_RANGE
        place = (2.0 * poisson_ratio - low - high) / (high - low)
        weight = chebvander(np.array([place]), SIZES[0] - 1)[0]
        return TableAtNu(coefficients=np.tensordot(weight, self.coefficients, axes=1))


@dataclass(frozen=True, kw_only=True)
class TableAtNu:
    """`Table` at one nu: (x', y', force axis, displacement axis, x, y, z)."""

    coefficients: Floats

    def displacement(self, points: Points, load: Rectangles) -> Points:
        """Return (n, 3) w in mm for E = 1 MPa."""
        field = np.einsum("kab,kf,abfdxyz->dxyz", _load_basis(load), load.force_n, self.coefficients, optimize=True)
        return np.asarray(_point_basis(points) @ field.reshape(3, -1).T)

    def gradient(self, points: Points, load: Rectangles) -> Floats:
        """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa."""
        field = np.einsum("kab,kf,abfdxyz->dxyz", _load_basis(load), load.force_n, self.coefficients, optimize=True)
        flat = field.reshape(3, -1).T
        return np.stack([_point_basis(points, along) @ flat for along in range(3)], axis=2)

    def rests(self, points: Points, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N for E = 1 MPa per unit force on each rectangle."""
        of_points = np.einsum("nq,pq->np", _point_basis(points), self._flat, optimize=True)
        of_points = of_points.reshape(len(points), *self.coefficients.shape[:4])
        out: Floats = np.einsum("nabfd,kab->ndkf", of_points, _load_basis(rectangles), optimize=True)
        return out

    @cached_property
    def _flat(self) -> Floats:
        return self.coefficients.reshape(int(np.prod(self.coefficients.shape[:4])), -1)


def _reach(load: Rectangles) -> Floats:
    """Return (k, 2) how far each rectangle extends from its centre along x and y."""
    return np.asarray(np.einsum("ks,ksi->ki", load.half_mm, np.abs(load.frames[:, :2, :2])))


def _load_basis(load: Rectangles) -> Floats:
    """Return (k, x', y') means of the polynomials over each rectangle, by 3 x 3 Gauss points."""
    node, weight = np.polynomial.legendre.leggauss(3)
    total = np.zeros((len(load), SIZES[1], SIZES[2]))
    for s, ws in zip(node, weight, strict=True):
        for t, wt in zip(node, weight, strict=True):
            place = (
                load.centre_mm
                + s * load.half_mm[:, :1] * load.frames[:, 0]
                + t * load.half_mm[:, 1:] * load.frames[:, 1]
            )
            a, b = (chebvander(place[:, i] / WINDOW_MM[i], SIZES[1 + i] - 1) for i in range(2))
            total += ws * wt / 4.0 * np.einsum("ka,kb->kab", a, b)
    return total


def _point_basis(points: Points, along: int | None = None) -> Floats:
    """Return (n, x y z) polynomials at the points, or their slopes along one axis, 1/mm."""
    places = (points[:, 0] / BOX_MM[0], points[:, 1] / BOX_MM[1], 2.0 * points[:, 2] / BOX_MM[2] - 1.0)
    scales = (BOX_MM[0], BOX_MM[1], BOX_MM[2] / 2.0)
    basis = []
    for axis, (place, size) in enumerate(zip(places, SIZES[3:], strict=True)):
        values = chebvander(place, size - 1)
        if axis == along:
            slope = np.polynomial.chebyshev.chebder(np.eye(size), scl=1.0 / scales[axis])
            values = values[:, : size - 1] @ slope
        basis.append(values)
    return np.asarray(np.einsum("nx,ny,nz->nxyz", *basis).reshape(len(points), -1))


def _kept() -> Bools:
    """Return which coefficients the two mirror planes allow."""
    n, a, b, f, d, i, j, _ = np.ogrid[tuple(slice(s) for s in (*SIZES[:3], 3, 3, *SIZES[3:]))]
    even_x = (a + i + (f == 0) + (d == 0)) % 2 == 0
    even_y = (b + j + (f == 1) + (d == 1)) % 2 == 0
    return np.broadcast_to(even_x & even_y & (n >= 0), (*SIZES[:3], 3, 3, *SIZES[3:]))


def shipped_path(level: Level) -> Path:
    """Return where the shipped table of the standard block is."""
    return MESHES / f"kamiyama_block.{level}.table.npz"


def shipped_table(body: Body, level: Level, mesh: Mesh | None = None) -> Table | None:
    """Return the shipped table if it was made of this body (and, if one is given, of this mesh), else None.

    Warns, and returns None, if its file is damaged.
    """
    if not isinstance(body, Block) or not shipped_path(level).exists():
        return None
    size = (body.width_mm, body.length_mm, body.thickness_mm)
    if size != (STANDARD.width_mm, STANDARD.length_mm, STANDARD.thickness_mm):
        return None
    try:
        table = read_table(shipped_path(level))
    except InputError as problem:  # the table only saves time, so a damaged one must not stop a run
        warnings.warn(f"{problem}; solving without the table, which takes a few seconds longer", stacklevel=2)
        return None
    return table if mesh is None or mesh.digest() == table.digest else None


def make_table(body: Body, mesh: Mesh, solver: Solver = "auto") -> Table:
    """Solve for all forces and nu of the table; takes a few seconds per nu."""
    x, y = (w * chebpts1(s) for w, s in zip(WINDOW_MM, SIZES[1:3], strict=True))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = body.surface_from_above(places)
    at = [b * chebpts1(s) for b, s in zip(BOX_MM, SIZES[3:], strict=True)]
    at[2] = (at[2] + BOX_MM[2]) / 2.0
    points = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1).reshape(-1, 3)
    matrix = Locator(mesh).locate(points).matrix(len(mesh.points))
    samples = np.empty((SIZES[0], SIZES[1], SIZES[2], 3, 3, *SIZES[3:]))
    low, high = NU_RANGE
    for n, nu in enumerate((low + high + (high - low) * chebpts1(SIZES[0])) / 2.0):
        system = TaylorHood(mesh, float(nu), solver)
        loads = [_point_force(c, body) for c in centres]
        fields = correction(system, body, loads, [np.eye(3)[None]] * len(loads))
        values = (matrix @ fields.reshape(len(fields), -1)).reshape(*SIZES[3:], 3, SIZES[1], SIZES[2], 3)
        samples[n] = np.transpose(values, (4, 5, 6, 3, 0, 1, 2))
    for axis, size in zip((0, 1, 2, 5, 6, 7), SIZES, strict=True):
        inverse = np.linalg.inv(chebvander(chebpts1(size), size - 1))
        samples = np.moveaxis(np.tensordot(inverse, samples, axes=(1, axis)), 0, axis)
    return Table(coefficients=np.where(_kept(), samples, 0.0), digest=mesh.digest())


def _point_force(centre: Points, body: Body) -> Rectangles:
    return Rectangles(
        centre_mm=centre[None].copy(),
        frames=np.array(body.frames(centre[None])),
        half_mm=np.zeros((1, 2)),
        force_n=np.zeros((1, 3)),
    )


def write_table(table: Table, path: Path) -> None:
    """Write the coefficients that are not negligible, with what they are made of."""
    flat = table.coefficients.ravel()
    index = np.flatnonzero(np.abs(flat) > NEGLIGIBLE * np.abs(flat).max())
    words = json.dumps({"digest": table.digest, "sizes": SIZES, "window_mm": WINDOW_MM, "box_mm": BOX_MM})
    np.savez_compressed(
        path,
        gap=np.diff(index, prepend=0).astype(np.uint16),
        value=flat[index].astype(np.float32),
        words=np.array(words),
    )


def read_table(path: Path) -> Table:
    """Read a table.

    Raises
    ------
    InputError
        The file is not a table of this program's sizes.
    """
    try:
        # opened here, because numpy leaves a broken zip file's handle to the garbage collector
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            words = json.loads(str(file["words"]))
            index, value = np.cumsum(file["gap"].astype(np.int64)), file["value"].astype(float)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, zlib.error) as problem:
        raise InputError(f"{path} is not a table of the rest ({problem}): make it anew") from problem
    expected = {"sizes": list(SIZES), "window_mm": list(WINDOW_MM), "box_mm": list(BOX_MM)}
    if {key: words.get(key) for key in expected} != expected:
        raise InputError(f"{path} was made for another window or size: make it anew with python -m twin.world.table")
    shape = (*SIZES[:3], 3, 3, *SIZES[3:])
    flat = np.zeros(int(np.prod(shape)))
    if index.shape != value.shape or np.any(index >= flat.size) or not np.isfinite(value).all():
        raise InputError(f"{path} is not a table of the rest (its arrays don't fit together): make it anew")
    flat[index] = value
    coefficients = flat.reshape(shape)
    frozen(coefficients)
    return Table(coefficients=coefficients, digest=words["digest"])


def main() -> None:
    """Make both shipped tables."""
    levels: tuple[Level, ...] = ("standard", "nominal")
    for level in levels:
        write_table(make_table(STANDARD, body_mesh(STANDARD, level)), shipped_path(level))
        print(f"{shipped_path(level)}: {shipped_path(level).stat().st_size} bytes")


if __name__ == "__main__":
    main()
