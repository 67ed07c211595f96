"""The linear system of one Newton step of contact, solved by iteration in single precision.

A step's unknowns x (`twin.world.pattern`) and the motion of the probe meet

    C x + M q = right,    B^T x = balance,

C being the compliance between unknowns, with (1 - c) / r added where a patch slips. Dense elimination of 1500 unknowns
takes fifty times a product with them. So x is sought by GMRES, preconditioned with the inverses of the
normal and of the tangential compliance of the patches in contact, each by itself. What those leave out (normal forces
that move patches sideways, the turns of slipping patches) is small or local: a thousandth is left after four or five
products, whatever the number of patches.

Why single precision: it halves the time, and the outer Newton steps mend what it loses, as they measure what is left
of the equations in double precision. Why the inverses are kept: they serve any subset of the patches that they were
made for as well, so that a whole path needs a few.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.linalg import lapack

from twin.arrays import Floats, Ints
from twin.world.pattern import Pattern

Singles: TypeAlias = Any
"""Arrays in single precision."""

LEFT, MOST = 1e-3, 60
"""Share of the right-hand side that may be left, and products at most."""

_SINGULAR = 1e6
"""Condition of the probe's own compliance from which single precision can't be trusted."""

_SLACK = 1.3
"""Over how many times as many patches as are in contact inverses are used before smaller ones are made."""


@dataclass(frozen=True, kw_only=True)
class LinearSystem:
    """One Newton step's equations.

    Attributes
    ----------
    pattern
        The n patches in contact and their unknowns.
    shift
        (n,) (1 - c) / r of the equations across the drag, mm/N.
    motion, pull
        (size, m) M and B for the m motions that are held by force.
    reach
        (m,) sizes of those motions: 1 of a translation, an arm of a turn, mm.
    """

    pattern: Pattern
    shift: Floats
    motion: Floats
    pull: Floats
    reach: Floats


class Krylov:
    """What is kept of a contact's compliance for solving its linear systems fast.

    Parameters
    ----------
    compliance
        (k, 3, k, 3) compliance between patches, mm/N.
    """

    def __init__(self, compliance: Floats) -> None:
        k = len(compliance)
        self._unit = float(np.mean(compliance.reshape(3 * k, 3 * k).diagonal()))
        self._whole: Singles = np.empty((3, k, 3, k), np.float32)
        np.divide(compliance.transpose(1, 0, 3, 2), self._unit, out=self._whole, casting="same_kind")
        self._kept: Ints = np.zeros(0, int)
        self._place: Ints = np.zeros(k, int)

    def _make_room(self, touching: Ints) -> bool:
        """Take over the patches in contact unless they are known; return whether their compliance can be inverted."""
        known = np.isin(touching, self._kept, assume_unique=True).all()
        if known and len(self._kept) <= _SLACK * len(touching):
            return True
        n = len(touching)
        self._place[touching] = np.arange(n)
        part = self._whole[:, touching][:, :, :, touching]
        self._part = part.reshape(3 * n, 3 * n)
        self._stiffness = _inverse(self._part[: 2 * n, : 2 * n]), _inverse(self._part[2 * n :, 2 * n :])
        self._kept = touching if all(np.isfinite(each).all() for each in self._stiffness) else np.zeros(0, int)
        return len(self._kept) > 0

    def moved(self, force: Floats) -> Floats:
        """Return the (3, k) displacements of all patches under forces (k, 3) on them, mm, to 1e-7 of the largest."""
        size = 3 * len(force)
        pushed: Singles = np.ascontiguousarray(force.T, np.float32).reshape(size)
        return np.asarray((self._whole.reshape(size, size) @ pushed).reshape(3, -1).astype(float) * self._unit)

    def _product(self, at: Ints, force: Singles) -> Singles:
        spread = np.zeros((3, len(self._kept)), np.float32)
        spread[:, at] = force
        return (self._part @ spread.reshape(-1)).reshape(3, -1)[:, at]

    def solve(self, system: LinearSystem, right: Floats, balance: Floats) -> tuple[Floats, Floats] | None:
        """Return x (size,) and q (m,) with `LEFT` of the right-hand sides left, None where that is not reached.

        Parameters
        ----------
        system
            The equations.
        right, balance
            (size,) mm and (m,) N and N mm.
        """
        pattern, size, count = system.pattern, system.pattern.size, len(balance)
        if not self._make_room(pattern.touching):
            return None
        at, aside = self._place[pattern.touching], pattern.aside
        share = np.maximum(pattern.share, 1e-20).astype(np.float32)
        shift = (system.shift / self._unit).astype(np.float32)
        motion = (system.motion / system.reach).astype(np.float32)
        pull = (system.pull / system.reach).T.astype(np.float32)
        root = np.ones((size, 1), np.float32)
        root[aside, 0] = np.sqrt(share)

        def rows(x: Singles) -> Singles:
            out = pattern.seen(self._product(at, pattern.forces(x)))
            out[aside] = share * out[aside] + shift * x[aside]
            return out

        def roughly(y: Singles) -> Singles:
            """Return (size, ...) unknowns for which `rows` are about y."""
            forces = np.zeros((3, len(self._kept), y.shape[1]), np.float32)
            forces[:, at] = self._unseen(pattern, y / root)
            along, normal = self._stiffness
            out = np.empty_like(forces)
            out[:2] = (along @ forces[:2].reshape(2 * forces.shape[1], -1)).reshape(out[:2].shape)
            out[2] = normal @ forces[2]
            return pattern.seen(out[:, at]) * root

        of_motion = roughly(motion)
        felt = (pull @ of_motion).astype(float)
        if count and np.linalg.cond(felt) > _SINGULAR:
            return None
        steer = np.linalg.inv(felt).astype(np.float32)

        def mended(y: Singles) -> Singles:
            x = roughly(y[:size, None])[:, 0]
            q = steer @ (pull @ x - y[size:])
            return np.concatenate([x - of_motion @ q, q]).astype(np.float32)

        def equations(y: Singles) -> Singles:
            found = mended(y)
            return np.concatenate([rows(found[:size]) + motion @ found[size:], pull @ found[:size]])

        wanted = np.concatenate([right / self._unit, balance / system.reach])
        largest = float(np.abs(wanted).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(size), np.zeros(count)
        found = _gmres(equations, (wanted / largest).astype(np.float32))
        if found is None:
            return None
        solution = mended(found).astype(float) * largest
        return solution[:size], solution[size:] * self._unit / system.reach

    @staticmethod
    def _unseen(pattern: Pattern, y: Singles) -> Singles:
        """Return the (3, n, ...) vectors whose `Pattern.seen` is y, and which have no part along a slipping drag."""
        n = len(pattern.touching)
        ahead = np.zeros((n, y.shape[1]), np.float32)
        ahead[pattern.stuck] = y[2 * n :]
        cosine, sine = pattern.ahead.T.astype(np.float32)[:, :, None]
        return np.stack([cosine * ahead - sine * y[n : 2 * n], sine * ahead + cosine * y[n : 2 * n], y[:n]])


def _inverse(matrix: Singles) -> Singles:
    """Return the inverse of a symmetric positive definite matrix in single precision; NaN where it is not definite."""
    root, wrong = lapack.spotrf(matrix, lower=0, clean=0)
    if wrong:
        return np.full_like(matrix, np.nan)
    inverse, _ = lapack.spotri(root, lower=0)
    return np.asarray(np.triu(inverse) + np.triu(inverse, 1).T)


def _gmres(product: Callable[[Singles], Singles], right: Singles) -> Singles | None:
    """Return x with `LEFT` of ``product(x) = right`` left; None after `MOST` products, or where one is not finite.

    Notes
    -----
    Y. Saad and M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856, without restart. Why not SciPy's: Python's time
    for its rotations and single inner products is as long as a product here.
    """
    basis = np.empty((MOST + 1, len(right)), np.float32)
    reduced = np.zeros((MOST + 1, MOST))
    length = float(np.linalg.norm(right))
    basis[0] = right / length
    first = np.zeros(MOST + 1)
    first[0] = length
    for done in range(1, MOST + 1):
        image = product(basis[done - 1])
        for _ in range(2):
            parts = basis[:done] @ image
            image = image - parts @ basis[:done]
            reduced[:done, done - 1] += parts
        reduced[done, done - 1] = norm = float(np.linalg.norm(image))
        if not np.isfinite(norm):
            return None
        weights = np.linalg.lstsq(reduced[: done + 1, :done], first[: done + 1], rcond=None)[0]
        left = float(np.linalg.norm(reduced[: done + 1, :done] @ weights - first[: done + 1]))
        if left <= LEFT * length:
            return weights.astype(np.float32) @ basis[:done]
        basis[done] = image / norm
    return None
