"""The inverse problem of one picture: marker shifts in, forces out.

`Problem.of` weighs the markers by their noise and sets up the least squares of the picture. What is
kept small, and how, is listed in `METHODS`, the rules for its weight in `RULES`;
`twin.sense.reconstruct` solves.

**The regularised inverse** (`Factors`). The papers minimise |H F - M|^2 + (w/2) F^T Q F (flat
paper, eqs. 12 and 15, with the corrections F = (H^T H + (w/2) Q)^-1 H^T M). With Q = L L^T and the
whitened H L^-T = U S V^T, every weight's solution, noise and evidence are sums over the singular
values, so choosing the weight costs no more than using it.

**Weights of the markers** are those of the rest picture, as each set of weights needs a
factorisation of its own (145 ms of CPU time on the flat block; a solve takes 5). So a solution
depends on nothing but the rest picture and the picture.

**A marker that is lost** in a picture, or far noisier than at rest, changes rows of H. With W the
share of its information that every datum has (1 usual, 0 lost), the solution F = (H^T W H + w Q)^-1
H^T W d is the unweighted one of other data: d' = W d + (1 - W) H F. As H F = A d' with A = U
diag(S^2/(S^2 + w)) U^T, these are as many equations as there are such data: exact, for any weight.
The covariance follows from the same few rows (Woodbury's formula). The rules for a weight look at
the weighted problem's own spectrum, W^1/2 H L^-T = U' S' V'^T, from V' S'^2 V'^T = S (1 - U^T (1 -
W) U) S in the base's V: filled data have no noise where they were filled.

Validity: the other markers must nearly determine the forces by themselves (`Problem` factorises
again where more data are concerned).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from threading import Lock
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.linalg

from twin.arrays import Bools, Floats, Ints, medians
from twin.errors import InputError
from twin.parts.methods import Method, WeightRule
from twin.sense.calibration import Calibration
from twin.sense.constraints import LEAST, Quadratic
from twin.sense.track import Found

LEAST_DECADES, MOST_DECADES = -13.0, -2.0
"""Weights that are searched, decades over the largest squared singular value.

The upper end decides where a picture shows noise alone: there the most likely weight is infinite,
which states zero force with zero deviation, and hides a small load. Errors of the total are .6 to
1.2 times those stated on both sensors, loads of 0 to 10 mN (5 mm and 1 mm presses, .005 px of
noise); with -1 loads of 2 to 5 mN are 2 to 4 stated deviations off, with 0 they are 4 to 12."""

DECADES = np.linspace(LEAST_DECADES, MOST_DECADES, 67)
STEPS = np.linspace(-1.0, 1.0, 21)
"""First all decades are searched, then around the best one."""

FLAT = 1e-8
"""Weights whose objectives differ by less are as good, and the largest is taken. Where sites have
more unknowns than markers give data, small weights all explain them without noise, and round-off
would choose."""

LEAST_RATIO = 1e-5
"""Ratio of singular values down to which they follow from their squares, the smallest to 2e-6 of
itself. Forces of the finger (6e-5, weights of 1e-8 of the largest square) change by 5e-11."""

ROBUSTNESS = 0.3
LIKELY = 2.0
"""What the most likely weight is raised by where none is given."""

MOST_RAISED = 10.0
"""What the likely weight is raised by at most, 2 to 5 on the flat sensor. Where few markers are
seen, any small weight explains their motion and says nothing of how large forces are."""

NOTHING = 2.0 * float(np.finfo(float).tiny)
"""What is left of data that are all zero."""

_Number = float | Floats
"""A number of one picture, or (c, 1) of a stack of pictures."""

ROUND_OFF = 1e-14
"""Squared singular values of a weighted problem, over the largest, that are round-off."""


@dataclass(frozen=True, kw_only=True)
class _Tried:
    """Weights that are tried on a spectrum, and what rules need of them whatever the data are.

    Attributes
    ----------
    decades
        (t,) of the weights over the largest squared singular value.
    left
        (t, r) w/(S^2 + w): what a weight leaves of the data along a singular direction.
    squared
        (t, r) its squares.
    log_gain
        (t,) sum of log(1 + S^2/w).
    per_square
        (t,) the cross-validated score over the squared residual; see `_cross_validated`.

    Those around the best one of each picture of a stack have the pictures' axis first.
    """

    decades: Floats
    left: Floats
    squared: Floats
    log_gain: Floats
    per_square: Floats

    def least(self, score: Floats) -> Ints:
        """Return the index of the largest weight whose ``score`` (t,) is the least but for
        `FLAT`."""
        good = score[..., ::-1] <= score.min(axis=-1, keepdims=True) + FLAT
        return np.asarray(self.decades.shape[-1] - 1 - good.argmax(axis=-1))


class _Trials:
    """The weights that are tried on squared singular values (r,) of ``count`` data: `all_decades`,
    then those around the best one."""

    def __init__(self, squared: Floats, count: int) -> None:
        self._relative, self._count = squared / squared.max(), count
        self.all_decades = self._at(DECADES)
        shape = (len(DECADES), len(STEPS))
        # memory is taken where it is filled
        self._near = {
            f.name: np.empty((*shape, *getattr(self.all_decades, f.name).shape[1:]))
            for f in fields(_Tried)
        }
        self._known = np.zeros(len(DECADES), np.bool_)

    def around(self, best: Ints) -> _Tried:
        """Return those around one of `DECADES`, by its index, or around one for each picture of a
        stack."""
        for k in np.atleast_1d(best):
            if not self._known[k]:
                step = DECADES[1] - DECADES[0]
                near = self._at(np.minimum(DECADES[k] + step * STEPS, MOST_DECADES))
                for name, table in self._near.items():
                    table[k] = getattr(near, name)
                self._known[k] = True
        return _Tried(**{name: table[best] for name, table in self._near.items()})

    def _at(self, decades: Floats) -> _Tried:
        weight = 10.0 ** decades[:, None]
        left = weight / (self._relative + weight)
        squared = left**2
        kept = ((1.0 - left) ** 2).sum(axis=1) / self._count
        freedom = (left.sum(axis=1) + self._count - left.shape[1]) / self._count
        return _Tried(
            decades=decades,
            left=left,
            squared=squared,
            log_gain=-np.log(left).sum(axis=1),
            per_square=(ROBUSTNESS + (1.0 - ROBUSTNESS) * kept) / freedom**2,
        )


def _automatic(seen: Factors.Spectrum) -> _Number:
    """Return the larger of `LIKELY` times the most likely weight and the cross-validated one.

    An even prior does not expect a press concentrated in few sites, so either rule smooths too
    little, not in the same cases (``python -m benchmarks inverse``).
    """
    return np.maximum(LIKELY * seen.likely, _cross_validated(seen))


def _most_likely(seen: Factors.Spectrum) -> _Number:
    """Return the whitened weight with the largest marginal likelihood.

    The forces are drawn from N(0, s^2 Q^-1 / weight) and the whitened noise from N(0, s^2), the
    common scale s^2 being profiled out: -2 log p = m log s^2(w) + sum log(1 + S^2/w), s^2(w) = (sum
    (U^T d)^2/(1 + S^2/w) + rest)/m. So only the relative noise of the markers matters, and model
    errors count as noise.
    """

    def minus_log(tried: _Tried) -> Floats:
        scale = ((tried.left @ seen.energy[..., None])[..., 0] + seen.outside) / seen.count
        return np.asarray(seen.count * np.log(scale) + tried.log_gain)

    return _least(minus_log, seen)


def _cross_validated(seen: Factors.Spectrum) -> _Number:
    """Return the weight with the least robust generalised cross-validation score.

    With h = S^2/(S^2 + w): (|residual|^2/m) / (1 - sum h/m)^2 (ROBUSTNESS + (1 - ROBUSTNESS) sum
    h^2/m). The second factor keeps it from the undersmoothing of plain cross-validation (M. A.
    Lukas, Inverse Problems 22 (2006) 1883).
    """

    def log_score(tried: _Tried) -> Floats:
        residual = (tried.squared @ seen.energy[..., None])[..., 0] + seen.outside
        return np.asarray(np.log(residual * tried.per_square))

    return _least(log_score, seen)


def _least(objective: Callable[[_Tried], Floats], seen: Factors.Spectrum) -> _Number:
    """Search the logarithm of the weight from `LEAST_DECADES` to `MOST_DECADES`."""
    top = seen.largest
    nothing = (top <= 0.0) | (seen.outside <= NOTHING)
    if np.asarray(nothing).all():
        return np.maximum(top, 1.0)

    trials = seen.trials
    near = trials.around(trials.all_decades.least(objective(trials.all_decades)))
    best = near.least(objective(near))
    if not best.ndim:
        return float(top * 10.0 ** near.decades[best])
    found = top * 10.0 ** near.decades[np.arange(len(best)), best][:, None]
    return np.where(nothing, np.maximum(top, 1.0), found)


RULES: dict[WeightRule, Callable[[Factors.Spectrum], _Number]] = {
    "auto": _automatic,
    "likelihood": lambda seen: seen.likely,
    "gcv": _cross_validated,
}
"""By name, from a spectrum to the whitened weight."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Factors:
    """A factorised inverse problem, whitened to unit noise.

    Of one picture, or of a stack of pictures without lost or odd data: then data (m,) and what
    comes of them have the pictures' axis first, and numbers of a picture are (c, 1).

    Attributes
    ----------
    modes
        The decomposition, of data in some unit.
    size
        Noise of the data in that unit.
    share
        (m,) information of every datum over its usual one; 0 for lost data.
    """

    @dataclass(frozen=True, kw_only=True, eq=False)
    class Modes:
        """A singular value decomposition H L^-T = U S V^T, and what many pictures need of it.

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

        @cached_property
        def usual_share(self) -> Floats:
            """(m,) ones: the information of data that are all the usual ones."""
            return np.ones(len(self.left))

        @cached_property
        def trials(self) -> _Trials:
            """The weights that rules try where all data are the usual ones."""
            return _Trials(self.singular**2, len(self.left))

        @cached_property
        def squares(self) -> tuple[Floats, Floats]:
            """(3k, r) squares of ``back``, and (3k,) their sums of ``null``."""
            return self.back**2, (self.null**2).sum(1)

        def along(self, rows: Floats) -> tuple[Floats, Floats, Floats]:
            """Return ``rows`` (q, 3k) times ``back``, its squares, and what ``null`` adds to the
            rows' (q,) variances at weight 1; kept for the last rows, which are mostly those of the
            totals."""
            last = self._last.get("rows")
            if last is None or last[0] is not rows:
                seen, unseen = rows @ self.back, ((rows @ self.null) ** 2).sum(axis=1)
                self._last["rows"] = last = (rows, seen, seen**2, unseen)
            return last[1:]

        @cached_property
        def _last(self) -> dict[str, tuple[Floats, Floats, Floats, Floats]]:
            return {}

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
        usual
            The weights that are tried, where other pictures have these squared singular values,
            too, up to a factor.
        """

        squared: Floats
        energy: Floats
        rest: _Number
        count: int
        usual: _Trials | None = None

        @cached_property
        def largest(self) -> _Number:
            """The largest of `squared`, 0 without any."""
            return _number(self.squared.max(axis=-1, initial=0.0))

        @cached_property
        def outside(self) -> _Number:
            """`rest`, with a round-off floor."""
            return self.rest + 1e-20 * (_total(self.energy) + self.rest) + NOTHING / 2.0

        @cached_property
        def likely(self) -> _Number:
            """The most likely weight, whitened, which several rules start from."""
            return _most_likely(self)

        @cached_property
        def trials(self) -> _Trials:
            """The weights that are tried."""
            return self.usual or _Trials(self.squared, self.count)

    modes: Modes
    size: _Number = 1.0
    share: Floats

    @cached_property
    def singular(self) -> Floats:
        """(r,) S of the whitened problem."""
        return np.asarray(self.modes.singular / self.size)

    @classmethod
    def of(cls, transfer: Floats, penalty: Floats) -> Factors:
        """Decompose a whitened (m, 3k) transfer matrix with respect to a (3k, 3k) positive definite
        penalty."""
        lower = np.linalg.cholesky(penalty)
        reduced = scipy.linalg.solve_triangular(lower, transfer.T, lower=True).T
        left, singular, right = scipy.linalg.svd(reduced, full_matrices=len(reduced) < len(penalty))
        back = scipy.linalg.solve_triangular(lower.T, right.T, lower=False)
        count = len(singular)
        modes = cls.Modes(
            left=left[:, :count],
            singular=singular,
            back=np.ascontiguousarray(back[:, :count]),
            null=back[:, count:],
        )
        return cls(modes=modes, share=np.ones(len(left)))

    def of_some(self, rows: Bools, scale: Floats) -> Factors:
        """Return the factors of some rows of the matrix, (m,), each times its scale (u,).

        Where data are fewer than unknowns, this takes a quarter of the time of `of`: most by the
        squares of the singular values, unless these are too far apart for double precision.
        """
        modes = self.modes
        part = scale[:, None] * (modes.left[rows] * self.singular)
        count = min(part.shape)
        right = np.linalg.eigh(part.T @ part)[1][:, ::-1]
        left = part @ right[:, :count]
        singular = np.sqrt((left**2).sum(axis=0))
        if count and singular.min() > LEAST_RATIO * singular.max():
            left = left / singular
        else:
            left, singular, across = scipy.linalg.svd(part, full_matrices=count == len(part))
            right = across.T
        back, null = modes.back @ right, modes.null
        if count < len(right):
            null = np.hstack([null, back[:, count:]])
        modes = self.Modes(left=left, singular=singular, back=back[:, :count], null=null)
        return Factors(modes=modes, share=np.ones(len(part)))

    @cached_property
    def rows(self) -> Ints:
        """(s,) indices of the data whose information is not the usual one."""
        if self.share is self.modes.usual_share:
            return np.arange(0)
        return np.flatnonzero(self.share != 1.0)

    def forces(self, data: Floats, weight: _Number) -> Floats:
        """Return (k, 3) forces of whitened data, N."""
        _, along = self._completed(data, weight)
        return _vectors((self._filtered(weight) * along) @ self.modes.back.T)

    def sums(self, rows: Floats, data: Floats, weight: _Number) -> Floats:
        """Return (q,) ``rows`` (q, 3k) times the forces of whitened data; any number of these comes
        before the pictures."""
        _, along = self._completed(data, weight)
        return np.asarray((self._filtered(weight) * along) @ self.modes.along(rows)[0].T)

    def filled(self, data: Floats, weight: float) -> Floats:
        """Return (m,) data of which the usual solution is the weighted one; lost data must be
        finite."""
        return self._completed(data, weight)[0] if len(self.rows) else data

    def _completed(self, data: Floats, weight: _Number) -> tuple[Floats, Floats]:
        """Return `filled` data, and U^T of them."""
        rows = self.rows
        if not len(rows):
            return data, np.asarray(data @ self.modes.left)
        filled = data.copy()
        filled[..., rows] = 0.0
        along = filled @ self.modes.left
        keep = self._keep(weight)
        some, lack = self.modes.left[rows], 1.0 - self.share[rows]
        within = np.eye(len(rows)) - lack[:, None] * ((some * keep) @ some.T)
        known = self.share[rows] * data[..., rows] + lack * ((keep * along) @ some.T)
        lost = np.linalg.solve(within, known.reshape(-1, len(rows)).T).T.reshape(known.shape)
        filled[..., rows] = lost
        return filled, along + lost @ some

    def towards(self, data: Floats, predicted: Floats) -> Floats:
        """Return (m,) data filled with what any solution predicts: with its own, it is that
        solution's `filled`."""
        return np.asarray(self.share * data + (1.0 - self.share) * predicted)

    def predicted(self, data: Floats, weight: _Number) -> Floats:
        """Return H F of data."""
        _, along = self._completed(data, weight)
        return np.asarray((self._keep(weight) * along) @ self.modes.left.T)

    def weight(self, rule: WeightRule, data: Floats) -> _Number:
        """Return the weight that one of `RULES` chooses for the data."""
        return self.weights(rule, data)[0]

    def weights(self, rule: WeightRule, data: Floats) -> tuple[_Number, _Number]:
        """Return `weight`, and the most likely one (`MOST_RAISED`), by which forces are as large
        as the data show them."""
        seen = self._spectrum(data)
        used = RULES[rule](seen)
        return used, np.maximum(seen.likely, used / MOST_RAISED)

    def freedom(self, weight: _Number) -> float:
        """Return the degrees of freedom of the residual over the number of data."""
        fitted = float((self.singular * self._filtered(weight)).sum())
        return 1.0 - fitted / len(self.modes.left)

    def noise_scale(self, data: Floats, weight: _Number) -> _Number:
        """Return how much larger the noise is than stated, as the marginal likelihood at ``weight``
        has it; for weight 0 the residual, the stated noise being one datum more."""
        if len(self.rows):
            residual = data - self.predicted(data, weight)
            squared = np.maximum(_total(self.share * data * residual), 0.0)
        else:  # without the cancellation where weights are small
            seen = self._spectrum(data)
            squared = seen.rest
            if not _unweighted(weight):
                squared = squared + _total(seen.energy * (weight / (seen.squared + weight)))
        count = int(np.count_nonzero(self.share))
        if _unweighted(weight):
            squared, count = squared + 1.0, count - self.singular.shape[-1] + 1
        return np.sqrt(squared / max(count, 1))

    def variance(self, weight: _Number, rows: Floats) -> Floats:
        """Return the (q,) variances of ``rows`` (q, 3k) times the forces, at unit noise.

        Those of the posterior, forces being drawn from N(0, Q^-1 / weight); directions that no
        marker sees keep their prior variance. For weight 0 those of the noise carried through the
        pseudo-inverse.
        """
        _, seen, unseen = self.modes.along(rows)
        if _unweighted(weight):
            return np.asarray(self._filtered(weight) ** 2 @ seen.T)
        usual = np.asarray((1.0 / (self.singular**2 + weight)) @ seen.T + unseen / weight)
        if not len(self.rows):
            return usual
        response, more = self._more(weight)
        widened = response @ rows.T
        return np.asarray(usual + (widened * (more @ widened)).sum(axis=0))

    def misfit_variance(self, data: Floats, weight: _Number, rows: Floats, even: _Number) -> Floats:
        """Return the (q,) variance of ``rows`` (q, 3k) times the forces that markers' residuals
        show beyond noise that is ``even`` times the stated one: the model errs next to a load.

        The covariance HC2 of J. G. MacKinnon and H. White (J. Econometrics 29 (1985) 305), a marker
        at a time: a residual over the root of its share of freedom, times what it moves.
        """
        if data.ndim > 1:  # a picture after the other
            every = np.broadcast_arrays(self.size, weight, even)
            return np.array(
                [
                    replace(self, size=float(size[0])).misfit_variance(
                        one, float(own[0]), rows, float(of_one[0])
                    )
                    for one, size, own, of_one in zip(data, *every, strict=True)
                ]
            )
        root = np.sqrt(self.share)
        seen = root[:, None] * self.modes.left * self.singular
        count = len(self.singular)
        stiffness = seen.T @ seen + weight * np.eye(count)
        inverse = (
            np.linalg.pinv(seen) if _unweighted(weight) else np.linalg.solve(stiffness, seen.T)
        )
        fitted = seen.reshape(-1, 2, count) @ inverse.reshape(count, -1, 2).transpose(1, 0, 2)
        freedom, axes = np.linalg.eigh(np.eye(2) - fitted)
        residual = (root * (data - self.predicted(data, weight))).reshape(-1, 2, 1)
        error = axes @ (axes.mT @ residual / np.sqrt(np.maximum(freedom, ROUND_OFF))[:, :, None])
        moves = (self.modes.along(rows)[0] @ inverse).reshape(len(rows), -1, 2).transpose(1, 0, 2)
        found = ((moves @ error)[:, :, 0] ** 2).sum(axis=0)
        noise = even**2 * (moves**2).sum(axis=(0, 2))
        return np.asarray(np.maximum(found - noise, 0.0))

    def site_variance(self, weight: _Number, likely: _Number) -> Floats:
        """Return (3k,) variances of the forces themselves, those being drawn from N(0, Q^-1 /
        likely): with C the `covariance` at ``weight``, C + (weight^2/likely - weight) C Q C.

        Why: a weight above the likely one takes forces for smaller than they are, and smooths off
        more than C has. On the flat sensor C states 0.6 to 1.15 times a press's error, this 0.84
        to 2.5 times.
        """
        squared_back, unseen = self.modes.squares
        if _unweighted(weight):
            return np.asarray(self._filtered(weight) ** 2 @ squared_back.T)
        each = 1.0 / (self.singular**2 + weight)
        excess = weight / likely - 1.0
        variance = (1.0 + excess) * unseen / weight
        if not len(self.rows):  # back^T Q back is the unit matrix
            return np.asarray(variance + (each + excess * weight * each**2) @ squared_back.T)
        response, more = self._more(weight)
        widened = more @ response
        smoothed = each[:, None] * self.modes.back.T
        smoothed += (self.modes.left[self.rows] * (self.singular * each)).T @ widened
        variance += squared_back @ each + np.einsum("si,si->i", response, widened)
        return np.asarray(variance + excess * weight * (smoothed**2).sum(axis=0))

    def _spectrum(self, data: Floats) -> Factors.Spectrum:
        """Return the weighted problem's spectrum; lost data must be finite."""
        last = self._last.get("seen")
        if last is not None and last[0] is data:
            return last[1]
        rows = self.rows
        known = self.share * data if len(rows) else data
        count = int(np.count_nonzero(self.share))
        pull = known @ self.modes.left
        squared, energy = self.singular**2, pull**2
        if len(rows):
            some = self.modes.left[rows] * self.singular
            gram = np.diag(squared) - (some.T * (1.0 - self.share[rows])) @ some
            squared, turn = (found[..., -count:] for found in np.linalg.eigh(gram))
            squared = np.maximum(squared, ROUND_OFF * squared.max(initial=np.finfo(float).tiny))
            energy = (turn.T @ (self.singular * pull)) ** 2 / squared
        rest = 0.0 * _total(energy)  # what lies outside is round-off where U is square
        if count > squared.shape[-1]:
            rest = np.maximum(_total(known * data) - _total(energy), 0.0)
        usual = None if len(rows) else self.modes.trials
        seen = Factors.Spectrum(squared=squared, energy=energy, rest=rest, count=count, usual=usual)
        self._last["seen"] = (data, seen)
        return seen

    @cached_property
    def _last(self) -> dict[str, tuple[Floats, Factors.Spectrum]]:
        """The last data and their spectrum, which the weight and the noise both need."""
        return {}

    def _filtered(self, weight: _Number) -> Floats:
        """Return (r,) factors S/(S^2 + weight); weight 0 is the pseudo-inverse, cut at round-off
        only."""
        singular = self.singular
        if not _unweighted(weight):
            return np.asarray(singular / (singular**2 + weight))
        size = max(self.modes.left.shape[0], self.modes.back.shape[0])
        cut = size * np.finfo(float).eps * singular.max(axis=-1, initial=0.0, keepdims=True)
        inverse = np.divide(1.0, singular, out=np.zeros_like(singular), where=singular > cut)
        return np.asarray(inverse)

    def _keep(self, weight: _Number) -> Floats:
        squared = self.singular**2
        return np.asarray(
            1.0 * (squared > 0) if _unweighted(weight) else squared / (squared + weight)
        )

    def _more(self, weight: _Number) -> tuple[Floats, Floats]:
        """Return C H_s^T as (s, 3k) and the (s, s) matrix that widens the covariance C by what the
        data s lack."""
        rows, singular = self.rows, self.singular
        some, lack = self.modes.left[rows], 1.0 - self.share[rows]
        response = (some * (singular / (singular**2 + weight))) @ self.modes.back.T
        inner = np.eye(len(rows)) - ((some * self._keep(weight)) @ some.T) * lack
        more = lack[:, None] * np.linalg.inv(inner)
        return response, (more + more.T) / 2


def _unweighted(weight: _Number) -> bool:
    """Return whether a weight, or those of a stack, are the number 0."""
    return isinstance(weight, float) and weight <= 0.0


def _total(values: Floats) -> _Number:
    """Return the sum along the last axis, (c, 1) of a stack."""
    return _number(values.sum(axis=-1))


def _number(value: Any) -> _Number:
    """Return what was found along the last axis as a number, (c, 1) of a stack."""
    return np.asarray(value)[:, None] if np.ndim(value) else float(value)


def _vectors(values: Floats) -> Floats:
    """Return (..., 3k) numbers as (..., k, 3)."""
    return np.asarray(values.reshape(*values.shape[:-1], -1, 3))


@dataclass(frozen=True, kw_only=True)
class InverseMethod:
    """A way to reconstruct.

    Attributes
    ----------
    penalty
        From the (columns, rows) of the sites to the (sites, sites) matrix that every component of
        the force is kept small in: positive definite, sites counted row by row within columns.
    weighted
        Whether the penalty has a weight; the pseudo-inverse has none.
    local
        Whether forces are expected only where a first solution has some.
    """

    penalty: Callable[[int, int], Floats]
    weighted: bool = True
    local: bool = False

    def matrix(self, grid: tuple[int, int]) -> Floats:
        """Return the (3k, 3k) matrix Q of the papers' (w/2) F^T Q F."""
        return np.asarray(np.kron(self.penalty(*grid), np.eye(3)), np.float64)


def _forces(columns: int, rows: int) -> Floats:
    """The forces themselves (flat paper, eq. 14)."""
    return np.eye(columns * rows)


def _neighbours(columns: int, rows: int) -> Floats:
    """Differences of neighbouring sites along both directions of the grid (flat paper, eq. 11,
    which as printed wraps at row ends and between components). They go on past the edge of the
    grid, to sites without force; see `twin.sense.reconstruct`."""
    along, across = (np.diff(np.eye(n + 2), axis=0)[:, 1:-1] for n in (columns, rows))
    return np.asarray(
        np.kron(along.T @ along, np.eye(rows)) + np.kron(np.eye(columns), across.T @ across)
    )


METHODS: dict[Method, InverseMethod] = {
    "smooth": InverseMethod(penalty=_neighbours),
    "norm": InverseMethod(penalty=_forces),
    "pinv": InverseMethod(penalty=_forces, weighted=False),
    "local": InverseMethod(penalty=_neighbours, local=True),
}

EVEN_NOISE = 2.0
"""Markers whose noise differs by less than this factor (10 % to 90 %) are weighed alike, so that a
factorisation serves a whole sequence."""

CLASS = 2.0
"""Other markers are weighed in classes by this factor around the median, so that a factorisation
serves several pictures. Readings at a class's ends lose a fifth of their precision at worst."""

UNUSUAL = 2.0
"""A marker whose noise differs from its usual one by more than this factor is weighed otherwise."""

MOST_UNUSUAL = 0.25
"""Share of the markers that may be weighed otherwise before the problem is factorised again."""

KEPT, KEPT_WEIGHTS = 8, 4
_ordering = Lock()
"""Held where what was used last is moved: a thread that found nothing meanwhile would factorise."""

_kept: WeakKeyDictionary[Calibration, dict[tuple[object, bytes], _Base]] = WeakKeyDictionary()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Base:
    """A transfer matrix whitened by the markers' relative noise, its factors, and what was solved
    with it.

    ``transfer`` (m, 3k), px/N; ``penalty`` (3k, 3k) Q; ``gram`` matrices that are filled in on
    first use; ``quadratics`` the last few constrained problems, by weight.
    """

    transfer: Floats
    penalty: Floats
    factors: Factors
    gram: dict[str, Floats]
    quadratics: dict[float, Quadratic]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """One picture's data with the base they belong to; whitened means: in units of each marker's
    usual noise.

    Of a stack of pictures (`together`) the axis of these comes first, in data, too.

    Attributes
    ----------
    calibration, used
        What the markers are known by, and (n,) which of them take part.
    known
        (n,) which of them the base has rows for; those that are not used are lost in this picture.
    noise_px
        (u,) standard deviation of a shift's component of the known ones, px.
    base
        The factorised matrix, whitened relatively.
    factors
        The base's with the noise's size and this picture's weights in it.
    """

    calibration: Calibration
    used: Bools
    known: Bools
    noise_px: Floats
    base: _Base
    factors: Factors

    @classmethod
    def of(cls, found: Found, calibration: Calibration, method: Method) -> Problem:
        """Return the whitened problem; factorised again only where markers or their relative noise
        changed.

        Raises
        ------
        InputError
            Motion and calibration don't belong together, or fewer than 2 markers are left.
        """
        if not np.array_equal(found.layer, calibration.layer):
            raise InputError(
                f"the tracked markers ({len(found.layer)}) aren't the calibration's "
                f"({len(calibration.layer)}): track with calibration.layout"
            )
        used = np.asarray(found.seen & calibration.calibrated)
        if np.count_nonzero(used) < 2:
            raise InputError(
                f"only {int(used.sum())} of {len(used)} markers were found in both pictures, at "
                "least 2 are needed: check exposure, layout, channels and compression (colours of "
                "JPEG and video have half the resolution unless 4:4:4 is asked for)"
            )
        known, noise, share = _weights(found, calibration, used, METHODS[method].weighted)
        base = _base(calibration, METHODS[method], known, noise)
        modes = base.factors.modes
        whole = modes.usual_share if share is None else np.repeat(share, 2)
        return cls(
            calibration=calibration,
            used=used,
            known=known,
            noise_px=noise,
            base=base,
            factors=Factors(modes=modes, size=float(noise.sum()) / len(noise), share=whole),
        )

    @classmethod
    def together(cls, problems: Sequence[Problem]) -> Problem:
        """Return the problems of several pictures as one of a stack; they must have the same
        `stack`."""
        factors = problems[0].factors
        size = np.array([[problem.factors.size] for problem in problems])
        noise = np.array([problem.noise_px for problem in problems])
        return replace(problems[0], noise_px=noise, factors=replace(factors, size=size))

    @cached_property
    def stack(self) -> int | None:
        """A number that is the same for pictures that can be solved together; None where markers
        are lost or odd, which is this picture's own."""
        return None if len(self.factors.rows) else id(self.base)

    @cached_property
    def size_px(self) -> _Number:
        """Mean noise, px."""
        size: _Number = _total(self.noise_px) / self.noise_px.shape[-1]
        return size

    @cached_property
    def omega(self) -> _Number:
        """The papers' weight over the whitened one, px^2."""
        omega: _Number = 2.0 * self.noise_px.shape[-1] / _total(1.0 / self.noise_px**2)
        return omega

    def whiten(self, shift_px: Floats) -> Floats:
        """Return (m,) data of (n, 2) shifts of all markers; 0 for lost ones. Any number of these
        comes before the pictures."""
        shift = shift_px
        if not self._all_used:
            shift = np.where(self.used[:, None], shift_px, 0.0)[..., self.known, :]
        data = shift / self.noise_px[..., None]
        return np.asarray(data.reshape(*data.shape[:-2], -1))

    @cached_property
    def _all_used(self) -> bool:
        return bool(self.used.all())

    def shifts_of(self, force_n: Floats) -> Floats:
        """Return (m,) whitened data that (k, 3) forces make, by the linear map."""
        return np.asarray(self.base.transfer @ force_n.ravel()) / self.size_px

    def constrained(
        self, data: Floats, weight: float, friction: float | None, start: Floats | None
    ) -> tuple[Floats, float]:
        """Return (k, 3) forces held to pushes or to friction cones, N, and the violation of the
        optimality conditions; ``start`` (k, 3) is a first guess."""
        frames, base = self.calibration.site_frames, self.base
        if "local" not in base.gram:
            base.gram["penalty"] = _into_frames(base.penalty, frames)
            # last: another thread that finds it finds both
            base.gram["local"] = _into_frames(base.transfer.T @ base.transfer, frames)
        # the quadratic's unit is px^2, not the noise
        least = LEAST * float(self.factors.singular.max() * self.size_px) ** 2
        relative = max(float(weight * self.size_px**2), least)
        quadratic = base.quadratics.get(relative)
        if quadratic is None:
            _make_room(base.quadratics, KEPT_WEIGHTS)
            curvature = base.gram["local"] + relative * base.gram["penalty"]
            quadratic = base.quadratics[relative] = Quadratic(curvature=curvature)
        pull = (base.transfer.T @ (data * self.size_px)).reshape(-1, 3)
        linear = np.asarray(np.einsum("kij,kj->ki", frames, pull).ravel())
        begin = None if start is None else np.einsum("kij,kj->ki", frames, start)
        if friction is None:
            local, _, kkt = quadratic.pushes(linear, None if begin is None else begin[:, 2] > 0)
        else:
            local, kkt = quadratic.cone(linear, friction, begin)
        return np.asarray(np.einsum("kij,ki->kj", frames, local)), kkt

    @staticmethod
    def in_classes(noise: Floats) -> Floats:
        """Return (u,) noise per marker, px: the same for all where it hardly differs, else in
        classes."""
        even = noise.max() <= EVEN_NOISE * noise.min()
        if not even:
            ranked = np.sort(noise)
            low, usual, most = (_at_share(ranked, share) for share in (0.1, 0.5, 0.9))
            even = most <= EVEN_NOISE * low and ranked[-1] <= 2 * EVEN_NOISE * low
        if even:
            return np.full(len(noise), math.sqrt(noise @ noise / len(noise)))
        return np.asarray(usual * CLASS ** np.rint(np.log(noise / usual) / np.log(CLASS)))


def _at_share(ranked: Floats, share: float) -> float:
    """Return what a share of ascending values lies below, interpolated between them."""
    place = share * (len(ranked) - 1)
    before = int(place)
    after = min(before + 1, len(ranked) - 1)
    return float(ranked[before] + (place - before) * (ranked[after] - ranked[before]))


def _into_frames(matrix: Floats, frames: Floats) -> Floats:
    """Return a (3k, 3k) matrix on global forces as one on forces in the sites' own frames."""
    count = len(frames)
    blocks = matrix.reshape(count, 3, count, 3)
    return np.asarray(
        np.einsum("iab,ibjd,jcd->iajc", frames, blocks, frames, optimize=True).reshape(matrix.shape)
    )


def _weights(
    found: Found, calibration: Calibration, used: Bools, weighted: bool
) -> tuple[Bools, Floats, Floats | None]:
    """Return (n,) markers to factorise with, (u,) their noise in px, and (u,) the share that each
    has of its weight; None where all have all of it."""
    own = np.where(np.isfinite(found.sd_px) & (found.sd_px > 0), found.sd_px, calibration.noise_px)
    usual = found.usual_sd_px
    unknowns = calibration.transfer.shape[1]
    if usual is not None and weighted and 2 * len(usual) >= unknowns:
        known = np.asarray(calibration.calibrated & np.isfinite(usual))
        if 2 * known.sum() >= unknowns and not (used & ~known).any():
            noise = Problem.in_classes(usual[known])
            ratio, here = own[known] / noise, used[known]
            size = float(medians(ratio[here]))
            odd = (ratio > UNUSUAL * size) | (ratio < size / UNUSUAL)
            share = np.where(here, np.where(odd, (size / ratio) ** 2, 1.0), 0.0)
            count = int((share != 1.0).sum())
            if count <= MOST_UNUSUAL * len(noise) and 2 * (len(noise) - count) >= unknowns:
                return known, noise * size, share if count else None
    return used, Problem.in_classes(own[used]), None


def _make_room(kept: dict[Any, Any], most: int) -> None:
    """Drop the oldest entries until fewer than ``most`` are left; other threads may, too."""
    for oldest in list(kept)[: len(kept) + 1 - most]:
        kept.pop(oldest, None)


def _base(calibration: Calibration, method: InverseMethod, known: Bools, noise: Floats) -> _Base:
    """Factorise, or take a kept factorisation: with even noise it only scales. Where markers give
    fewer data than sites have unknowns, a film's changing patterns of noise (`_weights`) follow
    from the factors of all markers alike."""
    kept = _kept.setdefault(calibration, {})
    even = bool((noise == noise[0]).all())
    pattern = (noise / noise.mean()).round(6) if not even else np.ones(1)
    key = (method.penalty, known.tobytes() + pattern.tobytes())
    with _ordering:  # as the last that goes
        base = kept.pop(key, None)
        if base is not None:
            kept[key] = base
    if base is None:
        scale = np.repeat(noise.mean() / noise, 2)
        whitened = scale[:, None] * calibration.transfer[np.repeat(known, 2)]
        every = calibration.calibrated
        alike = even and np.array_equal(known, every)
        if alike or 2 * every.sum() >= whitened.shape[1]:
            penalty = method.matrix(calibration.grid)
            factors = Factors.of(whitened, penalty)
        else:
            whole = _base(calibration, method, every, np.ones(int(every.sum())))
            penalty = whole.penalty
            factors = whole.factors.of_some(np.repeat(known[every], 2), scale)
        base = _Base(transfer=whitened, penalty=penalty, factors=factors, gram={}, quadratics={})
        _make_room(kept, KEPT)
        kept[key] = base
    return base
