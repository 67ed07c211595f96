"""The smooth rest of a block, tabulated: presses on it need no mesh and no solve at all.

On a flat face the rest w of a point force varies smoothly with the force's place, the point's place and nu. So it is
kept as the coefficients of a product of Chebyshev polynomials T_n(nu) T_a(x') T_b(y') T_i(x) T_j(y) T_k(z), (x', y')
the force's place in a window of the sensing face, (x, y, z) the point's in a box under it. The block's two mirror
planes kill three coefficients of four. `twin.world.tabulate` makes tables and finds them.

Validity: forces in the window, points in the box, nu in [0, 0.5], the block and mesh that the table was made of;
`Table.covers` says so, and everything else is solved.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from twin.arrays import Floats, Points
from twin.parts.load import Rectangles

NU_RANGE = (0.0, 0.5)
SIZES = (5, 5, 5, 8, 8, 5)
"""Numbers of polynomials in nu, in the force's x and y, and in the point's x, y and z."""

_GAUSS = np.polynomial.legendre.leggauss(3)
_NODES = np.stack(np.meshgrid(_GAUSS[0], _GAUSS[0], indexing="ij"), axis=-1).reshape(-1, 2)
_WEIGHTS = np.outer(_GAUSS[1], _GAUSS[1]).ravel() / 4.0
"""Gauss points of a square, and weights that sum to one."""


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

    def covers(self, points: Points, load: Rectangles, poisson_ratio: float) -> bool:
        """Tell whether the table holds for these points, forces and nu."""
        reach = np.abs(load.centre_mm[:, :2]) + np.einsum("ks,ksi->ki", load.half_mm, np.abs(load.frames[:, :2, :2]))
        flat = bool(np.all(load.frames[:, 2, 2] > 1.0 - 1e-12))
        return bool(
            flat
            and NU_RANGE[0] <= poisson_ratio <= NU_RANGE[1]
            and (reach <= self.window_mm).all()
            and (np.abs(points[:, :2]) <= self.box_mm[:2]).all()
            and (points[:, 2] <= self.box_mm[2]).all()
        )

    def at(self, poisson_ratio: float) -> TableAtNu:
        """Return the table of one nu."""
        low, high = NU_RANGE
        place = (2.0 * poisson_ratio - low - high) / (high - low)
        weight = chebvander(np.array([place]), SIZES[0] - 1)[0]
        coefficients = np.tensordot(weight, self.coefficients, axes=1)
        return TableAtNu(coefficients=coefficients, window_mm=self.window_mm, box_mm=self.box_mm)


@dataclass(frozen=True, kw_only=True)
class Basis:
    """The products of the point polynomials at n points, computed once for as many loads as there are.

    Attributes
    ----------
    values
        (n, x y z).
    slopes
        Three of (n, x y z), along x, y and z, 1/mm; made when first needed.
    """

    points: Points
    box_mm: tuple[float, float, float]

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
        return (across[:, :, :, None] * basis[2][:, None, None, :]).reshape(len(self.points), -1)


@dataclass(frozen=True, kw_only=True)
class TableAtNu:
    """`Table` at one nu: (x', y', force axis, displacement axis, x, y, z)."""

    coefficients: Floats
    window_mm: tuple[float, float]
    box_mm: tuple[float, float, float]

    def basis(self, points: Points) -> Basis:
        """Return what the table needs to know of ``points`` (n, 3)."""
        return Basis(points=points, box_mm=self.box_mm)

    def displacement(self, points: Basis, load: Rectangles) -> Points:
        """Return (n, 3) w in mm for E = 1 MPa."""
        return points.values @ self._field(load)

    def gradient(self, points: Basis, load: Rectangles) -> Floats:
        """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa."""
        field = self._field(load)
        return np.stack([slope @ field for slope in points.slopes], axis=2)

    def rests(self, points: Basis, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at the points for E = 1 MPa per unit force on each rectangle."""
        of_points = points.values @ self._by_point
        of_points = of_points.reshape(len(points.points), 9, -1)
        out = of_points @ self._load_basis(rectangles).T
        return np.ascontiguousarray(out.reshape(len(points.points), 3, 3, -1).transpose(0, 1, 3, 2))

    def _field(self, load: Rectangles) -> Floats:
        """Return (x y z, 3) coefficients of the load's field."""
        moments = self._load_basis(load).T @ load.force_n
        return (moments.ravel() @ self._by_load).reshape(3, -1).T

    @cached_property
    def _by_load(self) -> Floats:
        """Return (x' y' force axis, displacement axis x y z)."""
        count = self.coefficients.shape[0] * self.coefficients.shape[1] * 3
        return self.coefficients.reshape(count, -1)

    @cached_property
    def _by_point(self) -> Floats:
        """Return (x y z, displacement axis force axis x' y')."""
        ordered = self.coefficients.transpose(4, 5, 6, 3, 2, 0, 1)
        return np.ascontiguousarray(ordered.reshape(int(np.prod(ordered.shape[:3])), -1))

    def _load_basis(self, load: Rectangles) -> Floats:
        """Return (k, x' y') means of the polynomials over each rectangle, by 3 x 3 Gauss points."""
        offsets = _NODES[None] * load.half_mm[:, None]
        places = load.centre_mm[:, None, :2] + offsets @ load.frames[:, :2, :2]
        a = chebvander(places[..., 0] / self.window_mm[0], SIZES[1] - 1)
        b = chebvander(places[..., 1] / self.window_mm[1], SIZES[2] - 1)
        basis: Floats = np.einsum("kqa,kqb->kab", a * _WEIGHTS[:, None], b)
        return basis.reshape(len(load), -1)
