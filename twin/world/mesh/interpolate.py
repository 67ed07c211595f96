"""Values of nodal fields at any point of a body, and a smoother recovery of them.

`Locator` finds the element that holds a point. `Recovery` fits a cubic polynomial to the nodal
values around a point by weighted least squares and evaluates it there: patch recovery (O. C.
Zienkiewicz and J. Z. Zhu 1992), of values as in Z. Zhang and A. Naga (2005). Quadratic elements are
wrong by a cubic, so the difference of the two estimates the elements' own error at that place.

Validity of that estimate: it does not see what all elements have wrong together (the singularity of
a clamped rim moves whole regions alike), nor anything narrower than a few elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, Points, frozen
from twin.errors import MeshError
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh, inverses, shapes

_CANDIDATES = (4, 24, 400)
"""How many of the nearest elements are tried: first for all points, then for those not yet
found."""

_HAIR, _WITHIN = 5e-3, 1e-9
"""How far outside its element, over the element's size, a point may be read from it: beyond the
body's own surface, as the true surface is that far from the mesh's, and beyond any other face,
where a neighbour holds it."""

_FAR = -0.7
"""An element is not tried where a point's smallest barycentric coordinate would be less than this,
were the element's edges straight."""

_FLAT = 1e-13
"""An element whose map bends by no more than this over its size is straight: its map is inverted by
one product, wrong by rounding only."""

_NEIGHBOURS, _NARROW = 90, 2.0
"""Nodes that a cubic is fitted to, and how fast their weight falls: exp(-(NARROW r)^2), r = 1 at
the farthest."""

_POWERS = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3])
"""(20, 3) powers of x, y and z in a cubic; the first is 1."""

_SINGULAR = 1e-10
"""Directions of the fit that weigh less than this share of the heaviest are left out: in thin walls
the nodes lie in few planes and determine no cubic across them."""

_CHUNK = 512
"""Points that are worked on at once."""


class Recovery:
    """Smoother readings of fields on one mesh; built once per mesh."""

    @dataclass(frozen=True, kw_only=True)
    class Weighted:
        """Sums of nodal values, one for every point.

        Attributes
        ----------
        nodes
            (n, k) nodes that a point's sum is made of: of its element (k = 10), or around it.
        weights
            (n, k) what they count: a field's value is their product.
        """

        nodes: Ints
        weights: Floats

        def values(self, field: Floats) -> Floats:
            """Return (n, ...) values of the nodal ``field`` (N, ...)."""
            flat = field.reshape(len(field), -1)
            return np.asarray(self.matrix(len(field)) @ flat).reshape(
                len(self.nodes), *field.shape[1:]
            )

        def matrix(self, nodes: int) -> Any:
            """Return the (n, nodes) sparse matrix that takes a nodal field to the points."""
            from scipy.sparse import csr_matrix

            rows = np.arange(len(self.nodes) + 1) * self.nodes.shape[1]
            return csr_matrix(
                (self.weights.ravel(), self.nodes.ravel(), rows), shape=(len(self.nodes), nodes)
            )

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self._nodes = mesh.points
        self._tree = cKDTree(mesh.points)

    def at(self, points: Points) -> Recovery.Weighted:
        """Return what reads the cubics at ``points`` (n, 3) mm."""
        away, nodes = self._tree.query(points, min(_NEIGHBOURS, len(self._nodes)))
        weights = np.empty(nodes.shape)
        for start in range(0, len(points), _CHUNK):
            part = slice(start, start + _CHUNK)
            reach = away[part, -1:]
            weights[part] = _read(
                (self._nodes[nodes[part]] - points[part, None]) / reach[..., None],
                away[part] / reach,
            )
        return Recovery.Weighted(nodes=nodes, weights=weights)


class Locator:
    """Finds points in a mesh; built once per mesh."""

    @dataclass(frozen=True, kw_only=True)
    class Places(Recovery.Weighted):
        """Points located in a mesh: ``weights`` are the shape functions of each point's element.

        Attributes
        ----------
        slopes
            (n, 10, 3) gradients of the shape functions, 1/mm.
        """

        slopes: Floats

        def gradients(self, field: Floats) -> Floats:
            """Return (n, ..., 3) gradients of the nodal ``field`` (N, ...), 1/mm."""
            out: Floats = np.einsum("qam,qa...->q...m", self.slopes, field[self.nodes])
            return out

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self._mesh = mesh
        corners = mesh.points[mesh.tets[:, :4]]
        centre = corners.mean(axis=1)
        self._tree = cKDTree(centre)
        self._reach = 1.2 * np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        self._straight = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
        self._first = corners[:, 0]
        nodes = mesh.points[mesh.tets]
        slopes = shapes(np.vstack([np.zeros(3), np.eye(3)]))[1]
        self._linear = np.einsum("mai,aj->mij", nodes, slopes[0])
        self._bend = np.einsum("mai,kaj->mijk", nodes, slopes[1:] - slopes[0])
        size = np.abs(self._linear).max(axis=(1, 2))
        self._curved = np.abs(self._bend).max(axis=(1, 2, 3)) > _FLAT * size
        outer = np.zeros(len(mesh.points), bool)
        outer[mesh.faces] = True
        opposite = [[4 + e for e, edge in enumerate(TET_EDGES) if a not in edge] for a in range(4)]
        self._outer = np.stack(
            [outer[mesh.tets[:, middles]].all(axis=1) for middles in opposite], axis=1
        )

    def edges(self, points: Points) -> Floats:
        """Return (n,) the edge, mm, of a regular tetrahedron as large as the element nearest to
        each of ``points``."""
        corners = self._mesh.points[self._mesh.tets[self._tree.query(points)[1], :4]]
        volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
        return np.asarray(np.cbrt(6.0 * np.sqrt(2.0) * volume))

    def locate(self, points: Points) -> Locator.Places:
        """Return where ``points`` (n, 3) are.

        A point in no element (a hair outside the mesh) belongs to the element in which its smallest
        barycentric coordinate is largest.

        Raises
        ------
        MeshError
            A point is outside every element by more than a tenth of the element's size.
        """
        mesh, points = self._mesh, np.ascontiguousarray(points, float)
        best = np.zeros(len(points), np.int64)
        local = np.zeros((len(points), 3))
        inside = np.full(len(points), -np.inf)
        left = np.arange(len(points))
        for number in _CANDIDATES:
            step = max(1, 24 * _CHUNK // number)
            for part in (left[k : k + step] for k in range(0, len(left), step)):
                best[part], local[part], inside[part] = self._nearest_best(points[part], number)
            share = np.column_stack([1.0 - local.sum(axis=1), local])
            hair = self._outer[best, share.argmin(axis=1)] & (number > _CANDIDATES[0])
            left = np.flatnonzero(inside < np.where(hair, -_HAIR, -_WITHIN))
            if len(left) == 0:
                break
        if np.any(inside < -0.1):
            first = int(np.argmin(inside))
            raise MeshError(
                f"no element of the mesh holds the point {points[first]} mm: rebuild the mesh"
            )
        values, slopes = shapes(local)
        nodes = mesh.tets[best]
        jacobian = np.einsum("qai,qaj->qij", mesh.points[nodes], slopes)
        slopes = slopes @ inverses(jacobian)[0]
        return Locator.Places(nodes=nodes, weights=frozen(values), slopes=frozen(slopes))

    def _nearest_best(self, points: Points, number: int) -> tuple[Ints, Floats, Floats]:
        """Return the first of the ``number`` nearest elements that holds each point, else the least
        wrong one; local coordinates (n, 3); the smallest barycentric coordinate (n,)."""
        number = min(number, len(self._mesh.tets))
        away, near = self._tree.query(points, np.arange(1, number + 1))
        row, rank = np.nonzero(away <= self._reach[near])
        tets = near[row, rank]
        away_mm = points[row] - self._first[tets]
        start = np.einsum("pij,pj->pi", self._straight[tets], away_mm)
        hopeful = _least_barycentric(start) >= _FAR
        row, rank, tets, start = row[hopeful], rank[hopeful], tets[hopeful], start[hopeful]
        away_mm = away_mm[hopeful]
        local = np.zeros((*near.shape, 3))
        inside = np.full(near.shape, -np.inf)
        found, least = start, _least_barycentric(start)
        bent = np.flatnonzero(self._curved[tets])
        of = tets[bent]
        found[bent], least[bent] = _invert_maps(
            away_mm[bent], self._linear[of], self._bend[of], start[bent]
        )
        local[row, rank], inside[row, rank] = found, least
        holds = inside >= -_WITHIN
        chosen = np.where(holds.any(axis=1), holds.argmax(axis=1), inside.argmax(axis=1))
        every = np.arange(len(points))
        return near[every, chosen], local[every, chosen], inside[every, chosen]


def _least_barycentric(local: Floats) -> Floats:
    """Return (p,) the smallest barycentric coordinates at local coordinates (p, 3)."""
    return np.asarray(np.minimum(local.min(axis=1), 1.0 - local.sum(axis=1)))


def _invert_maps(
    points: Points, linear: Floats, bend: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Return local coordinates (p, 3) of points in quadratic elements by Newton's method, and the
    smallest barycentric coordinates (p,), -inf where it runs away.

    Parameters
    ----------
    points
        (p, 3) places less the element's first corner, mm.
    linear, bend
        (p, 3, 3) and (p, 3, 3, 3): local coordinates r lie at ``linear`` r + ``bend`` r r / 2.
    start
        (p, 3) first guess.
    """
    local = start.copy()
    inside = np.full(len(points), -np.inf)
    left = np.arange(len(points))
    # points are last here: a sum over axes is then a few operations on long rows
    to, at = np.ascontiguousarray(points.T), np.ascontiguousarray(start.T)
    straight = np.ascontiguousarray(linear.transpose(2, 1, 0))
    curved = np.ascontiguousarray(bend.transpose(3, 2, 1, 0))
    for _ in range(12):
        turn = curved[0] * at[0]
        turn += curved[1] * at[1]
        turn += curved[2] * at[2]
        slope = straight + turn
        turn *= 0.5
        turn += straight
        away = to - turn[0] * at[0] - turn[1] * at[1] - turn[2] * at[2]
        step = _solved(slope, away)
        at = at + step
        local[left] = at.T
        least = np.minimum(at.min(axis=0), 1.0 - at.sum(axis=0))
        done = np.abs(step).max(axis=0) < 1e-12
        inside[left[done]] = least[done]
        going = ~done & (least >= -5.0)
        if not going.any():
            break
        left, least, at, to = left[going], least[going], at[:, going], to[:, going]
        straight, curved = straight[..., going], curved[..., going]
    else:
        inside[left] = least
    return local, inside


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def _solved(columns: Floats, right: Floats) -> Floats:
    """Return the solutions (3, p) of 3 x 3 systems with ``columns`` (3, 3, p), columns first, by
    cofactors; inf or NaN where singular."""
    after, before = columns[_NEXT], columns[_LAST]
    cofactor = after[:, _NEXT] * before[:, _LAST]
    cofactor -= after[:, _LAST] * before[:, _NEXT]
    determinant = (columns[0] * cofactor[0]).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):  # such an element is given up
        return np.asarray((cofactor * right).sum(axis=1) / determinant)


def _read(places: Floats, away: Floats) -> Floats:
    """Return (n, k) weights of the nodes at ``places`` (n, k, 3), so far ``away`` (n, k), in the
    cubic's value at 0."""
    terms = np.prod(places[:, :, None] ** _POWERS, axis=3)
    weighted = terms * np.exp(-2.0 * (_NARROW * away) ** 2)[..., None]
    normal = np.linalg.pinv(terms.transpose(0, 2, 1) @ weighted, rcond=_SINGULAR, hermitian=True)
    return np.asarray(np.einsum("nkp,np->nk", weighted, normal[:, 0]))
