"""What an endless layer bonded to a rigid base adds to the half-space field of forces on its free
face.

A layer 0 <= z <= H is free at z = 0 and held at z = H. Its field is the half-space field u0 of the
same forces plus a smooth correction v, which has no traction at z = 0 and is -u0 at z = H. For one
wave number k both are sums of waves that decay or grow with depth like exp(-k z) and exp(k z),
times 1 or z (L. M. Burmister 1945, J. Appl. Phys. 16): four amplitudes follow from four linear
equations, at every Poisson's ratio up to 1/2. The field of a point force is the Hankel integral
over k. It depends on r/H, z/H and Poisson's ratio alone, so it is integrated once on a grid in
(r, z) and interpolated. With v known, the mesh of a thin body carries only what its sides change.

Validity: small strain, homogeneous and isotropic. Within `REACH` thicknesses of a force v is
interpolated to about 2e-6 / (G H) mm/N; farther away the layer is taken to be at rest, v = -u0,
which holds to about 1e-5 / (G H) mm/N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import jv

from twin.arrays import Floats, Ints, Points, for_kernel, grid_points
from twin.compiled import njit
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import shear_modulus
from twin.theory.halfspace import rectangle_slopes, rectangle_terms

THICK = 2.5
"""Longest side of a block over its thickness from which on it counts as a layer: that of the block
that estimates were fitted to."""

REACH = 12.0
"""Distance of a force, over the thickness, from which on the layer is at rest."""

_CELLS = 16
"""Cells of the grid per thickness, along r and z."""

_STENCIL = 6
"""Points of the interpolating polynomial along r and along z: order 6, a relative error of about
_CELLS^-6."""

_SCALE = np.array(
    [1.0 / math.prod(i - j for j in range(_STENCIL) if j != i) for i in range(_STENCIL)]
)
"""What makes each of these polynomials one at its own point."""

_NODES = 8
"""Grid nodes per thickness onto which the forces of a finely cut load are gathered."""

_LARGEST_WAVE = 24.0
"""Largest k H of the integral: v falls like exp(-k H) at the base, to 4e-11, and faster above
it."""

_CHUNK = 256
"""Points at which displacements are computed at once."""

_ORDER = 12
"""Gauss points per half period of the fastest Bessel function."""


@dataclass(frozen=True)
class BondedLayer:
    """The correction v of one layer of thickness H, mm, and Poisson's ratio up to 1/2."""

    thickness_mm: float
    poisson_ratio: float

    @classmethod
    def of(cls, body: Body, poisson_ratio: float) -> BondedLayer | None:
        """Return the endless layer that a flat, thin body is a piece of; None for others."""
        low, high = np.array(body.bounds_mm)
        thickness = body.layer_mm
        if thickness is None or np.max((high - low)[:2]) <= THICK * thickness:
            return None
        return cls(thickness_mm=thickness, poisson_ratio=poisson_ratio)

    @cached_property
    def _grid(self) -> Floats:
        return _grid_of(self.poisson_ratio)

    def displacement(self, points: Points, load: Rectangles, youngs_modulus_mpa: float) -> Points:
        """Return v (n, 3) in mm at ``points`` (n, 3) under all rectangles together."""
        out = np.empty((len(points), 3))
        for start in range(0, len(points), _CHUNK):
            some = slice(start, start + _CHUNK)
            moved = self.compliance(points[some], load, youngs_modulus_mpa)
            out[some] = (moved @ load.force_n.ravel()).reshape(-1, 3)
        return out

    def gradient(self, points: Points, load: Rectangles, youngs_modulus_mpa: float) -> Floats:
        """Return (n, 3, 3) dv_i/dx_j at ``points`` (n, 3)."""
        slope = self._slopes(points, load, load.force_n[:, :, None])[0]
        return slope[..., 0] / self._shear(youngs_modulus_mpa)

    def compliance(
        self, points: Points, rectangles: Rectangles, youngs_modulus_mpa: float
    ) -> Floats:
        """Return (3 n, 3 k): v in mm/N at ``points`` under unit forces on each rectangle."""
        centre, spread = self._point_forces(rectangles)
        each = np.empty((3 * len(points), 3, len(centre)))
        _compliance(
            for_kernel(points),
            centre,
            self._grid,
            self.thickness_mm,
            self._softness,
            each,
        )
        moved = np.swapaxes(
            (each.reshape(-1, len(centre)) @ spread).reshape(len(each), 3, -1), 1, 2
        )
        return moved.reshape(len(each), -1) / self._shear(youngs_modulus_mpa)

    def tractions(self, points: Points, areas: Floats, load: Rectangles, columns: Floats) -> Floats:
        """Return (n, 3, m) forces in N that v's stress exerts on areas (n, 3), mm2, at ``points``
        under forces ``columns`` (k, 3, m), N, in m load cases."""
        slope, tension = self._slopes(points, load, columns)
        sheared = np.einsum("nijm,nj->nim", slope, areas) + np.einsum("njim,nj->nim", slope, areas)
        return np.asarray(sheared + tension[:, None] * areas[:, :, None])

    def _slopes(self, points: Points, load: Rectangles, columns: Floats) -> tuple[Floats, Floats]:
        """Return dv_i/dx_j (n, 3, 3, m) for G = 1, and lambda div v (n, m) in MPa, in load cases
        (k, 3, m)."""
        cases = columns.shape[2]
        slope = np.zeros((len(points), 3, 3, cases))
        tension = np.zeros((len(points), cases))
        centre, spread = self._point_forces(load)
        force = (spread @ columns.reshape(len(columns), -1)).reshape(-1, 3, cases)
        _gradient(
            for_kernel(points),
            centre,
            force,
            self._grid,
            self.thickness_mm,
            self.poisson_ratio,
            slope,
            tension,
        )
        return slope, tension

    def _point_forces(self, load: Rectangles) -> tuple[Floats, Floats]:
        """Return places (c, 3) of point forces that stand for uniform rectangles, and their shares
        of each (c, k).

        v is analytic within one thickness of every force, so that n Gauss points on the half side a
        are exact to about (H/a + sqrt(1 + (H/a)^2))^(-2 n). Where they outnumber the nodes of a
        grid with `_NODES` per thickness, v is interpolated on that grid.
        """
        # Gauss points on every rectangle, more of them on wide ones.
        number = 1
        if load.half_mm.any():
            number = 2 + round(4.0 * float(load.half_mm.max()) / self.thickness_mm)
        node, share = np.polynomial.legendre.leggauss(number)
        corners = np.array([(s, t) for t in node for s in node])
        weight = np.tile([s * t / 4.0 for t in share for s in share], len(load))
        offsets = np.einsum("ga,ka,kai->kgi", corners, load.half_mm, load.frames[:, :2])
        centre = (load.centre_mm[:, None] + offsets).reshape(-1, 3)
        rectangle = np.repeat(np.arange(len(load)), len(corners))
        # The grid that would hold all of these points; use it only if it has fewer nodes.
        step = self.thickness_mm / _NODES
        low = centre.min(axis=0, initial=0.0 if len(load) == 0 else math.inf)
        counts = (
            np.floor(np.ptp(centre, axis=0)[:2] / step).astype(int) + _STENCIL
            if len(load)
            else np.ones(2, int)
        )
        if len(centre) <= counts.prod():
            spread = np.zeros((len(centre), len(load)))
            spread[np.arange(len(centre)), rectangle] = weight
            return centre, spread
        # Share each point force among the nodes of its stencil: the polynomial's weights along
        # both axes.
        at = (centre[:, :2] - low[:2]) / step + _STENCIL // 2 - 1
        first = np.empty(at.shape, int)
        parts = np.empty((2, len(centre), _STENCIL))
        slope = np.empty(_STENCIL)
        for axis in range(2):
            for i in range(len(centre)):
                first[i, axis] = _stencil(at[i, axis], parts[axis, i], slope)
        shares = weight[:, None, None] * parts[0][:, :, None] * parts[1][:, None, :]
        reach = np.arange(_STENCIL)
        # Sum the shares by node and rectangle.
        rows = (first[:, 0, None] + reach)[:, :, None] * counts[1] + (first[:, 1, None] + reach)[
            :, None, :
        ]
        spread = np.zeros((counts.prod(), len(load)))
        np.add.at(spread, (rows, rectangle[:, None, None]), shares)
        axes = [
            low[axis] + step * (np.arange(counts[axis]) - _STENCIL // 2 + 1) for axis in range(2)
        ]
        grid = grid_points(*axes)
        return np.column_stack([grid, np.full(len(grid), low[2])]), spread

    def _shear(self, youngs_modulus_mpa: float) -> float:
        return shear_modulus(youngs_modulus_mpa, self.poisson_ratio)

    @property
    def _softness(self) -> float:
        return 1.0 - 2.0 * self.poisson_ratio

    @staticmethod
    def wave_motions(kz: Floats, nu: float) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return U and W for decaying (q, 2) and growing (q, 2) waves, without exponentials."""
        one = np.ones_like(kz)
        bend = 3.0 - 4.0 * nu
        u = np.column_stack([one, kz - bend]), np.column_stack([one, -bend - kz])
        w = np.column_stack([one, kz]), np.column_stack([-one, kz])
        return u, w

    @staticmethod
    def wave_tractions(
        kz: Floats, nu: float, g: float
    ) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return the tractions along x (sin) and along z (cos) over k, like `wave_motions`."""
        one = np.ones_like(kz)
        x = (
            2 * g * np.column_stack([-one, 2 - 2 * nu - kz]),
            2 * g * np.column_stack([one, 2 * nu - 2 - kz]),
        )
        z = (
            2 * g * np.column_stack([-one, 1 - 2 * nu - kz]),
            2 * g * np.column_stack([-one, 1 - 2 * nu + kz]),
        )
        return x, z


@lru_cache(maxsize=8)
def _grid_of(nu: float) -> Floats:
    """Return (r, z, 7) the functions f of `_compliance` and `_near` for G = H = 1, at r = (i -
    _STENCIL / 2) / _CELLS and z = (j - _STENCIL / 2) / _CELLS.

    The grid goes on beyond its ends, so that all interpolation is in the middle of a stencil: v is
    analytic beyond the faces too, up to z = 2 H.
    """
    r, depths = (
        (np.arange(round(reach * _CELLS) + _STENCIL + 1) - _STENCIL // 2) / _CELLS
        for reach in (REACH, 1.0)
    )
    r[r == 0.0] = 1e-6  # the functions are even in r
    panels = math.ceil(_LARGEST_WAVE * (REACH + 1.0) / math.pi)
    # small waves matter most: panels that grow from the start
    ends = _LARGEST_WAVE * np.linspace(0.0, 1.0, panels + 1) ** 1.3
    node, share = np.polynomial.legendre.leggauss(_ORDER)
    half = np.diff(ends) / 2.0
    k = ((ends[:-1] + half)[:, None] + half[:, None] * node).ravel()
    weight = (half[:, None] * share).ravel() * k / (2.0 * np.pi)
    bessel = [weight * jv(order, r[:, None] * k) / r[:, None] ** order for order in (0, 1, 2)]
    out = np.empty((len(r), len(depths), 7))
    for j, depth in enumerate(depths):
        (u_down, w_down, t_down), (u_along, w_along, t_along), across = _waves(k, float(depth), nu)
        out[:, j, 0] = bessel[1] @ u_down
        out[:, j, 1] = bessel[0] @ w_down
        even = bessel[0] @ (u_along + across) / 2.0
        odd = bessel[2] @ (u_along - across) / 2.0
        out[:, j, 2] = even + odd * r**2
        out[:, j, 3] = 2.0 * odd
        out[:, j, 4] = -(bessel[1] @ w_along)
        out[:, j, 5] = bessel[0] @ t_down
        out[:, j, 6] = -(bessel[1] @ t_along)
    return out


def _waves(k: Floats, z: float, nu: float) -> tuple[tuple[Floats, ...], tuple[Floats, ...], Floats]:
    """Return what waves of unit traction add at depth ``z`` for G = H = 1, each (q,): U, W and
    lambda div v under the pressure cos(k x), the same under the traction sin(k x) along x, and V
    under the traction cos(k x) along y."""
    fade = np.exp(-k)
    none = 0.0 * k
    at_face = BondedLayer.wave_tractions(none, nu, 1.0)
    at_base = BondedLayer.wave_motions(k, nu)
    given = np.zeros((len(k), 2, 2))
    given[:, 1, 0] = given[:, 0, 1] = -1.0
    given /= k[:, None, None]
    # the half-space has decaying waves only
    alone = np.linalg.solve(np.stack([row[0] for row in at_face], axis=1), given)
    matrix, right = np.zeros((len(k), 4, 4)), np.zeros((len(k), 4, 2))
    for row, (decays, grows) in enumerate(at_face):
        matrix[:, row, :2] = decays
        matrix[:, row, 2:] = grows * fade[:, None]
    for row, (decays, grows) in enumerate(at_base):
        matrix[:, 2 + row, :2] = decays * fade[:, None]
        matrix[:, 2 + row, 2:] = grows
        right[:, 2 + row] = -np.einsum("qi,qic->qc", decays * fade[:, None], alone)
    solved = np.linalg.solve(matrix, right)
    down = np.exp(-k * z)
    up = np.exp(k * (z - 1.0))
    basis = [
        np.hstack([m[0] * down[:, None], m[1] * up[:, None]])
        for m in BondedLayer.wave_motions(k * z, nu)
    ]
    u, w = (np.einsum("qi,qic->cq", b, solved) for b in basis)
    tension = -4.0 * nu * k * (solved[:, 1] * down[:, None] + solved[:, 3] * up[:, None]).T
    across = -(np.exp(-k * (2.0 + z)) + np.exp(k * (z - 2.0))) / (k * (1.0 + fade * fade))
    return (u[0], w[0], tension[0]), (u[1], w[1], tension[1]), across


@njit(cache=True)
def _stencil(at: float, weight: Floats, slope: Floats) -> int:
    """Set weights, and derivatives, of the Lagrange polynomials of the points around ``at``; return
    the first point."""
    first = math.floor(at) - _STENCIL // 2 + 1
    for i in range(_STENCIL):
        product, change = 1.0, 0.0
        for j in range(_STENCIL):
            if j != i:
                change = change * (at - first - j) + product
                product *= at - first - j
        weight[i], slope[i] = product * _SCALE[i], change * _SCALE[i]
    return first


@njit(cache=True)
def _along(
    r: float, grid: Floats, j: int, depth: int, weights: Floats, level: Floats, known: Ints
) -> int:
    """Set ``weights`` along r, the first two, and what ``level`` (r, 2, 7), the grid's functions
    and their slopes at depth number ``depth``, lacks of them; return the first index."""
    first: int = _stencil(r * _CELLS + _STENCIL // 2, weights[0], weights[1])
    for i in range(first, first + _STENCIL):
        if known[i] == depth:
            continue
        known[i] = depth
        for c in range(7):
            value, slope = 0.0, 0.0
            for b in range(_STENCIL):
                value += weights[2, b] * grid[i, j + b, c]
                slope += weights[3, b] * grid[i, j + b, c]
            level[i, 0, c], level[i, 1, c] = value, slope
    return first


@njit(cache=True)
def _compliance(
    points: Floats, centre: Floats, grid: Floats, thickness: float, softness: float, out: Floats
) -> None:
    """Set ``out`` (3 n, 3, c) to v under unit forces, for G = 1.

    With f of the grid, for G = H = 1: v = (f0 x, f0 y, f1) under a normal force, (f2 - f3 x^2, -f3
    x y, f4 x) under one along x.
    """
    weights = np.empty((4, _STENCIL))
    level, known = np.empty((len(grid), 2, 7)), np.full(len(grid), -1)
    f = np.empty(5)
    u = np.empty((3, 3))
    n = np.empty(3)
    for q in range(len(points)):
        z = points[q, 2] / thickness
        if q == 0 or points[q, 2] != points[q - 1, 2]:
            depth = q
            down = min(max(z, 0.0), 1.0) * _CELLS + _STENCIL // 2
            first_down = _stencil(down, weights[2], weights[3])
        for t in range(len(centre)):
            x, y = (
                (points[q, 0] - centre[t, 0]) / thickness,
                (points[q, 1] - centre[t, 1]) / thickness,
            )
            r = math.sqrt(x * x + y * y)
            # Far from the force: the half-space's field with the opposite sign, as the layer
            # hardly moves there.
            if r > REACH:
                rectangle_terms(x, y, z, 0.0, 0.0, softness, u, n)
                for i in range(3):
                    for j in range(3):
                        u[i, j] *= -0.25 / math.pi
            else:
                # Near it: five functions of (r, z), interpolated from the grid.
                first = _along(r, grid, first_down, depth, weights, level, known)
                for c in range(5):
                    f[c] = 0.0
                    for a in range(_STENCIL):
                        f[c] += weights[0, a] * level[first + a, 0, c]
                u[0, 0], u[1, 1], u[2, 2] = f[2] - f[3] * x * x, f[2] - f[3] * y * y, f[1]
                u[0, 1] = u[1, 0] = -f[3] * x * y
                u[0, 2], u[1, 2] = f[0] * x, f[0] * y
                u[2, 0], u[2, 1] = f[4] * x, f[4] * y
            for i in range(3):
                for j in range(3):
                    out[3 * q + i, j, t] = u[i, j] / thickness


@njit(cache=True)
def _gradient(
    points: Floats,
    centre: Floats,
    force: Floats,
    grid: Floats,
    thickness: float,
    nu: float,
    out: Floats,
    tension: Floats,
) -> None:
    """Add dv_i/dx_j to ``out`` (n, 3, 3, m) and lambda div v to ``tension`` (n, m), for G = 1."""
    weights = np.empty((4, _STENCIL))
    level, known = np.empty((len(grid), 2, 7)), np.full(len(grid), -1)
    g = np.empty((3, 3, 3))
    t = np.empty(3)
    f = np.empty(7)
    r_slope = np.empty(7)
    z_slope = np.empty(7)
    n = np.empty(3)
    area = thickness * thickness
    for q in range(len(points)):
        z = points[q, 2] / thickness
        if q == 0 or points[q, 2] != points[q - 1, 2]:
            depth = q
            down = min(max(z, 0.0), 1.0) * _CELLS + _STENCIL // 2
            first_down = _stencil(down, weights[2], weights[3])
        for s in range(len(centre)):
            x, y = (
                (points[q, 0] - centre[s, 0]) / thickness,
                (points[q, 1] - centre[s, 1]) / thickness,
            )
            r = math.sqrt(x * x + y * y)
            if r > REACH:
                # minus the half-space's
                rectangle_slopes(x, y, z, 0.0, 0.0, 1.0 - 2.0 * nu, g, n)
                for i in range(3):
                    t[i] = nu / math.pi * n[i]
                    for k in range(3):
                        for j in range(3):
                            g[i, k, j] *= -0.25 / math.pi
            else:
                first = _along(r, grid, first_down, depth, weights, level, known)
                for c in range(7):
                    f[c], r_slope[c], z_slope[c] = 0.0, 0.0, 0.0
                for a in range(_STENCIL):
                    for c in range(7):
                        f[c] += weights[0, a] * level[first + a, 0, c]
                        r_slope[c] += _CELLS * weights[1, a] * level[first + a, 0, c]
                        z_slope[c] += _CELLS * weights[0, a] * level[first + a, 1, c]
                _near(x, y, r, f, r_slope, z_slope, g, t)
            for case in range(force.shape[2]):
                for k in range(3):
                    push = force[s, k, case] / area
                    tension[q, case] += t[k] * push
                    for i in range(3):
                        for j in range(3):
                            out[q, i, j, case] += g[i, k, j] * push


@njit(cache=True)
def _near(
    x: float, y: float, r: float, f: Floats, r_slope: Floats, z_slope: Floats, g: Floats, t: Floats
) -> None:
    """Set g[i, k, j] = dv_i/dx_j and t[k] = lambda div v under a unit force k."""
    away = (x, y)
    over_r = 1.0 / max(r, 1e-9)
    for j in range(2):
        towards = away[j] * over_r
        # normal force
        for i in range(2):
            g[i, 2, j] = r_slope[0] * towards * away[i] + (f[0] if i == j else 0.0)
        g[2, 2, j] = r_slope[1] * towards
        for k in range(2):
            for i in range(2):
                g[i, k, j] = -r_slope[3] * towards * away[i] * away[k]
                if i == k:
                    g[i, k, j] += r_slope[2] * towards
                if i == j:
                    g[i, k, j] -= f[3] * away[k]
                if k == j:
                    g[i, k, j] -= f[3] * away[i]
            g[2, k, j] = r_slope[4] * towards * away[k] + (f[4] if k == j else 0.0)
    for i in range(2):
        g[i, 2, 2] = z_slope[0] * away[i]
        for k in range(2):
            g[i, k, 2] = -z_slope[3] * away[i] * away[k] + (z_slope[2] if i == k else 0.0)
        g[2, i, 2] = z_slope[4] * away[i]
        t[i] = f[6] * away[i]
    g[2, 2, 2] = z_slope[1]
    t[2] = f[5]
