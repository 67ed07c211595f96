"""One contact of unknown place, size and force, where the user knows that there is just one.

Six unknowns instead of a field: place on the surface, radius of a round contact with Hertz's pressure, and the force.
The transfer at any place is interpolated between the sites by cubic splines; a site's own cell spreads a force as well,
so the contact is spread by what its second moment exceeds the cell's. The force is linear, so it is eliminated
(variable projection; Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413) and only place and radius are searched.

Validity: sites closer than about the depth of the nearest marker layer; else interpolation limits it. A contact on the
border of the sites is found only as far as `MARGIN` of a site beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import least_squares

from twin.arrays import Floats, Points
from twin.errors import InputError
from twin.sense.calibration import Calibration
from twin.sense.problem import Problem, problem_of
from twin.sense.robust import excess
from twin.sense.track import Found

MARGIN = 0.4
ANGLES = 6
RING = ((0.17883809, 0.583666), (0.7100508, 0.416334))
"""Squared radii over the contact's and weights that integrate Hertz's sqrt(1 - r^2) exactly up to r^6."""

ROUNDS, STARTS = 6, 3


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One contact.

    Attributes
    ----------
    place_mm
        (3,) its centre on the surface, mm.
    force_n, torque_nmm
        (3,) its force, N, and the force's moment about the origin, N mm.
    radius_mm
        Its radius, mm.
    sd_place_mm, sd_force_n
        Standard deviations along the surface (the larger direction) and of the force, from the residual.
    noise_px
        Root mean square of the residual's components, px: a contact that isn't round or alone leaves more.
    """

    place_mm: Points
    force_n: Floats
    torque_nmm: Floats
    radius_mm: float
    sd_place_mm: float
    sd_force_n: Floats
    noise_px: float


def single_contact(
    found: Found,
    calibration: Calibration,
    *,
    radius_mm: float | None = None,
    place: tuple[float, float] | None = None,
    robust: bool = False,
    camera: bool | None = None,
) -> Contact:
    """Return the one contact that moved the markers.

    Parameters
    ----------
    found, calibration
        As for `reconstruct`.
    radius_mm
        Its radius where known; searched if not given.
    place
        (column, row) of its centre in the sites' grid, fractions included, where known: only the force is then sought.
    robust
        Leave wrong vectors out.
    camera
        Follow the camera's bend; as the calibration can if not given.

    Raises
    ------
    InputError
        As for `reconstruct`; or the grid has fewer than 2 sites along a direction.
    """
    if min(calibration.grid) < 2:
        raise InputError(
            f"one contact is sought between sites, so 2 along each direction are needed: {calibration.grid}"
        )
    if camera and not calibration.has_camera:
        raise InputError(f"camera: this calibration ({calibration.method}) holds no compliance and camera")
    problem = problem_of(found, calibration, "norm")
    search = _Search(problem, radius_mm, place)
    whole = problem.weighed(problem.whiten(found.shift_px))
    off, bend = np.zeros_like(whole), np.zeros_like(whole)
    at = search.best(whole)
    for count in range(ROUNDS):
        data = whole - off - bend
        at = search.best(data, at)
        before = off + bend
        if (camera is None and calibration.has_camera) or camera:
            sites = np.outer(search.weights(at), search.force(at, data))
            bend = problem.weighed(problem.whiten(calibration.bend_px(sites)))
        if robust:
            residual = whole - bend - search.predicted(at, data)
            off, _ = excess(residual, np.ones_like(residual), 1.0, leave_out=count > 1)
        if np.abs(off + bend - before).max() < 1e-3:
            break
    return search.contact(at, whole - off - bend)


class _Search:
    """Place and radius as unknowns: (column, row, radius in mm), those that are known being held."""

    def __init__(self, problem: Problem, radius_mm: float | None, place: tuple[float, float] | None) -> None:
        self.problem, self.calibration = problem, problem.calibration
        columns, rows = self.calibration.grid
        self.pitch = np.sqrt(float(np.median(self.calibration.site_area_mm2)))
        self.splines = _cardinal(columns), _cardinal(rows)
        self.by_site = problem.weighed(problem.base.transfer).reshape(-1, columns * rows, 3) / problem.size_px
        largest = self.pitch * (max(columns, rows) - 1) / 2
        self.low = np.array([-MARGIN, -MARGIN, 0.0])
        self.high = np.array([columns - 1 + MARGIN, rows - 1 + MARGIN, max(largest, self.pitch)])
        self.known = np.array([place is not None, place is not None, radius_mm is not None])
        self.given = np.array([*(place or (0.0, 0.0)), radius_mm or 0.0])
        if place is not None and not ((self.low[:2] <= place) & (place <= self.high[:2])).all():
            raise InputError(f"place = {place}: must lie within the sites, {self.low[:2]} to {self.high[:2]}")

    def weights(self, at: Floats) -> Floats:
        """Return (k,) shares of the sites: the contact's pressure, interpolated."""
        column, row, radius = at
        spread = np.sqrt(max(radius**2 - 5.0 * self.pitch**2 / 12.0, 0.0)) / self.pitch
        angle = 2 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
        out = np.zeros(self.calibration.grid)
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

    def predicted(self, at: Floats, data: Floats) -> Floats:
        return np.asarray(self.transfer(at) @ self.force(at, data))

    def best(self, data: Floats, start: Floats | None = None) -> Floats:
        """Return (column, row, radius) with the least residual, the force being free."""
        starts = self._starts(data) if start is None else [start]
        found = [self._from(np.where(self.known, self.given, begin), data) for begin in starts]
        return min(found, key=lambda pair: pair[1])[0]

    def _from(self, begin: Floats, data: Floats) -> tuple[Floats, float]:
        """Return the nearest best (column, row, radius) and its squared residual."""
        free = ~self.known
        if not free.any():
            return begin, 0.0

        def residual(unknown: Floats) -> Floats:
            at = begin.copy()
            at[free] = unknown
            return np.asarray(data - self.predicted(at, data))

        low, high = self.low[free], self.high[free]
        inside = np.clip(begin[free], low + 1e-6, high - 1e-6)
        solved = least_squares(residual, inside, bounds=(low, high), x_scale=0.1, diff_step=1e-4, max_nfev=60)
        out = begin.copy()
        out[free] = solved.x
        return out, float(solved.cost)

    def _starts(self, data: Floats) -> list[Floats]:
        """Return the sites that explain the data best alone, none a neighbour of another."""
        columns = self.by_site.transpose(1, 0, 2)
        gram, pull = columns.transpose(0, 2, 1) @ columns, columns.transpose(0, 2, 1) @ data
        gram = gram + 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        explained = np.einsum("ki,ki->k", pull, np.linalg.solve(gram, pull[:, :, None])[:, :, 0])
        starts: list[Floats] = []
        for site in np.argsort(-explained):
            here = np.array([*divmod(int(site), self.calibration.grid[1]), self.pitch], float)
            if all(np.abs(here - other).max() > 1.5 for other in starts):
                starts.append(here)
            if len(starts) == STARTS:
                break
        return starts

    def contact(self, at: Floats, data: Floats) -> Contact:
        place = self.weights(np.array([at[0], at[1], 0.0])) @ self.calibration.site_mm
        transfer, force = self.transfer(at), self.force(at, data)
        residual = data - transfer @ force
        steps = np.diag([1e-3, 1e-3, 1e-3 * self.pitch])
        moves = [
            (self.transfer(at + s) - transfer) @ force / 1e-3 for s, k in zip(steps, self.known, strict=True) if not k
        ]
        slope = np.column_stack([*moves, transfer])
        noise = float(np.sqrt((residual**2).sum() / max(len(data) - slope.shape[1], 1)))
        spread = noise * np.sqrt(np.maximum(np.diag(np.linalg.pinv(slope.T @ slope)), 0.0))
        sd_place = self.pitch * float(spread[:2].max()) if not self.known[0] else 0.0
        return Contact(
            place_mm=place, force_n=force, torque_nmm=np.cross(place, force), radius_mm=float(at[2]),
            sd_place_mm=sd_place, sd_force_n=spread[-3:], noise_px=noise * self.problem.size_px,
        )  # fmt: skip


@lru_cache(maxsize=16)
def _cardinal(count: int) -> BSpline:
    """Return the spline whose values at a place are the weights of ``count`` equally spaced nodes."""
    return make_interp_spline(np.arange(count), np.eye(count), k=min(3, count - 1))
