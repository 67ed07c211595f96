"""Linear systems with a border, C x + M q = right and B x = balance, solved by iteration.

C comes as a product and a rough inverse. The border, a few columns and rows, is taken exactly in the preconditioner, so
that the balance is met to round-off at every step (constraint preconditioning; C. Keller, N. I. M. Gould and
A. J. Wathen, SIAM J. Matrix Anal. Appl. 21 (2000) 1300).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.compiled import njit
from twin.world.contact.inner import inner

MOST = 60
"""Products at most."""

SINGULAR = 1e6
"""Condition of the border's own equations from which single precision can't be trusted."""


@dataclass(frozen=True, kw_only=True)
class Bordered:
    """A system.

    Attributes
    ----------
    rows
        x (n,) to C x (n,).
    roughly
        y (n, ...) to about C^-1 y (n, ...).
    motion, pull
        (n, m) M and (m, n) B.
    """

    rows: Callable[[Floats], Floats]
    roughly: Callable[[Floats], Floats]
    motion: Floats
    pull: Floats

    def solve(self, right: Floats, balance: Floats, left: float) -> tuple[Floats, Floats] | None:
        """Return x (n,) and q (m,) with the share ``left`` of the right-hand side left; None where out of reach."""
        size, count, precision = len(right), len(balance), self.motion.dtype
        wanted = np.concatenate([right, balance])
        largest = float(np.abs(wanted).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(size), np.zeros(count)
        of_motion = self.roughly(self.motion) if count else self.motion
        felt = (self.pull @ of_motion).astype(float)
        if not np.isfinite(felt).all() or (count and np.linalg.cond(felt) > SINGULAR):
            return None
        steer = np.linalg.inv(felt).astype(precision)

        def mended(y: Floats) -> Floats:
            x = self.roughly(y[:size, None])[:, 0]
            q = steer @ (self.pull @ x - y[size:])
            return np.concatenate([x - of_motion @ q, q]).astype(precision)

        def equations(y: Floats) -> Floats:
            return np.concatenate([self.rows(y[:size]) + self.motion @ y[size:], self.pull @ y[:size]])

        found = _gmres(equations, mended, (wanted / largest).astype(precision), left)
        if found is None:
            return None
        solution = found.astype(float) * largest
        return solution[:size], solution[size:]


def _gmres(
    product: Callable[[Floats], Floats], roughly: Callable[[Floats], Floats], right: Floats, share: float
) -> Floats | None:
    """Return x with a share of ``product(x) = right`` left; None after `MOST` products, or where one is not finite.

    Notes
    -----
    Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461, without restart: preconditioned vectors are kept, which saves one
    preconditioning. Why not SciPy's: Python's time for its rotations and inner products is as long as a product here.
    """
    size = len(right)
    basis, mended = np.empty((MOST + 1, size), right.dtype), np.empty((MOST, size), right.dtype)
    triangle, turns, goal = np.zeros((MOST, MOST)), np.zeros((MOST, 2)), np.zeros(MOST + 1)
    length = float(np.linalg.norm(right))
    basis[0] = right / length
    goal[0] = length
    for done in range(1, MOST + 1):
        mended[done - 1] = roughly(basis[done - 1])
        basis[done] = product(mended[done - 1])
        column = np.zeros(done)
        norm = _orthogonal(basis, done, column)
        if not math.isfinite(norm):
            return None
        _turn(column, norm, turns, goal, done)
        triangle[:done, done - 1] = column
        if abs(goal[done]) <= share * length:
            weights = np.linalg.solve(triangle[:done, :done], goal[:done])
            return np.asarray(weights.astype(right.dtype) @ mended[:done])
        if norm == 0.0:
            return None
        basis[done] /= norm
    return None


@njit(cache=True)
def _orthogonal(basis: Floats, done: int, column: Floats) -> float:
    """Take off ``basis[done]`` what lies along those before, add how much to ``column``; return the length left.

    Why compiled: in NumPy the calls take longer than the sums.
    """
    image = basis[done]
    for _ in range(2):  # the second time for round-off
        for i in range(done):
            part = inner(basis[i], image)
            for j in range(len(image)):
                image[j] -= part * basis[i, j]
            column[i] += part
    return math.sqrt(inner(image, image))


@njit(cache=True)
def _turn(column: Floats, under: float, turns: Floats, goal: Floats, done: int) -> None:
    """Make a column of the Hessenberg matrix one of a triangle by plane rotations, and turn the right-hand side too."""
    for i in range(done - 1):
        cosine, sine = turns[i, 0], turns[i, 1]
        above, below = column[i], column[i + 1]
        column[i], column[i + 1] = cosine * above + sine * below, cosine * below - sine * above
    length = math.hypot(column[done - 1], under)
    cosine, sine = (column[done - 1] / length, under / length) if length > 0.0 else (1.0, 0.0)
    turns[done - 1, 0], turns[done - 1, 1] = cosine, sine
    column[done - 1] = length
    goal[done] = -sine * goal[done - 1]
    goal[done - 1] *= cosine
