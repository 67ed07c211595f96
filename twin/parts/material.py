"""The rubber: isotropic; elastic, or relaxing with one function of time."""

from __future__ import annotations

import math
from typing import Literal, Self, TypeVar

from pydantic import Field, field_validator, model_validator

from twin.arrays import Floats
from twin.errors import InputError
from twin.parts.part import LEAST_MM, LEAST_MPA, Flag, Part, Share

Modulus = TypeVar("Modulus", float, Floats)


class Material(Part):
    """The rubber.

    Attributes
    ----------
    youngs_modulus_mpa
        Young's modulus E, MPa; where the rubber relaxes, the instantaneous one.
    poisson_ratio
        Poisson's ratio nu; exactly 0.5 is incompressible and is solved as such.
    law
        ``linear``: strain is taken for small. ``neo_hookean``: presses are solved at finite strain
        (those that `twin.world.contact.finite_strain` lists), E and nu being those at rest. So are
        they with ``mooney_rivlin`` and ``yeoh``, which take `law_ratios`.
    law_ratios
        C2/C1 of ``mooney_rivlin`` (0 or more); C2/C1 and C3/C1 of ``yeoh``, W = C1 (I1 - 3) +
        C2 (I1 - 3)^2 + C3 (I1 - 3)^3, which must not soften to no stiffness at any strain.
    relaxation
        Prony series of the modulus, E(t)/E = 1 - sum of share (1 - exp(-t/time_s)), at a constant
        Poisson's ratio and the same in a cover; elastic if empty. It acts in presses whose steps
        have ``seconds``. The shares are less than 1 together.
    refractive_index
        Of the transparent rubber, for the camera's rays; at 588 nm if there is an `abbe_number`.
    abbe_number
        Dispersion, (n_d - 1) / (n_F - n_C): silicone has about 50. None: one index for all light.
    """

    class Term(Part):
        """One term of a Prony series.

        Attributes
        ----------
        share
            By which share of the instantaneous modulus it relaxes.
        time_s
            Its time constant, s.
        """

        share: float = Field(gt=0, lt=1)
        time_s: float = Field(ge=1e-6, le=1e9)

    youngs_modulus_mpa: float = Field(default=1.0, ge=LEAST_MPA, le=1e6)
    poisson_ratio: float = Field(default=0.5, ge=-0.5, le=0.5)
    law: Literal["linear", "neo_hookean", "mooney_rivlin", "yeoh"] = "linear"
    law_ratios: tuple[float, ...] = ()
    relaxation: tuple[Term, ...] = Field(default=(), max_length=32)
    refractive_index: float = Field(default=1.41, ge=1, le=3)
    abbe_number: float | None = Field(default=None, ge=10, le=200)

    @field_validator("relaxation")
    @classmethod
    def _stays_solid(cls, terms: tuple[Term, ...]) -> tuple[Term, ...]:
        if sum(term.share for term in terms) >= 1.0:
            raise ValueError("the shares must be less than 1 together: the rubber would flow away")
        return terms

    @model_validator(mode="after")
    def _takes_its_ratios(self) -> Self:
        wanted = {"mooney_rivlin": ("C2/C1",), "yeoh": ("C2/C1", "C3/C1")}.get(self.law, ())
        given = self.law_ratios
        if len(given) != len(wanted):
            raise ValueError(
                f"law_ratios holds {len(given)} numbers; law = {self.law} takes "
                + (f"{' and '.join(wanted)}" if wanted else "none")
            )
        if self.law == "mooney_rivlin" and not 0.0 <= given[0] <= 10.0:
            raise ValueError(f"law_ratios: C2/C1 of mooney_rivlin is 0 to 10, not {given[0]:g}")
        if self.law == "yeoh":
            # dW/dI1 > 0: 1 + 2 r2 x + 3 r3 x^2 has no root at any x = I1 - 3 >= 0
            second, third = given
            if not 0.0 <= third <= 10.0 or not -math.sqrt(3.0 * third) < second + 1e-12 <= 10.0:
                raise ValueError(
                    "law_ratios: yeoh takes C3/C1 from 0 to 10 and C2/C1 from "
                    f"-sqrt(3 C3/C1) to 10, not {second:g} and {third:g}: it would soften away"
                )
        return self


class Cover(Part):
    """The black sheet on the sensing surface: it occupies depths 0 to ``thickness_mm``.

    Attributes
    ----------
    thickness_mm
        Thickness, mm.
    albedo
        Diffuse reflectance, red, green, blue.
    transmittance
        Share of the light that passes, so that the camera sees what lies behind: the probe, if
        ``press.albedo`` is given, and ``light.outside``.
    deforms
        Whether pictures show how a press tilts and lifts it. At the papers' albedo that is less
        than a count, and it costs a field at some thousand places; so it is left out unless asked
        for.
    shadows
        Whether the fast renderers draw the markers' shadows on it, and how a press moves it; paths
        always do the first. Dots close before a bright cover have dark ones beside them.
    youngs_modulus_mpa, poisson_ratio
        Its own modulus, MPa, and Poisson's ratio; those of the body if not given.
    """

    thickness_mm: float = Field(default=0.2, ge=LEAST_MM, le=5)
    albedo: tuple[Share, Share, Share] = (0.03, 0.03, 0.03)
    transmittance: Share = 0.0
    deforms: Flag = False
    shadows: Flag = False
    youngs_modulus_mpa: float | None = Field(default=None, ge=LEAST_MPA, le=1e6)
    poisson_ratio: float | None = Field(default=None, ge=-0.5, le=0.5)

    @model_validator(mode="after")
    def _light_is_shared(self) -> Cover:
        if max(self.albedo) + self.transmittance > 1:
            raise ValueError(
                f"transmittance = {self.transmittance:g}: with an albedo of {max(self.albedo):g} "
                "more light would leave the cover than falls on it; their sum must be at most 1"
            )
        return self

    @property
    def moves(self) -> bool:
        """Whether pictures show how a press moves it."""
        return self.deforms or self.shadows

    @property
    def has_own_material(self) -> bool:
        """Whether a modulus or a Poisson's ratio of its own is given."""
        return self.youngs_modulus_mpa is not None or self.poisson_ratio is not None


def shear_modulus(youngs_modulus_mpa: Modulus, poisson_ratio: Modulus) -> Modulus:
    """Return G = E / (2 (1 + nu)), in the unit of E."""
    return youngs_modulus_mpa / (2.0 * (1.0 + poisson_ratio))


def plane_strain_modulus(youngs_modulus_mpa: float, poisson_ratio: float) -> float:
    """Return E* = E / (1 - nu^2), in the unit of E (contact with a rigid body; Johnson 1985, 4.2).

    Raises
    ------
    InputError
        No stable solid has this E and nu.
    """
    if not (youngs_modulus_mpa > 0 and -1 < poisson_ratio <= 0.5):
        raise InputError(
            f"youngs_modulus_mpa = {youngs_modulus_mpa:g} MPa must be above 0, poisson_ratio = "
            f"{poisson_ratio:g} above -1 and at most 0.5"
        )
    return youngs_modulus_mpa / (1.0 - poisson_ratio**2)
