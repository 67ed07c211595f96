"""The correction of a block in a table: presses on it need no mesh and no solve.

On a flat face the correction w of a point force varies smoothly with the force's place, the point's
place and nu. It is kept as the coefficients of products of Chebyshev polynomials T_n(nu) T_a(x')
T_b(y') T_i(x) T_j(y) T_k(z), (x', y') the force's place in a window of the sensing face, (x, y, z)
the point's in a box under it. The block's two mirror planes remove three coefficients of four. w is
solved at the Chebyshev nodes; forces of one quarter suffice, the others are mirrored.

A table has one of three roles: ``truth``; ``check``, from a coarser mesh, whose difference from it
estimates its error; and ``nominal``, the sensor's own. The standard block's tables are shipped
(``python -m twin.world.elasticity.block_table`` makes them), others are made when a contact needs
many compliances, and cached: of one nu for a press, of all for a dataset. The table of a thin block
holds what the bonded layer's field leaves of w, which varies only near the sides. Between blocks of
several thicknesses a table is interpolated (`Table.between`).

Validity: forces in the window, points in the box, nu in [0, 0.5] or the one that it was made for,
the block and mesh that the table was made of (`Table.covers`). Between thicknesses: blocks of one
width and length, ranges up to `WIDEST`.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from twin.arrays import Bools, Floats, Points, Progress, frozen, grid_points
from twin.errors import InputError
from twin.files import (
    MESHES,
    PINNED,
    cache_folder,
    kept_if_possible,
    read_arrays,
    write_whole,
)
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.theory.bonded_layer import BondedLayer
from twin.world.elasticity.cache import PointCache, require_table
from twin.world.elasticity.correction import correction
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.tensor_basis import SIZES, Axis
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.quadratic_mesh import Mesh
from twin.world.mesh.sizing import Level, Sizing
from twin.world.mesh.snap import RIM_SHARE, drawn_to_rim

NU_RANGE = (0.0, 0.5)
MANY_LOADS = 25
"""Loads at the same points from which on the table is worth a product with the points'
polynomials."""

_NU = Axis.chebyshev(SIZES[0], *NU_RANGE)

_GAUSS = np.polynomial.legendre.leggauss(3)
_MIDDLE = np.polynomial.legendre.leggauss(1)
"""Nodes and weights along each side of a rectangle."""


USABLE = 5e-4
"""Largest `Table.error` with which a table is used: thin blocks need more polynomials than it
has."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Chebyshev coefficients of w for E = 1 MPa, mm/N.

    Attributes
    ----------
    coefficients
        (nu, x', y', force axis, displacement axis, x, y, z).
    window_mm
        Half sizes of the window of forces, centred on the origin.
    box_mm
        Half sizes along x and y, and depth, of the box of points.
    digest
        Of the mesh it was made of.
    error
        Largest difference to a solve on that mesh over the largest displacement, under a load it
        was not made of.
    poisson_ratio
        The one nu of a table that holds for no other.
    """

    @dataclass(frozen=True, kw_only=True, eq=False)
    class AtNu:
        """`Table` at one nu: (x', y', force axis, displacement axis, x, y, z)."""

        coefficients: Floats
        window_mm: tuple[float, float]
        box_mm: tuple[float, float, float]

        def contains(self, points: PointCache) -> bool:
            """Return whether all points are in the box."""
            return self._basis(points).inside

        def displacement(self, points: PointCache, load: Rectangles) -> Points:
            """Return (n, 3) w in mm for E = 1 MPa."""
            moments = self._moments(load)
            basis = self._basis(points)
            reading = basis.reading(self)
            if reading is not None:
                return (reading @ moments).reshape(-1, 3)
            return basis.values @ (moments @ self._by_load).reshape(-1, 3)

        def gradient(self, points: PointCache, load: Rectangles) -> Floats:
            """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa."""
            field = (self._moments(load) @ self._by_load).reshape(-1, 3)
            return np.stack([slope @ field for slope in self._basis(points).slopes], axis=2)

        def corrections(self, points: PointCache, rectangles: Rectangles) -> Floats:
            """Return (n, 3, k, 3): w in mm/N at the points for E = 1 MPa per unit force on each
            rectangle."""
            k = len(rectangles)
            basis = self._basis(points)
            reading = basis.reading(self, k)
            if reading is None:
                reading = (basis.values @ self.by_point).reshape(3 * len(points), -1)
            # one product of three times the work, for turning its result's axes would take longer
            loads = np.einsum("ka,fg->afkg", self._load_basis(rectangles), np.eye(3)).reshape(
                -1, 3 * k
            )
            return np.asarray(reading @ loads).reshape(-1, 3, k, 3)

        def normal_corrections(self, points: PointCache, rectangles: Rectangles) -> Floats:
            """Return (n, k): the normal part of `corrections`, for rectangles in the plane z =
            0."""
            part = self._normal_part @ self._load_basis(rectangles).T
            return np.asarray(self._basis(points).values @ part)

        def _basis(self, points: PointCache) -> _PointBasis:
            return points.once(
                self.box_mm,
                lambda: _PointBasis(points=points.points, box_mm=self.box_mm, often=points.often),
            )

        @cached_property
        def _normal_part(self) -> Floats:
            """(x y z, x' y'): z displacement under z forces."""
            part = self.coefficients[:, :, 2, 2].transpose(2, 3, 4, 0, 1)
            return np.ascontiguousarray(part.reshape(int(np.prod(part.shape[:3])), -1))

        def _moments(self, load: Rectangles) -> Floats:
            """Return (x' y' force axis) the load's moments."""
            return np.asarray(self._load_basis(load).T @ load.force_n).ravel()

        @cached_property
        def _by_load(self) -> Floats:
            """(x' y' force axis, x y z displacement axis)."""
            count = self.coefficients.shape[0] * self.coefficients.shape[1] * 3
            return np.ascontiguousarray(
                self.coefficients.transpose(0, 1, 2, 4, 5, 6, 3).reshape(count, -1)
            )

        @cached_property
        def by_point(self) -> Floats:
            """(x y z, displacement axis x' y' force axis)."""
            ordered = self.coefficients.transpose(4, 5, 6, 3, 0, 1, 2)
            return np.ascontiguousarray(ordered.reshape(int(np.prod(ordered.shape[:3])), -1))

        def _load_basis(self, load: Rectangles) -> Floats:
            """Return (k, x' y') means of the polynomials over each rectangle, by 3 x 3 Gauss
            points; of points by one."""
            nodes, weights = _GAUSS if load.half_mm.any() else _MIDDLE
            square = grid_points(nodes, nodes)
            weight = np.multiply.outer(weights, weights).ravel() / 4.0
            along = square @ (load.half_mm[:, :, None] * load.frames[:, :2, :2])
            places = (load.centre_mm[:, None, :2] + along) / self.window_mm
            x = chebvander(places[:, :, 0], SIZES[1] - 1) * weight[:, None]
            y = chebvander(places[:, :, 1], SIZES[2] - 1)
            return np.asarray(x.transpose(0, 2, 1) @ y).reshape(len(load), -1)

    coefficients: Floats
    window_mm: tuple[float, float]
    box_mm: tuple[float, float, float]
    digest: str
    error: float
    poisson_ratio: float | None = None

    def covers(self, load: Rectangles, poisson_ratio: float) -> bool:
        """Tell whether the table holds for these forces and nu, at points of its box."""
        low, high = NU_RANGE if self.poisson_ratio is None else (self.poisson_ratio,) * 2
        return low <= poisson_ratio <= high and _lies_within(load, self.window_mm)

    def at(self, poisson_ratio: float) -> Table.AtNu:
        """Return the table of one nu."""
        weights = np.ones(1)
        if self.poisson_ratio is None:
            weights = _NU.basis(np.array([poisson_ratio]))[0]
        coefficients = np.tensordot(weights, self.coefficients, 1)
        return Table.AtNu(coefficients=coefficients, window_mm=self.window_mm, box_mm=self.box_mm)

    @staticmethod
    def make(
        body: Block,
        mesh: Mesh,
        progress: Progress | None = None,
        poisson_ratio: float | None = None,
    ) -> Table:
        """Return the table of a block, of one nu or of all, with its error under a load that it is
        not made of."""
        window, box = _window_of(body)
        axes = _axes(window, box)
        quarter = [axis.nodes[axis.nodes > -1e-12] for axis in axes[1:3]]
        forces = Rectangles.at(body, body.surface_from_above(grid_points(*quarter)), 0.0)
        points = grid_points(*(axis.nodes for axis in axes[3:]))
        matrix = Locator(mesh).locate(points).matrix(len(mesh.points))
        every = axes[0].nodes if poisson_ratio is None else np.array([poisson_ratio])
        samples = np.empty((len(every), SIZES[1], SIZES[2], 3, 3, *SIZES[3:]))
        for n, nu in enumerate(every):
            if progress:
                progress(f"table of the block's response, nu = {nu:.2f}", n / len(every))
            system = TaylorHood(mesh, float(nu))
            each = [forces[k : k + 1] for k in range(len(forces))]
            fields = correction(system, body, each, [np.eye(3)[None]] * len(each), 1e-7)
            values = matrix @ fields.reshape(len(fields), -1)
            layer = BondedLayer.of(body, float(nu))
            if layer is not None and _is_compact(body):
                values += layer.compliance(points, forces, 1.0).reshape(values.shape)
            values = values.reshape(*SIZES[3:], 3, len(quarter[0]), len(quarter[1]), 3)
            samples[n] = _mirrored(np.transpose(values, (4, 5, 6, 3, 0, 1, 2)))
        for axis, place in zip(axes, (0, 1, 2, 5, 6, 7), strict=True):
            if place or poisson_ratio is None:
                samples = axis.coefficients(samples, place)
        table = Table(
            coefficients=np.where(_kept(len(every)), samples, 0.0),
            window_mm=window,
            box_mm=box,
            digest=mesh.digest(),
            error=0.0,
            poisson_ratio=poisson_ratio,
        )
        return Table(**{**vars(table), "error": _error(table, body, system)})

    def write(self, path: Path) -> None:
        """Write the coefficients that symmetry allows, in steps, and what they are made of.

        Byte by byte: most steps are few, so that their upper bytes are zeros, which compress.
        """
        count = len(self.coefficients)
        allowed = self.coefficients[_kept(count)]
        step = STEP * float(np.abs(allowed).max())
        steps = np.rint(allowed / step).astype(np.int32)
        folded = ((steps << 1) ^ (steps >> 31)).astype("<u4")
        words = json.dumps(
            {
                "digest": self.digest,
                "sizes": [count, *SIZES[1:]],
                "nu_range": NU_RANGE if self.poisson_ratio is None else [self.poisson_ratio] * 2,
                "window_mm": self.window_mm,
                "box_mm": self.box_mm,
                "error": self.error,
                "step": step,
            }
        )
        planes = np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T)
        write_whole(
            path, lambda file: np.savez_compressed(file, planes=planes, words=np.array(words))
        )

    @staticmethod
    def read(path: Path) -> Table:
        """Read a table.

        Raises
        ------
        InputError
            The file is not a table of this program's sizes.
        """
        try:
            file = read_arrays(path, ("words", "planes"))
            words = json.loads(str(file["words"]))
            planes, step = file["planes"], float(words["step"])
            lengths = [*words["window_mm"], *words["box_mm"]]
            numbers = np.array([step, words["error"], *lengths], float)
            low, high = words["nu_range"]
            one = low == high
            expected = [1 if one else SIZES[0], *SIZES[1:]]
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as problem:
            raise InputError(
                f"{path} is not a table of corrections ({problem}): make it again"
            ) from problem
        if words.get("sizes") != expected or not (one or (low, high) == NU_RANGE):
            raise InputError(
                f"{path} was made for other sizes: make it again with python -m "
                "twin.world.elasticity.block_table"
            )
        allowed = _kept(expected[0])
        require_table(path, planes, (4, int(allowed.sum())), np.uint8)
        require_table(path, numbers, (7,), np.float64)
        folded = np.ascontiguousarray(planes.T).view("<u4").ravel()
        coefficients = np.zeros(allowed.shape)
        coefficients[allowed] = step * (
            (folded >> 1).astype(np.int64) ^ -(folded & 1).astype(np.int64)
        )
        frozen(coefficients)
        return Table(
            coefficients=coefficients,
            window_mm=tuple(words["window_mm"]),
            box_mm=tuple(words["box_mm"]),
            digest=words["digest"],
            error=words["error"],
            poisson_ratio=low if one else None,
        )

    @staticmethod
    def find(
        body: Body,
        role: Role,
        *,
        poisson_ratio: float | None = None,
        make: bool = False,
        progress: Progress | None = None,
        usable: float = USABLE,
    ) -> Table | None:
        """Return the table of a block: the shipped or pinned one, else (with ``make``) one from the
        cache or a new one; None without, as what lies in the cache must not change a result.

        Making takes some seconds, for one ``poisson_ratio`` alone a fifth of them. A damaged file
        warns and counts as absent, like a table whose `Table.error` is above ``usable``.
        """
        if not isinstance(body, Block) or not (
            _is_compact(body) or BondedLayer.of(body, NU_RANGE[1])
        ):
            return None
        usable *= CHECK if role == "check" else 1.0
        path = Table.path(body, role)
        of_one = poisson_ratio is not None and not _is_standard(body)
        if (folder := PINNED.folder) is not None:
            path = folder / path.name
            if of_one and not path.is_file():
                path = folder / Table.path(body, role, poisson_ratio).name
            return _usable(path, usable)
        if _is_standard(body):
            return _usable(path, usable)
        if not make:
            return None
        if of_one:
            path = Table.path(body, role, poisson_ratio)
        if not path.exists():
            mesh = drawn_to_rim(body_mesh(body, MADE[role], progress=progress), body)
            table = Table.make(body, mesh, progress, poisson_ratio)
            with kept_if_possible():  # without the table solves stand in
                table.write(path)
        return _usable(path, usable)

    @staticmethod
    def path(body: Block, role: Role, poisson_ratio: float | None = None) -> Path:
        """Return the file of a block's table, of one nu or of all: shipped for the standard block,
        in the cache for others."""
        if _is_standard(body):
            return MESHES / f"kamiyama_block.{role}.table.npz"
        key = Sizing.of(body, MADE[role]).mesh_key(body)
        every = NU_RANGE if poisson_ratio is None else poisson_ratio
        kind = [every, THIN, OBLONG, OFF_SIDES, DEEP]
        found = json.dumps([key, RIM_SHARE, SIZES, kind, WINDOW, BOX, STEP])
        return cache_folder() / f"table-{hashlib.sha256(found.encode()).hexdigest()[:32]}.npz"

    @staticmethod
    def between(body: Block, role: Role, low_mm: float, high_mm: float) -> Table | None:
        """Return the table of a block by interpolation; None where there is none to be had.

        The tables of the range of thicknesses, ``low_mm`` to ``high_mm``, are made, some seconds
        each, and cached.
        """
        if not low_mm <= body.thickness_mm <= high_mm or not low_mm < high_mm <= WIDEST * low_mm:
            return None
        if not _is_compact(body.model_copy(update={"thickness_mm": low_mm})):
            return None
        found = _tables(body.width_mm, body.length_mm, role, low_mm, high_mm)
        if found is None:
            return None
        modes, digest, error = found
        window, box = _window_of(body)
        weights = Axis.chebyshev(len(modes), low_mm, high_mm).basis(np.array([body.thickness_mm]))[
            0
        ]
        return Table(
            coefficients=np.tensordot(weights, modes, axes=1),
            window_mm=window,
            box_mm=box,
            digest=digest,
            error=error,
        )


@dataclass(kw_only=True, eq=False)
class _PointBasis:
    """The products of the point polynomials at n ``points``, computed once for many loads."""

    points: Points
    box_mm: tuple[float, float, float]
    often: bool
    _readings: dict[Table.AtNu, Floats] = field(default_factory=dict)
    _loads: int = 0

    def reading(self, table: Table.AtNu, loads: int = 1) -> Floats | None:
        """Return the (3 n, x' y' force axis) product of the table and the points' polynomials; None
        as long as it doesn't pay."""
        self._loads += loads
        if table not in self._readings and (self.often or self._loads > MANY_LOADS):
            self._readings[table] = (self.values @ table.by_point).reshape(3 * len(self.points), -1)
        return self._readings.get(table)

    @cached_property
    def inside(self) -> bool:
        """Whether all points are in the box."""
        sideways, depth = np.abs(self.points[:, :2]), self.points[:, 2]
        return bool((sideways <= self.box_mm[:2]).all() and (depth <= self.box_mm[2]).all())

    @cached_property
    def values(self) -> Floats:
        """(n, x y z)."""
        return self._products(None)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats, Floats]:
        """Three of (n, x y z), along x, y and z, 1/mm."""
        return self._products(0), self._products(1), self._products(2)

    def _products(self, along: int | None) -> Floats:
        a, b, depth = self.box_mm
        places = (
            self.points[:, 0] / a,
            self.points[:, 1] / b,
            2.0 * self.points[:, 2] / depth - 1.0,
        )
        basis = []
        for axis, (place, size, scale) in enumerate(
            zip(places, SIZES[3:], (a, b, depth / 2.0), strict=True)
        ):
            values = chebvander(place, size - 1)
            if axis == along:
                slope = np.polynomial.chebyshev.chebder(np.eye(size), scl=1.0 / scale)
                values = values[:, : size - 1] @ slope
            basis.append(np.asarray(values, float))
        return Axis.tensor_product(*basis)


Role = Literal["truth", "check", "nominal"]
ROLES: tuple[Role, ...] = ("truth", "check", "nominal")

STANDARD = Block(width_mm=100, length_mm=90, thickness_mm=40)
SHIPPED: dict[Role, Level] = {"truth": "fine", "check": "standard", "nominal": "nominal"}
"""The meshes of the shipped tables."""

MADE: dict[Role, Level] = {"truth": "coarse", "check": "sketch", "nominal": "nominal"}
"""The meshes of other blocks' tables."""

WINDOW, BOX = (0.4, 0.4), (0.48, 0.45, 0.25)
"""Half window over half the block's width and length; half box over the same, and depth over
thickness."""

STEP = 2e-6
"""Coefficients are stored as whole numbers of steps, this share of the largest: displacements are
then 4e-6 off."""

THIN, OBLONG = 4.6, 1.5
"""Largest ratios of a block's longest side to its thickness, and to its other side, for which a
table holds all of w: beyond, its error is above 8e-4 and 2e-3 (twelve blocks)."""

OFF_SIDES, DEEP = (2.0, 1.2), 0.75
"""Of a thin block: distance from its sides of the window and of the box, and the box's depth, over
the thickness. Errors are below 4e-4 (five pads up to 20 thicknesses wide)."""

CHECK = 4.0
"""How many times larger the error may be in a check, that of a coarser and rougher mesh."""

_CASE = ((0.37, -0.59), (0.31, 0.47, 1.0))
"""A load that no table is made of: its place in the window, and its force."""


def _window_of(body: Block) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return half sizes of the window, and half sizes and depth of the box, mm."""
    thickness = body.thickness_mm
    sides = np.array([body.width_mm, body.length_mm]) / 2.0
    window, box, deep = sides * WINDOW, sides * BOX[:2], BOX[2]
    if not _is_compact(body):
        window = np.maximum(window, sides - OFF_SIDES[0] * thickness)
        box = np.maximum(box, sides - OFF_SIDES[1] * thickness)
        deep = DEEP
    return (float(window[0]), float(window[1])), (float(box[0]), float(box[1]), deep * thickness)


def _lies_within(load: Rectangles, window_mm: tuple[float, float]) -> bool:
    """Tell whether patches lie level, and within half sizes of a window."""
    frames = load.frames
    reach = np.abs(load.centre_mm[:, :2]) + (
        load.half_mm[:, :, None] * np.abs(frames[:, :2, :2])
    ).sum(axis=1)
    return bool((frames[:, 2, 2] > 1.0 - 1e-12).all() and (reach <= window_mm).all())


def _is_standard(body: Body) -> bool:
    return isinstance(body, Block) and body.bounds_mm == STANDARD.bounds_mm


def _is_compact(body: Block) -> bool:
    """Return whether a table of the block holds all of w, and not only what the layer leaves."""
    shorter, longer = sorted((body.width_mm, body.length_mm))
    return longer <= min(THIN * body.thickness_mm, OBLONG * shorter)


def _usable(path: Path, most: float) -> Table | None:
    if not path.exists():
        return None
    try:
        table = Table.read(path)
    except InputError as problem:  # the table only saves time, so a damaged one must not stop a run
        warnings.warn(
            f"{problem}; solving without the table, which takes a few seconds longer", stacklevel=2
        )
        return None
    return table if table.error <= most else None


def _axes(window: tuple[float, float], box: tuple[float, float, float]) -> list[Axis]:
    """Return the interpolations in nu, in the force's x and y, and in the point's x, y and z."""
    ends = [(-half, half) for half in (*window, *box[:2])]
    return [
        Axis.chebyshev(size, low, high)
        for size, (low, high) in zip(SIZES, [NU_RANGE, *ends, (0.0, box[2])], strict=True)
    ]


def _mirrored(quarter: Floats) -> Floats:
    """Return (x', y', force, displacement, x, y, z) for all places of the force from those with x',
    y' >= 0: a mirror changes the sign of force and field along its normal."""
    whole = quarter
    for axis, size in ((0, SIZES[1]), (1, SIZES[2])):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        other = (
            np.flip(whole, axis=4 + axis)
            * sign[:, None, None, None, None]
            * sign[:, None, None, None]
        )
        other = np.flip(other, axis=axis)
        keep = size - whole.shape[axis]
        whole = np.concatenate([np.take(other, range(keep), axis=axis), whole], axis=axis)
    return whole


def _kept(count: int) -> Bools:
    """Return which coefficients the two mirror planes allow, of a table of ``count`` terms in
    nu."""
    shape = (count, *SIZES[1:3], 3, 3, *SIZES[3:])
    n, a, b, f, d, i, j, _ = np.ogrid[tuple(slice(size) for size in shape)]
    even_x = (a + i + (f == 0) + (d == 0)) % 2 == 0
    even_y = (b + j + (f == 1) + (d == 1)) % 2 == 0
    return np.broadcast_to(even_x & even_y & (n >= 0), shape)


def _error(table: Table, body: Block, system: TaylorHood) -> float:
    (x, y), force = _CASE
    nu = system.poisson_ratio
    place = np.array([[x * table.window_mm[0], y * table.window_mm[1]]])
    square = Rectangles.at(body, body.surface_from_above(place), table.box_mm[2] / 4.0)
    load = replace(square, force_n=np.array([force]))
    share = np.random.default_rng(1).uniform([-1.0, -1.0, 0.05], 1.0, (200, 3))
    if not _is_compact(body):  # random points miss where a thin block moves most
        share[0] = load.centre_mm[0] / table.box_mm + [0.0, 0.0, 0.05]
    points = share * np.array(table.box_mm)
    solved = Locator(system.mesh).locate(points).values(correction(system, body, [load])[:, :, 0])
    known = halfspace.displacement(points, load, 1.0, nu)
    made = table.at(nu).displacement(PointCache(points), load)
    if (layer := BondedLayer.of(body, nu)) is not None:
        of_layer = layer.displacement(points, load, 1.0)
        known += of_layer
        if _is_compact(body):
            made -= of_layer
    wrong = np.linalg.norm(made - solved, axis=1).max()
    return float(wrong / np.linalg.norm(known + solved, axis=1).max())


def _main(roles: list[str]) -> None:
    """Make the shipped tables of the named roles, all if none is named."""
    for role in ROLES:
        if not roles or role in roles:
            mesh = drawn_to_rim(body_mesh(STANDARD, SHIPPED[role]), STANDARD)
            path = Table.path(STANDARD, role)
            Table.make(STANDARD, mesh).write(path)
            print(f"{path}: {path.stat().st_size} bytes, error {Table.read(path).error:.1e}")


class Tables:
    """The tables of a `Compliance`, each looked for when it is first needed.

    ``use`` says whether tables may be used, or is the one to use, which then has no check.
    """

    def __init__(
        self,
        body: Body,
        poisson_ratio: float,
        *,
        nominal: bool,
        use: bool | Table,
        progress: Progress | None,
    ) -> None:
        self.nominal = nominal
        self._body = body
        self._nu = poisson_ratio
        self._use = use
        self._progress = progress
        self._tried = False

    def covering(self, points: PointCache, load: Rectangles) -> Table.AtNu | None:
        """Return the table that covers a load and these points, if there is one."""
        if self._table is None or not self._table.covers(load, self._nu):
            return None
        return self._at_nu if self._at_nu and self._at_nu.contains(points) else None

    def make_for(self, load: Rectangles) -> None:
        """Make them as `make` does, if they hold for a load."""
        if isinstance(self._body, Block) and _lies_within(load, _window_of(self._body)[0]):
            self.make()

    @property
    def level(self) -> Level:
        """The mesh that the table called ``truth`` is made of."""
        return (SHIPPED if _is_standard(self._body) else MADE)["truth"]

    @property
    def beyond_layer(self) -> bool:
        """Whether the tables leave out the bonded layer's field."""
        return isinstance(self._body, Block) and not _is_compact(self._body)

    @cached_property
    def check(self) -> Table.AtNu | None:
        """The table of a coarser mesh, if there is one."""
        found = self._find("check")
        return found.at(self._nu) if found else None

    @cached_property
    def between(self) -> float:
        """How far Poisson's ratio is from those solved for: 0 at them, 1 in the middle between two
        and at the ends."""
        low, high = NU_RANGE
        if self._table is not None and self._table.poisson_ratio is not None:
            return 0.0
        place = (2.0 * self._nu - low - high) / (high - low)
        return abs(math.cos(SIZES[0] * math.acos(min(max(place, -1.0), 1.0))))

    def make(self) -> None:
        """Make, and keep in the cache, the tables of a block that has none; nothing where they
        would be of no use."""
        low, high = NU_RANGE
        of_use = isinstance(self._body, Block) and low <= self._nu <= high
        if self._table is None and of_use and not self.nominal and not self._tried:
            self._tried = True  # a block that has no table has none, however often it is asked
            if (check := self._find("check", make=True)) is not None:
                made = {"check": check.at(self._nu), "_table": self._find("truth", make=True)}
                self.__dict__.update(made)
                self.__dict__.pop("_at_nu", None)

    @cached_property
    def _table(self) -> Table | None:
        return self._find("nominal" if self.nominal else "truth")

    @cached_property
    def _at_nu(self) -> Table.AtNu | None:
        return self._table.at(self._nu) if self._table else None

    def _find(self, role: Role, make: bool = False) -> Table | None:
        if isinstance(self._use, Table):
            return self._use if role != "check" else None
        if not self._use:
            return None
        return Table.find(
            self._body, role, poisson_ratio=self._nu, make=make, progress=self._progress
        )


NARROW, FEW, MANY = 1.7, 4, 6
"""Tables of a range whose ends differ by less than the first factor, and of wider ones: even
numbers, so that none is the middle, where the shipped table of a finer mesh may be."""

GOOD = 1e-3
"""Largest error of the displacement with which a table between tables is used."""

REST = 0.3
"""Largest share of w in a marker's displacement, roughly."""

WIDEST = 3.0
"""Largest ratio of the thicknesses of a range."""


@lru_cache(maxsize=8)
def _tables(
    width_mm: float, length_mm: float, role: Role, low_mm: float, high_mm: float
) -> tuple[Floats, str, float] | None:
    """Return the coefficients of a range as polynomials in the thickness, the mesh's digest and the
    error to expect."""
    tables = []
    thicknesses = Axis.chebyshev(FEW if high_mm <= NARROW * low_mm else MANY, low_mm, high_mm)
    for thickness in thicknesses.nodes:
        body = Block(width_mm=width_mm, length_mm=length_mm, thickness_mm=float(thickness))
        table = Table.find(body, role, make=True, usable=GOOD)
        if table is None:
            return None
        tables.append(table)
    modes = thicknesses.coefficients(np.stack([table.coefficients for table in tables]))
    # what the next polynomial would add is about as much less than the last as that is than the one
    # before
    last, before = (float(np.abs(m).max()) for m in (modes[-1], modes[-2]))
    error = max(t.error for t in tables) + REST * last * min(1.0, last / before) / float(
        np.abs(modes[0]).max()
    )
    return (modes, tables[0].digest, error) if error <= GOOD else None


if __name__ == "__main__":
    _main(sys.argv[1:])
