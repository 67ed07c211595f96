"""Contact of a rigid probe with an elastic half-space: Hertz, flat punches and cones; and how far
linear theory is off under a press.

Formulas of contact are from K. L. Johnson, *Contact Mechanics* (Cambridge, 1985), whose sections
are named. The half-space has Young's modulus E and Poisson's ratio nu; the probe is rigid, so that
Johnson's E* is the plane-strain modulus E / (1 - nu^2). Lengths are in mm, forces in N, moduli and
pressures in MPa.

Linear theory drops products of two gradients, so its relative error goes with the strain: the mean
contact pressure over Young's modulus, times a factor that grows with the contact's radius over the
rubber's thickness. Factors are the largest that neo-Hookean rubber showed under the papers'
presses, and under spheres on layers of 1.5 to 40 mm (docs/validity.md). `Material.law` replaces it
by what is found under the press itself. Validity: these presses, markers and rubber.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError
from twin.parts.material import plane_strain_modulus


@dataclass(frozen=True, kw_only=True)
class _HertzContact:
    """A rigid sphere of ``radius_mm`` pressed without friction on a half-space: radius a of the
    contact, approach from first touch, normal force, and pressure in the middle, 3/2 of the mean.
    """

    radius_mm: float
    contact_radius_mm: float
    indentation_mm: float
    force_n: float
    peak_pressure_mpa: float

    def pressure(self, distance_mm: Floats) -> Floats:
        """Return p0 sqrt(1 - r^2/a^2), MPa, at distances r (any shape); 0 outside (section 3.4)."""
        inside = 1.0 - (np.asarray(distance_mm, float) / self.contact_radius_mm) ** 2
        return self.peak_pressure_mpa * np.sqrt(np.maximum(inside, 0.0))


def hertz(
    *,
    radius_mm: float,
    youngs_modulus_mpa: float,
    poisson_ratio: float,
    force_n: float | None = None,
    indentation_mm: float | None = None,
) -> _HertzContact:
    """Return Hertz's contact of a rigid sphere for a given force or a given indentation.

    Parameters
    ----------
    radius_mm
        Radius R of the sphere.
    youngs_modulus_mpa, poisson_ratio
        Of the half-space.
    force_n, indentation_mm
        Exactly one of them, greater than 0.

    Raises
    ------
    InputError
        Neither or both of force and indentation are given, or not greater than 0; no solid has this
        modulus and Poisson's ratio.

    Notes
    -----
    a = (3 F R / (4 E*))^(1/3), d = a^2 / R, p0 = 3 F / (2 pi a^2) (Johnson 1985, section 4.2).
    Validity: a/R below about 0.3, no friction, a body much thicker and wider than a.
    """
    if (force_n is None) == (indentation_mm is None):
        raise InputError("hertz: give exactly one of force_n and indentation_mm")
    given = force_n if force_n is not None else indentation_mm
    if given is None or not given > 0 or not radius_mm > 0:
        raise InputError(
            f"hertz: radius, force and indentation must be greater than 0, got {radius_mm} mm "
            f"and {given}"
        )
    modulus = plane_strain_modulus(youngs_modulus_mpa, poisson_ratio)
    if force_n is not None:
        a = (3.0 * force_n * radius_mm / (4.0 * modulus)) ** (1.0 / 3.0)
        force = force_n
    else:
        a = math.sqrt(radius_mm * given)
        force = 4.0 * modulus * a**3 / (3.0 * radius_mm)
    return _HertzContact(
        radius_mm=radius_mm,
        contact_radius_mm=a,
        indentation_mm=a * a / radius_mm,
        force_n=force,
        peak_pressure_mpa=3.0 * force / (2.0 * math.pi * a * a),
    )


def punch_pressure(distance_mm: Floats, radius_mm: float, force_n: float) -> Floats:
    """Return the pressure under a rigid flat-ended cylinder without friction.

    Parameters
    ----------
    distance_mm
        Distances r from the axis, of any shape.
    radius_mm, force_n
        Radius a of the face, and the force F along the axis.

    Returns
    -------
    p = F / (2 pi a sqrt(a^2 - r^2)), MPa, in that shape; 0 from the rim on (Johnson 1985, section
    3.4). Validity: a half-space; towards the rim p grows without bound.
    """
    inside = radius_mm**2 - np.asarray(distance_mm, float) ** 2
    safe = np.where(inside > 0, inside, np.inf)
    return np.asarray(force_n / (2.0 * math.pi * radius_mm * np.sqrt(safe)))


def cone_contact_radius(
    force_n: float, apex_deg: float, youngs_modulus_mpa: float, poisson_ratio: float
) -> float:
    """Return the contact radius a, mm, of a rigid cone without friction.

    Parameters
    ----------
    force_n
        Force F along the axis.
    apex_deg
        The whole angle at the tip, 2 alpha.
    youngs_modulus_mpa, poisson_ratio
        Of the half-space.

    Notes
    -----
    F = (pi / 2) E* a^2 cot(alpha) (Johnson 1985, section 5.2). Validity: blunt cones, as the linear
    theory takes the slope cot(alpha) for small.
    """
    slope = 1.0 / math.tan(math.radians(apex_deg / 2))
    modulus = plane_strain_modulus(youngs_modulus_mpa, poisson_ratio)
    return math.sqrt(force_n / (math.pi / 2 * modulus * slope))


@dataclass(frozen=True)
class _Law:
    """Markers' error over the largest displacement = ``factor`` times mean contact pressure /
    Young's modulus; known up to a strain of ``known_strain``."""

    factor: float
    known_strain: float


SHEARED = 0.05
"""Force sideways over push from which on a probe counts as sheared: on a slope it always carries a
little."""


def law_of(probe: str, wide: float, *, sheared: bool) -> _Law:
    """Return the law of a probe (``sphere``, ``cylinder`` or ``pillar``), sheared by friction or
    not, whose contact's radius is ``wide`` times the rubber's thickness."""
    thin = 0.47 * wide
    if probe != "sphere":
        return _Law(factor=min(max(0.45, thin), 0.52), known_strain=0.16)
    return _Law(factor=min(max(0.13, thin), 0.46), known_strain=0.4 if sheared else 0.55)


ERROR_BOUND = 0.01
"""Expected error above which a press gets a note, or a warning where the law is not known."""

KNOWN_RADIUS = 0.72
"""Largest contact radius over a sphere's radius in the study; linear contact's indentation is up to
9 % less there."""


def largest_strain_and_turn(gradient: Floats) -> tuple[float, float]:
    """Return the largest principal strain (absolute) and the largest turn (degrees) in displacement
    gradients (n, 3, 3), du_i/dx_j: by linear theory, of the symmetric and of the skew part.
    """
    gradient = np.asarray(gradient, float)
    if not len(gradient):
        return 0.0, 0.0
    swapped = gradient.transpose(0, 2, 1)
    strain = np.abs(np.linalg.eigvalsh((gradient + swapped) / 2.0)).max()
    turn = np.linalg.norm((gradient - swapped) / 2.0, axis=(1, 2)).max() / math.sqrt(2.0)
    return float(strain), math.degrees(float(turn))
