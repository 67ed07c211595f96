"""The smooth rest of a block, tabulated: presses on it need no mesh and no solve at all.

On a flat face the rest w of a point force varies smoothly with the force's place, the point's place and nu. So it is
kept as the coefficients of a product of Chebyshev polynomials T_n(nu) T_a(x') T_b(y') T_i(x) T_j(y) T_k(z), (x', y')
the force's place in a window of the sensing face, (x, y, z) the point's in a box under it. The block's two mirror
planes kill three coefficients of four. `twin.world.elasticity.tabulate` makes tables and finds them.

Validity: forces in the window, points in the box, nu in [0, 0.5], the block and mesh that the table was made of;
`Table.covers` says so, and everything else is solved.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from twin.arrays import Floats, Points
from twin.compiled import njit
from twin.parts.load import Rectangles

NU_RANGE = (0.0, 0.5)
SIZES = (5, 5, 5, 8, 8, 5)
"""Numbers of polynomials in nu, in the force's x and y, and in the point's x, y and z."""

MANY_LOADS = 25
"""Loads at the same points from which on the table is worth a product with the points' polynomials."""

_GAUSS = np.polynomial.legendre.leggauss(3)
_MIDDLE = np.polynomial.legendre.leggauss(1)
"""Nodes and weights along each side of a rectangle."""


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
        Largest difference to a solve on that mesh over the largest displacement, under a load it was not made of.
    """

    coefficients: Floats
    window_mm: tuple[float, float]
    box_mm: tuple[float, float, float]
    digest: str
    error: float

    def covers(self, load: Rectangles, poisson_ratio: float) -> bool:
        """Tell whether the table holds for these forces and nu, at points of its box."""
        frames = load.frames
        reach = np.abs(load.centre_mm[:, :2]) + (load.half_mm[:, :, None] * np.abs(frames[:, :2, :2])).sum(axis=1)
        flat = bool((frames[:, 2, 2] > 1.0 - 1e-12).all())
        return flat and NU_RANGE[0] <= poisson_ratio <= NU_RANGE[1] and bool((reach <= self.window_mm).all())

    def at(self, poisson_ratio: float) -> TableAtNu:
        """Return the table of one nu."""
        low, high = NU_RANGE
        place = (2.0 * poisson_ratio - low - high) / (high - low)
        weight = chebvander(np.array([place]), SIZES[0] - 1)[0]
        coefficients = np.tensordot(weight, self.coefficients, axes=1)
        return TableAtNu(coefficients=coefficients, window_mm=self.window_mm, box_mm=self.box_mm)


@dataclass(kw_only=True, eq=False)
class Basis:
    """The products of the point polynomials at n points, computed once for as many loads as there are.

    Attributes
    ----------
    points, box_mm
        (n, 3) points, and the table's box.
    often
        Whether it is known beforehand that many loads will be asked about.
    inside
        Whether all points are in the box.
    values
        (n, x y z).
    slopes
        Three of (n, x y z), along x, y and z, 1/mm; made when first needed.
    """

    points: Points
    box_mm: tuple[float, float, float]
    often: bool = False
    _readings: dict[TableAtNu, Floats] = field(default_factory=dict)
    _loads: int = 0

    def reading(self, table: TableAtNu, loads: int = 1) -> Floats | None:
        """Return the (3 n, x' y' force axis) means to read a table at the points; None as long as it doesn't pay."""
        self._loads += loads
        if table not in self._readings and (self.often or self._loads > MANY_LOADS):
            self._readings[table] = (self.values @ table.by_point).reshape(3 * len(self.points), -1)
        return self._readings.get(table)

    @cached_property
    def inside(self) -> bool:
        sideways, depth = np.abs(self.points[:, :2]), self.points[:, 2]
        return bool((sideways <= self.box_mm[:2]).all() and (depth <= self.box_mm[2]).all())

    @cached_property
    def values(self) -> Floats:
        return self._products(None)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats, Floats]:
        return self._products(0), self._products(1), self._products(2)

    def _products(self, along: int | None) -> Floats:
        a, b, depth = self.box_mm
        places = (self.points[:, 0] / a, self.points[:, 1] / b, 2.0 * self.points[:, 2] / depth - 1.0)
        basis = []
        for axis, (place, size, scale) in enumerate(zip(places, SIZES[3:], (a, b, depth / 2.0), strict=True)):
            values = chebvander(place, size - 1)
            if axis == along:
                slope = np.polynomial.chebyshev.chebder(np.eye(size), scl=1.0 / scale)
                values = values[:, : size - 1] @ slope
            basis.append(values)
        across = basis[0][:, :, None] * basis[1][:, None, :]
        products = across[:, :, :, None] * basis[2][:, None, None, :]
        return np.ascontiguousarray(products.reshape(len(self.points), across[0].size * SIZES[5]))


@dataclass(frozen=True, kw_only=True, eq=False)
class TableAtNu:
    """`Table` at one nu: (x', y', force axis, displacement axis, x, y, z)."""

    coefficients: Floats
    window_mm: tuple[float, float]
    box_mm: tuple[float, float, float]

    def displacement(self, points: Basis, load: Rectangles) -> Points:
        """Return (n, 3) w in mm for E = 1 MPa."""
        moments = self._moments(load)
        reading = points.reading(self)
        if reading is not None:
            return (reading @ moments).reshape(-1, 3)
        return points.values @ (moments @ self._by_load).reshape(-1, 3)

    def gradient(self, points: Basis, load: Rectangles) -> Floats:
        """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa."""
        field = (self._moments(load) @ self._by_load).reshape(-1, 3)
        return np.stack([slope @ field for slope in points.slopes], axis=2)

    def rests(self, points: Basis, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at the points for E = 1 MPa per unit force on each rectangle."""
        k = len(rectangles)
        reading = points.reading(self, k)
        if reading is None:
            reading = (points.values @ self.by_point).reshape(3 * len(points.points), -1)
        # one product of three times the work, for turning its result's axes would take longer
        loads = np.einsum("ka,fg->afkg", self._load_basis(rectangles), np.eye(3)).reshape(-1, 3 * k)
        return np.asarray(reading @ loads).reshape(-1, 3, k, 3)

    def normal_rests(self, rectangles: Rectangles) -> Floats:
        """Return (k, k): w along z in the middles of rectangles per unit force along z on each, for E = 1 MPa."""
        at = rectangles.centre_mm[:, :2] / self.box_mm[:2]
        x, y = (chebvander(at[:, axis], SIZES[3 + axis] - 1) for axis in range(2))
        points = (x[:, :, None] * y[:, None, :]).reshape(len(at), -1)
        return np.asarray(points @ self._on_face @ self._load_basis(rectangles).T)

    def _moments(self, load: Rectangles) -> Floats:
        """Return (x' y' force axis) the load's moments."""
        return np.asarray(self._load_basis(load).T @ load.force_n).ravel()

    @cached_property
    def _on_face(self) -> Floats:
        """(x y, x' y') what normal forces do along z at z = 0, where T_k is 1 and -1 by turns."""
        signs = np.where(np.arange(SIZES[5]) % 2, -1.0, 1.0)
        onto = self.coefficients[:, :, 2, 2] @ signs
        return np.ascontiguousarray(onto.transpose(2, 3, 0, 1).reshape(SIZES[3] * SIZES[4], -1))

    @cached_property
    def _by_load(self) -> Floats:
        """Return (x' y' force axis, x y z displacement axis)."""
        count = self.coefficients.shape[0] * self.coefficients.shape[1] * 3
        return np.ascontiguousarray(self.coefficients.transpose(0, 1, 2, 4, 5, 6, 3).reshape(count, -1))

    @cached_property
    def by_point(self) -> Floats:
        """Return (x y z, displacement axis x' y' force axis)."""
        ordered = self.coefficients.transpose(4, 5, 6, 3, 0, 1, 2)
        return np.ascontiguousarray(ordered.reshape(int(np.prod(ordered.shape[:3])), -1))

    def _load_basis(self, load: Rectangles) -> Floats:
        """Return (k, x' y') means of the polynomials over each rectangle, by 3 x 3 Gauss points; of points by one."""
        out = np.empty((len(load), SIZES[1], SIZES[2]))
        # copies have one type each, whether what they were made of was writable or contiguous: compiled once
        centre, frames, half = (np.array(each, order="C") for each in (load.centre_mm, load.frames, load.half_mm))
        _means(centre, frames, half, self.window_mm, _GAUSS if half.any() else _MIDDLE, out)
        return out.reshape(len(load), -1)


@njit(cache=True)
def _means(
    centre: Floats, frames: Floats, half: Floats, window: tuple[float, float], nodes: tuple[Floats, Floats], out: Floats
) -> None:
    """Set ``out`` (k, x', y') to the means of the products T_a(x') T_b(y') over each rectangle."""
    most = max(out.shape[1], out.shape[2], 2)
    values = np.ones((2, most))
    for t in range(len(centre)):
        out[t] = 0.0
        for i in range(len(nodes[0])):
            for j in range(len(nodes[0])):
                for axis in range(2):
                    side = nodes[0][i] * half[t, 0] * frames[t, 0, axis] + nodes[0][j] * half[t, 1] * frames[t, 1, axis]
                    place = (centre[t, axis] + side) / window[axis]
                    values[axis, 1] = place
                    for n in range(2, most):
                        values[axis, n] = 2.0 * place * values[axis, n - 1] - values[axis, n - 2]
                weight = nodes[1][i] * nodes[1][j] / 4.0
                for a in range(out.shape[1]):
                    for b in range(out.shape[2]):
                        out[t, a, b] += weight * values[0, a] * values[1, b]
