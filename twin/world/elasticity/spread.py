"""The smooth rest for many small patches in one region, from a few: a contact's compliance in a few dozen solves.

Where a patch is moved within a contact, its rest w changes smoothly; so w is solved for probe patches at the nodes of
a Chebyshev grid over the region, and interpolated in the patch's place, the force being held in the patch's own frame.
A region is kept, in memory and on disk: the next grid of the same press, the next step of its path, or the same press
in another run costs products only. Its place and size are rounded, so that presses near each other share it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from twin.arrays import Floats, Points
from twin.parts.body import Body
from twin.parts.load import Rectangles, Traction
from twin.world.elasticity.correction import correction, unbalanced
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.store import field_key, kept
from twin.world.elasticity.tile import onto_surface
from twin.world.mesh.interpolate import Places

GRAIN_MM = 1.2
"""Region per node beyond the first three; on the reference finger the field of a whole contact is then .3 % off."""

MOST = 9
"""Nodes per direction at most."""

ROOM = 0.3
"""Share of its size by which a region is made larger on every side, for contact that grows or moves."""

PROBE_GOAL = 1e-6
"""Relative residual that is enough for what is interpolated to a few parts in a thousand: it saves the refinement."""

SNAP_MM, SNAP_SIZE = 0.5, 1.1
"""Grid to which a region's place and ends are rounded, and ratio to whose powers its patches' sizes are."""

KEPT_BYTES = 150_000_000
"""Largest size of the solved fields of separate patches that is worth the disk."""

BATCH = 32
"""Patches per block of right-hand sides, which bounds the memory."""


class Region:
    """Solved rests of probe patches all over one region of the surface, for any patches within it.

    Parameters
    ----------
    system, body
        The elastic system and the body it belongs to.
    rectangles
        The patches whose region this is to be, `ROOM` larger than they need.

    Raises
    ------
    InputError
        The region runs over the end of the sensing surface.
    """

    def __init__(self, system: TaylorHood, body: Body, rectangles: Rectangles) -> None:
        chart = body.chart_of(rectangles.centre_mm.mean(axis=0)[None])
        centre = body.chart_points(np.round(chart / SNAP_MM) * SNAP_MM)
        self._centre, self._frame, self._system = centre[0], body.frames(centre)[0], system
        offsets = self._offsets(rectangles)
        low, high = offsets.min(axis=0), offsets.max(axis=0)
        room = np.maximum(ROOM * (high - low), GRAIN_MM / 4)
        self._low, self._high = SNAP_MM * np.floor((low - room) / SNAP_MM), SNAP_MM * np.ceil((high + room) / SNAP_MM)
        self._nodes = [
            (a + b) / 2 + (b - a) / 2 * chebpts1(min(3 + math.ceil((b - a) / GRAIN_MM), MOST))
            for a, b in zip(self._low, self._high, strict=True)
        ]
        half = SNAP_SIZE ** np.round(np.log(rectangles.half_mm.mean(axis=0)) / math.log(SNAP_SIZE))
        probes = self._probes(body, half)
        axes = probes.frames.transpose(0, 2, 1)
        self._fields = kept(
            field_key(system, body, probes.centre_mm, probes.half_mm),
            lambda: np.concatenate([field for _, field in solved(system, body, probes, axes)], axis=2),
            single=True,
        )

    def covers(self, rectangles: Rectangles) -> bool:
        """Return whether all patches lie in the region."""
        offsets = self._offsets(rectangles)
        return bool((offsets >= self._low).all() and (offsets <= self._high).all())

    def rests(self, places: Places, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at ``places`` (n), for E = 1 MPa, per unit global force on each rectangle."""
        offsets, k = self._offsets(rectangles), len(rectangles)
        along = [lagrange(nodes, offsets[:, axis]) for axis, nodes in enumerate(self._nodes)]
        weight = np.einsum("ka,kb->kab", *along).reshape(k, -1)
        values = places.matrix(len(self._system.mesh.points)) @ self._fields.reshape(len(self._fields), -1)
        turned = np.einsum("kj,kcg->jckg", weight, rectangles.frames).reshape(-1, 3 * k)
        return np.asarray((values.reshape(-1, len(turned)) @ turned).reshape(-1, 3, k, 3))

    def _offsets(self, rectangles: Rectangles) -> Floats:
        return np.asarray((rectangles.centre_mm - self._centre) @ self._frame[:2].T)

    def _probes(self, body: Body, half_mm: Floats) -> Rectangles:
        offsets = np.stack(np.meshgrid(*self._nodes, indexing="ij"), axis=-1).reshape(-1, 2)
        size = self._high - self._low
        whole = Traction(kind="rectangle", centre_mm=tuple(self._centre), size_mm=(float(size[0]), float(size[1])))
        points: Points = onto_surface(offsets, self._centre, self._frame, body, whole)
        return Rectangles(
            centre_mm=points,
            frames=body.frames(points),
            half_mm=np.tile(half_mm, (len(points), 1)),
            force_n=np.zeros((len(points), 3)),
        )


def worth_a_region(rectangles: Rectangles, *, reused: bool = False) -> bool:
    """Return whether patches are many, and close enough together, for interpolation to save solves.

    A contact's first and coarse grid is followed by finer ones in the same place: with ``reused`` a quarter will do.
    """
    size = np.sort(np.ptp(rectangles.centre_mm, axis=0))[1:] * (1.0 + 2.0 * ROOM)
    nodes = 3 + np.ceil(np.maximum(size, GRAIN_MM / 2) / GRAIN_MM)
    count = np.minimum(nodes, MOST).prod()
    return bool(nodes.max() <= 2 * MOST and len(rectangles) > (count / 4 if reused else count))


def patch_rests(system: TaylorHood, body: Body, places: Places, rectangles: Rectangles) -> Floats:
    """Return (n, 3, k, 3) like `Region.rests`, every patch being solved for itself; the fields are kept on disk.

    Patches whose fields would fill more than `KEPT_BYTES` are solved again each time.
    """
    axes = np.broadcast_to(np.eye(3), (len(rectangles), 3, 3))
    parts = solved(system, body, rectangles, axes)
    matrix = places.matrix(len(system.mesh.points))
    if 4 * 9 * len(system.mesh.points) * len(rectangles) <= KEPT_BYTES:
        key = field_key(system, body, rectangles.centre_mm, rectangles.frames, rectangles.half_mm)
        fields = kept(key, lambda: np.concatenate([field for _, field in parts], axis=2), single=True)
        parts = iter([(slice(None), fields)])
    out = np.empty((len(places.nodes), 3, len(rectangles), 3))
    for part, fields in parts:
        out[:, :, part] = (matrix @ fields.reshape(len(fields), -1)).reshape(len(out), 3, -1, 3)
    return out


class Readings:
    """Adjoint solves for points: after three a point, the rests of any number of patches are products.

    Parameters
    ----------
    system, body
        The elastic system and its body.
    places
        The points, located in the system's mesh.
    """

    def __init__(self, system: TaylorHood, body: Body, places: Places) -> None:
        self._system, self._body = system, body
        self._matrix = places.matrix(len(system.mesh.points))
        self._influence = system.influence(self._matrix, PROBE_GOAL)

    def rests(self, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3) like `patch_rests`."""
        out = np.empty((self._matrix.shape[0], 3, len(rectangles), 3))
        axes = np.broadcast_to(np.eye(3), (len(rectangles), 3, 3))
        for part, patches, columns in _batches(rectangles, axes):
            drive = unbalanced(self._system, self._body, patches, columns)
            out[:, :, part] = self._system.read(self._influence, self._matrix, *drive).reshape(len(out), 3, -1, 3)
        return out


def solved(system: TaylorHood, body: Body, rectangles: Rectangles, axes: Floats) -> Iterator[tuple[slice, Floats]]:
    """Yield which patches, and the (N, 3, 3 k) rests under unit forces along the columns of each patch's axes."""
    for part, patches, columns in _batches(rectangles, axes):
        yield part, correction(system, body, patches, columns, PROBE_GOAL)


def _batches(rectangles: Rectangles, axes: Floats) -> Iterator[tuple[slice, list[Rectangles], list[Floats]]]:
    for start in range(0, len(rectangles), BATCH):
        part = slice(start, min(start + BATCH, len(rectangles)))
        each = range(part.start, part.stop)
        yield part, [single(rectangles, i) for i in each], [axes[i][None] for i in each]


def single(rectangles: Rectangles, index: int) -> Rectangles:
    """Return one of the rectangles."""
    part = slice(index, index + 1)
    return Rectangles(
        centre_mm=rectangles.centre_mm[part],
        frames=rectangles.frames[part],
        half_mm=rectangles.half_mm[part],
        force_n=rectangles.force_n[part],
    )


def lagrange(nodes: Floats, at: Floats) -> Floats:
    """Return (k, n) Lagrange polynomials of the nodes at k places."""
    away = at[:, None, None] - nodes[None, None, :]
    between = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(between, 1.0)
    ratio = away / between
    index = np.arange(len(nodes))
    ratio[:, index, index] = 1.0
    return np.asarray(ratio.prod(axis=2))
