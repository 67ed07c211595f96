"""Interpolated corrections: those of many small patches, from a few that are solved.

Where a patch moves, its correction w changes smoothly. So w is solved for probe patches at the
nodes of a grid and interpolated in the patch's place, the force being held in the patch's own
frame: `Region` on a Chebyshev grid around one contact, `EdgeRegion` on some of the patches of a
contact beside the end of the surface, `SurfaceTable` on a grid of cubic B-splines over the middle
of a curved sensing surface. `AdjointFields` are the reverse: solved for the points, after which any
number of patches are products.

The error of a `SurfaceTable` is estimated from every other node: on the reference finger a few
parts in ten thousand of the largest displacement under loads 2 to 4 mm wide, up to two in a
thousand, and five under single patches. Validity: patches on the true surface, in the window, no
wider than the grid's spacing. Twists, whose forces nearly cancel, are left to a solve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander2d
from scipy.linalg import qr
from scipy.spatial import ConvexHull

from twin.arrays import Bools, Floats, Ints, Points, Progress, grid_points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles, Traction
from twin.world.elasticity.cache import cached_field, field_key
from twin.world.elasticity.correction import correction, unbalanced
from twin.world.elasticity.discretise import onto_surface
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.tensor_basis import Axis
from twin.world.mesh.interpolate import Locator, Recovery
from twin.world.mesh.sizing import Sizing

GRAIN_MM = 1.2
"""Region per node beyond the first three; on the reference finger the field of a whole contact is
then .3 % off."""

MOST = 9
"""Nodes per direction at most."""

INDEPENDENT = 1e-6
"""Least part of a polynomial that no other makes up on the patches, over the largest."""

INSIDE = 1e-9
"""How far outside a hull a patch may be that counts as inside, over the hull's size."""

ROOM = 0.3
"""Share of its size by which a region is made larger on every side, for contact that grows or
moves."""

PROBE_GOAL = 1e-6
"""Relative residual that is enough for what is interpolated to a few parts in a thousand."""

SNAP_MM, SNAP_SIZE = 0.5, 1.1
"""Grid to which a region's place and ends are rounded, and ratio to whose powers its patches' sizes
are."""

KEPT_BYTES = 150_000_000
"""Largest size of the solved fields of separate patches that is worth the disk."""

BATCH = 32
"""Patches per block of right-hand sides, which bounds the memory."""


class Region:
    """Solved corrections of probe patches all over one region of the surface, `ROOM` larger than
    the rectangles need, for any patches within it.

    Raises an `InputError` where the region runs over the end of the sensing surface.
    """

    def __init__(self, system: TaylorHood, body: Body, rectangles: Rectangles) -> None:
        chart = body.chart_of(rectangles.centre_mm.mean(axis=0)[None])
        centre = body.chart_points(np.round(chart / SNAP_MM) * SNAP_MM)
        self._centre, self._frame, self._system = centre[0], body.frames(centre)[0], system
        offsets = self._offsets(rectangles)
        low, high = offsets.min(axis=0), offsets.max(axis=0)
        room = np.maximum(ROOM * (high - low), GRAIN_MM / 4)
        self._low, self._high = (
            SNAP_MM * np.floor((low - room) / SNAP_MM),
            SNAP_MM * np.ceil((high + room) / SNAP_MM),
        )
        self._axes = [
            Axis.lagrange(
                (a + b) / 2 + (b - a) / 2 * chebpts1(min(3 + math.ceil((b - a) / GRAIN_MM), MOST))
            )
            for a, b in zip(self._low, self._high, strict=True)
        ]
        half = SNAP_SIZE ** np.round(np.log(rectangles.half_mm.mean(axis=0)) / math.log(SNAP_SIZE))
        probes = self._probes(body, half)
        self._fields = _fields_of(system, body, probes, probes.frames.transpose(0, 2, 1))

    @staticmethod
    def pays(rectangles: Rectangles, *, reused: bool = False) -> bool:
        """Return whether patches are many, and close enough together, for interpolation to save
        solves; with ``reused``, when finer grids in the same place follow, a quarter will do."""
        size = np.sort(np.ptp(rectangles.centre_mm, axis=0))[1:] * (1.0 + 2.0 * ROOM)
        nodes = 3 + np.ceil(np.maximum(size, GRAIN_MM / 2) / GRAIN_MM)
        count = np.minimum(nodes, MOST).prod()
        enough = len(rectangles) > (count / 4 if reused else count)
        return bool(nodes.max() <= 2 * MOST and enough)

    def covers(self, rectangles: Rectangles) -> bool:
        """Return whether all patches lie in the region."""
        offsets = self._offsets(rectangles)
        return bool((offsets >= self._low).all() and (offsets <= self._high).all())

    def corrections(self, places: Locator.Places, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at ``places`` (n), for E = 1 MPa, per unit global force on
        each rectangle."""
        weight, k = self._weights(self._offsets(rectangles)), len(rectangles)
        values = places.matrix(len(self._system.mesh.points)) @ self._fields.reshape(
            len(self._fields), -1
        )
        turned = np.einsum("kj,kcg->jckg", weight, rectangles.frames).reshape(-1, 3 * k)
        return np.asarray((values.reshape(-1, len(turned)) @ turned).reshape(-1, 3, k, 3))

    def _offsets(self, rectangles: Rectangles) -> Floats:
        return np.asarray((rectangles.centre_mm - self._centre) @ self._frame[:2].T)

    def _weights(self, offsets: Floats) -> Floats:
        """Return (k, p): the weights of the p probe patches at offsets (k, 2)."""
        along = [axis.basis(offset) for axis, offset in zip(self._axes, offsets.T, strict=True)]
        return Axis.tensor_product(*along)

    def _probes(self, body: Body, half_mm: Floats) -> Rectangles:
        offsets = grid_points(*(axis.nodes for axis in self._axes))
        size = self._high - self._low
        whole = Traction(
            kind="rectangle",
            centre_mm=tuple(self._centre),
            size_mm=(float(size[0]), float(size[1])),
        )
        points: Points = onto_surface(offsets, self._centre, self._frame, body, whole)
        return Rectangles.at(body, points, half_mm)


class EdgeRegion(Region):
    """A region up to the end of the sensing surface, of any outline.

    Polynomials are interpolated between some of the rectangles themselves: approximate Fekete
    points of products of Chebyshev polynomials (A. Sommariva and M. Vianello, Computers and
    Mathematics with Applications 57, 2009), within their hull. Error: 2e-4 of the largest
    displacement and less, 2 to 6e-3 within 0.5 mm of a free edge, where the meshes' own is larger.
    """

    def __init__(self, system: TaylorHood, body: Body, rectangles: Rectangles) -> None:
        self._system = system
        self._centre = rectangles.centre_mm.mean(axis=0)
        self._frame = body.frames(body.chart_points(body.chart_of(self._centre[None])))[0]
        offsets = self._offsets(rectangles)
        self._low, self._high = offsets.min(axis=0), offsets.max(axis=0)
        # The patches may tell fewer polynomials apart than there are, such as those in two rows.
        self._degrees = (_nodes(self._high - self._low) - 1).tolist()
        products = self._products(offsets)
        _, triangle, order = qr(products.T, mode="economic", pivoting=True)
        known = np.abs(np.diag(triangle)) > INDEPENDENT * abs(triangle[0, 0])
        chosen = order[: len(known)][known]
        flat = np.linalg.matrix_rank(offsets) == 2
        self._hull = ConvexHull(offsets).equations if flat else None
        self._to_probes = np.linalg.pinv(products[chosen], rcond=INDEPENDENT)
        probes = rectangles[chosen]
        self._fields = _fields_of(system, body, probes, probes.frames.transpose(0, 2, 1))

    @staticmethod
    def pays(rectangles: Rectangles, *, reused: bool = False) -> bool:
        """Return whether patches are so many more than the polynomials that this saves solves."""
        size = np.sort(np.ptp(rectangles.centre_mm, axis=0))[1:]
        return reused and bool(len(rectangles) > 2 * _nodes(size).prod())

    def covers(self, rectangles: Rectangles) -> bool:
        """Return whether all patches lie in the hull of those that the region was made of."""
        if self._hull is None:
            return False
        out = self._offsets(rectangles) @ self._hull[:, :2].T + self._hull[:, 2]
        return bool((out <= INSIDE * (self._high - self._low).max()).all())

    def _weights(self, offsets: Floats) -> Floats:
        return np.asarray(self._products(offsets) @ self._to_probes)

    def _products(self, offsets: Floats) -> Floats:
        """Return (k, p): the products of polynomials at offsets (k, 2)."""
        middle, half = (self._low + self._high) / 2, (self._high - self._low) / 2
        scaled = (offsets - middle) / np.maximum(half, 1e-300)
        return chebvander2d(scaled[:, 0], scaled[:, 1], self._degrees)


def _fields_of(system: TaylorHood, body: Body, rectangles: Rectangles, axes: Floats) -> Floats:
    """Return the (N, 3, 3 k) corrections under unit forces along axes (k, 3, 3) of k patches, of
    which each is a column, as they are kept on disk."""
    return cached_field(
        field_key(system, body, rectangles.centre_mm, rectangles.frames, rectangles.half_mm, axes),
        lambda: np.concatenate(
            [field for _, field in _solved(system, body, rectangles, axes)], axis=2
        ),
        (len(system.mesh.points), 3, 3 * len(rectangles)),
        single=True,
    )


def _nodes(size_mm: Floats) -> Ints:
    """Return (2,) the polynomials along each direction that an `EdgeRegion` of a size (2,) has:
    beyond `MOST` half as many."""
    nodes = 3 + np.ceil(size_mm / GRAIN_MM).astype(int)
    half = np.clip(-(-nodes // 2), MOST, 2 * MOST)
    return np.asarray(np.minimum(nodes, half))


def patch_corrections(
    system: TaylorHood,
    body: Body,
    places: Locator.Places,
    rectangles: Rectangles,
    *,
    moving: bool = False,
) -> Floats:
    """Return (n, 3, k, 3) like `Region.corrections`, every patch being solved for itself. The
    fields are kept on disk if they fill no more than `KEPT_BYTES`, or if points are ``moving``."""
    nodes, patches = len(system.mesh.points), len(rectangles)
    matrix = places.matrix(nodes)
    axes = np.broadcast_to(np.eye(3), (patches, 3, 3))
    together = max(KEPT_BYTES // (4 * 9 * nodes), 1)
    parts = _solved(system, body, rectangles, axes)
    if moving or patches <= together:
        files = [slice(first, first + together) for first in range(0, patches, together)]
        parts = ((f, _fields_of(system, body, rectangles[f], axes[f])) for f in files)
    out = np.empty((len(places.nodes), 3, patches, 3))
    for part, fields in parts:
        out[:, :, part] = (matrix @ fields.reshape(nodes, -1)).reshape(len(out), 3, -1, 3)
    return out


class AdjointFields:
    """Adjoint solves for points located in a system's mesh: after three a point, the corrections
    of any number of patches are products."""

    def __init__(self, system: TaylorHood, body: Body, places: Locator.Places) -> None:
        self._system, self._body = system, body
        self._matrix = places.matrix(len(system.mesh.points))
        self._influence = system.influence(self._matrix, PROBE_GOAL)

    def corrections(self, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3) like `patch_corrections`."""
        out = np.empty((self._matrix.shape[0], 3, len(rectangles), 3))
        axes = np.broadcast_to(np.eye(3), (len(rectangles), 3, 3))
        for part, patches, columns in _batches(rectangles, axes):
            drive = unbalanced(self._system, self._body, patches, columns)
            out[:, :, part] = self._system.read(self._influence, self._matrix, *drive).reshape(
                len(out), 3, -1, 3
            )
        return out


def _solved(
    system: TaylorHood, body: Body, rectangles: Rectangles, axes: Floats
) -> Iterator[tuple[slice, Floats]]:
    """Yield which patches, and the (N, 3, 3 k) corrections under unit forces along the columns of
    each patch's axes."""
    for part, patches, columns in _batches(rectangles, axes):
        yield part, correction(system, body, patches, columns, PROBE_GOAL)


def _batches(
    rectangles: Rectangles, axes: Floats
) -> Iterator[tuple[slice, list[Rectangles], list[Floats]]]:
    for start in range(0, len(rectangles), BATCH):
        part = slice(start, min(start + BATCH, len(rectangles)))
        each = range(part.start, part.stop)
        yield part, [rectangles[i : i + 1] for i in each], [axes[i][None] for i in each]


NODES = 19
"""Nodes of the grid along each side; odd, so that every other one is a grid, too."""

PATCH = 1 / 70
"""Half side of the patches that are solved, over the window's half side."""

CLEAR = 0.05
"""Least distance of the window from the body's other faces, over its half side."""

CANCEL = 0.5
"""A load whose total force is less than this share of its forces' sizes is not interpolated."""

KEPT_POINTS = 1000
"""Points for which readings are kept, at most: they take 26 kB a point, gradients three times
that."""

_ALL = slice(None)

SHARE = 0.4
"""Share of the difference to the grid of every other node that is taken for the error of
interpolation."""


class SurfaceTable:
    """Corrections of patches on a grid over a curved sensing surface, for any load within it.

    Raises an `InputError` where the window comes too near to another face of the body.
    """

    def __init__(self, system: TaylorHood, body: Body, progress: Progress | None = None) -> None:
        self._system, self._body = system, body
        self._half = np.array(Sizing.of(body, "standard").window_mm)
        axes = [Axis.splines(np.linspace(-half, half, NODES)) for half in self._half]
        self._weights = {step: [_weights(axis, step) for axis in axes] for step in (1, 2)}
        chart = grid_points(*(axis.nodes for axis in axes))
        points = body.chart_points(chart)
        clear = float(body.piece_distances(points)[:, 1:].min())
        if not clear > CLEAR * self._half.min():
            raise InputError(
                "accuracy.surface_table = true: the window that would be tabled, "
                f"{2 * self._half[0]:.3g} x {2 * self._half[1]:.3g} mm of the sensing surface "
                f"around the origin, comes within {clear:.3g} mm of another face or runs over it "
                f"(allowed: {CLEAR * self._half.min():.3g} mm and more): set it to false"
            )
        probes = Rectangles.at(body, points, PATCH * float(self._half.min()))
        self._fields = cached_field(
            field_key(system, body, probes.centre_mm, probes.half_mm),
            lambda: _coefficients(_all_solved(system, body, probes, progress), axes),
            (len(system.mesh.points), 3, 3 * len(probes)),
            single=True,
        )
        self._grid = self._fields.reshape(-1, 3, NODES, NODES, 3)

    def covers(self, load: Rectangles) -> bool:
        """Tell whether all patches lie on the true surface in the window and are small enough."""
        if not (load.half_mm.max(initial=0.0) <= self._half.min() / (NODES - 1)):
            return False
        if not (np.abs(self._body.chart_of(load.centre_mm)) <= self._half).all():
            return False
        upright: Bools = (
            np.sum(load.frames[:, 2] * self._body.frames(load.centre_mm)[:, 2], axis=1) > 1.0 - 1e-9
        )
        return bool(upright.all())

    def pushes(self, load: Rectangles) -> bool:
        """Tell whether the load's forces add up, instead of cancelling each other as those of a
        twist do."""
        sizes = np.linalg.norm(load.force_n, axis=1).sum()
        return bool(np.linalg.norm(load.force_n.sum(axis=0)) >= CANCEL * sizes)

    def reading(self, places: Recovery.Weighted) -> Floats:
        """Return (n, 3, s, t, axis): the coefficients of w at ``places`` (n), mm for unit forces
        and 1 MPa."""
        return self._read(places, places.weights[:, :, None])[:, :, 0]

    def slopes(self, places: Locator.Places) -> Floats:
        """Return (n, 3, 3, s, t, axis): `reading` and, on the third axis, its derivative along x, y
        and z."""
        return self._read(places, places.slopes)

    def _read(
        self, places: Recovery.Weighted, weights: Floats, s: slice = _ALL, t: slice = _ALL
    ) -> Floats:
        """Return (n, 3, m, s, t, axis) of some of the grid's rows ``s`` and columns ``t``, by
        weights (n, k, m)."""
        fields = self._grid[:, :, s, t]
        out = np.empty((len(places.nodes), weights.shape[2], math.prod(fields.shape[1:])))
        for start in range(0, len(out), 64):
            part = slice(start, start + 64)
            used, column = np.unique(places.nodes[part], return_inverse=True)
            rows = np.asarray(fields[used], float).reshape(len(used), -1)
            column = column.reshape(-1, places.nodes.shape[1])
            for axis in range(weights.shape[2]):
                matrix = np.zeros((len(column), len(used)))
                np.put_along_axis(matrix, column, weights[part, :, axis], axis=1)
                out[part, axis] = matrix @ rows
        each = out.reshape(len(out), weights.shape[2], *fields.shape[1:])
        return np.ascontiguousarray(each.swapaxes(1, 2))

    def displacement(self, reading: Floats, load: Rectangles) -> tuple[Points, float]:
        """Return (n, 3) w in mm for E = 1 MPa under ``load``, and the largest error of
        interpolation, mm."""
        w, every_other = (
            np.tensordot(reading, self._moments(load, step), axes=3) for step in (1, 2)
        )
        return w, SHARE * float(np.linalg.norm(w - every_other, axis=1).max(initial=0.0))

    def field(self, load: Rectangles, step: int = 1) -> Floats:
        """Return the (N, 3) nodal field of w, mm for E = 1 MPa, in float32's digits; for more
        points than are kept."""
        return np.tensordot(
            self._grid, self._moments(load, step).astype(np.float32), axes=3
        ).astype(float)

    def gradient(self, slopes: Floats, load: Rectangles) -> Floats:
        """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa under ``load``."""
        return np.asarray(np.tensordot(slopes, self._moments(load, 1), axes=3))

    def corrections(self, places: Locator.Places, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at ``places`` for E = 1 MPa per unit global force on each
        rectangle."""
        along = self._splines(rectangles, 1)
        s, t = (_span(one) for one in along)
        weight = Axis.tensor_product(along[0][:, s], along[1][:, t])
        frames = self._body.frames(rectangles.centre_mm)
        turned = np.einsum("kp,kaj->pakj", weight, frames).reshape(-1, 3 * len(rectangles))
        values = self._read(places, places.weights[:, :, None], s, t).reshape(
            3 * len(places.nodes), -1
        )
        return np.asarray(values @ turned).reshape(-1, 3, len(rectangles), 3)

    def _moments(self, load: Rectangles, step: int) -> Floats:
        """Return (s, t, axis): how strongly the load pulls on each patch of the grid, or of every
        other one."""
        own = np.einsum("kij,kj->ki", self._body.frames(load.centre_mm), load.force_n)
        return np.asarray(
            np.einsum("ks,kt,ka->sta", *self._splines(load, step), own, optimize=True)
        )

    def _splines(self, load: Rectangles, step: int) -> list[Floats]:
        """Return (k, s) and (k, t): the weights of the coefficients at the patches."""
        chart = self._body.chart_of(load.centre_mm)
        return [weights(chart[:, axis]) for axis, weights in enumerate(self._weights[step])]


def _weights(axis: Axis, step: int) -> Callable[[Floats], Floats]:
    """Return what the coefficients of an axis' splines weigh at places; with ``step`` 2 as every
    other node has it."""
    if step == 1:
        return axis.basis
    coarse = Axis.splines(axis.nodes[::step])
    from_nodes = np.linalg.solve(coarse.basis(coarse.nodes), axis.basis(coarse.nodes))
    return lambda places: np.asarray(coarse.basis(places) @ from_nodes)


def _span(weights: Floats) -> slice:
    """Return the columns between the first and the last that hold anything."""
    held = np.flatnonzero(weights.any(axis=0))
    return slice(int(held[0]), int(held[-1]) + 1)


def _coefficients(fields: Floats, axes: list[Axis]) -> Floats:
    """Return what the axes' splines are multiplied with to pass through ``fields`` (N, 3, 3 k) of
    the nodes."""
    from_nodes = [axis.from_nodes().astype(np.float32) for axis in axes]
    for start in range(0, len(fields), 1000):
        part = fields[start : start + 1000].reshape(-1, *(len(axis.nodes) for axis in axes), 3)
        along = np.einsum("us,nsta->nuta", from_nodes[0], part, optimize=True)
        along = np.einsum("vt,nuta->nuva", from_nodes[1], along, optimize=True)
        fields[start : start + 1000] = along.reshape(-1, *fields.shape[1:])
    return fields


def _all_solved(
    system: TaylorHood, body: Body, probes: Rectangles, progress: Progress | None
) -> Floats:
    """Return the (N, 3, 3 k) corrections of all patches, float32."""
    parts = []
    for part, fields in _solved(system, body, probes, probes.frames.transpose(0, 2, 1)):
        parts.append(fields.astype(np.float32))
        if progress is not None:
            progress("table of the sensing surface", part.stop / len(probes))
    return np.concatenate(parts, axis=2)
