"""Tensor-product interpolation: a basis of functions along each axis, and their products.

Corrections are smooth in the force's place, the point's place, nu and a block's thickness, so each
is solved at a few nodes and interpolated. One `Axis` interpolates along one of these: block tables
have Chebyshev polynomials (`chebyshev`); regions and contact lattices have Lagrange's polynomials
of Chebyshev nodes (`lagrange`); surface tables, which have more nodes, cubic B-splines (`splines`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.arrays import Floats

SIZES = (5, 5, 5, 8, 8, 5)
"""Numbers of a block table's polynomials in nu, in the force's x and y, and in the point's x, y and
z."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Axis:
    """Interpolation along one axis.

    Attributes
    ----------
    nodes
        (n,) places whose values are interpolated.
    basis
        Takes places (k,) to the values (k, n) of the n basis functions there.
    """

    nodes: Floats
    basis: Callable[[Floats], Floats]

    @classmethod
    def chebyshev(cls, count: int, low: float = -1.0, high: float = 1.0) -> Axis:
        """Return the interpolation by ``count`` Chebyshev polynomials from ``low`` to ``high``."""

        def basis(places: Floats) -> Floats:
            return np.asarray(chebvander((2.0 * places - low - high) / (high - low), count - 1))

        return cls(nodes=(low + high + (high - low) * chebpts1(count)) / 2.0, basis=basis)

    @classmethod
    def lagrange(cls, nodes: Floats) -> Axis:
        """Return the interpolation whose coefficients are the values at the nodes themselves."""
        between = nodes[:, None] - nodes[None, :]
        np.fill_diagonal(between, 1.0)
        index = np.arange(len(nodes))

        def basis(places: Floats) -> Floats:
            ratio = (places[:, None, None] - nodes[None, None, :]) / between
            ratio[:, index, index] = 1.0
            return np.asarray(ratio.prod(axis=2))

        return cls(nodes=nodes, basis=basis)

    @classmethod
    def splines(cls, nodes: Floats) -> Axis:
        """Return the interpolation by the cubic B-splines whose knots are the nodes, without the
        second and the last but one ("not a knot")."""
        from scipy.interpolate import BSpline

        knots = np.concatenate([np.full(4, nodes[0]), nodes[2:-2], np.full(4, nodes[-1])])
        return cls(nodes=nodes, basis=BSpline(knots, np.eye(len(nodes)), 3))

    def from_nodes(self) -> Floats:
        """Return the (n, n) matrix that takes values at the nodes to the basis' coefficients."""
        return np.asarray(np.linalg.inv(self.basis(self.nodes)))

    def coefficients(self, values: Floats, axis: int = 0) -> Floats:
        """Return coefficients in place of the nodes' values along one axis of an array."""
        return np.moveaxis(np.tensordot(self.from_nodes(), values, axes=(1, axis)), 0, axis)

    @staticmethod
    def tensor_product(*factors: Floats) -> Floats:
        """Return the (k, a b ...) products of basis functions (k, a), (k, b), ... at k places, the
        last axis running fastest."""
        product = factors[0]
        for factor in factors[1:]:
            product = (product[:, :, None] * factor[:, None, :]).reshape(len(factor), -1)
        return product
