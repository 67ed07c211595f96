"""The rubber: isotropic, quasi-static; rate, creep and hysteresis are outside the model."""

from __future__ import annotations

from typing import Literal, TypeVar

from pydantic import Field

from twin.arrays import Floats
from twin.parts.part import LEAST_MM, LEAST_MPA, Part, Share

Modulus = TypeVar("Modulus", float, Floats)


class Material(Part):
    """Elastic rubber.

    Attributes
    ----------
    youngs_modulus_mpa
        Young's modulus E, MPa.
    poisson_ratio
        Poisson's ratio nu; exactly 0.5 is incompressible and is solved as such.
    law
        ``linear``: strain is taken for small. ``neo_hookean``: presses are solved at finite strain
        (`twin.world.contact.finite_strain` says which), E and nu being those at rest.
    refractive_index
        Of the transparent rubber, for the camera's rays.
    """

    youngs_modulus_mpa: float = Field(default=1.0, ge=LEAST_MPA, le=1e6)
    poisson_ratio: float = Field(default=0.5, ge=-0.5, le=0.5)
    law: Literal["linear", "neo_hookean"] = "linear"
    refractive_index: float = Field(default=1.41, ge=1, le=3)


class Cover(Part):
    """The black sheet on the sensing surface: it occupies depths 0 to ``thickness_mm``.

    Attributes
    ----------
    thickness_mm
        Thickness, mm.
    albedo
        Diffuse reflectance, red, green, blue.
    deforms
        Whether pictures show how a press tilts and lifts it. At the papers' albedo that is less
        than a count, and it costs a field at some thousand places; so it is left out unless asked
        for.
    youngs_modulus_mpa, poisson_ratio
        Its own modulus, MPa, and Poisson's ratio; those of the body if not given.
    """

    thickness_mm: float = Field(default=0.2, ge=LEAST_MM, le=5)
    albedo: tuple[Share, Share, Share] = (0.03, 0.03, 0.03)
    deforms: bool = False
    youngs_modulus_mpa: float | None = Field(default=None, ge=LEAST_MPA, le=1e6)
    poisson_ratio: float | None = Field(default=None, ge=-0.5, le=0.5)


def shear_modulus(youngs_modulus_mpa: Modulus, poisson_ratio: Modulus) -> Modulus:
    """Return G = E / (2 (1 + nu)), in the unit of E."""
    return youngs_modulus_mpa / (2.0 * (1.0 + poisson_ratio))


def plane_strain_modulus(youngs_modulus_mpa: Modulus, poisson_ratio: Modulus) -> Modulus:
    """Return E* = E / (1 - nu^2), in the unit of E: of contact with a rigid body (Johnson 1985,
    section 4.2)."""
    return youngs_modulus_mpa / (1.0 - poisson_ratio**2)


def compressibility(youngs_modulus_mpa: Modulus, poisson_ratio: Modulus) -> Modulus:
    """Return 1 / kappa = 3 (1 - 2 nu) / E, kappa the bulk modulus; 0 at nu = 1/2."""
    return 3.0 * (1.0 - 2.0 * poisson_ratio) / youngs_modulus_mpa
