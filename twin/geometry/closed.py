"""Read STL files (binary or text), and make a closed, outward wound surface of one.

Nothing in a file is trusted: size, count and every number are checked before use. An open or
wrongly wound surface is not repaired, because that may enclose another body than the user drew.

Validity: a surface that passes may still intersect itself; the mesher's check of the volume finds
that.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np

from twin.arrays import Floats, Ints, Points, coordinates, frozen
from twin.errors import InputError, TwinError

MOST_TRIANGLES = 400_000
"""Triangles in a file at most: a body's smooth field sees no more detail than a few thousand."""

_HEADER, _RECORD = 84, 50
_MOST_TEXT_BYTES = 400 * MOST_TRIANGLES
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")

_STARTS = (
    ("a PLY file", rb"ply\s"),
    ("an OFF file", rb"C?OFF\s"),
    ("a STEP file", rb"ISO-10303"),
    ("a 3MF or another zip file", rb"PK\x03\x04"),
    (
        "an OBJ file",
        rb"(#[^\n]*\n\s*)*(mtllib|o|g|v|vn|vt|s)\s[^\n]*\n\s*(#|mtllib|usemtl|o|g|v|vn|vt|f|s)\s",
    ),
)
"""How files of other formats start."""

_ENDINGS = {
    ".obj": "an OBJ file",
    ".ply": "a PLY file",
    ".off": "an OFF file",
    ".step": "a STEP file",
    ".stp": "a STEP file",
    ".iges": "an IGES file",
    ".igs": "an IGES file",
    ".3mf": "a 3MF or another zip file",
}

_CONVERTED = ("an OBJ file", "a PLY file", "an OFF file")
"""Formats that trimesh, which this program brings along, converts."""


def _read_triangles(path: Path) -> Floats:
    """Return the (m, 3, 3) corners of the triangles of an STL file; `InputError` where it is
    unsound."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            # The head decides between text and binary; sizes are checked before anything large is
            # read.
            head = file.read(_HEADER)
            file.seek(0)
            count = int.from_bytes(head[80:84], "little") if len(head) == _HEADER else 0
            text = _is_text(head, size, count)
            _refuse_others(path, head)
            if not text:
                _refuse_wrong_size(path, head, size, count)
            elif size > _MOST_TEXT_BYTES:
                raise InputError(
                    f"{path.name}: {size} bytes of text (allowed: {_MOST_TEXT_BYTES}); export it "
                    "as binary, or coarser"
                )
            data = file.read(size)
    except OSError as problem:
        raise TwinError.unreadable(path.name, problem, "; check the path") from None
    if text:
        corners = _from_text(path, data)
    else:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(data, record, count, _HEADER)["corners"].astype(np.float64)
    _refuse_count(path, len(corners))
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{path.name}: {int(bad.sum())} of {len(corners)} triangles have corners that are not "
            f"finite, the first is number {first}; export the file again"
        )
    return corners


def _is_text(head: bytes, size: int, count: int) -> bool:
    """Tell a text file; binary ones may start with "solid" too, so a size that fits them
    decides."""
    return (
        size != _HEADER + _RECORD * count
        and head.lstrip()[:5].lower() == b"solid"
        and b"\0" not in head
    )


def _refuse_others(path: Path, head: bytes) -> None:
    """Refuse what is known to be of another format, with the way to convert it."""
    kind = next(
        (name for name, start in _STARTS if re.match(start, head.lstrip(), re.IGNORECASE)), None
    )
    kind = kind or _ENDINGS.get(path.suffix.lower())
    if kind is None:
        return
    way = "export an STL file, in mm, from the program that made it"
    if kind in _CONVERTED:
        made = path.with_suffix(".stl").name
        way = (
            'convert it once, in its folder: python -c "import trimesh; '
            f"trimesh.load('{path.name}', force='mesh').export('{made}')\", and name {made}"
        )
    raise InputError(f"{path.name}: is {kind}, but an STL file is needed; {way}")


def _refuse_wrong_size(path: Path, head: bytes, size: int, count: int) -> None:
    if len(head) < _HEADER:
        raise InputError(
            f"{path.name}: {size} bytes are no STL file (allowed: at least {_HEADER}); export it "
            "again"
        )
    wanted = _HEADER + _RECORD * count
    if size != wanted:
        raise InputError(
            f"{path.name}: declares {count} triangles, which take {wanted} bytes, but has {size}; "
            "the file is truncated or no STL: export it again"
        )
    _refuse_count(path, count)


def _refuse_count(path: Path, count: int) -> None:
    if not 4 <= count <= MOST_TRIANGLES:
        raise InputError(
            f"{path.name}: {count} triangles (allowed: 4 to {MOST_TRIANGLES}); export the whole "
            "body" + (", coarser" if count > 4 else "")
        )


def _from_text(path: Path, data: bytes) -> Floats:
    facets = data.count(b"endfacet")
    if facets > MOST_TRIANGLES:
        _refuse_count(path, facets)
    corners = sum(1 for _ in islice(_VERTEX.finditer(data), 3 * facets + 1))
    if corners != 3 * facets or b"endsolid" not in data:
        many = "more than " * (corners > 3 * facets)
        raise InputError(
            f"{path.name}: {many}{min(corners, 3 * facets)} corners for {facets} whole "
            f"triangles{'' if b'endsolid' in data else ' and no endsolid'}; the text is truncated "
            "or no STL: export it again"
        )
    numbers = (float(number) for corner in _VERTEX.finditer(data) for number in corner.groups())
    try:
        return np.fromiter(numbers, np.float64, 9 * facets).reshape(-1, 3, 3)
    except ValueError as problem:
        raise InputError(
            f"{path.name}: a corner is no number ({problem}); export it again"
        ) from None


SIZE_MM = (5.0, 500.0)
"""Allowed longest side of the box around a body, mm."""

PROBE_SIZE_MM = (0.1, 1000.0)
"""Allowed longest side of the box around a probe, mm."""

THINNEST_MM = 0.5
"""Least mean thickness of a body, twice the volume over the surface, mm; of a probe less by its
smaller least size."""

FLAT = 1e-6
"""A piece is a plane if its corners are nearer to one than this share of the box's diagonal."""

_WELD = 1e-6
"""Corners nearer than this share of the box's diagonal are one, where exact equality leaves the
surface open."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A closed surface: (n, 3) vertices, mm, and (m, 3) triangles with normals out of the body."""

    vertices: Points
    triangles: Ints
    volume_mm3: float

    @staticmethod
    def directed_edges(triangles: Ints) -> Ints:
        """Return (3 m, 2) directed edges in the order of the triangles, 01, 12, 20."""
        return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)

    @staticmethod
    def read(file: str, size_mm: tuple[float, float] = SIZE_MM) -> Surface:
        """Return the checked surface of an STL file, kept while that stays as it is; `InputError`
        where it can't be read, or see `welded`."""
        path = Path(file)
        try:
            state = path.stat()
        except OSError as problem:
            raise TwinError.unreadable(path.name, problem, "; check the path") from None
        return _read_once(file, size_mm, state.st_mtime_ns, state.st_size)

    @staticmethod
    def welded(corners: Floats, name: str, size_mm: tuple[float, float] = SIZE_MM) -> Surface:
        """Weld triangles (m, 3, 3) into a closed surface; `InputError`, beginning with ``name``,
        where it is too small or large, open, wound both ways or inwards, in several parts, or too
        thin."""
        # Size: STL files carry no unit, so a wrong one shows here.
        size = float(np.max(np.ptp(corners.reshape(-1, 3), axis=0)))
        if not size_mm[0] <= size <= size_mm[1]:
            raise InputError(
                f"{name}: the longest side is {size:.6g} mm (allowed: {size_mm[0]:g} to "
                f"{size_mm[1]:g} mm); STL files carry no unit: {_units(size, size_mm)}export it in "
                "millimetres"
            )
        # Join corners that are exactly equal; only if the surface stays open, also those that are
        # nearly equal.
        vertices, triangles = _welded(corners, 0.0)
        if len(_open_edges(triangles)):
            vertices, triangles = _welded(
                corners, _WELD * float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
            )
        _refuse_open(vertices, triangles, name)
        _refuse_parts(vertices, triangles, name)
        # Triangles without area have no normal.
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        longest = np.max(
            [np.linalg.norm(q - p, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0
        )
        flat = double_area < 1e-7 * longest**2
        if flat.any():
            raise InputError(
                f"{name}: {int(flat.sum())} triangles have no area, the first at "
                f"({coordinates(a[np.argmax(flat)])}) mm; clean the surface (merge needles) and "
                "export it again"
            )
        # The divergence theorem: the volume is negative where the normals point inwards.
        volume = float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0
        if volume < 0.0:
            raise InputError(
                f"{name}: the triangles are wound inwards (volume {volume:.4g} mm3, allowed: above "
                "0); flip the normals and export it again"
            )
        # Twice the volume over the surface is the mean thickness of a plate.
        thickness = 4.0 * volume / float(double_area.sum())
        thinnest = THINNEST_MM * size_mm[0] / SIZE_MM[0]
        if thickness < thinnest:
            raise InputError(
                f"{name}: the mean thickness (twice the volume over the surface) is "
                f"{thickness:.3g} mm (allowed: at least {thinnest:g} mm); a shell is no body: "
                "close it into a solid one"
            )
        return Surface(vertices=frozen(vertices), triangles=frozen(triangles), volume_mm3=volume)


def _units(size: float, allowed_mm: tuple[float, float]) -> str:
    """Say what a size would be in the units that would make it an allowed one."""
    units = {"metres": 1000.0, "inches": 25.4, "micrometres": 1e-3}
    fits = [
        f"if it is in {name}, it is {size * mm:.4g} mm long"
        for name, mm in units.items()
        if allowed_mm[0] <= size * mm <= allowed_mm[1]
    ]
    return " and ".join(fits) + "; " * bool(fits)


@lru_cache(maxsize=8)
def _read_once(file: str, size_mm: tuple[float, float], _changed: int, _size: int) -> Surface:
    path = Path(file)
    return Surface.welded(_read_triangles(path), path.name, size_mm)


def _welded(corners: Floats, distance_mm: float) -> tuple[Points, Ints]:
    """Return vertices and triangles, near corners being one, collapsed triangles left out."""
    points = corners.reshape(-1, 3)
    # Number the corners that are exactly equal, in lexicographic order.
    order = np.lexsort(points.T[::-1])
    first_of_each = np.ones(len(points), bool)
    first_of_each[1:] = np.any(np.diff(points[order], axis=0), axis=1)
    vertices = points[order[first_of_each]]
    number = np.empty(len(points), np.int64)
    number[order] = np.cumsum(first_of_each) - 1
    # Join corners within the distance: connected components of the graph of neighbours.
    if distance_mm:
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        near = cKDTree(vertices).sparse_distance_matrix(
            cKDTree(vertices), distance_mm, output_type="coo_matrix"
        )
        near.data[:] = 1.0
        _, group = connected_components(near, directed=False)
        _, first = np.unique(group, return_index=True)
        vertices = vertices[first]
        number = group[number.ravel()]
    # Triangles of which two corners became one are no triangles any more.
    triangles = number.reshape(-1, 3).astype(np.int64)
    kept = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    return vertices, triangles[kept]


def _open_edges(triangles: Ints) -> Ints:
    """Return the (e, 2) edges that don't belong to exactly two triangles."""
    edges, count = _counted(np.sort(Surface.directed_edges(triangles), axis=1))
    return np.asarray(edges[count != 2])


def _counted(edges: Ints) -> tuple[Ints, Ints]:
    """Return the different rows of pairs (e, 2) of vertices, and how often each occurs."""
    size = int(edges.max(initial=0)) + 1
    keys, count = np.unique(edges[:, 0] * size + edges[:, 1], return_counts=True)
    return np.stack(np.divmod(keys, size), axis=1), count


def _refuse_open(vertices: Points, triangles: Ints, name: str) -> None:
    edges = _open_edges(triangles)
    if len(edges) or len(triangles) < 4:
        place = vertices[edges[0]].mean(axis=0) if len(edges) else np.zeros(3)
        raise InputError(
            f"{name}: the surface is not watertight: {len(edges)} edges do not belong to exactly "
            f"two triangles, the first at ({coordinates(place)}) mm; mend the "
            "holes and export it again"
        )
    ways, count = _counted(Surface.directed_edges(triangles))
    if (count != 1).any():
        place = vertices[ways[np.argmax(count)]].mean(axis=0)
        raise InputError(
            f"{name}: {int(np.sum(count - 1))} neighbouring triangles are wound against each "
            f"other, the first at ({coordinates(place)}) mm; make the normals "
            "consistent and export it again"
        )


def _refuse_parts(vertices: Points, triangles: Ints, name: str) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = Surface.directed_edges(triangles)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices), len(vertices)))
    parts, of_vertex = connected_components(graph, directed=False)
    if parts != 1:
        smallest = np.bincount(of_vertex[triangles[:, 0]]).min()
        raise InputError(
            f"{name}: {parts} separate surfaces, the smallest of {smallest} triangles (allowed: 1 "
            "body without hollows); join the bodies, or export one"
        )
