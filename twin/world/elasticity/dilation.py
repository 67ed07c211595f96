"""The change of volume that a load's half-space field has in materials of another Poisson's ratio, for w to undo.

The half-space's tension p and change of volume belong to the material under the load. Elsewhere the rest w is given the
tension g p (see `twin.world.elasticity.interfaces`), and the half-space's change of volume p / kappa must become g p /
kappa'. The integrand falls off like 1 / r^2 and the load is a layer away, so a few subdivisions near the load are
enough.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.theory.halfspace_kernels import rectangle_terms
from twin.world.mesh.elements import tet_shapes
from twin.world.mesh.mesh import Mesh

GROWTH, FINEST, LEVELS = 1.0, 0.3, 12
"""Largest size of a piece of an element over its distance to the load, and over the load's size near it."""

_A, _B = 0.5854101966249685, 0.1381966011250105
_RULE = np.where(np.eye(4, dtype=bool), _A, _B)
"""Shares of four points, exact to degree 2."""

_EIGHTH = np.array(
    [(0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3), (4, 5, 6, 7), (4, 5, 7, 8), (5, 6, 7, 9), (5, 7, 8, 9)]
)
"""Corners of the eight parts of a quadratic tetrahedron, of its ten nodes."""

_NODES = np.array([(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])


def dilation(
    mesh: Mesh, pressure: Ints, share: Floats, load: Rectangles, columns: Floats, poisson_ratio: float
) -> Floats:
    """Return (P, m) integrals of -share p q for every pressure unknown's q, mm3.

    Parameters
    ----------
    mesh, pressure
        The mesh, and the (e, 4) pressure unknowns of its elements.
    share
        (e,) 1 / kappa - g / kappa' of every element, 1/MPa; zero where the half-space fits.
    load, columns
        (k) rectangles, and the (k, 3, m) forces on them in m load cases, N.
    poisson_ratio
        nu of the half-space.
    """
    out = np.zeros((int(pressure.max()) + 1, columns.shape[2]))
    wrong = np.flatnonzero(share)
    if len(wrong) == 0 or len(load) == 0:
        return out
    element, shares = _pieces(mesh, wrong, load)
    corners = np.einsum("pc,ecs->eps", _RULE, shares)
    values, slopes = tet_shapes(corners.reshape(-1, 4)[:, 1:])
    element = np.repeat(element, len(_RULE))
    nodes = mesh.points[mesh.tets[element]]
    points = np.einsum("qa,qai->qi", values, nodes)
    part = np.abs(np.linalg.det(shares[:, 1:, 1:] - shares[:, :1, 1:]))
    volume = np.linalg.det(np.einsum("qai,qaj->qij", nodes, slopes)) / 24.0 * np.repeat(part, len(_RULE))
    tension = np.zeros((len(points), columns.shape[2]))
    _tension(points, load.centre_mm, load.frames, load.half_mm, np.ascontiguousarray(columns), poisson_ratio, tension)
    weighted = -(share[element] * volume)[:, None, None] * corners.reshape(-1, 4, 1) * tension[:, None]
    np.add.at(out, pressure[element], weighted)
    return out


def _pieces(mesh: Mesh, elements: Ints, load: Rectangles) -> tuple[Ints, Floats]:
    """Return elements (p,) and the barycentric shares (p, 4, 4) of pieces of them, small near the load."""
    from scipy.spatial import cKDTree

    tree, reach = cKDTree(load.centre_mm), float(np.linalg.norm(load.half_mm, axis=1).max())
    shares = np.tile(np.eye(4), (len(elements), 1, 1))
    done: list[tuple[Ints, Floats]] = []
    for level in range(LEVELS + 1):
        values = tet_shapes(shares.reshape(-1, 4)[:, 1:])[0].reshape(-1, 4, 10)
        corner = np.einsum("eca,eai->eci", values, mesh.points[mesh.tets[elements]])
        size = np.max([np.linalg.norm(corner[:, a] - corner[:, b], axis=1) for a in range(4) for b in range(a)], axis=0)
        away = np.maximum(tree.query(corner.mean(axis=1))[0] - reach, 0.0)
        big = (size > np.maximum(GROWTH * away, FINEST * reach)) & (level < LEVELS)
        big &= size > GROWTH * np.abs(away)
        done.append((elements[~big], shares[~big]))
        if not np.any(big):
            break
        nodes = (shares[big][:, _NODES[:, 0]] + shares[big][:, _NODES[:, 1]]) / 2.0
        shares = nodes[:, _EIGHTH].reshape(-1, 4, 4)
        elements = np.repeat(elements[big], len(_EIGHTH))
    return np.concatenate([e for e, _ in done]), np.concatenate([s for _, s in done])


@njit(cache=True)
def _tension(
    points: Floats, centre: Floats, frames: Floats, half: Floats, columns: Floats, nu: float, out: Floats
) -> None:
    """Add the mean tension -(1 + nu) / (3 pi) n . f of every rectangle to (q, m)."""
    u, n = np.empty((3, 3)), np.empty(3)
    for q in range(len(points)):
        for k in range(len(centre)):
            frame, place = frames[k], points[q] - centre[k]
            x = frame[0, 0] * place[0] + frame[0, 1] * place[1] + frame[0, 2] * place[2]
            y = frame[1, 0] * place[0] + frame[1, 1] * place[1] + frame[1, 2] * place[2]
            z = frame[2, 0] * place[0] + frame[2, 1] * place[1] + frame[2, 2] * place[2]
            rectangle_terms(x, y, max(z, 0.0), half[k, 0], half[k, 1], 1.0 - 2.0 * nu, u, n)
            for m in range(columns.shape[2]):
                for j in range(3):
                    force = (
                        frame[j, 0] * columns[k, 0, m] + frame[j, 1] * columns[k, 1, m] + frame[j, 2] * columns[k, 2, m]
                    )
                    out[q, m] -= (1.0 + nu) / (3.0 * math.pi) * n[j] * force
