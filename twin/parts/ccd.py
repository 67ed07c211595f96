"""The CCD: what it adds to the light that reaches it. A preset gives every number, single keys override it."""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

from pydantic import Field

from twin.parts.part import Part

PRESETS = MappingProxyType(
    {
        # psf_px, read_noise_e, full_well_e, white_dn, gamma, bits, noise
        "ideal": {"psf_px": 0.0, "read_noise_e": 0.0, "full_well_e": 1e9, "gamma": 1.0, "noise": False},
        "industrial": {"psf_px": 0.7, "read_noise_e": 12.0, "full_well_e": 20000.0, "gamma": 1.0, "noise": True},
    }
)


class Ccd(Part):
    """An 8-bit colour CCD.

    Attributes
    ----------
    preset
        ``ideal`` (no blur, no noise) or ``industrial`` (a machine-vision camera after EMVA 1288 data sheets: about
        half a count of read noise and shot noise of a 20 000 electron well).
    psf_px
        Standard deviation of the Gaussian point-spread function.
    read_noise_e
        Read noise, electrons rms.
    full_well_e
        Electrons at the largest count.
    gamma
        Count = largest (light share)^(1/gamma).
    white_dn
        Count that the brightest marker pixel of the rest picture is exposed to.
    crosstalk
        Share of each colour that leaks into each other channel.
    """

    preset: Literal["ideal", "industrial"] = "industrial"
    psf_px: float | None = Field(default=None, ge=0, le=20)
    read_noise_e: float | None = Field(default=None, ge=0, le=1e6)
    full_well_e: float | None = Field(default=None, gt=0, le=1e12)
    gamma: float | None = Field(default=None, ge=0.2, le=5)
    noise: bool | None = None
    white_dn: float = Field(default=200.0, gt=0, le=255)
    crosstalk: float = Field(default=0.05, ge=0, le=0.3)

    def spelt_out(self) -> Ccd:
        """Return the same CCD with the preset's numbers filled in."""
        preset = PRESETS[self.preset]
        return self.model_copy(update={k: v for k, v in preset.items() if getattr(self, k) is None})
