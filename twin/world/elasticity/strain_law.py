"""The stress of rubber at finite strain: one object a law.

A law splits the first Piola-Kirchhoff stress of rubber of shear modulus 1 into a part of its own
and a pressure,

    P = S(F) + q cof F,    (J - 1) - q / lambda = 0 weakly,    J = det F,

with S = 0 and dS = 2 e - e_kk I at rest, so that at rest the law *is* linear theory for every
Poisson's ratio (lambda = 2 nu / (1 - 2 nu), endless at nu = 1/2).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from twin.arrays import Floats


class StrainLaw(Protocol):
    """The law's own stress and its slope."""

    def stress(self, gradient: Floats, cofactor: Floats, ratio: Floats) -> Floats:
        """Return S (..., 3, 3) of F (..., 3, 3), its cofactors, and its determinant (...)."""
        ...

    def slope(self, cofactor: Floats, ratio: Floats, cofactor_change: Floats) -> Floats:
        """Return dS_ij / dF_kl (..., 3, 3, 3, 3); ``cofactor_change`` is d cof F_ij / dF_kl."""
        ...


class NeoHooke:
    """W = (I1 - 3) / 2 - (J - 1) + (J - 1)^2 / 2: a polynomial, so no step of a solver leaves its
    domain, even where an element is inverted on the way."""

    def stress(self, gradient: Floats, cofactor: Floats, ratio: Floats) -> Floats:
        """See `StrainLaw`."""
        return gradient - (2.0 - ratio)[..., None, None] * cofactor

    def slope(self, cofactor: Floats, ratio: Floats, cofactor_change: Floats) -> Floats:
        """See `StrainLaw`."""
        out = (ratio - 2.0)[..., None, None, None, None] * cofactor_change
        out += cofactor[..., :, :, None, None] * cofactor[..., None, None, :, :]
        for i in range(3):
            for j in range(3):
                out[..., i, j, i, j] += 1.0
        return out


LAWS: dict[str, StrainLaw] = {"neo_hookean": NeoHooke()}
"""The laws by their names in a scene (`material.law`)."""

_TURNS = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _TURNS[_i, _j, _k] = 1.0
    _TURNS[_i, _k, _j] = -1.0
_PAIRS = np.einsum("ika,jlb->ijklab", _TURNS, _TURNS).reshape(81, 9)


def cofactors(gradient: Floats) -> tuple[Floats, Floats]:
    """Return cof F (..., 3, 3) of F (..., 3, 3), and J (...)."""
    a, b, c = np.moveaxis(gradient, -2, 0)
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    return rows, np.einsum("...i,...i->...", a, rows[..., 0, :])


def cofactor_slope(gradient: Floats) -> Floats:
    """Return d cof F_ij / dF_kl (..., 3, 3, 3, 3)."""
    flat = gradient.reshape(-1, 9) @ _PAIRS.T
    return np.asarray(flat.reshape(*gradient.shape[:-2], 3, 3, 3, 3))
