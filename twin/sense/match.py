"""Match spots to markers: in the rest picture by the layout, in every other picture by the
rest state.

A marker's motion can exceed half the pitch, where its nearest spot is another marker. So
predictions come first: in the rest picture from one affine map found by voting, later from the
motion of the neighbours already matched (a local affine fit). A pair counts when each is the
other's nearest, near the prediction, and alike in size and brightness. What has no such partner is
missing and stays so.

Validity: motion that is smooth over a few pitches (strain between neighbours below about 0.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Pixels, medians
from twin.compiled import njit
from twin.sense.template import LEADS

NEIGHBOURS = 10
LEAST_NEIGHBOURS = 3
CANDIDATES = 8
GATE = 0.35
"""Largest distance between prediction and spot, in spacings."""

ROUNDS = 40
LATTICE, LATTICE_REACH = 0.4, 0.3
"""A step that leads from this share of the markers to another one belongs to the layout's lattice;
met within so many spacings."""

PRIOR, RIVAL, MORE = 4.0, 1.2, 2.5
"""From a cold start, motion by one spacing more must be borne out by so many standard deviations;
shifts that differ by less in all can't be distinguished. With these a lattice without a border is
matched up to .3 spacings. A pairing that leaves over less by `MORE` is not ruled out by its longer
motion alone."""

STILL = 0.25
"""With more motion than this, in spacings, the shift must also be the one that leaves over the
least: hidden markers are common, but so are they where nothing has moved."""

SHARED = 0.95
"""A pairing that has this share of the best one's pairs, and leaves over less by `MORE` standard
deviations, is not ruled out by its longer motion: whole rows that have gone were hidden, or have
moved out of the picture."""

TORN = 0.08
"""If a larger share of the markers has no spot, though as many spots have no marker, the pairs that
were found are not trusted."""

COVERED = 0.4
"""Of a layer of which more than this share is gone, it is covered: nothing moves by so much of the
picture."""

ASTRAY = 0.15
"""Share of the markers that may have moved unlike their neighbours: the spots of partly hidden
markers lie off their centres."""

TURNS_OF_PLANES, PULL = 3, 0.02
"""Weighted fits of the light around a marker; a weak pull to no slope."""

OUTLYING = 3.0
"""A score of more medians counts as one of so many: under moving shadows up to a quarter of a layer
may have more."""

LEAST_SCORES = 4
"""From so many numbers on a median is taken."""

TRUST = 0.25
"""Share of the markers that may be lost before the previous picture's motion is given up as a
start: a grid moved by a whole pitch looks like one that hasn't moved, so a cold start must not
overrule a good one."""


GATES = 0.4, 0.35, 0.3, 0.25, 0.2, 0.2
"""How far a spot may lie from where its marker is expected, in spacings, fit by fit."""

ROWS_OFF, LEAST_ODD, LEFT_ODD = 3, 6, 0.7
"""How many rows of its lattice a drawing may lie off, where it has a border. A shift by a row is
tried where so many markers have no spot or spots no marker, and taken if it leaves so small a share
of these."""


def spacing(points_px: Pixels) -> float:
    """Return the typical distance from a marker to its nearest neighbour, px; 30 for a lone
    marker."""
    points = np.asarray(points_px, float)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return 30.0
    distance, _ = cKDTree(points).query(points, k=2)
    return float(max(np.median(distance[:, 1]), 1.0))


def _onto_picture(
    nominal: list[Pixels], spots: list[Pixels], spacing_px: float, size_px: tuple[int, int]
) -> tuple[list[Pixels], int]:
    """Return where the markers of a drawing are expected in a picture (height, width): the drawing
    under one affine map; and how many are odd, see `_mapped`."""
    votes = np.concatenate(
        [_steps(n, s, 0.9 * spacing_px) for n, s in zip(nominal, spots, strict=True)]
    )
    if not len(votes):
        return nominal, sum(map(len, nominal)) + sum(map(len, spots))
    width = max(0.12 * spacing_px, 1.0)
    sample = votes[:: max(1, len(votes) // 2000)]
    support = cKDTree(votes).query_ball_point(sample, width, return_length=True) * (
        1.0 - 0.1 * np.linalg.norm(sample, axis=1) / spacing_px
    )
    peak = sample[np.argmax(support)]
    shift = votes[np.linalg.norm(votes - peak, axis=1) < width].mean(axis=0)
    expected, odd = _mapped(nominal, spots, shift, spacing_px, size_px)
    for _ in range(ROWS_OFF):
        if odd < LEAST_ODD:
            break  # nearly always
        most = max(expected, key=len)
        ways = Neighbourhood.of(most, spacing(most)).steps
        tried = [_mapped(expected, spots, way, spacing_px, size_px, GATES[-1:])[1] for way in ways]
        if min(tried, default=odd) > LEFT_ODD * odd:
            break
        way = ways[np.argmin(tried)]
        expected, odd = _mapped(expected, spots, way, spacing_px, size_px)
    return expected, odd


def _mapped(
    drawn: list[Pixels],
    spots: list[Pixels],
    shift: Pixels,
    spacing_px: float,
    size_px: tuple[int, int],
    gates: tuple[float, ...] = GATES,
) -> tuple[list[Pixels], int]:
    """Return where markers are expected by the affine map that fits their spots best, begun from a
    ``shift`` (2,) and by ever narrower ``gates``; and how many have no spot though well inside the
    picture, or are spots without a marker."""
    affine = np.vstack([np.eye(2), shift])
    places = np.concatenate(drawn)
    seen = np.zeros(len(places), np.bool_)
    for gate in gates:
        pairs = [
            _mutual_nearest(each @ affine[:2] + affine[2], s, gate * spacing_px)
            for each, s in zip(drawn, spots, strict=True)
        ]
        seen = np.concatenate(pairs) >= 0
        if seen.sum() < 4:
            break
        seen_at = np.concatenate([s[p[p >= 0]] for s, p in zip(spots, pairs, strict=True)])
        affine = _fit_affine(places[seen], seen_at)
    expected = [np.asarray(each @ affine[:2] + affine[2]) for each in drawn]
    border, at = 0.5 * spacing_px, np.concatenate(expected)
    inside = ((at > border) & (at < np.array([size_px[1], size_px[0]]) - border)).all(axis=1)
    odd = (inside & ~seen).sum() + sum(map(len, spots)) - seen.sum()
    return expected, int(odd)


def _steps(start: Pixels, spots: Pixels, reach: float) -> Pixels:
    if not len(start) or not len(spots):
        return np.zeros((0, 2))
    distance, index = cKDTree(spots).query(
        start, k=min(CANDIDATES, len(spots)), distance_upper_bound=reach
    )
    of, which = np.nonzero(np.isfinite(distance.reshape(len(start), -1)))
    return np.asarray(spots[index.reshape(len(start), -1)[of, which]] - start[of])


def _fit_affine(start: Pixels, end: Pixels) -> Floats:
    """Least squares with a stiff prior towards a pure shift, so that few or collinear points are no
    trouble."""
    middle = start.mean(axis=0)
    away = start - middle
    motion = end - start
    mean = motion.mean(axis=0)
    stiffness = 1e-3 * max(float((away**2).sum()), 1.0) * np.eye(2)
    slope = np.linalg.solve(away.T @ away + stiffness, away.T @ (motion - mean))
    return np.vstack([np.eye(2) + slope, mean - middle @ slope])


def _mutual_nearest(expected: Pixels, spots: Pixels, gate: float) -> Ints:
    """Return (n,) the spot of every marker, -1 for none: each the other's nearest, closer than
    ``gate``."""
    if not len(spots):
        return np.full(len(expected), -1, np.int64)
    distance, spot = cKDTree(spots).query(expected)
    _, marker = cKDTree(expected).query(spots)
    good = (marker[spot] == np.arange(len(expected))) & (distance < gate)
    return np.asarray(np.where(good, spot, -1))


@dataclass(frozen=True, kw_only=True)
class Neighbourhood:
    """The rest state that matching needs; made once for a sequence of pictures.

    Attributes
    ----------
    rest_px
        (n, 2) rest positions of the markers of one group, px; NaN for those not found at rest.
    near
        (n, NEIGHBOURS) the nearest other markers that were found.
    fit_weight
        (n, NEIGHBOURS) fitting weights, 0 for padding.
    lead
        (n, `twin.sense.template.LEADS`) the nearest neighbours of a lower row, -1 for padding.
    spacing_px
        Distance of neighbouring markers, px.
    goes_on
        Whether the lattice goes on beyond the drawn layout: then no motion is more likely from a
        cold start than another.
    """

    rest_px: Pixels
    near: Ints
    fit_weight: Floats
    lead: Ints
    spacing_px: float
    goes_on: bool = False

    @classmethod
    def of(cls, rest_px: Pixels, spacing_px: float) -> Neighbourhood:
        """Find the nearest neighbours of every marker at rest."""
        known = np.flatnonzero(np.isfinite(rest_px).all(axis=1))
        near = np.zeros((len(rest_px), NEIGHBOURS), np.int64)
        weight = np.zeros((len(rest_px), NEIGHBOURS))
        if len(known) > 1:
            count = min(NEIGHBOURS, len(known) - 1)
            distance, index = cKDTree(rest_px[known]).query(rest_px[known], k=count + 1)
            near[known, :count] = known[index[:, 1:]]
            weight[known, :count] = 1.0 / (1.0 + (distance[:, 1:] / (1.5 * spacing_px)) ** 2)
        earlier = (near < np.arange(len(near))[:, None]) & (weight > 0.0)
        first = np.argsort(~earlier, axis=1, kind="stable")[:, :LEADS]
        lead = np.where(
            np.take_along_axis(earlier, first, axis=1), np.take_along_axis(near, first, axis=1), -1
        )
        return cls(
            rest_px=rest_px,
            near=near,
            fit_weight=weight,
            lead=np.ascontiguousarray(lead),
            spacing_px=spacing_px,
        )

    @cached_property
    def partner(self) -> Ints:
        """(l, n) the marker that lies a step of the lattice away, for each of its l shortest steps;
        -1 where none does, and l = 0 where there is no lattice."""
        rest, reach = self.rest_px, LATTICE_REACH * self.spacing_px
        known = np.flatnonzero(np.isfinite(rest).all(axis=1))
        found: list[Ints] = []
        if len(known) > 1:
            tree = cKDTree(rest[known])
            steps = (rest[self.near] - rest[:, None])[self.fit_weight > 0.0]
            steps = steps[np.isfinite(steps[:, 0])]
            support = cKDTree(steps).query_ball_point(steps, reach, return_length=True)
            while len(steps) and support.max() >= LATTICE * len(known):
                close = np.linalg.norm(steps - steps[np.argmax(support)], axis=1) < reach
                step = steps[close].mean(axis=0)
                steps, support = steps[~close], support[~close]
                off, index = tree.query(rest[known] + step)
                partner = np.full(len(rest), -1, np.int64)
                partner[known] = np.where(off < reach, known[index], -1)
                found.append(partner)
        return np.array(found, np.int64).reshape(-1, len(rest))

    @cached_property
    def far_partner(self) -> Ints:
        """``partner``, and those two steps away."""
        found, steps = list(self.partner), list(self.steps)
        for first, second in combinations_with_replacement(self.partner, 2):
            there = np.where(first >= 0, second[first], -1)
            back = np.where(second >= 0, first[second], -1)
            partner = np.where(there >= 0, there, back)
            step = self._step(partner)
            away = np.hypot(*np.subtract([*steps, np.zeros(2)], step).T)
            if (away > LATTICE_REACH * self.spacing_px).all():
                found.append(partner)
                steps.append(step)
        return np.array(found, np.int64).reshape(-1, len(self.rest_px))

    @cached_property
    def steps(self) -> Pixels:
        """(l, 2) the shortest steps of the lattice, those to `partner`, px."""
        return np.array([self._step(partner) for partner in self.partner]).reshape(-1, 2)

    def _step(self, partner: Ints) -> Floats:
        """Return (2,) the usual step from markers to their partners, px; NaN where none has any."""
        steps = np.where((partner >= 0)[:, None], self.rest_px[partner] - self.rest_px, np.nan)
        steps = steps[np.isfinite(steps[:, 0])]
        return np.asarray(np.median(steps, axis=0)) if len(steps) else np.full(2, np.nan)

    def beyond(self, spots: Pixels) -> Ints:
        """Return which of the ``spots`` (b, 2), none of them a marker's, go on with the markers'
        lattice: step by step from marker to spot, and from spot to spot."""
        known, found = self.rest_px, np.zeros(len(spots), np.bool_)
        known = known[np.isfinite(known[:, 0])]
        while len(self.steps) and len(known) and not found.all():
            away, _ = cKDTree((known[:, None] + self.steps).reshape(-1, 2)).query(spots)
            new = (away < LATTICE_REACH * self.spacing_px) & ~found
            if not new.any():
                break
            found |= new
            known = spots[new]
        return np.flatnonzero(found)

    def predict(self, motion: Pixels) -> tuple[Pixels, Bools]:
        """Return every marker's motion as its matched neighbours have it (local affine), and where
        enough of them do."""
        predicted, certain = np.empty_like(motion), np.empty(len(motion), np.bool_)
        _local_affine(
            self.rest_px,
            self.near,
            self.fit_weight,
            self.spacing_px,
            motion,
            predicted,
            certain,
        )
        return predicted, certain

    @staticmethod
    def bounded_squares(score: Floats) -> Floats:
        """Return (q,) the mean squares of the columns of ``score`` (n, q), where more than
        `OUTLYING` medians count as so many."""
        score = np.sort(np.abs(score), axis=0)
        count = len(score)
        median = 0.5 * (score[(count - 1) // 2] + score[count // 2])
        np.minimum(score, OUTLYING * median, out=score)
        return np.asarray((score * score).sum(axis=0) / count)

    def scatter(self, shift_px: Pixels, sd_px: Floats) -> float | None:
        """Return how far shifts (n, 2) are off the local affine motion of their neighbours, over
        their deviations ``sd_px`` (n,), root mean square (`bounded_squares`): an upper bound of
        their noise, as motion that is less smooth counts, too. None where too few have
        neighbours."""
        squares = _scatter(
            self.rest_px, self.near, self.fit_weight, self.spacing_px, shift_px, sd_px
        )
        return None if squares < 0.0 else math.sqrt(squares)

    def usual(self, measured: Floats, fine: Bools, rows: Ints) -> tuple[Floats, Floats]:
        """Return what ``measured`` (n, q) should be for markers ``rows`` by their ``fine``
        neighbours, and its scatter: the median, and 1.4826 times the median distance from it.
        Where there are too few neighbours it is all markers'; NaN where these are too few."""
        known = np.where(fine[:, None], measured, np.nan)
        count = fine.sum()
        near = np.where((self.fit_weight[rows] > 0.0)[:, :, None], known[self.near[rows]], np.nan)
        near[np.isfinite(near[:, :, 0]).sum(axis=1) < LEAST_SCORES] = np.nan
        usual = medians(near, 1)
        spread = medians(np.abs(near - usual[:, None]), 1)
        alone = np.isnan(usual[:, 0])
        if alone.any() and count >= LEAST_SCORES:
            usual[alone] = medians(known)
            spread[alone] = medians(np.abs(known - usual[alone][0]))
        return usual, 1.4826 * spread

    def slopes(self, values: Floats, places: Pixels) -> tuple[Floats, Floats, float]:
        """Fit planes to ``values`` (n,) at ``places`` (n, 2) over every marker and its neighbours,
        outliers bounded.

        Returns
        -------
        (n, 2) slopes, 1/px; (n,) how far values lie off the planes; and which share of the values'
        squares that is.
        """
        members = np.column_stack([np.arange(len(values)), self.near])
        weight = np.column_stack([np.ones(len(values)), self.fit_weight])
        value = values[members]
        weight[~np.isfinite(value)] = 0.0
        value = np.nan_to_num(value)
        terms = np.ones((*members.shape, 3))
        terms[:, :, 1:] = np.nan_to_num(places[members] - places[:, None]) / self.spacing_px
        both = np.concatenate([terms, value[:, :, None]], axis=2)
        products = (terms[:, :, :, None] * both[:, :, None]).reshape(*members.shape, 12)
        trust, pull = weight, PULL * np.eye(3)
        for _ in range(TURNS_OF_PLANES):
            sums = (trust[:, None] @ products).reshape(-1, 3, 4)
            plane = np.linalg.solve(sums[:, :, :3] + pull, sums[:, :, 3:])
            off = value - (terms @ plane)[:, :, 0]
            usual = 1.4826 * medians(np.where(weight > 0.0, np.abs(off), np.nan), 1)
            trust = weight / (1.0 + (off / np.fmax(OUTLYING * usual, 1e-9)[:, None]) ** 2) ** 2
        mean = (weight * value).sum(axis=1) / np.fmax(weight.sum(axis=1), 1e-9)
        square = (weight * (value - mean[:, None]) ** 2).sum()
        left = float((weight * off**2).sum() / max(square, 1e-12))
        return plane[:, 1:, 0] / self.spacing_px, usual, left

    def complete(self, spots: Pixels, spot: Ints, allowed: Bools) -> Ints:
        """Return (n,) ``spot``, with those of the ``allowed`` (b,) spots added for markers that
        have none, where the neighbours' motion predicts them."""
        taken = np.flatnonzero(allowed)
        if not len(taken):
            return spot
        motion = np.where((spot >= 0)[:, None], spots[spot] - self.rest_px, np.nan)
        expected, certain = self.predict(motion)
        free = np.flatnonzero((spot < 0) & certain)
        if not len(free):
            return spot
        place = (self.rest_px + expected)[free]
        pair = _mutual_nearest(place, spots[taken], GATE * self.spacing_px)
        out = spot.copy()
        out[free] = np.where(pair >= 0, taken[pair], -1)
        return out

    def follow(
        self,
        spots: Pixels,
        alike: Bools,
        start_px: Pixels | None = None,
        size_px: tuple[int, int] | None = None,
        spare_px: Pixels | None = None,
        found_px: float = np.inf,
    ) -> tuple[Ints, bool]:
        """Return (n,) which spot every marker has become, -1 where none has; whether another
        lattice shift fits as well.

        Parameters
        ----------
        spots
            (b, 2) spots of the picture, px.
        alike
            (n, b) whether a spot could be the marker by its size and brightness.
        start_px
            (n, 2) motion in the previous picture, px, NaN where unknown; None starts cold.
        size_px
            (height, width) of the picture, whose markers may leave it; None if none can.
        spare_px
            (s, 2) spots at rest that are none of the markers, px.
        found_px
            How far beyond the frame the middle of a spot may be that is found at rest, px.

        Notes
        -----
        A lattice that has moved by one of its own steps shows the same spots but for its border:
        where its first row was none is, and one shows beyond its last. So pairings are compared by
        the markers and spots that they leave over: by 2 sqrt(number), whose standard deviation is 1
        if these are lost by chance (Anscombe 1948).
        """
        count = len(self.rest_px)
        if not count or not len(spots):
            return np.full(count, -1, np.int64), False
        search = _Search(self, spots, alike, size_px, start_px, spare_px, found_px)
        if start_px is not None:
            warm = search.grow(start_px, whole=True)
            allowed = TRUST * float(np.isfinite(self.rest_px).all(axis=1).sum())
            outdone = any(rival.left_over < warm.left_over for rival in search.rivals(warm))
            if search.lost(warm) < allowed and not outdone:
                return warm.spot, False
        still = search.grow(np.zeros_like(self.rest_px))
        if start_px is None and search.plain(still) and not self.goes_on:
            return still.spot, False
        grown = [still, *(search.grow(guess) for guess in search.common_motion())]
        if start_px is not None:
            grown += [warm, search.grow(start_px)]
        best = min(grown, key=lambda p: p.cost)
        trusted = start_px is not None and not outdone
        if trusted and search.lost(warm) - allowed < search.lost(best):
            return warm.spot, False
        tried = [best]
        rivals: list[_Pairing] = []
        for _ in range(ROUNDS):
            rivals = search.rivals(tried[-1])
            if not rivals:
                break
            better = search.grow(min(rivals, key=lambda p: p.left_over).motion)
            if better.left_over >= tried[-1].left_over:
                break
            tried.append(better)
        best = min(tried, key=lambda p: p.cost)
        if best is not tried[-1] or len(tried) > ROUNDS:  # else they are those found last
            rivals = search.rivals(best)
        others = [*rivals, *(p for p in (*tried, *grown) if not np.array_equal(p.spot, best.spot))]
        least = min((rival.left_over for rival in others), default=best.left_over)
        close = any(rival.cost < best.cost + RIVAL for rival in others)
        found = SHARED * np.count_nonzero(best.spot >= 0)
        left = [
            p.left_over
            for p in others
            if np.count_nonzero(p.spot >= 0) > found or p.unpaired < best.unpaired
        ]
        fewer = 2.0 * (np.sqrt(best.left_over) - np.sqrt(min(left, default=best.left_over)))
        moved = best.length > STILL and least < best.left_over
        equal = self.goes_on and 2.0 * (np.sqrt(least) - np.sqrt(best.left_over)) < MORE
        known = np.count_nonzero(search.known)
        torn = best.unpaired > TORN * known
        gone = fewer > MORE and search.lost(best) < COVERED * known
        # A shorter motion that has a marker for every spot: have rows of the border been hidden?
        # Not where as many would have come in that were not in sight at rest.
        hidden = any(
            2 * (p.strange - best.strange) < max(search.lost(p), 1.0)
            and p.step < best.step
            and search.lost(p) < COVERED * known
            for p in others
        )
        return best.spot, bool(close or moved or equal or torn or gone or hidden)

    @staticmethod
    def match_layout(
        nominal: list[Pixels], spots: list[Pixels], spacing_px: float, size_px: tuple[int, int]
    ) -> list[Ints]:
        """Return which spot of the rest picture every marker of a drawing is, -1 where none is.

        The drawing is mapped onto the picture by one affine map; then its local misfit is taken
        off.

        Parameters
        ----------
        nominal, spots
            (n, 2) drawn places and (b, 2) spots, px, group by group.
        spacing_px
            Distance of neighbouring markers, px; the drawing may be off by most of it, and by
            `ROWS_OFF` where the picture shows its border.
        size_px
            Height and width of the picture.
        """
        found = []
        expected_px, _ = _onto_picture(nominal, spots, spacing_px, size_px)
        for expected, seen in zip(expected_px, spots, strict=True):
            size = spacing(expected)
            pair = _mutual_nearest(expected, seen, 0.4 * size)
            if (pair >= 0).sum() >= 4:
                alike = np.linalg.norm(expected[:, None] - seen[None], axis=2) < 0.6 * size
                start = np.where((pair >= 0)[:, None], seen[pair] - expected, np.nan)
                around = Neighbourhood.of(expected, size)
                pair, _ = around.follow(seen, alike, start)
                # in perspective, corners lie farther off the affine map than neighbours lead to
                pair = around.complete(seen, pair, ~np.isin(np.arange(len(seen)), pair))
            found.append(pair)
        return found

    @staticmethod
    def odd_spots(
        nominal: list[Pixels], spots: list[Pixels], spacing_px: float, size_px: tuple[int, int]
    ) -> int:
        """Return how many markers of a drawing have no spot, or are spots without a marker, once it
        is mapped onto the picture as by `match_layout`."""
        return _onto_picture(nominal, spots, spacing_px, size_px)[1]


@dataclass(frozen=True, kw_only=True)
class _Pairing:
    """Which spot every marker is taken for: (n,) spots, -1 for none, (n, 2) motion; its mean length
    in spacings, and that since the last picture, or since rest; how much it leaves over, how many
    of that are markers that have moved unlike their neighbours, and how many spots; how many
    markers have no spot though as many spots have no marker; what speaks against it."""

    spot: Ints
    motion: Pixels
    length: float
    step: float
    left_over: int
    astray: int
    strange: int
    unpaired: int
    cost: float


class _Search:
    """Pairings of the markers of a neighbourhood with the spots of a picture."""

    def __init__(
        self,
        around: Neighbourhood,
        spots: Pixels,
        alike: Bools,
        size_px: tuple[int, int] | None,
        start_px: Pixels | None,
        spare_px: Pixels | None,
        found_px: float,
    ) -> None:
        spare = np.zeros((0, 2)) if spare_px is None else spare_px
        self.spare = cKDTree(spare) if len(spare) else None
        self.around, self.spots, self.alike, self.start_px = around, spots, alike, start_px
        self.known: Bools = np.asarray(np.isfinite(around.rest_px).all(axis=1))
        self.usable, self.found_px = alike.any(axis=0), found_px
        self.tree = cKDTree(spots)
        height, width = (np.inf, np.inf) if size_px is None else size_px
        self.border = np.array([width, height]) - 1.0

    def _motion(self, spot: Ints) -> Pixels:
        """Return (n, 2) motion of the markers to their spots, px; NaN where there is none."""
        return np.where((spot >= 0)[:, None], self.spots[spot] - self.around.rest_px, np.nan)

    def paired(self, spot: Ints) -> _Pairing:
        """Return a pairing with what it leaves over: markers that should be there, spots, motion
        unlike neighbours'."""
        size = self.around.spacing_px
        motion = self._motion(spot)
        expected, certain = self.around.predict(motion)
        if not certain.all() and (spot >= 0).any():
            expected[~certain] = np.median(motion[spot >= 0], axis=0)
        place = self.around.rest_px + expected
        with np.errstate(invalid="ignore"):
            margin = GATE * size if np.isfinite(self.border).all() else -np.inf
            inside = ((place > margin) & (place < self.border - margin)).all(axis=1)
        lost = np.flatnonzero(self.known & (spot < 0) & inside)
        strange = self._strange(spot, motion)
        # Spots unlike the markers that should be there are these, changed, as by a part hidden.
        pair = _mutual_nearest(place[lost], self.spots[strange], GATE * size)
        there = pair >= 0
        changed = int((~self.alike[lost[there], strange[pair[there]]]).sum())
        found = certain & (spot >= 0)
        astray = int(
            (np.linalg.norm(motion[found] - expected[found], axis=1) > 0.5 * GATE * size).sum()
        )
        lengths = self._mean_lengths(motion)
        mean = float(np.mean(lengths))
        left_over = len(lost) + len(strange) + astray - 2 * changed
        return _Pairing(
            spot=spot,
            motion=motion,
            length=mean,
            step=lengths[-1],
            left_over=left_over,
            astray=astray,
            strange=len(strange) - changed,
            unpaired=min(len(lost), len(strange)) - changed,
            cost=2.0 * np.sqrt(left_over) + PRIOR * mean,
        )

    def _mean_lengths(self, motion: Pixels) -> list[float]:
        """Return how far markers have moved on average, in spacings: since rest, and in a sequence
        since the last picture."""
        starts = [np.zeros(2)] if self.start_px is None else [np.zeros(2), self.start_px]
        lengths = [np.linalg.norm(motion - start, axis=1) for start in starts]
        known = [length[np.isfinite(length)] for length in lengths]
        size = self.around.spacing_px
        return [float(one.mean()) / size if len(one) else 0.0 for one in known]

    def _strange(self, spot: Ints, motion: Pixels) -> Ints:
        """Return which spots are no marker's, though at rest they would have been found in the
        picture, and none was there."""
        taken = spot >= 0
        free = self._free(spot)
        if not taken.any() or not len(free):
            return free
        _, near = cKDTree(self.spots[spot[taken]]).query(self.spots[free])
        place = self.spots[free] - motion[taken][near]
        reach = self.found_px
        strange = ((place > -reach) & (place < self.border + reach)).all(axis=1)
        if self.spare is not None:
            strange &= self.spare.query(place)[0] > GATE * self.around.spacing_px
        return np.asarray(free[strange])

    def _free(self, spot: Ints) -> Ints:
        """Return the spots that could be markers and are none's."""
        free = np.array(self.usable, np.bool_)
        free[spot[spot >= 0]] = False
        return np.flatnonzero(free)

    def lost(self, pairing: _Pairing) -> float:
        """Return how many markers have no spot."""
        return float((self.known & (pairing.spot < 0)).sum())

    def plain(self, pairing: _Pairing) -> bool:
        """Return whether no marker and no spot is left over, and none but a few `ASTRAY` markers
        have moved by `STILL` spacings: then every other pairing moves the markers at least three
        times as far, which `PRIOR` counts by more than `RIVAL`."""
        found = pairing.spot >= 0
        if pairing.left_over > pairing.astray or not found.any():
            return False
        far = np.linalg.norm(pairing.motion[found], axis=1) > STILL * self.around.spacing_px
        return bool(max(far.mean(), pairing.astray / found.sum()) <= ASTRAY)

    def common_motion(self) -> list[Pixels]:
        """Return the motion that most pairs agree on; nothing where that is no motion."""
        size, rest = self.around.spacing_px, self.around.rest_px
        steps = _steps(rest[self.known], self.spots, 0.95 * size)
        if not len(steps):
            return []
        support = cKDTree(steps).query_ball_point(steps, 0.12 * size, return_length=True)
        peak = steps[np.argmax(support * (1.0 - 0.05 * np.linalg.norm(steps, axis=1) / size))]
        return [np.zeros_like(rest) + peak] if np.linalg.norm(peak) > 0.1 * size else []

    def rivals(self, pairing: _Pairing) -> list[_Pairing]:
        """Return the pairings where every marker takes the spot of its partner a lattice step
        away."""
        around, spot = self.around, pairing.spot
        expected, _ = around.predict(pairing.motion)
        beyond = self._free(spot)
        found = []
        for partner in around.far_partner if around.goes_on else around.partner:
            has = (partner >= 0) & self.known & self.known[partner]
            if not has.any():
                continue
            taken = np.where(has, spot[partner], -1)
            step = np.median((around.rest_px[partner] - around.rest_px)[has], axis=0)
            lone = np.flatnonzero(self.known & ~has)
            if len(beyond) and len(lone):
                target = np.full_like(around.rest_px, -1e9)
                target[lone] = around.rest_px[lone] + expected[lone] + step
                free = np.zeros_like(self.alike)
                free[:, beyond] = self.alike[:, beyond]
                taken[lone] = self._nearest(target, free)[lone]
            allowed = self.alike[np.arange(len(taken)), taken] & (taken >= 0)
            found.append(self.paired(np.where(allowed, taken, -1)))
        return found

    def grow(self, guess: Pixels, whole: bool = False) -> _Pairing:
        """Spread from pairs near ``guess`` over the neighbours: from the largest patch of them, as
        spots a step of the lattice away are near as well, or the ``whole``."""
        around, rest = self.around, self.around.rest_px
        start = np.where(np.isfinite(rest + guess), rest + guess, -1e9)
        spot = self._nearest(start, self.alike)
        if not whole:
            spot = np.where(self._largest_patch(spot), spot, -1)
        motion = self._motion(spot)
        alone = np.count_nonzero(around.fit_weight, axis=1) < LEAST_NEIGHBOURS
        first = np.ones(len(rest), np.bool_) if whole else spot >= 0
        for turn in range(ROUNDS):
            expected, certain = around.predict(motion)
            seed = certain | alone | first if turn == 0 else certain | alone
            unsure = rest + np.where(np.isfinite(motion), motion, guess)
            target = np.where(certain[:, None], rest + expected, unsure)
            target = np.where(np.isfinite(target) & seed[:, None], target, -1e9)
            before, spot = spot, self._nearest(target, self.alike)
            motion = self._motion(spot)
            if np.array_equal(before, spot) and turn > 0:
                break
        return self.paired(spot)

    def _nearest(self, target: Pixels, alike: Bools) -> Ints:
        """Mutual nearest pairs among ``alike`` ones; on a tie between markers the closer one
        wins."""
        count, rows = min(CANDIDATES, len(self.spots)), np.arange(len(target))
        gate = max(GATE * self.around.spacing_px, 1e-9)
        distance, index = self.tree.query(target, k=count, distance_upper_bound=gate)
        distance, index = distance.reshape(len(target), -1), index.reshape(len(target), -1)
        fits = alike[rows[:, None], np.minimum(index, len(self.spots) - 1)]
        distance = np.where(fits, distance, np.inf)
        first = np.argmin(distance, axis=1)
        chosen, length = index[rows, first], distance[rows, first]
        found = np.isfinite(length)
        nearest = np.full(len(self.spots), np.inf)
        np.minimum.at(nearest, chosen[found], length[found])
        wins = found.copy()
        wins[found] = length[found] <= nearest[chosen[found]]
        return np.asarray(np.where(wins, chosen, -1))

    def _largest_patch(self, spot: Ints) -> Bools:
        """Return which markers with a spot hang together by neighbours that have moved alike."""
        around = self.around
        motion = self._motion(spot)
        with np.errstate(invalid="ignore"):
            apart = np.linalg.norm(motion[around.near] - motion[:, None], axis=2)
            joined = (apart < GATE * around.spacing_px) & (around.fit_weight > 0.0)
        row, column = np.nonzero(joined)
        count = len(spot)
        links = coo_array(
            (np.ones(len(row)), (row, around.near[row, column])), shape=(count, count)
        )
        _, patch = connected_components(links, directed=False)
        largest = np.argmax(np.bincount(patch[spot >= 0], minlength=1)) if (spot >= 0).any() else -1
        return np.asarray((patch == largest) & (spot >= 0))


@njit(cache=True)
def _local_affine(rest, near, fit_weight, size, motion, predicted, certain):
    """Fit motion = mean + slope (place - middle) to every marker's neighbours, with a weak pull to
    no slope."""
    for n in range(len(rest)):
        total, count = 0.0, 0
        mx, my, ux, uy = 0.0, 0.0, 0.0, 0.0
        for k in range(near.shape[1]):
            w, m = fit_weight[n, k], near[n, k]
            if w > 0.0 and math.isfinite(motion[m, 0] + motion[m, 1]):
                count += 1
                total += w
                mx += w * (rest[m, 0] - rest[n, 0])
                my += w * (rest[m, 1] - rest[n, 1])
                ux += w * motion[m, 0]
                uy += w * motion[m, 1]
        certain[n] = count >= LEAST_NEIGHBOURS and math.isfinite(rest[n, 0] + rest[n, 1])
        if total == 0.0:
            predicted[n, 0], predicted[n, 1] = 0.0, 0.0
            continue
        mx, my, ux, uy = mx / total, my / total, ux / total, uy / total
        pull = 0.15 * size * size
        sxx, sxy, syy, ax, ay, bx, by = pull, 0.0, pull, 0.0, 0.0, 0.0, 0.0
        for k in range(near.shape[1]):
            w, m = fit_weight[n, k], near[n, k]
            if w > 0.0 and math.isfinite(motion[m, 0] + motion[m, 1]):
                dx, dy = rest[m, 0] - rest[n, 0] - mx, rest[m, 1] - rest[n, 1] - my
                du, dv = motion[m, 0] - ux, motion[m, 1] - uy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
                ax += w * dx * du
                ay += w * dy * du
                bx += w * dx * dv
                by += w * dy * dv
        determinant = sxx * syy - sxy * sxy
        predicted[n, 0] = (
            ux - ((syy * ax - sxy * ay) * mx + (sxx * ay - sxy * ax) * my) / determinant
        )
        predicted[n, 1] = (
            uy - ((syy * bx - sxy * by) * mx + (sxx * by - sxy * bx) * my) / determinant
        )


@njit(cache=True)
def _scatter(rest, near, fit_weight, size, motion, sd):
    """Return the bounded mean square of the motions (n, 2) less `_local_affine`, over ``sd`` (n,);
    -1 where fewer than `LEAST_SCORES` markers have one."""
    predicted, certain = np.empty(motion.shape), np.empty(len(motion), np.bool_)
    _local_affine(rest, near, fit_weight, size, motion, predicted, certain)
    score, count = np.empty(2 * len(motion)), 0
    for n in range(len(motion)):
        if certain[n] and sd[n] > 0.0 and math.isfinite((motion[n, 0] - predicted[n, 0]) / sd[n]):
            for axis in range(2):
                score[count] = abs((motion[n, axis] - predicted[n, axis]) / sd[n])
                count += 1
    if count < 2 * LEAST_SCORES:
        return -1.0
    # the upper median is put in its place, smaller ones before it
    middle, low, high = count // 2, 0, count - 1
    while low < high:
        pivot, i, j = score[middle], low, high
        while i <= j:
            while score[i] < pivot:
                i += 1
            while pivot < score[j]:
                j -= 1
            if i <= j:
                score[i], score[j] = score[j], score[i]
                i, j = i + 1, j - 1
        low = i if j < middle else low
        high = j if middle < i else high
    below = 0.0
    for k in range(middle):
        below = max(below, score[k])
    limit, squares = OUTLYING * 0.5 * (below + score[middle]), 0.0
    for k in range(count):
        squares += min(score[k], limit) ** 2
    return squares / count
