"""Rigid beads in incompressible rubber under a free flat surface: how they move and what they do to
their neighbours.

A hard bead can't strain, so it moves with the mean of the field over its surface, and it pushes
back on the rubber around it, which moves the other beads.

A rigid sphere that is pushed through an endless elastic body has the same traction all over its
surface, F / (4 pi a^2). The reciprocal theorem with a bead that carries no force then gives the
mean over the surface, u + a^2/6 laplacian(u), exactly, as displacements are biharmonic: Faxen's
first law, at every Poisson's ratio. (The factor 1/10 belongs to the mean over the volume and to the
strain that the bead feels, his law of the stresslet.)

References: Faxen 1922 (Annalen der Physik 68, 89); Batchelor 1970 (Journal of Fluid Mechanics 41,
545, the stresslet); Mindlin 1936 (Physics 7, 195, point force below a free surface).

*Validity*: Poisson's ratio 1/2, small strain, bonded beads some hundred times stiffer than the
rubber, no closer than about four radii to each other and to the surface (there terms of order (a /
distance)^2 next to the stated ones, left out here, are 5 % of the change). The body's far faces are
left out of the response of a bead, not of the load's field.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Points

_CHUNK = 32
"""Points at a time in `dipole_displacement`: keeps its memory near 20 MB for 636 beads."""

_COMPONENT = ((0, 5, 4), (5, 1, 3), (4, 3, 2))
"""Where a symmetric tensor's entry stands among xx, yy, zz, yz, xz, xy."""

_TINY = 1e-30
"""Imaginary step, mm: derivatives of an analytic formula to the last digit, as nothing is
subtracted."""


def mean_on_sphere(
    field: Callable[[Points], Points], centres: Points, radius_mm: float | Floats
) -> Points:
    """Return the (n, 3) mean of ``field`` over spheres of one radius or of (n,): Faxen's law, u +
    a^2/6 laplacian(u).

    Six points do: their mean is that of the sphere up to fourth derivatives of the field.
    """
    arms = np.concatenate([np.eye(3), -np.eye(3)])[:, None] * np.reshape(radius_mm, (-1, 1))
    return np.asarray(field((centres + arms).reshape(-1, 3)).reshape(6, -1, 3).mean(axis=0))


def stresslet(strain: Floats, radius_mm: float | Floats, shear_modulus_mpa: float) -> Floats:
    """Return the (n, 3, 3) force dipole, N mm, by which rigid beads of one radius or (n,) push back
    on rubber of strain (n, 3, 3): -(20/3) pi G a^3 e at nu = 1/2, force along j at an arm along k.

    Its sum over a share of volume phi is the stress of a material 1 + 5/2 phi times as stiff
    (Einstein, Smallwood).
    """
    volumes = np.reshape(np.asarray(radius_mm, float) ** 3, (-1, 1, 1))
    return np.asarray(-20.0 / 3.0 * math.pi * shear_modulus_mpa * volumes * strain)


def point_force(points: Any, sources: Any, shear_modulus_mpa: float, direct: Any = True) -> Any:
    """Return (..., 3, 3) u_i at ``points`` under a unit force along j at ``sources``, (..., 3) mm
    with z >= 0, mm/N: Mindlin at nu = 1/2. Without ``direct`` (...) only the free surface's
    reflection is left. Complex places are taken, so that derivatives may be found by an imaginary
    step."""
    away = points - sources
    x, y, less = away[..., 0], away[..., 1], away[..., 2]
    deep, high = sources[..., 2], points[..., 2]
    more = deep + high
    # Kelvin's solution: the force in an endless body.
    near = x * x + y * y + less * less
    near = np.sqrt(np.where(direct, near, 1.0))
    a1 = np.where(direct, 1.0 / near, 0.0)
    b1 = np.where(direct, near**-3, 0.0)
    # Its image above the surface, and the terms that make the surface free (R. D. Mindlin 1936).
    far = np.sqrt(x * x + y * y + more * more)
    a2 = 1.0 / far
    b2 = far**-3
    bend = 6.0 * deep * high / far**5
    both = b1 + b2
    both_less = both - bend
    even = a1 + a2 + 2.0 * deep * high * b2
    out = np.empty((*x.shape, 3, 3), np.result_type(x, float))
    out[..., 0, 0] = even + x * x * both_less
    out[..., 1, 1] = even + y * y * both_less
    out[..., 0, 1] = out[..., 1, 0] = x * y * both_less
    for i, along in enumerate((x, y)):
        out[..., 2, i] = along * (less * both - bend * more)
        out[..., i, 2] = along * (less * both + bend * more)
    out[..., 2, 2] = (
        a1 + a2 + less * less * b1 + (more * more - 2.0 * deep * high) * b2 + bend * more * more
    )
    return out / (8.0 * math.pi * shear_modulus_mpa)


def dipole_displacement(
    points: Points,
    centres: Points,
    dipoles: Floats,
    shear_modulus_mpa: float,
    own: np.ndarray | None = None,
) -> Points:
    """Return the (n, 3) displacement in mm of ``points`` under force dipoles (m, 3, 3), N mm, at
    ``centres`` (m, 3). Of centre ``own`` (n,) only the free surface's reflection counts, -1 for
    none."""
    out = np.zeros((len(points), 3))
    for some, k, slope in _slopes(points, centres, shear_modulus_mpa, own):
        out[some] += np.einsum("nmij,mj->ni", slope, dipoles[:, :, k])
    return out


def shift_per_strain(points: Points, centres: Points, own: np.ndarray) -> NDArray[np.float32]:
    """Return (3 n, 6 m) by how many mm ``points`` move per unit strain, xx, yy, zz, yz, xz, xy, at
    beads of radius 1 mm at ``centres`` (m, 3); the modulus cancels. ``own`` as in
    `dipole_displacement`."""
    out = np.zeros((len(points), 3, len(centres), 6), np.float32)
    size = float(stresslet(np.ones((1, 1, 1)), 1.0, 1.0)[0, 0, 0])
    for some, k, slope in _slopes(points, centres, 1.0, own):
        for j in range(3):
            out[some, :, :, _COMPONENT[j][k]] += size * slope[:, :, :, j].swapaxes(1, 2)
    return out.reshape(3 * len(points), -1)


def _slopes(
    points: Points, centres: Points, shear_modulus_mpa: float, own: np.ndarray | None
) -> Iterator[tuple[slice, int, Floats]]:
    """Yield some points, an axis k, and (some, m, 3, 3) d/dk of `point_force` as its source
    moves."""
    for start in range(0, len(points), _CHUNK):
        some = slice(start, start + _CHUNK)
        direct = np.ones((len(points[some]), len(centres)), bool)
        if own is not None:
            inside = np.flatnonzero(own[some] >= 0)
            direct[inside, own[some][inside]] = False
        here = np.broadcast_to(points[some, None], (*direct.shape, 3))
        for k in range(3):
            there = np.broadcast_to(centres + 1j * _TINY * np.eye(3)[k], here.shape)
            moved = point_force(here, there, shear_modulus_mpa, direct)
            yield some, k, moved.imag / _TINY
