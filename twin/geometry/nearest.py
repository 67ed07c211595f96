"""The nearest place on a set of triangles, and the first triangle met from -z: a tree of boxes, searched in numba.

Why a tree of our own: the level sets of a triangulated body are asked for hundreds of thousands of points a press, and
which corner, edge or face is nearest must come with the distance, because it decides on which side the point lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Ints, Points, frozen
from twin.compiled import njit

LEAF = 4
"""Triangles in a leaf at most."""

FACE = 0
"""Feature of a triangle that is nearest: 0 its face, 1 to 3 its corners, 4 to 6 its edges 01, 12, 20."""

_STACK = 128


@dataclass(frozen=True)
class BoxTree:
    """Boxes around triangles.

    Attributes
    ----------
    corners
        (m, 3, 3) of the triangles, in the tree's order.
    original
        (m,) number of each triangle in the order given.
    low, high
        (b, 3) corners of the boxes.
    first, second
        (b,) children of a box; of a leaf, the first triangle and minus their number.
    """

    corners: Floats
    original: Ints
    low: Points
    high: Points
    first: Ints
    second: Ints


def box_tree(corners: Floats) -> BoxTree:
    """Return the tree of triangles (m, 3, 3), halved along the longest side of their middles' box."""
    middle = corners.mean(axis=1)
    order = np.arange(len(corners))
    low: list[Floats] = []
    high: list[Floats] = []
    first: list[int] = []
    second: list[int] = []
    waiting = [(0, len(corners), -1, False)]
    while waiting:
        start, end, parent, is_second = waiting.pop()
        part = order[start:end]
        here = len(low)
        if parent >= 0:
            (second if is_second else first)[parent] = here
        low.append(corners[part].min(axis=(0, 1)))
        high.append(corners[part].max(axis=(0, 1)))
        first.append(start)
        second.append(start - end)
        if end - start > LEAF:
            axis = int(np.argmax(np.ptp(middle[part], axis=0)))
            half = (start + end) // 2
            order[start:end] = part[np.argpartition(middle[part, axis], half - start)]
            waiting += [(half, end, here, True), (start, half, here, False)]
    return BoxTree(
        frozen(np.ascontiguousarray(corners[order])), frozen(order), frozen(np.array(low)), frozen(np.array(high)),
        frozen(np.array(first)), frozen(np.array(second)),
    )  # fmt: skip


def nearest(tree: BoxTree, points: Points) -> tuple[Ints, Points, Ints]:
    """Return for each of (n, 3) points the nearest triangle (n,), the nearest place (n, 3) and its feature (n,)."""
    triangle, feature = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    foot = np.zeros((len(points), 3))
    points = np.ascontiguousarray(points, np.float64)
    _search(points, tree.corners, tree.low, tree.high, tree.first, tree.second, triangle, foot, feature)
    return tree.original[triangle], foot, feature


def first_from_below(tree: BoxTree, xy: Floats, preferred: np.ndarray) -> tuple[Ints, Floats]:
    """Return the triangle (n,) met first by rays along +z through (n, 2) places, -1 for none, and its z (n,).

    Where several are met at one height (at an edge), a ``preferred`` (m,) triangle counts.
    """
    triangle, z = np.full(len(xy), -1), np.full(len(xy), np.nan)
    xy, wanted = np.ascontiguousarray(xy, np.float64), np.ascontiguousarray(preferred[tree.original])
    _climb(xy, tree.corners, tree.low, tree.high, tree.first, tree.second, wanted, triangle, z)
    return np.where(triangle >= 0, tree.original[triangle], -1), z


def first_along(tree: BoxTree, points: Points, along: Floats) -> tuple[Ints, Floats]:
    """Return the triangle (n,) met first by the whole lines through (n, 3) ``points`` along (n, 3) ``along``.

    -1 for none; and how many times ``along`` it lies from the point (n,), which may be negative.
    """
    triangle, times = np.full(len(points), -1), np.full(len(points), np.inf)
    _pierce(
        np.ascontiguousarray(points, np.float64), np.ascontiguousarray(along, np.float64), tree.corners, tree.low,
        tree.high, tree.first, tree.second, triangle, times,
    )  # fmt: skip
    return np.where(triangle >= 0, tree.original[triangle], -1), times


@njit(cache=True)
def _enters(point: Floats, along: Floats, low: Floats, high: Floats) -> float:
    """Return where a line enters a box, inf where it misses it."""
    start, end = -np.inf, np.inf
    for i in range(3):
        slack = 1e-9 * (1.0 + abs(point[i]))
        if abs(along[i]) < 1e-15:
            if point[i] < low[i] - slack or point[i] > high[i] + slack:
                return np.inf
            continue
        one, other = (low[i] - slack - point[i]) / along[i], (high[i] + slack - point[i]) / along[i]
        start, end = max(start, min(one, other)), min(end, max(one, other))
    return start if start <= end else np.inf


@njit(cache=True)
def _cross(a: Floats, b: Floats) -> Floats:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def _pierce(
    points: Points, along: Floats, corners: Floats, low: Floats, high: Floats, first: Ints, second: Ints,
    triangle: Ints, times: Floats,
) -> None:  # fmt: skip
    """Moeller and Trumbore's intersection, over the boxes that a line meets."""
    stack = np.empty(_STACK, np.int64)
    for q in range(len(points)):
        depth, stack[0] = 1, 0
        while depth > 0:
            depth -= 1
            box = stack[depth]
            if not _enters(points[q], along[q], low[box], high[box]) < times[q]:
                continue
            if second[box] >= 0:
                stack[depth], stack[depth + 1] = first[box], second[box]
                depth += 2
                continue
            for t in range(first[box], first[box] - second[box]):
                one, other = corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
                normal = _cross(one, other)
                size = np.sum(normal * along[q])
                if abs(size) <= 1e-12 * np.sqrt(np.sum(normal**2) * np.sum(along[q] ** 2)):
                    continue
                away = corners[t, 0] - points[q]
                time = np.sum(normal * away) / size
                foot = points[q] + time * along[q] - corners[t, 0]
                squared = np.sum(normal**2)
                u = np.sum(normal * _cross(foot, other)) / squared
                v = np.sum(normal * _cross(one, foot)) / squared
                if u >= -1e-9 and v >= -1e-9 and u + v <= 1.0 + 1e-9 and time < times[q]:
                    times[q], triangle[q] = time, t


@njit(cache=True)
def _to_box(point: Floats, low: Floats, high: Floats) -> float:
    squared = 0.0
    for i in range(3):
        away = max(low[i] - point[i], 0.0, point[i] - high[i])
        squared += away * away
    return squared


@njit(cache=True)
def _search(
    points: Floats, corners: Floats, low: Floats, high: Floats, first: Ints, second: Ints, triangle: Ints, foot: Floats,
    feature: Ints,
) -> None:  # fmt: skip
    stack, place = np.empty(_STACK, np.int64), np.empty(3)
    for q in range(len(points)):
        best, depth = np.inf, 1
        stack[0] = 0
        while depth > 0:
            depth -= 1
            box = stack[depth]
            if _to_box(points[q], low[box], high[box]) >= best:
                continue
            if second[box] < 0:
                for t in range(first[box], first[box] - second[box]):
                    kind = _onto_triangle(points[q], corners[t], place)
                    away = np.sum((points[q] - place) ** 2)
                    if away < best:
                        best, triangle[q], feature[q] = away, t, kind
                        foot[q] = place
                continue
            one, other = first[box], second[box]
            if _to_box(points[q], low[one], high[one]) < _to_box(points[q], low[other], high[other]):
                one, other = other, one
            stack[depth], stack[depth + 1] = one, other
            depth += 2


@njit(cache=True)
def _onto_triangle(point: Floats, corners: Floats, place: Floats) -> int:
    """Set ``place`` to the nearest place of a triangle and return its feature (by regions of barycentric sign)."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac, ap = b - a, c - a, point - a
    d1, d2 = np.sum(ab * ap), np.sum(ac * ap)
    if d1 <= 0.0 and d2 <= 0.0:
        place[:] = a
        return 1
    bp = point - b
    d3, d4 = np.sum(ab * bp), np.sum(ac * bp)
    if d3 >= 0.0 and d4 <= d3:
        place[:] = b
        return 2
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        place[:] = a + d1 / (d1 - d3) * ab
        return 4
    cp = point - c
    d5, d6 = np.sum(ab * cp), np.sum(ac * cp)
    if d6 >= 0.0 and d5 <= d6:
        place[:] = c
        return 3
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        place[:] = a + d2 / (d2 - d6) * ac
        return 6
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        place[:] = b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
        return 5
    place[:] = a + vb / (va + vb + vc) * ab + vc / (va + vb + vc) * ac
    return 0


@njit(cache=True)
def _climb(
    xy: Floats, corners: Floats, low: Floats, high: Floats, first: Ints, second: Ints, wanted: np.ndarray,
    triangle: Ints, z: Floats,
) -> None:  # fmt: skip
    stack = np.empty(_STACK, np.int64)
    slack = 1e-9
    for q in range(len(xy)):
        x, y, depth, best = xy[q, 0], xy[q, 1], 1, np.inf
        stack[0] = 0
        while depth > 0:
            depth -= 1
            box = stack[depth]
            if low[box, 2] > best + slack or not (
                low[box, 0] - slack <= x <= high[box, 0] + slack and low[box, 1] - slack <= y <= high[box, 1] + slack
            ):
                continue
            if second[box] >= 0:
                stack[depth], stack[depth + 1] = first[box], second[box]
                depth += 2
                continue
            for t in range(first[box], first[box] - second[box]):
                a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
                area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
                size = abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(c[0] - a[0]) + abs(c[1] - a[1])
                if abs(area) <= 1e-12 * size * size:
                    continue
                u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if u < -slack or v < -slack or u + v > 1.0 + slack:
                    continue
                height = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                if height < best - slack or (height < best + slack and wanted[t]):
                    best, triangle[q], z[q] = height, t, height
