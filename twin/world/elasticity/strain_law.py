"""The stress of rubber at finite strain: one object a law.

A law splits the first Piola-Kirchhoff stress of rubber of shear modulus 1 into a part of its own
and a pressure,

    P = S(F) + q cof F,    (J - 1) - q / (lambda - b) = 0 weakly,    J = det F,

with S = 0 and dS = 2 e + b tr(e) I at rest (e the small strain), so that at rest the law *is*
linear theory for every Poisson's ratio (lambda = 2 nu / (1 - 2 nu), endless at nu = 1/2). Between
the points where q sees the volume only S resists: a law whose S would give way there takes b > 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin.arrays import Floats
from twin.parts.material import Material

LEAST_POISSON = 0.44
"""The laws are tried for rubber, from here to 1/2: 0.45, and what casting may take off it."""

_MOST_BULK = 0.5
"""Largest share of lambda that a law takes itself."""


class StrainLaw(Protocol):
    """The law's own stress and its slope."""

    @property
    def bulk(self) -> float:
        """b: how much of the volume's stiffness lambda is in the law's own stress; mostly 0."""
        ...

    @property
    def stiffens(self) -> bool:
        """Whether the shear modulus depends on the strain."""
        ...

    def stress(self, gradient: Floats, cofactor: Floats, ratio: Floats) -> Floats:
        """Return S (..., 3, 3) of F (..., 3, 3), its cofactors, and its determinant (...)."""
        ...

    def slope(
        self, gradient: Floats, cofactor: Floats, ratio: Floats, cofactor_change: Floats
    ) -> Floats:
        """Return dS_ij / dF_kl (..., 3, 3, 3, 3); ``cofactor_change`` is d cof F_ij / dF_kl."""
        ...


@dataclass(frozen=True)
class _Polynomial:
    """W = c1 (I1 - 3) + c2 (I2 - 3) + c11 (I1 - 3)^2 + c111 (I1 - 3)^3 - p(J), with c1 + c2 = 1/2.

    I1 = F:F and I2 = cof F : cof F (Rivlin and Saunders 1951; Yeoh 1993). The last term is
    quadratic in J and takes off the stress at rest. No step of a solver leaves a polynomial's
    domain, even where an element is inverted on the way.

    Attributes
    ----------
    c2, c11, c111
        Over the shear modulus; all 0 is neo-Hooke's law.
    bulk
        See `StrainLaw`.
    """

    c2: float = 0.0
    c11: float = 0.0
    c111: float = 0.0
    bulk: float = 0.0

    def stress(self, gradient: Floats, cofactor: Floats, ratio: Floats) -> Floats:
        """See `StrainLaw`."""
        first, _ = self._of_first_invariant(gradient)
        out = first[..., None, None] * gradient
        if self.c2:
            second = cofactor_slope(gradient).reshape(*gradient.shape[:-2], 9, 9)
            crossed = second @ cofactor.reshape(*gradient.shape[:-2], 9, 1)
            out += 2.0 * self.c2 * crossed.reshape(gradient.shape)
        pull, change = self._of_volume
        out -= (pull + change * (ratio - 1.0))[..., None, None] * cofactor
        return np.asarray(out)

    def slope(
        self, gradient: Floats, cofactor: Floats, ratio: Floats, cofactor_change: Floats
    ) -> Floats:
        """See `StrainLaw`."""
        pull, change = self._of_volume
        out = -(pull + change * (ratio - 1.0))[..., None, None, None, None] * cofactor_change
        out -= change * _outer(cofactor)
        first, bend = self._of_first_invariant(gradient)
        for i in range(3):
            for j in range(3):
                out[..., i, j, i, j] += first
        if self.stiffens:
            out += 2.0 * bend[..., None, None, None, None] * _outer(gradient)
        if self.c2:
            # cof is quadratic in F: its slope along dF is the cross product of F and dF
            flat = cofactor_change.reshape(*gradient.shape[:-2], 9, 9)
            out += 2.0 * self.c2 * (cofactor_slope(cofactor) + (flat @ flat).reshape(out.shape))
        return out

    @property
    def stiffens(self) -> bool:
        """See `StrainLaw`."""
        return bool(self.c11 or self.c111)

    @property
    def _of_volume(self) -> tuple[float, float]:
        """p'(1) and p''(1): no stress at rest, and no stiffness there but shear and `bulk`."""
        return 1.0 + 2.0 * self.c2, 8.0 * self.c11 - 1.0 + 2.0 * self.c2 - self.bulk

    def _of_first_invariant(self, gradient: Floats) -> tuple[Floats, Floats]:
        """Return 2 dW/dI1 (...) and its slope by I1."""
        more = np.einsum("...ij,...ij->...", gradient, gradient) - 3.0
        first = 1.0 - 2.0 * self.c2 + 4.0 * self.c11 * more + 6.0 * self.c111 * more**2
        return first, 4.0 * self.c11 + 12.0 * self.c111 * more


def _outer(matrix: Floats) -> Floats:
    return np.asarray(matrix[..., :, :, None, None] * matrix[..., None, None, :, :])


def strain_law(material: Material) -> StrainLaw:
    """Return the law that a scene names (`Material.law`); linear theory has none here."""
    ratios = material.law_ratios
    if material.law == "mooney_rivlin":
        return _Polynomial(c2=0.5 * ratios[0] / (1.0 + ratios[0]))
    if material.law == "yeoh":
        # p'' > 0 would feed changes of volume wherever (I1 - 3)^2 has become softer than at rest
        nu = material.poisson_ratio
        lame = 2.0 * nu / (1.0 - 2.0 * nu) if nu < 0.5 else math.inf
        bulk = max(min(4.0 * ratios[0] + 2.0 * ratios[1] - 1.0, _MOST_BULK * lame), 0.0)
        return _Polynomial(c11=0.5 * ratios[0], c111=0.5 * ratios[1], bulk=bulk)
    return _Polynomial()


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
