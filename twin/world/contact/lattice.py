"""Equal contact patches on a plane lattice: their compliance as a convolution and a smooth rest.

On a plane the half-space part of the compliance depends on the offset between two patches only, so that products are
Fourier transforms (`twin.world.contact.convolution`). What a finite body adds varies smoothly with both places. Where a
table holds it as polynomials (`twin.world.elasticity.table`), it is a product of their values at a few Chebyshev nodes
of the lattice with Lagrange's polynomials on either side: of 4 nodes a side, or more where the last term is more than a
billionth of a patch's own compliance; 8 hold the table's polynomials without any error. So no matrix between patches is
made: one of 750 patches takes 40 MB, which every product would read.

Validity: the exact influence of a uniform rectangle on the middle of another, and the table's own error.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from twin.arrays import Floats, Ints, Points
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.world.contact.convolution import Convolution, padded_size
from twin.world.contact.krylov import Krylov
from twin.world.contact.linear import LinearSolver
from twin.world.contact.patches import Patches
from twin.world.elasticity.spread import lagrange
from twin.world.elasticity.table import SIZES

NODES = (4, 6, max(SIZES[1:5]))
"""Chebyshev nodes along each side; the last are as many as the table's polynomials have terms."""

_SMALL = 1e-9
"""Largest last term of the rest in Chebyshev polynomials, over a patch's own compliance: the next is a tenth of it."""

FEWEST = 100
"""Patches from which on products by transforms are faster than with a matrix."""

_ROUND_OFF = 1e-9


@runtime_checkable
class PlaneCompliance(Protocol):
    """A surface whose compliance is a function of the offset plus a smooth rest."""

    def offset_part(self, points: Points, rectangle: Rectangles) -> Floats:
        """Return (3 n, 3) mm/N: the part that depends on the offset between a point and the load's middle only."""
        ...

    def smooth_part(self, patches: Rectangles, nodes: Rectangles) -> Floats | None:
        """Return (3 n, 3 n) mm/N: the rest at the middles of ``nodes`` under unit forces on each, global axes.

        None where it isn't a polynomial of as many terms as `NODES` says along each side over all ``patches``.
        """
        ...


class Lattice:
    """A `twin.world.contact.between.Between` of equal patches on a lattice; it is its own operator.

    Parameters
    ----------
    place
        (k, 2) whole numbers of steps of each patch along the lattice's sides.
    kernel
        (Lu, Lv, 3, 3) compliance by offset, wrapped around.
    rest
        (3, M, 3, M) smooth rest between M = m x m nodes; None for none.
    """

    precision, finest, saves = np.float32, 1e-5, False

    def __init__(self, place: Ints, kernel: Floats, rest: Floats | None) -> None:
        self._place, self._kernel = place, kernel
        nu, nv = int(place[:, 0].max()) + 1, int(place[:, 1].max()) + 1
        self._convolution = Convolution.of_kernel(kernel)
        self._at = self._chosen = place[:, 0] * kernel.shape[1] + place[:, 1]
        self._inverse = self._convolution.inverse
        self._cell, self._shape = place[:, 0] * nv + place[:, 1], (nu, nv)
        self._normal = self._convolution.normal(self._shape, np.float64)
        self._rough_normal = None if self._inverse is None else self._inverse.normal(self._shape, np.float32)
        self.unit = float(np.mean(np.diag(kernel[0, 0])))
        self._rest = None if rest is None else np.ascontiguousarray(rest.reshape(3 * rest.shape[1], -1))
        m = NODES[0] if rest is None else math.isqrt(rest.shape[1])
        self._lines = nu, kernel.shape[1]
        u, v = (lagrange(nodes(n, m), np.arange(n, dtype=float)) for n in (nu, nv))
        v = np.concatenate([v, np.zeros((kernel.shape[1] - nv, m))])
        self._sides = {kind: (u.astype(kind), v.astype(kind)) for kind in ("float64", "float32")}
        self._rest_single: Any = None if self._rest is None else self._rest.astype(np.float32)

    def __len__(self) -> int:
        return len(self._at)

    @cached_property
    def own(self) -> Floats:
        """(k,) own normal compliances; the rest, a hundredth of them, is left out."""
        return np.full(len(self), self._kernel[0, 0, 2, 2])

    @property
    def rough(self) -> Lattice | None:
        """Itself, with the inverse convolution."""
        return self if self._inverse is not None else None

    def solver(self, carried: Floats) -> LinearSolver:
        """See `Between`; iteration needs nothing of the probes."""
        return Krylov(self)

    def moved(self, force: Floats) -> Floats:
        """See `twin.world.contact.between.Between`."""
        return self._product(self._at, force.T, self._convolution, self._rest).T

    def displaced(self, force: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        field: Any = force.T.astype(np.float32)
        return self._product(self._at, field, self._convolution.single, self._rest_single).astype(float)

    def sunk(self, push: Floats) -> Floats:
        """See `Between`."""
        field = self._filled(self._cell, push)
        out = self._normal.product(field)
        if self._rest is not None:
            out += self._rest_of(field, self._normal_rest)
        return np.asarray(out.reshape(-1)[self._cell])

    def part(self, rows: Ints) -> Floats:
        """See `Between`."""
        part = np.empty((len(rows), 3, len(rows), 3))
        _gather(self._kernel, self._place[rows], part)
        if self._rest is not None:
            weights, n = self._weights(rows), len(self._rest) // 3
            rest = np.matmul(weights, self._rest.reshape(3, n, 3 * n)).reshape(3, len(rows), 3, n) @ weights.T
            part += rest.transpose(1, 0, 3, 2)
        return part

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """See `Between`."""
        away = self._place[rows][:, None] - self._place[columns][None]
        part = self._kernel[away[..., 0], away[..., 1], 2, 2]  # negative offsets are at the end
        if self._rest is not None:
            part = part + self._weights(rows) @ self._normal_rest @ self._weights(columns).T
        return np.asarray(part)

    def pushes(self, rows: Ints, depth: Floats) -> Floats:
        """See `twin.world.contact.between.Rough`."""
        assert self._rough_normal is not None
        cell = self._cell[rows]
        depth_single: Any = depth.astype(np.float32)
        return np.asarray(self._rough_normal.product(self._filled(cell, depth_single)).reshape(-1)[cell].astype(float))

    def make_room(self, touching: Ints) -> bool:
        """See `twin.world.contact.krylov.Operator`."""
        self._chosen = self._at[touching]
        return self._inverse is not None

    def product(self, force: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        return self._product(self._chosen, force, self._convolution.single, self._rest_single) * np.float32(
            1.0 / self.unit
        )

    def roughly(self, displacement: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        assert self._inverse is not None
        field = self._spread(self._chosen, displacement.transpose(2, 0, 1))
        out = self._inverse.single.product(field).reshape(*field.shape[:2], -1)[..., self._chosen]
        return np.asarray(out.transpose(1, 2, 0) * np.float32(self.unit))

    def _product(self, at: Ints, force: Floats, convolution: Convolution, rest: Floats | None) -> Floats:
        """Return (3, n) displacements under forces (3, n), mm."""
        field = self._spread(at, force)
        out = convolution.product(field)
        if rest is not None:
            out += self._rest_of(field, rest)
        return np.asarray(out.reshape(3, -1)[:, at])

    def _rest_of(self, field: Floats, rest: Floats) -> Floats:
        """Return what the smooth rest makes of a field on the lattice."""
        u, v = self._sides[field.dtype.name]
        v = v[: field.shape[-1]]
        counted = u.T @ field @ v
        return np.asarray(u @ (rest @ counted.reshape(-1)).reshape(counted.shape) @ v.T)

    def _spread(self, at: Ints, values: Floats) -> Floats:
        """Return (..., nu, Lv) values (..., n) on the lattice, its lines padded."""
        field = np.zeros((*values.shape[:-1], self._lines[0] * self._lines[1]), values.dtype)
        field[..., at] = values
        return field.reshape(*values.shape[:-1], *self._lines)

    def _filled(self, cell: Ints, values: Floats) -> Floats:
        """Return (nu, nv) values (n,) on the lattice."""
        field = np.zeros(self._shape[0] * self._shape[1], values.dtype)
        field[cell] = values
        return field.reshape(self._shape)

    @cached_property
    def _normal_rest(self) -> Floats:
        assert self._rest is not None
        first = 2 * len(self._rest) // 3
        return np.ascontiguousarray(self._rest[first:, first:])

    def _weights(self, rows: Ints) -> Floats:
        """Return (n, M) how much each node counts at some patches."""
        u, v = (side[self._place[rows, axis]] for axis, side in enumerate(self._sides["float64"]))
        return np.asarray((u[:, :, None] * v[:, None, :]).reshape(len(rows), u.shape[1] * v.shape[1]))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _gather(kernel: Floats, place: Ints, out: Floats) -> None:
    """Set ``out`` (n, 3, n, 3) to the kernel at the offsets between n places."""
    for i in range(len(place)):
        for j in range(len(place)):
            u, v = (place[i, 0] - place[j, 0]) % kernel.shape[0], (place[i, 1] - place[j, 1]) % kernel.shape[1]
            for a in range(3):
                for b in range(3):
                    out[i, a, j, b] = kernel[u, v, a, b]


def nodes(count: int, m: int) -> Floats:
    """Return (m,) Chebyshev nodes over the places 0, ..., count - 1."""
    half = max(count - 1, 1) / 2.0
    return np.asarray(half - half * np.cos((np.arange(m) + 0.5) * np.pi / m))


def lattice(patches: Patches, compliance: object) -> Lattice | None:
    """Return the compliance between patches as a convolution; None where they are no lattice, or few."""
    if len(patches) < FEWEST or not isinstance(compliance, PlaneCompliance):
        return None
    frame, step = patches.frames[0], 2.0 * patches.half_mm[0]
    equal = np.ptp(patches.half_mm, axis=0).max() <= _ROUND_OFF * step.min()
    if not equal or np.any(np.ptp(patches.frames, axis=0)):
        return None
    middle = (patches.centre_mm - patches.centre_mm[0]) @ frame.T
    corner = middle[:, :2].min(axis=0)
    steps = (middle[:, :2] - corner) / step
    place = np.rint(steps).astype(int)
    if np.abs(steps - place).max() > 1e-6 or np.abs(middle[:, 2]).max() > _ROUND_OFF * step.min():
        return None
    origin = patches.centre_mm[0] + corner @ frame[:2]
    shape = place.max(axis=0) + 1
    kernel, rest = _kernel(compliance, shape, patches, step), None
    for m in NODES:
        rest = _rest(
            patches, compliance, [nodes(int(n), m) * side for n, side in zip(shape, step, strict=True)], origin
        )
        if rest is None:
            return None
        if _last_term(rest, m) <= _SMALL * float(kernel[0, 0].max()):
            break
    return Lattice(place, kernel, rest if rest is not None and rest.any() else None)


def _last_term(rest: Floats, m: int) -> float:
    """Return the largest coefficient of the highest polynomial along any side of a rest (3, M, 3, M)."""
    last = np.cos((m - 1) * (np.arange(m) + 0.5) * np.pi / m) * 2.0 / m
    sides = rest.reshape(3, m, m, 3, m, m)
    return max(float(np.abs(np.tensordot(last, sides, (0, axis))).max()) for axis in (1, 2))


def _kernel(compliance: PlaneCompliance, shape: Ints, patches: Patches, step: Floats) -> Floats:
    frame = patches.frames[0]
    lu, lv = padded_size((int(shape[0]), int(shape[1])))
    away = [np.fft.fftfreq(length, 1.0 / length) * side for length, side in zip((lu, lv), step, strict=True)]
    flat = np.stack(np.meshgrid(*away, indexing="ij"), axis=-1).reshape(-1, 2)
    one = Rectangles(
        centre_mm=patches.centre_mm[:1], frames=patches.frames[:1], half_mm=patches.half_mm[:1],
        force_n=np.zeros((1, 3)),
    )  # fmt: skip
    kernel = compliance.offset_part(patches.centre_mm[0] + flat @ frame[:2], one).reshape(lu, lv, 3, 3)
    return np.asarray(frame @ kernel @ frame.T)


def _rest(patches: Patches, compliance: PlaneCompliance, along: list[Floats], origin: Floats) -> Floats | None:
    """Return (3, M, 3, M) the symmetric rest between the nodes, in the patches' frame."""
    frame, everyone = patches.frames[0], np.ones(len(patches), bool)
    flat = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
    count = len(flat)
    at_nodes = Rectangles(
        centre_mm=origin + flat @ frame[:2], frames=np.tile(frame, (count, 1, 1)),
        half_mm=np.tile(patches.half_mm[0], (count, 1)), force_n=np.zeros((count, 3)),
    )  # fmt: skip
    found = compliance.smooth_part(patches.rectangles(np.zeros((len(patches), 3)), everyone), at_nodes)
    if found is None:
        return None
    rest = np.einsum("ab,kblc,dc->akdl", frame, found.reshape(count, 3, count, 3), frame, optimize=True)
    flat_rest = rest.reshape(3 * count, 3 * count)
    return np.asarray((flat_rest + flat_rest.T).reshape(3, count, 3, count) / 2.0)
