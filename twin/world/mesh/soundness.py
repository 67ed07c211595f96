"""Why an elastic system can't be solved, found before it is tried: a mesh that is no body, or a body that may drift.

Why before: a sparse solver does not notice. A body that is held nowhere has been "solved" to 1e14 mm with a small
relative residual, and an element turned inside out gives a plausible field. Looking costs a few milliseconds.

Validity: parts that hang together at a single node or along one edge count as one part, although they can turn about
it. The solver finds those: its answer is then out of balance with the load (`twin.world.elasticity.solve`).
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.errors import InputError, MeshError, SolveError
from twin.world.mesh.elements import tet_quadrature, tet_shapes
from twin.world.mesh.mesh import Mesh

STRAIGHT = 1e-6
"""Held nodes of a part count as lying on one line when they leave it by less than this share of their extent."""


def require_solvable(mesh: Mesh, held: Bools) -> None:
    """Raise unless the mesh is a body, every part of which is held.

    Parameters
    ----------
    mesh
        The mesh.
    held
        (N,) which nodes are held, in all three directions.

    Raises
    ------
    MeshError
        A node is not finite or belongs to no element, or an element is flat or turned inside out.
    SolveError
        The body, or a part of it, is held nowhere, or so that it can still turn.
    """
    _require_nodes(mesh)
    _require_volumes(mesh)
    _require_held(mesh, held)


def require_finite(mesh: Mesh, values: Floats, what: str, unit: str) -> None:
    """Raise an `InputError` that names the first node where nodal ``values`` (N, 3, m) are not finite."""
    if np.isfinite(values).all():
        return
    wrong = ~np.isfinite(values).all(axis=(1, 2))
    first = int(np.argmax(wrong))
    column = int(np.argmin(np.isfinite(values[first]).all(axis=0)))
    raise InputError(
        f"the {what} at node {first}, at ({_place(mesh.points[first])}) mm, is {values[first, :, column]} {unit} in "
        f"load case {column} ({wrong.sum()} nodes have one that is not finite): check the load"
    )


def _require_nodes(mesh: Mesh) -> None:
    wrong = ~np.isfinite(mesh.points).all(axis=1)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise MeshError(
            f"node {first} of the mesh is at {mesh.points[first]} mm ({wrong.sum()} nodes are not finite): make the "
            "mesh anew"
        )
    used = np.zeros(len(mesh.points), bool)
    used[mesh.tets] = True
    if not used.all():
        first = int(np.argmin(used))
        raise MeshError(
            f"node {first} of the mesh, at ({_place(mesh.points[first])}) mm, belongs to no element "
            f"({(~used).sum()} of {len(used)} nodes are like that): leave such nodes out"
        )


def _require_volumes(mesh: Mesh) -> None:
    least = _determinants(mesh)
    wrong = ~(least > 0.0)
    if wrong.any():
        worst = int(np.argmin(least))
        middle = mesh.points[mesh.tets[worst, :4]].mean(axis=0)
        raise MeshError(
            f"element {worst} of the mesh, near ({_place(middle)}) mm, is flat or turned inside out: the determinant "
            f"of its map goes down to {least[worst]:.3g} mm3, allowed is above 0 ({wrong.sum()} of {len(least)} "
            "elements are): mend the mesh or make it anew"
        )


def _determinants(mesh: Mesh) -> Floats:
    """Return (m,) the least determinant of each element's map at the points where the matrix is integrated, mm3."""
    slopes = tet_shapes(tet_quadrature()[0])[1]
    nodes = mesh.points[mesh.tets]
    least = np.full(len(mesh.tets), np.inf)
    for slope in slopes:
        a, b, c = np.einsum("mai,aj->jmi", nodes, slope, optimize=True)
        least = np.minimum(least, np.einsum("mi,mi->m", a, np.cross(b, c)))
    return least


def _require_held(mesh: Mesh, held: Bools) -> None:
    part = _parts(mesh)
    parts = int(part.max()) + 1
    for number in range(parts):
        own = part == number
        points = mesh.points[own & held]
        if _pins(points):
            continue
        where = _place(mesh.points[own].mean(axis=0))
        what = "the body" if parts == 1 else f"part {number} of the mesh, near ({where}) mm,"
        line = f"is held by {len(points)} nodes on one line only, and can turn"
        how = "is held nowhere" if len(points) == 0 else line
        raise SolveError(
            f"{what} {how}, so no load on it has an equilibrium: hold at least one face of every part, or join the "
            f"{'parts' if parts > 1 else 'body to something'}"
        )


def _parts(mesh: Mesh) -> Ints:
    """Return (N,) which connected part of the mesh every node belongs to."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    size = mesh.tets.shape[1]
    first, other = np.repeat(mesh.tets[:, 0], size - 1), mesh.tets[:, 1:].ravel()
    graph = csr_matrix((np.ones(len(first), np.int8), (first, other)), shape=(len(mesh.points),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1])


def _pins(points: Floats) -> bool:
    """Tell whether holding these points (n, 3) stops every motion: three of them are not on one line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > STRAIGHT * spread[0])


def _place(point: Floats) -> str:
    return ", ".join(f"{c:.4g}" for c in point)
