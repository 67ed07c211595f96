"""Linear systems with a border, C x + M q = right and B x = balance, solved by iteration.

C comes as a product and a rough inverse. The border, a few columns and rows, is taken exactly in the preconditioner, so
that the balance is met to round-off at every step (constraint preconditioning; C. Keller, N. I. M. Gould and
A. J. Wathen, SIAM J. Matrix Anal. Appl. 21 (2000) 1300).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats

MOST = 60
"""Products at most."""

_SINGULAR = 1e6
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
        of_motion = self.roughly(self.motion)
        felt = (self.pull @ of_motion).astype(float)
        if not np.isfinite(felt).all() or (count and np.linalg.cond(felt) > _SINGULAR):
            return None
        steer = np.linalg.inv(felt).astype(precision)

        def mended(y: Floats) -> Floats:
            x = self.roughly(y[:size, None])[:, 0]
            q = steer @ (self.pull @ x - y[size:])
            return np.concatenate([x - of_motion @ q, q]).astype(precision)

        def equations(y: Floats) -> Floats:
            found = mended(y)
            return np.concatenate([self.rows(found[:size]) + self.motion @ found[size:], self.pull @ found[:size]])

        found = _gmres(equations, (wanted / largest).astype(precision), left)
        if found is None:
            return None
        solution = mended(found).astype(float) * largest
        return solution[:size], solution[size:]


def _gmres(product: Callable[[Floats], Floats], right: Floats, share: float) -> Floats | None:
    """Return x with a share of ``product(x) = right`` left; None after `MOST` products, or where one is not finite.

    Notes
    -----
    Y. Saad and M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856, without restart. Why not SciPy's: Python's time
    for its rotations and single inner products is as long as a product here.
    """
    basis = np.empty((MOST + 1, len(right)), right.dtype)
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
        if left <= share * length:
            return np.asarray(weights.astype(right.dtype) @ basis[:done])
        basis[done] = image / norm
    return None
