"""Markers that a picture weighs otherwise than the factorised problem does, taken into account without factorising.

A marker that is lost in this picture, or far noisier than at rest, changes rows of the whitened matrix H. With W the
share of its information that every datum has (1 usual, 0 lost), the weighted solution F = (H^T W H + w Q)^-1 H^T W d
is the unweighted one of other data: d' = W d + (1 - W) H F, with which lost data are what the others predict. As
H F = A d' with A = U diag(S^2/(S^2 + w)) U^T, these are as many equations as there are such data: exact, for any
weight. The covariance follows from the same few rows (Woodbury's formula).

Validity: the other markers must determine the forces by themselves, or nearly (`problem_of` factorises anew where more
data are concerned than can be spared). An automatic weight is that of the filled data, as if all had been measured:
with a tenth of the finger's markers lost it is .91 times that of the measured ones alone (a fifth either way from case
to case), by which forces move by a tenth of their standard deviation; on the flat block a hundredth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Ints
from twin.sense.weigh import Factors, Spectrum, covariance, site_variance, spectrum

FIRST, STEADY, TURNS = 1e-4, 0.05, 12
"""Where the search for a weight starts, over the largest squared singular value, the relative change that ends it, and
its most steps, as lost data are filled in with what the weight makes of the others."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reweighed:
    """A factorised problem with other weights of some data.

    Attributes
    ----------
    factors
        Of the usual weights; m data, 3k forces.
    share
        (m,) information of every datum over its usual one; 0 for lost data.
    """

    factors: Factors
    share: Floats

    @property
    def rows(self) -> Ints:
        """(s,) indices of the data concerned."""
        return np.flatnonzero(self.share != 1.0)

    def filled(self, data: Floats, weight: float) -> Floats:
        """Return (m,) or (m, q) data of which the usual solution is the weighted one; lost data must be finite."""
        rows = self.rows
        if not len(rows):
            return data
        left, keep = self.factors.left, self._keep(weight)
        some, lack = left[rows], (1.0 - self.share[rows])[:, None]
        plain = data.reshape(len(data), -1).copy()
        measured = self.share[rows][:, None] * plain[rows]
        plain[rows] = 0.0
        from_others = some @ (keep[:, None] * (left.T @ plain))
        within = np.eye(len(rows)) - lack * ((some * keep) @ some.T)
        plain[rows] = np.linalg.solve(within, measured + lack * from_others)
        return np.asarray(plain.reshape(data.shape))

    def towards(self, data: Floats, predicted: Floats) -> Floats:
        """Return (m,) data filled with what any solution predicts: with its own, it is that solution's `filled`."""
        return np.asarray(self.share * data + (1.0 - self.share) * predicted)

    def predicted(self, filled: Floats, weight: float) -> Floats:
        """Return H F of filled data."""
        return np.asarray((self.factors.left * self._keep(weight)) @ (self.factors.left.T @ filled))

    def weight(self, rule: Callable[[Spectrum], float], data: Floats) -> float:
        """Return the weight that a rule of `twin.sense.weigh` chooses for the data."""
        if not len(self.rows):
            return rule(spectrum(self.factors, data))
        chosen = FIRST * float(self.factors.singular.max(initial=0.0)) ** 2
        for _ in range(TURNS):
            before, chosen = chosen, rule(spectrum(self.factors, self.filled(data, chosen)))
            if abs(chosen - before) <= STEADY * before:
                break
        return chosen

    def noise_scale(self, data: Floats, weight: float) -> float:
        """Return how much larger the noise is than stated, as the marginal likelihood at ``weight`` has it."""
        residual = data - self.predicted(self.filled(data, weight), weight)
        squared = float((self.share * data) @ residual)
        return float(np.sqrt(max(squared, 0.0) / max(int((self.share > 0).sum()), 1)))

    def covariance(self, weight: float, rows: Floats) -> Floats:
        """Return the (q, q) covariance of ``rows`` (q, 3k) times the forces, as `weigh.covariance`."""
        usual = covariance(self.factors, weight, rows)
        if not len(self.rows) or weight <= 0:
            return usual
        response, more = self._more(weight)
        seen = response @ rows.T
        return np.asarray(usual + seen.T @ more @ seen)

    def site_variance(self, weight: float) -> Floats:
        """Return (3k,) variances of the forces, as `weigh.site_variance`."""
        usual = site_variance(self.factors, weight)
        if not len(self.rows) or weight <= 0:
            return usual
        response, more = self._more(weight)
        return np.asarray(usual + np.einsum("si,si->i", response, more @ response))

    def _keep(self, weight: float) -> Floats:
        squared = self.factors.singular**2
        return np.asarray(squared / (squared + weight)) if weight > 0 else np.asarray((squared > 0).astype(float))

    def _more(self, weight: float) -> tuple[Floats, Floats]:
        """Return C H_s^T as (s, 3k) and the (s, s) matrix that widens the covariance C by what the data s lack."""
        rows, singular = self.rows, self.factors.singular
        some, lack = self.factors.left[rows], 1.0 - self.share[rows]
        response = (some * (singular / (singular**2 + weight))) @ self.factors.back.T
        inner = np.eye(len(rows)) - ((some * self._keep(weight)) @ some.T) * lack
        more = lack[:, None] * np.linalg.inv(inner)
        return response, (more + more.T) / 2
