"""A half-space with one layer of another material on it, under a smooth bump: the truth for covers.

Every wave cos(k x) of the load excites waves that decay or grow with depth as exp(-k z) or exp(k z), times 1 or z;
four amplitudes in the layer and two below it follow from the surface's tractions and from what is continuous at the
interface (L. M. Burmister 1945, J. Appl. Phys. 16, in other words). Sideways motion across the wave is two more. The
bump's field is the Hankel integral over k; its transform falls off like k^(-7/2), so the integral converges at the
surface too. Everything is written with 3 - 4 nu, so nu = 1/2 is no exception.

Validity: small strain, isotropic, layer bonded, flat and endless. No body is that; it is the limit near the load of a
thin cover.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import jv

from twin.arrays import Floats, Points
from twin.theory.bonded_layer import BondedLayer

DECAY, ENOUGH = 42.0, 500.0
"""Waves are summed up to k = DECAY / depth, but no further than ENOUGH / radius."""

ORDER = 12
"""Gauss points per half turn of the fastest oscillating factor."""


@dataclass(frozen=True, kw_only=True)
class Layered:
    """A layer, its thickness in mm, on a half-space: Young's modulus in MPa and Poisson's ratio of each."""

    thickness_mm: float
    layer: tuple[float, float]
    below: tuple[float, float]


def bump_displacement(points: Points, half_space: Layered, radius_mm: float, force_n: tuple[float, ...]) -> Points:
    """Return the (n, 3) displacement in mm at points (n, 3), mm, z into the half-space and 0 at its surface.

    The load is a bump max(0, 1 - r^2/a^2)^2 of radius a at the origin, of a total force in N of constant direction.
    """
    points = np.asarray(points, float)
    out = np.zeros((len(points), 3))
    for depth in np.unique(points[:, 2]):
        here = points[:, 2] == depth
        out[here] = _at_depth(points[here, :2], float(depth), half_space, radius_mm, np.asarray(force_n, float))
    return out


def _at_depth(places: Floats, depth: float, half_space: Layered, radius: float, force: Floats) -> Points:
    r, turn = np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0])
    k, weight = _waves(depth, radius, float(r.max(initial=0.0)))
    load = weight * k * 48.0 * jv(3, k * radius) / (k * radius) ** 3 / (2.0 * np.pi)
    down, along, across = amplitudes(k, depth, half_space)
    j0, j1, j2 = (jv(order, r[:, None] * k) for order in (0, 1, 2))
    cosine, sine = np.cos(turn), np.sin(turn)
    # pushed down: (U sin, W cos) per wave becomes (U J1, W J0)
    radial, sunk = j1 @ (load * down[0]), j0 @ (load * down[1])
    out = force[2] * np.column_stack([radial * cosine, radial * sine, sunk])
    # pushed sideways, along the direction phi = 0
    even, odd = j0 @ (load * (along[0] + across) / 2.0), j2 @ (load * (along[0] - across) / 2.0)
    lifted = -(j1 @ (load * along[1]))
    for axis, towards in enumerate(((cosine, sine), (sine, -cosine))):
        c, s = towards
        own = even - odd * (c * c - s * s)
        other = -odd * 2.0 * c * s * (1.0 if axis == 0 else -1.0)
        moved = (own, other) if axis == 0 else (other, own)
        out += force[axis] * np.column_stack([*moved, lifted * c])
    return np.asarray(out)


def _waves(depth: float, radius: float, reach: float) -> tuple[Floats, Floats]:
    """Return wave numbers and Gauss weights (q,) that resolve the load and Bessel functions out to ``reach``."""
    highest = min(DECAY / max(depth, 1e-300), ENOUGH / radius)
    panels = int(np.ceil(highest * (reach + radius + depth) / np.pi)) + 4
    # small waves matter most: panels that grow from the start
    ends = highest * np.linspace(0.0, 1.0, panels + 1) ** 1.3
    node, share = np.polynomial.legendre.leggauss(ORDER)
    half = np.diff(ends) / 2.0
    k = (ends[:-1] + half)[:, None] + half[:, None] * node
    return k.ravel(), (half[:, None] * share).ravel()


def amplitudes(k: Floats, depth: float, half_space: Layered) -> tuple[Floats, Floats, Floats]:
    """Return what waves of wave numbers (q,), 1/mm, and unit traction move at one depth, mm per MPa.

    First and second (2, q): U and W of the motion U sin(k x) along x and W cos(k x) along z, under the pressure
    cos(k x) and under the traction sin(k x) along x. Third (q,): V of the motion V cos(k x) along y under the traction
    cos(k x) along y.
    """
    t = half_space.thickness_mm
    (e1, nu1), (e2, nu2) = half_space.layer, half_space.below
    g1, g2 = e1 / (2.0 * (1.0 + nu1)), e2 / (2.0 * (1.0 + nu2))
    kt, fade = k * t, np.exp(-k * t)
    # columns: decaying A, B and growing a, b in the layer (growing ones are 1 at the interface), A, B below
    matrix = np.zeros((len(k), 6, 6))
    for row, values in enumerate(BondedLayer.wave_tractions(0.0 * k, nu1, g1)):
        matrix[:, row, :2] = values[0]
        matrix[:, row, 2:4] = values[1] * fade[:, None]
    layer = (*BondedLayer.wave_motions(kt, nu1), *BondedLayer.wave_tractions(kt, nu1, g1))
    below = (*BondedLayer.wave_motions(0.0 * k, nu2), *BondedLayer.wave_tractions(0.0 * k, nu2, g2))
    for row, (upper, lower) in enumerate(zip(layer, below, strict=True), start=2):
        matrix[:, row, :2] = upper[0] * fade[:, None]
        matrix[:, row, 2:4] = upper[1]
        matrix[:, row, 4:] = -lower[0]
    right = np.zeros((len(k), 6, 2))
    right[:, 1, 0] = right[:, 0, 1] = -1.0
    # motions times 2 G of the layer, tractions over k: all entries of like size, whatever the contrast
    matrix[:, 2:4] *= 2.0 * g1
    solved = np.linalg.solve(matrix, right / k[:, None, None])
    if depth <= t:
        decays, grows = np.exp(-k * depth)[:, None], np.exp(k * (depth - t))[:, None]
        basis = [np.hstack([m[0] * decays, m[1] * grows]) for m in BondedLayer.wave_motions(k * depth, nu1)]
        parts = solved[:, :4]
    else:
        basis = [m[0] * np.exp(-k * (depth - t))[:, None] for m in BondedLayer.wave_motions(k * (depth - t), nu2)]
        parts = solved[:, 4:]
    u, w = (np.einsum("qi,qic->cq", b, parts) for b in basis)
    return np.stack([u[0], w[0]]), np.stack([u[1], w[1]]), _across(k, depth, t, g1, g2)


def _across(k: Floats, depth: float, t: float, g1: float, g2: float) -> Floats:
    """Return V under unit traction: decaying and growing waves in the layer, a decaying one below."""
    fade = np.exp(-2.0 * k * t)
    turned = (g1 - g2) / (g1 + g2)  # growing over decaying amplitude at the interface
    amplitude = 1.0 / (g1 * k * (1.0 - turned * fade))
    if depth <= t:
        return np.asarray(amplitude * (np.exp(-k * depth) + turned * np.exp(k * (depth - 2.0 * t))))
    return np.asarray(amplitude * (1.0 + turned) * np.exp(-k * depth))
