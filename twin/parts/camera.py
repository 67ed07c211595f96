"""The camera behind the body: entrance pupil, lens, and the flat transparent layers it looks through."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from twin.parts.part import Part
from twin.parts.ranges import Angle, Coefficient, Pixel, Place, Size

Lens = Literal["pinhole", "equidistant"]
"""What each makes of an angle is in `twin.theory.lens`."""

DISTORTIONS: dict[str, tuple[int, ...]] = {"pinhole": (0, 2, 4, 5, 8), "equidistant": (0, 2, 4)}
"""How many coefficients of distortion each may have."""


class Layer(Part):
    """A flat transparent layer between the body's base and the camera.

    Attributes
    ----------
    index
        Refractive index.
    thickness_mm
        Thickness along z.
    """

    index: float = Field(ge=1, le=3)
    thickness_mm: Size


class Camera(Part):
    """A camera in air that looks along -z through the base, the layers in front of it being flat and normal to z.

    A recipe may name ``intrinsics``, a file of OpenCV's: its size, focal length, principal point and distortion stand
    for those keys.

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
        In OpenCV's order. Of a pinhole lens (Brown-Conrady) k1, k2; or k1, k2, p1, p2; or with k3; or with k3 to k6.
        Of an equidistant lens (Kannala-Brandt) k1, k2; or k1 to k4.
    vignetting
        Light falls as the cosine of the angle to the optical axis to this power; 4 is the natural law of a plain lens.
    aperture_mm, focus_z_mm
        Diameter of the entrance pupil, and the height z of what it shows sharply; a pupil of 0 shows everything so.
    pupil_mm
        Position of the entrance pupil; its z lies behind the base and the layers, the rest of the way being air.
    tilt_deg
        Small rotations of the camera about x, y and z, applied in this order.
    layers
        Between base and air, in the order in which a ray leaving the body meets them.
    """

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
    def centre_px(self) -> tuple[float, float]:
        """(column, row) of the optical axis."""
        return self.principal_px or ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
