"""What the sites' grid lets two pushes be told apart by, whatever the markers tell.

Forces are estimated at sites, so two pushes are two only where a site between them shows less. A grid that is too
coarse for what a sweep asks gives all its designs the same two-point distance, which then ranks nothing.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats
from twin.judge.resolution import dip, two_point_distance
from twin.parts.pipeline import Sites
from twin.parts.sweep import Loads

PAIRS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
"""Distances of two pushes over the sweep's ``pair_mm``."""

NEAR = 1.1
"""A two-point distance up to this times the grid's own is the grid's."""

FINE = 0.375
"""Pitch of sites over the two-point distance that they shall tell: two pushes need a site each and one between."""


def told_by_sites(grid: Sites, loads: Loads) -> float:
    """Return the least distance, mm, at which an estimate without any error shows two pushes along s; inf for none.

    Such an estimate holds in every site the part of the pushes that lies in its cell.
    """
    place, half = grid.axes()[0], loads.size_mm / 2
    apart = np.array(PAIRS) * loads.pair_mm
    apart = apart[reached(grid, apart)]
    ends = place[:, None] + grid.pitch_mm / 2 * np.array([-1.0, 1.0])

    def held(middle: float) -> Floats:
        low, high = np.clip(ends, middle - half, middle + half).T
        return np.asarray(high - low)

    dips = np.array([dip(place, held(-a / 2) + held(a / 2), float(a)) for a in apart])
    return two_point_distance(apart, dips) if len(apart) else float("inf")


def reached(grid: Sites, apart_mm: Floats) -> Bools:
    """Return (m,) whether two pushes so far apart along s are both over the sites."""
    return np.asarray(apart_mm / 2 <= grid.half_mm[0] + grid.pitch_mm / 2)


def limited(two_point_mm: Floats, sites_mm: Floats) -> Bools:
    """Return (m,) whether a design's two-point distance is that of its sites, not of its markers."""
    with np.errstate(invalid="ignore"):
        return np.asarray(two_point_mm <= NEAR * sites_mm)


def advice(sites_mm: float, wanted_mm: float) -> str:
    """Return what the sites tell, and what to set where that is less than what is wanted."""
    told = f"the sites' pitch tells two points from {sites_mm:.3g} mm on"
    if sites_mm <= wanted_mm:
        return f"{told}, which is all that is asked ({wanted_mm:.3g} mm); finer sites under [set] would rank them"
    return (
        f"{told}; set reconstruction.sites.pitch_mm = {FINE * wanted_mm:.2g} or less under [set], with more columns "
        "and rows to cover the presses"
    )
