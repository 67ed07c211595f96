"""The regularised inverse and its weight, from one singular value decomposition.

The papers minimise |H F - M|^2 + (w/2) F^T Q F (flat paper, eqs. 12 and 15, with the corrections F = (H^T H +
(w/2) Q)^-1 H^T M). With Q = L L^T and the whitened H L^-T = U S V^T, every weight's solution, noise and evidence are
sums over the singular values, so choosing the weight costs no more than using it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from twin.arrays import Floats

GRID = 91
LEAST_DECADES = -13.0
ROBUSTNESS = 0.3
LIKELY = 2.0
"""What the most likely weight is raised by, see `automatic_weight`."""


@dataclass(frozen=True, kw_only=True)
class Factors:
    """A factorised inverse problem, whitened to unit noise.

    Attributes
    ----------
    left
        (m, r) U.
    singular
        (r,) S.
    back
        (3k, r) L^-T V: from the reduced unknowns to forces.
    null
        (3k, 3k - r) the same for directions that no marker sees.
    """

    left: Floats
    singular: Floats
    back: Floats
    null: Floats


def factorise(transfer: Floats, penalty: Floats) -> Factors:
    """Decompose a whitened (m, 3k) transfer matrix with respect to a (3k, 3k) positive definite penalty."""
    lower = np.linalg.cholesky(penalty)
    reduced = scipy.linalg.solve_triangular(lower, transfer.T, lower=True).T
    left, singular, right = scipy.linalg.svd(reduced, full_matrices=len(reduced) < len(penalty))
    back = scipy.linalg.solve_triangular(lower.T, right.T, lower=False)
    count = len(singular)
    return Factors(left=left[:, :count], singular=singular, back=back[:, :count], null=back[:, count:])


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """What the rules for the weight look at: one picture's data along the singular directions.

    Attributes
    ----------
    squared
        (r,) squared singular values.
    energy
        (r,) squared components of the whitened data along U.
    rest
        What of |d|^2 lies outside U.
    count
        Number of data.
    """

    squared: Floats
    energy: Floats
    rest: float
    count: int

    @property
    def floor(self) -> float:
        """A round-off floor for sums of squares."""
        return 1e-20 * (float(self.energy.sum()) + self.rest)


def spectrum(factors: Factors, data: Floats) -> Spectrum:
    """Return the spectrum of whitened data."""
    coefficient = factors.left.T @ data
    rest = max(float(data @ data) - float(coefficient @ coefficient), 0.0)
    return Spectrum(squared=factors.singular**2, energy=coefficient**2, rest=rest, count=len(data))


def automatic_weight(factors: Factors, data: Floats) -> float:
    """Return the weight to use where none is given: `LIKELY` times the most likely or the cross-validated one.

    Why the larger one: a press is concentrated in few sites, which a prior that is the same everywhere does not expect,
    so either rule errs by smoothing too little, and not in the same cases (measured: ``python -m benchmarks inverse``).
    """
    return automatic(spectrum(factors, data))


def automatic(seen: Spectrum) -> float:
    """Return `automatic_weight` of a spectrum."""
    return max(LIKELY * most_likely(seen), cross_validated(seen))


def most_likely_weight(factors: Factors, data: Floats) -> float:
    """Return the weight (of the penalty, in whitened units) with the largest marginal likelihood.

    The forces are drawn from N(0, s^2 Q^-1 / weight) and the whitened noise from N(0, s^2), the common scale s^2 being
    profiled out: -2 log p = m log s^2(w) + sum log(1 + S^2/w), s^2(w) = (sum (U^T d)^2/(1 + S^2/w) + rest)/m. So only
    the relative noise of the markers matters, and model errors count as noise.
    """
    return most_likely(spectrum(factors, data))


def most_likely(seen: Spectrum) -> float:
    """Return `most_likely_weight` of a spectrum."""
    rest = seen.rest + seen.floor

    def minus_log(weight: Floats) -> Floats:
        gain = 1.0 + seen.squared / weight[:, None]
        scale = ((seen.energy / gain).sum(axis=1) + rest) / seen.count
        return np.asarray(seen.count * np.log(scale) + np.log(gain).sum(axis=1))

    return _least(minus_log, seen)


def cross_validated_weight(factors: Factors, data: Floats) -> float:
    """Return the weight with the least robust generalised cross-validation score.

    With h = S^2/(S^2 + w): (|residual|^2/m) / (1 - sum h/m)^2 (ROBUSTNESS + (1 - ROBUSTNESS) sum h^2/m). The second
    factor keeps it from the undersmoothing of plain cross-validation (M. A. Lukas, Inverse Problems 22 (2006) 1883).
    """
    return cross_validated(spectrum(factors, data))


def cross_validated(seen: Spectrum) -> float:
    """Return `cross_validated_weight` of a spectrum."""
    rest, count = seen.rest + seen.floor, seen.count

    def log_score(weight: Floats) -> Floats:
        share = seen.squared / (seen.squared + weight[:, None])
        residual = ((1.0 - share) ** 2 * seen.energy).sum(axis=1) + rest
        influence = ROBUSTNESS + (1.0 - ROBUSTNESS) * (share**2).sum(axis=1) / count
        freedom = np.maximum(1.0 - share.sum(axis=1) / count, 1e-6)
        return np.asarray(np.log(residual * influence / freedom**2))

    return _least(log_score, seen)


Rule = Literal["auto", "likelihood", "gcv"]
RULES: dict[str, Callable[[Spectrum], float]] = {
    "auto": automatic, "likelihood": most_likely, "gcv": cross_validated,
}  # fmt: skip
"""By name, from a spectrum to the whitened weight."""


def _least(objective: Callable[[Floats], Floats], seen: Spectrum) -> float:
    """Search the logarithm of the weight, from far below the smallest useful singular value to above the largest."""
    top = float(seen.squared.max(initial=0.0))
    if top <= 0.0 or not (seen.energy.any() or seen.rest > 0.0):
        return max(top, 1.0)
    decades = np.linspace(LEAST_DECADES, 2.0, GRID)
    best = 0.0
    for _ in range(2):
        best = float(decades[np.argmin(objective(top * 10.0**decades))])
        step = decades[1] - decades[0]
        decades = np.linspace(best - step, best + step, 21)
    return float(top * 10.0**best)


def noise_scale(factors: Factors, data: Floats, weight: float) -> float:
    """Return how much larger the noise is than stated, as the marginal likelihood at ``weight`` has it."""
    coefficient = factors.left.T @ data
    rest = max(float(data @ data - coefficient @ coefficient), 0.0)
    squared = (coefficient**2 / (1.0 + factors.singular**2 / weight)).sum() + rest
    return float(np.sqrt(squared / len(data)))


def filtered(factors: Factors, weight: float) -> Floats:
    """Return (r,) factors S/(S^2 + weight); weight 0 is the pseudo-inverse, cut at round-off only."""
    singular = factors.singular
    if weight > 0:
        return np.asarray(singular / (singular**2 + weight))
    size = max(factors.left.shape[0], factors.back.shape[0])
    cut = size * np.finfo(float).eps * singular.max(initial=0.0)
    return np.asarray(np.divide(1.0, singular, out=np.zeros_like(singular), where=singular > cut))


def covariance(factors: Factors, weight: float, rows: Floats) -> Floats:
    """Return the (q, q) covariance of ``rows`` (q, 3k) times the forces, at unit noise.

    That of the posterior, forces being drawn from N(0, Q^-1 / weight); directions that no marker sees keep their prior
    variance. For weight 0 that of the noise carried through the pseudo-inverse.
    """
    seen = rows @ factors.back
    if weight <= 0:
        return np.asarray((seen * filtered(factors, 0.0) ** 2) @ seen.T)
    unseen = rows @ factors.null
    return np.asarray((seen / (factors.singular**2 + weight)) @ seen.T + unseen @ unseen.T / weight)


def site_variance(factors: Factors, weight: float) -> Floats:
    """Return (3k,) variances of the forces themselves, like `covariance`."""
    if weight <= 0:
        return np.asarray((factors.back**2) @ filtered(factors, 0.0) ** 2)
    return np.asarray(factors.back**2 @ (1.0 / (factors.singular**2 + weight)) + (factors.null**2).sum(1) / weight)
