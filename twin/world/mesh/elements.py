"""Quadratic tetrahedra and triangles: numbering, shape functions and quadrature.

Nodes are in VTK's order: corners, then the middles of the edges `TET_EDGES` or `TRIANGLE_EDGES`.
The reference element has its corners at the origin and at the ends of the axes.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats, Ints, Points, grid_points

TET_EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])
TRIANGLE_EDGES = np.array([(0, 1), (1, 2), (2, 0)])

TET_FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
"""Corners of a positive tetrahedron's faces; right-hand normals point out of it."""

_KUHN = np.array(
    [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]
)
"""Six tetrahedra of a unit cube whose corner (i, j, k) has number i + 2 j + 4 k."""


def kuhn_grid(x: Floats, y: Floats, z: Floats) -> tuple[Points, Ints]:
    """Return the (n, 3) points of a grid on rising coordinates, and positive tetrahedra (m, 4), six
    for every cell."""
    number = np.arange(len(x) * len(y) * len(z)).reshape(len(x), len(y), len(z))
    nx, ny, nz = np.array(number.shape) - 1
    cube = np.stack(
        [
            number[i : i + nx, j : j + ny, k : k + nz].ravel()
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ],
        axis=1,
    )
    return grid_points(x, y, z), cube[:, _KUHN].reshape(-1, 4).astype(np.int64)


def signed_volumes(points: Points, tets: Ints) -> Floats:
    """Return the (m,) signed volumes, mm3, of straight tetrahedra (m, 4 or more; the first four
    nodes count)."""
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6)


def inverses(matrices: Floats) -> tuple[Floats, Floats]:
    """Return the inverses (..., 3, 3) of matrices by cofactors, and their determinants (...).

    Unlike LAPACK's, they scale exactly with powers of two; inf or NaN where singular.
    """
    a, b, c = np.moveaxis(matrices, -1, 0)
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    determinant = np.einsum("...i,...i->...", a, rows[..., 0, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        return rows / determinant[..., None, None], determinant


def shapes(places: Floats) -> tuple[Floats, Floats]:
    """Return the values (q, n) and gradients (q, n, axes) of the shape functions at reference
    ``places`` (q, axes): of a tetrahedron (3 axes, n = 10) or a triangle (2 axes, n = 6)."""
    edges = TET_EDGES if places.shape[1] == 3 else TRIANGLE_EDGES
    axes = places.shape[1]
    share = np.column_stack([1.0 - places.sum(axis=1), places])
    slope = np.vstack([-np.ones(axes), np.eye(axes)])
    a, b = edges.T
    values = np.hstack([share * (2.0 * share - 1.0), 4.0 * share[:, a] * share[:, b]])
    corner = (4.0 * share - 1.0)[:, :, None] * slope
    middle = 4.0 * (share[:, a, None] * slope[b] + share[:, b, None] * slope[a])
    return values, np.concatenate([corner, middle], axis=1)


def quadrature(axes: int) -> tuple[Floats, Floats]:
    """Return places (q, axes) and weights (q,) of a rule exact to degree 5: in a tetrahedron (3
    axes, 14 places, N. J. Walkington 2000) or a triangle (2 axes, 7 places, J. Radon 1948)."""
    if axes == 2:
        return _in_triangle()
    places, weights = [], []
    for a, weight in (
        (0.31088591926330060980, 0.11268792571801585080),
        (0.092735250310891226402, 0.073493043116361949544),
    ):
        for i in range(4):
            share = np.full(4, a)
            share[i] = 1.0 - 3.0 * a
            places.append(share[1:])
            weights.append(weight / 6.0)
    a, weight = 0.045503704125649649492, 0.042546020777081466438
    for i, j in TET_EDGES:
        share = np.full(4, a)
        share[[i, j]] = 0.5 - a
        places.append(share[1:])
        weights.append(weight / 6.0)
    return np.array(places), np.array(weights)


def _in_triangle() -> tuple[Floats, Floats]:
    root = np.sqrt(15.0)
    places, weights = [[1 / 3, 1 / 3]], [0.225 / 2]
    for sign in (-1.0, 1.0):
        a, weight = (6.0 + sign * root) / 21.0, (155.0 + sign * root) / 2400.0
        places += [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a]]
        weights += [weight] * 3
    return np.array(places), np.array(weights)


def boundary_triangles(tets: Ints) -> Ints:
    """Return the (f, 3) faces that belong to one tetrahedron only, right-hand normals pointing
    out."""
    faces = tets[:, TET_FACES].reshape(-1, 3)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(faces[np.sort(first[count == 1])])
