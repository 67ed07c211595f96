"""Quadratic tetrahedral meshes: the arrays of a `Mesh`, its file, and its export; and their
elements: numbering, shape functions and quadrature.

Nodes are in VTK's order: corners, then the middles of the edges `TET_EDGES` or `TRIANGLE_EDGES`.
The reference element has its corners at the origin and at the ends of the axes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, frozen, grid_points
from twin.errors import InputError
from twin.files import make_folder, read_arrays, write_whole
from twin.parts.body import Body

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


FORMAT = 1
"""Version of the file format and of the way meshes are made; part of every key."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Quadratic tetrahedra with a classified boundary.

    Attributes
    ----------
    points
        (n, 3) all nodes, mm; the corner nodes come first.
    tets
        (m, 10) indices in the order of VTK's quadratic tetrahedron: corners 0 to 3, then the
        middles of the edges 01, 12, 02, 03, 13, 23. Volumes are positive.
    corners
        Number of corner nodes.
    faces
        (f, 6) boundary triangles in the order of VTK's quadratic triangle: three corners, then the
        middles of 01, 12, 20; right-hand normals point out of the body.
    piece
        (f,) index into ``body.pieces`` of every boundary triangle: 0 is sensing,
        ``body.held_pieces`` are held.
    region
        (m,) what every element is made of: 0 the body (all of them, if not given), then its layers
        one by one.
    """

    points: Points
    tets: Ints
    corners: int
    faces: Ints
    piece: Ints
    region: Ints = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.region) == 0:
            object.__setattr__(self, "region", frozen(np.zeros(len(self.tets), np.int64)))

    def nodes_on(self, pieces: Sequence[int]) -> Bools:
        """Return (n,) which nodes lie on boundary triangles of ``pieces``."""
        on = np.zeros(len(self.points), bool)
        on[self.faces[np.isin(self.piece, pieces)]] = True
        return on

    def node_sheets(self, body: Body) -> Bools:
        """Return (n, sheets): which of the body's sheets meet at each node."""
        sheet = body.sheets_of(self.points[self.faces], self.piece)
        on = np.zeros((len(self.points), len(body.sensing_sheets)), dtype=bool)
        on[self.faces.ravel(), np.repeat(sheet, self.faces.shape[1])] = True
        return on

    def determinants(self, places: Floats) -> Iterator[Floats]:
        """Yield the (m,) determinants of the elements' maps at each of the reference places (q, 3),
        mm3."""
        nodes = self.points[self.tets]
        for slope in shapes(places)[1]:
            a, b, c = np.einsum("mai,aj->jmi", nodes, slope, optimize=True)
            yield np.einsum("mi,mi->m", a, np.cross(b, c))

    def jacobian_ratios(self) -> Floats:
        """Return (m,) ratios of the least to the largest determinant of the quadratic map, a cubic
        that the lattice of 20 points determines."""
        lattice = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3]) / 3.0
        values = list(self.determinants(lattice))
        least, largest = np.min(values, axis=0), np.max(values, axis=0)
        flat = np.full(len(self.tets), -np.inf)  # or inside out
        return np.asarray(np.divide(least, largest, out=flat, where=largest > 0))

    def enclosed_volume(self) -> float:
        """Return the volume inside the quadratic faces, mm3: a third of the flux of x through
        them, a quartic, which the quadrature integrates exactly."""
        places, weights = quadrature(2)
        values, slopes = shapes(places)
        nodes = self.points[self.faces]
        total = 0.0
        for weight, value, slope in zip(weights, values, slopes, strict=True):
            normal = np.cross(*np.einsum("na,fnk->afk", slope, nodes))
            total += weight * float(np.einsum("n,fnk,fk->", value, nodes, normal))
        return total / 3

    def outward_faces(self) -> tuple[Ints, Ints]:
        """Return the corners (4 m, 3) of all elements' faces, turned outward, and the elements (4
        m,)."""
        return self.tets[:, TET_FACES].reshape(-1, 3), np.repeat(np.arange(len(self.tets)), 4)

    def regions_behind(self, faces: Ints) -> Ints:
        """Return the region (f,) behind boundary faces."""
        if not np.any(self.region):
            return np.zeros(len(faces), np.int64)
        corners, owner = self.outward_faces()
        scale = np.array([self.corners**2, self.corners, 1])
        keys = np.sort(corners, axis=1) @ scale
        order = np.argsort(keys)
        at = np.searchsorted(keys[order], np.sort(faces[:, :3], axis=1) @ scale)
        return np.asarray(self.region[owner[order[at]]])

    def digest(self) -> str:
        """Return the SHA-256 of the arrays: equal for equal meshes, whatever file they came
        from."""
        sha = hashlib.sha256()
        for array, kind in (
            (self.points, "<f8"),
            (self.tets, "<i8"),
            (self.faces, "<i8"),
            (self.piece, "<i8"),
        ):
            sha.update(repr(array.shape).encode())
            sha.update(np.ascontiguousarray(array, dtype=kind).tobytes())
        sha.update(str(self.corners).encode())
        if np.any(self.region):
            sha.update(np.ascontiguousarray(self.region, dtype="<i8").tobytes())
        return sha.hexdigest()

    @property
    def unknowns(self) -> int:
        """Three displacements at every node and one pressure at every corner."""
        return 3 * len(self.points) + self.corners

    def write(self, path: Path, provenance: dict[str, Any], *, first: bool = False) -> None:
        """Write the mesh, and how it was made (plain JSON values), to an ``.npz`` file.

        With ``first`` a file that is there by then is kept. Raises a `TwinError` if the file can't
        be written.
        """
        text = json.dumps({**provenance, "format": FORMAT, "digest": self.digest()}, sort_keys=True)
        arrays: dict[str, Any] = {
            "points": self.points,
            "tets": self.tets.astype(np.int32),
            "corners": np.int64(self.corners),
            "faces": self.faces.astype(np.int32),
            "piece": self.piece.astype(np.int32),
            "region": self.region.astype(np.int32),
            "provenance": np.array(text),
        }
        write_whole(
            path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays), first=first
        )

    @staticmethod
    def read(path: Path) -> Mesh:
        """Return the mesh of a file; raises like `load`."""
        return Mesh.load(path)[0]

    @staticmethod
    def load(path: Path) -> tuple[Mesh, dict[str, Any]]:
        """Return a whole mesh and how it was made: key, body, sizing, quality, format and digest.

        Raises
        ------
        InputError
            If the file is missing, truncated, of another kind, or its arrays don't make a mesh.
        """
        try:
            file: dict[str, Any] = {**read_arrays(path)}
            mesh = Mesh(
                points=frozen(np.asarray(file["points"], np.float64)),
                tets=frozen(np.asarray(file["tets"], np.int64)),
                corners=int(file["corners"]),
                faces=frozen(np.asarray(file["faces"], np.int64)),
                piece=frozen(np.asarray(file["piece"], np.int64)),
                region=frozen(np.asarray(file.get("region", []), np.int64)),
            )
            provenance = json.loads(str(file["provenance"]))
        except FileNotFoundError:
            raise InputError(
                f"{path}: there is no such mesh file; make it with `twin mesh SCENE`"
            ) from None
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            RecursionError,
        ) as problem:
            raise InputError(
                f"{path}: not a whole mesh file ({type(problem).__name__}: {problem}); make it "
                "again with `twin mesh SCENE --rebuild`"
            ) from problem
        problem_text = _problem(mesh)
        if not problem_text and (
            not isinstance(provenance, dict) or provenance.get("digest") != mesh.digest()
        ):
            problem_text = "its arrays don't match the digest stored with them"
        if problem_text:
            raise InputError(
                f"{path}: {problem_text}; make it again with `twin mesh SCENE --rebuild`"
            )
        return mesh, provenance

    def export(self, body: Body, path: Path) -> None:
        """Write VTK's unstructured grid (.vtu), with the nodes' depth below the sensing surface.

        Raises
        ------
        InputError
            The name does not end in .vtu, or the file can't be written (`TwinError` on a full
            disk).
        """
        if path.suffix != ".vtu":
            raise InputError(f"{path}: a mesh is exported as .vtu")
        import pyvista
        from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

        grid = pyvista.UnstructuredGrid(
            {_VTK_QUADRATIC_TETRA: np.asarray(self.tets)}, np.array(self.points)
        )
        grid.point_data["depth_mm"] = body.depth(self.points)
        # Into memory: on a full disk VTK's writer leaves an empty file and raises nothing.
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(grid)
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()
        writer.Write()
        make_folder(path.parent)
        write_whole(path, writer.GetOutputString().encode())


def _problem(mesh: Mesh) -> str:
    """Return what keeps the arrays from being a mesh, or an empty string."""
    nodes = len(mesh.points)
    shapes = [("points", mesh.points, 3), ("tets", mesh.tets, 10), ("faces", mesh.faces, 6)]
    for name, array, width in shapes:
        if array.ndim != 2 or array.shape[1] != width or len(array) == 0:
            return f"{name} have shape {array.shape} (allowed: (n >= 1, {width}))"
    if mesh.piece.shape != (len(mesh.faces),):
        return f"piece has shape {mesh.piece.shape} (allowed: ({len(mesh.faces)},))"
    if mesh.region.shape != (len(mesh.tets),) or mesh.region.min() < 0:
        return (
            f"region has shape {mesh.region.shape} or negative numbers (allowed: "
            f"({len(mesh.tets)},), 0 and up)"
        )
    if not np.all(np.isfinite(mesh.points)):
        return "points are not finite"
    if not 4 <= mesh.corners <= nodes:
        return f"{mesh.corners} corner nodes (allowed: 4 to {nodes})"
    for name, array, own_corners in (("tets", mesh.tets, 4), ("faces", mesh.faces, 3)):
        if array.min() < 0 or array.max() >= nodes or array[:, :own_corners].max() >= mesh.corners:
            return (
                f"{name} name nodes that are not there (allowed: corners below "
                f"{mesh.corners}, nodes below {nodes})"
            )
    if np.min(signed_volumes(mesh.points, mesh.tets)) <= 0:
        return "a tetrahedron has no positive volume"
    return ""


_VTK_QUADRATIC_TETRA = 24
