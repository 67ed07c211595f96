"""Contact of a rigid probe with an elastic half-space: what the solver is compared with.

Every formula is from K. L. Johnson, *Contact Mechanics* (Cambridge, 1985), with the units of `twin.theory.contact`,
which holds those that a run itself needs: mm, N, N mm, radians and MPa.

`stick_radius`, `sheared_motion` and `twisted` are of a sphere sheared or twisted in partial slip, under a constant
normal force with Hertz's pressure and one coefficient of friction. Slip starts at the border; inside the stick radius
the contact sticks. Validity: the traction does not change the pressure (exact for twist, and at nu = 0.5); under shear
it is taken as parallel to the force, which is a few per cent off for the slip at the border (Johnson, section 7.2).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ellipe, ellipkm1

from twin.parts.material import plane_strain_modulus, shear_modulus


def punch_stiffness(radius_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return F / d = 2 a E* of a frictionless flat-ended cylinder (section 3.4).

    At nu = 0.5 also of the stuck punch, whose normal and tangential parts are then uncoupled.
    """
    return 2.0 * radius_mm * plane_strain_modulus(youngs_modulus_mpa, poisson_ratio)


def cone_indentation(contact_radius_mm: float, apex_deg: float) -> float:
    """Return (pi / 2) a cot(alpha), the approach of a cone from first touch (section 5.2)."""
    return math.pi / 2 * contact_radius_mm / math.tan(math.radians(apex_deg / 2))


def rocking_stiffness(radius_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return M / angle = 4 E* a^3 / 3 of a frictionless flat-ended cylinder that is tilted.

    A pressure proportional to x / sqrt(a^2 - r^2) tilts the surface under it (section 3.3). Validity: the whole face
    stays in contact, so the tilt is at most F / (2 a^2 E*).
    """
    return 4.0 / 3.0 * plane_strain_modulus(youngs_modulus_mpa, poisson_ratio) * radius_mm**3


def square_punch_stiffness(side_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return F / d = 1.1523 E* side of a frictionless flat-ended square pillar.

    Pressure under a frictionless flat punch is distributed like charge on a plate of its shape, so F / d is E* pi times
    the plate's capacitance in units of 4 pi epsilon0 (section 3.3 gives the analogy's kernel); for the unit square that
    is 0.36679 (F. H. Read, J. Comput. Phys. 133 (1997) 1). For a disc it is 2 a / pi, which gives `punch_stiffness`.
    """
    return math.pi * 0.36679 * side_mm * plane_strain_modulus(youngs_modulus_mpa, poisson_ratio)


def bonded_punch_stiffness(radius_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return F / d = 4 G a ln(3 - 4 nu) / (1 - 2 nu) of a stuck flat-ended cylinder (section 3.8, Mossakovski).

    It tends to `punch_stiffness` as nu tends to 0.5 and is 10 % above it at nu = 0.
    """
    ratio = 2.0 if poisson_ratio == 0.5 else math.log1p(2.0 - 4.0 * poisson_ratio) / (1.0 - 2.0 * poisson_ratio)
    return 4.0 * shear_modulus(youngs_modulus_mpa, poisson_ratio) * radius_mm * ratio


def tangential_stiffness(radius_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return Q / d = 8 G a / (2 - nu) of a stuck circular contact moved sideways (section 7.2: Cattaneo, Mindlin).

    The second body is rigid. Validity: the coupling of tangential traction to normal displacement is neglected, which
    is exact at nu = 0.5.
    """
    return 8.0 * shear_modulus(youngs_modulus_mpa, poisson_ratio) * radius_mm / (2.0 - poisson_ratio)


def oblique_motion(radius_mm: float, force_n: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return the sideways motion of a stuck sphere whose lateral force grows in proportion to its normal force.

    Radius and lateral force are the final ones. The stiffness 8 G a / (2 - nu) grows with a while the force grows like
    a^3: integrating dQ / stiffness gives 3/2 of the motion under the same force at the final radius (sections 7.2 and
    7.3: the limit without slip).
    """
    return 1.5 * force_n / tangential_stiffness(radius_mm, youngs_modulus_mpa, poisson_ratio)


def torsional_stiffness(radius_mm: float, youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return T / angle = 16 G a^3 / 3 of a stuck circular contact turned about its normal, for every nu.

    Section 3.9, after Reissner and Sagoci.
    """
    return 16.0 / 3.0 * shear_modulus(youngs_modulus_mpa, poisson_ratio) * radius_mm**3


_RINGS = 64


def stick_radius(radius_mm: float, side_force_n: float, normal_force_n: float, friction: float) -> float:
    """Return c = a (1 - Q / (mu P))^(1/3) of a sheared sphere (section 7.2: Cattaneo, Mindlin)."""
    return float(radius_mm * np.cbrt(1.0 - side_force_n / (friction * normal_force_n)))


def sheared_motion(
    radius_mm: float,
    side_force_n: float,
    normal_force_n: float,
    friction: float,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
) -> float:
    """Return the sideways motion of a sheared sphere (section 7.2, with a rigid second body).

    It is 3 mu P (2 - nu) / (16 G a) (1 - (1 - Q / (mu P))^(2/3)), which tends to Q over `tangential_stiffness` for a
    small Q, and to 3/2 of that as the whole contact slips.
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
    """Return turn and torque at which a twisted sphere sticks inside a given radius.

    J. L. Lubkin, J. Appl. Mech. 18 (1951) 183, derived here: a traction made of stuck punches of radii r from c to a,
    each turned by d theta(r), turns everything within c by theta = sum of d theta. Asking for mu p(r) outside c is an
    Abel equation, with the solution

        theta(c) = mu p0 / (2 G) (K(k) - E(k)),   k^2 = 1 - c^2 / a^2,   p0 = 3 P / (2 pi a^2)
        T(c) = 16/3 G (c^3 theta(c) + 3 integral over r from c to a of r^2 theta(r)),

    K and E being the complete elliptic integrals. As c tends to a it is the stuck contact's `torsional_stiffness`, as c
    tends to 0 the torque tends to 3 pi / 16 mu P a.
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
