"""How far linear elasticity is off under a press: strain and turn of a gradient, and a law for the
error they cost.

The law is first order: the terms that linear theory drops are products of two gradients, so the
relative error goes with the strain. Its strain is the mean contact pressure over Young's modulus,
which a press knows whatever its markers do. The factors are the largest that neo-Hookean rubber
showed in ``benchmarks/validity.py`` under the papers' presses, rounded up (docs/validity.md has the
table): an upper edge, up to five times what was found under a sphere. `Material.law` replaces it
by what is found under the press itself.

Validity: the presses, the markers and the rubber of that study, to which the factors were fitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats


@dataclass(frozen=True)
class _Law:
    """Error of the markers' displacement, relative to the largest one, = ``factor`` times mean
    contact pressure / Young's modulus; beyond the largest strain of the study, ``known_strain``,
    the law is a guess."""

    factor: float
    known_strain: float

    def error(self, mean_strain: float) -> float:
        """Return the error to expect at most, relative to the largest displacement."""
        return self.factor * mean_strain


SHEARED = 0.05
"""Force sideways over push from which on a probe counts as sheared: on a slope it always carries a
little."""


def law_of(probe: str, *, sheared: bool) -> _Law:
    """Return the law of a probe (``sphere``, ``cylinder`` or ``pillar``), sheared by friction or
    not."""
    if probe != "sphere":
        return _Law(factor=0.45, known_strain=0.16)
    return _Law(factor=0.1, known_strain=0.4 if sheared else 0.55)


ERROR_BOUND = 0.01
"""Expected error above which a press gets a note, or a warning where the law is not known."""

KNOWN_RADIUS = 0.72
"""Largest contact radius over a sphere's radius in the study; linear contact's indentation is up to
9 % less there."""


def largest_strain_and_turn(gradient: Floats) -> tuple[float, float]:
    """Return the largest principal strain (absolute) and the largest turn (degrees) in displacement
    gradients (n, 3, 3), du_i/dx_j.

    The parts of linear theory: strain is the symmetric one, the turn the length of the skew one's
    axial vector.
    """
    gradient = np.asarray(gradient, float)
    if not len(gradient):
        return 0.0, 0.0
    swapped = gradient.transpose(0, 2, 1)
    strain = np.abs(np.linalg.eigvalsh((gradient + swapped) / 2.0)).max()
    turn = np.linalg.norm((gradient - swapped) / 2.0, axis=(1, 2)).max() / math.sqrt(2.0)
    return float(strain), math.degrees(float(turn))
