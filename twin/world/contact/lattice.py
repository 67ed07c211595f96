"""Equal contact patches on a plane lattice: their compliance as a convolution and a smooth rest.

On a plane the half-space part of the compliance depends on the offset between two patches only, so that products are
transforms to waves and back (`twin.world.contact.convolution`). What a finite body adds varies smoothly with both
places. Where a table holds it as polynomials (`twin.world.elasticity.table`), it is a product of their values at a few
Chebyshev nodes of the lattice with Lagrange's polynomials on either side: of 6 nodes a side, or 8, which hold the
table's polynomials without any error, where the last term is more than a billionth of a patch's own compliance. So no
matrix between patches is made: one of 750 patches takes 40 MB, which every product would read.

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
from twin.world.contact.convolution import ZZ, Convolution, inverse_of, on_lattice, spectra_of
from twin.world.contact.krylov import Krylov
from twin.world.contact.linear import LinearSolver
from twin.world.contact.patches import Patches
from twin.world.elasticity.spread import lagrange
from twin.world.elasticity.table import SIZES

NODES = (6, max(SIZES[1:5]))
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
        (nu, nv, 3, 3) compliance by offset; one to the other side has its parity.
    rest
        (3, M, 3, M) smooth rest between M = m x m nodes; None for none.
    """

    precision, finest = np.float32, 1e-5

    def __init__(self, place: Ints, kernel: Floats, rest: Floats | None) -> None:
        self._place, self._kernel, self._shape = place, kernel, kernel.shape[:2]
        self._cell = self._chosen = place[:, 0] * kernel.shape[1] + place[:, 1]
        self._touching = np.arange(len(place))
        self.unit = float(np.mean(np.diag(kernel[0, 0])))
        self._rest = None if rest is None else np.ascontiguousarray(rest.reshape(3 * rest.shape[1], -1))
        self._nodes = NODES[0] if rest is None else math.isqrt(rest.shape[1])

    def __len__(self) -> int:
        return len(self._cell)

    @cached_property
    def _spectra(self) -> Floats:
        return spectra_of(self._kernel)

    @cached_property
    def _normal_spectrum(self) -> Floats:
        return spectra_of(self._kernel, (ZZ,))

    @cached_property
    def _inverse(self) -> Convolution | None:
        found = inverse_of(self._spectra)
        return None if found is None else Convolution(found, np.float32)

    @cached_property
    def _whole(self) -> Convolution:
        return Convolution(self._spectra, np.float64, self._rest, self._sides)

    @cached_property
    def _single(self) -> Convolution:
        return Convolution(self._spectra, np.float32, self._rest, self._sides)

    @cached_property
    def _normal(self) -> Convolution:
        rest = None if self._rest is None else self._normal_rest
        return Convolution(self._normal_spectrum, np.float64, rest, self._sides)

    @cached_property
    def _rough_normal(self) -> Convolution:
        return Convolution(1.0 / self._normal_spectrum, np.float32)

    @cached_property
    def _sides(self) -> tuple[Floats, Floats]:
        """(nu, m) and (nv, m) Lagrange's polynomials of the nodes along either side."""
        u, v = (lagrange(nodes(n, self._nodes), np.arange(n, dtype=float)) for n in self._shape)
        return u, v

    @cached_property
    def own(self) -> Floats:
        """(k,) own normal compliances; the rest, a hundredth of them, is left out."""
        return np.full(len(self), self._kernel[0, 0, 2, 2])

    @cached_property
    def rough(self) -> Lattice | None:
        """Itself, with the inverse convolution."""
        return self if self._normal_spectrum.min() > 0.0 else None

    def solver(self, carried: Floats) -> LinearSolver:
        """See `Between`; iteration needs nothing of the probes."""
        return Krylov(self)

    def moved(self, force: Floats) -> Floats:
        """See `twin.world.contact.between.Between`."""
        return self._spread_out(self._whole, self._cell, force.T).T

    def felt(self, force: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        field: Any = force.T.astype(np.float32)
        return self._spread_out(self._single, self._cell, field)[:, self._touching].astype(float)

    def sunk(self, push: Floats) -> Floats:
        """See `Between`."""
        return self._spread_out(self._normal, self._cell, push)

    def part(self, rows: Ints) -> Floats:
        """See `Between`."""
        part, rest = np.empty((len(rows), 3, len(rows), 3)), np.zeros((0, 3, 3, 0))
        if self._rest is not None:
            weights, m = self._weights(rows), len(self._rest) // 3
            by_row = weights @ self._rest.reshape(3, m, 3, m).transpose(1, 0, 2, 3).reshape(m, 9 * m)
            rest = (by_row.reshape(-1, m) @ weights.T).reshape(len(rows), 3, 3, len(rows))
        _gather(self._kernel, self._place[rows], rest, part)
        return part

    def normal_part(self, rows: Ints, columns: Ints) -> Floats:
        """See `Between`."""
        away = self._place[rows][:, None] - self._place[columns][None]
        part = self._kernel[..., 2, 2][np.abs(away[..., 0]), np.abs(away[..., 1])]
        if self._rest is not None:
            part = part + self._weights(rows) @ self._normal_rest @ self._weights(columns).T
        return np.asarray(part)

    def pushes(self, rows: Ints, depth: Floats) -> Floats:
        """See `twin.world.contact.between.Rough`."""
        single: Any = depth.astype(np.float32)
        return self._spread_out(self._rough_normal, self._cell[rows], single).astype(float)

    def make_room(self, touching: Ints) -> bool:
        """See `twin.world.contact.krylov.Operator`."""
        self._touching, self._chosen = touching, self._cell[touching]
        return self._inverse is not None

    def product(self, force: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        return self._spread_out(self._single, self._chosen, force) * np.float32(1.0 / self.unit)

    def roughly(self, displacement: Floats) -> Floats:
        """See `twin.world.contact.krylov.Operator`."""
        assert self._inverse is not None
        out = self._spread_out(self._inverse, self._chosen, displacement.transpose(2, 0, 1))
        return np.asarray(out.transpose(1, 2, 0) * np.float32(self.unit))

    def _spread_out(self, convolution: Convolution, cell: Ints, values: Floats) -> Floats:
        """Return the convolution (..., n) with values (..., n) of some cells, 0 in all others, in those cells."""
        field = np.zeros((*values.shape[:-1], self._shape[0] * self._shape[1]), values.dtype)
        field[..., cell] = values
        made = convolution.product(field.reshape(*values.shape[:-1], *self._shape))
        return np.asarray(made.reshape(field.shape)[..., cell])

    @cached_property
    def _normal_rest(self) -> Floats:
        assert self._rest is not None
        first = 2 * len(self._rest) // 3
        return np.ascontiguousarray(self._rest[first:, first:])

    def _weights(self, rows: Ints) -> Floats:
        """Return (n, M) how much each node counts at some patches."""
        u, v = (side[self._place[rows, axis]] for axis, side in enumerate(self._sides))
        return np.asarray((u[:, :, None] * v[:, None, :]).reshape(len(rows), u.shape[1] * v.shape[1]))


@njit(cache=True)
def _gather(kernel: Floats, place: Ints, rest: Floats, out: Floats) -> None:
    """Set ``out`` (n, 3, n, 3) to the kernel at the offsets between n places, and add the rest (n, 3, 3, n), if any.

    The kernel is odd along an axis where one of its two axes is that one.
    """
    for i in range(len(place)):
        for j in range(len(place)):
            away_u, away_v = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
            u, v = -1.0 if away_u < 0 else 1.0, -1.0 if away_v < 0 else 1.0
            k = kernel[abs(away_u), abs(away_v)]
            out[i, 0, j, 0], out[i, 0, j, 1], out[i, 0, j, 2] = k[0, 0], u * v * k[0, 1], u * k[0, 2]
            out[i, 1, j, 0], out[i, 1, j, 1], out[i, 1, j, 2] = u * v * k[1, 0], k[1, 1], v * k[1, 2]
            out[i, 2, j, 0], out[i, 2, j, 1], out[i, 2, j, 2] = u * k[2, 0], v * k[2, 1], k[2, 2]
        if len(rest):
            for a in range(3):
                for b in range(3):
                    for j in range(len(place)):
                        out[i, a, j, b] += rest[i, a, b, j]


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
    place = on_lattice(middle[:, :2], step)
    if place is None or np.abs(middle[:, 2]).max() > _ROUND_OFF * step.min():
        return None
    origin = patches.centre_mm[0] + middle[:, :2].min(axis=0) @ frame[:2]
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
    """Return (nu, nv, 3, 3) the compliance by offset, in the patches' frame."""
    frame = patches.frames[0]
    away = [np.arange(count) * side for count, side in zip(shape, step, strict=True)]
    flat = np.stack(np.meshgrid(*away, indexing="ij"), axis=-1).reshape(-1, 2)
    one = Rectangles(
        centre_mm=patches.centre_mm[:1], frames=patches.frames[:1], half_mm=patches.half_mm[:1],
        force_n=np.zeros((1, 3)),
    )  # fmt: skip
    kernel = compliance.offset_part(patches.centre_mm[0] + flat @ frame[:2], one).reshape(*shape, 3, 3)
    return np.asarray(frame @ kernel @ frame.T)


def _rest(patches: Patches, compliance: PlaneCompliance, along: list[Floats], origin: Floats) -> Floats | None:
    """Return (3, M, 3, M) the symmetric rest between the nodes, in the patches' frame."""
    frame = patches.frames[0]
    flat = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
    count = len(flat)
    at_nodes = Rectangles(
        centre_mm=origin + flat @ frame[:2], frames=np.tile(frame, (count, 1, 1)),
        half_mm=np.tile(patches.half_mm[0], (count, 1)), force_n=np.zeros((count, 3)),
    )  # fmt: skip
    found = compliance.smooth_part(patches.unloaded, at_nodes)
    if found is None:
        return None
    rest = (frame @ found.reshape(count, 3, count, 3).swapaxes(1, 2) @ frame.T).transpose(2, 0, 3, 1)
    flat_rest = rest.reshape(3 * count, 3 * count)
    return np.asarray((flat_rest + flat_rest.T).reshape(3, count, 3, count) / 2.0)
