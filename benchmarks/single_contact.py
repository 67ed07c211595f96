"""One round contact of known radius, where the user knows that there is just one: its place and its force.

The transfer at any place is interpolated between the sites by cubic splines; a site's own cell spreads a force as
well, so the contact is spread by what its second moment exceeds the cell's. The force is linear, so it is eliminated
(variable projection; Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413) and only the place is searched.

Validity: sites closer than about the depth of the nearest marker layer; else interpolation limits it. A contact on the
border of the sites is found only as far as `MARGIN` of a site beyond it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import least_squares

from twin.arrays import Floats, Points
from twin.sense.calibration import Calibration
from twin.sense.inverse import Problem, problem_of
from twin.sense.track import Found

MARGIN = 0.4
ANGLES = 6
RING = ((0.17883809, 0.583666), (0.7100508, 0.416334))
"""Squared radii over the contact's and weights that integrate Hertz's sqrt(1 - r^2) exactly up to r^6."""

ROUNDS, STARTS = 6, 3


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A contact: (3,) its centre on the surface, mm, and (3,) its force, N."""

    place_mm: Points
    force_n: Floats


def single_contact(
    found: Found, calibration: Calibration, radius_mm: float, place: tuple[float, float] | None = None
) -> Contact:
    """Return the contact that moved the markers; ``place`` is its (column, row) among the sites where it is known."""
    problem = problem_of(found, calibration, "norm")
    search = _Search(problem, radius_mm)
    whole = _weighed(problem, problem.whiten(found.shift_px))
    bend = np.zeros_like(whole)
    at = search.best(whole) if place is None else np.array(place, float)
    for _ in range(ROUNDS):
        if place is None:
            at = search.best(whole - bend, at)
        if not calibration.has_camera:
            break
        before = bend
        sites = np.outer(search.weights(at), search.force(at, whole - bend))
        bend = _weighed(problem, problem.whiten(calibration.bend_px(sites)))
        if np.abs(bend - before).max() < 1e-3:
            break
    centre = search.weights(at, spread=0.0) @ calibration.site_mm
    return Contact(place_mm=centre, force_n=search.force(at, whole - bend))


def _weighed(problem: Problem, rows: Floats) -> Floats:
    """Return the (m', ...) rows of data that were not lost, in units of the picture's own noise."""
    share = problem.factors.share
    here = share > 0
    return np.asarray((rows[here].T * np.sqrt(share[here])).T)


class _Search:
    """The place (column, row) as the unknown, the force being free."""

    def __init__(self, problem: Problem, radius_mm: float) -> None:
        self.grid = problem.calibration.grid
        columns, rows = self.grid
        pitch = np.sqrt(float(np.median(problem.calibration.site_area_mm2)))
        self.spread = np.sqrt(max(radius_mm**2 - 5.0 * pitch**2 / 12.0, 0.0)) / pitch
        self.splines = _cardinal(columns), _cardinal(rows)
        self.by_site = _weighed(problem, problem.base.transfer).reshape(-1, columns * rows, 3) / problem.size_px
        self.low = np.array([-MARGIN, -MARGIN])
        self.high = np.array([columns - 1 + MARGIN, rows - 1 + MARGIN])

    def weights(self, at: Floats, spread: float | None = None) -> Floats:
        """Return (k,) shares of the sites: the contact's pressure, interpolated."""
        column, row = at
        spread = self.spread if spread is None else spread
        angle = 2 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
        out = np.zeros(self.grid)
        for (squared, share), turn in zip(RING, (0.0, np.pi / ANGLES), strict=True):
            r = spread * np.sqrt(squared)
            along = self.splines[0](np.clip(column + r * np.cos(angle + turn), self.low[0], self.high[0]))
            across = self.splines[1](np.clip(row + r * np.sin(angle + turn), self.low[1], self.high[1]))
            out += share / ANGLES * along.T @ across
        return out.ravel()

    def transfer(self, at: Floats) -> Floats:
        """Return (m, 3) whitened shifts per force of the contact."""
        return np.asarray(np.tensordot(self.by_site, self.weights(at), axes=(1, 0)))

    def force(self, at: Floats, data: Floats) -> Floats:
        return np.asarray(np.linalg.lstsq(self.transfer(at), data, rcond=None)[0])

    def best(self, data: Floats, start: Floats | None = None) -> Floats:
        """Return the (column, row) with the least residual."""

        def residual(at: Floats) -> Floats:
            return np.asarray(data - self.transfer(at) @ self.force(at, data))

        def solved(begin: Floats) -> tuple[float, Floats]:
            inside = np.clip(begin, self.low + 1e-6, self.high - 1e-6)
            bounds = (self.low, self.high)
            found = least_squares(residual, inside, bounds=bounds, x_scale=0.1, diff_step=1e-4, max_nfev=60)
            return float(found.cost), found.x

        return min(map(solved, self._starts(data) if start is None else [start]), key=lambda pair: pair[0])[1]

    def _starts(self, data: Floats) -> list[Floats]:
        """Return the sites that explain the data best alone, none a neighbour of another."""
        columns = self.by_site.transpose(1, 0, 2)
        gram, pull = columns.transpose(0, 2, 1) @ columns, columns.transpose(0, 2, 1) @ data
        gram = gram + 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        explained = np.einsum("ki,ki->k", pull, np.linalg.solve(gram, pull[:, :, None])[:, :, 0])
        starts: list[Floats] = []
        for site in np.argsort(-explained):
            here = np.array(divmod(int(site), self.grid[1]), float)
            if all(np.abs(here - other).max() > 1.5 for other in starts):
                starts.append(here)
            if len(starts) == STARTS:
                break
        return starts


@lru_cache(maxsize=16)
def _cardinal(count: int) -> BSpline:
    """Return the spline whose values at a place are the weights of ``count`` equally spaced nodes."""
    return make_interp_spline(np.arange(count), np.eye(count), k=min(3, count - 1))
