"""The inverse problem of one picture: marker shifts in, forces out, for one weight.

`Problem.of` weighs the markers by their noise and sets up the least squares of the picture. What is
kept small, and how, is listed in `METHODS`; `twin.sense.reconstruct` solves.

**Weights of the markers** are those of the rest picture, as each set of weights needs a
factorisation of its own (145 ms of CPU time on the flat block; a solve takes 5). Lost markers, and
markers much noisier than at rest, are corrected exactly (`twin.sense.regularisation`). So a
solution depends on nothing but the rest picture and the picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from twin.arrays import Bools, Floats, medians
from twin.errors import InputError
from twin.parts.methods import Method
from twin.sense.calibration import Calibration
from twin.sense.constraints import LEAST, Quadratic
from twin.sense.regularisation import Factors
from twin.sense.track import Found


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
        if used.sum() < 2:
            raise InputError(
                f"only {int(used.sum())} of {len(used)} markers were found in both pictures, at "
                "least 2 are needed: check exposure, layout, channels and compression (colours of "
                "JPEG and video have half the resolution unless 4:4:4 is asked for)"
            )
        known, noise, share = _weights(found, calibration, used, METHODS[method].weighted)
        base = _base(calibration, METHODS[method], known, noise)
        singular = base.factors.singular / float(noise.mean())
        return cls(
            calibration=calibration,
            used=used,
            known=known,
            noise_px=noise,
            base=base,
            factors=replace(base.factors, singular=singular, share=np.repeat(share, 2)),
        )

    @property
    def size_px(self) -> float:
        """Mean noise, px."""
        return float(self.noise_px.mean())

    @property
    def omega(self) -> float:
        """The papers' weight over the whitened one, px^2."""
        return 2.0 * float(1.0 / np.mean(1.0 / self.noise_px**2))

    def whiten(self, shift_px: Floats) -> Floats:
        """Return (m,) data of (n, 2) shifts of all markers; 0 for lost ones."""
        shift = np.where(self.used[:, None], shift_px, 0.0)[self.known]
        return np.asarray(shift.ravel() / np.repeat(self.noise_px, 2))

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
        relative = max(weight * self.size_px**2, least)
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
        ranks = np.linspace(0.0, 1.0, len(noise))
        shares = [0.0, 0.1, 0.5, 0.9, 1.0]
        least, low, usual, most, high = np.interp(shares, ranks, np.sort(noise))
        even = most <= EVEN_NOISE * low and high <= 2 * EVEN_NOISE * low
        if even or high <= EVEN_NOISE * least:
            return np.full(len(noise), np.sqrt(np.mean(noise**2)))
        return np.asarray(usual * CLASS ** np.rint(np.log(noise / usual) / np.log(CLASS)))


def _into_frames(matrix: Floats, frames: Floats) -> Floats:
    """Return a (3k, 3k) matrix on global forces as one on forces in the sites' own frames."""
    count = len(frames)
    blocks = matrix.reshape(count, 3, count, 3)
    return np.asarray(
        np.einsum("iab,ibjd,jcd->iajc", frames, blocks, frames, optimize=True).reshape(matrix.shape)
    )


def _weights(
    found: Found, calibration: Calibration, used: Bools, weighted: bool
) -> tuple[Bools, Floats, Floats]:
    """Return (n,) markers to factorise with, (u,) their noise in px, and (u,) the share that each
    has of its weight."""
    own = np.where(np.isfinite(found.sd_px) & (found.sd_px > 0), found.sd_px, calibration.noise_px)
    usual = found.usual_sd_px
    if usual is not None and weighted:
        known = np.asarray(calibration.calibrated & np.isfinite(usual))
        unknowns = calibration.transfer.shape[1]
        if 2 * known.sum() >= unknowns and not (used & ~known).any():
            noise = Problem.in_classes(usual[known])
            ratio, here = own[known] / noise, used[known]
            size = float(medians(ratio[here]))
            odd = (ratio > UNUSUAL * size) | (ratio < size / UNUSUAL)
            share = np.where(here, np.where(odd, (size / ratio) ** 2, 1.0), 0.0)
            count = int((share != 1.0).sum())
            if count <= MOST_UNUSUAL * len(noise) and 2 * (len(noise) - count) >= unknowns:
                return known, noise * size, share
    return used, Problem.in_classes(own[used]), np.ones(int(used.sum()))


def _make_room(kept: dict[Any, Any], most: int) -> None:
    """Drop the oldest entries until fewer than ``most`` are left; other threads may, too."""
    for oldest in list(kept)[: len(kept) + 1 - most]:
        kept.pop(oldest, None)


def _base(calibration: Calibration, method: InverseMethod, known: Bools, noise: Floats) -> _Base:
    """Factorise, or take a kept factorisation: with even noise it only scales. Where markers give
    fewer data than sites have unknowns, a film's changing patterns of noise (`_weights`) follow
    from the factors of all markers alike."""
    kept = _kept.setdefault(calibration, {})
    even = bool(np.all(noise == noise[0]))
    pattern = (noise / noise.mean()).round(6) if not even else np.ones(1)
    key = (method.penalty, known.tobytes() + pattern.tobytes())
    base = kept.pop(key, None)
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
    kept[key] = base  # as the last that goes
    return base
