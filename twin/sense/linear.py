"""The linear solve of one picture: forces without bounds, and what wrong vectors and the camera's bend add to them.

Both come in as corrections of the data, so that one factorisation serves all iterations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats
from twin.sense.problem import Problem
from twin.sense.robust import excess
from twin.sense.weigh import RULES, filtered

SOFT, MOST = 6, 40
"""Iterations with Huber's loss before wrong vectors are left out, and iterations at most."""

SETTLED = 1e-4
"""Change of the whitened data that ends the iterations, in units of the noise."""


@dataclass(frozen=True, kw_only=True)
class Linear:
    """A solution without bounds.

    Attributes
    ----------
    problem
        What was solved.
    whole, off, bend
        (m,) whitened data, and what wrong vectors and the camera's bend add to them.
    weight
        Whitened.
    wrong
        (m/2,) vectors that were found to be wrong.
    """

    problem: Problem
    whole: Floats
    off: Floats
    bend: Floats
    weight: float
    wrong: Bools

    @property
    def data(self) -> Floats:
        """(m,) whitened data that were solved for."""
        return np.asarray(self.whole - self.off - self.bend)

    @cached_property
    def force_n(self) -> Floats:
        """(k, 3) forces, N."""
        return forces_of(self.problem, self.data, self.weight)

    @cached_property
    def scale(self) -> float:
        """Noise as the fit has it, over the stated one."""
        return self.problem.reweighed.noise_scale(self.data, self.weight) if self.weight > 0 else 1.0

    @property
    def sd_force_n(self) -> Floats:
        """(k, 3) standard deviations given the prior, N."""
        return np.asarray(self.scale * np.sqrt(self.problem.reweighed.site_variance(self.weight)).reshape(-1, 3))


def solved(problem: Problem, whole: Floats, weight: float | str, *, robust: bool, camera: bool) -> Linear:
    """Solve without bounds, for a weight in px^2/N^2 or by a rule."""
    reweighed = problem.reweighed
    off, bend = np.zeros_like(whole), np.zeros_like(whole)
    wrong: Bools = np.zeros(len(whole) // 2, np.bool_)
    whitened = 0.0 if isinstance(weight, str) else float(weight) / problem.omega
    for count in range(MOST):
        data, before = whole - off - bend, off + bend
        if isinstance(weight, str) and count < 2 * SOFT:  # later it stays, so that this settles
            whitened = reweighed.weight(RULES[weight], data)
        if not robust and not camera:
            break
        if camera:
            bend = bend_of(problem, forces_of(problem, data, whitened))
        if robust:
            filled = reweighed.filled(data, whitened)
            freedom = 1.0 - float((problem.factors.singular * filtered(problem.factors, whitened)).sum()) / len(data)
            residual = whole - bend - reweighed.predicted(filled, whitened)
            off, wrong = excess(residual, reweighed.share, freedom, leave_out=count >= SOFT)
        if count > (SOFT if robust else 0) and np.abs(off + bend - before).max() < SETTLED:
            break
    return Linear(problem=problem, whole=whole, off=off, bend=bend, weight=whitened, wrong=wrong)


def bend_of(problem: Problem, force: Floats) -> Floats:
    """Return (m,) whitened difference of the shifts through the camera to the linear ones."""
    return problem.whiten(problem.calibration.bend_px(force))


def forces_of(problem: Problem, data: Floats, weight: float) -> Floats:
    """Return (k, 3) linear estimate, N."""
    factors, told = problem.factors, problem.reweighed.filled(data, weight)
    return np.asarray((factors.back @ (filtered(factors, weight) * (factors.left.T @ told))).reshape(-1, 3))
