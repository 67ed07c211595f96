"""The camera behind the body: entrance pupil, lens, flat layers in front of it, LEDs and CCD."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Floats, Points, frozen
from twin.errors import RecipeError
from twin.parts.part import LEAST_MM, Angle, Coefficient, Flag, Part, Pixel, Place, Share, Size

Power = Annotated[float, Field(ge=0, le=1e3)]
Gain = Annotated[float, Field(gt=0, le=100)]
Efficiency = Annotated[float, Field(gt=0, le=1)]
Megahertz = Annotated[float, Field(ge=0.05, le=100)]

Lens = Literal["pinhole", "equidistant"]
"""What each makes of an angle is in `twin.theory.lens`."""

_TURNS = np.arange(6) * np.pi / 3
DISC_POINTS: Floats = np.concatenate(
    [np.zeros((1, 2)), np.sqrt(2 / 3) * np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])]
)
DISC_WEIGHTS: Floats = np.array([0.25, *[0.125] * 6])
"""Points of a disc of radius 1 and their weights: a rule exact for polynomials of degree 5 (Stroud
S2 5-1), the middle and a hexagon."""

DISTORTIONS: dict[str, tuple[int, ...]] = {"pinhole": (0, 2, 4, 5, 8), "equidistant": (0, 2, 4)}
"""How many coefficients of distortion each may have."""


class Camera(Part):
    """A camera in air that looks along -z through the base, the layers in front of it being flat
    and normal to z.

    A recipe may name ``intrinsics``, a file of OpenCV's: its size, focal length, principal point
    and distortion stand for those keys.

    Attributes
    ----------
    width_px, height_px
        Size of the picture.
    lens
        ``pinhole``: radius in px = focal_px tan(angle); ``equidistant``: focal_px times the angle.
    focal_px
        Focal length in px (px per radian on the axis).
    aspect
        Focal length along rows over that along columns: 1 for square pixels.
    principal_px
        (column, row) of the optical axis; the middle of the picture if not given.
    distortion
        In OpenCV's order. Of a pinhole lens (Brown-Conrady) k1, k2; or k1, k2, p1, p2; or with k3;
        or with k3 to k6. Of an equidistant lens (Kannala-Brandt) k1, k2; or k1 to k4.
    vignetting
        Light falls as the cosine of the angle to the optical axis to this power; 4 is the natural
        law of a plain lens.
    aperture_mm, focus_z_mm
        Diameter of the entrance pupil, and the height z of what it shows sharply; a pupil of 0
        shows everything so.
    pupil_mm
        Position of the entrance pupil; its z lies behind the base and the layers, the rest of the
        way being air.
    tilt_deg
        Small rotations of the camera about x, y and z, applied in this order.
    layers
        Between base and air, in the order in which a ray leaving the body meets them.
    dust, scratches, bubbles
        Marks on the outermost of them, or in the rubber, three kinds of them at most; None for
        none.
    """

    class Layer(Part):
        """A flat transparent layer between the body's base and the camera.

        Attributes
        ----------
        index
            Refractive index.
        thickness_mm
            Thickness along z.
        abbe_number
            As that of the rubber: glass has 64, acrylic 57.
        """

        index: float = Field(ge=1, le=3)
        thickness_mm: Size
        abbe_number: float | None = Field(default=None, ge=10, le=200)

    class Marks(Part):
        """Specks, scratches or bubbles: on the outer face of the window, lit by LEDs in air, or in
        the rubber, which carries them.

        Attributes
        ----------
        count, seed
            How many lie over the body's extent, and what draws their places: the same for every
            picture and every sensor.
        size_mm
            Diameter, or width of a scratch. Marks narrower than half a pixel are not seen; through
            a wide pupil one out of focus is seven fainter ones.
        length_mm
            Of straight scratches in all directions; 0: round marks.
        hollow
            Share of the width that is clear, in the middle: a bubble's rim is what shows, as its
            middle lets light pass. In silicone 0.7, from where on rays are reflected totally.
        albedo
            Diffuse reflectance; 0 is black.
        depth_mm
            Depth below the sensing surface at which they lie in the rubber, as balls of
            ``size_mm`` that move and strain with it; None: on the window.
        """

        count: int = Field(ge=1, le=100_000)
        size_mm: Size = 0.1
        length_mm: float = Field(default=0.0, ge=0, le=1000)
        hollow: float = Field(default=0.0, ge=0, le=0.99)
        albedo: Share = 0.3
        depth_mm: float | None = Field(default=None, ge=LEAST_MM, le=100)
        seed: int = Field(default=1, ge=0, le=2**63 - 1)

        @model_validator(mode="after")
        def _not_too_many(self) -> Camera.Marks:
            if self.depth_mm is not None and self.length_mm:
                raise ValueError(
                    f"depth_mm = {self.depth_mm:g}: scratches, which have a length_mm, lie on the "
                    "window; leave one of both out"
                )
            if self.count * self.length_mm > 1e6 * self.size_mm:
                raise ValueError(
                    f"length_mm = {self.length_mm:g}: {self.count} scratches are more than a "
                    "million times as long as wide in all: take fewer, shorter or wider ones"
                )
            return self

        def lines(self, low: Sequence[float], high: Sequence[float]) -> Floats:
            """Return the (count, 2, 2) ends of middle lines between two corners, mm."""
            rng = np.random.default_rng(self.seed)
            middles = rng.uniform(low[:2], high[:2], (self.count, 2))
            angle = rng.uniform(0, np.pi, self.count)
            half = self.length_mm / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
            return np.stack([middles - half, middles + half], axis=1)

    width_px: int = Field(default=640, ge=1, le=8192)
    height_px: int = Field(default=480, ge=1, le=8192)
    lens: Lens = "pinhole"
    focal_px: float = Field(gt=1, le=1e6)
    aspect: float = Field(default=1.0, gt=0.1, lt=10)
    principal_px: tuple[Pixel, Pixel] | None = None
    distortion: tuple[Coefficient, ...] = (0.0, 0.0)
    vignetting: float = Field(default=0.0, ge=0, le=20)
    aperture_mm: float = Field(default=0.0, ge=0, le=50)
    focus_z_mm: Place = 0.0
    pupil_mm: tuple[Place, Place, Place]
    tilt_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    layers: tuple[Layer, ...] = ()
    dust: Marks | None = None
    scratches: Marks | None = None
    bubbles: Marks | None = None

    @model_validator(mode="after")
    def _distortion_has_a_known_length(self) -> Camera:
        known = DISTORTIONS[self.lens]
        if len(self.distortion) not in known:
            raise ValueError(
                f"distortion: {len(self.distortion)} coefficients; a lens = '{self.lens}' has "
                f"{', '.join(map(str, known[1:]))}: fill up with zeros"
            )
        return self

    @property
    def on_window(self) -> list[Marks]:
        """The marks on the window."""
        return [each for each in self._marks if each.depth_mm is None]

    @property
    def in_rubber(self) -> list[Marks]:
        """The marks in the rubber."""
        return [each for each in self._marks if each.depth_mm is not None]

    def without_marks_in_rubber(self) -> Camera:
        """Return the camera with the marks on the window alone."""
        kinds = ("dust", "scratches", "bubbles")
        none = {kind: None for kind in kinds if getattr(self, kind) in self.in_rubber}
        return self.model_copy(update=none)

    @property
    def _marks(self) -> list[Marks]:
        return [each for each in (self.dust, self.scratches, self.bubbles) if each is not None]

    @property
    def centre_px(self) -> tuple[float, float]:
        """(column, row) of the optical axis."""
        return self.principal_px or ((self.width_px - 1) / 2, (self.height_px - 1) / 2)

    @property
    def is_plain(self) -> bool:
        """Whether the lens is a pinhole or thin, about its axis, and bends and dims nothing."""
        middle = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        off = float(np.abs(np.subtract(self.centre_px, middle)).max())
        bent = self.lens != "pinhole" or any(self.distortion) or self.aspect != 1
        return not bent and self.vignetting == 0 and (self.aperture_mm == 0 or off < 1e-9)

    @property
    def window_mm(self) -> float:
        """Thickness of all layers between the body and the camera, mm."""
        return sum(layer.thickness_mm for layer in self.layers)

    def deviating(
        self,
        base_z_mm: float,
        pupil_mm: Sequence[float],
        tilt_deg: Sequence[float],
        focal: float,
        distortion: float,
    ) -> Camera:
        """Return this camera as made: pupil, mm, and tilt, deg, moved; focal length changed by a
        share; first coefficient of distortion changed. The pupil stays behind base and layers."""
        x, y, z = (a + b for a, b in zip(self.pupil_mm, pupil_mm, strict=True))
        k1, k2, *others = self.distortion or (0.0, 0.0)
        changes = {
            "pupil_mm": (x, y, max(z, base_z_mm + self.window_mm)),
            "tilt_deg": tuple(a + b for a, b in zip(self.tilt_deg, tilt_deg, strict=True)),
            "focal_px": self.focal_px * (1 + focal),
            "distortion": (k1 + distortion, k2, *others),
        }
        return self.model_copy(update=changes)

    def tilt_matrix(self) -> Floats:
        """Return the (3, 3) rotation from camera to body axes: turns about x, then y, then z."""
        return _tilted(tuple(self.tilt_deg))

    def air_gap_mm(self, base_z_mm: float) -> float:
        """Return the way from the last layer to the pupil, mm; `RecipeError` for one in front."""
        back = base_z_mm + self.window_mm
        gap = self.pupil_mm[2] - back
        if gap < -1e-9:
            raise RecipeError(
                f"camera.pupil_mm: z = {self.pupil_mm[2]:.6g} mm must be at least {back:.6g} mm, "
                "behind the base and the layers: move the pupil back or thin the layers"
            )
        return max(gap, 0.0)


class Light(Part):
    """LEDs that shine along -z, plus a weak even light.

    Attributes
    ----------
    positions_mm
        (x, y, z) of every LED: in air behind the base and its layers, or in the body.
    exponent
        Emission falls off as cos(angle to -z) to this power: 1 is Lambertian.
    profile
        Emission as a table instead, of (angle to -z in degrees, share of the largest), joined by
        straight lines; 0 beyond the last.
    radius_mm
        Radius of each LED's disc, which lies across z, shines evenly, and is seen where the window
        mirrors it; 0 is a point, whose mirror image has no size. Fast renderers take a disc as
        seven points, and ``renderer = "path"`` as it is.
    ambient
        Share of the brightness that comes from all sides (scattering in the body), 0 to 1. It has
        the LEDs' mean colour.
    colours
        Red, green and blue power of each LED; 1 each if there are none.
    lit
        Groups of LEDs, by their numbers from 0: frame k of a sequence, from 0, is lit by group k
        modulo their number. Empty: all LEDs always shine.
    outside
        Red, green and blue light of the surroundings, 1 for white in the brightest marker's place,
        that the camera sees through rubber without a cover, or through one with ``transmittance``,
        where no probe is in its way. It lights nothing.
    """

    positions_mm: tuple[tuple[Place, Place, Place], ...] = Field(min_length=1, max_length=64)
    exponent: float = Field(default=1.0, ge=0, le=50)
    profile: tuple[tuple[float, float], ...] | None = None
    radius_mm: float = Field(default=0.0, ge=0, le=50)
    ambient: float = Field(default=0.2, ge=0, le=1)
    colours: tuple[tuple[Power, Power, Power], ...] = ()
    lit: tuple[tuple[int, ...], ...] = ()
    outside: tuple[Power, Power, Power] = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _leds_are_known(self) -> Light:
        if self.colours and len(self.colours) != len(self.positions_mm):
            raise ValueError(
                f"colours: {len(self.colours)} for {len(self.positions_mm)} LEDs: give one for each"
            )
        if self.colours and not np.any(self.colours):
            raise ValueError("colours: every LED is dark; give one a power above 0")
        count = len(self.positions_mm)
        for number, group in enumerate(self.lit):
            if not group or len(set(group)) < len(group) or not set(group) <= set(range(count)):
                raise ValueError(
                    f"lit: group {number} is {list(group)}; give each group at least one of the "
                    f"numbers 0 to {count - 1} of the {count} LEDs, each once"
                )
            if not self.powers[list(group)].any():
                raise ValueError(
                    f"lit: every LED of group {number}, {list(group)}, is dark by light.colours; "
                    "give one a power above 0"
                )
        return self

    @model_validator(mode="after")
    def _profile_is_a_table(self) -> Light:
        if self.profile is None:
            return self
        angles, shares = [row[0] for row in self.profile], [row[1] for row in self.profile]
        rising = all(a < b for a, b in pairwise(angles))
        if not (len(angles) >= 2 and angles[0] == 0 and angles[-1] <= 180 and rising):
            raise ValueError(
                f"profile: angles {angles} deg must rise from 0 to at most 180, at least two of "
                "them"
            )
        if min(shares) < 0 or max(shares) <= 0:
            raise ValueError("profile: shares must be 0 or more, and one above 0")
        return self

    def emission(self, cosine: Floats) -> Floats:
        """Return the intensity at cosines of the angle to -z, 1 along -z for a cosine's power."""
        if self.profile is None:
            falling: Floats = (
                np.maximum(cosine, 0.0) ** self.exponent if self.exponent else np.ones_like(cosine)
            )
            return falling
        angles, shares = np.array(self.profile).T
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
        table: Floats = np.interp(angle, angles, shares / shares.max(), right=0.0)
        return table

    @property
    def groups(self) -> list[Light]:
        """The lights that take turns: each group of LEDs that shine together by itself."""
        if not self.lit:
            return [self]
        places, colours = self.positions_mm, self.colours
        return [
            self.model_copy(
                update={
                    "positions_mm": tuple(places[led] for led in group),
                    "colours": tuple(colours[led] for led in group) if colours else (),
                    "lit": (),
                }
            )
            for group in self.lit
        ]

    def turns(self) -> list[str]:
        """Return a warning for what sees only the first of the groups, if there are more."""
        if len(self.lit) < 2:
            return []
        return [
            f"light.lit: only the first of {len(self.lit)} groups of LEDs, {list(self.lit[0])}, is "
            "lit here; films (twin run --film), datasets with every_step and environments show all"
        ]

    @property
    def powers(self) -> Floats:
        """(n, 3) red, green and blue power of each LED."""
        return np.array(self.colours or np.ones((len(self.positions_mm), 3)), float)

    def points(self) -> tuple[Points, Floats]:
        """Return (n, 3) points that stand for LEDs, mm, and (n,) intensities in each one's
        brightest channel; a disc's are `DISC_POINTS`."""
        places = np.array(self.positions_mm, float)
        power = self.powers.max(axis=1)
        if self.radius_mm == 0:
            return places, power
        disc = np.pad(self.radius_mm * DISC_POINTS, ((0, 0), (0, 1)))
        return (places[:, None] + disc).reshape(-1, 3), (power[:, None] * DISC_WEIGHTS).ravel()

    def tints(self) -> tuple[Floats, Floats]:
        """Return (k, n) shares of `points`' intensities by channel, and the LEDs' (k,) mean colour
        relative to their brightest channels; k = 1 for white LEDs."""
        colours = self.powers
        if np.ptp(colours, axis=1).max() == 0:
            colours = colours[:, :1]
        power = colours.max(axis=1, keepdims=True)
        even = colours.sum(axis=0) / power.sum()
        each = 1 if self.radius_mm == 0 else len(DISC_WEIGHTS)
        return np.repeat(colours / np.maximum(power, 1e-300), each, axis=0).T, even


FULL_SCALE = 255
"""Largest count of a picture."""

Shares = tuple[Share, Share, Share]
Mosaic = Literal["none", "rggb", "bggr", "grbg", "gbrg"]
Off = Literal["off"]

_CLEAN: dict[str, Any] = {
    "psf_px": 0.0,
    "read_noise_e": 0.0,
    "full_well_e": 1e9,
    "gamma": 1.0,
    "noise": False,
    "dark_current_e_s": 0.0,
    "exposure_ms": 10.0,
    "prnu_pct": 0.0,
    "dsnu_e": 0.0,
    "black_dn": 0.0,
    "quantum_efficiency": (1.0, 1.0, 1.0),
    "bayer": "none",
    "interlace": False,
    "bandwidth_mhz": "off",
    "jpeg_quality": "off",
}

PRESETS = MappingProxyType(
    {
        "ideal": _CLEAN,
        "industrial": {
            **_CLEAN,
            "psf_px": 0.7,
            "read_noise_e": 32.0,
            "full_well_e": 20000.0,
            "noise": True,
        },
        "kamiyama_ntsc": {
            **_CLEAN,
            "psf_px": 0.6,
            "read_noise_e": 25.0,
            "full_well_e": 15000.0,
            "noise": True,
            "exposure_ms": 16.7,
            "dark_current_e_s": 100.0,
            "prnu_pct": 1.0,
            "dsnu_e": 5.0,
            "gamma": 2.2,
            "interlace": True,
            "bandwidth_mhz": (4.2, 1.3, 0.4),
        },
        "sato_60fps": {
            **_CLEAN,
            "psf_px": 0.7,
            "read_noise_e": 20.0,
            "full_well_e": 10000.0,
            "noise": True,
            "exposure_ms": 15.0,
            "dark_current_e_s": 50.0,
            "prnu_pct": 1.0,
            "dsnu_e": 3.0,
            "quantum_efficiency": (0.9, 1.0, 0.8),
            "bayer": "rggb",
            "jpeg_quality": 85,
        },
    }
)


class Ccd(Part):
    """A colour CCD and what lies between it and the computer.

    Attributes
    ----------
    preset
        ``ideal`` (no blur, no noise); ``industrial`` (a machine-vision camera: half a count of
        noise in the dark, and the shot noise of a 20 000 electron well); ``kamiyama_ntsc``
        (composite video through a capture unit); ``sato_60fps`` (one chip under a colour mosaic,
        compressed).
    psf_px
        Standard deviation of the lens's Gaussian point-spread function; the mean over a pixel's
        square comes on top.
    quantum_efficiency
        Electrons per photon of the red, green and blue pixels. Only their ratios count, as the
        exposure follows from ``white_dn``.
    crosstalk
        Share of each colour that leaks into each other channel; or the whole 3 x 3 matrix, a row
        for each channel of the camera.
    full_well_e
        Electrons at the largest count.
    read_noise_e
        Read noise, electrons rms.
    dark_current_e_s, exposure_ms
        Electrons that gather without light, per second, and for how long.
    frames_per_second
        How many pictures the camera takes of a press whose steps take seconds. Each is then the
        mean of the light over ``exposure_ms``; without it pictures are of one instant.
    readout_ms
        How much later than the first row the last one is exposed (a rolling shutter); the middle of
        the middle row's exposure is a picture's time. Only with ``frames_per_second``.
    prnu_pct, dsnu_e
        Standard deviations over the pixels of their gain, percent, and of their dark signal,
        electrons: the same in every picture of a sensor.
    hot_pixels, dead_pixels
        How many of the pixels, each of one colour, are always full, and how many see no light.
    row_noise_e, column_noise_e
        Standard deviations of an offset of each row, another one in every picture, and of each
        column, the same in every picture of a sensor; electrons.
    haze, haze_px
        Share of the light that lens and window scatter, and the standard deviation of the Gaussian
        in which it falls.
    ghost, ghost_px
        Share of the light that is mirrored twice between two faces, and how far along columns and
        rows from its place it falls.
    smear
        Light that a pixel gathers while its charge passes the others of its column, as a share of
        the column's mean: the time of the transfer over that of the exposure.
    flicker, flicker_hz
        LEDs that shine as 1 + flicker sin(2 pi flicker_hz t), in another phase in every picture. An
        exposure of whole periods sees nothing of it; a rolling shutter sees bands.
    auto_exposure, auto_gain
        Share of the pixels that are no brighter than ``white_dn`` (times ``exposure``), in every
        picture; 0 for none. The first changes the light before its noise, the second signal and
        noise, either by a factor of 100 at most.
    white_balance
        Factors on red, green and blue; or ``grey``, by which all have green's mean in every
        picture.
    adc_bits
        Bits to which each pixel is read before white balance and gamma; 0: no rounding but the last
        one, to ``bits``.
    bits
        Bits of a picture's counts. Those of 10 and 12 bits are stretched to 16, as PNG wants; all
        counts in this table are of 255 nevertheless.
    noise
        False leaves all noise, every fixed pattern and flicker out.
    white_dn
        Count that the brightest of the rest picture is exposed to, be it a marker or the ground
        behind the markers, of which one pixel in a hundred may be brighter.
    exposure
        Factor on that exposure: 2 is a stop over, 0.5 a stop under.
    black_dn
        Count of no light.
    gamma
        Count = largest (light share)^(1/gamma).
    bayer
        Colours of the first two rows' first two pixels under a mosaic (interpolated bilinearly), or
        ``none``: each pixel sees three colours, as with three chips.
    interlace
        A field is every other line, each the mean of two lines of pixels; the second field is
        exposed a field later.
    bandwidth_mhz
        Where composite video loses half the power of luminance and of the colour signals I and Q,
        for an active line of 52.66 us (NTSC: 4.2, 1.3 and 0.4); ``off`` for no video, whatever the
        preset.
    jpeg_quality
        Pictures are compressed at this quality, 1 to 100; ``off`` for no compression, whatever the
        preset.

    Notes
    -----
    Read noise of the presets, in counts, without and with the 0.29 of rounding to 8 bits:
    ``industrial`` 0.41 and 0.50, ``kamiyama_ntsc`` 0.43 and 0.51 before gamma, ``sato_60fps`` 0.51
    and 0.59. EMVA 1288 (release 3.1, section 6.6) takes a variance in the dark of 0.24 count^2, a
    standard deviation of 0.49, for the least that can be measured: below it rounding dominates, and
    dark pictures become constant.
    """

    preset: Literal["ideal", "industrial", "kamiyama_ntsc", "sato_60fps"] = "industrial"
    psf_px: float | None = Field(default=None, ge=0, le=20)
    read_noise_e: float | None = Field(default=None, ge=0, le=1e6)
    full_well_e: float | None = Field(default=None, ge=1, le=1e12)
    gamma: float | None = Field(default=None, ge=0.2, le=5)
    noise: Flag | None = None
    white_dn: float = Field(default=200.0, gt=0, le=FULL_SCALE)
    crosstalk: Annotated[float, Field(ge=0, le=0.3)] | tuple[Shares, Shares, Shares] = 0.05
    quantum_efficiency: tuple[Efficiency, Efficiency, Efficiency] | None = None
    dark_current_e_s: float | None = Field(default=None, ge=0, le=1e9)
    exposure_ms: float | None = Field(default=None, gt=0, le=1e5)
    frames_per_second: float | None = Field(default=None, gt=0, le=1e5)
    readout_ms: float = Field(default=0.0, ge=0, le=1e5)
    prnu_pct: float | None = Field(default=None, ge=0, le=50)
    dsnu_e: float | None = Field(default=None, ge=0, le=1e6)
    hot_pixels: int = Field(default=0, ge=0, le=10**6)
    dead_pixels: int = Field(default=0, ge=0, le=10**6)
    row_noise_e: float = Field(default=0.0, ge=0, le=1e6)
    column_noise_e: float = Field(default=0.0, ge=0, le=1e6)
    haze: float = Field(default=0.0, ge=0, le=0.9)
    haze_px: float = Field(default=30.0, ge=0.5, le=4096)
    ghost: float = Field(default=0.0, ge=0, le=0.5)
    ghost_px: tuple[Pixel, Pixel] = (8.0, 0.0)
    smear: float = Field(default=0.0, ge=0, le=1)
    flicker: Share = 0.0
    flicker_hz: float = Field(default=100.0, gt=0, le=1e6)
    auto_exposure: Share = 0.0
    auto_gain: Share = 0.0
    white_balance: tuple[Gain, Gain, Gain] | Literal["grey", "off"] = "off"
    adc_bits: int = Field(default=0, ge=0, le=16)
    bits: Literal[8, 10, 12] = 8
    exposure: float = Field(default=1.0, gt=0, le=1000)
    black_dn: float | None = Field(default=None, ge=0, le=100)
    bayer: Mosaic | None = None
    interlace: Flag | None = None
    bandwidth_mhz: tuple[Megahertz, Megahertz, Megahertz] | Off | None = None
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | Off | None = None

    @model_validator(mode="after")
    def _every_channel_sees(self) -> Ccd:
        if isinstance(self.crosstalk, tuple) and not all(map(any, self.crosstalk)):
            raise ValueError(
                "crosstalk: a row of the matrix is all 0: its channel sees nothing; give it a share"
            )
        if self.bits > 8 and isinstance(self.spelt_out().jpeg_quality, int):
            raise ValueError(f"bits = {self.bits}: JPEG has 8; set jpeg_quality = 'off'")
        return self

    @model_validator(mode="after")
    def _fits_a_frame(self) -> Ccd:
        exposure_ms = self.spelt_out().exposure_ms
        if self.frames_per_second is None:
            if self.readout_ms:
                raise ValueError(f"readout_ms = {self.readout_ms:g}: give frames_per_second, too")
        elif max(exposure_ms, self.readout_ms) * self.frames_per_second > 1000:
            raise ValueError(
                f"exposure_ms = {exposure_ms:g} and readout_ms = {self.readout_ms:g}: each must be "
                f"at most a frame's time, 1000 / frames_per_second = "
                f"{1000 / self.frames_per_second:.4g} ms"
            )
        return self

    def spelt_out(self) -> Any:
        """Return the same CCD with the preset's numbers filled in: none of them is None."""
        preset = PRESETS[self.preset]
        return self.model_copy(update={k: v for k, v in preset.items() if getattr(self, k) is None})

    def pixel_sd(self, counts: float) -> float:
        """Return a pixel's standard deviation at counts, counts: shot, read and rounding noise."""
        own = self.spelt_out()
        gain = own.full_well_e / FULL_SCALE
        return float(np.sqrt((counts * gain + own.read_noise_e**2) / gain**2 + 1 / 12))

    @property
    def response(self) -> Floats:
        """(3, 3) matrix from red, green and blue light to the camera's channels.

        The rows of an even crosstalk sum to 1 before the quantum efficiencies, which count relative
        to the largest.
        """
        efficiency = np.asarray(self.spelt_out().quantum_efficiency, float)
        mixing = np.array(self.crosstalk)
        if isinstance(self.crosstalk, float):
            mixing = np.full((3, 3), self.crosstalk) + (1 - 3 * self.crosstalk) * np.eye(3)
        response: Floats = mixing * (efficiency / efficiency.max())[:, None]
        return response

    @property
    def white_level(self) -> float:
        """Light, as a share of full wells, whose count is ``white_dn``, times ``exposure``."""
        full = self.spelt_out()
        share = max(self.white_dn - full.black_dn, 1.0) / (FULL_SCALE - full.black_dn)
        return float(share**full.gamma) * self.exposure


@lru_cache(maxsize=64)
def _tilted(tilt_deg: tuple[float, float, float]) -> Floats:
    turn = np.eye(3)
    for axis, angle in enumerate(np.deg2rad(tilt_deg)):
        cosine, sine = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i] = step[j, j] = cosine
        step[i, j], step[j, i] = -sine, sine
        turn = step @ turn
    return frozen(turn)
