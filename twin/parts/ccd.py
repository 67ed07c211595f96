"""The CCD: what it adds to the light that reaches it. A preset gives every number, single keys override it."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Literal

from pydantic import Field, model_validator

from twin.parts.part import Part

Triple = tuple[float, float, float]
Mosaic = Literal["none", "rggb", "bggr", "grbg", "gbrg"]

_CLEAN: dict[str, Any] = {
    "psf_px": 0.0, "read_noise_e": 0.0, "full_well_e": 1e9, "gamma": 1.0, "noise": False,
    "dark_current_e_s": 0.0, "exposure_ms": 10.0, "prnu_pct": 0.0, "dsnu_e": 0.0, "black_dn": 0.0,
    "quantum_efficiency": (1.0, 1.0, 1.0), "bayer": "none", "interlace": False, "bandwidth_mhz": None,
    "jpeg_quality": None,
}  # fmt: skip

PRESETS = MappingProxyType(
    {
        "ideal": _CLEAN,
        "industrial": {**_CLEAN, "psf_px": 0.7, "read_noise_e": 12.0, "full_well_e": 20000.0, "noise": True},
        "kamiyama_ntsc": {
            **_CLEAN, "psf_px": 0.6, "read_noise_e": 25.0, "full_well_e": 15000.0, "noise": True, "exposure_ms": 16.7,
            "dark_current_e_s": 100.0, "prnu_pct": 1.0, "dsnu_e": 5.0, "gamma": 2.2, "interlace": True,
            "bandwidth_mhz": (4.2, 1.3, 0.4), "bayer": "none",
        },
        "sato_60fps": {
            **_CLEAN, "psf_px": 0.7, "read_noise_e": 20.0, "full_well_e": 10000.0, "noise": True, "exposure_ms": 15.0,
            "dark_current_e_s": 50.0, "prnu_pct": 1.0, "dsnu_e": 3.0, "quantum_efficiency": (0.9, 1.0, 0.8),
            "bayer": "rggb", "jpeg_quality": 85,
        },
    }
)  # fmt: skip


class Ccd(Part):
    """An 8-bit colour CCD and what lies between it and the computer.

    Attributes
    ----------
    preset
        ``ideal`` (no blur, no noise); ``industrial`` (a machine-vision camera after EMVA 1288 data sheets: about half a
        count of read noise and shot noise of a 20 000 electron well); ``kamiyama_ntsc`` (composite video through a
        capture unit); ``sato_60fps`` (one chip under a colour mosaic, compressed).
    psf_px
        Standard deviation of the Gaussian point-spread function.
    quantum_efficiency
        Electrons per photon of the red, green and blue pixels. Only their ratios count, as the exposure follows from
        ``white_dn``.
    crosstalk
        Share of each colour that leaks into each other channel; or the whole 3 x 3 matrix, a row for each channel of
        the camera.
    full_well_e
        Electrons at the largest count.
    read_noise_e
        Read noise, electrons rms.
    dark_current_e_s, exposure_ms
        Electrons that gather without light, per second, and for how long.
    prnu_pct, dsnu_e
        Standard deviations over the pixels of their gain, percent, and of their dark signal, electrons: the same in
        every picture of a sensor.
    noise
        False leaves all noise and both fixed patterns out.
    white_dn
        Count that the brightest marker pixel of the rest picture is exposed to.
    exposure
        Factor on that exposure: 2 is a stop over, 0.5 a stop under.
    black_dn
        Count of no light.
    gamma
        Count = largest (light share)^(1/gamma).
    bayer
        Colours of the first two rows' first two pixels under a mosaic (interpolated bilinearly), or ``none``: each
        pixel sees three colours, as with three chips.
    interlace
        A field is every other line, each the mean of two lines of pixels; the second field is exposed a field later.
    bandwidth_mhz
        Where composite video loses half the power of luminance and of the colour signals I and Q, for an active line of
        52.66 us (NTSC: 4.2, 1.3 and 0.4).
    jpeg_quality
        Pictures are compressed at this quality, 1 to 100.
    """

    preset: Literal["ideal", "industrial", "kamiyama_ntsc", "sato_60fps"] = "industrial"
    psf_px: float | None = Field(default=None, ge=0, le=20)
    read_noise_e: float | None = Field(default=None, ge=0, le=1e6)
    full_well_e: float | None = Field(default=None, ge=1, le=1e12)
    gamma: float | None = Field(default=None, ge=0.2, le=5)
    noise: bool | None = None
    white_dn: float = Field(default=200.0, gt=0, le=255)
    crosstalk: float | tuple[Triple, Triple, Triple] = 0.05
    quantum_efficiency: Triple | None = None
    dark_current_e_s: float | None = Field(default=None, ge=0, le=1e9)
    exposure_ms: float | None = Field(default=None, gt=0, le=1e5)
    prnu_pct: float | None = Field(default=None, ge=0, le=50)
    dsnu_e: float | None = Field(default=None, ge=0, le=1e6)
    exposure: float = Field(default=1.0, gt=0, le=1000)
    black_dn: float | None = Field(default=None, ge=0, le=100)
    bayer: Mosaic | None = None
    interlace: bool | None = None
    bandwidth_mhz: Triple | None = None
    jpeg_quality: int | None = Field(default=None, ge=1, le=100)

    @model_validator(mode="after")
    def _colours_are_shares(self) -> Ccd:
        told = self.crosstalk
        if isinstance(told, float) and not 0 <= told <= 0.3:
            raise ValueError(f"crosstalk = {told:g}: must be 0 to 0.3, or a matrix of three rows of three shares")
        if not isinstance(told, float) and not all(0 <= share <= 1 for row in told for share in row):
            raise ValueError("crosstalk: every share of the matrix must be 0 to 1")
        if not isinstance(told, float) and not all(sum(row) > 0 for row in told):
            raise ValueError("crosstalk: a row of the matrix is all 0, so that channel sees nothing: give it a share")
        if self.quantum_efficiency is not None and not all(0 < share <= 1 for share in self.quantum_efficiency):
            raise ValueError(f"quantum_efficiency = {self.quantum_efficiency}: each must be above 0 and at most 1")
        if self.bandwidth_mhz is not None and not all(0.05 <= f <= 100 for f in self.bandwidth_mhz):
            raise ValueError(f"bandwidth_mhz = {self.bandwidth_mhz}: each must be 0.05 to 100 MHz")
        return self

    def spelt_out(self) -> Ccd:
        """Return the same CCD with the preset's numbers filled in."""
        preset = PRESETS[self.preset]
        return self.model_copy(update={k: v for k, v in preset.items() if getattr(self, k) is None})
