"""Saddle-point systems C x + M q = right, B x = balance: forces x on patches and motions q of a
rigid probe; and `Influence`, the compliance C between patches, as solvers know it.

Systems are solved by GMRES with a constraint preconditioner: C is replaced by an approximation,
and the few rows and columns of the probe's balance are kept exactly, so that the balance holds to
round-off at every iteration (C. Keller, N. I. M. Gould and A. J. Wathen, SIAM J. Matrix Anal. Appl.
21 (2000) 1300). Systems that GMRES does not solve are solved by elimination.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin.arrays import Floats, Ints

_HELD = 1e-12
"""Share of a depth that iteration leaves."""

MOST_PRODUCTS = 60
"""Products with C until GMRES gives up."""

_SINGULAR = 1e6
"""Condition number of the probe's own equations from which on elimination solves them."""


@dataclass(frozen=True, kw_only=True)
class SaddlePoint:
    """A saddle-point system.

    Attributes
    ----------
    product
        x (n,) to C x (n,).
    approx_solve
        y (n, ...) to about C^-1 y (n, ...).
    motion, pull
        (n, m) M and (m, n) B.
    """

    product: Callable[[Floats], Floats]
    approx_solve: Callable[[Floats], Floats]
    motion: Floats
    pull: Floats

    def solve(self, right: Floats, balance: Floats, share: float) -> tuple[Floats, Floats] | None:
        """Return x (n,) and q (m,) with a residual of ``share`` of the right-hand side; None where
        out of reach."""
        n = len(right)
        m = len(balance)
        wanted = np.concatenate([right, balance])
        largest = float(np.abs(wanted).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(n), np.zeros(m)
        # Schur complement of the approximate C: the motions' own equations.
        under_motion = self.approx_solve(self.motion) if m else self.motion
        schur = self.pull @ under_motion
        if not np.isfinite(schur).all() or (m and np.linalg.cond(schur) > _SINGULAR):
            return None
        inverse = np.linalg.inv(schur)

        def preconditioned(y: Floats) -> Floats:
            x = self.approx_solve(y[:n, None])[:, 0]
            q = inverse @ (self.pull @ x - y[n:])
            return np.concatenate([x - under_motion @ q, q])

        def equations(y: Floats) -> Floats:
            return np.concatenate([self.product(y[:n]) + self.motion @ y[n:], self.pull @ y[:n]])

        found = _gmres(equations, preconditioned, wanted / largest, share)
        if found is None:
            return None
        solution = found * largest
        return solution[:n], solution[n:]

    @staticmethod
    def eliminate(
        matrix: Floats, motion: Floats, pull: Floats, right: Floats, balance: Floats
    ) -> tuple[Floats, Floats]:
        """Return x (n,) and q (m,) by elimination, C (n, n) being a matrix.

        Compliances and forces differ by the modulus, so both blocks are scaled to about one.

        Raises
        ------
        numpy.linalg.LinAlgError
            The system is singular.
        """
        n = len(right)
        m = len(balance)
        whole = np.zeros((n + m, n + m))
        whole[:n, :n] = matrix
        whole[:n, n:] = motion
        whole[n:, :n] = pull
        typical = float(np.mean(np.abs(np.diag(matrix))))
        scale = np.concatenate([np.full(n, typical**-0.5), np.full(m, typical**0.5)])
        whole *= scale
        whole *= scale[:, None]
        found = np.linalg.solve(whole, np.concatenate([right, balance]) * scale) * scale
        return found[:n], found[n:]


class Preconditioner(Protocol):
    """Approximate inverse of the compliance over its unit between k patches, restricted to some of
    them."""

    def force(self, rows: Ints, displacement: Floats) -> Floats:
        """Return (m, 3, n) forces on some patches that move these by about (m, 3, n)."""
        ...

    def push(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) normal forces on some patches that move these by about (n,) along their
        normals."""
        ...


class Influence(ABC):
    """Compliance between k patches, in their own frames, mm/N.

    Attributes
    ----------
    unit
        The mean compliance of a patch to a force on itself, mm/N.
    """

    unit: float

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    @abstractmethod
    def own(self) -> Floats:
        """(k,) normal displacement of each patch under a unit normal force on it."""

    @property
    @abstractmethod
    def _preconditioner(self) -> Preconditioner: ...

    @abstractmethod
    def apply(self, force: Floats) -> Floats:
        """Return the (k, 3) displacements of the patches under forces (k, 3), mm."""

    @abstractmethod
    def normal_displacement(self, push: Floats) -> Floats:
        """Return the (k,) normal displacements under normal forces (k,), mm."""

    def product(self, rows: Ints, force: Floats) -> Floats:
        """Return the (3, n) displacements over the `unit` of some patches under forces (3, n) on
        them."""
        whole = np.zeros((len(self), 3))
        whole[rows] = force.T
        return np.ascontiguousarray(self.apply(whole)[rows].T) / self.unit

    @abstractmethod
    def block(self, rows: Ints) -> Floats:
        """Return the (n, 3, n, 3) compliance between some patches."""

    @abstractmethod
    def normal_block(self, rows: Ints, columns: Ints) -> Floats:
        """Return the (n, m) normal displacements of some patches under unit normal forces on
        others."""

    def approx_solve(self, rows: Ints, displacement: Floats) -> Floats:
        """Return (3, n, m) forces on some patches that move these by about (3, n, m) over the
        `unit`."""
        columns = displacement.transpose(2, 0, 1)
        return self._preconditioner.force(rows, columns).transpose(1, 2, 0)

    def approx_push(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) normal forces on the patches ``rows`` (n,) that move them by about ``depth``
        (n,), mm."""
        return self._preconditioner.push(rows, depth / self.unit)

    def normal_system(self, rows: Ints, motion: Floats, pull: Floats) -> SaddlePoint:
        """Return the system of the normal forces on some patches, lengths over the `unit`."""

        def product(x: Floats) -> Floats:
            push = np.zeros(len(self))
            push[rows] = x
            return np.asarray(self.normal_displacement(push)[rows] / self.unit)

        def approx_solve(y: Floats) -> Floats:
            return self.unit * np.stack([self.approx_push(rows, column) for column in y.T], axis=1)

        return SaddlePoint(product=product, approx_solve=approx_solve, motion=motion, pull=pull)

    def pushes_for_depth(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) the normal forces on some patches that move these by ``depth`` (n,), mm,
        along their normals."""
        n = len(rows)
        system = self.normal_system(rows, np.zeros((n, 0)), np.zeros((0, n)))
        found = system.solve(depth / self.unit, np.zeros(0), _HELD)
        if found is not None:
            return found[0]
        return np.asarray(np.linalg.solve(self.normal_block(rows, rows), depth))


def _gmres(
    product: Callable[[Floats], Floats],
    preconditioned: Callable[[Floats], Floats],
    right: Floats,
    share: float,
) -> Floats | None:
    """Return x with a residual of ``share`` of the right-hand side; None after `MOST_PRODUCTS`, or
    if not finite.

    Flexible GMRES without restart (Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461): preconditioned
    vectors are kept, which saves one preconditioning. With SciPy's, presses with friction take up
    to 1.5 times as long.
    """
    size = len(right)
    basis = np.empty((MOST_PRODUCTS + 1, size))
    directions = np.empty((MOST_PRODUCTS, size))
    triangle = np.zeros((MOST_PRODUCTS, MOST_PRODUCTS))
    rotations: list[tuple[float, float]] = []
    goal = np.zeros(MOST_PRODUCTS + 1)
    length = float(np.linalg.norm(right))
    basis[0] = right / length
    goal[0] = length
    for done in range(1, MOST_PRODUCTS + 1):
        last = done - 1
        directions[last] = preconditioned(basis[last])
        image = product(directions[last])
        column = triangle[:done, last]
        for _ in range(2):  # Gram-Schmidt, the second time against round-off
            parts = basis[:done] @ image
            image = image - parts @ basis[:done]
            column += parts
        norm = float(np.linalg.norm(image))
        if not math.isfinite(norm):
            return None
        # The Hessenberg matrix becomes triangular by plane rotations, which turn the goal, too.
        for i, (cosine, sine) in enumerate(rotations):
            above, below = column[i : i + 2]
            column[i : i + 2] = cosine * above + sine * below, cosine * below - sine * above
        diagonal = math.hypot(column[last], norm)
        cosine, sine = (column[last] / diagonal, norm / diagonal) if diagonal else (1.0, 0.0)
        rotations.append((cosine, sine))
        column[last] = diagonal
        goal[done] = -sine * goal[last]
        goal[last] *= cosine
        if abs(goal[done]) <= share * length:
            weights = np.linalg.solve(triangle[:done, :done], goal[:done])
            return np.asarray(weights @ directions[:done])
        if norm == 0.0:
            return None
        basis[done] = image / norm
    return None
