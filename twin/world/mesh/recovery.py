"""A smoother reading of nodal fields, whose distance from the elements' own tells how rough a mesh is for a field.

Around every point one cubic polynomial is fitted to the nodal values nearby, by least squares in which near nodes weigh
most, and read at the point: patch recovery (O. C. Zienkiewicz and J. Z. Zhu 1992), of values as in Z. Zhang and A. Naga
(2005). Quadratic elements are wrong by a cubic, so the difference to what they say is an estimate of their own error in
that very place, without another mesh or solve.

Validity: it sees what elements miss of a field, not what all of them together have wrong (a clamped rim's singularity
moves whole regions alike), and nothing narrower than a few elements.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from twin.arrays import Floats, Points
from twin.world.mesh.interpolate import Weighted
from twin.world.mesh.mesh import Mesh

NEIGHBOURS, NARROW = 90, 2.0
"""Nodes that a cubic is fitted to, and by how much their weight falls: exp(-(NARROW r)^2), r = 1 at the farthest."""

POWERS = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3])
"""(20, 3) powers of x, y and z in a cubic; the first is 1."""

SINGULAR = 1e-10
"""Directions of the fit that weigh less than this share of the heaviest are left out: in thin walls nodes lie in few
planes and tell no cubic across them."""

TOGETHER = 512
"""Points that are worked on at once."""


class Recovery:
    """Smoother readings of fields on one mesh; built once per mesh."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self._nodes = mesh.points
        self._tree = cKDTree(mesh.points)

    def at(self, points: Points) -> Weighted:
        """Return what reads the cubics at ``points`` (n, 3) mm."""
        away, nodes = self._tree.query(points, min(NEIGHBOURS, len(self._nodes)))
        weights = np.empty(nodes.shape)
        for start in range(0, len(points), TOGETHER):
            part = slice(start, start + TOGETHER)
            reach = away[part, -1:]
            weights[part] = _read(
                (self._nodes[nodes[part]] - points[part, None]) / reach[..., None], away[part] / reach
            )
        return Weighted(nodes=nodes, weights=weights)


def _read(places: Floats, away: Floats) -> Floats:
    """Return (n, k) weights of the nodes at ``places`` (n, k, 3), so far ``away`` (n, k), in the cubic's value at 0."""
    terms = np.prod(places[:, :, None] ** POWERS, axis=3)
    weighted = terms * np.exp(-2.0 * (NARROW * away) ** 2)[..., None]
    normal = np.linalg.pinv(terms.transpose(0, 2, 1) @ weighted, rcond=SINGULAR, hermitian=True)
    return np.asarray(np.einsum("nkp,np->nk", weighted, normal[:, 0]))
