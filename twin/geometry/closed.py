"""From loose triangles to one closed, outward wound surface, or a refusal that says what is wrong with it.

Why refuse and not repair: a repaired surface encloses another body than the user drew, and nobody is told.

Validity: a surface that passes may still cut through itself; the mesher's volume check catches what that spoils.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from twin.arrays import Floats, Ints, Points, frozen
from twin.errors import InputError
from twin.geometry.stl import read_triangles

SIZE_MM = (5.0, 500.0)
"""Allowed longest side of the box around a body, mm."""

PROBE_SIZE_MM = (0.1, 1000.0)
"""Allowed longest side of the box around a probe, mm."""

THINNEST_MM = 0.5
"""Least mean thickness of a body, twice the volume over the surface, mm; of a probe less by its smaller least size."""

_WELD = 1e-6
"""Corners nearer than this share of the box's diagonal are one, where exact equality leaves the surface open."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A closed surface.

    Attributes
    ----------
    vertices
        (n, 3), mm.
    triangles
        (m, 3) indices, right-hand normals pointing out of the body.
    volume_mm3
        What it encloses.
    """

    vertices: Points
    triangles: Ints
    volume_mm3: float


def read_surface(file: str, size_mm: tuple[float, float] = SIZE_MM) -> Surface:
    """Return the checked surface of an STL file, which is kept while the file stays as it is.

    Raises
    ------
    InputError
        The file can't be read, or see `closed_surface`.
    """
    path = Path(file)
    try:
        state = path.stat()
    except OSError as problem:
        raise InputError(f"{path.name}: can't be read ({problem.strerror}); check the path") from None
    return _read_once(file, size_mm, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=8)
def _read_once(file: str, size_mm: tuple[float, float], _changed: int, _size: int) -> Surface:
    path = Path(file)
    return closed_surface(read_triangles(path), path.name, size_mm)


def closed_surface(corners: Floats, name: str, size_mm: tuple[float, float] = SIZE_MM) -> Surface:
    """Weld triangles (m, 3, 3) into a closed surface.

    Raises
    ------
    InputError
        The surface is too small, too large, open, wound both ways or inwards, in several parts, or too thin. ``name``
        says in the message whose surface it is.
    """
    size = float(np.max(np.ptp(corners.reshape(-1, 3), axis=0)))
    if not size_mm[0] <= size <= size_mm[1]:
        raise InputError(
            f"{name}: the longest side is {size:.6g} mm (allowed: {size_mm[0]:g} to {size_mm[1]:g} mm); STL files "
            "carry no unit: export it in millimetres"
        )
    vertices, triangles = _welded(corners, 0.0)
    if len(_open_edges(triangles)):
        vertices, triangles = _welded(corners, _WELD * float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))))
    _refuse_open(vertices, triangles, name)
    _refuse_parts(vertices, triangles, name)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(q - p, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    flat = double_area < 1e-7 * longest**2
    if flat.any():
        x, y, z = a[np.argmax(flat)]
        raise InputError(
            f"{name}: {int(flat.sum())} triangles have no area, the first at ({x:.4g}, {y:.4g}, {z:.4g}) mm; clean the "
            "surface (merge needles) and export it anew"
        )
    volume = float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0
    if volume < 0.0:
        raise InputError(
            f"{name}: the triangles are wound inwards (volume {volume:.4g} mm3, allowed: above 0); flip the normals "
            "and export it anew"
        )
    thickness = 4.0 * volume / float(double_area.sum())
    thinnest = THINNEST_MM * size_mm[0] / SIZE_MM[0]
    if thickness < thinnest:
        raise InputError(
            f"{name}: the mean thickness (twice the volume over the surface) is {thickness:.3g} mm (allowed: at least "
            f"{thinnest:g} mm); a shell is no body: close it into a solid one"
        )
    return Surface(vertices=frozen(vertices), triangles=frozen(triangles), volume_mm3=volume)


def _welded(corners: Floats, distance_mm: float) -> tuple[Points, Ints]:
    """Return vertices and triangles, corners nearer than a distance being one, collapsed triangles left out."""
    # + 0.0 makes -0.0 and 0.0 the same bits
    vertices, number = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    if distance_mm:
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        near = cKDTree(vertices).sparse_distance_matrix(cKDTree(vertices), distance_mm, output_type="coo_matrix")
        near.data[:] = 1.0
        _, group = connected_components(near, directed=False)
        _, first = np.unique(group, return_index=True)
        vertices, number = vertices[first], group[number.ravel()]
    triangles = number.reshape(-1, 3).astype(np.int64)
    kept = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    return vertices, triangles[kept]


def _directed_edges(triangles: Ints) -> Ints:
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def _open_edges(triangles: Ints) -> Ints:
    """Return the (e, 2) edges that don't belong to exactly two triangles."""
    edges, count = np.unique(np.sort(_directed_edges(triangles), axis=1), axis=0, return_counts=True)
    return np.asarray(edges[count != 2])


def _refuse_open(vertices: Points, triangles: Ints, name: str) -> None:
    edges = _open_edges(triangles)
    if len(edges) or len(triangles) < 4:
        place = vertices[edges[0]].mean(axis=0) if len(edges) else np.zeros(3)
        raise InputError(
            f"{name}: the surface is not watertight: {len(edges)} edges do not belong to exactly two triangles, the "
            f"first at ({', '.join(f'{c:.4g}' for c in place)}) mm; mend the holes and export it anew"
        )
    ways, count = np.unique(_directed_edges(triangles), axis=0, return_counts=True)
    if (count != 1).any():
        place = vertices[ways[np.argmax(count)]].mean(axis=0)
        raise InputError(
            f"{name}: {int(np.sum(count - 1))} neighbouring triangles are wound against each other, the first at "
            f"({', '.join(f'{c:.4g}' for c in place)}) mm; make the normals consistent and export it anew"
        )


def _refuse_parts(vertices: Points, triangles: Ints, name: str) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = _directed_edges(triangles)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices), len(vertices)))
    parts, of_vertex = connected_components(graph, directed=False)
    if parts != 1:
        smallest = np.bincount(of_vertex[triangles[:, 0]]).min()
        raise InputError(
            f"{name}: {parts} separate surfaces, the smallest of {smallest} triangles (allowed: 1 body without "
            "hollows); join the bodies, or export one"
        )
