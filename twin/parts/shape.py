"""What every body is: its shape as level sets, shared by surface, cover, marker layers and meshes.

Depth below the sensing surface is an exact distance, so marker layers, the cover and the snapping
of mesh nodes need no triangles, and a new body is one class with a few formulas. An `StlFile` is a
shape that a closed surface in a file gives; it stores the digest of its file and checks it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator, model_validator

from twin.arrays import Bools, Chart, Floats, Ints, Points, coordinates
from twin.errors import InputError
from twin.files import file_digest
from twin.geometry.closed import Surface
from twin.parts.part import Part

_FORGIVEN = 1e-6
"""How far outside the body, in mm, a point still counts as on its surface."""

_ROUNDING_MM = 1e-14
"""Distance from a sheet at which a point counts as being on it."""

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]


class Body(Part):
    """A solid, held on some pieces of its boundary, pressed on another."""

    @property
    @abstractmethod
    def pieces(self) -> tuple[str, ...]:
        """Names of the boundary's smooth pieces in order: ``sensing`` first, ``held``, the base,
        last."""

    @abstractmethod
    def piece_distances(self, points: Points) -> Floats:
        """Return (n, pieces) distances, mm, to every boundary piece, positive inside."""

    @abstractmethod
    def piece_normals(self, points: Points) -> Floats:
        """Return (n, pieces, 3) unit inward normals: the gradients of `piece_distances`."""

    @abstractmethod
    def chart_points(self, chart: Chart, depth_mm: Floats | float = 0.0) -> Points:
        """Return the (n, 3) points ``depth_mm`` below arc lengths (s, t) on the outer surface."""

    @abstractmethod
    def chart_of(self, points: Points) -> Chart:
        """Return the (n, 2) arc lengths (s, t) of the surface points above ``points``."""

    @abstractmethod
    def surface_from_above(self, xy: Floats) -> Points:
        """Return the (n, 3) points of the sensing surface met from -z at (x, y); NaN for none."""

    @property
    @abstractmethod
    def bounds_mm(self) -> Bounds:
        """Lowest and highest corner of the box around the body, mm."""

    @property
    @abstractmethod
    def volume_mm3(self) -> float:
        """Exact volume."""

    @property
    def sensing_sheets(self) -> Bools:
        """(sheets,) whether each smooth sheet of the boundary is pressed.

        Mesh nodes are moved onto sheets: they meet at sharp edges only, while the border between
        two pieces may cross a rounding. Of a body given by formulas they are the pieces.
        """
        return np.asarray(np.arange(len(self.pieces)) == 0)

    @property
    def has_smooth_border(self) -> bool:
        """Whether the sensing surface goes on as a rounding where it is not pressed any more."""
        return False

    def sheet_distances(self, points: Points) -> Floats:
        """Return (n, sheets) distances, mm, to every sheet, positive inside."""
        return self.piece_distances(points)

    def sheet_normals(self, points: Points) -> Floats:
        """Return (n, sheets, 3) unit inward normals: the gradients of `sheet_distances`."""
        return self.piece_normals(points)

    def from_sheets(self, points: Points, sheet: Ints) -> tuple[Floats, Floats]:
        """Return distances (n,), mm, of (n, 3) points from sheets (n,), and gradients (n, 3)."""
        row = np.arange(len(points))
        return self.sheet_distances(points)[row, sheet], self.sheet_normals(points)[row, sheet]

    def onto_sheets(self, points: Points, on: Bools, *, depth_mm: float = 0.0) -> Points:
        """Return the (n, 3) nearest points on sheets, edges (two sheets) or corners (three) of the
        surface, by Newton steps of least length.

        Parameters
        ----------
        on
            (n, sheets): the sheets that each point shall lie on; none leaves the point where it is.
        depth_mm
            Depth of the level set that takes the sensing sheets' place.
        """
        points = np.array(points, dtype=np.float64)
        moving = np.flatnonzero(on.any(axis=1))
        for _ in range(30):
            away = self.sheet_distances(points[moving]) - depth_mm * self.sensing_sheets
            distance = np.where(on[moving], away, 0.0)
            off = np.abs(distance).max(axis=1, initial=0.0) >= _ROUNDING_MM
            moving = moving[off]
            if len(moving) == 0:
                break
            normals = np.where(on[moving, :, None], self.sheet_normals(points[moving]), 0.0)
            step = np.linalg.pinv(normals, rcond=1e-6) @ distance[off, :, None]
            points[moving] -= step[:, :, 0]
        return points

    def pieces_on(self, points: Points, sheet: Ints) -> Ints:
        """Return (n,) the piece at points (n, 3) of the sheets (n,)."""
        return sheet

    def sheets_of(self, corners: Floats, piece: Ints) -> Ints:
        """Return (f,) the sheets of boundary faces, from their nodes (f, k, 3) and pieces (f,)."""
        return piece

    @property
    def held_pieces(self) -> tuple[int, ...]:
        """Indices into `pieces` of those bonded to something rigid; all others are free."""
        return (len(self.pieces) - 1,)

    @property
    def edge_pieces(self) -> list[int]:
        """Indices into `pieces` of the free ones at whose edges the sensing surface may end; none
        where it goes on beyond a smooth border."""
        if self.has_smooth_border and not self.is_flat:
            return []
        return [piece for piece in range(1, len(self.pieces)) if piece not in self.held_pieces]

    @property
    def is_flat(self) -> bool:
        """Whether the sensing surface is a plane."""
        return False

    @property
    def layer_mm(self) -> float | None:
        """Thickness H, mm, of the layer 0 <= z <= H that the body is a piece of, held at z = H
        only, over no less than is pressed of z = 0; None for others."""
        return None

    @property
    def is_convex(self) -> bool:
        """Whether the body lies behind every tangent plane of its surface."""
        return True

    def is_level_around(self, x_mm: float, y_mm: float, reach_mm: float) -> bool:
        """Return whether the sensing surface is z = 0 over a square, ``reach_mm`` from (x, y) each
        way."""
        if not self.is_convex:
            return False
        corners = np.array(
            [(0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
        ) * reach_mm + (x_mm, y_mm)
        distances = self.piece_distances(np.column_stack([corners, np.zeros(len(corners))]))
        return bool(not distances[:, 0].any() and distances[:, 1:].min() > 0.0)

    def stands_out(self, points: Points, normals: Floats) -> Floats:
        """Return (n,) how steeply the body rises over planes at points, ``normals`` pointing
        inwards: height over straight distance."""
        return np.zeros(len(points))

    @property
    def own_surface(self) -> tuple[Points, Ints] | None:
        """Vertices (n, 3) and outward triangles (m, 3) of a body given by them, else None."""
        return None

    @property
    def chord_mm(self) -> float:
        """How far given triangles lie off the curved faces that they stand for, mm, at most."""
        return 0.0

    @property
    def own_rim(self) -> Floats | None:
        """Ends (e, 2, 3) of edges of singular stress, of given triangles: held meets free, or a
        fold inwards."""
        return None

    def geometry(self) -> dict[str, Any]:
        """Return what the shape depends on, as plain values."""
        return self.model_dump(exclude={"source", "assumed"})

    @property
    def base_z_mm(self) -> float:
        """Height of the held base plane, mm; the camera looks through it."""
        return self.bounds_mm[1][2]

    @property
    def has_window(self) -> bool:
        """Whether something is held in the base plane, so that a camera can look through it."""
        return True

    def depth(self, points: Points) -> Floats:
        """Return (n,) depths below the outer sensing surface, mm, positive inside."""
        return self.piece_distances(points)[:, 0]

    def contains(self, points: Points, margin_mm: float = 0.0) -> Bools:
        """Return (n,) whether points are at least ``margin_mm`` inside; a negative one forgives
        round-off."""
        return np.asarray(np.all(self.piece_distances(points) >= margin_mm, axis=1))

    def holds(self, points: Points) -> Bools:
        """Return (n,) whether (n, 3) points of the body are sure to lie on a held piece.

        Planes of given triangles go on beyond their face, so of these only a layer's are sure.
        """
        if self.own_surface is not None and self.layer_mm is None:
            return np.zeros(len(points), np.bool_)
        away = self.piece_distances(points)
        on = np.abs(away[:, list(self.held_pieces)]).min(axis=1) <= _FORGIVEN
        return np.asarray(on & (away.min(axis=1) >= -_FORGIVEN))

    def surface_samples(self, spacing_mm: float) -> Points:
        """Return (n, 3) surface points, mm, about ``spacing_mm`` apart, on rays from the middle."""
        low, high = np.array(self.bounds_mm)
        middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
        count = int(4 * np.pi * (reach / 2 / spacing_mm) ** 2) + 200
        height = 1 - (2 * np.arange(count) + 1) / count
        turn = np.pi * (1 + 5**0.5) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        direction = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
        inside, outside = np.zeros(count), np.full(count, reach)
        for _ in range(60):
            trial = (inside + outside) / 2
            within = self.contains(middle + trial[:, None] * direction)
            inside, outside = np.where(within, trial, inside), np.where(within, outside, trial)
        return np.asarray(middle + inside[:, None] * direction)

    def require_inside(self, points: Points) -> None:
        """Raise an `InputError`, naming the first offender, unless all (n, 3) points are in the
        body."""
        points = np.asarray(points, float)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(f"points must have the shape (n, 3), got {points.shape}")
        distances = self.piece_distances(points)
        outside = ~(np.min(distances, axis=1) >= -_FORGIVEN)
        if not np.any(outside):
            return
        first = int(np.argmax(outside))
        piece = int(np.argmin(distances[first]))
        place = coordinates(points[first])
        low, high = self.bounds_mm
        raise InputError(
            f"point {first} at ({place}) mm is {-distances[first, piece]:.3g} mm outside the body, "
            f"beyond its {self.pieces[piece]} face ({int(outside.sum())} of {len(points)} points "
            f"are); the body lies between {low} and {high} mm"
        )

    def frames(self, points: Points) -> Floats:
        """Return (n, 3, 3) right-handed frames at surface points: tangents s and t, inward
        normal."""
        normal = self.piece_normals(points)[:, 0]
        along_s = np.array([1.0, 0.0, 0.0]) - normal[:, :1] * normal
        length = np.linalg.norm(along_s, axis=1, keepdims=True)
        along_s = np.where(length > 1e-9, along_s / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
        return np.stack([along_s, np.cross(normal, along_s), normal], axis=1)


class StlFile(Part):
    """The inside of a closed STL surface.

    Attributes
    ----------
    file
        STL file in mm, relative to the recipe.
    sha256
        Digest of the file; filled in when it is read, checked when it is given.
    """

    largest_mm: ClassVar[tuple[float, float]]
    """Allowed longest side of the box around the surface, mm."""

    file: str
    sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$")

    @field_validator("file")
    @classmethod
    def _is_a_closed_surface(cls, file: str) -> str:
        try:
            Surface.read(file, cls.largest_mm)
        except InputError as problem:
            raise ValueError(str(problem)) from None
        return file

    @model_validator(mode="before")
    @classmethod
    def _carries_a_digest(cls, table: Any) -> Any:
        """Fill in the digest of the file, so that hashes of the description stand for its content,
        or check the one that is given."""
        file = table.get("file") if isinstance(table, dict) else None
        if not isinstance(file, str) or not Path(file).is_file():
            return table
        found = file_digest(Path(file))
        given = table.get("sha256") or found
        if isinstance(given, str) and given != found:
            raise ValueError(
                f"sha256 = {given[:12]}... but {Path(file).name} has {found[:12]}...: the file was "
                "changed; leave sha256 out to take the new one"
            )
        return {**table, "sha256": given}

    @staticmethod
    def renamed(value: Any, changed: Callable[[str], str]) -> Any:
        """Return a plain value in which every probe's own file, however deep, has another name."""
        if isinstance(value, Mapping):
            table = {key: StlFile.renamed(inner, changed) for key, inner in value.items()}
            own = table.get("kind") == "stl" and isinstance(table.get("file"), str)
            return {**table, "file": changed(table["file"])} if own else table
        if isinstance(value, list | tuple):
            return [StlFile.renamed(inner, changed) for inner in value]
        return value

    @staticmethod
    def bare(value: Any) -> Any:
        """Return a plain value with the files of probes by their names alone, wherever they lie."""
        return StlFile.renamed(value, lambda file: Path(file).name)
