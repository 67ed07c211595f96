"""Reading nodal fields at any point of a body: which element holds it, and where in the element."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, Points, frozen
from twin.compiled import njit
from twin.errors import MeshError, OutOfBodyError
from twin.parts.body import Body
from twin.world.mesh.elements import TET_EDGES, tet_shapes
from twin.world.mesh.mesh import Mesh

CANDIDATES = (24, 400)
"""How many of the nearest elements are tried, first for all points, then for those not yet found."""

HAIR, WITHIN = 5e-3, 1e-9
"""How far outside its element, over the element's size, a point may be read from it: beyond the body's own surface, as
the true surface is that far from the mesh's, and beyond any other face, where a neighbour holds it."""

FAR = -0.7
"""A point whose smallest barycentric coordinate in an element would be less than this, were the element's edges
straight, is not looked for in it any further."""

FORGIVEN = 1e-6
"""How far outside the body, in mm, a point still counts as on its surface."""


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
        return np.asarray(self.matrix(len(field)) @ flat).reshape(len(self.nodes), *field.shape[1:])

    def matrix(self, nodes: int) -> Any:
        """Return the (n, nodes) sparse matrix that takes a nodal field to the points."""
        from scipy.sparse import csr_matrix

        rows = np.arange(len(self.nodes) + 1) * self.nodes.shape[1]
        return csr_matrix((self.weights.ravel(), self.nodes.ravel(), rows), shape=(len(self.nodes), nodes))


@dataclass(frozen=True, kw_only=True)
class Places(Weighted):
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


def require_inside(body: Body, points: Points) -> None:
    """Raise `OutOfBodyError`, naming the first offender, unless ``points`` (n, 3) are all in the body or on it."""
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise OutOfBodyError(f"points must have the shape (n, 3), got {points.shape}")
    distances = body.piece_distances(points)
    outside = ~(np.min(distances, axis=1) >= -FORGIVEN)
    if not np.any(outside):
        return
    first = int(np.argmax(outside))
    piece = int(np.argmin(distances[first]))
    place = ", ".join(f"{c:.4g}" for c in points[first])
    low, high = body.bounds_mm
    raise OutOfBodyError(
        f"point {first} at ({place}) mm is {-distances[first, piece]:.3g} mm outside the body, beyond its "
        f"{body.pieces[piece]} face ({int(outside.sum())} of {len(points)} points are); the body lies between "
        f"{low} and {high} mm"
    )


class Locator:
    """Finds points in a mesh; built once per mesh.

    A large element among small ones is far from the nearest by its centroid: a point that none of the first candidates
    holds is looked for among more of them, unless it is a hair beyond the body's own surface.
    """

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self._mesh = mesh
        self._tree = cKDTree(mesh.points[mesh.tets[:, :4]].mean(axis=1))
        outer = np.zeros(len(mesh.points), bool)
        outer[mesh.faces] = True
        opposite = [[4 + e for e, edge in enumerate(TET_EDGES) if a not in edge] for a in range(4)]
        self._outer = np.stack([outer[mesh.tets[:, middles]].all(axis=1) for middles in opposite], axis=1)

    def locate(self, points: Points) -> Places:
        """Return where ``points`` (n, 3) are; points a hair outside the mesh are read from the nearest element.

        Raises
        ------
        MeshError
            A point is outside every element by more than a tenth of the element's size.
        """
        mesh, points = self._mesh, np.ascontiguousarray(points, float)
        best = np.zeros(len(points), np.int64)
        where, inside = np.zeros((len(points), 3)), np.full(len(points), -np.inf)
        left = np.arange(len(points))
        for number in CANDIDATES:
            number = min(number, len(mesh.tets))
            near = self._tree.query(points[left], number)[1].reshape(len(left), number)
            found = (best[left], where[left], inside[left])
            _search(points[left], near.astype(np.int64), mesh.points, mesh.tets, *found)
            best[left], where[left], inside[left] = found
            share = np.column_stack([1.0 - where.sum(axis=1), where])
            beyond_body = self._outer[best, share.argmin(axis=1)]
            left = np.flatnonzero(inside < np.where(beyond_body, -HAIR, -WITHIN))
            if len(left) == 0:
                break
        if np.any(inside < -0.1):
            first = int(np.argmin(inside))
            raise MeshError(f"no element of the mesh holds the point {points[first]} mm: rebuild the mesh")
        values, slopes = tet_shapes(where)
        nodes = mesh.tets[best]
        jacobian = np.einsum("qai,qaj->qij", mesh.points[nodes], slopes)
        slopes = np.einsum("qaj,qjm->qam", slopes, np.linalg.inv(jacobian))
        frozen(values), frozen(slopes)
        return Places(nodes=nodes, weights=values, slopes=slopes)


@njit(cache=True)
def _search(points: Floats, near: Ints, nodes: Floats, tets: Ints, best: Ints, where: Floats, inside: Floats) -> None:
    """Keep for every point the element in which its smallest barycentric coordinate is largest, first hit wins."""
    place = np.empty(3)
    for q in range(len(points)):
        for t in near[q]:
            if inside[q] >= -WITHIN:
                break
            if not _outside_ball(points[q], nodes, tets[t], place):
                smallest = _invert_map(points[q], nodes, tets[t], place)
                if smallest > inside[q]:
                    inside[q], best[q] = smallest, t
                    where[q] = place


@njit(cache=True)
def _outside_ball(point: Floats, nodes: Floats, tet: Ints, place: Floats) -> bool:
    """Tell whether a point is farther from the element's centroid, left in ``place``, than 1.2 times any corner."""
    reach, distance = 0.0, 0.0
    for i in range(3):
        place[i] = (nodes[tet[0], i] + nodes[tet[1], i] + nodes[tet[2], i] + nodes[tet[3], i]) / 4.0
        distance += (point[i] - place[i]) ** 2
    for a in range(4):
        square = 0.0
        for i in range(3):
            square += (nodes[tet[a], i] - place[i]) ** 2
        reach = max(reach, square)
    return bool(distance > 1.44 * reach)


@njit(cache=True)
def _invert_map(point: Floats, nodes: Floats, tet: Ints, place: Floats) -> float:
    """Set ``place`` to where ``point`` is in the reference element (Newton); return its least barycentric share."""
    place[:] = 0.25
    residual, jac = np.empty(3), np.empty((3, 3))
    for turn in range(12):
        rest = 1.0 - place[0] - place[1] - place[2]
        residual[:], jac[:] = point, 0.0
        for a in range(4):
            share = place[a - 1] if a else rest
            value, slope = share * (2.0 * share - 1.0), 4.0 * share - 1.0
            for i in range(3):
                x = nodes[tet[a], i]
                residual[i] -= value * x
                if a:
                    jac[i, a - 1] += slope * x
                else:
                    for m in range(3):
                        jac[i, m] -= slope * x
        for e in range(6):
            one, two = TET_EDGES[e]
            first, second = place[one - 1] if one else rest, place[two - 1]
            for i in range(3):
                x = 4.0 * nodes[tet[4 + e], i]
                residual[i] -= first * second * x
                jac[i, two - 1] += first * x
                if one:
                    jac[i, one - 1] += second * x
                else:
                    for m in range(3):
                        jac[i, m] -= second * x
        largest = _add_solution(jac, residual, place)
        if largest < 1e-12:
            break
        smallest = min(1.0 - place[0] - place[1] - place[2], place[0], place[1], place[2])
        if not smallest >= -5.0 or (turn == 0 and smallest < FAR):
            return -np.inf
    return float(min(1.0 - place[0] - place[1] - place[2], place[0], place[1], place[2]))


@njit(cache=True)
def _add_solution(jac: Floats, residual: Floats, place: Floats) -> float:
    """Add the solution of three equations to ``place`` (Cramer's rule); return its largest component."""
    largest, det = 0.0, 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        det += jac[0, i] * (jac[1, j] * jac[2, k] - jac[1, k] * jac[2, j])
    if det == 0.0:
        place[:] = np.inf
        return np.inf
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        step = (
            residual[0] * (jac[1, j] * jac[2, k] - jac[1, k] * jac[2, j])
            + residual[1] * (jac[2, j] * jac[0, k] - jac[2, k] * jac[0, j])
            + residual[2] * (jac[0, j] * jac[1, k] - jac[0, k] * jac[1, j])
        ) / det
        place[i] += step
        largest = max(largest, abs(step))
    return largest
