"""A matrix of compliances in single precision, and inverses of its parts, for iteration.

Why single precision: it halves the time, and the outer Newton steps mend what it loses, as they measure what is left
of the equations in double precision. Why the inverses are kept: they serve any subset of the patches that they were
made for as well, so that a whole path needs a few. Why products of symmetric matrices: they read one half of a matrix,
and reading is what products of this size cost.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.linalg import blas, lapack

from twin.arrays import Floats, Ints

SinglesArray: TypeAlias = Any
"""Arrays in single precision."""

_SLACK = 1.3
"""Over how many times as many patches as are in contact inverses are used before smaller ones are made."""


class Operator(Protocol):
    """Products with a compliance over its ``unit``, mm/N, on the patches in contact, and rough inverses of them."""

    @property
    def unit(self) -> float:
        """The mean of the patches' own compliances, mm/N."""
        ...

    @property
    def precision(self) -> type[np.floating[Any]]:
        """Of the arrays."""
        ...

    @property
    def finest(self) -> float:
        """Share of a right-hand side that iteration can reach."""
        ...

    @property
    def saves(self) -> bool:
        """Whether `displaced` costs much less than a product in double precision."""
        ...

    def make_room(self, touching: Ints) -> bool:
        """Take over the n patches in contact; return whether their compliance can be inverted."""
        ...

    def displaced(self, force: Floats) -> Floats:
        """Return the (3, k) displacements of all patches under forces (k, 3) on them, mm, to 1e-7 of the largest."""
        ...

    def product(self, force: Floats) -> Floats:
        """Return the (3, n) displacements of the patches in contact under forces (3, n)."""
        ...

    def roughly(self, displacement: Floats) -> Floats:
        """Return (3, n, m) forces that cause about (3, n, m) displacements of the patches in contact."""
        ...


class Singles:
    """An `Operator` of a matrix (k, 3, k, 3), mm/N."""

    precision, finest, saves = np.float32, 1e-4, True

    def __init__(self, compliance: Floats) -> None:
        k = len(compliance)
        self.unit = float(np.mean(compliance.reshape(3 * k, 3 * k).diagonal()))
        self._whole: SinglesArray = np.empty((3, k, 3, k), np.float32)
        np.divide(compliance.transpose(1, 0, 3, 2), self.unit, out=self._whole, casting="same_kind")
        self._kept: Ints = np.zeros(0, int)
        self._place: Ints = np.zeros(k, int)
        self._at: Ints = np.zeros(0, int)

    def make_room(self, touching: Ints) -> bool:
        """See `Operator`."""
        known = np.isin(touching, self._kept, assume_unique=True).all()
        if not known or len(self._kept) > _SLACK * len(touching):
            n = len(touching)
            self._place[touching] = np.arange(n)
            part = self._whole[:, touching][:, :, :, touching]
            self._part = part.reshape(3 * n, 3 * n)
            self._stiffness: list[Any] = [inverse(self._part[: 2 * n, : 2 * n]), inverse(self._part[2 * n :, 2 * n :])]
            self._kept = touching if all(each is not None for each in self._stiffness) else np.zeros(0, int)
        self._at = self._place[touching]
        return len(self._kept) > 0

    def displaced(self, force: Floats) -> Floats:
        """See `Operator`."""
        size = 3 * len(force)
        pushed: SinglesArray = np.ascontiguousarray(force.T, np.float32).reshape(size)
        moved = symmetric_product(self._whole.reshape(size, size).T, pushed)
        return np.asarray(moved.reshape(3, -1).astype(float) * self.unit)

    def product(self, force: Floats) -> Floats:
        """See `Operator`."""
        spread: SinglesArray = np.zeros((3, len(self._kept)), np.float32)
        spread[:, self._at] = force
        return np.asarray(symmetric_product(self._part.T, spread.reshape(-1)).reshape(3, -1)[:, self._at])

    def roughly(self, displacement: Floats) -> Floats:
        """See `Operator`."""
        count = displacement.shape[2]
        spread: SinglesArray = np.zeros((count, 3, len(self._kept)), np.float32)
        spread[:, :, self._at] = displacement.transpose(2, 0, 1)
        columns = spread.reshape(count, -1).T
        along, normal = self._stiffness
        size = len(along)
        out = np.concatenate([symmetric_product(along, columns[:size]), symmetric_product(normal, columns[size:])])
        return np.asarray(out.reshape(3, -1, count)[:, self._at])


def symmetric_product(matrix: Any, right: Any) -> Any:
    """Return the product of a symmetric matrix (n, n) with (n,) or (n, m); what is above its diagonal is read only.

    The matrix in Fortran's order, or it is copied.
    """
    double = matrix.dtype == np.float64
    if right.ndim == 1 or right.shape[1] == 1:
        by = blas.dsymv if double else blas.ssymv
        return by(1.0, matrix, right.reshape(-1)).reshape(right.shape)
    return (blas.dsymm if double else blas.ssymm)(1.0, matrix, right)


def inverse(matrix: SinglesArray) -> SinglesArray | None:
    """Return what is above the diagonal of a symmetric matrix's inverse, (n, n); None where it is not definite."""
    root, wrong = lapack.spotrf(matrix, lower=0, clean=0)
    if wrong or not np.isfinite(root[-1, -1]):
        return None
    found: SinglesArray = lapack.spotri(root, lower=0, overwrite_c=1)[0]
    return found if np.isfinite(found.diagonal()).all() else None


def full_inverse(matrix: SinglesArray) -> SinglesArray | None:
    """Return a symmetric matrix's inverse, (n, n); None where it is not definite."""
    half = inverse(matrix.T)
    if half is None:
        return None
    half = np.triu(half)
    whole: SinglesArray = half + half.T
    whole[np.diag_indices(len(whole))] /= 2.0
    return whole
