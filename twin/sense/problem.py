"""The inverse problem of one picture, whitened and factorised: what every way of solving it starts from.

Why markers are weighed as at rest: a picture's own standard deviations differ a little from those of every other one,
and each set of weights would be factorised anew (145 ms of CPU time on the flat block, where the rest takes 5). What
does differ, lost markers and those much noisier than at rest, is corrected exactly (`twin.sense.reweigh`). So the
answer depends on rest picture and picture alone, not on the pictures between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import InputError
from twin.sense.calibration import Calibration
from twin.sense.cone import LEAST, Quadratic
from twin.sense.reweigh import Reweighed
from twin.sense.track import Found
from twin.sense.weigh import Factors, factorise

EVEN_NOISE = 2.0
"""Markers whose noise differs by less than this factor (10 % to 90 %) are weighed alike, so that a factorisation
serves a whole sequence."""

CLASS = 2.0
"""Other markers are weighed in classes by this factor around the median: noise is estimated a little differently in
every picture, and each new set of weights would be factorised anew. Two readings at the ends of a class lose a fifth of
their joint precision at worst, most hardly any."""

UNUSUAL = 2.0
"""A marker whose noise differs from its usual one by more than this factor is weighed otherwise."""

MOST_UNUSUAL = 0.25
"""Share of the markers that may be weighed otherwise before the problem is factorised anew."""

KEPT, KEPT_WEIGHTS = 8, 4
_kept: WeakKeyDictionary[Calibration, dict[tuple[str, bytes], Base]] = WeakKeyDictionary()


@dataclass(frozen=True, kw_only=True, eq=False)
class Base:
    """A transfer matrix whitened by the markers' relative noise, its factors, and what was solved with it.

    Attributes
    ----------
    transfer
        (m, 3k) rows over the markers' noise relative to its mean, px/N.
    penalty
        (3k, 3k) Q.
    factors
        Of both.
    gram
        (3k, 3k) H^T H in the sites' own frames, and others that are filled in when first asked for.
    quadratics
        Constrained problems by weight, the last few.
    """

    transfer: Floats
    penalty: Floats
    factors: Factors
    gram: dict[str, Floats]
    quadratics: dict[float, Quadratic]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """One picture's data with the base they belong to; whitened means: in units of each marker's usual noise.

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
    share
        (m,) information of every datum over what its noise says: 1 for most, 0 for lost markers.
    factors
        The base's with the noise's size in it.
    """

    calibration: Calibration
    used: Bools
    known: Bools
    noise_px: Floats
    base: Base
    share: Floats
    factors: Factors

    @property
    def size_px(self) -> float:
        """Mean noise, px."""
        return float(self.noise_px.mean())

    @property
    def omega(self) -> float:
        """The papers' weight over the whitened one, px^2."""
        return 2.0 * float(1.0 / np.mean(1.0 / self.noise_px**2))

    @cached_property
    def reweighed(self) -> Reweighed:
        """The factors with this picture's weights."""
        return Reweighed(factors=self.factors, share=self.share)

    def whiten(self, shift_px: Floats) -> Floats:
        """Return (m,) data of (n, 2) shifts of all markers; 0 for lost ones."""
        shift = np.where(self.used[:, None], shift_px, 0.0)[self.known]
        return np.asarray(shift.ravel() / np.repeat(self.noise_px, 2))

    def weighed(self, rows: Floats) -> Floats:
        """Return the (m', ...) rows of data that were not lost, in units of this picture's own noise."""
        here = self.share > 0
        return np.asarray((rows[here].T * np.sqrt(self.share[here])).T)

    def quadratic(self, weight: float) -> Quadratic:
        """Return the problem for constrained solves; its unit is px^2, not the noise."""
        base, frames = self.base, self.calibration.site_frames
        if "local" not in base.gram:
            base.gram["local"] = _into_frames(base.transfer.T @ base.transfer, frames)
            base.gram["penalty"] = _into_frames(base.penalty, frames)
        gram = base.gram["local"]
        relative = max(weight * self.size_px**2, LEAST * float(self.factors.singular.max() * self.size_px) ** 2)
        if relative not in base.quadratics:
            while len(base.quadratics) >= KEPT_WEIGHTS:
                base.quadratics.pop(next(iter(base.quadratics)))
            base.quadratics[relative] = Quadratic(curvature=gram + relative * base.gram["penalty"])
        return base.quadratics[relative]

    def linear_term(self, data: Floats) -> Floats:
        """Return (3k,) H^T M in the sites' own frames, in the quadratic's unit, of whitened data."""
        pull = (self.base.transfer.T @ (data * self.size_px)).reshape(-1, 3)
        return np.asarray(np.einsum("kij,kj->ki", self.calibration.site_frames, pull).ravel())

    def shifts_of(self, force: Floats) -> Floats:
        """Return (m,) whitened shifts that (k, 3) forces cause, N, seen linearly."""
        return np.asarray(self.base.transfer @ force.ravel()) / self.size_px

    def globally(self, local: Floats) -> Floats:
        """Return (k, 3) forces in global axes."""
        return np.asarray(np.einsum("kij,ki->kj", self.calibration.site_frames, local))


def problem_of(found: Found, calibration: Calibration, method: str) -> Problem:
    """Return the whitened problem; factorised anew only where markers or their relative noise changed.

    Raises
    ------
    InputError
        Motion and calibration don't belong together, or fewer than 2 markers are left.
    """
    used = _usable(found, calibration)
    known, noise, share = _weights(found, calibration, used, method)
    base = _base(calibration, method, known, noise)
    factors = replace(base.factors, singular=base.factors.singular / float(noise.mean()))
    return Problem(
        calibration=calibration, used=used, known=known, noise_px=noise, base=base, share=np.repeat(share, 2),
        factors=factors,
    )  # fmt: skip


def _usable(found: Found, calibration: Calibration) -> Bools:
    if not np.array_equal(found.layer, calibration.layer):
        raise InputError(
            f"the tracked markers ({len(found.layer)}) aren't the calibration's ({len(calibration.layer)}): "
            "track with calibration.layout"
        )
    used = np.asarray(found.seen & calibration.calibrated)
    if used.sum() < 2:
        raise InputError(
            f"only {int(used.sum())} of {len(used)} markers were found in both pictures, at least 2 are needed: check "
            "exposure, layout and channels"
        )
    return used


def _weights(found: Found, calibration: Calibration, used: Bools, method: str) -> tuple[Bools, Floats, Floats]:
    """Return (n,) markers to factorise with, (u,) their noise in px, and (u,) the share that each has of its weight."""
    own = np.where(np.isfinite(found.sd_px) & (found.sd_px > 0), found.sd_px, calibration.noise_px)
    usual = found.usual_sd_px
    if usual is not None and method != "pinv":
        known = np.asarray(calibration.calibrated & np.isfinite(usual))
        if not (used & ~known).any():
            noise = in_classes(usual[known])
            ratio, here = own[known] / noise, used[known]
            size = float(np.median(ratio[here]))
            odd = (ratio > UNUSUAL * size) | (ratio < size / UNUSUAL)
            share = np.where(here, np.where(odd, (size / ratio) ** 2, 1.0), 0.0)
            count = int((share != 1.0).sum())
            if count <= MOST_UNUSUAL * len(noise) and 2 * (len(noise) - count) >= calibration.transfer.shape[1]:
                return known, noise * size, share
    return used, in_classes(own[used]), np.ones(int(used.sum()))


def in_classes(noise: Floats) -> Floats:
    """Return (u,) noise per marker, px: the same for all where it hardly differs, else in classes."""
    low, high = noise.min(), noise.max()
    even = high <= EVEN_NOISE * low
    if not even:
        low, most = np.quantile(noise, [0.1, 0.9])
        even = most <= EVEN_NOISE * low and high <= 2 * EVEN_NOISE * low
    if even:
        return np.full(len(noise), np.sqrt(np.mean(noise**2)))
    usual = float(np.median(noise))
    return np.asarray(usual * CLASS ** np.rint(np.log(noise / usual) / np.log(CLASS)))


def _base(calibration: Calibration, method: str, known: Bools, noise: Floats) -> Base:
    """Factorise, or take a kept factorisation: with even noise it only scales."""
    kept = _kept.setdefault(calibration, {})
    even = bool(np.all(noise == noise[0]))
    pattern = (noise / noise.mean()).round(6) if not even else np.ones(1)
    key = (method, known.tobytes() + pattern.tobytes())
    if key not in kept:
        rows = calibration.transfer.reshape(len(known), 2, -1)[known].reshape(2 * int(known.sum()), -1)
        relative = noise / noise.mean()
        whitened, matrix = rows / np.repeat(relative, 2)[:, None], penalty(calibration, method)
        while len(kept) >= KEPT:
            kept.pop(next(iter(kept)))
        kept[key] = Base(
            transfer=whitened, penalty=matrix, factors=factorise(whitened, matrix), gram={}, quadratics={}
        )  # fmt: skip
    return kept[key]


def penalty(calibration: Calibration, method: str) -> Floats:
    """Return the (3k, 3k) matrix Q of the papers' (w/2) F^T Q F.

    ``smooth``: differences of neighbouring sites along both directions of the grid and per component (flat paper, eq.
    11, which as printed wraps at row ends and between components). They go on past the edge of the grid, to sites
    without force; see `twin.sense.reconstruct`. Anything else: the forces themselves (eq. 14).
    """
    return grid_penalty(calibration.grid, method)


def grid_penalty(grid: tuple[int, int], method: str) -> Floats:
    """Return `penalty` of a (columns, rows) grid of sites."""
    return np.asarray(np.kron(PENALTIES[method](*grid), np.eye(3)), np.float64)


def _forces(columns: int, rows: int) -> Floats:
    return np.eye(columns * rows)


def _neighbours(columns: int, rows: int) -> Floats:
    along, across = _differences(columns), _differences(rows)
    return np.asarray(np.kron(along.T @ along, np.eye(rows)) + np.kron(np.eye(columns), across.T @ across))


def _differences(count: int) -> Floats:
    """Return (count + 1, count) differences of a row of sites with one of zero force beyond either end."""
    return np.asarray(np.diff(np.eye(count + 2), axis=0)[:, 1:-1], float)


PENALTIES: dict[str, Callable[[int, int], Floats]] = {
    "smooth": _neighbours, "norm": _forces, "pinv": _forces, "local": _neighbours,
}  # fmt: skip
"""By method, from the grid's columns and rows to the (sites, sites) matrix that every component of the force is kept
small in: positive definite, sites counted row by row within columns."""


def _into_frames(matrix: Floats, frames: Floats) -> Floats:
    """Return a (3k, 3k) matrix on global forces as one on forces in the sites' own frames."""
    count = len(frames)
    blocks = matrix.reshape(count, 3, count, 3)
    return np.asarray(np.einsum("iab,ibjd,jcd->iajc", frames, blocks, frames, optimize=True).reshape(matrix.shape))
