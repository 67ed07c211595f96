"""What every peer is given, and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.clock import Cost
from benchmarks.peers_mesh import BUMP_MM, PATCH_MM
from benchmarks.reference import YOUNGS_MODULUS_MPA, reference
from twin.arrays import Bools, Floats, Points
from twin.world.mesh.mesh import Mesh

KEYS = {"block": ("R1z", "R1x"), "finger": ("apex_z", "apex_x")}
"""The two loads of a body: 1 N along z and along x, on a square of 4 mm (block) or as a bump 4 mm wide (finger)."""

KNOWN = (0.5, 0.49)
"""Poisson's ratios that the references have."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Two loads on one body, of one Poisson's ratio."""

    body: str
    nu: float
    axes: tuple[int, int] = (2, 0)
    youngs_modulus_mpa: float = YOUNGS_MODULUS_MPA

    @property
    def points(self) -> Points:
        """(n, 3) where displacements are wanted, mm."""
        return reference(self.body).points

    def right(self, load: int) -> Points:
        """Return (n, 3) the converged displacements, mm.

        Between the two ratios of the reference they are interpolated; the field is so smooth in nu that .4999 is then
        known to 1e-5.
        """
        fields = [reference(self.body).case(f"{KEYS[self.body][load]}_nu{nu:g}").right for nu in KNOWN]
        share = (KNOWN[0] - self.nu) / (KNOWN[0] - KNOWN[1])
        return np.asarray((1 - share) * fields[0] + share * fields[1])


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Displacements (n, 3) in mm under both loads, unknowns, and the costs from the ready mesh, first and next load."""

    unknowns: int
    first: Cost
    next: Cost
    moved: tuple[Points, Points]


def traction(body: str, places: Points) -> Floats:
    """Return the (q,) traction at surface places (q, 3) along the load, up to a factor."""
    if body == "block":
        return np.asarray((np.abs(places) <= PATCH_MM / 2 * np.array([1, 1, 0]) + 1e-9).all(axis=1), float)
    return np.asarray(np.maximum(0.0, 1.0 - np.sum((places / BUMP_MM) ** 2, axis=1)) ** 2)


def may_be_loaded(body: str, middles: Points) -> Bools:
    """Return which boundary faces may bear some of the load, by their middles (f, 3), mm."""
    if body == "block":
        return traction(body, middles) > 0
    return np.asarray(np.linalg.norm(middles, axis=1) < 2 * BUMP_MM)


_A, _B = (6 - np.sqrt(15)) / 21, (6 + np.sqrt(15)) / 21
PLACES = np.array([[1 / 3, 1 / 3], *[[a, b] for s in (_A, _B) for a, b in ((s, s), (1 - 2 * s, s), (s, 1 - 2 * s))]])
WEIGHTS = np.array([9 / 80] + [(155 - np.sqrt(15)) / 2400] * 3 + [(155 + np.sqrt(15)) / 2400] * 3)
"""Points (7, 2) and weights (7,) that integrate polynomials of degree 5 over the unit triangle (J. Radon 1948)."""


def nodal_shares(body: str, mesh: Mesh) -> Floats:
    """Return the (N,) forces on the nodes of quadratic elements that a total of 1 N makes, N."""
    faces = mesh.faces[mesh.piece == 0]
    a, b = PLACES.T
    c = 1.0 - a - b
    shape = np.stack([c * (2 * c - 1), a * (2 * a - 1), b * (2 * b - 1), 4 * a * c, 4 * a * b, 4 * b * c], axis=1)
    along_a = np.stack([1 - 4 * c, 4 * a - 1, 0 * a, 4 * (c - a), 4 * b, -4 * b], axis=1)
    along_b = np.stack([1 - 4 * c, 0 * a, 4 * b - 1, -4 * a, 4 * a, 4 * (c - b)], axis=1)
    nodes = mesh.points[faces]
    places, one, two = (np.einsum("qa,fai->fqi", table, nodes) for table in (shape, along_a, along_b))
    area = np.linalg.norm(np.cross(one, two), axis=2) * WEIGHTS
    strength = traction(body, places.reshape(-1, 3)).reshape(area.shape) * area
    out = np.bincount(faces.ravel(), (strength @ shape).ravel(), len(mesh.points))
    return np.asarray(out / out.sum())
