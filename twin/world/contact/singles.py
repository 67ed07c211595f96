"""A matrix of compliances in single precision, and inverses of its parts, for iteration.

Why single precision: it halves the time, and the outer Newton steps mend what it loses, as they measure what is left
of the equations in double precision. Why the inverses are kept: they serve any subset of the patches that they were
made for as well, so that a whole path needs a few.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.linalg import lapack

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

    precision, finest = np.float32, 1e-4

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
            self._stiffness = _inverse(self._part[: 2 * n, : 2 * n]), _inverse(self._part[2 * n :, 2 * n :])
            self._kept = touching if all(np.isfinite(each).all() for each in self._stiffness) else np.zeros(0, int)
        self._at = self._place[touching]
        return len(self._kept) > 0

    def displaced(self, force: Floats) -> Floats:
        """See `Operator`."""
        size = 3 * len(force)
        pushed: SinglesArray = np.ascontiguousarray(force.T, np.float32).reshape(size)
        return np.asarray((self._whole.reshape(size, size) @ pushed).reshape(3, -1).astype(float) * self.unit)

    def product(self, force: Floats) -> Floats:
        """See `Operator`."""
        spread: SinglesArray = np.zeros((3, len(self._kept)), np.float32)
        spread[:, self._at] = force
        return np.asarray((self._part @ spread.reshape(-1)).reshape(3, -1)[:, self._at])

    def roughly(self, displacement: Floats) -> Floats:
        """See `Operator`."""
        spread: SinglesArray = np.zeros((3, len(self._kept), displacement.shape[2]), np.float32)
        spread[:, self._at] = displacement
        along, normal = self._stiffness
        out = np.empty_like(spread)
        out[:2] = (along @ spread[:2].reshape(2 * spread.shape[1], -1)).reshape(out[:2].shape)
        out[2] = normal @ spread[2]
        return np.asarray(out[:, self._at])


def _inverse(matrix: SinglesArray) -> SinglesArray:
    """Return the inverse of a symmetric positive definite matrix in single precision; NaN where it is not definite."""
    root, wrong = lapack.spotrf(matrix, lower=0, clean=0)
    if wrong:
        return np.full_like(matrix, np.nan)
    inverse, _ = lapack.spotri(root, lower=0)
    return np.asarray(np.triu(inverse) + np.triu(inverse, 1).T)
