"""The law of friction: how large the tangential force on a patch may be under its normal force.

To change the law, change this file: another class with the two methods of `FrictionLaw`, as `LAW`
(docs/add_friction_law.md). The solver (`twin.world.contact.coulomb`) projects tangential forces on
the disc whose radius is the law's bound, and takes the slope of the bound for its Jacobian; at
finite strain `twin.world.contact.whole_body` does so at points of the surface. What
the normal force is, whether a patch sticks or slips and how the probe is balanced does not depend
on the law.

Validity: isotropic laws, with the same bound at rest and in motion.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from twin.arrays import Floats

STICKS_FROM = 1e3
"""Coefficient of friction from which a press is solved as sticking. Five light presses moved
sideways that settle either way have the forces of sticking to 1e-13 and its tractions to 1e-10 of
the largest; under others, patches at the border that carry a thousandth of a tangential force as
normal force let Newton's steps swing between stick and open."""


class FrictionLaw(Protocol):
    """The largest tangential force on patches."""

    def bound(self, friction: Floats, push: Floats, area_mm2: Floats) -> Floats:
        """Return (k,) the largest tangential forces, N.

        Parameters
        ----------
        friction
            (k,) coefficients of friction; 0 slides freely, inf sticks.
        push
            (k,) normal forces, N; of those that are not positive the bound is 0.
        area_mm2
            (k,) areas of the patches, for laws of the pressure.
        """
        ...

    def slope(self, friction: Floats, push: Floats, area_mm2: Floats) -> Floats:
        """Return (k,) the derivatives of the bound with respect to positive normal forces."""
        ...


class _CoulombLaw:
    """|f_t| <= mu f_n (Amontons and Coulomb)."""

    def bound(self, friction: Floats, push: Floats, area_mm2: Floats) -> Floats:
        """See `FrictionLaw`; of a patch that sticks there is no limit while it is pushed."""
        return np.where(push > 0.0, np.where(push > 0.0, push, 1.0) * friction, 0.0)

    def slope(self, friction: Floats, push: Floats, area_mm2: Floats) -> Floats:
        return friction


LAW: FrictionLaw = _CoulombLaw()
"""The law of all presses."""
