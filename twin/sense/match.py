"""Say which spot is which marker: in the rest picture by the layout, in every other picture by the rest state.

A marker's motion can exceed half the pitch, where its nearest spot is another marker. So predictions come first: in the
rest picture from one affine map found by voting, later from the motion of the neighbours already matched (a local
affine fit). A pair counts when each is the other's nearest, near the prediction, and alike in size and brightness.
What has no such partner is missing and stays so.

Validity: motion that is smooth over a few pitches (strain between neighbours below about 0.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Pixels
from twin.compiled import njit
from twin.sense.fit import LEADS

NEIGHBOURS = 10
LEAST_NEIGHBOURS = 3
CANDIDATES = 8
GATE = 0.35
"""Largest distance between prediction and spot, in spacings."""

ROUNDS = 40
TRUST = 0.25
"""Share of the markers that may be lost before the previous picture's motion is given up as a start: a grid moved by a
whole pitch looks like one that hasn't moved, so a cold start must not overrule a good one."""


def spacing(points_px: Pixels) -> float:
    """Return the typical distance from a marker to its nearest neighbour, px; 30 for a lone marker."""
    points = np.asarray(points_px, float)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return 30.0
    distance, _ = cKDTree(points).query(points, k=2)
    return float(max(np.median(distance[:, 1]), 1.0))


def nominal_to_rest(nominal: list[Pixels], spots: list[Pixels], spacing_px: float) -> list[Pixels]:
    """Return where the markers of a drawing are expected in the rest picture: the drawing under one affine map.

    Parameters
    ----------
    nominal, spots
        (n, 2) drawn places and (b, 2) spots, px, group by group.
    spacing_px
        Distance of neighbouring markers, px; the drawing may be off by most of it.
    """
    steps = [_steps(n, s, 0.9 * spacing_px) for n, s in zip(nominal, spots, strict=True)]
    votes = np.concatenate(steps) if steps else np.zeros((0, 2))
    if not len(votes):
        return [np.array(n, float) for n in nominal]
    width = max(0.12 * spacing_px, 1.0)
    sample = votes[:: max(1, len(votes) // 2000)]
    tree = cKDTree(votes)
    support = tree.query_ball_point(sample, width, return_length=True) * (
        1.0 - 0.1 * np.linalg.norm(sample, axis=1) / spacing_px
    )
    peak = sample[np.argmax(support)]
    shift = votes[np.linalg.norm(votes - peak, axis=1) < width].mean(axis=0)
    affine = np.vstack([np.eye(2), shift])
    drawn = np.concatenate(nominal)
    for gate in (0.4, 0.35, 0.3, 0.25, 0.2, 0.2):
        pairs = [
            mutual_nearest(_apply(affine, n), s, gate * spacing_px, np.ones((len(n), len(s)), bool))
            for n, s in zip(nominal, spots, strict=True)
        ]
        seen = np.concatenate(pairs) >= 0
        if seen.sum() < 4:
            break
        seen_at = np.concatenate([s[p[p >= 0]] for s, p in zip(spots, pairs, strict=True)])
        affine = _fit_affine(drawn[seen], seen_at)
    return [_apply(affine, n) for n in nominal]


def _steps(start: Pixels, spots: Pixels, reach: float) -> Pixels:
    if not len(start) or not len(spots):
        return np.zeros((0, 2))
    distance, index = cKDTree(spots).query(start, k=min(CANDIDATES, len(spots)), distance_upper_bound=reach)
    of, which = np.nonzero(np.isfinite(distance.reshape(len(start), -1)))
    return np.asarray(spots[index.reshape(len(start), -1)[of, which]] - start[of])


def _apply(affine: Floats, points: Pixels) -> Pixels:
    return np.asarray(points @ affine[:2] + affine[2])


def _fit_affine(start: Pixels, end: Pixels) -> Floats:
    """Least squares with a stiff prior towards a pure shift, so that few or collinear points are no trouble."""
    middle = start.mean(axis=0)
    away = start - middle
    motion = end - start
    mean = motion.mean(axis=0)
    stiffness = 1e-3 * max(float((away**2).sum()), 1.0) * np.eye(2)
    slope = np.linalg.solve(away.T @ away + stiffness, away.T @ (motion - mean))
    return np.vstack([np.eye(2) + slope, mean - middle @ slope])


def mutual_nearest(expected: Pixels, spots: Pixels, gate: float, allowed: Bools) -> Ints:
    """Return (n,) the spot of every marker, -1 for none: each the other's nearest, closer than ``gate``."""
    if not len(expected) or not len(spots):
        return np.full(len(expected), -1, np.int64)
    squared = ((expected[:, None] - spots[None]) ** 2).sum(axis=2)
    squared[~allowed] = np.inf
    spot = np.argmin(squared, axis=1)
    marker = np.argmin(squared, axis=0)
    index = np.arange(len(expected))
    good = (marker[spot] == index) & (squared[index, spot] < gate * gate)
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
        (n, `twin.sense.fit.LEADS`) the nearest neighbours of a lower row, -1 for padding.
    spacing_px
        Distance of neighbouring markers, px.
    """

    rest_px: Pixels
    near: Ints
    fit_weight: Floats
    lead: Ints
    spacing_px: float


def neighbourhood(rest_px: Pixels, spacing_px: float) -> Neighbourhood:
    """Return the nearest neighbours of every marker at rest."""
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
    lead = np.where(np.take_along_axis(earlier, first, axis=1), np.take_along_axis(near, first, axis=1), -1)
    return Neighbourhood(
        rest_px=rest_px, near=near, fit_weight=weight, lead=np.ascontiguousarray(lead), spacing_px=spacing_px
    )


def follow(around: Neighbourhood, spots: Pixels, alike: Bools, start_px: Pixels | None = None) -> Ints:
    """Return (n,) which spot every marker has become, -1 where none has.

    Parameters
    ----------
    spots
        (b, 2) spots of the picture, px.
    alike
        (n, b) whether a spot could be the marker by its size and brightness.
    start_px
        (n, 2) motion in the previous picture, px, NaN where unknown; None starts cold.
    """
    count = len(around.rest_px)
    if not count or not len(spots):
        return np.full(count, -1, np.int64)
    best, best_cost = np.full(count, -1, np.int64), np.inf
    if start_px is not None:
        best, best_cost = _grow(around, spots, alike, start_px, GATE)
        best_cost -= TRUST * float(np.isfinite(around.rest_px).all(axis=1).sum())
        if best_cost < 0:
            return best
    for guess, gate in _cold_starts(around, spots):
        spot, cost = _grow(around, spots, alike, guess, gate)
        if cost < best_cost - 1e-9:
            best, best_cost = spot, cost
    return best


def _cold_starts(around: Neighbourhood, spots: Pixels) -> list[tuple[Pixels, float]]:
    """Return guesses of the motion: none at all (only near pairs count), and the motion most pairs agree on."""
    size = around.spacing_px
    known = np.isfinite(around.rest_px).all(axis=1)
    still = np.zeros_like(around.rest_px)
    starts = [(still, 0.2)]
    steps = _steps(around.rest_px[known], spots, 0.95 * size)
    if len(steps):
        support = cKDTree(steps).query_ball_point(steps, 0.12 * size, return_length=True)
        peak = steps[np.argmax(support * (1.0 - 0.05 * np.linalg.norm(steps, axis=1) / size))]
        if np.linalg.norm(peak) > 0.1 * size:
            starts.append((still + peak, 0.2))
    return starts


def _grow(around: Neighbourhood, spots: Pixels, alike: Bools, guess: Pixels, gate: float) -> tuple[Ints, float]:
    """Spread from pairs near ``guess`` over the neighbours; return the pairs and how bad they are as a whole."""
    rest, size = around.rest_px, around.spacing_px
    reach = cKDTree(spots)
    spot = _nearest_pairs(np.where(np.isfinite(rest + guess), rest + guess, -1e9), reach, alike, gate * size)
    motion = np.where((spot >= 0)[:, None], spots[spot] - rest, np.nan)
    misfit = np.zeros(len(rest))
    alone = np.count_nonzero(around.fit_weight, axis=1) < LEAST_NEIGHBOURS
    for turn in range(ROUNDS):
        expected, certain = predict(around, motion)
        seed = certain | alone | (turn == 0)
        target = np.where(certain[:, None], rest + expected, rest + np.where(np.isfinite(motion), motion, guess))
        target = np.where(np.isfinite(target) & seed[:, None], target, -1e9)
        new = _nearest_pairs(target, reach, alike, GATE * size)
        before, spot = spot, new
        motion = np.where((spot >= 0)[:, None], spots[spot] - rest, np.nan)
        misfit = np.where(certain & (spot >= 0), np.linalg.norm(motion - expected, axis=1), 0.0)
        if np.array_equal(before, spot) and turn > 0:
            break
    known = np.isfinite(rest).all(axis=1)
    lost = float((known & (spot < 0)).sum())
    length = np.linalg.norm(np.nan_to_num(motion), axis=1)
    return spot, lost + float(np.nansum(misfit)) / size + 1e-3 * float(length.sum()) / size


def _nearest_pairs(target: Pixels, spots: cKDTree, alike: Bools, gate: float) -> Ints:
    """Mutual nearest pairs among ``alike`` ones; on a tie between markers the closer one wins."""
    count = min(CANDIDATES, spots.n)
    distance, index = spots.query(target, k=count, distance_upper_bound=max(gate, 1e-9))
    distance, index = distance.reshape(len(target), -1), index.reshape(len(target), -1)
    fits = np.isfinite(distance)
    fits &= alike[np.arange(len(target))[:, None], np.minimum(index, spots.n - 1)]
    distance = np.where(fits, distance, np.inf)
    first = np.argmin(distance, axis=1)
    rows = np.arange(len(target))
    chosen, length = index[rows, first], distance[rows, first]
    found = np.isfinite(length)
    nearest = np.full(spots.n, np.inf)
    np.minimum.at(nearest, chosen[found], length[found])
    wins = found.copy()
    wins[found] = length[found] <= nearest[chosen[found]]
    return np.asarray(np.where(wins, chosen, -1))


def predict(around: Neighbourhood, motion: Pixels) -> tuple[Pixels, Bools]:
    """Return every marker's motion as its matched neighbours have it (local affine), and where enough of them do."""
    predicted, certain = np.empty_like(motion), np.empty(len(motion), np.bool_)
    _local_affine(around.rest_px, around.near, around.fit_weight, around.spacing_px, motion, predicted, certain)
    return predicted, certain


@njit(cache=True)
def _local_affine(rest, near, fit_weight, size, motion, predicted, certain):  # type: ignore[no-untyped-def]
    """Fit motion = mean + slope (place - middle) to every marker's neighbours, with a weak pull to no slope."""
    for n in range(len(rest)):
        total, count = 0.0, 0
        mx, my, ux, uy = 0.0, 0.0, 0.0, 0.0
        for k in range(near.shape[1]):
            w, m = fit_weight[n, k], near[n, k]
            if w > 0.0 and np.isfinite(motion[m, 0] + motion[m, 1]):
                count += 1
                total += w
                mx += w * (rest[m, 0] - rest[n, 0])
                my += w * (rest[m, 1] - rest[n, 1])
                ux += w * motion[m, 0]
                uy += w * motion[m, 1]
        certain[n] = count >= LEAST_NEIGHBOURS and np.isfinite(rest[n, 0] + rest[n, 1])
        if total == 0.0:
            predicted[n, 0], predicted[n, 1] = 0.0, 0.0
            continue
        mx, my, ux, uy = mx / total, my / total, ux / total, uy / total
        pull = 0.15 * size * size
        sxx, sxy, syy, ax, ay, bx, by = pull, 0.0, pull, 0.0, 0.0, 0.0, 0.0
        for k in range(near.shape[1]):
            w, m = fit_weight[n, k], near[n, k]
            if w > 0.0 and np.isfinite(motion[m, 0] + motion[m, 1]):
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
        predicted[n, 0] = ux - ((syy * ax - sxy * ay) * mx + (sxx * ay - sxy * ax) * my) / determinant
        predicted[n, 1] = uy - ((syy * bx - sxy * by) * mx + (sxx * by - sxy * bx) * my) / determinant
