"""A rigid sphere that is pressed, and then sheared or twisted in partial slip: stick radius, motion and torque.

Every formula is for Hertz's pressure of a normal force P over a circle of radius a on a half-space, held constant while
the sphere is sheared or twisted, and for one coefficient mu of friction. Slip then starts at the border and eats its
way in: inside a circle of radius c the contact sticks. The names and units are those of `twin.theory.contact`.

Validity: the tangential traction does not change the pressure (exact for twist, and at Poisson's ratio 0.5). For shear
the traction is taken as parallel to the force everywhere, while the true slip is not quite collinear with it: a few per
cent of the slip at the border (K. L. Johnson, *Contact Mechanics* (Cambridge, 1985), section 7.2).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ellipe, ellipkm1

from twin.theory.contact import shear_modulus, tangential_stiffness

_RINGS = 64


def stick_radius(radius_mm: float, side_force_n: float, normal_force_n: float, friction: float) -> float:
    """Return c = a (1 - Q / (mu P))^(1/3), mm, of a sheared sphere (Cattaneo, Mindlin; Johnson 1985, section 7.2)."""
    return float(radius_mm * np.cbrt(1.0 - side_force_n / (friction * normal_force_n)))


def sheared_motion(
    radius_mm: float,
    side_force_n: float,
    normal_force_n: float,
    friction: float,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
) -> float:
    """Return the sideways motion of a sheared sphere, mm.

    Notes
    -----
    d = 3 mu P (2 - nu) / (16 G a) (1 - (1 - Q / (mu P))^(2/3)) (Johnson 1985, section 7.2, with a rigid second body).
    It tends to Q over `tangential_stiffness` for a small Q, and to 3/2 of that as the whole contact slips.
    """
    most = friction * normal_force_n
    stiffness = tangential_stiffness(radius_mm, youngs_modulus_mpa, poisson_ratio)
    return 1.5 * most / stiffness * (1.0 - float(np.cbrt(1.0 - side_force_n / most)) ** 2)


def twisted(
    stick_radius_mm: float,
    radius_mm: float,
    normal_force_n: float,
    friction: float,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
) -> tuple[float, float]:
    """Return turn (radians) and torque (N mm) at which a twisted sphere sticks inside a given radius.

    Notes
    -----
    J. L. Lubkin, J. Appl. Mech. 18 (1951) 183, worked out anew: a traction made of stuck punches of radii r from c to
    a, each turned by d theta(r), turns everything within c by theta = sum of d theta. Asking for mu p(r) outside c is
    an Abel equation, with the solution

        theta(c) = mu p0 / (2 G) (K(k) - E(k)),   k^2 = 1 - c^2 / a^2,   p0 = 3 P / (2 pi a^2)
        T(c) = 16/3 G (c^3 theta(c) + 3 integral over r from c to a of r^2 theta(r)),

    K and E being the complete elliptic integrals. As c tends to a it is the stuck contact's `torsional_stiffness`, as
    c tends to 0 the torque tends to 3 pi / 16 mu P a.
    """
    rigidity = shear_modulus(youngs_modulus_mpa, poisson_ratio)
    most = friction * 1.5 * normal_force_n / (math.pi * radius_mm**2)

    def turn(radius: np.ndarray) -> np.ndarray:
        squared = (radius / radius_mm) ** 2
        return np.asarray(most / (2.0 * rigidity) * (ellipkm1(squared) - ellipe(1.0 - squared)))

    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    half = (radius_mm - stick_radius_mm) / 2.0
    rings = stick_radius_mm + half * (1.0 + nodes)
    theta = float(turn(np.array(stick_radius_mm)))
    rest = 3.0 * half * float(weights @ (rings**2 * turn(rings)))
    return theta, 16.0 / 3.0 * rigidity * (stick_radius_mm**3 * theta + rest)
