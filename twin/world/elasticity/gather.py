"""Many patches on a flat face as few point forces, for points that lie deep under them.

A contact has hundreds of patches, but a marker some millimetres below sees only the smooth part of them. The field of
a point force is a smooth function of the force's place, so it is interpolated at Chebyshev nodes of the load's box,
and a patch's force is shared among the nodes by the same polynomials (the far field of a kernel-independent fast
multipole method: W. Fong and E. Darve, J. Comput. Phys. 228 (2009) 8712). Sums and first moments of the forces are
kept exactly.

Validity: patches in one plane and points below it. Seen from a depth z the field ends at complex places z off the
box, so m nodes over a half length a are off by about rho^-m, rho = z/a + sqrt(1 + (z/a)^2) (Bernstein's ellipse).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.arrays import Floats, Points, frozen
from twin.compiled import njit
from twin.parts.load import Rectangles

GOAL = 1e-3
"""What the bound on the error over the largest displacement is held to; true errors are below a hundredth of it."""

_SMALL = 8.0
"""A patch whose half side is so many times smaller than the depth takes two Gauss points along it."""


def gathered(points: Points, load: Rectangles, goal: float = GOAL) -> Rectangles:
    """Return a load of fewer point forces with the same field at ``points`` (n, 3), or the load itself.

    Parameters
    ----------
    points
        (n, 3) where the field is wanted, mm.
    load
        Rectangles; those on a curved surface, or too near to the points for gathering to pay, come back as they are.
    goal
        Allowed error over the largest displacement.
    """
    if len(load) < 16 or len(points) == 0 or not np.all(load.frames[:, 2, 2] > 1.0 - 1e-12):
        return load
    if np.ptp(load.centre_mm[:, 2]) > 1e-9:
        return load
    reach = np.einsum("ks,ksi->ki", load.half_mm, np.abs(load.frames[:, :2, :2]))
    low, high = (load.centre_mm[:, :2] - reach).min(axis=0), (load.centre_mm[:, :2] + reach).max(axis=0)
    deep = float(points[:, 2].min() - load.centre_mm[0, 2])
    counts = [_nodes(deep, (b - a) / 2.0, goal) for a, b in zip(low, high, strict=True)]
    if 2 * math.prod(counts) > 5 * len(load):
        return load
    # Enough Gauss points to share out a long patch exactly: the nodes' polynomials are of degree sum(counts) - 2.
    orders = [2 if deep >= _SMALL * side else max(2, math.ceil(sum(counts) / 2)) for side in load.half_mm.max(axis=0)]
    places, weights = zip(*(_gauss(order) for order in orders), strict=True)
    centre, half, forces = load.centre_mm[:, :2], load.half_mm, load.force_n
    if load.frames[:, 0, 1].any():  # turned patches are shared out as the Gauss points that they are made of
        square = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 2)
        weight = np.multiply.outer(*weights).ravel() / 4.0
        along = square @ (load.half_mm[:, :, None] * load.frames[:, :2, :2])
        centre = (centre[:, None] + along).reshape(-1, 2)
        forces = (forces[:, None] * weight[:, None]).reshape(-1, 3)
        half = np.zeros_like(centre)
        (places, weights) = zip(_gauss(1), _gauss(1), strict=True)
    middle, reach = (low + high) / 2.0, (high - low) / 2.0
    means = [
        _means((centre[:, i] - middle[i]) / reach[i], half[:, i] / reach[i], places[i], weights[i], counts[i])
        for i in (0, 1)
    ]
    shared = np.empty((counts[0], counts[1], 3))
    _shared(means[0] @ _lagrange(counts[0]), means[1] @ _lagrange(counts[1]), np.array(forces, order="C"), shared)
    total = math.prod(counts)
    nodes = np.empty((*counts, 3))
    nodes[:, :, 0] = (middle[0] + reach[0] * chebpts1(counts[0]))[:, None]
    nodes[:, :, 1] = middle[1] + reach[1] * chebpts1(counts[1])
    nodes[:, :, 2] = load.centre_mm[0, 2]
    frames = np.empty((total, 3, 3))
    frames[:] = load.frames[0]
    return Rectangles(
        centre_mm=nodes.reshape(-1, 3), frames=frames, half_mm=np.zeros((total, 2)), force_n=shared.reshape(-1, 3)
    )


def _nodes(deep: float, half: float, goal: float) -> int:
    ratio = deep / max(half, 1e-9)
    return 2 + math.ceil(-math.log(goal) / math.log(ratio + math.hypot(1.0, ratio))) if deep > 0 else 10**6


def _means(middle: Floats, half: Floats, places: Floats, weights: Floats, count: int) -> Floats:
    """Return (k, count) means of the Chebyshev polynomials over k intervals."""
    out = np.zeros((len(middle), count))
    _add_means(middle, half, places, weights, out)
    return out


@njit(cache=True)
def _add_means(middle: Floats, half: Floats, places: Floats, weights: Floats, out: Floats) -> None:
    for k in range(len(middle)):
        for g in range(len(places)):
            at, weight = middle[k] + half[k] * places[g], weights[g] / 2.0
            before, here = at, 1.0
            for n in range(out.shape[1]):
                out[k, n] += weight * here
                before, here = here, 2.0 * at * here - before


@njit(cache=True)
def _shared(first: Floats, second: Floats, forces: Floats, out: Floats) -> None:
    """Set ``out`` (a, b, 3) to the forces (k, 3) shared out by what nodes carry of each, (k, a) and (k, b)."""
    out[:] = 0.0
    for k in range(len(forces)):
        for a in range(out.shape[0]):
            for b in range(out.shape[1]):
                share = first[k, a] * second[k, b]
                for i in range(3):
                    out[a, b, i] += share * forces[k, i]


@lru_cache(maxsize=64)
def _lagrange(count: int) -> Floats:
    """Return (count, count) Chebyshev coefficients of the polynomials that are 1 at one node and 0 at the others."""
    at_nodes = chebvander(chebpts1(count), count - 1).T * (2.0 / count)
    at_nodes[0] /= 2.0
    return frozen(np.asarray(at_nodes, float))


@lru_cache(maxsize=64)
def _gauss(order: int) -> tuple[Floats, Floats]:
    places, weights = np.polynomial.legendre.leggauss(order)
    return frozen(places), frozen(weights)
