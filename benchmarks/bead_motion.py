"""How rigid beads move in a given field, to any order in their interaction, by closed forms.

The product keeps the first order only, as a map (`twin.world.elasticity.rigid_beads`); this states what that leaves
out.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points
from twin.theory.inclusions import dipole_displacement, mean_on_sphere, stresslet


@dataclass(frozen=True, kw_only=True)
class BeadMotion:
    """Motion of beads, (n, 3) mm: of passive points at their centres; what is added where a bead is alone; and what
    the push-back of all beads adds (of the bead itself: its reflection at the free surface)."""

    passive: Points
    alone: Points
    together: Points

    @property
    def change(self) -> Points:
        """Motion of the beads less that of passive points."""
        return self.alone + self.together


def bead_motion(
    field: Callable[[Points], Points],
    gradient: Callable[[Points], Floats],
    centres: Points,
    radius_mm: float,
    shear_modulus_mpa: float,
    rounds: int = 1,
) -> BeadMotion:
    """Return how beads at ``centres`` (n, 3) under the free surface z = 0 move in a field and its gradient.

    With one round each bead feels the strain of the field alone, with two also that of the other beads' push-back.
    """
    strain = outer = _symmetric(gradient(centres))
    passive = field(centres)
    alone = mean_on_sphere(field, centres, radius_mm) - passive
    own = np.arange(len(centres))
    step = 0.01 * radius_mm

    def pushed(points: Points) -> Points:
        return dipole_displacement(points, centres, dipole, shear_modulus_mpa, own)

    dipole = stresslet(strain, radius_mm, shear_modulus_mpa)
    for _ in range(rounds - 1):
        slopes = [(pushed(centres + step * axis) - pushed(centres - step * axis)) / (2 * step) for axis in np.eye(3)]
        strain = outer + _symmetric(np.stack(slopes, axis=-1))
        dipole = stresslet(strain, radius_mm, shear_modulus_mpa)
    return BeadMotion(passive=passive, alone=alone, together=pushed(centres))


def _symmetric(gradient: Floats) -> Floats:
    return np.asarray(0.5 * (gradient + gradient.swapaxes(1, 2)))
